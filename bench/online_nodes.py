# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes and a client for the benchmarks over real DDS."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'test'))  # the package `support`
TICKS = os.sysconf('SC_CLK_TCK')
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
os.environ.setdefault('ROS_DOMAIN_ID', '99')

ANSWER_S = 10.0
"""Seconds after which an unanswered service is called again."""

RELIABLE = (
    'qos_overrides./imu/data.subscription.reliability:=reliable',
    'qos_overrides./imu/data.subscription.history:=keep_all',
)
"""Parameters with which no message of a played recording is lost at any speed."""


def use_udp() -> None:
    """Let all nodes of this run use UDP, because a killed node may leave shared memory locked."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SYSTEM_DEFAULT'  # as in the profile
    for variable in ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE'):
        os.environ[variable] = str(ROOT / 'config' / 'fastdds' / 'loopback_udp.xml')


class Process:
    """A Python process, its CPU time and memory.

    Parameters
    ----------
    *command : str
        Arguments of Python.
    prefix : sequence of str
        Command that runs it, such as ``('nice', '-n', '19')``.
    env : mapping of str
        Added to the environment.
    log : Path, optional
        File for its output; by default the output of this process.
    """

    def __init__(
        self,
        *command: str,
        prefix: Sequence[str] = (),
        env: Mapping[str, str] | None = None,
        log: Path | None = None,
    ) -> None:
        with contextlib.ExitStack() as stack:
            out = stack.enter_context(log.open('wb')) if log else None
            self.popen = subprocess.Popen(
                [*prefix, sys.executable, *command],
                env={**os.environ, 'PYTHONPATH': str(ROOT), **(env or {})},
                stdout=out,
                stderr=subprocess.STDOUT if out else None,
            )

    def cpu_s(self) -> float:
        """Return the CPU time used so far, in s."""
        fields = Path(f'/proc/{self.popen.pid}/stat').read_text().rsplit(') ', 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / TICKS

    def memory_mb(self) -> float:
        """Return the resident memory in MB."""
        text = Path(f'/proc/{self.popen.pid}/status').read_text()
        found = re.search(r'VmRSS:\s+(\d+)', text)
        return int(found[1]) / 1024 if found else float('nan')

    def end(self, number: int = signal.SIGTERM) -> int:
        """Send a signal and return the exit code; the process is killed if it does not end."""
        self.popen.send_signal(number)
        try:
            return self.popen.wait(60)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            return self.popen.wait()


def start(
    name: str, *arguments: str, ros: Iterable[str] = (), remap: Iterable[str] = (), **how: Any
) -> Process:
    """Start a node, or 'play' (scripts/play.py), with parameters ``name:=value`` and remappings
    ``old:=new``.

    ``how`` is passed to `Process`.
    """
    given = [x for parameter in ros for x in ('-p', parameter)]
    given += [x for names in remap for x in ('-r', names)]
    ros_args = ['--ros-args', '--log-level', 'error', *given]
    script = str(ROOT / 'scripts' / 'play.py')
    command = [script] if name == 'play' else ['-m', 'allan_ros.nodes', name]
    return Process(*command, *arguments, *ros_args, **how)


@contextlib.contextmanager
def node(name: str, *arguments: str, **how: Any) -> Iterator[Process]:
    """Run a node during the block."""
    started = start(name, *arguments, **how)
    try:
        yield started
    finally:
        if started.popen.poll() is None:
            started.end()


class Client:
    """A node that receives diagnostics, publishes Imu and calls services."""

    def __init__(self) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray

        rclpy.init()
        self.node = rclpy.create_node('bench')
        self.statuses: dict[str, Any] = {}
        self.on_status: Callable[[Any], None] = lambda status: None
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._hear, 100)

    def _hear(self, message: Any) -> None:
        for status in message.status:
            self.statuses[status.name] = status
            self.on_status(status)

    def spin(self, seconds: float) -> None:
        """Spin for a duration."""
        import rclpy

        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            rclpy.spin_once(self.node, timeout_sec=left)

    def value(self, ending: str, key: str) -> str:
        """Return one value of the status whose name ends with ``ending``; empty if there is
        none.
        """
        for name, status in self.statuses.items():
            if name.endswith(ending):
                return next((v.value for v in status.values if v.key.startswith(key)), '')
        return ''

    def message(self, ending: str) -> str:
        """Return the message of the status whose name ends with ``ending``; empty if there is
        none.
        """
        found = (s.message for name, s in self.statuses.items() if name.endswith(ending))
        return next(found, '')

    def publisher(self, wanted: int = 1, keep_all: bool = False) -> Any:
        """Return a publisher of Imu, once ``wanted`` subscribers have discovered it."""
        from rclpy.qos import HistoryPolicy, QoSProfile
        from sensor_msgs.msg import Imu
        from support.handshake import Handshake

        qos = QoSProfile(history=HistoryPolicy.KEEP_ALL) if keep_all else QoSProfile(depth=1000)
        publisher = self.node.create_publisher(Imu, 'imu/data', qos)
        handshake = Handshake(self.node, publisher, wanted)
        while not handshake.update():
            self.spin(0.1)
        handshake.close()
        return publisher

    def call(self, service: str) -> Any:
        """Call a Trigger service and return its response.

        An answer to a client that the node has not discovered yet is lost; then the call is
        repeated. So the service must be safe to call twice.
        """
        from std_srvs.srv import Trigger

        client = self.node.create_client(Trigger, service)
        client.wait_for_service()
        while True:
            future, since = client.call_async(Trigger.Request()), time.monotonic()
            while time.monotonic() - since < ANSWER_S:
                if future.done():
                    return future.result()
                self.spin(0.1)
