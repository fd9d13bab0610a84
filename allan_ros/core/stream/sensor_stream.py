# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Computes, in several stages, the Allan sums of axes that are sampled together."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import partial
from heapq import nlargest

import numpy as np

from ..errors import AllanError
from ..imu import AXES, NANOSECONDS, Floats, ImuBatch, ImuIdentity, Stamps
from ..settings import SegmenterSettings
from .cleaning import RepeatFilter, SampleFilter
from .drive_recorder import DriveRecorder
from .health import (
    LISTED_EVENTS,
    LISTED_SEGMENTS,
    RATE_CHANGE,
    Counts,
    Event,
    Longest,
    Means,
    State,
)
from .motion import MotionGate
from .noise_levels import NoiseLevel, NoiseLevels, StreamSums
from .sensors import SensorPlan
from .timing import SampleClock, has_time

LARGE_RATE_CHANGE = 0.1
"""After a possible change of the rate, the mean step of the first stamps is compared with the
former period. If the relative difference exceeds this value, the rate has changed. A smaller
difference may be due to bursts, and is judged when the new period is learned."""


KEPT_MEANS = 120
"""Largest number of the latest one-second means that are kept; older means are removed."""


class RunningMeans:
    """Computes means over consecutive seconds of samples without a gap."""

    def __init__(self, axes: tuple[str, ...]) -> None:
        self.means = Means(axes, np.empty(0, np.int64), np.empty((0, len(axes))))
        """The latest complete means, at most `KEPT_MEANS`."""
        self.cut()

    def cut(self) -> None:
        """Remove the incomplete mean at the end of a segment."""
        self._start_ns: int | None = None
        self._second = 0  # index of the incomplete second, counted from `_start_ns`
        self._open: list[Floats] = []  # samples of the incomplete second

    def update(self, stamps: Stamps, rows: Floats) -> None:
        """Add samples without a gap: stamps in order, (n,), in ns, and values, (axes, n).

        At least one sample is required. No mean is computed for seconds without samples.
        """
        if self._start_ns is None:
            self._start_ns = int(stamps[0])
        last_second = int(stamps[-1] - self._start_ns) // NANOSECONDS
        if last_second > self._second:
            end_ns = self._start_ns + np.arange(self._second + 1, last_second + 1) * NANOSECONDS
            ends = np.searchsorted(stamps, end_ns)
            first_rows = np.concatenate([*self._open, rows[:, : ends[0]]], axis=1)
            # each second is summed at once, so that the rounding does not depend on the batches
            sums, counts = np.add.reduceat(first_rows, [0], axis=1), np.array([first_rows.shape[1]])
            seconds = np.flatnonzero(np.diff(ends))  # seconds with samples, after the first second
            if len(seconds):
                later_sums = np.add.reduceat(rows[:, : ends[-1]], ends[seconds], axis=1)
                sums = np.concatenate([sums, later_sums], axis=1)
                counts = np.concatenate([counts, np.diff(ends)[seconds]])
            self._keep(np.concatenate([end_ns[:1], end_ns[seconds + 1]]), (sums / counts).T)
            self._second, self._open = last_second, []
            rows = rows[:, ends[-1] :]
        self._open.append(rows.copy())

    def _keep(self, end_ns: Stamps, values: Floats) -> None:
        axes, *former = self.means
        end_ns, values = (np.concatenate(a)[-KEPT_MEANS:] for a in zip(former, (end_ns, values)))
        self.means = Means(axes, end_ns, values)


class SensorStream:
    """Computes the Allan sums of axes that are sampled together, from their samples at rest.

    The axes are all usable axes of the IMU, or the axes of one sensor, for example if the sensors
    have different rates. The stages are: `SampleFilter`, `SampleClock`, `RepeatFilter` (if the
    driver repeats samples at random), `MotionGate` (unless it is switched off), and the sums of a
    `NoiseLevel`.

    ``gate`` is None before `SampleClock` returns the first samples at the present rate, or if
    motion detection is switched off. ``recorder`` contains the drives between two rests at the
    present sample rate, or at the former rate while ``gate`` is None. It is None if ``with_drives``
    is not set, if the stream does not have all six axes, or before ``gate`` is set for the first
    time.
    """

    def __init__(
        self,
        plan: SensorPlan,
        identity: ImuIdentity,
        settings: SegmenterSettings,
        with_samples: bool = False,
        with_drives: bool = False,
        with_means: bool = False,
    ) -> None:
        self.axes = plan.axes
        self._with_drives, self._with_means = with_drives and plan.axes == AXES, with_means
        self.recorder: DriveRecorder | None = None
        self.events: Longest[Event] = Longest(LISTED_EVENTS)
        self._plan = plan
        self._former: StreamSums | None = None  # sums at the earlier rate with the most data
        self._settings = settings
        self._counts = Counts()  # counts of all samples that the present noise levels do not count
        self._lost, self._lost_s = 0, 0.0  # `lost` and `lost_s` at earlier rates
        self._former_ns = 0.0  # sample period before a change of the rate that is not confirmed yet
        self._filter = SampleFilter(plan, self._counts)
        self._start_level = partial(NoiseLevel, identity, plan.axes, with_samples)
        self._start()

    def _start(self) -> None:
        """Begin to learn the sample period, with empty sums."""
        axes, drop = self._plan.axes, self._plan.drop
        self.clock = SampleClock(len(axes), self._settings, bool(drop), self._counts)
        self.gate: MotionGate | None = None
        # stages between the clock and the sums
        self._stages: list[RepeatFilter | MotionGate] = []
        if self._plan.random_repeats:
            groups = [[axes.index(axis) for axis in group] for group in self._plan.random_repeats]
            self._stages.append(RepeatFilter(groups, len(axes)))
        self._levels = NoiseLevels(self._start_level)
        self._means = RunningMeans(self._plan.axes) if self._with_means else None

    @property
    def counts(self) -> Counts:
        """Counts of all used and excluded samples."""
        counts = replace(self._counts, splits=self._counts.splits.copy())
        counts.add(self._levels.counts)
        return counts

    @property
    def lost(self) -> int:
        """Number of noise levels that were the published level until a later level replaced them.

        The levels at all sample rates are counted (see `NoiseLevels.lost`).
        """
        return self._lost + self._levels.lost

    @property
    def lost_s(self) -> float:
        """Time in s from the first sample at rest to the first sample of the published noise level.

        It is the longest of the times at all sample rates (`NoiseLevels.lost_s`), and 0 if `lost`
        is 0.
        """
        return max(self._lost_s, self._levels.lost_s)

    @property
    def kept(self) -> list[ImuBatch]:
        """The samples at rest at the present rate; empty unless ``with_samples`` was set.

        They belong to the noise level whose Allan sums are the result at this rate.
        """
        return self._levels.published.kept

    @property
    def is_examined(self) -> bool:
        """Whether samples of the published noise level were searched for clipped values."""
        return self._levels.published.is_examined

    @property
    def clipped(self) -> dict[str, float]:
        """Axis -> clipped share of its examined samples at the published noise level.

        Only shares of at least `MIN_CLIPPED` are included.
        """
        return self._levels.published.clipped

    @property
    def state(self) -> State:
        """'waiting' or 'learning' until ``gate`` is set, then the state of `MotionGate`.

        If motion detection is switched off, the state is 'at_rest' as soon as the period is known.
        """
        if self.gate is not None:
            return self.gate.state
        if self.clock.clock is not None and not self._settings.motion_gate:
            return 'at_rest'
        return 'learning' if len(self.clock.pending) else 'waiting'

    def by_rate(self) -> list[StreamSums]:
        """Return the sums at the earlier sample rate with the most data, and at the present rate.

        If both rates are equal, the sums are added. Sums without samples are omitted. The sums at
        the present rate are also omitted if their samples seem to come from two IMUs, and there are
        sums at an earlier rate.
        """
        sums, segments = self._levels.published.result
        former = [] if self._former is None else [self._former]
        if not sums.samples or (former and self.is_interleaved):
            return former
        if former:
            with suppress(AllanError):  # raised if the rates differ
                sums = former[0].sums + sums
                longest_segments = nlargest(
                    LISTED_SEGMENTS, [*former[0].segments, *segments], key=lambda each: each.samples
                )
                return [StreamSums(sums, tuple(sorted(longest_segments)))]
        return [*former, StreamSums(sums, segments)]

    @property
    def is_interleaved(self) -> bool:
        """Whether the first samples at the present rate seem to come from two IMUs."""
        return self.clock.is_interleaved

    @property
    def means(self) -> Means | None:
        """The latest one-second means of static data; None unless ``with_means`` was set."""
        return None if self._means is None else self._means.means

    def feed(self, *parts: ImuBatch) -> None:
        """Process the next samples, which have six axes and may be in several parts."""
        self._pass_on(self.clock.feed(*map(self._filter.feed, parts)))
        while self.clock.rate_changed:
            self._pass_on(self._change_rate())
        if self._former_ns and self.clock.clock is not None:
            self._compare_rate(self.clock.clock.period_ns, RATE_CHANGE)

    def flush(self) -> None:
        """Process all buffered samples at the end of the input, and close the segment."""
        self._pass_on(self.clock.flush())
        while self.clock.rate_changed:
            self._pass_on(self._change_rate() + self.clock.flush())
        self._end_segment()

    def _change_rate(self) -> list[ImuBatch]:
        """Keep the longest sums so far, and return the first blocks of samples at the new rate."""
        assert self.clock.clock is not None
        self._end_segment()
        self._former_ns = self._former_ns or self.clock.clock.period_ns
        former_sums = self.by_rate()
        self._former = (
            max(former_sums, key=lambda each: each.sums.elapsed_ns) if former_sums else None
        )
        self._counts.add(self._levels.counts)
        self._lost, self._lost_s = self.lost, self.lost_s
        pending = self.clock.pending
        self._start()
        if has_time(pending.stamps_ns):
            mean_ns = float(pending.stamps_ns[-1] - pending.stamps_ns[0]) / (len(pending) - 1)
            self._compare_rate(mean_ns, LARGE_RATE_CHANGE, is_known=False)
        return self.clock.feed(pending)

    def _compare_rate(self, period_ns: float, least: float, is_known: bool = True) -> None:
        """Count a change of the rate, or a change of other properties of the stamps.

        The rate changed if the period differs from the former period by more than the fraction
        ``least``. Otherwise, a change of other properties is counted if the new rate is known.
        """
        if abs(period_ns / self._former_ns - 1.0) > least:
            self._counts.splits['rate change'] += 1
        elif is_known:
            self._counts.splits['stamps'] += 1
        else:
            return
        self._former_ns = 0.0

    def _pass_on(self, blocks: list[ImuBatch], at_end: bool = False) -> None:
        """Pass evenly spaced blocks through the stages to the sums."""
        if blocks and self.gate is None and self._settings.motion_gate:
            period_ns, axes = self.clock.learned_ns, self._plan.axes
            self.gate = MotionGate(
                period_ns, axes, self._levels, self._counts, self.events, self._settings
            )
            self._stages.append(self.gate)
            if self._with_drives:
                self.recorder = DriveRecorder(period_ns * 1e-9)
        for stage in self._stages:
            if stage is self.gate and self.recorder is not None:
                self.recorder.add_samples(blocks)
            blocks = stage.feed(blocks) + (stage.flush() if at_end else [])
        if self.recorder is not None:
            self.recorder.add_rests(blocks)
        for block in blocks:
            if self.gate is None:  # otherwise, the gate adds the samples at rest
                self._levels.present.add(block)
            if self._means is not None and block.cut:
                self._means.cut()
            if self._means is not None and len(block):
                self._means.update(block.stamps_ns, block.rows)

    def _end_segment(self) -> None:
        """Process the samples that the stages have buffered, and close the segment."""
        self._pass_on([], at_end=True)
        self._levels.present.close()
        if self._means is not None:
            self._means.cut()
