# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tests for noise that changes with time: false alarms, and how often changes are found.

python bench/bench_stationarity.py alarms --records 100    findings in records without changes
python bench/bench_stationarity.py gains --records 100     gains in likelihood in such records
python bench/bench_stationarity.py power --records 20      records with warm-up, steps or more noise
python bench/bench_stationarity.py sixths                  coefficients of parts of real recordings
python bench/bench_stationarity.py halves                  predicted and actual drift of such parts
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator

import numpy as np
from bench_accuracy import shared_recordings
from numpy.typing import NDArray
from scipy.stats import beta

import allan_ros as ar
from allan_ros.core.allan.running import RunningSums
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.estimate import Z_95
from allan_ros.core.filters.growth import GROWTH_WINDOW_S, growth_table
from allan_ros.core.fit import bias_changes
from allan_ros.core.fit.result import NoiseModel
from allan_ros.core.fit.stationary import fit_likelihood, fit_stationary
from allan_ros.core.fit.statistics import statistics
from allan_ros.core.imu import AXES, from_datasheet
from allan_ros.core.noise import Model
from allan_ros.core.simulator import simulate_axis

Floats = NDArray[np.float64]

HOUR = 3600
DEG_H = from_datasheet('B', 'gyro', 1.0)
TRUTH = {'Q': 0.138, 'N': 0.242, 'B': 5.237, 'K': 31.807, 'R': 76.242}
"""Noise terms of gyro X in table 1 of Cong, Wang & Yan 2019, in datasheet units."""

CLEAN = {'table 1 X': 'QNBKR', 'N': 'N', 'N + B': 'NB', 'N + K': 'NK'}

EARLY = {'settling', 'not_settled'}
LEVEL = {'level_changes', 'level_changed'}
TESTS = (EARLY, {'bias_steps'}, LEVEL)
"""Ids of the findings of each test: settling, steps, and level of the noise."""


def gyro(terms: str) -> Model:
    """Return a noise model with some of the terms of gyro X, such as 'NB'."""
    return Model.of(**{t: from_datasheet(t, 'gyro', TRUTH[t]) for t in terms})


def draw(terms: str, hours: float, rate: float, rng: np.random.Generator) -> Floats:
    samples = round(hours * HOUR * rate)
    return np.stack(
        [simulate_axis(samples, 1.0 / rate, gyro(terms), rng) for _ in range(3)], axis=1
    )


def sums_of(y: Floats, rate: float = 1.0) -> AllanSums:
    engine = RunningSums(axes=AXES[: y.shape[1]])
    engine.update(y, 0, round((len(y) - 1) / rate * 1e9))
    engine.end_segment()
    return engine.sums


def band(found: int, of: int) -> str:
    """Return the share found / of as text, with its exact 95 % interval."""
    low = beta.ppf(0.025, found, of - found + 1) if found else 0.0
    high = beta.ppf(0.975, found + 1, of - found) if found < of else 1.0
    return f'{found} of {of}: {found / of:.1%} ({low:.1%} to {high:.1%})'


def found_in(model: NoiseModel) -> list[bool]:
    """Return for each test in `TESTS` whether the fit has a finding of the test."""
    ids = {f.id for f in model.findings}
    return [bool(ids & test) for test in TESTS]


def show_alarms(records: int, seed: int) -> Iterator[tuple[str, ...]]:
    """Yield how often each test has a finding in records without changes, and its CPU time."""
    for k, (name, terms) in enumerate(CLEAN.items()):
        found, excess = np.zeros(3, int), 0.0
        for i in range(records):
            sums = sums_of(draw(terms, 2.0, 10.0, np.random.default_rng([seed, i, k])), 10.0)
            begin = time.process_time()
            fit_likelihood(sums)
            middle = time.process_time()
            _, model = fit_stationary(sums)
            excess += time.process_time() - middle - (middle - begin)
            found += found_in(model)
        yield (name, *(band(int(n), records) for n in found), f'{excess / records / 3.0:.3f} s')


def show_gains(records: int, seed: int) -> Iterator[tuple[str, ...]]:
    """Yield quantiles of the likelihood gains of settling and steps in records without changes."""
    bias_changes.GAIN_SETTLING = bias_changes.GAIN_STEPS = 0.0
    for k, (name, terms) in enumerate(CLEAN.items()):
        warm: list[float] = []
        steps: list[float] = []
        for i in range(records):
            sums = sums_of(draw(terms, 2.0, 1.0, np.random.default_rng([seed, i, k])))
            means = sums.recordings[0].means[0]
            segment = bias_changes.SegmentStatistics.of(statistics(sums), means, 1.0)
            assert segment is not None  # None only for shorter records
            one = bias_changes.settling(sums, statistics(sums), [0, 1, 2])
            warm.append(one.gain if one else 0.0)
            each = [bias_changes.bias_steps(segment, a) for a in range(3)]
            steps += [s.excess if s else 0.0 for s in each]
        yield (name, *(f'{np.quantile(v, q):.1f}' for v in (warm, steps) for q in (0.9, 0.99)))


def show_power(records: int, seed: int) -> Iterator[tuple[str, ...]]:
    """Yield how often a change is found, and how often interval or limit of K contain the truth."""
    rng = np.random.default_rng(seed)

    def warming(terms: str, hours: float, size: float) -> Floats:
        y = draw(terms, hours, 1.0, rng)
        return y + size * DEG_H * np.exp(-np.arange(len(y)) / 300.0)[:, None]

    def stepping(size: float) -> Floats:
        y = draw('NB', 10.0, 1.0, rng)
        for at in rng.integers(len(y) // 20, len(y) - len(y) // 20, 5):
            y[at:] += size * DEG_H * rng.choice([-1, 1])
        return y

    def noisier(factor: float) -> Floats:
        y = draw('N', 2.0, 1.0, rng)
        y[HOUR:] *= factor
        return y

    cases: tuple[tuple[str, int, float, Callable[[], Floats]], ...] = (
        ('warm-up 100 deg/h, 300 s, table 1 X, 2 h', 0, 31.807, lambda: warming('QNBKR', 2, 100.0)),
        ('warm-up 100 deg/h, 300 s, N + B, 8 h', 0, 0.0, lambda: warming('NB', 8, 100.0)),
        ('warm-up 300 deg/h, 300 s, N + K, 2 h', 0, 31.807, lambda: warming('NK', 2, 300.0)),
        ('five steps of 20 deg/h, N + B, 10 h', 1, np.nan, lambda: stepping(20.0)),
        ('five steps of 100 deg/h, N + B, 10 h', 1, np.nan, lambda: stepping(100.0)),
        ('N 1.1 times larger in the second hour', 2, 0.0, lambda: noisier(1.1)),
        ('N 1.3 times larger in the second hour', 2, 0.0, lambda: noisier(1.3)),
    )
    for name, which, truth, make in cases:
        found = covered = number = 0
        for _ in range(records):
            _, model = fit_stationary(sums_of(make()))
            found += found_in(model)[which]
            for fit in model.axes.values():
                k = fit.noise['K']
                low, high = k.ci95 or (0.0, k.upper95 or np.inf)
                covered += low <= from_datasheet('K', 'gyro', truth) <= high
                number += 1
        yield name, band(found, records), '' if np.isnan(truth) else band(covered, number)


# --- real recordings ------------------------------------------------------------------------------

LEAST_SIXTH_S, LEAST_HALF_S = 60.0, 600.0
"""Shortest sixth and shortest half in s into which a real recording is divided."""

HORIZONS_S = 10.0, 30.0, 100.0
"""Times in s over which the samples of a half are integrated."""


def parts_of(rows: Floats, number: int, least_s: float) -> tuple[float, list[Floats]]:
    """Return the rate of a recording in Hz, and the samples of its parts of equal length.

    ``rows`` has the time and the samples. There are no parts if they would last less than
    ``least_s`` seconds.
    """
    rows = rows[np.isfinite(rows).all(axis=1)]
    rate = (len(rows) - 1) / (rows[-1, 0] - rows[0, 0])
    n = len(rows) // number
    if n < least_s * rate:
        return rate, []
    return rate, [rows[k * n : (k + 1) * n, 1:] for k in range(number)]


def log_std(ends: tuple[float, float] | None) -> float:
    """Return the standard error of the logarithm of a number with a 95 % interval."""
    low, high = ends or (0.0, math.inf)
    return math.log(high / low) / (2.0 * Z_95) if low > 0.0 else math.inf


def show_sixths(records: int, seed: int) -> Iterator[tuple[str, ...]]:
    """Yield how N, B and K of the sixths of each recording agree with their predictive intervals.

    Chi-squared compares the logarithms of the resolved coefficients with their weighted mean. The
    interval of each sixth is also compared with the value of each other sixth, and so is the limit
    of a coefficient that is not resolved.
    """
    for name, rows in shared_recordings().items():
        rate, parts = parts_of(rows, 6, LEAST_SIXTH_S)
        fits = [ar.analyze(y, rate=rate, motion_gate=False) for y in parts]
        for sensor in ('gyro', 'accel') if fits else ():
            for term in 'NBK':
                total, freedom, inside, pairs, above, limits = 0.0, 0, 0, 0, 0, 0
                for axis in (a for a in AXES if a.startswith(sensor)):
                    each = [one[axis].fit.noise[term] for one in fits]
                    known = [c for c in each if c.resolved and c.ci95 and c.ci95[0] > 0.0]
                    if len(known) > 1:
                        x = np.log([c.value for c in known])
                        weight = np.array([log_std(c.ci95) for c in known]) ** -2.0
                        total += float(weight @ (x - np.average(x, weights=weight)) ** 2)
                        freedom += len(x) - 1
                    for a in each:
                        for value in (b.value or 0.0 for b in known if b is not a):
                            if a.resolved and a.ci95:
                                inside += a.ci95[0] <= value <= a.ci95[1]
                                pairs += 1
                            elif a.upper95:
                                above += a.upper95 >= value
                                limits += 1
                chi = f'{total / freedom:.2f} ({freedom})' if freedom else ''
                yield (
                    f'{name} {sensor} {term}',
                    chi,
                    f'{inside} of {pairs}',
                    f'{above} of {limits}',
                )


def growth(y: Floats, rate: float, horizon: float, window: float) -> Floats:
    """Return the root mean square error of the integral of samples, (axes,).

    `Model.growth` predicts this error: after the bias was averaged over ``window`` seconds, the
    samples minus this bias are integrated over ``horizon`` seconds. ``rate`` is in Hz.
    """
    theta = np.cumsum(np.pad(y - y.mean(axis=0), ((1, 0), (0, 0))), axis=0) / rate
    h, w = round(horizon * rate), round(window * rate)
    error = theta[h + w :] - theta[w:-h] - h / w * (theta[w:-h] - theta[: -h - w])
    return np.sqrt(np.mean(error**2, axis=0))


def show_halves(records: int, seed: int) -> Iterator[tuple[str, ...]]:
    """Yield how often the drift of a half lies in the interval that is predicted from the other."""
    for name, rows in shared_recordings().items():
        rate, parts = parts_of(rows, 2, LEAST_HALF_S)
        if not parts:
            continue
        inside = np.zeros((2, len(HORIZONS_S)), int)
        for known, other in (parts, parts[::-1]):
            results = ar.analyze(known, rate=rate, motion_gate=False)
            actual = np.array([growth(other, rate, h, GROWTH_WINDOW_S) for h in HORIZONS_S])
            for i, axis in enumerate(AXES):
                for k, one in enumerate(growth_table(results[axis].fit, HORIZONS_S)):
                    low, high = one.std.ci95 or (math.nan, math.nan)
                    inside[i // 3, k] += low <= actual[k, i] <= high
        for sensor, found in zip(('gyro', 'accel'), inside.tolist()):
            yield (f'{name} {sensor}', *(f'{number} of 6' for number in found))


SHOWS = {
    'alarms': (show_alarms, ('noise', 'settling', 'steps', 'level', 'CPU time per axis')),
    'gains': (show_gains, ('noise', 'settling 90 %', '99 %', 'steps 90 %', '99 %')),
    'power': (show_power, ('effect', 'found', 'K covered')),
    'sixths': (
        show_sixths,
        ('coefficient', 'chi^2/dof (dof)', 'inside other intervals', 'below other limits'),
    ),
    'halves': (show_halves, ('sensor', '10 s', '30 s', '100 s')),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('what', choices=SHOWS, nargs='?', default='alarms')
    parser.add_argument('--records', type=int, default=20)
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    show, columns = SHOWS[args.what]
    print(f'| {" | ".join(columns)} |')
    for row in show(args.records, args.seed):
        print(f'| {" | ".join(row)} |', flush=True)


if __name__ == '__main__':
    main()
