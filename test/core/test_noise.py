# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest

from allan_ros.core.errors import AllanError
from allan_ros.core.noise import (
    NoiseTerms,
    gauss_markov_avar,
    sampled_gauss_markov_avar,
    sinusoid_avar,
    term_avar,
)


def test_the_terms_agree_with_the_standard_at_long_tau():
    terms = NoiseTerms(Q=2e-3, N=0.3, B=0.05, K=0.02, R=-0.004)
    tau0, m = 0.01, np.array([1000, 30000])
    tau = m * tau0
    a = {-2: 3 * 2e-3**2, -1: 0.3**2, 0: 2 * math.log(2) / math.pi * 0.05**2}
    a |= {1: 0.02**2 / 3, 2: 0.004**2 / 2}
    polynomial = sum(value * tau**power for power, value in a.items())
    np.testing.assert_allclose(term_avar(m, tau0, terms).sum(axis=-1), polynomial, rtol=1e-6)


def test_a_random_walk_of_unit_steps_is_exact_at_one_sample():
    # V(1) = E(y_1 - y_0)^2/2 = 1/2 for steps of variance 1, not the 1/3 of continuous time.
    assert term_avar(1, 1.0, NoiseTerms(K=1.0))[3] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ('name', 'value', 'advice'),
    [
        ('N', -1.0, 'a finite number of 0 or above'),
        ('B', math.nan, 'a finite number of 0 or above'),
        ('R', math.inf, 'a finite number'),  # a ramp may be negative
    ],
)
def test_invalid_coefficients_are_rejected(name, value, advice):
    with pytest.raises(AllanError, match=f'^{name} is {value}: give {advice}$'):
        NoiseTerms(**{name: value})


def two_mean_variance(covariance, points: int) -> float:
    """Return E (mean of the second half - mean of the first)^2 / 2 from the covariance of
    samples.
    """
    sign = np.repeat([-1.0, 1.0], points) / points
    lag = np.arange(2 * points)
    return float(sign @ covariance(np.abs(lag[:, None] - lag)) @ sign) / 2.0


@pytest.mark.parametrize('m', [1, 7, 50, 400])
def test_gauss_markov_has_the_variance_of_its_autocovariance(m):
    fine = 400  # points per interval: the means agree with integrals to 1e-5
    expected = two_mean_variance(lambda lag: np.exp(-lag * (m / fine) / 30.0), fine)
    assert gauss_markov_avar([m], 30.0)[0] == pytest.approx(expected, rel=1e-3)
    expected = two_mean_variance(lambda lag: np.exp(-lag / 30.0), m)
    assert sampled_gauss_markov_avar([m], 30.0)[0] == pytest.approx(expected, rel=1e-9)


def test_gauss_markov_noise_is_a_walk_at_short_and_white_at_long_times():
    # K^2 = 2/T per sample at m << T, N^2 = 2 T at m >> T
    assert gauss_markov_avar([1], 1e4)[0] == pytest.approx(2e-4 / 3.0, rel=1e-3)
    assert gauss_markov_avar([10**6], 10.0)[0] == pytest.approx(20.0 / 1e6, rel=1e-4)
    walk = term_avar([1, 50], 1.0, NoiseTerms(K=(2e-4) ** 0.5))[:, 3]
    assert sampled_gauss_markov_avar([1, 50], 1e4) == pytest.approx(walk, rel=1e-2)


@pytest.mark.parametrize('m', [1, 3, 20, 64])
@pytest.mark.parametrize('frequency', [0.001, 0.03, 0.21, 0.4])
def test_a_sinusoid_has_the_variance_of_its_samples(m, frequency):
    # over all phases the autocovariance of sin is cos/2
    expected = two_mean_variance(lambda lag: np.cos(2.0 * np.pi * frequency * lag) / 2.0, m)
    assert sinusoid_avar([m], frequency)[0] == pytest.approx(expected, rel=1e-9, abs=1e-15)
