# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""First-order Gauss-Markov process: exponentially correlated noise."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..process import CORRELATION_TIME, Floats, Process, Search, States

FAST = 8.0
"""Correlation time in samples below which a process looks like low-pass filtered white noise.

A model with such a process passes its tests only if 2 log L is larger by `GAIN_RESOLVED` than for a
model of a low-pass filter (terms in f^2 and f^4), which has as many parameters. Measured
differences of 2 log L: at most 1.9 for real filters that remove up to 15 % of the power; at least
6.9 for a process with a correlation time of 2 samples and a third of the standard deviation of the
white noise, in 10 min at 100 Hz."""


@dataclass(frozen=True)
class GaussMarkov(Process):
    """First-order Gauss-Markov process of unit variance.

    gamma is the autocovariance minus the variance 1, so that no digits are lost at long correlation
    times.
    """

    name = 'gauss_markov'
    label = 'GM {correlation_time} s'
    meaning = 'First-order Gauss-Markov process (exponentially correlated noise).'
    parameters = (CORRELATION_TIME,)
    finding = 'gauss_markov'

    correlation_time: float

    def gamma(self, M: ArrayLike, j: ArrayLike) -> Floats:
        M, j, time = np.asarray(M, float), np.asarray(j, float), self.correlation_time
        x = M / time
        # lag j >= 1: exp(-((j - 1) M + 1)/T) times the squared mean of exp(-i/T) over 0 <= i < M
        mean = np.expm1(-x) / math.expm1(-1.0 / time) / M
        decay = np.expm1(-((np.maximum(j, 1.0) - 1.0) * x + 1.0 / time))
        at_lag = mean**2 * decay + (mean - 1.0) * (mean + 1.0)
        # lag 0: the mean of exp(-|a - b|/T) - 1 over all pairs of samples a, b of one mean
        half_rate = 0.5 / time
        pair_mean = (
            M / math.tanh(half_rate) + np.expm1(-x) / (2.0 * math.sinh(min(half_rate, 300.0)) ** 2)
        ) / M**2
        # series for the mean of exp(-u) - 1 with u = |a - b|/T: means of -u, u^2/2 and -u^3/6
        mean_lag = (M - 1.0 / M) / (3.0 * time)
        series = -mean_lag + (M**2 - 1.0) / (12.0 * time**2) - x**3 / 60.0 * (1.0 - 1.0 / M**2)
        return np.asarray(np.where(j >= 1, at_lag, np.where(x < 1e-3, series, pair_mean - 1.0)))

    @property
    def slowest_time(self) -> float:
        return self.correlation_time

    @property
    def bends_spectrum(self) -> bool:
        return self.correlation_time < FAST

    def facts(self, value: float) -> dict[str, float]:
        return {'sigma': value, 'time': self.correlation_time}

    def states(self) -> States:
        rate = 1.0 / self.correlation_time
        identity = np.ones((1, 1))
        return States(-rate * identity, 2.0 * rate * identity, np.ones(1), identity)

    @classmethod
    def grid(cls, search: Search) -> Iterator[Process]:
        octaves = math.log2(max(search.longest / search.shortest, 1.0))
        return (cls(float(search.shortest * 2.0**k)) for k in np.arange(0.0, octaves + 0.01, 0.5))
