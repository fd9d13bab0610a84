# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of the bias with time that are not noise: settling after the start, and steps.

An effect is a change of the bias of known form and unknown size: a settling exp(-t/T) or a step.

Method
------
The size of an effect is estimated from the block means of a segment by generalized least squares.
Then the noise is fitted again to the data minus the effect. The gain of an effect is the decrease
of -2 log likelihood when the effect is added to the model.

All axes of a sensor settle with one time constant T, which maximizes the likelihood for the
recording with the largest gain. Each axis has its own size A of the settling A exp(-t/T).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..allan.periods import BlockMeans
from ..allan.sums import AllanSums
from ..estimate import duration_text
from ..findings import Finding, finding, quantity
from ..imu import sensor_of
from ..noise import RANDOM_TERMS, Process
from ..noise.derived import avar
from ..noise.processes.sinusoid import daily_cycle
from .likelihood import AxisData, Columns, Fit, LowBand
from .result import K
from .statistics import (
    Floats,
    Group,
    Settling,
    Size,
    Statistics,
    contrasts,
    decay_of_means,
    elapsed,
    lower_edge,
)

MOST_CONTRASTS = 96
"""Largest number of contrasts of the block means; octave spectra describe higher frequencies."""

NEAR_OCTAVES = 4
"""Largest number of octave spectra that are used in addition to the contrasts: the octaves directly
above the frequencies of the contrasts."""

LEAST_MEANS = 24
"""A settling and steps are searched for only in segments with at least this number of means of
blocks."""

LEAST_TESTED_S = 120.0
"""A settling and steps are searched for only in segments of at least this duration in s. In shorter
segments, vibration rather than drift changes the means."""


@dataclass(frozen=True, eq=False)
class SegmentStatistics:
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
        Processes of the noise: the random terms, and a daily cycle if the segment lasts more than
        18 h.
    """

    means: BlockMeans
    tau0: float
    known: Statistics
    lowest: int
    components: tuple[Process, ...]

    @classmethod
    def of(
        cls, known: Statistics, means: BlockMeans | None, tau0: float
    ) -> SegmentStatistics | None:
        """Return the statistics of a segment, given its block means and the statistics of all data.

        ``tau0`` is the sample period in s. The result is None if ``means`` is None, or if the
        segment has fewer than `LEAST_MEANS` block means or is shorter than `LEAST_TESTED_S`.
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
        group = Group.of(size, means.values.T[None])
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

        The first contrast, which measures a linear change with time, is omitted.
        """
        group = self.known.groups[0]
        return np.asarray(contrasts(group.size)[:, 1:].T @ shapes)

    def axis(self, axis: int) -> AxisSegment | None:
        """Return one axis of the segment; None if the axis has no noise or cannot be fitted."""
        z = self.known.groups[0].sums[axis]
        data = AxisData.of(self.known, axis)
        data = replace(data, used=self.known.octave >= self.lowest)
        # the power is NaN if the samples are so large that their squares are infinite
        if not np.any(np.abs(z[1:]) > 0.0) or not np.all(data.power[data.used] > 0.0):
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
    # (contrasts,) contrasts of the block means, except the contrast that measures a linear change
    # with time, divided by the square root of `AxisData.scale`
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
            residual_contrasts = [LowBand(1, np.outer(residuals, residuals))]
            data = replace(self.data, low=residual_contrasts)
            start = np.maximum(fit.p, 1e-6 * fit.p.max())
            value_before = fit.value
            fit = data.solve(fit.components, self.columns, start, tolerance=1e-2)
            if abs(value_before - fit.value) < 0.1:
                break
        scale = math.sqrt(self.data.scale)
        return FittedEffects(sizes * scale, fit, self.fit.value - fit.value)

    def deviation(self, fit: Fit, m: float) -> float:
        """Return the Allan deviation of the random terms of a fit at the averaging factor m, in SI.

        An averaging factor below 1 counts as 1.
        """
        variance = sum(p * float(avar(c, max(m, 1.0))) for p, c in zip(fit.p, RANDOM_TERMS))
        return math.sqrt(variance * self.data.scale)


class FittedEffects(NamedTuple):
    """Sizes of steps or of a settling, and the fit of the noise to the data minus these effects."""

    sizes: Floats  # (effects,) sizes of the effects in SI
    fit: Fit
    gain: float  # decrease of -2 log L by all effects together


# --- settling -------------------------------------------------------------------------------------


GAIN_SETTLING = 16.5
"""Least gain in -2 log L of a settling, summed over the axes of a sensor. In simulations without a
settling, the 99 % quantiles of the gain are 10 to 13, depending on the noise, so that false alarms
are below 1 % of the sensors (`bench/bench_stationarity.py`)."""

TIMES = 2.0 * 0.5 ** np.arange(9)
"""Trial values of the time constant, relative to the length of the segment."""

REFINEMENTS = 4
"""Number of refinements of the time constant. Each refinement halves the distance between trial
values on a logarithmic scale."""

PROMISING_SETTLING = 5.0
"""Least score (approximate gain) of a settling, summed over the axes. If no trial value of the time
constant reaches this score, the noise is not fitted again. The number is below `GAIN_SETTLING`,
because a score is computed with the noise of a fit without the settling. If there is a settling,
this noise is too large, and the score is too small."""

LEAST_SEGMENT = 0.3
"""Least length of the first segment with block means, relative to the length of the recording. A
settling is not searched for in a shorter first segment."""

TESTED_RECORDINGS = 4
"""Largest number of recordings that are tested for a settling: the longest recordings."""

LARGEST_REMAINDER = 1.0
"""Largest remainder of a settling for which the sensor is assumed to have settled. The remainder is
measured at the end of the first segment with block means, and is divided by the Allan deviation of
the noise at the time constant."""


@dataclass(frozen=True)
class SensorSettling:
    """Settling of the axes of one sensor.

    Attributes
    ----------
    settling : Settling
        Time constant of the sensor, and size of the settling of each axis in each recording in
        which the sensor settles.
    axes : tuple of int
        Indices of the axes that settle.
    gain : float
        Gain in -2 log L, summed over the axes, in the recording with the largest gain.
    remainder : float
        Remainder of the settling at the end of the first segment with block means, divided by the
        Allan deviation of the noise at the time constant: the largest of these ratios for all
        settling axes and recordings.
    """

    settling: Settling
    axes: tuple[int, ...]
    gain: float
    remainder: float


@dataclass(frozen=True, eq=False)
class _Sensor:
    """Noise of the axes of one sensor in a segment in which a settling is searched for."""

    segment: SegmentStatistics
    noise: Mapping[int, AxisSegment]

    def effects(self, time: float) -> dict[int, FittedEffects]:
        """Return axis index -> fit with a settling of the time constant ``time`` in samples."""
        decay = self.segment.contrasts_of(_decays([time], self.segment.means))
        return {axis: axis_segment.with_effects(decay) for axis, axis_segment in self.noise.items()}

    def gain(self, time: float) -> float:
        """Return the gain in -2 log L of a settling with the time constant ``time`` in samples.

        The gains of the axes are added; a negative gain counts as 0.
        """
        return sum(max(fitted.gain, 0.0) for fitted in self.effects(time).values())

    def best_time(self) -> tuple[float, float]:
        """Return the best of the tried time constants, in samples, and its gain in -2 log L.

        Both are 0 if no trial value has a score of `PROMISING_SETTLING` or more.
        """
        means = self.segment.means
        times = (TIMES * (len(means.values) * means.step)).tolist()
        decays = self.segment.contrasts_of(_decays(times, means))
        no_effects = decays[:, :0]
        scores = np.sum(
            [
                axis_segment.scores(decays, no_effects, axis_segment.fit)
                for axis_segment in self.noise.values()
            ],
            axis=0,
        )
        if scores.max() < PROMISING_SETTLING:
            return 0.0, 0.0
        gains = {t: self.gain(t) for t, score in zip(times, scores) if score > 0.4 * scores.max()}
        best = max(gains, key=lambda t: gains[t])
        if gains[best] < GAIN_SETTLING / 2.0:
            return best, gains[best]
        for k in range(REFINEMENTS):
            factor = 2.0**0.5 ** (k + 1)
            for t in (best / factor, best * factor):
                gains[t] = self.gain(t)
            best = max(gains, key=lambda t: gains[t])
        return best, gains[best]


def settling(sums: AllanSums, known: Statistics, axes: Sequence[int]) -> SensorSettling | None:
    """Return the settling of the axes of a sensor, or None if no tested recording shows one.

    The first segment with block means of each of the `TESTED_RECORDINGS` longest recordings is
    tested, unless the segment is too short or none of the axes can be fitted. The time constant is
    taken from the recording with the largest gain. ``known`` are the statistics of the sums, and
    ``axes`` are the indices of the axes.
    """
    tau0 = sums.tau0 or 1.0
    longest_first = sorted(range(len(sums.recordings)), key=lambda i: -sums.recordings[i].samples)
    sensors = {}
    for i in longest_first[:TESTED_RECORDINGS]:
        recording = sums.recordings[i]
        first_means = recording.means[0] if recording.means else None
        if first_means is None or first_means.samples < LEAST_SEGMENT * recording.samples:
            continue
        segment = SegmentStatistics.of(known, first_means, tau0)
        if segment is not None:
            axis_segments = {a: segment.axis(a) for a in axes}
            noise = {a: fitted for a, fitted in axis_segments.items() if fitted is not None}
            if noise:
                sensors[i] = _Sensor(segment, noise)
    best_times = [sensor.best_time() for sensor in sensors.values()]
    time, gain = max(best_times, key=lambda each: each[1], default=(0.0, 0.0))
    if gain < GAIN_SETTLING:
        return None
    sizes: dict[int, Floats] = {}
    settling_axes: set[int] = set()
    largest_remainder = 0.0
    for i, sensor in sensors.items():
        effects = sensor.effects(time)
        if sum(max(fitted.gain, 0.0) for fitted in effects.values()) < GAIN_SETTLING:
            continue  # this recording has no settling
        recording, segment = sums.recordings[i], sensor.segment
        elapsed_samples = elapsed(recording, segment.means, tau0)
        size = np.zeros(len(sums.axes))
        for axis, fitted in effects.items():
            if max(fitted.gain, 0.0) < GAIN_SETTLING / len(effects) / 2.0:
                continue
            size[axis] = float(fitted.sizes[0]) * math.exp(min(elapsed_samples / time, 50.0))
            settling_axes.add(axis)
            remaining = abs(float(fitted.sizes[0])) * math.exp(-segment.means.samples / time)
            largest_remainder = max(
                largest_remainder, remaining / sensor.noise[axis].deviation(fitted.fit, time)
            )
        sizes[i] = size
    return SensorSettling(
        Settling(time, sizes), tuple(sorted(settling_axes)), gain, largest_remainder
    )


def _decays(times: Sequence[float], means: BlockMeans) -> Floats:
    """Return the block means of exp(-t/T) for each T, (means, times)."""
    return np.array([decay_of_means(t, means.step, len(means.values)) for t in times]).T


def settling_findings(sums: AllanSums, found: Sequence[SensorSettling]) -> list[Finding]:
    """Return one finding about each settling in ``found``."""
    tau0 = sums.tau0 or 1.0
    findings = []
    for sensor_settling in found:
        sizes = [abs(s) for size in sensor_settling.settling.sizes.values() for s in size.tolist()]
        axes = tuple(sums.axes[a] for a in sensor_settling.axes)
        size = quantity(max(sizes), sensor_of(axes[0]), 'signal')
        time = sensor_settling.settling.time * tau0
        if sensor_settling.remainder > LARGEST_REMAINDER:
            further_s = time * math.log(sensor_settling.remainder / LARGEST_REMAINDER)
            needed_s = max(r.samples for r in sums.recordings) * tau0 + further_s
            findings.append(finding('not_settled', axes, size=size, time=time, how_long=needed_s))
        else:
            findings.append(finding('settling', axes, size=size, time=time))
    return findings


# --- steps ----------------------------------------------------------------------------------------


GAIN_STEPS, GAIN_MORE_STEPS = 20.0, 10.0
"""Least gain in -2 log L of a model with one step of the bias, and number by which the least gain
increases with each further step. In simulations without steps, the 99 % quantiles of the gain are
11 to 22, depending on the noise, after `GAIN_MORE_STEPS` was subtracted for each further step
(`bench/bench_stationarity.py`)."""

MOST_STEPS = 5
"""Largest number of steps of the bias of an axis."""

STEPS_RATIO = 0.5
"""Largest variance of the random walk in a model with steps, relative to the variance in a model
without steps, for which the steps are reported. A drift that is not a random walk often looks like
a few steps, but such steps explain less of the random walk."""

PROMISING_STEP = 8.0
"""Least score (approximate gain) of a step for which the noise is fitted again. The number is below
`GAIN_STEPS`, because the score is computed with the noise of a fit without the step. If there is a
step, this noise is too large, and the score is too small."""


class BiasSteps(NamedTuple):
    """Steps of the bias of one axis, and the fit of the noise with these steps."""

    # index of the last block mean before each step, in the order in which the steps were found
    indices: list[int]
    effects: FittedEffects
    fit_without_steps: Fit

    @property
    def excess(self) -> float:
        """Gain of all steps minus the least gain for this number of steps."""
        return self.effects.gain - GAIN_STEPS - GAIN_MORE_STEPS * (len(self.indices) - 1)


def bias_steps(segment: SegmentStatistics, axis: int) -> BiasSteps | None:
    """Return the steps of the bias of one axis in a segment, or None if none are significant."""
    noise = segment.axis(axis)
    if noise is None:
        return None
    points = len(segment.means.values)
    steps = segment.contrasts_of(np.tril(np.ones((points, points)))[:, 1:])
    trials: list[BiasSteps] = []
    indices: list[int] = []
    fit = noise.fit
    while len(indices) < MOST_STEPS:
        scores = noise.scores(steps, steps[:, indices], fit)
        if scores.max() < PROMISING_STEP:
            break
        indices = [*indices, int(scores.argmax())]
        trials.append(BiasSteps(indices, noise.with_effects(steps[:, indices]), noise.fit))
        fit = trials[-1].effects.fit
    best = max(trials, key=lambda each: each.excess, default=None)
    return best if best is not None and best.excess > 0.0 else None


def step_findings(sums: AllanSums, known: Statistics, without: set[int]) -> list[Finding]:
    """Return the findings about steps of the bias in the longest segment with block means.

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
    recording, longest_means = max(all_means, key=lambda pair: pair[1].samples)
    segment = SegmentStatistics.of(known, longest_means, tau0)
    if segment is None:
        return []
    first_period = recording.periods[0]
    begin = first_period.begin * tau0 + (longest_means.start_ns - first_period.begin_ns) * 1e-9
    findings = []
    for i, axis in enumerate(sums.axes):
        steps = None if i in without else bias_steps(segment, i)
        if steps is None:
            continue
        walk_before, walk_after = steps.fit_without_steps.p[K], steps.effects.fit.p[K]
        if walk_after < STEPS_RATIO * walk_before:
            share = 1.0 - math.sqrt(walk_after / walk_before)
            size = float(np.abs(steps.effects.sizes).max())
            times = [begin + (k + 1) * longest_means.step * tau0 for k in sorted(steps.indices)]
            times_text = ', '.join(map(duration_text, times))
            findings.append(finding('bias_steps', (axis,), size=size, share=share, at=times_text))
    return findings
