# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from support.sums import noise, sums_of

from allan_ros.core.fit.likelihood import LEVEL_95, AxisData, profile_interval
from allan_ros.core.fit.statistics import statistics
from allan_ros.core.noise import RANDOM_TERMS, GaussMarkov
from allan_ros.core.noise.processes.random_walk import RandomWalk

PROCESSES = (*RANDOM_TERMS, GaussMarkov(50.0))


@pytest.fixture(scope='module')
def data():
    return AxisData.of(statistics(sums_of(noise(20_000, 3, 1), cuts=(7000,))), 0)


def test_the_score_is_the_derivative_of_the_likelihood(data):
    columns = data.columns(PROCESSES)
    p = np.array([0.1, 0.9, 0.01, 1e-4, 0.01])
    _, information, moment = data.moments(columns, p)

    def value(log_p):
        return data.moments(columns, np.exp(log_p))[0]

    slope = approx_fprime(np.log(p), value, 1e-6)
    np.testing.assert_allclose(-2.0 * p * (moment - information @ p), slope, rtol=1e-3, atol=1e-3)


def test_a_solution_is_a_maximum(data):
    """The score is 0 for coefficients above 0, and not positive for those held at 0."""
    fit = data.solve(PROCESSES, tolerance=1e-8)
    score = (fit.moment - fit.information @ fit.p) / np.sqrt(np.diag(fit.information))
    free = fit.p > 0.0
    np.testing.assert_allclose(score[free], 0.0, atol=1e-2)
    assert np.all(score[~free] < 1e-2)


def test_the_start_does_not_matter(data):
    ends = [
        data.solve(RANDOM_TERMS, p=np.array(p), tolerance=1e-6).value
        for p in ((1.0, 1.0, 1.0, 1.0), (1e-3, 1e-3, 1e-3, 1e-6), (5.0, 0.01, 1e-6, 1e-2))
    ]
    assert max(ends) - min(ends) < 0.01


def test_a_spectrum_that_is_not_positive_is_refused(data):
    columns = data.columns(RANDOM_TERMS)
    assert data.moments(columns, np.array([-10.0, 1.0, 0.0, 0.0])) is None
    start = np.array([-10.0, 1.0, 0.1, 1e-4])
    assert data.solve(RANDOM_TERMS, columns, start, signed=(0,)).value == math.inf
    fit = data.solve(RANDOM_TERMS, columns, np.array([-0.01, 1.0, 0.1, 1e-4]), signed=(0,))
    assert math.isfinite(fit.value) and np.all(fit.spectrum() > 0.0)


def test_the_ends_of_an_interval_have_the_same_likelihood(data):
    fit = data.solve(RANDOM_TERMS, tolerance=1e-6)
    at = RANDOM_TERMS.index(RandomWalk())
    interval = profile_interval(data, fit, at)
    assert interval.low < fit.p[at] < interval.high
    for end in interval[:2]:
        held = data.solve(RANDOM_TERMS, p=fit.p, held={at: end}, tolerance=1e-6)
        assert held.value - fit.value == pytest.approx(LEVEL_95, abs=0.15)
    assert interval.gain > LEVEL_95
    half = (interval.high - interval.low) / 2.0
    assert half == pytest.approx(1.96 * math.sqrt(fit.covariance()[at, at]), rel=0.3)
