# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Levels of the white noise of parts of a recording, and innovations of the block means."""

import numpy as np
import pytest

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.fit.period_levels import (
    MOST_MEANS,
    innovation_levels,
    period_spectra,
    white_noise_levels,
)
from allan_ros.core.fit.result import AxisFit
from allan_ros.core.fit.stationary import fit_stationary, scatter
from allan_ros.core.imu import AXES
from allan_ros.core.noise import Model
from allan_ros.core.simulator import simulate_axis

TRUTH = Model.of(N=1e-3, B=2e-3, K=5e-4)
FITS = [AxisFit({}, model=TRUTH)] * 3


def draw(seed: int, samples: int = 6000) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([simulate_axis(samples, 1.0, TRUTH, rng) for _ in range(3)], axis=1)


def sums_of(*segments: np.ndarray) -> AllanSums:
    engine = RunningSums(axes=AXES[:3])
    start = 0
    for y in segments:
        engine.update(y, start * 10**9, (start + len(y) - 1) * 10**9)
        engine.end_segment()
        start += len(y) + 100
    return engine.sums


def test_innovations_of_the_true_model_are_independent_and_have_unit_variance() -> None:
    """The bounds are 4.5 standard errors of three independent axes: false alarms below 1e-4."""
    levels = innovation_levels(sums_of(draw(1)), FITS, {})
    number = levels.power.size
    assert 128 <= len(levels.power) < MOST_MEANS and np.all(levels.dof == 1.0)
    assert np.all(levels.share > 0.8)
    assert levels.power.mean() == pytest.approx(1.0, abs=4.5 * (2.0 / number) ** 0.5)
    neighbors = np.mean((levels.power[1:] - 1.0) * (levels.power[:-1] - 1.0)) / 2.0
    assert abs(neighbors) < 4.5 / number**0.5


def test_a_ramp_and_a_settling_have_no_effect() -> None:
    y, t = draw(2), np.arange(6000.0)
    changed = y + 1e-4 * t[:, None] + np.exp(-t / 900.0)[:, None]
    before = innovation_levels(sums_of(y), FITS, {0: 900.0, 1: 900.0, 2: 900.0})
    after = innovation_levels(sums_of(changed), FITS, {0: 900.0, 1: 900.0, 2: 900.0})
    assert after.power == pytest.approx(before.power, abs=1e-4)


def test_a_shorter_segment_has_the_innovations_that_it_has_alone() -> None:
    y = draw(3)
    alone = innovation_levels(sums_of(y[:2048]), FITS, {})
    both = innovation_levels(sums_of(y[:2048], y), FITS, {})
    coarse = innovation_levels(sums_of(y), FITS, {})
    assert len(both.power) > len(coarse.power)
    assert both.samples[0] >= alone.samples[0]
    assert both.power[-len(coarse.power) :] == pytest.approx(coarse.power, rel=1e-5, abs=1e-8)


def test_a_part_without_spectra_has_no_level() -> None:
    """A quarter of the samples are in segments that are shorter than a spectral block."""
    rng = np.random.default_rng(5)
    short = [rng.normal(size=(40, 3)) for _ in range(60)]
    sums = sums_of(rng.normal(size=(3600, 3)), *short, 1.2 * rng.normal(size=(3600, 3)))
    levels = white_noise_levels(period_spectra(sums))
    assert not levels.dof.all()
    low, high = levels.extremes(0)
    assert 0.8 < low < 1.0 < high < 1.2


def test_without_drift_no_innovation_counts() -> None:
    levels = innovation_levels(sums_of(draw(4)), [AxisFit({}, model=Model.of(N=1e-3))] * 3, {})
    assert not levels.dof.any()
    assert scatter(levels, [0, 1, 2]) == 0.0


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_steps_in_a_part_of_the_recording_widen_the_interval_of_k(seed: int) -> None:
    """Ten steps of 15 times the noise of a block mean in a quarter of the recording."""
    y = draw(seed)
    rng = np.random.default_rng(seed)
    for at in rng.integers(3000, 4500, 10):
        y[at:] += 0.03 * rng.choice([-1, 1], 3)
    _, model = fit_stationary(sums_of(y))
    for fit in model.axes.values():
        assert fit.drift_scatter > 0.3
        k = fit.noise['K']
        assert k.recording_ci95 is not None and k.ci95 is not None
        assert k.ci95[0] < k.recording_ci95[0] and k.recording_ci95[1] < k.ci95[1]
