# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fisher bound: the smallest standard deviation of an unbiased estimate of each coefficient.

    python bench/fisher.py table1_x table1_y table1_z

The differences of neighboring samples are a stationary Gaussian sequence. Whittle's formula
approximates the Fisher information of such a sequence. At the lowest frequencies, the ends of the
record and the removal of the ramp make this approximation wrong. There, the exact information of
the integrated samples at `BLOCKS` points is used.
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
"""Number of points of the phase (the integrated samples) whose information is computed exactly."""

LAGS = 1 << 15
"""Number of lags of the autocovariance from which a spectrum is computed."""


def second_difference_covariance(lags: int, step: int) -> Floats:
    """Return the autocovariances of the second differences of the phase, (4, lags).

    The rows are for the coefficients q, w, b and k, each equal to 1. A second difference over
    ``step`` samples is ``step`` times the difference of two successive means over ``step`` samples,
    and gamma is the autocovariance of these means.
    """
    lag = np.abs(np.arange(-1, lags + 1))
    second = np.array([-1.0, 2.0, -1.0]) * step**2
    rows = [np.convolve(t.gamma(step, lag), second, mode='valid') for t in RANDOM_TERMS]
    if step == 1:
        # For large lags, t^2 ln t / (2 pi) cancels in the difference: use an expansion.
        t = np.arange(lags, dtype=float)
        far = t > 60.0
        rows[2][far] = -(2.0 / t[far] ** 2 + 2.0 / t[far] ** 4) / (2.0 * np.pi)
    return np.stack(rows)


def spectra(step: int) -> tuple[Floats, Floats]:
    """Return frequencies, and the spectra of second differences, (4, frequencies).

    The rows are for the coefficients q, w, b and k, each equal to 1.
    """
    rows = second_difference_covariance(LAGS, step)
    even = np.concatenate([rows, rows[:, -2:0:-1]], axis=1)
    return np.arange(LAGS) / (2.0 * LAGS - 2.0), fft.rfft(even, axis=1).real


def whittle(count: int, power: Floats, step: int) -> Floats:
    """Return the Fisher information (4, 4) of second differences, by Whittle's formula."""
    known, rows = spectra(step)
    f = np.arange(1, count // 2 + 1) / count
    # Only the quotient of the flicker spectrum and the sine is smooth enough to interpolate.
    sine = 2.0 * np.sin(np.pi * known[1:])
    s = np.stack([np.interp(f, known[1:], r[1:] / sine) * 2.0 * np.sin(np.pi * f) for r in rows])
    if step == 1:
        square = (2.0 * np.sin(np.pi * f)) ** 2
        s[0], s[1], s[3] = square**2, square, 1.0
    total = power @ s
    return np.asarray((s / total) @ (s / total).T)


def exact(count: int, power: Floats, step: int) -> tuple[Floats, float]:
    """Return the exact Fisher information of second differences, and the bound of the ramp.

    The information, (4, 4), is for an unknown ramp, and the bound is a standard deviation.
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
    """Return the bounds of the coefficients q, w, b and k, (4,), and of the ramp.

    The bound of a coefficient that is 0 is NaN.
    """
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
        # q, w, b and k with the sample period as the unit of time
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
