# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""CPU time and memory to compute the Allan deviations of a bag, compared with other readers.

    python bench/bench_offline.py           720,000 messages (1 h at 200 Hz), some minutes
    python bench/bench_offline.py --full    7.2 M messages too (10 h at 200 Hz), several minutes
    python bench/bench_offline.py --keep DIR    keep the bags in DIR, and reuse them

CPU time is the user and system time of the process that is measured. Each number is a median of
several rounds. A round runs all programs one after the other, so that a busy machine affects all of
them.
"""

from __future__ import annotations

import argparse
import os
import resource
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]

SHARED = Path(os.environ.get('ALLAN_ROS_SHARED', ROOT.parent / 'shared')) / 'data'
"""Folder of the shared recordings."""
sys.path.insert(0, str(ROOT))
os.environ.update(OPENBLAS_NUM_THREADS='1', PYTHONPATH=str(ROOT))
# with this variable, each process would compile the package again, which takes 0.5 s
os.environ.pop('PYTHONDONTWRITEBYTECODE', None)

RATE_HZ = 200.0
MINUTE, SHORT, LONG = 12_000, 720_000, 7_200_000
PLAIN = 100_000
"""Number of messages in the bag for `plain`, which takes at least 10 us per message."""
CHUNK_HEAD = 8 + 8 + 8 + 4 + 4 + 4 + 8
"""Bytes before the compressed data of an mcap chunk: two times, size, CRC, the name of the
compression ('zstd') with its length, and the length of the data."""
RECORDINGS = 2
"""Number of recordings that are read one after the other, and in parallel."""
MESSAGE_BYTES = 31 + 324
"""Bytes of an Imu message with the frame_id ``imu_link`` in an mcap chunk: header and payload."""
STORAGES = {'mcap zstd': ('mcap', 'storage'), 'sqlite3': ('sqlite3', 'none')}


def bag(folder: Path, name: str, messages: int) -> Path:
    """Return a simulated bag of a storage in `STORAGES`; a bag that exists is reused."""
    from allan_ros.core.noise import Model
    from allan_ros.core.simulator import simulate_imu
    from fuzz.reading import write_bag

    storage, compression = STORAGES[name]
    path = folder / f'{storage}_{messages}'
    if not path.exists():
        gyro, accel = Model.of(N=7e-5, B=2.5e-5, K=4e-6), Model.of(N=2e-4, B=4e-5)
        batches = simulate_imu(messages / RATE_HZ, RATE_HZ, [gyro] * 3, [accel] * 3, seed=5)
        write_bag(path, batches, storage, compression)
    return path


def table(path: Path) -> int:
    """Compute the Allan deviations of a bag, and return the number of samples."""
    from allan_ros.core.stream.pipeline import ImuStream
    from allan_ros.readers import open_recording

    recording = open_recording(path)
    accumulator = ImuStream()
    for batch in recording.batches():
        accumulator.update(batch)
    accumulator.end()
    (sums,) = accumulator.result().sums
    return sums.samples if sums.avar[0].all() else 0


def read(path: Path) -> int:
    """Read a bag into arrays of samples, and return the number of samples."""
    from allan_ros.readers import open_recording

    recording = open_recording(path)
    return sum(map(len, recording.batches()))


def plain(path: Path) -> int:
    """Read a bag message by message, as the documentation of rosbags shows; return their number."""
    from rosbags.highlevel import AnyReader

    messages = 0
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            messages += message.linear_acceleration.z != 0.0
    return messages


def floor(path: Path) -> int:
    """Do the least work of any reader of a bag, and return the number of messages.

    The chunks of mcap are decompressed, and SQLite steps over all rows.
    """
    from zstandard import ZstdDecompressor

    from allan_ros.readers.mcap import CHUNK, MCAP_MAGIC, RECORD_HEAD

    for database in path.glob('*.db3'):
        with sqlite3.connect(f'file:{database}?immutable=1', uri=True) as connection:
            query = 'SELECT count(*) FROM messages WHERE id > 0 AND length(data) > 0'
            return int(connection.execute(query).fetchone()[0])
    decompress, at, size = ZstdDecompressor().decompress, len(MCAP_MAGIC), 0
    (file,) = path.glob('*.mcap')
    with file.open('rb') as data:
        while data.seek(at) == at and len(head := data.read(RECORD_HEAD.size)) == RECORD_HEAD.size:
            opcode, length = RECORD_HEAD.unpack(head)
            at += RECORD_HEAD.size + length
            if opcode == CHUNK:
                size += len(decompress(data.read(length)[CHUNK_HEAD:]))
    return size // MESSAGE_BYTES


WORK: dict[str, Callable[[Path], int]] = {
    'table': table,
    'read': read,
    'plain': plain,
    'floor': floor,
}


def measured(work: str, path: Path) -> tuple[float, int, float]:
    """Run a function of `WORK` in a separate process, and return what the run costs.

    Returns CPU time in s, number of messages, and largest memory in MB.
    """
    command = [sys.executable, __file__, '--work', work, str(path)]
    cpu, messages, memory = subprocess.run(
        command, check=True, capture_output=True, text=True
    ).stdout.split()
    return float(cpu), int(messages), float(memory)


def work_here(work: str, path: Path) -> None:
    """Run a function of `WORK`, and print what `measured` returns, without the time of imports."""
    import allan_ros.core.stream.pipeline
    import allan_ros.readers.rosbag2  # noqa: F401

    begin = time.process_time()
    messages = WORK[work](path)
    cpu = time.process_time() - begin
    status = Path('/proc/self/status').read_text()
    peak = next(line for line in status.splitlines() if line.startswith('VmHWM'))
    print(cpu, messages, int(peak.split()[1]) / 1024)


class Reading(NamedTuple):
    """Median CPU time in us for reading a message, and the ratio of `plain` to `read`."""

    floor: float
    ours: float
    plain: float
    ratio: float


def reading(folder: Path, name: str, rounds: int) -> Reading:
    """Measure the readers of one storage in alternating rounds."""
    long, short = bag(folder, name, SHORT), bag(folder, name, PLAIN)
    costs: dict[str, list[float]] = {'floor': [], 'read': [], 'plain': []}
    for _ in range(rounds):
        for work, path in (('floor', long), ('read', long), ('plain', short)):
            cpu, messages, _ = measured(work, path)
            costs[work].append(cpu / messages * 1e6)
    ratio = statistics.median(p / r for p, r in zip(costs['plain'], costs['read']))
    least, ours, theirs = (statistics.median(costs[w]) for w in ('floor', 'read', 'plain'))
    return Reading(least, ours, theirs, ratio)


class Table(NamedTuple):
    """CPU time and memory of `table`.

    ``over`` and ``ratio`` compare the CPU time with the CPU time of `floor`. Times are in s.
    """

    cpu: float
    over: float
    ratio: float
    memory_mb: float


def to_table(path: Path, rounds: int) -> Table:
    """Measure `table` and `floor` for a bag in alternating rounds."""
    runs = [(measured('table', path), measured('floor', path)) for _ in range(rounds)]
    return Table(
        statistics.median(run[0] for run, _ in runs),
        statistics.median(run[0] - least[0] for run, least in runs),
        statistics.median(run[0] / least[0] for run, least in runs),
        max(run[2] for run, _ in runs),
    )


def show_reading(folder: Path, rounds: int) -> None:
    print('\n| reading, us of CPU a message | floor | ours | AnyReader + deserialize | ratio |')
    print('|---|---|---|---|---|')
    for name in STORAGES:
        r = reading(folder, name, rounds)
        cells = f'{r.floor:.2f} | {r.ours:.2f} | {r.plain:.1f} | {r.ratio:.0f}x'
        print(f'| {name} | {cells} |', flush=True)


def show_table(folder: Path, sizes: list[int], rounds: int) -> None:
    """Print CPU time and memory of `table`, and its excess over the CPU time of `floor`."""
    print('\n| bag to Allan table | messages | CPU, s | over the floor, s | peak, MB |')
    print('|---|---|---|---|---|')
    for messages in sizes:
        for name in STORAGES:
            t = to_table(bag(folder, name, messages), rounds)
            cells = f'{t.cpu:.2f} | {t.over:.2f} | {t.memory_mb:.0f}'
            print(f'| {name} | {messages / 1e6:g} M | {cells} |', flush=True)


def spread(path: Path, processes: int) -> None:
    """Read a bag `RECORDINGS` times with a number of processes, like ``allan analyze --jobs``."""
    from allan_ros.readers.recording_sums import ReadJob, read_in_processes, read_in_turn

    jobs = [ReadJob(str(path))] * RECORDINGS
    for _ in read_in_turn(jobs) if processes == 1 else read_in_processes(jobs, processes):
        pass


def show_jobs(folder: Path, messages: int, rounds: int) -> None:
    print(f'\n| {RECORDINGS} recordings of {messages / 1e6:g} M messages | wall, s | CPU, s |')
    print('|---|---|---|')
    costs: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for _ in range(rounds):
        for name in STORAGES:
            path = bag(folder, name, messages)
            for processes in (1, RECORDINGS):
                before, begin = os.times(), time.perf_counter()
                spread(path, processes)
                wall, after = time.perf_counter() - begin, os.times()
                cpu = sum(after[:4]) - sum(before[:4])
                costs.setdefault((name, processes), []).append((wall, cpu))
    for (name, processes), runs in costs.items():
        wall, cpu = (statistics.median(column) for column in zip(*runs))
        print(f'| {name} --jobs {processes} | {wall:.2f} | {cpu:.2f} |', flush=True)


def children_cpu(command: list[str]) -> float:
    """Run a command, and return its CPU time in s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


ALLAN = [sys.executable, '-m', 'allan_ros.cli.main']


def command_cpu(words: list[str], rounds: int) -> float:
    """Return the median CPU time in s of ``allan`` with the given arguments."""
    return statistics.median(children_cpu([*ALLAN, *words]) for _ in range(rounds))


def show_analysis(folder: Path, rounds: int) -> None:
    """Print the CPU time of a complete analysis of one minute of data."""
    print('\n| one analysis of 60 s | CPU, s |')
    print('|---|---|')
    path = str(bag(folder, 'mcap zstd', MINUTE))
    for title, more in (('terminal only', []), ('with all files', ['-o', str(folder / 'out')])):
        print(f'| {title} | {command_cpu(["analyze", path, *more], rounds):.2f} |', flush=True)


def show_start(rounds: int) -> None:
    print('\n| start-up | CPU, s |')
    print('|---|---|')
    for words in (['--help'], ['analyze', '--help'], ['compare', '--help']):
        print(f'| allan {" ".join(words)} | {command_cpu(words, 2 * rounds + 1):.2f} |', flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--full', action='store_true', help='7.2 M messages too')
    parser.add_argument('--rounds', type=int, default=5, help='how often (default 5)')
    parser.add_argument('--keep', type=Path, help='folder of the bags (default: a passing one)')
    parser.add_argument('--work', nargs=2, metavar=('WAY', 'BAG'), help='one way, in this process')
    args = parser.parse_args()
    if args.work:
        work_here(args.work[0], Path(args.work[1]))
        return
    with tempfile.TemporaryDirectory() as passing:
        folder = args.keep or Path(passing)
        show_reading(folder, args.rounds)
        show_table(folder, [SHORT, LONG] if args.full else [SHORT], args.rounds)
        show_jobs(folder, LONG if args.full else SHORT, args.rounds)
        show_analysis(folder, args.rounds)
    show_start(args.rounds)


if __name__ == '__main__':
    main()
