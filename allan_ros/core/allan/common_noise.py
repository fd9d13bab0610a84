# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise that sensors at rest have in common, such as vibration, and noise of individual sensors.

Method
------
The Allan covariance of two sensors a and b is (V(a) + V(b) - V(a - b)) / 2, where V is the Allan
variance of the samples of a sensor, or of the differences of the samples of both sensors.

A signal that all sensors measure equally cancels in the differences. From the differences of three
or more sensors, the noise of each individual sensor follows ("three-cornered hat": Gray & Allan, A
method for estimating the frequency stability of an individual oscillator, 28th Symp. Frequency
Control, 1974). `transfer` tests whether all sensors measure the common signal equally.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations
from operator import add
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..estimate import Z_95, Estimate
from ..imu import ImuIdentity
from ..nonnegative import nonnegative_least_squares
from .curve import allan_curve
from .grid import allan_variance
from .running import RunningSums
from .sums import AllanSums
from .transfer import transfer

Floats = NDArray[np.float64]

SAME_RATE = 0.01
"""Largest relative difference of two sample periods that are treated as equal."""

BLOCKS, T_95 = 20, 2.093
"""Number of blocks of the jackknife, and 97.5 % quantile of Student's t with 19 degrees of
freedom."""

LEAST_BLOCK = 64
"""Smallest number of samples of a block of the jackknife."""

ROUNDING_SHARE = 1e-20
"""Ratio of the variance of one signal to the variance of another signal, below which the first
signal is regarded as constant, because its variance is due to rounding errors."""

LEAST_DEGREES = 8.0
"""Smallest number of degrees of freedom for which a coherence is computed."""


class Coherence(NamedTuple):
    """Coherence (correlation, -1 to 1) of two signals at each averaging time, with its interval.

    The coherence with constant samples is NaN.
    """

    tau: Floats  # averaging times in s, (taus,)
    value: Floats  # coherence at each averaging time, (taus,)
    low: Floats  # lower ends of the 95 % intervals, (taus,)
    high: Floats  # upper ends of the 95 % intervals, (taus,)


@dataclass(frozen=True)
class CommonNoise:
    """Noise of one axis of an IMU, and how much of this noise other IMUs measure at the same time.

    An object of this class may also compare two axes of one IMU.

    Attributes
    ----------
    axis : str
        Name of the axis, such as 'gyro_x', or names of the two axes, such as 'gyro_x gyro_y'.
    label : str
        Name of the IMU.
    coherence : Coherence
        Correlation of the second differences of the axis with the second differences of the mean of
        the other IMUs, or of the other axis. It is near 0 for independent noise, and near 1 if
        nearly all noise is common.
    measured : Estimate or None
        N of the axis in SI, including common noise. None if two axes are compared, or if the
        samples are constant.
    own : Estimate or None
        N in SI without the noise that all IMUs measure equally. With two IMUs, only the root mean
        square of both values is known. It is given for both, times the ``gain`` of each IMU. None
        if two axes are compared, if the differences of the samples of the IMUs are constant, or if
        the IMUs measure the common noise with differences that ``gain`` does not correct.
    gain : float
        Factor with which the IMU measures the common noise; the geometric mean of the factors of
        all IMUs is 1.
    leak : float
        Share of common noise in the power of the difference of two IMUs, for the pair of IMUs with
        the largest share. This noise would be mistaken for own noise. 0 if there are too few
        samples to measure it (`transfer`).
    """

    axis: str
    label: str
    coherence: Coherence
    measured: Estimate | None = None
    own: Estimate | None = None
    gain: float = 1.0
    leak: float = 0.0


class Samples(NamedTuple):
    """Samples of one axis of one or several sensors."""

    stamps: NDArray[np.int64]  # (n,) in ns, ascending
    values: Floats  # in SI: (n,) for one sensor, (sensors, n) for several sensors


def common_noise(axis: str, imus: Sequence[Samples], labels: Sequence[str]) -> list[CommonNoise]:
    """Return the common and the own noise of one axis of two or more IMUs at rest on one body.

    Parameters
    ----------
    axis : str
        Name of the axis.
    imus : sequence of Samples
        Samples of this axis of each IMU, at least two samples each.
    labels : sequence of str
        Names of the IMUs.

    Returns
    -------
    list of CommonNoise
        One item for each IMU.

    Raises
    ------
    AllanError
        If the rates differ by more than 1 %, or the recordings overlap for too short a time.
    """
    parts, imu_count, rows = aligned(imus), len(imus), []
    imu_transfer = transfer([part.values for part in parts])
    parts = [part._replace(values=part.values / imu_transfer.gains[:, None]) for part in parts]
    blocks = _sums(axis, parts)
    covariance, noise = _allan_covariance(blocks, imu_count), white_noise(blocks, imu_count)
    for i, label in enumerate(labels):
        weights_of_imu = np.eye(imu_count)[i]
        weights_of_others = (1.0 - weights_of_imu) / (imu_count - 1)
        coherence = _coherence(*covariance, weights_of_imu, weights_of_others)
        gain = float(imu_transfer.gains[i])
        measured, own_noise = (
            None if estimate is None else estimate.times(gain)
            for estimate in (noise[i], noise[imu_count + i])
        )
        own_noise = own_noise if imu_transfer.is_equal else None
        rows.append(
            CommonNoise(axis, label, coherence, measured, own_noise, gain, imu_transfer.leak)
        )
    return rows


def common_of_axes(
    axes: Sequence[str], samples: Sequence[Samples], label: str
) -> list[CommonNoise]:
    """Return the coherence of each pair of axes of one IMU.

    ``samples`` are the samples of each of the ``axes``, and ``label`` is the name of the IMU.

    Raises
    ------
    AllanError
        If the rates differ by more than 1 %, or there are too few samples.
    """
    blocks = _sums(axes[0], aligned(samples))
    covariance, basis = _allan_covariance(blocks, len(axes)), np.eye(len(axes))
    return [
        CommonNoise(f'{axes[i]} {axes[j]}', label, _coherence(*covariance, basis[i], basis[j]))
        for i, j in combinations(range(len(axes)), 2)
    ]


def aligned(sensors: Sequence[Samples]) -> list[Samples]:
    """Return the samples of all sensors at the times of the first sensor, in parts without a gap.

    For each stamp of the first sensor, the sample of each other sensor with the nearest stamp is
    used. A stamp is excluded if the nearest stamp of some sensor is more than one sample period
    away; the sample period is the median of the first sensor. Each sensor has at least two samples.
    The values of each part are in SI, (sensors, n).

    Raises
    ------
    AllanError
        If the rates differ by more than 1 %.
    """
    periods = [float(np.median(np.diff(sensor.stamps))) for sensor in sensors]
    if max(periods) > (1.0 + SAME_RATE) * min(periods):
        rates = ', '.join(f'{1e9 / period:.6g}' for period in periods)
        raise AllanError(f'the rates differ ({rates} Hz): record all IMUs at the same rate')
    times = sensors[0].stamps
    has_all_sensors, values_at_times = np.ones(len(times), bool), []
    for stamps, values in sensors:
        next_indices = np.searchsorted(stamps, times).clip(1, len(stamps) - 1)
        nearest_indices = next_indices - (
            times - stamps[next_indices - 1] < stamps[next_indices] - times
        )
        has_all_sensors &= np.abs(stamps[nearest_indices] - times) <= periods[0]
        values_at_times.append(values[nearest_indices])
    used_indices = np.flatnonzero(has_all_sensors)
    parts = np.split(
        used_indices, np.flatnonzero(np.diff(times[used_indices]) > 1.5 * periods[0]) + 1
    )
    return [Samples(times[part], np.array(values_at_times)[:, part]) for part in parts if len(part)]


def _pairs(sensor_count: int) -> Floats:
    """Return the weight of each sensor in the difference of each pair, (pairs, sensors)."""
    basis = np.eye(sensor_count)
    return np.array([basis[i] - basis[j] for i, j in combinations(range(sensor_count), 2)])


def _sums(axis: str, parts: Sequence[Samples]) -> list[AllanSums]:
    """Return the Allan sums of each block; their columns are the sensors, then the pairs.

    The column of a pair contains the sums of the difference of both sensors. ``parts`` are from
    `aligned`. The `BLOCKS` blocks have equal numbers of samples. Raises AllanError if the blocks
    are too short.
    """
    sensor_count = len(parts[0].values) if parts else 0
    pairs = _pairs(sensor_count) if sensor_count else np.zeros((0, 0))
    size = sum(len(part.stamps) for part in parts) // BLOCKS
    if size < LEAST_BLOCK:
        raise AllanError('the recordings have too little time in common: record them together')
    names = tuple(f'{axis} {i}' for i in range(sensor_count + len(pairs)))
    running, blocks = RunningSums(ImuIdentity(), names), []
    for stamps, rows in parts:
        while len(stamps):
            taken = slice(size - running.samples)
            values = np.concatenate([rows[:, taken], pairs @ rows[:, taken]])
            running.update(values.T, int(stamps[taken][0]), int(stamps[taken][-1]))
            running.end_segment()
            stamps, rows = stamps[taken.stop :], rows[:, taken.stop :]
            if running.samples == size:
                blocks.append(running.sums)
                running = RunningSums(ImuIdentity(), names)
    return blocks


def _allan_covariance(
    blocks: Sequence[AllanSums], sensor_count: int
) -> tuple[Floats, Floats, Floats]:
    """Return averaging times, Allan covariances, and degrees of freedom of the covariances.

    The arrays are (taus,), (taus, sensors, sensors) and (taus,). ``blocks`` are from `_sums`.
    Averaging times with too few degrees of freedom are omitted.
    """
    curve = allan_curve(reduce(add, blocks))
    # an Allan covariance of two independent sensors has at least as many degrees of freedom as the
    # geometric mean of the degrees of freedom of their Allan variances
    mean_edf = np.exp(np.log(curve.edf[:, :sensor_count]).mean(axis=1))
    has_enough_edf = mean_edf >= LEAST_DEGREES
    avar = curve.adev[has_enough_edf] ** 2
    covariance = np.array([np.diag(row[:sensor_count]) for row in avar])
    for column, (i, j) in enumerate(combinations(range(sensor_count), 2), sensor_count):
        pair_covariance = (avar[:, i] + avar[:, j] - avar[:, column]) / 2.0
        covariance[:, i, j] = covariance[:, j, i] = pair_covariance
    return curve.tau[has_enough_edf], covariance, mean_edf[has_enough_edf]


def _coherence(
    tau: Floats, covariance: Floats, degrees: Floats, first: Floats, second: Floats
) -> Coherence:
    """Return the correlation of two weighted sums of sensors, with Fisher's 95 % interval.

    ``first`` and ``second``, (sensors,), are the weights of the sensors in the two sums.
    ``degrees`` are the degrees of freedom of the ``covariance`` at each averaging time. The
    correlation is NaN if one of the sums is constant, except for rounding errors.
    """
    variances = np.stack([covariance @ first @ first, covariance @ second @ second])
    has_noise = variances.min(axis=0) > ROUNDING_SHARE * variances.max(axis=0)
    with np.errstate(invalid='ignore', divide='ignore'):
        scale = np.where(has_noise, np.sqrt(variances.prod(axis=0)), np.nan)
        value = np.clip(covariance @ first @ second / scale, -1.0, 1.0)
        z, half_width = np.arctanh(value), Z_95 / np.sqrt(degrees - 2.0)
    return Coherence(tau, value, np.tanh(z - half_width), np.tanh(z + half_width))


def white_noise(blocks: Sequence[AllanSums], number: int) -> list[Estimate | None]:
    """Return N of each sensor, then own N of each sensor, in SI with 95 % intervals.

    N is fitted together with Q, B and K to the Allan variances by weighted least squares. The
    interval is from a jackknife over the blocks. *Own N* is N without the common noise. With two
    sensors, only the root mean square of both values of own N is known, and is given for both. N is
    None for constant samples, and own N is None if the differences of the sensors are constant.

    ``blocks`` are from `_sums`, and ``number`` is the number of sensors.
    """
    factors, curve = min(len(block.count) for block in blocks), allan_curve(reduce(add, blocks))
    m, tau = curve.m[:factors], curve.tau[:factors]
    count = np.array([block.count[:factors] for block in blocks])
    squares = np.array([block.sum_sq[:factors] for block in blocks])
    is_in_difference = np.abs(_pairs(number).T)  # 1 if a sensor is in a difference, else 0
    weight_of_other_pairs = -1.0 / ((number - 1) * max(number - 2, 1))
    own_weights = np.where(is_in_difference, 1.0 / max(number - 1, 2), weight_of_other_pairs)
    weights = np.block(
        [[np.eye(number), 0.0 * is_in_difference], [np.zeros((number, number)), own_weights]]
    )

    def curves(sums: Floats, differences: NDArray[np.int64]) -> Floats:
        return np.asarray(allan_variance(sums, m, differences) @ weights.T)

    # variances of the curves, as if the errors of all sensors and pairs were independent
    curve_variances = (curve.adev**4 / curve.edf)[:factors] @ weights.T**2
    curve_of_all = curves(squares.sum(axis=0), count.sum(axis=0))
    curves_without_block = [
        curves(squares.sum(axis=0) - s, count.sum(axis=0) - c) for s, c in zip(squares, count)
    ]
    white, quantization = 1.0 / tau, 3.0 / tau**2
    # The estimate of N^2 may be negative. The estimate of Q^2 may be negative, too, because the
    # stamps of the sensors differ. As all coefficients of the fit are nonnegative, the fit contains
    # each of these two terms with both signs
    signed_terms = white, -white, quantization, -quantization
    terms = np.stack([*signed_terms, np.ones(factors), tau / 3.0], axis=1)
    estimates: list[Estimate | None] = []
    for column, errors in enumerate(np.sqrt(curve_variances.T)):
        if not errors.all():
            estimates.append(None)
            continue
        squares_of_n = [
            _squared_n(terms, curve[:, column], errors)
            for curve in (curve_of_all, *curves_without_block)
        ]
        half_width = T_95 * np.sqrt((BLOCKS - 1) * np.var(squares_of_n[1:]))
        upper_end = float(np.sqrt(max(squares_of_n[0], 0.0) + half_width))
        if squares_of_n[0] > half_width:
            ci95 = float(np.sqrt(squares_of_n[0] - half_width)), upper_end
            estimates.append(Estimate(float(np.sqrt(squares_of_n[0])), ci95))
        else:
            estimates.append(Estimate(None, upper95=upper_end, status='not_observable'))
    return estimates


def _squared_n(terms: Floats, curve: Floats, errors: Floats) -> float:
    """Return N^2, the difference of the first two coefficients of a nonnegative fit.

    ``terms``, (taus, terms), are fitted to ``curve``, (taus,), which has the standard errors
    ``errors``, (taus,).
    """
    matrix = terms / errors[:, None]
    scale = np.linalg.norm(matrix, axis=0)
    coefficients = nonnegative_least_squares(matrix / scale, curve / errors) / scale
    return float(coefficients[0] - coefficients[1])
