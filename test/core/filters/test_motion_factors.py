# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Factors of the errors in motion, and the causes that explain them."""

from __future__ import annotations

import numpy as np
import pytest
from support.simulate_drives import MotionErrors, Route, SimulatedDrives, simulate_drives

from allan_ros.core.estimate import Estimate
from allan_ros.core.filters.motion_factors import (
    TYPICAL_SHARE,
    DriveRatio,
    NoiseInMotion,
    SensorInMotion,
    axis_noise,
    noise_in_motion,
)
from allan_ros.core.noise import Model
from allan_ros.core.stream.drive_recorder import LEAST_DRIVES
from allan_ros.core.stream.drives import Drive, DriveErrors, Rest, drive_errors

RATE = 50.0
GYRO, ACCEL = Model.of(N=7e-5, K=5e-6), Model.of(N=1.2e-3, K=5e-5)


NOISE = [axis_noise(GYRO, 1.0 / RATE)] * 3 + [axis_noise(ACCEL, 1.0 / RATE)] * 3


def drives_of(seed: int, drives: int = 16, route: dict | None = None, **errors: float) -> list:
    robot = simulate_drives(
        RATE,
        [GYRO] * 3,
        [ACCEL] * 3,
        Route(drives=drives, **(route or {})),
        MotionErrors(**errors),
        seed,
    )
    return errors_of(robot)


def errors_of(robot: SimulatedDrives) -> list[DriveErrors]:
    gyro, accel = robot.samples[:, :3], robot.samples[:, 3:]
    edges = [0, *(at for drive in robot.drives for at in drive), len(gyro)]

    def rest(first: int, last: int) -> Rest:
        return Rest(gyro[first:last].mean(0), accel[first:last].mean(0), (last - first) / RATE)

    return [
        drive_errors(Drive(b / RATE, 1.0 / RATE, gyro[b:c], accel[b:c], rest(a, b), rest(c, d)))
        for a, b, c, d in zip(edges[::2], edges[1::2], edges[2::2], edges[3::2])
    ]


def test_an_imu_that_is_as_at_rest_has_the_factor_one() -> None:
    """The intervals contain 1 in at least 95 % of the records; both of three in five: false alarm
    below 1 %.
    """
    inside = [
        found['gyro'].ci95[0] < 1.0 < found['gyro'].ci95[1]
        and found['accel'].ci95[0] < 1.0 < found['accel'].ci95[1]
        for seed in range(5)
        if (found := noise_in_motion(drives_of(seed), NOISE)) is not None
    ]
    assert len(inside) == 5
    assert sum(inside) >= 3


@pytest.mark.parametrize(
    'drives, factor, ends, worse',
    [
        (20, 1.2, (1.01, 1.43), False),
        (20, 1.2, (1.1, 1.31), True),
        (20, 1.2, (1.08, 1.33), True),
        (5, 1.2, (1.08, 1.33), False),
        (20, 0.8, (0.7, 0.9), False),
        (20, 1.2, None, False),
    ],
)
def test_a_sensor_is_worse_if_the_99_percent_interval_lies_above_1(
    drives: int, factor: float, ends: tuple[float, float] | None, worse: bool
) -> None:
    """The 99 % interval is 1.37 times as wide as the 95 % interval with 20 drives, and 1.84 times
    with five.
    """
    one = SensorInMotion(Estimate(factor, ends), None, None)
    motion = NoiseInMotion(one, one, (), drives * (DriveRatio(10.0, 1.0, 1.0, 1.0),))
    assert motion.is_worse('gyro') is worse


def test_an_unresolved_term_is_half_its_limit_if_another_drift_is_resolved() -> None:
    model, lags = Model.of(N=1e-3, K=5e-5), np.arange(4.0)
    known = axis_noise(Model.of(N=1e-3, B=TYPICAL_SHARE * 2e-4, K=5e-5), 0.02)
    assumed = axis_noise(model, 0.02, {'B': 2e-4})
    assert assumed.slow(1.0, lags) == pytest.approx(known.slow(1.0, lags))


def test_fewer_drives_than_the_least_number_give_no_result() -> None:
    drives = drives_of(1, LEAST_DRIVES)
    assert noise_in_motion(drives[:-1], NOISE) is None
    assert noise_in_motion(drives, NOISE) is not None


@pytest.mark.parametrize(
    ('cause', 'error', 'size', 'sensor'),
    [
        ('gyro_matrix', 'gyro_scale', 0.01, 'gyro'),
        ('gyro_matrix', 'gyro_misalignment', 0.01, 'gyro'),
        ('g_sensitivity', 'g_sensitivity', 5e-4, 'gyro'),
        ('accel_matrix', 'accel_scale', 0.02, 'accel'),
    ],
)
def test_an_error_of_calibration_is_found_as_the_cause(
    cause: str, error: str, size: float, sensor: str
) -> None:
    route = {'tilt': 0.15}  # slopes show scale factors of all axes
    found = noise_in_motion(drives_of(3, 20, route, **{error: size}), NOISE)
    assert found is not None
    assert found.causes[0].name == cause
    before, after = found[sensor], found.sensors[sensor].explained
    assert before.ci95[0] > 1.3
    assert after is not None
    assert after.ci95[0] < 1.2


def test_the_elements_of_the_matrix_are_estimated_within_their_intervals() -> None:
    """Nine elements at 95 % and correlated: at most three outside; false alarm below 1 %."""
    robot = simulate_drives(
        RATE,
        [GYRO] * 3,
        [ACCEL] * 3,
        Route(drives=20, tilt=0.15),
        MotionErrors(gyro_misalignment=0.005, gyro_scale=0.005),
        4,
    )
    found = noise_in_motion(errors_of(robot), NOISE)
    assert found is not None
    (cause,) = (each for each in found.causes if each.name == 'gyro_matrix')
    pairs = [
        (one, true)
        for one, true in zip(cause.elements, robot.gyro_matrix.ravel().tolist())
        if one.ci95 is not None
    ]
    assert len(pairs) >= 4
    assert sum(not one.ci95[0] <= true <= one.ci95[1] for one, true in pairs) <= 3


def test_nearly_flat_ground_shows_no_rotation_around_the_vertical() -> None:
    """The z element of the rotation between the sensors has no value, and no small interval."""
    found = noise_in_motion(drives_of(5, 20, {'tilt': 0.005}, gyro_misalignment=0.004), NOISE)
    assert found is not None
    (cause,) = found.causes
    assert cause.name == 'rotation'
    x, y, z = cause.elements
    assert x.ci95 and y.ci95
    assert not z.resolved and z.ci95 is None
    assert np.isnan(cause.matrix[:2, :2]).sum() == 2
    assert np.isfinite(cause.matrix[2]).all()


def test_more_white_noise_in_motion_is_told_from_more_drift() -> None:
    found = noise_in_motion(drives_of(6, 30, gyro_noise=5.0), NOISE)
    assert found is not None
    assert found['gyro'].ci95[0] > 1.0
    assert found.gyro.slow is None
    low, high = found.gyro.white.ci95
    assert low < 5.0 < high
    assert found['accel'].ci95[0] < 1.0
