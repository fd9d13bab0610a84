# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Means of static samples over one second: the input of the bias filter."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

KEPT_MEANS = 120
"""The latest means are kept, for a reader that comes once in a while."""


@dataclass(frozen=True)
class Means:
    """Means of the axes that are sampled together.

    Attributes
    ----------
    axes : tuple of str
    end_ns : (n,) int64 array
        Time at which each mean ends.
    values : (n, axes) float64 array
        In the unit of the samples.
    """

    axes: tuple[str, ...]
    end_ns: NDArray[np.int64]
    values: Floats


class RunningMeans:
    """Means over consecutive seconds of evenly spaced samples.

    Parameters
    ----------
    axes : tuple of str
    length : float
        Length of a mean in s.
    """

    def __init__(self, axes: tuple[str, ...], length: float = 1.0) -> None:
        self._axes, self._length_ns = axes, round(length * 1e9)
        self._kept: deque[tuple[int, Floats]] = deque(maxlen=KEPT_MEANS)
        self._start_ns: int | None = None
        self._sum, self._count = np.zeros(len(axes)), 0

    def cut(self) -> None:
        """Drop the mean in progress: the samples that follow are not contiguous."""
        self._start_ns, self._count = None, 0
        self._sum = np.zeros(len(self._axes))

    def update(self, stamps: NDArray[np.int64], rows: Floats) -> None:
        """Take contiguous samples: stamps (n,) in ns, rows (axes, n)."""
        at = 0
        while at < len(stamps):
            if self._start_ns is None:
                self._start_ns = int(stamps[at])
            end_ns = self._start_ns + self._length_ns
            stop = int(np.searchsorted(stamps, end_ns))
            self._sum = self._sum + rows[:, at:stop].sum(axis=1)
            self._count += stop - at
            if stop < len(stamps):
                self._kept.append((end_ns, self._sum / max(self._count, 1)))
                self._sum, self._count = np.zeros(len(self._axes)), 0
                gap = int(stamps[stop]) - end_ns >= self._length_ns
                self._start_ns = int(stamps[stop]) if gap else end_ns
            at = stop

    @property
    def means(self) -> Means:
        """The latest complete means."""
        end_ns = np.array([end for end, _ in self._kept], np.int64)
        values = np.array([value for _, value in self._kept]).reshape(-1, len(self._axes))
        return Means(self._axes, end_ns, values)
