# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Equivalent degrees of freedom of an Allan variance, and the chi-squared limits they give.

An estimate V of M second differences d has edf = 2 V^2 / Var V, and for Gaussian noise
Var V = (2 V^2 / M^2) sum over pairs of rho^2, rho being the correlation of two d's (Greenhall &
Riley, Uncertainty of stability variances based on finite differences, 35th PTTI, 2003, eq. 10;
NIST SP 1065 section 5.4.1). Pooled segments are independent, so their variances add. The sum is
taken in full over the lags where rho is not negligible, without the tables and fits of the source.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

CI_LEVEL = 0.683
"""Confidence level of the limits on a curve: one sigma, as NIST SP 1065 and Stable32 write it."""

WHITE_PHASE, FLICKER_PHASE, WHITE, FLICKER, RANDOM_WALK = 2, 1, 0, -1, -2
"""Noise types by the exponent alpha of their spectrum S_y ~ f^alpha (NIST SP 1065 table 2)."""

REACH = 6
"""Correlations are summed to that many m: beyond, rho^2 of flicker adds under 1e-4."""

FAR = 100.0
"""Samples from which the flicker phase autocovariance is its continuous limit, to 1e-5."""


def edf(noise_type: int, m: int, stride: int, counts: ArrayLike, number: ArrayLike = 1) -> float:
    """Return the equivalent degrees of freedom of an Allan variance pooled over segments.

    Parameters
    ----------
    noise_type : int
        Exponent alpha of S_y ~ f^alpha, 2 .. -2.
    m, stride : int
        Averaging factor, and samples between the starts of two second differences.
    counts : (segments,) array
        Second differences in each segment (or in each of the groups of `number`).
    number : (segments,) array
        How many segments there are of each count.

    Returns
    -------
    float
        NaN when there are no differences.
    """
    counts = np.atleast_1d(np.asarray(counts, np.int64))
    number = np.broadcast_to(np.asarray(number), counts.shape)
    number, counts = number[counts > 0], counts[counts > 0]
    if not len(counts):
        return float('nan')
    # rho^2 summed over lags -j .. j, and |j| rho^2: a pair at lag j occurs M - |j| times.
    lags = np.arange(1, min(int(counts.max()), REACH * m // stride + 1))
    squares = correlation(noise_type, m, stride * lags) ** 2
    pairs = np.concatenate([[1.0], 1.0 + 2.0 * np.cumsum(squares)])
    missing = np.concatenate([[0.0], 2.0 * np.cumsum(lags * squares)])
    last = np.minimum(counts, len(pairs)) - 1
    variance = np.sum(number * (counts * pairs[last] - missing[last]))
    return float(np.sum(number * counts)) ** 2 / float(variance)  # int64 ends at 3e9 squared


def correlation(noise_type: int, m: int, lags: ArrayLike) -> Floats:
    """Return the correlation of two second differences of averaging factor m.

    It is the fourth difference, with step m, of the generalised autocovariance of the phase.

    Parameters
    ----------
    noise_type : int
        Exponent alpha of S_y ~ f^alpha, 2 .. -2.
    m : int
        Averaging factor.
    lags : (n,) array
        Samples between their starts.
    """
    steps = np.arange(-2, 3) * m
    weights = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    lags = np.atleast_1d(np.asarray(lags, np.int64))
    near = _phase_autocovariance(noise_type, m, lags[:, None] + steps) @ weights
    variance = _phase_autocovariance(noise_type, m, steps) @ weights
    return np.asarray(near / variance)


def _phase_autocovariance(noise_type: int, m: int, t: NDArray[np.int64]) -> Floats:
    """Return the generalised autocovariance of the phase at t samples, up to a factor.

    Of sampled noise: delta(t) for white phase, -|t| for white, t^2 ln|t| for flicker and
    |t|^3 - |t| for a random walk of the samples (Greenhall & Riley eq. 7, in discrete time).
    Flicker phase is the second difference of -t^2 ln|t|. Time counts in units of m, which changes
    only multiples of t^2 that the fourth difference removes.
    """
    if noise_type == WHITE_PHASE:
        return np.asarray(t == 0, float)
    u = np.abs(t) / m
    if noise_type == FLICKER_PHASE:
        near: Floats = np.diff(_square_log(t[..., None] + np.array([-1.0, 0.0, 1.0])), 2)[..., 0]
        far = 2.0 * np.log(np.maximum(np.abs(t), 1.0)) + 3.0
        return -np.where(np.abs(t) < FAR, near, far)
    if noise_type == WHITE:
        return -u
    if noise_type == FLICKER:
        return _square_log(u)
    return np.asarray(u**3 - u / m**2)


def _square_log(t: ArrayLike) -> Floats:
    """Return t^2 ln|t|, 0 at 0."""
    t = np.asarray(t, float)
    return np.asarray(t**2 * np.log(np.where(t == 0.0, 1.0, np.abs(t))))


def chi_squared_limits(
    avar: ArrayLike, degrees: ArrayLike, level: float = CI_LEVEL
) -> tuple[Floats, Floats]:
    """Return the confidence limits of the deviation sqrt(avar), NIST SP 1065 section 5.3.1.

    Parameters
    ----------
    avar : array
        Allan variances.
    degrees : array of the same shape
        Their equivalent degrees of freedom; NaN gives NaN.
    level : float
        Probability between the limits.

    Returns
    -------
    low, high : float64 arrays
        sqrt(avar edf / chi^2) at the upper and lower quantile.
    """
    from scipy.special import chdtri  # 20 MB: a node that only accumulates draws no limits

    avar, degrees = np.asarray(avar, float), np.asarray(degrees, float)
    tail = (1.0 - level) / 2.0
    low, high = (np.sqrt(avar * degrees / chdtri(degrees, p)) for p in (tail, 1.0 - tail))
    return low, high
