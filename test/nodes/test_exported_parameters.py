# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exported parameter files are loaded by a node in the same way as by filter nodes."""

from __future__ import annotations

from pathlib import Path

import pytest

from allan_ros.io.exporters import target_of
from allan_ros.io.results import Results

rclpy = pytest.importorskip('rclpy')


@pytest.mark.parametrize(
    ('target', 'node_name', 'parameters'),
    [
        ('lio_sam', 'lio_sam_imuPreintegration', ['imuAccNoise', 'imuGyrBiasN']),
        ('fast_lio', 'laser_mapping', ['mapping.acc_cov', 'mapping.b_gyr_cov']),
        ('imu_filter_madgwick', 'imu_filter', ['gain', 'zeta']),
    ],
)
@pytest.mark.usefixtures('ros_domain')
def test_a_node_finds_its_parameters_as_doubles(
    small_results: Results, tmp_path: Path, target: str, node_name: str, parameters: list[str]
) -> None:
    small_results.export(target, tmp_path)
    path = tmp_path / target_of(target).file_name
    context = rclpy.Context()
    rclpy.init(args=['--ros-args', '--params-file', str(path)], context=context)
    try:
        node = rclpy.create_node(
            node_name, context=context, automatically_declare_parameters_from_overrides=True
        )
        values = [node.get_parameter(name).value for name in parameters]
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    assert all(isinstance(value, float) and value > 0.0 for value in values)
