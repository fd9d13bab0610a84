# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan check --plan`: exit codes, JSON, the summary of a batch, serial numbers, archives."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from allan_ros.cli.main import main

N = 1e-4
"""rad/s/sqrt(Hz) of the simulated units; .344 deg/sqrt(h)."""

PLAN = {
    'schema': 'allan_ros/plan/1',
    'name': 'line 4',
    'gyro': {
        'N': {'lower': 0.2, 'upper': 0.5, 'unit': 'deg/sqrt(h)'},
        'bias': {'lower': -0.5, 'upper': 0.5, 'unit': 'deg/s'},
    },
    'orientation': {'up': [0, 0, 1], 'upper': 2, 'unit': 'deg'},
    'rate': {'lower': 99, 'upper': 101, 'unit': 'Hz'},
}


def write_unit(path: Path, seed: int, scale: float = 1.0, **more: Any) -> None:
    imu = np.random.default_rng(seed).normal(size=(9000, 7)) * np.array([0.0] + [1e-3] * 6) * scale
    imu[:, 0] = np.arange(9000) / 100.0
    imu[:, 6] += 9.80665
    np.savez(path, imu=imu, **more)


@pytest.fixture(scope='module')
def plan(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp('plan') / 'line4.yaml'
    path.write_text(yaml.safe_dump(PLAN))
    return str(path)


@pytest.fixture(scope='module')
def units(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a good unit, a noisy one, one with NaN, and a damaged file."""
    folder = tmp_path_factory.mktemp('units')
    write_unit(folder / 'SN01_a.npz', 1, serial=np.array('A1'))
    write_unit(folder / 'SN02_b.npz', 2, scale=3.0, serial=np.array('B2'))
    write_unit(folder / 'SN03_c.npz', 3, serial=np.array('C3'))
    with np.load(folder / 'SN03_c.npz') as file:
        imu, serial = file['imu'], file['serial']
    imu[::100, 2] = np.nan
    np.savez(folder / 'SN03_c.npz', imu=imu, serial=serial)
    (folder / 'SN04_d.csv').write_text('t,gx\n1,two\n')
    return folder


def documents(words: Sequence[str], capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    main([*words, '--json'])
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_each_unit_has_its_exit_code_and_reason(
    units: Path, plan: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['check', str(units), '--plan', plan]) == 3
    *lines, totals, unchecked = capsys.readouterr().out.splitlines()
    assert [line.split(': ')[0] for line in lines] == ['healthy', 'failed', 'not judged', 'error']
    assert 'All limits of line 4 are met (8)' in lines[0]
    assert 'Beyond line 4: gyro N 1.0' in lines[1] and '(limit 0.2 to 0.5 deg/sqrt(h))' in lines[1]
    assert '90 samples are NaN or infinite' in lines[2]
    assert totals.startswith('4 units: 1 healthy, 1 failed (SN02_b.npz)')
    assert unchecked.startswith('unchecked (the plan has no limit): gyro Q, gyro B')
    for name, code in (('SN01_a.npz', 0), ('SN02_b.npz', 3), ('SN03_c.npz', 4), ('SN04_d.csv', 1)):
        assert main(['check', str(units / name), '--plan', plan, '--quiet']) == code


def test_json_has_limits_intervals_and_units(
    units: Path, plan: str, capsys: pytest.CaptureFixture[str]
) -> None:
    *found, totals = documents(['check', str(units), '--plan', plan], capsys)
    assert [document['exit_code'] for document in found] == [0, 3, 4, 1]
    assert all(document['schema'] == 'allan_ros/unit_check/1' for document in found)
    good, noisy, _, unreadable = found
    assert unreadable['level'] == 'error' and 'two' in unreadable['summary']
    n = good['axes']['gyro_x']['N']
    assert n['unit'] == 'rad/s/sqrt(Hz)' and n['ci95'][0] < n['value'] < n['ci95'][1]
    (limit,) = [x for x in noisy['limits'] if (x['axis'], x['quantity']) == ('gyro_x', 'N')]
    # 3 N; the interval of 90 s at 100 Hz has a half-width of 3 %, and 15 % is ten standard errors
    assert limit['value'] == pytest.approx(3.0 * 0.3438, rel=0.15)
    assert (limit['lower'], limit['upper'], limit['verdict']) == (0.2, 0.5, 'exceeds')
    assert limit['unit'] == 'deg/sqrt(h)' and 'gyro B' in noisy['unchecked']
    assert totals == {
        'units': 4,
        'totals': {'healthy': 1, 'failed': 1, 'not judged': 1, 'error': 1},
        'exit_code': 3,
    }


def test_a_batch_has_a_table_a_page_and_an_archive(
    units: Path, plan: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lot = tmp_path / 'lot'
    words = ['check', str(units), '--plan', plan, '-o', str(lot), '--serial-from', 'column:serial']
    assert main(words) == 3
    rows = list(csv.DictReader((lot / 'summary.csv').open()))
    assert [row['serial'] for row in rows] == ['A1', 'B2', 'C3', '']
    assert [row['exit_code'] for row in rows] == ['0', '3', '4', '1']
    unit = '[deg/sqrt(h)]'
    assert rows[0][f'gyro_x N lower limit {unit}'] == '0.2'
    assert rows[0]['rate upper limit [Hz]'] == '101' and 'rate low95 [Hz]' not in rows[0]
    assert float(rows[1][f'gyro_y N low95 {unit}']) < float(rows[1][f'gyro_y N {unit}'])
    page = (lot / 'index.html').read_text()
    assert '4 units against the plan line 4: 1 healthy, 1 failed' in page
    assert page.count('<polyline') == 18 and page.count('<polygon') == 3
    assert (lot / 'SN01_a_npz' / 'report.html').is_file()
    capsys.readouterr()
    # the archive is checked again, with another plan
    strict = tmp_path / 'strict.yaml'
    strict.write_text(yaml.safe_dump({**PLAN, 'rate': {'lower': 200, 'unit': 'Hz'}}))
    found = documents(['check', str(lot), '--plan', str(strict)], capsys)
    assert [document['serial'] for document in found[:-1]] == ['A1', 'B2', 'C3', '']
    assert [document['exit_code'] for document in found[:-1]] == [3, 3, 3, 1]
    assert 'not read when this folder was written: ' in found[3]['summary']
    assert found[3]['summary'].count('SN04_d.csv') == 1


@pytest.mark.parametrize(
    'rule, serials',
    [('name:SN([0-9]+)', ['01', '02', '03']), ('name:SN[0-9]+', ['SN01', 'SN02', 'SN03'])],
)
def test_serials_from_file_names(
    rule: str, serials: list[str], units: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [str(path) for path in sorted(units.glob('*.npz'))]
    *found, _ = documents(['check', *files, '--serial-from', rule, '--method', 'paper'], capsys)
    assert [document['serial'] for document in found] == serials


def test_serials_from_tables_and_bags(tmp_path: Path) -> None:
    from allan_ros.core.errors import AllanError
    from allan_ros.readers.serials import SerialRule

    table = tmp_path / 'unit.csv'
    table.write_text('# log\nt;gx;serial no\n0;1;X7\n1;2;X7\n')
    assert SerialRule('column:serial no').serial_of(str(table)) == 'X7'
    bag = tmp_path / 'bag'
    bag.mkdir()
    information = {'rosbag2_bagfile_information': {'custom_data': {'imu serial': 42}}}
    (bag / 'metadata.yaml').write_text(yaml.safe_dump(information))
    rule = SerialRule('metadata:imu serial')
    assert rule.serial_of(str(bag)) == rule.serial_of(str(bag / 'bag_0.mcap')) == '42'
    # the metadata of a bag with thousands of files may be larger than other YAML files
    information['rosbag2_bagfile_information']['relative_file_paths'] = 'x' * 200_000
    (bag / 'metadata.yaml').write_text(yaml.safe_dump(information))
    assert rule.serial_of(str(bag)) == '42'
    for text, path in (
        ('column:none', table),
        ('metadata:none', bag),
        ('metadata:imu serial', table),
        ('column:serial', bag / 'metadata.yaml'),
        ('name:Z+', table),
    ):
        with pytest.raises(AllanError, match='serial'):
            SerialRule(text).serial_of(str(path))
    long = tmp_path / 'long.csv'
    long.write_text('serial\n' + 2000 * '7' + '\n')
    with pytest.raises(AllanError, match='has more than 1000 characters'):
        SerialRule('column:serial').serial_of(str(long))
    broken = tmp_path / 'broken.csv'
    broken.write_bytes(b'serial\rx,b\n1,2\n')
    for path in (broken, tmp_path / 'missing.csv'):
        with pytest.raises(AllanError, match='check the path and the table'):
            SerialRule('column:serial').serial_of(str(path))
    for text in ('serial', 'name:', 'name:(', 'row:7'):
        with pytest.raises(AllanError, match='--serial-from'):
            SerialRule(text)


def test_a_serial_that_is_not_stated_is_the_error_of_its_unit(
    units: Path, plan: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ['check', str(units), '--plan', plan, '--serial-from', 'name:SN(01)']
    assert [d['exit_code'] for d in documents(words, capsys)[:-1]] == [0, 1, 1, 1]
    both = [*words[:2], '--hardware-id', '7', '--serial-from', 'name:SN(01)']
    assert main(both) == 1


def test_a_plan_that_cannot_be_read_is_one_line(
    units: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = tmp_path / 'wrong.yaml'
    wrong.write_text('schema: allan_ros/plan/1\nrate: {lower: 1, unit: kg}\n')
    for path in (wrong, tmp_path / 'none.yaml'):
        assert main(['check', str(units), '--plan', str(path)]) == 1
        shown = capsys.readouterr().err.strip()
        assert path.name in shown and '\n' not in shown


def test_a_datasheet_gives_a_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['sensors', 'adis16475-3', '--as-plan']) == 0
    text = capsys.readouterr().out
    assert yaml.safe_load(text)['gyro']['N'] == {
        'lower': 0.1,
        'upper': 0.36,
        'unit': 'deg/sqrt(h)',
    }
    assert main(['sensors', '--as-plan']) == 1
