# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Speed and rounding errors of the Allan sums, compared with allantools.oadev and exact integers.

    python bench/bench_engine.py           up to 10 h of six axes at 1 kHz, half a minute
    python bench/bench_engine.py --full    up to 100 h: 360 M samples, some minutes

Floating-point numbers (float64) between 8 and 16 are multiples of 2^-49. Samples near 9.8 m/s^2 are
therefore integers in this unit, and the exact sums of squares can be computed from the integers.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

os.environ['OPENBLAS_NUM_THREADS'] = '1'
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from allan_ros.core.allan.running import RunningSums

OFFSET = 9.8
BIT = 2.0**-49
"""Spacing of float64 numbers between 8 and 16."""
SIGMA = 0.02
"""Standard deviation of the samples in m/s^2, typical of a consumer accelerometer."""
RATE_HZ = 1000
BLOCK = 1 << 20
STEP = 256
"""The exact integral of the samples is kept at every 256th sample. Only the Allan sums whose stride
is at least 256 are checked."""
HOURS = (1 / 6, 1.0, 10.0, 100.0)
AXES = 6
CHECKED_AXIS = 3


def blocks(samples: int, pool: np.ndarray, seed: int = 0) -> Iterator[tuple[int, int]]:
    """Yield first column and number of columns of the random blocks of ``pool`` in a record."""
    rng = np.random.default_rng(seed)
    while samples > 0:
        size = min(BLOCK, samples)
        yield int(rng.integers(pool.shape[1] - size)), size
        samples -= size


def exact_phase(samples: int, numbers: np.ndarray) -> np.ndarray:
    """Return the integrated samples of an axis at every `STEP`-th sample, as multiples of `BIT`."""
    parts, last, at = [np.zeros(1, np.int64)], 0, 0
    first = None
    for begin, size in blocks(samples, numbers[None]):
        part = numbers[begin : begin + size]
        first = part[0] if first is None else first
        phase = last + np.cumsum(part - first)
        parts.append(phase[STEP - 1 - at % STEP :: STEP])
        last, at = int(phase[-1]), at + size
    return np.concatenate(parts)


def exact_sum_sq(phase: np.ndarray, m: int, stride: int) -> float:
    """Return the exact sum of the squared second differences at averaging factor ``m``."""
    lag, step = m // STEP, stride // STEP
    d = (phase[2 * lag :] - 2 * phase[lag:-lag] + phase[: -2 * lag])[::step]
    return float((d.astype(np.longdouble) ** 2).sum() * BIT**2)


def show_growth(hours: tuple[float, ...]) -> None:
    values = OFFSET + np.random.default_rng(1).normal(0.0, SIGMA, (AXES, 4 * BLOCK))
    numbers = np.rint((values[CHECKED_AXIS] - OFFSET) / BIT).astype(np.int64)
    print(
        '\n| record at 1 kHz x 6 axes | samples | CPU, s | us a sample | memory grew by, MB '
        '| worst relative error | factors checked |'
    )
    print('|---|---|---|---|---|---|---|')
    runs = []
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for length in hours:
        samples = round(length * 3600 * RATE_HZ)
        engine, cpu, at = RunningSums(), 0.0, 0
        for first, size in blocks(samples, values):
            part = values[:, first : first + size].T
            begin = time.process_time()
            engine.update(part, at, at + size - 1)
            cpu += time.process_time() - begin
            at += size
        engine.end_segment()
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        runs.append((length, samples, cpu, memory, engine.sums))
    for length, samples, cpu, memory, sums in runs:
        phase, errors = exact_phase(samples, numbers), []
        for i in np.flatnonzero(sums.stride >= STEP):
            exact = exact_sum_sq(phase, int(sums.m[i]), int(sums.stride[i]))
            errors.append(abs(sums.sum_sq[i, CHECKED_AXIS] / exact - 1.0))
        cells = f'{samples:,} | {cpu:.1f} | {cpu / samples * 1e6:.3f} | {memory / 1024:.1f}'
        print(f'| {length:.3g} h | {cells} | {max(errors):.1e} | {len(errors)} |', flush=True)


class Comparison(NamedTuple):
    """Median CPU time in s of the Allan sums and of allantools for equal averaging factors."""

    ours: float
    theirs: float
    ratio: float
    factors: int


def compared(rounds: int) -> Comparison:
    """Measure the Allan sums and allantools in alternating rounds, with 1 M samples of 6 axes."""
    import allantools

    # one row for each axis; the transpose of a part of the rows is a block of a stream
    y = np.random.default_rng(2).normal(size=(AXES, 1_000_000))
    ours, theirs = [], []
    for _ in range(rounds):
        begin = time.process_time()
        engine = RunningSums()
        for at in range(0, y.shape[1], 32768):
            part = y[:, at : at + 32768].T
            engine.update(part, at, at + len(part) - 1)
        engine.end_segment()
        factors = engine.sums.m.astype(float)
        ours.append(time.process_time() - begin)
        begin = time.process_time()
        for values in y:
            allantools.oadev(values, rate=1.0, data_type='freq', taus=factors)
        theirs.append(time.process_time() - begin)
    ratio = statistics.median(t / o for o, t in zip(ours, theirs))
    return Comparison(statistics.median(ours), statistics.median(theirs), ratio, len(factors))


def show_ratio(rounds: int) -> None:
    found = compared(rounds)
    print('\n| 1 M samples x 6 axes | factors | CPU, s |')
    print('|---|---|---|')
    print(f'| allan_ros | {found.factors} | {found.ours:.3f} |')
    print(f'| allantools.oadev, the same factors | {found.factors} | {found.theirs:.2f} |')
    print(f'| ratio | | {found.ratio:.1f}x |', flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--full', action='store_true', help='to 100 h')
    parser.add_argument('--rounds', type=int, default=5, help='how often (default 5)')
    args = parser.parse_args()
    show_ratio(args.rounds)
    show_growth(HOURS if args.full else HOURS[:-1])


if __name__ == '__main__':
    main()
