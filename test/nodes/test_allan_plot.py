# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Allan plot is published as a PNG, and drawn only while there is a subscriber."""

from __future__ import annotations

import io
import sys

import pytest

pytest.importorskip('rclpy')

OK = b'\x00'
QUICK = {'estimator.method': 'relative', 'estimator.plot_period': 1.0}
TOPIC = '/allan_monitor/allan_plot/gyro/compressed'


def subscribe(graph, topic: str = TOPIC) -> list:
    from sensor_msgs.msg import CompressedImage

    pictures: list = []
    graph.node.create_subscription(CompressedImage, topic, pictures.append, 1)
    return pictures


def test_the_plot_is_drawn_for_who_subscribes_and_not_before(graph, still_imu, monkeypatch):
    image = pytest.importorskip('matplotlib.image')
    monkeypatch.delitem(sys.modules, 'allan_ros.io.plots', raising=False)
    monkeypatch.delattr('allan_ros.io.plots', raising=False)
    graph.run('monitor', **QUICK)
    graph.send(graph.publisher(), still_imu(6000))
    models = graph.latched('/allan_monitor/noise_model')
    graph.model_of(6000)
    assert 'allan_ros.io.plots' not in sys.modules
    pictures = subscribe(graph)
    picture = graph.until(lambda: pictures and pictures[-1])
    assert picture.format == 'png' and picture.header.stamp.sec > 0
    height, width, _ = image.imread(io.BytesIO(bytes(picture.data)), format='png').shape
    assert width > 800 and height > 500
    assert len(picture.data) < 1_000_000
    graph.spin(2.0)
    assert len(pictures) <= len(models)  # nothing new to show: nothing is drawn


def test_a_missing_matplotlib_is_reported_once_and_all_else_works(
    graph, still_imu, monkeypatch, capfd
):
    monkeypatch.delitem(sys.modules, 'allan_ros.io.plots', raising=False)
    monkeypatch.delattr('allan_ros.io.plots', raising=False)
    monkeypatch.setitem(sys.modules, 'matplotlib', None)
    graph.run('monitor', **QUICK)
    pictures = subscribe(graph)
    graph.send(graph.publisher(), still_imu(6000))
    said: list[str] = []

    def reported() -> bool:
        said.append(capfd.readouterr().err)
        return 'no allan_plot' in ''.join(said)

    graph.until(reported)
    graph.spin(1.5)
    reported()
    assert ''.join(said).count('no allan_plot') == 1
    assert 'install python3-matplotlib' in ''.join(said) and 'Traceback' not in ''.join(said)
    assert graph.status('gyro x').level == OK and not pictures
