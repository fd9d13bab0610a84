# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bias of each axis as a function of temperature: `temperature_models`.

Model
-----
The block means of the Allan sums are modeled as a sum: a constant and a linear change with time for
each recording, the effects of the temperature T, and noise. The effects are b1 (T - T0),
b2 (T - T0)^2 and hysteresis (dT/dt) / (2 r) with r = mean |dT/dt|. The fit is derived in
`docs/method.md`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..allan.at_rest import LEAST_RANGE_K, equal_blocks
from ..allan.sums import AllanSums
from ..estimate import Estimate
from ..findings import Finding, finding
from ..noise import Process
from ..noise.processes.flicker import Flicker
from ..noise.processes.random_walk import RandomWalk
from ..noise.processes.white import White
from .coefficients import random_coefficient
from .likelihood import AxisData, Columns, Fit, LowBand, inverse, profile_interval
from .result import AxisFit, NoiseModel, SlowNoise, TemperatureModel
from .statistics import Floats, Ints, mean_alias, statistics

TEMPERATURE_RESOLVED = 0.01
"""The bias of an axis depends on temperature if the F test of its linear and quadratic coefficients
has a probability below this value."""

LEAST_RETURN = 1.0 / 3.0
"""Share of the temperature range by which the temperature must rise and also fall. Otherwise, the
effect of the temperature cannot be separated from a drift with time."""

MOST_MEANS, LEAST_MEANS = 256, 32
"""Largest and smallest number of block means of a fit."""

RATE_BLOCKS = 8
"""Time, in blocks, over which the rate of change of the temperature is averaged."""

LONGEST_PAUSE_S = 120.0
"""Longest time in s between two temperature readings over which the temperature is interpolated. If
two blocks last longer than this time, the limit is the duration of two blocks."""

SLOW = 2.0
"""Correlation time of a process, or half of the period of a sinusoid, in blocks. From this time on,
the process is omitted from the noise of the block means, because it may be an effect of the
temperature. The coefficients of faster processes are taken from the fit of all data."""

NOISE: tuple[Process, ...] = (White(), Flicker(), RandomWalk())
"""Terms in the noise of the block means: the first processes of each fit in this module."""

KNOWN_DOF = 1e4
"""Degrees of freedom of a coefficient that is known from the fit of all data. The error of such a
coefficient is 0.7 %, far below the errors of the other coefficients."""


class _TemperatureBlocks(NamedTuple):
    """Means of blocks of equal length from all segments, with their temperature."""

    step: int  # number of samples per block
    recording: Ints  # index of the recording of each block, (n,)

    # time from the start of the first segment to the middle of each block, in blocks, (n,)
    time: Floats
    celsius: Floats  # mean temperature of each block in degC, (n,)
    spread: Floats  # variance of the temperature within each block in K^2, (n,)
    values: Floats  # means of the samples in SI, (n, axes)

    @property
    def reference(self) -> float:
        """The temperature T0 of the models: the mean temperature, rounded to whole degC."""
        return float(self.celsius.mean().round())

    @property
    def parts(self) -> list[Ints]:
        """Indices of the blocks of each recording, one array per recording."""
        return [np.flatnonzero(self.recording == r) for r in np.unique(self.recording)]

    @property
    def rate(self) -> Floats:
        """Slope of the temperature near each block, in K per block, (n,).

        The blocks of the same recording within `RATE_BLOCKS` / 2 blocks of a block are used.
        """
        slopes = np.zeros(len(self.time))
        for part in self.parts:
            time, celsius = self.time[part], self.celsius[part]
            for i, index in enumerate(part.tolist()):
                is_near = np.abs(time - time[i]) <= RATE_BLOCKS / 2.0
                t = time[is_near] - time[is_near].mean()
                slopes[index] = float(t @ celsius[is_near]) / max(float(t @ t), 1e-300)
        return slopes


def temperature_models(
    sums: AllanSums, time_ns: Ints, celsius: Floats, model: NoiseModel
) -> tuple[dict[str, TemperatureModel], list[Finding]]:
    """Return axis -> model of the bias of the axis over temperature, and findings.

    There are no models if the temperature is known for too few block means, varies too little, or
    does not both rise and fall enough. In the last case, a finding states the range of the
    temperature.
    An axis has no model if it has no estimate of N, or if an interval of b0, b1 or b2 is unknown.

    Parameters
    ----------
    sums : AllanSums
        Sums with block means.
    time_ns, celsius : (readings,) arrays
        Times of the temperature readings in ns on the clock of the sums, ascending, and the
        temperatures in degC; at least two readings.
    model : NoiseModel
        Fit of the same axes, from which white noise and fast processes are taken.
    """
    blocks = _blocks(sums, time_ns, celsius)
    if len(blocks.time) < LEAST_MEANS:
        return {}, []
    range_k = max(float(np.ptp(blocks.celsius[part])) for part in blocks.parts)
    if range_k < LEAST_RANGE_K:
        return {}, []
    least_return = LEAST_RETURN * range_k
    if not any(_rises_and_falls(blocks.celsius[part], least_return) for part in blocks.parts):
        return {}, [finding('temperature_one_way', range=range_k)]
    difference, rate = blocks.celsius - blocks.reference, blocks.rate
    mean_rate = float(np.abs(rate).mean())
    hysteresis = rate / (2.0 * mean_rate) if mean_rate else rate
    effects = np.column_stack([difference, difference**2 + blocks.spread, hysteresis])
    trend = np.zeros((len(difference), 2 * len(blocks.parts)))
    for r, part in enumerate(blocks.parts):
        trend[part, 2 * r] = 1.0
        trend[part, 2 * r + 1] = blocks.time[part] - blocks.time[part].mean()
    basis, known, tau0 = _complement(trend), statistics(sums), model.tau0
    models = {}
    for i, axis in enumerate(sums.axes):
        if not model.axes[axis].noise['N'].value:
            continue
        contrasts = _contrasts(AxisData.of(known, i), model.axes[axis], tau0, blocks, basis)
        axis_model = _model(contrasts, tau0, blocks, effects, basis)
        if axis_model is not None:
            models[axis] = axis_model
    return models, []


def _blocks(sums: AllanSums, time_ns: Ints, celsius: Floats) -> _TemperatureBlocks:
    """Return the block means whose temperature is known."""
    step, segments = equal_blocks(sums, MOST_MEANS)
    tau0 = sums.tau0 or 1.0
    columns_of_segments = []
    origin = segments[0][1] if segments else 0
    for r, start_ns, values in segments:
        time = (start_ns - origin) * 1e-9 / (step * tau0) + np.arange(len(values)) + 0.5
        columns_of_segments.append((np.full(len(values), r), time, values))
    if not columns_of_segments:
        empty = np.zeros(0)
        return _TemperatureBlocks(step, np.zeros(0, np.int64), empty, empty, empty, empty)
    recording, time, values = (np.concatenate(column) for column in zip(*columns_of_segments))
    reading_times = (time_ns - origin) * 1e-9 / (step * tau0)
    times_in_block = time[:, None] + (np.arange(8) - 3.5) / 8.0
    temperatures = np.interp(times_in_block, reading_times, celsius, np.nan, np.nan)
    mean, spread = temperatures.mean(axis=1), temperatures.var(axis=1)
    next_reading = np.clip(np.searchsorted(reading_times, time), 1, len(reading_times) - 1)
    pause = reading_times[next_reading] - reading_times[next_reading - 1]
    is_known = np.isfinite(mean) & (pause < max(LONGEST_PAUSE_S / (step * tau0), 2.0))
    return _TemperatureBlocks(
        step, *(column[is_known] for column in (recording, time, mean, spread, values))
    )


def _rises_and_falls(celsius: Floats, least: float) -> bool:
    """Return whether the temperature rises and also falls by at least ``least``, in K."""
    rise = np.max(celsius - np.minimum.accumulate(celsius))
    fall = np.max(np.maximum.accumulate(celsius) - celsius)
    return bool(min(rise, fall) >= least)


def _complement(columns: Floats) -> Floats:
    """Return orthonormal columns that are orthogonal to all given columns."""
    q, _ = np.linalg.qr(columns, mode='complete')
    return np.asarray(q[:, columns.shape[1] :])


def _block_noise(fit: AxisFit, tau0: float, step: int) -> dict[Process, float]:
    """Return the noise of means over ``step`` samples of an axis.

    The result maps each process, whose shape is in samples, to the squared coefficient in the
    squared unit of the samples; NaN if the coefficient is to be fitted.

    The coefficients of white noise and fast processes are known from the fit of all data, because
    block means cannot resolve them. White noise includes aliases of sinusoids. Slower processes are
    omitted, because they may be effects of the temperature.
    """
    white = fit.model.value('N') ** 2 / tau0
    fast_variances: dict[Process, float] = {}
    for part in fit.model.shaped.parts:
        process = part.process.in_unit(tau0)
        if process.slowest_time >= SLOW * step:
            continue
        variance = process.variance_of(part.value, tau0)
        if process.is_line:
            white += variance * mean_alias(process, step)
        else:
            fast_variances[process] = fast_variances.get(process, 0.0) + variance
    return {**dict.fromkeys(NOISE, math.nan), White(): white or math.nan, **fast_variances}


def _slow_noise(data: AxisData, fit: Fit, tau0: float) -> SlowNoise:
    """Return B and K in SI, with intervals or limits, from the result of `_Contrasts.fitted`."""
    errors = np.sqrt(np.diag(fit.covariance()))

    def estimate(term: Process) -> Estimate:
        at = fit.components.index(term)
        return random_coefficient(
            term,
            variance=float(fit.p[at]) * data.scale,
            error=float(errors[at]) * data.scale,
            interval=profile_interval(data, fit, at).times(data.scale),
            tau0=tau0,
        )

    return SlowNoise(B=estimate(Flicker()), K=estimate(RandomWalk()))


class _Effects(NamedTuple):
    """Effects of the temperature, estimated from the contrasts by generalized least squares."""

    values: Floats  # (effects,) estimated sizes of the effects
    covariance: Floats  # (effects, effects) covariance of the sizes
    dof: Floats  # (effects,) degrees of freedom of the variance of each size


def half_widths(variances: ArrayLike, dof: ArrayLike) -> Floats:
    """Return half of the widths of the 95 % intervals of values, in the unit of the values.

    ``variances`` are the estimated variances of the values, and ``dof`` their degrees of freedom.
    The result has the shape to which both arrays broadcast.
    """
    from scipy.special import stdtrit  # slow to import

    return np.asarray(stdtrit(dof, 0.975) * np.sqrt(variances))


@dataclass(frozen=True, eq=False)
class _Contrasts:
    """Contrasts of the block means of one axis, divided by their root mean square.

    A constant and a linear change with time of each recording have no effect on the contrasts.

    Attributes
    ----------
    data : AxisData
        Data of the axis, of which only the scale and the index of the axis are used.
    processes : tuple of Process
        Noise of the block means, with shapes in samples.
    known : (processes,) array
        Squared coefficients relative to ``data.scale``, NaN for coefficients that are to be fitted.
    z : (contrasts,) array
        Contrasts of the block means; their mean square is 1.
    covariances : (processes, contrasts, contrasts) array
        Covariance of the contrasts for unit noise of each process.
    """

    data: AxisData
    processes: tuple[Process, ...]
    known: Floats
    z: Floats
    covariances: Floats

    def fitted(self, basis: Floats) -> tuple[AxisData, Fit]:
        """Return the projections of the contrasts on a basis, and the fit of the noise to them.

        The columns of ``basis``, (contrasts, n), are orthonormal. A known coefficient enters the
        likelihood as a measured power to which only the process of this coefficient contributes.
        """
        is_known = np.isfinite(self.known)
        power_columns = np.eye(len(self.processes))[is_known]
        projected = basis.T @ self.z
        data = replace(
            self.data,
            power=self.known[is_known],
            dof=np.full(len(power_columns), KNOWN_DOF),
            used=np.ones(len(power_columns), bool),
            low=[LowBand(1, np.outer(projected, projected))],
        )
        columns = Columns(power_columns, [basis.T @ self.covariances @ basis])
        return data, data.solve(self.processes, columns)

    def regression(self, fit: Fit, effects: Floats) -> _Effects:
        """Return the sizes of effects, estimated by generalized least squares.

        Each column of ``effects``, (contrasts, effects), contains the contrasts of an effect of
        size 1. The covariance and its degrees of freedom take the errors of the fitted noise into
        account (Kenward & Roger, Biometrics 53, 1997; Satterthwaite).
        """
        covariances = self.covariances
        precision = np.linalg.inv(np.tensordot(fit.p, covariances, 1))
        weighted_effects = precision @ effects
        # the information is singular if there are only two temperatures
        covariance = inverse(effects.T @ weighted_effects)
        gain = covariance @ weighted_effects.T
        gain_covariances = gain @ covariances  # shape (processes, effects, contrasts)
        errors = inverse(fit.information)
        slopes = np.einsum('kei,ei->ek', gain_covariances, gain)
        variance_errors = np.einsum('ek,kl,el->e', slopes, errors, slopes)
        dof = 2.0 * np.diag(covariance) ** 2 / np.maximum(variance_errors, 1e-300)
        residual = precision - weighted_effects @ gain
        correction = np.einsum(
            'kei,kl,lfi->ef', gain_covariances @ residual, errors, gain_covariances, optimize=True
        )
        return _Effects(gain @ self.z, covariance + 2.0 * correction, np.clip(dof, 1.0, 1e6))


def _contrasts(
    data: AxisData, fit: AxisFit, tau0: float, blocks: _TemperatureBlocks, basis: Floats
) -> _Contrasts:
    """Return the contrasts of the block means of one axis.

    The columns of ``basis``, (blocks, contrasts), are orthogonal to a constant and to a linear
    change with time in each recording.
    """
    noise = _block_noise(fit, tau0, blocks.step)
    lags = np.abs(np.subtract.outer(blocks.time, blocks.time))
    lags = np.maximum(np.round(lags, 6), 1.0 - np.eye(len(lags)))
    is_same_recording = np.equal.outer(blocks.recording, blocks.recording)
    gammas = (process.gamma(blocks.step, lags) for process in noise)
    covariances = np.array(
        [basis.T @ np.where(is_same_recording, gamma, 0.0) @ basis for gamma in gammas]
    )
    z = basis.T @ blocks.values[:, data.axis]
    scale = float(z @ z) / len(z) or 1.0
    data, known = replace(data, scale=scale), np.array([*noise.values()]) / scale
    return _Contrasts(data, tuple(noise), known, z / math.sqrt(scale), covariances)


def _model(
    contrasts: _Contrasts, tau0: float, blocks: _TemperatureBlocks, effects: Floats, basis: Floats
) -> TemperatureModel | None:
    """Return the model of one axis; None if an interval of b0, b1 or b2 is unknown.

    The columns of ``effects``, (blocks, 3), are the effects of b1, b2 and the hysteresis on the
    block means. ``basis`` is the basis of the contrasts.
    """
    from scipy.special import fdtrc  # slow to import

    scale, columns = contrasts.data.scale, basis.T @ effects
    corrected_data, corrected_fit = contrasts.fitted(_complement(columns))
    estimates = contrasts.regression(corrected_fit, columns)
    slopes, slope_covariance = estimates.values[:2], estimates.covariance[:2, :2]
    f_statistic = slopes @ np.linalg.solve(slope_covariance, slopes) / 2.0
    values, covariance = estimates.values * math.sqrt(scale), estimates.covariance * scale
    # the variance of `level` contains white noise of all block means, and errors of the effects
    y, mean_effects = blocks.values[:, contrasts.data.axis], effects.mean(axis=0)
    white = float(corrected_fit.p[NOISE.index(White())]) * scale / blocks.step
    level = float(y.mean() - mean_effects @ values)
    level_variance = white / len(y) + mean_effects @ covariance @ mean_effects
    level_half_width = float(half_widths(level_variance, estimates.dof.min()))
    effect_half_widths = half_widths(np.diag(covariance), estimates.dof)
    b1_ci95, b2_ci95, hysteresis_ci95 = (
        (float(v - h), float(v + h)) for v, h in zip(values, effect_half_widths)
    )
    if not np.isfinite([level_half_width, *effect_half_widths[:2]]).all():
        return None
    drift, remaining_drift = (
        sum(float(np.sum((x[p] - x[p].mean()) ** 2)) for p in blocks.parts) / len(y) - white
        for x in (y, y - effects[:, :2] @ values[:2])
    )
    has_drift = drift > 3.0 * math.sqrt(2.0 / len(y)) * white
    return TemperatureModel(
        reference=blocks.reference,
        lowest=float(blocks.celsius.min()),
        highest=float(blocks.celsius.max()),
        b0=level,
        b0_ci95=(level - level_half_width, level + level_half_width),
        b1=float(values[0]),
        b1_ci95=b1_ci95,
        b2=float(values[1]),
        b2_ci95=b2_ci95,
        hysteresis=float(values[2]),
        hysteresis_ci95=hysteresis_ci95,
        rate=float(np.abs(blocks.rate).mean()) / (blocks.step * tau0),
        resolved=bool(fdtrc(2.0, estimates.dof[:2].min(), f_statistic) < TEMPERATURE_RESOLVED),
        explained=min(max(1.0 - remaining_drift / drift, 0.0), 1.0) if has_drift else None,
        averaging_time=blocks.step * tau0,
        measured=_slow_noise(*contrasts.fitted(np.eye(len(columns))), tau0),
        corrected=_slow_noise(corrected_data, corrected_fit, tau0),
    )
