# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tests for a warm-up and for steps of the bias: known shapes in the block means of a segment.

The block means are described by white noise, bias instability and random walk. An effect, such as
exp(-t/T), shifts the expected means. Its size is estimated by generalized least squares, then the
noise is fitted again to what remains. The gain is the decrease of -2 log likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..allan.periods import BlockMeans
from ..allan.sums import AllanSums
from ..findings import Finding, finding
from ..imu import SENSORS, sensor_of
from ..noise import unit_avar
from ..number_text import duration_text
from .likelihood import TERMS, AxisData, Columns, Fit, LowBand
from .method import daily_cycle
from .statistics import (
    Component,
    Floats,
    Group,
    Statistics,
    contrasts,
    lower_edge,
    statistics,
)

GAIN_WARM_UP = 16.5
"""Least gain in -2 log L of a warm-up, summed over the axes of a sensor: 1 % per sensor. The
99 % quantiles without a warm-up are 10 to 13, depending on the noise (`bench_stationarity.py`)."""

GAIN_STEPS, GAIN_MORE_STEPS = 20.0, 10.0
"""Least gain in -2 log L of a step of the bias, and of each further one. The 99 % quantiles without
steps are 11 to 22, depending on the noise (`bench_stationarity.py`)."""

MOST_CONTRASTS = 96
"""Largest number of contrasts of the block means; octave spectra describe higher frequencies."""

NEAR_OCTAVES = 4
"""Number of octaves above the contrasts that are used."""

WARM_UP_TIMES = 0.5 ** np.arange(8)
"""Time constants of warm-ups, relative to the length of the segment."""

MOST_STEPS = 5

LEAST_MEANS = 24
"""Fewest block means of a segment that is tested."""

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

PROMISING_SCORE = 5.0, 8.0
"""Least score of a warm-up (per sensor) and of a step for which the noise is fitted again. Scores
use the noise that was fitted without the effect, which is too large if there is one."""


@dataclass(frozen=True, eq=False)
class Segment:
    """Contrasts of the block means of one segment, and the noise of one axis without effects."""

    data: AxisData
    columns: Columns
    components: tuple[Component, ...]
    z: Floats  # (contrasts,) scaled, without the line
    fit: Fit

    def whitened(self, x: Floats, fit: Fit) -> tuple[Floats, Floats]:
        """Return effects and contrasts with unit covariance under a fit."""
        root = np.linalg.cholesky(np.tensordot(fit.p, self.columns.low[0], 1))
        both = np.linalg.solve(root, np.column_stack([x, self.z]))
        return both[:, :-1], both[:, -1]

    def scores(self, x: Floats, base: Floats) -> Floats:
        """Return the score of each column of ``x``, given effects ``base`` in the model."""
        white, z = self.whitened(np.column_stack([base, x]), self.fit)
        known, white = white[:, : base.shape[1]], white[:, base.shape[1] :]
        if known.shape[1]:
            q, _ = np.linalg.qr(known)
            white, z = white - q @ (q.T @ white), z - q @ (q.T @ z)
        size = np.sum(white**2, axis=0)
        return np.where(
            size > 1e-9 * size.max(), (white.T @ z) ** 2 / np.maximum(size, 1e-300), 0.0
        )

    def with_effects(self, x: Floats) -> tuple[Segment, Floats]:
        """Return the segment with the noise fitted beside effects, and the sizes of these."""
        fit, beta = self.fit, np.zeros(x.shape[1], float)
        for _ in range(3):
            white, z = self.whitened(x, fit)
            beta = np.linalg.lstsq(white, z, rcond=None)[0]
            rest = self.z - x @ beta
            low = [LowBand(1, self.data.low[0].line, np.outer(rest, rest))]
            data = replace(self.data, low=low)
            start = np.maximum(fit.p, 1e-6 * fit.p.max())
            before = fit.value
            fit = data.solve(self.components, self.columns, start, tolerance=1e-2)
            if abs(before - fit.value) < 0.1:
                break
        return replace(self, fit=fit), beta * math.sqrt(self.data.scale)

    def deviation(self, m: float) -> float:
        """Return the Allan deviation of the terms at the averaging factor m, in SI."""
        avar = sum(p * float(unit_avar(max(m, 1.0), *c)) for p, c in zip(self.fit.p, TERMS))
        return math.sqrt(avar * self.data.scale)


@dataclass(frozen=True)
class WarmUp:
    """A transient exp(-t/T) at the start of a recording."""

    recording: int
    axes: tuple[int, ...]  # axes of the sensor that take part
    sizes: tuple[float, ...]  # of each, at the start of the segment
    age: float  # in samples, from which on it is below half of the Allan deviation at T
    excess: float  # gain above the threshold


@dataclass(frozen=True)
class BiasSteps:
    """Steps of the bias of one axis."""

    ns: tuple[int, ...]  # stamps of the steps
    sizes: tuple[float, ...]
    walk_before: float  # variance of the random walk per sample, without the steps in the model
    walk_after: float
    excess: float


def segment_statistics(known: Statistics, means: BlockMeans) -> tuple[Statistics, int]:
    """Return the statistics with contrasts of one segment only, and the lowest used octave."""
    points, step = len(means.values), means.step
    octaves = known.octaves
    fewer = [o for o in range(octaves + 1) if 2.0 * points * step * lower_edge(o) <= MOST_CONTRASTS]
    cut = min(fewer, default=octaves)
    high = max(min(int(2.0 * points * step * lower_edge(cut)), MOST_CONTRASTS, points - 2), 2)
    z = means.values.T @ contrasts(points, high)
    group = Group(points, high, 1, z, z[:, :, None] * z[:, None, :])
    on = known.octave < cut
    return replace(
        known,
        octave=known.octave[on],
        f=known.f[on],
        power=known.power[on],
        dof=known.dof[on],
        dof_alone=known.dof_alone[on],
        step=step,
        groups=(group,),
    ), max(cut - NEAR_OCTAVES, 0)


def segment_of(
    known: Statistics, lowest: int, axis: int, daily: Component | None = None
) -> Segment | None:
    """Return the segment of `segment_statistics` for one axis; None if the axis has no noise."""
    z = known.groups[0].sums[axis]
    data = AxisData.of(known, axis)
    data = replace(data, used=known.octave >= lowest)
    if not np.any(np.abs(z[1:]) > 0.0) or np.any(data.power[data.used] <= 0.0):
        return None
    components = (*TERMS, daily) if daily else TERMS
    columns = data.columns(components)
    fit = data.solve(components, columns, tolerance=1e-2)
    if not math.isfinite(fit.value):
        return None
    return Segment(data, columns, components, z[1:] / math.sqrt(data.scale), fit)


def warm_ups(sums: AllanSums) -> list[WarmUp]:
    """Return the warm-ups of the sensors in the longest recordings."""
    known, tau0 = statistics(sums), sums.tau0 or 1.0
    names = [sensor_of(axis) for axis in sums.axes]
    sensors = [[i for i, name in enumerate(names) if name == s] for s in SENSORS if s in names]
    order = sorted(range(len(sums.recordings)), key=lambda i: -sums.recordings[i].samples)
    found = []
    for i in order[:TESTED_RECORDINGS]:
        recording = sums.recordings[i]
        first = recording.means[0] if recording.means else None
        if (
            first is not None
            and _is_tested(first, tau0)
            and first.samples >= LEAST_SEGMENT * recording.samples
        ):
            daily = daily_cycle(first.samples, tau0)
            each = [warm_up(known, i, first, axes, daily) for axes in sensors]
            found += [w for w in each if w is not None]
    return found


def _is_tested(means: BlockMeans, tau0: float) -> bool:
    """Return whether a segment is long enough for a warm-up and steps."""
    return len(means.values) >= LEAST_MEANS and means.samples * tau0 >= LEAST_TESTED_S


def warm_up(
    known: Statistics,
    recording: int,
    means: BlockMeans,
    axes: Sequence[int],
    daily: Component | None = None,
) -> WarmUp | None:
    """Return the warm-up of the axes of one sensor in the first segment of a recording, or None."""
    local, lowest = segment_statistics(known, means)
    all_axes = {a: segment_of(local, lowest, a, daily) for a in axes}
    segments = {a: s for a, s in all_axes.items() if s is not None}
    if not segments:
        return None
    points, high = local.groups[0].points, local.groups[0].high
    times = np.asarray(WARM_UP_TIMES * points * means.step, np.float64)
    x = _decays(times, means) @ np.eye(points)
    x = (x @ contrasts(points, high)[:, 1:]).T
    none = x[:, :0]
    scores = np.sum([s.scores(x, none) for s in segments.values()], axis=0)
    if scores.max() < PROMISING_SCORE[0]:
        return None
    best: tuple[float, int, dict[int, tuple[float, float, Segment]]] | None = None
    for k in np.flatnonzero(scores > 0.4 * scores.max()).tolist():
        each = {}
        for a, segment in segments.items():
            fitted, beta = segment.with_effects(x[:, k : k + 1])
            each[a] = max(segment.fit.value - fitted.fit.value, 0.0), float(beta[0]), fitted
        total = sum(g for g, _, _ in each.values())
        if best is None or total > best[0]:
            best = total, k, each
    assert best is not None
    gain, k, each = best
    excess = gain - GAIN_WARM_UP
    if excess < 0.0:
        return None
    time = float(times[k])
    taking = [a for a, (g, _, _) in each.items() if g > GAIN_WARM_UP / len(each) / 2.0]
    age = 0.0
    for a in taking:
        _, size, fitted = each[a]
        ratio = abs(size) / fitted.deviation(time)
        age = max(age, time * math.log(max(2.0 * ratio, 1.0)))
    sizes = tuple(each[a][1] for a in taking)
    return WarmUp(recording, tuple(taking), sizes, means.age + age, excess)


def _decays(times: Floats, means: BlockMeans) -> Floats:
    """Return the block means of exp(-t/T) for each T, (times, means)."""
    step, begin = means.step, means.step * np.arange(len(means.values))
    return np.asarray([-np.expm1(-step / t) * t / step * np.exp(-begin / t) for t in times])


def bias_steps(
    known: Statistics,
    means: BlockMeans,
    axis: int,
    tau0: float,
    daily: Component | None = None,
) -> BiasSteps | None:
    """Return the steps of the bias of one axis in a segment, or None."""
    local, lowest = segment_statistics(known, means)
    segment = segment_of(local, lowest, axis, daily)
    if segment is None:
        return None
    points, high = local.groups[0].points, local.groups[0].high
    steps = np.tril(np.ones((points, points)))[:, 1:]  # column i: a step before mean i + 1
    x = contrasts(points, high)[:, 1:].T @ steps
    at: list[int] = []
    now, beta, excess = segment, np.zeros(0), -GAIN_STEPS
    best: tuple[float, list[int], Floats, Segment] | None = None
    while len(at) < MOST_STEPS:
        scores = now.scores(x, x[:, at])
        if scores.max() < PROMISING_SCORE[1]:
            break
        at = [*at, int(scores.argmax())]
        now, beta = segment.with_effects(x[:, at])
        excess = segment.fit.value - now.fit.value - GAIN_STEPS - GAIN_MORE_STEPS * (len(at) - 1)
        if excess > 0.0 and (best is None or excess > best[0]):
            best = excess, at, beta, now
    if best is None:
        return None
    excess, at, beta, now = best
    order = np.argsort(at)
    ns = [means.start_ns + round((at[i] + 1) * means.step * tau0 * 1e9) for i in order]
    before, after = (float(s.fit.p[3]) * s.data.scale for s in (segment, now))
    return BiasSteps(tuple(ns), tuple(float(beta[i]) for i in order), before, after, excess)


def step_findings(sums: AllanSums, without: set[int]) -> list[Finding]:
    """Return the findings about steps in the longest segment, except of some axes.

    Times are counted from the start of the recording, also if its first part is excluded.
    """
    tau0 = sums.tau0 or 1.0
    every = [m for r in sums.recordings for m in r.means]
    longest = max(every, key=lambda m: m.samples, default=None)
    if longest is None or not _is_tested(longest, tau0):
        return []
    known = statistics(sums)
    found = []
    for i, axis in enumerate(sums.axes):
        if i in without:
            continue
        steps = bias_steps(known, longest, i, tau0, daily_cycle(longest.samples, tau0))
        if steps is not None and steps.walk_after < STEPS_RATIO * steps.walk_before:
            share = 1.0 - math.sqrt(steps.walk_after / steps.walk_before)
            size = max(abs(s) for s in steps.sizes)
            begin = longest.age * tau0
            times = [duration_text(begin + (ns - longest.start_ns) * 1e-9) for ns in steps.ns]
            at = ', '.join(times)
            found.append(finding('bias_steps', (axis,), size=size, share=share, at=at))
    return found
