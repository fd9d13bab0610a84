# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Flicker noise: bias instability, coefficient B."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..process import Floats, Process

FLICKER_FLOOR = 2.0 * math.log(2.0) / math.pi
"""Ratio of the Allan variance of bias instability to B^2: (0.664)^2 (IEEE Std 952-1997, C.1.3)."""

SERIES_FROM = 30
"""Lag, as a number of means, above which the autocovariance of flicker noise is computed from a
series, because a second difference of large numbers would lose digits."""


@dataclass(frozen=True)
class Flicker(Process):
    """Flicker noise with B = 1.

    gamma is the second difference of -t^2 ln|t| / (2 pi) with a step of M samples, divided by M^2.
    At long lags, a series for this difference is used. The term ln(M) in gamma ensures that the
    missing constant is the same for all M.
    """

    name = 'flicker'
    letter = 'B'
    label = 'B'
    meaning = 'Flicker noise (bias instability).'
    no_states = (
        'it has no longest correlation time: a sum of Gauss-Markov processes approximates it'
    )

    def gamma(self, M: ArrayLike, j: ArrayLike) -> Floats:
        M, j = np.asarray(M, float), np.asarray(j, float)
        long_lag = np.maximum(j, 1.0)
        u = long_lag**-2
        series = -(2.0 * np.log(long_lag) + 3.0 - u * (1.0 / 6.0 + u * (1.0 / 30.0 + u / 84.0)))
        second_difference = (
            2.0 * _square_log(j) - _square_log(j + 1.0) - _square_log(np.abs(j - 1.0))
        )
        value = np.where(j > SERIES_FROM, series, second_difference) / (2.0 * math.pi)
        return np.asarray(value - np.log(M) / math.pi)


def _square_log(t: Floats) -> Floats:
    """Return t^2 ln(t) for t of 0 or above; it is 0 at t = 0."""
    return np.asarray(t * t * np.log(np.where(t > 0.0, t, 1.0)))
