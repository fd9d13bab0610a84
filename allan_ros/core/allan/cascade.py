# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums of one segment, in levels of decreasing rate: second differences and octave spectra.

Algorithm
---------
A point of level j is the sum of 2^j samples. When a block of 512 to 8192 points is full:

- the second differences that end in each part of the block are squared and summed, at the averaging
  factors of the level,
- the power of the spectral blocks that end in each part of the block is added,
- the sum of each pair of points is passed to level j + 1.

Blocks are counted from the start of the segment, so the sums are the same, bit for bit, for any
chunking of the samples.

A second difference of the phase (the cumulative sum of the samples) is the difference of the sums
of m points and of the next m points. Source: IEEE Std 952-1997 annex C; NIST SP 1065 eq. 11
(overlapping Allan variance). To reduce rounding errors, the first sample of the segment is
subtracted from all samples.

Time
----
For six axes, the sums take about 170 ns per sample on a virtual AMD EPYC. In this time, the second
differences take 60 ns (level 0 takes 40 ns), the octave spectra 75 ns (level 0 takes 55 ns), and
the sums of periods 15 ns.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..memory import WorkMemory, aligned
from .grid import FIRST_FACTORS, LEVEL_FACTORS, SAMPLE_OCTAVES, octave, tapers

Floats = NDArray[np.float64]
Floating = NDArray[np.floating]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]

FIRST_BLOCK, BLOCK = 512, 8192
"""Smallest and largest number of points of a block. The blocks of a segment have 512, 512, 1024,
2048, 4096, 8192, 8192 ... points. In long blocks, the overhead of numpy calls is small, and 8192
points still fit into the cache."""

FIRST_PART, PART = 4096, 2048
"""Largest number of points in a part of a block of level 0, and of a higher level. Each part has
separate sums, so that the time of the sums is known more accurately. Both numbers are multiples of
the length of every half spectral block."""

MAX_INTERPOLATED = 0.75
"""Largest share of interpolated samples in a spectral block; a block with a larger share, as during
a shock, is excluded. The fit takes the interpolated samples in other blocks into account."""

_KEPT = 32
"""Number of points of the previous blocks that a level keeps. The longest second difference needs
2 * `LEVEL_FACTORS`[-1] - 1 = 27 earlier points. As 32 is a multiple of 8, all axes are aligned in
memory."""

_work, _samples = WorkMemory(), WorkMemory()


@dataclass(frozen=True)
class CascadeLevel:
    """One level of the cascade: its decimation, averaging factors, and octaves of the spectra."""

    stride: int  # samples per point
    part: int  # largest number of points in a part of a block; each part has separate sums
    factors: tuple[int, ...]  # averaging factors in units of the stride
    groups: tuple[range, ...]  # groups of octaves with the same number of bins

    @property
    def octaves(self) -> list[int]:
        """Octaves of frequency whose spectra this level computes."""
        return [o for group in self.groups for o in group]


@lru_cache
def level_of(j: int) -> CascadeLevel:
    """Return the averaging factors and the octaves of level j of the cascade."""
    if j == 0:
        groups = range(1), range(1, SAMPLE_OCTAVES)
        return CascadeLevel(1, FIRST_PART, FIRST_FACTORS + LEVEL_FACTORS, groups)
    o = SAMPLE_OCTAVES + j - 1
    return CascadeLevel(1 << j, PART, LEVEL_FACTORS, (range(o, o + 1),))


@dataclass(frozen=True)
class LevelSums:
    """Sums of one level of the cascade over some blocks; ``+`` adds the sums over other blocks."""

    level: int
    # (2 * factors + bins, axes): sums of squares of the second differences, sums of squares of the
    # non-overlapping differences, and power of the bins
    values: Floats
    # (2 * factors + 2 * octaves,): numbers of second differences, of non-overlapping differences,
    # of spectral blocks in each octave, and of pairs of overlapping spectral blocks in each octave
    counts: Ints

    @classmethod
    def zero(cls, j: int, axes: int) -> LevelSums:
        """Return sums of level j to which no block is added yet: all values and counts are 0."""
        level = level_of(j)
        factors, bins = len(level.factors), sum(len(octave(o).bins) for o in level.octaves)
        counts = np.zeros(2 * (factors + len(level.octaves)), np.int64)
        return cls(j, np.zeros((2 * factors + bins, axes)), counts)

    def __add__(self, other: LevelSums) -> LevelSums:
        return LevelSums(self.level, self.values + other.values, self.counts + other.counts)

    @property
    def arrays(self) -> tuple[Ints, Floats, Ints, Floats, Ints, Ints, Floats]:
        """The counts and values as separate arrays.

        The arrays are, in this order: the number, (factors,), and the sum of squares, (factors,
        axes), of the second differences; the number, (factors,), and the sum of squares, (factors,
        axes), of the non-overlapping differences; the number of spectral blocks, (octaves,); the
        number of pairs of overlapping spectral blocks, (octaves,); and the power, (bins, axes).
        """
        level = level_of(self.level)
        n, octave_count = len(level.factors), len(level.octaves)
        count, group_count, blocks, pairs = np.split(self.counts, [n, 2 * n, 2 * n + octave_count])
        sum_sq, group_sum_sq, power = np.split(self.values, [n, 2 * n])
        return count, sum_sq, group_count, group_sum_sq, blocks, pairs, power


@dataclass(frozen=True)
class Block:
    """Sums over a part of a block of one level; the block is full, or the last of the segment."""

    begin: int  # index of the first sample of the part in the segment
    sums: LevelSums
    # if the level is 0, the samples in the part, (axes + 1, n): the first sample of the segment is
    # subtracted, and the last row is 1 for interpolated samples, else 0. On higher levels, the
    # array is empty
    samples: Floats


@lru_cache
def _half_tapers(octave_index: int, kind: str) -> Floating:
    """Return the tapers of both halves of a spectral block, (points per half block, 4 * bins).

    There are four columns for each bin: first the real parts in the first half of the block for all
    bins, then the imaginary parts in the first half, the real parts in the second half, and the
    imaginary parts in the second half. The tapers are divided by the number of samples per mean,
    because they are multiplied by sums instead of means.
    """
    step, size, bins = octave(octave_index)
    half_tapers = np.split(tapers(size, bins).T / step, 2)
    columns = [component(half) for half in half_tapers for component in (np.real, np.imag)]
    return np.concatenate(columns, axis=1).astype(kind)


@dataclass(frozen=True)
class _HalfBlocks:
    """Last half block of each octave of a group, which is also the first half of the next block."""

    # (octaves, axes, 2 * bins) products of the points with the tapers of the first half of a block
    first_products: Floating
    # (octaves,) number of interpolated samples in the half block; infinite before the first sample
    interpolated: Floats
    used: Flags  # (octaves,) whether the block that ends with this half block is in the spectra

    @classmethod
    def empty(cls, octaves: range, axes: int, kind: str) -> _HalfBlocks:
        """Return half blocks without samples, for the start of a segment."""
        number, columns = len(octaves), 2 * len(octave(octaves[0]).bins)
        first_products = np.zeros((number, axes, columns), kind)
        return cls(first_products, np.full(number, np.inf), np.zeros(number, bool))

    def copy(self) -> _HalfBlocks:
        return _HalfBlocks(self.first_products.copy(), self.interpolated.copy(), self.used.copy())


class _Rows(NamedTuple):
    """Rows of one octave in a matrix that has one row for each axis and half block.

    The rows are sorted by axis, then by time.
    """

    octave: int
    half_size: int  # points per half block
    number: int  # number of half blocks of each axis
    begin: int  # first row of the octave
    end: int  # row after the last row of the octave


class _Layout(NamedTuple):
    """Rows of several octaves in a matrix that has one row for each axis and half block."""

    octaves: list[_Rows]  # only octaves of which at least one half block is complete
    firsts: Ints  # (octaves * axes,) row of the first half block of each octave and axis
    lasts: Ints  # (octaves * axes,) row of the last half block of each octave and axis


@lru_cache(256)
def _layout(octaves: range, axes: int, n: int) -> _Layout:
    """Return which rows of a matrix belong to each octave, if there are n points (`_Layout`)."""
    rows: list[_Rows] = []
    for o in octaves:
        half_size, begin = octave(o).size // 2, rows[-1].end if rows else 0
        if number := n // half_size:
            rows.append(_Rows(o, half_size, number, begin, begin + axes * number))
    first_rows = [np.zeros(0, np.int64), *(np.arange(r.begin, r.end, r.number) for r in rows)]
    firsts = np.concatenate(first_rows)
    return _Layout(rows, firsts, firsts + np.repeat([r.number - 1 for r in rows], axes))


class _GroupSums(NamedTuple):
    """Power of the spectral blocks of a group of octaves, in separate sums for parts of the points.

    The power of a spectral block is added to the sum of the part that contains its last point.
    """

    power: Floats  # (parts, bins of all octaves, axes) in the squared unit of the samples
    blocks: Ints  # (parts, octaves) number of spectral blocks
    pairs: Ints  # (parts, octaves) number of pairs of overlapping spectral blocks
    last: _HalfBlocks  # the last half block of each octave


class _RunningLevel:
    """State of one level of the cascade in the current segment: the latest points and half blocks.

    ``points`` contains the last `_KEPT` points of earlier blocks, then the first ``fill`` points of
    the current block. There is one row for each axis, and a last row with the number of
    interpolated samples in each point.
    """

    def __init__(self, level: int, rows: int) -> None:
        self.level = level
        self.points = aligned((rows, _KEPT + BLOCK))
        self.points[:, :_KEPT] = 0.0
        self.fill = 0
        self.summed = 0  # number of points in the earlier blocks
        # for samples, the rounding errors of float32 are much smaller than the noise; for sums over
        # many samples they are not
        self.kind = 'f8' if level else 'f4'
        self.halves = [
            _HalfBlocks.empty(group, rows - 1, self.kind) for group in level_of(level).groups
        ]

    def __deepcopy__(self, memo: object) -> _RunningLevel:
        """Return an independent copy; the points that are not filled yet are not copied."""
        copied = copy(self)
        copied.points = aligned(self.points.shape)
        copied.points[:, : _KEPT + self.fill] = self.points[:, : _KEPT + self.fill]
        return copied

    @property
    def size(self) -> int:
        """Number of points at which the current block is full."""
        return min(max(self.summed, FIRST_BLOCK), BLOCK)

    @property
    def current(self) -> Floats:
        """The points of the current block, (rows, fill): a view."""
        return self.points[:, _KEPT : _KEPT + self.fill]

    def extend(self, number: int) -> Floats:
        """Extend the current block; return a view of the new points to fill, (rows, number)."""
        begin = _KEPT + self.fill
        self.fill += number
        return self.points[:, begin : begin + number]

    def close(self) -> list[Block]:
        """Return the sums over the parts of the full block, and begin the next block."""
        blocks, self.halves = self.blocks_of(self.points[:, : _KEPT + self.fill])
        self.points[:, :_KEPT] = self.points[:, self.fill : self.fill + _KEPT]
        self.summed += self.fill
        self.fill = 0
        return blocks

    def blocks_of(self, points: Floats) -> tuple[list[Block], list[_HalfBlocks]]:
        """Return the sums over the parts of a block, and the last half block of each octave.

        ``points`` are (rows, n): `_KEPT` earlier points, then the points of the block.
        """
        level, block = level_of(self.level), points[:, _KEPT:]
        squares, numbers = _second_differences(points[:-1], self.summed, level)
        (samples,) = _samples.arrays(self.kind, (len(block) - 1, block.shape[1]))
        interpolated = block[-1] if block[-1].any() else None
        with np.errstate(over='ignore', invalid='ignore'):
            # samples above 3e38 overflow float32: no sensor has such samples, and the fit excludes
            # an axis with them
            samples[...] = block[:-1]
            spectra = [
                _group_sums(samples, interpolated, group, previous_halves, level.part)
                for group, previous_halves in zip(level.groups, self.halves)
            ]
        values = np.concatenate([squares, *(s.power for s in spectra)], axis=1)
        counts = [numbers, *(s.blocks for s in spectra), *(s.pairs for s in spectra)]
        sums = map(partial(LevelSums, self.level), values, np.concatenate(counts, axis=1))
        blocks = [
            Block(
                (self.summed + first) << self.level,
                part_sums,
                block[:, :0] if self.level else block[:, first : first + level.part],
            )
            for first, part_sums in zip(range(0, block.shape[1], level.part), sums)
        ]
        return blocks, [s.last for s in spectra]


def _group_sums(
    samples: Floating,
    interpolated: Floats | None,
    octaves: range,
    previous_halves: _HalfBlocks,
    part: int,
) -> _GroupSums:
    """Return, for a group of octaves, the power of the spectral blocks that end within n points.

    ``samples``, (axes, n), are the points of a level: samples or sums over samples. The power is
    summed separately for each part of ``part`` points. ``interpolated``, (n,), is the number of
    interpolated samples in each point; None if no sample is interpolated. ``previous_halves`` are
    the last half blocks before the points.
    """
    octave_count, axes, columns = previous_halves.first_products.shape
    layout, last = _layout(octaves, *samples.shape), previous_halves.copy()
    all_squares = _squared_amplitudes(
        samples, layout, previous_halves.first_products, last.first_products
    )
    all_blocks_are_used = interpolated is None and not previous_halves.interpolated.any()
    parts = -(-samples.shape[1] // part)
    sums = np.zeros((octave_count, parts, axes, columns))
    blocks, pairs = np.zeros((2, parts, octave_count), np.int64)
    for i, (o, half_size, number, begin, end) in enumerate(layout.octaves):
        squares = all_squares[begin:end].reshape(axes, number, columns)
        # the first flag is the flag of the last spectral block before these points
        is_used = np.ones(number + 1, bool)
        is_used[0] = previous_halves.used[i]
        if not all_blocks_are_used:
            points = np.zeros(samples.shape[1]) if interpolated is None else interpolated
            counts = points[: number * half_size].reshape(number, half_size).sum(axis=1)
            counts = np.concatenate([previous_halves.interpolated[i : i + 1], counts])
            is_used[1:] = counts[:-1] + counts[1:] <= MAX_INTERPOLATED * octave(o).length
            last.interpolated[i] = counts[-1]
        last.used[i] = is_used[-1]
        is_pair, weights = is_used[1:] & is_used[:-1], is_used[1:].astype(float)
        for k in range(parts):
            part_blocks = slice(k * part // half_size, (k + 1) * part // half_size)
            blocks[k, i] = np.count_nonzero(is_used[1:][part_blocks])
            pairs[k, i] = np.count_nonzero(is_pair[part_blocks])
            # this product takes less time than a sum over the second dimension
            np.matmul(weights[part_blocks], squares[:, part_blocks], out=sums[i, k])
    power = sums[..., : columns // 2] + sums[..., columns // 2 :]
    return _GroupSums(power.transpose(1, 0, 3, 2).reshape(parts, -1, axes), blocks, pairs, last)


def _squared_amplitudes(
    samples: Floating, layout: _Layout, previous_products: Floating, last_products: Floating
) -> Floats:
    """Return the squares of the real and imaginary amplitudes of blocks, (rows, 2 * bins).

    Each row contains the amplitudes of one spectral block: the block whose second half is the half
    block of this row in ``layout``. ``previous_products``, (octaves, axes, 2 * bins), contains the
    last half block before ``samples``, multiplied by the tapers of the first half of a spectral
    block. The same products for the last half block of ``samples`` are written to
    ``last_products``, for the octaves in ``layout``.
    """
    if not layout.octaves:
        return np.zeros((0, previous_products.shape[2]))
    rows, columns, kind = layout.octaves[-1].end, previous_products.shape[2], samples.dtype.str
    products, amplitudes = _work.arrays(kind, (rows, 2 * columns), (rows, columns))
    for o, half_size, number, begin, end in layout.octaves:
        half_blocks = samples[:, : number * half_size].reshape(-1, half_size)
        np.matmul(half_blocks, _half_tapers(o, kind), out=products[begin:end])
    first_half, second_half = products[:, :columns], products[:, columns:]
    # the amplitude of a block is its first half times the tapers of the first half, plus its second
    # half times the tapers of the second half
    np.add(first_half[:-1], second_half[1:], out=amplitudes[1:])
    octave_count = len(layout.octaves)
    amplitudes[layout.firsts] = (
        previous_products[:octave_count].reshape(-1, columns) + second_half[layout.firsts]
    )
    last_products[:octave_count] = first_half[layout.lasts].reshape(octave_count, -1, columns)
    # The memory of the products is used again. Squares of large samples would exceed float32.
    squares = products.reshape(-1).view('f8')[: amplitudes.size].reshape(amplitudes.shape)
    np.square(amplitudes, out=squares, dtype='f8')
    return squares


def _second_differences(points: Floats, summed: int, level: CascadeLevel) -> tuple[Floats, Ints]:
    """Return the sums of squared second differences, and how many differences they contain.

    The sums are (parts, 2 * factors, axes), and the numbers are (parts, 2 * factors). The first
    half of the second dimension is for all differences that end in a part of the block. The other
    half is for the non-overlapping differences. They are not divided into periods, so the first
    part contains the sums of non-overlapping differences over the complete block.

    ``points``, (axes, `_KEPT` + n), are `_KEPT` earlier points and the n points of a block.
    ``summed`` is the number of points of the segment before the block. Only differences that start
    in the segment and end in the block are counted.
    """
    axes, columns = points.shape
    x = points.reshape(-1)  # operations on one long row take less time than on short ones
    d, *work = _work.arrays('f8', *3 * [x.shape])
    d_by_axis = d.reshape(axes, columns)
    part_ends = [*range(_KEPT + level.part, columns, level.part), columns]  # ends of the parts
    factors = level.factors
    squares = np.zeros((len(part_ends), 2 * len(factors), axes))
    numbers = np.zeros((len(part_ends), 2 * len(factors)), np.int64)
    for i, (factor, sums) in enumerate(zip(factors, _sums_over(factors, x, *work))):
        size = max(x.size - 2 * factor + 1, 0)
        np.subtract(sums[factor : factor + size], sums[:size], out=d[:size])
        begin = first = _KEPT - min(summed, 2 * factor - 1)
        for part, end in enumerate(part_ends):
            # first difference that ends after this part
            next_begin = max(end - 2 * factor + 1, first)
            squares[part, i] = _squares(d_by_axis[:, begin:next_begin])
            numbers[part, i] = next_begin - begin
            begin = next_begin
        first_non_overlapping = first + -(summed - _KEPT + first) % factor
        non_overlapping = d_by_axis[:, first_non_overlapping:begin:factor]
        numbers[0, len(factors) + i] = non_overlapping.shape[1]
        squares[0, len(factors) + i] = _squares(non_overlapping)
    return squares, numbers


def _sums_over(
    factors: tuple[int, ...], x: Floats, pairs: Floats, scratch: Floats
) -> Iterator[Floats]:
    """Yield the sums over f neighboring points x, (n - f + 1,), for each of the factors f.

    The factors must be ascending, and each must be 1, 3 or even. The work arrays ``pairs`` and
    ``scratch``, (n,), are overwritten. A yielded array is valid only until the next array is
    yielded.
    """
    sums, width = np.add(x[:-1], x[1:], out=pairs[:-1]), 2
    for factor in factors:
        while width + 1 < factor:
            size = len(sums) - 2
            sums = np.add(sums[:size], pairs[width : width + size], out=scratch[:size])
            width += 2
        if factor == width:
            yield sums
        else:
            yield x if factor == 1 else np.add(sums[:-1], x[width:], out=scratch[: len(sums) - 1])


def _squares(d: Floats) -> Floats:
    """Return the sum of squares of each row of an array, (rows,), by one dot product per row."""
    return np.asarray(np.matmul(d[:, None, :], d[:, :, None])[:, 0, 0])


class Cascade:
    """All levels of the cascade for the current segment.

    Parameters
    ----------
    reference : (axes,) array
        First sample of the segment, which is subtracted from all samples.
    """

    def __init__(self, reference: Floats) -> None:
        self.reference = reference
        self.samples = 0
        self._levels = [_RunningLevel(0, len(reference) + 1)]

    def feed(self, samples: Floats, interpolated: NDArray[np.bool_] | None) -> Iterator[Block]:
        """Add samples, (axes, n), and yield the sums over the parts of blocks that become full.

        The samples are added while the result is iterated. They have the unit of the reference.
        ``interpolated``, (n,), flags the interpolated samples; None means that there are none.
        """
        position, n = 0, samples.shape[1]
        lowest_level = self._levels[0]
        while position < n:
            number = min(lowest_level.size - lowest_level.fill, n - position)
            points = lowest_level.extend(number)
            np.subtract(
                samples[:, position : position + number], self.reference[:, None], out=points[:-1]
            )
            points[-1] = 0.0 if interpolated is None else interpolated[position : position + number]
            position += number
            self.samples += number
            if lowest_level.fill == lowest_level.size:
                yield from self._close()

    def _close(self) -> Iterator[Block]:
        """Yield the sums over the parts of each full block, and begin new blocks.

        The blocks are closed in the order of the levels, up to the first block that is not full.
        """
        for j in itertools.count():
            level = self._levels[j]
            if level.fill < level.size:
                return
            points = level.current
            if j + 1 == len(self._levels):
                self._levels.append(_RunningLevel(j + 1, len(points)))
            pair_sums = self._levels[j + 1].extend(level.fill // 2)
            np.add(points[:, ::2], points[:, 1::2], out=pair_sums)
            yield from level.close()

    def open_blocks(self) -> Iterator[Block]:
        """Yield the sums over the parts of the blocks that are not full, as if the segment ended.

        The state is unchanged.
        """
        # points that the open block of the level below passes on
        new_points = self._levels[0].points[:, :0]
        for j in itertools.count():
            if j >= len(self._levels) and not new_points.shape[1]:
                return
            level = self._levels[j] if j < len(self._levels) else _RunningLevel(j, len(new_points))
            points = np.concatenate([level.points[:, : _KEPT + level.fill], new_points], axis=1)
            block = points[:, _KEPT:]
            if block.shape[1]:
                yield from level.blocks_of(points)[0]
            paired_points = block[:, : block.shape[1] // 2 * 2]
            new_points = paired_points[:, ::2] + paired_points[:, 1::2]
