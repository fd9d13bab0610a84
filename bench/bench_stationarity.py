# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stationarity tests: false alarms on clean records, power, coverage of K, and real recordings.

    python bench/bench_stationarity.py alarms --records 400     clean records of every kind
    python bench/bench_stationarity.py power --records 100      warm-up and steps
    python bench/bench_stationarity.py coverage --records 40    of K after a warm-up, with fits
    python bench/bench_stationarity.py widths --records 40      of intervals on clean records
    python bench/bench_stationarity.py real --data DIR          sixths of ADIS16405 recordings

Records are drawn at 1 Hz: the tests take means over 8 s and more, which have the same distribution
as those of faster samples with the same N. Each writes its rows into
bench/results.md (``--dry`` only prints them).
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from allan_ros.core.allan.levels import drift_scatter, level_changes
from allan_ros.core.allan.stationarity import bias_steps, early_parts
from doc_table import DocTable
from numpy.typing import NDArray
from scipy.stats import beta

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.fit import Coefficient, fit_noise
from allan_ros.core.fit.stationary import fit_stationary
from allan_ros.core.imu import AXES, from_datasheet
from allan_ros.core.noise import NoiseTerms
from allan_ros.core.simulate import simulate_axis

Floats = NDArray[np.float64]

SENSORS = ((0, 1, 2), (3, 4, 5))
HOUR = 3600
TRUTH = {'Q': 0.138, 'N': 0.242, 'B': 5.237, 'K': 31.807, 'R': 76.242}
"""Gyro X of table 1 of the paper."""

SIXTHS = 6


def gyro(terms: str) -> NoiseTerms:
    """Return the noise of gyro X with only the given terms."""
    return NoiseTerms(**{t: from_datasheet(t, 'gyro', TRUTH[t]) for t in terms})


CLEAN = {'table 1 X': 'QNBKR', 'white': 'N', 'N + B': 'NB', 'N + K': 'NK'}


def deg_h(value: float) -> float:
    return from_datasheet('B', 'gyro', value)


def sums_of(y: Floats, gap: tuple[int, int] | None = None, tau0: float = 1.0) -> AllanSums:
    """Return the sums of samples; the samples in ``gap`` (first, last) are left out."""
    engine = RunningSums(axes=AXES[: y.shape[1]])
    tick = round(tau0 * 1e9)
    for first, last in ((0, len(y)),) if gap is None else ((0, gap[0]), (gap[1], len(y))):
        engine.update(y[first:last], first * tick, (last - 1) * tick)
        engine.end_segment()
    return engine.sums


def draw(terms: NoiseTerms, seconds: int, rng: np.random.Generator, axes: int = 6) -> Floats:
    return np.stack([simulate_axis(seconds, 1.0, terms, rng) for _ in range(axes)], axis=1)


def warm_up(seconds: int, size: float, decay: float) -> Floats:
    return deg_h(size) * np.exp(-np.arange(seconds) / decay)


def steps(seconds: int, size: float, count: int, rng: np.random.Generator) -> Floats:
    out = np.zeros(seconds)
    for at in rng.integers(seconds // 20, seconds - seconds // 20, count):
        out[at:] += deg_h(size) * rng.choice([-1, 1])
    return out


EARLY = ('warm_up', 'settled_part', 'early_part')
"""Findings of an early part."""

REPORTED = (*EARLY, 'bias_steps', 'level_changes', 'drift_changes')
"""Findings of all stationarity tests."""


def alarms(sums: AllanSums) -> tuple[bool, bool, bool, bool]:
    """Return whether the tests find an early part, steps, a change of level, a change of the
    drift.
    """
    one = sums.history.recordings[0]
    sensors = [s for s in SENSORS if s[-1] < len(sums.axes)] or [range(len(sums.axes))]
    early = early_parts(one, sensors)
    age = max((part.age for part in early), default=0)
    return (
        bool(early),
        bool(bias_steps(one, age)),
        bool(level_changes([one], age)),
        bool(drift_scatter([one], sensors, age).any()),
    )


def band(found: int, of: int) -> str:
    """Return a share with its exact 95 % limits."""
    low = beta.ppf(0.025, found, of - found + 1) if found else 0.0
    high = beta.ppf(0.975, found + 1, of - found) if found < of else 1.0
    return f'{found} of {of}: {found / of:.2%} ({low:.2%} to {high:.2%})'


def show_alarms(records: int, seed: int) -> Iterator[tuple[str, ...]]:
    """Yield the false alarms of each kind of clean noise; record i is the same in every run."""
    kinds = [(name, hours) for name in CLEAN for hours in (2, 10)]
    found = np.zeros((len(kinds), 6), int)
    for i in range(records):
        for k, (name, hours) in enumerate(kinds):
            rng = np.random.default_rng([seed, i, k])
            sums = sums_of(draw(gyro(CLEAN[name]), hours * HOUR, rng))
            each = alarms(sums)
            texts = reported(sums) if any(each) else []
            found[k] += (*each, any(each), bool(texts))
            if any(each):
                print(f'{name}, {hours} h, record {i}: {each}', *texts, sep='\n  ', flush=True)
        if i % 20 == 19:
            print(f'{i + 1} of each: {found.tolist()}', file=sys.stderr, flush=True)
    rows = [(f'{name}, {hours} h', records, row) for (name, hours), row in zip(kinds, found)]
    for label, of, row in (*rows, ('all', records * len(kinds), found.sum(axis=0))):
        yield (label, *(f'{n} of {of}' for n in row[:4]), *(band(int(n), of) for n in row[4:]))


def reported(sums: AllanSums) -> list[str]:
    """Return the findings of the stationarity tests."""
    _, model = fit_stationary(sums)
    return [f'{f.id}: {f}' for f in model.findings if f.id in REPORTED]


def show_power(records: int, seed: int) -> Iterator[tuple[str, ...]]:
    rng = np.random.default_rng(seed)

    def share(which: int, make: Callable[..., AllanSums], *args: object) -> str:
        return band(sum(alarms(make(*args))[which] for _ in range(records)), records)

    def warming(terms: str, hours: int, size: float, axes: int, knock: bool) -> AllanSums:
        y = draw(gyro(terms), hours * HOUR, rng)
        y[:, :axes] += warm_up(len(y), size, 300.0)[:, None]
        return sums_of(y, (3, 6) if knock else None)

    def stepping(size: float) -> AllanSums:
        y = draw(gyro('NB'), 10 * HOUR, rng, 1)
        y[:, 0] += steps(len(y), size, 5, rng)
        return sums_of(y)

    for name, terms, hours in (('table 1 X, 2 h', 'QNBKR', 2), ('N + B, 8 h', 'NB', 8)):
        for knock in (False, True):
            label = f'warm-up 100 deg/h, 300 s, {name}, all axes'
            knocked = ', knock at 3 s' if knock else ''
            yield label + knocked, share(0, warming, terms, hours, 100.0, 6, knock)
    for size in (100.0, 300.0):
        label = f'warm-up {size:g} deg/h, 300 s, table 1 X, 2 h, one axis'
        yield label, share(0, warming, 'QNBKR', 2, size, 1, False)
    for size in (20.0, 100.0):
        yield f'five steps of {size:g} deg/h, N + B, 10 h', share(1, stepping, size)


def show_coverage(records: int, seed: int) -> Iterator[tuple[str, ...]]:
    """Yield how often a warm-up of three axes is reported, and how often the fitted K is
    covered.
    """
    rng = np.random.default_rng(seed)
    for name, terms, hours in (('table 1 X, 2 h', 'QNBKR', 2), ('N + B, 8 h', 'NB', 8)):
        for knock in (False, True):
            reported = covered = number = 0
            for _ in range(records):
                y = draw(gyro(terms), hours * HOUR, rng, 3)
                y += warm_up(len(y), 100.0, 300.0)[:, None]
                _, model = fit_stationary(sums_of(y, (3, 6) if knock else None))
                reported += any(f.id in EARLY for f in model.findings)
                for axis in model.axes.values():
                    covered += covers(axis.noise['K'], gyro(terms).K)
                    number += 1
            label = name + (', knock at 3 s' if knock else '')
            yield label, band(reported, records), band(covered, number)


def show_widths(records: int, seed: int) -> Iterator[tuple[str, ...]]:
    """Yield the coverage on clean noise if intervals include the scatter between sixths."""
    rng = np.random.default_rng(seed)
    for name, terms in (('table 1 X', 'QNBKR'), ('N + K', 'NK')):
        covered, number, widths = dict.fromkeys('NBK', 0), 0, []
        for _ in range(records):
            sums = sums_of(draw(gyro(terms), 2 * HOUR, rng, 3))
            used, model = fit_stationary(sums)
            plain = fit_noise(used)
            for axis, fit in model.axes.items():
                number += 1
                for term in 'NBK':
                    covered[term] += covers(fit.noise[term], getattr(gyro(terms), term))
                wide, narrow = (width(m.axes[axis].noise['K']) for m in (model, plain))
                if wide and narrow:
                    widths.append(wide / narrow)
        shares = (band(covered[term], number) for term in 'NBK')
        yield f'{name}, 2 h', *shares, f'{np.mean(widths) - 1.0:+.2%}'


def width(c: Coefficient) -> float | None:
    if c.status == 'estimated' and c.ci95 is not None:
        return c.ci95[1] - c.ci95[0]
    return c.upper95


def covers(c: Coefficient, truth: float) -> bool:
    if c.status == 'estimated':
        return c.ci95 is not None and c.ci95[0] <= truth <= c.ci95[1]
    return c.upper95 is None or truth <= c.upper95


# --- real recordings ------------------------------------------------------------------------------


def show_real(folder: Path) -> Iterator[tuple[str, ...]]:
    """Yield chi^2 per degree of freedom of N, B, K over sixths of the fitted part."""
    sys.path.insert(0, str(folder / 'adis16405'))
    from load import load

    misfit: dict[tuple[str, str], list[float]] = {}
    for unit in ('imu1', 'imu2', 'imu4'):
        y = load(unit)[:, 1:]
        complete = sums_of(y, tau0=0.01)
        used, model = fit_stationary(complete)
        for found in model.findings:
            print(f'  {unit}: {found}', flush=True)
        rest = y[len(y) - used.samples :]
        n = len(rest) // SIXTHS
        parts = [fit_noise(sums_of(rest[i * n : (i + 1) * n], tau0=0.01)) for i in range(SIXTHS)]
        for axis in AXES:
            for term in 'NBK':
                each = [part.axes[axis].noise[term] for part in parts]
                value = chi_squared(each, model.axes[axis].noise[term])
                misfit.setdefault((axis[:5], term), []).append(value)
        yield unit, f'{used.samples / complete.samples:.0%} used', *deviations(used, model)
    for (sensor, term), values in misfit.items():
        yield f'chi^2/dof, {sensor} {term}', f'{np.nanmean(values):.2f}', '', ''


def chi_squared(parts: Sequence[Coefficient], whole: Coefficient) -> float:
    """Return the mean squared deviation of the parts from the whole, in standard errors.

    A limit agrees if it exceeds the value of the complete part.
    """
    terms = []
    for part in parts:
        if whole.status != 'estimated' or not whole.value or whole.ci95 is None:
            return math.nan
        if part.status != 'estimated' or part.ci95 is None or not part.ci95[0] > 0.0:
            above = part.upper95 is None or part.upper95 >= whole.value
            terms.append(0.0 if above else (math.log(whole.value / part.upper95) * 2) ** 2)
            continue
        error = math.hypot(
            *(math.log(c.ci95[1] / c.ci95[0]) / 3.92 for c in (part, whole) if c.ci95)
        )
        terms.append((math.log(part.value / whole.value) / error) ** 2)
    return float(np.mean(terms))


def deviations(sums: AllanSums, model) -> tuple[str, str]:
    """Return the median ratio of the measured deviation to the model, in two ranges."""
    ratios: dict[str, list[float]] = {'near': [], 'far': []}
    tau = sums.m * sums.tau0
    for i, axis in enumerate(sums.axes):
        drawn = model.axes[axis].model.avar(tau, sums.tau0)
        ratio = np.sqrt(sums.avar[:, i] / drawn)
        near, far = (tau >= 600) & (tau < 1500), tau >= 1500
        ratios['near'] += ratio[near].tolist()
        ratios['far'] += ratio[far].tolist()
    return tuple(f'{np.median(r):.2f}' for r in ratios.values())  # type: ignore[return-value]


TABLES = {
    'alarms': (
        *('clean records', 'early part', 'steps', 'level', 'drift'),
        *('any (95 % limits)', 'reported (95 % limits)'),
    ),
    'power': ('effect', 'reported (95 % limits)'),
    'coverage': ('warm-up 100 deg/h, 300 s, 3 axes', 'reported', 'K covered (95 % limits)'),
    'widths': ('clean records', 'N covered', 'B covered', 'K covered', 'K interval wider by'),
    'real': ('recording', 'value', 'curve/model, 600-1500 s', 'above 1500 s'),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('table', choices=tuple(TABLES))
    parser.add_argument('--records', type=int, default=100, help='of each kind (default 100)')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--data', type=Path, help='folder with adis16405/load.py')
    parser.add_argument('--dry', action='store_true', help='do not write the document')
    args = parser.parse_args()
    began = time.process_time()
    rows = {
        'alarms': lambda: show_alarms(args.records, args.seed),
        'power': lambda: show_power(args.records, args.seed),
        'coverage': lambda: show_coverage(args.records, args.seed),
        'widths': lambda: show_widths(args.records, args.seed),
        'real': lambda: show_real(args.data),
    }[args.table]()
    page = DocTable(f'stationarity_{args.table}', TABLES[args.table])
    for row in rows:
        print(f'| {" | ".join(row)} |', flush=True)
        if not args.dry:
            page.put(row)
    print(f'{time.process_time() - began:.0f} s of CPU')


if __name__ == '__main__':
    main()
