# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Speed and memory in one table, as ratios to other programs, with the goals.

    python bench/bench_speed.py            0.72 M messages, about 15 min
    python bench/bench_speed.py --full     7.2 M messages
    python bench/bench_speed.py sums read  some rows only

A ratio compares two programs that run one after the other, so that a busy machine affects both. A
row that needs `$ALLAN_ROS_SHARED` or rclpy is empty if this is missing.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import bench_offline as offline
import numpy as np

IMPORTS = 'import numpy, scipy.linalg, scipy.special'
"""The modules of numpy and scipy that an analysis imports."""

ADIS_SAMPLES = 250_000
"""Number of samples of the ADIS16405 that are analyzed: 42 min at 100 Hz."""

MONITOR_S, MONITOR_HZ = 60.0, 200


class Setting(NamedTuple):
    """Folder for files, number of rounds of a measurement, and number of messages of a bag."""

    folder: Path
    rounds: int
    messages: int


def table(setting: Setting) -> str:
    """Return the CPU time of `offline.table` as a multiple of `offline.floor`, for each storage."""
    bags = (offline.bag(setting.folder, name, setting.messages) for name in offline.STORAGES)
    return '; '.join(f'{offline.to_table(bag, setting.rounds).ratio:.1f}' for bag in bags)


def sums(setting: Setting) -> str:
    """Return the CPU time of allantools as a multiple of the CPU time of the Allan sums.

    Both run in a new process: memory that earlier rows have freed would make allantools twice as
    fast.
    """
    from bench_engine import compared

    with ProcessPoolExecutor(1, get_context('spawn')) as pool:
        return f'{pool.submit(compared, setting.rounds).result().ratio:.1f}'


def read(setting: Setting) -> str:
    """Return the CPU time of AnyReader as a multiple of the readers of allan_ros."""
    ratios = (offline.reading(setting.folder, n, setting.rounds).ratio for n in offline.STORAGES)
    return '; '.join(f'{ratio:.0f}' for ratio in ratios)


def analysis(setting: Setting) -> str:
    """Return the CPU time of ``allan analyze -o`` as a multiple of importing numpy and scipy."""
    minute = offline.bag(setting.folder, 'mcap zstd', offline.MINUTE)
    inputs = [minute]
    if offline.SHARED.is_dir():
        from bench_accuracy import shared_recordings

        rows = shared_recordings()['imu2'][:ADIS_SAMPLES]
        inputs.append(saved(setting.folder / 'imu2_42_min.npz', rows))
    ratios = []
    for path in inputs:
        runs = [(analyzed(setting.folder, path), imported()) for _ in range(setting.rounds)]
        ratios.append(statistics.median(cpu / least for cpu, least in runs))
    return '; '.join(f'{ratio:.1f}' for ratio in ratios)


def slowest(setting: Setting) -> str:
    """Return the longest CPU time in s of ``allan analyze -o`` for a shared recording."""
    if not offline.SHARED.is_dir():
        return ''
    costs = {path.name: analyzed(setting.folder, path) for path in recordings(setting.folder)}
    name = max(costs, key=lambda each: costs[each])
    return f'{costs[name]:.1f} s ({name})'


def nodes(setting: Setting) -> str:
    """Return the CPU times of accumulator and monitor as multiples of an empty subscriber.

    The rates are 200 Hz, 1 kHz and 4 kHz.
    """
    if not find_spec('rclpy'):
        return ''
    from bench_online import RATES_HZ, costs

    found = [costs(client(), rate) for rate in RATES_HZ]
    ratios = [[f'{one[i] / one[0]:.2f}' for one in found] for i in (1, 2)]
    return '; '.join(' '.join(each) for each in ratios)


def memory(setting: Setting) -> str:
    """Return the memory of the monitor in MB after a minute of messages."""
    if not find_spec('rclpy'):
        return ''
    from bench_online import memory_after

    return f'{memory_after(client(), MONITOR_S, MONITOR_HZ):.0f} MB'


class Row(NamedTuple):
    """A row of the table: title, function that measures, and goal."""

    title: str
    measure: Callable[[Setting], str]
    goal: str


ROWS = {
    'table': Row('{messages:g} M mcap; sqlite3 to the table, over the floor', table, '5; 8'),
    'sums': Row('sums against allantools, same factors', sums, '6.5'),
    'read': Row('reading against AnyReader: mcap; sqlite3', read, '50; 12'),
    'analysis': Row(
        '60 s with files; 42 min ADIS with files, over importing numpy and scipy',
        analysis,
        '2; 2.5',
    ),
    'slowest': Row('slowest recording of shared data, CPU with files', slowest, '3 s'),
    'nodes': Row(
        'accumulator; monitor over an empty subscriber at 200 Hz, 1, 4 kHz',
        nodes,
        '.25 .15 .12; .30 .15 .12',
    ),
    'memory': Row('monitor at 60 s', memory, '115 MB'),
}


_clients: list[Any] = []


def client() -> Any:
    """Return the client of the nodes, which is created at the first call."""
    from online_nodes import Client

    if not _clients:
        _clients.append(Client())
    return _clients[0]


def imported() -> float:
    """Return the CPU time in s of importing numpy and scipy."""
    return offline.children_cpu([sys.executable, '-c', IMPORTS])


def analyzed(folder: Path, path: Path) -> float:
    """Return the CPU time in s of ``allan analyze -o`` for a recording."""
    out = folder / 'out'
    shutil.rmtree(out, ignore_errors=True)
    return offline.children_cpu([*offline.ALLAN, 'analyze', str(path), '-o', str(out)])


def saved(path: Path, imu: np.ndarray) -> Path:
    """Save samples, (n, 7): t, gyro, accelerometer, as a recording; an existing file is kept."""
    if not path.exists():
        np.savez(path, imu=imu)
    return path


def recordings(folder: Path) -> list[Path]:
    """Return the paths of the shared recordings that `slowest` analyzes."""
    from bench_accuracy import shared_recordings

    found = [saved(folder / f'{name}.npz', rows) for name, rows in shared_recordings().items()]
    names = ('phidgets_imu_upside_down', 'robot_localization_test1', 'tilt_laser')
    return [
        *found,
        offline.SHARED / 'mpu6050.npz',
        *(offline.SHARED / 'bags' / f'{name}.bag' for name in names),
        *sorted((offline.SHARED / 'ulog').glob('*.ulg')),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('rows', nargs='*', default=list(ROWS), help=', '.join(ROWS))
    parser.add_argument('--full', action='store_true', help='7.2 M messages instead of 0.72 M')
    parser.add_argument('--rounds', type=int, default=5, help='how often (default 5)')
    parser.add_argument('--keep', type=Path, help='folder of the bags (default: a passing one)')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as passing:
        messages = offline.LONG if args.full else offline.SHORT
        setting = Setting(args.keep or Path(passing), args.rounds, messages)
        print('| same run, ratios | now | goal |\n|---|---|---|', flush=True)
        for name in args.rows:
            row = ROWS[name]
            title = row.title.format(messages=messages / 1e6)
            print(f'| {title} | {row.measure(setting)} | {row.goal} |', flush=True)


if __name__ == '__main__':
    main()
    sys.stdout.flush()
    os._exit(0)  # the receiving threads of a client do not end
