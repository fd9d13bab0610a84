# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Consistency of an inertial navigation filter (pyins) on a robot that drives and stops.

    python bench/bench_navigation.py [RECORDS]     8 records, about 20 min

A recording of 20 drives is analyzed. With the exported noise, the filter runs on 10 more drives,
and receives a velocity of 0 at the rests. After each of the last 8 drives, the NEES of the velocity
and of roll and pitch is computed; 1 is right. Three exports are compared: the noise at rest, the
noise with --motion, and the noise at rest with additional states for the scale factors and
misalignments of the gyro. The package `python-ins` is needed (extra "consumers").
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))  # contains `support`

from bench_motion import MEMS, RATE, batch
from support.simulate_drives import MotionErrors, Route, SimulatedDrives, simulate_drives

import allan_ros as ar

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
"""Number of drives that are analyzed, that teach the filter the biases, and that are tested."""

BIAS_SD = 1e-3, 0.03
"""Initial standard deviations of the biases of gyro (rad/s) and accelerometer (m/s^2)."""

MATRIX_SD = 0.005
"""Initial standard deviation of scale factors (relative) and misalignments (rad) of the gyro."""

LEVEL_SD, AZIMUTH_SD, VELOCITY_SD = 0.1, 0.5, 0.01
"""Initial standard deviations of roll and pitch (deg), heading (deg) and velocity (m/s)."""

ZUPT_SD, ZUPT_S, MARGIN_S = 0.005, 0.5, 0.5
"""Standard deviation of the velocity measurements at rest in m/s, their period in s, and time in s
between a drive and the nearest measurement."""

LATITUDE, ALTITUDE = 48.0, 735.0
"""Latitude in deg and altitude in m of a place where gravity is 9.80665 m/s^2."""

TO_NED = np.array([1.0, -1.0, -1.0])
"""Factors that turn axes forward, left, up into axes forward, right, down."""


class Nees(NamedTuple):
    """NEES of the velocity and of roll and pitch, averaged over the tested drives of a record."""

    velocity: float
    tilt: float


def increments(robot: SimulatedDrives, begin: int) -> Any:
    """Return the samples from index ``begin`` on as increments (integrals) for pyins."""
    import pandas as pd
    from pyins import strapdown

    samples = robot.samples[begin:] * np.tile(TO_NED, 2) / RATE
    rows = np.concatenate([samples[:1], samples])  # a row is the integral from the previous row
    time = pd.Index((begin + np.arange(len(rows))) / RATE, name='time')
    columns = [f'{sensor}_{axis}' for sensor in ('gyro', 'accel') for axis in 'xyz']
    imu = pd.DataFrame(rows, index=time, columns=columns)
    return strapdown.compute_increments_from_imu(imu, 'increment')


def models(results: ar.Results, export: str) -> list[Any]:
    """Return the models of gyro and accelerometer for pyins, from an exported file."""
    from pyins.inertial_sensor import EstimationModel

    read: dict[str, Any] = {}
    exec(results.export('pyins', motion=export == 'in motion'), read)
    gyro, accel = read['models'](*BIAS_SD)
    if export == EXPORTS[2]:
        matrix = np.full((3, 3), MATRIX_SD)
        gyro = EstimationModel(BIAS_SD[0], read['gyro_noise'], read['gyro_bias_walk'], matrix)
    return [gyro, accel]


def navigate(robot: SimulatedDrives, results: ar.Results, export: str, seed: int) -> Nees:
    """Run the filter in the drives that were not analyzed, and return its NEES."""
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
    """Simulate the records of each case, and print the table of the median NEES."""
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
