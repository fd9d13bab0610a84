# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The aggregator of config/viewers takes every status of the nodes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

pytest.importorskip('rclpy')


@pytest.fixture
def viewers(repository: Path) -> Path:
    return repository / 'config' / 'viewers'


def analyzers(viewers: Path) -> dict[str, list[str]]:
    """Return path -> regular expressions of every analyzer."""
    text = (viewers / 'diagnostic_aggregator.yaml').read_text()
    group = yaml.safe_load(text)['analyzers']['ros__parameters']['imu_noise']
    return {a['path']: a['regex'] for a in group['analyzers'].values()}


def matching(rules: dict[str, list[str]], name: str) -> list[str]:
    """Return the analyzers that take a status (GenericAnalyzer matches the whole name)."""
    return [path for path, rs in rules.items() if any(re.fullmatch(r, name) for r in rs)]


def test_a_running_monitor_has_statuses_in_every_group(graph, still_imu, viewers: Path) -> None:
    graph.run('monitor', **{'relay.enabled': True})
    graph.send(graph.publisher(), still_imu(10))
    graph.until(lambda: graph.status('accel z') and graph.status('relay'))
    rules = analyzers(viewers)
    for name in graph.statuses:
        (path,) = matching(rules, name)
        assert ('gyro' in name) == (path == 'Gyroscopes')
        assert ('accel' in name) == (path == 'Accelerometers')


@pytest.mark.parametrize(
    ('name', 'path'),
    [
        ('robot1/allan_monitor: left imu_link gyro z', 'Gyroscopes'),
        ('allan_estimator: os_imu accel x', 'Accelerometers'),
        ('allan_estimator: sums', 'Inputs and nodes'),
        ('a/b/allan_imu_relay: relay', 'Inputs and nodes'),
        ('allan_monitor: in motion', 'Inputs and nodes'),
        ('robot1/allan_monitor: left in motion', 'Inputs and nodes'),
        ('allan_monitor: parameters of /imu_filter_madgwick', 'Inputs and nodes'),
        ('robot1/imu_watcher: left imu_link gyro z', 'Gyroscopes'),
        ('imu_watcher: node', 'Inputs and nodes'),
        ('camera: exposure', None),
        ('battery: relay voltage', None),
    ],
)
def test_every_status_matches_one_analyzer(viewers: Path, name: str, path: str | None) -> None:
    assert matching(analyzers(viewers), name) == ([path] if path else [])
