# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bias of each axis as a function of temperature: `temperature_models`.

The block means of the sums are y = constant + line in time + b1 (T - T0) + b2 (T - T0)^2
+ hysteresis/2 (rising) or - hysteresis/2 (falling) + noise, with a constant and a line for each
recording. The noise is a sum of noise types, whose autocovariances `core.noise` defines. Their
coefficients are fitted by restricted likelihood, with and without the terms of the temperature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ..allan.sums import AllanSums
from ..estimate import Estimate
from ..fields import Signed
from ..findings import Finding, finding
from ..noise import Process
from ..noise.processes.flicker import Flicker
from ..noise.processes.random_walk import RandomWalk
from ..noise.processes.white import White
from .coefficients import random_coefficient
from .likelihood import AxisData, Columns, Fit, LowBand, inverse, profile_interval
from .result import AxisFit, NoiseModel
from .statistics import Floats, Ints, statistics

TEMPERATURE_RESOLVED = 0.01
"""Probability of the F test of b1 and b2 below which a bias depends on temperature, per axis."""

LEAST_RANGE_K = 3.0
"""Range of the temperature within a recording in K below which no model is fitted."""

LEAST_RETURN = 1.0 / 3.0
"""Part of this range by which the temperature must rise and also fall, so that its effect can be
separated from a drift with time."""

MOST_MEANS, LEAST_MEANS = 256, 32
"""Largest and smallest number of block means of a fit."""

LONGEST_PAUSE_S = 120.0
"""Longest time in s without a temperature reading that is interpolated, if blocks are shorter."""

SLOW = 2.0
"""Blocks per correlation time, or per half period, from which a process may be an effect of the
temperature and is omitted; the coefficients of faster ones are held."""

N, B, K = range(3)
"""Indices of the first components."""

HELD_DOF = 1e4
"""Degrees of freedom of a coefficient that is held."""


@dataclass(frozen=True)
class SlowNoise:
    """Bias instability and rate random walk, fitted to the block means."""

    B: Estimate
    K: Estimate


@dataclass(frozen=True)
class TemperatureModel:
    """Bias of one axis: b(T) = b0 + b1 (T - T0) + b2 (T - T0)^2, in SI and K.

    Attributes
    ----------
    reference, lowest, highest : float
        T0, and the lowest and highest temperature of the block means, in degC.
    b0, b1, b2 : float
        Mean over the recordings of the bias at T0, slope at T0 per K, and curvature per K^2. The
        bias of an accelerometer contains gravity.
    b0_ci95, b1_ci95, b2_ci95 : (low, high)
        95 % intervals.
    hysteresis : float
        Bias while the temperature rises minus bias while it falls, at equal temperature.
    hysteresis_ci95 : (low, high)
        95 % interval.
    resolved : bool
        Whether b1 or b2 differs from 0 (false-alarm probability 1 %).
    explained : float or None
        Share of the variance of the block means, without their white noise, that the temperature
        explains; None if white noise alone explains that variance.
    averaging_time : float
        Length of the block means in s.
    measured, corrected : SlowNoise
        B and K of the block means, without and with the temperature in the model. Q and N do not
        change.
    """

    reference: Signed
    lowest: Signed
    highest: Signed
    b0: Signed
    b0_ci95: tuple[float, float]
    b1: Signed
    b1_ci95: tuple[float, float]
    b2: Signed
    b2_ci95: tuple[float, float]
    hysteresis: Signed
    hysteresis_ci95: tuple[float, float]
    resolved: bool
    explained: float | None
    averaging_time: float
    measured: SlowNoise
    corrected: SlowNoise

    def bias(self, celsius: Floats) -> Floats:
        """Return b(T) at temperatures in degC, in SI."""
        x = np.asarray(celsius, float) - self.reference
        return np.asarray(self.b0 + x * (self.b1 + x * self.b2))


class _Blocks(NamedTuple):
    """Means of blocks of equal length from all segments, with their temperature."""

    step: int  # samples per block
    recording: Ints  # (n,)
    time: Floats  # middle of the block in blocks, (n,)
    celsius: Floats  # mean temperature, (n,)
    spread: Floats  # variance of the temperature within the block, (n,)
    values: Floats  # SI, (n, axes)

    @property
    def parts(self) -> list[Ints]:
        """The blocks of each recording."""
        return [np.flatnonzero(self.recording == r) for r in np.unique(self.recording)]


def temperature_models(
    sums: AllanSums, time_ns: Ints, celsius: Floats, model: NoiseModel
) -> tuple[dict[str, TemperatureModel], list[Finding]]:
    """Return axis -> model of its bias over temperature, and findings.

    There are no models if the temperature varies too little, or in one direction only; a finding
    states the second.

    Parameters
    ----------
    sums : AllanSums
        Sums with block means.
    time_ns, celsius : (readings,) arrays
        Times of the temperature readings on the clock of the sums, ascending, and degC.
    model : NoiseModel
        Fit of the same axes, from which white noise and fast processes are taken.
    """
    blocks = _blocks(sums, time_ns, celsius)
    if len(blocks.time) < LEAST_MEANS:
        return {}, []
    range_k = max(float(np.ptp(blocks.celsius[part])) for part in blocks.parts)
    if range_k < LEAST_RANGE_K:
        return {}, []
    least = LEAST_RETURN * range_k
    rising = np.concatenate([_rising(blocks.celsius[part], least) for part in blocks.parts])
    if not rising.any():
        return {}, [finding('temperature_one_way', range=range_k)]
    low, high, reference = blocks.celsius.min(), blocks.celsius.max(), blocks.celsius.mean().round()
    warmer = blocks.celsius - reference
    effects = np.column_stack([warmer, warmer**2 + blocks.spread, rising])
    trend = np.zeros((len(warmer), 2 * len(blocks.parts)))
    for r, part in enumerate(blocks.parts):
        trend[part, 2 * r] = 1.0
        trend[part, 2 * r + 1] = blocks.time[part] - blocks.time[part].mean()
    basis, known, tau0 = _complement(trend), statistics(sums), model.tau0
    found = {}
    for i, axis in enumerate(sums.axes):
        if not model.axes[axis].noise['N'].value:
            continue
        contrasts = _contrasts(AxisData.of(known, i), model.axes[axis], tau0, blocks, basis)
        values = _model(contrasts, tau0, blocks, effects, basis)
        if not np.isfinite([values['b0_ci95'], values['b1_ci95'], values['b2_ci95']]).all():
            continue
        found[axis] = TemperatureModel(float(reference), float(low), float(high), **values)
    return found, []


def _blocks(sums: AllanSums, time_ns: Ints, celsius: Floats) -> _Blocks:
    """Return the block means whose temperature is known."""
    known = [(r, m) for r, one in enumerate(sums.recordings) for m in one.means]
    step = max((m.step for _, m in known), default=1)
    while sum(m.samples // step for _, m in known) > MOST_MEANS:
        step *= 2
    tau0 = sums.tau0 or 1.0
    rows = []
    origin = known[0][1].start_ns if known else 0
    for r, m in known:
        values = m.coarser(step).values + sums.recordings[r].reference
        time = (m.start_ns - origin) * 1e-9 / (step * tau0) + np.arange(len(values)) + 0.5
        rows.append((np.full(len(values), r), time, values))
    if not rows:
        none = np.zeros(0)
        return _Blocks(step, np.zeros(0, np.int64), none, none, none, none)
    recording, time, values = (np.concatenate(column) for column in zip(*rows))
    read = (time_ns - origin) * 1e-9 / (step * tau0)
    inside = time[:, None] + (np.arange(8) - 3.5) / 8.0
    within = np.interp(inside, read, celsius, np.nan, np.nan)
    mean, spread = within.mean(axis=1), within.var(axis=1)
    after = np.clip(np.searchsorted(read, time), 1, len(read) - 1)
    pause = max(LONGEST_PAUSE_S / (step * tau0), 2.0)
    some = np.isfinite(mean) & (read[after] - read[after - 1] < pause)
    return _Blocks(step, *(each[some] for each in (recording, time, mean, spread, values)))


def _rising(celsius: Floats, least: float) -> Floats:
    """Return 1/2 while the temperature rises and -1/2 while it falls.

    Between two turning points it changes by at least ``least``; with fewer of them, the result is
    0.
    """
    turns: list[int] = []
    top = bottom = direction = 0
    for i, t in enumerate(celsius):
        top = i if t > celsius[top] else top
        bottom = i if t < celsius[bottom] else bottom
        if direction >= 0 and celsius[top] - t >= least:
            turns.append(top)
            direction, bottom = -1, i
        elif direction <= 0 and t - celsius[bottom] >= least:
            turns.append(bottom)
            direction, top = 1, i
    if len(turns) < 2:
        return np.zeros(len(celsius))
    later = len(turns) - np.searchsorted(turns, np.arange(len(celsius)), side='right')
    return np.where(later % 2, -direction, direction) / 2.0


def _complement(columns: Floats) -> Floats:
    """Return an orthonormal basis of the contrasts that are orthogonal to some columns."""
    q, _ = np.linalg.qr(columns, mode='complete')
    return np.asarray(q[:, columns.shape[1] :])


def _components(fit: AxisFit, tau0: float, step: int) -> tuple[list[Process], list[float]]:
    """Return the components of the noise, and their coefficients: NaN if they are to be fitted.

    The coefficients of white noise and fast processes are known from the fit of all data, because
    block means of ``step`` samples cannot resolve them. White noise includes aliases of sinusoids.
    Slower processes are omitted: they may be effects of the temperature.
    """
    white = fit.model.value('N') ** 2 / tau0
    components: list[Process] = [White(), Flicker(), RandomWalk()]
    others = []
    for part in fit.model.shaped.parts:
        process = part.process.in_unit(tau0)
        if process.slowest_time >= SLOW * step:
            continue
        variance = process.variance_of(part.value, tau0)
        if process.is_line:
            # half of the variance of its aliases, which are at random frequencies
            white += 0.5 * step * variance * process.alias_variance(step)
        else:
            components.append(process)
            others.append(variance)
    known = [white or math.nan, math.nan, math.nan, *others]
    return components, known


@dataclass(frozen=True, eq=False)
class _Contrasts:
    """Contrasts of the block means of one axis without constants and lines, scaled to variance 1.

    The coefficients of the components are relative to ``data.scale``, too.
    """

    data: AxisData
    components: list[Process]
    known: Floats  # (components,) coefficients, NaN if they are not known
    z: Floats  # (contrasts,)
    covariances: Floats  # for unit noise, (components, contrasts, contrasts)

    def fitted(self, basis: Floats) -> tuple[AxisData, Fit]:
        """Return the part of the contrasts in a basis, and the fit of the noise to it."""
        held = np.isfinite(self.known)
        w = basis.T @ self.z
        data = replace(
            self.data,
            power=self.known[held],
            low=[LowBand(1, np.zeros(0), np.outer(w, w))],
            dof=np.full(held.sum(), HELD_DOF),
            used=np.ones(held.sum(), bool),
        )
        columns = Columns(np.eye(len(held))[held], [basis.T @ self.covariances @ basis])
        return data, data.solve(self.components, columns)

    def regression(self, fit: Fit, effects: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the effects by generalized least squares: values, covariance, dof of each.

        The covariance and its degrees of freedom contain the errors of the noise (Kenward & Roger,
        Biometrics 53, 1997; Satterthwaite).
        """
        covariances = self.covariances
        noise = np.linalg.inv(np.tensordot(fit.p, covariances, 1))
        weighed = noise @ effects
        covariance = inverse(effects.T @ weighed)  # singular with only two temperatures
        gain = covariance @ weighed.T
        moved = gain @ covariances  # (components, effects, contrasts)
        errors = inverse(fit.information)
        slopes = np.einsum('kei,ei->ek', moved, gain)
        scatter = np.einsum('ek,kl,el->e', slopes, errors, slopes)
        dof = 2.0 * np.diag(covariance) ** 2 / np.maximum(scatter, 1e-300)
        rest = noise - weighed @ gain
        more = np.einsum('kei,kl,lfi->ef', moved @ rest, errors, moved, optimize=True)
        return gain @ self.z, covariance + 2.0 * more, np.clip(dof, 1.0, 1e6)


def _slow_noise(data: AxisData, fit: Fit, tau0: float) -> SlowNoise:
    """Return B and K of a fit in SI, with their intervals."""
    errors = np.sqrt(np.diag(fit.covariance()))

    def estimate(at: int) -> Estimate:
        return random_coefficient(
            fit.components[at],
            variance=float(fit.p[at]) * data.scale,
            error=float(errors[at]) * data.scale,
            interval=profile_interval(data, fit, at).times(data.scale),
            tau0=tau0,
        )

    return SlowNoise(B=estimate(B), K=estimate(K))


def _contrasts(
    data: AxisData, fit: AxisFit, tau0: float, blocks: _Blocks, basis: Floats
) -> _Contrasts:
    """Return the contrasts of one axis; ``basis`` excludes constants and lines."""
    components, known = _components(fit, tau0, blocks.step)
    lags = np.abs(np.subtract.outer(blocks.time, blocks.time))
    lags = np.maximum(np.round(lags, 6), 1.0 - np.eye(len(lags)))
    same = np.equal.outer(blocks.recording, blocks.recording)
    gammas = (c.gamma(blocks.step, lags) for c in components)
    covariances = np.array([basis.T @ np.where(same, gamma, 0.0) @ basis for gamma in gammas])
    z = basis.T @ blocks.values[:, data.axis]
    scale = float(z @ z) / len(z) or 1.0
    data = replace(data, scale=scale)
    return _Contrasts(data, components, np.array(known) / scale, z / math.sqrt(scale), covariances)


def _model(
    known: _Contrasts, tau0: float, blocks: _Blocks, effects: Floats, basis: Floats
) -> dict[str, Any]:
    """Return the values of the model of one axis, except for the temperatures.

    ``effects``, (blocks, 3), are the columns of b1, b2 and the hysteresis.
    """
    from scipy.special import fdtrc, stdtrit  # slow to import

    scale, columns = known.data.scale, basis.T @ effects
    corrected, fit = known.fitted(_complement(columns))
    value, covariance, dof = known.regression(fit, columns)
    test = value[:2] @ np.linalg.solve(covariance[:2, :2], value[:2]) / 2.0
    value, covariance = value * math.sqrt(scale), covariance * scale
    # the mean of all blocks has white noise of its own, and the errors of the effects
    y, center = blocks.values[:, known.data.axis], effects.mean(axis=0)
    white = float(fit.p[N]) * scale / blocks.step
    level = float(y.mean() - center @ value)
    levels = [level, *value]
    variances = [white / len(y) + center @ covariance @ center, *np.diag(covariance)]
    halves = stdtrit([dof.min(), *dof], 0.975) * np.sqrt(variances)
    ends = [(float(v - h), float(v + h)) for v, h in zip(levels, halves)]
    drift, left = (
        sum(float(np.sum((x[p] - x[p].mean()) ** 2)) for p in blocks.parts) / len(y) - white
        for x in (y, y - effects[:, :2] @ value[:2])
    )
    drifts = drift > 3.0 * math.sqrt(2.0 / len(y)) * white
    return {
        'b0': level,
        'b0_ci95': ends[0],
        'b1': float(value[0]),
        'b1_ci95': ends[1],
        'b2': float(value[1]),
        'b2_ci95': ends[2],
        'hysteresis': float(value[2]),
        'hysteresis_ci95': ends[3],
        'resolved': bool(fdtrc(2.0, dof[:2].min(), test) < TEMPERATURE_RESOLVED),
        'explained': min(max(1.0 - left / drift, 0.0), 1.0) if drifts else None,
        'averaging_time': blocks.step * tau0,
        'measured': _slow_noise(*known.fitted(np.eye(len(columns))), tau0),
        'corrected': _slow_noise(corrected, fit, tau0),
    }
