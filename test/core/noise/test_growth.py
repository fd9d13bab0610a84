# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Predicted error growth of a model: closed forms against state spaces and simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from allan_ros.core.filters.state_space import StateSpace
from allan_ros.core.noise import GaussMarkov, Model
from allan_ros.core.noise.processes.sinusoid import Sinusoid
from allan_ros.core.simulator import simulate_axis

PROCESSES = {
    'N': Model.of(N=1.0),
    'B': Model.of(B=1.0),
    'K': Model.of(K=1.0),
    'R': Model.of(R=1.0),
    'Gauss-Markov': Model.of((1.0, GaussMarkov(10.0))),
    'short Gauss-Markov': Model.of((1.0, GaussMarkov(0.02))),
    'sinusoid': Model.of((1.0, Sinusoid(0.02))),
}


def test_growth_over_the_window_is_the_allan_deviation():
    """With h = W the error is the second difference of theta, W sqrt(2 avar(W))."""
    tau = np.array([0.3, 5.0, 200.0])
    for model in PROCESSES.values():
        expected = tau * np.sqrt(2.0 * model.avar(tau))
        np.testing.assert_allclose(model.growth(tau, tau), expected, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize(
    'space',
    [
        StateSpace(1.0),
        StateSpace(0.0, 1.0),
        StateSpace(0.0, 0.0, ((1.0, GaussMarkov(10.0)),)),
        StateSpace(1.0, 0.3, ((2.0, GaussMarkov(2.0)), (1.0, GaussMarkov(300.0)))),
    ],
)
@pytest.mark.parametrize('horizon, window', [(30.0, 12.0), (5.0, 100.0)])
def test_growth_is_that_of_the_state_space(space, horizon, window):
    first, later = space.transition(window), space.transition(horizon)
    covariance = first @ space.initial_covariance(1.0) @ first.T + space.noise(window)
    error = later[0]  # theta(h) of the states at time 0, where theta(-W) is 0
    error[0] -= 1.0 + horizon / window
    expected = math.sqrt(error @ covariance @ error + space.noise(horizon)[0, 0])
    model = Model.of(*space.processes, N=space.white, K=space.walk)
    assert model.growth(horizon, window) == pytest.approx(expected, rel=1e-6)


def test_growth_has_the_broadcast_shape_also_without_noise():
    horizon, window = np.array([[1.0], [2.0]]), np.array([3.0, 4.0, 5.0])
    for model in (Model(), Model.of(N=1.0)):
        assert model.growth(horizon, window).shape == (2, 3)
        assert model.growth(1.0, window).shape == (3,)


def test_growth_of_a_ramp_and_of_a_sinusoid_of_any_phase():
    horizon, window = 30.0, 12.0
    ramp = horizon * (horizon + window) / 2.0
    assert PROCESSES['R'].growth(horizon, window) == pytest.approx(ramp)
    amplitude, frequency = 1.0, 0.02
    turn, phase = 2.0 * np.pi * frequency, 2.0 * np.pi * np.arange(16) / 16
    times = -window, 0.0, horizon
    before, start, end = (amplitude / turn * np.sin(turn * t + phase) for t in times)
    error = end - start - horizon / window * (start - before)
    std = float(np.sqrt(np.mean(error**2)))
    assert PROCESSES['sinusoid'].growth(horizon, window) == pytest.approx(std)


def test_growth_of_simulated_flicker():
    """40 independent records; the ratio of variances is within 25 % (false alarm below 1e-4)."""
    rng = np.random.default_rng(1)
    terms = Model.of(N=1.0, B=1.0, K=0.05)
    horizon, window = 20, 50
    errors = []
    for _ in range(40):
        y = simulate_axis(4000, 1.0, terms, rng)
        theta = np.concatenate([[0.0], np.cumsum(y)])
        start = np.arange(window, 4001 - horizon, horizon + window)
        before = theta[start] - theta[start - window]
        errors.append(theta[start + horizon] - theta[start] - horizon / window * before)
    actual = float(np.sqrt(np.mean(np.square(errors))))
    assert terms.growth(horizon, window) == pytest.approx(actual, rel=0.12)


def test_rounding_is_negligible_at_long_correlation_times():
    """At times far below tau a Gauss-Markov process is a random walk of density 2 sigma^2/tau."""
    for tau in (1e4, 1e7):
        process = Model.of((1.0, GaussMarkov(tau)))
        walk = Model.of(K=math.sqrt(2.0 / tau))
        ratio = process.growth(0.01, 0.5) / walk.growth(0.01, 0.5)
        assert ratio == pytest.approx(1.0, abs=1e-3)
