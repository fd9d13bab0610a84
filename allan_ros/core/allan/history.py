# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums by age: they assign each sum of squares to a part of the recording.

The age of a sample is the number of sample periods since the first sample of its recording.

- `AgeBin`: the Allan sums of the second differences that *start* in a range of ages. Segments are
  not split: all averaging factors are kept, and the bins add up to the sums of the recording.
  Edges lie at 2^k and 1.5 * 2^k samples: about 13 bins at any length. With them, the early part of
  a recording can be left out afterwards (`parts.settled_sums`).
- `Recording`: the means of up to 512 cells of equal length, and the sums of squares at every
  second octave of about 100 periods, which are shorter towards the end. The stationarity tests and
  the comparison of the recent noise with the earlier noise use them.

All values depend only on the samples and their number, so any chunking gives the same values, and
the values of several recordings can be added.
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
"""Bins that end before this fraction of the recording are merged into the first one, because the
phase record has too few points to leave them out exactly."""

CELLS, MERGED_CELLS = 512, 64
"""A recording has fewer cells than the first number; if several recordings are added, each has
fewer cells than the second."""

LONGEST_PERIOD, PERIOD_DISTANCE = 32, 4
"""Largest length of a period, as a fraction of its recording, and as a fraction of the time from
its end to the end of the recording."""

MERGED_PERIODS = 16
"""If several recordings are added, each of them except the latest has fewer periods than this."""

SHORTEST_PERIODS = (128, 2048)
"""Shortest period in samples of a short recording, and of a recording of 2e6 samples or more."""

PERIOD_OVER_FACTOR = 16
"""A period has sums at averaging factors up to its length divided by this number."""

KEPT_RECORDINGS = 32
"""Number of recordings that keep their means and periods."""

MOST_PIECES = 512
"""If there are more sums by period than this, they are merged to the periods of the recording."""

PooledCount = tuple[int, int, int]
"""Index of a length class, and the number of its segments and samples that begin in a bin."""


def age_bin(age: int) -> int:
    """Return the index of the bin that contains an age in samples."""
    if age < FIRST_EDGE:
        return 0
    octave = age.bit_length() - 1
    return 2 * (octave - FIRST_EDGE.bit_length()) + 3 + (2 * age >= 3 << octave)


def edge_age(index: int) -> int:
    """Return the age in samples at which a bin begins."""
    if index == 0:
        return 0
    octave, upper = divmod(index - 1, 2)
    return (FIRST_EDGE << octave) * (2 + upper) // 2


def cell_step(length: int, cells: int) -> int:
    """Return the smallest power of two that divides a length into fewer than ``cells`` cells."""
    return 1 << (length // cells).bit_length()


def shortest_period(length: int) -> int:
    """Return the length of the last periods of a recording, a power of two."""
    shortest, longest = SHORTEST_PERIODS
    return min(max(shortest, cell_step(length, longest)), longest)


def period_begins(length: int, begin: int = 0) -> Ints:
    """Return the ages at which the periods of a recording begin, from the period that contains
    ``begin``.

    The length of a period is a power of two, and it begins at a multiple of its length. It is the
    longest one within 1/32 of the length of the recording and 1/4 of the distance from its end to
    the end of the recording. So periods are only merged, never split, as the recording grows.
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
    """Return how many second differences of a segment start before given ages.

    ``m`` and ``stride`` (averaging factor, samples between two starts) broadcast with ``ages``;
    ``offset`` is the age of the first of the ``samples`` of the segment.
    """
    ends = np.maximum(samples - 2 * np.asarray(m) + 1, 0)  # all starts are smaller than this
    return np.asarray(-(-np.clip(ages - offset, 0, ends) // stride))


def short(values: Floats) -> Floats:
    """Return values rounded to the 16 significant bits that the history stores."""
    bits = np.ascontiguousarray(values, '<f8').view('<u8')
    even = bits + ((bits >> 37) & 1) + ((1 << 36) - 1)
    return np.asarray((even >> 37 << 37).view('<f8'))


@dataclass
class PeriodSums:
    """Sums of squares by period at one averaging factor; some periods may still be too short."""

    m: int
    begins: list[int]
    sums: list[Floats]

    def shortest(self, length: int) -> int:
        """Return the length of the shortest period with sums at this factor."""
        return max(shortest_period(length), PERIOD_OVER_FACTOR * self.m)

    def add(self, begins: range, sums: Floats) -> None:
        """Add sums, (periods, axes), of consecutive periods; the first is the last known one or the
        next.
        """
        if self.begins and begins[0] <= self.begins[-1]:
            self.sums[-1] = self.sums[-1] + sums[0]
            begins, sums = begins[1:], sums[1:]
        self.begins.extend(begins)
        self.sums.extend(sums)

    def over(self, begins: Ints, axes: int) -> Floats:
        """Return the sums over periods that begin at given ages, (periods, axes)."""
        return regrouped(np.reshape(self.sums, (-1, axes)), np.array(self.begins, int), begins)

    def merge(self, length: int) -> None:
        """Merge periods if there are too many for the present length of the recording."""
        if len(self.begins) > MOST_PIECES:
            coarser = period_begins(length, self.begins[0])
            self.sums = list(self.over(coarser, len(self.sums[0])))
            self.begins = coarser.tolist()


class ByValue:
    """Base of dataclasses with arrays that are compared by value with ``==``."""

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return False
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))  # type: ignore[arg-type]
        return all(
            np.array_equal(x, y) if isinstance(x, np.ndarray) else bool(x == y) for x, y in pairs
        )


@dataclass(frozen=True, eq=False)
class AgeBin(ByValue):
    """Sums of the second differences that start in one range of ages."""

    index: int  # it begins at ``edge_age(index)`` and ends where the next bin of the history begins
    # (factors,) and (factors, axes), as in `AllanSums`
    count: Ints
    sum_sq: Floats
    # segments that begin here and whose data are kept only in their length class
    pooled: tuple[PooledCount, ...]
    # (factors, axes) contribution of these segments to the ramp corrections of their classes
    ramp: Floats

    def __add__(self, other: AgeBin) -> AgeBin:
        """Return the sum of both bins, with the smaller index of the two."""
        return AgeBin(
            min(self.index, other.index),
            add_padded(self.count, other.count),
            add_padded(self.sum_sq, other.sum_sq),
            _add_pooled(self.pooled, other.pooled),
            add_padded(self.ramp, other.ramp),
        )


@dataclass(frozen=True, eq=False)
class Recording(ByValue):
    """Means and levels of one recording by age."""

    start_ns: int  # stamp of its first sample
    # sample periods from the first to the last sample, and samples in its segments
    length: int
    samples: int
    step: int  # length of a cell in samples, a power of two
    cell_samples: Ints  # (cells,) number of samples of each cell, 0 in gaps
    # (cells, axes) mean of these samples less ``reference``; 0 without samples
    cell_means: Floats
    reference: Floats  # (axes,) first sample of the recording
    period_begin: Ints  # (periods,) ages at which the periods begin, see `period_begins`
    # (periods, levels) and (periods, levels, axes): number of second differences that start in each
    # period at the factors 1, 4, 16 ..., and sum of their squares
    level_count: Ints
    level_sum_sq: Floats

    @property
    def order(self) -> tuple[int, int]:
        """Sort key: longest first, then earliest. It decides which recordings are kept."""
        return (-self.samples, self.start_ns)

    @property
    def mean(self) -> Floats:
        """Mean of the samples in the segments, (axes,)."""
        weights = self.cell_samples / max(int(self.cell_samples.sum()), 1)
        return np.asarray(self.reference + weights @ self.cell_means)

    @property
    def level_m(self) -> Ints:
        """Averaging factors of the levels, (levels,)."""
        return 4 ** np.arange(self.level_count.shape[1])

    def cells(self, first: int, last: int | None = None) -> Recording:
        """Return the recording with only the given cells; periods and length are unchanged."""
        number, means = self.cell_samples[first:last], self.cell_means[first:last]
        return replace(self, cell_samples=number, cell_means=means)

    def coarser(self, cells: int, begins: Ints) -> Recording:
        """Return the recording with fewer than ``cells`` cells, and with longer periods."""
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
        """Return the recording with few cells and periods, as kept when several are added."""
        period = cell_step(self.length, MERGED_PERIODS)
        return self.coarser(MERGED_CELLS, np.unique(self.period_begin // period * period))

    def rounded(self) -> Recording:
        """Return a copy rounded to the precision in which it is stored."""
        means, squares = short(self.cell_means), short(self.level_sum_sq)
        return replace(self, cell_means=means, level_sum_sq=squares)

    def continued(self, later: Recording) -> Recording:
        """Return this recording with a later segment; its ages count from the same first sample."""
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
    """Sums by age of one recording, or of several recordings added age by age."""

    # index of the lowest edge that is kept: all smaller ages are in the bin of index 0
    first: int = 1
    bins: tuple[AgeBin, ...] = ()  # by index; bins without a difference are left out
    # the latest recording and the 31 longest others, longest first, of ``recording_count``
    recordings: tuple[Recording, ...] = ()
    recording_count: int = 0

    @classmethod
    def of_segment(cls, bins: Iterable[AgeBin], recording: Recording) -> History:
        """Return the history of a single segment."""
        return cls(1, tuple(bins), (recording,), 1)._from(_first_edge(recording.length))

    @property
    def ages(self) -> tuple[int, ...]:
        """Ages in samples at which a bin begins, with data before and after."""
        return tuple(edge_age(b.index) for b in self.bins[1:])

    @property
    def length(self) -> int:
        """Sample periods of the longest recording."""
        return max((r.length for r in self.recordings), default=0)

    def continued(self, later: History) -> History:
        """Return the history of one recording with a later segment of it."""
        if not self.recordings or not later.recordings:
            return self if self.recordings else later
        one = self.recordings[0].continued(later.recordings[0])
        first = _first_edge(one.length)
        bins = _add_bins(self._from(first).bins, later._from(first).bins)
        return History(first, bins, (one,), 1)

    def __add__(self, other: History) -> History:
        """Return the history of the recordings of both; sums at equal ages are added."""
        if not self.recordings or not other.recordings:
            return self if self.recordings else other
        first = max(self.first, other.first)
        recordings = sorted(self.recordings + other.recordings, key=lambda r: r.order)
        latest = max(recordings, key=lambda r: (r.start_ns, r.length))
        former = [r.summary() for r in recordings if r is not latest][: KEPT_RECORDINGS - 1]
        return History(
            first,
            _add_bins(self._from(first).bins, other._from(first).bins),
            tuple(sorted((*former, latest), key=lambda r: r.order)),
            self.recording_count + other.recording_count,
        ).rounded()

    def rounded(self) -> History:
        """Return a copy rounded to the precision in which it is stored: 16 significant bits."""
        return replace(
            self,
            bins=tuple(replace(b, sum_sq=short(b.sum_sq)) for b in self.bins),
            recordings=tuple(r.rounded() for r in self.recordings),
        )

    def with_pooled(self, pooled: Iterable[tuple[int, PooledCount, Floats]]) -> History:
        """Return a copy in which the given segments are kept only by their length class.

        Each segment is given by the age of its first sample, (class index, segments, samples), and
        its ramp correction.
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

    def _from(self, first: int) -> History:
        """Return a copy in which all bins below an edge are merged into the first bin."""
        if first <= self.first:
            return self
        early = [b for b in self.bins if b.index < first]
        late = [b for b in self.bins if b.index >= first]
        if early:
            merged = reduce(operator.add, early)
            late.insert(0, replace(merged, index=0))
        return replace(self, first=first, bins=tuple(late))


def add_padded(a: NDArray, b: NDArray, axis: int = 0) -> NDArray:  # type: ignore[type-arg]
    """Return a + b; along one axis, the shorter one is filled with zeros."""
    if a.shape[axis] < b.shape[axis]:
        a, b = b, a
    out = a.copy()
    out[(slice(None),) * axis + (slice(b.shape[axis]),)] += b
    return out


def _first_edge(length: int) -> int:
    """Return the index of the lowest edge at or beyond `EARLIEST_PART` of a length in samples."""
    index = max(1, age_bin(max(length // EARLIEST_PART, 1)))
    return index if edge_age(index) * EARLIEST_PART >= length else index + 1


def regrouped(values: NDArray, begins: Ints, coarser: Ints) -> NDArray:  # type: ignore[type-arg]
    """Return sums of rows over the periods that begin at the ages ``begins``."""
    rows, first = np.unique(np.searchsorted(coarser, begins, 'right') - 1, return_index=True)
    out = np.zeros((len(coarser), *values.shape[1:]), values.dtype)
    if len(rows):
        out[rows] = np.add.reduceat(values, first)
    return out


def _pair_sums(values: NDArray) -> NDArray:  # type: ignore[type-arg]
    """Return the sums of pairs of neighbours along the first axis; a single last row is
    unchanged."""
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
