# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The SROS 2 policy: of the documented form, complete, and what the running nodes use."""

from __future__ import annotations

import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

pytest.importorskip('rclpy')

ROOT = Path(__file__).resolve().parents[2]
POLICY = ROOT / 'config' / 'sros2' / 'allan_ros.policy.xml'
FORM = {
    'policy': ({'version'}, {'enclaves'}),
    'enclaves': (set(), {'enclave'}),
    'enclave': ({'path'}, {'profiles'}),
    'profiles': (set(), {'profile'}),
    'profile': ({'ns', 'node'}, {'topics', 'services'}),
    'topics': ({'publish', 'subscribe'}, {'topic'}),
    'services': ({'reply', 'request'}, {'service'}),
    'topic': (set(), set()),
    'service': (set(), set()),
}
"""Element -> its attributes and what it holds (policy 0.2.0; actions we have none)."""


def test_the_policy_is_of_the_documented_form() -> None:
    root = ET.parse(POLICY).getroot()
    assert (root.tag, root.get('version')) == ('policy', '0.2.0')
    for element in root.iter():
        attributes, children = FORM[element.tag]
        assert set(element.attrib) <= attributes
        assert {child.tag for child in element} <= children
        if element.tag in ('topics', 'services'):
            assert set(element.attrib.values()) == {'ALLOW'}
        if not children:
            assert element.text and '*' not in element.text  # nothing is allowed wholesale
    paths = [enclave.get('path') for enclave in root.iter('enclave')]
    assert len(paths) == 6 == len(set(paths))


def test_the_policy_is_what_the_nodes_use(ros_domain: int) -> None:
    script = ROOT / 'scripts' / 'sros2_policy.py'
    nodes = ['allan_accumulator', 'allan_estimator']
    command = [sys.executable, str(script), '--check', *nodes]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
