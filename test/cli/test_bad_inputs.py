# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An input that cannot be used: one line, exit code 1, and nothing is written."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from allan_ros.cli.main import main

ULOG = b'ULog\x01\x12\x35\x01' + bytes(8)


def refused(path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the only line that `analyze` and `check` print about an input."""
    out = path.parent / 'out'
    assert main(['analyze', str(path), '-o', str(out)]) == 1
    analyzed = capsys.readouterr()
    assert not analyzed.out and not out.exists()
    assert main(['check', str(path)]) == 1
    checked = capsys.readouterr()
    assert not checked.out and analyzed.err.count('\n') == checked.err.count('\n') == 1
    assert str(path) in analyzed.err
    return analyzed.err


def test_an_empty_folder_and_a_damaged_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / 'empty'
    folder.mkdir()
    assert 'no bag in this folder' in (said := refused(folder, capsys))
    assert said.endswith('or other recordings (.csv, .npz, .ulg ...)\n')
    pytest.importorskip('pyulog')
    log = tmp_path / 'log.ulg'
    log.write_bytes(ULOG + np.random.default_rng(1).bytes(50_000))
    assert 'log.ulg: ' in refused(log, capsys)


def test_a_truncated_log_is_read_as_far_as_it_goes(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip('pyulog')
    log = tmp_path / 'log.ulg'
    log.write_bytes((shared_data / 'ulog' / 'sample_log_small.ulg').read_bytes()[:300_000])
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        assert main(['analyze', str(log), '-o', str(tmp_path / 'out'), '-q']) in (0, 1)
    assert capsys.readouterr().err == ''
    assert {'report.html', 'results.json'} <= {p.name for p in (tmp_path / 'out').iterdir()}


def test_a_damaged_summary_of_a_folder_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'summary.csv').write_text(f'unit,exit_code\n{"x" * 200_000},1\n')
    assert main(['check', str(tmp_path)]) == 1
    assert 'summary.csv: cannot be read (field larger' in capsys.readouterr().err


def test_a_folder_of_damaged_logs_has_a_line_for_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip('pyulog')
    for name in ('a.ulg', 'b.ulg'):
        (tmp_path / name).write_bytes(ULOG)
    assert main(['analyze', str(tmp_path), '-o', str(tmp_path / 'new' / 'out')]) == 1
    assert (tmp_path / 'new' / 'out' / 'summary.csv').is_file()
    lines = capsys.readouterr().out.splitlines()
    assert [Path(line.split(': ')[1]).name for line in lines] == ['a.ulg', 'b.ulg']
    assert all(line.startswith('error: ') for line in lines)


@pytest.mark.parametrize(
    ('words', 'said'),
    [
        ('export {truth} --to kalibr', "schema is 'allan_ros/truth/"),
        ('analyze {folder}/results.json', "schema is 'allan_ros/results/"),
        ('check {truth}', "schema is 'allan_ros/truth/"),
        ('simulate x.npz --spec {folder}/results.json', "schema is 'allan_ros/results/"),
        ('check {folder}/imu.yaml', 'not a known type of recording'),
        ('check x.csv --rate -1', 'rate is -1.0: it must lie between 1e-06 and 1e+06 Hz'),
    ],
)
def test_a_wrong_kind_of_file_is_named(
    words: str, said: str, recording: Path, analyzed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {'npz': recording, 'truth': f'{recording}.truth.json', 'folder': analyzed}
    code = main(words.format(**files).split())
    assert code == 1 and said in capsys.readouterr().err


def test_a_name_that_is_not_utf8_is_kept_readable(recording: Path, tmp_path: Path) -> None:
    path = tmp_path / 'imu_\udcff\x1b[31m.npz'
    path.write_bytes(recording.read_bytes())
    out = tmp_path / 'out \udcfe'
    words = ['--method', 'paper', '-q']
    assert main(['analyze', str(path), '-o', str(out), *words]) == 0
    text = (out / 'results.json').read_text(encoding='utf-8')
    assert r'imu_\\udcff' in text or r'imu_\\xff' in text
    assert main(['analyze', str(path), '-o', str(out), *words]) == 0
    assert main(['check', str(out), str(path), '--json']) == 4
    assert main(['analyze', str(out), *words]) == 0
    for batch in ([], ['-o', str(tmp_path / 'batch')]):
        assert main(['analyze', str(tmp_path), *batch, *words]) == 0


def test_results_of_another_recording_are_kept(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / 'other.npz'
    other.write_bytes(recording.read_bytes())
    out = str(tmp_path / 'out')
    quick = ['--method', 'paper', '-q', '-o', out]
    assert main(['analyze', str(recording), *quick]) == 0
    assert main(['analyze', str(other), *quick]) == 1
    assert 'has the results of another recording, imu.npz imu: give' in capsys.readouterr().err
    assert main(['analyze', str(other), *quick, '--overwrite']) == 0
    assert main(['analyze', str(other), *quick]) == 0
