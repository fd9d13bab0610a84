# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Likelihood-ratio tests for a warm-up, for larger drift at the start, and for steps of the bias.

Each test compares two models of the means of a recording over time intervals (Neyman & Pearson,
1933). The null model is white noise, bias instability and random walk, plus a constant and a ramp.
The alternative has an additional mean or variance component. The three noise variances are fitted
under each model by restricted maximum likelihood (Patterson & Thompson, Biometrika 58, 1971). Twice
the log likelihood ratio is summed over the axes of a sensor, because temperature acts on all of
them.

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

MIN_CELLS = 24
"""Smallest number of cells (intervals with a mean) in a recording that is tested."""

DECAYS, LONGEST_DECAY = 8, 1 / 12
"""Number of time constants tried for an exponential warm-up; the longest, as a fraction of the
recording."""

DURATIONS, LONGEST_DURATION = 5, 1 / 3
"""Number of durations tried for a linear warm-up; the longest, as a fraction of the recording."""

EARLY_AGES, LONGEST_EARLY = 7, 1 / 2
"""Number of ages tried for the end of an early part with larger drift; the largest, as a fraction
of the recording."""

NEGLIGIBLE = 1.0
"""The remainder of a warm-up is negligible if it changes twice the log likelihood by less than
this."""


@dataclass(frozen=True)
class EarlyPart:
    """The early part of a recording, whose mean or drift differs from the later part."""

    kind: str  # 'warm_up' (the mean settles) or 'early_drift' (the random walk is larger)
    axes: Axes  # positions of the axes with a significant difference
    amplitudes: Floats  # (axes,) change of the mean due to warm-up, for all axes; 0 for early drift
    # time constant or duration of the warm-up, or end of the larger drift, in samples
    decay: float
    excess: float  # twice the log likelihood ratio minus its threshold
    age: int  # age in samples after which the effect is negligible


@dataclass(frozen=True)
class _Candidate:
    kind: str  # 'exponential' or 'linear' (warm-up), 'walk' (early drift)
    parameter: float  # time constant, duration or end, in cells
    shape: Floats  # contrasts of the mean, (contrasts,), or their covariance for 'walk'


def early_parts(recording: Recording, sensors: Sequence[Sequence[int]]) -> tuple[EarlyPart, ...]:
    """Return the early parts of a recording with a significant warm-up or larger drift.

    After an early part is found, the data after it are tested in the same way. The tests end when
    nothing is significant or more than half of the recording is left out.

    ``sensors`` contains the positions of the axes of each sensor, which are tested together.
    """
    found: list[EarlyPart] = []
    left_out = 0
    while left_out <= len(recording.cell_samples) // 2:
        later = recording.cells(left_out)
        tests = [_most_significant(later, sensors, kind) for kind in THRESHOLDS]
        part = max((t for t in tests if t), key=lambda t: t.excess, default=None)
        if part is None:
            break
        found.append(replace(part, age=part.age + left_out * recording.step))
        left_out = math.ceil(found[-1].age / recording.step)
    return tuple(found)


THRESHOLDS = {'warm_up': (17.5, 27.0, 31.0), 'early_drift': (22.0, 24.0, 27.0)}
"""Significant values of twice the log likelihood ratio of one axis, summed over one sensor, and
over all axes. In simulated stationary records, each is exceeded about once in 1000 records."""

SCREENED = 0.5
"""Axes are fitted only if a score statistic reaches this fraction of its threshold. In 130
simulated axes with a significant ratio, the score was above 0.65 of the threshold."""

AXIS_THRESHOLD = 3.5
"""Twice the log likelihood ratio above which a single axis of a significant group is reported."""


def _groups(axes: int, sensors: Sequence[Sequence[int]], kind: str) -> Iterator[tuple[Axes, float]]:
    """Yield each group of axes that is tested together, and its threshold."""
    of_axis, of_sensor, of_all = THRESHOLDS[kind]
    yield from (((axis,), of_axis) for axis in range(axes))
    yield from ((tuple(sensor), of_sensor) for sensor in sensors)
    yield tuple(range(axes)), of_all


def _fit_alternative(
    values: Floats, model: VarianceModel, null: Likelihood, candidate: _Candidate
) -> Likelihood:
    if candidate.kind != 'walk':
        effect = candidate.shape[:, None]
        return maximum(values, model.units, null.variances, effect, iterations=10)
    start = np.append(null.variances, 0.0)
    return maximum(values, (*model.units, candidate.shape), start, iterations=10)


def _score_of(null: Likelihood, candidate: _Candidate) -> float:
    """Return the score statistic of an effect: about twice its log likelihood ratio."""
    if candidate.kind != 'walk':
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
    durations = np.geomspace(2.0, cells * LONGEST_DURATION, DURATIONS).tolist()
    return [_Candidate('exponential', d, model.exponential(d)) for d in decays] + [
        _Candidate('linear', d, model.linear(d)) for d in durations
    ]


def _most_significant(
    recording: Recording, sensors: Sequence[Sequence[int]], kind: str
) -> EarlyPart | None:
    """Return the most significant early part of one kind, or None."""
    if np.count_nonzero(2 * recording.cell_samples >= recording.step) < MIN_CELLS:
        return None
    means = CellMeans.growing(recording)
    model = variance_model(means)
    candidates = _candidates(model, len(recording.cell_samples), kind)
    values = (model.contrasts @ means.means).T
    nulls = [null_model(each, model) for each in values]
    scores = np.array([[_score_of(null, c) if null else 0.0 for c in candidates] for null in nulls])
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
            new = _fit_alternative(values[axis], model, null, candidates[i])
            ratio[axis, i] = max(new.value - null.value, 0.0)
    excess, group = max(
        ((float(ratio[list(g)].sum(axis=0).max()) - limit, g) for g, limit in groups),
        key=lambda one: one[0],
    )
    if excess <= 0.0:
        return None
    chosen = int(ratio[list(group)].sum(axis=0).argmax())
    best, group = candidates[chosen], tuple(i for i in group if ratio[i, chosen] >= AXIS_THRESHOLD)
    amplitudes = np.zeros(len(nulls))
    age = best.parameter
    if kind == 'warm_up':
        for axis, null in enumerate(nulls):
            if null is None:
                continue
            new = _fit_alternative(values[axis], model, null, best)
            amplitudes[axis] = new.amplitudes[0]
            if axis in group:
                age = max(age, _negligible_from(means, new, best))
    decay, end = best.parameter * recording.step, math.ceil(age * recording.step)
    return EarlyPart(kind, group, amplitudes, decay, excess, end)


def _negligible_from(means: CellMeans, fit: Likelihood, effect: _Candidate) -> float:
    """Return the age in cells after which the remainder of a warm-up is negligible."""
    if effect.kind == 'linear':
        return effect.parameter
    last = means.end[-1]
    age, change = 0.0, math.inf
    while age < last / 2.0 and change >= NEGLIGIBLE:
        age = max(age * 1.1, age + 1.0)
        later = means.since(age)
        if len(later.begin) < 5:
            break
        model = VarianceModel(later.begin, later.end)
        try:
            at = likelihood(model.exponential(effect.parameter), model.units, fit.variances)
        except np.linalg.LinAlgError:
            break
        change = float(fit.amplitudes[0] ** 2 * (at.residual @ at.residual))
    if change >= NEGLIGIBLE:
        age += effect.parameter / 2.0 * math.log(max(change, 1.0) + 1.0)
    return age


# --- steps of the bias ----------------------------------------------------------------------------


@dataclass(frozen=True)
class BiasSteps:
    """Steps of the bias of one axis."""

    axis: int  # position of the axis
    ages: tuple[float, ...]  # ages of the steps in samples, most significant first
    sizes: Floats  # (steps,) sizes in the unit of the samples
    walk_before: float  # variance of the random walk per sample, in the model without steps
    walk_after: float  # the same in the model with steps
    excess: float  # twice the log likelihood ratio minus its threshold


MAX_STEPS = 8
"""Largest number of steps that are searched for on one axis."""

FIRST_SCORE, NEXT_SCORE = 12.0, 8.0
"""Smallest score statistic for which the first step, and each further step, is tried."""

STEP_PENALTY, STEPS_THRESHOLD = 8.0, 22.0
"""Penalty for each step, subtracted from twice the log likelihood ratio, and smallest significant
difference."""

STEP_INTERVALS, FIT_INTERVALS = 512, 256
"""Largest number of intervals for locating steps, and for fitting the variances. With the same
intervals for both, steps were found in 5 instead of 1 of 320 simulated records without steps."""


def bias_steps(recording: Recording, age: int = 0) -> tuple[BiasSteps, ...]:
    """Return the bias steps of each axis for which a random walk alone does not fit the means.

    Steps are added one by one where the score statistic is largest; after each, the variances are
    fitted again. The first ``age`` samples are left out.
    """
    offset = math.ceil(age / recording.step)
    recording = recording.cells(offset)
    fine, coarse = (CellMeans.even(recording, most) for most in (STEP_INTERVALS, FIT_INTERVALS))
    grown = CellMeans.growing(recording)
    # Long intervals of a recording with many gaps may all have too few samples.
    if min(len(means.begin) for means in (fine, coarse, grown)) < MIN_CELLS:
        return ()
    samples = recording.cell_samples
    found = []
    model = variance_model(grown)
    values = model.contrasts @ grown.means
    for axis in range(fine.means.shape[1]):
        start = null_model(values[:, axis], model)
        steps = None if start is None else _steps_of(axis, fine, coarse, samples, start.variances)
        if steps is not None:
            ages = tuple((a + offset) * recording.step for a in steps.ages)
            scale = 1.0 / recording.step  # from the variance per cell to that per sample
            walks = steps.walk_before * scale, steps.walk_after * scale
            found.append(replace(steps, ages=ages, walk_before=walks[0], walk_after=walks[1]))
    return tuple(found)


def _steps_of(
    axis: int, fine: CellMeans, coarse: CellMeans, samples: NDArray[np.int64], start: Floats
) -> BiasSteps | None:
    """Return the steps of one axis, with ages in cells; None if they are not significant."""
    fine_model, coarse_model = variance_model(fine), variance_model(coarse)
    ages = fine.begin[2:-1]
    all_effects = fine_model.steps(ages, samples)
    values = fine_model.contrasts @ fine.means[:, axis]
    coarse_values = coarse_model.contrasts @ coarse.means[:, axis]
    chosen: list[int] = []
    null: Likelihood | None = None
    best: Likelihood | None = None
    current: Likelihood | None = None
    best_excess = 0.0
    while len(chosen) < MAX_STEPS:
        at = start if current is None else current.variances
        scores = _step_scores(values, fine_model, at, all_effects, chosen)
        strongest = int(scores.argmax())
        if scores[strongest] < (NEXT_SCORE if chosen else FIRST_SCORE):
            break
        if null is None or current is None:
            null = current = maximum(coarse_values, coarse_model.units, start, iterations=12)
        chosen.append(strongest)
        effects = coarse_model.steps(ages[chosen], samples)
        current = maximum(
            coarse_values, coarse_model.units, current.variances, effects, iterations=12
        )
        excess = current.value - null.value - STEP_PENALTY * len(chosen) - STEPS_THRESHOLD
        if excess > best_excess:
            best, best_excess = current, excess
    if best is None or null is None:
        return None
    kept = tuple(float(a) for a in ages[chosen[: len(best.amplitudes)]])
    walks = float(null.variances[2]), float(best.variances[2])
    return BiasSteps(axis, kept, best.amplitudes, *walks, best_excess)


def _step_scores(
    values: Floats, model: VarianceModel, variances: Floats, effects: Floats, chosen: list[int]
) -> Floats:
    """Return the score statistic of each step in addition to those already chosen, (steps,)."""
    known = effects[:, chosen] if chosen else None
    at = likelihood(values, model.units, variances, known)
    whitened = at.whitening @ effects
    if known is not None:
        basis, _ = np.linalg.qr(at.whitening @ known)
        whitened = whitened - basis @ (basis.T @ whitened)
    sizes = (whitened**2).sum(axis=0)
    return np.asarray((whitened.T @ at.residual) ** 2 / np.maximum(sizes, 1e-9 * sizes.max()))
