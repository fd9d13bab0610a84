# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What goes to stdout, what to stderr, and how much: --json, --quiet, --verbose, colors."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import pytest

from allan_ros.cli.console import Progress, colored
from allan_ros.cli.main import main
from allan_ros.export import TARGETS

FIT = ['--method', 'paper']


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_json_output_is_only_the_results_document(
    recording: Path, analyzed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['analyze', str(recording), '--json']) == 0
    shown = capsys.readouterr()
    file = json.loads((analyzed / 'results.json').read_text())
    assert len(file.pop('fingerprint')) == 16
    assert set(file.pop('files')) == {path.name for path in analyzed.iterdir()}
    assert {**json.loads(shown.out), 'findings': file['findings']} == file
    assert main(['analyze', str(analyzed / 'sums.json'), '--json']) == 0
    merged = json.loads(capsys.readouterr().out)
    assert merged['axes'] == json.loads(shown.out)['axes']


def test_json_of_export(analyzed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['export', '--list', '--json']) == 0
    assert json.loads(capsys.readouterr().out) == {
        'targets': {name: target.title for name, target in TARGETS.items()}
    }
    words = ['export', str(analyzed / 'results.json'), '--to', 'orb_slam3', '--json']
    words += ['--fidelity', 'coefficients']  # upper limits of K: there is a finding
    assert main(words) == 0
    shown = capsys.readouterr()
    made = json.loads(shown.out)
    assert made['target'] == 'orb_slam3' and made['text'].startswith('%YAML:1.0')
    assert len(made['findings']) == shown.err.count('allan export: ') > 0
    assert main([*words, '-q', '-o', str(tmp_path)]) == 0
    shown = capsys.readouterr()
    assert Path(json.loads(shown.out)['path']).read_text() == made['text']
    assert shown.err == ''


def test_json_of_simulate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / 'imu.npz'
    how = ['--preset', 'paper', '--hours', '0.01', '--rate', '50', '--json']
    assert main(['simulate', str(path), *how]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told['path'] == str(path) and told['samples'] == 1800
    assert Path(told['truth']).exists()


def test_quiet_prints_nothing_if_the_result_is_written_to_files(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['analyze', str(recording), *FIT, '--quiet', '-o', str(tmp_path)]) == 0
    assert capsys.readouterr() == ('', '')
    assert main(['analyze', str(recording), *FIT, '--quiet']) == 0
    shown = capsys.readouterr()
    assert 'deg/sqrt(h)' in shown.out and shown.err == ''
    assert main(['analyze', '/no/such.npz', '--quiet']) == 1
    assert 'no such file' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('environment', 'terminal', 'colors'),
    [
        ({}, True, True),
        ({}, False, False),
        ({'NO_COLOR': '1'}, True, False),
        ({'NO_COLOR': ''}, True, True),  # no-color.org: "when present and not an empty string"
        ({'FORCE_COLOR': '1'}, False, True),
        ({'FORCE_COLOR': '1', 'NO_COLOR': '1'}, True, False),
        ({'TERM': 'dumb'}, True, False),
    ],
)
def test_colors_follow_the_terminal_and_the_environment(
    environment: dict[str, str], terminal: bool, colors: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ('NO_COLOR', 'FORCE_COLOR', 'TERM'):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert colored(Terminal() if terminal else io.StringIO()) == colors


@pytest.mark.parametrize('total', [10, None])
def test_progress_leaves_a_terminal_clean(
    monkeypatch: pytest.MonkeyPatch, total: int | None
) -> None:
    shown = []
    for stream, quiet in ((Terminal(), False), (Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, 'stderr', stream)
        monkeypatch.setenv('TERM', 'xterm')
        with Progress('/a/very/long/path/' * 8 + '[bold]monday.mcap', total, not quiet) as bar:
            bar.advance(5)
        shown.append(stream.getvalue())
    assert '[bold]monday.mcap' in shown[0] and shown[0].endswith('\x1b[2K')
    assert ('50 %' in shown[0]) == (total is not None)
    assert shown[1:] == ['', '']
