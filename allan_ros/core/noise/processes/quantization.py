# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quantization noise, coefficient Q: rounding errors of a counter that carries its remainder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..process import Floats, Process


@dataclass(frozen=True)
class Quantization(Process):
    """First difference of white noise of unit variance."""

    name = 'quantization'
    letter = 'Q'
    label = 'Q'
    meaning = 'Quantization noise: the difference of white noise.'
    time_power = 1.0
    no_states = 'its integral is white noise, which has no memory'

    @property
    def is_drift(self) -> bool:
        return False

    def gamma(self, M: ArrayLike, j: ArrayLike) -> Floats:
        M, j = np.asarray(M, float), np.asarray(j, float)
        return np.asarray((2.0 * (j == 0) - (j == 1)) / M**2)
