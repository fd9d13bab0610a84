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
    octaves: range


@lru_cache
def level_of(j: int) -> Level:
    """Return factors and octaves of level j."""
    if j == 0:
        return Level(1, BLOCK, FIRST_FACTORS + LEVEL_FACTORS, range(SAMPLE_OCTAVES))
    o = SAMPLE_OCTAVES + j - 1
    return Level(1 << j, BLOCK // 2, LEVEL_FACTORS, range(o, o + 1))


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
def _half_tapers(o: int, kind: str) -> NDArray[np.floating]:
    """Return real and imaginary parts of both halves of the tapers, (half a block, 4 bins)."""
    _, size, bins = octave(o)
    first, second = np.split(tapers(size, bins).T, 2)
    return np.concatenate([first.real, first.imag, second.real, second.imag], axis=1).astype(kind)


@dataclass(frozen=True)
class _HalfBlock:
    """Last half block of an octave. It is also the first half of the next block."""

    early: NDArray[np.floating]  # (axes, 1, 2 bins) product with the first half of the tapers
    interpolated: float  # number of its samples that are interpolated
    used: bool  # whether the block that ends with it is not excluded


class _OctaveSums(NamedTuple):
    """Power of the blocks of one octave that end in some samples, and the last half block."""

    power: Floats  # (bins, axes)
    blocks: int
    pairs: int  # of overlapping blocks
    last: _HalfBlock | None


class _RunningLevel:
    """Points of one level of the open segment that are not summed yet.

    ``points`` contains the last `_KEPT` points up to the last summed one, then the first ``fill``
    points of the current block. The last row is the number of interpolated samples so far. A point
    is the phase minus ``origin``, (rows, 1): second differences do not depend on it.
    """

    def __init__(self, level: int, rows: int) -> None:
        self.level = level
        self.points = np.zeros((rows, _KEPT + level_of(level).block))
        self.origin = np.zeros((rows, 1))
        self.fill = 0
        self.summed = 0  # number of summed points after the first, theta(0)
        self.halves: tuple[_HalfBlock | None, ...] = (None,) * len(level_of(level).octaves)

    def append(self, points: Floats) -> None:
        """Append points to the current block."""
        self.points[:, _KEPT + self.fill : _KEPT + self.fill + points.shape[1]] = points
        self.fill += points.shape[1]

    @property
    def size(self) -> int:
        """Number of points of the current block when it is full."""
        return min(max(self.summed, FIRST_BLOCK), level_of(self.level).block)

    def phase(self, more: Floats) -> Floats:
        """Return the phase from the last summed point to the end of the block and ``more``."""
        own = self.points[:, _KEPT - 1 : _KEPT + self.fill]
        return (np.concatenate([own, more], axis=1) if more.shape[1] else own) + self.origin

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

    def sums_of(self, points: Floats) -> tuple[LevelSums, tuple[_HalfBlock | None, ...]]:
        """Return the sums of a block, and its last half blocks.

        ``points`` are (rows, n): `_KEPT` earlier points, then the points of the block.
        """
        kept = min(self.summed + 1, _KEPT)
        points = points[:, _KEPT - kept :]
        squares, groups, number = _second_differences(
            points[:-1], kept, self.summed + 1 - kept, level_of(self.level).factors
        )
        octaves = self._spectra(points[:, kept - 1 :])
        values = np.concatenate([*squares, *groups, *(each.power for each in octaves)])
        counts = [*number, *(o.blocks for o in octaves), *(o.pairs for o in octaves)]
        sums = LevelSums(self.level, values, np.array(counts, np.int64))
        return sums, tuple(each.last for each in octaves)

    def _spectra(self, points: Floats) -> list[_OctaveSums]:
        """Return the spectra of each octave in a block; ``points`` begin with the one before it."""
        level = level_of(self.level)
        # the rounding errors of float32 are much smaller than the noise of single samples, but
        # not than the noise of long means
        kind = 'f8' if self.level else 'f4'
        with np.errstate(over='ignore'):
            samples = np.subtract(points[:-1, 1:], points[:-1, :-1], dtype=float).astype(kind)
        if self.level:
            samples /= level.stride
        found = zip(level.octaves, self.halves)
        return [_octave_sums(samples, points[-1], o, before) for o, before in found]


def _octave_sums(
    samples: NDArray[np.floating], interpolated: Floats, o: int, before: _HalfBlock | None
) -> _OctaveSums:
    """Return the power of octave o in samples or means, (axes, n).

    ``interpolated`` is the cumulative number of interpolated samples, (n + 1,), and ``before`` the
    half block before the first sample.
    """
    axes, n = samples.shape
    _, size, bins = octave(o)
    half, columns = size // 2, 2 * len(bins)
    number = n // half
    if not number:
        return _OctaveSums(np.zeros((len(bins), axes)), 0, 0, before)
    # a tapered block is the sum of the products of its two halves
    with np.errstate(invalid='ignore'):  # no sensor has values above 1e38; the fit refuses them
        products = samples[:, : number * half].reshape(axes * number, half) @ _half_tapers(
            o, samples.dtype.str
        )
    products = products.reshape(axes, number, 2 * columns)
    amplitudes = products[:, 0 if before else 1 :, columns:]
    amplitudes[:, 1 if before else 0 :] += products[:, : number - 1, :columns]
    if before:
        amplitudes[:, :1] += before.early
    used, missing = _used_blocks(np.diff(interpolated[: number * half + 1 : half]), o, before)
    if not used.all():
        amplitudes = amplitudes[:, used]
    exact = amplitudes.astype(float)  # squares of large samples exceed the range of float32
    power = np.einsum('akc,akc->ac', exact, exact).T
    pairs = int(np.count_nonzero(used[:-1] & used[1:]))
    pairs += bool(before and before.used and len(used) and used[0])
    last = _HalfBlock(products[:, -1:, :columns].copy(), missing, bool(len(used) and used[-1]))
    return _OctaveSums(
        power[: len(bins)] + power[len(bins) :], int(np.count_nonzero(used)), pairs, last
    )


def _used_blocks(
    interpolated: Floats, o: int, before: _HalfBlock | None
) -> tuple[NDArray[np.bool_], float]:
    """Return which blocks of octave o are used, and the interpolated samples of the last half.

    ``interpolated``, (halves,), is the number of interpolated samples in each half block.
    """
    if before:
        interpolated = np.concatenate([[before.interpolated], interpolated])
    used = interpolated[:-1] + interpolated[1:] <= MAX_INTERPOLATED * octave(o).length
    return np.asarray(used), float(interpolated[-1])


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
            phase[-1] = 0.0 if interpolated is None else interpolated[at : at + take]
            # adding the last point before cumsum makes the order of additions the same for any
            # chunking
            phase[:, 0] += bottom.points[:, begin - 1]
            np.cumsum(phase, axis=1, out=phase)
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
            yield Block(level.summed << j, level.close(), phase[:, :0] if j else phase)
            if j == 0:
                level.move_origin()
            if j + 1 == len(self._levels):
                self._levels.append(_RunningLevel(j + 1, len(phase)))
            self._levels[j + 1].append(phase[:, 2::2])

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
