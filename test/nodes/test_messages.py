# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bias at rest: published by the estimator, subtracted by the relay only where permitted."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy')

from allan_ros.core.imu import ImuBatch
from allan_ros.io.readers.cdr import encode_imus, imu_dtype
from allan_ros.nodes.messages import bias_message

BIAS = np.array([1e-3, -2e-3, 3e-3])


def biased(batch: ImuBatch) -> ImuBatch:
    """Return the samples with a bias added to the gyro."""
    samples = batch.samples.copy()
    samples[:, :3] += BIAS
    return ImuBatch(batch.stamps_ns, samples, frame_id=batch.frame_id)


def rates(payload: bytes) -> np.ndarray:
    frame_bytes = int.from_bytes(payload[12:16], 'little')
    found = np.frombuffer(payload, imu_dtype('cdr', '<', frame_bytes, len(payload)))['gyro'][0]
    return np.asarray(found)


def test_the_estimator_publishes_the_bias(graph: Any, still_imu: Callable[..., ImuBatch]) -> None:
    from geometry_msgs.msg import TwistWithCovarianceStamped

    received: list[Any] = []
    graph.run('monitor', **{'estimator.method': 'relative', 'publish.sums_period': 3600.0})
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
    assert float(graph.value('gyro x', 'bias optimal averaging time [s]')) >= 1.0


def relayed_rates(graph: Any, payloads: list[bytes], bias: Any, **parameters: Any) -> list[Any]:
    """Return the angular velocities of messages after the relay, which knows a bias."""
    from geometry_msgs.msg import TwistWithCovarianceStamped
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import Imu

    from allan_ros.nodes.shell import LATCHED

    source = graph.node.create_publisher(TwistWithCovarianceStamped, 'bias', LATCHED)
    source.publish(bias)  # before the relay starts: later, the robot may not be at rest
    (relay,) = graph.run('relay', **parameters)._parts
    received: list[bytes] = []
    graph.node.create_subscription(
        Imu, 'imu/data_with_covariance', received.append, QoSProfile(depth=100), raw=True
    )
    publisher = graph.publisher()
    graph.introduce(source)
    graph.until(lambda: relay._bias is not None)
    for payload in payloads:
        publisher.publish(payload)
    graph.until(lambda: len(received) == len(payloads))
    return [rates(payload) for payload in received]


def message_at(batch: ImuBatch) -> Any:
    """Return the bias message of the time at which these samples start."""
    from allan_ros.core.filters.bias import AxisBias, BiasEstimate

    known = {
        f'gyro_{a}': AxisBias(BiasEstimate(b, 1e-6), int(batch.stamps_ns[0]), 1.0, 1.0, 1.0)
        for a, b in zip('xyz', BIAS.tolist())
    }
    return bias_message(known, batch.frame_id)


@pytest.mark.parametrize('options', [{'relay.subtract_bias': True}, {}])
def test_the_relay_subtracts_a_fresh_bias_at_rest_only_if_configured(
    graph: Any, still_imu: Callable[..., ImuBatch], options: dict[str, bool]
) -> None:
    batch = biased(still_imu(3))
    samples, stamps = batch.samples.copy(), batch.stamps_ns.copy()
    samples[1, 2] += 1.0  # turning
    stamps[2] += 3600 * 10**9  # an hour later
    sent = [bytes(p) for p in encode_imus(ImuBatch(stamps, samples, None, batch.frame_id), 'cdr')]
    still, turning, stale = relayed_rates(graph, sent, message_at(batch), **options)
    np.testing.assert_allclose(still, samples[0, :3] - BIAS * bool(options), atol=1e-12)
    np.testing.assert_array_equal(turning, samples[1, :3])
    np.testing.assert_array_equal(stale, samples[2, :3])


def test_an_axis_without_a_bias_has_a_variance_of_minus_one() -> None:
    from allan_ros.core.filters.bias import AxisBias, BiasEstimate

    bias = AxisBias(BiasEstimate(0.5, 0.1), 3 * 10**9 + 7, 1.0, 1.0, 1.0)
    message = bias_message({'accel_y': bias}, 'imu')
    assert message.twist.twist.linear.y == 0.5
    diagonal = [message.twist.covariance[7 * row] for row in range(6)]
    assert diagonal == [-1.0, pytest.approx(0.01), -1.0, -1.0, -1.0, -1.0]
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 7)
