# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settling of the bias: A exp(-t/T) after the start of each recording.

All axes of a sensor have one time constant T, which maximizes the likelihood. The size A of each
axis is estimated by generalized least squares, and the noise is fitted again to the data minus the
settling.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..allan.periods import BlockMeans
from ..allan.sums import AllanSums
from .bias_changes import AxisSegment, FittedEffects, Segment
from .statistics import Floats, Settling, Statistics, decay_of_means, elapsed

GAIN_SETTLING = 16.5
"""Least gain in -2 log L of a settling, summed over the axes of a sensor. In simulations without a
settling, the 99 % quantiles of the gain are 10 to 13, depending on the noise, so that false alarms
are below 1 % of the sensors (`bench/bench_stationarity.py`)."""

TIMES = 2.0 * 0.5 ** np.arange(9)
"""Trial values of the time constant, relative to the length of the segment."""

REFINEMENTS = 4
"""Number of refinements of the time constant. Each refinement halves the distance between trial
values on a logarithmic scale."""

PROMISING_SCORE = 5.0
"""Least score of a settling, summed over the axes, for which the noise is fitted again. It is below
`GAIN_SETTLING`, because a score is computed with the noise of a fit without the settling. If there
is a settling, this noise is too large, and the score is too small."""

LEAST_SEGMENT = 0.3
"""Least length of the first segment of a recording, relative to the recording, for which a settling
is searched for in this segment."""

TESTED_RECORDINGS = 4
"""Number of the longest recordings that are tested for a settling."""


@dataclass(frozen=True)
class SensorSettling:
    """Settling of the axes of one sensor.

    Attributes
    ----------
    settling : Settling
        Time constant of the sensor, and size of each axis in each recording.
    axes : tuple of int
        Indices of the axes that settle.
    gain : float
        Gain in -2 log L, summed over the axes, in the recording with the largest gain.
    left : float
        Part of the settling that is left at the end of the first segment of a recording, divided by
        the Allan deviation of the noise at the time constant. It is the largest of these ratios for
        all axes and recordings.
    """

    settling: Settling
    axes: tuple[int, ...]
    gain: float
    left: float


@dataclass(frozen=True, eq=False)
class _Sensor:
    """First segment of a recording, with the noise of the axes of one sensor in this segment."""

    segment: Segment
    noise: Mapping[int, AxisSegment]

    def effects(self, time: float) -> dict[int, FittedEffects]:
        """Return index of an axis -> fit with a settling; ``time`` is T in samples."""
        decay = self.segment.contrasts_of(_decays([time], self.segment.means))
        return {axis: one.with_effects(decay) for axis, one in self.noise.items()}

    def gain(self, time: float) -> float:
        """Return the gain of a settling in -2 log L, summed over the axes."""
        return sum(max(one.gain, 0.0) for one in self.effects(time).values())

    def best_time(self) -> tuple[float, float]:
        """Return the time constant in samples with the largest gain, and this gain.

        Both are 0 if no score reaches `PROMISING_SCORE`.
        """
        means = self.segment.means
        times = (TIMES * (len(means.values) * means.step)).tolist()
        decays = self.segment.contrasts_of(_decays(times, means))
        no_effects = decays[:, :0]
        scores = np.sum(
            [one.scores(decays, no_effects, one.fit) for one in self.noise.values()], axis=0
        )
        if scores.max() < PROMISING_SCORE:
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
    """Return the settling of the axes of a sensor, or None if no recording shows a settling.

    The time constant is taken from the recording with the largest gain. ``known`` are the
    statistics of the sums, and ``axes`` are the indices of the axes.
    """
    tau0 = sums.tau0 or 1.0
    by_length = sorted(range(len(sums.recordings)), key=lambda i: -sums.recordings[i].samples)
    sensors = {}
    for i in by_length[:TESTED_RECORDINGS]:
        recording = sums.recordings[i]
        first_means = recording.means[0] if recording.means else None
        if first_means is None or first_means.samples < LEAST_SEGMENT * recording.samples:
            continue
        segment = Segment.of(known, first_means, tau0)
        if segment is not None:
            by_axis = {a: segment.axis(a) for a in axes}
            noise = {a: one for a, one in by_axis.items() if one is not None}
            if noise:
                sensors[i] = _Sensor(segment, noise)
    best_times = [one.best_time() for one in sensors.values()]
    time, gain = max(best_times, key=lambda each: each[1], default=(0.0, 0.0))
    if gain < GAIN_SETTLING:
        return None
    sizes: dict[int, Floats] = {}
    settling_axes: set[int] = set()
    largest_left = 0.0
    for i, sensor in sensors.items():
        effects = sensor.effects(time)
        if sum(max(one.gain, 0.0) for one in effects.values()) < GAIN_SETTLING:
            continue  # this recording has no settling
        recording, segment = sums.recordings[i], sensor.segment
        elapsed_samples = elapsed(recording, segment.means, tau0)
        size = np.zeros(len(sums.axes))
        for axis, one in effects.items():
            if max(one.gain, 0.0) < GAIN_SETTLING / len(effects) / 2.0:
                continue
            size[axis] = float(one.sizes[0]) * math.exp(min(elapsed_samples / time, 50.0))
            settling_axes.add(axis)
            remaining = abs(float(one.sizes[0])) * math.exp(-segment.means.samples / time)
            largest_left = max(
                largest_left, remaining / sensor.noise[axis].deviation(one.fit, time)
            )
        sizes[i] = size
    return SensorSettling(Settling(time, sizes), tuple(sorted(settling_axes)), gain, largest_left)


def _decays(times: Sequence[float], means: BlockMeans) -> Floats:
    """Return the block means of exp(-t/T) for each T, (means, times)."""
    return np.array([decay_of_means(t, means.step, len(means.values)) for t in times]).T
