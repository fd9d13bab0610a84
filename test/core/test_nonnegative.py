# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nonnegative least squares against scipy."""

from __future__ import annotations

import numpy as np
import pytest

from allan_ros.core.nonnegative import nonnegative_least_squares


@pytest.mark.parametrize('seed', range(50))
def test_nonnegative_least_squares_is_as_close_as_that_of_scipy(seed: int) -> None:
    """Also with dependent columns, of which several solutions are equally close, and with signs."""
    from scipy.optimize import nnls

    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(12, 5))
    if seed % 2:
        matrix = np.column_stack([matrix, -matrix[:, :2], matrix[:, 3] * (1.0 + 1e-9)])
    target = rng.normal(size=12) * 10.0 ** rng.uniform(-3.0, 3.0)
    signed = rng.random(matrix.shape[1]) < 0.3 * (seed % 3)
    x = nonnegative_least_squares(matrix, target, signed)
    assert x[~signed].min(initial=0.0) >= 0.0
    closest = nnls(np.column_stack([matrix, -matrix[:, signed]]), target)[1]
    assert np.linalg.norm(matrix @ x - target) <= closest + 1e-12 * np.linalg.norm(target)
