# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Running Allan sums of a stream, computed in one pass by a cascade of decimated phases.

Level j of the cascade stores the phase (the cumulative sum of the samples) at every 2^j-th sample,
in blocks of `BLOCK` points. When a block is full, its second differences at the averaging factors
of the level are squared and summed, and every second point is passed to level j + 1. Blocks are
counted from the start of the segment, so the sums are the same, bit for bit, for any chunking.

Source of the statistic: IEEE Std 952-1997 annex C; NIST SP 1065 eq. 11 (overlapping Allan
variance). To avoid rounding errors, the first sample of the segment is subtracted from all samples,
and the phase starts from 0 in each block of level 0. Without this, an offset of 9.8 m/s^2 would
cause relative errors of up to 1e-5 at the longest factors after 1e9 samples.
"""

from __future__ import annotations

import itertools
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
"""Largest number of points in the phase record of a segment. When it is full, every second point is
dropped."""

_OVERLAP = 2 * LEVEL_FACTORS[-1]
"""Number of points of the previous block that a level keeps: the length of its longest second
difference."""


@dataclass
class _LevelSums:
    """Sums of squared second differences at the averaging factors of one level."""

    bins: dict[int, Floats]  # age bin -> (factors, axes) sums over the differences that start in it
    periods: dict[int, PeriodSums]  # row of the factors 1, 4, 16 ... -> sums by period
    groups: Floats  # (factors, axes) sums over non-overlapping differences

    @classmethod
    def empty(cls, factors: Sequence[int], axes: int) -> _LevelSums:
        fours = {i: m for i, m in enumerate(factors) if m.bit_count() == 1 and m.bit_length() % 2}
        periods = {i: PeriodSums(m, [], []) for i, m in fours.items()}
        return cls({}, periods, np.zeros((len(factors), axes)))

    def copy(self) -> _LevelSums:
        return _LevelSums(
            {index: squares.copy() for index, squares in self.bins.items()},
            {i: PeriodSums(p.m, p.begins[:], p.sums[:]) for i, p in self.periods.items()},
            self.groups.copy(),
        )


class _Level:
    """Phase at every 2^j-th sample of the open segment, and the sums of its second differences.

    ``points`` contains the last `_OVERLAP` points of the previous block, then the first ``fill``
    points of the current block, whose differences are not summed yet.
    """

    def __init__(self, level: int, axes: int, offset: int) -> None:
        self.level = level
        self.factors = LEVEL_FACTORS if level else FIRST_FACTORS + LEVEL_FACTORS
        self.offset = offset
        self.points = np.empty((axes, _OVERLAP + BLOCK))
        self.fill = 0
        self.summed = 0
        self.first: Floats | None = None  # (axes, _OVERLAP) points of the first block
        self.bin, self.bin_starts = 0, (0, 0)  # last used age bin; first difference in and after it
        self.sums = _LevelSums.empty([f << level for f in self.factors], axes)

    @property
    def overlap(self) -> int:
        """Number of points kept of the previous block."""
        return min(self.summed, _OVERLAP)

    def block(self) -> Floats:
        """Return a view of the points of the current block, (axes, fill)."""
        return self.points[:, _OVERLAP : _OVERLAP + self.fill]

    def sum_block(self) -> Floats:
        """Add the full block to the sums, begin a new one, and return every second point."""
        self._add(self.points[:, _OVERLAP - self.overlap :], self.sums)
        if self.first is None:
            self.first = self.block()[:, :_OVERLAP].copy()
        decimated = self.block()[:, ::2].copy()
        self.points[:, :_OVERLAP] = self.points[:, BLOCK:]
        self.summed += BLOCK
        self.fill = 0
        return decimated

    def snapshot(self, new: Floats) -> tuple[_LevelSums, Floats, Floats]:
        """Return the sums as if the segment ended with the points ``new``, (axes, n).

        The second and third value are the first and the last `_OVERLAP` points of the segment.
        """
        points = np.concatenate([self.points[:, _OVERLAP - self.overlap : _OVERLAP], new], axis=1)
        sums = self.sums.copy()
        self._add(points, sums)
        first = points[:, :_OVERLAP] if self.first is None else self.first
        return sums, first, points[:, -_OVERLAP:]

    def _add(self, points: Floats, sums: _LevelSums) -> None:
        """Add the squares of all differences that end after the first ``overlap`` points."""
        scratch = np.empty((2, *points.shape))
        length = self.offset + ((self.summed + points.shape[1] - self.overlap) << self.level)
        for i, f in enumerate(self.factors):
            before = min(self.overlap, 2 * f)
            window = points[:, self.overlap - before :]
            number = window.shape[1] - 2 * f
            if number <= 0:
                continue
            g = scratch[0, :, : number + f]
            np.subtract(window[:, f:], window[:, :-f], out=g)
            d = scratch[1, :, :number]
            np.subtract(g[:, f:], g[:, :-f], out=d)
            first = self.summed - before
            by_bin = [
                (index, _squares(d[:, low:high]))
                for index, low, high in self._split_by_bin(first, number)
            ]
            for index, squares in by_bin:
                if index not in sums.bins:
                    sums.bins[index] = np.zeros_like(sums.groups)
                sums.bins[index][i] += squares
            apart = d[:, -first % f :: f]
            sums.groups[i] += _squares(apart) if f > 1 or len(by_bin) > 1 else by_bin[0][1]
            if i in sums.periods:
                by_period = sums.periods[i]
                period = by_period.shortest(length)
                age = self.offset + (first << self.level)
                begin = age - age % period
                split = self._first_start(begin + period) - first
                if split >= number and len(by_bin) == 1:
                    squares = by_bin[0][1][None]
                else:
                    squares = _squares_by_part(d, split, period >> self.level)
                by_period.add(range(begin, begin + len(squares) * period, period), squares)
                by_period.merge(length)

    def _split_by_bin(self, first: int, number: int) -> list[tuple[int, int, int]]:
        """Split ``number`` differences by age bin: (bin, low, high) relative to ``first``."""
        begin, end = self.bin_starts
        if begin <= first and first + number <= end:
            return [(self.bin, 0, number)]
        found, low = [], 0
        while low < number:
            self.bin = age_bin(self.offset + ((first + low) << self.level))
            begin, end = (self._first_start(edge_age(self.bin + i)) for i in (0, 1))
            self.bin_starts = begin, end
            high = min(number, end - first)
            found.append((self.bin, low, high))
            low = high
        return found

    def _first_start(self, age: int) -> int:
        """Return the index of the first difference that starts at ``age`` samples or later."""
        return -((self.offset - age) >> self.level)


def _squares(d: Floats) -> Floats:
    """Return the sum of squares of each row, computed by one dot product per row."""
    return np.asarray(np.matmul(d[:, None, :], d[:, :, None])[:, 0, 0])


def _squares_by_part(d: Floats, split: int, size: int) -> Floats:
    """Return row sums of squares of the columns before ``split``, then of each ``size`` columns."""
    end = split + max(0, d.shape[1] - split) // size * size
    inner = d[:, split:end].reshape(len(d), -1, size)
    parts = [_squares(d[:, :split])[None]]
    parts.append(np.matmul(inner[:, :, None, :], inner[:, :, :, None])[:, :, 0, 0].T)
    if end < d.shape[1]:
        parts.append(_squares(d[:, end:])[None])
    return np.concatenate(parts)


def _signed_sum(first: Floats, last: Floats, lag: int) -> Floats:
    """Return the sum of all second differences d of a segment at a lag, (axes,).

    Only 2 * lag points of the phase theta at each end are needed, because the sum telescopes:
    d(u) = g(u + lag) - g(u) with g(u) = theta(u + lag) - theta(u).
    """
    head = first[:, lag : 2 * lag] - first[:, :lag]
    tail = last[:, -lag:] - last[:, -2 * lag : -lag]
    return np.asarray(tail.sum(axis=1) - head.sum(axis=1))


class _DecimatedPhase:
    """The phase of a segment at a few ages (in samples since the start of the recording).

    The ages are the multiples of ``step``, a power of two. The step is doubled when the age reaches
    ``points`` steps. The segment begins at the age ``offset``.
    """

    def __init__(self, axes: int, points: int, offset: int = 0) -> None:
        self._limit, self._offset = points, offset
        self.step = 1
        self.points = np.empty((axes, 0))

    def extended(self, theta: Floats, base: Floats, first: int) -> tuple[Floats, int]:
        """Return points and step after appending the phase ``base + theta``, (axes, n).

        ``first`` is the index of its first value in the segment. The object is not changed.
        """
        age, step = self._offset + first, self.step
        points = np.concatenate([self.points, theta[:, -age % step :: step] + base], axis=1)
        while age + theta.shape[1] - 1 >= self._limit * step:
            odd = -(-self._offset // step) % 2
            points, step = points[:, odd::2], 2 * step
        return points, step


class _OpenSegment:
    """The cascade of the current segment, and its phase decimated for two other statistics."""

    def __init__(self, axes: int, reference: Floats, start_ns: int, offset: int = 0) -> None:
        self.offset = offset
        self.reference = reference[:, None].copy()
        self.start_ns = self.last_ns = start_ns
        self.samples = 0
        # phase at the end of level 0 = base (phase before its current block) + theta
        self.base = np.zeros((axes, 1))
        self.theta = np.zeros(axes)
        self.levels = [_Level(0, axes, offset)]
        self.record = _DecimatedPhase(axes, PHASE_POINTS)  # for the `SegmentRecord`
        self.cells = _DecimatedPhase(axes, CELLS, offset)  # for the means of the `Recording`
        bottom = self.levels[0]
        bottom.points[:, _OVERLAP] = 0.0  # theta(0)
        bottom.fill = 1

    def feed(self, rows: Floats) -> None:
        """Add samples, (axes, n)."""
        at, n = 0, rows.shape[1]
        bottom = self.levels[0]
        while at < n:
            take = min(BLOCK - bottom.fill, n - at)
            begin = _OVERLAP + bottom.fill
            phase = bottom.points[:, begin : begin + take]
            np.subtract(rows[:, at : at + take], self.reference, out=phase)
            # adding theta before cumsum makes the order of additions the same for any chunking
            phase[:, 0] += self.theta
            np.cumsum(phase, axis=1, out=phase)
            self.theta = phase[:, -1].copy()
            bottom.fill += take
            at += take
            if bottom.fill == BLOCK:
                self._sum_full_blocks()
        self.samples += n

    def _sum_full_blocks(self) -> None:
        """Sum the full block of level 0, and all blocks of higher levels that become full."""
        bottom = self.levels[0]
        for phase in (self.record, self.cells):
            phase.points, phase.step = phase.extended(bottom.block(), self.base, bottom.summed)
        decimated = bottom.sum_block() + self.base
        last = bottom.points[:, _OVERLAP - 1 : _OVERLAP].copy()
        self.base += last
        bottom.points[:, :_OVERLAP] -= last  # a constant in the phase changes no difference
        self.theta[:] = 0.0
        for j in itertools.count(1):
            if j == len(self.levels):
                self.levels.append(_Level(j, len(decimated), self.offset))
            level = self.levels[j]
            begin = _OVERLAP + level.fill
            level.points[:, begin : begin + decimated.shape[1]] = decimated
            level.fill += decimated.shape[1]
            if level.fill < BLOCK:
                return
            decimated = level.sum_block()

    def sums(self, identity: ImuIdentity, axes: tuple[str, ...]) -> AllanSums:
        """Return the sums as if the segment ended with the last sample; the state is unchanged."""
        n = self.samples
        m, stride = grid_for(n)
        shape = (len(m), len(axes))
        bins: dict[int, Floats] = {}
        groups, signed = np.zeros(shape), np.zeros(shape)
        by_period: list[PeriodSums] = []
        decimated = np.empty((len(axes), 0))  # points of the level below that are not summed yet
        j = row = 0
        while row < len(m):
            level = self.levels[j] if j < len(self.levels) else _Level(j, len(axes), self.offset)
            new = np.concatenate([level.block(), decimated], axis=1)
            sums, first, last = level.snapshot(new)
            by_period += sums.periods.values()
            factors = level.factors[: len(m) - row]
            rows = slice(row, row + len(factors))
            groups[rows] = sums.groups[: len(factors)]
            for index, squares in sums.bins.items():
                bins.setdefault(index, np.zeros(shape))[rows] = squares[: len(factors)]
            signed[rows] = [_signed_sum(first, last, f) for f in factors]
            decimated = new[:, ::2] + self.base if j == 0 else new[:, ::2]
            row += len(factors)
            j += 1
        sum_sq = sum((bins[index] for index in sorted(bins)), np.zeros(shape))
        bottom = self.levels[0]
        phase, step = self.record.extended(bottom.block(), self.base, bottom.summed)
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
        """Yield the age bins of the segment; ``squares`` maps bins to (factors, axes) sums."""
        for index in sorted(squares):
            ages = np.array([[edge_age(index)], [edge_age(index + 1)]])
            count = np.diff(starts_before(ages, m, stride, self.offset, self.samples), axis=0)[0]
            count = np.trim_zeros(count, 'b')
            if len(count):
                yield AgeBin(index, count, squares[index][: len(count)], (), squares[index][:0])

    def _recording(self, by_period: list[PeriodSums]) -> Recording:
        """Return the `Recording` of the segment: means by cell, and sums of squares by period."""
        offset, bottom, axes = self.offset, self.levels[0], len(self.theta)
        phase, step = self.cells.extended(bottom.block(), self.base, bottom.summed)
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
        means = np.concatenate([np.zeros((first, axes)), means])
        cells = (step, samples, means, self.reference[:, 0].copy())
        return Recording(self.start_ns, length, self.samples, *cells, begins, count, sum_sq)


class RunningAllan:
    """Running Allan sums of one stream of evenly spaced samples.

    It needs O(log^2 n) memory for n samples and O(1) time per sample. Any chunking of the same
    samples gives the same sums, bit for bit.

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
        self._closed = AllanSums.empty(identity, axes)  # sums of the segments that have ended
        self._start_ns = 0
        self._open: _OpenSegment | None = None

    def update(self, samples: ArrayLike, first_ns: int, last_ns: int) -> None:
        """Add finite samples, (n, axes), that directly follow the previous ones.

        ``first_ns`` and ``last_ns`` are the stamps of the first and the last of them, in ns.
        """
        values = np.asarray(samples, float)
        if not len(values):
            return
        if self._open is None:
            age = self._age(first_ns)
            self._open = _OpenSegment(len(self._closed.axes), values[0], first_ns, age)
        self._open.feed(values.T)
        self._open.last_ns = last_ns

    def end_segment(self) -> None:
        """End the current segment; the next sample starts a new one.

        No second difference contains samples of two segments.
        """
        self._closed = self._exact
        self._open = None

    def _age(self, first_ns: int) -> int:
        """Return the age in samples of a segment that begins at ``first_ns``, 0 for the first."""
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
        """Number of samples in all segments."""
        return self._closed.samples + self.open_samples

    @property
    def open_samples(self) -> int:
        """Number of samples in the current segment."""
        return 0 if self._open is None else self._open.samples

    @property
    def sums(self) -> AllanSums:
        """The sums as if the current segment ended with the last sample; the state is unchanged."""
        exact = self._exact
        return replace(exact, history=exact.history.rounded())

    @property
    def _exact(self) -> AllanSums:
        if self._open is None:
            return self._closed
        now = self._open.sums(self._closed.identity, self._closed.axes)
        return self._closed.extended(now, continues=True)
