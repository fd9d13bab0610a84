# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drives: residuals, the effect of errors on them, and their covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.simulate_drives import MotionErrors, Route, simulate_drives

from allan_ros.core.filters.motion_factors import axis_noise
from allan_ros.core.noise import Model
from allan_ros.core.stream.drives import ROTATION, VELOCITY, Drive, Rest, drive_errors

RATE = 50.0
TINY = [Model.of(N=1e-12)] * 3
RNG = np.random.default_rng(11)


def one_drive(seed: int = 1, **route: float) -> Drive:
    """Return a drive without noise or errors, except the rotation of the Earth."""
    robot = simulate_drives(RATE, TINY, TINY, Route(drives=1, **route), seed=seed)
    ((begin, end),) = robot.drives
    gyro, accel = robot.samples[:, :3], robot.samples[:, 3:]

    def rest(part: slice) -> Rest:
        return Rest(gyro[part].mean(axis=0), accel[part].mean(axis=0), len(gyro[part]) / RATE)

    ends = rest(slice(0, begin)), rest(slice(end, None))
    return Drive(0.0, 1.0 / RATE, gyro[begin:end], accel[begin:end], *ends)


def with_errors(drive: Drive, gyro: np.ndarray, accel: np.ndarray, g: np.ndarray) -> Drive:
    """Return the drive as measured by an IMU with three error matrices."""

    def rest(one: Rest) -> Rest:
        rates = one.gyro + gyro @ one.gyro + g @ one.accel
        return replace(one, gyro=rates, accel=one.accel + accel @ one.accel)

    return replace(
        drive,
        gyro=drive.gyro + drive.gyro @ gyro.T + drive.accel @ g.T,
        accel=drive.accel + drive.accel @ accel.T,
        before=rest(drive.before),
        after=rest(drive.after),
    )


@pytest.mark.parametrize('error', ['gyro_matrix', 'accel_matrix', 'g_sensitivity'])
def test_the_effect_of_a_matrix_is_that_of_a_sensor_with_this_matrix(error: str) -> None:
    matrices = {name: np.zeros((3, 3)) for name in ('gyro_matrix', 'accel_matrix', 'g_sensitivity')}
    matrices[error] = 1e-6 * RNG.standard_normal((3, 3))
    drive = one_drive()
    without = drive_errors(drive)
    with_error = drive_errors(with_errors(drive, *matrices.values()))
    change = with_error.residual - without.residual
    predicted = getattr(without, error) @ matrices[error].ravel()
    assert change == pytest.approx(predicted, rel=2e-2, abs=2e-3 * np.abs(predicted).max())


def test_a_constant_bias_of_the_accelerometer_has_the_stated_effect() -> None:
    drive, bias = one_drive(), np.array([1e-4, -2e-4, 3e-4])

    def rest(one: Rest) -> Rest:
        return replace(one, accel=one.accel + bias)

    changed = replace(
        drive, accel=drive.accel + bias, before=rest(drive.before), after=rest(drive.after)
    )
    without = drive_errors(drive)
    change = drive_errors(changed).residual - without.residual
    assert change == pytest.approx(without.accel_bias @ bias, rel=1e-4, abs=1e-8)
    assert without.slow.sum(axis=0) == pytest.approx(np.zeros((9, 6)), abs=1e-9)


def test_the_rotation_of_the_earth_explains_the_residual_of_a_perfect_imu() -> None:
    found = drive_errors(one_drive())
    rate, *_ = np.linalg.lstsq(found.earth[:6], found.residual[:6], rcond=None)
    assert np.linalg.norm(rate) == pytest.approx(7.29e-5, rel=0.1)
    left = found.residual - found.earth @ rate
    for rows in (ROTATION, VELOCITY, slice(6, 9)):
        assert np.linalg.norm(left[rows]) < 0.1 * np.linalg.norm(found.residual[rows])


@pytest.mark.parametrize(
    ('sensor', 'terms'),
    [
        ('gyro', Model.of(N=7e-5)),
        ('gyro', Model.of(K=5e-6)),
        ('accel', Model.of(N=1e-3)),
        ('accel', Model.of(K=5e-5)),
    ],
    ids=['gyro N', 'gyro K', 'accel N', 'accel K'],
)
def test_the_covariance_is_that_of_simulated_noise(sensor: str, terms: Model) -> None:
    """The mean of y^2 over its variance for 60 drives and 3 rows has a standard deviation of at
    most sqrt(2/60); 6 deviations for the correlated rows: false alarm below 1e-6.
    """
    noise = {'gyro': TINY, 'accel': TINY} | {sensor: [terms] * 3}
    own = axis_noise(terms, 0.05)
    axes = range(3) if sensor == 'gyro' else range(3, 6)
    density = [terms.value('N') * (axis in axes) for axis in range(6)]
    route = Route(drives=15, speed=0.0, turn=0.0, shortest=5.0, longest=20.0)
    rows = slice(0, 2) if sensor == 'gyro' else slice(3, 6)
    ratios = []
    for seed in range(4):
        robot = simulate_drives(20.0, noise['gyro'], noise['accel'], route, MotionErrors(), seed)
        for k, (begin, end) in enumerate(robot.drives):
            gyro, accel = robot.samples[:, :3], robot.samples[:, 3:]
            former = robot.drives[k - 1][1] if k else 0
            after = robot.drives[k + 1][0] if k + 1 < len(robot.drives) else len(gyro)

            def rest(first: int, last: int, g=gyro, a=accel) -> Rest:
                return Rest(g[first:last].mean(0), a[first:last].mean(0), (last - first) / 20.0)

            drive = Drive(
                0.0, 0.05, gyro[begin:end], accel[begin:end], rest(former, begin), rest(end, after)
            )
            found = drive_errors(drive)
            variance = np.diag(found.earth @ found.earth.T) * 7.3e-5**2
            variance = variance + np.diag(sum(found.white_covariances(density).values()))
            if terms.value('K'):
                slow = (found.slow_covariance(axis, own.slow) for axis in axes)
                variance = variance + np.diag(sum(slow))
            variance = variance[rows]
            ratios.append(np.mean(found.residual[rows] ** 2 / variance))
    assert 0.3 < np.mean(ratios) < 2.0
