# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fit of recordings whose noise changes with time: `fit_stationary`.

If the level of the white noise has changed, only the data after the change are fitted. After a
warm-up, only the data after it are fitted. Findings report steps of the bias and variations of the
level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..allan.periods import BlockMeans
from ..allan.sums import AllanSums, part
from ..findings import Finding, Quantity, duration_text, finding
from ..imu import SENSORS, sensor_of
from . import NoiseModel, fit_noise
from .effects import LEAST_MEANS, BiasSteps, WarmUp, bias_steps, warm_up
from .levels import Levels, levels, present_part
from .method import daily_cycle
from .model import Z_95
from .statistics import statistics

LEAST_REMAINING = 0.25
"""Smallest fraction of the samples that must remain after the early part."""

LEAST_SEGMENT = 0.3
"""Shortest first segment, relative to its recording, in which a warm-up is searched for."""

TESTED_RECORDINGS = 4
"""Number of the longest recordings that are tested for a warm-up."""

LEAST_TESTED_S = 120.0
"""Shortest segment in s in which a warm-up and steps are searched for. In shorter ones, vibration
rather than drift changes the means."""

STEPS_RATIO = 0.5
"""Steps are reported if the variance of the random walk with steps in the model is below this
fraction of that without them. A drift that is no random walk often looks like a few steps, which
explain less of it."""

SHAKY_RATIO = 1.3
"""Ratio of the highest to the lowest N above which steps are not searched for."""

LEVEL_RATIO, LARGE_RATIO = 1.02, 1.1
"""Least ratio of the highest to the lowest N of the periods that is reported; the second if the
scatter may come from impulsive noise."""


def fit_stationary(
    sums: AllanSums, method: str = 'likelihood', settle: bool = True
) -> tuple[AllanSums, NoiseModel]:
    """Fit the data at the present level of the white noise, after a warm-up.

    Parameters
    ----------
    sums : AllanSums
    method : str
        One of `METHODS`; 'paper' always fits all data.
    settle : bool
        Whether data may be excluded; findings report a warm-up and changes of the level anyway.

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
    every = levels(sums)
    present = present_part(sums, every) if settle else None
    data = sums if present is None else _from_period(sums, present[0])
    warm_ups = _warm_ups(data)
    used, found = _without_warm_up(data, settle, warm_ups)
    model = fit_noise(used, method)
    if present is not None:
        at, changed = present
        since = data.samples * sums.tau0
        found += [_level_finding(model, sums.axes[i], every, i, at, since) for i in changed]
    if used is not sums:
        every = levels(used)
    # a larger level of the white noise in a part would look like steps
    shaky = {i for i in range(len(sums.axes)) if np.divide(*every.extremes(i)) < 1.0 / SHAKY_RATIO}
    shaky |= {a for w in warm_ups for a in w.axes} if used is data else set()
    found += _steps(used, shaky)
    return used, _with_variation(used, every, replace(model, findings=(*found, *model.findings)))


def _from_period(sums: AllanSums, at: int) -> AllanSums:
    """Return the sums without the first ``at`` periods, counted over all recordings."""
    first = []
    for recording in sums.recordings:
        first.append(min(at, len(recording.periods)))
        at -= first[-1]
    return _parts(sums, first)


def _parts(sums: AllanSums, first: Sequence[int]) -> AllanSums:
    """Return the sums of each recording from the period ``first`` of it on."""
    if not any(first):
        return sums
    parts = [
        part(replace(sums, recordings=(r,)), first=k)
        for r, k in zip(sums.recordings, first)
        if k < len(r.periods)
    ]
    total = parts[0]
    for more in parts[1:]:
        total = total + more
    return total


# --- warm-up --------------------------------------------------------------------------------------


def _axes_by_sensor(sums: AllanSums) -> list[list[int]]:
    """Return the indices of the axes of each sensor (gyroscope, accelerometer)."""
    names = [sensor_of(axis) for axis in sums.axes]
    return [[i for i, name in enumerate(names) if name == s] for s in SENSORS if s in names]


def _warm_ups(sums: AllanSums) -> list[WarmUp]:
    """Return the warm-ups of the sensors in the longest recordings."""
    known, tau0 = statistics(sums), sums.tau0 or 1.0
    order = sorted(range(len(sums.recordings)), key=lambda i: -sums.recordings[i].samples)
    found = []
    for i in order[:TESTED_RECORDINGS]:
        recording = sums.recordings[i]
        first = recording.means[0] if recording.means else None
        if (
            first is None
            or len(first.values) < LEAST_MEANS
            or first.samples < LEAST_SEGMENT * recording.samples
            or first.samples * tau0 < LEAST_TESTED_S
        ):
            continue
        more = daily_cycle(first.samples, tau0)
        each = [warm_up(known, i, first, axes, more) for axes in _axes_by_sensor(sums)]
        found += [w for w in each if w is not None]
    return found


def _first_periods(sums: AllanSums, ages: list[tuple[int, float]]) -> tuple[list[int], int]:
    """Return the first period of each recording after some ages, and the samples that remain."""
    first = [0] * len(sums.recordings)
    for i, age in ages:
        periods = sums.recordings[i].periods
        k = next((k for k, p in enumerate(periods) if p.begin >= age), len(periods))
        first[i] = max(first[i], k)
    remaining = (p.samples for r, k in zip(sums.recordings, first) for p in r.periods[k:])
    return first, sum(remaining)


def _without_warm_up(
    sums: AllanSums, settle: bool, warm_ups: list[WarmUp]
) -> tuple[AllanSums, list[Finding]]:
    """Exclude warm-ups; return sums and findings.

    With ``settle`` False, or if too little would remain, they are only reported.
    """
    if not warm_ups:
        return sums, []
    tau0 = sums.tau0 or 1.0
    first, remaining = _first_periods(sums, [(w.recording, w.age) for w in warm_ups])
    if remaining < LEAST_REMAINING * sums.samples:
        first, remaining = _first_periods(sums, [(w.recording, w.fair_age) for w in warm_ups])
    axes = tuple(a for i, a in enumerate(sums.axes) if any(i in w.axes for w in warm_ups))
    axis, largest = max(
        ((a, s) for w in warm_ups for a, s in zip(w.axes, w.sizes)), key=lambda each: abs(each[1])
    )
    size = Quantity(abs(largest), sensor_of(sums.axes[axis]), 'signal')
    if settle and remaining >= LEAST_REMAINING * sums.samples:
        if not any(first):
            return sums, []
        used = _parts(sums, first)
        early = max(r.periods[k].begin for r, k in zip(sums.recordings, first) if r.periods[k:])
        return used, [finding('settled_part', axes, early=early * tau0, size=size)]
    last = max(warm_ups, key=lambda w: w.age)
    rest = (last.age - sums.recordings[last.recording].samples) * tau0
    after = f'after {duration_text(last.age * tau0)}'
    settles = f'in about {duration_text(rest)}' if rest > 0.0 else after
    long = 2.0 * last.age * tau0
    return sums, [finding('warm_up', axes, size=size, settles=settles, how_long=long)]


# --- steps of the bias ----------------------------------------------------------------------------


def _steps(sums: AllanSums, without: set[int]) -> list[Finding]:
    """Return the findings about steps in the longest segment, except of some axes."""
    tau0 = sums.tau0 or 1.0
    every = [m for r in sums.recordings for m in r.means]
    longest = max(every, key=lambda m: m.samples, default=None)
    if (
        longest is None
        or len(longest.values) < LEAST_MEANS
        or longest.samples * tau0 < LEAST_TESTED_S
    ):
        return []
    known = statistics(sums)
    found = []
    for i, axis in enumerate(sums.axes):
        if i in without:
            continue
        steps = bias_steps(known, longest, i, tau0, daily_cycle(longest.samples, tau0))
        if steps is not None and steps.walk_after < STEPS_RATIO * steps.walk_before:
            found.append(_steps_finding(axis, steps, longest, tau0))
    return found


def _steps_finding(axis: str, steps: BiasSteps, means: BlockMeans, tau0: float) -> Finding:
    """Return the finding about the steps of an axis; times count from the start of the segment."""
    times = [duration_text((ns - means.start_ns) * 1e-9) for ns in steps.ns]
    size = max(abs(s) for s in steps.sizes)
    return finding(
        'bias_steps',
        (axis,),
        size=size,
        share=1.0 - math.sqrt(steps.walk_after / steps.walk_before),
        at=', '.join(times),
    )


# --- level of the white noise ---------------------------------------------------------------------


def _level_finding(
    model: NoiseModel, axis: str, every: Levels, i: int, at: int, since: float
) -> Finding:
    """Return the finding that the level of an axis has changed at a period."""
    n = model.axes[axis].noise['N'].value or 0.0
    ratio = math.sqrt(every.usual(i, at) / every.mean(i, slice(at, None)))
    return finding('level_changed', (axis,), before=n * ratio, value=n, since=since)


def _with_variation(sums: AllanSums, every: Levels, model: NoiseModel) -> NoiseModel:
    """Return the model with the intervals of N widened where the level varies, and findings."""
    which = 'between recordings' if len(sums.recordings) > 1 else 'within the recording'
    found = []
    for i, axis in enumerate(sums.axes):
        scatter = every.scatter(i)
        if not scatter:
            continue
        model = _widened(model, axis, scatter)
        low, high = every.extremes(i)
        n = model.axes[axis].noise['N']
        least = LEVEL_RATIO if every.varies(i, every.spread(i)) else LARGE_RATIO
        if n.status == 'estimated' and n.value and high > least * low:
            numbers = {'low': n.value * low, 'high': n.value * high, 'value': n.value}
            found.append(finding('level_changes', (axis,), which=which, **numbers))
    return replace(model, findings=(*found, *model.findings))


def _widened(model: NoiseModel, axis: str, scatter: float) -> NoiseModel:
    """Widen the interval of N of one axis by a relative standard deviation."""
    fit = model.axes[axis]
    n = fit.noise['N']
    if n.ci95 is not None and n.value and n.ci95[0] <= n.value <= n.ci95[1]:
        low, high = (
            n.value * math.exp(sign * math.hypot(math.log(end / n.value), Z_95 * scatter))
            if end > 0.0
            else 0.0
            for sign, end in zip((-1.0, 1.0), n.ci95)
        )
        n = replace(n, ci95=(low, high))
    if n.upper95 is not None:
        n = replace(n, upper95=n.upper95 * math.exp(Z_95 * scatter))
    return replace(model, axes={**model.axes, axis: replace(fit, noise={**fit.noise, 'N': n})})
