# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import json

import pytest

from allan_ros.core.errors import AllanError
from allan_ros.core.imu import AXES, from_datasheet
from allan_ros.core.noise import Model
from allan_ros.core.simulator import Faults
from allan_ros.results.simulation import read_noise, results_of_truth, truth_path, write_truth


@pytest.fixture
def read(tmp_path):
    def from_text(text):
        path = tmp_path / 'spec.yaml'
        path.write_text(text)
        return read_noise(path)

    return from_text


def test_a_sensor_sets_its_axes_and_an_axis_takes_precedence(read):
    noise = read('noise: {gyro: {N: 0.3, B: {value: 7, unit: deg/h}}, gyro_z: {N: 0.4, R: -2}}\n')
    assert tuple(noise) == AXES
    n, b = (from_datasheet(t, 'gyro', v) for t, v in (('N', 0.3), ('B', 7)))
    assert noise['gyro_x'] == noise['gyro_y'] == Model.of(N=n, B=b)
    n, r = (from_datasheet(t, 'gyro', v) for t, v in (('N', 0.4), ('R', -2)))
    assert noise['gyro_z'] == Model.of(N=n, B=b, R=r)
    assert noise['accel_x'] == Model.of()


def test_the_truth_file_is_exact(tmp_path):
    noise = {axis: Model.of(Q=1e-7 / 3, N=i + 0.1, R=-i) for i, axis in enumerate(AXES)}
    faults = Faults(drop=0.25, gaps=((1.0, 2.0),))
    path = write_truth(tmp_path / 'a.csv', noise, seconds=9.5, rate=100.0, seed=4, faults=faults)
    assert path == truth_path(tmp_path / 'a.csv') == tmp_path / 'a.csv.truth.json'
    assert read_noise(path) == noise
    document = json.loads(path.read_text())
    assert document['faults'] == {'drop': 0.25, 'gaps': [[1.0, 2.0]]}
    assert (document['seconds'], document['rate_hz'], document['seed']) == (9.5, 100.0, 4)


@pytest.mark.parametrize(
    'text, said',
    [
        ('gyro: {N: 1}', "'gyro' is unknown, use noise, faults"),
        ('noise: {gyros: {N: 1}}', "'gyros' is unknown, use gyro, accel, gyro_x"),
        ('noise: {gyro: {n: 1}}', r"gyro: 'n' is unknown, use Q, N, B, K, R"),
        ('noise: {gyro: {N: -1}}', r'gyro: N is -0.0002\d*: give a finite number of 0 or above'),
        ('noise: {gyro: {N: .inf}}', r'gyro.N is a number beyond 1.8e308: a number from'),
        ('noise: {gyro: {N: {value: 1}}}', r'gyro.N: unit is missing'),
        ('noise: {gyro: {N: {value: 1, unit: ug}}}', r"gyro.N: unit 'ug' cannot be used here"),
        ('noise: {gyro: 3}', r'gyro is 3: an object is expected'),
        ('faults: {drop: 2}', r'spec.yaml.faults: drop is 2: it must lie between 0 and 1'),
        ('faults: {drop: high}', r"drop is 'high': a number is expected"),
        ('faults: {gaps: [[1, -2]]}', r'length of gaps is -2: it must lie between'),
        ('faults: {gap: 1}', r"option 'gap' is unknown: use gaps"),
        ('schema: other/1\nnoise: {}', "schema is 'other/1'"),
    ],
)
def test_a_bad_specification_is_rejected_with_its_place(read, text, said):
    with pytest.raises(AllanError, match=said):
        read(text)


@pytest.mark.parametrize(('key', 'value'), [('rate_hz', 0), ('rate_hz', -100.0), ('seconds', -1)])
def test_a_truth_file_with_an_impossible_rate_or_duration_is_rejected(tmp_path, key, value):
    noise = dict.fromkeys(AXES, Model())
    path = write_truth(tmp_path / 'x', noise, seconds=9.0, rate=100.0, seed=3, faults=Faults())
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(AllanError, match=key):
        results_of_truth(path)


def test_a_fault_whose_name_is_no_text_is_rejected(tmp_path):
    path = tmp_path / 'noise.truth.json'
    path.write_text('{schema: allan_ros/truth/1, seconds: 3, rate_hz: 3, faults: {1: 2}}')
    with pytest.raises(AllanError, match='option 1 is unknown'):
        results_of_truth(path)
