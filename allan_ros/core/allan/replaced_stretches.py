# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Table of the stretches of samples that were replaced by a straight line.

The line joins the mean of ``level`` samples before the stretch and the mean of ``level`` samples
after it. The level is 1 for a gap or a spike. For a shock, the level is the number of samples in
several windows of the motion detector.

Table
-----
A table of stretches is an int64 array with one row per pair of length and level. The columns are
length, level, and the number of such stretches on each axis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]

COUNTED_BITS = 7
"""Number of significant bits of a length in a table. Lengths of 128 samples or more are rounded,
with a relative error below 1/128, so that the table remains small."""


def no_stretches(axes: int) -> Ints:
    """Return a table without stretches, (0, 2 + axes)."""
    return np.zeros((0, 2 + axes), np.int64)


def add_stretches(a: Ints, b: Ints) -> Ints:
    """Return the table of the stretches in two tables, sorted by length and level.

    All tables are (rows, 2 + axes).
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
        """Count the stretches in the next samples.

        ``levels``, (axes, n), are 0 for measured samples, and the level of the stretch for replaced
        samples. None means that all samples are measured, or that the segment ended.
        """
        axes = self._open.shape[1]
        if levels is None:
            levels = np.zeros((axes, 1), np.int32)
        if not (self._open.any() or levels.any()):
            return
        new_rows = []
        for axis, (length, level) in enumerate(self._open.T.tolist()):
            changes = np.flatnonzero(np.diff(levels[axis], prepend=level))
            starts_of_runs = np.concatenate([[-length], changes])
            levels_of_runs = np.concatenate([[level], levels[axis, changes]])
            ended_stretches = np.column_stack([np.diff(starts_of_runs), levels_of_runs[:-1]])[
                levels_of_runs[:-1] > 0
            ]
            for (n, level_of_run), number in zip(
                *np.unique(ended_stretches, axis=0, return_counts=True)
            ):
                row = np.zeros(2 + axes, np.int64)
                row[[0, 1, 2 + axis]] = _counted(int(n)), level_of_run, number
                new_rows.append(row)
            length = levels.shape[1] - int(starts_of_runs[-1])
            self._open[:, axis] = (length, levels_of_runs[-1]) if levels_of_runs[-1] else 0
        if new_rows:
            self.table = add_stretches(self.table, np.array(new_rows))


def _counted(length: int) -> int:
    """Return a length, rounded to `COUNTED_BITS` significant bits."""
    rounding_unit = 1 << max(length.bit_length() - COUNTED_BITS, 0)
    return (length + rounding_unit // 2) // rounding_unit * rounding_unit
