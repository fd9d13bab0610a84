# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of the process model: Gauss-Markov processes in addition to the five terms.

    python bench/bench_processes.py humps --rate 20       one process added to table 1, X
    python bench/bench_processes.py bounds                how often it can be found at all
    python bench/bench_processes.py growth --blocks 1     predicted against actual angle growth
    python bench/bench_processes.py adis                  measured curve over drawn model, settled
    python bench/bench_processes.py clean --rate 20       processes found where there are none
    python bench/bench_processes.py segments              one process in 400 short segments

A block is six records. ``adis`` needs the recordings of $ALLAN_ROS_SHARED.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from pathlib import Path

import numpy as np
from allan_ros.core.fit.model_selection import GAUSS_MARKOV_RATIO
from bench_accuracy import AXES, HOUR, X, clopper_pearson, gyro, read_slopes
from scipy.signal import lfilter

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.filters.growth import predicted_growth
from allan_ros.core.fit import AxisFit, fit_noise
from allan_ros.core.fit.stationary import fit_stationary
from allan_ros.core.noise import (
    NoiseTerms,
    ProcessModel,
    gauss_markov_avar,
    term_avar,
)
from allan_ros.core.simulate import simulate_axis

RATE = 100.0
SECONDS = 2 * HOUR
WINDOW = 100.0
HORIZONS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""Times in s for which the angle is predicted after the bias was averaged over `WINDOW`."""

SHARED = Path(os.environ.get('ALLAN_ROS_SHARED', '../shared'))


def process(n: int, tau0: float, sigma: float, time: float, rng: np.random.Generator) -> np.ndarray:
    """Return n samples of a stationary first-order Gauss-Markov process."""
    keep = math.exp(-tau0 / time)
    steps = rng.standard_normal(n) * sigma * math.sqrt(1.0 - keep * keep)
    steps[0] = sigma * rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -keep], steps))


def sigma_of_hump(truth: NoiseTerms, time: float, hump: float, rate: float = RATE) -> float:
    """Return sigma of a process whose Allan deviation is at most ``hump`` times that of
    ``truth``.
    """
    m = np.unique(np.round(np.geomspace(1.0, 100.0 * time * rate, 300)))
    rest = term_avar(m, 1.0 / rate, truth).sum(axis=-1)
    return hump / math.sqrt(float(np.max(gauss_markov_avar(m, time * rate) / rest)))


def sums_of(rows: np.ndarray, rate: float = RATE) -> AllanSums:
    """Return the sums of samples, one row per axis."""
    engine = RunningSums(axes=AXES[: rows.shape[1]])
    engine.update(rows, 0, round((len(rows) - 1) / rate * 1e9))
    engine.end_segment()
    return engine.sums


def bounds() -> None:
    """Print the power of the likelihood ratio test for one process added to table 1, X.

    Twice the Kullback-Leibler divergence (Whittle 1953) of the record from the nearest noise of
    N, B and K is the noncentrality of the test. The lowest frequency is weighted by half,
    because the ramp is fitted as well.
    """
    from scipy.optimize import minimize
    from scipy.special import ndtr

    frequency = np.arange(1, round(SECONDS * RATE / 2)) / SECONDS
    weight = np.where(frequency < 1.5 / SECONDS, 0.5, 1.0)
    omega = 2.0 * math.pi * frequency
    step = 2.0 * np.sin(omega / (2.0 * RATE)) * RATE
    columns = np.stack([np.ones_like(omega), 1.0 / omega, 1.0 / step**2], axis=1)
    start = np.log([X.N**2, X.B**2, X.K**2])
    print('| T [s] | hump | noncentrality | power at 1 % false alarms |')
    print('|---|---|---|---|')
    for time_, hump in ((t, h) for t in (0.3, 1.0, 10.0, 30.0, 100.0) for h in (0.3, 1.0, 3.0)):
        sigma, keep = sigma_of_hump(X, time_, hump), math.exp(-1.0 / (time_ * RATE))
        drift = (1.0 - keep**2) / (1.0 - 2.0 * keep * np.cos(omega / RATE) + keep**2)
        truth = columns @ np.exp(start) + sigma**2 / RATE * drift

        def divergence(log_power: np.ndarray, truth: np.ndarray = truth) -> tuple:
            parts = columns * np.exp(log_power)
            ratio = truth / parts.sum(axis=1)
            slope = (weight * (1.0 - ratio) / parts.sum(axis=1)) @ parts
            return float(np.sum(weight * (ratio - 1.0 - np.log(ratio)))), slope

        ends = [(s - 30.0, s + 10.0) for s in start]
        twice = 2.0 * minimize(divergence, start, jac=True, method='L-BFGS-B', bounds=ends).fun
        power = ndtr(math.sqrt(twice) - math.sqrt(GAUSS_MARKOV_RATIO))
        print(f'| {time_:g} | {hump:g} | {twice:.1f} | {100 * power:.0f} % |', flush=True)


def humps(blocks: int, rate: float) -> None:
    """Print N and how often the process is detected, for processes added to table 1, X."""
    print(
        '| T [s] | hump | records | N bias % | N coverage % (95 % band) | found % | ms per axis |'
    )
    print('|---|---|---|---|---|---|---|')
    n = round(SECONDS * rate)
    for time_ in (0.1, 0.3, 1.0, 10.0, 100.0):
        for hump in (0.3, 1.0, 3.0):
            sigma, fits, spent = sigma_of_hump(X, time_, hump, rate), [], 0.0
            for block in range(blocks):
                rng = np.random.default_rng([31, block, round(1e3 * time_), round(10 * hump)])
                rows = np.stack(
                    [
                        simulate_axis(n, 1 / rate, X, rng) + process(n, 1 / rate, sigma, time_, rng)
                        for _ in AXES
                    ],
                    axis=1,
                )
                sums = sums_of(rows, rate)
                begin = time.process_time()
                fits += fit_noise(sums).axes.values()
                spent += time.process_time() - begin
            print(_hump_line(time_, hump, fits, 1e3 * spent / len(fits)), flush=True)


def clean(blocks: int, rate: float) -> None:
    """Print how often a process is selected on records of table 1, X."""
    n, fits = round(SECONDS * rate), []
    for block in range(blocks):
        rng = np.random.default_rng([71, block, 0])
        rows = np.stack([simulate_axis(n, 1 / rate, X, rng) for _ in AXES], axis=1)
        fits += fit_noise(sums_of(rows, rate)).axes.values()
    found = sum(bool(fit.processes.gauss_markov or fit.processes.sinusoid) for fit in fits)
    low, high = clopper_pearson(found, len(fits))
    print(f'selected in {found} of {len(fits)} axes ({100 * low:.1f}-{100 * high:.1f} %)')


def segments(blocks: int, time_: float = 100.0, sigma: float = 0.5) -> None:
    """Print the fit of white noise and a process in 400 segments of 500 samples on average."""
    fits: list[AxisFit] = []
    for block in range(blocks):
        rng = np.random.default_rng([7, block])
        engine, begin = RunningSums(axes=AXES), 0
        for n in rng.exponential(500.0, 400).astype(int) + 2:
            drift = [process(n, 1.0, sigma, time_, rng) for _ in AXES]
            rows = rng.standard_normal((n, len(AXES))) + np.stack(drift, axis=1)
            engine.update(rows, begin * 10**9, (begin + int(n) - 1) * 10**9)
            engine.end_segment()
            begin += int(n) + 1000
        fits += fit_noise(engine.sums).axes.values()
    values = np.array([fit.noise['N'].value or math.nan for fit in fits])
    ends = [fit.noise['N'].ci95 or (0.0, math.inf) for fit in fits]
    inside = sum(low <= 1.0 <= high for low, high in ends)
    low, high = clopper_pearson(inside, len(fits))
    right = sum(
        len(fit.processes.gauss_markov) == 1
        and not fit.processes.sinusoid
        and 0.5 < fit.processes.gauss_markov[0].correlation_time / time_ < 2.0
        for fit in fits
    )
    misfits = sum(fit.misfit > 0.0 for fit in fits)
    error = np.std(values) / math.sqrt(len(fits))
    print(
        f'{len(fits)} axes: process alone {right}, misfit {misfits}, N bias '
        f'{100 * (np.mean(values) - 1):+.3f} +- {100 * error:.3f} %, covered {inside} '
        f'({100 * low:.0f}-{100 * high:.0f} %)'
    )


def _hump_line(time_: float, hump: float, fits: list[AxisFit], cost: float) -> str:
    values = np.array([fit.noise['N'].value or math.nan for fit in fits])
    ends = [fit.noise['N'].ci95 or (0.0, fit.noise['N'].upper95 or 0.0) for fit in fits]
    inside = sum(low <= X.N <= high for low, high in ends)
    low, high = clopper_pearson(inside, len(fits))
    found = np.mean(
        [
            any(0.5 < p.correlation_time / time_ < 2.0 for p in fit.processes.gauss_markov)
            for fit in fits
        ]
    )
    bias = 100.0 * (float(np.nanmean(values)) / X.N - 1.0)
    covered = f'{100 * inside / len(fits):.0f} ({100 * low:.0f}-{100 * high:.0f})'
    cells = f'{time_:g} | {hump:g} | {len(fits)} | {bias:+.2f} | {covered} | {100 * found:.0f}'
    return f'| {cells} | {cost:.0f} |'


def growth_error(model: ProcessModel, samples: np.ndarray, rate: float) -> float:
    """Return the rms log ratio of predicted to actual angle error over the horizons."""
    theta = np.concatenate([[0.0], np.cumsum(samples - samples.mean())]) / rate
    b, actual = round(WINDOW * rate), []
    for horizon in HORIZONS:
        a = round(horizon * rate)
        e = theta[a + b :] - theta[b:-a] - horizon / WINDOW * (theta[b:-a] - theta[: -(a + b)])
        actual.append(float(np.sqrt(np.mean(e**2))))
    predicted = predicted_growth(model, np.array(HORIZONS), WINDOW)
    return float(np.sqrt(np.mean(np.log(predicted / np.array(actual)) ** 2)))


def gmwm(sums: AllanSums, axis: int) -> ProcessModel:
    """Return the best model of up to three processes, fitted with the diagonal weights of the
    GMWM.
    """
    sys.path.insert(0, str(SHARED / 'oracle'))
    from processes import fit_processes

    octave = np.flatnonzero(np.isin(sums.m, 2 ** np.arange(40)) & (4 * sums.m <= sums.samples))
    tau, avar = sums.m[octave] * sums.tau0, sums.avar[octave, axis]
    best = None
    for p in (1, 2, 3):
        found = fit_processes(tau, avar, sums.samples, sums.tau0, p, starts=2)
        if best is None or found['chi2'] < 0.8 * best['chi2']:
            best = found
    return ProcessModel(NoiseTerms(N=best['N'], K=best['K']), tuple(best['gms']))


def models_of(sums: AllanSums, with_gmwm: bool) -> dict[str, list[ProcessModel]]:
    """Return method -> the noise models of all axes fitted with it."""
    slopes = [NoiseTerms(N=r['N'], K=r['K']) for r in read_slopes(sums)]
    out = {
        'this package': [fit.model for fit in fit_noise(sums).axes.values()],
        'relative NNLS': [fit.model for fit in fit_noise(sums, 'relative').axes.values()],
        'slopes, N and K': [ProcessModel(terms) for terms in slopes],
    }
    if with_gmwm:
        out['GMWM'] = [gmwm(sums, axis) for axis in range(len(sums.axes))]
    return out


def growth(blocks: int, with_gmwm: bool) -> None:
    """Print the error of the predicted growth by method, for sensors with several processes."""
    b = gyro(B=1.0).B
    white, walk = NoiseTerms(N=X.N), NoiseTerms(N=X.N, K=gyro(K=15.0).K)
    cases = {
        '0.1 + 10 + 200 s': (white, ((60 * b, 0.1), (9 * b, 10.0), (6 * b, 200.0))),
        '3 + 30 + 300 s + K': (walk, ((14 * b, 3.0), (8 * b, 30.0), (6 * b, 300.0))),
        'table 1, X without R': (NoiseTerms(X.Q, X.N, X.B, X.K), ()),
    }
    n = round(SECONDS * RATE)
    for name, (truth, processes) in cases.items():
        errors: dict[str, list[float]] = {}
        for block in range(blocks):
            rng = np.random.default_rng([33, block])
            rows = np.stack([simulate_axis(n, 1 / RATE, truth, rng) for _ in AXES], axis=1)
            for sigma, time_ in processes:
                for axis in range(rows.shape[1]):
                    rows[:, axis] += process(n, 1 / RATE, sigma, time_, rng)
            for method, models in models_of(sums_of(rows), with_gmwm).items():
                found = [growth_error(m, rows[:, a], RATE) for a, m in enumerate(models)]
                errors.setdefault(method, []).extend(found)
        _print_growth(name, errors)


def _print_growth(name: str, errors: dict[str, list[float]]) -> None:
    for method, found in errors.items():
        print(
            f'| {name} | {method} | {len(found)} | {np.median(found):.3f} | {np.max(found):.3f} |',
            flush=True,
        )


def adis(skip: float, with_gmwm: bool) -> None:
    """Print measured over modeled Allan deviation of the shared recordings, and growth errors."""
    sys.path.insert(0, str(SHARED / 'data' / 'adis16405'))
    from load import load

    ratios: dict[tuple[str, int], list[float]] = {}
    errors: dict[str, list[float]] = {}
    for unit in ('imu1', 'imu2', 'imu4'):
        rows = load(unit)[round(skip * RATE) :, 1:]
        begin = time.process_time()
        sums, fits = fit_stationary(sums_of(rows))
        cost = 1e3 * (time.process_time() - begin) / len(fits.axes)
        print(f'{unit}: {cost:.0f} ms per axis, {sums.samples / len(rows):.0%} used')
        rows = rows[len(rows) - sums.samples :]
        tau, half = sums.m * sums.tau0, len(rows) / RATE / 2.0
        for a, (axis, fit) in enumerate(fits.axes.items()):
            ratio = np.sqrt(sums.avar[:, a] / fit.model.avar(tau, sums.tau0))
            for k, (low, high) in enumerate(((600.0, 1500.0), (1500.0, half))):
                median = float(np.median(ratio[(tau >= low) & (tau <= high)]))
                ratios.setdefault((axis.split('_')[0], k), []).append(median)
        for method, models in models_of(sums, with_gmwm).items():
            found = [growth_error(m, rows[:, a], RATE) for a, m in enumerate(models)]
            errors.setdefault(method, []).extend(found)
    for (sensor, k), found in ratios.items():
        span = ('600-1500 s', '1500 s to half the record')[k]
        each = ' '.join(f'{r:.2f}' for r in found)
        print(f'{sensor} {span}: median {np.median(found):.2f} of {each}')
    _print_growth('ADIS16405', errors)


def main() -> None:
    """Run the requested measurement."""
    parser = argparse.ArgumentParser(description='Accuracy of the process model.')
    parser.add_argument('what', nargs='*', default=['humps', 'growth'])
    parser.add_argument('--blocks', type=int, default=1)
    parser.add_argument('--rate', type=float, default=RATE, help='samples per second (humps)')
    parser.add_argument('--skip', type=float, default=3900.0, help='seconds left out (adis)')
    parser.add_argument('--gmwm', action='store_true', help='also the prototype of the GMWM')
    options = parser.parse_args()
    for what in options.what:
        if what == 'humps':
            humps(options.blocks, options.rate)
        elif what == 'bounds':
            bounds()
        elif what == 'growth':
            growth(options.blocks, options.gmwm)
        elif what == 'clean':
            clean(options.blocks, options.rate)
        elif what == 'segments':
            segments(options.blocks)
        elif what == 'adis':
            adis(options.skip, options.gmwm)


if __name__ == '__main__':
    main()
