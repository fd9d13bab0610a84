# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Mean, drift, slope over temperature, bandwidth and rounding step of samples at rest."""

from __future__ import annotations

import numpy as np
import pytest
from support.sums import sums_of

from allan_ros.core.allan.at_rest import AtRest, at_rest, common_step

RATE = 100.0
SIGMA = 0.01
N = SIGMA / np.sqrt(RATE)
NONE = np.zeros(0, np.int64), np.zeros(0)


def measured(samples: np.ndarray, readings: tuple[np.ndarray, np.ndarray] = NONE) -> AtRest:
    sums = sums_of(samples[:, None], axes=('gyro_x',))
    return at_rest(sums, *readings, {'gyro_x': N})['gyro_x']


def white(n: int = 30_000, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(scale=SIGMA, size=n)


def filtered(corner: float) -> np.ndarray:
    """Return white noise behind a Butterworth filter of the second order, -3 dB at ``corner``."""
    from scipy import signal

    return signal.lfilter(*signal.butter(2, 2.0 * corner / RATE), white())


def test_the_mean_is_the_bias() -> None:
    found = measured(0.5 + white())
    # false alarm 1e-6: 4.9 standard errors
    assert found.mean == pytest.approx(0.5, abs=4.9 * SIGMA / np.sqrt(30_000))
    assert found.temperature is None and found.slope is None


def test_drift_is_the_range_of_the_means() -> None:
    steady, moving = white(), white() + np.linspace(0.0, 1.0, 30_000)
    assert measured(moving).drift == pytest.approx(1.0, rel=0.15)  # less the two half blocks
    assert measured(steady).drift < 0.01


def test_the_slope_over_temperature() -> None:
    t = np.arange(30_000) / RATE
    celsius = 25.0 + 10.0 * t / t[-1]
    readings = (t[::100] * 1e9).astype(np.int64), celsius[::100]
    found = measured(white() + 0.02 * celsius, readings)
    assert found.temperature == pytest.approx(30.0, abs=0.5)
    low, high = found.slope.ci95
    assert low < 0.02 < high and found.slope.value == pytest.approx(0.02, rel=0.05)
    narrow = readings[0], 25.0 + 0.2 * (readings[1] - 25.0)
    assert measured(white(), narrow).slope is None


@pytest.mark.parametrize('corner', [3.0, 10.0, 25.0])
def test_the_bandwidth_is_that_of_the_filter(corner: float) -> None:
    # a bin is at most 1/8 of its frequency wide, and the median is taken over five
    assert measured(filtered(corner)).bandwidth == pytest.approx(corner, rel=0.2)


def test_a_vibration_above_a_filter_is_no_bandwidth() -> None:
    shaken = filtered(5.0) + 0.1 * np.sin(2.0 * np.pi * 33.0 * np.arange(30_000) / RATE)
    assert measured(shaken).bandwidth == pytest.approx(5.0, rel=0.2)


def test_without_a_filter_it_is_half_of_the_rate() -> None:
    # false alarm: 60 medians of 1e-6 each
    assert measured(white()).bandwidth == RATE / 2.0
    sums = sums_of(white()[:, None], axes=('gyro_x',))
    assert at_rest(sums, *NONE, {})['gyro_x'].bandwidth is None  # N is unknown


def phase_of(samples, step):
    return np.concatenate([[0.0], np.cumsum(samples - samples[0])])[::step]


@pytest.mark.parametrize('lattice', [1e-6, 0.05, 3.0])
@pytest.mark.parametrize('relative', [0.1, 1.0, 4.0])
def test_step_of_rounded_samples_is_found(lattice, relative):
    rng = np.random.default_rng(5)
    noise = rng.normal(size=60000) * lattice / relative
    samples = 9.8 + lattice * np.round(noise / lattice)
    found = common_step(phase_of(samples, 512), lattice / relative)
    assert found == pytest.approx(lattice, rel=1e-6)


def test_smooth_and_constant_samples_have_no_step():
    rng = np.random.default_rng(7)
    assert common_step(phase_of(rng.normal(size=60000), 512), 1.0) is None
    assert common_step(np.zeros(100), 1.0) is None


def test_few_points_of_real_noise_have_no_step_and_cause_no_warning():
    """Records of a few seconds; a warning of numpy is an error here."""
    rng = np.random.default_rng(0)
    with np.errstate(all='raise'):
        for _ in range(2000):
            phase = np.cumsum(rng.normal(size=rng.integers(5, 40)))
            assert common_step(phase, float(rng.uniform(0.1, 60.0))) is None
