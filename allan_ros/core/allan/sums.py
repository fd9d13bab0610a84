# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`AllanSums`: sums of squared second differences of an IMU's samples; sums can be added.

The time unit is the sample period. The phase theta is the cumulative sum of the samples minus the
first sample of the segment, and d(u) = theta(u + 2m) - 2 theta(u + m) + theta(u) is the second
difference that starts at sample u, at the averaging factor m.
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
from .grid import FIRST_FACTORS as FIRST_FACTORS
from .grid import LEVEL_FACTORS as LEVEL_FACTORS
from .grid import MAX_LEVELS as MAX_LEVELS
from .grid import allan_variance as allan_variance
from .grid import counts as counts
from .grid import grid as grid
from .grid import grid_for as grid_for
from .grid import levels_of
from .history import ByValue, History, add_padded

Floats = NDArray[np.float64]

LONGEST_FILLED = 128
"""Longest gap of interpolated samples that is counted by its length; longer gaps are counted as
this length."""

KEPT_SEGMENTS = 32
"""Number of longest segments whose signed sums and phase record are kept."""

LENGTH_CLASS_RATIO = 1.1
"""Ratio of the longest to the shortest segment of a length class, in which all other segments are
pooled."""

TAU0_TOLERANCE = 1e-3
"""Sums whose sample periods differ by more than 0.1 % cannot be added."""


@dataclass(frozen=True, eq=False)
class SegmentRecord(ByValue):
    """Data of one segment from which the ramp (linear drift) of its samples can be estimated."""

    start_ns: int  # stamp of the first sample
    samples: int  # number of samples
    signed: Floats  # (factors, axes) sum of d (not squared) at the factors of ``grid_for(samples)``
    # (points, axes) phase at sample 0, ``phase_step``, 2 ``phase_step`` ... : at most 128 points
    phase: Floats
    phase_step: int  # samples between two phase points, a power of two
    age: int = 0  # sample periods from the first sample of the recording to that of the segment

    @cached_property
    def order(self) -> tuple[int, int, int]:
        """Sort key: longest first, then earliest; the first `KEPT_SEGMENTS` are kept."""
        return (-self.samples, self.start_ns, self.phase_step)

    @property
    def length_class(self) -> int:
        """Index of the length class of the segment, floor(log(samples) / log(1.1))."""
        return int(np.log(self.samples) / np.log(LENGTH_CLASS_RATIO))

    def ols_ramp(self) -> Floats:
        """Return the least-squares slope of the samples over time, per sample period, (axes,).

        It is 0 with fewer than three phase points.
        """
        return np.asarray(ols_ramp_weights(len(self.phase), self.phase_step) @ self.phase)


def ols_ramp_weights(points: int, step: int) -> Floats:
    """Return weights w, (points,), with w @ phase = least-squares slope of the samples over time.

    ``points`` is the number of phase points and ``step`` the number of samples between two of them.
    The slope is fitted to the interval means (theta_{k+1} - theta_k)/step of the samples. The
    weights are 0 with fewer than two intervals.
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
    """Pooled data of segments whose lengths are equal within 10 %."""

    index: int  # `SegmentRecord.length_class`
    count: int  # number of segments
    samples: int  # total number of their samples
    # (factors, axes) change of the sum of d^2 when the ramp of each segment is removed: with the
    # slope r (`SegmentRecord.ols_ramp`), the sum D of d and the number M of differences of a
    # segment, sum (d - r m^2)^2 - sum d^2 = -2 m^2 r D + M m^4 r^2
    ramp_correction: Floats

    @classmethod
    def of(cls, segment: SegmentRecord) -> LengthClass:
        """Return a class that contains one segment."""
        n_m = len(segment.signed)
        m, stride = (a[:n_m] for a in grid(levels_of(n_m)))
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
    """Allan sums of one stream; ``+`` adds the sums of another recording of the same IMU.

    The result depends on the order of additions only by rounding, at most 1e-12 of its value.

    Attributes
    ----------
    identity : ImuIdentity
        Frame and hardware id of the IMU.
    axes : tuple of str
        Names of the axes, in the order of `AXES`: the last dimension of the arrays.
    count : (factors,) int64 array
        Number of second differences at each averaging factor in ``m``.
    sum_sq : (factors, axes) float64 array
        Sum of their squares d^2, in the squared unit of the samples.
    group_count, group_sum_sq : arrays of the same shapes
        The same for non-overlapping differences, which start at samples 0, m, 2m ...
    segments : tuple of SegmentRecord
        The 32 longest segments, longest first.
    classes : tuple of LengthClass
        All other segments pooled by length, shortest first.
    elapsed_ns, intervals : int
        Time from the first to the last stamp of each segment in ns, and number of sample periods
        in it, summed over the segments. Their quotient is the sample period.
    history : History
        The same sums by the age of each difference; empty if they were read from a document
        without a history.
    filled : (lengths, axes) int64 array
        Number of gaps of 1, 2, ... lost samples that were interpolated, in each axis; may be empty.
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
        """Return the sums of zero samples; adding them to other sums changes nothing."""
        none, no_sums = np.zeros(0, np.int64), np.zeros((0, len(axes)))
        return cls(identity, axes, none, no_sums, none, no_sums)

    @property
    def m(self) -> NDArray[np.int64]:
        """Averaging factors in samples, (factors,), ascending."""
        return grid(levels_of(len(self.count)))[0][: len(self.count)]

    @property
    def stride(self) -> NDArray[np.int64]:
        """Samples between the starts of two second differences at each factor, (factors,)."""
        return grid(levels_of(len(self.count)))[1][: len(self.count)]

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
        """Pairs (mean length in samples, number of segments), longest first.

        Each kept segment has its own pair, followed by one pair for each length class.
        """
        kept = [(float(s.samples), 1) for s in self.segments]
        return tuple(kept + [(c.samples / c.count, c.count) for c in reversed(self.classes)])

    @property
    def avar(self) -> Floats:
        """Overlapping Allan variance at the factors ``m``, pooled over segments, (factors, axes).

        The unit is the squared unit of the samples. Factors without data have NaN.
        """
        return allan_variance(self.sum_sq, self.m, self.count)

    @property
    def group_avar(self) -> Floats:
        """Non-overlapping Allan variance at ``m``, (factors, axes); NaN without data."""
        return allan_variance(self.group_sum_sq, self.m, self.group_count)

    @property
    def _tau0_uncertainty(self) -> float:
        """Relative error of tau0 if both end stamps of each segment are wrong by one period."""
        return 2.0 * self.segment_count / self.intervals if self.intervals else 0.0

    def __deepcopy__(self, memo: object) -> AllanSums:
        """Return the object itself, because it is immutable."""
        return self

    def __add__(self, other: AllanSums) -> AllanSums:
        """Return the sums of both.

        Raises
        ------
        AllanError
            If the axes, the identities or the sample periods differ (see `check_addable`).
        """
        self.check_addable(other)
        if self.axes != other.axes:
            raise AllanError(
                f'sums of axes {", ".join(self.axes)} and of {", ".join(other.axes)} cannot be '
                'added: analyze them separately'
            )
        return self.extended(other)

    def extended(self, other: AllanSums, continues: bool = False) -> AllanSums:
        """Return the sums of both, which must have equal axes, without the checks of ``+``.

        With ``continues``, ``other`` is a later segment of the same recording, and its ages count
        from the first sample of this recording.
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
        """Check that both have the same IMU and sample period; their axes may differ.

        Raises
        ------
        AllanError
            If the identities differ, or the sample periods differ by more than 0.1 % plus the
            uncertainty of the stamps at the ends of the segments.
        """
        if self.identity != other.identity:
            raise AllanError(
                f'sums of {self.identity} and of {other.identity} cannot be added: '
                'they are different IMUs, analyze them separately'
            )
        a, b = self.tau0, other.tau0
        tolerance = TAU0_TOLERANCE + self._tau0_uncertainty + other._tau0_uncertainty
        if a and b and abs(a - b) > a * tolerance:
            raise AllanError(
                f'sums at {1 / a:.6g} Hz and at {1 / b:.6g} Hz cannot be added: the rates are '
                f'more than {TAU0_TOLERANCE:.1%} apart, analyze them separately'
            )


def add_sums(a: Sequence[AllanSums], b: Sequence[AllanSums]) -> tuple[AllanSums, ...]:
    """Return the sums of two recordings of one IMU, where each has one or more `AllanSums`.

    A recording has one `AllanSums` with all axes, or one per sensor if the sensors have different
    rates. Those with equal axes are added. If one sequence is empty, the other is returned.

    Raises
    ------
    AllanError
        If IMUs, rates or axes differ.
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
    """Check that the sums of two recordings have the same IMU and rate on their common axes.

    Raises
    ------
    AllanError
        If the IMU or the rate of a common axis differs.
    """
    for x, y in product(a, b):
        if not set(x.axes).isdisjoint(y.axes):
            x.check_addable(y)
