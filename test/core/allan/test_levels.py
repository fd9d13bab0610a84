# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scatter of the noise between parts widens the intervals; stationary noise has no scatter."""

import numpy as np
from support.drift import AXES, DEG_H, NOISE, SENSORS, sums_of_noise

from allan_ros.core.allan.engine import RunningAllan
from allan_ros.core.allan.levels import drift_scatter, level_changes, level_scatter
from allan_ros.core.fit import fit_noise
from allan_ros.core.fit.stationary import fit_stationary
from allan_ros.core.noise import NoiseTerms


def test_white_noise_that_changes_is_found_and_widens_the_interval_of_n():
    rng = np.random.default_rng(7)
    y = rng.normal(size=(200_000, 3))
    y[100_000:150_000, 0] *= 1.1
    engine = RunningAllan(axes=AXES)
    engine.update(y, 0, (len(y) - 1) * 10**9)
    sums = engine.sums
    ((axis, change),) = level_changes(sums.history.recordings).items()
    assert axis == 0 and 1.05 < change.high / change.low < 1.12
    _, model = fit_stationary(sums)
    (found,) = (f for f in model.findings if f.id == 'level_changes')
    assert found.axes == ('gyro_x',) and 'within the recording' in found.message
    low, high = model.axes['gyro_x'].noise['N'].ci95
    assert high / low > 1.1
    low, high = model.axes['gyro_y'].noise['N'].ci95
    assert high / low < 1.02


def test_recordings_with_different_noise_are_reported():
    rng = np.random.default_rng(8)
    total = None
    for scale in (1.0, 1.15, 0.9):
        engine = RunningAllan(axes=AXES)
        engine.update(scale * rng.normal(size=(30_000, 3)), 0, 29_999 * 10**9)
        total = engine.sums if total is None else total + engine.sums
    _, model = fit_stationary(total)
    found = [f for f in model.findings if f.id == 'level_changes']
    assert len(found) == 3 and 'between recordings' in found[0].message
    low, high = model.axes['gyro_x'].noise['N'].ci95
    assert low < 0.9 and high > 1.15


def relative_width(coefficient):
    low, high = coefficient.ci95
    return (high - low) / coefficient.value


def uneven_walk():
    """Return a random walk whose steps are 6 times larger in the third and fifth sixth."""
    steps = np.random.default_rng(1).normal(size=36_000) * 0.4 * DEG_H
    steps[12_000:18_000] *= 6.0
    steps[24_000:30_000] *= 6.0
    return np.cumsum(steps)


def test_drift_that_differs_between_sixths_widens_the_interval_of_k():
    sums = sums_of_noise(NoiseTerms(N=NOISE.N), 3, 36_000, uneven_walk())
    scatter = drift_scatter(sums.history.recordings, SENSORS)
    assert np.all(scatter > 0.3)
    _, model = fit_stationary(sums)
    assert [f.axes for f in model.findings if f.id == 'drift_changes'] == [AXES]
    before, after = (m.axes['gyro_y'].noise['K'] for m in (fit_noise(sums), model))
    assert after.value == before.value
    assert relative_width(after) > 1.5 * relative_width(before)


def test_drift_is_compared_from_two_minutes_on():
    """The same samples with stamps at different rates are tested only if they last 120 s."""
    for rate, axes in ((250.0, [AXES]), (1000.0, [])):
        sums = sums_of_noise(NoiseTerms(N=NOISE.N), 3, 36_000, uneven_walk(), rate=rate)
        assert drift_scatter(sums.history.recordings, SENSORS).all()
        _, model = fit_stationary(sums)
        assert [f.axes for f in model.findings if f.id == 'drift_changes'] == axes


def test_constant_drift_has_no_scatter():
    """0.1 % of clean sensors are false alarms by design: probability of one in 4 below 0.5 %;
    seeds fixed.
    """
    for seed in range(2):
        for terms in (NOISE, NoiseTerms(N=NOISE.N, K=32 * DEG_H / 60)):
            recordings = sums_of_noise(terms, 20 + seed).history.recordings
            assert not drift_scatter(recordings, SENSORS).any()


def test_recordings_with_different_drift_are_reported():
    quiet, loud = (
        sums_of_noise(NoiseTerms(N=NOISE.N, K=k * DEG_H / 60), seed, 20_000)
        for seed, k in ((1, 10.0), (2, 200.0))
    )
    assert drift_scatter((quiet + loud + quiet).history.recordings, SENSORS).all()


def test_heavy_tails_widen_the_interval_of_n():
    """The variance of Student's t with 3 degrees of freedom has no variance itself.

    Without the excess the interval covers N in 3 of 10 axes, with it in at least 19 of 20. Chance
    that 5 of 12 axes are missed: below 1e-3.
    """
    rng = np.random.default_rng(5)
    covered = 0
    for _ in range(4):
        y = rng.standard_t(3, size=(36_000, 3)) / np.sqrt(3.0)
        engine = RunningAllan(axes=AXES)
        engine.update(y, 0, (len(y) - 1) * 10**9)
        sums = engine.sums
        assert np.all(level_scatter(sums.history.recordings, 3) > 0.0)
        for axis in fit_stationary(sums)[1].axes.values():
            low, high = axis.noise['N'].ci95
            covered += low <= 1.0 <= high
    assert covered >= 8


def test_normal_noise_has_no_excess():
    """0.1 % of axes are false alarms by design: probability of one in 6 below 1 %; seeds fixed."""
    for seed in range(2):
        recordings = sums_of_noise(NOISE, 30 + seed, 100_000).history.recordings
        assert not level_scatter(recordings, 3).any()


def test_small_significant_changes_widen_the_interval_without_a_finding():
    """N changes by 1.6 % between the halves: over 20 standard deviations, but below the 2 % of a
    finding.
    """
    rng = np.random.default_rng(8)
    y = rng.normal(size=(400_000, 1))
    y[200_000:] *= 1.016
    engine = RunningAllan(axes=AXES[:1])
    engine.update(y, 0, (len(y) - 1) * 10**9)
    recordings = engine.sums.history.recordings
    assert not level_changes(recordings)
    assert 0.006 < level_scatter(recordings, 1)[0] < 0.012
