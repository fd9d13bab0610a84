# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of the noise level are found with size and time; steady noise has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import fdtri
from support.sums import TICK_NS

from allan_ros.core.allan.curve import edf
from allan_ros.core.allan.recent import noise_steps
from allan_ros.core.allan.running import RunningSums
from allan_ros.core.errors import AllanError

TAU0 = TICK_NS * 1e-9


class Stream:
    """White noise of one axis at 100 Hz, with a standard deviation that the test sets."""

    def __init__(self, seed=0, start=0):
        self.rng, self.engine = np.random.default_rng(seed), RunningSums(axes=('gyro_x',))
        self.start = self.now = start

    def play(self, seconds, scale=1.0):
        n = round(seconds / TAU0)
        rows = scale * self.rng.normal(size=(n, 1))
        self.engine.update(rows, self.now * TICK_NS, (self.now + n - 1) * TICK_NS)
        self.now += n
        return self

    def step(self, window_s=600.0):
        return noise_steps(self.engine.sums, window_s).get('gyro_x')


def test_an_increase_is_found_with_its_size_and_time():
    found = Stream().play(900).play(300, 1.5).step()
    assert found.ci95[0] < 1.5 < found.ci95[1] and found.ci95[1] / found.ci95[0] < 1.04
    assert found.since_s == pytest.approx(300.0, rel=0.25)
    assert found.before == pytest.approx(found.tau**-0.5 * TAU0**0.5, rel=0.02)
    assert found.beyond(0.2) and not found.beyond(0.6)


def test_changes_are_found_within_a_period_and_in_both_directions():
    """The shortest period has 4096 samples, here 41 s."""
    found = Stream().play(600).play(15, 1.5).step()
    assert found.since_s < 42.0 and found.ci95[0] > 1.0
    assert Stream().play(600).play(80, 1.5).step().beyond(0.2)
    assert Stream().play(600).play(300, 0.5).step().beyond(0.5)


def test_a_disturbance_that_has_ended_is_not_a_change():
    stream = Stream().play(900).play(100, 1.5)
    assert stream.step().beyond(0.2)
    found = stream.play(90).step()
    assert not found.beyond(0.2) and found.ratio == pytest.approx(1.0, rel=0.1)
    assert found.since_s == pytest.approx(90.0, abs=41.0)


def test_a_second_increase_is_compared_with_the_level_before_the_first():
    found = Stream().play(900).play(200, 1.5).play(100, 2.5).step()
    assert found.ratio == pytest.approx(2.5, rel=0.05)
    assert found.since_s == pytest.approx(100.0, rel=0.3)


def test_steady_noise_has_no_step():
    """False alarm probability: 2e-7 at each of 40 checks."""
    stream = Stream()
    for _ in range(40):
        assert stream.play(30).step() is None


def test_an_earlier_recording_belongs_to_the_earlier_data():
    """A restarted node continues from its checkpoint, so recent noise is compared with data
    before the restart.
    """
    first = Stream(seed=1).play(600).engine.sums
    later = Stream(seed=2, start=10**8).play(100, 1.5).engine.sums
    for total in (first + later, later + first):
        found = noise_steps(total, 3600.0)['gyro_x']
        assert found.beyond(0.2) and found.ratio == pytest.approx(1.5, rel=0.02)
        assert found.since_s == pytest.approx(100.0, abs=3.0)


def test_the_interval_takes_the_stride_of_the_differences_into_account():
    """At the averaging factor 24, differences start 2 samples apart. Only this factor has data."""
    sums = Stream().play(900).play(300, 1.5).engine.sums
    is_kept = sums.m == 24
    periods = tuple(
        replace(
            p,
            count=np.where(is_kept[: len(p.count)], p.count, 0),
            sum_sq=np.where(is_kept[: len(p.count), None], p.sum_sq, 0.0),
        )
        for p in sums.recordings[0].periods
    )
    found = noise_steps(
        replace(sums, recordings=(replace(sums.recordings[0], periods=periods),)), 600.0
    )['gyro_x']
    assert found.tau == pytest.approx(24 * TAU0)
    index = list(sums.m).index(24)
    total = int(sums.count[index])
    after = round(found.since_s / TAU0) / 2
    edf_after, edf_before = (
        edf(0, 24, 2, total) * share for share in (after / total, 1.0 - after / total)
    )
    low, high = (fdtri(edf_after, edf_before, q) ** -0.5 for q in (0.975, 0.025))
    assert found.ci95 == pytest.approx((found.ratio * low, found.ratio * high), rel=1e-3)


def test_short_recordings_are_not_compared():
    assert noise_steps(RunningSums(axes=('gyro_x',)).sums, 60.0) == {}
    assert Stream().play(1).step() is None


def test_a_window_of_zero_is_rejected():
    with pytest.raises(AllanError, match='window'):
        Stream().play(10).step(0.0)
