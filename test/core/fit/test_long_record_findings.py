# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings about the long averages: terms that are not resolved, and drift that is bounded."""

import numpy as np
from scipy.signal import butter, lfilter

from allan_ros.core.allan.engine import RunningAllan
from allan_ros.core.fit import fit_noise
from allan_ros.core.imu import ImuIdentity


def model_of(samples):
    engine = RunningAllan(ImuIdentity(), ('gyro_x',))
    engine.update(samples[:, None], 0, (len(samples) - 1) * 10**9)
    engine.end_segment()
    return fit_noise(engine.sums)


def test_a_longer_record_is_recommended_for_unresolved_terms():
    model = model_of(np.random.default_rng(0).normal(size=3000))
    (found,) = [f for f in model.findings if f.id == 'record_longer']
    assert model.axes['gyro_x'].noise['K'].status == 'not_observable'
    assert found.severity == 'info' and 'B' in found.message and found.axes == ('gyro_x',)
    assert any(unit in found.remedy for unit in (' min', ' h', ' days', ' s'))


def test_high_pass_filtered_drift_is_reported_as_bounded():
    """White noise behind a high-pass filter of 2500 s; 0.4 % of clean records are false alarms."""
    rng = np.random.default_rng(0)
    white = rng.normal(size=60_000)
    b, a = butter(1, 4e-4, 'high')
    (found,) = [f for f in model_of(lfilter(b, a, white)).findings if f.id == 'levels_off']
    assert 'bounded' in found.message
    assert 'levels_off' not in {f.id for f in model_of(white).findings}
