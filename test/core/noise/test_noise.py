# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise types: gamma against simulated samples, brute force and formulas of the standard."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from allan_ros.core.errors import AllanError
from allan_ros.core.noise import (
    FLICKER_FLOOR,
    NoiseTerms,
    ProcessModel,
    gamma_of,
    gauss_markov_avar,
    term_avar,
    unit_avar,
)
from allan_ros.core.simulate import simulate_axis

SHAPES = [
    ('Q',),
    ('N',),
    ('B',),
    ('K',),
    ('gauss_markov', 30.0),
    ('bounded_walk', 200.0),
    ('sinusoid', 0.031),
    ('resonance', 0.05, 30.0),
]


def simulated(component, n, rng):
    """Return n samples of a noise type with the coefficient 1."""
    kind, *shape = component
    if not shape:
        return simulate_axis(n, 1.0, NoiseTerms(**{kind: 1.0}), rng)
    if kind == 'sinusoid':
        return np.sin(2.0 * np.pi * (shape[0] * np.arange(n) + rng.uniform()))
    if kind == 'resonance':  # a rotating complex Gauss-Markov process
        rest = simulated(('gauss_markov', shape[1]), 2 * n, rng).reshape(2, n)
        turn = np.exp(2j * np.pi * shape[0] * np.arange(n))
        return ((rest[0] + 1j * rest[1]) * turn).real
    keep = math.exp(-1.0 / shape[0])
    variance = 1.0 if kind == 'gauss_markov' else shape[0] / 2.0
    steps = rng.standard_normal(n) * math.sqrt(variance * (1.0 - keep * keep))
    steps[0] = rng.standard_normal() * math.sqrt(variance)
    return lfilter([1.0], [1.0, -keep], steps)


@pytest.mark.parametrize('component', SHAPES, ids=lambda c: c[0])
@pytest.mark.parametrize('m', [1, 4, 16])
def test_gamma_is_the_autocovariance_of_means_of_simulated_samples(component, m):
    # False alarms: the bound is over 5 standard errors of the mean of 200 records, 1e-6.
    gamma, lags = gamma_of(*component), np.array([0, 1, 3])
    rng = np.random.default_rng(5)
    found = []
    for _ in range(200):
        means = simulated(component, 1 << 12, rng).reshape(-1, m).mean(axis=1)
        # differences at lag j have the variance 2 (gamma(0) - gamma(j)), even without a mean
        found.append([np.mean((means[j:] - means[: len(means) - j]) ** 2) / 2.0 for j in lags[1:]])
    expected = gamma(m, 0) - gamma(m, lags[1:])
    error = 5.5 * np.std(found, axis=0) / math.sqrt(len(found)) + 1e-3 * np.abs(expected)
    assert np.all(np.abs(np.mean(found, axis=0) - expected) < error)


@given(st.floats(0.5, 1e8), st.sampled_from([1, 2, 5, 64]), st.sampled_from([0, 1, 3]))
def test_gauss_markov_equals_the_mean_over_all_pairs_of_samples(time, m, lag):
    a = np.arange(m)
    distance = np.abs(a[:, None] - (a + lag * m))
    expected = np.mean(np.expm1(-distance / time))
    assert float(gamma_of('gauss_markov', time)(m, lag)) == pytest.approx(
        expected, rel=1e-6, abs=1e-11
    )


def test_allan_variances_are_those_of_the_standard():
    m = np.array([1.0, 7.0, 100.0])
    assert unit_avar(m, 'Q') == pytest.approx(3.0 / m**2)
    assert unit_avar(m, 'N') == pytest.approx(1.0 / m)
    assert unit_avar(m, 'B') == pytest.approx([FLICKER_FLOOR] * 3)
    assert unit_avar(m, 'K') == pytest.approx(m / 3.0 + 1.0 / (6.0 * m))
    sine = np.sin(np.pi * 0.03 * m) ** 4 / (m * np.sin(np.pi * 0.03)) ** 2
    assert unit_avar(m, 'sinusoid', 0.03) == pytest.approx(sine)
    long = np.array([1e3, 1e5])
    assert unit_avar(long, 'gauss_markov', 1e4) == pytest.approx(
        gauss_markov_avar(long, 1e4), rel=1e-3
    )


def test_term_avar_is_the_polynomial_of_the_standard():
    terms, tau0 = NoiseTerms(Q=2e-7, N=3e-4, B=2e-5, K=4e-6, R=1e-8), 0.01
    m = np.array([1, 10, 1000, 100_000])
    tau = m * tau0
    polynomial = (
        3 * terms.Q**2 / tau**2
        + terms.N**2 / tau
        + FLICKER_FLOOR * terms.B**2
        + terms.K**2 * (tau / 3 + tau0**2 / (6 * tau))
        + terms.R**2 * tau**2 / 2
    )
    np.testing.assert_allclose(term_avar(m, tau0, terms).sum(axis=-1), polynomial, rtol=1e-9)


def test_parts_add_up_to_the_model_and_a_filter_may_be_negative():
    model = ProcessModel(NoiseTerms(N=1e-3, K=1e-5), ((1e-4, 30.0),), ((2e-4, 5.0),), -1e-9)
    tau = np.geomspace(0.1, 1000.0, 9)
    parts = model.parts(tau, 0.01)
    assert list(parts) == ['N', 'K', 'GM 30 s', 'sine 5 Hz', 'filter']
    np.testing.assert_allclose(sum(parts.values()), model.avar(tau, 0.01))
    assert np.all(parts['filter'] < 0.0)


@pytest.mark.parametrize('bad', [{'N': -1.0}, {'K': math.nan}, {'R': math.inf}])
def test_impossible_coefficients_are_refused(bad):
    with pytest.raises(AllanError):
        NoiseTerms(**bad)
