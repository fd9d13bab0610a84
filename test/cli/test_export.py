# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan export` and `--export` from results to files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import allan_ros as ar
from allan_ros.cli.main import main
from allan_ros.export import TARGETS, target_of


def test_analyze_writes_the_requested_files_and_the_one_of_kalibr(analyzed: Path) -> None:
    names = {path.name for path in analyzed.iterdir()}
    assert {'imu.yaml', 'vins_fusion_imu.yaml', 'basalt_imu.json', 'gtsam_imu.py'} <= names
    assert not [name for name in names if name.startswith('orb_slam3')]


def test_analyze_and_export_write_the_same(
    analyzed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['export', str(analyzed / 'results.json'), '--to', 'vins_fusion']) == 0
    assert capsys.readouterr().out == (analyzed / 'vins_fusion_imu.yaml').read_text()


@pytest.mark.parametrize('target', [name for name in TARGETS if name != 'temperature'])
def test_every_target_is_written(analyzed: Path, tmp_path: Path, target: str) -> None:
    results = str(analyzed / 'results.json')
    assert main(['export', results, '--to', target, '-o', str(tmp_path)]) == 0
    named = tmp_path / 'named'
    assert main(['export', results, '--to', target, '-o', str(named)]) == 0
    assert (tmp_path / target_of(target).file_name).read_bytes() == named.read_bytes()


@pytest.mark.parametrize('target', [name for name in TARGETS if name != 'temperature'])
def test_only_an_exported_or_empty_file_is_replaced(
    analyzed: Path, tmp_path: Path, target: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ['export', str(analyzed / 'results.json'), '--to', target, '-o']
    for path in (tmp_path / 'mine', tmp_path / target_of(target).file_name):
        path.write_text('# my calibration, compared with allan_ros\nnoise: 1\n')
        place = str(tmp_path if path.name != 'mine' else path)
        assert main([*words, place]) == 1
        error = capsys.readouterr().err
        assert f'{path}: was not written by allan_ros' in error and error.count('\n') == 1
        assert path.read_text().startswith('# my calibration')
        for exported in (ar.load(analyzed), ar.sensor('bmi088')):
            with pytest.raises(ar.AllanError, match='was not written by allan_ros'):
                exported.export(target, place)
        assert main([*words, place, '--overwrite']) == 0
        assert main([*words, place]) == 0
        path.write_text('')
        assert main([*words, place]) == 0 and path.stat().st_size > 0
        capsys.readouterr()


def test_an_analysis_replaces_no_configuration_file_of_the_user(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / 'imu.yaml'
    mine.write_text('accelerometer_noise_density: 1.0\n')
    words = ['analyze', str(recording), '-q', '-o', str(tmp_path)]
    assert main(words) == 1
    assert f'{mine}: was not written by allan_ros' in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [mine]
    assert main([*words, '--overwrite']) == main(words) == 0


def test_a_folder_of_two_analyses_is_not_exported(
    analyzed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'results.json').write_bytes((analyzed / 'results.json').read_bytes())
    document = json.loads((analyzed / 'sums.json').read_text())
    (tmp_path / 'sums.json').write_text(json.dumps({**document, 'sums': document['sums'] * 2}))
    assert main(['export', str(tmp_path), '--to', 'kalibr']) == 1
    assert 'of different analyses' in capsys.readouterr().err


def test_list_explains_each_target_in_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['export', '--list']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(TARGETS)
    assert all(target.title in line for line, target in zip(lines, TARGETS.values()))


def test_the_own_file_is_compared_and_not_changed(
    analyzed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = analyzed / 'imu.yaml'
    before = mine.read_bytes()
    words = ['export', str(analyzed), '--to', 'kalibr', '--against', str(mine)]
    assert main(words) == 0
    *drifts, gyro, accel = capsys.readouterr().out.splitlines()
    assert len(drifts) == 18 and 'gyro_x after 1 s: your file ' in drifts[0]
    assert 'covers' in gyro and 'covers' in accel
    assert main([*words, '--json']) == 0
    document = json.loads(capsys.readouterr().out)
    assert document['drift'][0]['axis'] == 'gyro_x' and document['drift'][0]['ratio'] > 0.0
    assert mine.read_bytes() == before


def test_wrong_units_are_not_silent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    samples = rng.normal([0.5] * 3 + [0.0, 0.0, 9.81], [0.08] * 3 + [0.02] * 3, (6000, 6))
    np.save(tmp_path / 'dps.npy', samples)
    words = ['analyze', str(tmp_path / 'dps.npy'), '--rate', '100', '-q', '-o', str(tmp_path / 'x')]
    assert main([*words, '--export', 'px4']) == 1
    error = capsys.readouterr().err
    assert 'px4_imu.params is not written (the numbers are wrong, so only' in error
    assert '`allan export --force`' in error and 'deg/s' not in error  # another finding states this
    assert not list((tmp_path / 'x').glob('*.yaml')) + list((tmp_path / 'x').glob('*.params'))
    assert main(['export', str(tmp_path / 'x'), '--to', 'px4']) == 1
    assert 'the unit is probably deg/s' in capsys.readouterr().err
    assert main(['export', str(tmp_path / 'x'), '--to', 'px4', '--force']) == 0
    assert capsys.readouterr().out.startswith('# warning: gyro_x, gyro_y, gyro_z: The gyro at rest')


@pytest.mark.parametrize(
    ('words', 'said'),
    [
        (['export'], 'give a results.json or its folder'),
        (['export', '{results}'], 'give a results.json or its folder'),
        (['export', '/no/such.json', '--to', 'kalibr'], 'no such file'),
        (['export', '{results}', '--to', 'temperature'], 'no bias over temperature'),
        (['export', '{results}', '--to', 'klibr'], 'The targets are kalibr, openvins'),
        (
            ['export', '{recording}', '--to', 'kalibr'],
            'is not a JSON document; `allan analyze` reads',
        ),
        (['export', '{above}', '--to', 'kalibr'], 'no results.json in this folder'),
        (['export', '{results}', '--to', 'robot_localization'], 'the node allan_imu_relay'),
        (['export', '{results}', '--to', 'px4', '--against', '{yaml}'], 'no number of EKF2_GYR'),
        (['export', '{results}', '--to', 'kalibr', '--inflate', '0.5'], 'inflate is 0.5'),
        (['export', '{results}', '--to', 'kalibr', '--horizon', '-1'], 'horizon is -1'),
        (['export', '{results}', '--to', 'kalibr', '--filter-rate', '-1'], 'filter_rate is -1'),
        (['export', '{results}', '--to', 'kalibr', '-o', '/no/such/imu.yaml'], 'cannot be written'),
        (['analyze', '{results}', '--export', 'kalibr'], '--export needs a folder'),
        (['analyze', '{sums}', '--export', 'klibr', '-o', '{above}'], 'did you mean kalibr'),
    ],
)
def test_an_error_of_the_user_gives_one_line_and_exit_code_1(
    analyzed: Path,
    recording: Path,
    words: list[str],
    said: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    files = {
        '{recording}': str(recording),
        '{results}': str(analyzed / 'results.json'),
        '{sums}': str(analyzed / 'sums.json'),
        '{yaml}': str(analyzed / 'imu.yaml'),
        '{above}': str(analyzed.parent),
    }
    assert main([files.get(word, word) for word in words]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert said in lines[0]
