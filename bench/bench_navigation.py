# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Consistency of the inertial navigation of pyins on a robot that drives and stops.

    python bench/bench_navigation.py [RECORDS]     8 records, about 20 min

Needs the extra "consumers" (python-ins). A recording of 20 drives is analyzed. The error-state
Kalman filter of pyins then runs on 10 other drives with the exported numbers, and receives nothing
but a velocity of 0 in the rests. Its state at the end of the last 8 drives is compared with the
truth: the NEES is the squared error over the predicted variance, of the velocity (3 numbers, the
first measurement after the drive) and of roll and pitch. 1 is right. The exports are the noise at
rest, the noise in motion (--motion), and the noise at rest with states for the matrix of scale
factors and misalignments of the gyro.
"""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import numpy as np
from bench_motion import MEMS, RATE, batch

import allan_ros as ar
from allan_ros.core.simulate_drives import MotionErrors, Route, SimulatedDrives, simulate_drives

CASES: dict[str, dict[str, float]] = {
    'as at rest': {},
    'N of the gyro x3': {'gyro_noise': 3.0},
    'gyro scale factor 0.5 %': {'gyro_scale': 0.005},
    'gyro misalignment 5 mrad': {'gyro_misalignment': 0.005},
    'motors heat the gyro, 0.03 deg/s': {'heating': 5e-4},
    'vibration 0.1 m/s^2': {'vibration': 0.1},
}

EXPORTS = ('at rest', 'in motion', 'at rest, with calibration states')

USED, LEARNING, TESTED = 20, 2, 8
"""Drives that are analyzed, in which the filter learns the biases, and in which it is tested."""

BIAS_SD = 1e-3, 0.03
"""Initial standard deviation of the bias of gyro (rad/s) and accelerometer (m/s^2)."""

MATRIX_SD = 0.005
"""Initial standard deviation of scale factors and misalignments of the gyro."""

LEVEL_SD, AZIMUTH_SD, VELOCITY_SD = 0.1, 0.5, 0.01
"""Initial standard deviations in deg and m/s."""

ZUPT_SD, ZUPT_S, MARGIN_S = 0.005, 0.5, 0.5
"""Standard deviation of a measured velocity in m/s, its period, and the time in s to each drive."""

LATITUDE, ALTITUDE = 48.0, 735.0
"""Place where gravity is 9.80665 m/s^2, in deg and m."""

TO_NED = np.array([1.0, -1.0, -1.0])
"""Forward, left, up to forward, right, down."""


class Nees(NamedTuple):
    """NEES of one record."""

    velocity: float
    tilt: float


def increments(robot: SimulatedDrives, begin: int) -> Any:
    """Return the increments of pyins of the samples from an index on."""
    import pandas as pd
    from pyins import strapdown

    samples = robot.samples[begin:] * np.tile(TO_NED, 2) / RATE
    rows = np.concatenate([samples[:1], samples])  # each row is the integral since the row before
    time = pd.Index((begin + np.arange(len(rows))) / RATE, name='time')
    columns = [f'{sensor}_{axis}' for sensor in ('gyro', 'accel') for axis in 'xyz']
    imu = pd.DataFrame(rows, index=time, columns=columns)
    return strapdown.compute_increments_from_imu(imu, 'increment')


def models(results: ar.Results, export: str) -> list[Any]:
    """Return the sensor models of pyins from an exported file."""
    from pyins.inertial_sensor import EstimationModel

    read: dict[str, Any] = {}
    exec(results.export('pyins', motion=export == 'in motion'), read)
    gyro, accel = read['models'](*BIAS_SD)
    if export == EXPORTS[2]:
        matrix = np.full((3, 3), MATRIX_SD)
        gyro = EstimationModel(BIAS_SD[0], read['gyro_noise'], read['gyro_bias_walk'], matrix)
    return [gyro, accel]


def navigate(robot: SimulatedDrives, results: ar.Results, export: str, seed: int) -> Nees:
    """Run the filter in the last drives, and compare its state at their ends with the truth."""
    import pandas as pd
    from pyins import filters, measurements

    rng = np.random.default_rng(seed)
    drives = robot.drives[USED:]
    begin = robot.drives[USED - 1][1] + round(MARGIN_S * RATE)
    true = np.degrees(robot.angles * TO_NED)
    names = ['lat', 'lon', 'alt', 'VN', 'VE', 'VD', 'roll', 'pitch', 'heading']
    deviations = np.array([VELOCITY_SD] * 3 + [LEVEL_SD] * 2 + [AZIMUTH_SD])
    pva = np.concatenate([[LATITUDE, 0.0, ALTITUDE], np.zeros(3), true[begin]])
    pva[3:] += deviations * rng.standard_normal(6)
    edges = [begin, *(edge for drive in drives for edge in drive), len(robot.samples)]
    margin = round(MARGIN_S * RATE)
    at = np.concatenate(
        [
            np.arange(first + margin, last - margin, round(ZUPT_S * RATE))
            for first, last in zip(edges[::2], edges[1::2])
        ]
    )
    zero = pd.DataFrame(np.zeros((len(at), 3)), at / RATE, ['VN', 'VE', 'VD'])
    found = filters.run_feedback_filter(
        pd.Series(pva, names, name=begin / RATE),
        1.0,
        VELOCITY_SD,
        LEVEL_SD,
        AZIMUTH_SD,
        increments(robot, begin),
        *models(results, export),
        [measurements.NedVelocity(zero, ZUPT_SD)],
        time_step=0.5,
    )
    seen = found.innovations['NedVelocity']
    velocity, tilt = [], []
    for _, end in drives[LEARNING:]:
        first = seen.index[np.searchsorted(seen.index, end / RATE)]
        velocity.append(np.mean(seen.loc[first].to_numpy() ** 2))
        known = found.trajectory_sd.index
        before = known[np.searchsorted(known, first - 1e-6) - 1]
        levels = ['roll', 'pitch']
        wrong = found.trajectory.loc[before, levels].to_numpy() - true[round(before * RATE), :2]
        tilt.append(np.mean((wrong / found.trajectory_sd.loc[before, levels].to_numpy()) ** 2))
    return Nees(float(np.mean(velocity)), float(np.mean(tilt)))


def main(records: int) -> None:
    """Print the table."""
    print('| errors of the IMU in motion | ' + ' | '.join(EXPORTS) + ' |')
    print('|---' * (len(EXPORTS) + 1) + '|')
    for name, errors in CASES.items():
        found: dict[str, list[Nees]] = {export: [] for export in EXPORTS}
        for seed in range(records):
            route = Route(drives=USED + LEARNING + TESTED)
            gyro, accel = ([model] * 3 for model in MEMS)
            settings = MotionErrors(latitude=LATITUDE, **errors)
            robot = simulate_drives(RATE, gyro, accel, route, settings, seed)
            results = ar.analyze(batch(robot.samples[: robot.drives[USED][0]]))
            for export in EXPORTS:
                found[export].append(navigate(robot, results, export, seed))
        cells = ('{:.2f}, {:.2f}'.format(*np.median(found[e], axis=0)) for e in EXPORTS)
        print(f'| {name} | ' + ' | '.join(cells) + ' |', flush=True)


if __name__ == '__main__':
    main(int(sys.argv[1]) if sys.argv[1:] else 8)
