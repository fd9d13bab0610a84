# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start allan_monitor for one or several IMUs, or start its parts as separate processes.

ros2 launch allan_ros allan_ros.launch.py imu:=/camera/imu sensor:=adis16475-3
ros2 launch allan_ros allan_ros.launch.py imu:=/left/imu,/right/imu checkpoint:=/var/lib/imus
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

PACKAGE = 'allan_ros'

ARGUMENTS = {
    'imu': ('imu/data', 'Imu topic, or several separated by commas'),
    'accel': (
        '',
        'accelerometer topic of each IMU, separated by commas, if imu names gyro topics',
    ),
    'labels': ('', 'short name of each IMU, separated by commas; default: from the topics'),
    'namespace': ('', 'namespace of the nodes'),
    'sensor': ('', 'datasheet to compare with: a name in config/sensors, or a file'),
    'baseline': ('', 'earlier results.json to compare with'),
    'checkpoint': (
        '',
        'file that keeps the Allan sums for a restart; a folder for several IMUs',
    ),
    'hardware_id': ('', 'serial number of each IMU, separated by commas'),
    'relay': (
        'false',
        'true: republish the Imu messages with covariances, on imu/data_with_covariance, or on '
        '<imu>_with_covariance for each of several topics',
    ),
    'apart': ('false', 'true: run accumulator, estimator and relay in separate processes'),
    'use_sim_time': ('false', 'true: time comes from /clock'),
}
"""Launch argument -> default and description; `config` is declared separately."""

PARAMETERS = {
    'sensor': 'estimator.sensor',
    'baseline': 'estimator.baseline',
    'checkpoint': 'checkpoint.path',
}
"""Launch argument with one value -> parameter that this value overrides if it is given."""

LISTS = {
    'accel': 'input.accel_topics',
    'labels': 'input.labels',
    'hardware_id': 'input.hardware_ids',
}
"""Launch argument that is a list -> parameter that this list overrides if it is given."""

BOOLEANS = {'true': True, 'yes': True, 'on': True, '1': True}
BOOLEANS |= {'false': False, 'no': False, 'off': False, '0': False}
"""Accepted values of the arguments relay, apart and use_sim_time."""


def boolean(given, name):
    """Return the value of a launch argument as bool; raise RuntimeError for other text."""
    text = given[name].strip().lower()
    if text not in BOOLEANS:
        raise RuntimeError(f'{name}:={given[name]} is not a boolean: give true or false')
    return BOOLEANS[text]


def items(text):
    """Split a text at its commas, and return the items that are not empty."""
    return [word.strip() for word in text.split(',') if word.strip()]


def nodes(context):
    """Return the nodes to start, according to the launch arguments in ``context``."""
    given = {name: LaunchConfiguration(name).perform(context) for name in (*ARGUMENTS, 'config')}
    overrides = {parameter: given[name] for name, parameter in PARAMETERS.items() if given[name]}
    topics = items(given['imu'])
    has_several_imus = len(topics) > 1
    if has_several_imus:
        overrides['input.topics'] = topics
    for name, parameter in LISTS.items():
        if given[name]:
            overrides[parameter] = items(given[name])
    overrides['use_sim_time'] = boolean(given, 'use_sim_time')
    has_relay = boolean(given, 'relay')
    if has_relay:
        overrides['relay.enabled'] = True

    def node(executable, remappings):
        return Node(
            package=PACKAGE,
            executable=executable,
            namespace=given['namespace'],
            parameters=[given['config'], overrides],
            remappings=remappings,
            output='screen',
        )

    imu = ('imu/data', given['imu'])
    if not boolean(given, 'apart'):
        return [node('allan_monitor', [] if has_several_imus else [imu])]
    if has_several_imus:
        raise RuntimeError(f'apart:=true takes one IMU, but imu:={given["imu"]} names several')
    separate_nodes = [
        node('allan_accumulator', [imu]),
        node('allan_estimator', [('sums', 'allan_accumulator/sums')]),
    ]
    if has_relay:
        model = ('noise_model', 'allan_estimator/noise_model')
        bias = ('bias', 'allan_estimator/bias')
        separate_nodes.append(node('allan_imu_relay', [imu, model, bias]))
    return separate_nodes


def generate_launch_description():
    """Return the launch description: the arguments, and the function that returns the nodes."""
    config = PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', 'allan_ros.yaml'])
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            DeclareLaunchArgument(
                'config', default_value=config, description='parameter file of the nodes'
            ),
            OpaqueFunction(function=nodes),
        ]
    )
