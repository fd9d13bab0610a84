# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which power-law noise rules at an averaging factor: needed for the degrees of freedom there."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .edf import FLICKER, RANDOM_WALK, WHITE, WHITE_PHASE

Floats = NDArray[np.float64]

MIN_AVERAGES = 30
"""Fewest averages for the lag-1 method (NIST SP 1065 section 5.5.6)."""

FLICKER_EDGE = -1.75
"""Where flicker ends and random walk begins. Once differenced, averages of flicker have
r1 = (9 ln3 - 16 ln2)/(8 ln2), so alpha = -1.45; those of a random walk have -2 (m = 1) to -2.4. Of
2000 averages, plain rounding would take every fifth flicker for a random walk."""

SLOPE_SPAN = 4.0
"""A slope is taken from m/4 to 4 m: two octaves each way steady it against single points."""

MIN_BLOCKS = 16
"""Averaging times that must fit into the record for a slope to mean something."""

QUANTIZATION_SLOPE = -1.5
"""Slopes of sigma^2 below this are -2: white or flicker phase, which cannot be told apart."""


def noise_type_of_samples(y: ArrayLike, m: int) -> int | None:
    """Return the exponent alpha at factor m from the lag-1 autocorrelation of the averages.

    NIST SP 1065 section 5.5.6 (Riley & Greenhall, Power law noise identification using the lag 1
    autocorrelation, 18th EFTF, 2004): difference the averages until r1/(1 + r1) < 1/4, at most
    twice; then alpha = -2 (r1/(1 + r1) + differences), rounded (but see `FLICKER_EDGE`).

    Parameters
    ----------
    y : (n,) array
        Samples at the period of m = 1.
    m : int
        Averaging factor.

    Returns
    -------
    int or None
        2 .. -2; None with fewer than 30 averages, or when they do not vary.
    """
    y = np.asarray(y, float)
    blocks = len(y) // m
    if blocks < MIN_AVERAGES:
        return None
    z = y[: blocks * m].reshape(blocks, m).mean(axis=1)
    for differences in range(3):
        z = z - z.mean()
        power = float(z @ z)
        if power == 0.0:
            return None
        r1 = float(z[:-1] @ z[1:]) / power
        delta = r1 / (1.0 + r1)
        alpha = -2.0 * (delta + differences)
        if delta < 0.25:
            break
        z = np.diff(z)
    if alpha < WHITE - 0.5:
        return FLICKER if alpha > FLICKER_EDGE else RANDOM_WALK
    return min(round(alpha), WHITE_PHASE)


def noise_types_of_avar(m: NDArray[np.int64], avar: Floats, samples: int) -> NDArray[np.int64]:
    """Return the exponent alpha at every factor from the slope mu of log sigma^2 on log tau.

    alpha = -1 - mu (NIST SP 1065 table 4). For sums, whose samples are gone. A slope of -2 is read
    as white phase, which in an IMU is quantization. Where the record holds under 16 averaging
    times a slope means nothing, and the type of the factor before goes on.

    Parameters
    ----------
    m : (factors,) int64 array
        Ascending.
    avar : (factors, axes) float64 array
        Allan variance; NaN or 0 where there is none.
    samples : int
        Length of the record.

    Returns
    -------
    (factors, axes) int64 array
        2 .. -2; white (0) where nothing is known.
    """
    slopes = local_slopes(m, avar, np.where(MIN_BLOCKS * m <= samples, samples / m, 0.0))
    out = np.empty(avar.shape, np.int64)
    for axis in range(avar.shape[1]):
        last = WHITE
        for i, slope in enumerate(slopes[:, axis]):
            if MIN_BLOCKS * m[i] <= samples and np.isfinite(slope):
                steep = slope < QUANTIZATION_SLOPE
                last = WHITE_PHASE if steep else max(round(-1.0 - slope), RANDOM_WALK)
            out[i, axis] = last
    return out


def local_slopes(m: NDArray[np.int64], avar: Floats, weights: Floats) -> Floats:
    """Return the weighted least-squares slope of log sigma^2 on log m around every factor.

    Parameters
    ----------
    m : (factors,) int64 array
        Averaging factors.
    avar : (factors, axes) float64 array
        Allan variance.
    weights : (factors,) float64 array
        Of the points, such as their degrees of freedom; 0 leaves one out.

    Returns
    -------
    (factors, axes) float64 array
        NaN where fewer than two points with a weight and a positive variance are near.
    """
    x = np.log(m.astype(float))
    span = np.log(SLOPE_SPAN) * (1.0 + 1e-9)
    out = np.full(avar.shape, np.nan)
    for axis in range(avar.shape[1]):
        good = (weights > 0.0) & (avar[:, axis] > 0.0)
        xs, ws, ys = x[good], weights[good], np.log(avar[good, axis])
        for i in range(len(m)):
            near = np.abs(xs - x[i]) <= span
            if np.count_nonzero(near) < 2:
                continue
            w = ws[near] / ws[near].sum()
            dx = xs[near] - w @ xs[near]
            out[i, axis] = (w * dx) @ ys[near] / ((w * dx) @ dx)
    return out
