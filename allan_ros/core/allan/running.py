# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Allan sums, octave spectra and block means of a stream, updated with each chunk of samples."""

from __future__ import annotations

import bisect
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..imu import AXES, ImuIdentity
from .cascade import FIRST_BLOCK, Block, Cascade, LevelSums
from .periods import (
    MAX_PERIODS,
    MEAN_BYTES,
    BlockMeans,
    Period,
    RecordedPeriods,
    bounded_means,
    pair_to_merge,
    rounded,
    totals,
)
from .replaced_stretches import no_stretches
from .sums import AllanSums, Lengths, add_lengths

Floats = NDArray[np.float64]

SEGMENT_MEANS = 512
"""Largest number of block means of a segment. If a segment has more, each pair of means is
merged."""


@dataclass(frozen=True)
class _RunningPeriod:
    """Sums over one period before they are rounded; the period may still grow."""

    begin: int  # number of samples of the recording before the period
    # stamp in ns of the first sample of the segment in which the period begins, and number of
    # samples of this segment before the period
    start: tuple[int, int]
    samples: int
    # (axes + 1,) sums of the samples minus the first sample of the recording, then the number of
    # interpolated samples
    total: Floats
    levels: tuple[LevelSums, ...] = ()  # sums of each level of the cascade, from level 0 on

    def plus(self, levels: Iterable[LevelSums]) -> _RunningPeriod:
        """Return the period with the given sums added to the sums of the same levels."""
        summed = list(self.levels)
        for level_sums in levels:
            for j in range(len(summed), level_sums.level):
                summed.append(LevelSums.zero(j, level_sums.values.shape[1]))
            if level_sums.level == len(summed):
                summed.append(level_sums)
            else:
                summed[level_sums.level] = summed[level_sums.level] + level_sums
        return _RunningPeriod(self.begin, self.start, self.samples, self.total, tuple(summed))

    def extended(self, later: _RunningPeriod) -> _RunningPeriod:
        """Return this period and the next period as one period."""
        samples, total = self.samples + later.samples, self.total + later.total
        return replace(self, samples=samples, total=total).plus(later.levels)


class _SegmentSums(NamedTuple):
    """Sums over blocks of ``step`` samples of a segment, for the block means of the segment.

    ``sums`` are (axes, blocks). The last block may have fewer samples.
    """

    sums: Floats
    step: int

    def plus(self, block: Block) -> _SegmentSums:
        """Return the sums after the samples of a block of level 0 were added.

        ``step`` doubles if there would be more than `SEGMENT_MEANS` complete sums.
        """
        samples, step, sums = block.samples[:-1], self.step, self.sums.copy()
        # number of samples that are needed to complete the last sum
        missing = min(-block.begin % step, samples.shape[1])
        if missing:
            sums[:, -1] += samples[:, :missing].sum(axis=1)
        end = samples.shape[1] - (samples.shape[1] - missing) % step
        complete_sums = samples[:, missing:end].reshape(len(samples), -1, step) @ np.ones(step)
        incomplete_sum = samples[:, end:].sum(axis=1, keepdims=True)[:, : samples.shape[1] - end]
        sums = np.concatenate([sums, complete_sums, incomplete_sum], axis=1)
        while (block.begin + samples.shape[1]) // step > SEGMENT_MEANS:
            sums, step = np.add.reduceat(sums, range(0, sums.shape[1], 2), axis=1), 2 * step
        return _SegmentSums(sums, step)


class _OpenSegment:
    """Cascade of the current segment, and sums over blocks of samples for its block means."""

    def __init__(self, first: Floats, start_ns: int, age: int) -> None:
        self.age = age  # number of samples of the recording before the segment
        self.start_ns = self.last_ns = start_ns
        self.cascade = Cascade(first)
        self.sums = _SegmentSums(np.zeros((len(first), 0)), 1)


@dataclass(frozen=True)
class _State:
    """Sums over the segments of a recording that have ended.

    ``periods`` also contains the full blocks of the current segment.
    """

    reference: Floats  # (axes,) first sample of the recording
    periods: tuple[_RunningPeriod, ...] = ()
    samples: int = 0  # number of samples of the ended segments
    elapsed_ns: int = 0  # time from the first to the last stamp, summed over the ended segments
    lengths: Lengths = ()
    means: tuple[BlockMeans, ...] = ()

    def __deepcopy__(self, memo: object) -> _State:
        """Return the state itself, because it is not changed after its creation."""
        return self

    def with_blocks(
        self, segment: _OpenSegment, blocks: Iterable[Block]
    ) -> tuple[_State, _SegmentSums]:
        """Return the state and the segment sums after blocks of the current segment were added."""
        periods, segment_sums = list(self.periods), segment.sums
        for block in blocks:
            age = segment.age + block.begin
            if block.sums.level == 0:
                segment_sums = segment_sums.plus(block)
                length = block.samples.shape[1]
                total = block.samples @ np.ones(length)
                total[:-1] += length * (segment.cascade.reference - self.reference)
                new_period = _RunningPeriod(age, (segment.start_ns, block.begin), length, total)
                if periods and periods[-1].samples < FIRST_BLOCK:
                    periods[-1] = periods[-1].extended(new_period)
                else:
                    periods.append(new_period)
                if len(periods) > MAX_PERIODS:
                    _, i = pair_to_merge([p.begin for p in periods], age + length)
                    periods[i : i + 2] = [periods[i].extended(periods[i + 1])]
            i = bisect.bisect_right([p.begin for p in periods], age) - 1
            periods[i] = periods[i].plus([block.sums])
        return replace(self, periods=tuple(periods)), segment_sums

    def with_end(self, segment: _OpenSegment) -> _State:
        """Return the state after the end of the current segment."""
        state, (sums, step) = self.with_blocks(segment, segment.cascade.open_blocks())
        shift, samples = segment.cascade.reference - self.reference, segment.cascade.samples
        values = rounded(sums[:, : samples // step].T / step + shift, MEAN_BYTES)
        means = BlockMeans(segment.age, segment.start_ns, samples, step, values)
        return replace(
            state,
            samples=self.samples + samples,
            elapsed_ns=self.elapsed_ns + segment.last_ns - segment.start_ns,
            lengths=add_lengths(self.lengths, ((samples, 1),)),
            means=bounded_means([(*self.means, means)])[0],
        )


class RunningSums:
    """Running sums of one stream of evenly spaced samples.

    The memory is O(log n) for n samples, and the time O(1) per sample. The sums are the same, bit
    for bit, for any chunking of the samples.

    Examples
    --------
    >>> import numpy as np
    >>> running = RunningSums()
    >>> running.update(np.random.default_rng(0).normal(size=(1000, 6)), 0, 9_990_000_000)
    >>> running.end_segment()
    >>> running.sums.samples, running.sums.tau0
    (1000, 0.01)
    """

    def __init__(self, identity: ImuIdentity = ImuIdentity(), axes: tuple[str, ...] = AXES) -> None:
        self._identity, self._axes = identity, axes
        self._state = _State(np.zeros(len(axes)))
        self._open: _OpenSegment | None = None

    def update(
        self,
        samples: ArrayLike,
        first_ns: int,
        last_ns: int,
        interpolated: NDArray[np.bool_] | None = None,
    ) -> None:
        """Add samples that directly follow the previous samples of the current segment.

        Parameters
        ----------
        samples : (n, axes) array
            Finite values in SI; may be empty.
        first_ns, last_ns : int
            Stamps of the first and of the last of these samples in ns.
        interpolated : (n,) array of bool, optional
            Whether each sample is interpolated on some axis; None if no sample is interpolated.
        """
        values = np.asarray(samples, float)
        if not len(values):
            return
        if self._open is None:
            if not self._state.samples:
                self._state = _State(values[0].copy())
            self._open = _OpenSegment(values[0].copy(), first_ns, self._state.samples)
        segment = self._open
        blocks = segment.cascade.feed(values.T, interpolated)
        self._state, segment.sums = self._state.with_blocks(segment, blocks)
        segment.last_ns = last_ns

    def end_segment(self) -> None:
        """End the current segment; the next sample starts a new segment.

        No second difference and no spectral block contains samples of two segments.
        """
        self._state = self._at_end
        self._open = None

    @property
    def samples(self) -> int:
        """Number of samples in all segments."""
        return self._state.samples + self.open_samples

    @property
    def open_samples(self) -> int:
        """Number of samples in the current segment."""
        return 0 if self._open is None else self._open.cascade.samples

    @property
    def sums(self) -> AllanSums:
        """The Allan sums as if the current segment ended with the last sample.

        The state is unchanged.
        """
        state = self._at_end
        intervals = state.samples - sum(number for _, number in state.lengths)
        if not state.samples:
            return AllanSums.empty(self._identity, self._axes)
        arrays_of_periods = [_arrays(p) for p in state.periods]
        count, sum_sq, group_count, group_sum_sq = (
            totals(a) for a in list(zip(*arrays_of_periods))[:4]
        )
        factors = int(np.count_nonzero(count))
        periods = tuple(
            _period(p, arrays, state.elapsed_ns, intervals)
            for p, arrays in zip(state.periods, arrays_of_periods)
        )
        return AllanSums(
            self._identity,
            self._axes,
            count[:factors],
            sum_sq[:factors],
            group_count[:factors],
            group_sum_sq[:factors],
            state.elapsed_ns,
            intervals,
            (RecordedPeriods(periods, state.means, state.reference),),
            state.lengths,
            no_stretches(len(self._axes)),
        )

    @property
    def _at_end(self) -> _State:
        return self._state if self._open is None else self._state.with_end(self._open)


def _arrays(period: _RunningPeriod) -> list[NDArray]:  # type: ignore[type-arg]
    """Return the arrays of `LevelSums.arrays` for a period, each concatenated over all levels."""
    return [np.concatenate(a) for a in zip(*(level.arrays for level in period.levels))]


def _period(
    period: _RunningPeriod,
    arrays: list[NDArray],  # type: ignore[type-arg]
    elapsed_ns: int,
    intervals: int,
) -> Period:
    """Return the rounded sums of a period; the sample period is elapsed_ns / intervals."""
    count, sum_sq, _, _, blocks, pairs, power = arrays
    start_ns, samples_before = period.start
    total, interpolated = period.total[:-1], round(float(period.total[-1]))
    begin_ns = start_ns + samples_before * elapsed_ns // max(intervals, 1)
    extent = (period.begin, period.samples, begin_ns)
    return Period(*extent, count, sum_sq, blocks, pairs, power, total, interpolated).stored()
