# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publishes the Allan sums of one IMU."""

from __future__ import annotations

import json
from collections.abc import Callable

from rclpy.node import Node
from std_msgs.msg import String

from ..core.allan.sums import AllanSums
from .messages import Snapshot
from .shell import LATCHED


class SumsOutput:
    """Publishes snapshots of the Allan sums on ``<home>sums``, and passes them to listeners.

    ``home`` is the prefix of the topic, such as ``~/``.

    Attributes
    ----------
    latest : Snapshot or None
        The latest snapshot of this input, without an accelerometer that has its own topic.
    state : object
        The state of the input at the latest snapshot. If the present state of the input is
        different, the estimator must receive a new snapshot at once.
    """

    def __init__(self, node: Node, home: str) -> None:
        self.latest: Snapshot | None = None
        self.state: object = None
        self._listeners: list[Callable[[Snapshot], None]] = []
        self._publisher = node.create_publisher(String, f'{home}sums', LATCHED)
        self._subscribers = 0

    @property
    def topic(self) -> str:
        """Full name of the topic of the sums."""
        return str(self._publisher.topic_name)

    @property
    def sums(self) -> tuple[AllanSums, ...]:
        """The latest published sums of this input."""
        return self.latest.sums if self.latest is not None else ()

    def add_listener(self, listener: Callable[[Snapshot], None]) -> None:
        """Register a function that is called with every further snapshot."""
        self._listeners.append(listener)

    def has_new_subscriber(self) -> bool:
        """Return whether there are more subscribers than at the last call."""
        last_count, self._subscribers = self._subscribers, self._publisher.get_subscription_count()
        return self._subscribers > last_count

    def put(self, snapshot: Snapshot, state: object, accel: Snapshot | None) -> None:
        """Publish a snapshot, extended by the snapshot ``accel`` of a separate accelerometer.

        ``state`` is the state of the input at this snapshot. Listeners always receive the snapshot;
        a message is made and published only if the topic has a subscriber.
        """
        self.latest, self.state = snapshot, state
        united = snapshot if accel is None else snapshot.with_accel(accel)
        for listener in self._listeners:
            listener(united)
        if self._publisher.get_subscription_count():
            text = json.dumps(united.to_document(), separators=(',', ':'), allow_nan=False)
            self._publisher.publish(String(data=text))
