# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Estimate of the bias at rest, and coverage of its interval."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest

from allan_ros.core.allan.at_rest import turn_on_bias
from allan_ros.core.errors import AllanError
from allan_ros.core.estimate import Estimate
from allan_ros.core.filters.bias import (
    BiasFilter,
    BiasModel,
    BiasTracker,
)
from allan_ros.core.fit.result import AxisFit
from allan_ros.core.noise import Model
from allan_ros.core.simulator import simulate_axis

DEG = math.pi / 180.0
HOUR_BIAS = DEG / 3600
TERMS = Model.of(
    N=0.242 * DEG / 60, B=5.24 * HOUR_BIAS, K=31.8 * DEG / 3600**1.5, R=76.2 * DEG / 3600**2
)
MODEL = BiasModel(TERMS, TERMS.value('R'))


def test_the_interval_covers_the_present_and_the_future_bias():
    """Of 156 nearly independent intervals (12 records of 1 h), 88 to 99 % contain the bias.

    The number is binomial with 95 %: the false-alarm probability is 1e-3.
    """
    rng = np.random.default_rng(4)
    hits: dict[int, list[bool]] = {0: [], 60: [], 600: []}
    for _ in range(12):
        drift = Model.of(B=TERMS.value('B'), K=TERMS.value('K'), R=TERMS.value('R'))
        bias = simulate_axis(36_000, 0.1, drift, rng) + rng.normal(0.0, 100.0 * HOUR_BIAS)
        means = bias.reshape(-1, 10).mean(axis=1)
        noisy = means + TERMS.value('N') * rng.normal(size=len(means))
        tracker = BiasFilter(MODEL)
        for k, mean in enumerate(noisy, 1):
            tracker.update(float(mean))
            if k >= 300 and k % 200 == 0 and k + 610 <= len(means):
                for after, hit in hits.items():
                    later = copy.deepcopy(tracker)
                    later.pause(after)
                    low, high = later.estimate().ci95
                    hit.append(low < means[k + after : k + after + 10].mean() < high)
    for hit in hits.values():
        assert len(hit) == 156
        assert 0.88 < np.mean(hit) < 0.99


def fit_with_ramp(ramp: Estimate) -> AxisFit:
    return AxisFit({**{t: Estimate(TERMS.value(t)) for t in 'QNBK'}, 'R': ramp})


def test_a_ramp_that_is_not_resolved_widens_the_interval():
    # an estimate of 1e-8 and a limit of 1e-8 + 1.96 * 3e-8
    hidden = Estimate(1e-8, None, 1e-8 + 1.96 * 3e-8, 'not_observable')
    model = BiasModel.of_fit(fit_with_ramp(hidden))
    assert model.slope_std == pytest.approx(math.hypot(1e-8, 3e-8), rel=1e-6)
    assert model.processes.value('R') == 0.0
    without = BiasModel(model.processes)
    stds = []
    for one in (model, without):
        tracker = BiasFilter(one)
        for _ in range(1200):
            tracker.update(0.0)
        tracker.pause(600.0)
        stds.append(tracker.estimate().std)
    assert stds[0] > 1.01 * stds[1], stds


def test_the_slope_prior_follows_from_the_interval_of_the_ramp():
    resolved = Estimate.normal(1e-7, 2e-8)
    assert BiasModel.of_fit(fit_with_ramp(resolved)).slope_std == pytest.approx(1.02e-7, rel=1e-3)
    vague = BiasModel.of_fit(fit_with_ramp(Estimate(1e-7)))
    assert vague.slope_std > 100.0 * 1e-7
    for nothing in (Estimate(None, None, None, 'not_observable'), Estimate(0.0)):
        assert BiasModel.of_fit(fit_with_ramp(nothing)).slope_std == 0.0


def test_white_noise_averages_out_and_a_pause_widens_the_interval():
    tracker = BiasFilter(BiasModel(Model.of(N=1.0)))
    with pytest.raises(AllanError, match='at rest for a second'):
        tracker.estimate()
    for _ in range(100):
        tracker.update(3.0)
    estimate = tracker.estimate()
    assert (estimate.value, estimate.std) == pytest.approx((3.0, 0.1), rel=0.01)
    tracker.pause(1500.0)
    assert tracker.estimate().std == pytest.approx(0.1, rel=0.01)
    drifting = BiasFilter(MODEL)
    for _ in range(300):
        drifting.update(1e-4)
    before = drifting.estimate()
    drifting.pause(120.0)
    assert drifting.estimate().std > 1.1 * before.std


@pytest.mark.parametrize('step, within', [(5.0, 10), (1.5, 40)])
def test_a_step_of_the_bias_is_followed_at_once(step: float, within: int):
    """Without a restart, the mean of all data follows within hours: a filter would diverge."""
    rng = np.random.default_rng(3)
    bias = BiasFilter(BiasModel(Model.of(N=1.0)))
    for mean in rng.normal(0.0, 1.0, 3600):
        bias.update(mean)
    assert bias.estimate().std < 0.02  # no restart on constant bias
    for mean in rng.normal(step, 1.0, within):
        bias.update(mean)
    low, high = bias.estimate().ci95
    assert low < step < high < step + 1.5


def test_after_a_step_the_bias_follows_only_from_the_later_means() -> None:
    model = BiasModel(Model.of(N=0.1, B=0.02, K=1e-4), slope_std=1e-4)
    bias, fresh = BiasFilter(model), BiasFilter(model)
    for mean in np.random.default_rng(0).normal(0.0, 0.1, 60).tolist():
        bias.update(mean)
    for mean in (5.0, 5.1):
        bias.update(mean)
        fresh.update(mean)
        assert bias.estimate() == fresh.estimate()


def test_a_tracker_estimates_the_bias_of_an_axis_with_the_current_model() -> None:
    tracker = BiasTracker()
    ends = [10**18 + 10**9 * i for i in range(1, 301)]
    noise = TERMS.value('N') * np.random.default_rng(5).normal(size=300)
    values = (2.0 * HOUR_BIAS + noise).tolist()
    tracker.add_means('gyro_x', ends, values)
    assert tracker.bias('gyro_x') is None  # no model yet
    tracker.set_models({'gyro_x': MODEL})
    direct = BiasFilter(MODEL)
    for value in values:
        direct.update(value)
    found = tracker.bias('gyro_x')
    assert found is not None
    assert found == direct.estimate()
    assert tracker.end_ns == ends[-1]
    tracker.add_means('gyro_x', ends[-10:], values[-10:])  # skipped: already added
    assert tracker.bias('gyro_x') == found
    tracker.add_means('gyro_x', [ends[-1] + 61 * 10**9], [values[0]])
    direct.pause(60.0)
    direct.update(values[0])
    after = tracker.bias('gyro_x')
    assert after is not None
    assert after.value == pytest.approx(direct.estimate().value)
    assert after.std == pytest.approx(direct.estimate().std)
    tracker.add_means('gyro_x', [5 * 10**9], [1.0])  # an earlier time: the means are removed
    restarted = tracker.bias('gyro_x')
    assert restarted is not None and restarted.value == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize('noise', [0.0, 1.0])
def test_the_interval_of_the_turn_on_bias_covers_its_std(noise: float) -> None:
    # 1900 +- 9.7 of 2000 intervals: the false-alarm probability is 4e-5 (4.1 standard deviations)
    rng = np.random.default_rng(9)
    hits = 0
    for means in rng.normal(3.0, math.hypot(2.0, noise), size=(2000, 5)):
        found = turn_on_bias(means, noise**2)
        assert found is not None
        low, high = found.scatter.ci95 or (0.0, found.scatter.upper95 or 0.0)
        hits += low < 2.0 < high
    assert 1860 <= hits <= 1940
    assert turn_on_bias(np.array([1.0])) is None


def test_noise_alone_is_no_turn_on_bias() -> None:
    # 1 % of 2000 +- 4.4: 4 standard deviations
    means = np.random.default_rng(10).normal(3.0, 2.0, size=(2000, 5))
    found = [turn_on_bias(each, 4.0) for each in means]
    assert sum(one is not None and one.scatter.resolved for one in found) <= 38
    limits = [one.scatter.upper95 for one in found if one is not None]
    assert None in limits and all(limit is None or limit > 0.0 for limit in limits)
