# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
from scipy.optimize import nnls

from allan_ros.core.fit.gls_solver import nonnegative_least_squares


def test_agrees_with_lawson_and_hanson():
    rng = np.random.default_rng(0)
    for _ in range(100):
        columns = rng.standard_normal((20, 5)) * 10.0 ** rng.uniform(-8, 8, 5)
        target = rng.standard_normal(20)
        scale = np.linalg.norm(columns, axis=0)
        expected = nnls(columns / scale, target)[0] / scale
        found = nonnegative_least_squares(columns, target)
        np.testing.assert_allclose(found * scale, expected * scale, atol=1e-9)


def test_a_negative_target_gives_zeros():
    assert not nonnegative_least_squares(np.eye(4)[:, :2], -np.ones(4)).any()
