# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Linear least squares with nonnegative unknowns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def nonnegative_least_squares(
    matrix: NDArray[Any], target: NDArray[Any], signed: ArrayLike = False
) -> Floats:
    """Return the x that minimizes the norm of ``matrix @ x - target``, under the condition x >= 0.

    This is the active set method of Lawson and Hanson, *Solving Least Squares Problems*, 1974,
    chapter 23. `scipy.optimize.nnls` would load 20 MB of modules that nothing else needs.

    Parameters
    ----------
    matrix : array, shape (rows, columns)
        Coefficients of the equations.
    target : array, shape (rows,)
        Right-hand side of the equations.
    signed : array of bool, shape (columns,), or bool
        True for each unknown that may be negative; by default, no unknown may be negative.

    Returns
    -------
    array, shape (columns,)
        The unknowns x.

    Raises
    ------
    numpy.linalg.LinAlgError
        When the singular value decomposition of columns of ``matrix`` does not converge, as with
        NaN.

    Examples
    --------
    >>> import numpy as np
    >>> nonnegative_least_squares(np.eye(2), np.array([3.0, -1.0])).tolist()
    [3.0, 0.0]
    """
    columns = matrix.shape[1]
    signed = np.broadcast_to(np.asarray(signed, bool), columns)

    def solved(is_free: NDArray[np.bool_]) -> Floats:
        x = np.zeros(columns)
        x[is_free] = np.linalg.lstsq(matrix[:, is_free], target, rcond=None)[0]
        return x

    is_free = np.ones(columns, bool)
    # find a start near the solution
    while np.any((x := solved(is_free))[~signed] < 0.0):
        is_free &= (x > 0.0) | signed
    rounding = 10.0 * max(matrix.shape) * np.finfo(float).eps
    rounding_gain = rounding * np.linalg.norm(matrix, axis=0) * np.linalg.norm(target)
    for _ in range(3 * columns):
        gain = np.where(is_free, -np.inf, matrix.T @ (target - matrix @ x) - rounding_gain)
        if not gain.max() > 0.0:
            break
        is_free[gain.argmax()] = True
        while (is_invalid := is_free & ~signed & ((trial := solved(is_free)) <= 0.0)).any():
            x += (x[is_invalid] / (x[is_invalid] - trial[is_invalid])).min() * (trial - x)
            is_free &= (x > rounding * x.max()) | signed
            x[~is_free] = 0.0
        x = trial
    return x
