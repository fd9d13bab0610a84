# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stretches of samples that were replaced by a straight line, and their effect on the noise.

The line joins the means of ``level`` samples before and after the stretch. The level is 1 for a gap
or a spike. For a shock, the level is the number of samples in several windows of the motion
detector.

Table
-----
A table of stretches is an int64 array with one row per pair of length and level. The columns are
length, level, and the number of such stretches on each axis.

Effect on the autocovariance of white noise
-------------------------------------------
A stretch of g samples is replaced by a line between two means of L samples, before and after the
stretch. This removes the noise of g samples. Each of the L samples before the stretch keeps the
weight 1 at its own position. In addition, it has the weight (1 - i/(g + 1))/L at the positions
i = 1 .. g of the stretch. The L samples after the stretch have the same weights in reverse order.

At frequencies far below 1/(g + L), one stretch between single samples (L = 1) adds the power of
about g + g^2/2 samples. At frequencies far above 1/L, a stretch removes the power of g samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..noise import Gamma

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

COUNTED_BITS = 7
"""Number of significant bits of a length in a table. Lengths of 128 samples or more are rounded,
with a relative error of at most 1/128, so that the table remains small."""


def no_stretches(axes: int) -> Ints:
    """Return a table without stretches, (0, 2 + axes)."""
    return np.zeros((0, 2 + axes), np.int64)


def add_stretches(a: Ints, b: Ints) -> Ints:
    """Merge two tables of stretches into one table, sorted by length and level.

    Numbers of stretches with the same length and level are added. All tables are (rows, 2 + axes).
    """
    rows = np.concatenate([a, b])
    keys, key_of_row = np.unique(rows[:, :2], axis=0, return_inverse=True)
    total = np.zeros((len(keys), rows.shape[1] - 2), np.int64)
    np.add.at(total, key_of_row.reshape(-1), rows[:, 2:])
    return np.asarray(np.column_stack([keys, total]))


def scaled_stretches(table: Ints, share: float) -> Ints:
    """Return the estimated table for a ``share`` of the samples.

    All numbers of stretches are multiplied by the share and rounded. A row in which all numbers
    become 0 is omitted. Both tables are (rows, 2 + axes).
    """
    scaled_numbers = np.rint(table[:, 2:] * share).astype(np.int64)
    return np.asarray(np.column_stack([table[:, :2], scaled_numbers])[scaled_numbers.any(axis=1)])


class RunningStretches:
    """Counts the replaced stretches of a stream of samples that arrive in chunks of any size."""

    def __init__(self, axes: int) -> None:
        self.table = no_stretches(axes)
        # length and level of the stretch that has not ended yet; 0 on an axis without such a
        # stretch
        self._open = np.zeros((2, axes), np.int64)

    def add(self, levels: NDArray[np.int32] | None) -> None:
        """Count the stretches of replaced values in the next samples.

        ``levels``, (axes, n), contain 0 for each measured value, and for each replaced value the
        level of its stretch, as in the table. None ends the present stretches: no value in the next
        samples is replaced, or the segment has ended.
        """
        axes = self._open.shape[1]
        if levels is None:
            levels = np.zeros((axes, 1), np.int32)
        if not (self._open.any() or levels.any()):
            return
        new_rows = []
        for axis, (length, level) in enumerate(self._open.T.tolist()):
            changes = np.flatnonzero(np.diff(levels[axis], prepend=level))
            run_starts = np.concatenate([[-length], changes])
            run_levels = np.concatenate([[level], levels[axis, changes]])
            ended_stretches = np.column_stack([np.diff(run_starts), run_levels[:-1]])[
                run_levels[:-1] > 0
            ]
            for (ended_length, ended_level), number in zip(
                *np.unique(ended_stretches, axis=0, return_counts=True)
            ):
                row = np.zeros(2 + axes, np.int64)
                row[[0, 1, 2 + axis]] = _counted(int(ended_length)), ended_level, number
                new_rows.append(row)
            length = levels.shape[1] - int(run_starts[-1])
            self._open[:, axis] = (length, run_levels[-1]) if run_levels[-1] else 0
        if new_rows:
            self.table = add_stretches(self.table, np.array(new_rows))


def _counted(length: int) -> int:
    """Return a length, rounded to `COUNTED_BITS` significant bits."""
    rounding_unit = 1 << max(length.bit_length() - COUNTED_BITS, 0)
    return (length + rounding_unit // 2) // rounding_unit * rounding_unit


def stretch_excess(length: int, level: int) -> Floats:
    """Return by how much one replaced stretch changes the autocovariance of white noise.

    The result, (length + level,), is the sum of the changes over all positions, at lags of 0, 1 ...
    ``length`` + ``level`` - 1 samples, for unit variance. ``length`` is the number of replaced
    samples. ``level`` is the number of samples in each of the two means between which the samples
    are interpolated.
    """
    n = 2 * (length + level)
    mean_transform = np.fft.rfft(np.ones(level), n)
    line_weights = np.zeros(n)
    line_weights[level : level + length] = 1.0 - np.arange(1, length + 1) / (length + 1)
    line_transform = np.fft.rfft(line_weights)
    power = (
        2.0 * (mean_transform.conj() * line_transform).real + np.abs(line_transform) ** 2
    ) / level
    return np.asarray(np.fft.irfft(2.0 * power - length, n)[: n // 2])


def replaced_excess(stretches: Ints, number: Floats) -> Gamma:
    """Return the change of gamma(M, j) of unit white noise due to replaced stretches.

    The result is a function of M and j. gamma(M, j) is the autocovariance of means over M samples
    at a lag of j means. ``stretches`` is `AllanSums.replaced`. ``number``, (stretches,), is the
    number of stretches of each row on one axis, divided by the number of samples.

    gamma(M, j) is minus the second difference of a function P with step M, divided by M^2. The
    second difference of P with step 1 is minus the autocovariance of the samples.
    """
    total = np.zeros(max(int((stretches[:, :2]).sum(axis=1).max(initial=1)), 2))
    for (length, level, *_), share in zip(stretches.tolist(), number.tolist()):
        if share:
            excess = stretch_excess(length, level)
            total[: len(excess)] += share * excess
    lags = np.arange(len(total))
    slope = -np.cumsum(np.concatenate([total[:1] / 2.0, total[1:]]))
    table = np.cumsum(np.concatenate([[-(lags @ total)], slope]))

    def phase(t: Floats) -> Floats:
        index = np.minimum(t, len(total)).astype(np.int64)
        return np.asarray(table[index] + slope[-1] * (t - index))

    def gamma(M: ArrayLike, j: ArrayLike) -> Floats:
        M, j = np.asarray(M, float), np.asarray(j, float)
        second_difference = 2.0 * phase(j * M) - phase((j + 1.0) * M) - phase(np.abs(j - 1.0) * M)
        return np.asarray(second_difference / M**2)

    return gamma
