# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The names in the layouts of config/viewers are names that the nodes publish."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

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


def plotjuggler_series(viewers: Path) -> list[str]:
    root = ElementTree.parse(viewers / 'plotjuggler.xml').getroot()
    return [curve.attrib['name'] for curve in root.iter('curve')]


def foxglove_configs(viewers: Path) -> dict[str, dict]:
    return json.loads((viewers / 'foxglove.json').read_text())['configById']


def is_number(text: str) -> bool:
    try:
        float(text)
        return True
    except ValueError:
        return False


def test_the_layouts_name_what_the_monitor_publishes(graph, still_imu, viewers: Path) -> None:
    graph.run('monitor', **{'relay.enabled': True})
    graph.send(graph.publisher(), still_imu(12_000, frame_id='imu_link'))
    # the first fit may have too few samples to resolve N
    for sensor in ('gyro', 'accel'):
        for axis in 'xyz':
            for key in ('N low', 'B high', 'K high'):
                graph.until(lambda name=f'{sensor} {axis}', key=key: graph.value(name, key))
    graph.until(lambda: graph.status('relay'))
    told = {(s.name, v.key): v.value for s in graph.statuses.values() for v in s.values}

    # PlotJuggler: /<topic>/<hardware_id>/<status>/<key>
    series = {
        f'/diagnostics/{s.hardware_id}/{s.name}/{v.key}' for s in graph.statuses.values()
        for v in s.values
    }  # fmt: skip
    drawn = plotjuggler_series(viewers)
    assert len(drawn) == len(set(drawn)) == 2 * 3 * 3 * 3 + 5
    # a term that is not resolved has no lower end
    assert {name for name in drawn if name not in series and ' low [' not in name} == set()
    known = [name for name in drawn if '/N low [' in name]
    assert len(known) == 6 and set(known) <= series

    configs = foxglove_configs(viewers)
    panels = re.findall(r'"(\w+!\w+)"', (viewers / 'foxglove.json').read_text())
    assert set(panels) == set(configs) and all(panels.count(name) == 2 for name in configs)
    form = re.compile(r'/diagnostics\.status\[:\]{name=="(.*)"}\.values\[:\]{key=="(.*)"}\.value')
    for config in configs.values():
        for path in config.get('paths', ()):
            found = form.fullmatch(path['value'])
            assert found and found.groups() in told, path
            if ' high [' in found[2]:
                assert is_number(told[found.groups()])
    topics = dict(graph.node.get_topic_names_and_types())
    for name in ('Image!gyro', 'Image!accel'):
        topic = configs[name]['imageMode']['imageTopic']
        assert topics[topic] == ['sensor_msgs/msg/CompressedImage']
    chosen = configs['DiagnosticStatusPanel!allan']
    assert graph.statuses[chosen['selectedName']].hardware_id == chosen['selectedHardwareId']

    rules = analyzers(viewers)
    for name in graph.statuses:
        (path,) = matching(rules, name)
        assert ('gyro' in name) == (path == 'Gyroscopes')
        assert ('accel' in name) == (path == 'Accelerometers')


def test_the_layout_follows_the_rules_of_plotjuggler(viewers: Path) -> None:
    root = ElementTree.parse(viewers / 'plotjuggler.xml').getroot()
    tabs = root.findall('tabbed_widget/Tab')
    assert len(tabs) == 3 and {len(tab.findall('Container/DockSplitter')) for tab in tabs} == {1}
    for splitter in root.iter('DockSplitter'):
        # one pane per count, and one size per pane
        assert splitter.attrib['orientation'] in ('|', '-')
        assert len(splitter) == int(splitter.attrib['count'])
        assert len(splitter.attrib['sizes'].split(';')) == len(splitter)
        assert {child.tag for child in splitter} <= {'DockSplitter', 'DockArea'}
    for area in root.iter('DockArea'):
        assert area.attrib['name'] and area.find('plot/curve') is not None


@pytest.mark.parametrize(
    ('name', 'path'),
    [
        ('robot1/allan_monitor: left imu_link gyro z', 'Gyroscopes'),
        ('allan_estimator: os_imu accel x', 'Accelerometers'),
        ('allan_estimator: sums', 'Inputs and nodes'),
        ('a/b/allan_imu_relay: relay', 'Inputs and nodes'),
        ('allan_monitor: parameters of /imu_filter_madgwick', 'Inputs and nodes'),
        ('robot1/imu_watcher: left imu_link gyro z', 'Gyroscopes'),
        ('imu_watcher: node', 'Inputs and nodes'),
        ('camera: exposure', None),
        ('battery: relay voltage', None),
    ],
)
def test_every_status_matches_one_analyzer(viewers: Path, name: str, path: str | None) -> None:
    assert matching(analyzers(viewers), name) == ([path] if path else [])
