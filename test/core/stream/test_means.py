# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Means over a second: the same for any chunking, never across a gap."""

from __future__ import annotations

import numpy as np
import pytest

from allan_ros.core.imu import ImuBatch
from allan_ros.core.stream.health import KEPT_MEANS, RunningMeans
from allan_ros.core.stream.pipeline import ImuStream

STEP_NS = 10_000_000


def samples(count: int, start_ns: int = 0) -> tuple[np.ndarray, np.ndarray]:
    stamps = start_ns + STEP_NS * np.arange(count)
    return stamps, np.random.default_rng(1).normal(size=(2, count))


@pytest.mark.parametrize('chunk', [1, 7, 100, 1000])
def test_the_means_do_not_depend_on_the_chunks(chunk: int) -> None:
    stamps, rows = samples(1000)
    running = RunningMeans(('gyro_x', 'gyro_y'))
    for at in range(0, 1000, chunk):
        running.update(stamps[at : at + chunk], rows[:, at : at + chunk])
    means = running.means
    expected = rows[:, :900].reshape(2, 9, 100).mean(axis=2).T
    np.testing.assert_allclose(means.values, expected)
    whole = RunningMeans(('gyro_x', 'gyro_y'))
    whole.update(stamps, rows)
    assert np.array_equal(means.values, whole.means.values)
    assert means.end_ns.tolist() == [10**9 * (i + 1) for i in range(9)]


def test_a_gap_drops_the_mean_in_progress() -> None:
    stamps, rows = samples(150)
    running = RunningMeans(('gyro_x', 'gyro_y'))
    running.update(stamps, rows)
    running.cut()
    later, more = samples(250, 50 * 10**9)
    running.update(later, more)
    assert running.means.end_ns.tolist() == [10**9, 51 * 10**9, 52 * 10**9]
    np.testing.assert_allclose(running.means.values[1], more[:, :100].mean(axis=1))


def test_only_the_latest_are_kept() -> None:
    stamps, rows = samples(100 * (KEPT_MEANS + 20))
    running = RunningMeans(('gyro_x', 'gyro_y'))
    running.update(stamps, rows)
    assert len(running.means.end_ns) == KEPT_MEANS


def test_a_stream_has_means_of_static_samples_only() -> None:
    rng = np.random.default_rng(2)
    count = 60_00
    values = rng.normal(0.5, 0.01, size=(count, 6))
    values[3000:3500, :3] += rng.normal(0.0, 1.0, size=(500, 3))  # 5 s of motion
    stream = ImuStream()
    stream.update(ImuBatch(10**18 + STEP_NS * np.arange(count), values))
    (means,) = stream.means()
    assert means.axes[0] == 'gyro_x'
    seconds = (means.end_ns - 10**18) * 1e-9
    assert not np.any((seconds > 30.5) & (seconds < 35.0))
    assert len(seconds) > 40
    np.testing.assert_allclose(means.values, 0.5, atol=0.01)
