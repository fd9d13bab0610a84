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


def test_an_empty_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / 'empty'
    folder.mkdir()
    assert 'no bag in this folder' in refused(folder, capsys)


@pytest.mark.parametrize('damage', ['random', 'header', 'zeros'])
def test_a_damaged_log(damage: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip('pyulog')
    log = tmp_path / 'log.ulg'
    rest = {
        'random': np.random.default_rng(1).bytes(50_000),
        'header': b'',
        'zeros': bytes(5000),
    }
    log.write_bytes(ULOG + rest[damage])
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


def test_a_folder_of_damaged_logs_has_a_line_for_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip('pyulog')
    for name in ('a.ulg', 'b.ulg'):
        (tmp_path / name).write_bytes(ULOG)
    assert main(['analyze', str(tmp_path), '-o', str(tmp_path / 'new' / 'out')]) == 1
    assert (tmp_path / 'new' / 'out' / 'summary.csv').is_file()
    _, *rows = capsys.readouterr().out.splitlines()
    assert [row.split()[:2] for row in rows] == [['a.ulg', 'error'], ['b.ulg', 'error']]


def test_a_rate_out_of_range_is_named_as_it_was_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['check', str(tmp_path / 'x.csv'), '--rate', '-1']) == 1
    assert 'rate is -1.0: it must lie between 0 and 1e+06 Hz' in capsys.readouterr().err
