# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan analyze`, from recordings and earlier sums to files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allan_ros.cli.main import main

FILES = {
    'imu.yaml',
    'report.html',
    'results.json',
    'sums.json',
}


def read(path: Path) -> Any:
    return json.loads(path.read_text())


def parts_of(recording: Path, folder: Path, samples: int = 9000) -> list[str]:
    """Write the first and the last samples of a recording as recordings of their own."""
    with np.load(recording) as arrays:
        whole = dict(arrays)
    paths = []
    for name, part in (('a', slice(None, samples)), ('b', slice(-samples, None))):
        paths.append(str(folder / f'{name}.npz'))
        np.savez(paths[-1], **{k: v[part] if v.ndim else v for k, v in whole.items()})
    return paths


def test_plots_have_the_requested_formats_and_show_the_earlier_run(
    recording: Path, analyzed: Path, tmp_path: Path
) -> None:
    former = str(analyzed / 'results.json')
    how = ['--plots', 'svg,pdf', '--baseline', former]
    assert main(['analyze', str(recording), '-o', str(tmp_path), *how]) == 0
    page = (tmp_path / 'report.html').read_text()
    names = {path.name for path in tmp_path.iterdir()}
    assert {'allan_gyro.svg', 'allan_gyro.pdf'} <= names
    assert 'allan_gyro.png' not in names
    assert main(['analyze', str(recording), '-o', str(tmp_path), '--method', 'paper']) == 0
    assert {path.name for path in tmp_path.iterdir()} == FILES
    assert f'Compared with {analyzed.name}' in page
    assert 'are within' in page  # the baseline is the same run
    assert 'allan analyze' in page and '--plots svg,pdf' in page
    assert '"density":{"x"' in page


def test_invalid_plot_options_are_rejected_before_reading(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for how in (['--plots', 'gif'], ['--baseline', 'none.json']):
        assert main(['analyze', 'no_such_bag', '-o', str(tmp_path), *how]) == 1
        assert how[1] in capsys.readouterr().err


def test_the_table_agrees_with_the_files(
    recording: Path,
    analyzed: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(['analyze', str(recording), '--units', 'SI']) == 0
    said = capsys.readouterr().out
    value = read(analyzed / 'results.json')['axes']['gyro_y']['noise']['N']['value']
    assert f'{value:.3e}' in said
    assert 'rad/s/sqrt(Hz)' in said
    assert list(tmp_path.iterdir()) == []  # no file is written by default


def test_sums_and_recordings_are_added(recording: Path, tmp_path: Path) -> None:
    parts = parts_of(recording, tmp_path)
    folders = [tmp_path / name for name in ('one', 'two', 'merged', 'together')]
    how = ['--method', 'paper', '-o']
    for part, folder in zip(parts, folders):
        assert main(['analyze', part, *how, str(folder)]) == 0
    sums = [str(folders[0]), str(folders[1] / 'sums.json')]
    assert main(['analyze', *sums, *how, str(folders[2])]) == 0
    assert main(['analyze', *parts, *how, str(folders[3])]) == 0
    mixed = tmp_path / 'mixed'
    assert main(['analyze', parts[0], sums[1], *how, str(mixed)]) == 0
    assert read(mixed / 'sums.json')['sums'] == read(folders[3] / 'sums.json')['sums']
    merged, together = (read(folder / 'results.json') for folder in folders[2:])
    assert merged['segment_count'] == 2
    assert len(merged['source']) == 2
    assert merged['axes'] == together['axes']
    assert read(folders[2] / 'sums.json')['sums'] == read(folders[3] / 'sums.json')['sums']


def test_the_time_of_all_inputs_decides_whether_data_are_short(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths, short = parts_of(recording, tmp_path, 1800), []
    for given in (paths[:1], paths):
        assert main(['analyze', *given, '--json', '--method', 'paper']) == 0
        found = json.loads(capsys.readouterr().out)['findings']
        short.append([each['message'] for each in found if each['id'] == 'short'])
    assert len(short[0]) == 1 and '36' in short[0][0]
    assert short[1] == []


ABSURD_SUMS: dict[str, tuple[list[Any], Any]] = {
    'no time': (['elapsed_ns'], 0),
    'negative sums': (['sum_sq', 0, 0], -1.0),
    'sums of infinite noise': (['sum_sq', 3, 0], 1e300),
    'counts that disagree': (['count', 0], 2**62),
    'another IMU': (['hardware_id'], 'B'),
}


@pytest.mark.parametrize('what', ABSURD_SUMS)
def test_absurd_sums_are_rejected_in_one_line(
    what: str, analyzed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = read(analyzed / 'sums.json')
    place, value = ABSURD_SUMS[what]
    home = document['sums'][0]
    for key in place[:-1]:
        home = home[key]
    home[place[-1]] = value
    path = tmp_path / 'absurd.json'
    path.write_text(json.dumps(document))
    others = [str(analyzed / 'sums.json')] if what == 'another IMU' else []
    assert main(['analyze', *others, str(path)]) == 1
    error = capsys.readouterr().err
    assert error.count('\n') == 1 and str(path) in error and 'Traceback' not in error
    assert error.count('cannot be added') == len(others)


def test_skipping_all_data_is_reported(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['analyze', str(recording), '--skip', '9999']) == 1
    assert capsys.readouterr().err.endswith(
        '--skip 9999 (s) excludes the complete recording: reduce it\n'
    )


def test_constant_values_are_exit_1_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stuck = np.column_stack([np.arange(3000) * 0.01, np.full((3000, 6), 0.5)])
    np.savez(tmp_path / 'stuck.npz', imu=stuck)
    assert main(['analyze', str(tmp_path / 'stuck.npz'), '-o', str(tmp_path / 'out')]) == 1
    said = ' '.join(capsys.readouterr().out.split())
    assert said.count('The samples have no noise') == 2  # the verdict, and one finding for all axes
    assert read(tmp_path / 'out' / 'results.json')['axes']['gyro_x']['noise']['N']['value'] is None


def test_a_gyro_alone_is_analyzed_without_an_imu_yaml(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    samples = np.full((6000, 7), np.nan)
    samples[:, 0] = np.arange(6000) * 0.01
    samples[:, 1:4] = np.random.default_rng(0).normal(size=(6000, 3)) * 1e-3
    np.savez(tmp_path / 'gyro.npz', imu=samples)
    assert main(['analyze', str(tmp_path / 'gyro.npz'), '-o', str(tmp_path / 'out')]) == 0
    assert 'imu.yaml is not written (no accel' in ' '.join(capsys.readouterr().out.split())
    names = {path.name for path in (tmp_path / 'out').iterdir()}
    assert names == FILES - {'imu.yaml'}
    words = ['analyze', str(tmp_path / 'gyro.npz'), '-o', str(tmp_path / 'out'), '--overwrite']
    assert main([*words, '--export', 'openvins']) == 1
    said = capsys.readouterr().err.splitlines()
    (line,) = (each for each in said if each.startswith('allan analyze: '))
    assert ' is not written (no accel' in line and 'correct the cause' in line


def test_real_recordings_are_analyzed(shared_data: Path, tmp_path: Path) -> None:
    assert main(['analyze', str(shared_data / 'mpu6050.npz'), '-o', str(tmp_path)]) == 0
    results = read(tmp_path / 'results.json')
    assert results['rate_hz'] == pytest.approx(99.3, abs=0.05)
    assert results['segment_count'] == 1
    assert results['counts']['received'] == 65_067
