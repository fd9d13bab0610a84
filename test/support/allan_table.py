# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Allan sums of one finite record at any factors, computed from the definition."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allan_ros.core.allan.grid import counts

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class AllanTable:
    """Allan sums of one finite record at given factors.

    Attributes
    ----------
    m, stride, n : (factors,) int64 arrays
        Averaging factor, samples between starts, and number of second differences.
    avar : (factors, ...) float64 array
        sum d^2 / (2 m^2 n).
    signed : (factors, ...) float64 array
        sum d.
    """

    m: NDArray[np.int64]
    stride: NDArray[np.int64]
    n: NDArray[np.int64]
    avar: Floats
    signed: Floats


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
    ms, strides = (np.array(a) for a in np.broadcast_arrays(np.atleast_1d(m), stride))
    ms, strides = ms.astype(np.int64), strides.astype(np.int64)
    rows = values.reshape(len(values), -1).T
    theta = np.zeros((len(rows), len(values) + 1))
    np.cumsum(rows - rows[:, :1], axis=1, out=theta[:, 1:])
    sum_sq = np.empty((len(ms), len(rows)))
    signed = np.empty((len(ms), len(rows)))
    for i, (factor, step) in enumerate(zip(ms, strides)):
        d = _second_differences(theta, int(factor))[:, :: int(step)]
        sum_sq[i] = np.einsum('ij,ij->i', d, d)
        signed[i] = d.sum(axis=1)
    n = counts(len(values), ms, strides)
    avar = sum_sq / (2.0 * ms.astype(float)[:, None] ** 2 * n[:, None])
    shape = (len(ms), *values.shape[1:])
    return AllanTable(ms, strides, n, avar.reshape(shape), signed.reshape(shape))


def _second_differences(theta: Floats, lag: int) -> Floats:
    """Return theta(u + 2 lag) - 2 theta(u + lag) + theta(u) along the last axis, for every u."""
    g = theta[:, lag:] - theta[:, :-lag]
    return g[:, lag:] - g[:, :-lag]
