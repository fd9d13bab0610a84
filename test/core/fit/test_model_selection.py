# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Selection of a model for noise that the five terms do not describe; fixed seeds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from allan_ros.core.allan.curve import allan_curve
from allan_ros.core.allan.engine import RunningAllan
from allan_ros.core.fit.findings import with_deviations
from allan_ros.core.fit.gls import fit_gls
from allan_ros.core.fit.gls_solver import covariance_at, initial_variances
from allan_ros.core.fit.process_search import ProcessSearch
from allan_ros.core.fit.processes import GaussMarkovTerm
from allan_ros.core.fit.table import PooledTable
from allan_ros.core.simulate import NoiseTerms, simulate_axis

RATE = 200.0
SECONDS = 1800
SAMPLES = int(RATE * SECONDS)
TRUTH = NoiseTerms(N=1e-3, B=3e-4)
WHITE = TRUTH.N * RATE**0.5


def fit_of(y):
    engine = RunningAllan(axes=('gyro_x',))
    engine.update(np.reshape(y, (-1, 1)), 0, round((len(y) - 1) / RATE * 1e9))
    engine.end_segment()
    fit = with_deviations(fit_gls(engine.sums), allan_curve(engine.sums))
    return fit.axes['gyro_x'], {f.id: f for f in fit.findings}


@pytest.fixture
def noise():
    return simulate_axis(SAMPLES, 1.0 / RATE, TRUTH, np.random.default_rng(20))


def test_five_terms_need_no_process(noise):
    axis, findings = fit_of(noise)
    assert axis.m_min == 1
    assert axis.misfit == 0.0
    assert axis.gauss_markov is None
    assert axis.sinusoid is None
    assert not {'misfit', 'low_pass', 'short_averages', 'vibration'} & set(findings)


@pytest.mark.parametrize('width', [4, 8])
def test_a_boxcar_filter_affects_q_but_not_n(noise, width):
    axis, findings = fit_of(np.convolve(noise, np.ones(width) / width, 'valid'))
    assert 'low_pass' in findings or 'short_averages' in findings
    assert axis.noise['Q'].status == 'not_observable'
    assert axis.noise['Q'].upper95 is None
    low, high = axis.noise['N'].ci95
    assert low < TRUTH.N < high
    assert axis.noise['N'].value == pytest.approx(TRUTH.N, rel=0.01)


def test_process_of_less_than_a_sample_is_a_filter():
    """Regression: such a process replaced the white noise, and N was 4 times too small."""
    rng = np.random.default_rng(2)
    keep = np.exp(-2.0 * np.pi * 41.0 / RATE)
    for _ in range(2):
        y = simulate_axis(720_000, 1.0 / RATE, TRUTH, rng)
        axis, _ = fit_of(lfilter([1.0 - keep], [1.0, -keep], y))
        assert axis.noise['N'].value == pytest.approx(TRUTH.N, rel=0.01)


def test_processes_that_imitate_a_filter_are_not_preferred():
    """Regression: with three sinusoids, N was 2 % too large in two of three such records."""
    rng = np.random.default_rng(3)
    for _ in range(3):
        y = simulate_axis(720_000, 1.0 / RATE, TRUTH, rng)
        axis, _ = fit_of(lfilter(*butter(2, 0.2), y))
        assert axis.noise['N'].value == pytest.approx(TRUTH.N, rel=0.015)


def test_a_first_order_filter_affects_q_but_not_n(noise):
    keep = np.exp(-2.0 * np.pi * 41.0 / RATE)
    axis, findings = fit_of(lfilter([1.0 - keep], [1.0, -keep], noise))
    assert 'low_pass' in findings or 'short_averages' in findings
    low, high = axis.noise['N'].ci95
    assert low < TRUTH.N < high
    assert axis.noise['N'].value == pytest.approx(TRUTH.N, rel=0.01)


def test_a_slow_filter_is_not_reported_only_as_vibration(noise):
    keep = np.exp(-2.0 * np.pi * 5.0 / RATE)
    axis, findings = fit_of(lfilter([1.0 - keep], [1.0, -keep], noise))
    assert axis.m_min > 1
    assert 'low-pass filter' in findings['short_averages'].message


@pytest.mark.parametrize(
    'hertz, name', [(0.02, 'slow_disturbance'), (0.1, 'slow_disturbance'), (2.0, 'vibration')]
)
def test_a_sinusoid_is_found_with_frequency_and_amplitude(noise, hertz, name):
    line = 0.08 * WHITE * np.sin(2.0 * np.pi * hertz / RATE * np.arange(SAMPLES))
    axis, findings = fit_of(noise + line)
    assert {'vibration', 'slow_disturbance', 'slow_cycle'} & set(findings) == {name}
    low, high = axis.sinusoid.frequency_ci95
    assert low < hertz < high
    assert axis.sinusoid.frequency == pytest.approx(hertz, rel=0.1)
    low, high = axis.sinusoid.amplitude_ci95
    assert low < 0.08 * WHITE < high
    assert axis.noise['N'].value == pytest.approx(TRUTH.N, rel=0.01)


def test_a_sinusoid_without_noise_is_fitted():
    """The sinusoid describes the complete curve, so the noise of the fit is 0."""
    short = 360 * 50
    rng = np.random.default_rng(4)
    y = simulate_axis(short, 1.0 / 50, TRUTH, rng)
    line = 40.0 * TRUTH.N * 50**0.5 * np.sin(2.0 * np.pi * 3.0 / 50 * np.arange(short))
    axis, findings = fit_of(y + line)
    assert axis.processes.sinusoid or axis.misfit > 0.0
    assert findings


@pytest.mark.parametrize(
    'amplitude, hertz, phase',
    [
        (1e-3, 3.0, 5.0),
        (1e-3, 7.0, 5.0),
        (3e-3, 12.0, 5.0),
        (3e-3, 3.0, 5.0),
        (3e-3, 3.0, 2.0),
        (1e-2, 3.0, 0.0),
        (1e-2, 7.0, 5.0),
        (3e-3, 23.5, 0.7),
        (3e-3, 24.6, 0.7),
        (3e-3, 11.96, 0.7),
    ],
)
def test_a_strong_sinusoid_is_found_at_its_frequency(amplitude, hertz, phase):
    """At 3 to 30 times the noise, the residual is noise only if the frequency is exact."""
    rate, n = 50.0, 18_000
    truth = NoiseTerms(N=5e-5, B=2e-5, K=2e-6)
    y = simulate_axis(n, 1.0 / rate, truth, np.random.default_rng(1))
    y = y + amplitude * np.sin(2.0 * np.pi * hertz / rate * np.arange(n) + phase)
    engine = RunningAllan(axes=('gyro_x',))
    engine.update(y.reshape(-1, 1), 0, round((n - 1) / rate * 1e9))
    engine.end_segment()
    axis = fit_gls(engine.sums).axes['gyro_x']
    line = max(axis.processes.sinusoid, key=lambda s: s.amplitude)
    assert line.frequency == pytest.approx(hertz, rel=1e-3)
    assert line.amplitude == pytest.approx(amplitude, rel=0.02)
    assert axis.noise['N'].value == pytest.approx(truth.N, rel=0.05)
    assert (axis.m_min, axis.misfit) == (1, 0.0)


def test_gauss_markov_noise_is_found_with_its_correlation_time(noise):
    keep = np.exp(-1.0 / (RATE * 1.0))
    rng = np.random.default_rng(22)
    steps = rng.standard_normal(SAMPLES) * 0.1 * WHITE * (1.0 - keep**2) ** 0.5
    axis, findings = fit_of(noise + lfilter([1.0], [1.0, -keep], steps))
    assert 'gauss_markov' in findings
    low, high = axis.gauss_markov.correlation_time_ci95
    assert low < 1.0 < high
    low, high = axis.gauss_markov.sigma_ci95
    assert low < 0.1 * WHITE < high


def test_a_process_similar_to_flicker_is_found():
    """The five terms pass the test of fit, but the process is much likelier."""
    rate, n = 20.0, 144_000
    truth = NoiseTerms(N=7e-5, B=2.5e-5, K=2.6e-6)
    rng = np.random.default_rng(5)
    engine = RunningAllan(axes=('gyro_x', 'gyro_y'))
    keep = np.exp(-1.0 / (10.0 * rate))
    clean = np.stack([simulate_axis(n, 1.0 / rate, truth, rng) for _ in range(2)], axis=1)
    drift = lfilter([1.0], [1.0, -keep], rng.standard_normal(n)) * 4.3e-5 * (1.0 - keep**2) ** 0.5
    engine.update(clean + np.outer(drift, (1, 0)), 0, round((n - 1) / rate * 1e9))
    engine.end_segment()
    with_process, without = fit_gls(engine.sums).axes.values()
    assert with_process.gof_z < 3.0
    (found,) = with_process.processes.gauss_markov
    assert 5.0 < found.correlation_time < 20.0
    assert not without.processes.gauss_markov  # chosen by mistake in less than 1 % of axes


def test_three_sinusoids_are_found(noise):
    t = np.arange(SAMPLES) / RATE
    hertz = (0.05, 0.7, 9.0)
    axis, _ = fit_of(noise + sum(0.1 * WHITE * np.sin(2.0 * np.pi * f * t + f) for f in hertz))
    found = [line.frequency for line in axis.processes.sinusoid]
    assert found == pytest.approx(hertz, rel=0.1)
    assert axis.misfit == 0.0
    assert axis.noise['N'].value == pytest.approx(TRUTH.N, rel=0.01)


def test_noise_without_a_matching_process_is_a_misfit(noise):
    """A sinusoid of changing frequency makes a broad hump, which no process describes."""
    t = np.arange(SAMPLES) / RATE
    phase = 2.0 * np.pi * np.cumsum(0.5 + 0.4 * np.sin(2.0 * np.pi * t / 50.0)) / RATE
    axis, findings = fit_of(noise + 0.3 * WHITE * np.sin(phase))
    assert axis.misfit > 0.0
    assert 'misfit' in findings
    assert axis.deviation is not None
    assert axis.noise['N'].value == pytest.approx(TRUTH.N, rel=0.1)


@pytest.mark.parametrize('time', [0.1, 10.0])
def test_a_gauss_markov_process_does_not_change_n(noise, time):
    """The process dominates the curve near its hump."""
    rng = np.random.default_rng(8)
    keep = np.exp(-1.0 / (time * RATE))
    drift = lfilter([1.0], [1.0, -keep], rng.standard_normal(SAMPLES)) * np.sqrt(1.0 - keep**2)
    sigma = 3.0 * TRUTH.N / np.sqrt(time)
    axis, findings = fit_of(noise + sigma * drift)
    (found,) = axis.processes.gauss_markov
    low, high = found.correlation_time_ci95
    assert 0.8 * low < time < 1.25 * high  # the interval holds it in 95 % of records
    assert found.sigma == pytest.approx(sigma, rel=0.2)
    assert axis.noise['N'].value == pytest.approx(TRUTH.N, rel=0.01)
    assert axis.m_min == 1
    assert 'gauss_markov' in findings
    assert not {'low_pass', 'short_averages', 'vibration', 'misfit'} & set(findings)


def test_rounding_is_distinguished_from_quantization(noise):
    step = 2.0 * WHITE
    axis, findings = fit_of(step * np.round((9.8 + noise) / step))
    assert 'rounding' in findings
    assert axis.noise['Q'].status == 'not_observable'
    # Rounding adds white noise of about step^2/12 to N; a step so coarse is not quite independent.
    want = (TRUTH.N**2 + step**2 / 12.0 / RATE) ** 0.5
    assert axis.noise['N'].value == pytest.approx(want, rel=0.05)


def test_a_drift_that_is_not_separable_is_reported():
    truth = NoiseTerms(N=1e-3, K=1.5e-5)
    told = 0
    for seed in range(6):
        y = simulate_axis(SAMPLES, 1.0 / RATE, truth, np.random.default_rng(seed))
        axis, findings = fit_of(y + 1.5e-7 / RATE * np.arange(SAMPLES))
        unseen = {axis.noise[t].status for t in 'KR'} == {'not_observable'}
        assert ('drift_not_separable' in findings) <= unseen
        told += 'drift_not_separable' in findings
    assert told > 0


def test_a_process_is_kept_or_dropped_where_no_other_correlation_time_can_be_tried():
    engine = RunningAllan(axes=('gyro_x',))
    engine.update(np.random.default_rng(1).standard_normal((400, 1)), 0, 399 * 10**7)
    engine.end_segment()
    table = PooledTable(engine.sums).table(0, m_min=16)
    covariance = covariance_at(table, initial_variances(table))
    search = ProcessSearch(table, covariance, 400, signed=False, walk=True)
    assert search.search([GaussMarkovTerm(30.0)]).extras in ((), (GaussMarkovTerm(30.0),))


@pytest.mark.parametrize(('periods', 'size'), [(9, 3.0), (9, 10.0), (3, 10.0)])
def test_a_cycle_of_a_few_periods_has_its_period_and_no_further_process(noise, periods, size):
    """Regression: the period was at most a tenth of the record, and K contained the rest."""
    angle = 2.0 * np.pi * periods * np.arange(SAMPLES) / SAMPLES
    axis, findings = fit_of(noise + size * TRUTH.B * np.sin(angle + 1.0))
    assert {'slow_cycle', 'slow_disturbance'} & set(findings)
    assert len(axis.processes.sinusoid) == 1 and not axis.processes.gauss_markov
    assert axis.sinusoid.frequency == pytest.approx(periods / SECONDS, rel=0.05)
    assert axis.sinusoid.amplitude == pytest.approx(size * TRUTH.B, rel=0.1)
    assert axis.noise['K'].status == 'not_observable'


@pytest.mark.filterwarnings('error')
def test_an_average_of_zero_is_not_divided_by():
    """The correction for the ramp of a short record can make an Allan variance 0."""
    engine = RunningAllan(axes=('gyro_x',))
    engine.update(np.random.default_rng(1).standard_normal((400, 1)), 0, 399 * 10**7)
    engine.end_segment()
    table = PooledTable(engine.sums).table(0)
    covariance = covariance_at(table, initial_variances(table))
    avar = np.where(np.arange(len(table.m)) < len(table.m) - 1, table.avar, 0.0)
    search = ProcessSearch(replace(table, avar=avar), covariance, 400, signed=False, walk=True)
    assert np.isfinite(search.search().chi_squared)


@pytest.mark.parametrize('size', [10.0, 30.0])
def test_a_slow_cycle_does_not_widen_the_interval_of_n(size):
    """Regression: the interval of N was 30 % wide. It misses N one time in 20 by design; seed
    fixed.
    """
    y = simulate_axis(SAMPLES, 1.0 / RATE, TRUTH, np.random.default_rng(21))
    cycle = size * TRUTH.B * np.sin(2.0 * np.pi * np.arange(SAMPLES) / SAMPLES)
    axis, _ = fit_of(y + cycle)
    low, high = axis.noise['N'].ci95
    assert low < TRUTH.N < high and high - low < 0.02 * TRUTH.N
    assert axis.m_min == 1


@pytest.mark.parametrize('size', [28.0, 100.0, 300.0])
def test_n_next_to_a_strong_sinusoid_is_right_or_a_limit(size):
    """Regression: N was 10 to 45 % too small. A limit is missed one time in 40 by design; seed
    fixed.
    """
    n = 360_000
    y = simulate_axis(n, 1.0 / RATE, TRUTH, np.random.default_rng([200, 3, round(size)]))
    y += size * WHITE * np.sin(2.0 * np.pi * 3.0 * np.arange(n) / RATE + 0.3)
    axis, findings = fit_of(y)
    if axis.noise['N'].status == 'estimated':
        assert axis.noise['N'].value == pytest.approx(TRUTH.N, rel=0.05)
    else:
        assert axis.noise['N'].upper95 > TRUTH.N
        assert 'noise_hidden' in findings


def test_drift_is_bounded_if_short_averages_need_a_model_error(shared_data):
    """Regression: the random walk fitted to this accelerometer was 7 times the long averages."""
    counts = np.load(shared_data / 'adis16405' / 'imu4_counts.npz')
    y = np.asarray(counts['accel'])[12_000:, 1] * 0.00333 * 9.80665  # m/s^2
    engine = RunningAllan(axes=('accel_y',))
    engine.update(y[:, None], 0, round((len(y) - 1) * 1e7))
    engine.end_segment()
    axis = fit_gls(engine.sums).axes['accel_y']
    tau = engine.sums.m * engine.sums.tau0
    model = axis.selected.avar(tau, engine.sums.tau0)
    ratio = np.sqrt(engine.sums.avar[:, 0] / model)[tau > 600.0]
    assert axis.noise['K'].status != 'estimated'
    assert 0.4 < np.median(ratio) < 2.5
