# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The cascade of the open segment: every sample is summed once a level, in O(log samples) memory.

Level j holds the phase at every 2^j-th sample in blocks of `BLOCK` points; a full block is summed
at the factors of its level, and every second point goes up to level j + 1. Blocks are counted from
the start of the segment, so the sums do not depend on how the samples were chunked, to the last
bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import AllanError
from ..imu import AXES, ImuIdentity
from .sums import FIRST_FACTORS, LEVEL_FACTORS, AllanSums, SegmentRecord, counts, grid_for

Floats = NDArray[np.float64]


BLOCK = 4096
"""Phase points a level gathers before it sums them: fits the cache, amortises numpy's calls."""


PHASE_POINTS = 128
"""Most points of a segment's coarse phase record; beyond, every second one is dropped."""


_HISTORY = 2 * LEVEL_FACTORS[-1]
"""Points a level keeps of the block before: the reach of its longest second difference."""


_ALL_FACTORS = FIRST_FACTORS + LEVEL_FACTORS


class _Level:
    """Phase at every 2^j-th sample of the open segment, and its sums of squares so far.

    ``points[:, :_HISTORY]`` are the last points of the block before (once there is one), then come
    ``fill`` points that wait to be summed.
    """

    def __init__(self, factors: tuple[int, ...], axes: int) -> None:
        self.factors = factors
        self.points = np.empty((axes, _HISTORY + BLOCK))
        self.fill = 0
        self.summed = 0
        self.first: Floats | None = None
        self.sum_sq = np.zeros((len(factors), axes))
        self.group_sum_sq = np.zeros((len(factors), axes))

    @property
    def past(self) -> int:
        """How many points of history there are."""
        return min(self.summed, _HISTORY)

    def waiting(self) -> Floats:
        """Return the points that wait, (axes, fill), as a view."""
        return self.points[:, _HISTORY : _HISTORY + self.fill]

    def sum_block(self) -> Floats:
        """Sum the full block, keep its end as history, return every second point for above."""
        sum_sq, group_sum_sq = self.sums_of(self.points[:, _HISTORY - self.past :])
        self.sum_sq += sum_sq
        self.group_sum_sq += group_sum_sq
        if self.first is None:
            self.first = self.waiting()[:, :_HISTORY].copy()
        upward = self.waiting()[:, ::2].copy()
        self.points[:, :_HISTORY] = self.points[:, BLOCK:]
        self.summed += BLOCK
        self.fill = 0
        return upward

    def with_history(self, new: Floats) -> Floats:
        """Return new points, (axes, n), behind the history they follow on."""
        return np.concatenate([self.points[:, _HISTORY - self.past : _HISTORY], new], axis=1)

    def sums_of(self, points: Floats) -> tuple[Floats, Floats]:
        """Return sum d^2 of every d that ends in new points: all, and the groups'.

        points : (axes, history + new), the new ones behind the history they follow on.
        """
        sum_sq = np.zeros_like(self.sum_sq)
        group_sum_sq = np.zeros_like(self.sum_sq)
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
            sum_sq[i] = _squares(d)
            first_start = self.summed - reach
            group_sum_sq[i] = _squares(d[:, -first_start % f :: f]) if f > 1 else sum_sq[i]
        return sum_sq, group_sum_sq

    def ends(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the first and the last points of the level; arguments as of `sums_of`."""
        first = points[:, :_HISTORY] if self.first is None else self.first
        return first, points[:, -_HISTORY:]


def _squares(d: Floats) -> Floats:
    """Return the sum of squares of each row: one dot product a row, the fastest numpy has."""
    sums: Floats = np.matmul(d[:, None, :], d[:, :, None])[:, 0, 0]
    return sums


def _signed_sum(first: Floats, last: Floats, lag: int) -> Floats:
    """Return the sum of all d of a lag from the first and the last 2 lag points.

    The sum telescopes: with g(u) = theta(u + lag) - theta(u), d(u) = g(u + lag) - g(u), so the sum
    is that of the last ``lag`` of g less that of the first.
    """
    head = first[:, lag : 2 * lag] - first[:, :lag]
    tail = last[:, -lag:] - last[:, -2 * lag : -lag]
    out: Floats = tail.sum(axis=1) - head.sum(axis=1)
    return out


class _CoarsePhase:
    """At most `PHASE_POINTS` points of the phase of a segment, evenly spaced from its start."""

    def __init__(self, axes: int) -> None:
        self.step = 1
        self.points = np.empty((axes, 0))

    def extended(self, theta: Floats, base: Floats, first: int) -> tuple[Floats, int]:
        """Return points and step with base + theta added, whose first point has that index."""
        step = self.step
        points = np.concatenate([self.points, theta[:, -first % step :: step] + base], axis=1)
        while points.shape[1] > PHASE_POINTS:
            points, step = points[:, ::2], 2 * step
        return points, step


class OpenSegment:
    """The cascade of the segment that is being fed."""

    def __init__(self, axes: int, reference: Floats, start_ns: int) -> None:
        self.reference = reference[:, None].copy()
        self.start_ns = self.last_ns = start_ns
        self.samples = 0
        # The phase at level 0 is counted from ``base``, where its block begins: with small numbers
        # the rounding of a running sum of 1e8 samples stays small too.
        self.base = np.zeros((axes, 1))
        self.theta = np.zeros(axes)
        self.levels = [_Level(_ALL_FACTORS, axes)]
        self.coarse = _CoarsePhase(axes)
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
        self.coarse.points, self.coarse.step = self.coarse.extended(
            bottom.waiting(), self.base, bottom.summed
        )
        upward = bottom.sum_block() + self.base
        last = bottom.points[:, _HISTORY - 1 : _HISTORY].copy()
        self.base += last
        bottom.points[:, :_HISTORY] -= last  # a constant in the phase changes no difference
        self.theta[:] = 0.0
        j = 1
        while upward.shape[1]:
            if j == len(self.levels):
                self.levels.append(_Level(LEVEL_FACTORS, len(upward)))
            level = self.levels[j]
            begin = _HISTORY + level.fill
            level.points[:, begin : begin + upward.shape[1]] = upward
            level.fill += upward.shape[1]
            if level.fill < BLOCK:
                return
            upward = level.sum_block()
            j += 1

    def sums(self, identity: ImuIdentity, axes: tuple[str, ...]) -> AllanSums:
        """Return the segment's sums as if it ended here; nothing is changed."""
        m, stride = grid_for(self.samples)
        sum_sq: list[Floats] = []
        groups: list[Floats] = []
        signed: list[Floats] = []
        carry = np.empty((len(self.theta), 0))
        j = 0
        while len(sum_sq) < len(m):
            level = self.levels[j] if j < len(self.levels) else _Level(LEVEL_FACTORS, len(carry))
            new = np.concatenate([level.waiting(), carry], axis=1)
            points = level.with_history(new)
            tail_sq, tail_groups = level.sums_of(points)
            sum_sq += list(level.sum_sq + tail_sq)
            groups += list(level.group_sum_sq + tail_groups)
            first, last = level.ends(points)
            reached = level.factors[: len(m) - len(signed)]
            signed += [_signed_sum(first, last, f) for f in reached]
            carry = new[:, ::2] + self.base if j == 0 else new[:, ::2]
            j += 1
        bottom = self.levels[0]
        phase, step = self.coarse.extended(bottom.waiting(), self.base, bottom.summed)
        cut = (len(m), len(axes))
        record = SegmentRecord(
            self.start_ns,
            self.samples,
            np.array(signed).reshape(cut),
            phase.T.copy(),
            step,
        )
        return AllanSums(
            identity,
            axes,
            counts(self.samples, m, stride),
            np.array(sum_sq[: len(m)]).reshape(cut),
            counts(self.samples, m, m),
            np.array(groups[: len(m)]).reshape(cut),
            (record,),
            elapsed_ns=self.last_ns - self.start_ns,
            intervals=self.samples - 1,
        )


@dataclass(frozen=True)
class AllanTable:
    """Allan sums of one finite record at chosen factors.

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

    Memory is O(log samples), time O(1) per sample. Any chunking of the same samples gives the same
    sums, bit for bit.

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
        self._open: OpenSegment | None = None

    def update(self, samples: ArrayLike, first_ns: int, last_ns: int) -> None:
        """Add samples that follow on the last ones without a cut.

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
            self._open = OpenSegment(len(self._closed.axes), values[0], first_ns)
        self._open.feed(values.T)
        self._open.last_ns = last_ns

    def end_segment(self) -> None:
        """Cut: the next sample starts a new segment, and no difference straddles the cut."""
        self._closed = self.sums
        self._open = None

    @property
    def open_samples(self) -> int:
        """Samples of the open segment."""
        return 0 if self._open is None else self._open.samples

    @property
    def sums(self) -> AllanSums:
        """The sums of all that came, as if the open segment ended here; nothing is disturbed."""
        if self._open is None:
            return self._closed
        now = self._open.sums(self._closed.identity, self._closed.axes)
        return self._closed.extended(now)
