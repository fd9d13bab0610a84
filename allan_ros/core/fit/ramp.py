# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ramp of a segment, estimated from its coarse phase record, and the effect of removing it.

The second differences of the coarse phase over the square of its step are estimates of the ramp r
(in sample units) with stationary noise. Their best linear unbiased combination (Aitken 1935) is

    r = 1' S^-1 z / 1' S^-1 1        var r = 1 / 1' S^-1 1

with S the Toeplitz covariance of z under the noise model. Any such r is linear in the phase,
``weights @ phase``. Taking r m^2 out of every difference d leaves a table whose expectation is
still linear in the variance coefficients, for any fixed weights and exactly:

    E V'_i = E V_i - sqrt2 m_i Cov(S_i, r) + m_i^2 Var(r) / 2

where S_i is the mean of d/(sqrt2 m_i). `RampEffect` holds both, per unit coefficient.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..allan.engine import PHASE_POINTS
from ..allan.history import cell_step
from ..allan.sums import counts, grid_for
from .model import DIFFERENCE, RANDOM_TERMS, Floats, phase_covariance, walk_from_cubic

_FOURTH_DIFFERENCE = np.convolve(DIFFERENCE, DIFFERENCE)
"""Second differences of theta have the fourth difference of its covariance."""


@dataclass(frozen=True)
class RampGeometry:
    """Covariances that determine the best ramp estimate of a segment of some length.

    Attributes
    ----------
    points, step : int
        Of its coarse phase record.
    m : (factors,) int64 array
    second_differences : (4, points - 2) float64 array
        Covariance at lag 0, 1, .. of the second differences of the phase, per unit coefficient.
    cross : (4, factors, points) float64 array
        Covariance of S_i, the mean of d_i/(sqrt2 m_i), with each phase point, per unit coefficient.
    """

    points: int
    step: int
    m: NDArray[np.int64]
    second_differences: Floats
    cross: Floats

    def best_weights(self, power: Floats) -> Floats | None:
        """Return the weights on the phase of the best estimate of r; None under three points."""
        z = self.points - 2
        row = np.maximum(power, 0.0) @ self.second_differences
        if z < 1 or not row[0] > 0.0:
            return None
        lag = np.abs(np.arange(z)[:, None] - np.arange(z))
        solution = np.linalg.solve(row[lag] / row[0], np.ones(z))
        return self._on_phase(solution / solution.sum())

    def _on_phase(self, on_second: Floats) -> Floats:
        """Convert weights on the second differences of the phase to weights on the phase."""
        return np.asarray(np.convolve(on_second, DIFFERENCE) / float(self.step) ** 2)

    def effect(self, weights: Floats) -> RampEffect:
        """Return the effect on the table of removing the ramp estimated with these weights."""
        on_second = _on_second_differences(weights)
        # w' S w of a Toeplitz S is the sum of its lags times the autocorrelation of w.
        lags = np.correlate(on_second, on_second, 'full')[len(on_second) - 1 :]
        lags[1:] *= 2.0
        return RampEffect(self.cross @ weights, self.second_differences @ lags)


@dataclass(frozen=True)
class RampEffect:
    """Covariance of a ramp estimate with the signed means S_i (4, factors), and its variance (4,).

    Both per unit coefficient.
    """

    cross: Floats
    variance: Floats


def ramp_shift(m: NDArray[np.int64], effect: RampEffect) -> Floats:
    """Return what removing the ramp adds to the expected d^2/(2 m^2), (factors, 4).

    -sqrt2 m Cov(S, r) + m^2 Var(r) / 2, per unit coefficient.
    """
    m = m.astype(float)
    return np.asarray((np.outer(effect.variance, m * m / 2.0) - np.sqrt(2.0) * m * effect.cross).T)


def _on_second_differences(weights: Floats) -> Floats:
    """Convert weights on the phase to weights on its second differences."""
    return np.asarray(np.cumsum(np.cumsum(weights))[:-2])


@lru_cache(maxsize=80)
def ramp_geometry(samples: int, step: int = 0) -> RampGeometry:
    """Return the geometry of a segment of that many samples; the last 80 are cached.

    Parameters
    ----------
    samples : int
    step : int
        Samples between two points of its phase record; 0 gives that of a complete segment.
    """
    if not step:
        step = cell_step(samples, PHASE_POINTS)
    points = samples // step + 1
    m, stride = grid_for(samples)
    lags = np.arange(-2, max(points, 3), dtype=np.float64) * step
    second_differences = np.stack(
        [np.convolve(g, _FOURTH_DIFFERENCE, mode='valid') for g in phase_covariance(lags)]
    )
    cross = _cross(m, stride, counts(samples, m, stride), np.arange(points) * step)
    return RampGeometry(points, step, m, second_differences[:, : points - 2], cross)


def _cross(
    m: NDArray[np.int64], stride: NDArray[np.int64], count: NDArray[np.int64], at: NDArray[np.int64]
) -> Floats:
    """Return the covariances of S_i with the phase ``at`` some samples, (4, factors, points).

    The mean over starts u = 0, s .. (M-1) s of sum_a c_a G(u + a m - x): as the integral over
    each start's s for the smooth G, start by start for white phase.
    """
    out = np.zeros((len(RANDOM_TERMS), len(m), len(at)))
    end = (count - 1) * stride
    for a, c in enumerate(DIFFERENCE):
        start = at[None, :] - (a * m)[:, None]
        met = (start >= 0) & (start <= end[:, None]) & (start % stride[:, None] == 0)
        out[0] += c * met
        half = stride / 2.0
        upper, lower = (end + half)[:, None] - start, -half[:, None] - start
        out[1:] += c * (_integral(upper, at[-1]) - _integral(lower, at[-1])) / stride[:, None]
    return np.asarray(out / (np.sqrt(2.0) * m * count)[:, None])


def _integral(t: Floats, unit: float) -> Floats:
    """Return the integrals from 0 to t of the generalised covariances of w, b and k, (3, ...).

    Lags in the logarithm are taken in a unit: what that adds to G, a multiple of t^2, vanishes.
    """
    white = -t * np.abs(t) / 4.0
    cube = t**3
    with np.errstate(divide='ignore', invalid='ignore'):
        log = np.where(t == 0.0, 0.0, np.log(np.abs(t) / unit))
    flicker = cube * (log / 3.0 - 1.0 / 9.0) / (2.0 * np.pi)
    return np.stack([white, flicker, walk_from_cubic(white, cube * np.abs(t) / 48.0)])
