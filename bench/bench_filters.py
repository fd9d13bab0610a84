# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Consistency of state estimators with exported parameters: NEES, outages, growth of the error.

    python bench/bench_filters.py nees                  24 axes per sensor, about 5 min
    python bench/bench_filters.py nees --sensors x z --axes 8
    python bench/bench_filters.py growth                shared ADIS16405 recordings, 1 min
    python bench/bench_filters.py bias                  coverage of the bias interval, 5 min
    python bench/bench_filters.py gtsam                 a factor graph in rest and motion, 2 min
    python bench/bench_filters.py figure                docs/images/filter_growth.png

Each sensor is simulated for two hours, or for 5 min, and analyzed. A filter with two states,
attitude and bias, gets the exported parameters and runs on other records of the sensor. Once a
second, it receives an attitude measurement with an error of 0.1 deg. The simulators and the filter
are in `reality.py`, which shares no code with this package, in $ALLAN_ROS_SHARED/oracle or
../shared/oracle.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import runpy
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import allan_ros as ar
from allan_ros.core.filters.bias import BiasFilter, BiasModel
from allan_ros.core.filters.noise_parameters import reduce_model
from allan_ros.core.imu import AXES
from allan_ros.core.noise import GaussMarkov, Model
from allan_ros.export import ExportOptions, make_export

ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get('ALLAN_ROS_SHARED', ROOT.parent / 'shared'))
RATE, SECONDS = 100.0, 7200
DT = 1.0 / RATE
OUTAGES = (10, 60, 300)
EXPORTS, MEASURES = ('N, K as measured', 'N, raised K', 'state space'), ('NEES', 'outage')
GROWTH_S = (1.0, 10.0, 100.0, 300.0)
WINDOW_S = 100.0


def oracle() -> dict[str, Any]:
    """Return the functions of `reality.py`; print a message and exit if this file is missing."""
    path = SHARED / 'oracle' / 'reality.py'
    if not path.is_file():
        print('skipped: no shared data')
        raise SystemExit
    return runpy.run_path(str(path))


REALITY = oracle()
DEG = REALITY['deg']
TABLE1 = REALITY['TABLE1']
N_X = {'N': TABLE1['x']['N']}
SENSORS: dict[str, tuple[str, dict[str, float], tuple[tuple[float, float], ...], int]] = {
    'x': ('table 1 X', TABLE1['x'], (), SECONDS),
    'y': ('table 1 Y', TABLE1['y'], (), SECONDS),
    'z': ('table 1 Z', TABLE1['z'], (), SECONDS),
    'nb': ('N + B', {**N_X, 'B': TABLE1['x']['B']}, (), SECONDS),
    'nk': ('N + K', {**N_X, 'K': TABLE1['x']['K']}, (), SECONDS),
    'gm1': ('Gauss-Markov 10 s', N_X, ((9.0, 10.0),), SECONDS),
    'gm2': ('Gauss-Markov 10 + 200 s', N_X, ((9.0, 10.0), (6.0, 200.0)), SECONDS),
    'gm3': ('Gauss-Markov 3 + 30 + 300 s', N_X, ((9.0, 3.0), (6.0, 30.0), (6.0, 300.0)), SECONDS),
    'x5': ('5 min of X', TABLE1['x'], (), 300),
}
"""Name -> title, noise terms in SI, Gauss-Markov processes, and duration in s of the record that is
analyzed. A process is given by its standard deviation in deg/h and its correlation time in s."""


def draw(
    name: str, seconds: int, rng: np.random.Generator, axes: int, rate: float = RATE
) -> tuple[Any, Any]:
    """Return the white noise and the complete noise of a sensor, (n, axes) each, in SI."""
    _, terms, processes, _ = SENSORS[name]
    n, dt = round(seconds * rate), 1.0 / rate
    white = REALITY['white_noise'](n, dt, terms['N'], rng, axes)
    samples = white + REALITY['draw'](n, dt, {**terms, 'N': 0.0}, rng, axes)
    for sigma, tau in processes:
        samples += REALITY['gauss_markov'](n, dt, DEG(B=sigma)['B'], tau, rng, axes)
    return white, samples


def analyzed(samples: Any) -> ar.Results:
    """Return the results of samples at rest, (n, 3), used for both gyro and accelerometer."""
    return ar.analyze(np.hstack([samples, samples]), rate=RATE, motion_gate=False, skip=0.0)


def exported(results: ar.Results, axis: str) -> dict[str, dict[str, Any]]:
    """Return the exported models of an axis: N and K as measured, raised K, and state space."""
    models = {}
    for name, fidelity in (('N, K as measured', 'coefficients'), ('N, raised K', 'reduction')):
        read: dict[str, Any] = {}
        exec(make_export(results, 'gtsam', ExportOptions(fidelity=fidelity)).text, read)
        i = AXES.index(axis)
        white, walk = read['gyroscopeCovariance'][i], read['biasOmegaCovariance'][i]
        models[name] = {'N': white**0.5, 'K': walk**0.5}
    one = json.loads(make_export(results, 'state_space').text)['axes'][axis]
    processes = [
        (process[GaussMarkov.coefficient], process['correlation_time'])
        for process in one['processes']
    ]
    models['state space'] = {'N': one['white'], 'K': one['walk'], 'gms': processes}
    return models


def nees(names: list[str], axes: int) -> None:
    """Print NEES and outage ratios of the filter, for each sensor and each exported model."""
    for name in names:
        began, title = time.monotonic(), SENSORS[name][0]
        rng = np.random.default_rng(20 + list(SENSORS).index(name))
        results = analyzed(draw(name, SENSORS[name][3], rng, 3)[1])
        found: dict[str, list[list[float]]] = {}
        per_axis = max(axes // 3, 1)
        for axis in AXES[:3]:
            white, samples = draw(name, SECONDS, rng, per_axis)
            for export, model in exported(results, axis).items():
                seed = np.random.default_rng(1)
                ran = REALITY['run_filter'](model, samples, DT, seed, white, outages=OUTAGES)
                row = [ran['nees'], *(ran['outage'][h] for h in OUTAGES)]
                found.setdefault(export, []).append(row)
        for export in EXPORTS:
            each = np.array(found[export])
            mean = [each[:, 0].mean(), *np.sqrt((each[:, 1:] ** 2).mean(axis=0))]
            print(f'{title:28} {export:12}', *(f'{value:6.2f}' for value in mean))
        print(f'{"":28} {3 * per_axis} axes, {time.monotonic() - began:.0f} s', flush=True)


def units() -> dict[str, Any]:
    """Return the samples of the shared ADIS16405 recordings: name of the IMU -> (n, 6)."""
    folder = SHARED / 'data' / 'adis16405'
    load = runpy.run_path(str(folder / 'load.py'))['load']
    names = sorted(path.stem.removesuffix('_counts') for path in folder.glob('*_counts.npz'))
    return {name: load(name)[:, 1:7] for name in names}


SETTLED_HOURS = {'imu1': 1.1, 'imu2': 1.1, 'imu4': 1.45}
"""Name of the IMU -> start of the settled part of its recording in h. All three IMUs drift for an
hour, and imu4 has shocks until 1.43 h."""

BAND_RECORDS = 200
"""Number of simulated records from which `_growth_band` computes a band."""


def growth() -> None:
    """Print the ratio of the predicted to the actual error growth on real recordings.

    The parentheses contain the 95 % band of the ratio for a sensor that matches the model, widened
    by the interval of the prediction. The band is wide, because a recording contains few
    independent intervals of 300 s. A ratio outside 0.8 to 1.25 is marked by * if it lies within
    the band, else by !.
    """
    for name, samples in units().items():
        settled = samples[round(SETTLED_HOURS[name] * 3600 * RATE) :]
        results = ar.analyze(settled, rate=RATE, skip=0.0)
        print(f'{name}: {len(settled) / RATE / 3600:.2f} h; horizons {GROWTH_S} s', flush=True)
        for i, axis in enumerate(AXES):
            predicted = {one.horizon: one.std.value for one in results[axis].growth}
            bands = _growth_band(results[axis], len(settled) / RATE)
            cells = []
            for horizon, (low, high) in zip(GROWTH_S, bands):
                actual = REALITY['actual_growth'](settled[:, i], DT, horizon, WINDOW_S)
                ratio = predicted[horizon] / actual
                mark = '' if 0.8 <= ratio <= 1.25 else '*' if low <= ratio <= high else '!'
                cells.append(f'{ratio:5.2f}{mark:1} ({low:.2f}..{high:.2f})')
            print(f'{name} {axis:8}', *cells, flush=True)


def _growth_band(axis: ar.AxisResult, seconds: float) -> list[tuple[float, float]]:
    """Return the 95 % band of predicted over actual growth for each horizon in `GROWTH_S`.

    The band is for records of this duration in s, simulated from the fitted model.
    """
    model = axis.fit.model
    known = {growth.horizon: growth for growth in axis.growth if growth.window == WINDOW_S}
    rng, n = np.random.default_rng(9), round(seconds)
    terms = {name: model.value(name) for name in 'NBKR'}
    records = REALITY['draw'](n, 1.0, terms, rng, BAND_RECORDS)
    for process, sigma, *_ in model['gauss_markov']:
        time = process.numbers['correlation_time']
        records += REALITY['gauss_markov'](n, 1.0, sigma, time, rng, BAND_RECORDS)
    bands = []
    for horizon in GROWTH_S:
        predicted = float(model.growth(horizon, WINDOW_S))
        ratios = [
            predicted / REALITY['actual_growth'](records[:, i], 1.0, horizon, WINDOW_S)
            for i in range(BAND_RECORDS)
        ]
        low, high = np.log(np.quantile(ratios, [0.025, 0.975]))
        if (growth := known.get(horizon)) is not None and growth.std.ci95 is not None:
            # The upper end of the predicted interval widens the band downward: if the true growth
            # is at this upper end, the ratio is below 1.
            below, above = np.log(np.array(growth.std.ci95) / growth.std.value)
            low, high = min(low, 0.0), max(high, 0.0)
            low, high = -np.hypot(low, above), np.hypot(high, below)
        bands.append((float(np.exp(low)), float(np.exp(high))))
    return bands


BIAS_RATE = 10.0
"""Sample rate in Hz of the records that `bias` simulates."""


def bias(records: int) -> None:
    """Print how often the 95 % interval of the estimated bias contains the true bias."""
    for name in ('x', 'y', 'z'):
        covered: list[float] = []
        for record in range(records):
            rng = np.random.default_rng([record, ord(name)])
            white, samples = draw(name, SECONDS, rng, 3, BIAS_RATE)
            results = ar.analyze(samples, rate=BIAS_RATE, motion_gate=False, skip=0.0)
            for i, axis in enumerate(AXES[:3]):
                hits = _bias_hits(results[axis], samples[:, i], white[:, i], 30)
                covered.append(float(np.mean(hits)))
        cell = f'{np.mean(covered):.3f} +- {np.std(covered) / len(covered) ** 0.5:.3f}'
        print(f'table 1 {name}: coverage {cell} ({3 * records} axes)', flush=True)


def _bias_hits(axis: ar.AxisResult, samples: Any, white: Any, every: int) -> list[bool]:
    """Return whether the 95 % interval of the bias contains the mean bias of the next 10 s.

    From 10 min on, the result has an item for every ``every``-th second.
    """
    seconds = len(samples) // round(BIAS_RATE)
    means, drift = (
        values.reshape(seconds, -1).mean(axis=1) for values in (samples, samples - white)
    )
    hits: list[bool] = []
    tracker = BiasFilter(BiasModel.of_fit(axis.fit))
    for k, mean in enumerate(means, 1):
        tracker.update(float(mean))
        if k >= 600 and k % every == 0 and k + 10 <= seconds:
            low, high = tracker.estimate().ci95 or (math.nan, math.nan)
            hits.append(bool(low < drift[k : k + 10].mean() < high))
    return hits


GRAPH_S, GRAPH_RUNS = 150, 12
"""Duration of a trajectory in s, and number of trajectories, with which GTSAM is tested."""

TURN_RATE, TURN_START, TURN_END = 0.2, 50, 100
"""Turn rate about z in rad/s, and start and end of the turn in s. Before and after the turn, the
platform is at rest."""


def graph(runs: int) -> None:
    """Print the NEES of attitude and gyro bias in GTSAM, with K as measured and with raised K.

    A factor graph has a pose for each second, a CombinedImuFactor between successive poses, and a
    measurement of each pose with errors of 0.1 deg and 1 cm. From 60 s on, every tenth pose is
    compared with the truth.
    """
    import gtsam

    rng = np.random.default_rng(8)
    results = analyzed(draw('x', SECONDS, rng, 3)[1])
    noise, drift = [], []
    for _ in range(runs):
        white, samples = draw('x', GRAPH_S + 1, rng, 6)
        bias = samples - white
        noise.append(samples - bias[0])
        drift.append(bias - bias[0])
    for fidelity in ('coefficients', 'reduction'):
        read: dict[str, Any] = {}
        exec(make_export(results, 'gtsam', ExportOptions(fidelity=fidelity)).text, read)
        params = read['set_noise'](gtsam.PreintegrationCombinedParams.MakeSharedU(9.81))
        errors = [_graph_nees(gtsam, params, *pair) for pair in zip(noise, drift)]
        print(
            f'GTSAM {fidelity:14} NEES {np.mean(errors):5.2f} of attitude and gyro bias', flush=True
        )


def _graph_nees(gtsam: Any, params: Any, noise: Any, drift: Any) -> float:
    """Return the mean NEES of attitude and gyro bias in one trajectory.

    ``noise``, (n, 6), is the noise of the samples in SI, and ``drift``, (n, 6), the bias that is
    contained in this noise.
    """
    x, v, b = (lambda i, c=c: gtsam.symbol(c, i) for c in 'xvb')
    sigmas = np.array([0.1 * np.pi / 180.0] * 3 + [0.01] * 3)
    measured = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    rng = np.random.default_rng(1)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    per_s, angle = round(RATE), 0.0
    truth = []
    for second in range(GRAPH_S + 1):
        true = gtsam.Pose3(gtsam.Rot3.Rz(angle), np.zeros(3))
        truth.append(true)
        seen = true.retract(sigmas * rng.standard_normal(6))
        factors.add(gtsam.PriorFactorPose3(x(second), seen, measured))
        values.insert(x(second), true)
        values.insert(v(second), np.zeros(3))
        values.insert(b(second), gtsam.imuBias.ConstantBias())
        if second == GRAPH_S:
            break
        rate = TURN_RATE if TURN_START <= second < TURN_END else 0.0
        sums = gtsam.PreintegratedCombinedMeasurements(params, gtsam.imuBias.ConstantBias())
        for row in noise[second * per_s : (second + 1) * per_s]:
            force = row[3:] + np.array([0.0, 0.0, 9.81])
            sums.integrateMeasurement(force, row[:3] + np.array([0.0, 0.0, rate]), DT)
        nodes = (x(second), v(second), x(second + 1), v(second + 1), b(second), b(second + 1))
        factors.add(gtsam.CombinedImuFactor(*nodes, sums))
        angle += rate
    spread = gtsam.noiseModel.Isotropic.Sigma
    factors.add(gtsam.PriorFactorVector(v(0), np.zeros(3), spread(3, 0.1)))
    factors.add(gtsam.PriorFactorConstantBias(b(0), gtsam.imuBias.ConstantBias(), spread(6, 0.01)))
    found = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    marginals = gtsam.Marginals(factors, found)
    errors = []
    for second in range(60, GRAPH_S, 10):
        turn = truth[second].rotation().between(found.atPose3(x(second)).rotation())
        attitude = marginals.marginalCovariance(x(second))[:3, :3]
        bias_error = found.atConstantBias(b(second)).gyroscope()
        bias_error = bias_error - drift[second * per_s : (second + 1) * per_s, :3].mean(axis=0)
        spread_b = marginals.marginalCovariance(b(second))[3:, 3:]
        for error, covariance in ((gtsam.Rot3.Logmap(turn), attitude), (bias_error, spread_b)):
            errors.append(float(error @ np.linalg.solve(covariance, error)) / 3.0)
    return float(np.mean(errors))


def figure() -> None:
    """Draw the actual growth of the angle error, and the prediction of each exported model."""
    import matplotlib

    matplotlib.use('agg')
    from matplotlib import pyplot

    rng = np.random.default_rng(3)
    results = analyzed(draw('x', SECONDS, rng, 3)[1])
    _, samples = draw('x', SECONDS, rng, 12)
    models = exported(results, 'gyro_x')
    window = 30.0
    times = np.geomspace(0.5, 300.0, 40)
    per_axis = [
        [REALITY['actual_growth'](samples[:, i], DT, h, window) for h in times] for i in range(12)
    ]
    scale = 180.0 / np.pi
    actual = np.sqrt((np.array(per_axis) ** 2).mean(axis=0)) * scale
    chart, axes = pyplot.subplots(figsize=(6.4, 4.0), layout='constrained')
    axes.loglog(times, actual, 'k.', label='actual (12 simulated axes)')
    styles = {'N, K as measured': 'C3--', 'N, raised K': 'C0-', 'state space': 'C2-'}
    for name, style in styles.items():
        one = models[name]
        bias = [(sigma, GaussMarkov(tau)) for sigma, tau in one.get('gms', ())]
        model = Model.of(*bias, N=one['N'], K=one['K'])
        predicted = model.growth(times, window) * scale
        axes.loglog(times, predicted, style, label=name)
    axes.axvspan(1.0, 30.0, color='C0', alpha=0.08, lw=0.0)
    axes.set(xlabel='time without correction t [s]', ylabel='angle error, 1 sigma [deg]')
    axes.legend(title=f'bias known from {window:g} s; shaded: 1 to 30 s')
    axes.grid(True, which='both', alpha=0.2)
    path = ROOT / 'docs' / 'images' / 'filter_growth.png'
    chart.savefig(path, dpi=120)
    print(path.relative_to(ROOT))
    reduction = reduce_model(results['gyro_x'].fit.model)
    print(f'predicted over model growth {reduction.ratio[0]:.2f} to {reduction.ratio[1]:.2f}')


def main() -> None:
    """Run the requested measurement."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    choices = ('nees', 'growth', 'bias', 'gtsam', 'figure')
    parser.add_argument('what', choices=choices, nargs='?', default='growth')
    parser.add_argument('--sensors', nargs='+', choices=tuple(SENSORS))
    parser.add_argument('--axes', type=int, default=24, help='axes the filter runs on')
    parser.add_argument('--records', type=int, default=20, help='records of three axes')
    args = parser.parse_args()
    if args.what == 'nees':
        nees(args.sensors or list(SENSORS), args.axes)
    elif args.what == 'growth':
        growth()
    elif args.what == 'bias':
        bias(args.records)
    elif args.what == 'gtsam':
        graph(GRAPH_RUNS)
    else:
        figure()


if __name__ == '__main__':
    main()
