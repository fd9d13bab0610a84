# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Coverage of the intervals of N and B, for simulated recordings with spikes and shocks.

    python bench/bench_recordings.py                        all scenarios, 96 axes each
    python bench/bench_recordings.py shocks_20 --axes 24    one scenario

Each recording has six axes and lasts 15 min at 50 Hz. Unlike in `bench_accuracy.py`, the samples
pass the motion gate, and spikes and shocks are replaced as in a real recording.
"""

from __future__ import annotations

import argparse
import math

import numpy as np
from bench_accuracy import Outcome, clopper_pearson

import allan_ros as ar
from allan_ros.core.imu import AXES, from_datasheet, sensor_of
from allan_ros.core.noise import Model
from allan_ros.core.simulator import LEVEL, PRESETS, simulate_axis

RATE, SECONDS = 50.0, 900.0
SHOCK_S = 0.2
"""Duration in s of a shock, which is a decaying oscillation of 8 Hz."""

SHOCK_SIZES = 20.0, 200.0
"""Smallest and largest amplitude of a shock, in standard deviations of the white noise."""

SCENARIOS = {
    'clean': {},
    'shocks_3': {'shocks': 3},
    'shocks_20': {'shocks': 20},
    'gauss_markov_2': {'time': 2.0},
    'gauss_markov_4': {'time': 4.0},
    'gauss_markov_8': {'time': 8.0},
}
"""Scenario -> number of shocks, or correlation time in samples of an added Gauss-Markov process."""

TRUTH = {
    axis: Model.of(
        **{t: from_datasheet(t, sensor_of(axis), PRESETS['paper'][axis][t]) for t in 'NB'}
    )
    for axis in AXES
}


def recording(rng: np.random.Generator, shocks: int = 0, time: float = 0.0) -> np.ndarray:
    """Return the samples of a simulated recording, (n, axes), in SI."""
    from scipy.signal import lfilter

    n = round(RATE * SECONDS)
    y = np.stack([simulate_axis(n, 1.0 / RATE, TRUTH[axis], rng) for axis in AXES], axis=1)
    white = np.array([TRUTH[axis].value('N') for axis in AXES]) * RATE**0.5
    if time:
        keep = math.exp(-1.0 / time)
        steps = rng.standard_normal((n, len(AXES)))
        steps[1:] *= math.sqrt(1.0 - keep * keep)
        y += white * lfilter([1.0], [1.0, -keep], steps, axis=0)
    t = np.arange(round(SHOCK_S * RATE)) / RATE
    shape = np.exp(-t / (0.3 * SHOCK_S)) * np.cos(2.0 * np.pi * 8.0 * t)
    for start in np.linspace(30.0, SECONDS - 30.0, shocks) + rng.uniform(-9.0, 9.0, shocks):
        at = round(start * RATE)
        size = math.exp(rng.uniform(*np.log(SHOCK_SIZES)))
        y[at : at + len(t)] += size * white * shape[:, None]
    return y + np.array(LEVEL)


def run(scenario: str, axes: int) -> str:
    """Return a row of the table: coverage of N and B, error of N, and processes that were found."""
    options = SCENARIOS[scenario]
    inside, off, found = {'N': 0, 'B': 0}, [], {'gauss_markov': 0, 'sinusoid': 0, 'resonance': 0}
    filtered = lack = number = 0
    while number < axes:
        rng = np.random.default_rng([ord(c) for c in scenario] + [number])
        results = ar.analyze(recording(rng, **options), rate=RATE)
        for axis in AXES:
            fit = results[axis].fit
            for term in inside:
                outcome = Outcome.of(fit.noise[term])
                inside[term] += outcome.low <= TRUTH[axis].value(term) <= outcome.high
            off.append((fit.noise['N'].value or math.nan) / TRUTH[axis].value('N') - 1.0)
            for kind in found:
                found[kind] += bool(fit.model[kind])
            filtered += fit.filtered
            lack += bool(fit.lack_of_fit)
            number += 1
    cells = [scenario, str(number)]
    for term in inside:
        low, high = clopper_pearson(inside[term], number)
        cells.append(f'{100 * inside[term] / number:.0f} % ({100 * low:.0f}-{100 * high:.0f})')
    cells += [
        f'{100 * np.mean(off):+.2f} %',
        f'{100 * np.std(off):.2f} %',
        str(filtered),
        str(lack),
    ]
    return '| ' + ' | '.join([*cells, *map(str, found.values())]) + ' |'


def main(arguments: list[str] | None = None) -> None:
    """Print the table of the requested scenarios."""
    parser = argparse.ArgumentParser(description='Coverage of recordings that pass the stream.')
    parser.add_argument('scenarios', nargs='*', default=list(SCENARIOS))
    parser.add_argument('--axes', type=int, default=96)
    options = parser.parse_args(arguments)
    print(
        '| scenario | axes | N covered | B covered | mean error of N | its scatter | filter '
        '| lack of fit | Gauss-Markov | sinusoid | resonance |\n' + '|---' * 11 + '|'
    )
    for scenario in options.scenarios:
        print(run(scenario, options.axes), flush=True)


if __name__ == '__main__':
    main()
