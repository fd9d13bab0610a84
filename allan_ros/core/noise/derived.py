# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics of a noise process, derived from its autocovariance `Process.gamma`.

The time unit is the sample period. The coefficient of the process is 1, except in `simulate`.

Method
------
Every statistic is the variance of a contrast: of a sum of means with weights w_i whose sum is 0.
This variance is the sum of w_i w_j gamma(M, |i - j|) over i and j, in which a constant in gamma
cancels. The formula therefore also holds for bias instability and random walk, whose variance is
infinite (generalized covariance; G. Matheron, The intrinsic random functions and their
applications, 1973).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..nonnegative import nonnegative_least_squares
from .process import Floats, Process
from .processes.gauss_markov import GaussMarkov

MOST_CACHED = 1 << 22
"""Largest number of lags for which the values of gamma are kept in memory for the next axis of a
simulation. This number of values takes 34 MB. The values of up to four processes are kept."""

LONGEST_CIRCLE = 16
"""Largest size of the circulant covariance matrix of a simulation, relative to its smallest
possible size. If a matrix of the largest size has negative eigenvalues, they are set to 0."""


def avar(process: Process, m: ArrayLike) -> Floats:
    """Return the Allan variance of a process with the coefficient 1 at averaging factors m.

    The Allan variance is gamma(m, 0) - gamma(m, 1). The result is a float64 array of the shape of
    ``m``, in the squared unit of the samples.

    Examples
    --------
    >>> from allan_ros.core.noise.processes.white import White
    >>> avar(White(), [1, 4])
    array([1.  , 0.25])
    """
    return np.asarray(process.gamma(m, 0) - process.gamma(m, 1))


def growth_variance(process: Process, horizon: ArrayLike, window: ArrayLike) -> Floats:
    """Return the variance of a sum of ``horizon`` samples minus ``horizon`` times the bias.

    The bias is the mean of the ``window`` samples directly before the sum. ``horizon`` and
    ``window`` may be arrays; the result has the shape to which they broadcast. The coefficient of
    the process is 1.

    A sum over M samples has the variance M^2 gamma(M, 0). The covariance of two neighboring sums
    follows from the variances of each sum and of their total.
    """
    n, b = np.asarray(horizon, float), np.asarray(window, float)
    gamma_horizon, gamma_window, gamma_total = (process.gamma(M, 0) for M in (n, b, n + b))
    twice_covariance = (n + b) ** 2 * gamma_total - n**2 * gamma_horizon - b**2 * gamma_window
    return np.asarray(n**2 * (gamma_horizon + gamma_window) - n / b * twice_covariance)


def simulate(parts: Iterable[tuple[float, Process]], n: int, rng: np.random.Generator) -> Floats:
    """Return n samples of a sum of processes, (n,), up to a constant.

    ``parts`` are pairs of a coefficient and a process. The unit of time of both is the sample
    period.

    The samples are drawn by circulant embedding of gamma (Dietrich & Newsam, SIAM J. Sci. Comput.
    18, 1997): gamma, continued to an even periodic sequence, is the first row of a circulant
    covariance matrix, whose eigenvalues are the Fourier transform of this row. The constant in
    gamma and an infinite spectrum at frequency 0 change only the mean, so that flicker noise and
    random walk are exact, too. The autocovariance is approximate if eigenvalues of the largest
    matrix are negative (`LONGEST_CIRCLE`). Ramps and sinusoids are computed by `Process.sample`.
    """
    from scipy import fft  # slow to import, and rarely needed

    y = np.zeros(n)
    from_gamma = []
    for coefficient, process in parts:
        samples = process.sample(n, rng)
        if samples is None:
            from_gamma.append((process.variance_of(coefficient, 1.0), process))
        else:
            y += coefficient * samples
    relative_size = 1
    while from_gamma:
        half_size = fft.next_fast_len(max(relative_size * (n - 1), 2), real=True)
        gamma = np.zeros(half_size + 1)
        for variance, process in from_gamma:
            gamma += variance * _lags(process, half_size + 1)
        # the Fourier transform of an even sequence is the cosine transform of half of the sequence
        eigenvalues = fft.dct(gamma, type=1, overwrite_x=True)
        eigenvalues[0] = 0.0
        if eigenvalues.min() > -1e-9 * eigenvalues.max() or relative_size >= LONGEST_CIRCLE:
            y += _draw(np.maximum(eigenvalues, 0.0), rng)[:n]
            break
        relative_size *= 2
    return y


def _lags(process: Process, number: int) -> Floats:
    """Return the autocovariance gamma of samples at the lags 0 to number - 1, (number,)."""
    if number <= MOST_CACHED:
        return _kept_lags(process, number)
    return process.gamma(1, np.arange(number))


@lru_cache(maxsize=4)  # all axes of an IMU have the same number of samples
def _kept_lags(process: Process, number: int) -> Floats:
    gamma: Floats = process.gamma(1, np.arange(number))
    gamma.flags.writeable = False
    return gamma


def _draw(eigenvalues: Floats, rng: np.random.Generator) -> Floats:
    """Return a random stationary sequence, (2 * half,), with a circulant covariance matrix.

    ``eigenvalues``, (half + 1,), are the eigenvalues of this matrix for frequencies from 0 to 1/2.
    The autocovariance of the sequence is correct for lags of up to ``half``, so that at most
    half + 1 successive values can be used.
    """
    from scipy import fft

    size = 2 * (len(eigenvalues) - 1)
    spectrum = rng.standard_normal(2 * len(eigenvalues)).view(complex)
    # the transform of a real sequence is real at the frequencies 0 and 1/2, where the real part has
    # the complete variance
    spectrum[[0, -1]] = spectrum.real[[0, -1]] * math.sqrt(2.0)
    spectrum *= np.sqrt(eigenvalues * (size / 2.0))
    return np.asarray(fft.irfft(spectrum, size, overwrite_x=True))


def gauss_markov_approximation(
    process: Process, times: Sequence[float], m: ArrayLike
) -> tuple[tuple[float, GaussMarkov], ...]:
    """Return Gauss-Markov processes whose sum approximates the Allan variance of a process.

    Parameters
    ----------
    process : Process
        The process to approximate, with the coefficient 1 and its shape in samples.
    times : sequence of float
        Correlation times of the Gauss-Markov processes in samples.
    m : (factors,) array
        Averaging factors at which the relative differences between the Allan variances are
        minimized by nonnegative least squares.

    Returns
    -------
    tuple of (float, GaussMarkov)
        Variance of each Gauss-Markov process, and the process; only variances above 0.
    """
    gauss_markov_processes = [GaussMarkov(float(time)) for time in times]
    target = avar(process, m)
    columns = np.stack([avar(each, m) / target for each in gauss_markov_processes], axis=1)
    variances = nonnegative_least_squares(columns, np.ones(len(target)))
    return tuple((float(v), each) for v, each in zip(variances, gauss_markov_processes) if v > 0.0)
