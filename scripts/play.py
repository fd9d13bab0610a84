# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publish the Imu messages of a recording, or of a simulated IMU, on `imu/data`.

    python scripts/play.py recording/ --rate 0
    python scripts/play.py --simulate 600 --frequency 200

The messages keep their stamps. The publisher is reliable and keeps all messages until they are
acknowledged. No message is lost at any speed if the subscribers have the same QoS.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import rclpy
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import Imu

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import ImuBatch
from allan_ros.core.noise import Model
from allan_ros.core.simulator import simulate_imu
from allan_ros.readers import ReadOptions, open_recording
from allan_ros.readers.cdr import encode_imus

# noise of a good MEMS IMU in SI
GYRO = [Model.of(N=5e-5, B=2e-5, K=2e-6)] * 3
ACCEL = [Model.of(N=8e-4, B=3e-4, K=2e-5)] * 3

DISCOVERY_S = 1.0
"""Time in s to wait after the discovery of the subscribers, until they discover the publisher."""

POLL_S = 0.05


def batches_of(options: argparse.Namespace) -> Iterator[ImuBatch]:
    if options.simulate:
        now = time.time_ns()
        return simulate_imu(options.simulate, options.frequency, GYRO, ACCEL, start_ns=now)
    return open_recording(options.input, ReadOptions(topic=options.topic)).batches()


def play(
    publisher: Publisher, batches: Iterator[ImuBatch], rate: float, stop: threading.Event
) -> int:
    """Publish the samples at ``rate`` times their real speed, and return their number.

    A ``rate`` of 0 publishes without pauses. While the queue of a reliable subscriber is full,
    `publish` waits and then raises RCLError; the message is then published again.
    """
    played = first_ns = 0
    began = time.monotonic()
    for batch in batches:
        for stamp_ns, payload in zip(batch.stamps_ns.tolist(), encode_imus(batch, 'cdr')):
            first_ns = first_ns or stamp_ns
            if rate:
                due = began + (stamp_ns - first_ns) * 1e-9 / rate
                stop.wait(max(0.0, due - time.monotonic()))
            while not stop.is_set():
                with suppress(rclpy_implementation.RCLError):
                    publisher.publish(bytes(payload))
                    played += 1
                    break
            if stop.is_set():
                return played
    return played


def main() -> int:
    """Play until the end, SIGINT or SIGTERM; return 1 if the recording cannot be read."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument('input', nargs='?', help='recording')
    source.add_argument('--simulate', type=float, metavar='SECONDS', help='simulate an IMU')
    parser.add_argument('--topic', default='', help='Imu topic of the bag, if it has several')
    parser.add_argument('--frequency', type=float, default=200.0, help='of the simulated IMU [Hz]')
    parser.add_argument('--rate', type=float, default=1.0, help='speed; 0: as fast as possible')
    parser.add_argument('--wait', type=int, default=1, help='subscribers to wait for')
    options = parser.parse_args(remove_ros_args(sys.argv)[1:])
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('imu_player', start_parameter_services=False)
    qos = QoSProfile(history=HistoryPolicy.KEEP_ALL)
    how = QoSOverridingOptions.with_default_policies()
    publisher = node.create_publisher(Imu, 'imu/data', qos, qos_overriding_options=how)
    while publisher.get_subscription_count() < options.wait and not stop.wait(POLL_S):
        pass
    stop.wait(DISCOVERY_S)
    began = time.monotonic()
    try:
        played = play(publisher, batches_of(options), options.rate, stop)
    except AllanError as error:
        print(error, file=sys.stderr)
        return 1
    print(f'played {played} messages in {time.monotonic() - began:.2f} s', flush=True)
    while not (stop.is_set() or publisher.wait_for_all_acked(Duration(seconds=POLL_S))):
        pass
    rclpy.shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
