# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Demonstration on an IMU with known noise: simulate, analyze, compare with the truth, play to the
nodes.

usage: demo.py FOLDER [--hours H]

The IMU is the ADIS16475-3 of Cong, Wang, Yan (2019): 100 Hz, 2 h, the five terms of its table 1.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from demo_online import play

from allan_ros.cli.main import main as allan
from allan_ros.core.estimate import Estimate, interval_text, value_text
from allan_ros.core.fit.result import TERMS
from allan_ros.core.imu import shown_unit
from allan_ros.core.number_text import significant
from allan_ros.readers.files import read_json
from allan_ros.results.documents import results_from_document
from allan_ros.results.results import Results
from allan_ros.results.simulation import AxesNoise, read_noise, truth_path

CONFIDENCE = 0.95
"""Expected fraction of intervals and limits that contain the truth."""


def main() -> int:
    """Run the demo and return the exit code of the first step that fails, else 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('folder', type=Path)
    parser.add_argument('--hours', default='2', help='length of the recording (default 2)')
    args = parser.parse_args()
    bag = args.folder / 'adis16475'
    args.folder.mkdir(parents=True, exist_ok=True)
    steps = [
        ['simulate', f'{bag}', '--preset', 'paper', '--hours', args.hours, '--overwrite'],
        ['analyze', f'{bag}', '-o', f'{args.folder}'],
    ]
    for step in steps:
        print(f'$ allan {shlex.join(step)}', flush=True)
        began = time.monotonic()
        code = allan(step)
        if code:
            return code
        print(f'({time.monotonic() - began:.1f} s)\n', flush=True)
    results = results_from_document(read_json(args.folder / 'results.json'))
    print('\n'.join(comparison(results, read_noise(truth_path(bag)))))
    if find_spec('rclpy') is None:
        print('\nno rclpy here: the nodes are left out (it is there inside ROS, or by `make venv`)')
        return 0
    return play(bag, args.folder, 'adis16475-3')


def comparison(results: Results, truth: AxesNoise) -> Iterator[str]:
    """Yield a table of every coefficient with its true value, then the number of correct
    intervals.
    """
    yield f'{"":9}{"":17}{"true":>10}{"found":>11}   95 % interval'
    inside = []
    for axis, result in results.axes.items():
        for term in TERMS:
            true, coefficient = truth[axis].value(term), result.fit.noise[term]
            unit = shown_unit(axis, term, 'deg/h')
            inside.append(holds(coefficient, abs(true)))
            yield (
                f'{axis if term == TERMS[0] else "":9}{f"{term} {unit.name}":17}'
                f'{significant(true * unit.factor, 4):>10}{value_text(coefficient, unit):>11}   '
                f'{interval_text(coefficient, unit):18}{"" if inside[-1] else "truth outside"}'
            ).rstrip()
    yield (
        f'\n{sum(inside)} of {len(inside)} intervals and limits hold the truth; '
        f'{CONFIDENCE * len(inside):g} are expected to'
    )


def holds(coefficient: Estimate, true: float) -> bool:
    """Return whether the true value is in the interval, or below the limit of an unresolved
    term.
    """
    if coefficient.status == 'estimated' and coefficient.ci95 is not None:
        low, high = coefficient.ci95
        return low <= true <= high
    return coefficient.upper95 is None or true <= coefficient.upper95


if __name__ == '__main__':
    sys.exit(main())
