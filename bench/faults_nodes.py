# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that are killed with SIGKILL and restarted some seconds later, and a second node."""

from __future__ import annotations

import math
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from fault_harness import DiagnosticsLog, Row, Trial, fault
from online_nodes import Client, Process, node, start
from still_stream import Stream

DOWN_S = 8.0
"""Seconds until a killed node is restarted, as by an operator."""

QUICK_SUMS = 'publish.sums_period:=2.0'
"""Parameters for trials of a minute; the default period is 10 s."""


class Watch:
    """`allan_watch`, which reports nodes that have stopped publishing."""

    def __init__(self, folder: Path) -> None:
        self._log = folder / 'watch.log'
        self._process = Process('-m', 'allan_ros.nodes', 'watch', '--plain', log=self._log)

    def stale(self, name: str) -> str:
        """Return the first line that reports a status with this prefix as stale; '' without one."""
        lines = (line.split(' ', 1)[-1] for line in self._log.read_text().splitlines())
        found = next((x for x in lines if x.startswith('STALE') and name in x), '')
        return f'allan_watch: {found}' if found else ''

    def end(self) -> None:
        """End the process."""
        self._process.end()


def _title(name: str) -> str:
    return f'kill -9 of {name}, started again after {DOWN_S:.0f} s'


@fault()
def kill_monitor(client: Client, folder: Path) -> Row:
    """The monitor is killed between two checkpoints."""
    watch = Watch(folder)
    row = _kill_watching(client, folder, 'monitor')
    stale = watch.stale('input')
    watch.end()
    return replace(row, message=stale or 'nothing', delay='5 s' if stale else '-')


@fault()
def kill_accumulator(client: Client, folder: Path) -> Row:
    """The accumulator is killed; an estimator subscribes to it."""
    with node('estimator', ros=(QUICK_SUMS,), remap=('sums:=/allan_accumulator/sums',)):
        return _kill_watching(client, folder, 'accumulator')


def _kill_watching(client: Client, folder: Path, name: str) -> Row:
    trial = Trial(client, folder, ('checkpoint.period:=5.0', QUICK_SUMS), name)
    with trial.fault():
        trial.watched.end(signal.SIGKILL)
        trial.spin(DOWN_S)
    trial.start()
    return trial.row(_title(f'allan_{name}'), 'checkpoint.period 5 s', same=False)


@fault()
def kill_estimator(client: Client, folder: Path) -> Row:
    """The estimator is killed; the accumulator continues."""
    how: dict[str, Any] = {'ros': (QUICK_SUMS,), 'remap': ('sums:=/allan_accumulator/sums',)}
    watch, estimator = Watch(folder), start('estimator', **how)
    trial = Trial(client, folder, (QUICK_SUMS,), 'accumulator')
    fitted = trial.log.until(lambda: ' N ' in f' {client.message("gyro x")}')
    if math.isnan(fitted):
        raise SystemExit('the estimator says no N')
    with trial.fault():
        estimator.end(signal.SIGKILL)
        trial.spin(DOWN_S)
    client.statuses.clear()
    estimator = start('estimator', **how)
    again = trial.log.until(lambda: ' N ' in f' {client.message("gyro x")}')
    stale = watch.stale('gyro x')
    watch.end()
    row = trial.row(_title('allan_estimator'))
    code = estimator.end(signal.SIGINT)
    return replace(
        row,
        message=stale or 'nothing',
        delay='5 s' if stale else '-',
        recovered=f'coefficients after {again - trial.ended:.1f} s',
        exits=f'{row.exits}, {code}',
    )


@fault()
def kill_relay(client: Client, folder: Path) -> Row:
    """The relay is killed; its subscribers receive nothing."""
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import Imu

    filled: list[tuple[float, bool]] = []

    def on_imu(message: Imu) -> None:
        filled.append((time.monotonic(), message.angular_velocity_covariance[0] > 0.0))

    client.node.create_subscription(Imu, 'imu/data_with_covariance', on_imu, QoSProfile(depth=1000))
    remap = ('noise_model:=/allan_monitor/noise_model',)
    watch, relay = Watch(folder), start('relay', remap=remap)
    trial = Trial(client, folder, (QUICK_SUMS,), stream=lambda: Stream(subscribers=2))
    trial.log.until(lambda: bool(filled) and filled[-1][1])
    with trial.fault():
        relay.end(signal.SIGKILL)
        made = trial.stream.made
        trial.spin(DOWN_S)
    relay = start('relay', remap=remap)
    before = len(filled)
    trial.log.until(lambda: len(filled) > before)
    lost = trial.stream.made - made
    again = filled[before][0] - trial.ended
    trial.log.until(lambda: filled[-1][1])
    known = next(at for at, is_filled in filled[before:] if is_filled) - trial.ended
    stale = watch.stale('relay')
    watch.end()
    row = trial.row(_title('allan_imu_relay'), f'{lost} messages were not relayed')
    code = relay.end(signal.SIGINT)
    return replace(
        row,
        message=stale or 'nothing',
        delay='5 s' if stale else '-',
        recovered=f'messages after {again:.1f} s, filled after {known:.1f} s',
        exits=f'{row.exits}, {code}',
    )


@fault()
def kill_player(client: Client, folder: Path) -> Row:
    """The player is killed in the middle of a recording."""
    log = DiagnosticsLog(client)
    checkpoint = folder / 'imu.json'
    monitor = start('monitor', ros=(f'checkpoint.path:={checkpoint}',))
    arguments = ('--simulate', '300')
    player = start('play', *arguments)
    log.until(lambda: bool(log.grew) and float(client.value('input', 'evidence')) > 12.0)
    began = time.monotonic()
    player.end(signal.SIGKILL)
    client.spin(DOWN_S)
    ended = time.monotonic()
    player = start('play', *arguments)
    log.until(lambda: not math.isnan(log.static_data_grew_since(ended)))
    client.spin(8.0)
    lost = client.value('input', 'lost on the way')
    received, used = (int(client.value('input', key)) for key in ('received', 'used'))
    shown_s, words = log.first_since(began)
    codes = player.end(signal.SIGINT), monitor.end(signal.SIGINT)
    return Row(
        _title('the player'),
        f'{received - used} of {received} received, {lost} on the way',
        words or 'nothing',
        f'{shown_s - began:.1f} s',
        f'{log.static_data_grew_since(ended) - ended:.1f} s',
        ', '.join(map(str, codes)),
    )


@fault()
def second_node(client: Client, folder: Path) -> Row:
    """A second node is started with the same checkpoint."""
    trial = Trial(client, folder)

    def shown() -> tuple[float, str]:
        """Return time and text of the message about the checkpoint; NaN and empty without one."""
        return next((x for x in trial.log.messages if 'in use by' in x[1]), (math.nan, ''))

    with trial.fault():
        other = start('accumulator', ros=(f'checkpoint.path:={trial.checkpoint}',))
        trial.log.until(lambda: bool(shown()[1]))
        trial.spin(DOWN_S)
        code = other.end(signal.SIGINT)
    row = trial.row(f'a second node on the same checkpoint for {DOWN_S:.0f} s')
    shown_s, words = shown()
    return replace(
        row,
        message=words.replace(f'{folder}/', '') or 'nothing',
        delay=f'{shown_s - trial.began:.1f} s',
        exits=f'{row.exits}, {code}',
    )
