# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Allan sums and means of a recording by age, to test whether its noise changes with time.

The age of a sample is the number of sample periods since the first sample of its recording.

- `AgeBin`: the Allan sums of the second differences that *start* in a range of ages. The bins add
  up to the sums of the recording, at all averaging factors. Edges lie at 2^k and 1.5 * 2^k samples,
  which gives about 13 bins at any length. The early part of a recording (its warm-up) can be
  removed from the sums by leaving out the first bins.
- `Recording`: the means over fewer than 512 cells (time intervals of equal length), and the sums of
  squares over about 100 periods (time intervals that are shorter toward the end) at the averaging
  factors 1, 4, 16 ... The stationarity tests and the comparison of recent with earlier noise use
  them.

All values depend only on the samples and their number, so they are the same for any chunking.
Values of several recordings can be added.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FIRST_EDGE = 256
"""Age in samples of the first edge between two bins."""

EARLIEST_PART = 64
"""Bins that end before 1/64 of the recording are merged into the first one. The phase record has at
most 128 points, which is too few to leave out a shorter part exactly."""

CELLS, MERGED_CELLS = 512, 64
"""A single recording has fewer than 512 cells. If several recordings are added, each of them is
reduced to fewer than 64."""

LONGEST_PERIOD, PERIOD_DISTANCE = 32, 4
"""A period is at most 1/32 of the length of its recording, and at most 1/4 of the time from its end
to the end of the recording."""

MERGED_PERIODS = 16
"""If several recordings are added, each of them except the latest is reduced to fewer periods than
this."""

SHORTEST_PERIODS = (128, 2048)
"""Length in samples of the shortest period: 128 in a short recording, 2048 in one of 2e6 samples or
more."""

PERIOD_OVER_FACTOR = 16
"""A period has sums at the averaging factors up to 1/16 of its length."""

KEPT_RECORDINGS = 32
"""Number of recordings whose means and periods are kept; the others contribute only to the bins."""

MAX_STORED_PERIODS = 512
"""Number of stored periods above which short ones are merged."""

PooledCount = tuple[int, int, int]
"""Index of a length class, number of its segments that begin in an age bin, and their samples."""


def age_bin(age: int) -> int:
    """Return the index of the age bin that contains an age (samples since the recording began)."""
    if age < FIRST_EDGE:
        return 0
    octave = age.bit_length() - 1
    return 2 * (octave - FIRST_EDGE.bit_length()) + 3 + (2 * age >= 3 << octave)


def edge_age(index: int) -> int:
    """Return the age in samples at which an age bin begins."""
    if index == 0:
        return 0
    octave, upper = divmod(index - 1, 2)
    return (FIRST_EDGE << octave) * (2 + upper) // 2


def cell_step(length: int, cells: int) -> int:
    """Return the length in samples of the cells (equal intervals) of a recording.

    It is the smallest power of two for which ``length`` samples have fewer than ``cells`` cells.
    """
    return 1 << (length // cells).bit_length()


def shortest_period(length: int) -> int:
    """Return the length in samples of the shortest periods, at the end of a recording."""
    shortest, longest = SHORTEST_PERIODS
    return min(max(shortest, cell_step(length, longest)), longest)


def period_begins(length: int, begin: int = 0) -> Ints:
    """Return the ages in samples at which the periods of a recording begin, (periods,).

    The first period returned contains the age ``begin``. The length of a period is a power of two,
    and it begins at a multiple of its length. It is at most 1/32 of the recording, and at most 1/4
    of the time from its end to the end of the recording. As the recording grows, periods are merged
    but never split.
    """
    begins = []
    shortest = shortest_period(length)
    while begin < length:
        period = shortest
        while LONGEST_PERIOD * 2 * period <= length and (
            (1 + PERIOD_DISTANCE) * 2 * period <= length - begin // (2 * period) * 2 * period
        ):
            period *= 2
        begins.append(begin // period * period)
        begin = begins[-1] + period
    return np.array(begins, np.int64)


def starts_before(ages: Ints, m: Ints | int, stride: Ints | int, offset: int, samples: int) -> Ints:
    """Return the number of second differences of a segment that start before each of ``ages``.

    ``m`` is the averaging factor and ``stride`` the number of samples between two starts; both
    broadcast with ``ages``. The segment has ``samples`` samples, the first at the age ``offset``.
    """
    ends = np.maximum(samples - 2 * np.asarray(m) + 1, 0)  # all starts are smaller than this
    return np.asarray(-(-np.clip(ages - offset, 0, ends) // stride))


def round_to_stored(values: Floats) -> Floats:
    """Return values rounded to 16 significant bits, the precision of stored histories."""
    bits = np.ascontiguousarray(values, '<f8').view('<u8')
    even = bits + ((bits >> 37) & 1) + ((1 << 36) - 1)
    return np.asarray((even >> 37 << 37).view('<f8'))


@dataclass
class PeriodSums:
    """Sums of squared second differences by period (time interval), at one averaging factor."""

    m: int  # averaging factor in samples
    begins: list[int]  # ages at which the periods begin
    sums: list[Floats]  # (axes,) of each period

    def shortest(self, length: int) -> int:
        """Return the length of the shortest period of a recording of ``length``, in samples."""
        return max(shortest_period(length), PERIOD_OVER_FACTOR * self.m)

    def add(self, begins: range, sums: Floats) -> None:
        """Add sums, (periods, axes), of consecutive periods that begin at the ages ``begins``.

        If the first of them lies in the last stored period, its sums are added to that period.
        """
        if self.begins and begins[0] <= self.begins[-1]:
            self.sums[-1] = self.sums[-1] + sums[0]
            begins, sums = begins[1:], sums[1:]
        self.begins.extend(begins)
        self.sums.extend(sums)

    def over(self, begins: Ints, axes: int) -> Floats:
        """Return the sums over longer periods that begin at ``begins``, (periods, axes)."""
        return regrouped(np.reshape(self.sums, (-1, axes)), np.array(self.begins, int), begins)

    def merge(self, length: int) -> None:
        """Merge short periods if more than `MAX_STORED_PERIODS` are stored.

        ``length`` is the length of the recording in samples, which determines the new periods.
        """
        if len(self.begins) > MAX_STORED_PERIODS:
            coarser = period_begins(length, self.begins[0])
            self.sums = list(self.over(coarser, len(self.sums[0])))
            self.begins = coarser.tolist()


class ByValue:
    """Base class of dataclasses with array fields; adds a ``==`` that compares the arrays."""

    def __eq__(self, other: object) -> bool:
        """Return whether type and all fields are equal."""
        if type(self) is not type(other):
            return False
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))  # type: ignore[arg-type]
        return all(
            np.array_equal(x, y) if isinstance(x, np.ndarray) else bool(x == y) for x, y in pairs
        )


@dataclass(frozen=True, eq=False)
class AgeBin(ByValue):
    """Allan sums of the second differences that start in one range of ages (in samples)."""

    index: int  # begins at the age ``edge_age(index)``, ends where the next bin of a history begins
    count: Ints  # (factors,) number of second differences
    sum_sq: Floats  # (factors, axes) sum of their squares
    # segments that begin in the bin and are pooled in a length class, without a record of their own
    pooled: tuple[PooledCount, ...]
    ramp: Floats  # (factors, axes) sum of the ramp corrections of these segments

    def __add__(self, other: AgeBin) -> AgeBin:
        """Return the sum of both bins; it has the smaller of the two indices."""
        return AgeBin(
            min(self.index, other.index),
            add_padded(self.count, other.count),
            add_padded(self.sum_sq, other.sum_sq),
            _add_pooled(self.pooled, other.pooled),
            add_padded(self.ramp, other.ramp),
        )


@dataclass(frozen=True, eq=False)
class Recording(ByValue):
    """Means and short-term variances of one recording by age."""

    start_ns: int  # stamp of the first sample
    length: int  # length in sample periods, including gaps
    samples: int  # number of samples, without those missing in gaps
    step: int  # length of a cell in samples, a power of two
    cell_samples: Ints  # (cells,) number of samples in each cell, 0 in gaps
    cell_means: Floats  # (cells, axes) mean of these samples minus ``reference``; 0 without samples
    reference: Floats  # (axes,) first sample of the recording
    period_begin: Ints  # (periods,) ages at which the periods begin, see `period_begins`
    # (periods, levels) number of second differences that start in each period, at the averaging
    # factors 1, 4, 16 ... (one per level)
    level_count: Ints
    level_sum_sq: Floats  # (periods, levels, axes) sum of their squares

    @property
    def order(self) -> tuple[int, int]:
        """Sort key: most samples first, then earliest start."""
        return (-self.samples, self.start_ns)

    @property
    def mean(self) -> Floats:
        """Mean of all samples, (axes,)."""
        weights = self.cell_samples / max(int(self.cell_samples.sum()), 1)
        return np.asarray(self.reference + weights @ self.cell_means)

    @property
    def level_m(self) -> Ints:
        """Averaging factors 1, 4, 16 ... of ``level_count`` and ``level_sum_sq``, (levels,)."""
        return 4 ** np.arange(self.level_count.shape[1])

    def cells(self, first: int, last: int | None = None) -> Recording:
        """Return a copy with only the cells ``first`` to ``last`` - 1; periods are unchanged."""
        number, means = self.cell_samples[first:last], self.cell_means[first:last]
        return replace(self, cell_samples=number, cell_means=means)

    def coarser(self, cells: int, begins: Ints) -> Recording:
        """Return a copy with fewer than ``cells`` cells, and periods that begin at ``begins``."""
        step = max(cell_step(self.length, cells), self.step)
        number, means = self.cell_samples, self.cell_means
        if step > self.step:
            sums = means * number[:, None]
            for _ in range(step.bit_length() - self.step.bit_length()):
                number, sums = _pair_sums(number), _pair_sums(sums)
            means = sums / np.maximum(number, 1)[:, None]
        return replace(
            self,
            step=step,
            cell_samples=number,
            cell_means=means,
            period_begin=begins,
            level_count=regrouped(self.level_count, self.period_begin, begins),
            level_sum_sq=regrouped(self.level_sum_sq, self.period_begin, begins),
        )

    def summary(self) -> Recording:
        """Return a smaller copy, with fewer than 64 cells and 16 periods."""
        period = cell_step(self.length, MERGED_PERIODS)
        return self.coarser(MERGED_CELLS, np.unique(self.period_begin // period * period))

    def rounded(self) -> Recording:
        """Return a copy rounded by `round_to_stored`."""
        means, squares = round_to_stored(self.cell_means), round_to_stored(self.level_sum_sq)
        return replace(self, cell_means=means, level_sum_sq=squares)

    def continued(self, later: Recording) -> Recording:
        """Return this recording extended by a later segment of it.

        The ages of ``later`` count from the first sample of this recording.
        """
        length = max(self.length, later.length)
        begins = period_begins(length)
        a = replace(self, length=length).coarser(CELLS, begins)
        b = replace(later, length=length).coarser(CELLS, begins)
        number = add_padded(a.cell_samples, b.cell_samples)
        shifted = b.cell_means + (b.reference - a.reference)
        sums = add_padded(a.cell_means * a.cell_samples[:, None], shifted * b.cell_samples[:, None])
        return replace(
            a,
            samples=a.samples + b.samples,
            cell_samples=number,
            cell_means=sums / np.maximum(number, 1)[:, None],
            level_count=add_padded(a.level_count, b.level_count, 1),
            level_sum_sq=add_padded(a.level_sum_sq, b.level_sum_sq, 1),
        )


@dataclass(frozen=True, eq=False)
class History(ByValue):
    """Sums by age of one recording, or of several recordings, whose sums at equal ages are added.

    It is empty for sums from a document without a history, and for the sums of zero samples.
    """

    first: int = 1  # index of the second bin: all smaller ages belong to the bin of index 0
    bins: tuple[AgeBin, ...] = ()  # sorted by index; bins without a difference are left out
    # the latest recording and the 31 longest others, longest first
    recordings: tuple[Recording, ...] = ()
    recording_count: int = 0  # number of recordings in the sums; may exceed len(recordings)

    @classmethod
    def of_segment(cls, bins: Iterable[AgeBin], recording: Recording) -> History:
        """Return the history of a recording with a single segment."""
        return cls(1, tuple(bins), (recording,), 1)._merged_below(_first_edge(recording.length))

    @property
    def ages(self) -> tuple[int, ...]:
        """Ages in samples at which the bins begin, except the first bin."""
        return tuple(edge_age(b.index) for b in self.bins[1:])

    @property
    def length(self) -> int:
        """Length of the longest recording in sample periods; 0 without recordings."""
        return max((r.length for r in self.recordings), default=0)

    def continued(self, later: History) -> History:
        """Return the history of one recording extended by a later segment of it."""
        if not self.recordings or not later.recordings:
            return self if self.recordings else later
        one = self.recordings[0].continued(later.recordings[0])
        first = _first_edge(one.length)
        bins = _add_bins(self._merged_below(first).bins, later._merged_below(first).bins)
        return History(first, bins, (one,), 1)

    def __add__(self, other: History) -> History:
        """Return the history of the recordings of both; sums at equal ages are added.

        If one history is empty, the other is returned.
        """
        if not self.recordings or not other.recordings:
            return self if self.recordings else other
        first = max(self.first, other.first)
        recordings = sorted(self.recordings + other.recordings, key=lambda r: r.order)
        latest = max(recordings, key=lambda r: (r.start_ns, r.length))
        others = [r.summary() for r in recordings if r is not latest][: KEPT_RECORDINGS - 1]
        return History(
            first,
            _add_bins(self._merged_below(first).bins, other._merged_below(first).bins),
            tuple(sorted((*others, latest), key=lambda r: r.order)),
            self.recording_count + other.recording_count,
        ).rounded()

    def rounded(self) -> History:
        """Return a copy rounded by `round_to_stored`."""
        return replace(
            self,
            bins=tuple(replace(b, sum_sq=round_to_stored(b.sum_sq)) for b in self.bins),
            recordings=tuple(r.rounded() for r in self.recordings),
        )

    def with_pooled(self, pooled: Iterable[tuple[int, PooledCount, Floats]]) -> History:
        """Return a copy with pooled segments added to the age bins in which they begin.

        These are segments of which only the sums are kept. ``pooled`` contains, for each of them,
        the age of its first sample, its `PooledCount` and its `LengthClass.ramp_correction`.
        """
        more = [
            AgeBin(
                index if (index := age_bin(age)) >= self.first else 0,
                np.zeros(0, np.int64),
                ramp[:0],
                (number,),
                ramp,
            )
            for age, number, ramp in pooled
        ]
        return replace(self, bins=_add_bins(self.bins, more))

    def _merged_below(self, first: int) -> History:
        """Return a copy with all bins below the index ``first`` merged into one."""
        if first <= self.first:
            return self
        early = [b for b in self.bins if b.index < first]
        late = [b for b in self.bins if b.index >= first]
        if early:
            merged = reduce(operator.add, early)
            late.insert(0, replace(merged, index=0))
        return replace(self, first=first, bins=tuple(late))


def add_padded(a: NDArray, b: NDArray, axis: int = 0) -> NDArray:  # type: ignore[type-arg]
    """Return a + b; the shorter of the two is padded with zeros along ``axis``."""
    if a.shape[axis] < b.shape[axis]:
        a, b = b, a
    out = a.copy()
    out[(slice(None),) * axis + (slice(b.shape[axis]),)] += b
    return out


def _first_edge(length: int) -> int:
    """Return the index of the first bin that begins at ``length``/64 or later, at least 1."""
    index = max(1, age_bin(max(length // EARLIEST_PART, 1)))
    return index if edge_age(index) * EARLIEST_PART >= length else index + 1


def regrouped(values: NDArray, begins: Ints, coarser: Ints) -> NDArray:  # type: ignore[type-arg]
    """Return the rows of ``values`` added up over longer periods.

    Row i belongs to the period that begins at the age ``begins[i]``. The longer periods begin at
    the ages ``coarser`` and must consist of complete periods. The result has one row for each.
    """
    rows, first = np.unique(np.searchsorted(coarser, begins, 'right') - 1, return_index=True)
    out = np.zeros((len(coarser), *values.shape[1:]), values.dtype)
    if len(rows):
        out[rows] = np.add.reduceat(values, first)
    return out


def _pair_sums(values: NDArray) -> NDArray:  # type: ignore[type-arg]
    """Return the sums of rows 0 and 1, 2 and 3, and so on; an unpaired last row is unchanged."""
    if len(values) % 2:
        values = np.concatenate([values, np.zeros_like(values[:1])])
    return np.asarray(values[::2] + values[1::2])


def _add_pooled(a: tuple[PooledCount, ...], b: tuple[PooledCount, ...]) -> tuple[PooledCount, ...]:
    total: dict[int, PooledCount] = {}
    for index, count, samples in a + b:
        _, counts, lengths = total.get(index, (index, 0, 0))
        total[index] = (index, counts + count, lengths + samples)
    return tuple(total[index] for index in sorted(total))


def _add_bins(a: Iterable[AgeBin], b: Iterable[AgeBin]) -> tuple[AgeBin, ...]:
    total: dict[int, AgeBin] = {each.index: each for each in a}
    for each in b:
        total[each.index] = total[each.index] + each if each.index in total else each
    return tuple(total[index] for index in sorted(total))
