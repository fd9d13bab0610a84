# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics of a noise process, derived from its gamma: one function for all processes.

Every statistic is a contrast, that is, a sum of means with weights w_i whose sum is 0. Its variance
is sum w_i w_j gamma(M, |i - j|), and a constant in gamma cancels. Bias instability and random walk
need no other treatment, although they have no other autocovariance (G. Matheron, The intrinsic
random functions and their applications, 1973).

The time unit is the sample period, and the coefficient is 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..nonnegative import nonnegative_least_squares
from .process import Floats, Process
from .processes.gauss_markov import GaussMarkov

MOST_CACHED = 1 << 22
"""Largest number of lags of which gamma is kept for the next axis of a simulation."""

LONGEST_CIRCLE = 16
"""Largest length of a circulant covariance relative to the shortest possible one."""


def avar(process: Process, m: ArrayLike) -> Floats:
    """Return the Allan variance at averaging factors m: gamma(m, 0) - gamma(m, 1).

    Examples
    --------
    >>> from allan_ros.core.noise.processes.white import White
    >>> avar(White(), [1, 4])
    array([1.  , 0.25])
    """
    return np.asarray(process.gamma(m, 0) - process.gamma(m, 1))


def autocorrelation(weights: NDArray[np.number]) -> Floats:
    """Return c with sum c_j gamma_j = sum w_i conj(w_k) gamma_|i-k| of weights, (..., n)."""
    n = np.shape(weights)[-1]
    c = np.fft.ifft(np.abs(np.fft.fft(weights, 2 * n)) ** 2).real[..., :n]
    c[..., 1:] *= 2.0
    return np.asarray(c)


def contrast_variance(process: Process, weights: NDArray[np.number], step: int = 1) -> Floats:
    """Return the variance of sum w_i y_i for consecutive means y_i over ``step`` samples.

    Parameters
    ----------
    process : Process
    weights : (..., n) array
        Weights of sum 0. Complex ones give the mean square of the magnitude, which is the expected
        power of a tapered block.
    step : int
        Samples per mean.
    """
    lags = np.arange(np.shape(weights)[-1])
    return np.asarray(autocorrelation(weights) @ process.gamma(step, lags))


def covariance_of_means(process: Process, step: int, lags: ArrayLike) -> Floats:
    """Return the covariance, up to a constant, of means over ``step`` samples.

    ``lags`` are their distances in means, for example a matrix of the distances of all pairs.
    """
    return process.gamma(step, lags)


def growth_variance(process: Process, horizon: ArrayLike, window: ArrayLike) -> Floats:
    """Return the variance of the error of integrated samples after the bias was subtracted.

    The bias is the mean over the ``window`` samples before; ``horizon`` samples are integrated.
    A sum over M samples has the variance M^2 gamma(M, 0), so the covariance of two neighboring sums
    follows from those of both and of their sum.
    """
    n, b = np.asarray(horizon, float), np.asarray(window, float)
    of_horizon, of_window, of_both = (process.gamma(M, 0) for M in (n, b, n + b))
    twice_cross = (n + b) ** 2 * of_both - n**2 * of_horizon - b**2 * of_window
    return np.asarray(n**2 * (of_horizon + of_window) - n / b * twice_cross)


def simulate(parts: Iterable[tuple[float, Process]], n: int, rng: np.random.Generator) -> Floats:
    """Return n samples of a sum of processes, (n,), up to a constant.

    ``parts`` are coefficients in sample units, and processes. The samples are drawn by circulant
    embedding of gamma (Dietrich & Newsam, SIAM J. Sci. Comput. 18, 1997): an even periodic sequence
    whose first half is gamma has the eigenvalues of a covariance matrix. The constant in gamma and
    an infinite spectrum at frequency 0 change only the mean, so flicker noise and random walk are
    exact, too. A process with a `Process.sample` of its own draws itself.
    """
    from scipy import fft  # slow to import, and rarely needed

    y = np.zeros(n)
    drawn = []
    for coefficient, process in parts:
        samples = process.sample(n, rng)
        if samples is None:
            drawn.append((process.variance_of(coefficient, 1.0), process))
        else:
            y += coefficient * samples
    circle = 1
    while drawn:
        half = fft.next_fast_len(max(circle * (n - 1), 2), real=True)
        gamma = np.zeros(half + 1)
        for variance, process in drawn:
            gamma += variance * _lags(process, half + 1)
        # the Fourier transform of an even sequence is the cosine transform of half of it
        eigenvalues = fft.dct(gamma, type=1, overwrite_x=True)
        eigenvalues[0] = 0.0
        if eigenvalues.min() > -1e-9 * eigenvalues.max() or circle >= LONGEST_CIRCLE:
            y += _draw(np.maximum(eigenvalues, 0.0), rng)[:n]
            break
        circle *= 2
    return y


def _lags(process: Process, number: int) -> Floats:
    """Return gamma of samples at the lags 0 to number - 1."""
    if number <= MOST_CACHED:
        return _kept_lags(process, number)
    return process.gamma(1, np.arange(number))


@lru_cache(maxsize=4)  # all axes of an IMU have the same length
def _kept_lags(process: Process, number: int) -> Floats:
    gamma: Floats = process.gamma(1, np.arange(number))
    gamma.flags.writeable = False
    return gamma


def _draw(eigenvalues: Floats, rng: np.random.Generator) -> Floats:
    """Return a random stationary sequence with a circulant covariance, (2 half,).

    ``eigenvalues``, (half + 1,), are the spectrum at frequencies from 0 to 1/2. Only the first
    half + 1 values of the result have the autocovariance that the eigenvalues represent.
    """
    from scipy import fft

    size = 2 * (len(eigenvalues) - 1)
    spectrum = rng.standard_normal(2 * len(eigenvalues)).view(complex)
    # A real sequence has real values, with the full variance, at the frequencies 0 and 1/2.
    spectrum[[0, -1]] = spectrum.real[[0, -1]] * math.sqrt(2.0)
    spectrum *= np.sqrt(eigenvalues * (size / 2.0))
    return np.asarray(fft.irfft(spectrum, size, overwrite_x=True))


def bank(
    process: Process, times: Sequence[float], m: ArrayLike
) -> tuple[tuple[float, GaussMarkov], ...]:
    """Return Gauss-Markov processes whose sum has nearly the Allan variance of a process.

    Parameters
    ----------
    process : Process
    times : sequence of float
        Correlation times of the Gauss-Markov processes.
    m : (factors,) array
        Averaging factors at which the relative differences are minimized.

    Returns
    -------
    tuple of (variance, GaussMarkov)
        Only processes with a variance above 0.
    """
    members = [GaussMarkov(float(time)) for time in times]
    target = avar(process, m)
    columns = np.stack([avar(one, m) / target for one in members], axis=1)
    variances = nonnegative_least_squares(columns, np.ones(len(target)))
    return tuple((float(v), one) for v, one in zip(variances, members) if v > 0.0)
