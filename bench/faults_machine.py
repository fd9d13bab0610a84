# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the machine: its disk, its clock, its CPU, and the middleware's shared memory."""

from __future__ import annotations

import math
import os
import re
import signal
import struct
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from fault_harness import Row, Trial, fault
from online_nodes import Client, Process

SHIFTED_CLOCK = Path(__file__).with_name('shifted_clock.c')
"""Library preloaded into a node to set its wall clock."""

BUSY = 'while True: pass'
BUSY_PROCESSES = 4


# --- the disk -------------------------------------------------------------------------------------


@contextmanager
def _tmpfs(folder: Path, size: str) -> Iterator[Path]:
    """Mount a tmpfs of this size within the block; needs root."""
    place = folder / 'disk'
    place.mkdir()
    subprocess.run(['mount', '-t', 'tmpfs', '-o', f'size={size}', 'tmpfs', place], check=True)
    try:
        yield place
    finally:
        subprocess.run(['umount', '-l', place], check=True)


def _fill(place: Path) -> None:
    """Fill the disk."""
    with (place / 'filler').open('wb', buffering=0) as file:
        try:
            while True:
                file.write(b'\0' * 4096)
        except OSError:
            return


@fault('root')
def disk_full(client: Client, folder: Path) -> Row:
    """A tmpfs of 2 MB is filled, and emptied again."""
    with _tmpfs(folder, '2m') as place:
        trial = Trial(client, place, ('checkpoint.period:=2.0',))
        with trial.fault():
            _fill(place)
            trial.spin(10.0)
            (place / 'filler').unlink()
        return _saved_again(trial, 'disk full for 10 s (tmpfs)')


@fault('root')
def disk_read_only(client: Client, folder: Path) -> Row:
    """The file system is mounted read-only for a while."""
    with _tmpfs(folder, '2m') as place:
        trial = Trial(client, place, ('checkpoint.period:=2.0',))
        with trial.fault():
            subprocess.run(['mount', '-o', 'remount,ro', place], check=True)
            trial.spin(10.0)
            subprocess.run(['mount', '-o', 'remount,rw', place], check=True)
        return _saved_again(trial, 'disk read-only for 10 s (tmpfs)')


def _saved_again(trial: Trial, name: str) -> Row:
    """Return the row of the trial, including the time until the next checkpoint was written."""
    before = trial.checkpoint.stat().st_mtime_ns
    again = trial.log.until(lambda: trial.checkpoint.stat().st_mtime_ns > before)
    row = trial.row(name, 'checkpoint.period 2 s')
    saved = 'never' if math.isnan(again) else f'saved after {again - trial.ended:.1f} s'
    return replace(row, recovered=saved)


# --- the clock ------------------------------------------------------------------------------------


@fault()
def wall_clock_forward(client: Client, folder: Path) -> Row:
    """The wall clock of the node steps forward; stamps do not."""
    return _wall_clock(client, folder, 'forward', 3600)


@fault()
def wall_clock_back(client: Client, folder: Path) -> Row:
    """The wall clock of the node steps back; stamps do not."""
    return _wall_clock(client, folder, 'back', -3600)


def _wall_clock(client: Client, folder: Path, where: str, shift_s: int) -> Row:
    library, clock = folder / 'shifted_clock.so', folder / 'clock'
    subprocess.run(['cc', '-O', '-shared', '-fPIC', '-o', library, SHIFTED_CLOCK], check=True)
    clock.write_bytes(struct.pack('=q', 0))
    trial = Trial(client, folder, env={'LD_PRELOAD': str(library), 'SHIFTED_CLOCK': str(clock)})
    with trial.fault(), clock.open('r+b') as file:
        file.write(struct.pack('=q', shift_s))
    return trial.row(f'clock of the node set {where} by 1 h')


@fault()
def sim_time_jumps(client: Client, folder: Path) -> Row:
    """/clock jumps ahead and back; the stamps continue."""
    from rclpy.time import Time
    from rosgraph_msgs.msg import Clock

    publisher = client.node.create_publisher(Clock, '/clock', 10)
    leap_s, told, stop = [0.0], [1000.0], threading.Event()

    def tell() -> None:
        while not stop.wait(0.025):
            told[0] += 0.025
            publisher.publish(Clock(clock=Time(seconds=told[0] + leap_s[0]).to_msg()))

    thread = threading.Thread(target=tell, daemon=True)
    thread.start()
    trial = Trial(client, folder, ('use_sim_time:=true',))
    with trial.fault():
        for leap in (3600.0, 0.0):
            leap_s[0] = leap
            trial.spin(3.0)
    row = trial.row('use_sim_time: /clock 1 h ahead for 3 s, and back')
    stop.set()
    thread.join()
    return row


# --- the CPU --------------------------------------------------------------------------------------


@fault()
def starved(client: Client, folder: Path) -> Row:
    """Run the monitor at the lowest priority while other processes are busy."""
    trial = Trial(client, folder, prefix=('nice', '-n', '19'))
    with trial.fault():
        busy = [Process('-c', BUSY, prefix=('nice', '-n', '1')) for _ in range(BUSY_PROCESSES)]
        trial.spin(20.0)
        for process in busy:
            process.end(signal.SIGKILL)
    return trial.row(f'monitor at nice 19 next to {BUSY_PROCESSES} busy loops for 20 s')


@fault()
def frozen(client: Client, folder: Path) -> Row:
    """The monitor is stopped for a while (SIGSTOP)."""
    trial = Trial(client, folder)
    with trial.fault():
        trial.watched.popen.send_signal(signal.SIGSTOP)
        trial.spin(5.0)
        trial.watched.popen.send_signal(signal.SIGCONT)
    return trial.row('monitor stopped for 5 s (SIGSTOP, SIGCONT)', same=False)


# --- the middleware -------------------------------------------------------------------------------


@fault()
def publisher_anew(client: Client, folder: Path) -> Row:
    """The DDS participant of the driver disappears and reappears."""
    trial = Trial(client, folder)
    with trial.fault():
        trial.stream.silent = True
        trial.spin(0.2)
        trial.stream.close()
        trial.spin(5.0)
        trial.stream.open()
        trial.stream.silent = False
    return trial.row('the participant of the driver destroyed, created again after 5 s', same=False)


@fault()
def shared_memory_removed(client: Client, folder: Path) -> Row:
    """/dev/shm is emptied: the files that the monitor and the driver use are deleted."""
    trial = Trial(client, folder)
    with trial.fault():
        files = _shared_memory(trial.watched.popen.pid) | _shared_memory(os.getpid())
        for path in files:
            path.unlink(missing_ok=True)
        trial.spin(5.0)
    return trial.row('shared memory files of the middleware deleted', f'{len(files)} files', False)


def _shared_memory(pid: int) -> set[Path]:
    """Return the files of Fast DDS that a process has mapped."""
    maps = Path(f'/proc/{pid}/maps').read_text()
    return {Path(x) for x in re.findall(r'/dev/shm/\S*fastrtps\S*', maps)}
