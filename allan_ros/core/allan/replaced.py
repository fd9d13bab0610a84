# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stretches of samples that were replaced by a line, counted by length.

The line joins two means, of ``level`` samples before the stretch and of as many after it. A gap or
a spike is replaced by a line between two samples (level 1), a shock by a line between the means of
some windows. A table of stretches is an int64 array with one row per pair of length and level:
columns length, level, and the number of such stretches on each axis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]

COUNTED_BITS = 7
"""Significant bits of a counted length: lengths of 128 samples or more are rounded, so that a table
remains small. The relative error is below 1/128."""


def no_stretches(axes: int) -> Ints:
    """Return the table without a stretch, (0, 2 + axes)."""
    return np.zeros((0, 2 + axes), np.int64)


def add_stretches(a: Ints, b: Ints) -> Ints:
    """Return the table of the stretches in both, in the order of length and level."""
    rows = np.concatenate([a, b])
    keys, of_row = np.unique(rows[:, :2], axis=0, return_inverse=True)
    total = np.zeros((len(keys), rows.shape[1] - 2), np.int64)
    np.add.at(total, of_row.reshape(-1), rows[:, 2:])
    return np.column_stack([keys, total])


class RunningStretches:
    """Counts the stretches of a stream, in chunks of any size."""

    def __init__(self, axes: int) -> None:
        self.table = no_stretches(axes)
        self._open = np.zeros((2, axes), np.int64)  # length and level of the stretch at the end

    def add(self, levels: Ints | None) -> None:
        """Count the stretches in the next samples.

        ``levels``, (axes, n), are 0 for measured samples, else the level of their stretch. None
        means that all samples are measured, or that the segment ended.
        """
        axes = self._open.shape[1]
        if levels is None:
            if not self._open[0].any():
                return
            levels = np.zeros((axes, 1), np.int64)
        found = []
        for axis, (length, level) in enumerate(self._open.T.tolist()):
            each = np.append(levels[axis].astype(np.int64), -1)  # -1 ends the last stretch
            if not length and not each[:-1].any():
                continue
            first = np.flatnonzero(np.diff(each, prepend=level if length else 0))
            starts = np.concatenate([[-length if length else 0], first])
            lengths, kinds = np.diff(starts), np.concatenate([[level], each[first[:-1]]])
            self._open[:, axis] = (lengths[-1], kinds[-1]) if kinds[-1] else (0, 0)
            for n, kind in zip(lengths[:-1].tolist(), kinds[:-1].tolist()):
                if n and kind:
                    row = [_counted(n), kind, *(i == axis for i in range(axes))]
                    found.append(np.array(row, np.int64))
        if found:
            self.table = add_stretches(self.table, np.array(found))


def _counted(length: int) -> int:
    """Return a length with `COUNTED_BITS` significant bits."""
    unit = 1 << max(length.bit_length() - COUNTED_BITS, 0)
    return (length + unit // 2) // unit * unit
