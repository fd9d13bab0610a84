# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`fit_stationary`: fit recordings that are not the same throughout.

The settled part is fitted where the early part differs, steps of the bias are reported, and the
interval of N is widened where the level of the white noise varies.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..allan.history import Recording
from ..allan.levels import Scatter, drift_scatter, level_changes, level_excess
from ..allan.parts import settled_sums
from ..allan.stationarity import BiasSteps, EarlyPart, bias_steps, early_parts
from ..allan.sums import AllanSums
from ..errors import AllanError
from ..findings import Finding, duration_text, finding
from ..imu import SENSORS, sensor_of, to_datasheet
from . import TERMS, Coefficient, NoiseModel, fit_noise
from .model import Z_95

LEAST_REST = 0.4
"""The settled part is used if at least this fraction of the samples remains: half after the sensor
has settled, less what is lost because sums are divided at some ages only."""

CERTAIN = 8.0
"""Twice the log likelihood ratio beyond the threshold from which the early part is left out."""

SHIFT, LEAST_SHIFT = 0.02, 0.005
"""Relative changes of a value: one that matters in any case, and one below which none does."""

TESTED_RECORDINGS = 8
"""How many of the longest recordings are tested."""

LEAST_TESTED_S = 120.0
"""Seconds of a recording from which its drift is tested. Shorter ones are compared by means over
less than a quarter of a second, which vibration moves rather than drift."""

STEPS_MATTER = 0.96
"""Steps are reported if without them the variance of the walk is below this fraction."""

NAMED_CHANGES = 3
"""How many changed coefficients a finding names."""


@dataclass(frozen=True)
class _Change:
    """A coefficient of all data, and of the settled part."""

    axis: str
    term: str
    complete: Coefficient
    settled: Coefficient

    @property
    def matters(self) -> bool:
        """Whether the coefficient leaves its interval or moves by more than 2 %."""
        a, b = self._both
        low, high = _range(a)
        if b.status != 'estimated' or b.value is None:
            return b.upper95 is not None and b.upper95 < low
        left = not low <= b.value <= high
        if a.status != 'estimated' or not a.value:
            return left
        shift = abs(b.value / a.value - 1.0)
        return shift > SHIFT or (left and shift > LEAST_SHIFT)

    @property
    def size(self) -> float:
        """Magnitude of the logarithm of their ratio, a limit counting as the value."""
        a, b = (c.value if c.status == 'estimated' else c.upper95 for c in self._both)
        return abs(math.log(a / b)) if a and b else 0.0

    @property
    def _both(self) -> tuple[Coefficient, Coefficient]:
        return self.complete, self.settled

    def text(self, after: str) -> str:
        """Return both values in datasheet units."""
        (a, unit), (b, _) = (_text(self.axis, self.term, c) for c in self._both)
        return f'{self.axis} {self.term} is {a} {unit} in all data, {b} after {after}'


def fit_stationary(
    sums: AllanSums, method: str = 'gls', settle: bool = True
) -> tuple[AllanSums, NoiseModel]:
    """Return the fit of the sums or, if an early part differs, of the part after it.

    Parameters
    ----------
    sums : AllanSums
    method : str
        One of `METHODS`; 'paper' always fits all data.
    settle : bool
        Whether an early part may be left out; it is reported in any case.

    Returns
    -------
    sums : AllanSums
        Those that were fitted.
    model : NoiseModel
        With findings where the recording is not stationary.

    Raises
    ------
    AllanError
        As `fit_noise`.
    """
    if method == 'paper' or not sums.tau0:
        return sums, fit_noise(sums, method)
    parts = [part for one in _tested(sums) for part in early_parts(one, _sensors(sums))]
    used, model, found = _without_early_part(sums, method, settle, parts)
    age = max((part.age for part in parts), default=0)
    found += [_steps_finding(sums, steps) for steps in _steps(sums, age)]
    model, scattered = _with_scatter(sums, age, model)
    return used, replace(model, findings=(*found, *scattered, *model.findings))


def _with_scatter(sums: AllanSums, age: int, model: NoiseModel) -> tuple[NoiseModel, list[Finding]]:
    """Return the model with intervals widened by the scatter between periods, and findings."""
    recordings = sums.history.recordings
    which = 'between recordings' if len(recordings) > 1 else 'within the recording'
    found = []
    excess = level_excess(recordings, len(sums.axes), age)
    for axis, scatter in zip(sums.axes, excess.tolist()):
        model = _widened(model, axis, 'N', scatter)
    for i, change in level_changes(recordings, age).items():
        found += _level_finding(sums.axes[i], change, model, which)
        model = _widened(model, sums.axes[i], 'N', change.scatter)
    tested = _tested(sums, len(recordings))
    drift = dict(zip(sums.axes, drift_scatter(tested, _sensors(sums), age).tolist()))
    for axis, scatter in drift.items():
        for term in ('B', 'K'):
            model = _widened(model, axis, term, scatter)
    # Of a drift that is not resolved it cannot be stated how much it differs.
    scattered = tuple(axis for axis in sums.axes if drift[axis] and _has_drift(model, axis))
    if scattered:
        typical = math.expm1(max(drift[axis] for axis in scattered))
        found.append(finding('drift_changes', scattered, which=which, typical=typical))
    return model, found


def _has_drift(model: NoiseModel, axis: str) -> bool:
    return any(model.axes[axis].noise[term].status == 'estimated' for term in 'BK')


def _tested(sums: AllanSums, most: int = TESTED_RECORDINGS) -> list[Recording]:
    """Return the longest recordings, at most so many, that are long enough to test their drift."""
    least = LEAST_TESTED_S / (sums.tau0 or 1.0)
    return [one for one in sums.history.recordings[:most] if one.length >= least]


def _without_early_part(
    sums: AllanSums, method: str, settle: bool, parts: list[EarlyPart]
) -> tuple[AllanSums, NoiseModel, list[Finding]]:
    """Return the sums to be used, their fit, and the finding of the early part."""
    if not parts or not sums.tau0:
        return sums, fit_noise(sums, method), []
    last = max(parts, key=lambda part: part.age)
    rest = _rest(sums, last.age)
    if rest is None:
        return sums, fit_noise(sums, method), [_unsettled(sums, last)]
    settled = fit_noise(rest, method)
    certain = settle and max(part.excess for part in parts) >= CERTAIN
    # The selection of the model takes most of the time: once is enough.
    complete = fit_noise(sums, method, settled if certain else None)
    every = sorted(_changes(complete, settled), key=lambda change: -change.size)
    changes = [change for change in every if change.matters]
    if not changes and not certain:
        return sums, complete, []
    stated = changes or every[:NAMED_CHANGES]
    early = duration_text((_edge(sums, last.age) or 0) * sums.tau0)
    found = finding(
        'settled_part' if certain else 'early_part',
        tuple(dict.fromkeys(change.axis for change in stated)),
        early=early,
        what=_what(sums, parts),
        changes='; '.join(change.text(early) for change in stated[:NAMED_CHANGES]),
    )
    return (rest, settled, [found]) if certain else (sums, complete, [found])


def _steps(sums: AllanSums, age: int) -> list[BiasSteps]:
    """Return the bias steps of each axis, from the recording where they are most significant."""
    best: dict[int, BiasSteps] = {}
    for recording in _tested(sums):
        for steps in bias_steps(recording, age):
            have = best.get(steps.axis)
            if steps.walk_after < STEPS_MATTER * steps.walk_before and (
                have is None or steps.excess > have.excess
            ):
                best[steps.axis] = steps
    return [best[axis] for axis in sorted(best)]


def _steps_finding(sums: AllanSums, steps: BiasSteps) -> Finding:
    name = sums.axes[steps.axis]
    sensor, tau0 = sensor_of(name), sums.tau0 or 1.0
    size, size_unit = to_datasheet('B', sensor, float(np.abs(steps.sizes).max()))
    (before, unit), (after, _) = (
        to_datasheet('K', sensor, math.sqrt(walk / tau0))
        for walk in (steps.walk_before, steps.walk_after)
    )
    return finding(
        'bias_steps',
        (name,),
        count=len(steps.ages),
        size=size,
        size_unit=size_unit,
        before=before,
        after=after,
        unit=unit,
    )


def _level_finding(name: str, change: Scatter, model: NoiseModel, which: str) -> list[Finding]:
    """Return the finding of white noise that varies; none where N is not resolved."""
    noise = model.axes[name].noise['N']
    if noise.status != 'estimated' or not noise.value:
        return []
    sensor = sensor_of(name)
    (low, unit), (high, _), (value, _) = (
        to_datasheet('N', sensor, noise.value * ratio) for ratio in (change.low, change.high, 1.0)
    )
    return [
        finding('level_changes', (name,), which=which, low=low, high=high, value=value, unit=unit)
    ]


def _widened(model: NoiseModel, axis: str, term: str, scatter: float) -> NoiseModel:
    """Return the model with the interval of a term of one axis widened by a relative scatter."""
    fit = model.axes[axis]
    noise = fit.noise[term]
    value, limit = noise.value, noise.upper95
    if not scatter:
        return model
    if noise.ci95 is not None and value and noise.ci95[0] <= value <= noise.ci95[1]:
        low, high = (
            value * math.exp(sign * math.hypot(math.log(end / value), Z_95 * scatter))
            if end > 0.0
            else 0.0
            for sign, end in zip((-1.0, 1.0), noise.ci95)
        )
        noise = replace(noise, ci95=(low, high))
    if limit is not None:
        noise = replace(noise, upper95=limit * math.exp(Z_95 * scatter))
    axes = {**model.axes, axis: replace(fit, noise={**fit.noise, term: noise})}
    return replace(model, axes=axes)


def _sensors(sums: AllanSums) -> list[list[int]]:
    """Return the positions of the axes of each sensor."""
    names = [sensor_of(axis) for axis in sums.axes]
    return [[i for i, name in enumerate(names) if name == s] for s in SENSORS if s in names]


def _edge(sums: AllanSums, age: int) -> int | None:
    """Return the first age at or after the given one at which the sums can be divided."""
    return next((a for a in sums.history.ages if a >= age), None)


def _rest(sums: AllanSums, age: int) -> AllanSums | None:
    """Return the sums from an age on; None if too few samples remain."""
    edge = _edge(sums, age)
    if edge is None:
        return None
    try:
        rest = settled_sums(sums, edge)
    except AllanError:
        return None
    return rest if rest.samples >= LEAST_REST * sums.samples else None


def _unsettled(sums: AllanSums, part: EarlyPart) -> Finding:
    """Return the finding of a warm-up after which too little data remains for a fit."""
    tau0 = sums.tau0 or 0.0
    duration = part.age * tau0
    now = max((r.length for r in sums.history.recordings), default=0)
    remaining = duration - now * tau0
    axes = tuple(sums.axes[i] for i in part.axes)
    return finding(
        'warm_up',
        axes,
        what=_what(sums, [part]),
        when=f'in about {duration_text(remaining)}'
        if remaining > 0.0
        else f'after {duration_text(duration)}',
        how_long=duration_text(2.0 * duration),
    )


def _what(sums: AllanSums, parts: list[EarlyPart]) -> str:
    """Return the description of the early part."""
    warm_ups = [part for part in parts if part.kind == 'warm_up']
    if not warm_ups:
        return 'larger drift'
    strongest = max(warm_ups, key=lambda part: part.excess)
    axis = max(strongest.axes, key=lambda i: abs(strongest.amplitudes[i]))
    name = sums.axes[axis]
    value, unit = to_datasheet('B', sensor_of(name), float(abs(strongest.amplitudes[axis])))
    return f'warm-up by up to {value:.3g} {unit}'


def _changes(complete: NoiseModel, settled: NoiseModel) -> Iterator[_Change]:
    """Yield every coefficient of all data with that of the settled part."""
    for axis, fit in complete.axes.items():
        for term in TERMS:
            yield _Change(axis, term, fit.noise[term], settled.axes[axis].noise[term])


def _range(c: Coefficient) -> tuple[float, float]:
    if c.status == 'estimated' and c.ci95 is not None:
        return c.ci95
    return 0.0, np.inf if c.upper95 is None else c.upper95


def _text(axis: str, term: str, c: Coefficient) -> tuple[str, str]:
    limit = c.status != 'estimated'
    size = c.upper95 if limit else c.value
    value, unit = to_datasheet(term, sensor_of(axis), size or 0.0)
    return f'{"< " if limit else ""}{value:.3g}', unit
