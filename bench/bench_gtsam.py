# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compare the covariance that GTSAM predicts from the exported file with its actual errors.

    python bench/bench_gtsam.py             about 1 min

An IMU whose noise is known is recorded at rest for two hours, analyzed, and exported. Then it
moves: GTSAM integrates noisy samples of a turning, accelerating IMU many times over, and the
variances of angle, position, velocity and biases are compared with the covariance it predicts from
the file. "true" is a file of the true coefficients; its ratios must be within 5 % of 1.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

try:
    import gtsam
except ImportError:
    print('skipped: needs GTSAM, which the extra "consumers" brings (Python 3.11 to 3.13)')
    raise SystemExit from None

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from allan_ros.core.fit import AxisFit, Coefficient
from allan_ros.core.fit.model import model_of_terms
from allan_ros.core.noise import NoiseTerms
from allan_ros.core.simulate import simulate_axis, simulate_imu
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.io.exporters import ExportOptions, make_export
from allan_ros.io.recorded import Provenance
from allan_ros.io.results import Results, analyze_sums

Floats = NDArray[np.float64]

RATE_HZ = 100.0
REST_S = 7200.0
GYRO, ACCEL = NoiseTerms(N=1e-3, K=1e-4), NoiseTerms(N=5e-3, K=5e-4)
TURN = np.array([0.05, -0.1, 0.2])  # rad/s
PUSH = np.array([1.0, 0.5, 9.81])  # m/s^2
MOVE_S, RUNS = 5.0, 6000

NAMES = ('angle', 'position', 'velocity', 'accel bias', 'gyro bias')


def analyzed() -> Results:
    """Return the results of two hours at rest."""
    accumulator = ImuStream()
    for batch in simulate_imu(REST_S, RATE_HZ, [GYRO] * 3, [ACCEL] * 3, seed=1):
        accumulator.update(batch)
    accumulator.end()
    return analyze_sums(accumulator.result().sums, Provenance())


def with_truth(results: Results) -> Results:
    """Return the results with the measured coefficients replaced by the true ones."""
    axes = {}
    for name, axis in results.axes.items():
        terms = GYRO if name.startswith('gyro') else ACCEL
        noise = dict.fromkeys('QBR', Coefficient(None, status='not_observable'))
        noise |= {'N': Coefficient(terms.N), 'K': Coefficient(terms.K)}
        axes[name] = replace(axis, fit=AxisFit(noise, model_of_terms(noise)))
    return replace(results, axes=axes)


def params_of(results: Results) -> Any:
    """Return the GTSAM parameters of the exported file, without integration error."""
    names: dict[str, Any] = {}
    exec(make_export(results, 'gtsam', ExportOptions(axis='mean')).text, names)
    params = names['set_noise'](gtsam.PreintegrationCombinedParams.MakeSharedU(9.81))
    params.setIntegrationCovariance(np.zeros((3, 3)))
    return params


def integrated(params: Any, gyro: Floats, accel: Floats) -> Any:
    """Return GTSAM's preintegration of samples of gyro and accelerometer, (n, 3) each."""
    sums = gtsam.PreintegratedCombinedMeasurements(params, gtsam.imuBias.ConstantBias())
    for rate, force in zip(gyro, accel):
        sums.integrateMeasurement(force, rate, 1.0 / RATE_HZ)
    return sums


def noise(terms: NoiseTerms, steps: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return white noise and a bias that is zero at the start of each run, (runs, n, 3) each.

    One record is divided into runs, because a simulated record begins at zero: separate records
    would give every run the same first sample.
    """
    white, bias = np.empty((2, RUNS, steps, 3))
    for axis in range(3):
        whole = simulate_axis(RUNS * steps, 1.0 / RATE_HZ, NoiseTerms(N=terms.N), rng)
        white[..., axis] = (whole - whole.mean()).reshape(RUNS, steps)
        walk = simulate_axis(RUNS * steps + 1, 1.0 / RATE_HZ, NoiseTerms(K=terms.K), rng)
        bias[..., axis] = walk[1:].reshape(RUNS, steps) - walk[:-1:steps, None]
    return white, bias


def actual_variances(params: Any) -> Floats:
    """Return the variances of the integration errors over all runs, (15,)."""
    rng = np.random.default_rng(2)
    steps = round(MOVE_S * RATE_HZ)
    ends = np.empty((RUNS, 15))
    gyro_white, gyro_bias = noise(GYRO, steps, rng)
    accel_white, accel_bias = noise(ACCEL, steps, rng)
    gyro, accel = TURN + gyro_white + gyro_bias, PUSH + accel_white + accel_bias
    for run in range(RUNS):
        sums = integrated(params, gyro[run], accel[run])
        ends[run, :9] = [*gtsam.Rot3.Logmap(sums.deltaRij()), *sums.deltaPij(), *sums.deltaVij()]
    ends[:, 9:] = np.concatenate([accel_bias[:, -1], gyro_bias[:, -1]], axis=1)
    variances: Floats = ends.var(axis=0)
    return variances


def main() -> None:
    """Print the ratios of actual to predicted variance."""
    start = time.monotonic()
    results = analyzed()
    steps = round(MOVE_S * RATE_HZ)
    still = np.tile(TURN, (steps, 1)), np.tile(PUSH, (steps, 1))
    files = {'true': params_of(with_truth(results)), 'measured': params_of(results)}
    variances = actual_variances(files['true'])
    print(f'variance shown by {RUNS} runs of {MOVE_S:g} s over variance predicted, x y z')
    worst = 0.0
    for name, params in files.items():
        ratio = variances / np.diag(integrated(params, *still).preintMeasCov())
        if name == 'true':
            worst = float(abs(ratio - 1.0).max())
        for i, what in enumerate(NAMES):
            print(f'{name:9} {what:11}', *(f'{value:6.3f}' for value in ratio[3 * i : 3 * i + 3]))
    print(f'largest deviation with the true coefficients {worst:.1%}; goal 5 %')
    print(f'{time.monotonic() - start:.0f} s')


if __name__ == '__main__':
    main()
