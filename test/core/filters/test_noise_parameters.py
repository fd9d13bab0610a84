# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""N and K for a filter: as fitted, reduced, as variances, inflated.

Reduced-order models have at least the error growth of the complete model.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from allan_ros.core.errors import AllanError
from allan_ros.core.estimate import Estimate
from allan_ros.core.filters.growth import growth_table
from allan_ros.core.filters.noise_parameters import (
    FilterLevel,
    axis_level,
    closest_process,
    measure_inflation,
    reduce_axis,
    reduce_model,
)
from allan_ros.core.filters.white_variances import white_variances
from allan_ros.core.fit.result import AxisFit, model_of_terms
from allan_ros.core.noise import GaussMarkov, Model, Part
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


def fit_with(**noise: Estimate) -> AxisFit:
    known = {term: noise.get(term, Estimate(None)) for term in 'QNBKR'}
    return AxisFit(known, model_of_terms(known))


def level(term: str, value: float, ci95: tuple[float, float] | None = None) -> FilterLevel:
    return FilterLevel(Estimate(value, ci95, name=term, axis='gyro_x'))


def limit_level(term: str, limit: float) -> FilterLevel:
    return FilterLevel(Estimate(None, None, limit, 'not_observable', name=term, axis='gyro_x'))


def with_process(fit: AxisFit, part: Part) -> AxisFit:
    return replace(fit, model=Model((*fit.model.parts, part)))


def test_a_term_has_its_estimate_or_its_upper_limit() -> None:
    fit = fit_with(K=Estimate(0.0, (0.0, 2e-6), 2e-6, 'not_observable'))
    assert axis_level('gyro_x', fit, 'K') == limit_level('K', 2e-6)
    fit = fit_with(K=Estimate(1e-6, (8e-7, 2e-6), 1.9e-6))
    known = level('K', 1e-6, (8e-7, 2e-6))
    assert axis_level('gyro_x', fit, 'K') == known


@pytest.mark.parametrize('value', [None, 0.0, math.inf, math.nan])
@pytest.mark.parametrize('limit', [None, 0.0, math.inf, math.nan])
@pytest.mark.parametrize('status', ['estimated', 'not_observable'])
def test_no_level_is_ever_zero_negative_or_infinite(
    value: float | None, limit: float | None, status: str
) -> None:
    fit = AxisFit({'N': Estimate(value, None, limit, status)})  # type: ignore[arg-type]
    with pytest.raises(AllanError, match='not even as a limit'):
        axis_level('accel_y', fit, 'N')


def test_the_level_of_a_negative_ramp_is_its_magnitude() -> None:
    fit = AxisFit({'R': Estimate(-4e-7, (-5e-7, -3e-7))})
    assert axis_level('gyro_x', fit, 'R') == level('R', 4e-7, (3e-7, 5e-7))


def resolved(value: float) -> Estimate:
    return Estimate(value, (0.9 * value, 1.2 * value), 1.1 * value)


def hidden(limit: float) -> Estimate:
    return Estimate(None, None, limit, 'not_observable')


def test_the_limit_of_k_is_used_if_no_drift_is_resolved() -> None:
    fit = fit_with(N=resolved(1e-3), B=hidden(1e-4), K=hidden(1e-5), R=hidden(1e-7))
    reduced = reduce_axis('gyro_x', fit)
    assert reduced.levels['K'] == limit_level('K', 1e-5)
    assert pytest.approx(1e-5) == reduced.model.value('K')


def test_limits_are_not_used_if_other_drift_is_resolved() -> None:
    alone = fit_with(N=resolved(1e-3), B=resolved(1e-4))
    with_limits = fit_with(N=resolved(1e-3), B=resolved(1e-4), K=hidden(1e-3), R=hidden(1e-3))
    one, other = (reduce_axis('gyro_x', fit) for fit in (alone, with_limits))
    assert one == other
    assert one.levels['K'].raised_from == 0.0
    assert not one.levels['K'].is_limit


def test_a_k_of_the_model_that_is_not_resolved_is_not_stated_as_measured() -> None:
    unsure = Estimate(1e-6, None, 1e-3, 'not_observable')
    fit = fit_with(N=resolved(1e-3), B=resolved(1e-4), K=resolved(1e-6))
    fit, same = replace(fit, noise={**fit.noise, 'K': unsure}), fit
    one, other = (reduce_axis('gyro_x', each).levels['K'] for each in (fit, same))
    assert one.value == other.value > 1e-6
    assert (one.raised_from, other.raised_from) == (0.0, 1e-6)


def test_fast_drift_becomes_white_noise_and_k_has_its_limit() -> None:
    process = Part(GaussMarkov(0.02), 3e-3, (2e-3, 4e-3), ((0.01, 0.03),))
    fit = with_process(fit_with(N=resolved(1e-3), K=hidden(1e-5)), process)
    reduced = reduce_axis('gyro_x', fit)
    assert reduced.levels['N'].value == pytest.approx(math.hypot(1e-3, 3e-3 * math.sqrt(0.04)))
    assert reduced.levels['N'].raised_from == 1e-3
    assert reduced.levels['K'] == limit_level('K', 1e-5)


def test_a_raised_limit_of_n_stays_a_limit() -> None:
    process = Part(GaussMarkov(0.02), 3e-3, (2e-3, 4e-3), ((0.01, 0.03),))
    fit = with_process(fit_with(N=hidden(1e-3), K=hidden(1e-5)), process)
    white = reduce_axis('gyro_x', fit).levels['N']
    assert white.is_limit and white.raised_from == 1e-3 < white.value
    assert white.interval == (0.0, white.value)


def test_the_predicted_growth_has_an_interval() -> None:
    fit = fit_with(N=resolved(1e-3), B=resolved(1e-4), K=hidden(1e-5), R=hidden(1e-9))
    for growth in growth_table(fit):
        assert growth.std.ci95 is not None and growth.std.value is not None
        low, high = growth.std.ci95
        assert low < growth.std.value < high
    # of white noise, B and K alone, after 100 s: only the limit of K widens it to one side
    assert high / growth.std.value > growth.std.value / low
    assert growth_table(fit_with(N=resolved(1e-3), B=Estimate(1e-4)))[0].std.ci95 is None


def test_a_term_that_is_not_resolved_is_included_with_its_estimate() -> None:
    likely = Estimate(1e-5, None, 3e-5, 'not_observable')
    fit = fit_with(N=resolved(1e-3), B=resolved(1e-6), K=likely)
    last = growth_table(fit)[-1]
    assert last.std.value == pytest.approx(float(fit.model.growth(last.horizon, last.window)))
    assert pytest.approx(1e-5, rel=1e-2) == reduce_axis('gyro_x', fit, 'processes').model.value('K')


def test_the_interval_of_the_reduction_contains_it() -> None:
    fit = fit_with(N=resolved(1e-3), B=resolved(1e-4), K=hidden(1e-6))
    levels = reduce_axis('gyro_x', fit, 'walk', 30.0).levels
    assert levels['N'].interval == pytest.approx((0.9e-3, 1.2e-3))
    low, high = levels['K'].interval
    assert (low, high) == pytest.approx((0.9 * levels['K'].value, 1.2 * levels['K'].value))
    blind = fit_with(N=resolved(1e-3), B=Estimate(1e-4))
    assert reduce_axis('gyro_x', blind).levels['K'].interval == (0.0, math.inf)


def test_white_noise_alone_can_bound_the_growth() -> None:
    axes = {f'gyro_{a}': fit_with(N=resolved(1e-3), B=resolved(1e-4)) for a in 'xyz'}
    (bare,) = white_variances(axes, 100.0).values()
    (wide,) = white_variances(axes, 100.0, horizon=60.0).values()
    assert bare == pytest.approx([1e-4] * 3)
    # h = W = 60 s: flicker alone grows as h B sqrt(4 ln2/pi), N grows as N sqrt(2 h)
    drift = 2.0 * math.log(2.0) / math.pi * 1e-8 * 60.0
    assert wide[0] == pytest.approx(100.0 * (1e-6 + drift), rel=0.02)


def test_the_larger_value_is_used_and_divided_by_the_value_at_rest() -> None:
    def fit(n: float, k: float) -> AxisFit:
        return fit_with(N=Estimate(n), K=Estimate(k))

    rest = {'gyro_x': fit(1e-3, 2e-5), 'gyro_y': fit(1e-3, 1e-5)}
    ((axis, one),) = measure_inflation(rest, {'gyro_x': fit(3e-3, 1e-5)}).items()
    assert axis == 'gyro_x'
    assert (one['N'].limit, one['N'].factor) == pytest.approx((1e-3, 3.0))
    # a smaller K with motors on is due to chance: the value at rest is used
    assert (one['K'].limit, one['K'].factor) == pytest.approx((2e-5, 1.0))
    with pytest.raises(AllanError, match='no axis in common'):
        measure_inflation(rest, {'accel_x': fit(1.0, 1.0)})


def test_white_variances_by_hand() -> None:
    axes = {
        'gyro_x': fit_with(N=Estimate(1e-3)),
        'gyro_y': fit_with(N=Estimate(2e-3)),
        'gyro_z': fit_with(N=hidden(3e-3)),  # the upper limit is used
        'accel_x': fit_with(N=Estimate(1e-2)),
        'accel_y': fit_with(N=Estimate(1e-2)),
    }
    found = white_variances(axes, 200.0)
    assert set(found) == {'gyro'}  # an axis of the accelerometer is missing
    assert found['gyro'] == pytest.approx((2e-4, 8e-4, 1.8e-3))
    assert white_variances(axes, 200.0, 10.0)['gyro'] == pytest.approx((2e-2, 8e-2, 1.8e-1))
    axes['gyro_z'] = fit_with()
    assert white_variances(axes, 200.0) == {}


@pytest.mark.parametrize('model', [FLICKER, HUMP, QUICK], ids=['flicker', 'hump', 'quick'])
@pytest.mark.parametrize('states', ['none', 'walk', 'processes'])
@pytest.mark.parametrize('horizon', [0.5, 30.0, 300.0])
def test_the_growth_is_bounded_from_above(model, states, horizon):
    reduction = reduce_model(model, states, horizon)
    assert 0.97 <= reduction.ratio[0] <= reduction.ratio[1] < math.inf
    # between the horizons at which it is enforced, too
    between = np.geomspace(min(1.0, horizon / 10.0), horizon, 101)
    growth = [m.growth(between, horizon) for m in (reduction.model, model)]
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
