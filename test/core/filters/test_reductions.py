# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reductions have at least the error growth of the complete model; the discrete matrices are
exact.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from allan_ros.core.errors import AllanError
from allan_ros.core.filters.growth import has_drift, predicted_growth
from allan_ros.core.filters.reductions import (
    StateSpace,
    closest_process,
    flicker_processes,
    reduce_model,
)
from allan_ros.core.noise import FLICKER_FLOOR, NoiseTerms, ProcessModel

DEG = math.pi / 180.0
FLICKER = ProcessModel(
    NoiseTerms(
        Q=1e-7,
        N=0.168 * DEG / 60,
        B=4.97 * DEG / 3600,
        K=8.2 * DEG / 3600**1.5,
        R=11.0 * DEG / 3600**2,
    )
)
HUMP = ProcessModel(
    NoiseTerms(N=0.242 * DEG / 60),
    gauss_markov=((9.0 * DEG / 3600, 3.0), (6.0 * DEG / 3600, 30.0), (6.0 * DEG / 3600, 300.0)),
)
QUICK = ProcessModel(NoiseTerms(N=1e-5, K=1e-9), gauss_markov=((1e-4, 0.05),))


@pytest.mark.parametrize('model', [FLICKER, HUMP, QUICK], ids=['flicker', 'hump', 'quick'])
@pytest.mark.parametrize('states', ['none', 'walk', 'processes'])
@pytest.mark.parametrize('horizon', [0.5, 30.0, 300.0])
def test_the_growth_is_bounded_from_above(model, states, horizon):
    reduction = reduce_model(model, states, horizon)
    assert 0.97 <= reduction.ratio[0] <= reduction.ratio[1] < math.inf
    # between the horizons at which it is enforced, too
    between = np.geomspace(min(1.0, horizon / 10.0), horizon, 101)
    growth = [predicted_growth(m, between, horizon) for m in (reduction.model, model)]
    slack = 0.97 if model is not FLICKER or horizon > 1.0 else 0.5  # Q is no drift
    assert np.all(growth[0] >= slack * growth[1])


def test_a_model_of_n_and_k_is_not_changed():
    model = ProcessModel(NoiseTerms(N=2e-4, K=3e-6))
    reduction = reduce_model(model)
    assert reduction.model.terms.N == 2e-4
    assert pytest.approx(3e-6) == reduction.model.terms.K
    assert reduction.ratio == pytest.approx((1.0, 1.0))
    assert not reduction.poor


def test_flicker_increases_k_but_not_n():
    reduction = reduce_model(FLICKER)
    assert reduction.model.terms.N == FLICKER.terms.N
    assert reduction.model.terms.K > 10.0 * FLICKER.terms.K
    assert 1.3 < reduction.ratio[1] < 2.0


def test_fast_processes_become_white_noise_if_a_walk_is_a_poor_model():
    reduction = reduce_model(QUICK)
    assert not reduction.poor
    assert pytest.approx(math.hypot(1e-5, 1e-4 * math.sqrt(2 * 0.05))) == reduction.model.terms.N


def test_a_reduction_to_all_processes_is_exact():
    reduction = reduce_model(HUMP, 'processes', 100.0)
    assert reduction.model.gauss_markov == HUMP.gauss_markov
    assert reduction.ratio == pytest.approx((1.0, 1.0))


def test_vibration_is_not_reported_as_drift():
    shaken = ProcessModel(NoiseTerms(N=1e-3), sinusoids=((0.1, 20.0),))
    assert not has_drift(shaken)
    assert reduce_model(shaken).model.terms.K == 0.0
    warming = ProcessModel(NoiseTerms(N=1e-3), sinusoids=((0.1, 1.0 / 1200.0),))
    assert reduce_model(warming).model.terms.K > 0.0


def test_the_walk_covers_a_slow_sinusoid_that_has_no_state():
    warming = ProcessModel(NoiseTerms(N=1e-4), sinusoids=((4e-4, 0.05),))
    reduction = reduce_model(warming, 'processes')
    assert reduction.model.terms.K > 0.0 and reduction.ratio[0] >= 1.0 - 1e-9


def test_a_drift_of_the_size_of_rounding_has_a_closest_process():
    for model in (
        ProcessModel(NoiseTerms(N=1e-3, K=1e-12)),
        ProcessModel(NoiseTerms(N=1.0), ((1e-9, 1e-3),)),
    ):
        found = closest_process(model, 30.0, bound=False)
        assert found is not None and found[0] > 0.0 and math.isfinite(found[0])


def test_a_step_of_zero_is_rejected():
    with pytest.raises(AllanError, match='rate above 0'):
        StateSpace(1.0).transition(0.0)


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
def test_four_processes_have_the_allan_variance_of_flicker(white, limit):
    processes = flicker_processes(2.0, white)
    assert len(processes) == 4
    tau = np.geomspace(3.0, 3000.0, 50)
    ratio = ProcessModel(gauss_markov=processes).avar(tau) / (4.0 * FLICKER_FLOOR)
    assert np.abs(ratio - 1.0).max() < limit
