# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A step in the noise is found with its size and time; none is found where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from allan_ros.core.allan.engine import RunningAllan
from allan_ros.core.allan.recent import PARTS, RecentView
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import AXES, ImuIdentity

RATE = 100.0
STEP_S = 10.0


def play(scale, view: RecentView, steps: int, seed: int = 0, running=None, start: int = 0):
    """Feed white noise of deviation scale(second); give the view the sums at each step."""
    rng = np.random.default_rng(seed)
    running = running or RunningAllan(ImuIdentity('imu'), AXES)
    n = int(STEP_S * RATE)
    for k in range(start, start + steps):
        stamps = np.round((np.arange(k * n, (k + 1) * n)) * 1e9 / RATE).astype(np.int64)
        noise = rng.normal(size=(n, 6)) * scale(k * STEP_S)
        running.update(noise, int(stamps[0]), int(stamps[-1]))
        view.update(running.sums, (k + 1) * STEP_S)
    return running


def test_a_rise_is_found_with_its_size_and_time():
    view = RecentView(600.0)
    play(lambda t: 1.5 if t >= 900.0 else 1.0, view, 120)
    changes = [c for c in view.changes() if c.m == 1]
    assert {c.axis for c in changes} == set(AXES)
    for change in changes:
        low, high = change.ratio_ci95
        assert low < 1.5 < high and high / low < 1.03
        assert change.since_s == pytest.approx(300.0, abs=STEP_S)
        assert change.before == pytest.approx(1.0, rel=0.02)
        assert change.after == pytest.approx(1.5, rel=0.02)
        assert change.beyond(0.2) and not change.beyond(0.6)


def test_it_is_found_within_two_updates():
    view = RecentView(600.0)
    running = play(lambda t: 1.0, view, 60)
    play(lambda t: 1.5, view, 2, seed=1, running=running, start=60)
    found = {c.axis for c in view.changes() if c.m == 1 and c.beyond(0.2)}
    assert found == set(AXES)


def test_a_fall_is_beyond_the_margin_too():
    view = RecentView(600.0)
    play(lambda t: 0.5 if t >= 600.0 else 1.0, view, 90)
    assert all(c.beyond(0.5) for c in view.changes() if c.m == 1)


def test_a_disturbance_that_passed_is_no_change_any_more():
    """One look at 6 axes: a 95 % interval has a margin of 20 % to go, so never in practice."""
    view = RecentView(600.0)
    running = play(lambda t: 1.5 if 900.0 <= t < 1000.0 else 1.0, view, 100)
    assert {c.axis for c in view.changes() if c.m == 1 and c.beyond(0.2)} == set(AXES)
    play(lambda t: 1.0, view, 2, seed=1, running=running, start=100)
    certain = {}
    for change in view.changes():
        known = certain.get(change.axis)
        if known is None or change.likelihood_ratio > known.likelihood_ratio:
            certain[change.axis] = change
    assert set(certain) == set(AXES)
    for change in certain.values():
        assert not change.beyond(0.2)
        assert change.after == pytest.approx(1.0 / np.sqrt(change.m), rel=0.1)
        assert change.since_s == pytest.approx(20.0, abs=STEP_S)


def test_a_second_rise_is_told_from_the_level_before_the_first():
    view = RecentView(600.0)
    play(lambda t: 1.0 + 0.5 * (t >= 900.0) + 1.0 * (t >= 1100.0), view, 120)
    for change in (c for c in view.changes() if c.m == 1):
        assert change.before == pytest.approx(1.0, rel=0.02)
        assert change.after == pytest.approx(2.5, rel=0.02)
        assert change.since_s == pytest.approx(100.0, abs=STEP_S)


def test_steady_noise_has_no_change():
    """60 looks at 6 axes and 60 splits: at 2e-7 a look, and of 20 %, never in practice."""
    view = RecentView(600.0)
    running = None
    for k in range(60):
        running = play(lambda t: 1.0, view, 2, seed=100 + k, running=running, start=2 * k)
        assert not [c for c in view.changes() if c.beyond(0.2)]
    curve = view.curve()
    assert curve.tau[-1] <= 150.0 and np.isfinite(curve.ratio).all()
    inside = (curve.ratio_low < 1.0) & (curve.ratio_high > 1.0)
    assert inside.mean() > 0.85


def test_the_recent_curve_is_that_of_the_window_alone():
    view = RecentView(300.0)
    play(lambda t: 3.0 if t >= 300.0 else 1.0, view, 60)
    curve = view.curve()
    assert curve.adev[0] == pytest.approx(np.full(6, 3.0), rel=0.02)
    assert curve.ratio[0] == pytest.approx(np.full(6, 3.0), rel=0.04)


def test_another_run_starts_anew():
    view = RecentView(300.0)
    play(lambda t: 1.0, view, 40)
    play(lambda t: 9.0, view, 1, start=40)  # sums of a new accumulator: fewer than before
    assert view.changes() == [] and view.curve() is None


def test_memory_is_bounded():
    view = RecentView(60.0)
    running = play(lambda t: 1.0, view, 1)
    for k in range(700):
        view.update(running.sums, 10.0 + 0.3 * k)
    assert len(view._ring) <= PARTS + 2


def test_a_window_must_have_a_length():
    with pytest.raises(AllanError, match='window'):
        RecentView(0.0)
