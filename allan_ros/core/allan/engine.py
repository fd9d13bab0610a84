# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The engine: running Allan sums of a stream in O(log samples) memory.

Level j of the cascade holds the phase at every 2^j-th sample in blocks of `BLOCK` points. A full
block is summed at the factors of its level, and every second point is passed to level j + 1. Blocks
are counted from the start of the segment, so the sums are the same, bit for bit, for any chunking.
Every second difference is counted in the age bin in which it starts (see `history`).

Source of the statistic: IEEE Std 952-1997 annex C; NIST SP 1065 eq. 11 (overlapping Allan
variance). The phase is counted from the first sample of the segment, block by block: with raw sums
an offset of 9.8 m/s^2 costs up to 1e-5 of the longest factors after 1e9 samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import AllanError
from ..imu import AXES, ImuIdentity
from .history import (
    CELLS,
    PERIOD_OVER_FACTOR,
    PERIODS,
    History,
    PeriodSums,
    Recording,
    SegmentAges,
    bins_of,
    cell_step,
    short,
    starts_between,
)
from .sums import FIRST_FACTORS, LEVEL_FACTORS, AllanSums, SegmentRecord, counts, grid_for

Floats = NDArray[np.float64]


BLOCK = 4096
"""Phase points of a block: it fits the cache and amortizes the overhead of numpy calls."""


PHASE_POINTS = 128
"""Most points of the phase record of a segment; when full, every second one is dropped."""


_HISTORY = 2 * LEVEL_FACTORS[-1]
"""Points a level keeps of the previous block: the reach of its longest second difference."""


_ALL_FACTORS = FIRST_FACTORS + LEVEL_FACTORS


class _LevelSums:
    """Sums of squares of a level: of all differences by the age of their start, and the groups'.

    Attributes
    ----------
    bins : dict of bin index to (factors, axes) float64 array
    groups : (factors, axes) float64 array
    """

    def __init__(self, factors: int, axes: int) -> None:
        self.bins: dict[int, Floats] = {}
        self.groups = np.zeros((factors, axes))

    def of_bin(self, index: int) -> Floats:
        """Return the sums of one bin, to be added to."""
        if index not in self.bins:
            self.bins[index] = np.zeros_like(self.groups)
        return self.bins[index]

    def copy(self) -> _LevelSums:
        """Return a copy that can be added to."""
        other = _LevelSums(*self.groups.shape)
        other.bins = {index: squares.copy() for index, squares in self.bins.items()}
        other.groups = self.groups.copy()
        return other


class _Level:
    """Phase at every 2^j-th sample of the open segment, and its sums of squares so far.

    ``points[:, :_HISTORY]`` are the last points of the previous block, if there is one; ``fill``
    points that are not summed yet follow.
    """

    def __init__(self, level: int, axes: int, ages: SegmentAges) -> None:
        self.level = level
        self.factors = LEVEL_FACTORS if level else _ALL_FACTORS
        self.ages = ages
        self.points = np.empty((axes, _HISTORY + BLOCK))
        self.fill = 0
        self.summed = 0
        self.first: Floats | None = None
        self.sums = _LevelSums(len(self.factors), axes)
        # every second octave is also summed by period
        self.by_period = {
            i: PeriodSums(axes)
            for i, f in enumerate(self.factors)
            if (f << level).bit_count() == 1 and (f << level).bit_length() % 2
        }

    @property
    def past(self) -> int:
        """Number of points kept of the previous block."""
        return min(self.summed, _HISTORY)

    def waiting(self) -> Floats:
        """Return the points that are not summed yet, (axes, fill), as a view."""
        return self.points[:, _HISTORY : _HISTORY + self.fill]

    def sum_block(self) -> Floats:
        """Sum the full block, keep its end, and return every second point for the next level."""
        period = cell_step(self.ages.offset + ((self.summed + BLOCK) << self.level), PERIODS)
        self._add(self.points[:, _HISTORY - self.past :], period, self.sums, self.by_period)
        if self.first is None:
            self.first = self.waiting()[:, :_HISTORY].copy()
        upward = self.waiting()[:, ::2].copy()
        self.points[:, :_HISTORY] = self.points[:, BLOCK:]
        self.summed += BLOCK
        self.fill = 0
        return upward

    def with_history(self, new: Floats) -> Floats:
        """Return the end of the previous block followed by new points, (axes, n)."""
        return np.concatenate([self.points[:, _HISTORY - self.past : _HISTORY], new], axis=1)

    def sums_with(self, points: Floats, period: int) -> tuple[_LevelSums, dict[int, Floats]]:
        """Return the sums so far and those of every difference that ends in new points.

        Parameters
        ----------
        points : (axes, history + new) float64 array
            The new points behind the history they follow on.
        period : int
            Length in samples of the periods to sum by.

        Returns
        -------
        sums : _LevelSums
        by_period : dict of factor to (periods, axes) float64 array
        """
        sums = self.sums.copy()
        by_period = {
            i: sums_so_far.copy()
            for i, sums_so_far in self.by_period.items()
            if PERIOD_OVER_FACTOR * (self.factors[i] << self.level) <= period
        }
        self._add(points, period, sums, by_period)
        return sums, {self.factors[i] << self.level: p.at(period) for i, p in by_period.items()}

    def _add(
        self, points: Floats, period: int, sums: _LevelSums, by_period: dict[int, PeriodSums]
    ) -> None:
        """Add the squares of every difference that ends in new points, as of `sums_with`."""
        scratch = np.empty((2, *points.shape))
        for i, f in enumerate(self.factors):
            reach = min(self.past, 2 * f)
            window = points[:, self.past - reach :]
            length = window.shape[1] - 2 * f
            if length <= 0:
                continue
            g = scratch[0, :, : length + f]
            np.subtract(window[:, f:], window[:, :-f], out=g)
            d = scratch[1, :, :length]
            np.subtract(g[:, f:], g[:, :-f], out=d)
            first = self.summed - reach
            pieces = [
                (index, _squares(d[:, low:high]))
                for index, low, high in self.ages.by_bin(first, length, self.level)
            ]
            for index, squares in pieces:
                sums.of_bin(index)[i] += squares
            every = d[:, -first % f :: f]
            sums.groups[i] += _squares(every) if f > 1 or len(pieces) > 1 else pieces[0][1]
            if i in by_period:
                at, begins = self.ages.by_period(first, length, self.level, period)
                if len(begins) > 1:
                    by_period[i].add(period, at, np.add.reduceat(d * d, begins, axis=1).T)
                elif len(pieces) == 1:
                    by_period[i].add(period, at, pieces[0][1][None])
                else:
                    by_period[i].add(period, at, _squares(d)[None])

    def ends(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the first and the last points of the level; ``points`` as in `sums_with`."""
        first = points[:, :_HISTORY] if self.first is None else self.first
        return first, points[:, -_HISTORY:]


def _squares(d: Floats) -> Floats:
    """Return the sum of squares of each row, by one dot product per row."""
    sums: Floats = np.matmul(d[:, None, :], d[:, :, None])[:, 0, 0]
    return sums


def _signed_sum(first: Floats, last: Floats, lag: int) -> Floats:
    """Return the sum of all d at a lag, from the first and the last 2 lag points.

    The sum telescopes: with g(u) = theta(u + lag) - theta(u), d(u) = g(u + lag) - g(u), so the sum
    is that of the last ``lag`` of g less that of the first.
    """
    head = first[:, lag : 2 * lag] - first[:, :lag]
    tail = last[:, -lag:] - last[:, -2 * lag : -lag]
    out: Floats = tail.sum(axis=1) - head.sum(axis=1)
    return out


class _SparsePhase:
    """The phase of a segment at ages that are multiples of a step, a power of two.

    Parameters
    ----------
    axes : int
    points : int
        The step doubles whenever the last age reaches that many steps.
    offset : int
        Age of the first sample of the segment.
    """

    def __init__(self, axes: int, points: int, offset: int = 0) -> None:
        self._limit, self._offset = points, offset
        self.step = 1
        self.points = np.empty((axes, 0))

    def extended(self, theta: Floats, base: Floats, first: int) -> tuple[Floats, int]:
        """Return points and step with base + theta added, whose first point has that index."""
        age, step = self._offset + first, self.step
        points = np.concatenate([self.points, theta[:, -age % step :: step] + base], axis=1)
        while age + theta.shape[1] - 1 >= self._limit * step:
            odd = -(-self._offset // step) % 2
            points, step = points[:, odd::2], 2 * step
        return points, step


class OpenSegment:
    """The cascade of the open segment."""

    def __init__(self, axes: int, reference: Floats, start_ns: int, offset: int = 0) -> None:
        self.ages = SegmentAges(offset)
        self.reference = reference[:, None].copy()
        self.start_ns = self.last_ns = start_ns
        self.samples = 0
        # The phase at level 0 is counted from ``base``, where its block begins: with small numbers
        # the rounding of a running sum of 1e8 samples stays small too.
        self.base = np.zeros((axes, 1))
        self.theta = np.zeros(axes)
        self.levels = [_Level(0, axes, self.ages)]
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
            # theta goes into the first term, so the sum runs on in the same order in any chunking
            phase[:, 0] += self.theta
            np.cumsum(phase, axis=1, out=phase)
            self.theta = phase[:, -1].copy()
            bottom.fill += take
            at += take
            if bottom.fill == BLOCK:
                self._sum_from_bottom()
        self.samples += n

    def _sum_from_bottom(self) -> None:
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
                self.levels.append(_Level(j, len(upward), self.ages))
            level = self.levels[j]
            begin = _HISTORY + level.fill
            level.points[:, begin : begin + upward.shape[1]] = upward
            level.fill += upward.shape[1]
            if level.fill < BLOCK:
                return
            upward = level.sum_block()
            j += 1

    def sums(self, identity: ImuIdentity, axes: tuple[str, ...]) -> AllanSums:
        """Return the sums of the segment as if it ended here; the state does not change."""
        m, stride = grid_for(self.samples)
        period = cell_step(self.ages.offset + self.samples, PERIODS)
        shape = (len(m), len(axes))
        bins: dict[int, Floats] = {}
        groups, signed = np.zeros(shape), np.zeros(shape)
        by_period: dict[int, Floats] = {}
        carry = np.empty((len(axes), 0))
        j = row = 0
        while row < len(m):
            level = self.levels[j] if j < len(self.levels) else _Level(j, len(axes), self.ages)
            new = np.concatenate([level.waiting(), carry], axis=1)
            points = level.with_history(new)
            sums, level_by_period = level.sums_with(points, period)
            by_period.update(level_by_period)
            reached = level.factors[: len(m) - row]
            rows = slice(row, row + len(reached))
            groups[rows] = sums.groups[: len(reached)]
            for index, squares in sums.bins.items():
                bins.setdefault(index, np.zeros(shape))[rows] = squares[: len(reached)]
            first, last = level.ends(points)
            signed[rows] = [_signed_sum(first, last, f) for f in reached]
            carry = new[:, ::2] + self.base if j == 0 else new[:, ::2]
            row += len(reached)
            j += 1
        sum_sq = np.zeros(shape)
        for index in sorted(bins):
            sum_sq += bins[index]
        bottom = self.levels[0]
        phase, step = self.coarse.extended(bottom.waiting(), self.base, bottom.summed)
        record = SegmentRecord(
            self.start_ns, self.samples, signed, phase.T.copy(), step, self.ages.offset
        )
        history = History.of_segment(
            bins_of(bins, m, stride, self.ages.offset, self.samples),
            self._recording(period, by_period),
        )
        return AllanSums(
            identity,
            axes,
            counts(self.samples, m, stride),
            sum_sq,
            counts(self.samples, m, m),
            groups,
            (record,),
            elapsed_ns=self.last_ns - self.start_ns,
            intervals=self.samples - 1,
            history=history,
        )

    def _recording(self, period: int, by_period: dict[int, Floats]) -> Recording:
        """Return the means by cell and the sums of squares by period of this segment."""
        offset, bottom, axes = self.ages.offset, self.levels[0], len(self.theta)
        phase, step = self.cells.extended(bottom.waiting(), self.base, bottom.summed)
        first = -(-offset // step)
        means = np.diff(phase, axis=1).T / step
        samples = np.zeros(first + len(means), np.int64)
        samples[first:] = step
        kept = [m for m in (4**i for i in range(len(by_period))) if m in by_period]
        number = (offset + self.samples) // period + 1
        count = np.zeros((number, len(kept)), np.int64)
        sum_sq = np.zeros((number, len(kept), axes))
        for i, m in enumerate(kept):
            stride = np.array([max(1, m // LEVEL_FACTORS[0])])
            for at in range(offset // period, number):
                low, high = at * period, (at + 1) * period
                factor = np.array([m])
                count[at, i] = starts_between(factor, stride, offset, self.samples, low, high)[0]
            sum_sq[: len(by_period[m]), i] = by_period[m]
        return Recording(
            self.start_ns,
            offset + self.samples,
            self.samples,
            step,
            samples,
            short(np.concatenate([np.zeros((first, axes)), means])),
            self.reference[:, 0].copy(),
            period,
            count,
            short(sum_sq),
        )


@dataclass(frozen=True)
class AllanTable:
    """Allan sums of one finite record at given factors.

    Attributes
    ----------
    m, stride, n : (factors,) int64 arrays
        Averaging factor, samples between starts, and number of second differences.
    avar : (factors, ...) float64 array
        sum d^2 / (2 m^2 n).
    signed : (factors, ...) float64 array
        sum d.
    """

    m: NDArray[np.int64]
    stride: NDArray[np.int64]
    n: NDArray[np.int64]
    avar: Floats
    signed: Floats


def allan_table(y: ArrayLike, m: ArrayLike, stride: ArrayLike = 1) -> AllanTable:
    """Return the Allan variance of a record at any factors; stride 1 is full overlap.

    Parameters
    ----------
    y : (samples,) or (samples, axes) array
        Evenly spaced samples.
    m, stride : ints or (factors,) arrays
        Averaging factors, and samples between the starts of two second differences.

    Raises
    ------
    AllanError
        When a factor is not in 1 .. samples/2, or a stride is below 1.
    """
    values = np.asarray(y, float)
    ms, strides = (np.array(a) for a in np.broadcast_arrays(np.atleast_1d(m), stride))
    ms, strides = ms.astype(np.int64), strides.astype(np.int64)
    if len(ms) and (ms.min() < 1 or 2 * ms.max() > len(values) or strides.min() < 1):
        raise AllanError(
            f'factors {ms.min()} .. {ms.max()} need a record of at least {2 * ms.max()} samples '
            f'and strides of at least 1; this one has {len(values)} samples'
        )
    rows = values.reshape(len(values), -1).T
    theta = np.zeros((len(rows), len(values) + 1))
    np.cumsum(rows - rows[:, :1], axis=1, out=theta[:, 1:])
    sum_sq = np.empty((len(ms), len(rows)))
    signed = np.empty((len(ms), len(rows)))
    for i, (factor, step) in enumerate(zip(ms, strides)):
        d = _second_differences(theta, int(factor))[:, :: int(step)]
        sum_sq[i] = np.einsum('ij,ij->i', d, d)
        signed[i] = d.sum(axis=1)
    n = counts(len(values), ms, strides)
    avar = sum_sq / (2.0 * ms.astype(float)[:, None] ** 2 * n[:, None])
    shape = (len(ms), *values.shape[1:])
    return AllanTable(ms, strides, n, avar.reshape(shape), signed.reshape(shape))


def _second_differences(theta: Floats, lag: int) -> Floats:
    """Return theta(u + 2 lag) - 2 theta(u + lag) + theta(u) along the last axis, for every u."""
    g = theta[:, lag:] - theta[:, :-lag]
    return g[:, lag:] - g[:, :-lag]


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
        """Add samples that directly follow the previous ones.

        Parameters
        ----------
        samples : (n, axes) array
            Finite values.
        first_ns, last_ns : int
            Stamps of the first and the last of them.
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
        """End the segment: the next sample starts a new one, no difference spans both."""
        self._closed = self.sums
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
    def open_samples(self) -> int:
        """Number of samples in the open segment."""
        return 0 if self._open is None else self._open.samples

    @property
    def sums(self) -> AllanSums:
        """The sums of all samples as if the open segment ended here; the state does not change."""
        if self._open is None:
            return self._closed
        now = self._open.sums(self._closed.identity, self._closed.axes)
        return self._closed.extended(now, continues=True)
