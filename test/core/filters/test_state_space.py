# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The discrete matrices against numerical integration, and flicker as Gauss-Markov processes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from allan_ros.core.errors import AllanError
from allan_ros.core.filters.reductions import StateSpace, flicker_processes
from allan_ros.core.noise import FLICKER_FLOOR, ProcessModel


def van_loan(space: StateSpace, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return Phi and Qd of the continuous model by the matrix exponential (van Loan 1978)."""
    n = space.size
    a, w = np.zeros((n, n)), np.zeros((n, n))
    a[0, 1 : 2 + len(space.gauss_markov)] = 1.0
    w[0, 0], w[1, 1] = space.white**2, space.walk**2
    for i, (sigma, tau) in enumerate(space.gauss_markov, 2):
        a[i, i], w[i, i] = -1.0 / tau, 2.0 * sigma**2 / tau
    if space.slope:
        a[1, n - 1] = 1.0
    e = expm(np.block([[-a, w], [np.zeros((n, n)), a.T]]) * dt)
    phi = e[n:, n:].T
    return phi, phi @ e[:n, n:]


@pytest.mark.parametrize('dt', [0.004, 1.0, 30.0])
def test_matrices_are_those_of_the_continuous_model(dt):
    space = StateSpace(1.0, 0.3, ((2.0, 3.0), (1.0, 100.0), (0.5, 1e4)), slope=True)
    phi, noise = van_loan(space, dt)
    np.testing.assert_allclose(space.transition(dt), phi, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(space.noise(dt), noise, rtol=1e-5, atol=1e-9)
    assert space.sample_variance(100.0) == pytest.approx(100.0)


@pytest.mark.parametrize('white, limit', [(10.0, 0.05), (0.5, 0.11), (0.0, 0.15)])
def test_four_processes_follow_flicker(white, limit):
    processes = flicker_processes(2.0, white)
    assert len(processes) == 4
    tau = np.geomspace(3.0, 3000.0, 50)
    ratio = ProcessModel(gauss_markov=processes).avar(tau) / (4.0 * FLICKER_FLOOR)
    assert np.abs(ratio - 1.0).max() < limit


def test_a_step_of_nothing_is_refused():
    with pytest.raises(AllanError, match='rate above 0'):
        StateSpace(1.0).transition(0.0)
