# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Allan sums and spectra of a recording over periods of time, and block means of the recording.

Periods
-------
The age of a sample is the number of samples of the recording before this sample. Periods are short
at the start of a recording (warm-up) and at its end (recent changes), and long in between. The sums
over each part of a block of the cascade belong to the period in which the part starts.

Rounding
--------
The sums of squares and the powers of periods are rounded to 21 significant bits, and block means to
29 bits. This makes documents smaller.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from .grid import bins_up_to

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MAX_PERIODS = 24
"""Largest number of periods of an `AllanSums`, over all recordings."""

KEPT_SEGMENTS, MIN_MEANS, MAX_MEANS = 32, 4, 1024
"""Block means are kept for at most 32 segments: the longest ones that have at least 4 means. All
segments together have at most 1024 means."""

SUM_BYTES, MEAN_BYTES = 4, 5
"""Number of most significant bytes of a float64 that are kept in the sums of a period, and in block
means. The other bytes are set to 0."""


def rounded(values: Floats, size: int) -> Floats:
    """Return values, (n, ...), in any unit, rounded to the first ``size`` bytes of each float64.

    The first byte is the most significant byte.
    """
    shift = 64 - 8 * size
    bits = np.ascontiguousarray(values, '<f8').view('<u8')
    rounded_bits = (
        bits + ((bits >> np.uint64(shift)) & np.uint64(1)) + np.uint64((1 << (shift - 1)) - 1)
    )
    return np.asarray((rounded_bits >> np.uint64(shift) << np.uint64(shift)).view('<f8'))


class ByValue:
    """Base class of dataclasses with array fields; adds a ``==`` that compares the arrays.

    NaN equals NaN.
    """

    def __eq__(self, other: object) -> bool:
        """Return whether the types and all fields are equal."""
        if type(self) is not type(other):
            return False
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))  # type: ignore[arg-type]
        return all(
            np.array_equal(x, y, equal_nan=x.dtype.kind == 'f')
            if isinstance(x, np.ndarray)
            else bool(x == y)
            for x, y in pairs
        )


def add_padded(a: NDArray, b: NDArray) -> NDArray:  # type: ignore[type-arg]
    """Return a + b; the array with fewer rows is padded with zero rows.

    The shapes of the arrays, (rows, ...), may differ only in the number of rows.
    """
    if len(a) < len(b):
        a, b = b, a
    total = a.copy()
    total[: len(b)] += b
    return total


def nonzero_length(counts: Ints) -> int:
    """Return the number of elements of an array, (n,), up to the last element that is not zero."""
    return int(np.max(np.flatnonzero(counts), initial=-1)) + 1


@dataclass(frozen=True, eq=False)
class Period(ByValue):
    """Sums of one period of a recording."""

    begin: int  # number of samples of the recording before the period
    samples: int  # number of samples
    begin_ns: int  # stamp of the first sample in ns, computed from the mean sample period
    count: Ints  # (factors,) number of second differences
    sum_sq: Floats  # (factors, axes) sum of the squares of the second differences
    blocks: Ints  # (octaves,) number of spectral blocks
    pairs: Ints  # (octaves,) number of pairs of overlapping spectral blocks
    power: Floats  # (bins, axes) power in the bins of all octaves, summed over the spectral blocks
    total: Floats  # (axes,) sum of all differences ``sample - RecordedPeriods.reference``
    interpolated: int  # number of samples that are interpolated on some axis

    @property
    def end(self) -> int:
        """Number of samples of the recording up to the end of the period."""
        return self.begin + self.samples

    def __add__(self, later: Period) -> Period:
        """Return the sums over this period and a later period, as one period."""
        return replace(
            self,
            samples=self.samples + later.samples,
            count=add_padded(self.count, later.count),
            sum_sq=add_padded(self.sum_sq, later.sum_sq),
            blocks=add_padded(self.blocks, later.blocks),
            pairs=add_padded(self.pairs, later.pairs),
            power=add_padded(self.power, later.power),
            total=self.total + later.total,
            interpolated=self.interpolated + later.interpolated,
        ).stored()

    def stored(self) -> Period:
        """Return a copy with rounded sums of squares and powers.

        Factors and octaves without data are removed from the ends of the arrays.
        """
        factors, octaves = nonzero_length(self.count), nonzero_length(self.blocks)
        power = self.power[: bins_up_to(octaves)]
        return replace(
            self,
            count=self.count[:factors],
            sum_sq=rounded(self.sum_sq[:factors], SUM_BYTES),
            blocks=self.blocks[:octaves],
            pairs=self.pairs[:octaves],
            power=rounded(power, SUM_BYTES),
        )


@dataclass(frozen=True, eq=False)
class BlockMeans(ByValue):
    """Means of one segment over consecutive blocks of samples."""

    age: int  # number of samples of the recording before the segment
    start_ns: int  # stamp of the first sample of the segment in ns
    samples: int  # number of samples of the segment
    step: int  # samples per block, a power of two
    values: Floats  # (means, axes) mean of each block, minus `RecordedPeriods.reference`

    def coarser(self, step: int) -> BlockMeans:
        """Return the means over longer blocks of ``step`` samples, a power of two."""
        values, size = self.values, self.step
        while size < step:
            pairs = len(values) // 2
            values, size = (values[: 2 * pairs : 2] + values[1 : 2 * pairs : 2]) / 2.0, 2 * size
        return replace(self, step=size, values=rounded(values, MEAN_BYTES))


@dataclass(frozen=True, eq=False)
class RecordedPeriods(ByValue):
    """Periods and block means of one recording."""

    periods: tuple[Period, ...]
    means: tuple[BlockMeans, ...]  # block means of the longest segments, the earliest segment first
    reference: Floats  # (axes,) first sample of the recording

    @property
    def samples(self) -> int:
        """Number of samples of the recording."""
        return sum(p.samples for p in self.periods)

    @property
    def mean(self) -> Floats:
        """Mean of all samples of the recording, (axes,)."""
        total = sum((p.total for p in self.periods), np.zeros(len(self.reference)))
        return np.asarray(self.reference + total / max(self.samples, 1))

    def merged(self, i: int) -> RecordedPeriods:
        """Return a copy in which period i and the next period are one period."""
        p = self.periods
        return replace(self, periods=(*p[:i], p[i] + p[i + 1], *p[i + 2 :]))

    def joined(self, later: RecordedPeriods) -> RecordedPeriods:
        """Return both recordings as one, as if ``later`` continued this recording after a gap."""
        age, shift = self.samples, later.reference - self.reference
        periods = tuple(
            replace(p, begin=p.begin + age, total=p.total + p.samples * shift)
            for p in later.periods
        )
        means = tuple(
            replace(m, age=m.age + age, values=rounded(m.values + shift, MEAN_BYTES))
            for m in later.means
        )
        return replace(self, periods=self.periods + periods, means=self.means + means)


def pair_to_merge(begins: Sequence[int], length: int) -> tuple[float, int]:
    """Return the least relative length of two neighboring periods, and the index of the first.

    ``begins`` are the ages at which the periods begin, and ``length`` is the number of samples of
    the recording. The length of a pair of periods is divided by the smaller of two distances: from
    the start of the recording to the end of the pair, and from the start of the pair to the end of
    the recording. For fewer than two periods, the least length is infinite, and the index is 0.
    """
    ends = [*begins[1:], length]
    relative_lengths = [
        (end - begin) / min(end, length - begin) for begin, end in zip(begins, ends[1:])
    ]
    smallest = min(relative_lengths, default=math.inf)
    return smallest, relative_lengths.index(smallest) if relative_lengths else 0


def bounded(recordings: Iterable[RecordedPeriods]) -> tuple[RecordedPeriods, ...]:
    """Return the recordings, sorted by time, with at most 24 periods and 1024 means in all.

    Neighboring periods are merged. If there are more than 24 recordings, the two oldest ones are
    joined repeatedly.
    """
    kept_recordings = sorted(recordings, key=lambda r: (r.periods[0].begin_ns, r.samples))
    while sum(len(r.periods) for r in kept_recordings) > MAX_PERIODS:
        pairs = [pair_to_merge([p.begin for p in r.periods], r.samples) for r in kept_recordings]
        _, shortest, i = min((length, number, i) for number, (length, i) in enumerate(pairs))
        if len(kept_recordings[shortest].periods) > 1:
            kept_recordings[shortest] = kept_recordings[shortest].merged(i)
        else:
            kept_recordings[:2] = [kept_recordings[0].joined(kept_recordings[1])]
    means = iter(bounded_means([r.means for r in kept_recordings]))
    return tuple(replace(r, means=m) for r, m in zip(kept_recordings, means))


def bounded_means(
    means_of_recordings: Sequence[Sequence[BlockMeans]],
) -> list[tuple[BlockMeans, ...]]:
    """Return the block means of the longest segments of all recordings, at a common step.

    ``means_of_recordings`` are the block means of each recording, and the result has the same
    order. It contains at most `KEPT_SEGMENTS` segments with at least `MIN_MEANS` means each, and at
    most `MAX_MEANS` means, for all recordings together.
    """
    segments = [(m, i) for i, means in enumerate(means_of_recordings) for m in means]
    segments = sorted(segments, key=lambda s: (-s[0].samples, s[0].start_ns))[:KEPT_SEGMENTS]
    step = max((m.step for m, _ in segments), default=1)
    while True:
        means_per_segment = [m.samples // step for m, _ in segments]
        if sum(n for n in means_per_segment if n >= MIN_MEANS) <= MAX_MEANS:
            break
        step *= 2
    kept_means: list[list[BlockMeans]] = [[] for _ in means_of_recordings]
    for (m, i), n in zip(segments, means_per_segment):
        if n >= MIN_MEANS:
            kept_means[i].append(m.coarser(step))
    return [tuple(sorted(means, key=lambda m: m.age)) for means in kept_means]


def totals(arrays: Iterable[NDArray]) -> NDArray:  # type: ignore[type-arg]
    """Return the sum of arrays; arrays with fewer rows are padded with zero rows.

    The shapes of the arrays, (rows, ...), may differ only in the number of rows.
    """
    return reduce(add_padded, arrays)
