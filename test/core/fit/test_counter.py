# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counters of an angle, whose rounding errors are correlated from sample to sample."""

from __future__ import annotations

import math

import numpy as np
import pytest

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.fit.stationary import fit_likelihood
from allan_ros.core.noise.derived import avar
from allan_ros.core.noise.processes.rounded_angle import RoundedAngle

N_SAMPLES = 60_000
PERIOD = 0.01


def counts(step, rate, rng):
    """Return differences of an angle that is rounded to ``step``; the samples have unit noise."""
    angle = np.cumsum(np.r_[step * rng.uniform(), rate * step + rng.normal(size=N_SAMPLES)])
    return step * np.diff(np.round(angle / step))


def fits_of(samples):
    engine = RunningSums(axes=[f'gyro_{axis}' for axis in 'xyz'][: samples.shape[1]])
    engine.update(samples, 0, round((len(samples) - 1) * PERIOD * 1e9))
    engine.end_segment()
    return list(fit_likelihood(engine.sums).axes.values())


@pytest.mark.parametrize('step', [2.5, 5.0, 10.0])
@pytest.mark.parametrize('rate', [0.0, 0.2, 0.5, 7.3])
def test_gamma_predicts_the_allan_variance_of_a_counter(step, rate):
    """Within 5 standard errors of the mean of 40 records; 36 numbers, false alarms below 1e-3."""
    rng = np.random.default_rng(1)
    m = np.array([1, 2, 5])
    found = []
    for _ in range(40):
        phase = np.r_[0.0, np.cumsum(counts(step, rate, rng)[:20_000])]
        second = (phase[2 * k :] - 2.0 * phase[k:-k] + phase[: -2 * k] for k in m.tolist())
        found.append([np.mean(d**2) / (2.0 * k**2) for d, k in zip(second, m)])
    rounding = RoundedAngle(rate, step**2 / (2.0 * math.pi**2))
    expected = 1.0 / m + step**2 / 12.0 * avar(rounding, m)
    error = np.std(found, axis=0) / math.sqrt(len(found))
    assert np.all(np.abs(np.mean(found, axis=0) - expected) < 5.0 * error)


@pytest.mark.parametrize('step', [2.5, 5.0])
def test_n_and_q_of_a_counter_are_right(step):
    """Within 4.5 standard errors; 12 numbers, false alarms below 1e-4."""
    rng = np.random.default_rng(2)
    for fit in fits_of(np.column_stack([counts(step, rate, rng) for rate in (0.0, 0.3, 0.5)])):
        truth = {'N': math.sqrt(PERIOD), 'Q': step * PERIOD / math.sqrt(12.0)}
        for term, true_value in truth.items():
            low, high = fit.noise[term].ci95
            assert abs(fit.noise[term].value - true_value) < 4.5 / 3.92 * (high - low)
        (part,) = fit.model['rounded_angle']
        assert part.value == fit.noise['Q'].value and fit.model.value('Q') == 0.0
        assert part.process.correlation_time == pytest.approx(
            PERIOD * step**2 / (2.0 * math.pi**2), rel=0.1
        )


def test_rounding_without_carry_and_plain_quantization_are_no_counters():
    """Neither has a known step and a resolved Q of this step at the same time."""
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(N_SAMPLES + 1, 3))
    rounded = 2.0 * np.round(noise[1:, 0] / 2.0)
    quantized = noise[1:, 1] + 0.8 * np.diff(noise[:, 2])
    for fit in fits_of(np.column_stack([rounded, quantized])):
        assert not fit.model['rounded_angle']
