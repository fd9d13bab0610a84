# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Wait until a publisher and its subscribers have discovered each other."""

from __future__ import annotations

import time

from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.publisher import Publisher

from allan_ros.nodes.imu_input import NAMELESS, full_name

CALL_PERIOD_S = 1.0
"""Period in s at which a call is repeated, because answers to undiscovered clients are lost."""


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
        self._clients: dict[str, Client] = {}
        self._called: dict[str, float] = {}
        self._answered: set[str] = set()

    def update(self) -> bool:
        """Call the subscribing nodes without an answer; return True if all have answered."""
        known = self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
        names = {full_name(each) for each in known if each.node_name != NAMELESS}
        for name in names - self._answered:
            self._call(name)
        every = all(each.node_name != NAMELESS for each in known) and names <= self._answered
        return every and self._wanted <= self._publisher.get_subscription_count() <= len(known)

    def close(self) -> None:
        """Destroy the clients."""
        for client in self._clients.values():
            self._node.destroy_client(client)

    def _call(self, name: str) -> None:
        if name not in self._clients:
            service = f'{name}/get_parameters'
            self._clients[name] = self._node.create_client(GetParameters, service)
        client, now = self._clients[name], time.monotonic()
        due = now - self._called.get(name, float('-inf')) >= CALL_PERIOD_S
        if due and client.service_is_ready():
            self._called[name] = now
            answer = client.call_async(GetParameters.Request())
            answer.add_done_callback(lambda _: self._answered.add(name))
