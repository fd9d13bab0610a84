# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Effect of a low-pass filter of the sensor on white noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .quantization import Quantization


@dataclass(frozen=True)
class LowPass(Quantization):
    """Effect of a low-pass filter on averages that are long compared with its impulse response.

    A filter multiplies the spectrum of white noise by a series in f^2. The term in f^2 has the
    spectrum of quantization noise, but its coefficient q is mostly negative. Covariances are
    q/tau0^2 times `gamma`, so they contain q itself and not, as for other coefficients, its square.
    """

    name = 'low_pass'
    letter = ''
    label = 'filter'
    meaning = 'Effect of a low-pass filter of the sensor on white noise.'
    coefficient = 'q'
    time_power = 2.0
    is_regressor = True
    no_states = 'it describes the samples, not the bias'

    def variance_of(self, coefficient: float, tau0: float) -> float:
        return self.in_samples(coefficient, tau0)

    def coefficient_of(self, variance: float, tau0: float) -> float:
        return variance * math.pow(tau0, self.time_power)
