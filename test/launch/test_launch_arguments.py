# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every launch argument reaches the right nodes, in real processes.

Needs launch_testing and the installed package, as in a ROS workspace.
"""

import tempfile
import time
import unittest
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('launch_ros', reason='skipped: no launch_ros')
pytest.importorskip('launch_testing', reason='skipped: no launch_testing')
pytest.importorskip('ament_index_python')

import launch_testing
import launch_testing.actions
import launch_testing.asserts
import rclpy
from ament_index_python import PackageNotFoundError, get_package_share_directory
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from rcl_interfaces.srv import GetParameters

import allan_ros
from launch import LaunchDescription

try:
    SHARE = get_package_share_directory('allan_ros')
except PackageNotFoundError:
    pytest.skip('skipped: allan_ros is not installed', allow_module_level=True)

PATIENCE_S = 240.0

CASES = {
    'defaults': ({}, {'/allan_monitor': {'input.topics': ['imu/data']}}, {'/imu/data'}),
    'one_imu': (
        {
            'imu': '/camera/imu',
            'sensor': 'adis16475-3',
            'hardware_id': 'SN1',
            'namespace': 'robot1',
            'use_sim_time': 'true',
        },
        {
            '/robot1/allan_monitor': {
                'estimator.sensor': 'adis16475-3',
                'input.hardware_ids': ['SN1'],
                'use_sim_time': True,
                'relay.enabled': False,
            }
        },
        {'/camera/imu', '/robot1/allan_monitor/noise_model'},
    ),
    'checkpoint_and_relay': (
        {'checkpoint': '{folder}/imu.json', 'relay': 'true'},
        {'/allan_monitor': {'checkpoint.path': '{folder}/imu.json', 'relay.enabled': True}},
        {'/imu/data', '/imu/data_with_covariance'},
    ),
    'config_and_baseline': (
        {'config': '{folder}/config.yaml', 'baseline': '{folder}/results.json'},
        {
            '/allan_monitor': {
                'estimator.growth': 0.25,
                'estimator.baseline': '{folder}/results.json',
            }
        },
        {'/imu/data', '/allan_monitor/noise_model'},
    ),
    'several_imus': (
        {'imu': '/left/imu,/right/imu', 'labels': 'port,starboard', 'hardware_id': 'A,B'},
        {
            '/allan_monitor': {
                'input.topics': ['/left/imu', '/right/imu'],
                'input.labels': ['port', 'starboard'],
                'input.hardware_ids': ['A', 'B'],
            }
        },
        {'/left/imu', '/right/imu', '/allan_monitor/port/sums'},
    ),
    'accel': (
        {'imu': '/gyro', 'accel': '/accel'},
        {'/allan_monitor': {'input.accel_topics': ['/accel']}},
        {'/gyro', '/accel', '/allan_monitor/sums', '/allan_monitor/accel/sums'},
    ),
    'apart': (
        {'imu': '/camera/imu', 'apart': 'true', 'relay': 'true'},
        {
            '/allan_accumulator': {'input.topics': ['imu/data']},
            '/allan_estimator': {'estimator.method': 'likelihood'},
            '/allan_imu_relay': {'relay.horizon': 0.0},
        },
        {'/camera/imu', '/allan_accumulator/sums', '/imu/data_with_covariance'},
    ),
}
"""Case -> arguments; node -> parameters; topics that must exist."""


CONFIG = """/**:
  ros__parameters:
    estimator:
      growth: 0.25
"""


def filled(value, folder):
    return value.replace('{folder}', folder) if isinstance(value, str) else value


@pytest.mark.launch_test
@launch_testing.parametrize('case', list(CASES))
def generate_test_description(case):
    folder = tempfile.mkdtemp(prefix='allan_ros_launch_')
    Path(folder, 'config.yaml').write_text(CONFIG)
    if 'baseline' in CASES[case][0]:
        samples = np.random.default_rng(1).normal(0.0, 1e-3, (6000, 3))
        allan_ros.analyze(samples, rate=100.0).save(folder)
    arguments = {name: filled(value, folder) for name, value in CASES[case][0].items()}
    source = PythonLaunchDescriptionSource(f'{SHARE}/launch/allan_ros.launch.py')
    included = IncludeLaunchDescription(source, launch_arguments=arguments.items())
    return LaunchDescription([included, launch_testing.actions.ReadyToTest()]), {'folder': folder}


class TestArguments(unittest.TestCase):
    def setUp(self):
        rclpy.init()
        self.node = rclpy.create_node('test_client')

    def tearDown(self):
        self.node.destroy_node()
        rclpy.shutdown()

    def until(self, holds):
        deadline = time.monotonic() + PATIENCE_S
        while not (value := holds()):
            assert time.monotonic() < deadline, 'waited too long'
            rclpy.spin_once(self.node, timeout_sec=0.1)
        return value

    def parameters(self, node, names):
        client = self.node.create_client(GetParameters, f'{node}/get_parameters')
        self.until(client.service_is_ready)

        def ask():
            # an answer to a client that the node has not discovered yet is lost
            future = client.call_async(GetParameters.Request(names=names))
            rclpy.spin_until_future_complete(self.node, future, timeout_sec=2.0)
            return future.result() if future.done() else None

        values = self.until(ask).values
        return [rclpy.parameter.parameter_value_to_python(value) for value in values]

    def test_parameters_and_topics(self, case, folder):
        _, nodes, topics = CASES[case]
        for node, wanted in nodes.items():
            found = self.parameters(node, list(wanted))
            found = [list(v) if not isinstance(v, (str, bool, float)) else v for v in found]
            assert found == [filled(value, folder) for value in wanted.values()], (node, found)
        self.until(lambda: topics <= {name for name, _ in self.node.get_topic_names_and_types()})


@launch_testing.post_shutdown_test()
class TestExit(unittest.TestCase):
    def test_every_node_ends_with_code_0(self, proc_info):
        launch_testing.asserts.assertExitCodes(proc_info)
