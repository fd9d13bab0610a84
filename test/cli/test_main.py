# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The shell around the verbs: exit codes, one line an error, and never a traceback."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

import allan_ros
from allan_ros.cli.main import VERBS, main

ALLAN = [sys.executable, '-m', 'allan_ros.cli.main']


def exit_code(words: Sequence[str]) -> object:
    with pytest.raises(SystemExit) as stop:
        main(words)
    return stop.value.code


@pytest.mark.parametrize('verb', VERBS)
def test_every_verb_tells_its_options(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code([verb, '--help']) == 0
    assert f'usage: allan {verb}' in capsys.readouterr().out


def test_help_names_every_verb(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(['--help']) == 0
    said = capsys.readouterr().out
    assert all(f'{verb} ' in said and what in said for verb, what in VERBS.items())


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(['--version']) == 0
    assert capsys.readouterr().out == f'allan_ros {allan_ros.__version__}\n'


@pytest.mark.parametrize('words', [[], ['analyse'], ['analyze'], ['analyze', 'x', '--skip', 'a']])
def test_a_wrong_command_line_is_exit_2(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(words) == 2
    assert 'usage: allan' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('words', 'said'),
    [
        (['analyze', '/no/such.mcap'], 'no such file'),
        (['analyze', 'x', '--skip', '-1'], 'skip is -1.0: it must lie between'),
        (['merge', '/no/such.json'], 'no such file'),
    ],
)
def test_what_a_user_can_mend_is_one_line_and_exit_1(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f'allan {words[0]}: ')
    assert said in lines[0]


def test_ctrl_c_is_one_line_and_exit_130(tmp_path: Path) -> None:
    endless = tmp_path / 'endless.mcap'
    process = subprocess.Popen(
        [*ALLAN, 'simulate', str(endless), '--preset', 'paper', '--hours', '100'],
        stderr=subprocess.PIPE,
        text=True,
    )
    time.sleep(2.0)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.strip() == 'allan simulate: interrupted, nothing more is written'
    assert not endless.exists()


def test_a_reader_that_leaves_is_not_an_error_to_shout_about(recording: Path) -> None:
    shell = f'"{sys.executable}" -m allan_ros.cli.main analyze "{recording}" --method paper | true'
    done = subprocess.run(['sh', '-c', shell], capture_output=True, text=True)
    assert done.stderr == ''
