# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A path is locked by one process, and free once the process has ended, however it ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from allan_ros.core.errors import AllanError
from allan_ros.readers.files import PathLock

HOLD = """
import sys
from pathlib import Path
from allan_ros.readers.files import PathLock
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


def test_the_lock_ends_with_its_process(tmp_path: Path) -> None:
    lock = PathLock(tmp_path / 'imu.json')
    command = [sys.executable, '-c', HOLD, str(tmp_path / 'imu.json')]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == b'held\n'
        assert lock.acquire() == f'process {holder.pid}'
        holder.send_signal(signal.SIGKILL)
    assert lock.acquire() == ''


def test_a_lock_file_that_is_removed_while_it_is_opened_is_created_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, opened = tmp_path / 'imu.json', []
    former = PathLock(path)
    former.acquire()
    real_open = os.open

    def open_late(*arguments: object) -> int:
        opened.append(real_open(*arguments))
        former.release()  # after this process opened the file and before it locked it
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


@pytest.mark.skipif(not hasattr(os, 'mkfifo'), reason='no FIFOs on this system')
@pytest.mark.parametrize('make', [os.mkfifo, os.mkdir])
def test_a_lock_file_that_is_not_a_regular_file_is_rejected(
    make: Callable[[Path], None], tmp_path: Path
) -> None:
    make(tmp_path / '.imu.json.lock')
    with pytest.raises(AllanError, match=r'regular file|directory'):
        PathLock(tmp_path / 'imu.json').acquire()


def test_the_offline_part_imports_without_posix() -> None:
    program = """
import os, signal, sys
for name in ('fcntl', 'grp', 'pwd', 'resource', 'termios', 'tty', 'pty'):
    sys.modules[name] = None
for name in ('pthread_sigmask', 'SIG_BLOCK', 'SIG_SETMASK', 'SIGKILL', 'SIGHUP', 'SIGALRM',
             'SIGUSR1', 'SIGPIPE', 'setitimer', 'alarm'):
    if hasattr(signal, name):
        delattr(signal, name)
names = ['O_NOFOLLOW', 'O_CLOEXEC', 'mkfifo', 'pread', 'fork', 'getuid']
if sys.version_info < (3, 13):  # shutil itself needs it from then on
    names.append('O_NONBLOCK')
for name in names:
    if hasattr(os, name):
        delattr(os, name)
import tempfile
import allan_ros as ar
from allan_ros.cli.main import main
with tempfile.TemporaryDirectory() as folder:
    assert main(['simulate', f'{folder}/a.npz', '--preset', 'paper', '--hours', '0.02']) == 0
    assert main(['analyze', f'{folder}/a.npz', '--method', 'paper', '-o', f'{folder}/out']) == 0
    assert ar.load(f'{folder}/out').samples == 7200
"""
    done = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
