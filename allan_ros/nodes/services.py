# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calls ``~/save`` and ``~/fit`` of running nodes: `ros2 allan save` and `ros2 allan fit`."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import rclpy
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

DISCOVERY_S = 5.0
"""Longest time to find nodes and to get an answer from them."""

TRIGGER = 'std_srvs/srv/Trigger'

EXIT_FAILED = 1


def services_of(node: Node, verb: str, wanted: str) -> list[str]:
    """Return the services ``.../<verb>`` of the allan_ros nodes in the graph.

    Parameters
    ----------
    node : Node
    verb : {'save', 'fit'}
    wanted : str
        Only those of this node or IMU, such as ``/allan_monitor``; '' for all.
    """
    known = {name for name, types in node.get_service_names_and_types() if TRIGGER in types}
    homes = [name.rpartition('/')[0] for name in known if name.endswith(f'/{verb}')]
    # an accumulator has `reset` next to `save`, an estimator `noise_model` next to `fit`
    topics = {name for name, _ in node.get_topic_names_and_types()}
    ours = [h for h in homes if f'{h}/reset' in known or f'{h}/noise_model' in topics]
    chosen = f'/{wanted.strip("/")}' if wanted else ''
    return sorted(f'{h}/{verb}' for h in ours if f'{h}/'.startswith(f'{chosen}/'))


def main(verb: str, args: Sequence[str]) -> int:
    """Call the service of every running node; return 0 if there is one and all succeeded."""
    doc = {
        'save': 'Write the checkpoint of running nodes now.',
        'fit': 'Fit the sums of running nodes now.',
    }[verb]
    parser = argparse.ArgumentParser(prog=f'ros2 allan {verb}', description=doc)
    parser.add_argument('--node', default='', help='only this node or IMU, such as /allan_monitor')
    options = parser.parse_args(list(args))
    rclpy.init(args=[])
    node, executor = Node(f'allan_{verb}'), SingleThreadedExecutor()
    executor.add_node(node)
    try:
        return _call_all(node, executor, verb, options.node)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()


def _call_all(node: Node, executor: SingleThreadedExecutor, verb: str, wanted: str) -> int:
    deadline = time.monotonic() + DISCOVERY_S
    while not (found := services_of(node, verb, wanted)) and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    if not found:
        print(f'no allan_ros node{f" {wanted}" if wanted else ""} with a service {verb} is running')
        return EXIT_FAILED
    codes = [_call(node, executor, name) for name in found]
    return max(codes)


def _call(node: Node, executor: SingleThreadedExecutor, name: str) -> int:
    """Call one service and print its answer; return 0 on success."""
    client: Client = node.create_client(Trigger, name)
    client.wait_for_service(DISCOVERY_S)
    # An answer to a client that the service has not discovered yet is lost: repeat the call.
    for _ in range(3):
        future = client.call_async(Trigger.Request())
        executor.spin_until_future_complete(future, DISCOVERY_S)
        answer = future.result() if future.done() else None
        if answer is not None:
            print(f'{name}: {answer.message or "done"}')
            return 0 if answer.success else EXIT_FAILED
    print(f'{name}: no answer within {3 * DISCOVERY_S:g} s')
    return EXIT_FAILED
