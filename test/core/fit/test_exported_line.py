# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The model in results.json describes the measured curve."""

import json
import math
import runpy

import numpy as np
import pytest
from scipy.signal import butter, lfilter

import allan_ros as ar
from allan_ros.core.noise import Model
from allan_ros.core.simulator import simulate_axis
from allan_ros.results.documents import results_from_document, results_to_document

RATE, N = 100.0, 120_000


def octave_ratios(results, longest):
    """Yield axis and median of curve over line in each octave of tau up to a time."""
    document = json.loads(json.dumps(results_to_document(results)))
    again = results_from_document(document)
    for name in again:
        axis, curve = again[name], results[name].curve
        at = (curve.m >= axis.fit.m_min) & (curve.m * axis.tau0 <= longest)
        tau = curve.m[at] * axis.tau0
        ratio = curve.adev[at] / np.sqrt(axis.fit.model.avar(tau, axis.tau0))
        octave = np.floor(np.log2(tau / tau[0]))
        for o in np.unique(octave):
            yield name, tau[octave == o][0], float(np.median(ratio[octave == o]))


def samples_of(kind):
    rng = np.random.default_rng([ord(c) for c in kind])
    terms = Model.of(N=1e-3, B=2e-4, K=2e-5)
    y = np.stack([simulate_axis(N, 1.0 / RATE, terms, rng) for _ in range(3)], axis=1)
    t = np.arange(N)[:, None] / RATE
    if kind == 'ramp':
        y += 1e-6 * t
    elif kind == 'vibration':
        y += 0.03 * np.sin(2.0 * np.pi * (17.3 * t + rng.uniform(size=3)))
    elif kind == 'filtered':
        y = lfilter(*butter(2, 0.2), y, axis=0)
        y[:1000] = y[1000:2000]
    elif kind == 'resonance':
        phi = np.exp(-1.0 / 20.0 + 2j * np.pi * 0.12)
        steps = rng.standard_normal((N, 3)) + 1j * rng.standard_normal((N, 3))
        y += 4e-3 * lfilter([1.0], [1.0, -phi], steps, axis=0).real
    elif kind == 'Gauss-Markov':
        phi = math.exp(-1.0 / (RATE * 5.0))
        steps = 2e-3 * math.sqrt(1.0 - phi * phi) * rng.standard_normal((N, 3))
        y += lfilter([1.0], [1.0, -phi], steps, axis=0)
    return y


@pytest.mark.parametrize(
    'kind', ['terms', 'ramp', 'vibration', 'filtered', 'resonance', 'Gauss-Markov']
)
def test_the_exported_line_is_near_the_curve(kind):
    """Every octave up to T/20 within .8 to 1.25: five standard deviations of the curve there."""
    y = samples_of(kind)
    results = ar.analyze(np.hstack([y, y + (0.0, 0.0, 9.8)]), rate=RATE, motion_gate=False)
    for name, tau, ratio in octave_ratios(results, N / RATE / 20.0):
        assert 0.8 < ratio < 1.25, (name, tau)


@pytest.mark.parametrize('name', ['dot01', 'imutest_mti'])
def test_the_exported_line_is_near_the_curve_of_recordings(name, shared_data):
    """Real noise is not stationary: a factor of two in every octave, and 1.25 in nine of ten."""
    load = runpy.run_path(str(shared_data / 'static' / 'load.py'))['load']
    t, gyro, accel = load(name)
    y = np.hstack([gyro, accel])
    rate = 1.0 / float(np.median(np.diff(t)))
    y = y[np.isfinite(y).all(axis=1)]
    results = ar.analyze(y, rate=rate, motion_gate=False)
    ratios = [r for _, _, r in octave_ratios(results, results.duration_s / 20.0)]
    assert min(ratios) > 0.5 and max(ratios) < 2.0
    assert np.mean([0.8 < r < 1.25 for r in ratios]) > 0.9, ratios
