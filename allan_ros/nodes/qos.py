# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the middleware says of a subscription, asked for instead of waited for.

In the executor's wait set an event of a reader wakes it for every message that lies unread in that
reader's queue: with the queue drained by a timer that is a busy loop (seen with Fast DDS). The
counts are totals, so it is enough to ask for them when they are shown.
"""

from __future__ import annotations

from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from ..core.stream.transport import TransportStatistics

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Reliable, and the last one is kept for who comes late: sums and noise model."""


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
"""Field of `TransportStatistics` -> the event whose total it is."""


NO_CALLBACKS = SubscriptionEventCallbacks(use_default_callbacks=False)
"""Keeps rclpy from putting events into the wait set."""


_EVENT_HANDLE: Any = getattr(
    rclpy_implementation, 'EventHandle', getattr(rclpy_implementation, 'QoSEvent', None)
)
"""rclpy's own handle of an event; the second name is Humble's."""


class QosEvents:
    """The totals of a subscription's events; those that the middleware lacks stay zero."""

    def __init__(self, subscription: Subscription) -> None:
        self._events: dict[str, Any] = {}
        for name, kind in EVENTS.items() if _EVENT_HANDLE is not None else ():
            try:
                with subscription.handle:
                    self._events[name] = _EVENT_HANDLE(subscription.handle, kind)
            except UnsupportedEventTypeError:
                continue

    def ask(self, reception: TransportStatistics) -> None:
        """Bring the counts up to date."""
        for name, event in self._events.items():
            with event:
                told = event.take_event()
            if told is not None:
                setattr(reception, name, told.total_count)

    def destroy(self) -> None:
        """Let the handles go, before the subscription goes."""
        for event in self._events.values():
            event.destroy_when_not_in_use()
        self._events = {}
