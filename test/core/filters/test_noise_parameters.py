# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Filter parameters of each convention add the variance of the continuous-time noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allan_ros.core.errors import AllanError
from allan_ros.core.filters.growth import (
    growth_table,
    predicted_growth,
)
from allan_ros.core.filters.noise_parameters import (
    NOTATIONS,
    axis_level,
    deviation_at,
    measure_inflation,
    reduce_axis,
    sensor_levels,
    white_variances,
)
from allan_ros.core.filters.reductions import Horizons, Level
from allan_ros.core.fit import AxisFit, Coefficient, GaussMarkov, Processes
from allan_ros.core.fit.model import model_of_terms
from allan_ros.core.noise import NoiseTerms, ProcessModel, term_avar
from allan_ros.core.simulate import simulate_axis

STD = NOTATIONS['std']

levels = st.floats(1e-9, 1e3)
rates = st.floats(0.1, 1e5)
SECONDS = 7.0


@given(n=levels, rate=rates)
def test_steps_of_white_noise_add_up_to_n_squared_t(n: float, rate: float) -> None:
    steps, dt = SECONDS * rate, 1.0 / rate
    # (dt F) Q (dt F)' of FAST-LIO and of autopilots: dt^2 times the variance per step
    assert steps * dt**2 * STD.number(n, rate) ** 2 == pytest.approx(n**2 * SECONDS)


@given(k=levels, rate=rates)
def test_steps_of_a_walk_add_up_to_k_squared_t(k: float, rate: float) -> None:
    steps, dt = SECONDS * rate, 1.0 / rate
    assert steps * (dt * STD.number(k, rate)) ** 2 == pytest.approx(k**2 * SECONDS)


def test_white_std_is_the_std_of_a_simulated_sample() -> None:
    # 4e5 samples: the standard deviation of this estimate is 0.11 %.
    rate, n = 200.0, 1e-3
    samples = simulate_axis(400_000, 1.0 / rate, NoiseTerms(N=n), np.random.default_rng(3))
    assert samples.std() == pytest.approx(STD.number(n, rate), rel=0.005)


def test_white_std_of_k_is_the_rate_of_a_simulated_walk() -> None:
    rate, k = 200.0, 1e-3
    bias = simulate_axis(400_000, 1.0 / rate, NoiseTerms(K=k), np.random.default_rng(4))
    assert (np.diff(bias) * rate).std() == pytest.approx(STD.number(k, rate), rel=0.005)


@given(level=levels, rate=rates, name=st.sampled_from(sorted(NOTATIONS)))
def test_the_level_is_read_back_from_its_number(level: float, rate: float, name: str) -> None:
    one = replace(NOTATIONS[name], factor=3.0)
    assert one.level(one.number(level, rate), rate) == pytest.approx(level, rel=1e-9)


def test_the_deviation_is_that_of_the_model_with_another_n() -> None:
    n, b, tau0, m = 1e-3, 2e-4, 0.01, 1000
    avar = term_avar(np.array([m]), tau0, NoiseTerms(N=n, B=b)).sum()
    found = deviation_at(ProcessModel(NoiseTerms(Q=1.0, N=7.0, B=b)), n, m * tau0)
    assert found == pytest.approx(math.sqrt(avar), rel=1e-9)


def three(*values: float) -> list[Level]:
    return [Level(f'gyro_{a}', 'N', value) for a, value in zip('xyz', values)]


def test_rules_for_three_axes_give_values_computed_by_hand() -> None:
    axes = three(1.0, 5.0, 7.0)
    assert sensor_levels(axes, 'worst') == (axes[2],)
    assert sensor_levels(axes, 'each') == tuple(axes)
    (mean,) = sensor_levels([replace(a, ci95=(0.9 * a.value, 2.0 * a.value)) for a in axes], 'mean')
    assert (mean.value, mean.interval) == (5.0, (pytest.approx(4.5), 10.0))  # sqrt(75 / 3)
    assert sensor_levels(axes, 'mean')[0].interval == (0.0, math.inf)


def fit_with(**noise: Coefficient) -> AxisFit:
    known = {term: noise.get(term, Coefficient(None)) for term in 'QNBKR'}
    return AxisFit(known, model_of_terms(known))


def with_process(fit: AxisFit, process: GaussMarkov) -> AxisFit:
    model = replace(fit.model, gauss_markov=((process.sigma, process.correlation_time),))
    return replace(fit, model=model, processes=Processes((process,)))


def test_a_term_that_is_not_resolved_has_its_upper_limit() -> None:
    fit = fit_with(K=Coefficient(0.0, (0.0, 2e-6), 2e-6, 'not_observable'))
    assert axis_level('gyro_x', fit, 'K') == Level('gyro_x', 'K', 2e-6, None, True)
    with pytest.raises(AllanError, match=r'K of gyro_x is not observable .below 2e-06.*--strict'):
        axis_level('gyro_x', fit, 'K', strict=True)


def test_a_resolved_term_has_its_estimate() -> None:
    fit = fit_with(K=Coefficient(1e-6, (8e-7, 2e-6), 1.9e-6))
    assert axis_level('gyro_x', fit, 'K', strict=True) == Level(
        'gyro_x', 'K', 1e-6, (8e-7, 2e-6), False
    )


@pytest.mark.parametrize('value', [None, 0.0, -1e-9, math.inf, math.nan])
@pytest.mark.parametrize('limit', [None, 0.0, math.inf, math.nan])
@pytest.mark.parametrize('status', ['estimated', 'not_observable'])
def test_no_level_is_ever_zero_negative_or_infinite(
    value: float | None, limit: float | None, status: str
) -> None:
    fit = AxisFit({'N': Coefficient(value, None, limit, status)})  # type: ignore[arg-type]
    with pytest.raises(AllanError, match='neither a value nor a limit'):
        axis_level('accel_y', fit, 'N')


def resolved(value: float) -> Coefficient:
    return Coefficient(value, (0.9 * value, 1.2 * value), 1.1 * value)


def hidden(limit: float) -> Coefficient:
    return Coefficient(None, None, limit, 'not_observable')


def test_the_limit_of_k_is_used_if_no_drift_is_resolved() -> None:
    fit = fit_with(N=resolved(1e-3), B=hidden(1e-4), K=hidden(1e-5), R=hidden(1e-7))
    reduced = reduce_axis('gyro_x', fit)
    assert reduced.levels['K'] == Level('gyro_x', 'K', 1e-5, is_limit=True)
    assert reduced.walk == pytest.approx(1e-5)
    with pytest.raises(AllanError, match='K of gyro_x is not observable'):
        reduce_axis('gyro_x', fit, strict=True)


def test_limits_are_not_used_if_other_drift_is_resolved() -> None:
    alone = fit_with(N=resolved(1e-3), B=resolved(1e-4))
    with_limits = fit_with(N=resolved(1e-3), B=resolved(1e-4), K=hidden(1e-3), R=hidden(1e-3))
    one, other = (reduce_axis('gyro_x', fit) for fit in (alone, with_limits))
    assert one == other
    assert one.levels['K'].raised_from == 0.0
    assert not one.levels['K'].is_limit


def test_fast_drift_becomes_white_noise_and_k_has_its_limit() -> None:
    process = GaussMarkov(3e-3, (2e-3, 4e-3), 0.02, (0.01, 0.03))
    fit = with_process(fit_with(N=resolved(1e-3), K=hidden(1e-5)), process)
    reduced = reduce_axis('gyro_x', fit)
    assert reduced.levels['N'].value == pytest.approx(math.hypot(1e-3, 3e-3 * math.sqrt(0.04)))
    assert reduced.levels['N'].raised_from == 1e-3
    assert reduced.levels['K'] == Level('gyro_x', 'K', 1e-5, is_limit=True)


def test_a_raised_limit_of_n_stays_a_limit() -> None:
    process = GaussMarkov(3e-3, (2e-3, 4e-3), 0.02, (0.01, 0.03))
    fit = with_process(fit_with(N=hidden(1e-3), K=hidden(1e-5)), process)
    level = reduce_axis('gyro_x', fit).levels['N']
    assert level.is_limit and level.raised_from == 1e-3 < level.value
    assert level.interval == (0.0, level.value)


def test_the_predicted_growth_has_an_interval() -> None:
    fit = fit_with(N=resolved(1e-3), B=resolved(1e-4), K=hidden(1e-5), R=hidden(1e-9))
    for growth in growth_table(fit):
        assert growth.ci95 is not None
        low, high = growth.ci95
        assert low < growth.std < high
    # of white noise, B and K alone, after 100 s: only the limit of K widens it to one side
    assert high / growth.std > growth.std / low
    assert growth_table(fit_with(N=resolved(1e-3), B=Coefficient(1e-4)))[0].ci95 is None
    # twice integrated white noise with a known bias: N sqrt(h^3/3), plus the error of the bias
    # over 100 s, N / sqrt(100) h^2 / 2
    white = growth_table(fit_with(N=resolved(1e-3)), integrals=2)[1]
    assert white.std == pytest.approx(1e-3 * math.hypot(math.sqrt(1000.0 / 3.0), 5.0))


def test_a_term_that_is_not_resolved_is_included_with_its_estimate() -> None:
    likely = Coefficient(1e-5, None, 3e-5, 'not_observable')
    fit = fit_with(N=resolved(1e-3), B=resolved(1e-6), K=likely)
    last = growth_table(fit)[-1]
    assert last.std == pytest.approx(float(predicted_growth(fit.model, last.horizon, last.window)))
    assert reduce_axis('gyro_x', fit, 'processes').walk == pytest.approx(1e-5, rel=1e-2)


def test_the_interval_of_the_reduction_contains_it() -> None:
    fit = fit_with(N=resolved(1e-3), B=resolved(1e-4), K=hidden(1e-6))
    levels = reduce_axis('gyro_x', fit, 'walk', Horizons.up_to(30.0)).levels
    assert levels['N'].interval == pytest.approx((0.9e-3, 1.2e-3))
    low, high = levels['K'].interval
    assert (low, high) == pytest.approx((0.9 * levels['K'].value, 1.2 * levels['K'].value))
    blind = fit_with(N=resolved(1e-3), B=Coefficient(1e-4))
    assert reduce_axis('gyro_x', blind).levels['K'].interval == (0.0, math.inf)


def test_white_noise_alone_can_bound_the_growth() -> None:
    axes = {f'gyro_{a}': fit_with(N=resolved(1e-3), B=resolved(1e-4)) for a in 'xyz'}
    (bare,) = white_variances(axes, 100.0).values()
    (wide,) = white_variances(axes, 100.0, horizon=60.0).values()
    assert bare == pytest.approx([1e-4] * 3)
    # h = W = 60 s: the growth of flicker alone is h B sqrt(4 ln2/pi), that of N is N sqrt(2 h)
    drift = 2.0 * math.log(2.0) / math.pi * 1e-8 * 60.0
    assert wide[0] == pytest.approx(100.0 * (1e-6 + drift), rel=0.02)


def fit_of_n_and_k(n: float, k: float) -> AxisFit:
    noise = {term: Coefficient(None, None, 1e-9, 'not_observable') for term in 'QBR'}
    noise |= {'N': Coefficient(n), 'K': Coefficient(k)}
    return AxisFit(noise, model_of_terms(noise))


def test_the_larger_value_is_used_and_divided_by_the_value_at_rest() -> None:
    rest = {'gyro_x': fit_of_n_and_k(1e-3, 2e-5), 'gyro_y': fit_of_n_and_k(1e-3, 1e-5)}
    running = {'gyro_x': fit_of_n_and_k(3e-3, 1e-5)}
    ((axis, one),) = measure_inflation(rest, running).items()
    assert axis == 'gyro_x'
    assert (one.white.use, one.white.factor) == pytest.approx((3e-3, 3.0))
    # a smaller K with motors on is due to chance: the value at rest is used
    assert (one.walk.use, one.walk.factor) == pytest.approx((2e-5, 1.0))


def test_fits_without_a_common_axis_are_rejected() -> None:
    with pytest.raises(AllanError, match='no axis in common'):
        measure_inflation(
            {'gyro_x': fit_of_n_and_k(1.0, 1.0)}, {'accel_x': fit_of_n_and_k(1.0, 1.0)}
        )
