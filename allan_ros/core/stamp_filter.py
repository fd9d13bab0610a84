# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first sieve: samples that cannot be used at all are dropped and counted.

Every decision looks only at the sample and at those before it, so chunks do not matter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .batch import LARGEST
from .health import Counts

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

BACKWARD_RUN = 16
"""So many stamps in a row before the latest one are a clock set back; fewer are dropped."""


class StampFilter:
    """Drops samples that are no numbers of an IMU, repeat the one before, or go back in time."""

    def __init__(self, axes: int, counts: Counts) -> None:
        self._counts = counts
        self._latest: int | None = None
        self._latest_row: Floats = np.full(axes, np.nan)
        self._backward = 0

    def feed(self, stamps: Stamps, rows: Floats) -> tuple[Stamps, Floats, NDArray[np.bool_]]:
        """Return the samples that stay, and where a clock that was set back starts anew.

        Parameters
        ----------
        stamps : (n,) int64 array
        rows : (axes, n) float64 array

        Returns
        -------
        stamps, rows, jumped : (k,), (axes, k) and (k,) bool arrays
        """
        if len(stamps) and not (rows.max() <= LARGEST and rows.min() >= -LARGEST):
            finite = (np.abs(rows) <= LARGEST).all(axis=0)
            self._counts.not_finite += int(np.count_nonzero(~finite))
            stamps, rows = stamps[finite], rows[:, finite]
        if not len(stamps):
            return stamps, rows, np.zeros(0, bool)
        latest = stamps[0] - 1 if self._latest is None else self._latest
        step = np.diff(stamps, prepend=latest)
        jumped = np.zeros(len(stamps), bool)
        if step.min() <= 0 or self._backward:
            keep, jumped = self._sift(stamps, rows, step)
            stamps, rows, jumped = stamps[keep], rows[:, keep], jumped[keep]
        if len(stamps):
            self._latest, self._latest_row = int(stamps[-1]), rows[:, -1].copy()
        return stamps, rows, jumped

    def _sift(
        self, stamps: Stamps, rows: Floats, step: Stamps
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which samples stay and which start anew, one by one."""
        before = np.concatenate([self._latest_row[:, None], rows[:, :-1]], axis=1)
        repeated = (step == 0) & (rows == before).all(axis=0)
        self._counts.duplicate += int(np.count_nonzero(repeated))
        keep = ~repeated
        jumped = np.zeros(len(stamps), bool)
        latest = stamps[0] if self._latest is None else self._latest
        for i in np.flatnonzero(keep):
            if stamps[i] >= latest:
                self._backward = 0
                latest = stamps[i]
                continue
            self._backward += 1
            if self._backward < BACKWARD_RUN:
                keep[i] = False
                self._counts.backward += 1
            else:
                self._backward = 0
                jumped[i] = True
                latest = stamps[i]
        return keep, jumped
