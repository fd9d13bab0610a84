# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the ramps that were taken out of pooled segments took from the expected table.

Of the segments of a length class only the mean length is kept. What a ramp takes changes smoothly
with the length of its segment, so the mean does for every factor m with 2 m below the class: the
error is of second order in its width of 10 %. The one class that 2 m falls into is another matter,
for only some of its segments have a difference at m. How many differences these have is known
nevertheless: of those that the sums count at m, what the longer classes leave over.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..grid import counts
from ..sums import LENGTH_CLASS_RATIO, LengthClass, ols_ramp_weights
from .model import RANDOM_TERMS, Floats
from .ramp import RampEffect, ramp_geometry, ramp_shift

Ints = NDArray[np.int64]


def pooled_shift(classes: Sequence[LengthClass], m: Ints, stride: Ints, count: Ints) -> Floats:
    """Return what taking the ramps out adds to the expected sums over the pooled differences.

    Parameters
    ----------
    classes : sequence of LengthClass
    m, stride, count : (factors,) int64 arrays
        Averaging factors, samples between two starts, and differences of all pooled segments.

    Returns
    -------
    (factors, 4) float64 array
        Per unit power, for sums of d^2/(2 m^2).
    """
    taken = np.zeros((len(m), len(RANDOM_TERMS)))
    number = np.zeros(len(m))
    partly = np.zeros(len(m), np.int64)
    for pool in classes:
        mean, low, high = _lengths(pool)
        whole = np.flatnonzero(2 * m <= low)
        here = pool.count * _differences(pool, mean, m[whole], stride[whole])
        number[whole] += here
        taken[whole] += here[:, None] * _shift(round(mean))[whole]
        partly[(2 * m > low) & (2 * m < high)] = round(mean)
    for i in np.flatnonzero(partly):
        rest = max(count[i] - number[i], 0.0)
        number[i] += rest
        taken[i] += rest * _shift(max(int(partly[i]), 2 * int(m[i])))[i]
    return np.asarray(taken * (count / np.maximum(number, 1.0))[:, None])


def fixed_effect(samples: int) -> RampEffect | None:
    """Return what the least-squares ramp of a pooled segment does; None where it has none."""
    geometry = ramp_geometry(samples)
    if geometry.points < 3:
        return None
    return geometry.effect(ols_ramp_weights(geometry.points, geometry.step))


def _lengths(pool: LengthClass) -> tuple[float, float, float]:
    """Return the mean of the lengths of a class, and between what they lie."""
    mean = pool.samples / pool.count
    if pool.count == 1:
        return mean, mean, mean
    low = LENGTH_CLASS_RATIO ** np.floor(np.log(mean) / np.log(LENGTH_CLASS_RATIO))
    return mean, min(low, mean), low * LENGTH_CLASS_RATIO


def _differences(pool: LengthClass, mean: float, m: Ints, stride: Ints) -> Floats:
    """Return how many differences a segment of a class has at the factors, on average."""
    if pool.count == 1:
        return counts(pool.samples, m, stride).astype(float)
    # The mean of floor((n - 2 m)/s) + 1 over lengths n of any remainder.
    return np.asarray((mean - 2 * m) / stride + (1.0 + 1.0 / stride) / 2.0)


def _shift(samples: int) -> Floats:
    """Return what taking the ramp out of a segment adds to each difference, (its factors, 4)."""
    m, effect = ramp_geometry(samples).m, fixed_effect(samples)
    if effect is None:
        return np.zeros((len(m), len(RANDOM_TERMS)))
    return ramp_shift(m, effect)
