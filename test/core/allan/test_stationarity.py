# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stationarity tests: a warm-up is found and left out, noise of any kind is not."""

import re

import numpy as np
import pytest
from support.drift import AXES, DEG_H, NOISE, SECONDS, SENSORS, sums_of_noise

from allan_ros.core.allan.engine import RunningAllan
from allan_ros.core.allan.likelihood import CellMeans, variance_model
from allan_ros.core.allan.stationarity import EarlyPart, bias_steps, early_parts
from allan_ros.core.fit import stationary
from allan_ros.core.fit.stationary import CERTAIN_EXCESS, fit_stationary
from allan_ros.core.noise import NoiseTerms
from allan_ros.core.simulate import simulate_axis


def parts_of(sums):
    return early_parts(sums.history.recordings[0], SENSORS)


def test_covariance_of_the_means_is_that_of_simulated_noise():
    """Four sigma of 400 draws of each variance: chance below 1 % for all."""
    rng = np.random.default_rng(0)
    begin = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0])
    end = np.array([1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0])
    model = variance_model(CellMeans(begin, end, np.zeros((7, 0))))
    for unit, terms in zip(model.units, (NoiseTerms(N=1.0), NoiseTerms(B=1.0), NoiseTerms(K=1.0))):
        draws = []
        for _ in range(400):
            fine = simulate_axis(20 * 64, 1 / 64, terms, rng).reshape(20, 64).mean(axis=1)
            means = [fine[int(a) : int(b)].mean() for a, b in zip(begin, end)]
            draws.append(model.contrasts @ means)
        measured = np.mean(np.square(draws), axis=0)
        assert measured == pytest.approx(np.diag(unit), rel=4 * np.sqrt(2 / 400))


@pytest.mark.parametrize(
    'terms', [NOISE, NoiseTerms(N=NOISE.N), NoiseTerms(N=NOISE.N, K=32 * DEG_H / 60)]
)
def test_stationary_noise_has_no_early_part(terms):
    """One false alarm in 200 recordings by design: probability of one in 12 below 6 %; seeds
    fixed.
    """
    assert not any(parts_of(sums_of_noise(terms, seed)) for seed in range(4))


@pytest.mark.parametrize('decay', [120.0, 300.0])
def test_a_warm_up_is_found_with_its_duration(decay):
    t = np.arange(SECONDS)
    sums = sums_of_noise(NOISE, 1, early=100 * DEG_H * np.exp(-t / decay))
    parts = parts_of(sums)
    assert parts[0].kind == 'warm_up' and parts[0].decay == pytest.approx(decay, rel=0.6)
    assert parts[0].amplitudes[0] == pytest.approx(100 * DEG_H, rel=0.5)
    assert decay < parts[-1].age < 8 * decay


def test_larger_early_drift_is_found():
    walk = np.cumsum(np.random.default_rng(2).normal(size=900)) * 1.0 * DEG_H * 3
    early = np.concatenate([walk, np.full(SECONDS - 900, walk[-1])])
    assert parts_of(sums_of_noise(NOISE, 3, early=early))


def test_the_settled_part_is_fitted_and_both_values_are_stated():
    t = np.arange(SECONDS)
    sums = sums_of_noise(NOISE, 4, early=300 * DEG_H * np.exp(-t / 200))
    used, model = fit_stationary(sums)
    assert 0.5 * sums.samples <= used.samples < sums.samples
    (found,) = (f for f in model.findings if f.id == 'settled_part')
    assert 'in all data' in found.message and 'warm-up' in found.message
    assert not re.search(r' [0-9.e+-]+ after', found.message)  # each value has its unit
    assert model.axes['gyro_x'].noise['K'].status == 'not_observable'
    everything, _ = fit_stationary(sums, settle=False)
    assert everything is sums


@pytest.mark.parametrize('rate', [1.0, 200.0])
def test_a_short_warm_up_is_left_out_if_a_coefficient_changes(rate):
    """A warm-up of 30 s in 2 h, and the same samples as a recording of 36 s."""
    early = 1000 * DEG_H * np.exp(-np.arange(SECONDS) / 30.0)
    sums = sums_of_noise(NOISE, 6, early=early, rate=rate)
    used, model = fit_stationary(sums)
    assert used.samples < sums.samples
    (found,) = (f for f in model.findings if f.id == 'settled_part')
    assert 'warm-up' in found.message or 'drift' in found.message


def test_an_early_part_of_a_short_recording_that_changes_no_coefficient_is_not_reported(
    monkeypatch,
):
    part = EarlyPart('warm_up', (0,), np.zeros(3), 100.0, 2 * CERTAIN_EXCESS, 600)
    monkeypatch.setattr(stationary, 'early_parts', lambda *_: (part,))
    for rate, reported in ((1.0, True), (200.0, False)):
        sums = sums_of_noise(NOISE, 1, rate=rate)
        used, model = fit_stationary(sums)
        assert (used is not sums) == reported
        assert any(f.id == 'settled_part' for f in model.findings) == reported


def test_only_axes_with_a_warm_up_are_reported():
    """A warm-up of one axis is far above every threshold; the noise of the others is not."""
    engine = RunningAllan(axes=AXES)
    rng = np.random.default_rng(1)
    y = np.stack([simulate_axis(SECONDS, 1.0, NOISE, rng) for _ in AXES], axis=1)
    y[:, 1] += 3000 * DEG_H * np.exp(-np.arange(SECONDS) / 300.0)
    engine.update(y, 0, (SECONDS - 1) * 10**9)
    engine.end_segment()
    assert parts_of(engine.sums)[0].axes == (1,)


def test_a_warm_up_of_the_complete_recording_is_reported():
    t = np.arange(SECONDS)
    sums = sums_of_noise(NOISE, 5, early=1000 * DEG_H * np.exp(-t / 1500))
    used, model = fit_stationary(sums)
    assert used is sums
    assert any(f.id == 'warm_up' for f in model.findings)


def test_constant_and_short_recordings_are_not_tested():
    engine = RunningAllan(axes=AXES)
    engine.update(np.ones((5000, 3)), 0, 4999 * 10**9)
    assert parts_of(engine.sums) == ()
    engine = RunningAllan(axes=AXES)
    engine.update(np.random.default_rng(0).normal(size=(20, 3)), 0, 19 * 10**9)
    assert parts_of(engine.sums) == ()


def test_steps_of_the_bias_are_found_where_they_are():
    steps = np.zeros(36_000)
    for at, size in ((5000, 60), (13_000, -40), (27_000, 50)):
        steps[at:] += size * DEG_H
    sums = sums_of_noise(NOISE, 6, 36_000, steps)
    found = bias_steps(sums.history.recordings[0])
    assert [each.axis for each in found] == [0, 1, 2]
    for each in found:
        assert len(each.ages) >= 3
        for at in (5000, 13_000, 27_000):
            assert min(abs(age - at) for age in each.ages) < 500
        assert each.walk_after < 0.5 * each.walk_before
    _, model = fit_stationary(sums)
    named = [f for f in model.findings if f.id == 'bias_steps']
    assert len(named) == 3 and 'deg/h' in named[0].message


def test_a_change_of_the_bias_between_segments_does_not_affect_k():
    """No coefficient includes a change between segments, such as a restart, so K does not
    include it.
    """
    rng, engine = np.random.default_rng(2), RunningAllan(axes=AXES)
    for first, bias in ((0, 0.0), (20_000, 400 * DEG_H)):
        y = np.stack([simulate_axis(18_000, 1.0, NOISE, rng) for _ in AXES], axis=1) + bias
        engine.update(y, first * 10**9, (first + 17_999) * 10**9)
        engine.end_segment()
    _, model = fit_stationary(engine.sums)
    found = {f.id for f in model.findings}
    assert 'bias_differs' in found and 'bias_steps' not in found


def test_steps_are_not_searched_in_a_recording_of_many_short_segments():
    """All pairs of intervals had too few samples, which ended in a LinAlgError."""
    engine = RunningAllan(axes=('gyro_x',))
    rng = np.random.default_rng(3)
    for begin in range(0, 200 * 32, 32):
        y = rng.normal(size=(9, 1)) + 5.0 * (begin > 3200)
        engine.update(y, begin * 10**9, (begin + 8) * 10**9)
        engine.end_segment()
    recording = engine.sums.history.recordings[0]
    assert len(CellMeans.even(recording, 512).begin) >= 24
    assert bias_steps(recording) == ()


def test_a_random_walk_has_no_steps():
    """0.05 % of such axes are false alarms by design: probability of one in 9 below 0.5 %; seeds
    fixed.
    """
    terms = NoiseTerms(N=NOISE.N, K=32 * DEG_H / 60)
    for seed in range(3):
        assert bias_steps(sums_of_noise(terms, 10 + seed).history.recordings[0]) == ()


def test_a_warm_up_on_a_gyro_with_all_five_terms_can_be_fitted():
    """The short averages are excluded from this fit, but not from its table."""
    per_hour = DEG_H / 60
    terms = NoiseTerms(N=NOISE.N, B=NOISE.B, K=31.8 * per_hour, R=76.2 * DEG_H / 3600)
    early = 100 * DEG_H * np.exp(-np.arange(SECONDS) / 300.0)
    for seed in (7, 40):
        _, model = fit_stationary(sums_of_noise(terms, seed, early=early))
        assert model.axes['gyro_x'].noise['N'].value == pytest.approx(terms.N, rel=0.05)


@pytest.mark.parametrize('seed', [0, 4])
def test_a_certain_warm_up_is_left_out_even_if_every_coefficient_stays_in_its_interval(seed):
    """None of 156 warm-ups was missed: chance of a miss below 2 % each; seeds fixed."""
    early = 100 * DEG_H * np.exp(-np.arange(28_800) / 300.0)
    sums = sums_of_noise(NOISE, seed, 28_800, early)
    used, model = fit_stationary(sums)
    assert used.samples < sums.samples
    (found,) = (f for f in model.findings if f.id == 'settled_part')
    assert found.axes and 'in all data' in found.message


@pytest.mark.parametrize('axis', [0, 1, 2])
def test_the_finding_names_the_axis_on_which_the_early_part_differs(axis, monkeypatch):
    """No coefficient changes beyond its interval in these sums, on any axis."""
    part = EarlyPart('warm_up', (axis,), np.zeros(3), 100.0, 2 * CERTAIN_EXCESS, 600)
    monkeypatch.setattr(stationary, 'early_parts', lambda *_: (part,))
    _, model = fit_stationary(sums_of_noise(NOISE, 1))
    (found,) = (f for f in model.findings if f.id == 'settled_part')
    assert found.axes == (AXES[axis],)
