# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`AllanSums`: the sums of squared second differences of an IMU's samples, which can be added.

All sums are in sample units (sample period 1): the phase theta is the cumulative sum of the samples
less the first sample of the segment, and d(u) = theta(u + 2m) - 2 theta(u + m) + theta(u).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..imu import AXES, ImuIdentity
from .history import ByValue, History, add_padded

FIRST_FACTORS = (1, 2, 3, 4, 6)
"""Averaging factors of level 0 only."""

LEVEL_FACTORS = (8, 10, 12, 14)
"""Averaging factors of every level, in units of its stride 2^j."""

MAX_LEVELS = 42
"""Largest number of levels in a document: 2^41 x 14 samples are 970 years at 1 kHz. Lags of a
covariance then fit into 64-bit search keys."""


def grid(levels: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the averaging factors and strides of the first levels, (5 + 4 levels,) each."""
    m = [*FIRST_FACTORS, *(f << j for j in range(levels) for f in LEVEL_FACTORS)]
    stride = [1] * len(FIRST_FACTORS) + [1 << j for j in range(levels) for _ in LEVEL_FACTORS]
    return np.array(m, np.int64), np.array(stride, np.int64)


def grid_for(samples: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the averaging factors m <= samples/2 of the grid, and their strides."""
    levels = max(1, samples.bit_length() - 3)
    m, stride = grid(levels)
    keep = 2 * m <= samples
    return m[keep], stride[keep]


def counts(samples: int, m: NDArray[np.int64], stride: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of second differences of a segment of ``samples`` samples at each factor.

    n samples make n + 1 phase points; differences start at 0, stride, 2 stride .. n - 2 m.
    """
    return np.where(2 * m <= samples, (samples - 2 * m) // stride + 1, 0)


Floats = NDArray[np.float64]

LONGEST_FILLED = 128
"""Longest gap of interpolated samples with its own count; longer gaps are included in this
count."""

KEPT_SEGMENTS = 32
"""Number of longest segments that keep their own signed sums and phase record."""

LENGTH_CLASS_RATIO = 1.1
"""Length ratio of a class: all other segments are pooled with segments of the same length within 10
%."""

TAU0_TOLERANCE = 1e-3
"""Sums with sample periods more than 0.1 % apart belong to different streams."""

LEAST_VARIANCE = 1e-80
"""Smaller variances count as 0. No sensor has steps of 1e-40, and the cube and the inverse square
of a variance, which the fit needs, stay within the range of normal numbers."""


@dataclass(frozen=True, eq=False)
class SegmentRecord(ByValue):
    """Data of one segment for the estimate of its ramp, in addition to its part of the sums."""

    start_ns: int  # stamp of its first sample
    samples: int  # number of samples
    # (factors, axes) sum of d for the first factors of the grid (those with m <= samples/2)
    signed: Floats
    # (points, axes) phase at sample 0, ``phase_step``, 2 ``phase_step`` ... : at most 128 points
    phase: Floats
    phase_step: int  # samples between two phase points, a power of two
    age: int = 0  # sample periods since the first sample of the recording

    @cached_property
    def order(self) -> tuple[int, int, int]:
        """Sort key: longest first, then earliest. It decides which segments are kept."""
        return (-self.samples, self.start_ns, self.phase_step)

    @property
    def length_class(self) -> int:
        """Index of the length class; segments of one class differ by less than 10 %."""
        return int(np.log(self.samples) / np.log(LENGTH_CLASS_RATIO))

    def ols_ramp(self) -> Floats:
        """Return the slope of the samples over the segment by least squares, per sample.

        This fixed linear estimator removes the ramp of pooled segments. For the 32 longest
        segments, the fit uses the efficient estimator. Zero with fewer than three points.
        """
        return np.asarray(ols_ramp_weights(len(self.phase), self.phase_step) @ self.phase)


def ols_ramp_weights(points: int, step: int) -> Floats:
    """Return w such that w @ phase is the least-squares slope of the samples, per sample.

    The interval means of the samples are (theta_{k+1} - theta_k)/step; w is their least-squares
    slope over time, expressed by theta. The slope is exact for a pure ramp, and 0 for a constant or
    fewer than two intervals.
    """
    k = np.arange(points - 1, dtype=float)
    k -= k.mean() if points > 1 else 0.0
    spread = float(k @ k)
    if spread == 0.0:
        return np.zeros(points)
    slope = k / (spread * step * step)
    return np.asarray(np.concatenate([[0.0], slope]) - np.concatenate([slope, [0.0]]))


@dataclass(frozen=True, eq=False)
class LengthClass(ByValue):
    """Pooled segments whose lengths are equal within 10 %."""

    index: int  # floor(log(samples) / log(1.1))
    # number of segments, and of their samples in total
    count: int
    samples: int
    # (factors, axes) correction that removes the ramps of these segments from the sums of d^2: sum
    # over segments of -2 m^2 r D + M m^4 r^2, with r = `SegmentRecord.ols_ramp`, D the signed sum
    # and M the count of the segment (the square of d - r m^2, less d^2)
    ramp_correction: Floats

    @classmethod
    def of(cls, segment: SegmentRecord) -> LengthClass:
        """Return the class of a single segment."""
        n_m = len(segment.signed)
        m, stride = (a[:n_m] for a in grid(_levels(n_m)))
        r = segment.ols_ramp()
        m2 = m.astype(float)[:, None] ** 2
        number = counts(segment.samples, m, stride)[:, None]
        correction = -2.0 * m2 * r * segment.signed + number * (m2 * r) ** 2
        return cls(segment.length_class, 1, segment.samples, correction)

    def __add__(self, other: LengthClass) -> LengthClass:
        if self.index != other.index:
            raise AllanError(f'length classes {self.index} and {other.index} cannot be added')
        return LengthClass(
            self.index,
            self.count + other.count,
            self.samples + other.samples,
            add_padded(self.ramp_correction, other.ramp_correction),
        )


@dataclass(frozen=True, eq=False)
class AllanSums(ByValue):
    """Running Allan sums of one stream; ``+`` adds the sums of another recording of the same IMU.

    Sums of floating-point numbers depend on the order of addition in the last bits: sums of the
    same recordings added in another order agree to 1e-12 of their value.

    Attributes
    ----------
    identity : ImuIdentity
    axes : tuple of str
        Axes that are present, in the order of `AXES`: the last dimension of the arrays.
    count : (factors,) int64 array
        Number of second differences at each factor of ``grid(levels)``.
    sum_sq : (factors, axes) float64 array
        Sum of d^2, in the unit of the samples squared (theta is a sum of samples).
    group_count, group_sum_sq : as count and sum_sq
        The same for groups that do not overlap (starts 0, m, 2m ...).
    segments : tuple of SegmentRecord
        The 32 longest segments, longest first.
    classes : tuple of LengthClass
        All other segments by length, shortest first.
    elapsed_ns, intervals : int
        Time between the first and the last stamp of each segment, and the number of sample
        periods in it, summed over the segments. Their quotient is tau0.
    history : History
        The same sums by the age of each difference; empty if they were read from a document
        without them.
    filled : (lengths, axes) int64 array
        Gaps of 1, 2, ... lost samples that were interpolated, in each axis; may be empty.
    """

    identity: ImuIdentity
    axes: tuple[str, ...]
    count: NDArray[np.int64]
    sum_sq: Floats
    group_count: NDArray[np.int64]
    group_sum_sq: Floats
    segments: tuple[SegmentRecord, ...] = ()
    classes: tuple[LengthClass, ...] = ()
    elapsed_ns: int = 0
    intervals: int = 0
    history: History = field(default_factory=History)
    filled: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 0), np.int64))

    @classmethod
    def empty(
        cls, identity: ImuIdentity = ImuIdentity(), axes: tuple[str, ...] = AXES
    ) -> AllanSums:
        """Return the sums of zero samples: the neutral element of ``+``."""
        none, no_sums = np.zeros(0, np.int64), np.zeros((0, len(axes)))
        return cls(identity, axes, none, no_sums, none, no_sums)

    @property
    def m(self) -> NDArray[np.int64]:
        """Averaging factors in samples, (factors,)."""
        return grid(_levels(len(self.count)))[0][: len(self.count)]

    @property
    def stride(self) -> NDArray[np.int64]:
        """Samples between the starts of two second differences at each factor, (factors,)."""
        return grid(_levels(len(self.count)))[1][: len(self.count)]

    @property
    def tau0(self) -> float | None:
        """Sample period in seconds; None with fewer than two samples."""
        return self.elapsed_ns / self.intervals * 1e-9 if self.intervals else None

    @property
    def samples(self) -> int:
        """Number of samples in all segments."""
        return sum(s.samples for s in self.segments) + sum(c.samples for c in self.classes)

    @property
    def segment_count(self) -> int:
        """Number of segments."""
        return len(self.segments) + sum(c.count for c in self.classes)

    @property
    def length_histogram(self) -> tuple[tuple[float, int], ...]:
        """(mean samples, number) of each kept segment, then of each length class."""
        kept = [(float(s.samples), 1) for s in self.segments]
        return tuple(kept + [(c.samples / c.count, c.count) for c in reversed(self.classes)])

    @property
    def avar(self) -> Floats:
        """Overlapping Allan variance at ``m``, pooled over segments, (factors, axes).

        In the squared unit of the samples; NaN without data.
        """
        return allan_variance(self.sum_sq, self.m, self.count)

    @property
    def group_avar(self) -> Floats:
        """Allan variance over groups that do not overlap, (factors, axes)."""
        return allan_variance(self.group_sum_sq, self.m, self.group_count)

    @property
    def _end_slack(self) -> float:
        """Relative error of tau0 if the stamps at both ends of each segment are wrong by one
        period."""
        return 2.0 * self.segment_count / self.intervals if self.intervals else 0.0

    def __deepcopy__(self, memo: object) -> AllanSums:
        """Return itself: the value is immutable."""
        return self

    def __add__(self, other: AllanSums) -> AllanSums:
        """Return the sums of both.

        Raises
        ------
        AllanError
            When IMU or axes differ, or their sample periods differ by more than 0.1 % and more than
            the uncertainty of the stamps at the ends of the segments.
        """
        self.check_addable(other)
        if self.axes != other.axes:
            raise AllanError(
                f'sums of axes {", ".join(self.axes)} and of {", ".join(other.axes)} cannot be '
                'added: '
                'analyze them separately'
            )
        return self.extended(other)

    def extended(self, other: AllanSums, continues: bool = False) -> AllanSums:
        """Return the sums of both without checking that they belong to one stream.

        Parameters
        ----------
        other : AllanSums
        continues : bool
            Whether ``other`` is a later segment of the same recording.
        """
        segments = sorted((*self.segments, *other.segments), key=lambda s: s.order)
        pooled = [(s, LengthClass.of(s)) for s in segments[KEPT_SEGMENTS:]]
        classes = {c.index: c for c in self.classes}
        for more in (*other.classes, *(c for _, c in pooled)):
            known = more.index in classes
            classes[more.index] = classes[more.index] + more if known else more
        history = History()
        if self._has_history and other._has_history:
            both = (self.history, other.history)
            history = both[0].continued(both[1]) if continues else both[0] + both[1]
            history = history.with_pooled(
                (s.age, (c.index, c.count, c.samples), c.ramp_correction) for s, c in pooled
            )
        filled = [one for one in (self.filled, other.filled) if len(one)]
        return replace(
            self,
            count=add_padded(self.count, other.count),
            sum_sq=add_padded(self.sum_sq, other.sum_sq),
            group_count=add_padded(self.group_count, other.group_count),
            group_sum_sq=add_padded(self.group_sum_sq, other.group_sum_sq),
            segments=tuple(segments[:KEPT_SEGMENTS]),
            classes=tuple(classes[i] for i in sorted(classes)),
            elapsed_ns=self.elapsed_ns + other.elapsed_ns,
            intervals=self.intervals + other.intervals,
            history=history,
            filled=reduce(add_padded, filled) if filled else self.filled,
        )

    @property
    def _has_history(self) -> bool:
        return bool(self.history.recordings) or not self.samples

    def check_addable(self, other: AllanSums) -> None:
        """Check that both have the same IMU and rate; their axes may differ.

        Raises
        ------
        AllanError
            When IMU or sample period differ, as in ``+``.
        """
        if self.identity != other.identity:
            raise AllanError(
                f'sums of {self.identity} and of {other.identity} cannot be added: '
                'they are different IMUs, analyze them separately'
            )
        a, b = self.tau0, other.tau0
        if a and b and abs(a - b) > a * (TAU0_TOLERANCE + self._end_slack + other._end_slack):
            raise AllanError(
                f'sums at {1 / a:.6g} Hz and at {1 / b:.6g} Hz cannot be added: the rates are '
                'more than '
                f'{TAU0_TOLERANCE:.1%} apart, analyze them separately'
            )


def allan_variance(sum_sq: Floats, m: NDArray[np.int64], count: NDArray[np.int64]) -> Floats:
    """Return sum d^2 / (2 m^2 count), (factors, axes), NIST SP 1065 eq. 11.

    NaN without data, 0 below `LEAST_VARIANCE`.
    """
    number = m.astype(float) ** 2 * count  # int64 would overflow after weeks at 1 kHz
    with np.errstate(invalid='ignore', divide='ignore'):
        variance: Floats = sum_sq / (2.0 * number[:, None])
    return np.where(variance < LEAST_VARIANCE, 0.0, variance)


def _levels(factors: int) -> int:
    """Return the number of levels of a grid with ``factors`` factors, at least 1."""
    return max(1, -(-(factors - 5) // 4))


def add_sums(a: Sequence[AllanSums], b: Sequence[AllanSums]) -> tuple[AllanSums, ...]:
    """Return the sums of two recordings of one IMU; sums of the same axes are added.

    A recording has one `AllanSums` with all axes, or one per sensor if the sensors have different
    rates. An empty sequence is neutral.

    Raises
    ------
    AllanError
        When IMUs, rates or axes differ.
    """
    if not a or not b:
        return tuple(a or b)
    by_axes = {s.axes: s for s in b}
    if set(by_axes) != {s.axes for s in a}:
        one, other = (' and separately '.join(', '.join(s.axes) for s in sums) for sums in (a, b))
        raise AllanError(
            f'sums of {one} and of {other} cannot be added: the sensors differ, analyze them '
            'separately'
        )
    return tuple(s + by_axes[s.axes] for s in a)


def check_same_imu(a: Sequence[AllanSums], b: Sequence[AllanSums]) -> None:
    """Check that both can belong to one stream; one may have more axes.

    Raises
    ------
    AllanError
        When a common axis has different IMUs or rates.
    """
    for x, y in product(a, b):
        if not set(x.axes).isdisjoint(y.axes):
            x.check_addable(y)
