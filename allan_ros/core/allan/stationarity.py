# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stationarity tests for an early part that differs from the rest, and for jumps of the bias.

All tests compare the likelihood of two models of the cell means of a recording
(`history.Recording`; Neyman & Pearson, 1933). The model without an effect is white noise, bias
instability and random walk, plus a constant and a ramp. The other model has an additional mean or
variance component. The three variances are fitted again under each model by maximum likelihood on
the contrasts that are free of the constant and the ramp (Patterson & Thompson, Biometrika 58,
1971). Twice the log likelihood ratio is summed over the axes of a sensor, because temperature acts
on all of them.

The thresholds were determined by simulation, see docs/engineering/stationarity.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .history import Recording
from .likelihood import (
    CellMeans,
    Likelihood,
    VarianceModel,
    likelihood,
    maximum,
    null_model,
    variance_model,
)

Floats = NDArray[np.float64]
Axes = tuple[int, ...]

LEAST_CELLS = 24
"""Smallest number of cells with data in a recording that is tested."""

DECAYS, LONGEST_DECAY = 8, 1 / 12
"""Number of correlation times tried for an exponential warm-up; the longest, as a fraction of the
recording."""

LINES, LONGEST_LINE = 5, 1 / 3
"""Number of durations tried for a linear warm-up; the longest, as a fraction of the recording."""

EARLY_AGES, LONGEST_EARLY = 7, 1 / 2
"""Number of ages tried for the end of an early part with larger drift; the largest, as a fraction
of the recording."""

INVISIBLE = 1.0
"""The rest of a warm-up is negligible if it changes twice the log likelihood by less than this."""


@dataclass(frozen=True)
class EarlyPart:
    """An early part of a recording that differs from the rest."""

    kind: str  # 'warm_up': a mean that settles, or 'early_drift': a larger random walk
    axes: Axes  # positions of the axes with a significant difference
    amplitudes: Floats  # (axes,) change of the mean due to warm-up, for all axes; 0 for early drift
    # correlation time or duration of the warm-up in samples; the age itself for early drift
    decay: float
    excess: float  # twice the log likelihood ratio less its threshold
    age: int  # age in samples after which the effect is negligible


@dataclass(frozen=True)
class _Candidate:
    kind: str
    parameter: float
    shape: Floats


def early_parts(recording: Recording, sensors: Sequence[Sequence[int]]) -> tuple[EarlyPart, ...]:
    """Return the early parts of a recording that differ significantly from the rest, in turn.

    The most significant part is found first. The remaining data are tested again, up to half of the
    recording.

    The likelihood ratios of the axes of each of the ``sensors`` (positions of axes) are summed.
    """
    found: list[EarlyPart] = []
    left_out = 0
    while left_out <= len(recording.cell_samples) // 2:
        rest = recording.cells(left_out)
        tests = [_strongest(rest, sensors, kind) for kind in THRESHOLDS]
        part = max((t for t in tests if t), key=lambda t: t.excess, default=None)
        if part is None:
            break
        found.append(replace(part, age=part.age + left_out * recording.step))
        left_out = math.ceil(found[-1].age / recording.step)
    return tuple(found)


THRESHOLDS = {'warm_up': (17.5, 27.0, 31.0), 'early_drift': (22.0, 24.0, 27.0)}
"""Significant values of twice the log likelihood ratio: of one axis, one sensor, and all axes.
According to the tails of 60 records of table 1, X, about one clean record in 1000 exceeds each of
the six values."""

SCREENED = 0.5
"""Axes are fitted only if a score reaches this fraction of its threshold. In 130 simulated axes
with a significant ratio, the score was above 0.65 of the threshold."""

SHARES = 3.5
"""Twice the log likelihood ratio above which an axis is named together with the others."""


def _groups(axes: int, sensors: Sequence[Sequence[int]], kind: str) -> Iterator[tuple[Axes, float]]:
    """Yield the axes that are tested together and their threshold."""
    of_axis, of_sensor, of_all = THRESHOLDS[kind]
    yield from (((axis,), of_axis) for axis in range(axes))
    yield from ((tuple(sensor), of_sensor) for sensor in sensors)
    yield tuple(range(axes)), of_all


def _alternative(
    values: Floats, model: VarianceModel, null: Likelihood, candidate: _Candidate, kind: str
) -> Likelihood:
    if kind == 'warm_up':
        effect = candidate.shape[:, None]
        return maximum(values, model.units, null.variances, effect, rounds=10)
    start = np.append(null.variances, 0.0)
    return maximum(values, (*model.units, candidate.shape), start, rounds=10)


def _score_of(null: Likelihood, candidate: _Candidate, kind: str) -> float:
    """Return the score statistic of an effect: the expected ratio without a new maximisation."""
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
    recording: Recording, sensors: Sequence[Sequence[int]], kind: str
) -> EarlyPart | None:
    """Return the most significant early part of one kind; None if no part is significant."""
    if np.count_nonzero(2 * recording.cell_samples >= recording.step) < LEAST_CELLS:
        return None
    means = CellMeans.of(recording)
    model = variance_model(means)
    candidates = _candidates(model, len(recording.cell_samples), kind)
    values = (model.contrasts @ means.means).T
    nulls = [null_model(each, model) for each in values]
    scores = np.array(
        [[_score_of(null, c, kind) if null else 0.0 for c in candidates] for null in nulls]
    )
    groups = list(_groups(len(nulls), sensors, kind))
    fitted = {
        axis
        for group, limit in groups
        if scores[list(group)].sum(axis=0).max() >= SCREENED * limit
        for axis in group
    }
    ratio = np.zeros_like(scores)
    pooled = set(np.argsort(scores.sum(axis=0))[-3:].tolist())
    for axis, null in enumerate(nulls):
        if null is None or axis not in fitted:
            continue
        for i in pooled | {int(scores[axis].argmax())}:
            new = _alternative(values[axis], model, null, candidates[i], kind)
            ratio[axis, i] = max(new.value - null.value, 0.0)
    excess, group = max(
        ((float(ratio[list(g)].sum(axis=0).max()) - limit, g) for g, limit in groups),
        key=lambda one: one[0],
    )
    if excess <= 0.0:
        return None
    chosen = int(ratio[list(group)].sum(axis=0).argmax())
    best, group = candidates[chosen], tuple(i for i in group if ratio[i, chosen] >= SHARES)
    amplitudes = np.zeros(len(nulls))
    age = best.parameter
    if kind == 'warm_up':
        for axis, null in enumerate(nulls):
            if null is None:
                continue
            new = _alternative(values[axis], model, null, best, kind)
            amplitudes[axis] = new.amplitudes[0]
            if axis in group:
                age = max(age, _invisible_from(means, new, best))
    decay, end = best.parameter * recording.step, math.ceil(age * recording.step)
    return EarlyPart(kind, group, amplitudes, decay, excess, end)


def _invisible_from(means: CellMeans, fit: Likelihood, effect: _Candidate) -> float:
    """Return the age in cells after which the rest of a warm-up is negligible.

    After the last interval the exponential is extrapolated.
    """
    if effect.kind == 'linear':
        return effect.parameter
    last = means.end[-1]
    age, rest_effect = 0.0, math.inf
    while age < last / 2.0 and rest_effect >= INVISIBLE:
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
        rest_effect = float(fit.amplitudes[0] ** 2 * (at.residual @ at.residual))
    if rest_effect >= INVISIBLE:
        age += effect.parameter / 2.0 * math.log(max(rest_effect, 1.0) + 1.0)
    return age


# --- steps of the bias ----------------------------------------------------------------------------


@dataclass(frozen=True)
class BiasSteps:
    """Steps of the bias of one axis."""

    axis: int
    ages: tuple[float, ...]  # positions of the steps in samples, largest likelihood first
    sizes: Floats  # (steps,) sizes in the unit of the samples
    # variance of the random walk per sample, without and with the steps
    walk_before: float
    walk_after: float
    excess: float  # twice the log likelihood ratio less its threshold


MOST_STEPS = 8
"""Largest number of steps that are searched for on one axis."""

FIRST_SCORE, NEXT_SCORE = 12.0, 8.0
"""Smallest score statistic at which the first step, and each further step, is tried."""

STEP_PRICE, STEPS_THRESHOLD = 8.0, 22.0
"""Twice the log likelihood ratio that is subtracted for each step, and the smallest remainder that
is a finding."""

STEP_CELLS, STEP_STRETCHES = 512, 256
"""Largest number of intervals in which steps are located, and with which the variances are fitted.
With the same intervals for both, 5 instead of 1 of 320 clean records have steps."""


def bias_steps(recording: Recording, age: int = 0) -> tuple[BiasSteps, ...]:
    """Return the axes on which steps of the bias are more likely than a random walk alone.

    Steps are added one by one at the largest score, and the variances are fitted again. The first
    ``age`` samples are left out.
    """
    offset = math.ceil(age / recording.step)
    recording = recording.cells(offset)
    fine = CellMeans.even(recording, STEP_CELLS)
    if len(fine.begin) < LEAST_CELLS:
        return ()
    grown, coarse = CellMeans.of(recording), CellMeans.even(recording, STEP_STRETCHES)
    samples = recording.cell_samples
    found = []
    model = variance_model(grown)
    values = model.contrasts @ grown.means
    for axis in range(fine.means.shape[1]):
        start = null_model(values[:, axis], model)
        steps = None if start is None else _steps_of(axis, fine, coarse, samples, start.variances)
        if steps is not None:
            ages = tuple((a + offset) * recording.step for a in steps.ages)
            scale = 1.0 / recording.step  # random walk per cell
            walks = steps.walk_before * scale, steps.walk_after * scale
            found.append(replace(steps, ages=ages, walk_before=walks[0], walk_after=walks[1]))
    return tuple(found)


def _steps_of(
    axis: int, fine: CellMeans, coarse: CellMeans, samples: NDArray[np.int64], start: Floats
) -> BiasSteps | None:
    """Return the steps of one axis in cells; None if they are not significant."""
    where, fitted = variance_model(fine), variance_model(coarse)
    ages = fine.begin[2:-1]
    every = where.steps(ages, samples)
    values = where.contrasts @ fine.means[:, axis]
    coarse_values = fitted.contrasts @ coarse.means[:, axis]
    chosen: list[int] = []
    null: Likelihood | None = None
    best: Likelihood | None = None
    current: Likelihood | None = None
    best_excess = 0.0
    while len(chosen) < MOST_STEPS:
        at = start if current is None else current.variances
        scores = _step_scores(values, where, at, every, chosen)
        strongest = int(scores.argmax())
        if scores[strongest] < (NEXT_SCORE if chosen else FIRST_SCORE):
            break
        if null is None or current is None:
            null = current = maximum(coarse_values, fitted.units, start, rounds=12)
        chosen.append(strongest)
        effects = fitted.steps(ages[chosen], samples)
        current = maximum(coarse_values, fitted.units, current.variances, effects, rounds=12)
        excess = current.value - null.value - STEP_PRICE * len(chosen) - STEPS_THRESHOLD
        if excess > best_excess:
            best, best_excess = current, excess
    if best is None or null is None:
        return None
    kept = tuple(float(a) for a in ages[chosen[: len(best.amplitudes)]])
    walks = float(null.variances[2]), float(best.variances[2])
    return BiasSteps(axis, kept, best.amplitudes, *walks, best_excess)


def _step_scores(
    values: Floats, model: VarianceModel, variances: Floats, every: Floats, chosen: list[int]
) -> Floats:
    """Return the score statistic of each additional step."""
    known = every[:, chosen] if chosen else None
    at = likelihood(values, model.units, variances, known)
    whitened = at.whitening @ every
    if known is not None:
        basis, _ = np.linalg.qr(at.whitening @ known)
        whitened = whitened - basis @ (basis.T @ whitened)
    sizes = (whitened**2).sum(axis=0)
    return np.asarray((whitened.T @ at.residual) ** 2 / np.maximum(sizes, 1e-9 * sizes.max()))
