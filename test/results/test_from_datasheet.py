# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files for filters from a datasheet alone, and values that were measured with known sensors."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

import allan_ros as ar
from allan_ros.cli.main import main
from allan_ros.core.errors import AllanError
from allan_ros.core.noise import Model
from allan_ros.export import TARGETS
from allan_ros.results.datasheets import (
    SCHEMA,
    Datasheet,
    load_sensor,
    sensor_names,
)
from allan_ros.results.from_datasheet import CROSSING_S
from allan_ros.results.measured import known_factors, measured_values
from allan_ros.results.results import Results

SHEET = {
    'schema': SCHEMA,
    'name': 'X1',
    'sources': {'sheet': {'title': 'X1 Data Sheet', 'url': 'https://x.org/x1'}},
    'gyro': {
        'noise_density': {'value': 0.01, 'unit': 'deg/s/sqrt(Hz)', 'sided': 'one'},
        'bias_instability': {'value': 3, 'unit': 'deg/h', 'stated_as': 'minimum'},
    },
    'accel': {'vrw': {'value': 0.06, 'unit': 'm/s/sqrt(h)'}},
}


@pytest.fixture
def imu(tmp_path: Path) -> Datasheet:
    path = tmp_path / 'x1.yaml'
    path.write_text(yaml.safe_dump(SHEET))
    return ar.sensor(path)


def test_an_invalid_rate_is_an_error(imu: Datasheet) -> None:
    with pytest.raises(AllanError, match="filter_rate is 'fast'"):
        imu.export('kalibr', filter_rate='fast')
    with pytest.raises(AllanError, match='filter_rate is -1'):
        imu.export('kalibr', filter_rate=-1.0)
    for rate in (0.0, -1.0, math.nan, 'fast'):
        with pytest.raises(AllanError, match='rate is'):
            imu.results(rate)


def test_a_file_from_a_datasheet_has_its_n_and_covers_its_b(imu: Datasheet) -> None:
    text = imu.export('kalibr', filter_rate=100.0)
    read = yaml.safe_load(text)
    n = math.radians(0.01) / math.sqrt(2.0)  # a one-sided density is sqrt(2) N
    b = math.radians(3.0) / 3600.0 / math.sqrt(2.0 * math.log(2.0) / math.pi)  # of its minimum
    assert read['gyroscope_noise_density'] == pytest.approx(n, rel=1e-5)
    assert read['accelerometer_noise_density'] == pytest.approx(1e-3, rel=1e-5)
    assert read['update_rate'] == 100.0
    times = np.geomspace(1.0, 30.0, 20)
    for whole, key in (
        (Model.of(N=n, B=b), 'gyroscope'),
        # flicker noise of the accelerometer crosses its white noise at 10 s
        (Model.of(N=1e-3, B=1e-3 / math.sqrt(0.441271 * CROSSING_S)), 'accelerometer'),
    ):
        file = Model.of(N=read[f'{key}_noise_density'], K=read[f'{key}_random_walk'])
        bound, growth = (t.growth(times, 30.0) for t in (file, whole))
        assert np.all(bound >= 0.999 * growth) and bound.max() < 2.0 * growth.max()
    low, high = known_factors(map(load_sensor, sensor_names()))
    assert low < 1.0 < high
    for words in (
        f'# warning: These numbers are from the datasheet of X1 and not measured. Sensors that '
        f'were measured have {low:.2g} to {high:.2g} times',
        'from the datasheet of X1 and not measured (allan_ros',
        'source: X1 Data Sheet https://x.org/x1',
        'gyro N stated 0.01 deg/s/sqrt(Hz) (one-sided density, divided by sqrt(2))',
        'warning: accel_x, accel_y, accel_z: The datasheet states no bias instability',
    ):
        assert words in text


@pytest.mark.parametrize('target', [name for name in TARGETS if name != 'temperature'])
def test_every_target_is_written_from_a_datasheet(imu: Datasheet, target: str) -> None:
    text = imu.export(target)
    assert 'not measured' in text and 'imu_link' not in text
    assert 'date: ' not in text


def test_an_axis_without_figures_is_absent(tmp_path: Path) -> None:
    figures = {'noise_density': {'value': 0.01, 'unit': 'deg/s/sqrt(Hz)', 'sided': 'two'}}
    document = {'schema': 'allan_ros/sensor/1', 'name': 'one', 'sources': {'a': {'title': 'b'}}}
    path = tmp_path / 'one.yaml'
    path.write_text(yaml.safe_dump({**document, 'gyro': figures, 'accel': {}}))
    assert list(ar.sensor(path).results()) == ['gyro_x', 'gyro_y', 'gyro_z']


def test_a_datasheet_without_n_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / 'x2.yaml'
    path.write_text(yaml.safe_dump({key: SHEET[key] for key in SHEET if key != 'gyro'}))
    with pytest.raises(AllanError, match='no gyro'):
        ar.sensor(str(path)).export('kalibr')
    only = {'bias_instability': SHEET['gyro']['bias_instability']}
    path.write_text(yaml.safe_dump({**SHEET, 'gyro': only}))
    with pytest.raises(AllanError, match='X1 states no N of gyro_x'):
        ar.sensor(str(path)).export('kalibr')
    with pytest.raises(AllanError, match='a name or a path'):
        ar.sensor(7)  # type: ignore[arg-type]


def test_a_unit_is_compared_with_the_measured_units(
    small_results: Results, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = measured_values(small_results)
    assert all(one.ci95[0] <= one.value <= one.ci95[1] for one in own.values())
    small_results.save(tmp_path / 'results')
    assert main(['sensors', '--from', str(tmp_path / 'results')]) == 0
    stated = yaml.safe_load(capsys.readouterr().out)
    assert main(['sensors', 'bmi088', '--from', str(tmp_path / 'results')]) == 1
    assert 'omit bmi088' in capsys.readouterr().err
    path = tmp_path / 'x1.yaml'
    path.write_text(yaml.safe_dump({**SHEET, **stated}))
    (read,) = load_sensor(str(path)).measured
    for (kind, term), one in own.items():
        known = read.values[kind][term]
        assert known.value == pytest.approx(one.value, rel=1e-3)
        assert known.ci95 == pytest.approx(one.ci95, rel=1e-3)
    for name, factor in (('typical', 1.0), ('quieter', 2.0), ('noisier', 0.5)):
        n = own['gyro', 'N'].times(factor)
        ends = n.value, *n.ci95
        entry = dict(zip(('value', 'low', 'high'), ends), unit='rad/s/sqrt(Hz)')
        sheet = tmp_path / f'{name}.yaml'
        sheet.write_text(yaml.safe_dump({**SHEET, 'measured': [{'by': 'Y', 'gyro': {'N': entry}}]}))
        assert main(['compare', str(tmp_path / 'results'), f'sensor:{sheet}']) == 0
        assert f'measured units of X1:\n         gyro N {name}: ' in capsys.readouterr().out
    assert main(['compare', str(tmp_path / 'results'), f'sensor:{sheet}', '--json']) == 0
    document = json.loads(capsys.readouterr().out)
    (known,) = document['datasheets'][0]['measured']
    assert (known['quantity'], known['reference']) == ('N', '1 unit')
    assert known['verdict'] == 'higher'


def test_a_measured_value_must_be_above_zero(tmp_path: Path) -> None:
    entry = {'value': 0.0, 'low': 0.0, 'high': 1.0, 'unit': 'rad/s/sqrt(Hz)'}
    sheet = tmp_path / 'x1.yaml'
    sheet.write_text(yaml.safe_dump({**SHEET, 'measured': [{'by': 'Y', 'gyro': {'N': entry}}]}))
    with pytest.raises(AllanError, match='value'):
        load_sensor(str(sheet))


def test_a_measured_term_must_be_known(tmp_path: Path) -> None:
    entry = {'value': 1.0, 'low': 0.9, 'high': 1.1, 'unit': 'deg/h'}
    sheet = tmp_path / 'x1.yaml'
    sheet.write_text(yaml.safe_dump({**SHEET, 'measured': [{'by': 'Y', 'gyro': {'X': entry}}]}))
    with pytest.raises(AllanError, match="gyro: 'X' is unknown"):
        load_sensor(str(sheet))


def test_the_catalogue_names_who_measured(capsys: pytest.CaptureFixture[str]) -> None:
    measured = [one for name in sensor_names() for one in load_sensor(name).measured]
    assert len(measured) >= 5
    assert all(one.by and one.url and one.hours > 0.1 and one.values for one in measured)
    assert main(['sensors', 'adis16405']) == 0
    shown = capsys.readouterr().out
    assert 'measured by Department of Geomatics Engineering, University of Calgary' in shown
    assert 'gyro N 2.43 (2.25..2.56) deg/sqrt(h), 1.2 times the datasheet' in shown


def test_the_command_exports_from_a_datasheet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ['export', '--sensor', 'bmi088', '--to', 'openvins', '--filter-rate', '200']
    assert main([*words, '-o', str(tmp_path / 'imu.yaml')]) == 0
    assert (tmp_path / 'imu.yaml').read_text() == ar.sensor('bmi088').export(
        'openvins', filter_rate=200.0
    )
    assert 'from the datasheet of BMI088 and not measured' in capsys.readouterr().err
    assert main([*words, 'results']) == 1
    assert 'or --sensor NAME' in capsys.readouterr().err
