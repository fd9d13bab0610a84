# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Allan variances of one finite record at any factors, computed from the definition."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allan_ros.core.allan.grid import grid


class AllanTable(NamedTuple):
    """Number of second differences (factors,), and Allan variance (factors, ...)."""

    n: NDArray[np.int64]
    avar: NDArray[np.float64]


def allan_table(y: ArrayLike, m: ArrayLike, stride: ArrayLike = 1) -> AllanTable:
    """Return the Allan variance of a record at any factors; stride 1 is full overlap.

    Parameters
    ----------
    y : (samples,) or (samples, axes) array
        Evenly spaced samples.
    m, stride : ints or (factors,) arrays
        Averaging factors, and samples between the starts of two second differences.
    """
    values = np.asarray(y, float)
    theta = np.concatenate([0.0 * values[:1], np.cumsum(values - values[0], axis=0)])
    n, avar = [], []
    for factor, step in zip(*np.broadcast_arrays(np.atleast_1d(m), stride)):
        means = theta[factor:] - theta[:-factor]
        d = (means[factor:] - means[:-factor])[::step]
        n.append(len(d))
        avar.append((d**2).mean(axis=0) / (2.0 * float(factor) ** 2))
    return AllanTable(np.array(n, int), np.reshape(avar, (len(n), *values.shape[1:])))


def grid_for(samples: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the factors m of `grid` up to half of the number of samples, and their strides."""
    levels = max(1, samples.bit_length() - 3)
    m, stride = grid(levels)
    keep = 2 * m <= samples
    return m[keep], stride[keep]
