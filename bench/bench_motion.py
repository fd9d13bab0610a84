# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of the factors in motion: coverage, false alarms, and the prediction of other drives.

Usage: bench_motion.py [RECORDS] [CASE ...]. Half of 40 simulated drives give the factors, the other
half is predicted. A row has the factors (median), how often the intervals contain 1, how often they
lie above 1, which causes were named, and the squared error of the unused drives over its prediction
with the noise at rest, with the factors, and with the factors and causes (1 is right; medians).
"""

from __future__ import annotations

import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from allan_ros.core.filters.motion_factors import NoiseInMotion, axis_noise, noise_in_motion
from allan_ros.core.filters.motion_factors import predicted_errors as predicted
from allan_ros.core.imu import ImuBatch
from allan_ros.core.noise import Model
from allan_ros.core.simulate_drives import MotionErrors, Route, simulate_drives
from allan_ros.core.stream.pipeline import ImuStream

RATE = 50.0
GYRO, ACCEL = Model.of(N=7e-5, B=2e-5, K=5e-6), Model.of(N=1.2e-3, B=2e-4, K=5e-5)
NOISE = [axis_noise(GYRO, 1.0 / RATE)] * 3 + [axis_noise(ACCEL, 1.0 / RATE)] * 3

CASES: dict[str, tuple[dict[str, float], dict[str, float]]] = {
    'as at rest': ({}, {}),
    'flat ground': ({'tilt': 0.0}, {}),
    'drives of 3 to 8 s': ({'shortest': 3.0, 'longest': 8.0}, {}),
    'gyro noise x3': ({}, {'gyro_noise': 3.0}),
    'accelerometer noise x5': ({}, {'accel_noise': 5.0}),
    'gyro scale factor 0.5 %': ({}, {'gyro_scale': 0.005}),
    'gyro misalignment 5 mrad': ({}, {'gyro_misalignment': 0.005}),
    'accelerometer scale factor 0.5 %': ({}, {'accel_scale': 0.005}),
    'g-sensitivity 0.06 deg/s/g': ({}, {'g_sensitivity': 1e-4}),
    'vibration 1 m/s^2': ({}, {'vibration': 1.0}),
    'motors heat the gyro, 0.03 deg/s': ({}, {'heating': 5e-4}),
    'wheels creep, 1 cm/s': ({}, {'creep': 0.01}),
}


class Outcome(NamedTuple):
    """Result of one record; ``errors`` are squared errors of unused drives over predictions."""

    motion: NoiseInMotion
    errors: tuple[float, float, float]


def one_record(case: str, seed: int) -> Outcome:
    """Simulate one record, and measure the factors from every second drive."""
    route, errors = CASES[case]
    options: dict[str, Any] = {'drives': 40, **route}
    robot = simulate_drives(
        RATE, [GYRO] * 3, [ACCEL] * 3, Route(**options), MotionErrors(**errors), seed
    )
    stamps = (np.arange(len(robot.samples)) * round(1e9 / RATE)).astype(np.int64)
    stream = ImuStream(with_drives=True)
    stream.update(ImuBatch(stamps, robot.samples))
    stream.end()
    drives = stream.drives().errors
    half = len(drives) // 2
    motion = noise_in_motion(drives[:half], NOISE)
    assert motion is not None
    return Outcome(motion, predicted(drives[:half], drives[half:], NOISE))


def main(records: int, cases: list[str]) -> None:
    """Print the table."""
    print(f'{records} records, 20 drives each')
    with ProcessPoolExecutor(2) as pool:
        for case in cases:
            found = list(pool.map(partial(one_record, case), range(records)))
            motions = [each.motion for each in found]
            row = [f'{case:34s}']
            for sensor in ('gyro', 'accel'):
                ends = np.array([one[sensor].ci95 for one in motions])
                inside = np.mean((ends[:, 0] < 1.0) & (ends[:, 1] > 1.0))
                above = np.mean(ends[:, 0] > 1.0)
                middle = np.median([one[sensor].value for one in motions])
                row.append(f'{sensor} {middle:.2f} with 1 {inside:.0%} above {above:.0%}')
            named = Counter(cause.name for one in motions for cause in one.causes)
            row.append(f'causes {dict(named)}')
            errors = np.median([each.errors for each in found], axis=0)
            row.append('errors ' + ' '.join(f'{error:.2f}' for error in errors))
            print('  '.join(row), flush=True)


if __name__ == '__main__':
    main(int(sys.argv[1]) if sys.argv[1:] else 20, sys.argv[2:] or list(CASES))
