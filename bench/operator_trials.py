# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages to an operator after a fault, and their delay: trials over real DDS with a 200 Hz
stream.

    python bench/operator_trials.py                   all, about 12 min
    python bench/operator_trials.py louder_2 qos      these

Each trial starts its own monitor. Times count from the fault, or from the start of the process,
until `/diagnostics` names the right cause first; the periods are the defaults. The rows go to
bench/results.md.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from doc_table import DocTable
from online_nodes import Client, Process, start, use_udp
from still_stream import RATE_HZ, STD, Stream

from allan_ros.core.imu import ImuBatch

HEADING = 'trial', 'change', 'first message', 'after', 'measured'
LEVELS = {b'\0': 'OK', b'\1': 'WARN', b'\2': 'ERROR', b'\3': 'STALE'}
PATIENCE_S = 120.0
HEALTHY_S = 30.0
"""Static data in s before a fault, after which there is a noise model."""

TRUE_N = STD[0] / math.sqrt(RATE_HZ)
"""N of the gyro in rad/s/sqrt(Hz)."""

Cells = tuple[str, str, str, str]
TRIALS: dict[str, Callable[[Client], Cells]] = {}


def trial(function: Callable[[Client], Cells]) -> Callable[[Client], Cells]:
    """Register a function in `TRIALS` by its name."""
    TRIALS[function.__name__] = function
    return function


def until(client: Client, holds: Callable[[], object], patience_s: float = PATIENCE_S) -> float:
    """Wait until a condition is true; return the elapsed time in s, NaN if it never is."""
    began = time.monotonic()
    while not holds():
        if time.monotonic() - began > patience_s:
            return math.nan
        client.spin(0.02)
    return time.monotonic() - began


def status(client: Client, ending: str) -> str:
    """Return the level and message of a status; '' if there is none."""
    for name, found in client.statuses.items():
        if name.endswith(ending):
            return f'{LEVELS[found.level]}: {found.message}'
    return ''


def says(client: Client, words: str, *endings: str) -> Callable[[], str]:
    """Return a function that returns the message of one of these statuses if it contains
    ``words``.
    """

    def holds() -> str:
        shown = (status(client, ending) for ending in endings or ('input',))
        return next((text for text in shown if words in text), '')

    return holds


def seconds(value: float) -> str:
    """Return a time as text for the table."""
    return 'never' if math.isnan(value) else f'{value:.1f} s'


def monitor(*ros: str, remap: tuple[str, ...] = (), log: Path | None = None) -> Process:
    """Start a monitor."""
    return start('monitor', ros=ros, remap=remap, log=log)


def healthy_stream(client: Client) -> Stream:
    """Return a stream of an IMU that has been at rest for some time."""
    stream = Stream()
    stream.begin()
    until(client, lambda: float(client.value('input', 'evidence') or 0.0) >= HEALTHY_S)
    until(client, lambda: client.message('gyro z').startswith('N '))
    return stream


def driving(block: ImuBatch) -> ImuBatch:
    """Return the block of a robot that turns left and right at up to 0.5 rad/s and vibrates."""
    t = block.stamps_ns[:, None] * 1e-9 % 1000.0
    rng = np.random.default_rng(int(block.stamps_ns[0] % 2**31))
    samples = block.samples.copy()
    samples[:, :3] += 0.5 * np.sin(2.0 * np.pi * 0.3 * t + np.arange(3))
    samples[:, 3:] += rng.normal(0.0, 1.0, (len(block), 3))
    return replace(block, samples=samples)


def louder(factor: float) -> Callable[[ImuBatch], ImuBatch]:
    """Return a change of blocks that multiplies the noise of all axes."""

    def change(block: ImuBatch) -> ImuBatch:
        mean = np.round(block.samples.mean(axis=0), 1)
        return replace(block, samples=mean + factor * (block.samples - mean))

    return change


@trial
def driving_at_boot(client: Client) -> Cells:
    """Drive for 60 s from the first sample on, then rest."""
    node, stream = monitor('relay.enabled:=true'), Stream(subscribers=2)
    stream.change = driving
    stream.begin()
    said = until(client, says(client, 'never at rest'))
    text = status(client, 'input')
    wrong = filled = 0
    began = time.monotonic()
    while time.monotonic() - began < 60.0 - (0.0 if math.isnan(said) else said):
        client.spin(0.5)
        wrong += client.message('gyro z').startswith('N ')
        filled += bool(client.value('relay', 'variance of gyro z'))
    used = client.value('input', 'used')
    stream.change = lambda block: block
    right = until(client, lambda: _n_is_right(client))
    known = f'{float(client.value("gyro z", "N [rad/s").split()[0]) / TRUE_N:.3f} of the true N'
    stream.end()
    node.end()
    return (
        '60 s of turns up to 0.5 rad/s, then rest',
        text,
        seconds(said),
        f'{used} driving samples used, {wrong} statuses with coefficients, {filled} with filled '
        f'covariances; {known} {seconds(right)} after the drive',
    )


def _n_is_right(client: Client) -> bool:
    ends = [client.value('gyro z', f'N {end} [rad') for end in ('low', 'high')]
    if not all(ends):
        ends = client.value('gyro z', 'N 95 % [rad').split('..')
    return len(ends) == 2 and all(ends) and float(ends[0]) <= TRUE_N <= float(ends[1])


def _louder(client: Client, factor: float, words: str) -> Cells:
    node = monitor()
    stream = healthy_stream(client)
    stream.change = louder(factor)
    axes = [f'{sensor} {letter}' for sensor in ('gyro', 'accel') for letter in 'xyz']
    seen = says(client, words, 'input', *axes)
    took = until(client, seen)
    text = seen()
    client.spin(5.0)
    static = client.value('input', 'evidence')
    stream.change = lambda block: block
    back = until(client, lambda: status(client, 'input').startswith('OK: still'))
    stream.end()
    node.end()
    return (
        f'noise of all axes x {factor:g} for good, after {HEALTHY_S:.0f} s at rest',
        text,
        seconds(took),
        f'{float(static):.0f} s of static data; OK again {seconds(back)} after the noise fell',
    )


@trial
def louder_2(client: Client) -> Cells:
    """Double the noise."""
    return _louder(client, 2.0, 'WARN')


@trial
def louder_3(client: Client) -> Cells:
    """Triple the noise."""
    return _louder(client, 3.0, 'WARN')


@trial
def louder_20(client: Client) -> Cells:
    """Multiply the noise by 20, like that of a loose IMU."""
    return _louder(client, 20.0, 'WARN')


@trial
def wrong_type(client: Client) -> Cells:
    """Publish text on the topic."""
    from std_msgs.msg import String

    publisher = client.node.create_publisher(String, 'imu/data', 10)
    node = monitor()
    first = until(client, lambda: status(client, 'input'))
    took = until(client, says(client, 'has type std_msgs/msg/String'))
    text = status(client, 'input')
    node.end()
    client.node.destroy_publisher(publisher)
    return 'the topic has another type', text, seconds(took), f'first status {seconds(first)}'


@trial
def qos(client: Client) -> Cells:
    """Subscribe reliably to a best effort publisher."""
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import Imu

    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = client.node.create_publisher(Imu, 'imu/data', best_effort)
    node = monitor('qos_overrides./imu/data.subscription.reliability:=reliable')
    first = until(client, lambda: status(client, 'input'))
    took = until(client, says(client, 'is incompatible with the subscription'))
    text = status(client, 'input')
    node.end()
    client.node.destroy_publisher(publisher)
    return (
        'best effort publisher, reliable subscription',
        text,
        seconds(took),
        f'first status {seconds(first)}',
    )


def _stream_fault(
    client: Client, what: str, change: Callable[[ImuBatch], ImuBatch], words: str
) -> Cells:
    node = monitor()
    stream = healthy_stream(client)
    stream.change = change
    other = until(client, lambda: not status(client, 'input').startswith('OK'), 60.0)
    first = status(client, 'input')
    took = other + until(client, says(client, words))
    text = status(client, 'input')
    stream.end()
    node.end()
    same = 'the first warning' if words in first else f'before it, {seconds(other)}: {first}'
    return what, text, seconds(took), same


@trial
def rate_change(client: Client) -> Cells:
    """Halve the rate."""
    return _stream_fault(client, 'rate 200 -> 100 Hz', lambda b: b[::2], 'rate')


@trial
def stamp_leap(client: Client) -> Cells:
    """Set the clock of the stamps one hour ahead."""

    def leap(block: ImuBatch) -> ImuBatch:
        return replace(block, stamps_ns=block.stamps_ns + 3600 * 10**9)

    return _stream_fault(client, 'stamps 1 h ahead', leap, 'jumped ahead')


@trial
def advice(client: Client) -> Cells:
    """Record what the status of an axis says about the missing coefficients."""
    node = monitor()
    stream = healthy_stream(client)
    shown: list[str] = []
    began = time.monotonic()
    while time.monotonic() - began < 90.0:
        client.spin(1.0)
        text = client.value('gyro z', 'next coefficient')
        if text not in ('', 'unknown') and (not shown or shown[-1] != text):
            shown.append(text)
    text = status(client, 'gyro z')
    stream.end()
    node.end()
    return (
        'at rest for 2 min: what is missing',
        text,
        '-',
        f'{len(shown)} different texts in 90 s: {"; ".join(shown) or "none"}',
    )


@trial
def start_up(client: Client) -> Cells:
    """Start the monitor before the driver, with a misspelled parameter."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / 'log'
        path = Path(folder) / 'new' / 'imu.json'
        node = start(
            'monitor',
            ros=(f'checkpoint.path:={path}', 'checkpoint.pth:=x', 'relay.enabled:=true'),
            log=log,
        )
        first = until(client, lambda: status(client, 'input'))
        error = until(client, lambda: status(client, 'input').startswith('ERROR'))
        text = status(client, 'input')
        relay = status(client, 'relay')
        stream = Stream(subscribers=2)
        stream.begin()
        axes = until(client, lambda: status(client, 'gyro z'))
        worst: set[str] = set()
        began = time.monotonic()
        while time.monotonic() - began < 15.0:
            client.spin(0.25)
            if time.monotonic() - began > 2.0:
                worst |= {
                    f'{name.split(": ")[1]} {LEVELS[s.level]}'
                    for name, s in client.statuses.items()
                    if s.level != b'\0'
                }
        stream.end()
        node.end()
        made = path.parent.is_dir()
    return (
        'the monitor starts 1 s or more before the driver',
        text,
        f'{seconds(first)} to the first status, {seconds(error)} more to ERROR',
        f'relay {relay.split(":")[0]}; axes {seconds(axes)} after the first message; not OK in the '
        f'13 s from then on: {", ".join(sorted(worst)) or "nothing"}; folder of the checkpoint '
        f'{"created" if made else "missing"}',
    )


@trial
def two_monitors(client: Client) -> Cells:
    """Start two monitors that relay two IMUs to one topic."""
    one = monitor('relay.enabled:=true', remap=('imu/data:=left/imu',))
    until(client, lambda: status(client, 'relay'))
    two = monitor('relay.enabled:=true', remap=('imu/data:=right/imu', '__node:=second'))
    until(client, lambda: status(client, 'second: relay'))
    took = until(client, says(client, 'publish', 'second: relay', 'allan_monitor: relay'), 20.0)
    text = says(client, 'publish', 'second: relay', 'allan_monitor: relay')()
    one.end()
    two.end()
    return 'two monitors without namespaces, both relay', text, seconds(took), '-'


@trial
def unknown_parameter(client: Client) -> Cells:
    """Give a parameter that does not exist, and an argument that does not exist."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / 'log'
        began = time.monotonic()
        node = Process(
            *('-m', 'allan_ros.nodes', 'monitor', '--ros-args', '-p', 'checkpoint.pth:=x'), log=log
        )
        until(client, lambda: 'did you mean' in log.read_text())
        took = time.monotonic() - began
        node.end()
        lines = [x for x in log.read_text().splitlines() if 'did you mean' in x]
    command = [sys.executable, '-m', 'allan_ros.nodes', 'monitor', '--typo']
    refused = subprocess.run(command, capture_output=True, text=True, check=False)
    text = lines[0].partition(']: ')[2] if lines else 'nothing'
    return (
        'checkpoint.pth:=x, and the argument --typo',
        f'log: {text}',
        seconds(took),
        f'--typo: exit {refused.returncode}, {refused.stderr.splitlines()[-1]}',
    )


def main() -> int:
    """Run the named trials, by default all, each in its own process."""
    use_udp()
    if sys.argv[1:2] == ['--here']:
        name = sys.argv[2]
        row = (name.replace('_', ' '), *TRIALS[name](Client()))
        print(' | '.join(row), flush=True)
        DocTable('operator', HEADING).put(row)
        os._exit(0)  # threads and contexts of the streams
    failed = [
        name
        for name in sys.argv[1:] or TRIALS
        if subprocess.run([sys.executable, __file__, '--here', name], check=False).returncode
    ]
    print(f'failed: {", ".join(failed) or "none"}')
    return bool(failed)


if __name__ == '__main__':
    sys.exit(main())
