# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Receives Imu messages without a callback per message: a timer empties the queue.

One Python callback per message costs more than all other processing. Therefore the executor does
not wait for the subscription, and `ImuInput.drain` empties its queue a few times a second with
``take_message``, an undocumented method that the executors of rclpy call. If a version of rclpy
does not have it, a callback receives the same bytes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
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
from ..readers.cdr import MalformedMessage, decode_imus, is_imu
from .settings import InputSettings

try:
    from rclpy.event_handler import (
        QoSSubscriptionEventType,
        SubscriptionEventCallbacks,
        UnsupportedEventTypeError,
    )
except ImportError:  # Humble
    from rclpy.qos_event import (
        QoSSubscriptionEventType,
        SubscriptionEventCallbacks,
        UnsupportedEventTypeError,
    )

IMU_TYPE = 'sensor_msgs/msg/Imu'

QUEUE_DEPTH = 4000
"""Queue depth of the subscription, in messages; ``qos_overrides`` change it."""

DRAIN_LIMIT = 50_000
"""Largest number of messages fetched at once: a fast publisher must not block the node."""

NAMELESS = '_NODE_NAME_UNKNOWN_'
"""Node name that the ROS graph returns for an endpoint of an unknown node."""

SUGGESTED_TOPICS = 5
"""Number of Imu topics that are named if the given topic has another type."""

FIRST_NUMBER = 1
"""Publication sequence number of a publisher's first message (RTPS 2.5, 8.3.5.4)."""

NO_CALLBACKS = SubscriptionEventCallbacks(use_default_callbacks=False)
"""Prevents rclpy from registering callbacks of events, which would wake the executor."""

_EVENT_HANDLE: Any = getattr(
    rclpy_implementation, 'EventHandle', getattr(rclpy_implementation, 'QoSEvent', None)
)
"""rclpy's handle of an event, which is named `QoSEvent` in Humble; None if there is none."""


class DrainedGroup(CallbackGroup):
    """A callback group that never allows execution: the executor ignores its subscription.

    rclpy requires these methods of a callback group.
    """

    def can_execute(self, entity: Any) -> bool:
        """Return False: the executor must not take messages of this subscription."""
        return False

    beginning_execution = can_execute

    def ending_execution(self, entity: Any) -> None:
        """Do nothing: no execution ever begins."""


def qos_text(qos: QoSProfile) -> str:
    """Return the reliability and history of a QoS profile, for the log."""
    history = qos.history.name.lower()
    depth = f' {qos.depth}' if history == 'keep_last' else ''
    return f'{qos.reliability.name.lower()}, {history}{depth}'


def _loss_event(subscription: Subscription) -> Any:
    """Return a handle to poll the number of messages that the middleware lost; None without one.

    An executor that waits for such an event also wakes for every unread message of the subscription
    (Fast DDS), which would be a busy loop here.
    """
    lost = QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
    try:
        with subscription.handle:
            return _EVENT_HANDLE(subscription.handle, lost)
    except (TypeError, UnsupportedEventTypeError):
        return None


def _take(subscription: Subscription) -> Any:
    """Return the next queued message as bytes and its information, or None."""
    return subscription.handle.take_message(Imu, True)


def subscribe_raw(
    node: Node, topic: str, callback: Callable[..., None], depth: int, plain: bool
) -> tuple[Subscription, bool]:
    """Subscribe to an Imu topic as raw bytes.

    Returns the subscription, and whether the caller must fetch the messages from its queue. If
    ``plain`` is True, or if this version of rclpy cannot fetch messages, the executor calls
    ``callback`` with the bytes of each message instead. ``depth`` is the depth of the queue.
    """
    # Best effort connects to every publisher; reliable publishers still deliver in order.
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


class ImuInput:
    """Subscribes to the Imu messages of one topic (which may be remapped), and decodes them.

    ``polled`` is True if `drain` must be called to fetch messages, False if a callback does it.
    """

    def __init__(self, node: Node, topic: str, settings: InputSettings) -> None:
        self._statistics = TransportStatistics()
        self._node = node
        self._payloads: list[bytes] = []
        self._received_ns: list[int] = []
        self._arrived_s: list[float] = []  # on a steady clock
        self._drained_s = steady_s()
        self._arrivals = Arrivals(self._statistics)
        self.constant = ConstantAxes()
        self._last_number: dict[bytes, int | None] = {}
        self._publisher_count, self._alone = 1, True
        self._scale = sample_factors(settings.gyro_unit, settings.accel_unit)
        self._subscription, self.polled = subscribe_raw(
            node, topic, self._collect, QUEUE_DEPTH, plain=False
        )
        self.topic = self._subscription.topic_name
        self._loss = _loss_event(self._subscription)

    def drain(self) -> None:
        """Fetch the queued messages; do nothing unless the input is ``polled``."""
        if not self.polled:
            return
        # The queue may still contain messages of a publisher that has left since the last call.
        count = self._node.count_publishers(self.topic)
        self._alone = max(count, self._publisher_count) <= 1
        self._publisher_count = count
        if not self._alone and b'' in self._last_number:
            self._last_number[b''] = None
        handle, before = self._subscription.handle, len(self._received_ns)
        with handle:
            for _ in range(DRAIN_LIMIT):
                message = handle.take_message(Imu, True)
                if message is None:
                    break
                self._collect(*message)
        # the system clock of the times of reception may have been set since the last call
        now_s = steady_s()
        received_s = np.array(self._received_ns[before:], np.int64) / NANOSECONDS
        arrived_s = np.clip(received_s - (time.time() - now_s), self._drained_s, now_s)
        self._arrived_s += arrived_s.tolist()
        self._drained_s = now_s

    def batches(self) -> Iterator[ImuBatch]:
        """Decode the messages received since the last call, in SI units, and yield them in order.

        All samples of a batch have the same frame_id. Malformed messages are counted and dropped.
        """
        payloads, received = self._payloads, np.array(self._received_ns, np.int64)
        arrived_s = np.array(self._arrived_s)
        self._payloads, self._received_ns, self._arrived_s = [], [], []
        try:
            decoded = decode_imus(payloads, 'cdr')
        except MalformedMessage:
            valid = [is_imu(payload, 'cdr') for payload in payloads]
            self._statistics.malformed += valid.count(False)
            decoded = decode_imus(list(compress(payloads, valid)), 'cdr')
            received, arrived_s = (x[np.array(valid, bool)] for x in (received, arrived_s))
        self._arrivals.update(decoded.stamps_ns, arrived_s)
        if len(received):
            self.constant.update(decoded.samples)
        for batch in decoded.batches(received):
            yield replace(batch, samples=batch.samples * self._scale)

    def publishers(self) -> tuple[tuple[str, ...], tuple[Finding, ...]]:
        """Return the node names of all publishers on the topic, and findings.

        The findings report publishers whose messages cannot be received, because their message type
        differs or their QoS is incompatible.
        """
        known = self._node.get_publishers_info_by_topic(self.topic)
        return tuple(map(full_name, known)), self._mismatches(known)

    def _mismatches(self, known: Sequence[Any]) -> tuple[Finding, ...]:
        imus = [p for p in known if p.topic_type == IMU_TYPE]
        if known and not imus:
            types = ', '.join(sorted({p.topic_type for p in known}))
            topics = [
                topic
                for topic, kinds in self._node.get_topic_names_and_types()
                if IMU_TYPE in kinds and topic != self.topic
            ]
            shown = ', '.join(sorted(topics)[:SUGGESTED_TOPICS])
            candidates = f', such as {shown}' if shown else ''
            return (finding('wrong_type', topic=self.topic, types=types, candidates=candidates),)
        found = []
        for publisher in imus:
            own = self._subscription.qos_profile
            fits, reason = qos_check_compatible(publisher.qos_profile, own)
            if fits == QoSCompatibility.ERROR:
                values = {'names': full_name(publisher), 'topic': self.topic}
                why = one_line(reason).removeprefix('ERROR: ').strip('; ')
                found.append(finding('qos_incompatible', reason=why, **values))
        return tuple(found)

    @property
    def qos(self) -> str:
        """Reliability and history of the subscription, after overrides."""
        return qos_text(self._subscription.qos_profile)

    @property
    def received(self) -> int:
        """Number of messages received so far."""
        return self._statistics.received

    def statistics(self) -> TransportStatistics:
        """Return the counts of received, lost and malformed messages so far."""
        if self._loss is not None:
            with self._loss:
                data = self._loss.take_event()
            if data is not None:
                self._statistics.reported_lost = data.total_count
        return self._statistics

    def close(self) -> None:
        """Release the event, which would keep the subscription alive."""
        self._loss = None

    def _collect(self, payload: bytes, info: dict[str, Any] | None = None) -> None:
        """Store one message, and count the messages that were lost before it."""
        self._statistics.received += 1
        self._payloads.append(payload)
        if info is None:  # called by the executor
            self._received_ns.append(time.time_ns())
            self._arrived_s.append(steady_s())
            return
        self._received_ns.append(info['received_timestamp'])
        number = info.get('publication_sequence_number')
        if number is None:  # Humble
            return
        gid = info.get('publisher_gid')
        publisher = b'' if gid is None else gid['data']
        if publisher not in self._last_number:
            self._statistics.sent_before += number - FIRST_NUMBER
        before = self._last_number.get(publisher)
        self._last_number[publisher] = number
        # Before Kilted, messages of two publishers cannot be distinguished.
        if before is not None and (gid is not None or self._alone):
            self._statistics.skipped_numbers += max(0, number - before - 1)


def steady_s() -> float:
    """Return the time in s of a clock that is never set and that does not stop in standby."""
    boot = getattr(time, 'CLOCK_BOOTTIME', None)
    return time.monotonic() if boot is None else time.clock_gettime(boot)


def full_name(endpoint: Any) -> str:
    """Return namespace and name of the node that owns a publisher or subscriber."""
    if endpoint.node_name == NAMELESS:
        return 'an unnamed node'
    return one_line(f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}')
