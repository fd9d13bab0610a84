# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The averaging factors of the engine: four to an octave, each with its stride.

Level j of the cascade holds the phase at every 2^j-th sample. There the factors are 2^j times
8, 10, 12 and 14; level 0 has 1, 2, 3, 4 and 6 besides. A factor of level j starts a second
difference every 2^j samples (stride m/8 .. m/14), which loses at most 2 % of the information of
full overlap for white noise (1 + 1.25 (stride/m)^2) and none for slower noises.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FIRST_FACTORS = (1, 2, 3, 4, 6)
"""Factors that only level 0 has."""

LEVEL_FACTORS = (8, 10, 12, 14)
"""Factors of every level, in units of the level's stride 2^j."""

MAX_LEVELS = 42
"""2^41 x 14 samples are 970 years at 1 kHz: a bound for what is read from strangers, and as far as
the lags of a covariance fit their search keys."""


def grid(levels: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the averaging factors and their strides of the first levels, ascending.

    Parameters
    ----------
    levels : int
        How many levels, at least 1.

    Returns
    -------
    m, stride : (5 + 4 levels,) int64 arrays
        In samples.
    """
    m = list(FIRST_FACTORS)
    stride = [1] * len(m)
    for j in range(levels):
        m += [f << j for f in LEVEL_FACTORS]
        stride += [1 << j] * len(LEVEL_FACTORS)
    return np.array(m, np.int64), np.array(stride, np.int64)


def grid_for(samples: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the factors m <= samples/2 of the grid, and their strides."""
    levels = max(1, samples.bit_length() - 3)
    m, stride = grid(levels)
    keep = 2 * m <= samples
    return m[keep], stride[keep]


def counts(samples: int, m: NDArray[np.int64], stride: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how many second differences a segment of that many samples has at each factor.

    n samples make n + 1 phase points; starts are 0, stride, 2 stride .. n - 2 m.
    """
    number: NDArray[np.int64] = np.where(2 * m <= samples, (samples - 2 * m) // stride + 1, 0)
    return number
