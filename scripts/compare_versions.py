# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compare two checkouts: are the sums of recordings equal bit for bit, and how do results
differ?

usage: compare_versions.py BEFORE AFTER [RECORDING ...]

BEFORE and AFTER are folders of checkouts. Five simulated recordings are written and analyzed by
both, in addition to the named recordings. Exits with 1 if any sums differ.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

SIMULATED = {
    'clean': ['--hours', '1'],
    'gaps': ['--hours', '0.5', '--gaps', '300:20', '--gaps', '900:5', '--drop', '0.002'],
    'motion': ['--hours', '0.5', '--motion', '600:30', '--bumps', '3'],
    'held': ['--hours', '0.5', '--accel-rate', '62.5'],
    'jitter': ['--hours', '0.5', '--jitter', '0.0004', '--low-pass', '20'],
}
"""Name -> faults of a simulated recording."""

SUMS = ('axes', 'elapsed_ns', 'intervals', 'm', 'count', 'sum_sq', 'group_count', 'group_sum_sq')
SEGMENT = ('start_ns', 'samples', 'phase_step', 'signed', 'phase')
CLASS = ('index', 'count', 'samples', 'ramp_correction')
"""Fields that must be equal in both versions."""


def allan(checkout: Path, *words: str) -> bool:
    """Run the command line of a checkout and return whether it succeeded."""
    environment = {**os.environ, 'PYTHONPATH': str(checkout), 'OPENBLAS_NUM_THREADS': '1'}
    command = [sys.executable, '-m', 'allan_ros.cli.main', *words]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=checkout)
    if done.returncode:
        print(f'  {checkout.name}: {done.stderr.strip()[:200]}')
    return done.returncode == 0


def kept(document: dict[str, Any]) -> list[Any]:
    """Return the numbers of a sums.json that both versions must compute equally."""
    return [
        [
            [sums[key] for key in SUMS],
            [[segment[key] for key in SEGMENT] for segment in sums['segments']],
            [[each[key] for key in CLASS] for each in sums['classes']],
        ]
        for sums in document['sums']
    ]


def coefficients(results: dict[str, Any]) -> Iterator[tuple[str, float | None]]:
    """Yield the name and value of each coefficient; None if it is not resolved."""
    for axis, of_axis in results['axes'].items():
        for term, c in of_axis['noise'].items():
            yield f'{axis} {term}', c['value'] if c['status'] == 'estimated' else None


def largest_change(before: dict[str, Any], after: dict[str, Any]) -> str:
    """Return the largest relative change of a coefficient, and how many changed status."""
    old, new = dict(coefficients(before)), dict(coefficients(after))
    both = {k: abs(math.log(new[k] / v)) for k, v in old.items() if v and new.get(k)}
    status = sum((old[k] is None) != (new.get(k) is None) for k in old)
    worst = max(both, key=lambda name: both[name], default='')
    change = f'{worst} by {math.expm1(both[worst]):.2%}' if worst and both[worst] else 'none'
    return f'largest change {change}, {status} of {len(old)} terms changed status'


def main() -> int:
    """Analyze all recordings with both checkouts and print one line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('before', type=Path)
    parser.add_argument('after', type=Path)
    parser.add_argument('recordings', nargs='*', type=Path)
    args = parser.parse_args()
    checkouts = [args.before.resolve(), args.after.resolve()]
    differ = 0
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        recordings = [path.resolve() for path in args.recordings]
        for seed, (name, faults) in enumerate(SIMULATED.items()):
            path = place / f'{name}.npz'
            words = ['simulate', str(path), '--preset', 'paper', '--seed', str(seed), *faults]
            if allan(checkouts[0], *words):
                recordings.append(path)
        for recording in recordings:
            outputs = [place / 'before', place / 'after']
            words = ['analyze', str(recording), '-q', '-o']
            done = [allan(c, *words, str(o)) for c, o in zip(checkouts, outputs)]
            if not all(done):
                print(f'{recording.name}: analyzed by {sum(done)} of 2 versions')
                differ += done[0] != done[1]
                continue
            sums = [kept(json.loads((o / 'sums.json').read_text())) for o in outputs]
            results = [json.loads((o / 'results.json').read_text()) for o in outputs]
            same = 'identical' if sums[0] == sums[1] else 'DIFFERENT'
            differ += sums[0] != sums[1]
            print(f'{recording.name}: sums {same}; {largest_change(*results)}', flush=True)
    return 1 if differ else 0


if __name__ == '__main__':
    sys.exit(main())
