# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The metrics file follows the text format of Prometheus."""

from __future__ import annotations

import re

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticStatus

from allan_ros.core.findings import finding
from allan_ros.nodes.diagnostics import metrics_text, status_of

LINE = re.compile(r'(allan_ros_\w+)(\{(?:\w+="(?:[^"\\\n]|\\["\\n])*",?)*\})? \S+')


def test_every_line_is_valid_and_unique():
    found = [finding('no_publisher', topic='/imu'), finding('no_noise', ('gyro_x',))]
    pairs = [('N [deg/sqrt(h)]', 0.24), ('rate [Hz]', None), ('topic', '/a "b" \\ c'), ('n', 3)]
    statuses = [
        status_of(name, found, '', pairs, hardware_id='SN "7"')
        for name in ('robot/allan_monitor: imu gyro x', 'allan_monitor: imu/data input')
    ]
    text = metrics_text(statuses, 12.5)
    lines = [line for line in text.splitlines() if line[0] != '#']
    assert text.endswith('\n') and all(LINE.fullmatch(line) for line in lines)
    assert len({line.rsplit(' ', 1)[0] for line in lines}) == len(lines)
    metrics = [line.split('{')[0] for line in lines]
    assert all(text.count(f'# TYPE {m.split(" ")[0]} gauge') == 1 for m in metrics)
    assert metrics == sorted(metrics)  # each metric in one group
    assert sum('quantity="N",unit="deg/sqrt(h)"} 0.24' in line for line in lines) == 2
    assert sum('id="no_publisher"} 1' in line for line in lines) == 2
    assert not any('topic' in line or 'rate' in line for line in lines)
    assert sum(line.startswith('allan_ros_level') and line.endswith(' 2') for line in lines) == 2


def test_the_key_finding_has_the_id_of_the_finding_in_the_message():
    info, error = finding('no_noise', ('gyro_x',)), finding('no_publisher', topic='/imu')
    status = status_of('a: b', [error, info], 'fine', [])
    assert (status.values[0].key, status.values[0].value) == ('finding', 'no_publisher')
    assert status.message.startswith(str(error))
    assert status_of('a: b', [], 'fine', []).values[0].value == 'none'
    assert isinstance(status, DiagnosticStatus)
