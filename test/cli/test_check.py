# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan check`: one line and an exit code."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from allan_ros.cli.main import main


@pytest.mark.parametrize(
    ('arw', 'code', 'word'), [(0.4, 0, 'healthy'), (0.05, 3, 'failed'), (0.2, 3, 'failed')]
)
def test_a_datasheet_decides(
    recording: Path,
    sheet: Callable[[float], str],
    arw: float,
    code: int,
    word: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    margin = ['--margin', '0.05']
    assert main(['check', str(recording), '--sensor', sheet(arw), *margin]) == code
    out = capsys.readouterr().out
    assert out.count('\n') == 1
    assert out.startswith(f'{word}: {recording}: ')


def test_the_accepted_run_is_healthy_against_itself_and_results_are_read(
    recording: Path, analyzed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    baseline = ['--baseline', str(analyzed / 'results.json')]
    assert main(['check', str(recording), *baseline]) == 0
    assert main(['check', str(analyzed), *baseline, '--json']) == 0
    document = json.loads(capsys.readouterr().out.partition('\n')[2])
    assert (document['level'], document['exit_code']) == ('healthy', 0)
    assert main(['check', str(analyzed), '--json']) == 4
    shown = json.loads(capsys.readouterr().out)
    written = json.loads((analyzed / 'results.json').read_text())['verdict']
    assert shown['level'] == 'unknown' and written['level'] == 'measured'
    assert (shown['summary'], shown['next_steps']) == (written['summary'], written['next_steps'])
    folder = ['--baseline', str(analyzed)]
    assert main(['analyze', str(recording), *folder]) == 0
    assert 'numbers are within' in capsys.readouterr().out


@pytest.mark.parametrize('compared', [[], ['--sensor', 'bmi088']])
def test_the_line_of_a_unit_states_wrong_units(
    tmp_path: Path, compared: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    imu = np.random.default_rng(1).normal(scale=0.05, size=(6000, 7))
    imu[:, 0] = np.arange(6000) / 100.0
    imu[:, 6] += 1.0
    path = tmp_path / 'in_deg_and_g.npy'
    np.save(path, imu)
    assert main(['check', str(path), *compared]) == 4
    assert 'the unit is probably' in capsys.readouterr().out


def test_without_a_reference_or_enough_data_nothing_is_judged(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['check', str(recording)]) == 4
    assert capsys.readouterr().out.startswith('not judged: ')
    short = tmp_path / 'short.npz'
    imu = np.random.default_rng(1).normal(size=(500, 7))
    imu[:, 0] = np.arange(500) / 100.0
    np.savez(short, imu=imu)
    assert main(['check', str(short), '--sensor', 'mpu-6050']) in (3, 4)
    assert main(['check', str(tmp_path / 'none.npz'), '--sensor', 'mpu-6050']) == 1
    assert main(['check', str(recording), '--sensor', 'no-such-part']) == 1


def write_unit(path: Path, seed: int, scale: float = 1.0) -> None:
    imu = np.random.default_rng(seed).normal(size=(9000, 7)) * 1e-3 * scale
    imu[:, 0] = np.arange(9000) / 100.0
    imu[:, 6] += 9.80665
    if path.suffix == '.csv':
        gyro, accel = (','.join(f'{s}{a} [{unit}]' for a in 'xyz')
                       for s, unit in (('g', 'rad/s'), ('a', 'm/s^2')))  # fmt: skip
        np.savetxt(path, imu, delimiter=',', header=f't,{gyro},{accel}', comments='')
    else:
        np.savez(path, imu=imu)


@pytest.fixture(scope='module')
def units(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of five good units, a noisy one, a copy, and a damaged file."""
    folder = tmp_path_factory.mktemp('units')
    for number in range(5):
        write_unit(folder / f'unit_{number}.csv', number)
    write_unit(folder / 'unit_5.csv', 5, scale=3.0)
    (folder / 'unit_6.csv').write_bytes((folder / 'unit_2.csv').read_bytes())
    (folder / 'unit_7.csv').write_text('t,gx\n1,two\n')
    return folder


@pytest.fixture
def limit(sheet: Callable[[float], str]) -> list[str]:
    return ['--sensor', sheet(0.4)]  # 1e-4 rad/s/sqrt(Hz) is 0.34 deg/sqrt(h)


@pytest.mark.parametrize('how', ['folder', 'files'])
def test_units_are_never_pooled(
    how: str, units: Path, limit: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    files = [str(path) for path in sorted(units.glob('*.csv'))]
    given = files if how == 'files' else [str(units)]
    words = ['check', *given, *limit, '--method', 'likelihood']
    assert main([*words, '--jobs', '2' if how == 'files' else '1']) == 3
    *lines, totals = capsys.readouterr().out.splitlines()
    assert [line.split(': ')[1] for line in lines] == files
    assert [line.split(':')[0] for line in lines] == [
        'healthy', 'healthy', 'healthy', 'healthy', 'healthy', 'failed', 'not judged', 'error',
    ]  # fmt: skip
    assert f'duplicate: it has the samples of {files[2]}' in lines[6]
    assert 'gyro N' in lines[5] and 'Above TEST' in lines[5]
    named = '1 failed (unit_5.csv), 1 not judged (unit_6.csv), 1 error (unit_7.csv)'
    assert totals == f'8 units: 5 healthy, {named}'
    assert main([*words, '--json']) == 3
    *documents, last = map(json.loads, capsys.readouterr().out.splitlines())
    assert [document['exit_code'] for document in documents] == [0, 0, 0, 0, 0, 3, 4, 1]
    assert documents[6]['level'] == 'unknown'
    assert documents[0]['axes']['gyro_x']['N']['value'] == pytest.approx(1e-4, rel=0.1)
    assert last == {
        'units': 8,
        'totals': {'healthy': 5, 'failed': 1, 'not judged': 1, 'error': 1},
        'exit_code': 3,
    }


def test_the_exit_code_is_that_of_the_worst_unit(
    units: Path, limit: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, broken = str(units / 'unit_0.csv'), str(units / 'unit_7.csv')
    assert main(['check', good, *limit]) == 0
    assert main(['check', good]) == 4
    assert main(['check', good, broken, *limit]) == 1
    assert main(['check', good, 'missing.csv']) == 1
    assert main(['check', good, good, '--hardware-id', '7', *limit]) == 0  # one unit
    assert main(['check', good, broken, '--hardware-id', '7']) == 1
    assert '--hardware-id is the number of one IMU' in capsys.readouterr().err
    out = str(tmp_path / 'batch')
    assert main(['analyze', str(units), '-o', out, '--method', 'paper']) == 1
    capsys.readouterr()
    assert main(['check', out, *limit]) == 1  # results without intervals, and an unread unit
    assert capsys.readouterr().out.splitlines()[-1].startswith('8 units: 7 not judged')


def test_a_unit_that_cannot_be_read_is_counted_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ('a.csv', 'b.csv'):
        (tmp_path / name).write_text('t,gx\n1,two\n')
    for _ in range(2):
        assert main(['check', str(tmp_path), '-o', str(tmp_path)]) == 1
        assert capsys.readouterr().out.splitlines()[-1] == '2 units: 2 error (a.csv, b.csv)'


def test_every_recording_has_the_exit_code_of_its_state(
    repository: Path, shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(repository / 'scripts'))
    from check_table import run_cases

    for case, code, line in run_cases(shared_data, tmp_path):
        assert code == case.exit_code, line
