# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The statuses as a text file for the textfile collector of Prometheus' node exporter."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence

from diagnostic_msgs.msg import DiagnosticStatus

FINDING = 'finding'
"""Key of a status with the id of the finding in its message. ``finding: <id>`` has the text."""

HEADER = """\
# HELP allan_ros_level Level of a diagnostic status: 0 ok, 1 warning, 2 error, 3 stale.
# TYPE allan_ros_level gauge
# HELP allan_ros_value Number in a diagnostic status.
# TYPE allan_ros_value gauge
# HELP allan_ros_finding 1 while a status contains this finding.
# TYPE allan_ros_finding gauge
# HELP allan_ros_written_seconds Time at which this file was written.
# TYPE allan_ros_written_seconds gauge
"""


def metrics_text(statuses: Sequence[DiagnosticStatus], time_s: float) -> str:
    """Return the file; ``time_s`` is the system time in s.

    Examples
    --------
    >>> from diagnostic_msgs.msg import KeyValue
    >>> status = DiagnosticStatus(name='allan_monitor: imu gyro x', hardware_id='SN 7')
    >>> status.values = [KeyValue(key='N [deg/sqrt(h)]', value='0.24')]
    >>> print(metrics_text([status], 0.0).splitlines()[-2])
    allan_ros_value{node="allan_monitor",status="imu gyro x",hardware_id="SN 7",quantity="N",unit="deg/sqrt(h)"} 0.24
    """  # noqa: E501
    lines = [line for status in statuses for line in _lines(status)]
    # all lines of one metric must be consecutive
    return HEADER + '\n'.join([*sorted(lines), f'allan_ros_written_seconds {time_s:.3f}', ''])


def _lines(status: DiagnosticStatus) -> Iterator[str]:
    node, _, name = status.name.partition(': ')
    labels = {'node': node, 'status': name, 'hardware_id': status.hardware_id}
    yield _line('level', labels, str(int.from_bytes(status.level, 'little')))
    for pair in status.values:
        quantity, unit = re.fullmatch(r'(.*?)(?: \[([^]]*)\])?', pair.key, re.DOTALL).groups('')  # type: ignore[union-attr]
        if quantity.startswith(f'{FINDING}: '):
            yield _line('finding', {**labels, 'id': quantity.removeprefix(f'{FINDING}: ')}, '1')
        elif _is_number(pair.value):
            yield _line('value', {**labels, 'quantity': quantity, 'unit': unit}, pair.value)


def _line(metric: str, labels: dict[str, str], value: str) -> str:
    escaped = (f'{name}="{_escaped(text)}"' for name, text in labels.items())
    return f'allan_ros_{metric}{{{",".join(escaped)}}} {value}'


def _escaped(text: str) -> str:
    return text.replace('\\', r'\\').replace('"', r'\"').replace('\n', r'\n')


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text)) and '_' not in text
    except ValueError:
        return False
