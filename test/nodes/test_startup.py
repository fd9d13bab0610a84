# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node logs what it does at its start, and names the cause of a silent input first."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip('rclpy')

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from allan_ros.core.errors import AllanError
from allan_ros.nodes.__main__ import EXECUTABLES, start

OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'


@pytest.mark.parametrize('name', EXECUTABLES)
def test_help_is_printed_and_unknown_arguments_are_rejected(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for word, code, said in (
        ('--help', 0, 'usage: allan_'),
        ('--typo', 2, 'unrecognized arguments: --typo'),
    ):
        with pytest.raises(SystemExit) as stop:
            start(name, [word])
        shown = capsys.readouterr()
        assert stop.value.code == code and said in shown.out + shown.err


WITHOUT_RCLPY = """
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] == 'rclpy':
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)
sys.meta_path.insert(0, Blocker())
program, *words = sys.argv[1:]
if program == 'ros2':
    import argparse
    from allan_ros.ros2_command import AllanCommand
    parser = argparse.ArgumentParser()
    AllanCommand().add_arguments(parser, 'ros2 allan')
    sys.exit(AllanCommand().main(parser=parser, args=parser.parse_args(words)))
from allan_ros.nodes import __main__
sys.argv[1:] = words
sys.exit(getattr(__main__, program)())
"""


@pytest.mark.parametrize(
    ('words', 'program'),
    [
        ('watch --once', 'allan_watch'),
        ('monitor', 'allan_monitor'),
        ('ros2 check', 'ros2 allan check'),
    ],
)
def test_without_rclpy_a_program_ends_with_one_line(
    words: str, program: str, repository: Path
) -> None:
    environment = {**os.environ, 'PYTHONPATH': str(repository)}
    command = [sys.executable, '-c', WITHOUT_RCLPY, *words.split()]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 1 and done.stdout == ''
    (line,) = done.stderr.splitlines()
    assert line.startswith(f'{program}: rclpy cannot be imported')
    assert "No module named 'rclpy'" in line and 'source the setup file of a ROS 2' in line


@pytest.mark.parametrize(
    ('words', 'reason'),
    [
        ('monitor --ros-args --params-file /no/such.yaml', '/no/such.yaml'),
        ('monitor --ros-args -p checkpoint.period:=-1.0', 'checkpoint.period'),
        ('accumulator --ros-args -p input.topics:=[a,b]', 'use allan_monitor for several IMUs'),
    ],
)
def test_a_node_that_cannot_start_ends_with_one_line(graph, words: str, reason: str) -> None:
    name, *arguments = words.split()
    node = graph.start(name, *arguments)
    assert node.wait() == 1
    assert f'allan_{name} stops: ' in node.output and 'Traceback' not in node.output
    assert reason in node.output


def test_without_its_enclave_a_node_reports_it_and_ends(
    ros_domain: int, tmp_path: Path, repository: Path
) -> None:
    secured = {
        'ROS_SECURITY_ENABLE': 'true',
        'ROS_SECURITY_STRATEGY': 'Enforce',
        'ROS_SECURITY_KEYSTORE': str(tmp_path),
        'PYTHONPATH': os.pathsep.join([str(repository), os.environ.get('PYTHONPATH', '')]),
    }
    command = [sys.executable, '-m', 'allan_ros.nodes', 'relay']
    command += ['--ros-args', '--enclave', '/allan_ros/allan_imu_relay']
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, **secured})
    said = done.stdout + done.stderr
    assert done.returncode == 1, said
    assert f'{tmp_path}/enclaves/allan_ros/allan_imu_relay' in said and 'Traceback' not in said


@pytest.mark.parametrize(
    ('parameters', 'reason'),
    [
        ({'estimator.sensor': 'no-such-imu'}, 'no datasheet'),
        ({'estimator.baseline': '/no/such/results.json'}, 'no such file'),
        ({'input.labels': ('a b',)}, 'letters, digits and underscores'),
        ({'input.accel_topics': ('a', 'b')}, 'accel_topics has 2 entries for 1 topics'),
        ({'relay.enabled': True, 'input.accel_unit': 'g'}, 'cannot be combined with input'),
        ({'push.node': 'imu_filter'}, 'give a full name'),
        ({'push.node': '/a', 'push.filter': 'none-such'}, 'no plan for push.filter'),
        (
            {'push.node': '/a', 'input.topics': ('a', 'b'), 'push.filter': 'noise_densities'},
            'there are 2 IMUs',
        ),
    ],
)
def test_bad_parameters_are_rejected_at_start(graph, parameters, reason: str) -> None:
    with pytest.raises(AllanError, match=reason):
        graph.run('monitor', **parameters)


def test_one_line_states_what_a_node_does(
    graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv('HOME', str(tmp_path))
    checkpoint = tmp_path / 'new' / 'folder' / 'sums.json'
    settings = {'estimator.growth': 0.5, 'checkpoint.path': '~/new/folder/sums.json'}
    graph.run('monitor', **settings, **{'checkpoint.pth': 'x'})
    said = capfd.readouterr().err
    (line,) = [line for line in said.splitlines() if 'monitors' in line]
    assert f'monitors /imu/data (reliable, keep_all; checkpoint {checkpoint})' in line
    assert 'estimator.growth=0.5' in line
    unknown = "parameter 'checkpoint.pth' is unknown and ignored; did you mean checkpoint.path?"
    assert unknown in said
    assert checkpoint.parent.is_dir()


def test_a_topic_of_another_type_is_named_first(graph) -> None:
    graph.node.create_publisher(String, 'imu/data', 10)
    graph.node.create_publisher(Imu, 'camera/imu', 10)
    graph.start('monitor')  # a participant cannot have two types of one topic
    found = graph.until(lambda: graph.value('input', 'finding: wrong_type'))
    assert found.startswith('now: /imu/data has type std_msgs/msg/String, not ')
    assert found.endswith('Remap imu/data to an Imu topic, such as /camera/imu.')
    assert f'now: {graph.status("input").message}' == found


def test_a_qos_that_does_not_fit_is_named_first(graph) -> None:
    graph.node.create_publisher(
        Imu, 'imu/data', QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    graph.run('monitor')
    told = 'The QoS of /test_client is incompatible with the subscription to /imu/data ('
    status = graph.until(lambda: (s := graph.status('input')) and s.message.startswith(told) and s)
    assert 'Best effort publisher and reliable subscription' in status.message


def test_a_jump_of_the_stamps_is_not_a_loss_of_messages(graph, still_imu) -> None:
    graph.run('monitor')
    publisher = graph.publisher()
    graph.send(publisher, still_imu(2000))
    graph.until(lambda: graph.value('input', 'received') == '2000')
    graph.spin(0.5)
    later = still_imu(1000, start_ns=10**18 + 1800 * 10**9, seed=2)
    graph.send(publisher, later)
    status = graph.until(lambda: (s := graph.status('input')).level == WARN and s)
    assert status.message.startswith('The clock of the stamps was set forward by 30 min')
    assert not [v for v in status.values if 'queue' in v.value]


def test_silence_is_an_error_with_its_age_but_not_at_once(graph, still_imu) -> None:
    given = {'relay.enabled': True, 'input.hardware_ids': ('SN-7',), 'input.stale_after': 2.0}
    graph.run('monitor', **given)
    status = graph.until(lambda: graph.status('input'))
    assert status.level == OK and status.message == 'waiting for the first message'
    relay = graph.until(lambda: graph.status('relay'))
    assert relay.level == OK and relay.hardware_id == 'SN-7'

    def error(text: str) -> None:
        graph.until(lambda: text in graph.status('input').message)
        assert graph.status('input').level == ERROR

    error('Nothing publishes on /imu/data.')
    publisher = graph.publisher()
    graph.send(publisher, still_imu(100))
    graph.until(lambda: graph.status('input').level == OK)
    error('No message on /imu/data for')
    assert 'cable' in graph.status('input').message
    graph.node.destroy_publisher(publisher)
    error('its publisher is gone')


def test_units_of_the_driver_are_converted(graph, still_imu, tmp_path: Path) -> None:
    """Samples in deg/s and g give the sums of the same samples in SI."""
    batch = still_imu(3000)
    factor = [180.0 / 3.141592653589793] * 3 + [1.0 / 9.80665] * 3
    batch.samples[:] *= factor
    units = {'input.gyro_unit': 'deg/s', 'input.accel_unit': 'g'}
    checkpoint = tmp_path / 'sums.json'
    graph.run('monitor', **units, **{'checkpoint.path': str(checkpoint)})
    graph.send(graph.publisher(), batch)
    graph.until(lambda: graph.value('input', 'used') == '3000')
    assert graph.call('/allan_monitor/save').success
    sums = json.loads(checkpoint.read_text())['sums'][0]
    # half of the mean square second difference is the variance of white noise
    variance = [x / (2.0 * sums['count'][0]) for x in sums['sum_sq'][0]]
    assert variance == pytest.approx([1e-6] * 3 + [1e-4] * 3, rel=0.5)
