# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""White noise: angle or velocity random walk, coefficient N."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..process import Floats, Process


@dataclass(frozen=True)
class White(Process):
    """White noise whose samples have the variance 1."""

    name = 'white'
    letter = 'N'
    label = 'N'
    meaning = 'White noise (angle or velocity random walk).'
    time_power = 0.5
    is_white = True
    no_states = 'it has no memory: its density is the noise of the samples'

    def gamma(self, M: ArrayLike, j: ArrayLike) -> Floats:
        return np.asarray((np.asarray(j) == 0) / np.asarray(M, float))
