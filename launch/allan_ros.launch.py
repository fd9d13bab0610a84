# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Watch one IMU: allan_monitor, or the nodes it is made of apart.

ros2 launch allan_ros allan_ros.launch.py imu:=/camera/imu sensor:=adis16475-3
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

PACKAGE = 'allan_ros'

ARGUMENTS = {
    'imu': ('imu/data', 'Imu topic to watch'),
    'namespace': ('', 'namespace of the nodes'),
    'sensor': ('', 'datasheet to compare with: a name in config/sensors, or a file'),
    'baseline': ('', 'results.json of a former run to compare with'),
    'checkpoint': ('', 'file in which the sums survive a restart'),
    'hardware_id': ('', 'serial number of the IMU'),
    'relay': ('false', 'true: hand the Imu on with covariances, to imu/data_with_covariance'),
    'apart': ('false', 'true: accumulator, estimator and relay in processes of their own'),
    'use_sim_time': ('false', 'true: time comes from /clock'),
}
"""Argument -> its default and what it is; `config` is declared beside them."""

PARAMETERS = {
    'sensor': 'estimator.sensor',
    'baseline': 'estimator.baseline',
    'checkpoint': 'checkpoint.path',
}
"""Argument -> the parameter it sets where it is given; else the configuration file decides."""


def nodes(context):
    """Return the nodes that the arguments ask for."""
    given = {name: LaunchConfiguration(name).perform(context) for name in (*ARGUMENTS, 'config')}
    overrides = {parameter: given[name] for name, parameter in PARAMETERS.items() if given[name]}
    if given['hardware_id']:
        overrides['input.hardware_ids'] = [given['hardware_id']]
    overrides['use_sim_time'] = given['use_sim_time'].lower() == 'true'
    relay = given['relay'].lower() == 'true'
    if relay:
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
    if given['apart'].lower() != 'true':
        return [node('allan_monitor', [imu])]
    apart = [
        node('allan_accumulator', [imu]),
        node('allan_estimator', [('sums', 'allan_accumulator/sums')]),
    ]
    if relay:
        model = ('noise_model', 'allan_estimator/noise_model')
        apart.append(node('allan_imu_relay', [imu, model]))
    return apart


def generate_launch_description():
    """Return the arguments and what they start."""
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
