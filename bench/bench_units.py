# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Error rates of `allan check` with a test plan: IMUs with a simulated fault, and good IMUs.

    python bench/bench_units.py                   each fault once, 20 good IMUs
    python bench/bench_units.py --good 100        false alarms, as in docs/production.md
    python bench/bench_units.py --seed 7          other noise, sizes and axes of the faults

A *unit* is a simulated recording of one IMU with a turn-on bias, 10 min at 100 Hz. The exit code
must be 0 for a good unit, and not 0 for a unit with a fault. The seed determines the noise, and the
size, axis and time of each fault.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import allan_ros as ar
from allan_ros.cli.main import main as allan

RATE, MINUTES = 100.0, 10.0
GRAVITY = 9.80665

PLAN = """
schema: allan_ros/plan/1
name: line 4
gyro:
  N: {lower: 0.1, upper: 0.36, unit: deg/sqrt(h)}
  B: {upper: 30, unit: deg/h}
  bias: {lower: -0.6, upper: 0.6, unit: deg/s}
  drift: {upper: 0.05, unit: deg/s}
  bandwidth: {lower: 35, unit: Hz}
accel:
  N: {lower: 0.006, upper: 0.03, unit: m/s/sqrt(h)}
  B: {upper: 60, unit: ug}
  bias: {lower: -40, upper: 40, unit: mg}
  drift: {upper: 3, unit: mg}
  bandwidth: {lower: 35, unit: Hz}
gravity: {lower: 9.7, upper: 9.91, unit: m/s^2}
orientation: {up: [0, 0, 1], upper: 3, unit: deg}
rate: {lower: 99, upper: 101, unit: Hz}
duration: {lower: 9.5, unit: min}
used: {lower: 98, unit: "%"}
"""


class Unit:
    """The samples of one simulated IMU; the functions of the faults change them in place."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        batch = ar.simulate(MINUTES / 60.0, RATE, seed=seed)
        self.t = np.arange(len(batch.samples)) / RATE
        bias = self.random.normal(scale=[np.radians(0.15)] * 3 + [0.025] * 3)
        self.rows = batch.samples + bias
        self.gyro, self.accel = self.rows[:, :3], self.rows[:, 3:]
        self.x, self.a = self.random.integers(0, 3, 2)  # axes with a fault
        self.size = float(self.random.uniform(0.8, 1.3))  # multiplies the size of a fault
        self.half = int(len(self.t) * self.random.uniform(0.3, 0.6))

    @property
    def noise(self) -> float:
        """Standard deviation in rad/s of the white noise of the gyro axis that a fault changes."""
        return float(np.std(np.diff(self.gyro[:, self.x])) / np.sqrt(2.0))

    def keep(self, rows: np.ndarray) -> None:
        self.t, self.rows = self.t[rows], self.rows[rows]


def dead_gyro(u: Unit) -> None:
    u.gyro[u.half :, u.x] = u.gyro[u.half, u.x]


def dead_accel(u: Unit) -> None:
    u.accel[:, u.a] = GRAVITY * (u.a == 2)


def dead_for_a_while(u: Unit) -> None:
    u.gyro[u.half : u.half + 3_000, u.x] = 0.0


def clipped_gyro(u: Unit) -> None:
    y = u.gyro[:, u.x]
    np.minimum(y, y.mean() + 0.5 * u.noise, out=y)


def clipped_late(u: Unit) -> None:
    y = u.gyro[u.half :, u.x]
    np.maximum(y, y.mean() - 0.3 * u.noise, out=y)


def clipped_accel(u: Unit) -> None:
    u.accel[:, 2] = np.minimum(u.accel[:, 2], np.median(u.accel[:, 2]))


def cut(u: Unit) -> None:
    u.keep(np.arange(len(u.t)) < 0.3 * u.size * len(u.t))


def not_numbers(u: Unit) -> None:
    u.gyro[u.random.random(len(u.t)) < 0.01 * u.size, u.x] = np.nan


def vibration(u: Unit) -> None:
    u.gyro[:, u.x] += 1.5 * u.size * u.noise * np.sin(2.0 * np.pi * 31.7 * u.size * u.t)


def slow_vibration(u: Unit) -> None:
    u.rows[:, 3 + u.a] += 3e-2 * u.size * np.sin(2.0 * np.pi * 0.1 * u.t)


def radians(u: Unit) -> None:
    u.gyro /= 57.29578


def degrees(u: Unit) -> None:
    u.gyro *= 57.29578


def half_rate(u: Unit) -> None:
    u.keep(np.arange(len(u.t)) % 2 == 0)


def relabeled_rate(u: Unit) -> None:
    u.t *= 1.0 + 0.05 * u.size


def swapped(u: Unit) -> None:
    u.accel[:] = u.accel[:, [2, 1, 0]] if u.a else u.accel[:, [0, 2, 1]]


def inverted(u: Unit) -> None:
    u.accel[:, 2] *= -1.0


def upside_down_gyro_bias(u: Unit) -> None:
    u.gyro[:, u.x] += np.radians(-3.0 * u.size)


def accel_bias(u: Unit) -> None:
    u.accel[:, u.a] += 0.7 * u.size


def accel_scale(u: Unit) -> None:
    u.accel *= 1.0 - 0.08 * u.size


def filtered(u: Unit) -> None:
    from scipy import signal

    y = signal.lfilter(*signal.butter(2, 2.0 * 5.0 * u.size / RATE), u.gyro - u.gyro[0], axis=0)
    u.gyro[:] = y + u.gyro[0]


def filtered_accel(u: Unit) -> None:
    y, keep = u.accel.copy(), np.exp(-2.0 * np.pi * 4.0 * u.size / RATE)
    for i in range(1, len(y)):
        y[i] = keep * y[i - 1] + (1.0 - keep) * y[i]
    u.accel[:] = y


def thermal(u: Unit) -> None:
    u.gyro[:, u.x] += np.radians(0.7 * u.size) * u.t / u.t[-1]


def settling(u: Unit) -> None:
    u.gyro[:, u.x] += np.radians(0.3 * u.size) * np.exp(-u.t / 120.0)


def in_g(u: Unit) -> None:
    u.accel /= GRAVITY


def labeled_g(u: Unit) -> None:
    u.accel *= GRAVITY


def noisy_gyro(u: Unit) -> None:
    u.gyro[:, u.x] += 2.0 * u.size * u.noise * u.random.normal(size=len(u.t))


def noisy_accel(u: Unit) -> None:
    y = u.accel[:, u.a]
    y += 3.0 * np.std(np.diff(y)) / np.sqrt(2.0) * u.random.normal(size=len(y))


def quiet_gyro(u: Unit) -> None:
    y = u.gyro[:, u.x]
    y[:] = y.mean() + 0.2 * u.size * (y - y.mean())


def flicker(u: Unit) -> None:
    f = np.fft.rfftfreq(2 * len(u.t))[1:]
    z = (u.random.normal(size=len(f)) + 1j * u.random.normal(size=len(f))) / np.sqrt(f)
    y = np.fft.irfft(np.r_[0.0, z])[: len(u.t)]
    u.gyro[:, u.x] += 8e-4 * u.size * (y - y.mean()) / y.std()


def walk(u: Unit) -> None:
    steps = u.random.normal(size=len(u.t)) * 2e-4 * u.size / np.sqrt(RATE)
    u.gyro[:, u.x] += np.cumsum(steps)


def lost(u: Unit) -> None:
    u.keep(u.random.random(len(u.t)) > 0.05 * u.size)


def gap(u: Unit) -> None:
    u.keep((np.arange(len(u.t)) < u.half) | (np.arange(len(u.t)) > u.half + 3_000))


def heavy_tails(u: Unit) -> None:
    hit = u.random.random(len(u.t)) < 0.03
    u.gyro[hit, u.x] += 10.0 * u.noise * u.random.normal(size=np.count_nonzero(hit))


def repeats(u: Unit) -> None:
    for i in np.flatnonzero(u.random.random(len(u.t) - 1) < 0.2) + 1:
        u.rows[i] = u.rows[i - 1]


def no_gyro(u: Unit) -> None:
    u.gyro[:] = 0.0


def popcorn(u: Unit) -> None:
    edges = np.sort(u.random.integers(0, len(u.t), 8))
    for first, last in zip(edges[::2], edges[1::2]):
        u.gyro[first:last, u.x] += np.radians(0.08 * u.size)


def tilted(u: Unit) -> None:
    u.accel[u.half :, u.a % 2] += 0.15 * u.size


def moved(u: Unit) -> None:
    part = slice(u.half, u.half + 2_000)
    u.rows[part] += 0.3 * np.sin(2.0 * np.pi * 0.7 * u.t[part])[:, None]


def spikes(u: Unit) -> None:
    u.gyro[u.random.integers(0, len(u.t), 60), u.x] += np.radians(20.0)


def coarse(u: Unit) -> None:
    step = np.radians(0.5 * u.size)
    u.gyro[:] = np.rint(u.gyro / step) * step


def noisier(u: Unit) -> None:
    y = u.gyro[u.half :, u.x]
    y += 0.9 * u.size * u.noise * u.random.normal(size=len(y))


def copied(u: Unit) -> None:
    u.gyro[:, u.x] = u.gyro[:, (u.x + 1) % 3]


FAULTS: tuple[Callable[[Unit], None], ...] = (
    *(dead_gyro, dead_accel, dead_for_a_while, clipped_gyro, clipped_late, clipped_accel),
    *(cut, not_numbers, vibration, slow_vibration, radians, degrees, half_rate, relabeled_rate),
    *(swapped, inverted, upside_down_gyro_bias, accel_bias, accel_scale, filtered),
    *(filtered_accel, thermal, settling, in_g, labeled_g, noisy_gyro, noisy_accel, quiet_gyro),
    *(flicker, walk, lost, gap, heavy_tails, repeats, no_gyro, popcorn, tilted, moved, spikes),
    *(coarse, noisier, copied),
)


def write(folder: Path, name: str, unit: Unit) -> Path:
    path = folder / f'{name}.npz'
    stamps = 1_700_000_000 * 10**9 + np.rint(unit.t * 1e9).astype(np.int64)
    np.savez(path, imu=np.column_stack([unit.t, unit.rows]), stamps_ns=stamps)
    return path


def check(path: Path, plan: str) -> tuple[int, str, float]:
    """Run `allan check` on a recording, and return exit code, summary and CPU time in s."""
    text, began = io.StringIO(), time.process_time()
    with contextlib.redirect_stdout(text):
        code = allan(['check', str(path), '--plan', plan, '--json'])
    (line, *_) = text.getvalue().splitlines() or ['{}']
    return code, json.loads(line).get('summary', ''), time.process_time() - began


def main() -> None:
    """Check the units, and print a line for each fault and the rates of both kinds of error."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--good', type=int, default=20)
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--faults', nargs='*', help='names of faults (default: all)')
    args = parser.parse_args()
    shipped, alarms, times = [], [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plan = folder / 'line4.yaml'
        plan.write_text(PLAN, encoding='utf-8')
        for i, fault in enumerate(FAULTS):
            if args.faults is not None and fault.__name__ not in args.faults:
                continue
            unit = Unit(1000 * args.seed + i)
            fault(unit)
            path = write(folder, fault.__name__, unit)
            code, summary, seconds = check(path, str(plan))
            times.append(seconds)
            shipped += [fault.__name__] * (code == 0)
            print(f'{code}  {fault.__name__:22}  {summary[:110]}', flush=True)
            path.unlink()
        for i in range(args.good):
            path = write(folder, f'good_{i}', Unit(1000 * args.seed + 500 + i))
            code, summary, seconds = check(path, str(plan))
            times.append(seconds)
            if code:
                alarms.append(i)
                print(f'{code}  good unit {i:12}  {summary[:110]}', flush=True)
            path.unlink()
    number = len(times) - args.good
    print(f'{number} suspect units, shipped: {len(shipped)} ({", ".join(shipped) or "none"})')
    print(f'{args.good} good units, not 0: {len(alarms)}')
    print(f'CPU per unit: {np.mean(times):.2f} s (median {np.median(times):.2f} s)')


if __name__ == '__main__':
    main()
