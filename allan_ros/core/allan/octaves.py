# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Octave spectra: power of short tapered blocks, in a few frequency bins of each octave.

The blocks of octave o have 64 * 2^o samples and overlap by half. Octave 0 uses bins 8 to 31 of its
blocks (from 1/8 to nearly 1/2 cycle per sample), the others bins 8 to 15, which is one octave. From
octave 5 on, a block consists of 1024 means over 2^(o - 4) samples. Only frequencies below 1/64 of
the rate of the means are used, where aliases are below 0.1 % of white noise.

The powers at the same bin of two blocks, and at two bins of the same block, are correlated. Their
covariances follow from the tapers (`overlap`).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SHORTEST_BLOCK = 64
"""Samples per block of octave 0."""

LOW_BIN = 8
"""Lowest bin of each octave: the number of periods in a block."""

SAMPLE_OCTAVES = 5
"""Number of octaves whose blocks consist of samples; blocks of higher octaves consist of means."""

LONGEST_BLOCK = SHORTEST_BLOCK << (SAMPLE_OCTAVES - 1)
"""Largest number of samples or means in a block."""


class Octave(NamedTuple):
    """Blocks and bins of one octave."""

    step: int  # samples per mean
    size: int  # means per block
    bins: range  # frequencies in periods per block

    @property
    def length(self) -> int:
        """Samples per block."""
        return self.step * self.size


@lru_cache
def octave(o: int) -> Octave:
    """Return blocks and bins of octave o."""
    means = max(o - SAMPLE_OCTAVES + 1, 0)
    bins = range(LOW_BIN, 4 * LOW_BIN if o == 0 else 2 * LOW_BIN)
    return Octave(1 << means, SHORTEST_BLOCK << (o - means), bins)


def bins_up_to(octaves: int) -> int:
    """Return the number of bins of the first ``octaves`` octaves."""
    return sum(len(octave(o).bins) for o in range(octaves))


@lru_cache
def tapers(size: int, bins: range) -> NDArray[np.complex128]:
    """Return complex tapers of unit power, (bins, size); block power is |tapers @ block|^2.

    The window is power-complementary at an overlap of one half. Each taper is orthogonal to a
    constant and to a line, so that an offset or a slow drift adds no power.
    """
    t = np.arange(size)
    window = np.sin(np.pi / 2 * np.sin(np.pi * (t + 0.5) / size) ** 2)
    a = window * np.exp(-2j * np.pi * np.outer(np.array(bins), t) / size)
    line = np.linalg.qr(np.stack([np.ones(size), t - t.mean()], axis=1))[0]
    a = a - (a @ line) @ line.T
    return np.asarray(a / np.sqrt((np.abs(a) ** 2).sum(axis=1))[:, None])


@lru_cache
def overlap(o: int) -> tuple[Floats, Floats]:
    """Return covariances of the power of a middle bin of octave o, for unit white noise.

    The first array contains those with bins 1 to 31 of the same block, the second the sum of those
    with the two neighboring blocks. The largest of the first is the variance of the bin.
    """
    size = octave(o).size
    a = tapers(size, range(1, 4 * LOW_BIN))
    late = np.zeros_like(a)  # of the next block
    late[:, size // 2 :] = a[:, : size // 2]
    middle = (2 * LOW_BIN if o == 0 else LOW_BIN + LOW_BIN // 2) - 1  # row of bin 16 or 12

    def covariance(x: NDArray[np.complex128], y: NDArray[np.complex128]) -> Floats:
        one = x[middle]
        return np.asarray(np.abs(one.conj() @ y.T) ** 2 + np.abs(one @ y.T) ** 2)

    return covariance(a, a), covariance(a, late) + covariance(late, a)
