# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of the bias with time that are not noise, such as steps.

An effect is a change of the bias of known form and unknown size, such as a step or exp(-t/T).

Method
------
The size of an effect is estimated from the block means of a segment by generalized least squares.
Then the noise is fitted again to the data minus the effect. The gain of an effect is the decrease
of -2 log likelihood when the effect is added to the model.
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
"""Least gain in -2 log L for the first step of the bias, and for each further step. In simulations
without steps, the 99 % quantiles of the gain are 11 to 22, depending on the noise
(`bench/bench_stationarity.py`)."""

MOST_CONTRASTS = 96
"""Largest number of contrasts of the block means; octave spectra describe higher frequencies."""

NEAR_OCTAVES = 4
"""Number of octave spectra that are used in addition to the contrasts: the octaves directly above
the frequencies of the contrasts."""

MOST_STEPS = 5
"""Largest number of steps of an axis."""

LEAST_MEANS = 24
"""Fewest block means of a segment in which a settling and steps are searched for."""

LEAST_TESTED_S = 120.0
"""Shortest segment in s in which a settling and steps are searched for. In shorter segments,
vibration rather than drift changes the means."""

STEPS_RATIO = 0.5
"""Largest variance of the random walk in a model with steps, relative to the variance in a model
without steps, for which the steps are reported. A drift that is not a random walk often looks like
a few steps, but such steps explain less of the random walk."""

PROMISING_SCORE = 8.0
"""Least score of a step for which the noise is fitted again. It is below `GAIN_STEPS`, because the
score is computed with the noise of a fit without the step. If there is a step, this noise is too
large, and the score is too small."""


@dataclass(frozen=True, eq=False)
class Segment:
    """Block means of one segment, and the octave spectra of all data at higher frequencies.

    Attributes
    ----------
    means : BlockMeans
        Block means of the segment.
    tau0 : float
        Sample period in s.
    known : Statistics
        Spectra of all data, and contrasts of this segment only.
    lowest : int
        Smallest index of an octave that is used; smaller indices have higher frequencies.
    components : tuple of Process
        Processes of the noise: the random terms, and a daily cycle if the segment is long.
    """

    means: BlockMeans
    tau0: float
    known: Statistics
    lowest: int
    components: tuple[Process, ...]

    @classmethod
    def of(cls, known: Statistics, means: BlockMeans | None, tau0: float) -> Segment | None:
        """Return a segment from the statistics of all data and the block means of the segment.

        ``tau0`` is the sample period in s. The result is None if there are no block means, or if
        the segment is too short for a test.
        """
        if means is None or len(means.values) < LEAST_MEANS:
            return None
        if means.samples * tau0 < LEAST_TESTED_S:
            return None
        points, step, octaves = len(means.values), means.step, known.octaves
        numbers_of_contrasts = (
            (o, 2.0 * points * step * lower_edge(o)) for o in range(octaves + 1)
        )
        kept_octaves = min(
            (o for o, n in numbers_of_contrasts if n <= MOST_CONTRASTS), default=octaves
        )
        possible_contrasts = int(2.0 * points * step * lower_edge(kept_octaves))
        size = Size(points, max(min(possible_contrasts, MOST_CONTRASTS, points - 2), 2))
        z = means.values.T @ contrasts(size)
        group = Group(size, 1, z, z[:, :, None] * z[:, None, :])
        kept_bins = known.octave < kept_octaves
        segment_statistics = replace(
            known,
            octave=known.octave[kept_bins],
            f=known.f[kept_bins],
            power=known.power[kept_bins],
            settling=known.settling[kept_bins],
            dof=known.dof[kept_bins],
            dof_alone=known.dof_alone[kept_bins],
            step=step,
            groups=(group,),
        )
        daily = daily_cycle(means.samples, tau0)
        components = (*RANDOM_TERMS, daily) if daily else RANDOM_TERMS
        return cls(means, tau0, segment_statistics, max(kept_octaves - NEAR_OCTAVES, 0), components)

    def contrasts_of(self, shapes: Floats) -> Floats:
        """Return the contrasts, (contrasts, n), of n series of means, (means, n).

        The first contrast, a line in time, is omitted.
        """
        group = self.known.groups[0]
        return np.asarray(contrasts(group.size)[:, 1:].T @ shapes)

    def axis(self, axis: int) -> AxisSegment | None:
        """Return one axis of the segment; None if it has no noise or cannot be fitted."""
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
    """One axis of a segment, and the fit of its noise without steps and without a settling."""

    data: AxisData
    columns: Columns
    # contrasts of the block means except the line in time, in units of the fit, (contrasts,)
    z: Floats
    fit: Fit

    def _whitened(self, effects: Floats, fit: Fit) -> tuple[Floats, Floats]:
        """Return the contrasts of effects and of block means, whitened by the noise of a fit."""
        root = np.linalg.cholesky(np.tensordot(fit.p, self.columns.low[0], 1))
        whitened = np.linalg.solve(root, np.column_stack([effects, self.z]))
        return whitened[:, :-1], whitened[:, -1]

    def scores(self, effects: Floats, others: Floats, fit: Fit) -> Floats:
        """Return the score of each column of ``effects``, (effects,).

        The score of an effect is the square of its estimated size, divided by the variance of this
        estimate. The model consists of this effect, the effects ``others``, and the noise of
        ``fit``. Each column of ``effects`` and ``others``, (contrasts, number), contains the
        contrasts of one effect. The score is 0 for an effect that ``others`` explain completely.
        """
        whitened, z = self._whitened(np.column_stack([others, effects]), fit)
        number = others.shape[1]
        whitened_others, whitened = whitened[:, :number], whitened[:, number:]
        if number:
            q, _ = np.linalg.qr(whitened_others)
            whitened, z = whitened - q @ (q.T @ whitened), z - q @ (q.T @ z)
        information = np.sum(whitened**2, axis=0)
        return np.where(
            information > 1e-9 * information.max(),
            (whitened.T @ z) ** 2 / np.maximum(information, 1e-300),
            0.0,
        )

    def with_effects(self, effects: Floats) -> FittedEffects:
        """Estimate the sizes of effects, and fit the noise to the data minus the effects.

        Each column of ``effects``, (contrasts, effects), contains the contrasts of one effect of
        size 1. The estimated sizes are in SI.
        """
        fit, sizes = self.fit, np.zeros(effects.shape[1], float)
        for _ in range(3):
            whitened, z = self._whitened(effects, fit)
            sizes = np.linalg.lstsq(whitened, z, rcond=None)[0]
            residuals = self.z - effects @ sizes
            low = [LowBand(1, self.data.low[0].line, np.outer(residuals, residuals))]
            data = replace(self.data, low=low)
            start = np.maximum(fit.p, 1e-6 * fit.p.max())
            value_before = fit.value
            fit = data.solve(fit.components, self.columns, start, tolerance=1e-2)
            if abs(value_before - fit.value) < 0.1:
                break
        scale = math.sqrt(self.data.scale)
        return FittedEffects(sizes * scale, fit, self.fit.value - fit.value)

    def deviation(self, fit: Fit, m: float) -> float:
        """Return the Allan deviation of the terms of a fit at the averaging factor m, in SI."""
        variance = sum(p * float(avar(c, max(m, 1.0))) for p, c in zip(fit.p, RANDOM_TERMS))
        return math.sqrt(variance * self.data.scale)

    def walk(self, fit: Fit) -> float:
        """Return the variance that the random walk of a fit gains per sample, in SI."""
        return float(fit.p[K]) * self.data.scale


class FittedEffects(NamedTuple):
    """Sizes of steps or of a settling, and the fit of the noise to the data minus these effects."""

    sizes: Floats  # (effects,) sizes of the effects in SI
    fit: Fit
    gain: float  # decrease of -2 log L by all effects together


# --- steps ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class BiasSteps:
    """Steps of the bias of one axis, and the random walk without and with these steps."""

    ns: tuple[int, ...]  # stamps of the steps in ns
    sizes: tuple[float, ...]  # sizes of the steps in SI
    walk_before: float  # variance of the random walk per sample, without steps in the model
    walk_after: float  # variance of the random walk per sample, with the steps in the model
    excess: float  # gain of all steps minus the least gain for this number of steps


class _Steps(NamedTuple):
    """Steps of the bias between block means, and the fit with these steps."""

    # index of the last block mean before each step, in the order in which the steps were found
    at: list[int]
    effects: FittedEffects

    @property
    def excess(self) -> float:
        """Gain of all steps minus the least gain for this number of steps."""
        return self.effects.gain - GAIN_STEPS - GAIN_MORE_STEPS * (len(self.at) - 1)


def bias_steps(segment: Segment, axis: int) -> BiasSteps | None:
    """Return the steps of the bias of one axis in a segment, or None if there are none."""
    noise = segment.axis(axis)
    if noise is None:
        return None
    points = len(segment.means.values)
    steps = segment.contrasts_of(np.tril(np.ones((points, points)))[:, 1:])
    trials: list[_Steps] = []
    indices: list[int] = []
    fit = noise.fit
    while len(indices) < MOST_STEPS:
        scores = noise.scores(steps, steps[:, indices], fit)
        if scores.max() < PROMISING_SCORE:
            break
        indices = [*indices, int(scores.argmax())]
        trials.append(_Steps(indices, noise.with_effects(steps[:, indices])))
        fit = trials[-1].effects.fit
    best = max(trials, key=lambda each: each.excess, default=None)
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

    An axis has a finding if its steps explain enough of its random walk (`STEPS_RATIO`). ``known``
    are the statistics of the sums, and ``without`` are the indices of axes that are not tested. The
    findings state the times of the steps since the first used sample of the recording, gaps and
    motions included. If the sums contain only the later periods of a recording, gaps and motions
    before these periods are not included.
    """
    tau0 = sums.tau0 or 1.0
    all_means = [(r, m) for r in sums.recordings for m in r.means]
    if not all_means:
        return []
    recording, longest = max(all_means, key=lambda pair: pair[1].samples)
    segment = Segment.of(known, longest, tau0)
    if segment is None:
        return []
    findings = []
    for i, axis in enumerate(sums.axes):
        steps = None if i in without else bias_steps(segment, i)
        if steps is not None and steps.walk_after < STEPS_RATIO * steps.walk_before:
            share = 1.0 - math.sqrt(steps.walk_after / steps.walk_before)
            size = max(abs(s) for s in steps.sizes)
            first_period = recording.periods[0]
            begin = first_period.begin * tau0 + (longest.start_ns - first_period.begin_ns) * 1e-9
            times = [duration_text(begin + (ns - longest.start_ns) * 1e-9) for ns in steps.ns]
            times_text = ', '.join(times)
            findings.append(finding('bias_steps', (axis,), size=size, share=share, at=times_text))
    return findings
