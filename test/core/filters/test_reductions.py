# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reductions have at least the error growth of the complete model; the discrete matrices are
exact.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from allan_ros.core.filters.growth import predicted_growth
from allan_ros.core.filters.reductions import closest_process, reduce_model
from allan_ros.core.noise import GaussMarkov, Model
from allan_ros.core.noise.processes.sinusoid import Sinusoid

DEG = math.pi / 180.0
FLICKER = Model.of(
    Q=1e-7,
    N=0.168 * DEG / 60,
    B=4.97 * DEG / 3600,
    K=8.2 * DEG / 3600**1.5,
    R=11.0 * DEG / 3600**2,
)
HUMP = Model.of(
    (9.0 * DEG / 3600, GaussMarkov(3.0)),
    (6.0 * DEG / 3600, GaussMarkov(30.0)),
    (6.0 * DEG / 3600, GaussMarkov(300.0)),
    N=0.242 * DEG / 60,
)
QUICK = Model.of((1e-4, GaussMarkov(0.05)), N=1e-5, K=1e-9)


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
    model = Model.of(N=2e-4, K=3e-6)
    reduction = reduce_model(model)
    assert reduction.model.value('N') == 2e-4
    assert pytest.approx(3e-6) == reduction.model.value('K')
    assert reduction.ratio == pytest.approx((1.0, 1.0))
    assert not reduction.poor


def test_flicker_increases_k_but_not_n():
    reduction = reduce_model(FLICKER)
    assert reduction.model.value('N') == FLICKER.value('N')
    assert reduction.model.value('K') > 10.0 * FLICKER.value('K')
    assert 1.3 < reduction.ratio[1] < 2.0


def test_fast_processes_become_white_noise_if_a_walk_is_a_poor_model():
    reduction = reduce_model(QUICK)
    assert not reduction.poor
    assert pytest.approx(math.hypot(1e-5, 1e-4 * math.sqrt(2 * 0.05))) == reduction.model.value('N')


def test_a_reduction_to_all_processes_is_exact():
    reduction = reduce_model(HUMP, 'processes', 100.0)
    assert reduction.model['gauss_markov'] == HUMP['gauss_markov']
    assert reduction.ratio == pytest.approx((1.0, 1.0))


def test_vibration_is_not_reported_as_drift():
    shaken = Model.of((0.1, Sinusoid(20.0)), N=1e-3)
    assert not shaken.has_drift
    assert reduce_model(shaken).model.value('K') == 0.0
    warming = Model.of((0.1, Sinusoid(1.0 / 1200.0)), N=1e-3)
    assert reduce_model(warming).model.value('K') > 0.0


def test_the_walk_covers_a_slow_sinusoid_that_has_no_state():
    warming = Model.of((4e-4, Sinusoid(0.05)), N=1e-4)
    reduction = reduce_model(warming, 'processes')
    assert reduction.model.value('K') > 0.0 and reduction.ratio[0] >= 1.0 - 1e-9


def test_a_drift_of_the_size_of_rounding_has_a_closest_process():
    for model in (
        Model.of(N=1e-3, K=1e-12),
        Model.of((1e-9, GaussMarkov(1e-3)), N=1.0),
    ):
        found = closest_process(model, GaussMarkov, 30.0, bound=False)
        assert found is not None and found[0] > 0.0 and math.isfinite(found[0])
