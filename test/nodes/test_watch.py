# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Output of `allan_watch`: at every width, as text, as JSON, and without any status."""

from __future__ import annotations

import io
import json

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from support.node_server import PATIENCE_S

from allan_ros.nodes.watch import (
    StatusRow,
    counts_text,
    most_severe_first,
    picture,
    plain_line,
    row,
)

ADVICE = 'no message on /imu for 3.2 s; look at the driver [and its cable]'


def status(name: str, level: bytes = DiagnosticStatus.OK, message: str = '', **values: str):
    pairs = [KeyValue(key=k.replace('_', ' ', 1), value=v) for k, v in values.items()]
    return DiagnosticStatus(name=name, level=level, message=message, values=pairs)


def gyro(age_s: float = 0.2) -> StatusRow:
    message = 'N 0.1720 deg/sqrt(h), B < 3.10 deg/h from 20.0 min of static data; B shows soon'
    return row(status('allan_monitor: imu gyro x', message=message), age_s)


def rows() -> list[StatusRow]:
    silent = status('allan_monitor: imu input', DiagnosticStatus.ERROR, ADVICE)
    louder = status('robot/allan_estimator: imu gyro y', DiagnosticStatus.WARN, 'N rose')
    late = status('allan_monitor: imu accel z', message='N 0.01')
    return most_severe_first([gyro(), row(louder, 0.4), row(late, 12.3), row(silent, 0.1)])


def drawn(shown: list[StatusRow], columns: int, encoding: str = 'utf-8') -> list[str]:
    console = pytest.importorskip('rich.console')
    file = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    console.Console(width=columns, file=file).print(picture(shown))
    file.seek(0)
    return file.read().splitlines()


def test_the_most_severe_comes_first_and_a_silent_status_is_stale():
    assert [r.level for r in rows()] == ['ERROR', 'STALE', 'WARN', 'ok']
    text = 'allan_ros: 1 ERROR, 1 STALE, 1 WARN, 1 ok; last message 0.1 s ago'
    assert counts_text(rows()) == text
    assert plain_line(rows()[1]) == 'STALE imu accel z: N 0.01 (12 s old)'
    assert plain_line(rows()[2]) == 'WARN  robot/allan_estimator: imu gyro y: N rose'


@pytest.mark.parametrize('columns', [40, 60, 80, 120, 160])
@pytest.mark.parametrize('encoding', ['utf-8', 'ascii'])
def test_every_width_shows_everything(columns: int, encoding: str):
    lines = drawn(rows(), columns, encoding)
    assert max(map(len, lines)) <= columns
    words = ' '.join(' '.join(lines).split())
    for each in rows():
        assert each.level in words
    # brackets are text, not markup; nothing is cut off
    for word in (*ADVICE.split(), '12', '0.1720', '3.10'):
        assert word in words


def test_scripts_get_one_document(graph):
    watch = graph.start('watch', '--json', '--seconds', str(PATIENCE_S))
    publisher = graph.node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    graph.introduce(publisher, wanted=2)
    bad = status('allan_monitor: imu input', DiagnosticStatus.ERROR, ADVICE, rate_Hz='200')
    publisher.publish(DiagnosticArray(status=[bad, status('battery: charge')]))
    assert watch.wait() == 0
    (told,) = json.loads(watch.output)['statuses']
    assert (told['level'], told['node'], told['name']) == ('ERROR', 'allan_monitor', 'imu input')
    assert told['message'] == ADVICE and told['values'] == {'rate Hz': '200'}
    assert 0.0 <= told['age_s'] < PATIENCE_S


def test_without_a_status_the_watch_prints_what_to_check(graph):
    watch = graph.start('watch', '--once', '--seconds', '1')
    assert watch.wait() == 1
    said = ' '.join(watch.output.split())
    assert 'no allan_ros node publishes on /diagnostics. Start one: ros2 launch' in said
    assert 'ROS_DOMAIN_ID=' in said


def test_the_watcher_shows_each_status(graph, still_imu):
    watch = graph.start('watch', '--plain')
    publisher = graph.node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    graph.introduce(publisher, wanted=2)
    good = status('allan_monitor: imu gyro x', message='N 0.172 deg/sqrt(h)')
    bad = status('allan_monitor: input', DiagnosticStatus.ERROR, 'nothing comes')
    publisher.publish(DiagnosticArray(status=[good, bad, status('battery: charge')]))
    graph.until(lambda: 'imu gyro x: N 0.172 deg/sqrt(h)' in watch.output)
    assert watch.stop() == 0
    assert 'ERROR input: nothing comes' in watch.output and 'battery' not in watch.output


def test_a_check_waits_for_every_node(graph):
    """The first node says that all is well; the second one needs some seconds to start."""
    first, late = graph.add_node('allan_monitor'), graph.add_node('allan_imu_relay')
    publishers = [n.create_publisher(DiagnosticArray, '/diagnostics', 10) for n in (first, late)]
    watch = graph.start('watch', '--check', '--seconds', str(PATIENCE_S))
    for publisher in publishers:
        graph.introduce(publisher, wanted=2)
    publishers[0].publish(DiagnosticArray(status=[status('allan_monitor: imu input')]))
    graph.spin(5.0)
    assert watch.poll() is None
    bad = status('allan_imu_relay: relay', DiagnosticStatus.ERROR, 'no model')
    publishers[1].publish(DiagnosticArray(status=[bad]))
    assert watch.wait() == 4, watch.output
    assert 'no model' in watch.output


def test_a_node_without_a_status_is_no_success(graph):
    first, late = graph.add_node('allan_monitor'), graph.add_node('allan_imu_relay')
    publishers = [n.create_publisher(DiagnosticArray, '/diagnostics', 10) for n in (first, late)]
    watch = graph.start('watch', '--check', '--seconds', '8')
    for publisher in publishers:
        graph.introduce(publisher, wanted=2)
    publishers[0].publish(DiagnosticArray(status=[status('allan_monitor: imu input')]))
    assert watch.wait() == 4, watch.output
    assert 'allan_imu_relay: node: runs, but publishes no status' in watch.output
