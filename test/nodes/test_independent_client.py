# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Another DDS implementation, without ROS, feeds the monitor and reads its diagnostics."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('cyclonedds')

CLIENT = Path(__file__).parent / 'independent_client.py'

FIRST_RCLPY_OF_FAST_DDS_3 = 8
"""Since Kilted: cyclonedds 11 rejects its type information and does not connect."""

LOOPBACK = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="lo"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers>
</Discovery></Domain></CycloneDDS>"""


@pytest.mark.skipif(
    int(version('rclpy').split('.')[0]) >= FIRST_RCLPY_OF_FAST_DDS_3,
    reason='cyclonedds does not read the type information of Fast DDS 3',
)
def test_a_client_of_another_dds_works(graph, ros_domain: int):
    reliable = {'qos_overrides./imu/data.subscription.reliability': 'reliable'}
    graph.start(
        'monitor', **reliable, **{'publish.sums_period': 0.5, 'estimator.method': 'relative'}
    )
    graph.until(lambda: graph.status('input'))
    client = subprocess.run(
        [
            sys.executable,
            str(Path(__file__).parent / 'independent_client.py'),
            str(ros_domain),
            '2000',
        ],
        env={**os.environ, 'CYCLONEDDS_URI': LOOPBACK},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert client.returncode == 0, client.stderr
    heard = json.loads(client.stdout)
    values = heard['allan_monitor: imu/data input']['values']
    assert values['received [messages]'] == values['used [samples]'] == '2000'
    assert values['lost on the way [messages]'] == '0'
    assert heard['allan_monitor: independent gyro x']['message'].startswith('N ')
