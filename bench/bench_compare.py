# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""False alarms of `allan compare`: the share of pairs of equal noise with a significant difference.

    python bench/bench_compare.py                           20 pairs, a minute or two
    python bench/bench_compare.py --pairs 200 --seed 2026   the count in docs/compare.md, 8 min

Each pair consists of two simulated recordings of the six axes of one IMU. Every sample goes through
the engine; fits are done as by `allan analyze`, comparisons as by `allan compare`.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter

import numpy as np
from bench_accuracy import clopper_pearson

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.compare import FAMILY_ERROR
from allan_ros.core.imu import AXES, from_datasheet, sensor_of
from allan_ros.core.noise import NoiseTerms
from allan_ros.core.simulate import PRESETS, simulate_axis
from allan_ros.io.comparison import Subject, compare_runs
from allan_ros.io.recorded import Provenance
from allan_ros.io.results import Results, analyze_sums

RATE = 50.0
"""Hz."""

TRUTH = {
    axis: NoiseTerms(**{t: from_datasheet(t, sensor_of(axis), v) for t, v in terms.items()})
    for axis, terms in PRESETS['paper'].items()
}


def simulated_run(seconds: float, rng: np.random.Generator) -> Results:
    """Return the results of one simulated recording of six axes."""
    n = round(seconds * RATE)
    rows = np.stack([simulate_axis(n, 1.0 / RATE, TRUTH[axis], rng) for axis in AXES], axis=1)
    engine = RunningSums(axes=AXES)
    engine.update(rows, 0, round((n - 1) * 1e9 / RATE))
    engine.end_segment()
    return analyze_sums([engine.sums], Provenance())


def main() -> None:
    """Simulate the pairs and print how many differ significantly, and in which term."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--pairs', type=int, default=20)
    parser.add_argument('--minutes', type=float, nargs=2, default=(60.0, 60.0), metavar='M')
    parser.add_argument('--seed', type=int, default=0)
    args = parser.parse_args()
    alarms, compared = 0, []
    by_what: Counter[str] = Counter()
    shown = sys.stderr.isatty()  # progress is drawn on a terminal only
    for pair in range(args.pairs):
        rng = np.random.default_rng([args.seed, pair])
        runs = [
            Subject(name, simulated_run(60.0 * minutes, rng))
            for name, minutes in zip(('first', 'second'), args.minutes)
        ]
        (found,) = compare_runs(runs).pairs
        compared.append(sum(d.p is not None for d in found.differences))
        alarms += bool(found.beyond)
        by_what.update(d.quantity for d in found.beyond)
        if shown:
            print(f'\r{alarms} of {pair + 1}', end='', file=sys.stderr, flush=True)
    if shown:
        print('\r', end='', file=sys.stderr, flush=True)
    low, high = clopper_pearson(alarms, args.pairs)
    print(
        f'{alarms} of {args.pairs} pairs of equal noise are told apart, '
        f'{alarms / args.pairs:.1%} ({low:.1%} to {high:.1%}), {FAMILY_ERROR:.0%} allowed; '
        f'{min(compared)} to {max(compared)} comparisons each; by {dict(by_what)}'
    )


if __name__ == '__main__':
    main()
