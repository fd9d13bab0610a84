# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Predicted error growth: closed forms against integrals, simulation and each other."""

from __future__ import annotations

import math

import numpy as np
import pytest

from allan_ros.core.filters.growth import predicted_growth
from allan_ros.core.filters.reductions import StateSpace, flicker_processes
from allan_ros.core.noise import NoiseTerms, ProcessModel
from allan_ros.core.simulate import simulate_axis

PROCESSES = {
    'N': ProcessModel(NoiseTerms(N=1.0)),
    'B': ProcessModel(NoiseTerms(B=1.0)),
    'K': ProcessModel(NoiseTerms(K=1.0)),
    'R': ProcessModel(NoiseTerms(R=1.0)),
    'Gauss-Markov': ProcessModel(gauss_markov=((1.0, 10.0),)),
    'short Gauss-Markov': ProcessModel(gauss_markov=((1.0, 0.02),)),
    'sinusoid': ProcessModel(sinusoids=((1.0, 0.02),)),
}

SPACES = [
    StateSpace(1.0),
    StateSpace(0.0, 1.0),
    StateSpace(0.0, 0.0, ((1.0, 10.0),)),
    StateSpace(1.0, 0.3, ((2.0, 2.0), (1.0, 300.0))),
]


def test_growth_over_the_window_is_the_allan_deviation():
    """With h = W the error is the second difference of theta, W sqrt(2 avar(W))."""
    tau = np.array([0.3, 5.0, 200.0])
    for model in PROCESSES.values():
        expected = tau * np.sqrt(2.0 * model.avar(tau))
        np.testing.assert_allclose(
            predicted_growth(model, tau, tau), expected, rtol=1e-4, atol=1e-9
        )


@pytest.mark.parametrize('space', SPACES)
def test_position_is_the_integral_of_the_velocity_error(space):
    """The closed form agrees with an integration of the states, including the position, in small
    steps.
    """
    horizon, window, steps = 30.0, 12.0, 400
    dt, n = horizon / steps, space.size
    # states: theta(t) - theta(0), bias parts, then theta(0) - theta(-W), then the position
    phi, noise = space.transition(window), space.noise(window)
    start = phi @ space.initial_covariance(1e3) @ phi.T + noise
    covariance = np.zeros((n + 2, n + 2))
    moved = [n, *range(1, n)]
    covariance[np.ix_(moved, moved)] = start
    step, half, added = np.eye(n + 2), np.eye(n + 2), np.zeros((n + 2, n + 2))
    step[:n, :n], added[:n, :n] = space.transition(dt), space.noise(dt)
    half[n + 1, 0] = dt / 2.0
    for _ in range(steps):  # trapezoidal rule
        covariance = half @ (step @ half @ covariance @ half.T @ step.T + added) @ half.T
    error = np.zeros(n + 2)
    error[n + 1], error[n] = 1.0, -(horizon**2) / (2.0 * window)
    expected = math.sqrt(error @ covariance @ error)
    model = ProcessModel(NoiseTerms(N=space.white, K=space.walk), space.gauss_markov)
    growth = predicted_growth(model, horizon, window, 2)
    assert growth == pytest.approx(expected, rel=2e-3)


def test_position_under_a_ramp_and_flicker():
    """The ramp is computed by hand; flicker agrees within 5 % with the processes that
    approximate it.
    """
    ramp = predicted_growth(PROCESSES['R'], 6.0, 4.0, 2)
    assert ramp == pytest.approx(6.0**3 / 6.0 + 6.0**2 * 4.0 / 4.0)
    flicker = predicted_growth(PROCESSES['B'], 60.0, 100.0, 2)
    processes = ProcessModel(gauss_markov=flicker_processes(1.0, 10.0))
    assert flicker == pytest.approx(predicted_growth(processes, 60.0, 100.0, 2), rel=0.05)


def test_growth_of_simulated_flicker():
    """40 independent records; the ratio of variances is within 25 % (false alarm below 1e-4)."""
    rng = np.random.default_rng(1)
    terms = NoiseTerms(N=1.0, B=1.0, K=0.05)
    horizon, window = 20, 50
    errors = []
    for _ in range(40):
        y = simulate_axis(4000, 1.0, terms, rng)
        theta = np.concatenate([[0.0], np.cumsum(y)])
        start = np.arange(window, 4001 - horizon, horizon + window)
        before = theta[start] - theta[start - window]
        errors.append(theta[start + horizon] - theta[start] - horizon / window * before)
    actual = float(np.sqrt(np.mean(np.square(errors))))
    assert predicted_growth(ProcessModel(terms), horizon, window) == pytest.approx(actual, rel=0.12)


def test_rounding_is_negligible_at_long_correlation_times():
    """At times far below tau a Gauss-Markov process is a random walk of density 2 sigma^2/tau."""
    for tau in (1e4, 1e7):
        process = ProcessModel(gauss_markov=((1.0, tau),))
        walk = ProcessModel(NoiseTerms(K=math.sqrt(2.0 / tau)))
        for integrals in (1, 2):
            ratio = predicted_growth(process, 0.01, 0.5, integrals) / predicted_growth(
                walk, 0.01, 0.5, integrals
            )
            assert ratio == pytest.approx(1.0, abs=1e-3)
