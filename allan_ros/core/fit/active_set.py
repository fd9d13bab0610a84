# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nonnegative least squares over a handful of columns, by trying every set of active ones."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


RIDGE = 1e-12
"""Added to the normal equations of unit columns, so that too few points give a wide answer
instead of none."""


def nonnegative_least_squares(
    columns: Floats, target: Floats, signed: tuple[int, ...] = ()
) -> Floats:
    """Return x >= 0 that minimises |columns x - target|.

    The minimiser is the unconstrained one of some set of columns (Lawson & Hanson, Solving Least
    Squares Problems, 1974, ch. 23), and five columns have 31 sets: if that of all columns will
    not do, all are tried, which is exact and quicker than importing a general solver.

    Parameters
    ----------
    columns : (points, terms) float64 array
        A few columns, of any scale.
    target : (points,) float64 array
        What they are to make.
    signed : tuple of int
        Columns whose coefficient may be negative.

    Returns
    -------
    (terms,) float64 array
    """
    scale = np.sqrt((columns**2).sum(axis=0))
    scale[scale == 0.0] = 1.0
    scaled = columns / scale
    gram, moment = scaled.T @ scaled, scaled.T @ target
    bound = [c for c in range(len(scale)) if c not in signed]
    best, most = np.zeros(len(scale)), -np.inf
    for size in range(len(bound), -1, -1):
        for chosen in combinations(bound, size):
            active = sorted((*chosen, *signed))
            part = gram[np.ix_(active, active)] + RIDGE * np.eye(len(active))
            x = np.linalg.solve(part, moment[active])
            gain = float(x @ moment[active])
            if gain > most and (x[[c in chosen for c in active]] >= 0.0).all():
                best, most = np.zeros(len(scale)), gain
                best[active] = x
        if size == len(bound) and most > -np.inf:
            break
    return np.asarray(best / scale)
