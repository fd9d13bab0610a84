# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nonnegative least squares over a handful of columns, by trying every set of active ones."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def nonnegative_least_squares(columns: Floats, target: Floats) -> Floats:
    """Return x >= 0 that minimises |columns x - target|.

    The minimiser is the unconstrained one of some set of columns (Lawson & Hanson, Solving Least
    Squares Problems, 1974, ch. 23), and five columns have 31 sets: all are tried, which is exact
    and quicker than importing a general solver.

    Parameters
    ----------
    columns : (points, terms) float64 array
        A few columns, of any scale; none all zero.
    target : (points,) float64 array
        What they are to make.

    Returns
    -------
    (terms,) float64 array
    """
    scale = np.sqrt((columns**2).sum(axis=0))
    scaled = columns / scale
    best, least = np.zeros(columns.shape[1]), float(target @ target)
    for size in range(1, columns.shape[1] + 1):
        for active in combinations(range(columns.shape[1]), size):
            part = scaled[:, active]
            x = np.linalg.lstsq(part, target, rcond=None)[0]
            rest = target - part @ x
            cost = float(rest @ rest)
            if cost < least and (x >= 0.0).all():
                best, least = np.zeros(columns.shape[1]), cost
                best[list(active)] = x
    return np.asarray(best / scale)
