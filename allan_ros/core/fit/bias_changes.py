# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of the bias with time that are no noise, such as steps.

An effect is a change of the bias whose form is known and whose size is not, such as a step or
exp(-t/T).

Method
------
The size of an effect is estimated from the block means of a segment by generalized least squares.
Then the noise is fitted again to the data minus the effect. The gain of an effect is the decrease
of -2 log likelihood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..allan.periods import BlockMeans
from ..allan.sums import AllanSums
from ..findings import Finding, finding
from ..noise import RANDOM_TERMS, Process
from ..noise.derived import avar
from ..noise.processes.sinusoid import daily_cycle
from ..number_text import duration_text
from .likelihood import AxisData, Columns, Fit, LowBand
from .result import K
from .statistics import Floats, Group, Size, Statistics, contrasts, lower_edge

GAIN_STEPS, GAIN_MORE_STEPS = 20.0, 10.0
"""Least gain in -2 log L of the first step of the bias, and of each further step. In simulations
without steps, the 99 % quantiles of the gain are 11 to 22, depending on the noise
(`bench/bench_stationarity.py`)."""

MOST_CONTRASTS = 96
"""Largest number of contrasts of the block means; octave spectra describe higher frequencies."""

NEAR_OCTAVES = 4
"""Number of octaves above the frequencies of the contrasts whose spectra are used."""

MOST_STEPS = 5
"""Largest number of steps of an axis."""

LEAST_MEANS = 24
"""Fewest block means of a segment in which a settling and steps are searched for."""

LEAST_TESTED_S = 120.0
"""Shortest segment in s in which a settling and steps are searched for. In shorter ones, vibration
rather than drift changes the means."""

STEPS_RATIO = 0.5
"""Largest ratio of the variances of the random walk with and without steps in the model for which
steps are reported. A drift that is no random walk often looks like a few steps, but such steps
explain less of the random walk."""

PROMISING_SCORE = 8.0
"""Least score of a step for which the noise is fitted again. It is below the least gain, because a
score uses the noise of a fit without the step, which is too large if there is a step."""


@dataclass(frozen=True, eq=False)
class Segment:
    """Block means of one segment, and the octave spectra of all data at higher frequencies.

    Attributes
    ----------
    means : BlockMeans
    tau0 : float
        Sample period in s.
    known : Statistics
        Spectra of all data, and contrasts of this segment only.
    lowest : int
        Lowest octave that is used.
    components : tuple of Process
        Noise of the segment: the terms, and a daily cycle in a long one.
    """

    means: BlockMeans
    tau0: float
    known: Statistics
    lowest: int
    components: tuple[Process, ...]

    @classmethod
    def of(cls, known: Statistics, means: BlockMeans | None, tau0: float) -> Segment | None:
        """Return a segment from the statistics of all data and the block means of the segment.

        ``tau0`` is the sample period in s. The result is None without means, or if the segment is
        too short for a test.
        """
        if means is None or len(means.values) < LEAST_MEANS:
            return None
        if means.samples * tau0 < LEAST_TESTED_S:
            return None
        points, step, octaves = len(means.values), means.step, known.octaves
        edges = ((o, 2.0 * points * step * lower_edge(o)) for o in range(octaves + 1))
        cut = min((o for o, most in edges if most <= MOST_CONTRASTS), default=octaves)
        most = min(int(2.0 * points * step * lower_edge(cut)), MOST_CONTRASTS, points - 2)
        high = max(most, 2)
        size = Size(points, high)
        z = means.values.T @ contrasts(size)
        group = Group(size, 1, z, z[:, :, None] * z[:, None, :])
        used = known.octave < cut
        own = replace(
            known,
            octave=known.octave[used],
            f=known.f[used],
            power=known.power[used],
            settling=known.settling[used],
            dof=known.dof[used],
            dof_alone=known.dof_alone[used],
            step=step,
            groups=(group,),
        )
        daily = daily_cycle(means.samples, tau0)
        components = (*RANDOM_TERMS, daily) if daily else RANDOM_TERMS
        return cls(means, tau0, own, max(cut - NEAR_OCTAVES, 0), components)

    def contrasts_of(self, shapes: Floats) -> Floats:
        """Return the contrasts, (contrasts, n), of n series of means, (means, n)."""
        group = self.known.groups[0]
        return np.asarray(contrasts(group.size)[:, 1:].T @ shapes)

    def axis(self, axis: int) -> AxisSegment | None:
        """Return one axis of the segment; None if it has no noise."""
        z = self.known.groups[0].sums[axis]
        data = AxisData.of(self.known, axis)
        data = replace(data, used=self.known.octave >= self.lowest)
        if not np.any(np.abs(z[1:]) > 0.0) or np.any(data.power[data.used] <= 0.0):
            return None
        columns = data.columns(self.components)
        fit = data.solve(self.components, columns, tolerance=1e-2)
        if not math.isfinite(fit.value):
            return None
        return AxisSegment(data, columns, z[1:] / math.sqrt(data.scale), fit)


@dataclass(frozen=True, eq=False)
class AxisSegment:
    """One axis of a segment, and the fit of its noise without effects."""

    data: AxisData
    columns: Columns
    z: Floats  # (contrasts,) contrasts of the block means, without the line, in units of the fit
    fit: Fit

    def _whitened(self, effects: Floats, fit: Fit) -> tuple[Floats, Floats]:
        """Return effects and contrasts after whitening with the noise of a fit."""
        root = np.linalg.cholesky(np.tensordot(fit.p, self.columns.low[0], 1))
        both = np.linalg.solve(root, np.column_stack([effects, self.z]))
        return both[:, :-1], both[:, -1]

    def scores(self, effects: Floats, beside: Floats, fit: Fit) -> Floats:
        """Return the score of each column of ``effects``, (effects,).

        The score is the square of the estimated size over its variance. The model of the noise is
        ``fit``, and the effects ``beside`` are also in the model. Effects are columns of contrasts.
        """
        white, z = self._whitened(np.column_stack([beside, effects]), fit)
        known, white = white[:, : beside.shape[1]], white[:, beside.shape[1] :]
        if known.shape[1]:
            q, _ = np.linalg.qr(known)
            white, z = white - q @ (q.T @ white), z - q @ (q.T @ z)
        size = np.sum(white**2, axis=0)
        return np.where(
            size > 1e-9 * size.max(), (white.T @ z) ** 2 / np.maximum(size, 1e-300), 0.0
        )

    def with_effects(self, effects: Floats) -> FittedEffects:
        """Return the sizes of effects, and the fit of the noise to the data minus the effects.

        ``effects`` are the contrasts of effects of size 1, (contrasts, effects). The sizes,
        (effects,), are in SI.
        """
        fit, sizes = self.fit, np.zeros(effects.shape[1], float)
        for _ in range(3):
            white, z = self._whitened(effects, fit)
            sizes = np.linalg.lstsq(white, z, rcond=None)[0]
            rest = self.z - effects @ sizes
            low = [LowBand(1, self.data.low[0].line, np.outer(rest, rest))]
            data = replace(self.data, low=low)
            start = np.maximum(fit.p, 1e-6 * fit.p.max())
            before = fit.value
            fit = data.solve(fit.components, self.columns, start, tolerance=1e-2)
            if abs(before - fit.value) < 0.1:
                break
        scale = math.sqrt(self.data.scale)
        return FittedEffects(sizes * scale, fit, self.fit.value - fit.value)

    def deviation(self, fit: Fit, m: float) -> float:
        """Return the Allan deviation of the terms of a fit at the averaging factor m, in SI."""
        variance = sum(p * float(avar(c, max(m, 1.0))) for p, c in zip(fit.p, RANDOM_TERMS))
        return math.sqrt(variance * self.data.scale)

    def walk(self, fit: Fit) -> float:
        """Return the variance of the random walk of a fit per sample, in SI."""
        return float(fit.p[K]) * self.data.scale


class FittedEffects(NamedTuple):
    """Sizes of effects, and the fit of the noise to the data minus these effects."""

    sizes: Floats  # (effects,) in SI
    fit: Fit
    gain: float  # decrease of -2 log L by all effects together


# --- steps ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class BiasSteps:
    """Steps of the bias of one axis."""

    ns: tuple[int, ...]  # stamps of the steps
    sizes: tuple[float, ...]  # in SI
    walk_before: float  # variance of the random walk per sample, without steps in the model
    walk_after: float  # variance of the random walk per sample, with the steps in the model
    excess: float  # gain minus the least gain of this number of steps


class _Steps(NamedTuple):
    """Steps between block means."""

    at: list[int]  # index of the last mean before each step, in the order in which they were found
    effects: FittedEffects

    @property
    def excess(self) -> float:
        """Gain minus the least gain of this number of steps."""
        return self.effects.gain - GAIN_STEPS - GAIN_MORE_STEPS * (len(self.at) - 1)


def bias_steps(segment: Segment, axis: int) -> BiasSteps | None:
    """Return the steps of the bias of one axis in a segment, or None if there are none."""
    noise = segment.axis(axis)
    if noise is None:
        return None
    points = len(segment.means.values)
    steps = segment.contrasts_of(np.tril(np.ones((points, points)))[:, 1:])
    tried: list[_Steps] = []
    at: list[int] = []
    fit = noise.fit
    while len(at) < MOST_STEPS:
        scores = noise.scores(steps, steps[:, at], fit)
        if scores.max() < PROMISING_SCORE:
            break
        at = [*at, int(scores.argmax())]
        tried.append(_Steps(at, noise.with_effects(steps[:, at])))
        fit = tried[-1].effects.fit
    best = max(tried, key=lambda each: each.excess, default=None)
    if best is None or best.excess <= 0.0:
        return None
    order = np.argsort(best.at)
    period = segment.means.step * segment.tau0 * 1e9
    return BiasSteps(
        tuple(segment.means.start_ns + round((best.at[i] + 1) * period) for i in order),
        tuple(float(best.effects.sizes[i]) for i in order),
        noise.walk(noise.fit),
        noise.walk(best.effects.fit),
        best.excess,
    )


def step_findings(sums: AllanSums, known: Statistics, without: set[int]) -> list[Finding]:
    """Return the findings about steps of the bias in the longest segment.

    ``known`` are the statistics of the sums, and ``without`` are the indices of axes that are not
    tested. Times are counted from the start of the recording, also if its first part is excluded.
    """
    tau0 = sums.tau0 or 1.0
    every = [m for r in sums.recordings for m in r.means]
    longest = max(every, key=lambda m: m.samples, default=None)
    segment = Segment.of(known, longest, tau0)
    if longest is None or segment is None:
        return []
    found = []
    for i, axis in enumerate(sums.axes):
        steps = None if i in without else bias_steps(segment, i)
        if steps is not None and steps.walk_after < STEPS_RATIO * steps.walk_before:
            share = 1.0 - math.sqrt(steps.walk_after / steps.walk_before)
            size = max(abs(s) for s in steps.sizes)
            begin = longest.age * tau0
            times = [duration_text(begin + (ns - longest.start_ns) * 1e-9) for ns in steps.ns]
            at = ', '.join(times)
            found.append(finding('bias_steps', (axis,), size=size, share=share, at=at))
    return found
