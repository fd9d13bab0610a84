# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of the factors in motion: coverage, false alarms, and the prediction of other drives.

    bench_motion.py                          20 records of every case
    bench_motion.py 100 CASE ...             100 records of some cases
    bench_motion.py recording FILE ...       real recordings: half of the drives predict the others

The first 20 of 30 simulated drives give the factors, and the noise at rest is measured in the same
record. The columns are for each sensor the median factor of the error, how often the factor is
significant (worse), the median factor of N, how often its interval contains the truth, and how
often K has a factor. Then follow the causes, how often the interval of the factor with the causes
contains 1, and the squared errors of the other drives, divided by three predictions.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))  # contains `support`

from support.simulate_drives import MotionErrors, Route, SimulatedDrives, simulate_drives

import allan_ros as ar
from allan_ros.core.estimate import Estimate
from allan_ros.core.filters.drive_likelihood import DriveLikelihood, NoiseAtRest
from allan_ros.core.filters.motion_factors import (
    LIMIT,
    WITH_COMMON_FACTOR,
    NoiseInMotion,
    noise_in_motion,
)
from allan_ros.core.imu import ImuBatch
from allan_ros.core.noise import Model
from allan_ros.core.stream.drives import ROTATION, VELOCITY, Drive, DriveErrors, Rest, drive_errors
from allan_ros.results.motion import noise_at_rest

RATE, START_NS = 20.0, 10**18
MEMS = Model.of(N=7e-5, B=2e-5, K=5e-6), Model.of(N=1.2e-3, B=2e-4, K=5e-5)
GOOD = Model.of(N=4e-6, B=5e-7, K=5e-8), Model.of(N=3e-4, B=5e-5, K=5e-6)


class Case(NamedTuple):
    """A simulated robot and IMU, with the true factors of N; None for errors that are not noise."""

    route: dict[str, Any] = {}  # noqa: RUF012
    errors: dict[str, Any] = {}  # noqa: RUF012
    true: tuple[float | None, float | None] = (1.0, 1.0)
    imu: tuple[Model, Model] = MEMS
    bench_s: float = 0.0  # duration in s of a separate recording at rest


CASES = {
    'as at rest': Case(),
    'as at rest, noise of 1 h on the bench': Case(bench_s=3600.0),
    'flat ground': Case({'tilt': 0.0}),
    '5 drives': Case({'drives': 8, 'first': 40.0}),
    'drives of 3 to 8 s': Case({'shortest': 3.0, 'longest': 8.0}),
    'drives of 60 to 150 s': Case({'shortest': 60.0, 'longest': 150.0}),
    'carried by hand (tilts of 0.5 rad)': Case({'tilt': 0.5, 'speed': 2.0}),
    'good gyro (0.014 deg/sqrt(h))': Case(imu=GOOD),
    'N of the gyro x3': Case({}, {'gyro_noise': 3.0}, (3.0, 1.0)),
    'N of the accelerometer x5': Case({}, {'accel_noise': 5.0}, (1.0, 5.0)),
    'gyro scale factor 0.5 %': Case({}, {'gyro_scale': 0.005}, (None, None)),
    'gyro misalignment 5 mrad': Case({}, {'gyro_misalignment': 0.005}, (None, None)),
    'accelerometer scale factor 0.5 %': Case({}, {'accel_scale': 0.005}, (None, None)),
    'g-sensitivity 0.06 deg/s/g': Case({}, {'g_sensitivity': 1e-4}, (None, None)),
    'good gyro, scale factor 200 ppm': Case({}, {'gyro_scale': 2e-4}, (None, None), GOOD),
    'vibration 0.1 m/s^2': Case({}, {'vibration': 0.1}, (1.0, None)),
    'N of the gyro grows with vibration, x2': Case(
        {}, {'vibration': 0.1, 'growth': 10.0 * math.sqrt(3.0 / math.exp(0.5))}, (2.0, None)
    ),
    'motors heat the gyro, 0.03 deg/s': Case({}, {'heating': 5e-4}, (None, None)),
    'hits, 5 cm/s each': Case({}, {'hits': 0.05}, (1.0, None)),
    'wheels creep, 1 cm/s': Case({}, {'creep': 0.01}, (1.0, None)),
    'rests on a ferry, 0.05 deg': Case({}, {'waves': 9e-4}, (None, None)),
}


class Outcome(NamedTuple):
    """Factors in the first drives, and squared errors of other drives over three predictions."""

    motion: NoiseInMotion
    errors: tuple[float, float, float]


def one_record(name: str, seed: int) -> Outcome:
    """Simulate a record, measure the factors in the first drives, and predict the other drives."""
    case = CASES[name]
    gyro, accel = ([model] * 3 for model in case.imu)
    route = Route(**{'drives': 30, **case.route})
    robot = simulate_drives(RATE, gyro, accel, route, MotionErrors(**case.errors), seed)
    number = 2 * len(robot.drives) // 3
    middle = robot.drives[number][0]
    bench = None
    if case.bench_s:
        rest = Route(drives=0, first=case.bench_s)
        rest_samples = simulate_drives(RATE, gyro, accel, rest, seed=seed + 10**6).samples
        bench = ar.analyze(batch(rest_samples))
    used = batch(robot.samples[:middle])
    results = ar.analyze(used, noise=bench) if bench else ar.analyze(used)
    motion = results.motion
    assert motion is not None and results.recorded is not None
    noise = noise_at_rest((bench or results).axes)
    causes = tuple(cause.name for cause in motion.causes)
    before, after = results.recorded.drives.errors, drives_of(robot)[number:]
    return Outcome(motion, predicted_errors(before, after, noise, causes))


def predicted_errors(
    used: Sequence[DriveErrors],
    others: Sequence[DriveErrors],
    noise: Sequence[NoiseAtRest],
    causes: tuple[str, ...] = (),
) -> tuple[float, float, float]:
    """Return the mean squared errors of drives, divided by the variance that other drives predict.

    Parameters
    ----------
    used : sequence of DriveErrors
        Drives from which factors and causes are estimated.
    others : sequence of DriveErrors
        Drives whose errors are predicted. Unknowns that all drives have in common, such as the bias
        of the accelerometer, are estimated from the drives ``used``.
    noise : sequence of NoiseAtRest
        Noise of the six axes at rest.
    causes : tuple of str
        Names of the calibration errors in the third model, keys of `CAUSES`.

    Returns
    -------
    (float, float, float)
        Mean of the squared errors of rotation and velocity, divided by the predicted variance. The
        first model is the noise at rest, the second model contains the factors, and the third model
        contains factors and causes. The expected mean is 1 if the model is right.
    """
    whole = DriveLikelihood.of([*used, *others], noise)
    data, predicted = part(whole, slice(0, len(used))), part(whole, slice(len(used), None))
    plain = data.fit(WITH_COMMON_FACTOR)
    largest_log_factors = [LIMIT * data.unknown.get(names[0], 0.0) for names in plain.groups]
    log_factors_at_rest = np.minimum(plain.log_factors, largest_log_factors)
    log_factors_at_rest[:2] = 0.0
    rows = slice(ROTATION.start, VELOCITY.stop)
    mean_squares = []
    for fit in (
        plain._replace(log_factors=log_factors_at_rest),
        plain,
        data.fit(WITH_COMMON_FACTOR, causes, plain),
    ):
        u = predicted.all_effects(fit.causes)
        residuals = (predicted.y - u @ fit.mean)[:, rows]
        noise_covariance = predicted.covariances(fit.groups, fit.log_factors)[1]
        error_covariance = (noise_covariance + u @ fit.covariance @ u.swapaxes(1, 2))[:, rows, rows]
        inverse = np.linalg.inv(error_covariance)
        mean_squares.append(float(np.einsum('di,dij,dj->di', residuals, inverse, residuals).mean()))
    return mean_squares[0], mean_squares[1], mean_squares[2]


def part(whole: DriveLikelihood, drives: slice) -> DriveLikelihood:
    """Return the likelihood of the drives in a range of indices."""
    return replace(
        whole,
        y=whole.y[drives],
        noise={name: each[drives] for name, each in whole.noise.items()},
        own=whole.own[drives],
        common=whole.common[drives],
        effects={name: each[drives] for name, each in whole.effects.items()},
    )


def batch(samples: np.ndarray) -> ImuBatch:
    """Return samples, (n, 6), with evenly spaced stamps."""
    stamps = START_NS + np.arange(len(samples)) * round(1e9 / RATE)
    return ImuBatch(stamps.astype(np.int64), samples)


def drives_of(robot: SimulatedDrives) -> list[DriveErrors]:
    """Return the errors of the drives, integrated from 0.5 s before to 2.5 s after each drive."""
    gyro, accel = robot.samples[:, :3], robot.samples[:, 3:]
    margins = round(0.5 * RATE), round(2.5 * RATE)
    edges = [0, *(at + m * s for d in robot.drives for at, m, s in zip(d, margins, (-1, 1)))]
    edges.append(len(gyro))

    def rest(first: int, last: int) -> Rest:
        return Rest(gyro[first:last].mean(0), accel[first:last].mean(0), (last - first) / RATE)

    found = []
    for a, b, c, d in zip(edges[::2], edges[1::2], edges[2::2], edges[3::2]):
        start = START_NS * 1e-9 + b / RATE
        rests = rest(a, b), rest(c, d)
        found.append(drive_errors(Drive(start, 1.0 / RATE, gyro[b:c], accel[b:c], *rests, b > 0)))
    return found


def row(name: str, found: list[Outcome]) -> str:
    """Return the row of a case in the table."""
    motions, cells = [each.motion for each in found], [f'{name:39s}']
    for sensor, true in zip(('gyro', 'accel'), CASES[name].true):
        each = [one.sensors[sensor] for one in motions]
        ratio = np.median([one.factor.value for one in each])
        white = [one.white or Estimate(1.0, (1.0, 1.0)) for one in each]
        worse = np.mean([motion.is_worse(sensor) for motion in motions])
        inside = '  – '
        if true is not None:
            ends = np.array([one.ci95 for one in white])
            inside = f'{np.mean((ends[:, 0] <= true) & (ends[:, 1] >= true)):4.0%}'
        drift = np.mean([one.slow is not None for one in each])
        cells.append(
            f'{sensor} {ratio:5.2f} worse {worse:4.0%} '
            f'N {np.median([one.value for one in white]):5.2f} {inside} K {drift:4.0%}'
        )
    named = Counter(cause.name for one in motions for cause in one.causes)
    left = [
        one.explained.ci95
        for motion in motions
        for one in motion.sensors.values()
        if one.explained is not None and one.explained.ci95 is not None
    ]
    contained = np.mean([low < 1.0 < high for low, high in left]) if left else 1.0
    cells.append(f'causes {dict(named)} {contained:.0%}' if named else 'no cause')
    errors = np.median([each.errors for each in found], axis=0)
    return '  '.join([*cells, 'errors ' + ' '.join(f'{error:.2f}' for error in errors)])


def show_recordings(paths: list[str]) -> None:
    """Print the factors in recordings of one IMU, and how well half of the drives predict the rest.

    The factors are printed for all drives, and for the first half, which predicts the errors of
    the second half.
    """
    results = ar.analyze(paths if len(paths) > 1 else paths[0])
    assert results.recorded is not None
    drives, unused = results.recorded.drives
    print(f'{len(drives)} drives, not used: {dict(unused)}, {results.duration_s:.0f} s at rest')
    if results.motion is None:
        return
    show(results.motion)
    noise, half = noise_at_rest(results.axes), (len(drives) + 1) // 2
    motion = noise_in_motion(drives[:half], noise)
    if motion is not None:
        show(motion)
        causes = tuple(cause.name for cause in motion.causes)
        errors = predicted_errors(drives[:half], drives[half:], noise, causes)
        print(
            'errors of the other drives: at rest {:.2f}, factors {:.2f}, causes {:.2f}'.format(
                *errors
            )
        )


def show(motion: NoiseInMotion) -> None:
    """Print the factors of each sensor and the causes."""
    for name, one in motion.sensors.items():
        print(
            f'  {name} {one.factor}, of terms {dict(one.term_factors)}, with causes {one.explained}'
        )
    print('  causes', [cause.name for cause in motion.causes])


def main(records: int, cases: list[str]) -> None:
    """Simulate the records of each case, and print the table."""
    print(f'{records} records, 20 drives each')
    with ProcessPoolExecutor(1) as pool:
        for case in cases:
            print(row(case, list(pool.map(partial(one_record, case), range(records)))), flush=True)


if __name__ == '__main__':
    if sys.argv[1:2] == ['recording']:
        show_recordings(sys.argv[2:])
    else:
        main(int(sys.argv[1]) if sys.argv[1:] else 20, sys.argv[2:] or list(CASES))
