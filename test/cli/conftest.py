# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A small recording for the tests of the verbs."""

from __future__ import annotations

from pathlib import Path

import pytest

from allan_ros.cli.main import main


@pytest.fixture(scope='session')
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the path of an npz recording of six simulated minutes at 50 Hz."""
    path = tmp_path_factory.mktemp('recording') / 'imu.npz'
    assert main(['simulate', str(path), '--preset', 'paper', '--hours', '0.1', '--rate', '50']) == 0
    return path
