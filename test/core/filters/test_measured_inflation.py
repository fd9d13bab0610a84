# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inflation of N and K by running motors: the larger value, and its ratio to the value at rest."""

from __future__ import annotations

import pytest

from allan_ros.core.errors import AllanError
from allan_ros.core.filters.noise_parameters import measure_inflation
from allan_ros.core.fit import AxisFit, Coefficient


def fit(n: float, k: float) -> AxisFit:
    noise = {term: Coefficient(None, None, 1e-9, 'not_observable') for term in 'QBR'}
    return AxisFit({**noise, 'N': Coefficient(n), 'K': Coefficient(k)})


def test_the_larger_value_is_used_and_divided_by_the_value_at_rest() -> None:
    rest = {'gyro_x': fit(1e-3, 2e-5), 'gyro_y': fit(1e-3, 1e-5)}
    running = {'gyro_x': fit(3e-3, 1e-5)}
    ((axis, one),) = measure_inflation(rest, running).items()
    assert axis == 'gyro_x'
    assert (one.white.use, one.white.factor) == pytest.approx((3e-3, 3.0))
    # a smaller K with motors on is due to chance: the value at rest is used
    assert (one.walk.use, one.walk.factor) == pytest.approx((2e-5, 1.0))


def test_fits_without_a_common_axis_are_rejected() -> None:
    with pytest.raises(AllanError, match='no axis in common'):
        measure_inflation({'gyro_x': fit(1.0, 1.0)}, {'accel_x': fit(1.0, 1.0)})
