# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exit codes, one line for each error, and never a traceback."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.node_server import PATIENCE_S

import allan_ros
from allan_ros.cli import analyze
from allan_ros.cli.main import EXITS, VERBS, command_of, main

ALLAN = [sys.executable, '-m', 'allan_ros.cli.main']

LONG = 2_000_000
"""Samples of a recording that takes seconds to read."""


def exit_code(words: Sequence[str]) -> object:
    with pytest.raises(SystemExit) as stop:
        main(words)
    return stop.value.code


@pytest.mark.parametrize('verb', VERBS)
def test_the_help_of_every_verb_has_options_an_example_and_exit_codes(
    verb: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv('COLUMNS', '60')
    assert exit_code([verb, '--help']) == 0
    # examples and exit codes are not wrapped, so that users can copy and find them
    lines = capsys.readouterr().out.splitlines()
    assert max(len(line) for line in lines if line[:2] != '  ' or line[2] == ' ') <= 60
    monkeypatch.setenv('COLUMNS', '200')
    assert exit_code([verb, '--help']) == 0
    said = capsys.readouterr().out
    assert said.startswith(f'usage: allan {verb} [options]')
    assert f'\n  allan {verb} ' in said
    assert all(f' --{option}' in said for option in ('json', 'quiet', 'verbose'))
    exits = {**EXITS, **command_of(verb).exits}
    assert all(f'\n  {code:<4} {what}' in said for code, what in exits.items())


def test_the_version_and_every_verb_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(['--version']) == 0
    assert capsys.readouterr().out == f'allan_ros {allan_ros.__version__}\n'
    assert exit_code(['--help']) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert all(f'{verb} {known.help}' in said for verb, known in VERBS.items())
    assert all(what in said for what in EXITS.values())


def test_the_bare_command_lists_the_verbs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    said = capsys.readouterr()
    assert not said.out
    verbs = (f'\n    {verb} ' for verb in VERBS)
    order = [said.err.index(word) for word in ('allan analyze my_bag', *verbs, '\n  --version')]
    assert order == sorted(order)


@pytest.mark.parametrize(
    ('words', 'said'),
    [
        ('analyze', 'are required: INPUT'),
        ('analyze x --skip a', 'write a time'),
        ('analyze x --zzz', '; see `allan analyze --help`'),
        ('analyze x -q -v', 'not allowed with'),
        ('analyse', "invalid choice: 'analyse'"),
        ('analyze x --skp 3', 'unrecognized arguments: --skp'),
        ('check x --method likelyhood', "invalid choice: 'likelyhood'"),
        ('simulate x --gyro N', 'write '),
        ('simulate x --gyro N=x', 'write '),
    ],
)
def test_a_wrong_command_line_is_exit_2(
    words: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(words.split()) == 2
    usage, wrong = capsys.readouterr().err.splitlines()
    assert usage.startswith('usage: allan ') and wrong.startswith('allan') and said in wrong


def fails(error: BaseException) -> Any:
    def run(_args: object) -> int:
        raise error

    return run


@pytest.mark.parametrize(
    ('error', 'code', 'said'),
    [
        (OSError(28, 'No space left on device', 'x.json'), 1, "No space left on device: 'x.json'"),
        (MemoryError(), 1, 'not enough memory'),
        (ZeroDivisionError('by zero'), 70, 'ZeroDivisionError: by zero at cli/main.py:'),
        (KeyboardInterrupt(), 130, 'interrupted'),
    ],
)
def test_errors_give_one_line_and_no_traceback(
    error: BaseException,
    code: int,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(analyze, 'CHECK', replace(analyze.CHECK, run=fails(error)))
    assert main(['check', 'x', '--verbose']) == code
    line = capsys.readouterr().err.strip()
    assert line.startswith('allan check: ') and said in line and '\n' not in line


@pytest.mark.parametrize(
    ('words', 'code', 'said'),
    [
        ('sensors >&-', 0, ''),
        ('sensors 2>&-', 0, ''),
        ('--help | true', 0, ''),
        ('sensors | true', 0, ''),
        ('analyze größe_\udcff.mcap', 1, 'no such file'),  # that no terminal can write
    ],
)
def test_no_stream_causes_a_traceback(words: str, code: int, said: str) -> None:
    environment = {**os.environ, 'PYTHONIOENCODING': 'ascii', 'LC_ALL': 'C'}
    call = f'"{sys.executable}" -m allan_ros.cli.main {words}'
    done = subprocess.run(call, shell=True, env=environment, capture_output=True, text=True)
    assert done.returncode == code
    assert said in done.stderr and done.stderr.count('\n') == (said != ''), done.stderr


def interrupted(process: subprocess.Popen[str], verb: str) -> None:
    """Send SIGINT to all its processes, and check its only line and its exit code."""
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, said
    assert said.strip() == f'allan {verb}: interrupted, nothing more is written'


@pytest.mark.parametrize(
    'words',
    [
        ['analyze', ''],
        ['check', '', '--sensor', 'bmi088'],
        ['check', 'imu.npz', '--baseline', ''],
        ['check', 'imu.npz', '--plan='],
        ['analyze', 'imu.npz', '-o', ''],
        ['export', 'run', '--to', 'openvins', '-o', ''],
    ],
)
def test_an_empty_argument_is_neither_the_working_directory_nor_the_default(
    words: Sequence[str],
    recording: Path,
    analyzed: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / 'imu.npz').symlink_to(recording)
    (tmp_path / 'run').symlink_to(analyzed)
    monkeypatch.chdir(tmp_path)
    files = sorted(tmp_path.iterdir())
    assert main(words) == 1
    printed = capsys.readouterr()
    assert not printed.out and printed.err.count('\n') == 1 and ' is empty: give ' in printed.err
    assert sorted(tmp_path.iterdir()) == files


def test_ctrl_c_is_one_line_and_exit_130(tmp_path: Path) -> None:
    endless = tmp_path / 'endless.mcap'
    process = subprocess.Popen(
        [*ALLAN, 'simulate', str(endless), '--preset', 'paper', '--hours', '20'],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    # Not before the bag is open: during an import the signal may end Python directly,
    # or drop the interrupt.
    while not any(path.is_file() for path in tmp_path.rglob('*.mcap')):
        assert process.poll() is None
        time.sleep(0.1)
    interrupted(process, 'simulate')
    assert not endless.exists()


def test_ctrl_c_ends_all_processes_of_an_analysis_in_one_line(tmp_path: Path) -> None:
    # Two recordings, long enough that no worker has read its own before the signal arrives.
    paths = [str(tmp_path / f'{number}.npz') for number in range(2)]
    for seed, path in enumerate(paths):
        imu = np.tile(np.random.default_rng(seed).normal(size=(1000, 7)), (LONG // 1000, 1))
        imu[:, 0] = seed * LONG + np.arange(LONG) / 100.0
        np.savez(path, imu=imu)
    process = subprocess.Popen(
        [*ALLAN, 'analyze', *paths, '--jobs', '2', '-o', str(tmp_path / 'out')],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    children = Path(f'/proc/{process.pid}/task/{process.pid}/children')
    while len(children.read_text().split()) < 3:  # a resource tracker and two workers
        assert process.poll() is None
        time.sleep(0.02)
    interrupted(process, 'analyze')
    assert not (tmp_path / 'out').exists()


def test_a_missing_matplotlib_is_noticed_before_anything_is_read(
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, 'matplotlib', None)
    monkeypatch.delitem(sys.modules, 'allan_ros.view.plots', raising=False)
    missing = tmp_path / 'missing.csv'  # reading it first would end in another error
    assert main(['analyze', str(missing), '-o', str(tmp_path), '--plots', 'svg']) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert ': figures need matplotlib, which cannot be imported ' in line
    assert main(['analyze', str(recording), '--method', 'paper', '-q']) == 0


def test_a_package_that_is_missing_is_one_line_and_exit_1(
    recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def read(*_: object) -> None:
        raise ModuleNotFoundError('no module', name='lz4')

    monkeypatch.setattr('allan_ros.cli.analyze.read_in_turn', read)
    assert main(['analyze', str(recording), '-q']) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith('allan analyze: needs the Python package lz4')
