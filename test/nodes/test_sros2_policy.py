# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The SROS 2 policy has the documented form and covers what running nodes use."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

pytest.importorskip('rclpy')

ROOT = Path(__file__).resolve().parents[2]
POLICY = ROOT / 'config' / 'sros2' / 'allan_ros.policy.xml'

WORDS = {'publish': 'out', 'subscribe': 'in', 'reply': 'reply'}
"""Notation of the policy -> notation of the tables in the docs."""

EVERY_NODE = re.compile(
    'in clock|out rosout|.*parameter.*|reply ~/get_type_description'
    '|in ~/(noise_model|bias)'  # the relay in the monitor subscribes to the monitor
)


def test_the_policy_has_five_enclaves_without_wildcards() -> None:
    root = ET.parse(POLICY).getroot()
    assert (root.tag, root.get('version')) == ('policy', '0.2.0')
    for group in (*root.iter('topics'), *root.iter('services')):
        assert set(group.attrib) <= {*WORDS, 'request'} and {*group.attrib.values()} == {'ALLOW'}
        assert all(name.text and '*' not in name.text for name in group)
    assert len({enclave.get('path') for enclave in root.iter('enclave')}) == 5


def test_the_tables_of_the_docs_agree_with_the_policy() -> None:
    """Another test compares the policy with running nodes, so the tables agree with these, too."""
    text = (ROOT / 'docs' / 'diagnostics.md').read_text()
    told: dict[str, set[tuple[str, str]]] = {}
    for names, _, uses, _ in rows(text, '| topic |'):
        for how, nodes in (use.split(':') for use in uses.split(';')):
            for node in nodes.split(','):
                told.setdefault(node.strip(), set()).update((how.strip(), n) for n in names)
    for names, nodes, _ in rows(text, '| service |'):
        for node in nodes.split(','):
            told.setdefault(node.strip(), set()).update(('reply', n) for n in names)
    assert told == {node: allowed(node) for node in told} and len(told) == 5


def rows(text: str, head: str) -> list[list]:
    """Return the rows of a table: the names in its first column, and the other columns."""
    table = text[text.index(head) :].partition('\n\n')[0].splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip('|').split('|')] for line in table]
    return [[re.findall('`/?(.*?)`', first), *others] for first, *others in cells]


def allowed(node: str) -> set[tuple[str, str]]:
    """Return what the policy allows to a node, without what all nodes have in common."""
    enclave = ET.parse(POLICY).getroot().find(f".//enclave[@path='/allan_ros/allan_{node}']")
    return {
        (WORDS[how], element.text)
        for group in enclave.iter()
        for how in WORDS.keys() & group.keys()
        for element in group
        if not EVERY_NODE.fullmatch(f'{WORDS[how]} {element.text}')
    }


def test_the_policy_contains_what_the_nodes_use(ros_domain: int) -> None:
    script = ROOT / 'scripts' / 'sros2_policy.py'
    nodes = ['allan_accumulator', 'allan_estimator']
    command = [sys.executable, str(script), '--check', *nodes]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr


def test_without_its_enclave_a_node_reports_it_and_ends(ros_domain: int, tmp_path: Path) -> None:
    secured = {
        'ROS_SECURITY_ENABLE': 'true',
        'ROS_SECURITY_STRATEGY': 'Enforce',
        'ROS_SECURITY_KEYSTORE': str(tmp_path),
        'PYTHONPATH': os.pathsep.join([str(ROOT), os.environ.get('PYTHONPATH', '')]),
    }
    command = [sys.executable, '-m', 'allan_ros.nodes', 'relay']
    command += ['--ros-args', '--enclave', '/allan_ros/allan_imu_relay']
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, **secured})
    said = done.stdout + done.stderr
    assert done.returncode == 1, said
    assert f'{tmp_path}/enclaves/allan_ros/allan_imu_relay' in said and 'Traceback' not in said
