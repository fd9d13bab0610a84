# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Error rate of `allan compare`: false differences between recordings of equal noise.

    python bench/bench_compare.py                          20 pairs of 5 min, a minute or two
    python bench/bench_compare.py --pairs 200 --hours 1    the counts in docs/validation.md

Each pair consists of two simulated recordings of the six axes of an IMU.
"""

from __future__ import annotations

import argparse

from scipy.stats import beta

import allan_ros as ar

RATE = 50.0
"""Hz."""


def simulated(hours: float, seed: int) -> ar.Results:
    """Return the results of one simulated recording."""
    return ar.analyze(ar.simulate(hours, RATE, seed=seed))


def clopper_pearson(hits: int, runs: int) -> tuple[float, float]:
    """Return the 95 % interval of a probability."""
    low = beta.ppf(0.025, hits, runs - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, runs - hits) if hits < runs else 1.0
    return float(low), float(high)


def main() -> None:
    """Simulate the pairs and print the error rate."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--pairs', type=int, default=20)
    parser.add_argument('--hours', type=float, default=1.0 / 12.0)
    parser.add_argument('--seed', type=int, default=0)
    args = parser.parse_args()
    alarms = 0
    for pair in range(args.pairs):
        seed = 3 * (args.seed * args.pairs + pair)
        first, second = (simulated(args.hours, seed + i) for i in (1, 2))
        (found,) = ar.compare(first, second).pairs
        alarms += bool(found.significant)
    low, high = clopper_pearson(alarms, args.pairs)
    print(f'pairs of equal noise told apart: {alarms} of {args.pairs} ({low:.1%} to {high:.1%})')


if __name__ == '__main__':
    main()
