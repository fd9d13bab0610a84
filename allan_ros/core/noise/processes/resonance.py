# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Resonance, for example of a mounting: a damped oscillation that is excited by white noise."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..process import CORRELATION_TIME, FREQUENCY, Floats, Parameter, Process, Search, States
from .sinusoid import Sinusoid

CANDIDATE_TIMES = (1.0, 3.0)
"""Correlation times that a search tries, in units of 1.5 periods of the oscillation. A fitted
correlation time is at least one period, because a resonance with a shorter correlation time
imitates a low-pass filter."""


@dataclass(frozen=True)
class Resonance(Process):
    """Second-order process of unit variance: a damped oscillation of random phase.

    The autocovariance at the lag t is exp(-t/T) cos(2 pi f t). A fit replaces the resonance by a
    sinusoid if the bandwidth is at most about a third of the width of a bin.
    """

    name = 'resonance'
    label = 'resonance {frequency} Hz'
    meaning = 'Damped oscillation that noise excites, such as a resonance of a mounting.'
    parameters = (FREQUENCY, CORRELATION_TIME)
    finding = 'resonance'
    low_band = 'none'

    frequency: float
    correlation_time: float

    def gamma(self, M: ArrayLike, j: ArrayLike) -> Floats:
        frequency, time = self.frequency, self.correlation_time
        z = cmath.exp(complex(-1.0 / time, 2.0 * math.pi * frequency))
        M, j = np.asarray(M, float), np.asarray(j, float)
        power_sum = (1.0 - np.exp(M * cmath.log(z))) / (1.0 - z)
        at_zero_lag = (M * (1.0 + z) / (1.0 - z) - 2.0 * z * power_sum / (1.0 - z)).real
        k = (np.maximum(j, 1.0) - 1.0) * M + 1.0
        wave = np.cos(2.0 * math.pi * frequency * k + 2.0 * np.angle(power_sum))
        at_lag = np.abs(power_sum) ** 2 * np.exp(-k / time) * wave
        return np.asarray(np.where(j >= 1, at_lag, at_zero_lag) / M**2)

    @property
    def is_drift(self) -> bool:
        return False

    @property
    def density_at_zero(self) -> float:
        """The integral of the autocovariance exp(-|t|/T) cos(2 pi f t) over all lags t."""
        angle = 2.0 * math.pi * self.frequency * self.correlation_time
        return 2.0 * self.correlation_time / (1.0 + angle**2)

    @property
    def slowest_time(self) -> float:
        return 0.0  # a resonance is fast compared with any drift

    def is_broad_near(self, highest: float) -> bool:
        periods_correlated = self.frequency * self.correlation_time
        return self.frequency > highest / 4.0 and periods_correlated < 2.0 * CANDIDATE_TIMES[0]

    def facts(self, value: float) -> dict[str, float]:
        bandwidth = 1.0 / (math.pi * self.correlation_time)
        return {'frequency': self.frequency, 'width': bandwidth, 'amplitude': value}

    def states(self) -> States:
        rate, angular_frequency = 1.0 / self.correlation_time, 2.0 * math.pi * self.frequency
        dynamics = np.array([[-rate, -angular_frequency], [angular_frequency, -rate]])
        return States(dynamics, 2.0 * rate * np.eye(2), np.array([1.0, 0.0]), np.eye(2))

    @classmethod
    def grid(cls, search: Search) -> Iterator[Process]:
        """Yield resonances at the frequencies of the bins above twice the crossover frequency."""
        f = search.f[search.f > 2.0 * search.crossover]
        return (cls(float(x), float(1.5 * c / x)) for x in f for c in CANDIDATE_TIMES)

    def bounds(self, parameter: Parameter, search: Search) -> tuple[float, float]:
        if parameter is FREQUENCY:
            return super().bounds(parameter, search)
        low = CANDIDATE_TIMES[0] / self.frequency
        return low, max(search.narrowest(self.frequency), low)

    def limit(self, search: Search) -> Process:
        is_narrow = self.correlation_time >= 0.99 * search.narrowest(self.frequency)
        return Sinusoid(self.frequency) if is_narrow else self
