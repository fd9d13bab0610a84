# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write the SROS 2 policy of the running nodes: config/sros2/allan_ros.policy.xml.

    python scripts/sros2_policy.py            # starts every node, reads its topics and services
    python scripts/sros2_policy.py --check NODE ...  # exit 1 if the file is wrong for these

The format is version 0.2.0 of the policies that ``ros2 security create_permission`` reads
(design.ros2.org, ROS 2 Access Control Policies and ROS 2 Security Enclaves).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
POLICY = ROOT / 'config' / 'sros2' / 'allan_ros.policy.xml'
VERSION = '0.2.0'
ENCLAVES = '/allan_ros/'

HEADER = """\
<?xml version="1.0" encoding="UTF-8"?>
<!-- Copyright 2026 the allan_ros authors -->
<!-- SPDX-License-Identifier: Apache-2.0 -->
<!-- Made by scripts/sros2_policy.py from the graph of the running nodes. -->
"""

STARTED = {
    'allan_monitor': ('monitor', ['-p', 'relay.enabled:=true']),
    'allan_accumulator': ('accumulator', []),
    'allan_estimator': ('estimator', []),
    'allan_imu_relay': ('relay', []),
    'allan_watch': ('watch', []),
}
"""Node -> its module, and parameters that create all its endpoints.

All get ``use_sim_time`` for `/clock`.
"""

PATIENCE_S = 240.0
"""Longest time in s to wait for the nodes, and for the names that are expected of them."""

SETTLED_S = 3.0
"""Time in s without a change after which the names of a node are complete."""

Names = dict[str, frozenset[str]]
"""'publish', 'subscribe', 'reply', 'request' -> names of topics or services."""


def read_graph(
    nodes: Iterable[str], expected: Callable[[dict[str, Names]], bool]
) -> dict[str, Names]:
    """Start these nodes and return the names that each uses, by fully qualified node name.

    While ``expected`` is False, a node may be slow, and the names are read again.
    """
    import rclpy

    rclpy.init()
    client = rclpy.create_node('sros2_policy')
    path = os.pathsep.join([str(ROOT), os.environ.get('PYTHONPATH', '')])
    environment = {**os.environ, 'PYTHONPATH': path}
    processes = []
    try:
        for module, given in (STARTED[node] for node in nodes):
            own = ['--plain'] if module == 'watch' else []
            processes.append(
                subprocess.Popen(
                    [sys.executable, '-m', 'allan_ros.nodes', module, *own, '--ros-args']
                    + ['-p', 'use_sim_time:=true', *given],
                    env=environment,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
            )
        return _settled(lambda: {name: _names(client, name) for name in nodes}, expected)
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.wait()
        client.destroy_node()
        rclpy.shutdown()


def _settled(
    read: Callable[[], dict[str, Names]], expected: Callable[[dict[str, Names]], bool]
) -> dict[str, Names]:
    """Return the names once all nodes have some, they no longer change, and they are expected."""
    ends = time.monotonic() + PATIENCE_S
    known, since = read(), time.monotonic()
    while time.monotonic() < ends:
        time.sleep(0.2)
        now = read()
        if now != known or not all(names['publish'] for names in now.values()):
            known, since = now, time.monotonic()
        elif time.monotonic() - since > SETTLED_S and expected(known):
            return known
    if missing := [name for name in known if not known[name]['publish']]:
        raise SystemExit(f'these nodes did not come up: {missing}')
    return known


def _names(client: object, node: str) -> Names:
    """Return the names that a node uses now; an empty value before it is discovered."""
    from rclpy.node import NodeNameNonExistentError

    asked = {
        'publish': 'get_publisher_names_and_types_by_node',
        'subscribe': 'get_subscriber_names_and_types_by_node',
        'reply': 'get_service_names_and_types_by_node',
        'request': 'get_client_names_and_types_by_node',
    }
    try:
        return {
            what: frozenset(name for name, _ in getattr(client, how)(node, '/'))
            for what, how in asked.items()
        }
    except NodeNameNonExistentError:
        return dict.fromkeys(asked, frozenset())


def policy_of(graph: dict[str, Names]) -> str:
    """Return the policy as XML, with an enclave and keys for each node."""
    policy = ET.Element('policy', version=VERSION)
    enclaves = ET.SubElement(policy, 'enclaves')
    for node, names in sorted(graph.items()):
        enclave = ET.SubElement(enclaves, 'enclave', path=f'{ENCLAVES}{node}')
        profile = ET.SubElement(ET.SubElement(enclave, 'profiles'), 'profile', ns='/', node=node)
        for what, group, each in (
            ('subscribe', 'topics', 'topic'),
            ('publish', 'topics', 'topic'),
            ('reply', 'services', 'service'),
            ('request', 'services', 'service'),
        ):
            if names[what]:
                allowed = ET.SubElement(profile, group, {what: 'ALLOW'})
                for name in _relative(node, names[what]):
                    ET.SubElement(allowed, each).text = name
    ET.indent(policy)
    return f'{HEADER}{ET.tostring(policy, encoding="unicode")}\n'


def _relative(node: str, names: Iterable[str]) -> list[str]:
    """Return names as policies write them: names of the node's own namespace begin with ``~/``."""
    own = f'/{node}/'
    return sorted(f'~/{n[len(own) :]}' if n.startswith(own) else n.lstrip('/') for n in names)


def differing(graph: dict[str, Names]) -> list[str | None]:
    """Return the enclaves that are not as the file says."""
    seen, written = ET.fromstring(policy_of(graph)), ET.parse(POLICY).getroot()
    known = {e.get('path'): ET.tostring(e).split() for e in written.iter('enclave')}
    return [
        e.get('path')
        for e in seen.iter('enclave')
        if ET.tostring(e).split() != known.get(e.get('path'))
    ]


def main() -> int:
    """Write the file, or compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--check', action='store_true', help='compare instead of writing')
    parser.add_argument('nodes', nargs='*', choices=[*STARTED, []], help='compare only these')
    options = parser.parse_args()
    graph = read_graph(
        options.nodes or STARTED, lambda found: not options.check or not differing(found)
    )
    if options.check:
        differ = differing(graph)
        for path in differ:
            print(f'{path} is not as {POLICY.name} says: run this script without --check')
        return 1 if differ else 0
    POLICY.parent.mkdir(exist_ok=True)
    POLICY.write_text(policy_of(graph))
    print(f'written: {POLICY.relative_to(ROOT)}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
