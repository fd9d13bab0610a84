# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Play a recording to allan_monitor over DDS, and show `/diagnostics` in the terminal.

The recording is played as fast as the monitor processes the messages, hours of data in a minute. At
the end, the Allan sums of the monitor are compared with the Allan sums of the offline analysis.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

RELIABLE = [
    *('-p', 'qos_overrides./imu/data.subscription.reliability:=reliable'),
    *('-p', 'qos_overrides./imu/data.subscription.history:=keep_all'),
]
"""Parameters with which no message is lost: the player waits while a queue is full."""

PATIENCE_S = 300.0
ANSWER_S = 10.0


def play(bag: Path, folder: Path, sensor: str) -> int:
    """Play a bag to a monitor. Return 0 if its Allan sums equal the sums in sums.json, else 1."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'  # nodes on this machine only
    checkpoint = folder / 'online_sums.json'
    checkpoint.unlink(missing_ok=True)
    parameters = {
        'checkpoint.path': checkpoint,
        'estimator.sensor': sensor,
        'publish.sums_period': 2.0,
        'input.stale_after': 3600.0,  # no error after the end of the recording
        # a week, because an hour of a fast playback lasts only seconds
        'estimator.recent_window': 604800.0,
    }
    given = [word for name, value in parameters.items() for word in ('-p', f'{name}:={value}')]
    print(f'$ ros2 run allan_ros allan_monitor  # and: scripts/play.py {bag} --rate 0; allan_watch')
    monitor = _start('monitor', '--ros-args', *RELIABLE, *given)
    watch = _start('watch')
    script = Path(__file__).with_name('play.py')
    player = subprocess.Popen([sys.executable, str(script), str(bag), '--rate', '0'])
    began = time.monotonic()
    try:
        if player.wait():
            return 1
        took = time.monotonic() - began
        _fit()
        time.sleep(2.0)  # until allan_watch has shown the last coefficients
    finally:
        for process in (watch, player, monitor):
            if process.poll() is None:
                process.terminate()
            process.wait()
    online, offline = (
        json.loads(path.read_text())['sums'] for path in (checkpoint, folder / 'sums.json')
    )
    verdict = 'identical to' if online == offline else 'DIFFERENT FROM'
    print(f'\nplayed in {took:.0f} s; the sums of the monitor are {verdict} the offline analysis')
    return int(online != offline)


def _start(name: str, *arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, '-m', 'allan_ros.nodes', name, *arguments])


def _fit() -> None:
    """Let the monitor save and fit its Allan sums, and wait for the noise model of all samples."""
    import rclpy
    from std_msgs.msg import String
    from std_srvs.srv import Trigger

    from allan_ros.nodes.shell import LATCHED

    rclpy.init()
    node = rclpy.create_node('demo')
    deadline = time.monotonic() + PATIENCE_S

    def call(service: str) -> Any:
        client = node.create_client(Trigger, f'/allan_monitor/{service}')
        if not client.wait_for_service(PATIENCE_S):
            raise TimeoutError(service)
        # The node cannot answer before it has discovered the client, so the call is repeated.
        while time.monotonic() < deadline:
            future = client.call_async(Trigger.Request())
            rclpy.spin_until_future_complete(node, future, timeout_sec=ANSWER_S)
            if future.done():
                return future.result()
        raise TimeoutError(service)

    saved = call('save')
    while not call('fit').success and time.monotonic() < deadline:
        time.sleep(0.5)  # an earlier fit is still running
    samples = int(saved.message.rsplit(': ', 1)[1].split()[0])
    models: list[int] = []
    node.create_subscription(
        String,
        '/allan_monitor/noise_model',
        lambda message: models.append(json.loads(message.data)['samples']),
        LATCHED,
    )
    while samples not in models and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.5)
    node.destroy_node()
    rclpy.shutdown()
