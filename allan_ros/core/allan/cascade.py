# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cascade of decimated phases of one segment: its second differences and octave spectra.

Level j of the cascade stores the phase (the cumulative sum of the samples) at every 2^j-th sample,
in blocks of some thousand points. When a block is full, the second differences that end in it are
squared and summed at the averaging factors of the level, the power of the spectral blocks that end
in it is added, and every second point is passed to level j + 1. Blocks are counted from the start
of the segment, so the sums are the same, bit for bit, for any chunking.

Source of the first statistic: IEEE Std 952-1997 annex C; NIST SP 1065 eq. 11 (overlapping Allan
variance). To avoid rounding errors, the first sample of the segment is subtracted from all samples,
and the phase starts from 0 in each block of level 0. Without this, an offset of 9.8 m/s^2 would
cause relative errors of up to 1e-5 at the longest factors after 1e9 samples.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .grid import FIRST_FACTORS, LEVEL_FACTORS, SAMPLE_OCTAVES, octave, tapers

Floats = NDArray[np.float64]
Floating = NDArray[np.floating]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]

FIRST_BLOCK, BLOCK = 512, 4096
"""Phase points of the first and of later blocks of level 0: 512, 512, 1024, 2048, 4096, 4096 ...
Long blocks amortize the overhead of numpy calls, and still fit into the cache. Those of higher
levels have at most half as many, which locates their sums more accurately in time."""

MAX_INTERPOLATED = 0.75
"""A spectral block is excluded if more than this share of its samples is interpolated on any axis:
shocks. The fit knows the effect of short gaps."""

_KEPT = 2 * LEVEL_FACTORS[-1]
"""Number of points of the previous blocks that a level keeps: the length of its longest second
difference."""


@dataclass(frozen=True)
class Level:
    """One level of the cascade: its decimation, averaging factors and octave spectra."""

    stride: int  # samples between two points
    block: int  # largest number of points per block
    factors: tuple[int, ...]  # averaging factors in units of the stride
    groups: tuple[range, ...]  # octaves with equal numbers of bins

    @property
    def octaves(self) -> list[int]:
        """All octaves of the level."""
        return [o for group in self.groups for o in group]


@lru_cache
def level_of(j: int) -> Level:
    """Return factors and octaves of level j."""
    if j == 0:
        groups = range(1), range(1, SAMPLE_OCTAVES)
        return Level(1, BLOCK, FIRST_FACTORS + LEVEL_FACTORS, groups)
    o = SAMPLE_OCTAVES + j - 1
    return Level(1 << j, BLOCK // 2, LEVEL_FACTORS, (range(o, o + 1),))


@dataclass(frozen=True)
class LevelSums:
    """Sums of one level over some of its blocks; they can be added.

    ``values`` contains, for each axis, the sums of squares at the factors of the level, the same
    for non-overlapping differences, and the power of the bins. ``counts`` contains the numbers of
    differences, of non-overlapping differences, of spectral blocks of each octave, and of pairs of
    overlapping ones.
    """

    level: int
    values: Floats  # (2 factors + bins, axes)
    counts: Ints  # (2 factors + 2 octaves,)

    @classmethod
    def zero(cls, j: int, axes: int) -> LevelSums:
        """Return the sums over no block of level j."""
        level = level_of(j)
        factors, bins = len(level.factors), sum(len(octave(o).bins) for o in level.octaves)
        counts = np.zeros(2 * (factors + len(level.octaves)), np.int64)
        return cls(j, np.zeros((2 * factors + bins, axes)), counts)

    def __add__(self, other: LevelSums) -> LevelSums:
        return LevelSums(self.level, self.values + other.values, self.counts + other.counts)

    @property
    def arrays(self) -> tuple[Ints, Floats, Ints, Floats, Ints, Ints, Floats]:
        """The counts and values apart: differences, non-overlapping ones, blocks, pairs, power."""
        n = len(level_of(self.level).factors)
        m = (len(self.counts) - 2 * n) // 2
        count, group_count, blocks, pairs = np.split(self.counts, [n, 2 * n, 2 * n + m])
        sum_sq, group_sum_sq, power = np.split(self.values, [n, 2 * n])
        return count, sum_sq, group_count, group_sum_sq, blocks, pairs, power


@dataclass(frozen=True)
class Block:
    """Sums of a block of one level, full or at the end of the segment."""

    begin: int  # index of its first sample in the segment
    sums: LevelSums
    # level 0: (axes + 1, samples + 1) phase before and after its samples; the last row is the
    # number of interpolated samples. Empty at higher levels
    phase: Floats


@lru_cache
def _half_tapers(o: int, kind: str) -> Floating:
    """Return the tapers of the first and of the second half of a block, (half a block, 4 bins).

    The columns of each are its real, then its imaginary parts. They are divided by the number of
    samples per mean, because they are multiplied by sums.
    """
    step, size, bins = octave(o)
    halves = np.split(tapers(size, bins).T / step, 2)
    return np.concatenate([f(h) for h in halves for f in (np.real, np.imag)], axis=1).astype(kind)


@dataclass(frozen=True)
class _HalfBlocks:
    """Last half block of each octave of a group. It is also the first half of the next block."""

    early: Floating  # (octaves, axes, 2 bins) products with the tapers of the first half
    # (octaves,) number of its samples that are interpolated; infinite before the first sample
    interpolated: Floats
    used: Flags  # (octaves,) whether the block that ends with it is not excluded

    @classmethod
    def none(cls, octaves: range, axes: int, kind: str) -> _HalfBlocks:
        """Return the half blocks before the first sample."""
        number, columns = len(octaves), 2 * len(octave(octaves[0]).bins)
        early = np.zeros((number, axes, columns), kind)
        return cls(early, np.full(number, np.inf), np.zeros(number, bool))

    def copy(self) -> _HalfBlocks:
        return _HalfBlocks(self.early.copy(), self.interpolated.copy(), self.used.copy())


class _Layout(NamedTuple):
    """Rows of the half blocks of an octave in n samples or sums."""

    octave: int
    half: int  # samples per half block
    number: int  # half blocks of each axis
    begin: int  # row of the first of them; those of an axis follow each other
    end: int


@lru_cache(256)
def _layout(octaves: range, axes: int, n: int) -> list[_Layout]:
    """Return the rows of each octave."""
    rows: list[_Layout] = []
    for o in octaves:
        half, begin = octave(o).size // 2, rows[-1].end if rows else 0
        rows.append(_Layout(o, half, n // half, begin, begin + axes * (n // half)))
    return rows


class _GroupSums(NamedTuple):
    """Power of the blocks of a group of octaves that end in some samples, and the last halves."""

    power: list[Floats]  # (bins, axes) of each octave
    blocks: list[int]
    pairs: list[int]  # of overlapping blocks
    last: _HalfBlocks


class _RunningLevel:
    """Points of one level of the open segment that are not summed yet.

    ``points`` contains the last `_KEPT` points up to the last summed one, then the first ``fill``
    points of the current block. The last row is the number of interpolated samples so far. A point
    of level 0 is the phase minus ``origin``, (rows, 1): second differences do not depend on it.
    """

    def __init__(self, level: int, rows: int) -> None:
        self.level = level
        self.points = np.zeros((rows, _KEPT + level_of(level).block))
        self.origin = np.zeros((rows, 1))
        self.fill = 0
        self.summed = 0  # number of summed points after the first, theta(0)
        # the rounding errors of float32 are much smaller than the noise of single samples, but
        # not than the noise of long means
        self.kind = 'f8' if level else 'f4'
        self.halves = [
            _HalfBlocks.none(group, rows - 1, self.kind) for group in level_of(level).groups
        ]

    def append(self, points: Floats) -> None:
        """Append points to the current block."""
        self.points[:, _KEPT + self.fill : _KEPT + self.fill + points.shape[1]] = points
        self.fill += points.shape[1]

    @property
    def size(self) -> int:
        """Number of points of the current block when it is full."""
        return min(max(self.summed, FIRST_BLOCK), level_of(self.level).block)

    def phase(self, more: Floats) -> Floats:
        """Return the phase from the last summed point to the end of the block and ``more``.

        At higher levels, it is a view if ``more`` is empty.
        """
        own = self.points[:, _KEPT - 1 : _KEPT + self.fill]
        if more.shape[1]:
            own = np.concatenate([own, more], axis=1)
        return own if self.level else own + self.origin

    def close(self) -> LevelSums:
        """Return the sums of the full block, and begin a new one."""
        sums, self.halves = self.sums_of(self.points[:, : _KEPT + self.fill])
        self.points[:, :_KEPT] = self.points[:, self.fill : self.fill + _KEPT]
        self.summed += self.fill
        self.fill = 0
        return sums

    def move_origin(self) -> None:
        """Move the origin to the last point of a block that was just closed.

        The numbers remain as small as the phase of one block, so that no digits are lost.
        """
        last = self.points[:, _KEPT - 1 : _KEPT].copy()
        self.points[:, :_KEPT] -= last
        self.origin += last

    def sums_of(self, points: Floats) -> tuple[LevelSums, list[_HalfBlocks]]:
        """Return the sums of a block, and its last half blocks.

        ``points`` are (rows, n): `_KEPT` earlier points, then the points of the block.
        """
        kept, level = min(self.summed + 1, _KEPT), level_of(self.level)
        points = points[:, _KEPT - kept :]
        squares, groups, number = _second_differences(
            points[:-1], kept, self.summed + 1 - kept, level.factors
        )
        points = points[:, kept - 1 :]
        with np.errstate(over='ignore', invalid='ignore'):
            # no sensor has values above 1e38, the largest float32; the fit refuses them
            samples = (points[:-1, 1:] - points[:-1, :-1]).astype(self.kind)
            spectra = [
                _group_sums(samples, points[-1], group, before)
                for group, before in zip(level.groups, self.halves)
            ]
        values = [*squares, *groups, *(power for each in spectra for power in each.power)]
        counts = [*number, *(b for s in spectra for b in s.blocks)]
        counts += [p for s in spectra for p in s.pairs]
        sums = LevelSums(self.level, np.concatenate(values), np.array(counts, np.int64))
        return sums, [each.last for each in spectra]


def _group_sums(
    samples: Floating, interpolated: Floats, octaves: range, before: _HalfBlocks
) -> _GroupSums:
    """Return the power of a group of octaves in samples or sums over their step, (axes, n).

    ``interpolated`` is the cumulative number of interpolated samples, (n + 1,), and ``before`` are
    the half blocks before the first sample.
    """
    layout = _layout(octaves, *samples.shape)
    last = before.copy()
    amplitudes = _amplitudes(samples, layout, before.early, last.early)
    all_used = interpolated[-1] == interpolated[0] and not before.interpolated.any()
    power, blocks, pairs = [], [], []
    for i, (o, half, number, begin, end) in enumerate(layout):
        found = amplitudes[begin:end].reshape(len(samples), number, amplitudes.shape[1])
        if all_used:
            blocks.append(number)
            pairs.append(number - (not before.used[i]) if number else 0)
            last.used[i] = number > 0
        else:
            counts = interpolated[: number * half + 1 : half]
            counts = np.concatenate([before.interpolated[i : i + 1], counts[1:] - counts[:-1]])
            used = counts[:-1] + counts[1:] <= MAX_INTERPOLATED * octave(o).length
            found = found[:, used]
            used = np.concatenate([before.used[i : i + 1], used])  # with the block before
            blocks.append(int(np.count_nonzero(used[1:])))
            pairs.append(int(np.count_nonzero(used[1:] & used[:-1])))
            last.interpolated[i], last.used[i] = counts[-1], used[-1]
        squares = np.einsum('akc,akc->ac', found, found).T
        power.append(squares[: len(squares) // 2] + squares[len(squares) // 2 :])
    return _GroupSums(power, blocks, pairs, last)


def _amplitudes(
    samples: Floating, layout: list[_Layout], before: Floating, last: Floating
) -> Floats:
    """Return the amplitudes of the blocks that end with each half block, (rows, 2 bins).

    ``before``, (octaves, axes, 2 bins), is the product of the half block before the first sample
    with the tapers of the first half; that of the last half block is written to ``last``.
    """
    rows, columns = layout[-1].end, before.shape[2]
    products = np.empty((rows, 2 * columns), samples.dtype)
    for o, half, number, begin, end in layout:
        whole = samples[:, : number * half].reshape(-1, half)
        np.matmul(whole, _half_tapers(o, samples.dtype.str), out=products[begin:end])
    early, late = products[:, :columns], products[:, columns:]
    # the amplitude of a block is the sum of the products of its two halves
    amplitudes = np.empty(late.shape, samples.dtype)
    np.add(early[:-1], late[1:], out=amplitudes[1:])
    for i, (_, _, number, begin, end) in enumerate(layout):
        if number:
            amplitudes[begin:end:number] = before[i] + late[begin:end:number]
            last[i] = early[begin + number - 1 : end : number]
    del products, early, late
    return amplitudes.astype(float)  # squares of large samples exceed float32


def _second_differences(
    points: Floats, kept: int, first: int, factors: tuple[int, ...]
) -> tuple[list[Floats], list[Floats], list[int]]:
    """Return sums of squares of all and of non-overlapping differences, and the numbers of both.

    ``points`` are (axes, n). Only differences count that end after the first ``kept`` points.
    ``first`` is the index of the first point in the segment.
    """
    axes, n = points.shape
    flat = points.reshape(-1)  # operations on one long row take less time than on short ones
    g, d = np.empty((2, flat.size))
    by_axis = d.reshape(axes, n)
    squares, groups, number, apart = [], [], [], []
    for f in factors:
        start, end = max(kept - 2 * f, 0), n - 2 * f
        if start >= end:
            squares.append(np.zeros((1, axes)))
            groups.append(squares[-1])
            number.append(0)
            apart.append(0)
            continue
        np.subtract(flat[f:], flat[:-f], out=g[:-f])
        np.subtract(g[f:-f], g[: -2 * f], out=d[: -2 * f])
        squares.append(_squares(by_axis[:, start:end]))
        number.append(end - start)
        chosen = by_axis[:, start + -(first + start) % f : end : f]
        groups.append(_squares(chosen) if f > 1 else squares[-1])
        apart.append(chosen.shape[1])
    return squares, groups, number + apart


def _squares(d: Floats) -> Floats:
    """Return the sum of squares of each row, (1, rows), computed by one dot product per row."""
    return np.asarray(np.matmul(d[:, None, :], d[:, :, None])[:, 0, 0])[None]


class Cascade:
    """The cascade of the current segment.

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
        """Add samples, (axes, n), and yield the blocks that become full."""
        at, n = 0, samples.shape[1]
        bottom = self._levels[0]
        while at < n:
            take = min(bottom.size - bottom.fill, n - at)
            begin = _KEPT + bottom.fill
            phase = bottom.points[:, begin : begin + take]
            np.subtract(samples[:, at : at + take], self.reference[:, None], out=phase[:-1])
            if interpolated is None:
                phase[-1], rows = bottom.points[-1, begin - 1], slice(-1)
            else:
                phase[-1], rows = interpolated[at : at + take], slice(None)
            # adding the last point before cumsum makes the order of additions the same for any
            # chunking
            phase[rows, 0] += bottom.points[rows, begin - 1]
            np.cumsum(phase[rows], axis=1, out=phase[rows])
            bottom.fill += take
            at += take
            self.samples += take
            if bottom.fill == bottom.size:
                yield from self._close()

    def _close(self) -> Iterator[Block]:
        """Yield the full blocks, from level 0 on, and begin new ones."""
        for j in itertools.count():
            level = self._levels[j]
            if level.fill < level.size:
                return
            phase = level.phase(level.points[:, :0])
            if j + 1 == len(self._levels):
                self._levels.append(_RunningLevel(j + 1, len(phase)))
            self._levels[j + 1].append(phase[:, 2::2])
            yield Block(level.summed << j, level.close(), phase[:, :0] if j else phase)
            if j == 0:
                level.move_origin()

    def open_blocks(self) -> Iterator[Block]:
        """Yield the blocks that are not full as if the segment ended; the state is unchanged."""
        new = self._levels[0].points[:, :0]  # points of the level below that are not summed yet
        for j in itertools.count():
            if j >= len(self._levels) and not new.shape[1]:
                return
            level = self._levels[j] if j < len(self._levels) else _RunningLevel(j, len(new))
            phase = level.phase(new)
            if phase.shape[1] > 1:
                points = np.concatenate([level.points[:, : _KEPT + level.fill], new], axis=1)
                sums = level.sums_of(points)[0]
                yield Block(level.summed << j, sums, phase[:, :0] if j else phase)
            new = phase[:, 2::2]
