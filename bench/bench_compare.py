# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Error rates of `allan compare`: false differences, and false equality at the limit of --within.

    python bench/bench_compare.py                          20 pairs of 5 min, a minute or two
    python bench/bench_compare.py --pairs 200 --hours 1    200 pairs of 1 h

Each pair consists of two simulated recordings of the six axes of an IMU. If both recordings have
the same noise, a significant difference is an error. If all noise terms differ by exactly
--within, the answer 'same' is an error, which is expected on at most 5 % of the axes.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable

from scipy.stats import beta

import allan_ros as ar
from allan_ros.core.check import Check
from allan_ros.core.simulator import PRESETS

RATE = 50.0
"""Sample rate in Hz."""


def simulated(hours: float, seed: int, factor: float = 1.0) -> ar.Results:
    """Return the results of a simulated recording, with all noise terms multiplied by a factor."""
    noise = {
        axis: {term: factor * value for term, value in terms.items()}
        for axis, terms in PRESETS['paper'].items()
    }
    gyro, accel = ({a: noise[f'{s}_{a}'] for a in 'xyz'} for s in ('gyro', 'accel'))
    return ar.analyze(ar.simulate(hours, RATE, gyro=gyro, accel=accel, seed=seed))


def clopper_pearson(hits: int, runs: int) -> tuple[float, float]:
    """Return the 95 % interval of a probability, given the number of hits in a number of runs."""
    low = beta.ppf(0.025, hits, runs - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, runs - hits) if hits < runs else 1.0
    return float(low), float(high)


def main() -> None:
    """Simulate the pairs and print both error rates."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--pairs', type=int, default=20)
    parser.add_argument('--hours', type=float, default=1.0 / 12.0)
    parser.add_argument('--within', type=float, default=0.1)
    parser.add_argument('--seed', type=int, default=0)
    args = parser.parse_args()
    alarms = 0
    equal: Counter[tuple[str, str]] = Counter()
    at_limit: Counter[tuple[str, str]] = Counter()
    for pair in range(args.pairs):
        seed = 3 * (args.seed * args.pairs + pair)
        first, second = (simulated(args.hours, seed + i) for i in (1, 2))
        (found,) = ar.compare(first, second).differences.values()
        alarms += any(check.significant for check in found)
        equal.update(_answers(found, args.within))
        shifted = simulated(args.hours, seed, 1.0 + args.within)
        for found_at_limit in ar.compare(first, shifted).differences.values():
            at_limit.update(_answers(found_at_limit, args.within))
    low, high = clopper_pearson(alarms, args.pairs)
    print(f'pairs of equal noise told apart: {alarms} of {args.pairs} ({low:.1%} to {high:.1%})')
    for what, counts in (('of equal noise', equal), ('at the limit', at_limit)):
        for term in ('N', 'B', 'K'):
            n = sum(count for (of, _), count in counts.items() if of == term)
            same = counts[term, 'same']
            low, high = clopper_pearson(same, n) if n else (0.0, 1.0)
            print(f"{term} {what}: 'same' in {same} of {n} axes ({low:.1%} to {high:.1%})")


def _answers(differences: Iterable[Check], within: float) -> list[tuple[str, str]]:
    """Return (term, answer of the test of equivalence) for each coefficient with a known ratio."""
    return [
        (d.quantity, d.equivalence(within))
        for d in differences
        if d.tau is None and d.ratio is not None
    ]


if __name__ == '__main__':
    main()
