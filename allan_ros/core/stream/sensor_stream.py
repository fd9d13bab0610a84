# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The samples of one sensor stream on their way to sums.

A sensor stream is the axes that are sampled together: all six, or one sensor where the two have
different rates. Its stages: own samples, order of stamps, sample clock, motion gate, engine.
"""

from __future__ import annotations

from bisect import insort
from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..allan.engine import RunningAllan
from ..allan.spectrum import RunningSpectrum, SpectrumSums
from ..allan.sums import LONGEST_FILLED, AllanSums
from ..errors import AllanError
from ..imu import ImuIdentity
from ..settings import SegmenterSettings
from .cleaning import SampleHoldFilter, SensorPlan, StampFilter
from .health import Counts, Segment, State
from .motion import RELEARNED, MotionGate
from .timing import LEARN, Block, SampleClock, learn_clock

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

Samples = tuple[Stamps, Floats, NDArray[np.bool_]]
"""Stamps (n,), rows (axes, n), and a flag for backward clock steps (n,)."""

LISTED_SEGMENTS = 1000
"""How many of the longest segments are listed."""

KEPT_RATES = 8
"""Rates of one sensor stream whose sums are kept."""

KEPT_MEANS = 120
"""Latest means that are kept, for a reader that asks once in a while."""


def longest_segments(segments: list[Segment]) -> tuple[Segment, ...]:
    """Return the `LISTED_SEGMENTS` longest, in order of time."""
    longest = sorted(segments, key=lambda s: (-s.samples, s.start_ns))[:LISTED_SEGMENTS]
    return tuple(sorted(longest))


class StreamSums(NamedTuple):
    """Sums, spectrum if requested, and the listed segments of the samples at one rate."""

    sums: AllanSums
    spectrum: SpectrumSums | None
    segments: tuple[Segment, ...]

    def joined(self, other: StreamSums) -> StreamSums:
        """Return both together.

        Raises AllanError when they are of different rates.
        """
        spectra = (self.spectrum, other.spectrum)
        both = None if spectra[0] is None or spectra[1] is None else spectra[0] + spectra[1]
        segments = longest_segments([*self.segments, *other.segments])
        return StreamSums(self.sums + other.sums, both, segments)


@dataclass(frozen=True)
class Means:
    """Means of static samples of the axes of one sensor stream: the input of the bias filter.

    Attributes
    ----------
    axes : tuple of str
    end_ns : (n,) int64 array
        Time at which each mean ends.
    values : (n, axes) float64 array
        In the unit of the samples.
    """

    axes: tuple[str, ...]
    end_ns: NDArray[np.int64]
    values: Floats


class RunningMeans:
    """Means over consecutive seconds of contiguous samples.

    Parameters
    ----------
    axes : tuple of str
    length : float
        Length of a mean in s.
    """

    def __init__(self, axes: tuple[str, ...], length: float = 1.0) -> None:
        self._axes, self._length_ns = axes, round(length * 1e9)
        self._kept: deque[tuple[int, Floats]] = deque(maxlen=KEPT_MEANS)
        self.cut()

    def cut(self) -> None:
        """Drop the mean in progress: the samples that follow are not contiguous."""
        self._start_ns: int | None = None
        self._second, self._count = 0, 0
        self._sum = np.zeros(len(self._axes))

    def update(self, stamps: Stamps, rows: Floats) -> None:
        """Take contiguous samples: stamps (n,) in ns, rows (axes, n)."""
        if self._start_ns is None:
            self._start_ns = int(stamps[0])
        seconds = (stamps - self._start_ns) // self._length_ns
        begins = np.concatenate([[0], np.flatnonzero(np.diff(seconds)) + 1])
        sums = np.add.reduceat(rows, begins, axis=1).T
        counts = np.diff(begins, append=len(stamps)).tolist()
        for second, total, count in zip(seconds[begins].tolist(), sums, counts):
            if second > self._second:
                end_ns = self._start_ns + (self._second + 1) * self._length_ns
                self._kept.append((end_ns, self._sum / max(self._count, 1)))
                self._sum, self._count, self._second = np.zeros(len(total)), 0, second
            self._sum = self._sum + total
            self._count += count

    @property
    def means(self) -> Means:
        """The latest complete means."""
        end_ns = np.array([end for end, _ in self._kept], np.int64)
        values = np.array([value for _, value in self._kept]).reshape(-1, len(self._axes))
        return Means(self._axes, end_ns, values)


class FilledGaps:
    """Counts the runs of interpolated samples that the sums hold, by length and axis.

    Attributes
    ----------
    count : (lengths, axes) int64 array
    """

    def __init__(self, axes: int) -> None:
        self.count = np.zeros((0, axes), np.int64)
        self._open = [0] * axes  # lengths of the runs that may go on

    def add(self, filled: NDArray[np.bool_] | None) -> None:
        """Take the flags of the next samples, (axes, n); None if none of them is filled."""
        if filled is None:
            self.end()
            return
        for axis, flags in enumerate(filled):
            if not self._open[axis] and not flags.any():
                continue
            edges = np.flatnonzero(np.diff(flags, prepend=False, append=False))
            for begin, end in edges.reshape(-1, 2).tolist():
                if begin:
                    self._close(axis)
                self._open[axis] += end - begin
                if end < len(flags):
                    self._close(axis)
            if not flags[-1]:
                self._close(axis)

    def end(self) -> None:
        """End all runs: the next sample is not filled, or belongs to another segment."""
        for axis, length in enumerate(self._open):
            if length:
                self._close(axis)

    def _close(self, axis: int) -> None:
        length, self._open[axis] = min(self._open[axis], LONGEST_FILLED), 0
        if not length:
            return
        if length > len(self.count):
            longer = np.zeros((length - len(self.count), self.count.shape[1]), np.int64)
            self.count = np.concatenate([self.count, longer])
        self.count[length - 1, axis] += 1


class StreamOptions(NamedTuple):
    """What is accumulated: the settings, and whether to keep spectra and means too."""

    settings: SegmenterSettings = SegmenterSettings()
    with_spectra: bool = False
    with_means: bool = False


class SensorStream:
    """Feeds the engine with the samples at rest of one sensor stream.

    Parameters
    ----------
    plan : SensorPlan
        Its axes, and which messages have samples of its own.
    identity : ImuIdentity
    wanted : StreamOptions

    Attributes
    ----------
    counts : Counts
        Counts of the samples.
    relearned : int
        How often the sums were discarded because the data had been taken in motion.
    """

    def __init__(self, plan: SensorPlan, identity: ImuIdentity, wanted: StreamOptions) -> None:
        self.plan = plan
        self.counts = Counts()
        self.relearned = 0
        self._former: list[StreamSums] = []  # one of each rate the stream had
        self._identity = identity
        self._wanted = wanted
        self._own = SampleHoldFilter(plan)
        self._filter = StampFilter(len(plan.axes), self.counts)
        self._start(_nothing(len(plan.axes)))

    def _start(self, waiting: Samples) -> None:
        """Start to learn a rate, with the buffered samples."""
        self._learning = waiting
        self._clock: SampleClock | None = None
        self._gate: MotionGate | None = None
        self._clear()

    def _clear(self) -> None:
        """Start with empty sums."""
        axes = self.plan.axes
        self._engine = RunningAllan(self._identity, axes)
        self._spectrum = RunningSpectrum(axes) if self._wanted.with_spectra else None
        self._means = RunningMeans(axes) if self._wanted.with_means else None
        self._filled = FilledGaps(len(axes))
        self._segments: list[tuple[int, Segment]] = []  # shortest first
        self._start_ns = self._end_ns = 0
        self._cut = ''

    @property
    def state(self) -> State:
        """State of the stream."""
        if self._clock is None:
            return 'learning' if len(self._learning[0]) else 'waiting'
        gate = self._gate
        if gate is None:
            return 'still'
        if gate.learning:
            return 'learning'
        if gate.louder is not None:
            return 'louder'
        return 'moving' if gate.moving else 'still'

    @property
    def loudest(self) -> dict[str, float]:
        """Axis -> how many times louder than its floor it became at rest; empty if it did not."""
        if self._gate is None or self._gate.loudest is None:
            return {}
        return dict(zip(self.plan.axes, self._gate.loudest.tolist()))

    @property
    def clock(self) -> tuple[float, bool] | None:
        """Working period in ns and whether stamps are bursty; None before they are learned."""
        if self._clock is None:
            return None
        return self._clock.clock.period_ns, self._clock.clock.bursty

    @property
    def present(self) -> StreamSums:
        """Sums at the present rate."""
        spectrum = None if self._spectrum is None else self._spectrum.sums
        segments = tuple(sorted(segment for _, segment in self._segments))
        sums = self._engine.sums
        if len(self._filled.count):
            sums = replace(sums, filled=self._filled.count.copy())
        return StreamSums(sums, spectrum, segments)

    def by_rate(self) -> list[StreamSums]:
        """Return the sums at each rate; a rate that returns is continued."""
        present = self.present
        if not present.sums.samples:
            return self._former
        for i, former in enumerate(self._former):
            try:
                joined = former.joined(present)
            except AllanError:  # another rate
                continue
            return [*self._former[:i], joined, *self._former[i + 1 :]]
        return [*self._former, present]

    @property
    def means(self) -> Means | None:
        """The latest means of static samples over a second, if they are kept."""
        return None if self._means is None else self._means.means

    def feed(self, stamps: Stamps, rows: Floats) -> None:
        """Take samples of the six-axis stream: stamps (n,) in ns, rows (6, n)."""
        own = self._filter.feed(*self._own.pick(stamps, rows))
        if self._clock is not None:
            self._advance(self._clock.feed(*own))
            return
        a, b = self._learning, own
        self._learning = (
            np.concatenate([a[0], b[0]]),
            np.concatenate([a[1], b[1]], axis=1),
            np.concatenate([a[2], b[2]]),
        )
        if len(self._learning[0]) >= LEARN:
            self._learn()

    def flush(self) -> None:
        """Process all buffered samples at the end of the input, and close the segment."""
        while True:
            if self._clock is None:
                self._learn()
            if self._clock is None:
                break
            self._pass_on(self._clock.flush())
            if not self._clock.rate_changed:
                break
            self._change_rate()
        self._end_gate()

    def _learn(self) -> None:
        """Learn the clock from the first samples, then take them all."""
        clock = learn_clock(self._learning[0][:LEARN])
        waiting = self._learning
        self._learning = _nothing(len(self.plan.axes))
        if clock is None:
            # equal stamps give no time; kept, they would fill the memory
            self.counts.untimed += len(waiting[0])
            return
        settings, axes = self._wanted.settings, self.plan.axes
        self._clock = SampleClock(clock, len(axes), settings.max_bridge, self.counts)
        if settings.motion_gate:
            self._gate = MotionGate(
                clock.period_ns, axes, self.counts, settings.motion_ratio, settings.rate_limit
            )
        self._advance(self._clock.feed(*waiting))

    def _advance(self, blocks: list[Block]) -> None:
        self._pass_on(blocks)
        if self._clock is not None and self._clock.rate_changed:
            self._change_rate()
            if len(self._learning[0]) >= LEARN:
                self._learn()

    def _change_rate(self) -> None:
        """Keep the sums of the former rate, and start to learn the new one."""
        assert self._clock is not None
        self._end_gate()
        self.counts.cuts['rate change'] += 1
        longest_first = sorted(self.by_rate(), key=lambda each: -each.sums.elapsed_ns)
        self._former = longest_first[:KEPT_RATES]
        stamps, rows = self._clock.waiting
        self._start((stamps.copy(), rows.copy(), np.zeros(len(stamps), bool)))

    def _end_gate(self) -> None:
        if self._gate is not None:
            for block in self._gate.flush():
                self._accumulate(block)
        self._close_segment()

    def _pass_on(self, blocks: list[Block]) -> None:
        for block in blocks if self._gate is None else self._gate.feed(blocks):
            self._accumulate(block)

    def _accumulate(self, block: Block) -> None:
        if block.cut == RELEARNED:
            self.counts.moving += self._engine.sums.samples
            self.counts.used -= self._engine.sums.samples
            self.relearned += 1
            self._clear()
        elif block.cut:
            self._close_segment()
        if not len(block):
            return
        if not self._engine.open_samples:
            self._start_ns, self._cut = int(block.stamps[0]), block.cut
        self._end_ns = int(block.stamps[-1])
        self.counts.used += len(block)
        self._filled.add(block.filled)
        self._engine.update(block.rows.T, int(block.stamps[0]), self._end_ns)
        if self._means is not None:
            self._means.update(block.stamps, block.rows)
        if self._spectrum is not None:
            self._spectrum.update(block.rows)

    def _close_segment(self) -> None:
        samples = self._engine.open_samples
        if not samples:
            return
        length = (self._end_ns - self._start_ns) * 1e-9
        insort(self._segments, (samples, Segment(self._start_ns, samples, length, self._cut)))
        del self._segments[:-LISTED_SEGMENTS]
        self._engine.end_segment()
        self._filled.end()
        if self._means is not None:
            self._means.cut()
        if self._spectrum is not None:
            self._spectrum.end_segment()


def _nothing(axes: int) -> Samples:
    return np.empty(0, np.int64), np.empty((axes, 0)), np.empty(0, bool)
