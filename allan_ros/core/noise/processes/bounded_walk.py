# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bounded random walk: a slow Gauss-Markov process with the coefficient K."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..process import CORRELATION_TIME, Floats, Process, Search, States
from .gauss_markov import GaussMarkov
from .random_walk import RandomWalk


@dataclass(frozen=True)
class BoundedWalk(Process):
    """Gauss-Markov process that grows like a random walk up to its correlation time T.

    The variance is T/2 for T in samples. If T is long, the variance of the change from one sample
    to the next is nearly 1. If T is infinite, the process is a random walk. A fit replaces the
    random walk by this process if the data show that 1/T is above 0.
    """

    name = 'bounded_walk'
    letter = 'K'
    label = 'GM {correlation_time} s'
    meaning = 'Random walk that levels off after its correlation time.'
    time_power = -0.5
    parameters = (CORRELATION_TIME,)
    finding = 'levels_off'
    replaces = RandomWalk

    correlation_time: float

    def gamma(self, M: ArrayLike, j: ArrayLike) -> Floats:
        time = self.correlation_time
        return np.asarray(time / 2.0 * GaussMarkov(time).gamma(M, j))

    @property
    def slowest_time(self) -> float:
        return self.correlation_time

    def facts(self, value: float) -> dict[str, float]:
        return {'tau': self.correlation_time}

    def states(self) -> States:
        time, identity = self.correlation_time, np.ones((1, 1))
        return States(-identity / time, identity, np.ones(1), time / 2.0 * identity)

    @classmethod
    def grid(cls, search: Search) -> Iterator[Process]:
        return (cls(float(time)) for time in search.longest / 2.0 ** np.arange(0, 11, 2))

    @classmethod
    def threshold(cls, bins: int) -> float:
        return 7.0  # false alarms on 1 % of the axes in a search over all correlation times
