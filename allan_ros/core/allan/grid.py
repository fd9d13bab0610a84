# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Averaging factors of the running Allan sums, and the Allan variance at these factors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FIRST_FACTORS = (1, 2, 3, 4, 6)
"""Averaging factors of level 0 only."""

LEVEL_FACTORS = (8, 10, 12, 14)
"""Averaging factors of every level j, in units of its stride 2^j."""

MAX_LEVELS = 42
"""Largest accepted number of levels: 2^41 x 14 samples are 970 years at 1 kHz. With more levels,
the lags of a covariance would not fit into 64-bit search keys."""


def grid(levels: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the averaging factors m and the strides of a cascade of ``levels`` decimations.

    The stride is the number of samples between the starts of two second differences. Both arrays
    have 5 + 4 ``levels`` elements.
    """
    m = [*FIRST_FACTORS, *(f << j for j in range(levels) for f in LEVEL_FACTORS)]
    stride = [1] * len(FIRST_FACTORS) + [1 << j for j in range(levels) for _ in LEVEL_FACTORS]
    return np.array(m, np.int64), np.array(stride, np.int64)


def grid_for(samples: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the factors m of `grid` up to half of the number of samples, and their strides."""
    levels = max(1, samples.bit_length() - 3)
    m, stride = grid(levels)
    keep = 2 * m <= samples
    return m[keep], stride[keep]


def counts(samples: int, m: NDArray[np.int64], stride: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of second differences of a segment of n ``samples`` at each factor m.

    n samples have n + 1 phase points, so differences start at 0, stride, 2 stride ... n - 2 m.
    """
    return np.where(2 * m <= samples, (samples - 2 * m) // stride + 1, 0)


MIN_VARIANCE = 1e-80
"""Smaller variances are set to 0. No sensor has a resolution of 1e-40. The fit computes the cube
and the inverse square of variances, which would be outside the range of float64."""


def allan_variance(sum_sq: Floats, m: NDArray[np.int64], count: NDArray[np.int64]) -> Floats:
    """Return the Allan variance sum d^2 / (2 m^2 count), (factors, axes), NIST SP 1065 eq. 11.

    It is NaN where ``count`` is 0; values below `MIN_VARIANCE` are set to 0.
    """
    number = m.astype(float) ** 2 * count  # int64 would overflow after weeks at 1 kHz
    with np.errstate(invalid='ignore', divide='ignore'):
        variance: Floats = sum_sq / (2.0 * number[:, None])
    return np.where(variance < MIN_VARIANCE, 0.0, variance)


def levels_of(factors: int) -> int:
    """Return the number of levels of a grid with ``factors`` factors, at least 1."""
    return max(1, -(-(factors - 5) // 4))
