# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import pytest
import yaml

from allan_ros.core.errors import AllanError
from allan_ros.io.sensors import SCHEMA, load_sensor, sensor_names

DEGREE = math.pi / 180


def sheet(**sensors):
    return {'schema': SCHEMA, 'name': 'X', 'sources': ['a data sheet, Rev. 1'], **sensors}


@pytest.fixture
def load(tmp_path):
    def from_document(document):
        path = tmp_path / 'x.yaml'
        path.write_text(document if isinstance(document, str) else yaml.safe_dump(document))
        return load_sensor(str(path))

    return from_document


def test_the_imu_of_the_paper_comes_with_the_package():
    assert 'adis16475-3' in sensor_names()
    imu = load_sensor('ADIS16475-3')
    assert imu.limits['gyro']['N'].value == pytest.approx(0.3 * DEGREE / 60)
    assert imu.limits['gyro']['B'].value == pytest.approx(7 / 0.6643 * DEGREE / 3600, rel=1e-4)
    assert imu.limits['gyro']['B'].stated == '7 deg/h'
    assert imu.limits['accel']['B'].value == pytest.approx(3.6e-6 / 0.6643 * 9.80665, rel=1e-4)
    assert 'N' not in imu.limits['accel']  # no source, no limit
    assert imu.range == pytest.approx({'gyro': 2000 * DEGREE, 'accel': 8 * 9.80665})
    assert imu.lsb == pytest.approx({'gyro': 0.1 * DEGREE, 'accel': 0.25e-3 * 9.80665})


def test_every_datasheet_that_comes_with_the_package_loads():
    for name in sensor_names():
        imu = load_sensor(name)
        assert imu.sources and imu.limits


@pytest.mark.parametrize(
    'sided, factor, note',
    [('one', 0.5**0.5, 'one-sided'), ('two', 1, ''), ('unknown', 2**0.5, 'w')],
)
def test_a_density_becomes_n_by_its_sides(load, sided, factor, note):
    density = {'value': 0.05, 'unit': 'deg/s/sqrt(Hz)', 'sided': sided}
    limit = load(sheet(gyro={'noise_density': density})).limits['gyro']['N']
    assert limit.value == pytest.approx(0.05 * DEGREE * factor)
    assert limit.stated == '0.05 deg/s/sqrt(Hz)'
    assert note in limit.note and bool(note) == bool(limit.note)


def test_the_random_walk_is_believed_before_the_density(load):
    """ADIS16405: 2.0 deg/sqrt(h) and 0.05 deg/s/sqrt(Hz) agree when the density is one-sided."""
    density = {'value': 0.05, 'unit': 'deg/s/sqrt(Hz)', 'sided': 'one'}
    both = load(
        sheet(gyro={'arw': {'value': 2.0, 'unit': 'deg/sqrt(h)'}, 'noise_density': density})
    )
    assert both.limits['gyro']['N'].value == pytest.approx(2 * DEGREE / 60)
    alone = load(sheet(gyro={'noise_density': density}))
    assert alone.limits['gyro']['N'].value == pytest.approx(2 * DEGREE / 60, rel=0.07)


@pytest.mark.parametrize('stated_as, factor', [(None, 1), ('coefficient', 1), ('minimum', 1.5054)])
def test_a_minimum_becomes_the_coefficient(load, stated_as, factor):
    bias = {'value': 10, 'unit': 'ug'} | ({'stated_as': stated_as} if stated_as else {})
    limit = load(sheet(accel={'bias_instability': bias})).limits['accel']['B']
    assert limit.value == pytest.approx(10e-6 * 9.80665 * factor, rel=1e-4)


@pytest.mark.parametrize('number', ['3e-1', '0.3', '3.0E-01', '+3e-01'])
def test_numbers_mean_what_people_mean(load, number):
    text = yaml.safe_dump(arw(value='?')).replace("'?'", number)
    assert load(text).limits['gyro']['N'].value == pytest.approx(0.3 * DEGREE / 60)


def arw(**change):
    return sheet(gyro={'arw': {'value': 1.0, 'unit': 'deg/sqrt(h)'} | change})


@pytest.mark.parametrize(
    'document, said',
    [
        (arw(value=-1), r'gyro.arw.value is -1: a positive number'),
        (arw(value='much'), r"gyro.arw.value is 'much': a number is expected"),
        (arw(value=math.nan), r'gyro.arw.value is nan'),
        (
            arw(unit='deg/h'),
            r"gyro.arw: unit 'deg/h' does not fit here: use one of .*deg/sqrt\(h\)",
        ),
        (arw(sided='one'), r"gyro.arw: 'sided' is unknown"),
        (sheet(gyro={'ARW': {}}), r"gyro: 'ARW' is unknown, use arw, noise_density"),
        (sheet(gyro={'noise_density': {'value': 1, 'unit': 'deg/s/sqrt(Hz)'}}), 'sided is missing'),
        (sheet() | {'schema': 'other'}, "schema is 'other'"),
        (sheet() | {'sources': []}, 'sources is empty'),
        ('[1, 2', 'is not YAML'),
        ('just words', 'object is expected'),
        ('', 'object is expected'),
        ('!!python/object/apply:os.getcwd []', 'is not YAML'),
        ('x' * 200_000, 'over 100000 bytes'),
    ],
)
def test_a_bad_file_is_refused_with_its_place(load, document, said):
    with pytest.raises(AllanError, match=said):
        load(document)


def test_an_unknown_name_lists_the_known_ones(tmp_path):
    with pytest.raises(AllanError, match=r"no datasheet 'mpu1': choose one of .*adis16475-3"):
        load_sensor('mpu1')
    with pytest.raises(AllanError, match='cannot be read'):
        load_sensor(str(tmp_path / 'none.yaml'))
