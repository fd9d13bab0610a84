# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Monte Carlo of the fits: simulate records with known noise, fit them, compare with the truth.

    python bench/bench_accuracy.py                                   a short version, minutes
    python bench/bench_accuracy.py table1_x --runs 300 --keep DIR    one scenario, sums kept

Samples pass through the engine like those of a recording. With --keep their sums are stored and
reused, so all methods are compared on the same records.
"""

from __future__ import annotations

import argparse
import math
import pickle
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from allan_ros.core.fit.goodness import Z_FAIL

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.fit import TERMS, AxisFit, Coefficient, fit_noise
from allan_ros.core.imu import from_datasheet, to_datasheet
from allan_ros.core.simulate import NoiseTerms, simulate_axis

AXES = ('gyro_x', 'gyro_y', 'gyro_z', 'accel_x', 'accel_y', 'accel_z')
"""Number of axes that are fitted together, as the axes of one IMU."""

CONFIDENCE = 0.95


def gyro(**datasheet: float) -> NoiseTerms:
    """Return noise terms of a gyro; Q, N, B, K, R are in urad, deg/sqrt h, deg/h, deg/h^1.5,
    deg/h^2.
    """
    return NoiseTerms(**{k: from_datasheet(k, 'gyro', v) for k, v in datasheet.items()})


@dataclass(frozen=True)
class Scenario:
    """Kind of records to simulate.

    Attributes
    ----------
    truth : NoiseTerms
    rate, seconds : float
        In Hz and s.
    seed : int
        Seed of the random numbers. It does not depend on the other scenarios.
    segments : int
        Number of segments.
    at_random : bool
        Whether the segments have random instead of equal lengths.
    line : (amplitude, frequency)
        An additional sinusoid: amplitude relative to the white noise per sample, and Hz.
    gauss_markov : (share, correlation time)
        Gauss-Markov noise: variance relative to the white noise per sample, and s.
    """

    truth: NoiseTerms
    rate: float
    seconds: float
    seed: int
    segments: int = 1
    at_random: bool = False
    line: tuple[float, float] = (0.0, 1.0)
    gauss_markov: tuple[float, float] = (0.0, 1.0)

    def axis(self, rng: np.random.Generator) -> np.ndarray:
        """Return the samples of one record."""
        n = round(self.rate * self.seconds)
        white = self.truth.N * self.rate**0.5
        y = simulate_axis(n, 1.0 / self.rate, self.truth, rng)
        amplitude, frequency = self.line
        if amplitude > 0.0:
            turns = frequency / self.rate * np.arange(n) + rng.uniform()
            y += amplitude * white * np.sin(2.0 * np.pi * turns)
        share, time = self.gauss_markov
        if share > 0.0:
            from scipy.signal import lfilter

            keep = math.exp(-1.0 / (self.rate * time))
            steps = rng.standard_normal(n) * math.sqrt(1.0 - keep * keep)
            steps[0] /= math.sqrt(1.0 - keep * keep)
            y += share**0.5 * white * lfilter([1.0], [1.0, -keep], steps)
        return y

    def cuts(self, rng: np.random.Generator) -> np.ndarray:
        """Return the index of the first sample of each segment except the first segment."""
        n = round(self.rate * self.seconds)
        if self.at_random:
            return np.sort(rng.choice(np.arange(1, n), self.segments - 1, replace=False))
        return np.cumsum([len(part) for part in np.array_split(np.arange(n), self.segments)])[:-1]

    def draw(self, rng: np.random.Generator, axes: int) -> AllanSums:
        """Return the sums of one independent record per axis."""
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
# The month of bench/soak_month.py, split at every drive and knock, at a sufficient rate.
MONTH = gyro(N=0.172, K=6.19)
WITH_FLICKER = replace(MONTH, B=from_datasheet('B', 'gyro', 1.24))
SCENARIOS = {
    'table1_x': Scenario(X, 100.0, 2 * HOUR, 10),
    'table1_y': Scenario(Y, 100.0, 2 * HOUR, 11),
    'table1_z': Scenario(Z, 100.0, 2 * HOUR, 12),
    'table1_z_5hz': Scenario(Z, 5.0, 2 * HOUR, 777),
    'white': Scenario(gyro(N=0.242), 100.0, 2 * HOUR, 14),
    'no_walk': Scenario(gyro(N=0.242, B=5.237), 100.0, 2 * HOUR, 6),
    'no_flicker': Scenario(gyro(N=0.242, K=31.807), 100.0, 2 * HOUR, 4),
    'no_ramp': Scenario(replace(X, R=0.0), 100.0, 2 * HOUR, 5),
    'ramp_no_walk': Scenario(replace(X, K=0.0), 100.0, 2 * HOUR, 8),
    'quantized': Scenario(gyro(Q=4.0, N=0.242, K=31.807), 100.0, 2 * HOUR, 7),
    'five_minutes': Scenario(X, 100.0, 300.0, 0),
    'three_hours': Scenario(gyro(N=0.6, B=8.0, K=40.0), 200.0, 3 * HOUR, 13),
    'six_segments': Scenario(X, 100.0, 2 * HOUR, 9, segments=6),
    'line_slow': Scenario(X, 100.0, 2 * HOUR, 3, line=(0.03, 0.02)),
    'line_fast': Scenario(X, 100.0, 2 * HOUR, 2, line=(0.03, 0.2)),
    'gauss_markov': Scenario(X, 100.0, 2 * HOUR, 1, gauss_markov=(0.01, 10.0)),
    'month': Scenario(MONTH, 1.0, 30 * DAY, 15, segments=2600, at_random=True),
    'month_flicker': Scenario(WITH_FLICKER, 1.0, 30 * DAY, 16, segments=2600, at_random=True),
    'month_whole': Scenario(WITH_FLICKER, 1.0, 30 * DAY, 17),
    'million': Scenario(WITH_FLICKER, 1.0, 1e6, 101),
    'half_day': Scenario(X, 20.0, 12 * HOUR, 103),
    'day': Scenario(gyro(N=0.242, B=5.237, K=31.8), 10.0, DAY, 104),
    'month_gauss_markov': Scenario(
        MONTH, 1.0, 30 * DAY, 18, segments=2600, at_random=True, gauss_markov=(0.04, 100.0)
    ),
}


def read_slopes(sums: AllanSums) -> list[dict[str, float | None]]:
    """Return coefficients from lines with the textbook slopes, as most tools do.

    The curve is used up to a ninth of the record. B is its smallest value over 0.664. The other
    coefficients come from lines of slope -1, -1/2, 1/2 and 1 through the point at which the
    slope of the curve is closest to that of the line.
    """
    tau = sums.m * sums.tau0
    keep = 9 * sums.m <= sums.samples
    out: list[dict[str, float | None]] = []
    for a in range(len(sums.axes)):
        log_tau, log_dev = np.log10(tau[keep]), 0.5 * np.log10(sums.avar[keep, a])
        slope = np.diff(log_dev) / np.diff(log_tau)
        values: dict[str, float | None] = {'B': 10 ** log_dev.min() / 0.664}
        lines = (('Q', -1, 3**0.5), ('N', -0.5, 1.0), ('K', 0.5, 3.0), ('R', 1, 2**0.5))
        for term, gradient, at in lines:
            i = int(np.argmin(np.abs(slope - gradient)))
            values[term] = 10 ** (log_dev[i] + gradient * (math.log10(at) - log_tau[i]))
        out.append(values)
    return out


@dataclass(frozen=True)
class Outcome:
    """Result of one fit for one term; NaN if the fit gives no number."""

    value: float
    low: float
    high: float
    seen: bool

    @classmethod
    def of(cls, c: Coefficient) -> Outcome:
        """Return the outcome of a coefficient; an upper limit becomes an interval that begins at
        zero.
        """
        nan = float('nan')
        low, high = c.ci95 or (0.0, nan if c.upper95 is None else c.upper95)
        return cls(c.value or 0.0, low, high, c.status == 'estimated')


def fits_of(sums: AllanSums, method: str) -> list[AxisFit]:
    """Return the fit of every axis."""
    if method == 'slope':
        read = read_slopes(sums)
        return [AxisFit({t: Coefficient(values[t]) for t in TERMS}) for values in read]
    fit = fit_noise(sums, method)
    return [fit.axes[axis] for axis in sums.axes]


def draws(scenario: str, runs: int, keep: Path | None) -> Iterator[AllanSums]:
    """Yield the sums of simulated records, six at a time; files in ``keep`` are reused."""
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
    """Return the exact 95 % interval of a share (Clopper & Pearson, Biometrika 26, 1934)."""
    from scipy.special import betaincinv

    tail = (1.0 - CONFIDENCE) / 2.0
    low = betaincinv(hits, runs - hits + 1, tail) if hits else 0.0
    high = betaincinv(hits + 1, runs - hits, 1.0 - tail) if hits < runs else 1.0
    return float(low), float(high)


def table(scenario: str, fits: list[AxisFit]) -> str:
    """Return the table of one scenario and method: a line per term."""
    lines = [
        '| term | truth | bias % | RMSE % | median | said | coverage % (95 % band) | width |',
        '|---|---|---|---|---|---|---|---|',
    ]
    for term in TERMS:
        truth = getattr(SCENARIOS[scenario].truth, term)
        got = [Outcome.of(fit.noise[term]) for fit in fits]
        value = np.array([g.value for g in got])
        shown, unit = to_datasheet(term, 'gyro', truth)
        cells = [f'{term} [{unit}]', f'{shown:.4g}']
        if truth > 0.0:
            error = value / truth - 1.0
            cells += [f'{100 * error.mean():+.3f}', f'{100 * np.sqrt(np.mean(error**2)):.3f}']
        else:
            cells += ['', '']
        cells.append(f'{to_datasheet(term, "gyro", float(np.median(value)))[0]:.4g}')
        cells.append(f'{100 * np.mean([g.seen for g in got]):.1f} %')
        if np.isfinite([g.high for g in got]).any():
            inside = sum(g.low <= truth <= g.high for g in got)
            low, high = clopper_pearson(inside, len(got))
            cells.append(f'{100 * inside / len(got):.1f} ({100 * low:.1f}-{100 * high:.1f})')
            width = float(np.median([g.high - g.low for g in got]))
            cells.append(f'{to_datasheet(term, "gyro", width)[0]:.4g}')
        else:
            cells += ['', '']
        lines.append('| ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines)


def additional_terms(scenario: str, fits: list[AxisFit]) -> str:
    """Return how often the fit rejected the five terms, and the additional processes it found."""
    failed = np.mean([fit.gof_z >= Z_FAIL for fit in fits])
    lines = [f'fit rejected in {failed:.1%} of runs']
    found = [fit.sinusoid for fit in fits if fit.sinusoid]
    if found:
        white = SCENARIOS[scenario].truth.N * SCENARIOS[scenario].rate ** 0.5
        size = np.median([line.amplitude for line in found]) / white
        hertz = np.median([line.frequency for line in found])
        lines.append(
            f'line in {len(found) / len(fits):.1%}: median {size:.4f} of the white noise per '
            f'sample, {hertz:.4g} Hz'
        )
    drift = [fit.gauss_markov for fit in fits if fit.gauss_markov]
    if drift:
        white = SCENARIOS[scenario].truth.N * SCENARIOS[scenario].rate ** 0.5
        share = np.median([g.sigma for g in drift]) ** 2 / white**2
        time = np.median([g.correlation_time for g in drift])
        lines.append(
            f'Gauss-Markov noise in {len(drift) / len(fits):.1%}: median {share:.4f} of the '
            f'variance per sample, {time:.4g} s'
        )
    misfit = np.mean([fit.misfit > 0.0 for fit in fits])
    cut = np.mean([fit.m_min > 1 for fit in fits])
    lines.append(f'misfit in {misfit:.1%}, shortest averages left out in {cut:.1%}')
    return '; '.join(lines)


def run(scenario: str, runs: int, methods: list[str], keep: Path | None) -> None:
    """Simulate, fit, and print a table for every method."""
    rows: dict[str, list[AxisFit]] = {method: [] for method in methods}
    spent = dict.fromkeys(methods, 0.0)
    for sums in draws(scenario, runs, keep):
        for method in methods:
            begin = time.process_time()
            rows[method] += fits_of(sums, method)
            spent[method] += time.process_time() - begin
    for method in methods:
        got = rows[method][:runs]
        cost = 1e3 * spent[method] / len(rows[method])
        print(f'\n{scenario}, {method}, {len(got)} runs, {cost:.1f} ms of CPU per axis\n')
        print(table(scenario, got), flush=True)
        if method == 'likelihood':
            print(f'\n{additional_terms(scenario, got)}', flush=True)


def main(arguments: list[str] | None = None) -> None:
    """Run the requested scenarios."""
    parser = argparse.ArgumentParser(description='Monte Carlo of the fits.')
    parser.add_argument('scenarios', nargs='*', default=['table1_x', 'white', 'five_minutes'])
    parser.add_argument('--runs', type=int, default=24)
    methods = ['likelihood', 'relative', 'paper', 'slope']
    parser.add_argument('--methods', nargs='+', default=methods)
    parser.add_argument('--keep', type=Path, help='folder to keep the sums of the draws in')
    parser.add_argument('--rate', type=float, help='another rate in Hz than that of the scenarios')
    options = parser.parse_args(arguments)
    if options.rate:
        known = {name: replace(SCENARIOS[name], rate=options.rate) for name in options.scenarios}
        SCENARIOS.update(known)
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
    for scenario in options.scenarios:
        run(scenario, options.runs, options.methods, options.keep)


if __name__ == '__main__':
    main()
