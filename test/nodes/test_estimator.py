# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums become coefficients on /diagnostics and a noise model, in one process or two."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy')

from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.readers.recording_sums import Provenance
from allan_ros.results.analysis import analyze_sums
from allan_ros.results.documents import results_from_document, results_to_document

OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'
N = 1e-3 * 200.0**-0.5
"""N of the gyro axes of the still IMU in rad/s/sqrt(Hz)."""


# the fastest method: these tests are about the time and the use of a fit, not its result
QUICK = {'estimator.method': 'paper'}


def test_two_nodes_make_a_noise_model(graph, still_imu):
    graph.run('accumulator')
    graph.run('estimator', remap={'sums': '/allan_accumulator/sums'})
    models = graph.latched('/allan_estimator/noise_model')
    graph.send(graph.publisher(), still_imu(6000))
    # the first models have too few samples to determine N
    model = graph.until(lambda: models and models[-1]['samples'] >= 5000 and models[-1])
    graph.statuses.clear()
    assert model['schema'] == 'allan_ros/results/3' and model['samples'] <= 6000
    gyro = model['axes']['gyro_x']
    low, high = gyro['noise']['N']['ci95']
    assert low * 0.9 < N < high * 1.1
    assert gyro['white_std_per_sample'] == pytest.approx(gyro['noise']['N']['value'] * 200**0.5)
    assert 'curve' not in gyro
    assert results_from_document(model).identity.frame_id == 'imu'
    status = graph.until(lambda: (s := graph.status('imu gyro x')) and s.message[0] == 'N' and s)
    assert status.name == 'allan_estimator: imu gyro x' and status.level == OK
    assert float(graph.value('gyro x', 'N [rad/s/sqrt(Hz)]')) == pytest.approx(N, rel=0.1)
    assert graph.value('gyro x', 'N verdict') == 'estimated'
    assert graph.value('gyro x', 'K verdict') == 'not observable'
    assert graph.value('gyro x', 'K [deg/h^1.5]').startswith('<')
    assert graph.until(lambda: graph.status('sums')).level == OK


def test_an_estimator_without_sums_reports_it(graph):
    graph.run('estimator', **{'publish.sums_period': 0.1})
    status = graph.until(lambda: (s := graph.status('sums')) and s.level == ERROR and s)
    assert (
        'No Allan sums on /sums' in status.message and 'Start allan_accumulator' in status.message
    )


def test_a_sensor_worse_than_its_datasheet_or_than_it_was_is_warned_of(
    graph, still_imu, tmp_path: Path
):
    stream = ImuStream()
    stream.update(still_imu(6000))
    results = analyze_sums(stream.result().sums, Provenance(), 'likelihood')
    baseline, sheet = tmp_path / 'results.json', tmp_path / 'good.yaml'
    baseline.write_text(json.dumps(results_to_document(results)))
    sheet.write_text(
        'schema: allan_ros/sensor/1\nname: GOOD-1\nsources: {test: {title: a test}}\n'
        'gyro: {arw: {value: 0.3, unit: deg/sqrt(h)}}\n'
        'accel: {vrw: {value: 10.0, unit: m/s/sqrt(h)}}\n'
    )
    worse = still_imu(6000, seed=2)
    worse.samples[:, 1] *= 1.6  # from 0.24 deg/sqrt(h)
    references = {'estimator.baseline': str(baseline), 'estimator.sensor': str(sheet)}
    graph.run('monitor', **references)
    graph.send(graph.publisher(), worse)
    graph.model_of(6000)
    status = graph.until(lambda: (s := graph.status('gyro y')) and s.level == WARN and s)
    assert 'of GOOD-1 by more than 20 %. Check vibration' in status.message
    assert any(str(baseline) in v.key and v.value.startswith('exceeds') for v in status.values)
    assert graph.value('gyro y', 'N against GOOD-1').startswith('exceeds, limit 0.300')
    assert graph.status('gyro x').level == graph.status('accel x').level == OK
    assert graph.value('accel x', 'N against GOOD-1').startswith('within, limit 10')


def test_a_change_of_the_noise_is_found_and_dated(graph, still_imu):
    graph.run('monitor', **QUICK, **{'estimator.recent_window': 60.0})
    publisher = graph.publisher()
    graph.send(publisher, still_imu(6000))
    graph.until(lambda: 'N ' in (graph.status('gyro z').message if graph.status('gyro z') else ''))
    graph.spin(1.0)
    louder = still_imu(4000, start_ns=10**18 + 30 * 10**9, seed=2)
    louder.samples[:, 2] *= 1.5
    graph.send(publisher, louder)
    # until all samples have arrived, the period in which the noise changes contains both levels
    rose = re.compile(r'N rose from 0\.2\d+ deg/sqrt\(h\) to 0\.3\d+ deg/sqrt\(h\) .* ago')
    graph.until(lambda: (s := graph.status('gyro z')).level == WARN and rose.match(s.message))
    assert graph.status('gyro x').level == OK


def test_reset_removes_the_coefficients_and_fit_restores_them(graph, still_imu):
    graph.run('monitor', **QUICK)
    models = graph.latched('/allan_monitor/noise_model')
    publisher = graph.publisher()
    assert not graph.call('/allan_monitor/fit').success
    graph.send(publisher, still_imu(4000))
    graph.until(lambda: models)
    before = len(models)
    graph.until(lambda: graph.call('/allan_monitor/fit').success)  # a periodic fit may be running
    graph.until(lambda: len(models) > before)
    assert graph.call('/allan_monitor/reset').success
    status = graph.until(lambda: (s := graph.status('gyro x')).level == WARN and s)
    assert status.message.startswith('The coefficients were invalidated')
    assert graph.until(lambda: models[-1]['axes'] == {})


def test_several_imus_have_their_labels(graph, still_imu, tmp_path: Path):
    names = {
        'input.topics': ('left/imu', 'right/imu'),
        'input.labels': ('port', 'starboard'),
        'input.hardware_ids': ('P1', 'S2'),
    }
    node = graph.run('monitor', **QUICK, **names, **{'checkpoint.path': str(tmp_path)})
    left, right = graph.publisher('left/imu'), graph.publisher('right/imu')
    sums = graph.latched('/allan_monitor/port/sums')
    models = graph.latched('/allan_monitor/starboard/noise_model')
    graph.send(left, still_imu(3000))
    gyro_only = still_imu(2000, seed=3)
    gyro_only.samples[:, 3:] = np.nan
    graph.send(right, gyro_only)
    graph.until(lambda: sums and models)
    graph.until(lambda: graph.status('port imu accel z') and graph.status('starboard imu gyro x'))
    assert graph.status('starboard imu accel z') is None
    graph.until(lambda: graph.status('port input').hardware_id == 'P1')
    assert graph.call('/allan_monitor/port/save').success
    graph.stop(node)
    saved = {p.stem: json.loads(p.read_text())['sums'][0] for p in tmp_path.glob('*.json')}
    assert {k: v['hardware_id'] for k, v in saved.items()} == {
        'port': 'P1',
        'starboard': 'S2',
    }
