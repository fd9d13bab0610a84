# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Effect of replaced samples on the autocovariance of white noise.

Derivation
----------
A stretch of g samples is replaced by a line between two means of L samples, before and after the
stretch. This removes the noise of g samples. Each of the L samples before the stretch keeps the
weight 1 at its own position. In addition, it has the weight (1 - i/(g + 1))/L at the positions
i = 1 .. g of the stretch. The L samples after the stretch have the same weights in reverse order.

At frequencies far below 1/(g + L), one stretch between single samples (L = 1) adds the power of
about g^2/2 samples. At frequencies far above 1/L, a stretch removes the power of g samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..noise import Gamma

Floats = NDArray[np.float64]


def stretch_excess(length: int, level: int) -> Floats:
    """Return by how much one replaced stretch changes the autocovariance of white noise.

    The result, (length + level,), is the sum of the changes over all positions, at lags of 0, 1 ...
    ``length`` + ``level`` - 1 samples, for unit variance. ``length`` is the number of replaced
    samples. ``level`` is the number of samples in each of the two means between which the samples
    are interpolated.
    """
    n = 2 * (length + level)
    mean_transform = np.fft.rfft(np.ones(level), n)
    line_weights = np.zeros(n)
    line_weights[level : level + length] = 1.0 - np.arange(1, length + 1) / (length + 1)
    line_transform = np.fft.rfft(line_weights)
    power = (
        2.0 * (mean_transform.conj() * line_transform).real + np.abs(line_transform) ** 2
    ) / level
    return np.asarray(np.fft.irfft(2.0 * power - length, n)[: n // 2])


def replaced_excess(stretches: NDArray[np.int64], number: Floats) -> Gamma:
    """Return the function by which replaced stretches change gamma(M, j) of unit white noise.

    ``stretches`` is `AllanSums.replaced`. ``number``, (stretches,), is the number of stretches of
    each row on one axis, divided by the number of samples.

    gamma(M, j) is the autocovariance of means over M samples at a lag of j means. It is minus the
    second difference of a function P with step M, divided by M^2. The second difference of P with
    step 1 is minus the autocovariance of the samples.
    """
    total = np.zeros(max(int((stretches[:, :2]).sum(axis=1).max(initial=1)), 2))
    for (length, level, *_), share in zip(stretches.tolist(), number.tolist()):
        if share:
            excess = stretch_excess(length, level)
            total[: len(excess)] += share * excess
    lags = np.arange(len(total))
    slope = -np.cumsum(np.concatenate([total[:1] / 2.0, total[1:]]))
    table = np.cumsum(np.concatenate([[-(lags @ total)], slope]))

    def phase(t: Floats) -> Floats:
        index = np.minimum(t, len(total)).astype(np.int64)
        return np.asarray(table[index] + slope[-1] * (t - index))

    def gamma(M: ArrayLike, j: ArrayLike) -> Floats:
        M, j = np.asarray(M, float), np.asarray(j, float)
        second_difference = 2.0 * phase(j * M) - phase((j + 1.0) * M) - phase(np.abs(j - 1.0) * M)
        return np.asarray(second_difference / M**2)

    return gamma
