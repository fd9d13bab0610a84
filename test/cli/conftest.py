# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A small recording for the tests of the verbs, and its analysis."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from allan_ros.cli.main import main


@pytest.fixture(scope='session')
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the path of an npz recording of six simulated minutes at 50 Hz."""
    path = tmp_path_factory.mktemp('recording') / 'imu.npz'
    assert main(['simulate', str(path), '--preset', 'paper', '--hours', '0.1', '--rate', '50']) == 0
    return path


@pytest.fixture(scope='session')
def analyzed(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder ``run`` of an analysis of the recording, which no test may change."""
    folder = tmp_path_factory.mktemp('analyzed') / 'run'
    words = ['--export', 'vins_fusion,basalt,gtsam', '-q', '-o', str(folder)]
    assert main(['analyze', str(recording), *words]) == 0
    return folder


@pytest.fixture(scope='session')
def sheet(tmp_path_factory: pytest.TempPathFactory) -> Callable[[float], str]:
    """Return a function that writes a datasheet with a limit of N of the gyro in deg/sqrt(h)."""

    def write(arw: float) -> str:
        path = tmp_path_factory.mktemp('sheet') / 'test.yaml'
        path.write_text(
            'schema: allan_ros/sensor/1\nname: TEST\nmaker: M\n'
            'sources: {d: {title: t, url: "https://example.org", seen: datasheet}}\n'
            f'gyro:\n  arw: {{value: {arw}, unit: deg/sqrt(h)}}\n'
        )
        return str(path)

    return write
