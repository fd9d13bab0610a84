# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums by age: the part of a recording that each sum of squares comes from.

The age of a sample is the number of sample periods since the first sample of its recording.

- `AgeBin`: the Allan sums of the second differences that *start* in a range of ages. Segments are
  not split, so all averaging factors stay, and the sum over the bins is the sum of the recording.
  Edges lie at 2^k and 1.5 * 2^k samples: about 16 bins at any length. They make it possible to
  leave out the early part of a recording afterwards (`AllanSums.settled`).
- `Recording`: the means of up to 512 cells of equal length, and the sums of squares at every
  second octave of up to 64 periods of equal length. The stationarity tests use both.

Everything is a function of the samples and their number alone, so any chunking gives the same
values, and the values of several recordings add.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FIRST_EDGE = 256
"""Age in samples of the first edge between two bins."""

EARLIEST_PART = 128
"""Bins that end before this fraction of the recording are merged into the first one."""

CELLS, MERGED_CELLS = 512, 64
"""Cells of a recording are fewer than this; of each of several recordings together, fewer."""

PERIODS, MERGED_PERIODS = 64, 16
"""The same for the periods with sums of squares."""

PERIOD_OVER_FACTOR = 16
"""A period has sums at averaging factors up to its length over this."""

KEPT_RECORDINGS = 32
"""How many of the longest recordings keep their means and periods."""

PooledCount = tuple[int, int, int]
"""Index of a length class, and how many segments and samples of it begin in a bin."""


def age_bin(age: int) -> int:
    """Return the index of the bin that holds an age in samples."""
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
    """Return the smallest power of two that divides a length into fewer than so many cells."""
    step = 1
    while length >= cells * step:
        step *= 2
    return step


def starts_between(m: Ints, stride: Ints, offset: int, samples: int, low: int, high: int) -> Ints:
    """Return how many second differences of a segment start at ages from ``low`` to ``high`` - 1.

    Parameters
    ----------
    m, stride : (factors,) int64 arrays
        Averaging factors, and samples between two starts.
    offset, samples : int
        Age of the first sample of the segment, and its length.
    """
    ends = samples - 2 * m + 1  # starts are below it
    below = [-(-np.clip(age - offset, 0, np.maximum(ends, 0)) // stride) for age in (low, high)]
    number: Ints = below[1] - below[0]
    return number


def short(values: Floats) -> Floats:
    """Return values rounded to single precision, in which the statistics by period are kept."""
    largest = float(np.finfo(np.float32).max)
    rounded: Floats = np.clip(values, -largest, largest).astype(np.float32).astype(float)
    return rounded


def same_values(a: object, b: object) -> bool:
    """Return whether two dataclass values of one type are equal, arrays included."""
    if type(a) is not type(b):
        return False
    pairs = ((getattr(a, f.name), getattr(b, f.name)) for f in fields(a))  # type: ignore[arg-type]
    return all(
        np.array_equal(x, y) if isinstance(x, np.ndarray) else bool(x == y) for x, y in pairs
    )


@dataclass(frozen=True, eq=False)
class AgeBin:
    """Sums of the second differences that start in one range of ages.

    Attributes
    ----------
    index : int
        It begins at ``edge_age(index)`` and ends where the next one of the history begins.
    count : (factors,) int64 array
    sum_sq : (factors, axes) float64 array
        As in `AllanSums`.
    pooled : tuple of (class index, segments, samples)
        The segments that begin here and are kept only by their length class.
    ramp : (factors, axes) float64 array
        What these segments contributed to the ramp corrections of their classes.
    """

    index: int
    count: Ints
    sum_sq: Floats
    pooled: tuple[PooledCount, ...]
    ramp: Floats

    def __eq__(self, other: object) -> bool:
        return same_values(self, other)

    def __add__(self, other: AgeBin) -> AgeBin:
        """Return the sums of both, with the lower index."""
        return AgeBin(
            min(self.index, other.index),
            add_padded(self.count, other.count),
            add_padded(self.sum_sq, other.sum_sq),
            _add_pooled(self.pooled, other.pooled),
            add_padded(self.ramp, other.ramp),
        )


@dataclass(frozen=True, eq=False)
class Recording:
    """Means and levels of one recording by age.

    Attributes
    ----------
    start_ns : int
        Stamp of its first sample.
    length, samples : int
        Sample periods from the first to the last sample, and samples in its segments.
    step : int
        Length of a cell in samples, a power of two.
    cell_samples : (cells,) int64 array
        Samples used of each cell, 0 in gaps.
    cell_means : (cells, axes) float64 array
        Mean of these samples less ``reference``; 0 where there are none.
    reference : (axes,) float64 array
        First sample of the recording.
    period : int
        Length of a period in samples, a power of two.
    level_count : (periods, levels) int64 array
    level_sum_sq : (periods, levels, axes) float64 array
        Second differences that start in each period at the factors 1, 4, 16 ..., and the sum of
        their squares.
    """

    start_ns: int
    length: int
    samples: int
    step: int
    cell_samples: Ints
    cell_means: Floats
    reference: Floats
    period: int
    level_count: Ints
    level_sum_sq: Floats

    def __eq__(self, other: object) -> bool:
        return same_values(self, other)

    @property
    def order(self) -> tuple[int, int]:
        """Longest first, then earliest: the order that decides which recordings are kept."""
        return (-self.samples, self.start_ns)

    @property
    def level_m(self) -> Ints:
        """Averaging factors of the levels, (levels,)."""
        return 4 ** np.arange(self.level_count.shape[1])

    def coarser(self, cells: int, periods: int) -> Recording:
        """Return the same in fewer cells and periods than so many."""
        step, period = cell_step(self.length, cells), cell_step(self.length, periods)
        number, means = self.cell_samples, self.cell_means
        sums = means * number[:, None]
        for _ in range(_doublings(self.step, step)):
            number, sums = _pair_sums(number), _pair_sums(sums)
        count, sum_sq = self.level_count, self.level_sum_sq
        for _ in range(_doublings(self.period, period)):
            count, sum_sq = _pair_sums(count), _pair_sums(sum_sq)
        if step > self.step:
            means = sums / np.maximum(number, 1)[:, None]
        return replace(
            self,
            step=max(step, self.step),
            cell_samples=number,
            cell_means=short(means),
            period=max(period, self.period),
            level_count=count,
            level_sum_sq=short(sum_sq),
        )

    def continued(self, later: Recording) -> Recording:
        """Return this recording with a later segment of it, aged from the same first sample."""
        a = replace(self, length=max(self.length, later.length)).coarser(CELLS, PERIODS)
        b = replace(later, length=a.length).coarser(CELLS, PERIODS)
        number = add_padded(a.cell_samples, b.cell_samples)
        shifted = b.cell_means + (b.reference - a.reference)
        sums = add_padded(a.cell_means * a.cell_samples[:, None], shifted * b.cell_samples[:, None])
        levels = max(a.level_count.shape[1], b.level_count.shape[1])
        counts, squares = (
            [_with_levels(x, levels) for x in pair]
            for pair in ((a.level_count, b.level_count), (a.level_sum_sq, b.level_sum_sq))
        )
        return replace(
            a,
            samples=a.samples + b.samples,
            cell_samples=number,
            cell_means=short(sums / np.maximum(number, 1)[:, None]),
            level_count=add_padded(*counts),
            level_sum_sq=short(add_padded(*squares)),
        )


@dataclass(frozen=True, eq=False)
class History:
    """Sums by age of one recording, or of several added age by age.

    Attributes
    ----------
    first : int
        Index of the lowest edge that is kept: everything younger is in the bin of index 0.
    bins : tuple of AgeBin
        By index; bins without a difference are left out.
    recordings : tuple of Recording
        The 32 longest, longest first.
    recording_count : int
        How many there are.
    """

    first: int = 1
    bins: tuple[AgeBin, ...] = ()
    recordings: tuple[Recording, ...] = ()
    recording_count: int = 0

    def __eq__(self, other: object) -> bool:
        return same_values(self, other)

    @classmethod
    def of_segment(cls, bins: Iterable[AgeBin], recording: Recording) -> History:
        """Return the history of a single segment."""
        return cls(1, tuple(bins), (recording,), 1)._from(_first_edge(recording.length))

    @property
    def ages(self) -> tuple[int, ...]:
        """Ages in samples at which a bin begins and that have something on both sides."""
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
        """Return the history of the recordings of both, added at equal ages."""
        if not self.recordings or not other.recordings:
            return self if self.recordings else other
        first = max(self.first, other.first)
        recordings = sorted(
            (r.coarser(MERGED_CELLS, MERGED_PERIODS) for r in self.recordings + other.recordings),
            key=lambda r: r.order,
        )
        return History(
            first,
            _add_bins(self._from(first).bins, other._from(first).bins),
            tuple(recordings[:KEPT_RECORDINGS]),
            self.recording_count + other.recording_count,
        )

    def with_pooled(self, pooled: Iterable[tuple[int, PooledCount, Floats]]) -> History:
        """Return the same with segments that are from now on kept by their length class alone.

        Parameters
        ----------
        pooled : iterable of (age, (class index, segments, samples), ramp correction)
            Age of the first sample of each.
        """
        bins = {b.index: b for b in self.bins}
        for age, number, ramp in pooled:
            index = age_bin(age)
            index = index if index >= self.first else 0
            have = bins.get(index)
            nothing = AgeBin(index, ramp[:0, 0].astype(np.int64), ramp[:0], (), ramp[:0])
            more = replace(nothing, pooled=(number,), ramp=ramp)
            bins[index] = more if have is None else have + more
        return replace(self, bins=tuple(bins[i] for i in sorted(bins)))

    def _from(self, first: int) -> History:
        """Return the same with all bins below an edge merged into the first."""
        if first <= self.first:
            return self
        early = [b for b in self.bins if b.index < first]
        late = [b for b in self.bins if b.index >= first]
        if early:
            merged = early[0]
            for more in early[1:]:
                merged = merged + more
            late.insert(0, replace(merged, index=0))
        return replace(self, first=first, bins=tuple(late))


class SegmentAges:
    """Divides the starts of the second differences of one segment by age.

    Parameters
    ----------
    offset : int
        Age of the first sample of the segment.
    """

    def __init__(self, offset: int) -> None:
        self.offset = offset

    def by_bin(self, first: int, length: int, level: int) -> Iterator[tuple[int, int, int]]:
        """Yield (bin, low, high) for the starts first .. first + length - 1 of a level.

        ``low`` and ``high`` count from ``first``; starts are 2^level samples apart.
        """
        low = 0
        while low < length:
            index = age_bin(self.offset + ((first + low) << level))
            high = min(length, (-((self.offset - edge_age(index + 1)) >> level)) - first)
            yield index, low, high
            low = high

    def by_period(self, first: int, length: int, level: int, period: int) -> tuple[int, Ints]:
        """Return the index of the first period, and the first start in each period."""
        age = self.offset + (first << level)
        last = (self.offset + ((first + length - 1) << level)) // period
        at = np.arange(age // period + 1, last + 1) * period
        begins = -((self.offset - at) >> level) - first
        return age // period, np.concatenate([[0], begins])


class PeriodSums:
    """Sums of squares by period at one averaging factor, coarsened as the recording grows."""

    def __init__(self, axes: int) -> None:
        self.period = 1
        self.sums = np.zeros((0, axes))

    def add(self, period: int, first: int, sums: Floats) -> None:
        """Add sums, (periods, axes), of the periods from ``first`` on."""
        self.sums = self.at(period)
        self.period = period
        missing = first + len(sums) - len(self.sums)
        if missing > 0:
            self.sums = np.pad(self.sums, ((0, missing), (0, 0)))
        self.sums[first : first + len(sums)] += sums

    def copy(self) -> PeriodSums:
        """Return a copy that can be added to."""
        other = PeriodSums(self.sums.shape[1])
        other.period, other.sums = self.period, self.sums.copy()
        return other

    def at(self, period: int) -> Floats:
        """Return the sums by periods of a length that is a multiple of the present one."""
        sums = self.sums
        for _ in range(_doublings(self.period, period) if len(sums) else 0):
            sums = _pair_sums(sums)
        return sums.copy()


def add_padded(a: NDArray, b: NDArray) -> NDArray:  # type: ignore[type-arg]
    """Return a + b along the first axis, the shorter one filled with zeros."""
    if len(a) < len(b):
        a, b = b, a
    out = a.copy()
    out[: len(b)] += b
    return out


def _first_edge(length: int) -> int:
    """Return the index of the lowest edge at or beyond 1/128 of a length in samples."""
    index = max(1, age_bin(max(length // EARLIEST_PART, 1)))
    return index if edge_age(index) * EARLIEST_PART >= length else index + 1


def _doublings(step: int, coarser: int) -> int:
    return max(0, coarser.bit_length() - step.bit_length())


def _pair_sums(values: NDArray) -> NDArray:  # type: ignore[type-arg]
    """Return the sums of neighbours along the first axis; a last one without neighbour stays."""
    if len(values) % 2:
        values = np.concatenate([values, np.zeros_like(values[:1])])
    pairs: NDArray = values[::2] + values[1::2]  # type: ignore[type-arg]
    return pairs


def _with_levels(values: NDArray, levels: int) -> NDArray:  # type: ignore[type-arg]
    """Return values, (periods, levels, ...), with zeros for further levels."""
    width = [(0, 0)] * values.ndim
    width[1] = (0, levels - values.shape[1])
    return np.pad(values, width)


def _add_pooled(a: tuple[PooledCount, ...], b: tuple[PooledCount, ...]) -> tuple[PooledCount, ...]:
    total: dict[int, tuple[int, int]] = {}
    for index, count, samples in a + b:
        have = total.get(index, (0, 0))
        total[index] = (have[0] + count, have[1] + samples)
    return tuple((index, *total[index]) for index in sorted(total))


def _add_bins(a: tuple[AgeBin, ...], b: tuple[AgeBin, ...]) -> tuple[AgeBin, ...]:
    total: dict[int, AgeBin] = {each.index: each for each in a}
    for each in b:
        have = total.get(each.index)
        total[each.index] = each if have is None else have + each
    return tuple(total[index] for index in sorted(total))


def bins_of(
    squares: Mapping[int, Floats], m: Ints, stride: Ints, offset: int, samples: int
) -> list[AgeBin]:
    """Return the bins of one segment.

    Parameters
    ----------
    squares : mapping of bin index to (factors, axes) float64 array
    m, stride : (factors,) int64 arrays
    offset, samples : int
        Age of the first sample of the segment, and its length.
    """
    bins = []
    for index in sorted(squares):
        low, high = edge_age(index), edge_age(index + 1)
        count = starts_between(m, stride, offset, samples, low, high)
        some = int(np.flatnonzero(count)[-1]) + 1 if count.any() else 0
        sum_sq = squares[index][:some]
        if some:
            bins.append(AgeBin(index, count[:some], sum_sq, (), np.zeros((0, sum_sq.shape[1]))))
    return bins
