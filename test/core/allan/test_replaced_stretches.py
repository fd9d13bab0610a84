# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shocks in a recording do not change its coefficients."""

import numpy as np
import pytest

from allan_ros.core.allan.replaced_stretches import replaced_excess
from allan_ros.core.fit.stationary import fit_likelihood
from allan_ros.core.imu import AXES, ImuBatch
from allan_ros.core.noise import Model
from allan_ros.core.simulator import simulate_axis
from allan_ros.core.stream.pipeline import ImuStream

RATE, SECONDS = 50.0, 900.0
NOISE = Model.of(N=1e-4, B=4e-5)


def fits(samples):
    """Return the fits of the axes of a recording, and the number of its shocks."""
    stream = ImuStream()
    stamps = 10**18 + np.arange(len(samples)) * round(1e9 / RATE)
    stream.update(ImuBatch(stamps, samples, None, 'imu'))
    stream.end()
    result = stream.result()
    return fit_likelihood(result.sums[0]).axes, result.health.counts.shocks


@pytest.mark.parametrize('number', [3, 20])
def test_shocks_change_neither_n_nor_b(number):
    """The same noise with and without shocks, six axes.

    5 % of the samples are replaced by 20 shocks, so N changes by about a fifth of its standard
    error (0.4 %), and B by a fifth of 15 %. The limits are five times these changes.
    """
    rng = np.random.default_rng(number)
    n = round(RATE * SECONDS)
    y = np.stack([simulate_axis(n, 1.0 / RATE, NOISE, rng) for _ in AXES], axis=1)
    y += [0.0, 0.0, 0.0, 0.0, 0.0, 9.8]
    clean, _ = fits(y)
    t = np.arange(10)
    for start in np.linspace(40.0, SECONDS - 40.0, number):
        at = round(start * RATE)
        y[at : at + 10] += 0.03 * (np.exp(-t / 3.0) * np.cos(t))[:, None]
    shaken, shocks = fits(y)
    assert shocks == number
    for name, fit in shaken.items():
        assert not fit.lack_of_fit and not fit.filtered
        assert fit.noise['N'].value == pytest.approx(clean[name].noise['N'].value, rel=0.005)
        assert fit.noise['B'].value == pytest.approx(clean[name].noise['B'].value, rel=0.15)


@pytest.mark.parametrize(('length', 'level'), [(1, 1), (3, 1), (7, 4), (5, 40)])
def test_the_excess_is_the_covariance_of_the_replaced_samples(length, level):
    """Exact covariance of the means of a recording with one stretch, over all its positions."""
    size = 2 * (length + 2 * level)
    matrix, at = np.eye(size), size // 2
    t = np.arange(1, length + 1)[:, None] / (length + 1)
    stretch = np.zeros((length, size))
    stretch[:, at - level : at] = (1.0 - t) / level
    stretch[:, at + length : at + length + level] = t / level
    matrix[at : at + length] = stretch
    change = matrix @ matrix.T - np.eye(size)
    lags = np.arange(-size + 1, size)
    autocovariance = np.array([np.trace(change, k) for k in lags])
    gamma = replaced_excess(np.array([[length, level, 1]]), np.array([1.0]))
    for m in (1, 3, 64):
        for j in (0, 1, 2):
            weight = np.maximum(m - np.abs(j * m - lags), 0) / m**2
            assert float(gamma(m, j)) == pytest.approx(float(weight @ autocovariance), abs=1e-9)
