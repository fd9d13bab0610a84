# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sample variance from the Allan deviation, and the variance for a consistent filter."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.allan_table import allan_table

from allan_ros.core.filters.noise_parameters import (
    measured_variances,
    sample_variance,
    white_variances,
)
from allan_ros.core.fit import AxisFit, Coefficient

RATE = 128.0
WINDOW = 128  # samples in a second


def windowed_variance(y: np.ndarray) -> float:
    """Return the mean of the variances within windows of 1 s, from the definition."""
    return float(y.reshape(-1, WINDOW).var(axis=1, ddof=1).mean())


def measured(y: np.ndarray) -> float:
    m = 1 << np.arange(8)
    table = allan_table(y[:, None], m, stride=1)
    value = sample_variance(m, np.sqrt(table.avar[:, 0]), 1.0 / RATE)
    assert value is not None
    return value


@pytest.mark.parametrize('kind', ['white', 'filtered', 'quantization', 'walk', 'line'])
def test_it_is_the_variance_within_a_second_for_any_noise(kind):
    rng = np.random.default_rng(3)
    white = rng.normal(0.0, 2.0, 1 << 18)
    y = {
        'white': white,
        'filtered': np.convolve(white, np.ones(8) / 8.0, 'same'),
        'quantization': np.diff(white, prepend=0.0),
        'walk': np.cumsum(white) * 0.01,
        'line': np.sin(0.7 * np.arange(len(white))),
    }[kind]
    # windows weight the samples differently from overlapping differences: 1.7 % for the walk
    assert measured(y) == pytest.approx(windowed_variance(y), rel=0.04)


def test_the_sample_variance_needs_all_factors_of_the_window():
    m, adev = np.array([1, 2, 4]), np.array([1.0, math.nan, 1.0])
    assert sample_variance(m, adev, tau0=0.25) is None
    assert sample_variance(m, np.ones(3), tau0=2.0) is None
    assert sample_variance(m, np.ones(3), tau0=0.01) is None  # 64 samples need m up to 32
    # two samples: the mean square of their difference, halved, is the Allan variance itself
    assert sample_variance(m, np.array([3.0, 1.0, 1.0]), tau0=0.5) == pytest.approx(9.0)


def test_only_n2f_is_consistent_behind_a_low_pass():
    """The variance of the mean over a second follows from N, not from the scatter of samples."""
    rng = np.random.default_rng(11)
    n_density = 0.3
    white = rng.normal(0.0, n_density * math.sqrt(RATE), (2000, 3 * WINDOW))
    a = 0.6  # first order, time constant of two samples
    filtered = np.empty_like(white)
    filtered[:, 0] = white[:, 0]
    for i in range(1, white.shape[1]):
        filtered[:, i] = a * filtered[:, i - 1] + (1 - a) * white[:, i]
    second = filtered[:, 2 * WINDOW :]
    true_variance = float((second.mean(axis=1) ** 2).mean())
    # 2000 runs: a variance is known to sqrt(2/2000) = 3.2 %, 4 standard deviations are 13 %
    believed = n_density**2 * RATE / WINDOW
    assert believed == pytest.approx(true_variance, rel=0.13)
    from_scatter = float(second.var(axis=1, ddof=1).mean()) / WINDOW
    assert from_scatter < 0.35 * true_variance


def fit_of(n: float | None, upper95: float | None = None) -> AxisFit:
    status = 'estimated' if n is not None else 'not_observable'
    nothing = Coefficient(None, status='not_observable')
    return AxisFit({**dict.fromkeys('QBKR', nothing), 'N': Coefficient(n, None, upper95, status)})


def test_white_variances_by_hand():
    axes = {
        'gyro_x': fit_of(1e-3),
        'gyro_y': fit_of(2e-3),
        'gyro_z': fit_of(None, 3e-3),  # the upper limit is used
        'accel_x': fit_of(1e-2),
        'accel_y': fit_of(1e-2),
    }
    found = white_variances(axes, 200.0)
    assert set(found) == {'gyro'}  # an axis of the accelerometer is missing
    assert found['gyro'] == pytest.approx((2e-4, 8e-4, 1.8e-3))
    assert white_variances(axes, 200.0, 10.0)['gyro'] == pytest.approx((2e-2, 8e-2, 1.8e-1))
    axes['gyro_z'] = fit_of(None)
    assert white_variances(axes, 200.0) == {}


def test_measured_variances_by_hand():
    stds = {'accel_x': 0.1, 'accel_y': 0.2, 'accel_z': 0.3, 'gyro_x': 1.0, 'gyro_y': None}
    assert measured_variances(stds, 2.0)['accel'] == pytest.approx((0.04, 0.16, 0.36))
    assert set(measured_variances(stds)) == {'accel'}
    assert measured_variances({**stds, 'gyro_z': 1.0}).keys() == {'accel'}
