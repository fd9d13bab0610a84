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

from allan_ros.core.errors import AllanError
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.io.analysis import analyze_sums
from allan_ros.io.documents import results_from_document, results_to_document
from allan_ros.io.recorded import Provenance

OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'
N = 1e-3 * 200.0**-0.5
"""N of the gyro axes of the still IMU in rad/s/sqrt(Hz)."""

# the fastest method: these tests are about the time and the use of a fit, not its result
QUICK = {'estimator.method': 'relative'}


def test_two_processes_make_a_noise_model(graph, still_imu):
    graph.start('accumulator')
    graph.start('estimator', remap={'sums': '/allan_accumulator/sums'})
    models = graph.latched('/allan_estimator/noise_model')
    graph.send(graph.publisher(), still_imu(6000))
    # the first models have too few samples to determine N
    model = graph.until(lambda: models and models[-1]['samples'] >= 5000 and models[-1])
    graph.statuses.clear()
    assert model['schema'] == 'allan_ros/results/2' and model['samples'] <= 6000
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
        'No Allan variance sums on /sums' in status.message
        and 'Start allan_accumulator' in status.message
    )


def test_sums_that_cannot_be_read_do_not_stop_the_node(graph):
    from std_msgs.msg import String

    from allan_ros.nodes.shell import LATCHED

    graph.run('estimator')
    publisher = graph.node.create_publisher(String, 'sums', LATCHED)
    graph.introduce(publisher)
    for text in ('nonsense', '[' * 100_000, '{"schema": "allan_ros/sums_file/2", "sums": [3]}'):
        graph.statuses.clear()
        publisher.publish(String(data=text))
        status = graph.until(lambda: (s := graph.status('sums')) and s.level == ERROR and s)
        assert 'cannot be read' in status.message


def test_a_sensor_worse_than_its_datasheet_is_warned_of(graph, still_imu, tmp_path: Path):
    sheet = tmp_path / 'good.yaml'
    sheet.write_text(
        json.dumps(
            {
                'schema': 'allan_ros/sensor/1',
                'name': 'GOOD-1',
                'sources': {'test': {'title': 'a test'}},
                'gyro': {'arw': {'value': 0.05, 'unit': 'deg/sqrt(h)'}},
                'accel': {'vrw': {'value': 10.0, 'unit': 'm/s/sqrt(h)'}},
            }
        )
    )
    graph.run('monitor', **{'estimator.sensor': str(sheet)})
    graph.send(graph.publisher(), still_imu(6000))
    status = graph.until(lambda: (s := graph.status('gyro x')) and s.level == WARN and s)
    assert re.match(
        r'N is 0\.2\d+ deg/sqrt\(h\) \(.*\), above the 0\.0500 .* GOOD-1', status.message
    )
    assert 'Check vibration' in status.message
    assert graph.status('accel x').level == OK
    assert graph.value('accel x', 'N against GOOD-1').startswith('within, limit 10')


def test_a_sensor_worse_than_it_was_is_warned_of(graph, still_imu, tmp_path: Path):
    def results_of(batch):
        accumulator = ImuStream()
        accumulator.update(batch)
        accumulator.end()
        return analyze_sums(accumulator.result().sums, Provenance(), 'likelihood')

    baseline = tmp_path / 'results.json'
    baseline.write_text(json.dumps(results_to_document(results_of(still_imu(6000)))))
    worse = still_imu(6000, seed=2)
    worse.samples[:, 1] *= 1.6
    graph.run('monitor', **{'estimator.baseline': str(baseline)})
    graph.send(graph.publisher(), worse)
    status = graph.until(lambda: (s := graph.status('gyro y')) and s.level == WARN and s)
    assert str(baseline) in status.message
    assert graph.status('gyro x').level == OK


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
    graph.send(right, still_imu(2000, seed=3))
    graph.until(lambda: sums and models)
    graph.until(lambda: graph.status('port imu gyro x') and graph.status('starboard imu accel z'))
    graph.until(lambda: graph.status('port input').hardware_id == 'P1')
    assert graph.call('/allan_monitor/port/save').success
    graph.stop(node)
    saved = {p.stem: json.loads(p.read_text())['sums'][0] for p in tmp_path.glob('*.json')}
    assert {k: v['hardware_id'] for k, v in saved.items()} == {
        'port': 'P1',
        'starboard': 'S2',
    }


def test_a_halved_rate_and_a_stuck_axis_are_reported(graph, still_imu):
    graph.run('monitor', **QUICK)
    publisher = graph.publisher()
    graph.send(publisher, still_imu(4000))
    graph.until(lambda: graph.value('input', 'rate') == '200')
    second = 10**9
    graph.send(publisher, still_imu(3000, rate=100.0, start_ns=10**18 + 20 * second, seed=2))
    said = graph.until(lambda: graph.value('input', 'finding: rate_changed'))
    assert 'is now 100 Hz' in said and graph.status('input').level == WARN
    stuck = still_imu(2000, rate=100.0, start_ns=10**18 + 50 * second, seed=3)
    stuck.samples[:, 4] = stuck.samples[0, 4]
    graph.send(publisher, stuck)
    said = graph.until(lambda: graph.value('input', 'finding: stuck'))
    assert 'An axis repeated one value' in said


@pytest.mark.parametrize(
    ('name', 'value', 'reason'),
    [
        ('estimator.sensor', 'no-such-imu', 'no datasheet'),
        ('estimator.baseline', '/no/such/results.json', 'no such file'),
        ('input.labels', ('a b',), 'letters, digits and underscores'),
        ('input.accel_topics', ('a', 'b'), 'input.accel_topics has 2 entries for 1 topics'),
    ],
)
def test_bad_references_are_rejected(graph, name: str, value: object, reason: str):
    with pytest.raises(AllanError, match=reason):
        graph.run('monitor', **{name: value})


def test_an_absent_sensor_has_no_status(graph, still_imu):
    gyro_only = still_imu(4000)
    gyro_only.samples[:, 3:] = np.nan
    graph.run('monitor', **QUICK)
    graph.send(graph.publisher(), gyro_only)
    graph.until(lambda: graph.status('gyro x'))
    assert graph.status('accel x') is None
