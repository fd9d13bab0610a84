# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A stream of a static IMU, for injecting faults."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np

from allan_ros.core.imu import ImuBatch
from allan_ros.core.simulate import LEVEL
from allan_ros.io.readers.cdr import encode_imus

RATE_HZ = 200.0
PERIOD_NS = round(1e9 / RATE_HZ)
BLOCK = 20
"""Samples per block passed to a fault: a tenth of a second."""
STD = [7e-4] * 3 + [1.1e-2] * 3
"""Standard deviation of a sample in rad/s and m/s^2: N = 5e-5 and 8e-4 at this rate."""


class Stream:
    """Publishes a static IMU in real time, in its own thread and ROS context.

    Attributes
    ----------
    change : callable
        Changes each block before it is sent: set it to inject a fault, and restore `healthy`.
    made, sent : int
        Samples before and after ``change``.
    truth : list of ImuBatch
        The sent samples.
    """

    def __init__(
        self,
        topic: str = 'imu/data',
        frame_id: str = 'imu',
        seed: int = 1,
        subscribers: int = 1,
    ) -> None:
        self.topic, self.frame_id, self._subscribers = topic, frame_id, subscribers
        self.change: Callable[[ImuBatch], ImuBatch] = healthy
        self.made = self.sent = 0
        self.truth: list[ImuBatch] = []
        self.silent = False
        self._rng = np.random.default_rng(seed)
        self._stop = threading.Event()
        self.open()
        self._thread = threading.Thread(target=self._work, daemon=True)

    def open(self) -> None:
        """Create the DDS participant and wait until a subscriber has discovered it."""
        import rclpy
        from rclpy.qos import QoSProfile
        from sensor_msgs.msg import Imu

        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node('driver', context=self._context)
        self._publisher = self._node.create_publisher(Imu, self.topic, QoSProfile(depth=1000))
        while not self._publisher.get_subscription_count():
            time.sleep(0.02)

    def close(self) -> None:
        """Destroy the DDS participant; samples are dropped until it is opened again."""
        self._node.destroy_node()
        self._context.shutdown()

    def begin(self) -> None:
        """Start publishing once the subscribers have been discovered."""
        from rclpy.executors import SingleThreadedExecutor
        from support.handshake import Handshake

        handshake = Handshake(self._node, self._publisher, self._subscribers)
        executor = SingleThreadedExecutor(context=self._context)
        executor.add_node(self._node)
        while not handshake.update():
            executor.spin_once(0.05)
        executor.shutdown()
        handshake.close()
        self._thread.start()

    def end(self) -> None:
        """Stop publishing."""
        self._stop.set()
        self._thread.join()

    def _work(self) -> None:
        began, start_ns = time.monotonic(), time.time_ns()
        while not self._stop.is_set():
            stamps = start_ns + (self.made + np.arange(BLOCK)) * PERIOD_NS
            noise = self._rng.standard_normal((BLOCK, 6)) * STD + np.array(LEVEL)
            due = began + self.made / RATE_HZ
            self.made += BLOCK
            block = self.change(ImuBatch(stamps, noise, frame_id=self.frame_id))
            if self.silent:
                time.sleep(max(0.0, due + BLOCK / RATE_HZ - time.monotonic()))
                continue
            for i, payload in enumerate(encode_imus(block, 'cdr')):
                wait = due + i * BLOCK / len(block) / RATE_HZ - time.monotonic()
                if wait > 0:
                    time.sleep(wait)
                self._publisher.publish(bytes(payload))
            self.sent += len(block)
            self.truth.append(block)


def healthy(block: ImuBatch) -> ImuBatch:
    """Return the block unchanged."""
    return block
