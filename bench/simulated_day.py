# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot's day over real DDS: diagnostics each hour, variances for a filter, and true values.

python bench/simulated_day.py [hours] [rate]     eight hours at 25 Hz take about ten minutes

The monitor starts while the robot drives. Then the robot parks for 20 minutes, and works: drives of
8 minutes, stops of 30 s, a break of 30 minutes after every fourth hour. The temperature swings by
10 K, which moves the gyro's bias. The monitor is stopped after a third of the day and killed after
two thirds; at the third start the robot drives again. Samples are sent as fast as the nodes take
them. The table goes to bench/results.md.
"""

from __future__ import annotations

import json
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from doc_table import DocTable
from online_nodes import RELIABLE, Client, Process, start, use_udp
from rclpy.impl.implementation_singleton import rclpy_implementation

from allan_ros.core.imu import ImuBatch
from allan_ros.core.simulate import NoiseTerms, simulate_imu
from allan_ros.io.readers.cdr import encode_imus

GYRO, ACCEL = NoiseTerms(N=5e-5, B=2e-5, K=5e-7), NoiseTerms(N=8e-4, B=3e-4, K=2e-6)
START_NS = 10**18
BOOT_S, PARKED_S, DRIVE_S, STOP_S, BREAK_S = 60.0, 1200.0, 480.0, 30.0, 1800.0
BIAS_PER_KELVIN = 2e-5
"""Gyro bias in rad/s per K, a typical MEMS value."""

SWING_K, DAY_S = 10.0, 86400.0
DEG_PER_SQRT_H = np.pi / 180.0 / 60.0
PATIENCE_S = 120.0
"""Seconds without progress after which messages count as lost."""

FIT_S = 60.0
"""Longest wait for the model of the sums at the end of an hour."""

HEADING = (
    'hour', 'at rest', 'gyro z', 'N / true N', 'static data', 'variance of gyro z / true', 'level',
    'first message',
)  # fmt: skip


def drives(hours: int) -> Iterator[tuple[float, float]]:
    """Yield (start, end) of every drive in s."""
    yield 0.0, BOOT_S
    at = BOOT_S + PARKED_S
    while at < hours * 3600.0:
        yield at, at + DRIVE_S
        rest = BREAK_S if int(at / 3600.0) % 4 == 3 and at % 3600.0 < 1200.0 else STOP_S
        at += DRIVE_S + rest


def day(hours: int, rate: float) -> tuple[ImuBatch, np.ndarray]:
    """Return the samples of the day, and whether each is at rest."""
    batches = list(simulate_imu(hours * 3600.0, rate, [GYRO] * 3, [ACCEL] * 3, start_ns=START_NS))
    stamps = np.concatenate([b.stamps_ns for b in batches])
    samples = np.concatenate([b.samples for b in batches])
    t = (stamps - START_NS) * 1e-9
    samples[:, :3] += BIAS_PER_KELVIN * SWING_K * np.sin(2.0 * np.pi * t / DAY_S)[:, None]
    rng = np.random.default_rng(7)
    still = np.ones(len(t), bool)
    for begin, end in drives(hours):
        rows = (t >= begin) & (t < end)
        still &= ~rows
        n = int(rows.sum())
        phases = rng.uniform(0.0, 2.0 * np.pi, 3)
        turn = np.sin(2.0 * np.pi * 0.3 * t[rows][:, None] + phases)
        samples[rows, :3] += 0.35 * turn + rng.normal(0.0, 0.02, (n, 3))
        samples[rows, 3:] += rng.normal(0.0, 1.0, (n, 3))
    return ImuBatch(stamps, samples, frame_id='imu_link'), still


class Robot:
    """The monitor, its checkpoint and the driver."""

    def __init__(self, folder: Path) -> None:
        self.checkpoint = folder / 'imu.json'
        self.client = Client()
        self.monitor: Process | None = None
        self.received = 0

    def boot(self) -> None:
        """Start the monitor and wait until a publisher has discovered it."""
        self.monitor = start(
            'monitor',
            ros=(
                *RELIABLE,
                f'checkpoint.path:={self.checkpoint}',
                'checkpoint.period:=2.0',
                'publish.sums_period:=0.5',
                'publish.diagnostics_period:=0.5',
                'relay.enabled:=true',
                'input.stale_after:=3600.0',  # nothing is sent while the table is written
            ),
        )
        self.received = 0
        self.client.statuses.clear()
        self.publisher = self.client.publisher(2, keep_all=True)

    def stop(self, number: int) -> None:
        """Stop or kill the monitor."""
        assert self.monitor is not None
        self.monitor.end(number)
        self.client.node.destroy_publisher(self.publisher)
        # A killed node counts as a subscriber for about 20 s more. A publisher would wait for its
        # acknowledgments, and a new node could miss messages sent meanwhile.
        while self.client.node.count_subscribers('imu/data'):
            self.client.spin(0.5)

    def send(self, batch: ImuBatch) -> None:
        """Publish every sample and wait until the monitor has received all."""
        for payload in encode_imus(batch, 'cdr'):
            while True:
                try:
                    self.publisher.publish(bytes(payload))
                    break
                except rclpy_implementation.RCLError:  # the queue of the monitor is full
                    continue
        self.received += len(batch)
        before, since = '', time.monotonic()
        while (now := self.client.value('data input', 'received')) != str(self.received):
            if now != before:
                before, since = now, time.monotonic()
            if time.monotonic() - since > PATIENCE_S:
                raise SystemExit(f'{self.received} sent, {now or "none"} received')
            self.client.spin(0.2)

    def settle(self) -> None:
        """Wait until the coefficients on `/diagnostics` belong to the present sums."""
        self.client.call('/allan_monitor/save')
        deadline = time.monotonic() + FIT_S
        while not (answer := self.client.call('/allan_monitor/fit')).success:
            if 'no sums' in answer.message or time.monotonic() > deadline:
                self.client.spin(1.5)
                return
            self.client.spin(0.5)
        age = float('inf')
        while age > 3.0 and time.monotonic() < deadline:
            self.client.spin(0.5)
            age = float(self.client.value('gyro z', 'fit age') or 'inf')
        self.client.spin(1.5)

    def row(self, name: str, still_s: float, variance: float) -> tuple[str, ...]:
        """Return the row of the table: the present coefficients and the true ones."""
        client = self.client
        worst = max(client.statuses.values(), key=lambda s: s.level)
        level = {b'\0': 'OK', b'\1': 'WARN', b'\2': 'ERROR'}[worst.level]
        estimate = client.value('gyro z', 'N [rad/s')
        known = estimate and estimate[0].isdigit()
        filled = client.value('relay', 'variance of gyro z')
        low, high = (client.value('gyro z', f'N {end} [deg') or '?' for end in ('low', 'high'))
        return (
            name,
            f'{still_s / 60.0:.0f} min',
            client.message('gyro z').partition(' from ')[0],
            f'{float(estimate) / GYRO.N:.3f} ({low}..{high})' if known else '-',
            f'{float(client.value("gyro z", "evidence") or 0.0) / 60.0:.0f} min',
            f'{float(filled) / variance:.2f}' if filled else 'not filled',
            level,
            client.message(worst.name),
        )


def main(hours: int = 8, rate: float = 25.0) -> None:
    """Simulate the day and write the table."""
    use_udp()
    batch, still = day(hours, rate)
    table = DocTable('day', HEADING)
    variance = GYRO.N**2 * rate
    print(f'true N {GYRO.N / DEG_PER_SQRT_H:.4f} deg/sqrt(h), variance {variance:.3g} (rad/s)^2')
    restarts = {hours // 3: signal.SIGTERM, 2 * hours // 3: signal.SIGKILL}
    with tempfile.TemporaryDirectory() as folder:
        robot = Robot(Path(folder))
        robot.boot()
        n = round(rate * 3600.0)
        edges = [('first minute', 0, round(rate * BOOT_S))]
        edges += [('5 min', edges[0][2], round(rate * 300.0))]
        edges += [('1', edges[1][2], n)]
        edges += [(str(hour), (hour - 1) * n, hour * n) for hour in range(2, hours + 1)]
        for name, begin, end in edges:
            robot.send(batch[begin:end])
            robot.settle()
            row = robot.row(name, float(still[:end].sum()) / rate, variance)
            print(json.dumps(row), flush=True)
            table.put(row)
            if name.isdigit() and int(name) in restarts:
                robot.stop(restarts[int(name)])
                robot.boot()
        robot.stop(signal.SIGTERM)


if __name__ == '__main__':
    main(*(int(x) for x in sys.argv[1:2]), *(float(x) for x in sys.argv[2:3]))
