# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from allan_ros.core.errors import AllanError
from allan_ros.core.imu import joined
from allan_ros.core.noise import Model
from allan_ros.core.simulator import (
    BATCH_SAMPLES,
    Faults,
    simulate_axis,
    simulate_imu,
)

MIXED = Model.of(Q=2e-3, N=0.03, B=0.1, K=0.02, R=1e-3)
QUIET = [Model.of(N=1e-4)] * 3
SILENT = [Model.of()] * 3
RATE, SECONDS = 100.0, 100.0


def record(faults=Faults(), noise=SILENT, seconds=SECONDS, rate=RATE, **options):
    """Return times in s and samples."""
    options = {'mean': np.zeros(6), **options}
    batch = joined(list(simulate_imu(seconds, rate, noise, noise, faults=faults, **options)))
    return batch.stamps_ns * 1e-9, batch.samples


def avar(y, m):
    """Return the fully overlapping Allan variance along the last axis, from its definition."""
    theta = np.concatenate([np.zeros((*y.shape[:-1], 1)), np.cumsum(y, axis=-1)], axis=-1)
    d = theta[..., 2 * m :] - 2 * theta[..., m:-m] + theta[..., : -2 * m]
    return (d**2).mean(axis=-1) / (2 * m**2)


@pytest.mark.parametrize('terms', [*(Model.of(**{t: 0.1}) for t in 'QNBKR'), MIXED])
def test_mean_allan_variance_is_the_expected_one_at_every_factor(terms):
    """False alarm probability below 1e-3: 60 comparisons of a nearly normal mean at 4.5 sigma."""
    n, tau0, draws = 1024, 0.1, 1000
    rng = np.random.default_rng(11)
    y = np.stack([simulate_axis(n, tau0, terms, rng) for _ in range(draws)])
    for m in (1, 2, 3, 8, 20, 50, 128, 200, 350, 512):
        ratio = avar(y, m) / terms.avar(m * tau0, tau0)
        spread = ratio.std(ddof=1) / np.sqrt(draws) + 1e-9
        assert abs(ratio.mean() - 1) < 4.5 * spread, f'm = {m}'


def test_the_seed_decides_everything():
    again = [record(noise=QUIET, seed=5)[1] for _ in range(2)]
    assert np.array_equal(*again)
    assert not np.array_equal(again[0], record(noise=QUIET, seed=6)[1])


def test_axes_are_independent_and_centered_on_the_mean():
    """False alarm probability below 1e-5: 15 correlations of 20000 samples at 5 sigma."""
    _, samples = record(noise=QUIET, seconds=200.0, mean=[1, 2, 3, 4, 5, 6])
    assert np.abs(samples.mean(axis=0) - [1, 2, 3, 4, 5, 6]).max() < 0.05
    steps = np.diff(samples, axis=0)
    correlation = np.corrcoef(steps.T) - np.eye(6)
    assert np.abs(correlation).max() < 5 / np.sqrt(len(steps)) * np.sqrt(1.5)


def test_stamps_start_at_the_given_time_and_batches_are_bounded():
    batches = list(simulate_imu(500.0, 100.0, QUIET, QUIET, start_ns=10**18, frame_id='a'))
    assert [len(b) for b in batches] == [BATCH_SAMPLES, 50000 - BATCH_SAMPLES]
    stamps = np.concatenate([b.stamps_ns for b in batches])
    assert np.array_equal(stamps, 10**18 + 10_000_000 * np.arange(50000))
    assert {b.frame_id for b in batches} == {'a'}


def test_a_simulated_fault_changes_only_its_own_effect():
    _, clean = record(noise=QUIET)
    _, dropped = record(Faults(drop=0.1, jitter=1e-3), noise=QUIET)
    assert set(dropped[:, 0]) < set(clean[:, 0])
    _, shaken = record(Faults(vibration_gyro=1.0), noise=QUIET)
    assert np.array_equal(shaken[:, 3:], clean[:, 3:])


def test_motion_stays_in_its_spans():
    t, y = record(Faults(motion=((10.0, 5.0), (50.0, 1.0)), motion_gyro=0.3, motion_accel=2.0))
    inside = ((t >= 10) & (t < 15)) | ((t >= 50) & (t < 51))
    assert not y[~inside].any()
    assert 0.1 < np.abs(y[inside, :3]).max() <= 0.3
    assert 0.7 < np.abs(y[inside, 3:]).max() <= 2.0


def test_gaps_lose_exactly_their_seconds():
    t, _ = record(Faults(gaps=((20.0, 2.5), (60.0, 10.0))))
    steps = np.diff(t)
    assert sorted(steps[steps > 0.011]) == pytest.approx([2.51, 10.01])
    assert len(t) == SECONDS * RATE - 1250


def test_drops_and_jitter_have_their_size():
    """500 +- 22 of 10,000 samples are lost at 5 %; the bound is 6 sigma (false alarm 2e-9). As many
    normal values determine their spread to 0.7 %; the bound is 5 sigma.
    """
    t, _ = record(Faults(drop=0.05))
    assert abs(len(t) - 9500) < 6 * 22 and t[0] == 0.0
    t, _ = record(Faults(jitter=1e-3))
    assert (t - np.arange(len(t)) / RATE).std() == pytest.approx(1e-3, rel=0.036)


def test_low_pass_keeps_the_mean_and_reduces_the_variance():
    """White noise filtered with the pole p has the variance (1 - p)/(1 + p); bound 5 sigma of
    3e4.
    """
    _, raw = record(noise=QUIET)
    _, slow = record(Faults(low_pass=20.0), noise=QUIET)
    pole = np.exp(-2 * np.pi * 20.0 / RATE)
    gain = slow.var(axis=0).mean() / raw.var(axis=0).mean()
    assert gain == pytest.approx((1 - pole) / (1 + pole), rel=0.05)
    np.testing.assert_allclose(slow.mean(axis=0), raw.mean(axis=0), atol=1e-6)


def test_vibration_is_one_line():
    t, y = record(Faults(vibration_frequency=7.0, vibration_gyro=0.2, vibration_accel=3.0))
    spectrum = np.abs(np.fft.rfft(y, axis=0)) / (len(t) / 2)
    line = round(7.0 * SECONDS)
    np.testing.assert_allclose(spectrum[line], [0.2] * 3 + [3.0] * 3, rtol=1e-6)
    spectrum[line] = 0
    assert spectrum.max() < 1e-9


def test_gauss_markov_has_its_variance_and_correlation_time():
    """2000 s of T_c = 1 s and six axes: 6000 independent values determine each to 2 %; bounds 5
    sigma.
    """
    faults = Faults(gauss_markov_gyro=0.3, gauss_markov_accel=0.3, gauss_markov_time=1.0)
    _, y = record(faults, seconds=2000.0, rate=20.0)
    assert y.var() == pytest.approx(0.09, rel=0.1)
    assert (y[20:] * y[:-20]).mean() / y.var() == pytest.approx(np.exp(-1.0), abs=0.06)
    assert np.abs(np.corrcoef(y.T) - np.eye(6)).max() < 0.2


@pytest.mark.parametrize('rate', [62.5, 99.0, 1000.0])
def test_accelerometer_is_held_between_its_readings(rate):
    _, raw = record(noise=QUIET)
    _, held = record(Faults(accel_rate=rate), noise=QUIET)
    assert np.array_equal(held[:, :3], raw[:, :3])
    fresh = 1 + np.count_nonzero(np.diff(held[:, 3]))
    assert fresh == pytest.approx(min(rate, RATE) * SECONDS, abs=1)
    # Every value is a true sample, at most one reading old.
    longest = int(np.ceil(RATE / min(rate, RATE)))
    age = np.array(
        [list(raw[max(0, i - longest) : i + 1, 3][::-1]).index(held[i, 3]) for i in range(1000)]
    )
    assert age.max() <= longest - 1


def test_rounding_puts_values_on_the_lattice():
    _, y = record(Faults(lsb_gyro=1e-3, lsb_accel=0.02), noise=QUIET)
    for sensor, lsb in ((y[:, :3], 1e-3), (y[:, 3:], 0.02)):
        assert np.abs(sensor / lsb - np.round(sensor / lsb)).max() < 1e-9


def test_warm_up_decays():
    t, y = record(Faults(warmup_gyro=0.1, warmup_accel=-0.2, warmup_time=30.0))
    np.testing.assert_allclose(y[:, 0], 0.1 * np.exp(-t / 30.0))
    np.testing.assert_allclose(y[:, 5], -0.2 * np.exp(-t / 30.0))


def test_nothing_to_simulate_is_rejected():
    with pytest.raises(AllanError, match='longer time'):
        next(simulate_imu(1e-9, 100.0, QUIET, QUIET))
