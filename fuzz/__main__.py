# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Run the targets one after the other, each in its own process, and print a table."""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from .harness import CURRENT, HANG_SECONDS, TARGETS, Tally, Watch, run_target

EXIT_CRASHES = 1

HEADING = ('target', 'inputs', 'refused in a line', 'valid', 'crashes', 'slowest, s', 'memory, MB')
"""Columns of the table; the memory is the growth of the process after the first inputs."""

GRACE_S = HANG_SECONDS + 60.0
"""Additional time in s that a target may take to start, to check the last input, and to shrink."""


def main() -> int:
    """Run the targets and return 1 if one crashed."""
    parser = argparse.ArgumentParser(prog='python -m fuzz', description=__doc__)
    parser.add_argument('targets', nargs='*', metavar='TARGET', help=f'of {", ".join(TARGETS)}')
    parser.add_argument('--seconds', type=float, default=60.0, help='total time in s (default 60)')
    parser.add_argument('--seed', type=int, default=0, help='first seed of the inputs')
    parser.add_argument(
        '--shrink', action='store_true', help='reduce inputs that crash to small ones (slow)'
    )
    parser.add_argument('--here', action='store_true', help='run in this process, and print JSON')
    options = parser.parse_args()
    names = options.targets or list(TARGETS)
    if unknown := set(names) - set(TARGETS):
        parser.error(f'no target {", ".join(unknown)}: choose of {", ".join(TARGETS)}')
    share = options.seconds / len(names)
    if options.here:
        watch = Watch()
        for name in names:
            print(
                json.dumps(
                    asdict(run_target(TARGETS[name](), share, options.seed, watch, options.shrink))
                )
            )
        return 0
    print(_line(HEADING))
    found = 0
    for name in names:
        tally = _in_a_process(name, share, options.seed, options.shrink)
        row = _row(tally)
        print('\n  '.join([_line(row), *tally.crashes.values()]), flush=True)
        found += len(tally.crashes)
    return EXIT_CRASHES if found else 0


def _in_a_process(name: str, seconds: float, number: int, shrink: bool) -> Tally:
    """Run one target in a process with its own limits."""
    command = [sys.executable, '-m', 'fuzz', '--here', name]
    command += ['--seconds', str(seconds), '--seed', str(number)] + ['--shrink'] * shrink
    with tempfile.TemporaryDirectory(prefix='allan_fuzz.') as folder:
        current = Path(folder, 'current')
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, CURRENT: str(current), 'TMPDIR': folder},
            start_new_session=True,
        )
        try:
            out, errors = process.communicate(timeout=seconds + GRACE_S)
        except subprocess.TimeoutExpired:
            _kill_group(process.pid)
            out, errors = '', f'hung between inputs\n{process.communicate()[1]}'
        finally:
            _kill_group(process.pid)
        if process.returncode or not out.strip():
            last = current.read_text('utf-8', errors='replace') if current.exists() else 'no input'
            text = f'ended with {process.returncode}: {errors[-4000:]}\n  {last[:2000]}'
            return Tally(name, crashes={'process': text})
    return Tally(**json.loads(out.strip().splitlines()[-1]))


def _kill_group(leader: int) -> None:
    """Kill a process and its child processes, which would keep its output open."""
    with suppress(ProcessLookupError):
        os.killpg(leader, signal.SIGKILL)


def _line(cells: tuple[str, ...]) -> str:
    return ''.join(f'{cell:>18}' for cell in cells)


def _row(tally: Tally) -> tuple[str, ...]:
    counted = (tally.inputs, tally.inputs - tally.valid, tally.valid, len(tally.crashes))
    cost = f'{tally.slowest_s:.2f}', f'{tally.memory_bytes / 1e6:.0f}'
    return tally.name, *(f'{number:,}' for number in counted), *cost


if __name__ == '__main__':
    sys.exit(main())
