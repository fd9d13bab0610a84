# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes that run nodes, and a ROS client, for the benchmarks with real DDS."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'test'))  # contains `support`
TICKS = os.sysconf('SC_CLK_TCK')
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
os.environ.setdefault('ROS_DOMAIN_ID', '99')
# with this variable, each process would compile the package again
os.environ.pop('PYTHONDONTWRITEBYTECODE', None)

EMPTY_SUBSCRIBER = """
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
rclpy.init()
node = rclpy.create_node('empty')
qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
node.create_subscription(Imu, 'imu/data', lambda raw: None, qos, raw=True)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
    pass
"""
"""Program of a subscriber that receives serialized Imu messages and does nothing."""


class Process:
    """A Python process that is started with the arguments ``command``."""

    def __init__(self, *command: str) -> None:
        env = {**os.environ, 'PYTHONPATH': str(ROOT)}
        self.popen = subprocess.Popen([sys.executable, *command], env=env)

    def cpu_s(self) -> float:
        """Return the CPU time of the process so far in s."""
        fields = Path(f'/proc/{self.popen.pid}/stat').read_text().rsplit(') ', 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / TICKS

    def memory_mb(self) -> float:
        """Return the resident memory of the process in MB."""
        text = Path(f'/proc/{self.popen.pid}/status').read_text()
        found = re.search(r'VmRSS:\s+(\d+)', text)
        return int(found[1]) / 1024 if found else float('nan')

    def end(self) -> int:
        """Send SIGTERM, kill the process if it still runs after 60 s, and return the exit code."""
        self.popen.terminate()
        try:
            return self.popen.wait(60)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            return self.popen.wait()


@contextlib.contextmanager
def node(name: str, *arguments: str, ros: Iterable[str] = ()) -> Iterator[Process]:
    """Run a node, or scripts/play.py ('play'), while the block of the with statement runs.

    ``ros`` are parameters, such as 'publish.sums_period:=15.0'.
    """
    given = [x for parameter in ros for x in ('-p', parameter)]
    script = str(ROOT / 'scripts' / 'play.py')
    command = [script] if name == 'play' else ['-m', 'allan_ros.nodes', name]
    started = Process(*command, *arguments, '--ros-args', '--log-level', 'error', *given)
    try:
        yield started
    finally:
        if started.popen.poll() is None:
            started.end()


class Client:
    """A ROS node that receives `/diagnostics` and can publish Imu messages."""

    def __init__(self) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray

        rclpy.init()
        self.node = rclpy.create_node('bench')
        self.statuses: dict[str, Any] = {}
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._hear, 100)

    def _hear(self, message: Any) -> None:
        for status in message.status:
            self.statuses[status.name] = status

    def spin(self, seconds: float) -> None:
        """Process callbacks for a number of seconds."""
        import rclpy

        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            rclpy.spin_once(self.node, timeout_sec=left)

    def value(self, ending: str, key: str) -> str:
        """Return the first value whose key starts with ``key``, or '' if there is none.

        ``ending`` is the end of the name of the status.
        """
        for name, status in self.statuses.items():
            if name.endswith(ending):
                return next((v.value for v in status.values if v.key.startswith(key)), '')
        return ''

    def message(self, ending: str) -> str:
        """Return the message of the status whose name ends with ``ending``, or ''."""
        found = (s.message for name, s in self.statuses.items() if name.endswith(ending))
        return next(found, '')

    def publisher(self) -> Any:
        """Return a publisher of Imu messages, once a subscriber has discovered the publisher."""
        from rclpy.qos import QoSProfile
        from sensor_msgs.msg import Imu
        from support.handshake import Handshake

        publisher = self.node.create_publisher(Imu, 'imu/data', QoSProfile(depth=1000))
        handshake = Handshake(self.node, publisher, 1)
        while not handshake.update():
            self.spin(0.1)
        handshake.close()
        return publisher
