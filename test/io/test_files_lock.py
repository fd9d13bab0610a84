# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A path belongs to one process, and to nobody once that has ended, however it ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from allan_ros.core.errors import AllanError
from allan_ros.io.files import PathLock

HOLD = """
import sys
from pathlib import Path
from allan_ros.io.files import PathLock
lock = PathLock(Path(sys.argv[1]))
assert lock.acquire() == ''
print('held', flush=True)
sys.stdin.read()
"""


def test_the_second_learns_who_has_it(tmp_path: Path) -> None:
    path = tmp_path / 'imu.json'
    first, second, other = PathLock(path), PathLock(path), PathLock(tmp_path / 'right.json')
    assert first.acquire() == first.acquire() == ''
    assert other.acquire() == ''
    assert second.acquire() == f'process {os.getpid()}'
    first.release()
    assert second.acquire() == ''
    assert first.acquire() == f'process {os.getpid()}'
    second.release()
    other.release()
    assert list(tmp_path.iterdir()) == []


def test_it_ends_with_its_process(tmp_path: Path) -> None:
    lock = PathLock(tmp_path / 'imu.json')
    command = [sys.executable, '-c', HOLD, str(tmp_path / 'imu.json')]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == b'held\n'
        assert lock.acquire() == f'process {holder.pid}'
        holder.send_signal(signal.SIGKILL)
    assert lock.acquire() == ''


def test_a_mark_that_goes_while_it_is_opened_is_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, opened = tmp_path / 'imu.json', []
    former = PathLock(path)
    former.acquire()
    real_open = os.open

    def open_late(*arguments: object) -> int:
        opened.append(real_open(*arguments))
        former.release()  # between our opening and our locking
        return opened[-1]

    monkeypatch.setattr(os, 'open', open_late)
    lock = PathLock(path)
    assert lock.acquire() == ''
    assert len(opened) == 2 and (tmp_path / '.imu.json.lock').exists()
    monkeypatch.undo()
    assert PathLock(path).acquire() == f'process {os.getpid()}'


def test_a_link_in_its_place_is_not_followed(tmp_path: Path) -> None:
    victim = tmp_path / 'victim'
    victim.write_text('precious')
    (tmp_path / '.imu.json.lock').symlink_to(victim)
    with pytest.raises(AllanError, match='cannot be written'):
        PathLock(tmp_path / 'imu.json').acquire()
    assert victim.read_text() == 'precious'


def test_a_missing_folder_is_said(tmp_path: Path) -> None:
    with pytest.raises(AllanError, match='No such file or directory'):
        PathLock(tmp_path / 'missing' / 'imu.json').acquire()
