# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise processes against brute force, formulas of the standard, and their sum in a model."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allan_ros.core.errors import AllanError
from allan_ros.core.noise import FLICKER_FLOOR, RANDOM_TERMS, GaussMarkov, Model, Part
from allan_ros.core.noise.derived import avar
from allan_ros.core.noise.processes.low_pass import LowPass
from allan_ros.core.noise.processes.resonance import Resonance
from allan_ros.core.noise.processes.sinusoid import Sinusoid


@given(st.floats(0.5, 1e8), st.sampled_from([1, 2, 5, 64]), st.sampled_from([0, 1, 3]))
def test_gauss_markov_equals_the_mean_over_all_pairs_of_samples(time, m, lag):
    a = np.arange(m)
    distance = np.abs(a[:, None] - (a + lag * m))
    expected = np.mean(np.expm1(-distance / time))
    assert float(GaussMarkov(time).gamma(m, lag)) == pytest.approx(expected, rel=1e-6, abs=1e-11)


def test_allan_variances_are_those_of_the_standard():
    m = np.array([1.0, 7.0, 100.0])
    q, n, b, k = (avar(term, m) for term in RANDOM_TERMS)
    assert q == pytest.approx(3.0 / m**2)
    assert n == pytest.approx(1.0 / m)
    assert b == pytest.approx([FLICKER_FLOOR] * 3)
    assert k == pytest.approx(m / 3.0 + 1.0 / (6.0 * m))
    sine = np.sin(np.pi * 0.03 * m) ** 4 / (m * np.sin(np.pi * 0.03)) ** 2
    assert avar(Sinusoid(0.03), m) == pytest.approx(sine)
    x = np.array([0.1, 10.0])  # IEEE Std 952-2020 annex C, continuous time
    exact = (2.0 * x + 4.0 * np.expm1(-x) - np.expm1(-2.0 * x)) / x**2
    assert avar(GaussMarkov(1e4), 1e4 * x) == pytest.approx(exact, rel=1e-3)


def test_the_model_has_the_polynomial_of_the_standard():
    Q, N, B, K, R, tau0 = 2e-7, 3e-4, 2e-5, 4e-6, 1e-8, 0.01
    tau = np.array([1, 10, 1000, 100_000]) * tau0
    polynomial = (
        3 * Q**2 / tau**2
        + N**2 / tau
        + FLICKER_FLOOR * B**2
        + K**2 * (tau / 3 + tau0**2 / (6 * tau))
        + R**2 * tau**2 / 2
    )
    model = Model.of(Q=Q, N=N, B=B, K=K, R=-R)
    np.testing.assert_allclose(model.avar(tau, tau0), polynomial, rtol=1e-9)
    assert model.value('R') == -R and model.changed(R=0.0).value('R') == 0.0


def test_contributions_add_up_to_the_model_and_a_filter_may_be_negative():
    model = Model.of((1e-4, GaussMarkov(30.0)), (2e-4, Sinusoid(5.0)), N=1e-3, K=1e-5)
    model = Model((*model.parts, Part(LowPass(), -1e-9)))
    tau = np.geomspace(0.1, 1000.0, 9)
    parts = model.contributions(tau, 0.01)
    assert list(parts) == ['N', 'K', 'GM 30 s', 'sine 5 Hz', 'filter']
    np.testing.assert_allclose(sum(parts.values()), model.avar(tau, 0.01))
    np.testing.assert_allclose(parts['filter'], -3e-9 / tau**2)
    assert [p.process.name for p in model.drift.parts] == ['white', 'random_walk', 'gauss_markov']
    assert model.has_drift and not Model.of((1.0, Sinusoid(5.0)), N=1.0, Q=1.0).has_drift


def test_a_model_at_the_ends_of_its_intervals():
    part = Part(GaussMarkov(3.0), 2.0, (1.0, 3.0), ((2.0, 4.0),))
    line = Part(Sinusoid(0.1), 2.0, (1.0, 3.0), ((0.1, 0.1),))
    model = Model((*Model.of(N=1.0).parts, part, line))
    assert [p.value for p in model.at_end(0).parts] == [1.0, 1.0, 2.0]
    assert [p.value for p in model.at_end(1).parts] == [1.0, 3.0, 2.0]
    assert model['gauss_markov'] == (part,) and model.shaped.parts == (part, line)


@pytest.mark.parametrize(
    'bad', [{'N': -1.0}, {'K': math.nan}, {'R': math.inf}, {'R': 10**400}, {'X': 1.0}]
)
def test_impossible_coefficients_are_refused(bad):
    with pytest.raises(AllanError):
        Model.of(**bad)


@pytest.mark.parametrize('model', [Model(), Model.of(N=1.0)])
def test_the_coefficient_of_an_unknown_term_is_refused(model):
    with pytest.raises(KeyError):
        model.value('X')


@given(st.floats(2.0, 50.0), st.floats(1.0, 20.0))
def test_a_resonance_grows_like_white_noise_of_its_density_at_0_hz(f, periods):
    """Its mean over a long time has the same variance, and the integral grows with it."""
    model = Model.of((1.0, Resonance(f, periods / f)), N=0.05)
    tau = 2000.0 * periods / f
    white = float(model.avar([tau])[0]) * tau
    assert model.drift.value('N') ** 2 == pytest.approx(white, rel=2e-3)
    assert [part.process.name for part in model.drift.parts] == ['white']
