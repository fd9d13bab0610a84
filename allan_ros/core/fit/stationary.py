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

from ..allan.sums import AllanSums, part
from ..estimate import Z_95
from ..findings import Finding, finding, quantity
from ..imu import sensor_of
from ..number_text import duration_text
from .bias_changes import WarmUp, step_findings, warm_ups
from .maximum_likelihood import fit_likelihood
from .methods import fit_noise
from .result import NoiseModel
from .statistics import statistics
from .white_noise_levels import WhiteNoiseLevels, present_part, white_noise_levels

LEAST_REMAINING = 0.25
"""Smallest fraction of the samples that must remain after a warm-up."""

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
    if method != 'likelihood' or not sums.tau0:
        return sums, fit_noise(sums, method)
    levels = white_noise_levels(sums)
    present = present_part(sums, levels) if settle else None
    data = sums if present is None else _from_period(sums, present[0])
    known = statistics(data)
    warming = warm_ups(data, known)
    used, found = _without_warm_up(data, settle, warming)
    known = known if used is data else statistics(used)
    model = fit_likelihood(used, known)
    if present is not None:
        at, changed = present
        since = data.samples * sums.tau0
        found += [_level_finding(model, sums.axes[i], levels, i, at, since) for i in changed]
    if used is not sums:
        levels = white_noise_levels(used)
    # a larger level of the white noise in a part would look like steps
    ratios = (np.divide(*levels.extremes(i)) for i in range(len(sums.axes)))
    shaky = {i for i, ratio in enumerate(ratios) if ratio < 1.0 / SHAKY_RATIO}
    shaky |= {a for w in warming for a in w.axes} if used is data else set()
    found += step_findings(used, known, shaky)
    return used, _with_variation(used, levels, replace(model, findings=(*found, *model.findings)))


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
    sums: AllanSums, settle: bool, warming: list[WarmUp]
) -> tuple[AllanSums, list[Finding]]:
    """Exclude warm-ups; return sums and findings.

    With ``settle`` False, or if too little would remain, they are only reported.
    """
    if not warming:
        return sums, []
    tau0 = sums.tau0 or 1.0
    first, remaining = _first_periods(sums, [(w.recording, w.age) for w in warming])
    axes = tuple(a for i, a in enumerate(sums.axes) if any(i in w.axes for w in warming))
    axis, largest = max(
        ((a, s) for w in warming for a, s in zip(w.axes, w.sizes)), key=lambda each: abs(each[1])
    )
    size = quantity(abs(largest), sensor_of(sums.axes[axis]), 'signal')
    if settle and remaining >= LEAST_REMAINING * sums.samples:
        if not any(first):
            return sums, []
        used = _parts(sums, first)
        early = max(r.periods[k].begin for r, k in zip(sums.recordings, first) if r.periods[k:])
        return used, [finding('settled_part', axes, early=early * tau0, size=size)]
    last = max(warming, key=lambda w: w.age)
    rest = (last.age - sums.recordings[last.recording].samples) * tau0
    after = f'after {duration_text(last.age * tau0)}'
    settles = f'in about {duration_text(rest)}' if rest > 0.0 else after
    long = 2.0 * last.age * tau0
    name = 'not_settled' if rest > 0.0 else 'warm_up'
    return sums, [finding(name, axes, size=size, settles=settles, how_long=long)]


# --- findings about the level ---------------------------------------------------------------------


def _level_finding(
    model: NoiseModel, axis: str, levels: WhiteNoiseLevels, i: int, at: int, since: float
) -> Finding:
    """Return the finding that the level of an axis has changed at a period."""
    n = model.axes[axis].noise['N'].value or 0.0
    ratio = math.sqrt(levels.usual(i, at) / levels.mean(i, slice(at, None)))
    return finding('level_changed', (axis,), before=n * ratio, value=n, since=since)


def _with_variation(sums: AllanSums, levels: WhiteNoiseLevels, model: NoiseModel) -> NoiseModel:
    """Return the model with the intervals of N widened where the level varies, and findings."""
    which = 'between recordings' if len(sums.recordings) > 1 else 'within the recording'
    found = []
    for i, axis in enumerate(sums.axes):
        scatter = levels.scatter(i)
        if not scatter:
            continue
        model = _widened(model, axis, scatter)
        low, high = levels.extremes(i)
        n = model.axes[axis].noise['N']
        least = LEVEL_RATIO if levels.varies(i, levels.spread(i)) else LARGE_RATIO
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
        n = replace(n, recording_ci95=(low, high))
    if n.upper95 is not None:
        n = replace(n, upper95=n.upper95 * math.exp(Z_95 * scatter))
    return replace(model, axes={**model.axes, axis: replace(fit, noise={**fit.noise, 'N': n})})
