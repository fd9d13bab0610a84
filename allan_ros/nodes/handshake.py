# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the subscribers of a publisher have found it, and whether they have taken its end.

A publisher counts a subscriber once it has heard of it; the subscriber may hear of the publisher
later (0.07 s on a busy machine, and nothing bounds it). What is sent in between is lost to a best
effort subscriber, and no number tells it: the first message it gets is the first it knows of.

DDS announces the endpoints of a participant in the order in which they were made, reliably (RTPS
2.5, 8.5.4: one announcing writer for all of them). So a service client that is made after the
publisher is answered by a node only when that node has found the publisher too. Every ROS node
offers its parameters as services, unless it was told not to.

When the publisher goes, what a best effort subscriber has not yet taken from the transport is lost
likewise (417 messages, where a process was frozen for 7 s). A question that is sent after the last
message takes the same way and its turn, so the answer tells that all before it have arrived.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.publisher import Publisher

ASK_AGAIN_S = 1.0
"""An answer may be lost, like any message, to a client that was not found in time."""

PATIENCE_S = 10.0
"""A subscriber that has not answered by then has no parameter services, or is stuck."""

NAMELESS = '_NODE_NAME_UNKNOWN_'
"""What the graph calls the node of an endpoint that it does not know yet, or that has none."""


@dataclass
class _Asked:
    """What was asked of the node of one subscriber."""

    since: float
    name: str = ''
    client: Client | None = None
    last: float = float('-inf')
    answered: bool = False


class Handshake:
    """Asks every subscriber of a publisher for a sign that it has found the publisher.

    Made after the publisher; `update` is called by whoever runs the node's executor.

    Parameters
    ----------
    node : Node
    publisher : Publisher
        One of the node's.
    wanted : int
        How many subscribers there must be.
    """

    def __init__(self, node: Node, publisher: Publisher, wanted: int = 1) -> None:
        self._node, self._publisher, self._wanted = node, publisher, wanted
        self._asked: dict[bytes, _Asked] = {}
        self._round = 0

    def update(self) -> bool:
        """Ask on; return whether all there are have found the publisher, or will never say."""
        now = time.monotonic()
        known = self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
        done = True
        for subscriber in known:
            asked = self._asked.setdefault(bytes(subscriber.endpoint_gid), _Asked(now))
            if not asked.answered:
                if subscriber.node_name != NAMELESS:
                    asked.name = f'{subscriber.node_namespace.rstrip("/")}/{subscriber.node_name}'
                    self._ask(asked, now)
                done = done and now - asked.since > PATIENCE_S
        return done and self._wanted <= self._publisher.get_subscription_count() <= len(known)

    def again(self) -> None:
        """Ask anew whoever is still there; who never answered is not waited for again."""
        self._wanted, self._round = 0, self._round + 1
        for asked in self._asked.values():
            if asked.answered:
                asked.answered, asked.since, asked.last = False, time.monotonic(), float('-inf')

    def silent(self) -> tuple[str, ...]:
        """Return the nodes that have not answered."""
        silent = (a.name or 'a nameless node' for a in self._asked.values() if not a.answered)
        return tuple(sorted(silent))

    def close(self) -> None:
        """Ask no more."""
        for asked in self._asked.values():
            if asked.client is not None:
                self._node.destroy_client(asked.client)
        self._asked = {}

    def _ask(self, asked: _Asked, now: float) -> None:
        if asked.client is None:
            asked.client = self._node.create_client(GetParameters, f'{asked.name}/get_parameters')
        if now - asked.last >= ASK_AGAIN_S and asked.client.service_is_ready():
            asked.last = now
            answer = asked.client.call_async(GetParameters.Request())
            answer.add_done_callback(partial(self._on_answer, asked, self._round))

    def _on_answer(self, asked: _Asked, round_asked: int, _: Any) -> None:
        """Note an answer, unless it is a late one to what was asked before `again`."""
        asked.answered = asked.answered or round_asked == self._round
