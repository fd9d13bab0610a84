# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Print the table of docs/recording.md: the precision of N, B and K after 10 min to 8 h.

usage: recording_table.py [--records N]

The three axes of a simulated IMU at 100 Hz have the noise of three grades of IMU. The table states
half the width of the 95 % interval in percent of the true value, as the median of the records in
which the term is resolved.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

import numpy as np

import allan_ros as ar
from allan_ros.core.imu import AXES, from_datasheet, sensor_of

RATE = 100.0
"""Sample rate in Hz."""

LENGTHS = {'10 min': 600.0, '1 h': 3600.0, '2 h': 7200.0, '8 h': 28800.0}
"""Label of a duration -> duration in s."""

GRADES = {
    'gyro': {
        'consumer': {'N': 0.3, 'B': 20.0, 'K': 100.0},
        'industrial': {'N': 0.24, 'B': 6.0, 'K': 40.0},
        'tactical': {'N': 0.1, 'B': 1.0, 'K': 2.0},
    },
    'accel': {
        'consumer': {'N': 0.1, 'B': 150.0, 'K': 600.0},
        'industrial': {'N': 0.012, 'B': 6.0, 'K': 30.0},
        'tactical': {'N': 0.006, 'B': 4.0, 'K': 8.0},
    },
}
"""Sensor -> grade of IMU -> typical noise terms in datasheet units."""

MOSTLY = 0.5
"""The width of an interval is shown if at least this fraction of the records resolves the term."""


def half_widths(seconds: float, seed: int) -> dict[tuple[str, str], float]:
    """Return (axis, term) -> half the width of the interval / true value; NaN if not resolved."""
    noise = {sensor: dict(zip('xyz', grades.values())) for sensor, grades in GRADES.items()}
    samples = ar.simulate(seconds / 3600.0, RATE, preset='', **noise, seed=seed)
    results = ar.analyze(samples, motion_gate=False)
    out = {}
    for axis in AXES:
        truth = noise[sensor_of(axis)][axis[-1]]
        for term in 'NBK':
            c = results.noise[axis][term]
            seen = c.status == 'estimated' and c.ci95 is not None
            half = (c.ci95[1] - c.ci95[0]) / 2.0 if seen else np.nan
            out[axis, term] = half / from_datasheet(term, sensor_of(axis), truth[term])
    return out


def rows(records: int) -> Iterator[str]:
    """Yield the lines of the table."""
    found = {
        length: [half_widths(seconds, seed) for seed in range(records)]
        for length, seconds in LENGTHS.items()
    }
    yield f'| sensor | term | {" | ".join(LENGTHS)} |'
    yield f'|---|---|{"---|" * len(LENGTHS)}'
    for i, axis in enumerate(AXES):
        sensor = sensor_of(axis)
        grade, terms = list(GRADES[sensor].items())[i % 3]
        for term in 'NBK':
            cells = [cell([one[axis, term] for one in found[length]]) for length in LENGTHS]
            yield f'| {grade} {sensor} | {term} = {terms[term]:g} | {" | ".join(cells)} |'


def cell(halves: list[float]) -> str:
    """Return the text of a table cell, given the half widths of the interval in all records."""
    shown = np.isfinite(halves)
    if not shown.any():
        return 'no'
    if shown.mean() < MOSTLY:
        return f'{100 * shown.mean():.0f} % of records'
    half = 100.0 * float(np.median(np.array(halves)[shown]))
    often = '' if shown.all() else f' ({100 * shown.mean():.0f} % of records)'
    return f'± {half:.2g} %{often}'


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--records', type=int, default=20, help='of each length (default 20)')
    for line in rows(parser.parse_args().records):
        print(line)
    return 0


if __name__ == '__main__':
    sys.exit(main())
