# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Effect of the gain that a push sets on the tilt error of a Madgwick filter (package `ahrs`).

    pip install ahrs
    python bench/bench_push.py --seeds 5

A simulated robot rests for two minutes, and then drives and rests 12 times. Its IMU is good or
cheap, and has a gyro bias. The gain is computed from the samples as in a node. The table states for
each former gain the ratio of the tilt error with the pushed gain to the tilt error with the former
gain, in motion and at rest (the largest ratio of all seeds). A dash means that the push keeps the
former gain.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))  # contains `support`

from ahrs.common.orientation import acc2q
from ahrs.filters import Madgwick
from support.simulate_drives import MotionErrors, Route, SimulatedDrives, simulate_drives

from allan_ros.core.imu import AXES, ImuBatch
from allan_ros.core.noise import Model
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.export import ExportOptions, target_rows
from allan_ros.nodes.push_plan import Proposal
from allan_ros.readers.recording_sums import Provenance
from allan_ros.results.analysis import analyze_sums
from allan_ros.results.motion import with_motion

RATE = 50
"""Sample rate in Hz."""

FORMER = (3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1)
"""Gains in rad/s that are in the node before the push."""

BIAS = 1.5e-3
"""Standard deviation of the gyro bias in rad/s (0.09 deg/s)."""

TIMES = {'first': 120.0, 'rest': 10.0, 'shortest': 20.0, 'longest': 40.0, 'drives': 12}

ROUTES = {
    'driving': Route(speed=1.0, turn=0.5, tilt=0.05, **TIMES),
    'rough ground': Route(speed=4.0, turn=1.0, tilt=0.15, **TIMES),
    'by hand': Route(speed=1.5, turn=1.5, tilt=0.6, **TIMES),
}

IMUS = {
    'good': MotionErrors(vibration=0.1),
    'cheap': MotionErrors(
        gyro_scale=0.01,
        gyro_misalignment=0.01,
        g_sensitivity=2e-4,
        vibration=0.5,
        gyro_noise=3.0,
    ),
}


def filtered(samples: np.ndarray, gain: float) -> np.ndarray:
    """Return the attitudes that the filter estimates, as quaternions, (n, 4)."""
    madgwick = Madgwick(frequency=float(RATE), gain_imu=gain)
    out = np.empty((len(samples), 4))
    now = acc2q(samples[:RATE, 3:].mean(axis=0))
    for i, sample in enumerate(samples):
        out[i] = now = madgwick.updateIMU(now, sample[:3], sample[3:])
    return out


def rms_errors(samples: np.ndarray, gain: float, robot: SimulatedDrives) -> np.ndarray:
    """Return the rms tilt error in deg in motion and at rest, (2,).

    The tilt error is the angle between the estimated and the true direction of gravity.
    """
    w, x, y, z = filtered(samples, gain).T
    roll, pitch, _ = robot.angles[1:].T
    cosine = (
        -np.sin(pitch) * 2 * (x * z - w * y)
        + np.sin(roll) * np.cos(pitch) * 2 * (w * x + y * z)
        + np.cos(roll) * np.cos(pitch) * (1 - 2 * (x * x + y * y))
    )
    squares = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) ** 2
    moving = np.zeros(len(samples), dtype=bool)
    for first, last in robot.drives:
        moving[first:last] = True
    return np.sqrt([squares[moving].mean(), squares[~moving].mean()])


@dataclass(frozen=True)
class Push:
    """Result of one simulated push.

    ``gain`` is the proposed gain in rad/s, and ``factor`` the factor of N of the gyro in motion.
    ``ratios`` maps each former gain that is replaced to the ratios of the tilt errors, (2,): in
    motion and at rest.
    """

    gain: float
    factor: float
    ratios: dict[float, np.ndarray]


def proposed_gain(samples: np.ndarray) -> tuple[float, float]:
    """Return the gain in rad/s that a push proposes, and the factor of N of the gyro in motion."""
    stream = ImuStream(with_drives=True)
    stamps = 10**18 + np.arange(len(samples)) * (10**9 // RATE)
    stream.update(ImuBatch(stamps, samples))
    stream.end()
    results = with_motion(analyze_sums(stream.result().sums, Provenance()), stream.drives())
    assert results.motion is not None
    bias = {axis: abs(results.axes[axis].at_rest.mean) for axis in AXES[:3]}
    row = next(iter(target_rows(results, 'imu_filter_madgwick', ExportOptions(motion=True), bias)))
    factor = results.motion.sensors['gyro'].term_factors.get('N')
    return row.value, 1.0 if factor is None or factor.value is None else factor.value


def run(route: Route, imu: MotionErrors, seed: int) -> Push:
    """Simulate a robot, compute the gain, and run the filter with this and each former gain."""
    quiet = [Model.of(N=1.5e-4, K=1e-5)] * 3, [Model.of(N=2e-3, K=1e-4)] * 3
    robot = simulate_drives(float(RATE), *quiet, route, imu, seed)
    bias = np.random.default_rng(seed + 99).normal(0, BIAS, 3)
    samples = robot.samples + np.append(bias, [0] * 3)
    gain, factor = proposed_gain(samples)
    proposal = Proposal('gain', (gain,), (gain, gain), '', is_gain=True)
    replaced = [former for former in FORMER if not proposal.keeps((former,))]
    after = rms_errors(samples, gain, robot) if replaced else np.ones(2)
    return Push(gain, factor, {g: after / rms_errors(samples, g, robot) for g in replaced})


def main() -> None:
    """Simulate all robots and IMUs, and print the table."""
    formatter = argparse.RawTextHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument('--seeds', type=int, default=5)
    seeds = range(parser.parse_args().seeds)
    print(f'{"":22}{"gain":>16}{"factor":>12}' + ''.join(f'{former:>14g}' for former in FORMER))
    for where, route in ROUTES.items():
        for which, imu in IMUS.items():
            runs = [run(route, imu, seed) for seed in seeds]
            gains, factors = [each.gain for each in runs], [each.factor for each in runs]
            cells = []
            for former in FORMER:
                known = [each.ratios[former] for each in runs if former in each.ratios]
                worst = np.max(known, axis=0) if known else None
                cells.append('-' if worst is None else f'{worst[0]:.2f} {worst[1]:.2f}')
            print(
                f'{f"{where}, {which}":22}{f"{min(gains):.4f}..{max(gains):.4f}":>16}'
                f'{f"{min(factors):.1f}..{max(factors):.1f}":>12}'
                + ''.join(f'{cell:>14}' for cell in cells),
                flush=True,
            )


if __name__ == '__main__':
    main()
