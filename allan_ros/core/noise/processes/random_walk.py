# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Random walk of the bias: rate or acceleration random walk, coefficient K."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..process import Floats, Process, States


@dataclass(frozen=True)
class RandomWalk(Process):
    """Random walk with steps of unit variance per sample."""

    name = 'random_walk'
    letter = 'K'
    label = 'K'
    meaning = 'Random walk of the bias (rate or acceleration random walk).'
    time_power = -0.5

    def gamma(self, M: ArrayLike, j: ArrayLike) -> Floats:
        M, j = np.asarray(M, float), np.asarray(j, float)
        return np.asarray(np.where(j >= 1, -j * M / 2.0, 1.0 / (6.0 * M) - M / 6.0))

    def states(self) -> States:
        return States(np.zeros((1, 1)), np.ones((1, 1)), np.ones(1), np.zeros((1, 1)))
