# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Prepares the samples of a stream: chooses stamps, sorts samples, and excludes unusable samples.

Duplicates, samples that are not finite, samples with backward stamps (until the clock is known to
have been set back), and samples of a time that earlier samples cover are excluded. Short sequences
of samples that a driver repeats at random are interpolated.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..findings import Finding, finding
from ..imu import (
    AXES,
    EPOCH_S,
    LARGEST,
    NANOSECONDS,
    STAMP_UNITS,
    Flags,
    Floats,
    ImuBatch,
    Stamps,
    even_stamps,
    joined,
)
from .health import Counts
from .sensors import SensorPlan
from .timing import has_time

BACKWARD_RUN = 16
"""If this many consecutive samples have stamps earlier than the latest stamp, the clock was set
back. After jumps in short succession, more samples are required (`JUMP_DISTANCE`). All but the last
of these samples are excluded."""

JUMP_DISTANCE = 4096
"""The clock counts as set back after a number of consecutive samples with backward stamps. This
number is `BACKWARD_RUN` at first. It is doubled if the clock is set back within `JUMP_DISTANCE`
samples after the start, or after the clock was last set back. Otherwise, it becomes `BACKWARD_RUN`
again. Without the doubling, stamps in random order would split the data very often."""

REORDER = 32
"""Longest delay, in sample periods, of a sample that is sorted because it arrived out of order."""

DISORDERED_SHARE = 0.25
"""If more than this share of the stamps are earlier than the previous stamp after sorting over
`REORDER` places, the stamps are not used."""

SLOWEST_S = 0.1
"""Longest sample period, in s, for which the unit of the stamps is recognized."""


NEAR_NS = NANOSECONDS
"""Longest time between two consecutive stamps, in ns, that counts as covered by samples."""

NEVER_NS = -(2**62)
"""A stamp in ns that is earlier than the stamp of any sample."""

MOST_COVERED = 256
"""Largest number of covered stretches of time that are stored; the oldest are removed first."""


def unit_of_stamps(stamps: Stamps) -> str:
    """Return the unit of one or more integer stamps, (n,): 'us', 'ms' or 'ns'.

    The unit is 'us' or 'ms' if the stamps in this unit are times since 1970 (`EPOCH_S`), and the
    median magnitude of their steps is above 0 and at most `SLOWEST_S`. Otherwise, the unit is 'ns'.

    >>> import numpy as np
    >>> unit_of_stamps(1_700_000_000_000_000 + 5000 * np.arange(9))
    'us'
    """
    step = np.median(np.abs(np.diff(stamps))) if len(stamps) > 1 else 0
    for unit in ('us', 'ms'):
        ticks_per_second = NANOSECONDS // STAMP_UNITS[unit]
        low, high = (limit * ticks_per_second for limit in EPOCH_S)
        if low <= stamps.min() and stamps.max() < high and 0 < step <= SLOWEST_S * ticks_per_second:
            return unit
    return 'ns'


class StampChoice:
    """Chooses the stamps of a stream: from the header, the record times, or the declared rate."""

    def __init__(self, use_record: bool, declared_rate: float) -> None:
        self.use_record = self._is_record_wanted = use_record
        self._rate = declared_rate
        self._unit = 1  # size of the unit of the stamps in ns
        self._unusable = False  # whether the stamps are too disordered to be sorted

        # number of samples whose stamps were computed from the rate; None if the rate is not used
        self._computed: int | None = None

    def learn(self, first: ImuBatch) -> list[Finding]:
        """Choose the stamps from the first samples, and return the findings about the choice."""
        stamps = first.stamps_ns
        self.use_record = self._is_record_wanted and first.record_ns is not None
        if self.use_record:
            return []
        self._unit, self._unusable = 1, False
        fault_of_equal_stamps = (
            'all equal' if len(stamps) < 2 or stamps.min() == stamps.max() else 'mostly equal'
        )
        fault = fault_of_equal_stamps if stamps.any() else 'all zero'
        if len(stamps) < 2 or has_time(np.sort(stamps)):
            if are_ordered(first):
                unit = unit_of_stamps(stamps)
                self._unit, self._computed = STAMP_UNITS[unit], None
                return [finding('stamps_unit', unit=unit)] if unit != 'ns' else []
            fault, self._unusable = 'in no order', True
        if first.record_ns is not None:
            self.use_record = True
            return [finding('stamps_unusable', what=fault)]
        if self._rate:
            self._computed = self._computed or 0
            return [finding('stamps_from_rate', what=fault, rate=self._rate)]
        return [finding('stamps_missing', what=fault)]

    def of(self, batch: ImuBatch) -> ImuBatch:
        """Return ``batch``, the next samples, with the stamps that `learn` has chosen.

        Record times are used only if ``batch`` has them. The result has no record times.
        """
        stamps = batch.stamps_ns
        if self.use_record and batch.record_ns is not None:
            stamps = batch.record_ns
        elif self._computed is not None:
            stamps = even_stamps(self._computed, len(batch), self._rate)
            self._computed += len(batch)
        elif self._unusable:
            stamps = np.zeros_like(stamps)  # `SampleClock` counts samples at time 0 as untimed
        elif self._unit > 1:
            stamps = stamps * self._unit
        return ImuBatch(stamps, batch.samples)


class StampSorter:
    """Sorts samples that arrive slightly out of order, for example over UDP.

    Windows of 2 * `REORDER` samples, which overlap by half, are sorted. A window with a sample that
    is delayed by more than about `REORDER` sample periods is not sorted, because the clock was
    probably set back within the window, or the stamps come from two clocks. ``sorted`` is the
    number of late samples in the windows that were sorted.
    """

    def __init__(self, stamps: Stamps = np.empty(0, np.int64)) -> None:
        """Compute the longest delay of a late sample that is sorted into its place.

        ``stamps``, (n,), are the first stamps in ns. With fewer than two, no sample is sorted.
        """
        self.sorted = 0
        places = min(len(stamps) - 1, REORDER)
        sorted_stamps = np.sort(stamps)
        # longest delay, in ns, of a late sample that is sorted into its place
        self._longest_ns = (
            np.median(sorted_stamps[places:] - sorted_stamps[:-places]) if places > 0 else 0.0
        )
        self._pending = ImuBatch.empty(len(AXES))
        self._latest: int | None = None  # stamp of the last sample that was returned

    def feed(self, samples: ImuBatch) -> list[ImuBatch]:
        """Add samples of the six axes, and return the samples whose order is final, in parts."""
        pending = self._pending
        number = ((len(pending) + len(samples)) // REORDER - 1) * REORDER
        end = number - len(pending)  # number of samples of ``samples`` whose order is final
        if end > 0 and self._is_sorted(np.concatenate([pending.stamps_ns, samples.stamps_ns])):
            self._latest = int(samples.stamps_ns[end - 1])
            self._pending = samples.part(slice(end, None)).copy()
            return [pending, samples.part(slice(end))]
        # a copy, because the samples are sorted in place
        self._pending = joined([pending, samples], copy=True)
        return [self._take(number)]

    def flush(self) -> ImuBatch:
        """Return the buffered samples at the end of the input, sorted as far as possible."""
        return self._take(len(self._pending))

    @classmethod
    def all_sorted(cls, samples: ImuBatch) -> ImuBatch:
        """Return the samples of a complete input, sorted as far as possible (see the class)."""
        sorter = cls(samples.stamps_ns)
        return joined([*sorter.feed(samples), sorter.flush()])

    def _is_sorted(self, stamps: Stamps) -> bool:
        """Return whether the next stamps, (n,), are in order and not before the latest stamp."""
        is_after_latest = self._latest is None or stamps[0] >= self._latest
        return is_after_latest and bool((stamps[1:] >= stamps[:-1]).all())

    def _take(self, number: int) -> ImuBatch:
        """Remove and return the first ``number`` buffered samples, sorted as far as possible."""
        stamps, rows = self._pending.stamps_ns, self._pending.rows
        if number < 1:
            return self._pending.part(slice(0))
        latest = int(stamps[0]) if self._latest is None else self._latest
        is_sorted = self._is_sorted(stamps)
        for begin in range(0, 0 if is_sorted else number, REORDER):
            window = stamps[begin : begin + 2 * REORDER]
            delay = np.maximum(np.maximum.accumulate(window), latest) - window
            if delay.any() and delay.max() <= self._longest_ns:
                order = begin + np.argsort(window, kind='stable')
                self.sorted += int(np.count_nonzero(delay))
                stamps[begin : begin + len(order)] = stamps[order]
                rows[:, begin : begin + len(order)] = rows[:, order]
            latest = int(stamps[min(begin + REORDER, len(stamps)) - 1])
        self._latest = int(stamps[number - 1]) if is_sorted else latest
        taken = self._pending.part(slice(number))
        self._pending = self._pending.part(slice(number, None)).copy()
        return taken


def are_ordered(samples: ImuBatch) -> bool:
    """Return whether the stamps of samples advance and are in order after sorting.

    `StampSorter` sorts the samples. Then at most `DISORDERED_SHARE` of the stamps may be earlier
    than the previous stamp. The result is True for fewer than two samples.

    >>> import numpy as np
    >>> stamps = np.arange(100) * 10**7
    >>> [are_ordered(ImuBatch(t, np.zeros((100, 6)))) for t in (stamps, stamps[::-1], 0 * stamps)]
    [True, False, False]
    """
    stamps = samples.stamps_ns
    if len(stamps) > 1 and not has_time(np.sort(stamps)):
        return False
    is_backward = np.diff(StampSorter.all_sorted(ImuBatch(stamps, samples.samples)).stamps_ns) < 0
    return bool(np.count_nonzero(is_backward) <= DISORDERED_SHARE * len(stamps))


class CoveredTime:
    """Excludes samples whose time is already covered, as when a recording is played again.

    ``covered`` lists the stretches of time that earlier data cover: (first, last) stamp in ns. Each
    kept sample covers the time since the previous stamp, if this time is at most `NEAR_NS`. A
    sample with the stamp of the previous sample is kept if the previous sample is kept. At most
    `MOST_COVERED` stretches are stored. ``dropped`` is the number of excluded samples.
    """

    def __init__(self, covered: Sequence[tuple[int, int]] = ()) -> None:
        self.dropped = 0
        self._stretches = [[first, last] for first, last in covered[-MOST_COVERED:]]
        # first and last stamp, in ns, of the covered stretch that contains the latest sample
        self._present = [NEVER_NS, NEVER_NS]
        self._was_new = False  # whether the latest sample was kept

    def feed(self, samples: ImuBatch) -> ImuBatch:
        """Return the samples whose time is not covered yet, and mark their time as covered."""
        stamps = samples.stamps_ns
        if not len(stamps):
            return samples
        last, present = int(stamps[-1]), self._present
        steps = np.diff(stamps, prepend=present[1])
        continues_stretch = (
            steps[0] >= (not self._was_new) and steps.min() >= 0 and steps.max() <= NEAR_NS
        )
        if continues_stretch and not any(
            begin <= last and present[1] < end for begin, end in self._stretches
        ):
            present[1], self._was_new = last, True
            return samples
        is_new = np.fromiter(map(self._is_new, stamps.tolist()), bool, len(stamps))
        self.dropped += int(np.count_nonzero(~is_new))
        return samples.part(is_new)

    def _is_new(self, stamp: int) -> bool:
        """Return whether the sample with this stamp is kept; if so, mark its time as covered."""
        if self._was_new and stamp == self._present[1]:
            return True
        for stretch in self._stretches:
            if stretch[0] <= stamp <= stretch[1]:
                self._present, self._was_new = stretch, False
                return False
        if not 0 <= stamp - self._present[1] <= NEAR_NS:
            self._present = [stamp, stamp]
            self._stretches = [*self._stretches[1 - MOST_COVERED :], self._present]
        self._present[1], self._was_new = stamp, True
        return True


class SampleFilter:
    """Selects the axes of a sensor stream, and excludes samples that cannot be used.

    Samples of the kind ``plan.drop`` ('repeated' or 'zero'), samples with a value that is not
    finite or of a magnitude above `LARGEST`, duplicates, and samples with backward stamps
    (`BACKWARD_RUN`) are excluded. A duplicate has the stamp and the values of the previous sample.
    The stamps of the remaining samples decrease only where the clock was set back. ``counts`` is
    updated in place.
    """

    def __init__(self, plan: SensorPlan, counts: Counts) -> None:
        self._drop = plan.drop
        self._axes = [AXES.index(axis) for axis in plan.axes]
        # values of the last received sample, with which the next sample is compared
        self._measured: Floats = np.full(len(self._axes), np.nan)
        self._counts = counts
        self._latest: int | None = None  # stamp of the last sample that was returned
        self._last = 0, self._measured  # stamp and values of the last finite sample
        self._backward = 0  # number of consecutive samples with backward stamps

        # value of `_backward` that shows that the clock was set back (see `JUMP_DISTANCE`)
        self._needed = BACKWARD_RUN
        self._position = 0  # number of finite samples so far
        self._last_jump = 0  # value of `_position` when the clock was last set back

    def feed(self, samples: ImuBatch) -> ImuBatch:
        """Return the usable samples of a batch of six axes, with the axes of the plan."""
        if len(self._axes) < len(AXES):
            samples = ImuBatch.of_rows(samples.stamps_ns, samples.rows[self._axes])
        if self._drop == 'zero':
            samples = samples.part(np.asarray(samples.rows.any(axis=0)))
        elif self._drop and len(samples):
            rows, last_values = samples.rows, self._measured
            self._measured = rows[:, -1].copy()
            has_changed = rows != np.column_stack([last_values, rows[:, :-1]])
            samples = samples.part(np.asarray(has_changed.any(axis=0)))
        rows = samples.rows
        if len(samples) and not (rows.max() <= LARGEST and rows.min() >= -LARGEST):
            is_finite = np.asarray((np.abs(rows) <= LARGEST).all(axis=0))
            self._counts.not_finite += int(np.count_nonzero(~is_finite))
            samples = samples.part(is_finite)
        if not len(samples):
            return samples
        stamps, number = samples.stamps_ns, len(samples)
        last_sample = int(stamps[-1]), samples.rows[:, -1].copy()
        latest = stamps[0] - 1 if self._latest is None else self._latest
        if stamps[0] <= latest or (stamps[1:] <= stamps[:-1]).any() or self._backward:
            samples = samples.part(self._select(samples))
        self._last, self._position = last_sample, self._position + number
        if len(samples):
            self._latest = int(samples.stamps_ns[-1])
        return samples

    def _select(self, samples: ImuBatch) -> Flags:
        """Return which samples are neither duplicates nor excluded for a backward stamp, (n,)."""
        stamps, rows = samples.stamps_ns, samples.rows
        last_stamp, last_values = self._last
        repeats_values = (rows == np.column_stack([last_values, rows[:, :-1]])).all(axis=0)
        is_duplicate = repeats_values & (np.diff(stamps, prepend=last_stamp) == 0)
        self._counts.duplicate += int(np.count_nonzero(is_duplicate))
        is_kept = np.asarray(~is_duplicate)
        latest = stamps[0] if self._latest is None else self._latest
        for i in np.flatnonzero(is_kept):
            if stamps[i] < latest:
                self._backward += 1
                if self._backward < self._needed:
                    is_kept[i] = False
                    self._counts.backward += 1
                    continue
                self._counts.splits['clock jump'] += 1
                position = self._position + int(i)
                is_recent = position - self._last_jump < JUMP_DISTANCE
                self._needed = 2 * self._needed if is_recent else BACKWARD_RUN
                self._last_jump = position
            self._backward = 0
            latest = stamps[i]
        return is_kept


LONGEST_REPEAT = 16
"""Largest number of consecutive repeated samples that are interpolated. A sensor that repeats a
sample more often may be stuck."""


class RepeatFilter:
    """Interpolates the samples of evenly spaced blocks that repeat the previous sample.

    ``groups`` are lists of indices of axes. A sample that equals the previous sample on all axes of
    a group is interpolated on these axes, unless more than `LONGEST_REPEAT` such samples follow one
    another, or the segment ends before a new value. The last `LONGEST_REPEAT` samples are buffered
    until more samples follow or the segment ends.
    """

    def __init__(self, groups: list[list[int]], axes: int) -> None:
        self._groups = groups
        self._empty = self._samples = ImuBatch.empty(axes)
        self._returned = 0  # number of buffered samples that were already returned

    def feed(self, blocks: list[ImuBatch]) -> list[ImuBatch]:
        """Add blocks, and return the samples whose interpolation is complete."""
        complete_blocks: list[ImuBatch] = []
        for block in filter(len, blocks):
            complete_blocks += self.flush() if block.cut else []
            self._samples = joined([self._samples, block])
            complete_blocks += self._take(LONGEST_REPEAT)
        return complete_blocks

    def flush(self) -> list[ImuBatch]:
        """Return the buffered samples at the end of a segment; repeats at the end are unchanged."""
        blocks = self._take(0)
        self._samples, self._returned = self._empty, 0
        return blocks

    def _take(self, look_ahead: int) -> list[ImuBatch]:
        """Return the next samples except the last ``look_ahead``, with interpolated repeats."""
        buffered, begin = self._samples, self._returned
        n, end = len(buffered), len(buffered) - look_ahead
        if end <= begin:
            return []
        rows, index = buffered.rows.copy(), np.arange(n)
        filled = (
            np.zeros(rows.shape, np.int32) if buffered.filled is None else buffered.filled.copy()
        )
        for group in self._groups:
            is_repeated = np.zeros(n, bool)
            is_repeated[1:] = (buffered.rows[group, 1:] == buffered.rows[group, :-1]).all(axis=0)
            last_new = np.maximum.accumulate(np.where(is_repeated, -1, index))
            next_new = np.minimum.accumulate(np.where(is_repeated, n, index)[::-1])[::-1]
            replaced_at = np.flatnonzero(
                is_repeated & (next_new < n) & (next_new - last_new <= LONGEST_REPEAT + 1)
            )
            index_before, index_after = last_new[replaced_at], next_new[replaced_at]
            fraction = (replaced_at - index_before) / (index_after - index_before)
            for axis in group:
                value_before = buffered.rows[axis, index_before]
                rows[axis, replaced_at] = value_before + fraction * (
                    buffered.rows[axis, index_after] - value_before
                )
                filled[axis, replaced_at] = 1
        interpolated = ImuBatch.of_rows(
            buffered.stamps_ns, rows, filled=filled if filled.any() else None
        )
        # a run of repeats that begins before these samples is too long to be interpolated
        first_kept = max(0, end - LONGEST_REPEAT - 1)
        self._samples = buffered.part(slice(first_kept, None)).copy()
        self._returned = end - first_kept
        return [interpolated.part(slice(begin, end), buffered.cut if begin == 0 else '')]
