# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of the fits: simulate records with known noise, fit them, compare with the truth.

    python bench/bench_accuracy.py                                   three scenarios, minutes
    python bench/bench_accuracy.py table1_x --runs 300 --keep DIR    one scenario, keep sums
    python bench/bench_accuracy.py line_30 lines_30_03 low_pass_4_20 hump_10 --methods likelihood
    python bench/bench_accuracy.py real                              real recordings

With --keep, the Allan sums of the simulated records are stored, and later runs fit these sums
again. ``real`` compares the Allan curves of real recordings with the curves of the fitted models.
It needs $ALLAN_ROS_SHARED.
"""

from __future__ import annotations

import argparse
import math
import pickle
import runpy
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bench_offline import SHARED

import allan_ros as ar
from allan_ros.core.allan.running import RunningSums
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.estimate import Estimate
from allan_ros.core.fit.least_squares import fit_paper
from allan_ros.core.fit.result import TERMS, AxisFit
from allan_ros.core.fit.stationary import fit_likelihood
from allan_ros.core.imu import from_datasheet, shown_unit
from allan_ros.core.noise import PROCESSES, GaussMarkov, Model
from allan_ros.core.noise.derived import avar
from allan_ros.core.simulator import simulate_axis

AXES = ('gyro_x', 'gyro_y', 'gyro_z', 'accel_x', 'accel_y', 'accel_z')
"""Names of the axes of a simulated record, which are fitted together."""

CONFIDENCE = 0.95


def gyro(**datasheet: float) -> Model:
    """Return the noise model of a gyro, given its terms in datasheet units.

    Q is in urad, N in deg/sqrt(h), B in deg/h, K in deg/h^1.5 and R in deg/h^2.
    """
    return Model.of(**{k: from_datasheet(k, 'gyro', v) for k, v in datasheet.items()})


@dataclass(frozen=True)
class Scenario:
    """Noise, length and disturbances of the records that are simulated.

    Attributes
    ----------
    truth : Model
        The five noise terms.
    rate, seconds : float
        Sample rate in Hz, and duration of a record in s.
    seed : int
        Seed of the random numbers.
    segments : int
        Number of segments into which a record is split.
    at_random : bool
        Whether the segments have random instead of equal lengths.
    lines : tuple of (amplitude, frequency)
        Sinusoids that are added: amplitude relative to the standard deviation of the white noise of
        a sample, and frequency in Hz.
    hump : (size, correlation time)
        Gauss-Markov process that is added: largest ratio of its Allan deviation to the Allan
        deviation of ``truth``, and correlation time in s. Size 0 adds no process.
    low_pass : (order, corner)
        Order and corner frequency in Hz of a Butterworth filter of the samples. Order 0 means that
        the samples are not filtered.
    counter : bool
        Whether the sensor counts steps of an angle, and carries the remainder to the next sample.
        The step gives the quantization noise of ``truth``. The mean rate is random.
    """

    truth: Model
    rate: float
    seconds: float
    seed: int
    segments: int = 1
    at_random: bool = False
    lines: tuple[tuple[float, float], ...] = ()
    hump: tuple[float, float] = (0.0, 1.0)
    low_pass: tuple[int, float] = (0, 1.0)
    counter: bool = False

    def axis(self, rng: np.random.Generator) -> np.ndarray:
        """Return the samples of one axis of a record, (n,), in SI."""
        from scipy.signal import butter, lfilter

        order, corner = self.low_pass
        before = round(100 * self.rate / corner) if order else 0
        n = round(self.rate * self.seconds) + before
        noise = self.truth.changed(Q=0.0) if self.counter else self.truth
        y = simulate_axis(n, 1.0 / self.rate, noise, rng)
        for amplitude, frequency in self.lines:
            turns = frequency / self.rate * np.arange(n) + rng.uniform()
            y += amplitude * self.truth.value('N') * self.rate**0.5 * np.sin(2.0 * np.pi * turns)
        size, time = self.hump
        if size > 0.0:
            m = np.unique(np.geomspace(1.0, 100.0 * time * self.rate, 300).round())
            rest = self.truth.avar(m / self.rate, 1.0 / self.rate)
            sigma = size / math.sqrt((avar(GaussMarkov(time * self.rate), m) / rest).max())
            keep = math.exp(-1.0 / (self.rate * time))
            steps = sigma * rng.standard_normal(n)
            steps[1:] *= math.sqrt(1.0 - keep * keep)
            y += lfilter([1.0], [1.0, -keep], steps)
        if order:
            y = lfilter(*butter(order, 2.0 * corner / self.rate), y - y[0])
        if self.counter:
            step = self.truth.value('Q') * self.rate * math.sqrt(12.0)
            counts = np.cumsum(np.append(rng.uniform(), y / step + rng.uniform()))
            y = step * np.diff(np.round(counts))
        return y[before:]

    def cuts(self, rng: np.random.Generator) -> np.ndarray:
        """Return the index of the first sample of each segment except the first segment."""
        n = round(self.rate * self.seconds)
        if self.at_random:
            return np.sort(rng.choice(np.arange(1, n), self.segments - 1, replace=False))
        return np.cumsum([len(part) for part in np.array_split(np.arange(n), self.segments)])[:-1]

    def draw(self, rng: np.random.Generator, axes: int) -> AllanSums:
        """Return the Allan sums of one record whose axes have independent noise."""
        rows = np.stack([self.axis(rng) for _ in range(axes)], axis=1)
        engine = RunningSums(axes=AXES[:axes])
        start = 0
        for part in np.split(rows, self.cuts(rng)):
            period = 1e9 / self.rate
            engine.update(part, round(start * period), round((start + len(part) - 1) * period))
            engine.end_segment()
            start += len(part)
        return engine.sums


# Cong, Wang & Yan, Industry and Mine Automation 45(10), 2019, table 1: an ADIS16475-3.
X = gyro(Q=0.138, N=0.242, B=5.237, K=31.807, R=76.242)
Y = gyro(Q=0.124, N=0.168, B=4.972, K=8.169, R=11.068)
Z = gyro(Q=0.100, N=0.245, B=6.058, K=50.568, R=66.250)
HOUR = 3600.0
DAY = 24 * HOUR
# X with counts of 2.5 standard deviations of the white noise of a sample at 100 Hz
COUNTED = X.changed(Q=2.5 * X.value('N') / math.sqrt(12.0 * 100.0))
# noise in the scenarios of a month on a robot, in which drives and shocks split the record
MONTH = gyro(N=0.172, K=6.19)
WITH_FLICKER = MONTH.changed(B=from_datasheet('B', 'gyro', 1.24))
SCENARIOS = {
    'table1_x': Scenario(X, 100.0, 2 * HOUR, 10),
    'table1_y': Scenario(Y, 100.0, 2 * HOUR, 11),
    'table1_z': Scenario(Z, 100.0, 2 * HOUR, 12),
    'table1_z_5hz': Scenario(Z, 5.0, 2 * HOUR, 777),
    'white': Scenario(gyro(N=0.242), 100.0, 2 * HOUR, 14),
    'no_walk': Scenario(gyro(N=0.242, B=5.237), 100.0, 2 * HOUR, 6),
    'no_flicker': Scenario(gyro(N=0.242, K=31.807), 100.0, 2 * HOUR, 4),
    'no_ramp': Scenario(X.changed(R=0.0), 100.0, 2 * HOUR, 5),
    'ramp_no_walk': Scenario(X.changed(K=0.0), 100.0, 2 * HOUR, 8),
    'quantized': Scenario(gyro(Q=4.0, N=0.242, K=31.807), 100.0, 2 * HOUR, 7),
    'counter': Scenario(COUNTED, 100.0, HOUR / 2, 18, counter=True),
    'five_minutes': Scenario(X, 100.0, 300.0, 0),
    'three_hours': Scenario(gyro(N=0.6, B=8.0, K=40.0), 200.0, 3 * HOUR, 13),
    'six_segments': Scenario(X, 100.0, 2 * HOUR, 9, segments=6),
    **{
        f'line_{size:g}': Scenario(X, 200.0, HOUR / 2, 3, lines=((size, 33.0),))
        for size in (0.3, 3.0, 30.0, 300.0)
    },
    'lines_3_1': Scenario(X, 200.0, HOUR / 2, 2, lines=((3.0, 33.0), (1.0, 20.0))),
    'lines_30_03': Scenario(X, 200.0, HOUR / 2, 21, lines=((30.0, 33.0), (0.3, 20.0))),
    **{
        f'hump_{time:g}': Scenario(X, 100.0, 2 * HOUR, 1, hump=(1.0, time))
        for time in (1.0, 10.0, 100.0)
    },
    **{
        f'low_pass_{order}_{corner:g}': Scenario(X, 200.0, HOUR / 2, 22, low_pass=(order, corner))
        for order, corner in ((1, 41.0), (1, 10.0), (1, 5.0), (4, 40.0), (4, 20.0), (4, 10.0))
    },
    'month': Scenario(MONTH, 1.0, 30 * DAY, 15, segments=2600, at_random=True),
    'month_flicker': Scenario(WITH_FLICKER, 1.0, 30 * DAY, 16, segments=2600, at_random=True),
    'month_whole': Scenario(WITH_FLICKER, 1.0, 30 * DAY, 17),
    'million': Scenario(WITH_FLICKER, 1.0, 1e6, 101),
    'half_day': Scenario(X, 20.0, 12 * HOUR, 103),
    'day': Scenario(gyro(N=0.242, B=5.237, K=31.8), 10.0, DAY, 104),
}


@dataclass(frozen=True)
class Outcome:
    """Estimate of one term by one fit, and its 95 % interval; NaN for unknown limits."""

    value: float
    low: float
    high: float
    seen: bool

    @classmethod
    def of(cls, c: Estimate) -> Outcome:
        """Return the outcome for a coefficient; an upper limit becomes an interval from 0 on."""
        nan = float('nan')
        low, high = c.ci95 or (0.0, nan if c.upper95 is None else c.upper95)
        return cls(c.value or 0.0, low, high, c.status == 'estimated')


def draws(scenario: str, runs: int, keep: Path | None) -> Iterator[AllanSums]:
    """Yield the Allan sums of records of six axes; sums in the folder ``keep`` are reused."""
    for block in range(-(-runs // len(AXES))):
        file = keep / f'{scenario}_{block:04d}.pickle' if keep else None
        if file and file.exists():
            yield pickle.loads(file.read_bytes())
            continue
        seed = [SCENARIOS[scenario].seed, block]
        sums = SCENARIOS[scenario].draw(np.random.default_rng(seed), len(AXES))
        if file:
            file.write_bytes(pickle.dumps(sums))
        yield sums


def clopper_pearson(hits: int, runs: int) -> tuple[float, float]:
    """Return the exact 95 % interval of hits / runs (Clopper & Pearson, Biometrika 26, 1934)."""
    from scipy.special import betaincinv

    tail = (1.0 - CONFIDENCE) / 2.0
    low = betaincinv(hits, runs - hits + 1, tail) if hits else 0.0
    high = betaincinv(hits + 1, runs - hits, 1.0 - tail) if hits < runs else 1.0
    return float(low), float(high)


def table(scenario: str, fits: list[AxisFit]) -> str:
    """Return the table of one scenario and one method of the fit, with a line for each term."""
    lines = [
        '| term | truth | bias % | RMSE % | median | said | coverage % (95 % band) | width |',
        '|---|---|---|---|---|---|---|---|',
    ]
    for term in TERMS:
        truth = SCENARIOS[scenario].truth.value(term)
        got = [Outcome.of(fit.noise[term]) for fit in fits]
        value = np.array([g.value for g in got])
        unit = shown_unit('gyro', term, 'deg/h')
        cells = [f'{term} [{unit.name}]', f'{truth * unit.factor:.4g}']
        if truth > 0.0:
            error = value / truth - 1.0
            cells += [f'{100 * error.mean():+.3f}', f'{100 * np.sqrt(np.mean(error**2)):.3f}']
        else:
            cells += ['', '']
        cells.append(f'{np.median(value) * unit.factor:.4g}')
        cells.append(f'{100 * np.mean([g.seen for g in got]):.1f} %')
        if np.isfinite([g.high for g in got]).any():
            inside = sum(g.low <= truth <= g.high for g in got)
            low, high = clopper_pearson(inside, len(got))
            cells.append(f'{100 * inside / len(got):.1f} ({100 * low:.1f}-{100 * high:.1f})')
            width = float(np.median([g.high - g.low for g in got]))
            cells.append(f'{width * unit.factor:.4g}')
        else:
            cells += ['', '']
        lines.append('| ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines)


def processes_found(fits: list[AxisFit]) -> str:
    """Return as text on how many axes processes, a low-pass filter or lack of fit were found."""
    kinds = [name for name, one in PROCESSES.items() if one.parameters]
    numbers = {k: Counter(len(fit.model[k]) for fit in fits) for k in kinds}
    parts = [f'{k} {dict(sorted(n.items()))}' for k, n in numbers.items()]
    parts.append(f'filtered {np.mean([fit.filtered for fit in fits]):.1%}')
    parts.append(f'lack of fit {np.mean([bool(fit.lack_of_fit) for fit in fits]):.1%}')
    return 'axes by number of processes: ' + ', '.join(parts)


POINTS, RECORDS = 512, 400
"""Number of block means of a record that is simulated from a model, and number of records."""


def octave_medians(ratio: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Return the median ratio in each octave of tau, (..., octaves); ``ratio`` is (..., taus)."""
    octave = np.floor(np.log2(tau / tau[0]) + 1e-9)
    return np.stack([np.median(ratio[..., octave == o], -1) for o in np.unique(octave)], -1)


def differences(axis: ar.AxisResult, step: int) -> np.ndarray:
    """Return the covariance matrix of the differences of neighboring block means.

    The covariance follows from the fitted model for `POINTS` means over ``step`` samples. For
    nonstationary noise, gamma is known only up to a constant, which cancels in the differences.
    """
    model, tau0, lag = axis.fit.model, axis.tau0, np.arange(POINTS)
    gamma = sum(
        process.variance_of(value, tau0) * process.in_unit(tau0).gamma(step, lag)
        for process, value, *_ in model.parts
        if not process.is_regressor
    )
    rows = gamma[np.abs(lag[:, None] - lag)]
    return np.diff(np.diff(rows, axis=0), axis=1)


def beyond(axis: ar.AxisResult, seconds: float) -> tuple[int, int]:
    """Return how many octaves of the curve lie outside their 95 % band, and how many were tested.

    The octaves from T/20 to T/4 are tested, where T is the duration ``seconds``. The band contains
    95 % of the curves of records that are simulated from the fitted model.
    """
    step = int(seconds / axis.tau0) // POINTS
    root = np.linalg.cholesky(differences(axis, step))
    noise = root @ np.random.default_rng(1).standard_normal((POINTS - 1, RECORDS))
    drift = axis.fit.model.value('R') * step * axis.tau0
    phase = np.cumsum(
        np.cumsum(np.pad(noise, ((2, 0), (0, 0))), 0) + drift * np.arange(513)[:, None], 0
    )
    curve = axis.curve
    tau = curve.m * axis.tau0
    used = (tau > seconds / 20.0) & (tau < seconds / 4.0)
    k = np.round(curve.m[used] / step).astype(int)
    simulated = np.array(
        [
            np.mean((phase[2 * n :] - 2 * phase[n:-n] + phase[: -2 * n]) ** 2, 0) / (2 * n**2)
            for n in k
        ]
    ).T
    expected = axis.fit.model.avar(tau[used], axis.tau0)
    measured = octave_medians(curve.adev[used] / np.sqrt(expected), tau[used])
    low, high = np.quantile(
        octave_medians(np.sqrt(simulated / expected), tau[used]), (0.025, 0.975), 0
    )
    return int(np.sum((measured < low) | (measured > high))), len(measured)


def shared_recordings() -> dict[str, np.ndarray]:
    """Return the shared recordings of six axes: name -> samples.

    The samples are (n, 7): time in s, then the axes of the gyro and of the accelerometer in SI.
    """
    static = runpy.run_path(str(SHARED / 'static' / 'load.py'))['load']
    adis = runpy.run_path(str(SHARED / 'adis16405' / 'load.py'))['load']
    recordings = {unit: adis(unit) for unit in ('imu1', 'imu2', 'imu4')}
    for file in sorted(SHARED.glob('static/*.npz')):
        t, gyro, accel = static(file.stem)
        if accel is not None and gyro.shape[1] == 3:
            recordings[file.stem] = np.column_stack([t, gyro, accel])
    return recordings


def real() -> None:
    """Print how the Allan curves of the shared recordings differ from the curves of the models.

    A line has for each sensor the range of the ratios of the two curves up to T/20 (medians of the
    octaves), where T is the duration, and the result of `beyond` for the longer times.
    """
    for name, rows in shared_recordings().items():
        rows = rows[np.isfinite(rows).all(axis=1)]
        rate = 1.0 / float(np.median(np.diff(rows[:, 0])))
        began = time.process_time()
        results = ar.analyze(rows[:, 1:], rate=rate, motion_gate=False)
        spent = (time.process_time() - began) / len(list(results))
        medians: dict[str, list[float]] = {'gyro': [], 'accel': []}
        outside: Counter[str] = Counter()
        octaves: Counter[str] = Counter()
        for axis in (results[each] for each in results):
            if axis.curve is None:
                continue
            tau = axis.curve.m * axis.tau0
            used = (axis.curve.m >= axis.fit.m_min) & (tau <= results.duration_s / 20.0)
            ratio = axis.curve.adev[used] / np.sqrt(axis.fit.model.avar(tau[used], axis.tau0))
            sensor = axis.name.split('_')[0]
            medians[sensor] += octave_medians(ratio, tau[used]).tolist()
            found, number = beyond(axis, results.duration_s)
            outside[sensor] += found
            octaves[sensor] += number
        cells = [
            f'{sensor} {min(r):.2f}..{max(r):.2f}, {outside[sensor]} of {octaves[sensor]} outside'
            for sensor, r in medians.items()
        ]
        print(
            f'{name}, {results.duration_s:.0f} s, {spent:.2f} s/axis: ' + '; '.join(cells),
            flush=True,
        )


def run(scenario: str, runs: int, methods: list[str], keep: Path | None) -> None:
    """Simulate the records of a scenario, fit them by each method, and print a table per method."""
    rows: dict[str, list[AxisFit]] = {method: [] for method in methods}
    spent = dict.fromkeys(methods, 0.0)
    for sums in draws(scenario, runs, keep):
        for method in methods:
            begin = time.process_time()
            fit = fit_paper if method == 'paper' else fit_likelihood
            rows[method] += fit(sums).axes.values()
            spent[method] += time.process_time() - begin
    for method in methods:
        got = rows[method][:runs]
        cost = 1e3 * spent[method] / len(rows[method])
        print(f'\n{scenario}, {method}, {len(got)} runs, {cost:.1f} ms of CPU per axis\n')
        print(table(scenario, got), flush=True)
        if method == 'likelihood':
            print(f'\n{processes_found(got)}', flush=True)


def main(arguments: list[str] | None = None) -> None:
    """Run the requested scenarios."""
    parser = argparse.ArgumentParser(description='Monte Carlo of the fits.')
    parser.add_argument('scenarios', nargs='*', default=['table1_x', 'white', 'five_minutes'])
    parser.add_argument('--runs', type=int, default=24)
    methods = ['likelihood', 'paper']
    parser.add_argument('--methods', nargs='+', default=methods)
    parser.add_argument('--keep', type=Path, help='folder to keep the sums of the draws in')
    parser.add_argument('--rate', type=float, help='rate in Hz instead of the rate of the scenario')
    options = parser.parse_args(arguments)
    if options.rate:
        known = {name: replace(SCENARIOS[name], rate=options.rate) for name in options.scenarios}
        SCENARIOS.update(known)
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
    for scenario in options.scenarios:
        if scenario == 'real':
            real()
        else:
            run(scenario, options.runs, options.methods, options.keep)


if __name__ == '__main__':
    main()
