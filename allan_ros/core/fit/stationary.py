# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fit of recordings whose noise changes with time: `fit_stationary`.

If an early part (a warm-up, or a larger drift) differs, the part after it is fitted. Findings
report steps of the bias. Intervals are widened if the level of the white noise or the size of the
drift varies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..allan.history import Recording
from ..allan.levels import drift_scatter, level_changes, level_scatter
from ..allan.parts import settled_sums
from ..allan.stationarity import BiasSteps, EarlyPart, bias_steps, early_parts
from ..allan.sums import AllanSums
from ..errors import AllanError
from ..findings import Finding, Quantity, duration_text, finding
from ..imu import SENSORS, sensor_of
from . import TERMS, Coefficient, NoiseModel, fit_noise
from .model import Z_95

LEAST_REMAINING = 0.4
"""Smallest fraction of the samples that must remain after the early part: half of the recording,
less the loss because sums can be divided only at some ages."""

CERTAIN_EXCESS = 4.5
"""Excess of the likelihood ratio statistic over its threshold above which the early part is left
out."""

SHIFT, LEAST_SHIFT = 0.02, 0.005
"""Relative changes of a coefficient: one that is always relevant, and one below which a change is
never relevant."""

TESTED_RECORDINGS = 8
"""Number of the longest recordings that are tested."""

LEAST_TESTED_S = 120.0
"""Shortest recording in s in which bias steps and the size of the drift are tested, and in which an
early part is reported even if no coefficient leaves its interval. In shorter ones, means over less
than a quarter of a second would be compared, which change because of vibration, not drift."""

STEPS_RATIO = 0.96
"""Steps are reported if the variance of the random walk with steps in the model is below this
fraction of that without them."""


@dataclass(frozen=True)
class _Change:
    """A coefficient estimated from all data, and from the data after the early part."""

    axis: str
    term: str
    complete: Coefficient
    settled: Coefficient

    @property
    def is_outside(self) -> bool:
        """Whether the settled value is outside the interval of all data."""
        a, b = self.complete, self.settled
        low, high = a.ci95 or (0.0, math.inf if a.upper95 is None else a.upper95)
        if b.status != 'estimated' or b.value is None:
            return b.upper95 is not None and b.upper95 < low
        return not low <= b.value <= high

    @property
    def is_relevant(self) -> bool:
        """Whether the change is large enough to be reported."""
        a, b = self.complete, self.settled
        if a.status != 'estimated' or b.status != 'estimated' or not a.value or b.value is None:
            return self.is_outside
        shift = abs(b.value / a.value - 1.0)
        return shift > (LEAST_SHIFT if self.is_outside else SHIFT)

    @property
    def _values_or_limits(self) -> list[float]:
        """Both estimates; for an unresolved term its upper limit, or 0 if there is none."""
        both = self.complete, self.settled
        return [(c.value if c.status == 'estimated' else c.upper95) or 0.0 for c in both]

    @property
    def size(self) -> float:
        """Absolute logarithm of the ratio of both values."""
        a, b = self._values_or_limits
        return abs(math.log(a / b)) if a and b else 0.0

    @property
    def values(self) -> dict[str, object]:
        """The values of the finding: the axis, the term, and its coefficient before and after."""
        before, after = (
            Quantity(value, sensor_of(self.axis), self.term)
            if c.status == 'estimated'
            else Quantity(None, sensor_of(self.axis), self.term, high=value)
            for c, value in zip((self.complete, self.settled), self._values_or_limits)
        )
        return {'axis': self.axis, 'term': self.term, 'before': before, 'after': after}


def fit_stationary(
    sums: AllanSums, method: str = 'gls', settle: bool = True
) -> tuple[AllanSums, NoiseModel]:
    """Fit all data or, if an early part differs (warm-up or larger drift), the part after it.

    Parameters
    ----------
    sums : AllanSums
    method : str
        One of `METHODS`; 'paper' always fits all data.
    settle : bool
        Whether an early part may be left out; a finding reports it in any case.

    Returns
    -------
    sums : AllanSums
        The sums that were fitted.
    model : NoiseModel
        The fit, with findings about noise that changes with time.

    Raises
    ------
    AllanError
        If the method is unknown, or there are fewer than two samples.
    """
    if method == 'paper' or not sums.tau0:
        return sums, fit_noise(sums, method)
    longest = sums.history.recordings[:TESTED_RECORDINGS]
    parts = [part for one in longest for part in early_parts(one, _axes_by_sensor(sums))]
    used, model, found = _without_early_part(sums, method, settle, parts)
    age = max((part.age for part in parts), default=0)
    found += [_steps_finding(sums, steps, model) for steps in _largest_bias_steps(sums, age)]
    model, scattered = _widen_for_changes(sums, age, model)
    return used, replace(model, findings=(*found, *scattered, *model.findings))


def _widen_for_changes(
    sums: AllanSums, age: int, model: NoiseModel
) -> tuple[NoiseModel, list[Finding]]:
    """Widen the intervals for noise that changes with time; return the model and findings."""
    # Only data after the first ``age`` samples are tested.
    recordings = sums.history.recordings
    which = 'between recordings' if len(recordings) > 1 else 'within the recording'
    found = []
    for i, scatter in enumerate(level_scatter(recordings, len(sums.axes), age).tolist()):
        model = _widened(model, sums.axes[i], 'N', scatter)
    for i, change in level_changes(recordings, age).items():
        axis = sums.axes[i]
        n = model.axes[axis].noise['N']
        if n.status == 'estimated' and n.value:
            ends = {'low': n.value * change.low, 'high': n.value * change.high}
            found.append(finding('level_changes', (axis,), which=which, value=n.value, **ends))
    tested = _recordings_to_test(sums, len(recordings))
    drift = dict(zip(sums.axes, drift_scatter(tested, _axes_by_sensor(sums), age).tolist()))
    for axis, scatter in drift.items():
        model = _widened(model, axis, 'BK', scatter)
    # If the drift is not resolved, its relative change is unknown.
    scattered = tuple(axis for axis in sums.axes if drift[axis] and _has_drift(model, axis))
    if scattered:
        typical = math.expm1(max(drift[axis] for axis in scattered))
        found.append(finding('drift_changes', scattered, which=which, typical=typical))
    return model, found


def _has_drift(model: NoiseModel, axis: str) -> bool:
    return any(model.axes[axis].noise[term].status == 'estimated' for term in 'BK')


def _recordings_to_test(sums: AllanSums, most: int = TESTED_RECORDINGS) -> list[Recording]:
    """Return up to ``most`` of the longest recordings that are long enough for a test of drift."""
    least = LEAST_TESTED_S / (sums.tau0 or 1.0)
    return [one for one in sums.history.recordings[:most] if one.length >= least]


def _without_early_part(
    sums: AllanSums, method: str, settle: bool, parts: list[EarlyPart]
) -> tuple[AllanSums, NoiseModel, list[Finding]]:
    """Leave out an early part (warm-up) that changes a coefficient; return sums, fit, findings.

    ``parts`` are the detected early parts. With ``settle`` False, none is left out, only reported.
    """
    if not parts or not sums.tau0:
        return sums, fit_noise(sums, method), []
    last = max(parts, key=lambda part: part.age)
    divided = _settled_part(sums, last.age)
    if divided is None:
        return sums, fit_noise(sums, method), [_warm_up_finding(sums, parts, last.age)]
    remaining, age = divided
    settled = fit_noise(remaining, method)
    certain = settle and max(part.excess for part in parts) >= CERTAIN_EXCESS
    # The selection of the model takes most of the time: it is done once.
    complete = fit_noise(sums, method, settled if certain else None)
    # Coefficients of the other axes also change by chance, because they are estimated from fewer
    # samples.
    axes = tuple(a for i, a in enumerate(sums.axes) if any(i in part.axes for part in parts))
    every = [
        _Change(axis, term, complete.axes[axis].noise[term], settled.axes[axis].noise[term])
        for axis in axes
        for term in TERMS
    ]
    every.sort(key=lambda change: -change.size)
    brief = sums.history.length * sums.tau0 < LEAST_TESTED_S
    changes = [each for each in every if each.is_relevant and (each.is_outside or not brief)]
    if not changes and (brief or not certain):
        return sums, complete, []
    found = finding(
        'settled_part' if certain else 'early_part',
        axes,
        early=age * sums.tau0,
        **_early_part_values(sums, parts),
        **(changes or every)[0].values,
    )
    return (remaining, settled, [found]) if certain else (sums, complete, [found])


def _largest_bias_steps(sums: AllanSums, age: int) -> list[BiasSteps]:
    """Return the most significant bias steps of each axis after the first ``age`` samples."""
    best: dict[int, BiasSteps] = {}
    for recording in _recordings_to_test(sums):
        for steps in bias_steps(recording, age):
            have = best.get(steps.axis)
            if steps.walk_after < STEPS_RATIO * steps.walk_before and (
                have is None or steps.excess > have.excess
            ):
                best[steps.axis] = steps
    return [best[axis] for axis in sorted(best)]


def _steps_finding(sums: AllanSums, steps: BiasSteps, model: NoiseModel) -> Finding:
    """Return the finding about bias steps, or about a bias that differs between segments."""
    # Steps between two segments affect no coefficient.
    axis, tau0 = sums.axes[steps.axis], sums.tau0 or 1.0
    size = float(np.abs(steps.sizes).max())
    walks = [math.sqrt(walk / tau0) for walk in (steps.walk_before, steps.walk_after)]
    known = model.axes[axis].noise['K']
    most = known.ci95[1] if known.ci95 is not None else known.upper95
    if sum(each.samples > 0 for each in sums.segments) > 1 and most and most < walks[0]:
        return finding('bias_differs', (axis,), size=size)
    before, after = walks
    return finding('bias_steps', (axis,), size=size, before=before, after=after)


def _widened(model: NoiseModel, axis: str, terms: str, scatter: float) -> NoiseModel:
    """Widen the intervals of some terms of one axis by a relative standard deviation."""
    if not scatter:
        return model
    fit = model.axes[axis]
    noise = dict(fit.noise)
    for term in terms:
        c = noise[term]
        if c.ci95 is not None and c.value and c.ci95[0] <= c.value <= c.ci95[1]:
            low, high = (
                c.value * math.exp(sign * math.hypot(math.log(end / c.value), Z_95 * scatter))
                if end > 0.0
                else 0.0
                for sign, end in zip((-1.0, 1.0), c.ci95)
            )
            c = replace(c, ci95=(low, high))
        if c.upper95 is not None:
            c = replace(c, upper95=c.upper95 * math.exp(Z_95 * scatter))
        noise[term] = c
    return replace(model, axes={**model.axes, axis: replace(fit, noise=noise)})


def _axes_by_sensor(sums: AllanSums) -> list[list[int]]:
    """Return the indices of the axes of each sensor (gyroscope, accelerometer)."""
    names = [sensor_of(axis) for axis in sums.axes]
    return [[i for i, name in enumerate(names) if name == s] for s in SENSORS if s in names]


def _settled_part(sums: AllanSums, age: int) -> tuple[AllanSums, int] | None:
    """Leave out at least the first ``age`` samples; return the sums and how many are left out.

    The result is None if too few samples remain.
    """
    # The number is at least ``age``: sums can be divided only at some ages.
    edge = next((a for a in sums.history.ages if a >= age), None)
    if edge is None:
        return None
    try:
        remaining = settled_sums(sums, edge)
    except AllanError:
        return None
    return (remaining, edge) if remaining.samples >= LEAST_REMAINING * sums.samples else None


def _warm_up_finding(sums: AllanSums, parts: list[EarlyPart], age: int) -> Finding:
    """Return the finding about a warm-up after which too few data remain for a fit."""
    tau0 = sums.tau0 or 0.0
    duration = age * tau0
    remaining = duration - sums.history.length * tau0
    after = f'after {duration_text(duration)}'
    return finding(
        'warm_up',
        tuple(axis for i, axis in enumerate(sums.axes) if any(i in part.axes for part in parts)),
        **_early_part_values(sums, parts),
        settles=f'in about {duration_text(remaining)}' if remaining > 0.0 else after,
        how_long=2.0 * duration,
    )


def _early_part_values(sums: AllanSums, parts: list[EarlyPart]) -> dict[str, object]:
    """Return the values that describe the early part in a finding."""
    warm_ups = [part for part in parts if part.kind == 'warm_up']
    if not warm_ups:
        return {'what': 'larger drift', 'size': None}
    strongest = max(warm_ups, key=lambda part: part.excess)
    axis = max(strongest.axes, key=lambda i: abs(strongest.amplitudes[i]))
    size = float(abs(strongest.amplitudes[axis]))
    return {'what': 'warm-up', 'size': Quantity(size, sensor_of(sums.axes[axis]), 'signal')}
