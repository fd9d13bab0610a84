# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stationarity tests: does the early part of a recording differ from the rest, does the bias jump?

All tests take the means of the cells of a recording (`history.Recording`), and compare the
likelihood of two models of them (Neyman & Pearson, 1933). Without an effect the means are those of
white noise, bias instability and random walk about a constant and a ramp; with it a mean or a
variance component is added. The three variances are fitted anew under each model by maximum
likelihood on the contrasts that are free of the constant and the ramp (Patterson & Thompson,
Biometrika 58, 1971). Twice the log likelihood ratio is summed over the axes of a sensor, because
temperature acts on all of them.

The thresholds are those of simulations, see docs/engineering/stationarity.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .history import Recording

Floats = NDArray[np.float64]

LEAST_CELLS = 24
"""Recordings with fewer cells of data are not tested."""

GROWTH = 24
"""Cells are pooled beyond this many, in proportion to their age: some 100 remain."""

DECAYS, LONGEST_DECAY = 8, 1 / 12
"""Correlation times tried for an exponential warm-up, and the longest, of the recording."""

LINES, LONGEST_LINE = 5, 1 / 3
"""Durations tried for a linear warm-up, and the longest, of the recording."""

EARLY_AGES, LONGEST_EARLY = 7, 1 / 2
"""Ages tried for the end of an early part with larger drift, and the longest, of the recording."""

INVISIBLE = 1.0
"""A warm-up whose rest changes twice the log likelihood by less than this has no effect."""

TOLERANCE = 1e-3
"""Gain in twice the log likelihood at which a maximisation stops."""


@dataclass(frozen=True)
class CellMeans:
    """Means of consecutive stretches of one recording.

    Attributes
    ----------
    begin, end : (stretches,) float64 array
        In cells since the start of the recording.
    means : (stretches, axes) float64 array
    """

    begin: Floats
    end: Floats
    means: Floats

    @classmethod
    def of(cls, recording: Recording, growth: int = GROWTH) -> CellMeans:
        """Return the means of stretches that grow in proportion to their age."""
        number, means = recording.cell_samples, recording.cell_means
        edges = [0]
        while edges[-1] < len(number):
            edges.append(min(edges[-1] + max(1, edges[-1] // growth), len(number)))
        begin, end = np.array(edges[:-1]), np.array(edges[1:])
        if not len(begin):
            return cls(begin.astype(float), end.astype(float), means)
        samples = np.add.reduceat(number, begin)
        sums = np.add.reduceat(means * number[:, None], begin, axis=0)
        some = 2 * samples >= (end - begin) * recording.step
        mean = sums[some] / np.maximum(samples[some], 1)[:, None]
        return cls(begin[some].astype(float), end[some].astype(float), mean)

    def since(self, age: float) -> CellMeans:
        """Return the stretches that begin at an age or later, in cells."""
        late = self.begin >= age
        return CellMeans(self.begin[late], self.end[late], self.means[late])


class VarianceModel:
    """Covariance of means under white noise, bias instability and random walk of unit size.

    Attributes
    ----------
    contrasts : (stretches - 2, stretches) float64 array
        Orthonormal, free of a constant and a ramp.
    units : tuple of (stretches - 2, stretches - 2) float64 arrays
        Covariances of the contrasts.
    """

    def __init__(self, begin: Floats, end: Floats) -> None:
        self.begin, self.end = begin, end
        middle = (begin + end) / 2.0
        fixed = np.stack([np.ones(len(begin)), middle - middle.mean()], axis=1)
        basis, _ = np.linalg.qr(fixed, mode='complete')
        self.contrasts: Floats = basis[:, 2:].T
        self.units = tuple(self._of_contrasts(v) for v in self._covariances())

    def exponential(self, decay: float) -> Floats:
        """Return the contrasts of exp(-age/decay)."""
        low, high = (np.exp(-age / decay) for age in (self.begin, self.end))
        return np.asarray(self.contrasts @ (decay * (low - high) / (self.end - self.begin)))

    def linear(self, duration: float) -> Floats:
        """Return the contrasts of 1 - age/duration, 0 from ``duration`` on."""
        low, high = (np.minimum(age, duration) for age in (self.begin, self.end))
        area = (high - low) - (high**2 - low**2) / (2.0 * duration)
        return np.asarray(self.contrasts @ (area / (self.end - self.begin)))

    def step(self, age: float) -> Floats:
        """Return the contrasts of a step of unit size at an age."""
        after = np.clip((self.end - age) / (self.end - self.begin), 0.0, 1.0)
        return np.asarray(self.contrasts @ after)

    def early_walk(self, age: float) -> Floats:
        """Return the covariance of the contrasts of a random walk that ends at an age."""
        left = np.maximum(age - (self.begin + self.end) / 2.0, 0.0)
        return self._of_contrasts(np.minimum(left[:, None], left))

    def _of_contrasts(self, covariance: Floats) -> Floats:
        return np.asarray(self.contrasts @ covariance @ self.contrasts.T)

    def _covariances(self) -> list[Floats]:
        """Return the covariances of the means, up to those of a constant and a ramp.

        They are second differences of the generalised covariances of the phase: -|t|/2, and
        t^2 ln|t| / (2 pi), and |t|^3 / 12.
        """
        ends = (self.begin, self.end)
        lags = [np.abs(x[:, None] - y) for x in ends for y in ends]
        widths = np.outer(self.end - self.begin, self.end - self.begin)
        covariances = []
        for phase in (_white, _flicker, _walk):
            begins, outward, inward, last = (phase(t) for t in lags)
            covariances.append((begins - outward - inward + last) / widths)
        return covariances


def _white(lag: Floats) -> Floats:
    return -lag / 2.0


def _flicker(lag: Floats) -> Floats:
    return np.asarray(lag * lag * np.log(np.where(lag > 0.0, lag, 1.0)) / (2.0 * math.pi))


def _walk(lag: Floats) -> Floats:
    return np.asarray(lag**3 / 12.0)


@lru_cache(maxsize=4)
def _model(begin: tuple[float, ...], end: tuple[float, ...]) -> VarianceModel:
    return VarianceModel(np.array(begin), np.array(end))


def variance_model(means: CellMeans) -> VarianceModel:
    """Return the model of some stretches; that of the last four is cached."""
    return _model(tuple(means.begin.tolist()), tuple(means.end.tolist()))


@dataclass(frozen=True)
class Likelihood:
    """A maximum of the likelihood of contrasts with normal distribution.

    Attributes
    ----------
    value : float
        Twice the log likelihood, up to a constant.
    variances : (components,) float64 array
    whitening : (contrasts, contrasts) float64 array
        W with W C W' = 1.
    residual : (contrasts,) float64 array
        Whitened contrasts less their mean.
    amplitudes : (effects,) float64 array
        Of the effects on the mean.
    """

    value: float
    variances: Floats
    whitening: Floats
    residual: Floats
    amplitudes: Floats


def likelihood(
    values: Floats, units: Sequence[Floats], variances: Floats, effects: Floats | None = None
) -> Likelihood:
    """Return the likelihood of contrasts at given variances, the best amplitudes of the effects.

    Parameters
    ----------
    values : (contrasts,) float64 array
    units : sequence of (contrasts, contrasts) float64 arrays
        Covariance of each variance component.
    variances : (components,) float64 array
    effects : (contrasts, effects) float64 array, optional
        Effects on the mean, of unit size.

    Raises
    ------
    numpy.linalg.LinAlgError
        When the covariance is not positive definite.
    """
    covariance = sum((v * u for v, u in zip(variances, units)), np.zeros_like(units[0]))
    covariance[np.diag_indices_from(covariance)] += 1e-12 * np.trace(covariance) / len(values)
    factor = np.linalg.cholesky(covariance)
    whitening = np.linalg.inv(factor)
    white: Floats = np.asarray(whitening @ values)
    amplitudes = np.zeros(0)
    if effects is not None and effects.shape[1]:
        seen = whitening @ effects
        amplitudes = np.asarray(np.linalg.lstsq(seen, white, rcond=None)[0])
        white -= seen @ amplitudes
    value = -2.0 * float(np.log(np.diag(factor)).sum()) - float(white @ white)
    return Likelihood(value, variances, whitening, white, amplitudes)


def maximum(
    values: Floats,
    units: Sequence[Floats],
    start: Floats,
    effects: Floats | None = None,
    rounds: int = 25,
) -> Likelihood:
    """Return the maximum of the likelihood over variances of 0 or above, by Fisher scoring.

    Parameters
    ----------
    values, units, effects
        As of `likelihood`.
    start : (components,) float64 array
        Variances to begin with.
    rounds : int
        Most iterations.
    """
    best = likelihood(values, units, start, effects)
    for _ in range(rounds):
        score, information = _score(best, units)
        free = (best.variances > 0.0) | (score > 0.0)
        if not free.any():
            break
        scale = np.sqrt(np.diag(information)[free])
        scaled = information[np.ix_(free, free)] / np.outer(scale, scale)
        scaled[np.diag_indices_from(scaled)] += 1e-9
        change = np.zeros(len(start))
        change[free] = np.linalg.solve(scaled, score[free] / scale) / scale
        found = _climb(best, values, units, change, effects)
        if found is None:
            break
        gain, best = found.value - best.value, found
        if gain < TOLERANCE:
            break
    return best


def _score(at: Likelihood, units: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Return the derivative of the log likelihood by the variances, and its information."""
    inverse = at.whitening.T @ at.whitening
    weighted = at.whitening.T @ at.residual
    products = [inverse @ unit for unit in units]
    score = [float(weighted @ u @ weighted - np.trace(p)) / 2.0 for u, p in zip(units, products)]
    information = [[float(np.sum(p * q.T)) / 2.0 for q in products] for p in products]
    return np.array(score), np.array(information)


def _climb(
    at: Likelihood,
    values: Floats,
    units: Sequence[Floats],
    change: Floats,
    effects: Floats | None,
) -> Likelihood | None:
    """Return the likelihood after the change or a part of it; None if none is better."""
    for halvings in range(10):
        new = np.maximum(at.variances + change * 0.5**halvings, 0.0)
        if not new.any():
            continue
        try:
            found = likelihood(values, units, new, effects)
        except np.linalg.LinAlgError:
            continue
        if found.value >= at.value:
            return found
    return None


STARTS = ((0.4, 0.3, 0.3), (0.9, 0.05, 0.05), (0.05, 0.05, 0.9))
"""Shares of the three components in the variance from which the maximum is searched."""


def null_model(values: Floats, model: VarianceModel) -> Likelihood:
    """Return the likelihood of contrasts without any effect."""
    scale = float(values @ values) / len(values)
    sizes = np.array([np.trace(unit) / len(values) for unit in model.units])
    starts = [scale * np.array(shares) / sizes for shares in STARTS]
    return max((maximum(values, model.units, s) for s in starts), key=lambda found: found.value)


@dataclass(frozen=True)
class EarlyPart:
    """An early part of a recording that differs from the rest.

    Attributes
    ----------
    kind : 'warm_up' or 'early_drift'
        A mean that settles, or a larger random walk.
    axes : tuple of int
        Positions of the axes on which it is significant.
    amplitudes : (axes,) float64 array
        Change of the mean by warming up, for all axes; 0 for early drift.
    decay : float
        Correlation time or duration of the warm-up in samples; the age itself for early drift.
    excess : float
        Twice the log likelihood ratio beyond its threshold.
    age : int
        Age in samples from which it has no effect.
    """

    kind: str
    axes: tuple[int, ...]
    amplitudes: Floats
    decay: float
    excess: float
    age: int


@dataclass(frozen=True)
class _Candidate:
    kind: str
    parameter: float
    shape: Floats


def early_parts(recording: Recording, sensors: Sequence[Sequence[int]]) -> tuple[EarlyPart, ...]:
    """Return the early parts of a recording that differ significantly from the rest, in turn.

    The most significant one is found first; what follows it is tested again, up to half the
    recording.

    Parameters
    ----------
    recording : Recording
    sensors : sequence of sequences of int
        Positions of the axes of each sensor; their likelihood ratios are summed.
    """
    found: list[EarlyPart] = []
    left_out = 0
    while left_out <= len(recording.cell_samples) // 2:
        rest = replace(
            recording,
            cell_samples=recording.cell_samples[left_out:],
            cell_means=recording.cell_means[left_out:],
        )
        tests = [_strongest(rest, sensors, kind, limits) for kind, limits in THRESHOLDS.items()]
        part = max((t for t in tests if t), key=lambda t: t.excess, default=None)
        if part is None:
            break
        found.append(replace(part, age=part.age + left_out * recording.step))
        left_out = math.ceil(found[-1].age / recording.step)
    return tuple(found)


THRESHOLDS = {'warm_up': (17.5, 22.0, 26.0), 'early_drift': (16.5, 18.0, 20.0)}
"""Twice the log likelihood ratio that is significant: of one axis, one sensor, and all axes."""


def ratios(
    recording: Recording, kind: str
) -> tuple[VarianceModel, list[_Candidate], Floats, list[Likelihood | None]]:
    """Return twice the log likelihood ratios of the candidates of one kind of early part.

    Returns
    -------
    model : VarianceModel
    candidates : list
    ratios : (axes, candidates) float64 array
    null : list of Likelihood or None
        Without the effect; None for an axis without noise.
    """
    means = CellMeans.of(recording)
    model = variance_model(means)
    candidates = _candidates(model, len(recording.cell_samples), kind)
    values = model.contrasts @ means.means
    nulls = [_null_of(column, model) for column in values.T]
    scores = np.array(
        [[_score_of(null, c, kind) if null else 0.0 for c in candidates] for null in nulls]
    )
    out = np.zeros_like(scores)
    pooled = set(np.argsort(scores.sum(axis=0))[-3:].tolist())
    for axis, null in enumerate(nulls):
        if null is None:
            continue
        for i in pooled | {int(scores[axis].argmax())}:
            new = _alternative(values[:, axis], model, null, candidates[i], kind)
            out[axis, i] = max(new.value - null.value, 0.0)
    return model, candidates, out, nulls


def _null_of(values: Floats, model: VarianceModel) -> Likelihood | None:
    return null_model(values, model) if float(values @ values) > 0.0 else None


def _alternative(
    values: Floats, model: VarianceModel, null: Likelihood, candidate: _Candidate, kind: str
) -> Likelihood:
    if kind == 'warm_up':
        effect = candidate.shape[:, None]
        return maximum(values, model.units, null.variances, effect, rounds=10)
    start = np.append(null.variances, 0.0)
    return maximum(values, (*model.units, candidate.shape), start, rounds=10)


def _score_of(null: Likelihood, candidate: _Candidate, kind: str) -> float:
    """Return the score statistic of an effect: the ratio expected without a new maximum."""
    if kind == 'warm_up':
        shape = null.whitening @ candidate.shape
        return float((shape @ null.residual) ** 2 / max(float(shape @ shape), 1e-300))
    unit = null.whitening @ candidate.shape @ null.whitening.T
    score = float(null.residual @ unit @ null.residual - np.trace(unit))
    return max(score, 0.0) ** 2 / max(2.0 * float(np.sum(unit * unit)), 1e-300)


def _candidates(model: VarianceModel, cells: int, kind: str) -> list[_Candidate]:
    if kind == 'early_drift':
        ages = np.geomspace(4.0, cells * LONGEST_EARLY, EARLY_AGES)
        return [_Candidate('walk', a, model.early_walk(a)) for a in ages.tolist()]
    decays = np.geomspace(0.7, cells * LONGEST_DECAY, DECAYS).tolist()
    lines = np.geomspace(2.0, cells * LONGEST_LINE, LINES).tolist()
    return [_Candidate('exponential', d, model.exponential(d)) for d in decays] + [
        _Candidate('linear', d, model.linear(d)) for d in lines
    ]


def _strongest(
    recording: Recording,
    sensors: Sequence[Sequence[int]],
    kind: str,
    thresholds: tuple[float, float, float],
) -> EarlyPart | None:
    if np.count_nonzero(2 * recording.cell_samples >= recording.step) < LEAST_CELLS:
        return None
    model, candidates, ratio, nulls = ratios(recording, kind)
    every = tuple(range(len(ratio)))
    groups = [(one,) for one in every] + [tuple(s) for s in sensors] + [every]
    limits = [thresholds[0]] * len(every) + [thresholds[1]] * len(sensors) + [thresholds[2]]
    excesses = [float(ratio[list(g)].sum(axis=0).max()) - limit for g, limit in zip(groups, limits)]
    strongest = int(np.argmax(excesses))
    if excesses[strongest] <= 0.0:
        return None
    group = groups[strongest]
    best = candidates[int(ratio[list(group)].sum(axis=0).argmax())]
    amplitudes = np.zeros(len(every))
    age = best.parameter
    if kind == 'warm_up':
        means = CellMeans.of(recording)
        values = model.contrasts @ means.means
        ages = [age]
        for axis, null in enumerate(nulls):
            if null is None:
                continue
            new = _alternative(values[:, axis], model, null, best, kind)
            amplitudes[axis] = new.amplitudes[0]
            if axis in group:
                ages.append(_invisible_from(means, new, best))
        age = max(ages)
    return EarlyPart(
        kind,
        group,
        amplitudes,
        best.parameter * recording.step,
        excesses[strongest],
        math.ceil(age * recording.step),
    )


def _invisible_from(means: CellMeans, fit: Likelihood, effect: _Candidate) -> float:
    """Return the age in cells from which the rest of a warm-up has no effect.

    Beyond the last stretch the exponential is extrapolated.
    """
    if effect.kind == 'linear':
        return effect.parameter
    last = means.end[-1]
    age, seen = 0.0, math.inf
    while age < last / 2.0 and seen >= INVISIBLE:
        age = max(age * 1.1, age + 1.0)
        rest = means.since(age)
        if len(rest.begin) < 5:
            break
        model = VarianceModel(rest.begin, rest.end)
        shape = model.exponential(effect.parameter)[:, None]
        try:
            at = likelihood(shape[:, 0], model.units, fit.variances)
        except np.linalg.LinAlgError:
            break
        seen = float(fit.amplitudes[0] ** 2 * (at.residual @ at.residual))
    if seen >= INVISIBLE:
        age += effect.parameter / 2.0 * math.log(max(seen, 1.0) + 1.0)
    return age
