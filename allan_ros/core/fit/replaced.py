# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Effect of replaced samples on the autocovariance of white noise.

Derivation
----------
A stretch of g samples is replaced by a line between two means of L samples, before and after the
stretch. This removes the noise of g samples. Each of the L samples before the stretch keeps its own
weight of 1. In addition, it has the weight (1 - i/(g + 1))/L at the positions i = 1 .. g of the
stretch. The samples after the stretch have such weights in reverse order.

At frequencies far below 1/(g + L), one stretch between single samples (L = 1) adds the power of
about g^2/2 samples. At frequencies far above 1/L, it removes the power of g samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..noise import Gamma

Floats = NDArray[np.float64]


def stretch_excess(length: int, level: int) -> Floats:
    """Return the change of the autocovariance of white noise by one replaced stretch.

    The result, (length + level,), is the sum over all positions, at lags of 0, 1 ...
    ``length`` + ``level`` - 1 samples, for unit variance. ``level`` is the number of samples of the
    means on either side.
    """
    n = 2 * (length + level)
    own = np.fft.rfft(np.ones(level), n)
    line = np.zeros(n)
    line[level : level + length] = 1.0 - np.arange(1, length + 1) / (length + 1)
    weights = np.fft.rfft(line)
    power = (2.0 * (own.conj() * weights).real + np.abs(weights) ** 2) / level
    return np.asarray(np.fft.irfft(2.0 * power - length, n)[: n // 2])


def replaced_excess(stretches: NDArray[np.int64], number: Floats) -> Gamma:
    """Return the change of gamma(M, j) of unit white noise by replaced stretches.

    ``stretches`` is `AllanSums.replaced`. ``number``, (stretches,), is the number of stretches of
    each row, divided by the number of samples.

    gamma(M, j) is the autocovariance of means over M samples at a lag of j means. It is minus the
    second difference of a function P with step M, divided by M^2. The second difference of P with
    step 1 is minus the autocovariance of the samples.
    """
    total = np.zeros(max(int((stretches[:, :2]).sum(axis=1).max(initial=1)), 2))
    for (length, level, *_), share in zip(stretches.tolist(), number.tolist()):
        if share:
            excess = stretch_excess(length, level)
            total[: len(excess)] += share * excess
    lag = np.arange(len(total))
    slope = -np.cumsum(np.concatenate([total[:1] / 2.0, total[1:]]))
    table = np.cumsum(np.concatenate([[-(lag @ total)], slope]))

    def phase(t: Floats) -> Floats:
        near = np.minimum(t, len(total)).astype(np.int64)
        return np.asarray(table[near] + slope[-1] * (t - near))

    def gamma(M: ArrayLike, j: ArrayLike) -> Floats:
        M, j = np.asarray(M, float), np.asarray(j, float)
        second = 2.0 * phase(j * M) - phase((j + 1.0) * M) - phase(np.abs(j - 1.0) * M)
        return np.asarray(second / M**2)

    return gamma
