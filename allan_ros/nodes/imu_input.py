# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Receives Imu messages without a callback for each message.

A Python callback for each message costs more than all other processing. A thread therefore fetches
the queued messages several times a second with ``take_message``, an undocumented method of rclpy.
If a version of rclpy does not have this method, a callback receives the same bytes.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import Any

import numpy as np
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import (
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from sensor_msgs.msg import Imu

from ..core.errors import one_line
from ..core.findings import Finding, finding
from ..core.imu import NANOSECONDS, ImuBatch, sample_factors
from ..core.stream.transport import Arrivals, ConstantAxes, TransportStatistics
from ..readers.cdr import IMU_TYPE, MalformedMessage, decode_imus, is_imu
from .node_settings import InputSettings

try:
    from rclpy.event_handler import (
        QoSSubscriptionEventType,
        SubscriptionEventCallbacks,
        UnsupportedEventTypeError,
    )
except ImportError:  # in Humble, the module has another name
    from rclpy.qos_event import (
        QoSSubscriptionEventType,
        SubscriptionEventCallbacks,
        UnsupportedEventTypeError,
    )


QUEUE_DEPTH = 5000
"""Depth of the subscription's queue in messages; ``qos_overrides`` can change it. Fast DDS keeps at
most this number of messages, which is 0.25 s of messages at 20 kHz, or about 2.5 MB."""

FETCH_S, FETCH_SHARE = 0.1, 0.25
"""Longest time in s between two fetches, and largest share of the queue that fills meanwhile if the
rate of the messages stays the same."""

BUFFER_BYTES, MESSAGE_BYTES = 2**26, 120
"""Largest total size in bytes of the fetched messages that are not decoded yet, and number of bytes
that Python adds to each payload. The total size suffices for 7 s of messages at 20 kHz, or 12 min
at 200 Hz. If the node decodes nothing for a longer time, further messages stay in the queue.
Messages that do not fit into the queue are lost; they are counted if the middleware reports them or
numbers the messages."""

NAMELESS = '_NODE_NAME_UNKNOWN_'
"""Node name that the ROS graph returns for an endpoint of an unknown node."""

SUGGESTED_TOPICS = 5
"""Largest number of Imu topics that a message suggests if the given topic has another type."""

FIRST_NUMBER = 1
"""Publication sequence number of a publisher's first message (RTPS 2.5, 8.3.5.4)."""

NO_CALLBACKS = SubscriptionEventCallbacks(use_default_callbacks=False)
"""Prevents rclpy from registering callbacks of events, which would wake the executor."""

_EVENT_HANDLE: Any = getattr(
    rclpy_implementation, 'EventHandle', getattr(rclpy_implementation, 'QoSEvent', None)
)
"""Class of rclpy with which an event is polled. In Humble, its name is `QoSEvent`. None if this
version of rclpy has no such class."""


class DrainedGroup(CallbackGroup):
    """A callback group that never permits execution, so that the executor ignores a subscription.

    rclpy requires the methods of this class.
    """

    def can_execute(self, entity: Any) -> bool:
        """Return False, because the executor must not take messages of this subscription."""
        return False

    beginning_execution = can_execute

    def ending_execution(self, entity: Any) -> None:
        """Do nothing, because no execution ever begins."""


def qos_text(qos: QoSProfile) -> str:
    """Return the reliability and history of a QoS profile, for the log."""
    history = qos.history.name.lower()
    depth = f' {qos.depth}' if history == 'keep_last' else ''
    return f'{qos.reliability.name.lower()}, {history}{depth}'


def _loss_event(subscription: Subscription) -> Any:
    """Return a handle for polling the number of messages that the middleware has lost.

    Returns None if the middleware does not count lost messages, or if rclpy cannot poll the event.
    The event is polled, because with Fast DDS, an executor that waits for such an event wakes again
    and again while the subscription has unread messages.
    """
    event_type = QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
    try:
        with subscription.handle:
            return _EVENT_HANDLE(subscription.handle, event_type)
    except (TypeError, UnsupportedEventTypeError):
        return None


def _take(subscription: Subscription) -> Any:
    """Return the bytes of the next message in the queue, and a dict of information about it.

    The result is None if the queue is empty.
    """
    return subscription.handle.take_message(Imu, True)


def subscribe_raw(
    node: Node, topic: str, callback: Callable[..., None], depth: int, plain: bool
) -> tuple[Subscription, bool]:
    """Subscribe to an Imu topic as raw bytes.

    Returns the subscription, and whether the caller must fetch the messages from its queue. If
    ``plain`` is True, or if this version of rclpy cannot fetch messages, the executor calls
    ``callback`` with the bytes of each message instead. ``depth`` is the depth of the queue.
    """
    # Unless qos_overrides change it, this best-effort subscription connects to every Imu publisher.
    # Reliable publishers still deliver to it in order.
    qos = QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT
    )
    subscription = node.create_subscription(
        Imu,
        topic,
        callback,
        qos,
        callback_group=MutuallyExclusiveCallbackGroup() if plain else DrainedGroup(),
        event_callbacks=NO_CALLBACKS,
        qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        raw=True,
    )
    if plain:
        return subscription, False
    try:
        message = _take(subscription)
    except (AttributeError, TypeError):
        node.destroy_subscription(subscription)
        return subscribe_raw(node, topic, callback, depth, True)
    if message is not None:
        callback(*message)
    return subscription, True


@dataclass
class _Buffer:
    """Fetched messages that are not decoded yet, and counts of missing messages."""

    payloads: list[bytes] = field(default_factory=list)
    # times of reception by the system clock, and by a clock that is never set
    received_ns: list[int] = field(default_factory=list)
    arrived_s: list[float] = field(default_factory=list)
    size: int = 0  # size of all messages in bytes
    sent_before: int = 0  # number of messages sent before the first received message
    skipped_numbers: int = 0  # number of missing sequence numbers of the publishers


class ImuInput:
    """Subscribes to the Imu messages of one topic, and decodes them; the topic may be remapped.

    ``polled`` is True if a thread fetches the messages, and False if a callback receives the
    messages. ``constant`` finds axes whose values no longer change.
    """

    def __init__(self, node: Node, topic: str, settings: InputSettings) -> None:
        self._statistics = TransportStatistics()
        self._node = node
        self._buffer = _Buffer()
        self._lock = threading.Lock()  # protects the buffer and the queue
        self._error: Exception | None = None  # error in the thread; `batches` raises it
        self._closed = threading.Event()
        self._drained_s = steady_s()
        self._arrivals = Arrivals(self._statistics)
        self.constant = ConstantAxes()
        self._last_number: dict[bytes, int | None] = {}
        self._publisher_count, self._has_one_publisher = 1, True
        self._scale = sample_factors(settings.gyro_unit, settings.accel_unit)
        self._subscription, self.polled = subscribe_raw(
            node, topic, self._collect, QUEUE_DEPTH, plain=False
        )
        self.topic = self._subscription.topic_name
        self._loss = _loss_event(self._subscription)
        self._thread = threading.Thread(target=self._fetch, daemon=True)
        if self.polled:
            self._thread.start()

    def drain(self) -> None:
        """Fetch at most `QUEUE_DEPTH` messages from the queue, if the input is ``polled``.

        When the buffer of fetched messages is full, further messages stay in the queue.
        """
        if self.polled:
            with self._lock:
                self._take_all()

    def _fetch(self) -> None:
        """Fetch messages repeatedly, so often that the queue rarely becomes full."""
        wait_s = FETCH_S
        while not self._closed.wait(wait_s):
            last_drain_s, last_count = self._drained_s, self.received
            try:
                self.drain()
            except rclpy_implementation.InvalidHandle:  # the node was destroyed
                return
            except Exception as error:
                self._error = error
            rate = (self.received - last_count) / max(self._drained_s - last_drain_s, 1e-3)
            wait_s = min(FETCH_S, FETCH_SHARE * QUEUE_DEPTH / max(rate, 1.0))

    def _take_all(self) -> None:
        """Move up to `QUEUE_DEPTH` messages from the queue to the buffer, while it has space."""
        # The queue may still contain messages of a publisher that has left since the last call.
        count = self._node.count_publishers(self.topic)
        self._has_one_publisher = max(count, self._publisher_count) <= 1
        self._publisher_count = count
        if not self._has_one_publisher and b'' in self._last_number:
            self._last_number[b''] = None
        handle, buffer = self._subscription.handle, self._buffer
        former_length = len(buffer.received_ns)
        with handle:
            for _ in range(QUEUE_DEPTH):  # a fast publisher must not block the node
                if buffer.size >= BUFFER_BYTES:
                    break
                message = handle.take_message(Imu, True)
                if message is None:
                    break
                self._collect(*message)
        # The times of reception are from the system clock, which may have been set since the last
        # call. They are therefore limited to the time since the last call.
        now_s = steady_s()
        received_s = np.array(buffer.received_ns[former_length:], np.int64) / NANOSECONDS
        arrived_s = np.clip(received_s - (time.time() - now_s), self._drained_s, now_s)
        buffer.arrived_s += arrived_s.tolist()
        self._drained_s = now_s

    def batches(self) -> Iterator[ImuBatch]:
        """Decode the messages received since the last call, and yield their samples in SI.

        All samples of a batch have the same frame_id. Malformed messages are counted and excluded.
        If the thread that fetches messages has failed since the last call, its exception is raised.
        """
        error, self._error = self._error, None
        if error is not None:
            raise error
        with self._lock:
            buffer, self._buffer = self._buffer, _Buffer()
            self._statistics.received += len(buffer.payloads)
        self._statistics.sent_before += buffer.sent_before
        self._statistics.skipped_numbers += buffer.skipped_numbers
        payloads, received_ns = buffer.payloads, np.array(buffer.received_ns, np.int64)
        arrived_s = np.array(buffer.arrived_s)
        try:
            decoded = decode_imus(payloads, 'cdr')
        except MalformedMessage:
            is_valid = [is_imu(payload, 'cdr') for payload in payloads]
            self._statistics.malformed += is_valid.count(False)
            decoded = decode_imus(list(compress(payloads, is_valid)), 'cdr')
            received_ns, arrived_s = (x[np.array(is_valid, bool)] for x in (received_ns, arrived_s))
        self._arrivals.update(decoded.stamps_ns, arrived_s)
        if len(received_ns):
            self.constant.update(decoded.samples)
        for batch in decoded.batches(received_ns):
            yield replace(batch, samples=batch.samples * self._scale)

    def publishers(self) -> tuple[tuple[str, ...], tuple[Finding, ...]]:
        """Return the names of the nodes that publish on the topic, and findings.

        A finding reports that all publishers have another message type, or that an Imu publisher
        has an incompatible QoS.
        """
        endpoints = self._node.get_publishers_info_by_topic(self.topic)
        return tuple(map(full_name, endpoints)), self._mismatches(endpoints)

    def _mismatches(self, publishers: Sequence[Any]) -> tuple[Finding, ...]:
        imu_publishers = [p for p in publishers if p.topic_type == IMU_TYPE]
        if publishers and not imu_publishers:
            types = ', '.join(sorted({p.topic_type for p in publishers}))
            topics = [
                topic
                for topic, topic_types in self._node.get_topic_names_and_types()
                if IMU_TYPE in topic_types and topic != self.topic
            ]
            suggestions = ', '.join(sorted(topics)[:SUGGESTED_TOPICS])
            candidates = f', such as {suggestions}' if suggestions else ''
            return (finding('wrong_type', topic=self.topic, types=types, candidates=candidates),)
        mismatches = []
        for publisher in imu_publishers:
            own_qos = self._subscription.qos_profile
            compatibility, reason = qos_check_compatible(publisher.qos_profile, own_qos)
            if compatibility == QoSCompatibility.ERROR:
                name = full_name(publisher)
                reason_text = one_line(reason).removeprefix('ERROR: ').strip('; ')
                mismatches.append(
                    finding('qos_incompatible', reason=reason_text, names=name, topic=self.topic)
                )
        return tuple(mismatches)

    @property
    def qos(self) -> str:
        """Reliability and history of the subscription as text, including ``qos_overrides``."""
        return qos_text(self._subscription.qos_profile)

    @property
    def received(self) -> int:
        """Number of messages received so far."""
        with self._lock:
            return self._statistics.received + len(self._buffer.payloads)

    def statistics(self) -> TransportStatistics:
        """Return the numbers of received, lost and malformed messages.

        Messages count as received when `batches` has begun to decode them.
        """
        if self._loss is not None:
            with self._loss:
                event_data = self._loss.take_event()
            if event_data is not None:
                self._statistics.reported_lost = event_data.total_count
        return self._statistics

    def close(self) -> None:
        """Stop the thread, and release the handle that keeps the subscription alive."""
        self._closed.set()
        if self.polled:
            self._thread.join()
        self._loss = None

    def _collect(self, payload: bytes, info: dict[str, Any] | None = None) -> None:
        """Store one message; count the missing messages that its sequence number shows."""
        buffer = self._buffer
        buffer.payloads.append(payload)
        buffer.size += len(payload) + MESSAGE_BYTES
        if info is None:  # rclpy calls this method without the info of the message
            buffer.received_ns.append(time.time_ns())
            buffer.arrived_s.append(steady_s())
            return
        buffer.received_ns.append(info['received_timestamp'])
        number = info.get('publication_sequence_number')
        if number is None:  # Humble provides no sequence numbers
            return
        gid = info.get('publisher_gid')
        publisher = b'' if gid is None else gid['data']
        if publisher not in self._last_number:
            buffer.sent_before += number - FIRST_NUMBER
        last_number = self._last_number.get(publisher)
        self._last_number[publisher] = number
        # Before Kilted, messages of two publishers cannot be distinguished.
        if last_number is not None and (gid is not None or self._has_one_publisher):
            buffer.skipped_numbers += max(0, number - last_number - 1)


def steady_s() -> float:
    """Return the time in s of a clock that is never set; on Linux, it also runs during standby."""
    boot_clock = getattr(time, 'CLOCK_BOOTTIME', None)
    return time.monotonic() if boot_clock is None else time.clock_gettime(boot_clock)


def full_name(endpoint: Any) -> str:
    """Return the full name of the node that owns a publisher or subscriber, as text for messages.

    Returns 'an unnamed node' if the ROS graph does not know the name.
    """
    if endpoint.node_name == NAMELESS:
        return 'an unnamed node'
    return one_line(f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}')
