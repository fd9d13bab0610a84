# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Averaging factors of the Allan sums, and blocks and frequency bins of the octave spectra.

Octave spectra
--------------
Octave spectra are the power of tapered blocks in a few frequency bins of each octave. The blocks of
octave o have 64 * 2^o samples and overlap by half. Octave 0 uses bins 8 to 31 of its blocks, from
1/8 to nearly 1/2 cycle per sample. Other octaves use bins 8 to 15.

From octave 5 on, a block consists of 1024 means over 2^(o - 4) samples. The bins are below 1/64 of
the rate of the means, where aliases are below 0.1 % of white noise.

The powers at the same bin of two overlapping blocks, and at two bins of the same block, are
correlated. The covariances follow from the tapers (`overlap`).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FIRST_FACTORS = (1, 2, 3, 4, 6)
"""Averaging factors that only level 0 of the cascade has, in samples."""

LEVEL_FACTORS = (8, 10, 12, 14)
"""Averaging factors of each level j of the cascade, in units of its stride, 2^j samples."""

MAX_LEVELS = 42
"""Largest accepted number of levels of the cascade. The longest averaging time is then 2^41 x 14
samples, which are 976 years at 1 kHz."""


def grid(levels: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the averaging factors m and the strides of a cascade with ``levels`` levels.

    The stride is the number of samples between the starts of successive second differences. Both
    arrays have 5 + 4 * ``levels`` elements.
    """
    m = [*FIRST_FACTORS, *(factor << j for j in range(levels) for factor in LEVEL_FACTORS)]
    stride = [1] * len(FIRST_FACTORS) + [1 << j for j in range(levels) for _ in LEVEL_FACTORS]
    return np.array(m, np.int64), np.array(stride, np.int64)


def counts(samples: int, m: NDArray[np.int64], stride: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of second differences of a segment at each averaging factor m, (factors,).

    A segment of n ``samples`` has n + 1 phase points. Differences start at the samples 0, stride,
    2 stride ... up to n - 2 m; ``stride`` is (factors,).
    """
    return np.where(2 * m <= samples, (samples - 2 * m) // stride + 1, 0)


MIN_VARIANCE = 1e-80
"""Smallest Allan variance; smaller values are set to 0. The fit computes the cube and the inverse
square of variances, which must be in the range of float64. No sensor has a resolution as fine as
1e-40."""


def allan_variance(sum_sq: Floats, m: NDArray[np.int64], count: NDArray[np.int64]) -> Floats:
    """Return the Allan variance, (factors, axes), from sums of squared second differences.

    The Allan variance is ``sum_sq`` / (2 m^2 ``count``), NIST SP 1065 eq. 11. It is NaN where
    ``count`` and ``sum_sq`` are 0, and 0 where it would be below `MIN_VARIANCE`. ``sum_sq`` is
    (factors, axes), ``m`` and ``count`` are (factors,).
    """
    squared_m_count = m.astype(float) ** 2 * count  # int64 would overflow after weeks at 1 kHz
    with np.errstate(invalid='ignore', divide='ignore'):
        variance: Floats = sum_sq / (2.0 * squared_m_count[:, None])
    return np.where(variance < MIN_VARIANCE, 0.0, variance)


def levels_of(factors: int) -> int:
    """Return the number of levels, at least 1, of a grid with ``factors`` averaging factors."""
    return max(1, -(-(factors - len(FIRST_FACTORS)) // len(LEVEL_FACTORS)))


# --- octave spectra -------------------------------------------------------------------------------


SHORTEST_BLOCK = 64
"""Number of samples in a block of octave 0."""

LOW_BIN = 8
"""Lowest frequency of each octave, in periods per block."""

SAMPLE_OCTAVES = 5
"""Number of octaves whose blocks consist of samples; blocks of higher octaves consist of means."""

LONGEST_BLOCK = SHORTEST_BLOCK << (SAMPLE_OCTAVES - 1)
"""Largest number of samples or means in a block."""


class Octave(NamedTuple):
    """Lengths of the blocks of one octave, and the frequency bins of the octave."""

    step: int  # samples per mean; 1 if blocks consist of samples
    size: int  # means (or samples) per block
    bins: range  # frequencies in periods per block

    @property
    def length(self) -> int:
        """Samples per block."""
        return self.step * self.size


@lru_cache
def octave(index: int) -> Octave:
    """Return the lengths of the blocks, and the frequency bins, of the octave number ``index``."""
    log2_step = max(index - SAMPLE_OCTAVES + 1, 0)
    bins = range(LOW_BIN, 4 * LOW_BIN if index == 0 else 2 * LOW_BIN)
    return Octave(1 << log2_step, SHORTEST_BLOCK << (index - log2_step), bins)


def bins_up_to(octaves: int) -> int:
    """Return the number of bins of the first ``octaves`` octaves."""
    return sum(len(octave(o).bins) for o in range(octaves))


@lru_cache
def tapers(size: int, bins: range) -> NDArray[np.complex128]:
    """Return the complex taper of each bin, (bins, size); its squared magnitudes sum to 1.

    The powers of a block in the bins are |tapers @ block|^2. The squared windows of two blocks that
    overlap by half add up to 1. Each taper is orthogonal to a constant and to a line, so that an
    offset or a linear drift adds no power.
    """
    t = np.arange(size)
    window = np.sin(np.pi / 2 * np.sin(np.pi * (t + 0.5) / size) ** 2)
    waves = window * np.exp(-2j * np.pi * np.outer(np.array(bins), t) / size)
    constant_and_line = np.linalg.qr(np.stack([np.ones(size), t - t.mean()], axis=1))[0]
    waves = waves - (waves @ constant_and_line) @ constant_and_line.T
    return np.asarray(waves / np.sqrt((np.abs(waves) ** 2).sum(axis=1))[:, None])


@lru_cache
def overlap(octave_index: int) -> tuple[Floats, Floats]:
    """Return the covariances of the power of a middle bin of an octave, for unit white noise.

    The first array, (31,), contains the covariances with bins 1 to 31 of the same block; the
    largest one is the variance of the middle bin. The second array, (31,), contains the covariances
    with the same bins of both neighboring blocks, summed over the two blocks.
    """
    size = octave(octave_index).size
    these_tapers = tapers(size, range(1, 4 * LOW_BIN))
    # tapers of the next block, where the next block overlaps this block
    next_tapers = np.zeros_like(these_tapers)
    next_tapers[:, size // 2 :] = these_tapers[:, : size // 2]
    # row of bin 16 (octave 0) or bin 12 (other octaves)
    middle_row = (2 * LOW_BIN if octave_index == 0 else LOW_BIN + LOW_BIN // 2) - 1

    def covariance(x: NDArray[np.complex128], y: NDArray[np.complex128]) -> Floats:
        middle_taper = x[middle_row]
        return np.asarray(np.abs(middle_taper.conj() @ y.T) ** 2 + np.abs(middle_taper @ y.T) ** 2)

    with_next = covariance(these_tapers, next_tapers)
    with_previous = covariance(next_tapers, these_tapers)
    return covariance(these_tapers, these_tapers), with_next + with_previous
