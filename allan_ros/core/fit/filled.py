# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Effect of interpolated samples on the Allan variance of white noise.

Linear interpolation replaces samples by weighted means of the two next to a gap. A second
difference is a weighted sum of independent samples, so its variance changes from the sum of the
squared weights of all samples to that of the recorded samples. At averaging factors m >= k it
grows, in the sum over all starts, by 2 (k + k^2/2) for each step of m.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def filled_white(m: Ints, filled: Ints, samples: int) -> Floats:
    """Return what filled gaps add to the Allan variance of white noise of unit variance.

    Parameters
    ----------
    m : (factors,) int64 array
        Averaging factors.
    filled : (lengths, ...) int64 array
        Gaps of 1, 2, ... filled samples.
    samples : int
        Samples that they are among, the filled ones included.

    Returns
    -------
    (factors, ...) float64 array
    """
    out = np.zeros((len(m), *filled.shape[1:]))
    for k, number in enumerate(filled, start=1):
        if number.any():
            slope = 2.0 * (k + k * k / 2.0)
            extra = np.array([_excess(k, min(int(f), k)) + slope * max(f - k, 0) for f in m])
            out += np.multiply.outer(extra / (2.0 * m.astype(float) ** 2), number / samples)
    return out


@lru_cache(maxsize=1024)
def _excess(k: int, m: int) -> float:
    """Return by how much one gap changes the squared weights, summed over all starts."""
    length = k + 2
    base = np.concatenate([np.zeros(length), -np.ones(m), np.ones(m), np.zeros(length)])
    share = np.arange(1, k + 1) / (k + 1)
    change = 0.0
    for at in range(len(base) - length + 1):
        w = base[at : at + length]
        left = w[0] + (1.0 - share) @ w[1:-1]
        right = w[-1] + share @ w[1:-1]
        change += left**2 + right**2 - float(w @ w)
    return change
