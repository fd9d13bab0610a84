# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node logs what it does at its start, and names the cause of a silent input first."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip('rclpy')

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
from std_msgs.msg import String

OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'
QUICK = {'publish.diagnostics_period': 0.2, 'publish.sums_period': 0.5}
RELIABLE = {
    'qos_overrides./imu/data.subscription.reliability': 'reliable',
    'qos_overrides./imu/data.subscription.history': 'keep_all',
}


@pytest.mark.parametrize('executable', ['accumulator', 'estimator', 'monitor', 'relay', 'watch'])
def test_help_is_printed_and_unknown_arguments_are_rejected(graph, executable: str) -> None:
    shown, refused = graph.start(executable, '--help'), graph.start(executable, '--typo')
    assert shown.wait() == 0 and 'usage: allan_' in shown.output
    assert refused.wait() == 2 and 'unrecognized arguments: --typo' in refused.output


def test_a_missing_parameter_file_is_one_line(graph) -> None:
    node = graph.start('monitor', '--ros-args', '--params-file', '/no/such.yaml')
    assert node.wait() == 1
    assert 'allan_monitor stops: ' in node.output and 'Traceback' not in node.output


def test_one_line_states_what_a_node_does(graph, tmp_path: Path) -> None:
    checkpoint = tmp_path / 'new' / 'folder' / 'sums.json'
    node = graph.start(
        'monitor',
        **{**RELIABLE, 'estimator.growth': 0.5, 'checkpoint.path': str(checkpoint)},
        **{'checkpoint.pth': 'x'},
    )
    graph.until(lambda: 'did you mean' in node.output)
    (line,) = [line for line in node.output.splitlines() if 'monitors' in line]
    assert f'monitors /imu/data (reliable, keep_all; checkpoint {checkpoint})' in line
    assert 'estimator.growth=0.5' in line
    assert (
        "parameter 'checkpoint.pth' is unknown and ignored; did you mean checkpoint.path?"
        in node.output
    )
    assert checkpoint.parent.is_dir()


def test_the_home_folder_is_expanded(graph, monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    monkeypatch.setenv('HOME', str(tmp_path))
    node = graph.start('monitor', **{'checkpoint.path': '~/imu/sums.json'})
    graph.until(lambda: f'checkpoint {tmp_path}/imu/sums.json' in node.output)
    assert (tmp_path / 'imu').is_dir()


def test_a_topic_of_another_type_is_named_first(graph) -> None:
    graph.node.create_publisher(String, 'imu/data', 10)
    graph.node.create_publisher(Imu, 'camera/imu', 10)
    graph.start('monitor', **QUICK)
    found = graph.until(lambda: graph.value('input', 'finding: wrong_type'))
    assert found.startswith('/imu/data has type std_msgs/msg/String, not sensor_msgs/msg/Imu.')
    assert found.endswith('Remap imu/data to an Imu topic, such as /camera/imu.')
    assert graph.status('input').message == found


def test_a_qos_that_does_not_fit_is_named_first(graph) -> None:
    graph.node.create_publisher(
        Imu, 'imu/data', QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    graph.start('monitor', **QUICK, **RELIABLE)
    told = 'The QoS of /test_client is incompatible with the subscription to /imu/data ('
    status = graph.until(lambda: (s := graph.status('input')) and s.message.startswith(told) and s)
    assert 'Best effort publisher and reliable subscription' in status.message


def test_a_jump_of_the_stamps_is_not_a_loss_of_messages(graph, still_imu) -> None:
    graph.start('monitor', **QUICK, **RELIABLE)
    publisher = graph.publisher()
    graph.send(publisher, still_imu(2000))
    graph.until(lambda: graph.value('input', 'received') == '2000')
    graph.spin(0.5)
    later = still_imu(1000, start_ns=10**18 + 1800 * 10**9, seed=2)
    graph.send(publisher, later)
    status = graph.until(lambda: (s := graph.status('input')).level == WARN and s)
    assert status.message.startswith('The clock of the stamps was set forward by 30 min')
    assert not [v for v in status.values if 'queue' in v.value]


def test_a_start_without_a_driver_is_not_an_error_at_once(graph) -> None:
    given = {'relay.enabled': True, 'input.stale_after': 2.0}
    graph.start('monitor', **QUICK, **given)
    status = graph.until(lambda: graph.status('input'))
    assert status.level == OK and status.message == 'waiting for the first message'
    assert graph.until(lambda: graph.status('relay')).level == OK
    status = graph.until(lambda: (s := graph.status('input')).level == ERROR and s)
    assert status.message.startswith('Nothing publishes on /imu/data.')


def test_units_of_the_driver_are_converted(graph, still_imu, tmp_path: Path) -> None:
    """Samples in deg/s and g give the sums of the same samples in SI."""
    batch = still_imu(3000)
    factor = [180.0 / 3.141592653589793] * 3 + [1.0 / 9.80665] * 3
    batch.samples[:] *= factor
    units = {'input.gyro_unit': 'deg/s', 'input.accel_unit': 'g'}
    checkpoint = tmp_path / 'sums.json'
    graph.start('monitor', **QUICK, **RELIABLE, **units, **{'checkpoint.path': str(checkpoint)})
    graph.send(graph.publisher(), batch)
    graph.until(lambda: graph.value('input', 'used') == '3000')
    assert graph.call('/allan_monitor/save').success
    sums = json.loads(checkpoint.read_text())['sums'][0]
    # half of the mean square second difference is the variance of white noise
    variance = [x / (2.0 * sums['count'][0]) for x in sums['sum_sq'][0]]
    assert variance == pytest.approx([1e-6] * 3 + [1e-4] * 3, rel=0.5)


def test_the_relay_of_other_units_is_rejected(graph) -> None:
    node = graph.start('monitor', **{'relay.enabled': True, 'input.accel_unit': 'g'})
    assert node.wait() == 1 and 'relay.enabled excludes input.gyro_unit' in node.output


def test_the_relay_names_the_serial_number_given(graph) -> None:
    graph.start('monitor', **QUICK, **{'relay.enabled': True, 'input.hardware_ids': ('SN-7',)})
    assert graph.until(lambda: graph.status('relay')).hardware_id == 'SN-7'
