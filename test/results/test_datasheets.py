# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import importlib.util
import json
import math

import pytest
import yaml

import allan_ros as ar
from allan_ros.core.check import worst_verdict
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import AXES, UNITS, sensor_of
from allan_ros.results.datasheets import (
    SCHEMA,
    Datasheet,
    Limit,
    Source,
    load_sensor,
    sensor_names,
)
from allan_ros.results.documents import results_from_document, results_to_document

DEGREE = math.pi / 180
DENSITY = {'value': 0.05, 'unit': 'deg/s/sqrt(Hz)'}
N = 0.05 * DEGREE
ARW = {'value': 1.0, 'unit': 'deg/sqrt(h)'}
BIAS = {'value': 10, 'unit': 'ug'}


def sheet(**sensors):
    sources = {'sheet': {'title': 'X Data Sheet', 'revision': 'Rev. 1'}}
    return {'schema': SCHEMA, 'name': 'X', 'sources': sources, **sensors}


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
    assert tuple(imu.limits) == AXES
    assert imu.limits['gyro_y']['N'].value == pytest.approx(0.3 * DEGREE / 60)
    assert imu.limits['gyro_z']['B'].value == pytest.approx(7 / 0.6643 * DEGREE / 3600, rel=1e-4)
    assert imu.limits['gyro_x']['B'].stated == '7 deg/h'
    assert imu.limits['accel_x']['B'].value == pytest.approx(3.6e-6 / 0.6643 * 9.80665, rel=1e-4)
    assert imu.values()['gyro_x']['N'] == imu.limits['gyro_x']['N'].value


PLAUSIBLE = {
    ('gyro', 'N'): (0.01, 5.0, 'deg/sqrt(h)'),
    ('gyro', 'B'): (0.1, 500.0, 'deg/h'),
    ('accel', 'N'): (5.0, 1000.0, 'ug/sqrt(Hz)'),
    ('accel', 'B'): (0.5, 2000.0, 'ug'),
}
"""Plausible range for a MEMS IMU; a wrong unit or digit lies outside."""


@pytest.mark.parametrize('name', sensor_names())
def test_every_datasheet_that_comes_with_the_package(name):
    imu = load_sensor(name)
    assert imu.name.lower() == name and imu.maker
    assert any(imu.limits.values())
    for axis, terms in imu.limits.items():
        for term, limit in terms.items():
            low, high, unit = PLAUSIBLE[sensor_of(axis), term]
            assert low <= limit.value / UNITS[unit].factor <= high, (axis, term)
            assert limit.source in imu.sources
    for source in imu.sources.values():
        assert source.title and source.seen and source.via


def test_the_page_agrees_with_the_files(repository):
    script = repository / 'scripts' / 'sensor_table.py'
    spec = importlib.util.spec_from_file_location('sensor_table', script)
    written = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(written)
    text = (repository / 'docs' / 'sensors.md').read_text()
    assert written.page(text) == text, 'run scripts/sensor_table.py'


def test_the_examples_of_the_page_load(repository, load):
    text = (repository / 'docs' / 'sensors.md').read_text()
    imu = load(text.split('```yaml\n')[1].split('```')[0])
    assert imu.limits['accel_x']['N'].stated == '65 ug/sqrt(Hz)'
    assert load(text.split('```yaml\n')[2].split('```')[0]).carries == 'BMI055'


@pytest.mark.parametrize(
    'sensor, stated, term, expected, note',
    [
        ('gyro', {'noise_density': DENSITY | {'sided': 'one'}}, 'N', N / 2**0.5, 'one-sided'),
        ('gyro', {'noise_density': DENSITY | {'sided': 'two'}}, 'N', N, ''),
        ('gyro', {'noise_density': DENSITY | {'sided': 'unknown'}}, 'N', N, 'does not state'),
        # the random walk is N itself, so it is used before the density
        ('gyro', {'arw': ARW, 'noise_density': DENSITY | {'sided': 'one'}}, 'N', DEGREE / 60, ''),
        ('accel', {'bias_instability': BIAS | {'stated_as': 'coefficient'}}, 'B', 9.80665e-5, ''),
        ('accel', {'bias_instability': BIAS | {'stated_as': 'minimum'}}, 'B', 1.47628e-4, 'min'),
        ('accel', {'bias_instability': BIAS | {'stated_as': 'unknown'}}, 'B', 1.47628e-4, 'not'),
    ],
)
def test_figures_become_coefficients_by_their_meaning(load, sensor, stated, term, expected, note):
    limit = load(sheet(**{sensor: stated})).limits[f'{sensor}_x'][term]
    assert limit.value == pytest.approx(expected, rel=1e-4)
    assert note in limit.note and bool(note) == bool(limit.note)


@pytest.mark.parametrize('number', ['3e-1', '0.3', '3.0E-01', '+3e-01'])
def test_numbers_are_parsed_as_users_write_them(load, number):
    text = yaml.safe_dump(arw(value='?')).replace("'?'", number)
    assert load(text).limits['gyro_x']['N'].value == pytest.approx(0.3 * DEGREE / 60)


def arw(**change):
    return sheet(gyro={'arw': ARW | change})


@pytest.mark.parametrize(
    'document, said',
    [
        (arw(value=-1), r'gyro.arw.value is -1: a positive number'),
        (arw(value='much'), r"gyro.arw.value is 'much': a number is expected"),
        (arw(value=math.nan), r'gyro.arw.value is nan'),
        (
            arw(unit='deg/h'),
            r"gyro.arw: unit 'deg/h' cannot be used here: use one of .*deg/sqrt\(h\)",
        ),
        (arw(sided='one'), r"gyro.arw: 'sided' is unknown"),
        (arw(source='other'), r"gyro.arw.source is 'other': one of sheet"),
        (sheet(gyro={'bias_instability': {'value': 1, 'unit': 'deg/h'}}), 'stated_as is missing'),
        (sheet(accel={'vrw': {'value': 1, 'unit': 'deg/sqrt(h)'}}), r'accel.vrw: unit'),
        (sheet(gyro_w={}), r"'gyro_w' is unknown"),
        (sheet() | {'sources': {'a': {'title': 'X', 'seen': 'no'}}}, r'a.seen is .no.: one of'),
        (sheet() | {'sources': {'a': {'author': 'X'}}}, r"a: 'author' is unknown, use title"),
        (sheet(gyro={'ARW': {}}), r"gyro: 'ARW' is unknown, use arw, noise_density"),
        (sheet(gyro={'noise_density': {'value': 1, 'unit': 'deg/s/sqrt(Hz)'}}), 'sided is missing'),
        (sheet() | {'schema': 'other'}, "schema is 'other'"),
        (sheet() | {'sources': {}}, 'sources is empty'),
        ('[1, 2', 'is not YAML'),
        ('just words', 'keys with values .* are expected'),
        ('', 'keys with values .* are expected'),
        ('!!python/object/apply:os.getcwd []', 'is not YAML'),
        ('x' * 200_000, 'larger than 100000 bytes'),
    ],
)
def test_a_bad_file_is_rejected_with_its_place(load, document, said):
    with pytest.raises(AllanError, match=said):
        load(document)


def test_a_single_axis_takes_precedence_over_its_sensor(load):
    quantity = {'value': 160, 'unit': 'ug/sqrt(Hz)', 'sided': 'two', 'condition': 'typical'}
    imu = load(
        sheet(
            accel={'noise_density': quantity},
            accel_z={'noise_density': quantity | {'value': 190}},
        )
    )
    assert [imu.limits[axis]['N'].stated for axis in ('accel_x', 'accel_y', 'accel_z')] == [
        '160 ug/sqrt(Hz)', '160 ug/sqrt(Hz)', '190 ug/sqrt(Hz)',
    ]  # fmt: skip
    assert imu.limits['accel_z']['N'].condition == 'typical'
    assert imu.limits['accel_z']['N'].source == 'sheet'
    assert 'gyro_x' not in imu.limits


PRODUCT = {
    'schema': SCHEMA, 'name': 'Camera', 'carries': 'bmi055', 'sources': {'manual': {'title': 'M'}},
}  # fmt: skip


def test_a_product_has_the_figures_of_the_sensor_it_carries(load):
    product, sensor = load(PRODUCT), load_sensor('bmi055')
    assert (product.name, product.carries, sensor.carries) == ('Camera', 'BMI055', '')
    assert product.limits == sensor.limits and product.remark == ''
    assert list(product.sources) == ['manual', 'datasheet']


@pytest.mark.parametrize(
    'change, said',
    [
        ({'carries': 'realsense-d435i'}, r"x.yaml.carries: .*d435i.yaml: 'carries' is unknown"),
        ({'carries': 'bmi05'}, r"x.yaml.carries: no datasheet 'bmi05': did you mean .*bmi055"),
        ({'gyro': {}}, r"'gyro' is unknown, use schema, name, .*carries"),
        ({'sources': {}}, 'sources is empty'),
    ],
)
def test_a_bad_product_is_rejected_with_its_place(load, change, said):
    with pytest.raises(AllanError, match=said) as refused:
        load(PRODUCT | change)
    assert '\n' not in str(refused.value)


@pytest.mark.parametrize('name', ['mpu6050', 'MPU_6050', 'Mpu-6050'])
def test_case_and_punctuation_of_a_name_do_not_matter(name):
    assert load_sensor(name).name == 'MPU-6050'


@pytest.mark.parametrize(
    'name, said',
    [
        ('adis1647-3', r"no datasheet 'adis1647-3': did you mean adis16475-3"),
        ('xyz', r"no datasheet 'xyz': choose one of 3dm-gx5-25, .* more\)"),
        # another model is not a misspelling
        *((name, ': choose one of .* more') for name in ('mpu-6500', 'adis16406', 'bmi161')),
        ('/nowhere/none.yaml', 'cannot be read'),
    ],
)
def test_an_unknown_name_is_answered_with_the_nearest(name, said):
    with pytest.raises(AllanError, match=said):
        load_sensor(name)


def test_a_file_in_the_users_folder_has_a_name(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CONFIG_HOME', str(tmp_path))
    folder = tmp_path / 'allan_ros' / 'sensors'
    folder.mkdir(parents=True)
    own = arw() | {'name': 'my own'}
    for name in ('mine', 'adis16475-3'):
        (folder / f'{name}.yaml').write_text(yaml.safe_dump(own))
    assert {'mine', 'adis16475-3'} <= set(sensor_names())
    assert load_sensor('MINE').name == 'my own'
    # it takes precedence over the file of the package
    assert load_sensor('adis16475-3').name == 'my own'


def limits_of(**limits):
    """Return a datasheet that states limits of gyro_x, in SI."""
    stated = {term: Limit(value, f'{value:g} SI') for term, value in limits.items()}
    return Datasheet('X-1', 'Maker', {'a': Source('X-1', 'Rev. A')}, {'gyro_x': stated})


def held(results, **limits):
    return results.against_datasheet(limits_of(**limits), 0.2)


@pytest.mark.parametrize('share, verdict', [(1.0, 'within'), (0.9, 'within'), (0.5, 'exceeds')])
def test_the_complete_interval_decides(small_results, share, verdict):
    n = small_results.axes['gyro_x'].fit.noise['N']
    against = held(small_results, N=n.value * share)
    [entry] = against.datasheet_checks
    assert (entry.axis, entry.quantity, entry.verdict) == ('gyro_x', 'N', verdict)
    new = against.findings[len(small_results.findings) :]
    assert [f.id for f in new] == ['exceeds_limit'] * (verdict == 'exceeds')
    assert all(f.axes == ('gyro_x',) and f.values['reference'] == 'X-1' for f in new)


def test_a_second_datasheet_replaces_the_findings_of_the_first(small_results):
    beyond = held(small_results, N=1e-9)
    assert held(beyond, N=1e-9).findings == beyond.findings
    assert held(beyond, N=1e-4).findings == small_results.findings  # not below a third, either


def test_the_round_trip_of_the_document_is_complete(small_results):
    against = held(small_results, N=1e-9, B=1.0)
    assert [c.verdict for c in against.datasheet_checks] == ['exceeds', 'within']
    assert worst_verdict(against.datasheet_checks) == 'exceeds'
    assert worst_verdict(held(small_results).datasheet_checks) is None
    document = json.loads(json.dumps(results_to_document(against), allow_nan=False))
    assert document['datasheet']['axes']['gyro_x']['N']['verdict'] == 'exceeds'
    assert document['datasheet']['axes']['gyro_x']['N']['unit'] == 'rad/s/sqrt(Hz)'
    again = results_from_document(document)
    assert again.datasheet == against.datasheet and again.margin == against.margin
    assert again.datasheet_checks == against.datasheet_checks
    before = json.loads(json.dumps(results_to_document(small_results)))
    assert results_from_document(before).datasheet is None


def test_noise_far_below_a_datasheet_is_named() -> None:
    def ids(scale: float) -> set[str]:
        batch = ar.simulate(hours=0.05, rate=50, seed=1)
        batch.samples[:, :3] *= scale
        results = ar.analyze(batch).compared(sensor='adis16475-3')
        return {f.id for f in results.findings if f.axes == ('gyro_x',)}

    # N of gyro_x is .8 of the figure
    assert 'below_typical' not in ids(1.0) | ids(0.5)
    assert 'below_typical' in ids(0.3) and 'below_typical' in ids(1.0 / 57.3)
