# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bias at rest: published by the estimator."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy')

from allan_ros.core.estimate import Estimate
from allan_ros.core.imu import ImuBatch
from allan_ros.nodes.messages import bias_message

BIAS = np.array([1e-3, -2e-3, 3e-3])


def biased(batch: ImuBatch) -> ImuBatch:
    """Return the samples with a bias added to the gyro."""
    samples = batch.samples.copy()
    samples[:, :3] += BIAS
    return ImuBatch(batch.stamps_ns, samples, frame_id=batch.frame_id)


def test_the_estimator_publishes_the_bias(graph: Any, still_imu: Callable[..., ImuBatch]) -> None:
    from geometry_msgs.msg import TwistWithCovarianceStamped

    received: list[Any] = []
    graph.run('monitor', **{'estimator.method': 'paper', 'publish.sums_period': 3600.0})
    graph.node.create_subscription(
        TwistWithCovarianceStamped, '/allan_monitor/bias', received.append, 10
    )
    batch = biased(still_imu(12_000))
    graph.send(graph.publisher(), batch)
    graph.model_of(12_000)  # no sums are published after it
    message = graph.until(lambda: received and received[-1])
    angular = message.twist.twist.angular
    found = np.array([angular.x, angular.y, angular.z])
    std = np.sqrt([message.twist.covariance[7 * row] for row in (3, 4, 5)])
    assert np.all(std > 0.0)
    np.testing.assert_array_less(np.abs(found - BIAS), 5.0 * std + 1e-6)
    assert message.header.frame_id == batch.frame_id
    stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    assert batch.stamps_ns[0] < stamp_ns <= batch.stamps_ns[-1]
    value = graph.until(lambda: graph.value('gyro x', 'bias at rest [rad/s]'))
    assert float(value) == pytest.approx(BIAS[0], abs=2e-4)


def test_an_axis_without_a_bias_has_a_variance_of_minus_one() -> None:
    bias = Estimate.normal(0.5, 0.1)
    message = bias_message({'accel_y': bias}, 3 * 10**9 + 7, 'imu')
    assert message.twist.twist.linear.y == 0.5
    diagonal = [message.twist.covariance[7 * row] for row in range(6)]
    assert diagonal == [-1.0, pytest.approx(0.01), -1.0, -1.0, -1.0, -1.0]
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 7)
