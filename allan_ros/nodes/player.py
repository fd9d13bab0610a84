# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan_player`: publish a recorded or simulated IMU, at any speed and without loss."""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from ..core.errors import AllanError
from ..core.imu import ImuBatch
from ..core.noise import NoiseTerms
from ..core.simulate import simulate_imu
from ..io.readers import open_recordings
from ..io.readers.cdr import encode_imus
from ..io.readers.recording import ReadOptions, Recording
from .imu_input import NAMELESS, full_name
from .shell import STEADY, run

CLOCK_PERIOD_S = 0.025
"""Period of `/clock` in s of wall time: 40 Hz, as in ``ros2 bag play``."""

POLL_S = 0.05
"""Period in s at which a thread that waits checks whether the node should stop."""

LINGER_S = 0.5
"""Time in s for which the publisher stays after the end, while subscribers empty their queues."""

SIMULATED = (
    NoiseTerms(Q=0.0, N=5e-5, B=2e-5, K=2e-6, R=0.0),
    NoiseTerms(Q=0.0, N=8e-4, B=3e-4, K=2e-5, R=0.0),
)
"""Noise terms of the simulated gyro (rad/s) and accelerometer (m/s^2), as of a good MEMS IMU."""

CALL_PERIOD_S = 1.0
"""Period in s at which a call is repeated, because answers to undiscovered clients are lost."""

PATIENCE_S = 10.0
"""Longest time in s to wait for the answer of a subscriber."""


@dataclass
class _Subscriber:
    """A subscriber and its answer to a service call; times of the monotonic clock in s."""

    first_call: float
    name: str = ''
    client: Client | None = None
    last_call: float = float('-inf')
    answered: bool = False

    def on_answer(self, _answer: object) -> None:
        """Record that the node has answered."""
        self.answered = True


class Handshake:
    """Waits until at least ``wanted`` subscribers have discovered a publisher.

    A publisher can discover a subscriber before the subscriber discovers the publisher; best effort
    messages are then lost. The handshake calls a service of the subscribing node. Endpoints are
    announced in the order of their creation, so a node that answers has also discovered all
    publishers that are older than the service client. Create the handshake after the publisher, in
    the same node, and call `update` from the thread that runs the executor of that node.
    """

    def __init__(self, node: Node, publisher: Publisher, wanted: int = 1) -> None:
        self._node, self._publisher, self._wanted = node, publisher, wanted
        self._subscribers: dict[bytes, _Subscriber] = {}  # by endpoint gid

    def update(self) -> bool:
        """Call subscribers without an answer; return True if all have answered or timed out."""
        now = time.monotonic()
        known = self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
        done, gids = True, [bytes(subscriber.endpoint_gid) for subscriber in known]
        for gone in self._subscribers.keys() - gids:
            self._remove(gone)
        for gid, endpoint in zip(gids, known):
            subscriber = self._subscribers.setdefault(gid, _Subscriber(now))
            if not subscriber.answered:
                if endpoint.node_name != NAMELESS:
                    subscriber.name = full_name(endpoint)
                    self._call(subscriber, now)
                done = done and now - subscriber.first_call > PATIENCE_S
        return done and self._wanted <= self._publisher.get_subscription_count() <= len(known)

    def restart(self) -> None:
        """Require another answer from each remaining subscriber.

        A subscriber that timed out before is not given more time.
        """
        self._wanted, now = 0, time.monotonic()
        # new objects, because an answer to an earlier call may still arrive
        self._subscribers = {
            gid: _Subscriber(now if s.answered else s.first_call, s.name, s.client)
            for gid, s in self._subscribers.items()
        }

    def unanswered(self) -> tuple[str, ...]:
        """Return the subscribing nodes that have not answered."""
        known = self._subscribers.values()
        return tuple(sorted(s.name or 'an unnamed node' for s in known if not s.answered))

    def close(self) -> None:
        """Destroy the clients."""
        for gid in list(self._subscribers):
            self._remove(gid)

    def _remove(self, gid: bytes) -> None:
        client = self._subscribers.pop(gid).client
        if client is not None:
            self._node.destroy_client(client)

    def _call(self, subscriber: _Subscriber, now: float) -> None:
        if subscriber.client is None:
            service = f'{subscriber.name}/get_parameters'
            subscriber.client = self._node.create_client(GetParameters, service)
        if now - subscriber.last_call >= CALL_PERIOD_S and subscriber.client.service_is_ready():
            subscriber.last_call = now
            answer = subscriber.client.call_async(GetParameters.Request())
            answer.add_done_callback(subscriber.on_answer)


class Player(Node):
    """Publishes the batches of a recording on ``imu/data``.

    The publisher is reliable and keeps all messages until they are acknowledged. If the subscribers
    have the same QoS, a full queue slows the player down, and no message is lost.
    """

    def __init__(self, options: argparse.Namespace, stop: threading.Event) -> None:
        super().__init__('allan_player')
        self._options = options
        self._recordings = None if options.simulate else _open(options)
        qos = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
        overriding = QoSOverridingOptions.with_default_policies()
        self._publisher = self.create_publisher(
            Imu, 'imu/data', qos, qos_overriding_options=overriding
        )
        self._clock = self.create_publisher(Clock, '/clock', 10) if options.clock else None
        self._clock_due = 0.0
        self._stop = stop
        self._error: AllanError | None = None
        self._played = 0
        self._handshake = Handshake(self, self._publisher, options.wait)
        self._asking, self._answered = False, threading.Event()
        self.create_timer(POLL_S, self._tick, clock=STEADY)  # signals are also handled at wake-ups
        source = ' '.join(options.input) if self._recordings else 'a simulated IMU'
        self.get_logger().info(
            f'plays {source} on {self._publisher.topic_name}; '
            f'number of subscribers to wait for: {options.wait}'
        )
        self._thread = threading.Thread(target=self._work)
        self._thread.start()

    def close(self) -> None:
        """Stop playing; raise the error of the recording, if any."""
        self._stop.set()
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _tick(self) -> None:
        """Continue the handshake, in the thread of the executor."""
        if self._asking and self._handshake.update():
            self._asking = False
            self._answered.set()

    def _work(self) -> None:
        """Play to the end and stop the node; runs in a separate thread."""
        try:
            self._wait_for_answers('has missed the start')
            self._play()
            self._wait_for_acknowledgments()
            self._handshake.restart()
            self._wait_for_answers('has received the end')
            self._stop.wait(LINGER_S)
        except AllanError as error:
            self._error = error
        self._stop.set()

    def _play(self) -> None:
        began = time.monotonic()
        rebase = self._options.stamps == 'rebase'
        start_ns = time.time_ns() if rebase else None
        while True:
            length = self._play_once(start_ns)
            if self._stop.is_set():
                return
            took = time.monotonic() - began
            self.get_logger().info(f'played {self._played} messages in {took:.2f} s')
            if not self._options.loop:
                return
            if start_ns is not None:
                start_ns += length

    def _play_once(self, start_ns: int | None) -> int:
        """Play the recording with its first stamp shifted to start_ns; return its length in ns."""
        first_ns = last_ns = origin_ns = count = 0
        began = time.monotonic()
        for batch in self._batches():
            times_ns = batch.stamps_ns if batch.record_ns is None else batch.record_ns
            if not count:
                first_ns, origin_ns = int(batch.stamps_ns[0]), int(times_ns[0])
                began = time.monotonic()
            shift = 0 if start_ns is None else start_ns - first_ns
            due = due_times(times_ns - origin_ns, began, self._options.rate)
            self._publish(replace(batch, stamps_ns=batch.stamps_ns + shift), due)
            if self._stop.is_set():
                return 0
            last_ns, count = int(batch.stamps_ns[-1]), count + len(batch)
        if not count:
            raise AllanError('the recording contains no Imu message: choose another one')
        return last_ns - first_ns + (last_ns - first_ns) // max(count - 1, 1)

    def _publish(self, batch: ImuBatch, due: list[float] | None) -> None:
        """Publish each message at its time in ``due`` (monotonic clock, s); None: at once."""
        for i, payload in enumerate(encode_imus(batch, 'cdr')):
            if due is not None:
                wait = due[i] - time.monotonic()
                if wait > 0 and self._stop.wait(wait):
                    return
            self._send(bytes(payload))
            self._publish_time(int(batch.stamps_ns[i]))
            if self._stop.is_set():
                return

    def _send(self, payload: bytes) -> None:
        """Publish one message; wait while the queue of a reliable subscriber is full."""
        while not self._stop.is_set():
            try:
                self._publisher.publish(payload)
            except rclpy_implementation.RCLError:  # the queue was full for 0.1 s
                continue
            self._played += 1
            return

    def _publish_time(self, stamp_ns: int) -> None:
        now = time.monotonic()
        if self._clock is not None and now >= self._clock_due:
            self._clock_due = now + CLOCK_PERIOD_S
            self._clock.publish(Clock(clock=Time(nanoseconds=stamp_ns).to_msg()))

    def _wait_for_answers(self, event: str) -> None:
        """Wait until all subscribers have answered or timed out; log those without an answer."""
        self._answered.clear()
        self._asking = True
        while not (self._stop.is_set() or self._answered.wait(POLL_S)):
            pass
        for name in () if self._stop.is_set() else self._handshake.unanswered():
            self.get_logger().warning(
                f'{name} subscribes but does not answer: it is unknown whether it {event}'
            )

    def _wait_for_acknowledgments(self) -> None:
        poll = Duration(seconds=POLL_S)
        while not (self._stop.is_set() or self._publisher.wait_for_all_acked(poll)):
            pass

    def _batches(self) -> Iterator[ImuBatch]:
        o = self._options
        if self._recordings is None:
            gyro, accel = ([terms] * 3 for terms in SIMULATED)
            now = time.time_ns()
            yield from simulate_imu(o.simulate, o.frequency, gyro, accel, seed=o.seed, start_ns=now)
            return
        for recording in self._recordings:
            yield from recording.batches()


def due_times(elapsed_ns: NDArray[np.int64], began: float, rate: float) -> list[float] | None:
    """Return the times on the monotonic clock, in s, at which samples are due.

    ``elapsed_ns`` are their times since the first sample, which is due at ``began``. ``rate`` is
    the speed factor; if it is 0, the result is None: all samples are due at once.
    """
    due: list[float] | None = (began + elapsed_ns * (1e-9 / rate)).tolist() if rate else None
    return due


def _open(options: argparse.Namespace) -> list[Recording]:
    if not options.input:
        raise AllanError('nothing to play: name a recording, or give --simulate SECONDS')
    return open_recordings(options.input, ReadOptions(topic=options.topic))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line without ROS arguments."""
    parser = argparse.ArgumentParser(prog='allan_player', description=__doc__)
    add = parser.add_argument
    add('input', nargs='*', help='recording: bag (mcap, sqlite3, ROS 1), CSV or npz')
    add('--topic', default='', help='Imu topic of the bag; needed only if there are several')
    add('--rate', type=_factor, default=1.0, help='speed factor; 0: as fast as possible')
    add('--loop', action='store_true', help='start again at the end')
    rebase = 'keep the recorded stamps, or shift them so that the first is now and loops continue'
    add('--stamps', choices=('keep', 'rebase'), default='keep', help=rebase)
    add('--clock', action='store_true', help='publish /clock from the stamps')
    add('--wait', type=int, default=1, help='number of subscribers to wait for (default 1)')
    add('--simulate', type=float, metavar='SECONDS', help='play a simulated IMU instead')
    add('--frequency', type=float, default=200.0, help='rate of the simulated IMU [Hz]')
    add('--seed', type=int, default=0, help='random seed of the simulated IMU')
    return parser


def _factor(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < float('inf'):
        raise argparse.ArgumentTypeError('give a speed factor of 0 or more')
    return value


def main(args: Sequence[str] | None = None) -> int:
    """Run `allan_player`."""
    return run('allan_player', lambda stop, options: Player(options, stop), make_parser(), args)


if __name__ == '__main__':
    sys.exit(main())
