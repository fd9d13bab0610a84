# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rounding errors of a counter whose step is not small compared with the noise of a sample."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..process import CORRELATION_TIME, FREQUENCY, Floats, Process
from .quantization import Quantization

NEGLIGIBLE_EXPONENT = 39.0
"""Value of x from which exp(-x), at most about 1e-17, is negligible compared with 1."""

LEAST_DECAY = 1e-4
"""Smallest value of 1/T, where T is the correlation time in samples. This value limits the number
of terms in the series of the autocovariance (`RoundedAngle`)."""


@dataclass(frozen=True)
class RoundedAngle(Process):
    """First difference of correlated rounding errors of unit variance.

    A counter measures an angle (or a velocity) in whole steps and carries the remainder to the next
    sample. The rounding error is a sawtooth function of the angle. If the angle increases by a mean
    of f steps per unit of time, with white noise, the autocovariance of the error at the lag t is
    6/pi^2 times the sum of exp(-n^2 t/T) cos(2 pi n f t)/n^2 over n = 1, 2, ... The time T is at
    most step^2/(2 pi^2 N^2), and shorter if the mean rate drifts. If T is far below the sample
    period, the errors are white, and the process is quantization noise.

    The series follows from the Fourier series of the sawtooth, and from the characteristic function
    of a Gaussian change of the angle (B. Widrow and I. Kollar, Quantization Noise, 2008).
    """

    name = 'rounded_angle'
    letter = 'Q'
    label = 'Q'
    meaning = 'Quantization noise of a counter with a large step: correlated rounding errors.'
    time_power = 1.0
    parameters = (FREQUENCY, CORRELATION_TIME)
    finding = 'counter'
    replaces = Quantization
    no_states = 'its integral is a rounding error, which depends on the angle and does not grow'

    frequency: float = 0.0
    correlation_time: float = 1.0

    def gamma(self, M: ArrayLike, j: ArrayLike) -> Floats:
        M, j = np.asarray(M, float), np.asarray(j, float)
        before, at, after = (
            self._error_autocovariance(np.abs(j + shift) * M) for shift in (-1.0, 0.0, 1.0)
        )
        return np.asarray((2.0 * at - before - after) / M**2)

    def _error_autocovariance(self, lag: Floats) -> Floats:
        """Return the autocovariance of a rounding error of unit variance at lags in samples."""
        total, lags = np.ones(lag.shape), lag[lag > 0.0]
        if not lags.size:
            return total
        exponents = lags / self.correlation_time
        terms = 1 + int(math.sqrt(NEGLIGIBLE_EXPONENT / float(exponents.min())))
        series = np.zeros(lags.shape)
        for n in range(1, terms + 1):
            is_relevant = n * n * exponents < NEGLIGIBLE_EXPONENT
            wave = np.cos(2.0 * math.pi * n * self.frequency * lags[is_relevant])
            series[is_relevant] += np.exp(-n * n * exponents[is_relevant]) * wave / n**2
        total[lag > 0.0] = 6.0 / math.pi**2 * series
        return total

    @property
    def is_drift(self) -> bool:
        return False  # the rounding error is bounded

    @property
    def slowest_time(self) -> float:
        return 0.0

    def facts(self, value: float) -> dict[str, float]:
        return {'step': value * math.sqrt(12.0)}


def rounding_of_counter(step: float, white: float, effect_of_rate: complex) -> RoundedAngle:
    """Return the process of the rounding errors of a counter, with its shape in samples.

    Parameters
    ----------
    step : float
        Step of the counter, in the unit of the samples.
    white : float
        Variance of the white noise of a sample.
    effect_of_rate : complex
        Mean of exp(2 pi i y/step) over block means y of the samples. Its phase is 2 pi times the
        mean number of steps per sample, up to whole steps. Its magnitude is below 1 if the rate
        drifts: the drift reduces the correlation of successive errors by this factor. The white
        noise in the block means also reduces the magnitude a little.
    """
    frequency = abs(cmath.phase(effect_of_rate)) / (2.0 * math.pi)
    decay_by_noise = 2.0 * math.pi**2 * white / step**2
    decay_by_drift = -math.log(max(abs(effect_of_rate), 1e-300))
    return RoundedAngle(frequency, 1.0 / max(decay_by_noise + decay_by_drift, LEAST_DECAY))
