# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`AllanSums`: sums over the samples of an IMU, from which the noise of the IMU is computed.

Definitions
-----------
The unit of time is the sample period. The first sample of the segment is subtracted from each
sample, and the phase theta is the cumulative sum of these differences. The second difference at the
averaging factor m that starts at sample u is d(u) = theta(u + 2m) - 2 theta(u + m) + theta(u).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..imu import AXES, ImuIdentity
from .grid import allan_variance, grid, levels_of
from .periods import (
    MIN_MEANS,
    BlockMeans,
    ByValue,
    Period,
    RecordedPeriods,
    add_padded,
    bounded,
    nonzero_length,
)
from .replaced_stretches import add_stretches, no_stretches, scaled_stretches

Floats = NDArray[np.float64]

LENGTH_CLASS_RATIO = 1.1
"""Largest ratio of the lengths of two segments in a length class. Allan sums contain the number of
segments in each class, not the length of each segment."""

TAU0_TOLERANCE = 1e-3
"""Largest relative difference between the sample periods of two `AllanSums` that can be added, in
addition to the uncertainty of the periods."""

Lengths = tuple[tuple[int, int], ...]
"""Total number of samples, and number of segments, in each class of segments of similar length. The
class of the shortest segments is first."""


def length_class(samples: float) -> int:
    """Return the index of the length class of a segment: floor(log(samples) / log(1.1))."""
    return int(math.log(samples) / math.log(LENGTH_CLASS_RATIO))


def add_lengths(a: Lengths, b: Lengths) -> Lengths:
    """Return the length classes of all segments in ``a`` and ``b``."""
    total: dict[int, tuple[int, int]] = {}
    for samples, number in a + b:
        i = length_class(samples / number)
        previous = total.get(i, (0, 0))
        total[i] = previous[0] + samples, previous[1] + number
    return tuple(total[i] for i in sorted(total))


LEAST_EQUAL = 100
"""Least number of second differences, all of them 0, for which an axis is said to have no noise.
Fewer differences can be 0 by chance because the resolution is coarse."""


@dataclass(frozen=True, eq=False)
class AllanSums(ByValue):
    """Sums over the samples of one stream; ``+`` adds another recording of the same IMU.

    The order of additions changes ``sum_sq`` and ``group_sum_sq`` only by rounding errors. The
    periods and block means in ``recordings`` may depend on the order.

    Attributes
    ----------
    identity : ImuIdentity
        Frame and hardware id of the IMU.
    axes : tuple of str
        Names of the axes, in the order of `AXES` if they are the axes of an IMU. The columns of the
        sums have this order.
    count : (factors,) int64 array
        Number of second differences at each averaging factor in ``m``.
    sum_sq : (factors, axes) float64 array
        Sum of the squares d^2 of the second differences, in the squared unit of the samples.
    group_count, group_sum_sq : arrays of the same shapes
        Number, and sum of squares, of the second differences that start at the samples 0, m, 2m ...
        They give the non-overlapping Allan variance.
    elapsed_ns, intervals : int
        Time from the first to the last stamp of each segment in ns, and number of sample periods in
        this time, both summed over the segments. ``elapsed_ns`` / ``intervals`` is the sample
        period.
    recordings : tuple of RecordedPeriods
        The periods of each recording, with their sums and octave spectra, and its block means. The
        recordings are in the order of time. Of more than 24 recordings, the oldest are joined.
    lengths : tuple of pairs of int
        Total number of samples, and number of segments, of each length class. The class of the
        shortest segments is first.
    replaced : (stretches, 2 + axes) int64 array
        Table of the stretches of samples that were replaced by a line: length, level (see
        `replaced_stretches`), and number of such stretches on each axis. The rows are sorted by
        length and level.
    """

    identity: ImuIdentity
    axes: tuple[str, ...]
    count: NDArray[np.int64]
    sum_sq: Floats
    group_count: NDArray[np.int64]
    group_sum_sq: Floats
    elapsed_ns: int = 0
    intervals: int = 0
    recordings: tuple[RecordedPeriods, ...] = ()
    lengths: Lengths = ()
    replaced: NDArray[np.int64] = field(default_factory=lambda: no_stretches(0))

    @classmethod
    def empty(
        cls, identity: ImuIdentity = ImuIdentity(), axes: tuple[str, ...] = AXES
    ) -> AllanSums:
        """Return the sums over zero samples.

        Adding these sums to other sums with the same identity and axes changes nothing.
        """
        no_counts, no_sums = np.zeros(0, np.int64), np.zeros((0, len(axes)))
        no_table = no_stretches(len(axes))
        return cls(identity, axes, no_counts, no_sums, no_counts, no_sums, replaced=no_table)

    @property
    def m(self) -> NDArray[np.int64]:
        """Averaging factors in samples, (factors,), ascending."""
        return grid(levels_of(len(self.count)))[0][: len(self.count)]

    @property
    def stride(self) -> NDArray[np.int64]:
        """Samples from the start of a second difference to the next, at each factor, (factors,)."""
        return grid(levels_of(len(self.count)))[1][: len(self.count)]

    @property
    def tau0(self) -> float | None:
        """Sample period in seconds; None if no segment has two samples."""
        return self.elapsed_ns / self.intervals * 1e-9 if self.intervals else None

    @property
    def samples(self) -> int:
        """Number of samples in all segments."""
        return sum(samples for samples, _ in self.lengths)

    @property
    def segment_count(self) -> int:
        """Number of segments."""
        return sum(number for _, number in self.lengths)

    @property
    def length_histogram(self) -> tuple[tuple[float, int], ...]:
        """Mean length in samples, and number of segments, of each length class, longest first."""
        return tuple((samples / number, number) for samples, number in reversed(self.lengths))

    @property
    def periods(self) -> tuple[Period, ...]:
        """The periods of all recordings: recording by recording, each in the order of time."""
        return tuple(p for r in self.recordings for p in r.periods)

    @property
    def means(self) -> tuple[BlockMeans, ...]:
        """The block means of the longest segments of all recordings, one object per segment."""
        return tuple(m for r in self.recordings for m in r.means)

    @property
    def longest(self) -> int:
        """Number of samples of the longest segment with block means; 0 without block means."""
        return max((m.samples for m in self.means), default=0)

    @property
    def avar(self) -> Floats:
        """Overlapping Allan variance at the factors ``m``, pooled over segments, (factors, axes).

        The unit is the squared unit of the samples. Factors without data have NaN.
        """
        return allan_variance(self.sum_sq, self.m, self.count)

    @property
    def group_avar(self) -> Floats:
        """Non-overlapping Allan variance at the factors ``m``, (factors, axes).

        The unit is the squared unit of the samples. Factors without data have NaN.
        """
        return allan_variance(self.group_sum_sq, self.m, self.group_count)

    @property
    def _tau0_uncertainty(self) -> float:
        """Relative error of tau0 if both ends of each segment are wrong by one sample period."""
        return 2.0 * self.segment_count / self.intervals if self.intervals else 0.0

    def __deepcopy__(self, memo: object) -> AllanSums:
        """Return the object itself, because Allan sums are not changed after their creation."""
        return self

    def __add__(self, other: AllanSums) -> AllanSums:
        """Return the sums over the samples of both recordings.

        The identity has the known frame_id if one recording has none.

        Raises
        ------
        AllanError
            If the axes, the IMUs or the sample periods differ (see `check_addable`).
        """
        self.check_addable(other)
        if self.axes != other.axes:
            raise AllanError(
                f'sums of axes {", ".join(self.axes)} and of {", ".join(other.axes)} cannot be '
                'added: analyze them separately'
            )
        return replace(
            self,
            identity=self.identity if self.identity.frame_id else other.identity,
            count=add_padded(self.count, other.count),
            sum_sq=add_padded(self.sum_sq, other.sum_sq),
            group_count=add_padded(self.group_count, other.group_count),
            group_sum_sq=add_padded(self.group_sum_sq, other.group_sum_sq),
            elapsed_ns=self.elapsed_ns + other.elapsed_ns,
            intervals=self.intervals + other.intervals,
            recordings=bounded(self.recordings + other.recordings),
            lengths=add_lengths(self.lengths, other.lengths),
            replaced=add_stretches(self.replaced, other.replaced),
        )

    def check_addable(self, other: AllanSums) -> None:
        """Check that ``other`` has the same IMU and sample period; the axes may differ.

        Raises
        ------
        AllanError
            If the identities cannot be of one IMU (see `ImuIdentity.can_be`), or the sample
            periods differ by more than 0.1 % plus the uncertainty of the stamps at the ends of the
            segments.
        """
        if not self.identity.can_be(other.identity):
            raise AllanError(
                f'sums of different IMUs ({self.identity}; {other.identity}) cannot be added: '
                'analyze them separately'
            )
        a, b = self.tau0, other.tau0
        tolerance = TAU0_TOLERANCE + self._tau0_uncertainty + other._tau0_uncertainty
        if a and b and abs(a - b) > a * tolerance:
            raise AllanError(
                f'sums at {1 / a:.6g} Hz and at {1 / b:.6g} Hz cannot be added: the rates are '
                f'more than {TAU0_TOLERANCE:.1%} apart, analyze them separately'
            )


def add_sums(a: Sequence[AllanSums], b: Sequence[AllanSums]) -> tuple[AllanSums, ...]:
    """Return the sums over two recordings of one IMU, given the sums of each recording.

    A recording has one `AllanSums` with all axes, or one `AllanSums` for each sensor if the rates
    or topics of the sensors differ. `AllanSums` with equal axes are added. If one sequence is
    empty, the other sequence is returned.

    Raises
    ------
    AllanError
        If the IMUs, the rates or the axes differ.
    """
    if not a or not b:
        return tuple(a or b)
    sums_by_axes = {s.axes: s for s in b}
    if set(sums_by_axes) != {s.axes for s in a}:
        axes_of_a, axes_of_b = (
            ' and separately '.join(', '.join(s.axes) for s in sums) for sums in (a, b)
        )
        raise AllanError(
            f'sums of {axes_of_a} and of {axes_of_b} cannot be added: the sensors differ, '
            'analyze them separately'
        )
    return tuple(s + sums_by_axes[s.axes] for s in a)


def check_same_imu(a: Sequence[AllanSums], b: Sequence[AllanSums]) -> None:
    """Check that two recordings have the same IMU and equal rates on their common axes.

    Recordings without a common axis are not compared.

    Raises
    ------
    AllanError
        If the IMU or the rate of a common axis differs (see `AllanSums.check_addable`).
    """
    for x, y in product(a, b):
        if not set(x.axes).isdisjoint(y.axes):
            x.check_addable(y)


# --- later periods --------------------------------------------------------------------------------


def part(sums: AllanSums, first: int) -> AllanSums:
    """Return the sums over the later periods of each recording, beginning at the index ``first``.

    A negative ``first`` counts from the last period. Block means outside of these periods are
    removed, and the result has no non-overlapping differences.

    At large averaging factors, the differences that end in a long stretch of samples have one
    common sum, which belongs to the period in which the stretch begins. The later periods may
    therefore have few differences. Where the block means give more differences, the differences of
    block means are used instead.
    """
    kept_recordings = [
        r for r in (_excerpt(r, sums.tau0, first) for r in sums.recordings) if r.periods
    ]
    samples, factors = sum(r.samples for r in kept_recordings), len(sums.count)
    count, sum_sq = np.zeros(factors, np.int64), np.zeros((factors, len(sums.axes)))
    for period in (p for r in kept_recordings for p in r.periods):
        count = add_padded(count, period.count)
        sum_sq = add_padded(sum_sq, period.sum_sq)
    for i, (m, stride) in enumerate(zip(sums.m.tolist(), sums.stride.tolist())):
        difference_count, squares = _from_means(kept_recordings, m, stride)
        if difference_count > count[i]:
            count[i], sum_sq[i] = difference_count, squares
    used_factors = nonzero_length(count)
    lengths = _scaled_lengths(sums.lengths, samples)
    intervals = samples - sum(number for _, number in lengths)
    return replace(
        sums,
        count=count[:used_factors],
        sum_sq=sum_sq[:used_factors],
        group_count=np.zeros(used_factors, np.int64),
        group_sum_sq=np.zeros((used_factors, len(sums.axes))),
        elapsed_ns=round(sums.elapsed_ns * intervals / sums.intervals) if sums.intervals else 0,
        intervals=intervals,
        recordings=tuple(kept_recordings),
        lengths=lengths,
        replaced=scaled_stretches(sums.replaced, samples / max(sums.samples, 1)),
    )


def _excerpt(recording: RecordedPeriods, tau0: float | None, first: int) -> RecordedPeriods:
    """Return a recording without the periods before index ``first`` and their block means."""
    periods = recording.periods[first:]
    means: tuple[BlockMeans, ...] = ()
    if periods:
        clipped = (_clipped(m, tau0 or 0.0, periods[0].begin) for m in recording.means)
        means = tuple(m for m in clipped if len(m.values) >= MIN_MEANS)
    return replace(recording, periods=periods, means=means)


def _clipped(means: BlockMeans, tau0: float, begin: int) -> BlockMeans:
    """Return the block means of a segment without the blocks that begin before a sample.

    ``begin`` is the index of this sample in the recording. ``tau0`` is the sample period in s.
    """
    step = means.step
    first_mean = min(max(-((means.age - begin) // step), 0), len(means.values))
    return replace(
        means,
        age=means.age + first_mean * step,
        start_ns=means.start_ns + round(first_mean * step * tau0 * 1e9),
        samples=means.samples - first_mean * step,
        values=means.values[first_mean:],
    )


def _from_means(
    recordings: list[RecordedPeriods], m: int, stride: int
) -> tuple[int, Floats | float]:
    """Return the number, and the sum of squares, (axes,), of second differences of block means.

    ``m`` is the averaging factor. The differences start ``stride`` samples apart, or one block
    apart if a block is longer. The sum is 0.0 if there are no differences.
    """
    difference_count, squares = 0, 0.0
    for means in (means for r in recordings for means in r.means):
        step = means.step
        if m % step or 2 * m > len(means.values) * step:
            continue
        phase = step * np.cumsum(np.vstack([0.0 * means.values[:1], means.values]), axis=0)
        lag = m // step
        d = (phase[2 * lag :] - 2.0 * phase[lag:-lag] + phase[: -2 * lag])[
            :: max(stride // step, 1)
        ]
        difference_count += len(d)
        squares = squares + (d**2).sum(axis=0)
    return difference_count, squares


def _scaled_lengths(lengths: Lengths, samples: int) -> Lengths:
    """Return the estimated length classes of a part of the data with ``samples`` samples.

    The lengths of the segments of a part are not stored. Each length class is assumed to have the
    same share of the samples as in the complete data, whose ``lengths`` are given.
    """
    share = samples / max(sum(total for total, _ in lengths), 1)
    scaled = [(round(total * share), round(segments * share)) for total, segments in lengths]
    kept_classes = [(total, segments) for total, segments in scaled if 0 < segments <= total]
    if not kept_classes:
        return ((samples, 1),) if samples else ()
    _, segments = kept_classes.pop()  # the class of the longest segments gets the remaining samples
    remaining = samples - sum(total for total, _ in kept_classes)
    return add_lengths((), (*kept_classes, (max(remaining, segments), segments)))
