# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cost of relaying a message with real DDS: latency, CPU time, messages lost in bursts.

    python bench/bench_relay.py      about 2 min

The latency is the time from the call of `publish` until another thread of this process receives the
message. The rows "direct" are for messages that are not relayed. If the latency of "direct" is
high, the machine is busy.
"""

from __future__ import annotations

import json
import os
import struct
import sys
import threading
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from online_nodes import EMPTY_SUBSCRIBER, Client, Process, node

from allan_ros.core.noise import Model
from allan_ros.core.simulator import simulate_imu
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.readers.cdr import CovariancePatch, encode_imus
from allan_ros.readers.recording_sums import Provenance
from allan_ros.results.analysis import analyze_sums
from allan_ros.results.documents import results_to_document

RATES_HZ = (200, 1000)
MEASURE_S = 10.0
SETTLE_S = 2.0
BURST, BURST_PERIOD_S, BURSTS = 400, 0.2, 50
SIMULATED = [Model.of(N=1e-4)] * 3
OUT = 'imu/data_with_covariance'


class Receiver:
    """Receives the messages of a topic in a separate thread, and records their latencies."""

    def __init__(self, client: Client, topic: str) -> None:
        from rclpy.impl.implementation_singleton import rclpy_implementation
        from rclpy.qos import QoSProfile
        from sensor_msgs.msg import Imu

        from allan_ros.nodes.imu_input import NO_CALLBACKS, DrainedGroup

        self.latencies_ns: list[int] = []
        self._handle = client.node.create_subscription(
            Imu,
            topic,
            lambda raw: None,
            QoSProfile(depth=2000),
            callback_group=DrainedGroup(),
            event_callbacks=NO_CALLBACKS,
            raw=True,
        ).handle
        self._imu = Imu
        self._wait_set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, client.node.context.handle)
        threading.Thread(target=self._work, daemon=True).start()

    def _work(self) -> None:
        while True:
            self._wait_set.clear_entities()
            self._wait_set.add_subscription(self._handle)
            self._wait_set.wait(10**8)
            while (taken := self._handle.take_message(self._imu, True)) is not None:
                sec, nanosec = struct.unpack_from('<iI', taken[0], 4)
                self.latencies_ns.append(time.monotonic_ns() - sec * 10**9 - nanosec)


def message() -> tuple[bytearray, str]:
    """Return a serialized Imu message, and the JSON text of a noise model for its frame_id."""
    accumulator = ImuStream()
    for batch in simulate_imu(20.0, 200.0, SIMULATED, SIMULATED, seed=1):
        accumulator.update(batch)
        payload = bytearray(encode_imus(batch[:1], 'cdr')[0])
    accumulator.end()
    results = analyze_sums(accumulator.result().sums, Provenance())
    return payload, json.dumps(results_to_document(results, curves=False))


def send(publisher: Any, payload: bytearray, rate: float, seconds: float) -> int:
    """Publish messages at a rate in Hz for a number of seconds, and return their number."""
    began, count = time.monotonic(), int(rate * seconds)
    for i in range(count):
        wait = began + i / rate - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        publish(publisher, payload)
    return count


def publish(publisher: Any, payload: bytearray) -> None:
    """Publish one message, whose stamp is the time of the monotonic clock."""
    struct.pack_into('<iI', payload, 4, *divmod(time.monotonic_ns(), 10**9))
    publisher.publish(bytes(payload))


def show(name: str, rate: int, latencies_ns: list[int], sent: int, cpu_us: float | None) -> None:
    """Print one line of the table: latencies, CPU time, and number of lost messages."""
    us = np.array(latencies_ns) / 1e3
    cpu = '' if cpu_us is None else f'{cpu_us:.0f}'
    print(
        f'{name:>16} {rate:>6} {np.median(us):>8.0f} {np.percentile(us, 99):>8.0f} '
        f'{us.max():>8.0f} {cpu:>8} {sent - len(us):>6}',
        flush=True,
    )


def main() -> None:
    """Measure messages without relay, with the relay, and with the monitor as relay."""
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import String

    client = Client()
    payload, document = message()
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    client.node.create_publisher(String, 'noise_model', latched).publish(String(data=document))

    patch = CovariancePatch({'gyro': (1e-8,) * 3, 'accel': (1e-8,) * 3})
    raw, began = bytes(payload), time.perf_counter()
    for _ in range(100_000):
        patch.patch(raw)
    print(f'patching alone: {(time.perf_counter() - began) * 10:.2f} us a message')

    print(
        f'{"":>16} {"Hz":>6} {"median":>8} {"p99":>8} {"max [us]":>8} {"CPU [us]":>8} {"lost":>6}'
    )
    direct, relayed = Receiver(client, 'imu/data'), Receiver(client, OUT)
    publisher = client.publisher()
    for rate in RATES_HZ:
        direct.latencies_ns.clear()
        sent = send(publisher, payload, rate, MEASURE_S)
        client.spin(0.5)
        show('direct', rate, list(direct.latencies_ns), sent, None)
    measure('empty subscriber', Process('-c', EMPTY_SUBSCRIBER), client, publisher, payload, direct)
    for name, module, parameters in (
        ('relay', 'relay', ()),
        ('in the monitor', 'monitor', ('relay.enabled:=true',)),
    ):
        with node(module, ros=parameters) as process:
            measure(name, process, client, publisher, payload, relayed, bursts=True)


def measure(
    name: str,
    process: Process,
    client: Client,
    publisher: Any,
    payload: bytearray,
    receiver: Receiver,
    bursts: bool = False,
) -> None:
    """Print latency and CPU time of a process at each rate, and its losses in bursts."""
    before = publisher.get_subscription_count()
    while publisher.get_subscription_count() == before:
        client.spin(0.1)
    client.spin(SETTLE_S)
    for rate in RATES_HZ:
        receiver.latencies_ns.clear()
        cpu_before = process.cpu_s()
        sent = send(publisher, payload, rate, MEASURE_S)
        client.spin(0.5)
        cpu_us = (process.cpu_s() - cpu_before) / sent * 1e6
        show(name, rate, list(receiver.latencies_ns), sent, cpu_us)
    if bursts:
        receiver.latencies_ns.clear()
        for _ in range(BURSTS):
            for _ in range(BURST):
                publish(publisher, payload)
            time.sleep(BURST_PERIOD_S)
        client.spin(2.0)
        lost = BURSTS * BURST - len(receiver.latencies_ns)
        print(f'{name:>16} lost {lost} of {BURSTS} bursts of {BURST}', flush=True)
    elif process.popen.poll() is None:
        process.popen.kill()
        process.popen.wait()


if __name__ == '__main__':
    main()
    sys.stdout.flush()
    os._exit(0)  # the receiving threads do not end
