# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise that sensors at rest have in common, such as vibration, and the own noise of each sensor.

The Allan covariance of two sensors a and b follows from the Allan variances V of their samples and
of the difference of their samples, (V(a) + V(b) - V(a - b)) / 2. A signal that all sensors measure
equally cancels in the differences; from three or more sensors, the own noise of each one follows
("three-cornered hat": Gray & Allan, A method for estimating the frequency stability of an
individual oscillator, 28th Symp. Frequency Control, 1974). `transfer` tests whether they do.
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
"""Largest relative difference of two sample periods that are regarded as equal."""

BLOCKS, T_95 = 20, 2.093
"""Number of blocks of the jackknife, and the 97.5 % quantile of Student's t for it."""

LEAST_BLOCK = 64
"""Smallest number of samples of a block."""

LEAST_DEGREES = 8.0
"""Smallest number of degrees of freedom for which a coherence is computed."""


class Coherence(NamedTuple):
    """Coherence with its 95 % interval, from -1 to 1, at each averaging time."""

    tau: Floats  # s, (taus,)
    value: Floats  # (taus,)
    low: Floats
    high: Floats


@dataclass(frozen=True)
class CommonNoise:
    """The noise of one axis of an IMU, and how much of it other IMUs measure at the same time.

    Attributes
    ----------
    axis : str
        Name of the axis, such as 'gyro_x'; of two axes, if the axes of one IMU are compared.
    label : str
        Name of the IMU.
    coherence : Coherence
        Correlation of the Allan differences with the mean of the other IMUs, or of two axes: 0 for
        independent noise, 1 for common noise.
    measured, own : Estimate or None
        N in SI of all noise, and without the noise that all IMUs measure equally. With two IMUs,
        ``own`` is the root mean square of both. None if two axes are compared; ``own`` also if the
        IMUs do not measure the common noise equally.
    gain : float
        Factor with which the IMU measures the common noise, relative to the mean of all.
    leak : float
        Share of the common noise in the power of the differences of two IMUs, by which ``own``
        would be too large.
    """

    axis: str
    label: str
    coherence: Coherence
    measured: Estimate | None = None
    own: Estimate | None = None
    gain: float = 1.0
    leak: float = 0.0


class Samples(NamedTuple):
    """Samples of one axis."""

    stamps: NDArray[np.int64]  # (n,) in ns, ascending
    values: Floats  # (n,) in SI; (sensors, n) for several


def common_noise(axis: str, imus: Sequence[Samples], labels: Sequence[str]) -> list[CommonNoise]:
    """Return the common and the own noise of one axis of two or more IMUs at rest on one body.

    Raises AllanError if the rates differ, or the common time is too short.
    """
    parts, number, found = aligned(imus), len(imus), []
    measures = transfer([part.values for part in parts])
    parts = [part._replace(values=part.values / measures.gains[:, None]) for part in parts]
    blocks = _sums(axis, parts)
    covariance, noise = _allan_covariance(blocks, number), white_noise(blocks, number)
    for i, label in enumerate(labels):
        this, others = np.eye(number)[i], (1.0 - np.eye(number)[i]) / (number - 1)
        coherence = _coherence(*covariance, this, others)
        gain = float(measures.gains[i])
        measured, own = (
            None if one is None else one.times(gain) for one in (noise[i], noise[number + i])
        )
        own = own if measures.is_equal else None
        found.append(CommonNoise(axis, label, coherence, measured, own, gain, measures.leak))
    return found


def common_of_axes(
    axes: Sequence[str], samples: Sequence[Samples], label: str
) -> list[CommonNoise]:
    """Return the coherence of each two axes of one IMU; raise AllanError for too few samples."""
    blocks = _sums(axes[0], aligned(samples))
    covariance, unit = _allan_covariance(blocks, len(axes)), np.eye(len(axes))
    return [
        CommonNoise(f'{axes[i]} {axes[j]}', label, _coherence(*covariance, unit[i], unit[j]))
        for i, j in combinations(range(len(axes)), 2)
    ]


def aligned(sensors: Sequence[Samples]) -> list[Samples]:
    """Return the samples nearest to the times of the first sensor, for each time without a gap.

    Raises AllanError if the rates differ.
    """
    periods = [float(np.median(np.diff(sensor.stamps))) for sensor in sensors]
    if max(periods) > (1.0 + SAME_RATE) * min(periods):
        rates = ', '.join(f'{1e9 / period:.6g}' for period in periods)
        raise AllanError(f'the rates differ ({rates} Hz): record all IMUs at the same rate')
    times = sensors[0].stamps
    near, rows = np.ones(len(times), bool), []
    for stamps, values in sensors:
        right = np.searchsorted(stamps, times).clip(1, len(stamps) - 1)
        nearest = right - (times - stamps[right - 1] < stamps[right] - times)
        near &= np.abs(stamps[nearest] - times) <= periods[0]
        rows.append(values[nearest])
    used = np.flatnonzero(near)
    parts = np.split(used, np.flatnonzero(np.diff(times[used]) > 1.5 * periods[0]) + 1)
    return [Samples(times[part], np.array(rows)[:, part]) for part in parts if len(part)]


def _pairs(number: int) -> Floats:
    """Return the weights of the sensors in the difference of each two, (pairs, sensors)."""
    one = np.eye(number)
    return np.array([one[i] - one[j] for i, j in combinations(range(number), 2)])


def _sums(axis: str, parts: Sequence[Samples]) -> list[AllanSums]:
    """Return the sums of each sensor, then of the difference of each two, in `BLOCKS` blocks.

    ``parts`` are from `aligned`. The blocks have equal numbers of samples. Raises AllanError if
    they are too short.
    """
    number = len(parts[0].values) if parts else 0
    pairs = _pairs(number) if number else np.zeros((0, 0))
    size = sum(len(part.stamps) for part in parts) // BLOCKS
    if size < LEAST_BLOCK:
        raise AllanError('the recordings have too little time in common: record them together')
    names = tuple(f'{axis} {i}' for i in range(number + len(pairs)))
    running, blocks = RunningSums(ImuIdentity(), names), []
    for stamps, rows in parts:
        while len(stamps):
            some = slice(size - running.samples)
            values = np.concatenate([rows[:, some], pairs @ rows[:, some]])
            running.update(values.T, int(stamps[some][0]), int(stamps[some][-1]))
            running.end_segment()
            stamps, rows = stamps[some.stop :], rows[:, some.stop :]
            if running.samples == size:
                blocks.append(running.sums)
                running = RunningSums(ImuIdentity(), names)
    return blocks


def _allan_covariance(blocks: Sequence[AllanSums], number: int) -> tuple[Floats, Floats, Floats]:
    """Return averaging times, Allan covariances (taus, sensors, sensors) and degrees of freedom."""
    curve = allan_curve(reduce(add, blocks))
    # of the product of two independent sensors: at least the geometric mean of both
    degrees = np.exp(np.log(curve.edf[:, :number]).mean(axis=1))
    some = degrees >= LEAST_DEGREES
    avar = curve.adev[some] ** 2
    covariance = np.array([np.diag(row[:number]) for row in avar])
    for column, (i, j) in enumerate(combinations(range(number), 2), number):
        shared = (avar[:, i] + avar[:, j] - avar[:, column]) / 2.0
        covariance[:, i, j] = covariance[:, j, i] = shared
    return curve.tau[some], covariance, degrees[some]


def _coherence(tau: Floats, covariance: Floats, degrees: Floats, a: Floats, b: Floats) -> Coherence:
    """Return the correlation of two weighted sums of sensors, with Fisher's 95 % interval."""
    with np.errstate(invalid='ignore', divide='ignore'):
        scale = np.sqrt((covariance @ a @ a) * (covariance @ b @ b))
        value = np.clip(covariance @ a @ b / scale, -1.0, 1.0)
        z, half = np.arctanh(value), Z_95 / np.sqrt(degrees - 2.0)
    return Coherence(tau, value, np.tanh(z - half), np.tanh(z + half))


def white_noise(blocks: Sequence[AllanSums], number: int) -> list[Estimate | None]:
    """Return N of each sensor, then the own N of each one, in SI with 95 % intervals.

    N is fitted together with Q, B and K to the Allan variances by weighted least squares; the
    interval is from a jackknife over the blocks. N is None if the samples are constant. The own
    N of two sensors is the root mean square of both.
    """
    factors, curve = min(len(block.count) for block in blocks), allan_curve(reduce(add, blocks))
    m, tau = curve.m[:factors], curve.tau[:factors]
    count = np.array([block.count[:factors] for block in blocks])
    squares = np.array([block.sum_sq[:factors] for block in blocks])
    differences = np.abs(_pairs(number).T)  # whether a sensor is in a difference
    away = -1.0 / ((number - 1) * max(number - 2, 1))
    own = np.where(differences, 1.0 / max(number - 1, 2), away)
    weights = np.block([[np.eye(number), 0.0 * differences], [np.zeros((number, number)), own]])

    def curves(sums: Floats, differences: NDArray[np.int64]) -> Floats:
        return np.asarray(allan_variance(sums, m, differences) @ weights.T)

    scatter = (curve.adev**4 / curve.edf)[:factors] @ weights.T**2  # as if all were independent
    whole = curves(squares.sum(axis=0), count.sum(axis=0))
    without = [
        curves(squares.sum(axis=0) - s, count.sum(axis=0) - c) for s, c in zip(squares, count)
    ]
    white, quantization = 1.0 / tau, 3.0 / tau**2
    # N^2 and Q^2 can be negative, Q^2 because the stamps differ: their terms occur with both signs
    signed = white, -white, quantization, -quantization
    terms = np.stack([*signed, np.ones(factors), tau / 3.0], axis=1)
    found: list[Estimate | None] = []
    for column, error in enumerate(np.sqrt(scatter.T)):
        if not error.all():
            found.append(None)
            continue
        n = [_level(terms, curve[:, column], error) for curve in (whole, *without)]
        half = T_95 * np.sqrt((BLOCKS - 1) * np.var(n[1:]))
        high = float(np.sqrt(max(n[0], 0.0) + half))
        if n[0] > half:
            ci95 = float(np.sqrt(n[0] - half)), high
            found.append(Estimate(float(np.sqrt(n[0])), ci95))
        else:
            found.append(Estimate(None, upper95=high, status='not_observable'))
    return found


def _level(terms: Floats, curve: Floats, error: Floats) -> float:
    """Return the difference of the first two coefficients in a fit without negative ones."""
    matrix = terms / error[:, None]
    scale = np.linalg.norm(matrix, axis=0)
    found = nonnegative_least_squares(matrix / scale, curve / error) / scale
    return float(found[0] - found[1])
