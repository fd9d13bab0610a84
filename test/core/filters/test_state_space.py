# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The discrete matrices are exact, also of very short and very long steps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from allan_ros.core.errors import AllanError
from allan_ros.core.filters.state_space import (
    StateSpace,
    flicker_processes,
    state_space,
    white_density,
)
from allan_ros.core.noise import FLICKER_FLOOR, PROCESSES, GaussMarkov, Model


def test_a_step_of_zero_is_rejected():
    with pytest.raises(AllanError, match='rate above 0'):
        StateSpace(1.0).transition(0.0)


def van_loan(space: StateSpace, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return Phi and Qd of the continuous model by the matrix exponential (van Loan 1978)."""
    n = space.size
    a, w = np.zeros((n, n)), np.zeros((n, n))
    a[0, 1 : 2 + len(space.processes)] = 1.0
    w[0, 0], w[1, 1] = space.white**2, space.walk**2
    for i, (sigma, process) in enumerate(space.processes, 2):
        tau = process.slowest_time
        a[i, i], w[i, i] = -1.0 / tau, 2.0 * sigma**2 / tau
    if space.slope:
        a[1, n - 1] = 1.0
    e = expm(np.block([[-a, w], [np.zeros((n, n)), a.T]]) * dt)
    phi = e[n:, n:].T
    return phi, phi @ e[:n, n:]


@pytest.mark.parametrize('dt', [0.004, 1.0, 30.0])
def test_matrices_are_those_of_the_continuous_model(dt):
    processes = tuple((s, GaussMarkov(t)) for s, t in ((2.0, 3.0), (1.0, 100.0), (0.5, 1e4)))
    space = StateSpace(1.0, 0.3, processes, slope=True)
    phi, noise = van_loan(space, dt)
    np.testing.assert_allclose(space.transition(dt), phi, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(space.noise(dt), noise, rtol=1e-5, atol=1e-9)
    assert space.sample_variance(100.0) == pytest.approx(100.0)


@pytest.mark.parametrize('white, limit', [(10.0, 0.05), (0.5, 0.11), (0.0, 0.15)])
def test_four_processes_have_the_allan_variance_of_flicker(white, limit):
    processes = flicker_processes(2.0, white)
    assert len(processes) == 4
    tau = np.geomspace(3.0, 3000.0, 50)
    ratio = Model.of(*processes).avar(tau) / (4.0 * FLICKER_FLOOR)
    assert np.abs(ratio - 1.0).max() < limit


@pytest.mark.parametrize('ratio', [1e-7, 1e-3, 1.0, 30.0, 1e5])
def test_the_matrices_of_a_gauss_markov_process_are_exact_for_any_step(ratio):
    """Against the closed form, by its series for short steps."""
    space = StateSpace(0.0, 0.0, ((2.0, GaussMarkov(50.0)),))
    dt, x = 50.0 * ratio, ratio
    q = space.noise(dt)
    exact = 2.0 * x + 4.0 * np.expm1(-x) - np.expm1(-2.0 * x)
    if x < 0.05:
        exact = x**3 * (2.0 / 3.0 - x * (0.5 - x * (7.0 / 30.0 - x / 12.0)))
    assert q[0, 0] == pytest.approx(4.0 * 2500.0 * exact, rel=1e-8)
    assert q[2, 2] == pytest.approx(-4.0 * np.expm1(-2.0 * x), rel=1e-8)
    assert q[0, 2] == pytest.approx(4.0 * 50.0 * np.expm1(-x) ** 2, rel=1e-8)
    assert space.transition(dt)[0, 2] == pytest.approx(-50.0 * np.expm1(-x), rel=1e-8)


def test_a_fast_process_looks_like_white_noise():
    assert white_density(GaussMarkov(0.05)) == pytest.approx(np.sqrt(2.0 * 0.05))


def test_processes_without_states_are_refused_or_approximated():
    with pytest.raises(AllanError, match='no longest correlation time'):
        StateSpace(1.0, 0.0, ((1.0, PROCESSES['flicker']()),)).noise(1.0)
    space = state_space(Model.of((1e-3, GaussMarkov(7.0)), N=1e-3, B=1e-4, K=1e-6, R=1e-9))
    assert len(space.processes) == 5 and space.processes[-1] == (1e-3, GaussMarkov(7.0))
    assert space.walk > 1e-6 and space.white == 1e-3
