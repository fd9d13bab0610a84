# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the network between a robot, where the player runs, and a station with the monitor.

Each is a network namespace with a tap interface. `lossy_link.py` forwards packets between them and
loses some at random on request. The shared memory, which both could access, is turned off.
"""

from __future__ import annotations

import contextlib
import json
import math
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from fault_harness import DiagnosticsLog, Row, fault
from online_nodes import Client, start

ROBOT, STATION = 'allan_robot', 'allan_station'
ADDRESS = {ROBOT: '10.77.0.1/24', STATION: '10.77.0.2/24'}
ON_ROBOT = ('ip', 'netns', 'exec', ROBOT)
INSIDE = ('ip', 'netns', 'exec', STATION)
"""Prefix that runs a command on the station, where the process of a fault runs, too."""

TRANSPORT = {'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4', 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}
"""Environment of commands on the station."""

LINK = Path(__file__).with_name('lossy_link.py')
LOSS = Path(tempfile.gettempdir()) / 'allan_ros_loss_percent'
"""File from which `lossy_link.py` reads the percentage of packets to lose."""
HEALTHY_S = 12.0
AFTER_S = 8.0


@contextlib.contextmanager
def namespaces(wanted: bool) -> Iterator[None]:
    """Create the network namespaces of robot and station within the block."""
    if not wanted:
        yield
        return
    with contextlib.ExitStack() as stack:
        for name in (ROBOT, STATION):
            _ip('netns', 'add', name)
            stack.callback(_ip, 'netns', 'delete', name)
        LOSS.write_text('0')
        link = subprocess.Popen(
            [sys.executable, str(LINK), ROBOT, STATION, str(LOSS)], stdout=subprocess.PIPE
        )
        stack.callback(link.wait)
        stack.callback(link.kill)
        assert link.stdout is not None
        link.stdout.readline()  # both interfaces exist
        for name, address in ADDRESS.items():
            _ip('link', 'set', name, 'netns', name)
            _ip('-n', name, 'address', 'add', address, 'dev', name)
            _ip('-n', name, 'link', 'set', 'lo', 'up')
            _up(name)
        yield


def _ip(*arguments: str) -> None:
    subprocess.run(['ip', *arguments], check=True)


def _up(name: str) -> None:
    """Enable the interface and add the route for multicast, which is lost when it is disabled."""
    _ip('-n', name, 'link', 'set', name, 'up')
    _ip('-n', name, 'route', 'replace', '224.0.0.0/4', 'dev', name)


@fault('network')
def link_down(client: Client, folder: Path) -> Row:
    """The network cable of the robot is unplugged."""

    def pull(spin: Callable[[float], None]) -> None:
        _ip('-n', ROBOT, 'link', 'set', ROBOT, 'down')
        spin(10.0)
        _up(ROBOT)

    return _over_the_network(client, folder, 'network interface down for 10 s', pull)


@fault('network')
def network_loses_5(client: Client, folder: Path) -> Row:
    """The network loses 5 % of its packets."""
    return _loss(client, folder, 5)


@fault('network')
def network_loses_30(client: Client, folder: Path) -> Row:
    """The network loses 30 % of its packets."""
    return _loss(client, folder, 30)


def _loss(client: Client, folder: Path, percent: int) -> Row:
    def lose(spin: Callable[[float], None]) -> None:
        LOSS.write_text(str(percent))
        spin(20.0)
        LOSS.write_text('0')

    name = f'the network loses {percent} % of the packets for 20 s'
    return _over_the_network(client, folder, name, lose)


def _over_the_network(
    client: Client, folder: Path, name: str, put_in: Callable[[Callable[[float], None]], None]
) -> Row:
    log, checkpoint = DiagnosticsLog(client), folder / 'imu.json'
    monitor = start('monitor', ros=(f'checkpoint.path:={checkpoint}',))
    player = start('play', '--simulate', '600', prefix=ON_ROBOT)
    log.until(lambda: bool(log.grew) and float(client.value('input', 'evidence')) > HEALTHY_S)
    began = log.until(lambda: True)
    put_in(client.spin)
    ended = log.until(lambda: True)
    log.until(lambda: not math.isnan(log.static_data_grew_since(ended)))
    client.spin(AFTER_S)
    codes = player.end(signal.SIGINT), monitor.end(signal.SIGINT)
    counts = json.loads(checkpoint.read_text())['counts']
    shown_s, words = log.first_since(began)
    grew = log.static_data_grew_since(ended)
    received, missing = counts['received'], counts['lost']
    return Row(
        name,
        f'{missing} of {received + missing} ({client.value("input", "lost on the way")} known to '
        f'be lost on the way, {counts["bridged"]} interpolated)',
        words or 'nothing',
        f'{shown_s - began:.1f} s' if words else '-',
        'never' if math.isnan(grew) else f'{grew - ended:.1f} s',
        ', '.join(map(str, codes)),
    )
