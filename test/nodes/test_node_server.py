# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The process that forks the nodes of the tests leaves no process behind."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip('rclpy')

from support.node_server import PATIENCE_S, NodeProcess, NodeServer


def runs(pid: int) -> bool:
    """Return whether a process is running; only its parent may wait for it."""
    try:
        state = Path(f'/proc/{pid}/stat').read_text().rpartition(') ')[2][0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in 'XZ'


@pytest.mark.skipif(sys.platform != 'linux', reason='other systems do not signal it')
def test_nodes_end_with_their_server(ros_domain: int, tmp_path: Path) -> None:
    server = NodeServer(Path(__file__).resolve().parents[2])
    environment = {**os.environ, 'ROS_LOG_DIR': str(tmp_path)}
    node = NodeProcess(server, ['monitor'], environment, tmp_path / 'log')
    deadline = time.monotonic() + PATIENCE_S
    while 'monitors /imu/data' not in node.output:
        assert time.monotonic() < deadline, node.output
        time.sleep(0.05)
    assert runs(node.pid)
    server.kill()
    while runs(node.pid):
        assert time.monotonic() < deadline
        time.sleep(0.05)
