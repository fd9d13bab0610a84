# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bias over temperature: coverage of the intervals, and false alarms of the test.

python bench/bench_temperature.py --records 70    70 records of three axes for each case
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from bench_stationarity import DEG_H, HOUR, band, gyro
from numpy.typing import NDArray

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.fit.stationary import fit_likelihood
from allan_ros.core.fit.temperature import temperature_models
from allan_ros.core.imu import AXES
from allan_ros.core.simulator import simulate_axis

Floats = NDArray[np.float64]

RATE, CENTER, AMPLITUDE = 2.0, 30.0, 6.0
B0, B1, B2 = 100.0 * DEG_H, 5.0 * DEG_H, 0.3 * DEG_H

CASES = {
    '2 h, 2 cycles, N + B + K': ('NBK', 2.0, 'cycles', 1.0),
    '2 h, 2 cycles, N + B + K, no dependence': ('NBK', 2.0, 'cycles', 0.0),
    '2 h, 2 cycles, N + K': ('NK', 2.0, 'cycles', 1.0),
    '8 h, one rise and fall, N + B + K': ('NBK', 8.0, 'once', 1.0),
    '1 h, irregular, N + B + K': ('NBK', 1.0, 'irregular', 1.0),
    '1 h, irregular, N + B + K, no dependence': ('NBK', 1.0, 'irregular', 0.0),
}
"""Case -> noise terms, duration in h, kind of `temperature`, factor of b1 and b2."""


def temperature(kind: str, n: int, rng: np.random.Generator) -> Floats:
    """Return the temperature of each sample, (n,), in degC."""
    phase = np.linspace(0.0, 2.0 * np.pi, n)
    if kind == 'cycles':
        return CENTER + AMPLITUDE * np.sin(2.0 * phase - 1.0)
    if kind == 'once':
        return CENTER - AMPLITUDE * np.cos(phase)
    coefficients = rng.normal(size=(2, 6)) / np.arange(1.0, 7.0)
    waves = np.outer(np.arange(1.0, 7.0), phase)
    sums = coefficients[0] @ np.sin(waves) + coefficients[1] @ np.cos(waves)
    return CENTER + AMPLITUDE * sums / np.abs(sums).max()


def show(records: int, seed: int) -> Iterator[tuple[str, ...]]:
    """Yield the coverage of b0, b1, b2 and the hysteresis, and how often b1 or b2 is resolved."""
    for k, (name, (terms, hours, kind, factor)) in enumerate(CASES.items()):
        n, hit, number, resolved = round(hours * HOUR * RATE), np.zeros(4, int), 0, 0
        for i in range(records):
            rng = np.random.default_rng([seed, i, k])
            celsius = temperature(kind, n, rng)
            drift = np.stack(
                [simulate_axis(n, 1.0 / RATE, gyro(terms[1:]), rng) for _ in range(3)], axis=1
            )
            warmer = (celsius - CENTER)[:, None]
            y = drift + B0 + factor * warmer * (B1 + B2 * warmer)
            y += rng.normal(size=(n, 3)) * gyro('N').value('N') * np.sqrt(RATE)
            engine = RunningSums(axes=AXES[:3])
            engine.update(y, 0, round((n - 1) / RATE * 1e9))
            engine.end_segment()
            read = np.arange(0, n, 10)
            measured = celsius[read] + rng.normal(scale=0.02, size=len(read))
            times = np.int64(read / RATE * 1e9)
            sums = engine.sums
            models, _ = temperature_models(sums, times, measured, fit_likelihood(sums))
            for axis, m in models.items():
                level = drift[:, AXES.index(axis)].mean() + B0
                off = m.reference - CENTER
                truth = (
                    level + factor * off * (B1 + B2 * off),
                    factor * (B1 + 2.0 * B2 * off),
                    factor * B2,
                    0.0,
                )
                ends = m.b0_ci95, m.b1_ci95, m.b2_ci95, m.hysteresis_ci95
                hit += [low <= t <= high for t, (low, high) in zip(truth, ends)]
                resolved, number = resolved + m.resolved, number + 1
        yield name, *(band(int(h), number) for h in hit), band(resolved, number)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--records', type=int, default=10)
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    print('| case | b0 covered | b1 | b2 | hysteresis | resolved |', flush=True)
    for row in show(args.records, args.seed):
        print(f'| {" | ".join(row)} |', flush=True)


if __name__ == '__main__':
    main()
