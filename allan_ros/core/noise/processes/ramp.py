# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ramp of the bias: rate or acceleration ramp, coefficient R."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..process import Floats, Process, States


@dataclass(frozen=True)
class Ramp(Process):
    """Ramp with the slope of one unit per sample; its coefficient may be negative.

    A weighted sum of means at the times t_i, with weights w_i whose sum is 0, has the square
    (sum w_i t_i)^2 = - sum w_i w_j (t_i - t_j)^2 / 2. This square has the form of the variance of
    such a sum for a random process. A ramp therefore has an autocovariance (`gamma`), like a random
    process.
    """

    name = 'ramp'
    letter = 'R'
    label = 'R'
    meaning = 'Ramp of the bias (rate or acceleration ramp).'
    time_power = -1.0
    is_regressor = True

    def gamma(self, M: ArrayLike, j: ArrayLike) -> Floats:
        M, j = np.asarray(M, float), np.asarray(j, float)
        return np.asarray(-((M * j) ** 2) / 2.0 - (M**2 - 1.0) / 12.0)

    def states(self) -> States:
        dynamics = np.array([[0.0, 1.0], [0.0, 0.0]])
        return States(dynamics, np.zeros((2, 2)), np.array([1.0, 0.0]), np.diag([0.0, 1.0]))

    def sample(self, n: int, rng: np.random.Generator) -> Floats:
        return np.arange(n, dtype=np.float64)
