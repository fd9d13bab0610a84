# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The engine: running Allan sums of a stream in O(log samples) memory.

Level j of the cascade holds the phase at every 2^j-th sample in blocks of `BLOCK` points. A full
block is summed at the factors of its level, and every second point is passed to level j + 1. Blocks
are counted from the start of the segment, so the sums are the same, bit for bit, for any chunking.
Every second difference is counted in the age bin in which it starts (see `history`).

Source of the statistic: IEEE Std 952-1997 annex C; NIST SP 1065 eq. 11 (overlapping Allan
variance). The first sample of the segment is subtracted before the phase is accumulated, and each
block of level 0 has its own origin. With raw sums, an offset of 9.8 m/s^2 causes relative errors
of up to 1e-5 at the longest factors after 1e9 samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..imu import AXES, ImuIdentity
from .history import (
    CELLS,
    PERIOD_OVER_FACTOR,
    AgeBin,
    History,
    PeriodSums,
    Recording,
    age_bin,
    edge_age,
    period_begins,
    shortest_period,
    starts_before,
)
from .sums import FIRST_FACTORS, LEVEL_FACTORS, AllanSums, SegmentRecord, counts, grid_for

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

BLOCK = 4096
"""Phase points per block: fits into the cache and amortizes the overhead of numpy calls."""

PHASE_POINTS = 128
"""Largest number of points of the phase record of a segment; when it is full, every second point is
dropped."""

_HISTORY = 2 * LEVEL_FACTORS[-1]
"""Number of points of the previous block that a level keeps: the length of its longest second
difference."""


@dataclass
class _LevelSums:
    """Sums of squared second differences of one level, (factors, axes) in each bin by age.

    It also contains the sums by period, for the rows of every second octave, and the sums over
    groups.
    """

    bins: dict[int, Floats]
    periods: dict[int, PeriodSums]
    groups: Floats

    @classmethod
    def of(cls, factors: Sequence[int], axes: int) -> _LevelSums:
        """Return the sums of zero differences."""
        octaves = {i: m for i, m in enumerate(factors) if m.bit_count() == 1}
        periods = {i: PeriodSums(m, [], []) for i, m in octaves.items() if m.bit_length() % 2}
        return cls({}, periods, np.zeros((len(factors), axes)))

    def copy(self) -> _LevelSums:
        """Return a copy that can be added to."""
        return _LevelSums(
            {index: squares.copy() for index, squares in self.bins.items()},
            {i: PeriodSums(p.m, p.begins[:], p.sums[:]) for i, p in self.periods.items()},
            self.groups.copy(),
        )


class _Level:
    """Phase at every 2^j-th sample of the open segment, and its sums of squares so far.

    ``points`` contains the last `_HISTORY` points of the previous block, if any, and ``fill``
    points that are not summed yet.
    """

    def __init__(self, level: int, axes: int, offset: int) -> None:
        self.level = level
        self.factors = LEVEL_FACTORS if level else FIRST_FACTORS + LEVEL_FACTORS
        self.offset = offset
        self.points = np.empty((axes, _HISTORY + BLOCK))
        self.fill = 0
        self.summed = 0
        self.first: Floats | None = None
        self.bin, self.bin_starts = 0, (0, 0)  # the bin used last, and its differences
        self.sums = _LevelSums.of([f << level for f in self.factors], axes)

    @property
    def past(self) -> int:
        """Number of points kept of the previous block."""
        return min(self.summed, _HISTORY)

    def waiting(self) -> Floats:
        """Return the points that are not summed yet, (axes, fill), as a view."""
        return self.points[:, _HISTORY : _HISTORY + self.fill]

    def sum_block(self) -> Floats:
        """Sum the full block, keep its last points, and return every second point for the next
        level."""
        self._add(self.points[:, _HISTORY - self.past :], self.sums)
        if self.first is None:
            self.first = self.waiting()[:, :_HISTORY].copy()
        upward = self.waiting()[:, ::2].copy()
        self.points[:, :_HISTORY] = self.points[:, BLOCK:]
        self.summed += BLOCK
        self.fill = 0
        return upward

    def snapshot(self, new: Floats) -> tuple[_LevelSums, Floats, Floats]:
        """Return the sums including the differences that end in new points, and the end points."""
        points = np.concatenate([self.points[:, _HISTORY - self.past : _HISTORY], new], axis=1)
        sums = self.sums.copy()
        self._add(points, sums)
        first = points[:, :_HISTORY] if self.first is None else self.first
        return sums, first, points[:, -_HISTORY:]

    def _add(self, points: Floats, sums: _LevelSums) -> None:
        """Add the squares of all differences that end in the points after the `past` ones."""
        scratch = np.empty((2, *points.shape))
        length = self.offset + ((self.summed + points.shape[1] - self.past) << self.level)
        for i, f in enumerate(self.factors):
            reach = min(self.past, 2 * f)
            window = points[:, self.past - reach :]
            number = window.shape[1] - 2 * f
            if number <= 0:
                continue
            g = scratch[0, :, : number + f]
            np.subtract(window[:, f:], window[:, :-f], out=g)
            d = scratch[1, :, :number]
            np.subtract(g[:, f:], g[:, :-f], out=d)
            first = self.summed - reach
            pieces = [
                (index, _squares(d[:, low:high]))
                for index, low, high in self._by_bin(first, number)
            ]
            for index, squares in pieces:
                if index not in sums.bins:
                    sums.bins[index] = np.zeros_like(sums.groups)
                sums.bins[index][i] += squares
            every = d[:, -first % f :: f]
            sums.groups[i] += _squares(every) if f > 1 or len(pieces) > 1 else pieces[0][1]
            if i in sums.periods:
                by_period = sums.periods[i]
                period = by_period.shortest(length)
                age = self.offset + (first << self.level)
                begin = age - age % period
                split = self._start_at(begin + period) - first
                if split >= number and len(pieces) == 1:
                    squares = pieces[0][1][None]
                else:
                    squares = _squares_by_part(d, split, period >> self.level)
                by_period.add(range(begin, begin + len(squares) * period, period), squares)
                by_period.merge(length)

    def _by_bin(self, first: int, number: int) -> list[tuple[int, int, int]]:
        """Return (bin, low, high) of differences; ``low`` and ``high`` count from ``first``."""
        begin, end = self.bin_starts
        if begin <= first and first + number <= end:
            return [(self.bin, 0, number)]
        found, low = [], 0
        while low < number:
            self.bin = age_bin(self.offset + ((first + low) << self.level))
            begin, end = (self._start_at(edge_age(self.bin + i)) for i in (0, 1))
            self.bin_starts = begin, end
            high = min(number, end - first)
            found.append((self.bin, low, high))
            low = high
        return found

    def _start_at(self, age: int) -> int:
        """Return the first difference that starts at an age or later."""
        return -((self.offset - age) >> self.level)


def _squares(d: Floats) -> Floats:
    """Return the sum of squares of each row, by one dot product per row."""
    return np.asarray(np.matmul(d[:, None, :], d[:, :, None])[:, 0, 0])


def _squares_by_part(d: Floats, split: int, size: int) -> Floats:
    """Return `_squares` of the columns before ``split``, and of each group of ``size`` columns
    after it.
    """
    whole = max(0, d.shape[1] - split) // size
    rest = split + whole * size
    inner = d[:, split:rest].reshape(len(d), whole, size)
    parts = [_squares(d[:, :split])[None]]
    parts.append(np.matmul(inner[:, :, None, :], inner[:, :, :, None])[:, :, 0, 0].T)
    if rest < d.shape[1]:
        parts.append(_squares(d[:, rest:])[None])
    return np.concatenate(parts)


def _signed_sum(first: Floats, last: Floats, lag: int) -> Floats:
    """Return the sum of all d at a lag, from the first and the last 2 lag points.

    The sum telescopes: d(u) = g(u + lag) - g(u) with g(u) = theta(u + lag) - theta(u).
    """
    head = first[:, lag : 2 * lag] - first[:, :lag]
    tail = last[:, -lag:] - last[:, -2 * lag : -lag]
    return np.asarray(tail.sum(axis=1) - head.sum(axis=1))


class _SparsePhase:
    """The phase of a segment, stored at the ages that are multiples of a step.

    The segment begins at the age ``offset``. The step is a power of two and doubles when the last
    age reaches ``points`` steps.
    """

    def __init__(self, axes: int, points: int, offset: int = 0) -> None:
        self._limit, self._offset = points, offset
        self.step = 1
        self.points = np.empty((axes, 0))

    def extended(self, theta: Floats, base: Floats, first: int) -> tuple[Floats, int]:
        """Return points and step after appending base + theta, whose first index is ``first``."""
        age, step = self._offset + first, self.step
        points = np.concatenate([self.points, theta[:, -age % step :: step] + base], axis=1)
        while age + theta.shape[1] - 1 >= self._limit * step:
            odd = -(-self._offset // step) % 2
            points, step = points[:, odd::2], 2 * step
        return points, step


class OpenSegment:
    """The cascade of the open segment."""

    def __init__(self, axes: int, reference: Floats, start_ns: int, offset: int = 0) -> None:
        self.offset = offset
        self.reference = reference[:, None].copy()
        self.start_ns = self.last_ns = start_ns
        self.samples = 0
        # phase at level 0; it starts from 0 in each block, which keeps rounding small
        self.base = np.zeros((axes, 1))
        self.theta = np.zeros(axes)
        self.levels = [_Level(0, axes, offset)]
        self.coarse = _SparsePhase(axes, PHASE_POINTS)
        self.cells = _SparsePhase(axes, CELLS, offset)
        bottom = self.levels[0]
        bottom.points[:, _HISTORY] = 0.0  # theta(0)
        bottom.fill = 1

    def feed(self, rows: Floats) -> None:
        """Add samples, (axes, n)."""
        at, n = 0, rows.shape[1]
        bottom = self.levels[0]
        while at < n:
            take = min(BLOCK - bottom.fill, n - at)
            begin = _HISTORY + bottom.fill
            phase = bottom.points[:, begin : begin + take]
            np.subtract(rows[:, at : at + take], self.reference, out=phase)
            # theta is added to the first term, so the order of additions is the same for any
            # chunking
            phase[:, 0] += self.theta
            np.cumsum(phase, axis=1, out=phase)
            self.theta = phase[:, -1].copy()
            bottom.fill += take
            at += take
            if bottom.fill == BLOCK:
                self._sum_from_bottom()
        self.samples += n

    def _sum_from_bottom(self) -> None:
        """Sum the full block of level 0, and the blocks of higher levels that it completes."""
        bottom = self.levels[0]
        for sparse in (self.coarse, self.cells):
            sparse.points, sparse.step = sparse.extended(bottom.waiting(), self.base, bottom.summed)
        upward = bottom.sum_block() + self.base
        last = bottom.points[:, _HISTORY - 1 : _HISTORY].copy()
        self.base += last
        bottom.points[:, :_HISTORY] -= last  # a constant in the phase changes no difference
        self.theta[:] = 0.0
        j = 1
        while upward.shape[1]:
            if j == len(self.levels):
                self.levels.append(_Level(j, len(upward), self.offset))
            level = self.levels[j]
            begin = _HISTORY + level.fill
            level.points[:, begin : begin + upward.shape[1]] = upward
            level.fill += upward.shape[1]
            if level.fill < BLOCK:
                return
            upward = level.sum_block()
            j += 1

    def sums(self, identity: ImuIdentity, axes: tuple[str, ...]) -> AllanSums:
        """Return the sums as if the segment ended here; the state does not change."""
        n = self.samples
        m, stride = grid_for(n)
        shape = (len(m), len(axes))
        bins: dict[int, Floats] = {}
        groups, signed = np.zeros(shape), np.zeros(shape)
        by_period: list[PeriodSums] = []
        carry = np.empty((len(axes), 0))
        j = row = 0
        while row < len(m):
            level = self.levels[j] if j < len(self.levels) else _Level(j, len(axes), self.offset)
            new = np.concatenate([level.waiting(), carry], axis=1)
            sums, first, last = level.snapshot(new)
            by_period += sums.periods.values()
            reached = level.factors[: len(m) - row]
            rows = slice(row, row + len(reached))
            groups[rows] = sums.groups[: len(reached)]
            for index, squares in sums.bins.items():
                bins.setdefault(index, np.zeros(shape))[rows] = squares[: len(reached)]
            signed[rows] = [_signed_sum(first, last, f) for f in reached]
            carry = new[:, ::2] + self.base if j == 0 else new[:, ::2]
            row += len(reached)
            j += 1
        sum_sq = sum((bins[index] for index in sorted(bins)), np.zeros(shape))
        bottom = self.levels[0]
        phase, step = self.coarse.extended(bottom.waiting(), self.base, bottom.summed)
        record = SegmentRecord(self.start_ns, n, signed, phase.T.copy(), step, self.offset)
        history = History.of_segment(self._bins(bins, m, stride), self._recording(by_period))
        return AllanSums(
            identity,
            axes,
            counts(n, m, stride),
            sum_sq,
            counts(n, m, m),
            groups,
            (record,),
            elapsed_ns=self.last_ns - self.start_ns,
            intervals=n - 1,
            history=history,
        )

    def _bins(self, squares: dict[int, Floats], m: Ints, stride: Ints) -> Iterator[AgeBin]:
        """Yield the bins of this segment from sums of squares, (factors, axes), by bin."""
        for index in sorted(squares):
            ages = np.array([[edge_age(index)], [edge_age(index + 1)]])
            count = np.diff(starts_before(ages, m, stride, self.offset, self.samples), axis=0)[0]
            count = np.trim_zeros(count, 'b')
            if len(count):
                yield AgeBin(index, count, squares[index][: len(count)], (), squares[index][:0])

    def _recording(self, by_period: list[PeriodSums]) -> Recording:
        """Return the means by cell and the sums of squares by period of this segment."""
        offset, bottom, axes = self.offset, self.levels[0], len(self.theta)
        phase, step = self.cells.extended(bottom.waiting(), self.base, bottom.summed)
        first = -(-offset // step)
        means = np.diff(phase, axis=1).T / step
        samples = np.zeros(first + len(means), np.int64)
        samples[first:] = step
        length = offset + self.samples
        begins = period_begins(length)
        periods = np.diff(begins, append=begins[-1] + shortest_period(length))
        long_enough = [one for one in by_period if PERIOD_OVER_FACTOR * one.m <= periods.max()]
        count = np.zeros((len(begins), len(long_enough)), np.int64)
        sum_sq = np.zeros((len(begins), len(long_enough), axes))
        for i, one in enumerate(long_enough):
            rows = PERIOD_OVER_FACTOR * one.m <= periods
            stride = max(1, one.m // LEVEL_FACTORS[0])
            before = starts_before(np.append(begins, length), one.m, stride, offset, self.samples)
            count[rows, i] = np.diff(before)[rows]
            sum_sq[rows, i] = one.over(begins, axes)[rows]
        return Recording(
            self.start_ns,
            length,
            self.samples,
            step,
            samples,
            np.concatenate([np.zeros((first, axes)), means]),
            self.reference[:, 0].copy(),
            begins,
            count,
            sum_sq,
        )


class RunningAllan:
    """Running Allan sums of one stream of evenly spaced samples.

    Memory is O(log^2 samples), time O(1) per sample. Any chunking of the same samples gives the
    same sums, bit for bit.

    Examples
    --------
    >>> import numpy as np
    >>> engine = RunningAllan()
    >>> engine.update(np.random.default_rng(0).normal(size=(1000, 6)), 0, 9_990_000_000)
    >>> engine.end_segment()
    >>> sums = engine.sums
    >>> sums.samples, sums.tau0
    (1000, 0.01)
    """

    def __init__(self, identity: ImuIdentity = ImuIdentity(), axes: tuple[str, ...] = AXES) -> None:
        self._closed = AllanSums.empty(identity, axes)
        self._start_ns = 0
        self._open: OpenSegment | None = None

    def update(self, samples: ArrayLike, first_ns: int, last_ns: int) -> None:
        """Add finite samples, (n, axes), that directly follow the previous ones.

        ``first_ns`` and ``last_ns`` are the stamps of the first and the last of them.
        """
        values = np.asarray(samples, float)
        if not len(values):
            return
        if self._open is None:
            age = self._age(first_ns)
            self._open = OpenSegment(len(self._closed.axes), values[0], first_ns, age)
        self._open.feed(values.T)
        self._open.last_ns = last_ns

    def end_segment(self) -> None:
        """End the segment: the next sample starts a new one, and no difference contains samples of
        both.
        """
        self._closed = self._exact
        self._open = None

    def _age(self, first_ns: int) -> int:
        """Return the age of the first sample of a new segment, in sample periods."""
        closed = self._closed
        if not closed.samples:
            self._start_ns = first_ns
            return 0
        passed = first_ns - self._start_ns
        if closed.intervals and closed.elapsed_ns:
            passed = round(passed * closed.intervals / closed.elapsed_ns)
        return max(passed, closed.history.length)

    @property
    def samples(self) -> int:
        """Number of samples in the sums."""
        return self._closed.samples + self.open_samples

    @property
    def open_samples(self) -> int:
        """Number of samples in the open segment."""
        return 0 if self._open is None else self._open.samples

    @property
    def sums(self) -> AllanSums:
        """The sums if the open segment ended here; the state does not change."""
        exact = self._exact
        return replace(exact, history=exact.history.rounded())

    @property
    def _exact(self) -> AllanSums:
        if self._open is None:
            return self._closed
        now = self._open.sums(self._closed.identity, self._closed.axes)
        return self._closed.extended(now, continues=True)
