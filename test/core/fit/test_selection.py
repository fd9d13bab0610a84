# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Truth of simulated records. All seeds are fixed; each false-alarm probability is stated."""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, lfilter
from support.sums import sums_of

from allan_ros.core.fit.candidates import Candidates
from allan_ros.core.fit.frequency_range import estimate
from allan_ros.core.fit.likelihood import AxisData
from allan_ros.core.fit.selection import Selection
from allan_ros.core.fit.stationary import fit_likelihood
from allan_ros.core.fit.statistics import statistics
from allan_ros.core.imu import AXES
from allan_ros.core.noise import RANDOM_TERMS, Model
from allan_ros.core.noise.processes.sinusoid import Sinusoid
from allan_ros.core.simulator import simulate_axis

RATE = 100.0
TAU0 = 1.0 / RATE
TRUTH = Model.of(N=1e-3, B=2e-4, K=4e-5)
FLAT = Model.of(N=1e-3, B=5e-5)
WHITE = FLAT.value('N') * math.sqrt(RATE)  # standard deviation of a sample


def simulated(n, axes, seed, terms=TRUTH):
    rng = np.random.default_rng(seed)
    return np.stack([simulate_axis(n, TAU0, terms, rng) for _ in range(axes)], axis=1)


def fits(y, cuts=()):
    axes = tuple(f'gyro_{i}' for i in range(y.shape[1]))
    return list(fit_likelihood(sums_of(y, cuts=cuts, axes=axes)).axes.values())


@pytest.fixture(scope='module')
def twelve():
    return fits(simulated(60_000, 12, 1))


@pytest.mark.parametrize('term', ['N', 'B', 'K'])
def test_the_truth_lies_within_its_interval(twelve, term):
    """At least 9 of 12: with 95 % intervals, fewer have a probability of 0.2 % (at 91 %, 1.8 %)."""
    truth, found = TRUTH.value(term), [fit.noise[term] for fit in twelve]
    ends = [c.ci95 or (0.0, c.upper95) for c in found]
    assert sum(low <= truth <= high for low, high in ends) >= 9


def test_n_is_unbiased(twelve):
    """The mean of 12 is within four of its standard errors (0.3 % each): 6e-5."""
    off = np.array([fit.noise['N'].value for fit in twelve]) / TRUTH.value('N') - 1.0
    assert abs(off.mean()) < 4.0 * 0.003 / math.sqrt(12)


def test_clean_records_get_no_process_and_no_filter(twelve):
    """A false process or filter in 1 % of the axes: more than one of 12 has 0.6 %."""
    assert sum(bool(fit.model.shaped.parts) for fit in twelve) <= 1
    assert sum(fit.filtered or bool(fit.lack_of_fit) for fit in twelve) <= 1


def test_segments_are_fitted_together():
    y = simulated(60_000, 4, 2, FLAT)
    whole, cut = fits(y), fits(y + np.repeat([[0.0], [1.0], [-2.0]], 20_000, 0), (20_000, 40_000))
    for a, b in zip(whole, cut):
        assert b.noise['N'].value == pytest.approx(a.noise['N'].value, rel=5e-3)


def sine(n, frequency, rng, axes):
    t = np.arange(n)[:, None] * TAU0
    return np.sin(2.0 * np.pi * (frequency * t + rng.uniform(size=axes)))


@pytest.mark.parametrize(
    ('size', 'frequency'),
    [(0.5, 16.5), (5.0, 4.71), (30.0, 7.216), (30.0, 16.12), (30.0, 24.5965), (300.0, 20.3)],
)
def test_a_sinusoid_is_the_only_process_and_does_not_change_n(size, frequency):
    """N within 1.5 % (over five standard errors). The aliases of a strong sinusoid in averages and
    its power in bins far from it are no processes.
    """
    rng = np.random.default_rng(2)
    y = simulated(120_000, 3, 2, FLAT) + size * WHITE * sine(120_000, frequency, rng, 3)
    for fit in fits(y):
        (line,) = fit.model['sinusoid']
        assert line.process.frequency == pytest.approx(frequency, rel=2e-3)
        assert line.value == pytest.approx(size * WHITE, rel=0.1)
        assert fit.noise['N'].value == pytest.approx(FLAT.value('N'), rel=0.015)
        assert not fit.filtered and len(fit.model.shaped.parts) == 1


def test_three_sinusoids_are_not_taken_for_a_filter():
    """Each axis has the three sinusoids and the right N."""
    rng = np.random.default_rng(6)
    y = simulated(300_000, 3, 6, FLAT)
    for size, frequency in ((5.0, 14.73), (2.0, 4.71), (0.5, 9.42)):
        y += size * WHITE * sine(300_000, frequency, rng, 3)
    for fit in fits(y):
        found = [line.process.frequency for line in fit.model['sinusoid']]
        np.testing.assert_allclose(found, [4.71, 9.42, 14.73], atol=0.05)
        assert not fit.filtered
        assert fit.noise['N'].value == pytest.approx(FLAT.value('N'), rel=0.015)


def three_sinusoids(samples=60_000):
    y = simulated(samples, 1, 6, FLAT)
    for size, frequency in ((5.0, 14.73), (2.0, 4.71), (0.5, 9.42)):
        y += size * WHITE * sine(samples, frequency, np.random.default_rng(6), 1)
    return AxisData.of(known := statistics(sums_of(y)), 0), Candidates(known)


def test_a_false_alarm_of_the_test_for_filters_keeps_the_sinusoids(monkeypatch):
    """With this threshold, every model looks low-pass filtered."""
    monkeypatch.setattr('allan_ros.core.fit.frequency_range.CURVATURE', -10.0)
    result = estimate(*three_sinusoids())
    assert result.top == 0.5 and [c.name for c in result.fit.components[4:]] == 3 * ['sinusoid']


def test_bins_have_full_weight_again_when_no_sinusoid_remains(monkeypatch):
    data, candidates = three_sinusoids()
    monkeypatch.setattr(
        Selection, 'without_superfluous', lambda rules, fit: rules.fit(RANDOM_TERMS)
    )
    rules, fit = Selection(data, candidates).selected()
    assert np.array_equal(rules.data.dof, data.dof)
    assert fit.value == pytest.approx(data.solve(RANDOM_TERMS).value, rel=1e-4)


def test_a_wandering_frequency_changes_neither_n_nor_its_interval():
    """A disturbance of 11 to 15 mHz, 20 times the noise: N within 2 %, interval of .5 to 5 %."""
    n = 120_000
    t = np.arange(n) * TAU0
    phase = 2.0 * math.pi * TAU0 * np.cumsum(0.013 + 0.002 * np.sin(2.0 * math.pi * t / 600.0))
    y = simulated(n, 3, 17, FLAT) + 20.0 * FLAT.value('N') * np.sin(phase)[:, None]
    for fit in fits(y):
        assert not fit.filtered
        white = fit.noise['N']
        assert white.value == pytest.approx(FLAT.value('N'), rel=0.02)
        low, high = white.ci95
        assert 0.005 < (high - low) / white.value < 0.05


@pytest.mark.parametrize(('order', 'corner'), [(1, 10.0), (4, 20.0), (4, 10.0), (4, 5.0)])
def test_a_low_pass_filter_is_recognized(order, corner):
    """The mean N of 4 axes within 1.5 %: four standard errors and the known bias of .4 %."""
    y = lfilter(*butter(order, 2.0 * corner / RATE), simulated(120_000, 4, 5, FLAT), axis=0)
    found = fits(y[4000:])
    assert all(fit.filtered and fit.noise['Q'].value is None for fit in found)
    assert all(not fit.model['sinusoid'] and fit.m_min > 1 for fit in found)
    values = [fit.noise['N'].value for fit in found]
    assert np.mean(values) == pytest.approx(FLAT.value('N'), rel=0.015)


def markov(n, time, rng, axes):
    phi = math.exp(-TAU0 / time)
    white = rng.standard_normal((n, axes)) * math.sqrt(1.0 - phi * phi)
    white[0] /= math.sqrt(1.0 - phi * phi)
    return lfilter([1.0], [1.0, -phi], white, axis=0)


@pytest.mark.parametrize('time', [0.5, 5.0])
def test_a_gauss_markov_process_is_found(time):
    """A hump of three times the rest of the curve; sigma and T_c within a factor of 1.5."""
    sigma = 3.0 * FLAT.value('N') / math.sqrt(2.0 * time) * 2.0
    y = simulated(120_000, 3, 6, FLAT) + sigma * markov(120_000, time, np.random.default_rng(6), 3)
    for fit in fits(y):
        process = max(fit.model['gauss_markov'], key=lambda each: each.value)
        assert abs(math.log(process.value / sigma)) < math.log(1.5)
        assert abs(math.log(process.process.correlation_time / time)) < math.log(1.5)
        assert fit.noise['N'].value == pytest.approx(FLAT.value('N'), rel=0.02)


@pytest.mark.parametrize('size', [0.3, 1.0])
@pytest.mark.parametrize('samples', [2, 4, 8])
def test_fast_gauss_markov_noise_is_no_low_pass_filter(samples, size):
    """N within 10 %: four standard errors of the most uncertain case (2 samples)."""
    rng = np.random.default_rng(samples)
    y = simulated(120_000, 4, samples, FLAT) + size * WHITE * markov(120_000, samples / 100, rng, 4)
    for fit in fits(y):
        assert not fit.filtered and not fit.model['resonance'] and not fit.lack_of_fit
        ((process, *_),) = fit.model['gauss_markov']
        assert abs(math.log(process.correlation_time * RATE / samples)) < math.log(1.5)
        assert fit.noise['N'].value == pytest.approx(FLAT.value('N'), rel=0.1)


@pytest.mark.parametrize('low', [0.05, 0.15])
def test_a_filter_that_removes_little_is_no_gauss_markov_process(low):
    """The samples are y - low/2 (second difference of y)/2: the power at half the rate is
    (1 - low)^2. The mean N of 4 axes within 1.5 %.
    """
    y = simulated(240_000, 4, 15, FLAT)
    y = y[1:-1] + low / 4.0 * (y[2:] - 2.0 * y[1:-1] + y[:-2])
    found = fits(y)
    assert all(fit.filtered and not fit.model['gauss_markov'] for fit in found)
    assert np.mean([fit.noise['N'].value for fit in found]) == pytest.approx(
        FLAT.value('N'), rel=0.015
    )


def test_vibration_at_high_frequencies_is_no_low_pass_filter():
    """A broad resonance at a third of the rate: the spectrum rises there."""
    rng = np.random.default_rng(16)
    pole = math.exp(-1.0 / 6.0) * np.exp(2j * np.pi * 0.35)
    steps = rng.standard_normal((120_000, 3)) + 1j * rng.standard_normal((120_000, 3))
    vibration = lfilter([math.sqrt(1.0 - abs(pole) ** 2)], [1.0, -pole], steps, axis=0).real
    found = fits(simulated(120_000, 3, 16, FLAT) + 0.3 * WHITE * vibration)
    assert not any(fit.filtered for fit in found)


def test_a_fast_gauss_markov_process_does_not_absorb_the_white_noise():
    """Correlation over a third of a sample is white noise."""
    rng = np.random.default_rng(7)
    y = simulated(60_000, 3, 7, FLAT) + WHITE * markov(60_000, TAU0 / 3.0, rng, 3)
    for fit in fits(y):
        assert fit.noise['N'].value == pytest.approx(math.sqrt(2.0) * FLAT.value('N'), rel=0.12)


def test_a_walk_that_levels_off_is_recognized():
    """A correlation time of 1/40 of the record; sigma within twice its interval."""
    time, sigma = 30.0, 6e-4
    y = simulated(120_000, 4, 9, Model.of(N=1e-3))
    y += sigma * markov(120_000, time, np.random.default_rng(9), 4)
    found = fits(y)
    drifts = [fit.model.shaped.parts[0] for fit in found if fit.model.shaped.parts]
    assert len(drifts) >= 3
    for drift in drifts:
        low, high = np.sqrt(drift.process.states().initial[0, 0]) * np.array(drift.ci95)
        assert 0.5 * low < sigma < 2.0 * high


@pytest.mark.parametrize('sign', [1, -1])
def test_a_ramp_is_resolved_with_its_sign(sign):
    """R of 30 standard errors; 95 % interval, 4 axes: two outside have 1.4 %."""
    terms = Model.of(N=1e-3, R=sign * 1e-5)
    ramps = [fit.noise['R'] for fit in fits(simulated(60_000, 4, 9, terms))]
    assert all(r.resolved and r.value * sign > 0.0 for r in ramps)
    assert sum(r.ci95[0] <= sign * 1e-5 <= r.ci95[1] for r in ramps) >= 3


def test_white_noise_has_no_ramp():
    """A false ramp in 1 % of the axes: more than one of 12 has 0.6 %."""
    found = fits(simulated(20_000, 12, 10, Model.of(N=1e-3)))
    assert sum(fit.noise['R'].status == 'estimated' for fit in found) <= 1


DAY = 1440
"""Samples of a day: one per minute."""


@pytest.mark.parametrize('days', [2, 11])
def test_a_daily_cycle_is_in_the_model_only_if_it_is_significant(days):
    """12 axes without a cycle: more than one false alarm of 1 % has a probability of 0.6 %."""
    n, cycle = days * DAY, Sinusoid(1.0 / DAY)
    y = simulated(n, 12, days, Model.of(N=1e-3, B=5e-4, K=1e-6 * RATE))
    daily = 0.1 * np.sin(2.0 * np.pi * np.arange(n) / DAY)[:, None]
    present = []
    for samples in (y, y + daily):
        known = statistics(sums_of(samples))
        found = [estimate(AxisData.of(known, a), Candidates(known), cycle) for a in range(12)]
        present.append(sum(cycle in each.fit.components for each in found))
    assert present[0] <= 1 and present[1] == 12


def test_a_sinusoid_has_three_periods_in_the_data():
    """A wave of 1.3 periods is drift: 3 axes."""
    n = 60_000
    y = simulated(n, 3, 18, FLAT)
    y += 50.0 * FLAT.value('B') * np.sin(2.0 * np.pi * 1.3 * np.arange(n) / n)[:, None]
    for fit in fits(y):
        assert all(line.process.frequency * n * TAU0 >= 3.0 for line in fit.model['sinusoid'])
        assert all(r.process.frequency * n * TAU0 >= 3.0 for r in fit.model['resonance'])


@pytest.mark.parametrize('samples', [60, 300, 900])
def test_a_brief_record_has_only_n(samples):
    for fit in fits(simulated(samples, 3, 12)):
        assert all(fit.noise[t].value is None for t in 'BKR')
        assert {fit.model.value(t) for t in 'BKR'} == {0.0}
        assert fit.noise['N'].value == pytest.approx(TRUTH.value('N'), rel=0.5)


def test_constant_axes_have_no_values_and_disturb_no_other():
    y = simulated(30_000, 2, 13)
    y[:, 0] = 9.81
    constant, other = fits(y)
    assert all(c.value is None for c in constant.noise.values())
    assert other.noise['N'].value == pytest.approx(TRUTH.value('N'), rel=0.02)


@pytest.mark.parametrize('scale', [1e-9, 1e-3, 1e6])
def test_units_do_not_matter(scale):
    y = simulated(20_000, 1, 14)
    (one,), (other,) = fits(y), fits(scale * y)
    for term in 'QNBK':
        a, b = one.noise[term], other.noise[term]
        assert a.status == b.status
        assert (b.value or 0.0) == pytest.approx(scale * (a.value or 0.0), rel=1e-3)


@pytest.mark.parametrize('seed', [19, 22, 27])
def test_a_moving_sensor_gives_a_fit(seed: int) -> None:
    """Coefficients below 0, which describe a filter, must not make any variance negative."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3000, 16000))
    rows = []
    for _ in range(6):
        hits = rng.normal(size=n) * (rng.random(n) < rng.choice([0.002, 0.02]))
        motion = gaussian_filter1d(hits, float(rng.choice([5, 20, 60]))) * rng.choice([3, 30, 300])
        motion *= np.cumsum(rng.normal(size=n)) ** rng.integers(0, 2)
        rows.append(motion + rng.normal(size=n) * 0.003)
    for fit in fit_likelihood(sums_of(np.stack(rows, axis=1), axes=AXES)).axes.values():
        assert all(math.isfinite(part.value) for part in fit.model.parts)
