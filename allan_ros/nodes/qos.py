# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Latched QoS, and QoS event counts of a subscription that are polled instead of waited for.

With an event of a reader in its wait set, the executor wakes for every unread message in the
queue of that reader (with Fast DDS), which is a busy loop where a timer drains the queue. The
counts are totals, so it is enough to poll them before they are shown.
"""

from __future__ import annotations

from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from ..core.stream.transport import TransportStatistics

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Reliable, and late subscribers receive the last message: for sums and noise model."""


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


EVENTS = {
    'reported_lost': QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST,
    'incompatible_qos': QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS,
}
"""Field of `TransportStatistics` -> the event that counts it."""


NO_CALLBACKS = SubscriptionEventCallbacks(use_default_callbacks=False)
"""Keeps rclpy from adding events to the wait set."""


_EVENT_HANDLE: Any = getattr(
    rclpy_implementation, 'EventHandle', getattr(rclpy_implementation, 'QoSEvent', None)
)
"""rclpy's handle of an event; the second name is that of Humble."""


def qos_text(qos: QoSProfile) -> str:
    """Return the reliability and history of a QoS profile, for the log."""
    history = qos.history.name.lower()
    depth = f' {qos.depth}' if history == 'keep_last' else ''
    return f'{qos.reliability.name.lower()}, {history}{depth}'


class QosEvents:
    """Event totals of a subscription; events that the middleware lacks stay zero."""

    def __init__(self, subscription: Subscription) -> None:
        self._events: dict[str, Any] = {}
        for name, kind in EVENTS.items() if _EVENT_HANDLE is not None else ():
            try:
                with subscription.handle:
                    self._events[name] = _EVENT_HANDLE(subscription.handle, kind)
            except UnsupportedEventTypeError:
                continue

    def poll(self, statistics: TransportStatistics) -> None:
        """Update the counts."""
        for name, event in self._events.items():
            with event:
                data = event.take_event()
            if data is not None:
                setattr(statistics, name, data.total_count)

    def destroy(self) -> None:
        """Release the handles; call it before the subscription is destroyed."""
        for event in self._events.values():
            event.destroy_when_not_in_use()
        self._events = {}
