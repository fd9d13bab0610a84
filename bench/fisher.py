# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Fisher bound: the smallest standard deviation of any unbiased estimate of the coefficients.

    python bench/fisher.py table1_x table1_y table1_z

The steps of the samples are a stationary Gaussian sequence, so the information of all samples
follows from Whittle's formula, 1/2 per frequency and pair of spectra. At the lowest frequencies,
this approximation is wrong because of the ends of the record and the removal of the ramp. There it
is replaced by the information of the phase at `BLOCKS` points, which is computed exactly.
"""

from __future__ import annotations

import argparse

import numpy as np
from bench_accuracy import SCENARIOS
from numpy.typing import NDArray
from scipy import fft
from scipy.linalg import toeplitz

from allan_ros.core.noise import RANDOM_TERMS

Floats = NDArray[np.float64]

BLOCKS = 1200
"""Number of points of the phase that are treated exactly."""

LAGS = 1 << 15
"""Number of lags of the autocovariance for a spectrum."""


def second_difference_covariance(lags: int, step: int) -> Floats:
    """Return the autocovariances of second differences of the phase over ``step``, (4, lags).

    A row belongs to a variance coefficient (q, w, b, k) of 1. The second difference of the phase is
    ``step`` times the difference of two successive means, whose autocovariance is gamma.
    """
    lag = np.abs(np.arange(-1, lags + 1))
    second = np.array([-1.0, 2.0, -1.0]) * step**2
    rows = [np.convolve(t.gamma(step, lag), second, mode='valid') for t in RANDOM_TERMS]
    if step == 1:
        # For large lags the difference of t^2 ln t / (2 pi) loses its digits: use an expansion.
        t = np.arange(lags, dtype=float)
        far = t > 60.0
        rows[2][far] = -(2.0 / t[far] ** 2 + 2.0 / t[far] ** 4) / (2.0 * np.pi)
    return np.stack(rows)


def spectra(step: int) -> tuple[Floats, Floats]:
    """Return frequencies, and the spectra for variance coefficients of 1, (4, frequencies)."""
    rows = second_difference_covariance(LAGS, step)
    even = np.concatenate([rows, rows[:, -2:0:-1]], axis=1)
    return np.arange(LAGS) / (2.0 * LAGS - 2.0), fft.rfft(even, axis=1).real


def whittle(count: int, power: Floats, step: int) -> Floats:
    """Return the information of ``count`` second differences by Whittle's formula, (4, 4)."""
    known, rows = spectra(step)
    f = np.arange(1, count // 2 + 1) / count
    # Divided by the sine, the flicker spectrum is smooth enough to interpolate.
    sine = 2.0 * np.sin(np.pi * known[1:])
    s = np.stack([np.interp(f, known[1:], r[1:] / sine) * 2.0 * np.sin(np.pi * f) for r in rows])
    if step == 1:
        square = (2.0 * np.sin(np.pi * f)) ** 2
        s[0], s[1], s[3] = square**2, square, 1.0
    total = power @ s
    return np.asarray((s / total) @ (s / total).T)


def exact(count: int, power: Floats, step: int) -> tuple[Floats, float]:
    """Return the exact information of second differences with a free ramp, and the sd of the
    ramp.
    """
    rows = second_difference_covariance(count, step)
    inverse = np.linalg.inv(toeplitz(power @ rows))
    ramp = inverse @ np.full(count, float(step) ** 2)
    knowledge = float(ramp.sum() * step**2)
    project = inverse - np.outer(ramp, ramp) / knowledge
    parts = [project @ toeplitz(row) for row in rows]
    information = [[0.5 * float(np.sum(a * b.T)) for b in parts] for a in parts]
    return np.array(information), knowledge**-0.5


def bound(samples: int, power: Floats) -> tuple[Floats, float]:
    """Return the smallest standard deviations of the nonzero variance coefficients and the ramp."""
    step = samples // BLOCKS
    low, ramp = exact(BLOCKS - 1, power, step)
    information = whittle(samples - 1, power, 1) + low - whittle(BLOCKS - 1, power, step)
    present = np.flatnonzero(power)
    scale = power[present]
    covariance = np.linalg.inv(information[np.ix_(present, present)] * np.outer(scale, scale))
    out = np.full(len(power), np.nan)
    out[present] = scale * np.sqrt(np.diag(covariance))
    return out, ramp


def main() -> None:
    """Print the bound for each scenario in percent of each coefficient."""
    parser = argparse.ArgumentParser(description='Fisher bounds of the scenarios.')
    parser.add_argument('scenarios', nargs='+', choices=sorted(SCENARIOS))
    for name in parser.parse_args().scenarios:
        scenario = SCENARIOS[name]
        tau0 = 1.0 / scenario.rate
        q, w, b, k, r = (scenario.truth.value(term) for term in 'QNBKR')
        # in the squared unit of the samples; the time unit is the sample period
        power = np.array([(q / tau0) ** 2, w**2 / tau0, b**2, k**2 * tau0])
        powers, ramp = bound(round(scenario.rate * scenario.seconds), power)
        cells = [
            f'{term} {50.0 * sd / p:.3f} %' for term, sd, p in zip('QNBK', powers, power) if p > 0.0
        ]
        if r != 0.0:
            cells.append(f'R {100.0 * ramp / abs(r * tau0):.1f} %')
        print(name, *cells, sep='  ')


if __name__ == '__main__':
    main()
