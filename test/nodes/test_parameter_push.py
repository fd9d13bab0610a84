# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of another node are set once values are known, rejected with a reason, and
restored.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip('rclpy')

OK, WARN = b'\x00', b'\x01'
N = 1e-3 / 200**0.5

MAPPING = """
schema: allan_ros/filter/1
name: a test
constants: {h: 4.0}
parameters:
  gain: {sensor: gyro, expression: N / sqrt(h)}
  zeta: {sensor: gyro, axis: mean, expression: 1000 * N}   # out of the range of the node
  densities: {sensor: gyro, axis: each, expression: N**2 * f}
  fixed: {sensor: gyro, expression: N}                     # the node refuses it
  missing: {sensor: gyro, expression: N}
  count: {sensor: gyro, expression: N}
  later: {sensor: gyro, expression: K}                     # K is not resolved in half a minute
"""

QUICK = {
    'publish.sums_period': 0.5,
    'publish.diagnostics_period': 0.2,
    'qos_overrides./imu/data.subscription.reliability': 'reliable',
    'qos_overrides./imu/data.subscription.history': 'keep_all',
    'push.node': '/imu_filter',
    'push.period': 0.5,
}


@pytest.fixture
def filter_node(ros_domain: int) -> Iterator[Callable[..., None]]:
    """Return a function that starts the node whose parameters are set, in the graph's domain."""
    started: list[subprocess.Popen[bytes]] = []

    def start() -> None:
        script = Path(__file__).with_name('filter_node.py')
        started.append(subprocess.Popen([sys.executable, str(script)], env={**os.environ}))

    yield start
    for process in started:
        process.kill()
        process.wait()


def values(graph: Any, *names: str) -> list[Any]:
    """Return parameters of the node, read from the node itself."""
    from rcl_interfaces.srv import GetParameters
    from rclpy.parameter import parameter_value_to_python

    request = GetParameters.Request(names=names)
    response = graph.ask(GetParameters, '/imu_filter/get_parameters', request)
    return [parameter_value_to_python(value) for value in response.values]


def test_parameters_are_set_rejected_and_restored(graph, still_imu, tmp_path, filter_node):
    mapping = tmp_path / 'mapping.yaml'
    mapping.write_text(MAPPING)
    monitor = graph.start('monitor', **QUICK, **{'push.filter': str(mapping)})
    graph.send(graph.publisher(), still_imu(6000))
    absent = graph.until(
        lambda: (s := graph.status('parameters of /imu_filter')) and s.level == WARN and s
    )
    assert '/imu_filter is not running: start it' in absent.message
    graph.model_of(6000)
    filter_node()
    # not atomic: one parameter may be set before the next one
    graph.until(lambda: 'set gain, densities' in graph.status('parameters of /imu_filter').message)
    gain, zeta, densities, count = values(graph, 'gain', 'zeta', 'densities', 'count')
    # the gyro has N: 6000 samples determine it to 2 %, the worst of three axes lies above
    assert gain == pytest.approx(N / 2.0, rel=0.15)
    assert list(densities) == pytest.approx([1e-6] * 3, rel=0.15)
    assert zeta == 0.0 and count == 3
    status = graph.until(
        lambda: 'refused' in (s := graph.status('parameters of /imu_filter')).message and s
    )
    assert status.level == WARN
    for said in (
        'set gain, densities',
        'zeta: /imu_filter refused 0.0',
        'out of range',
        'fixed: /imu_filter refused 7',
        'fixed is not for you',
        'missing: is not declared in /imu_filter',
        'count: is of another type in /imu_filter',
        'later: between 0 and',
    ):
        assert said in status.message
    assert 'gain of /imu_filter: 0.1 -> ' in monitor.output
    restored = graph.call('/allan_monitor/restore')
    assert restored.success, restored.message
    assert 'gain = 0.1' in restored.message
    assert [*values(graph, 'gain', 'zeta')] == [0.1, 0.0]
    assert list(values(graph, 'densities')[0]) == [0.1, 0.2, 0.3]
    graph.spin(1.5)  # three periods: the values stay restored
    assert monitor.output.count('fixed is not for you') == 1
    assert values(graph, 'gain') == [0.1]
    off = graph.until(
        lambda: 'push.enabled' in (s := graph.status('parameters of /imu_filter')).message and s
    )
    assert off.level == OK
    assert not graph.call('/allan_monitor/restore').success
    assert monitor.stop() == 0, monitor.output


@pytest.mark.parametrize(
    'given, reason',
    [
        ({'push.node': 'imu_filter'}, 'give a full name'),
        ({'push.node': '/a', 'push.filter': 'none-such'}, 'no filter mapping'),
        ({'input.topics': ('a', 'b'), 'push.filter': 'noise_densities'}, 'there are 2 IMUs'),
    ],
)
def test_bad_settings_are_rejected_at_start(graph, given, reason):
    monitor = graph.start('monitor', **{**QUICK, **given})
    assert monitor.wait() == 1
    assert reason in monitor.output and 'Traceback' not in monitor.output
