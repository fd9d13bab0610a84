# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drives that a stream collects between two rests."""

from __future__ import annotations

import numpy as np
import pytest
from support.simulate_drives import Route, SimulatedDrives, simulate_drives

from allan_ros.core.imu import ImuBatch
from allan_ros.core.noise import Model
from allan_ros.core.stream.drive_recorder import Drives
from allan_ros.core.stream.pipeline import ImuStream

RATE = 50.0
GYRO, ACCEL = [Model.of(N=7e-5)] * 3, [Model.of(N=1e-3)] * 3


@pytest.fixture(scope='module')
def robot() -> SimulatedDrives:
    """Return the samples of six drives of 8 to 15 s."""
    return simulate_drives(RATE, GYRO, ACCEL, Route(drives=6, shortest=8.0, longest=15.0), seed=2)


def drives_of(
    samples: np.ndarray, size: int = 5000, keep: np.ndarray | None = None, set_back: int = 0
) -> Drives:
    """Return the drives; at sample ``set_back``, if not 0, the clock is set back by 1000 s."""
    stamps = (np.arange(len(samples)) * round(1e9 / RATE)).astype(np.int64)
    if set_back:
        stamps[:set_back] += 10**12
    if keep is not None:
        stamps, samples = stamps[keep], samples[keep]
    stream = ImuStream(with_drives=True)
    for at in range(0, len(stamps), size):
        stream.update(ImuBatch(stamps[at : at + size], samples[at : at + size]))
    stream.end()
    return stream.drives()


def test_every_drive_between_two_rests_is_found(robot: SimulatedDrives) -> None:
    drives = drives_of(robot.samples)
    assert len(drives.errors) == 6
    assert not drives.unused
    for found, (begin, end) in zip(drives.errors, robot.drives):
        assert (end - begin) / RATE <= found.duration <= (end - begin) / RATE + 5.0
        assert found.start <= begin / RATE


def test_the_drives_do_not_depend_on_the_size_of_the_batches(robot: SimulatedDrives) -> None:
    first, *others = (drives_of(robot.samples, size).errors for size in (7, 1001, 100000))
    for other in others:
        for a, b in zip(first, other, strict=True):
            assert np.array_equal(a.residual, b.residual)
            assert np.array_equal(a.slow, b.slow)


def test_a_drive_with_missing_samples_is_not_used(robot: SimulatedDrives) -> None:
    begin, end = robot.drives[2]
    keep = np.ones(len(robot.samples), bool)
    keep[(begin + end) // 2 : (begin + end) // 2 + 100] = False
    drives = drives_of(robot.samples, keep=keep)
    assert len(drives.errors) == 5
    assert drives.unused == {'gap': 1}


@pytest.mark.parametrize('size', [50, 1001, 100_000])
def test_only_the_drive_in_which_the_clock_is_set_back_is_not_used(
    robot: SimulatedDrives, size: int
) -> None:
    begin, end = robot.drives[2]
    drives = drives_of(robot.samples, size, set_back=(begin + end) // 2)
    assert len(drives.errors) == 5
    assert drives.unused == {'gap': 1}


def test_a_gap_at_rest_is_no_drive(robot: SimulatedDrives) -> None:
    middle = (robot.drives[1][1] + robot.drives[2][0]) // 2
    keep = np.ones(len(robot.samples), bool)
    keep[middle : middle + 100] = False
    drives = drives_of(robot.samples, keep=keep)
    assert len(drives.errors) == 6
    assert not drives.unused


def test_a_drive_of_more_than_three_minutes_is_not_used() -> None:
    route = Route(drives=1, shortest=200.0, longest=200.0, rest=20.0)
    robot = simulate_drives(RATE, GYRO, ACCEL, route, seed=1)
    for size in (500, 100000):
        drives = drives_of(robot.samples, size)
        assert drives.errors == ()
        assert drives.unused == {'long': 1}


def test_a_sensor_alone_gives_no_drives(robot: SimulatedDrives) -> None:
    samples = robot.samples.copy()
    samples[:, 3:] = np.nan
    assert drives_of(samples) == Drives()


def test_the_drives_of_two_recordings_are_added(robot: SimulatedDrives) -> None:
    drives = drives_of(robot.samples)
    both = drives + drives
    assert both.errors == (*drives.errors, *drives.errors)
