# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node like a filter: its parameters have ranges, and can be set or rejected at run time."""

from __future__ import annotations

import rclpy
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node


def main() -> None:
    """Declare gain, zeta (range 0 to 1e-3), three densities, an integer, and one that is fixed."""
    rclpy.init()
    node = Node('imu_filter')
    small = ParameterDescriptor(
        floating_point_range=[FloatingPointRange(from_value=0.0, to_value=1e-3)]
    )
    node.declare_parameter('gain', 0.1)
    node.declare_parameter('zeta', 0.0, small)
    node.declare_parameter('densities', [0.1, 0.2, 0.3])
    node.declare_parameter('count', 3)
    node.declare_parameter('fixed', 1.0)

    def on_set(parameters: list) -> SetParametersResult:
        """Reject changes of the fixed parameter."""
        if any(p.name == 'fixed' for p in parameters):
            return SetParametersResult(successful=False, reason='fixed is not for you')
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)
    rclpy.spin(node)


if __name__ == '__main__':
    main()
