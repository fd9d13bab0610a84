# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sinusoid of random phase, such as a vibration or a temperature cycle."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..process import FREQUENCY, LEAST_PERIODS, Floats, Process, Search

SLOW_SINUSOID_HZ = 0.1
"""Highest frequency in Hz of a sinusoid that is regarded as drift of the sensor, such as a
temperature cycle. Faster sinusoids are regarded as vibration or motion."""

DAY_S = 86400.0


@dataclass(frozen=True)
class Sinusoid(Process):
    """Sinusoid of unit amplitude and random phase."""

    name = 'sinusoid'
    label = 'sine {frequency} Hz'
    meaning = 'Sinusoid of random phase, such as a vibration.'
    coefficient = 'amplitude'
    parameters = (FREQUENCY,)
    finding = 'vibration'
    is_line = True
    low_band = 'rank two'
    no_states = 'it is not noise: a state estimator that models it needs its phase'

    frequency: float

    def gamma(self, M: ArrayLike, j: ArrayLike) -> Floats:
        M, half_angle = np.asarray(M, float), math.pi * self.frequency
        gain = np.sin(half_angle * M) / (M * math.sin(half_angle))
        return np.asarray(0.5 * gain**2 * np.cos(2.0 * half_angle * M * np.asarray(j, float)))

    @property
    def is_drift(self) -> bool:
        return self.frequency <= SLOW_SINUSOID_HZ

    @property
    def slowest_time(self) -> float:
        return 0.5 / self.frequency

    def sample(self, n: int, rng: np.random.Generator) -> Floats:
        phase = rng.uniform(0.0, 2.0 * np.pi)
        return np.asarray(np.sin(2.0 * np.pi * self.frequency * np.arange(n) + phase))

    def alias_variance(self, step: int) -> float:
        if self.frequency * step <= 1.0:
            return 0.0
        # the mean over a number of samples multiplies the amplitude by at most 1/(step sin(pi f))
        return 0.5 / (step * math.sin(math.pi * self.frequency)) ** 2

    @classmethod
    def grid(cls, search: Search) -> Iterator[Process]:
        """Yield sinusoids whose frequencies are half a bin apart within each octave.

        Below the lowest bin, successive sinusoids differ by half a period over the length of the
        longest segment.
        """
        f, highest = search.f, min(search.crossover, 0.5 / search.step)
        low_frequencies = np.arange(LEAST_PERIODS, search.longest * highest, 0.5) / search.longest
        width = np.diff(f, append=f[-1:] if len(f) else [])
        # whether the next bin is in the same octave
        has_next = np.append(np.diff(search.block) == 0.0, False) if len(f) else width > 0.0
        midpoints = (f + width / 2.0)[has_next]
        frequencies = np.unique(np.concatenate([low_frequencies, f, midpoints]))
        return (cls(float(frequency)) for frequency in frequencies if 0.0 < frequency < 0.49)


def daily_cycle(samples: int, tau0: float) -> Sinusoid | None:
    """Return a sinusoid with a period of one day, or None if a segment lasts 18 h or less.

    ``samples`` is the number of samples of the segment, and ``tau0`` is the sample period in s. The
    frequency is in cycles per sample. A daily cycle is expected because most rooms are warmer
    during the day.
    """
    return Sinusoid(tau0 / DAY_S) if samples * tau0 > 0.75 * DAY_S else None
