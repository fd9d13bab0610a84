# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes like filters, whose parameters are set: run with the name of one of them.

``imu_filter`` declares parameters with ranges, and rejects one. ``imu_filter_madgwick`` estimates
the orientation as the filter of imu_tools does, and publishes the angle between the estimated and
the true vertical of an IMU that lies level.
"""

from __future__ import annotations

import sys

import numpy as np
import rclpy
from rcl_interfaces.msg import (
    FloatingPointRange,
    ParameterDescriptor,
    ParameterEvent,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64

EVERY = 100
"""Number of samples for each published tilt."""


def imu_filter() -> Node:
    """Declare gain, zeta (range 0 to 1e-3), three densities, an integer, and one that is fixed."""
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
    return node


def product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the product of two quaternions (w, x, y, z)."""
    scalar = p[0] * q[0] - p[1:] @ q[1:]
    return np.concatenate([[scalar], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])])


class Madgwick(Node):
    """Madgwick's filter without a magnetometer, with the default gain of imu_tools.

    The orientation q minimizes f(q) = R(q)' z - a, the difference of the predicted and the measured
    direction of gravity in the frame of the sensor. Each sample integrates the angular rate and
    takes a step of length ``gain`` against the gradient J' f of |f|^2 / 2:
    dq/dt = q * (0, omega) / 2 - gain J' f / |J' f|.
    """

    def __init__(self) -> None:
        super().__init__('imu_filter_madgwick')
        self.declare_parameter('gain', 0.1)
        self.declare_parameter('zeta', 0.0)
        self.gain = 0.1
        self.q = np.array([1.0, 0.0, 0.0, 0.0])
        self.last_s: float | None = None
        self.tilts: list[float] = []
        keep_all = QoSProfile(history=HistoryPolicy.KEEP_ALL)
        self.create_subscription(Imu, 'imu/data', self.on_imu, keep_all)
        self.create_subscription(ParameterEvent, '/parameter_events', self.on_event, 100)
        self.tilt = self.create_publisher(Float64, 'tilt', keep_all)

    def on_event(self, event: ParameterEvent) -> None:
        """Apply the gain of any node, as imu_tools does."""
        for parameter in event.changed_parameters:
            if parameter.name == 'gain':
                self.gain = parameter.value.double_value

    def on_imu(self, message: Imu) -> None:
        """Update the orientation; publish the largest tilt of the last samples, in degrees."""
        time_s = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        dt = 0.0 if self.last_s is None else time_s - self.last_s
        self.last_s = time_s
        rate, force = message.angular_velocity, message.linear_acceleration
        measured = np.array([force.x, force.y, force.z])
        measured /= np.linalg.norm(measured)
        w, x, y, z = self.q
        vertical = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
        # derivatives of `vertical` by w, x, y, z
        jacobian = 2.0 * np.array([[-y, z, -w, x], [x, w, z, y], [0.0, -2 * x, -2 * y, 0.0]])
        gradient = jacobian.T @ (vertical - measured)
        step = gradient / max(float(np.linalg.norm(gradient)), 1e-12)
        change = 0.5 * product(self.q, np.array([0.0, rate.x, rate.y, rate.z])) - self.gain * step
        self.q = self.q + change * dt
        self.q /= np.linalg.norm(self.q)
        _, x, y, _ = self.q
        self.tilts.append(float(np.degrees(2.0 * np.arcsin(np.hypot(x, y)))))
        if len(self.tilts) == EVERY:
            self.tilt.publish(Float64(data=max(self.tilts)))
            self.tilts.clear()


def main() -> None:
    """Run the node that the command line names."""
    rclpy.init()
    rclpy.spin(imu_filter() if sys.argv[1] == 'imu_filter' else Madgwick())


if __name__ == '__main__':
    main()
