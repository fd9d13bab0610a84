# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gauss-Markov processes and sinusoids in a table of Allan variances, and their covariance.

Their expected Allan variances are linear in the variance (or squared amplitude) and depend on a
shape: a correlation time or a frequency.

The covariance of two Allan variances is a sum over lags of squared covariances of differences
(module `covariance`). Gauss-Markov processes add the products C_k C_g and C_g C_h to this sum,
where C_k is the covariance of differences of a random term, and C_g and C_h are those of two
processes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial import legendre

from ..noise import gauss_markov_sums, sinusoid_avar
from .model import RANDOM_TERMS, Floats, Ints, Q, walk_from_cubic

SINUSOID_PEAK = 0.371
"""Value of f m at which the Allan variance of a sinusoid, sin^4(pi f m)/(pi f m)^2, is largest."""


@dataclass(frozen=True)
class GaussMarkovTerm:
    """First-order Gauss-Markov process; ``shape`` is its correlation time in samples."""

    shape: float

    @property
    def scale(self) -> float:
        """Averaging factor at which the Allan variance is largest relative to white noise."""
        return 1.89 * self.shape

    def equivalent_white(self) -> float:
        """Return the variance of white noise with the same spectral density at low frequencies.

        The process has unit variance.
        """
        return float(gauss_markov_sums(self.shape)[0][0])


@dataclass(frozen=True)
class SinusoidTerm:
    """Sinusoid of random phase; ``shape`` is its frequency in cycles per sample."""

    shape: float

    @property
    def scale(self) -> float:
        """Averaging factor at which the Allan variance of the sinusoid is largest."""
        return SINUSOID_PEAK / self.shape


Process = GaussMarkovTerm | SinusoidTerm


def correlation_times(extras: Sequence[Process]) -> tuple[float, ...]:
    """Return the correlation times in samples of the Gauss-Markov processes in a list."""
    return tuple(e.shape for e in extras if isinstance(e, GaussMarkovTerm))


def amplitude_variance(samples: int, times: Sequence[float], lines: Sequence[Process]) -> Floats:
    """Return the variance of estimated squared amplitudes due to noise, (sinusoids, 4 + times).

    It is divided by the squared amplitude, and given per unit coefficient of the four random terms
    and of Gauss-Markov processes with the correlation times ``times`` in samples. ``lines`` are the
    sinusoids, and ``samples`` is the length of the record.
    """
    # Noise of two-sided density S adds 8 A^2 S / n for an amplitude A and n samples.
    rows = []
    for line in lines:
        omega = 2.0 * np.pi * line.shape
        step = (2.0 * np.sin(omega / 2.0)) ** 2
        density = [step, 1.0, 1.0 / omega, 1.0 / step]
        for time in times:
            keep = np.exp(-1.0 / time)
            lost = -np.expm1(-1.0 / time)
            # (1 - keep^2) / (1 - 2 keep cos(omega) + keep^2) without loss of digits
            density.append(lost * (1.0 + keep) / (lost**2 + keep * step))
        rows.append(8.0 / samples * np.array(density))
    return np.array(rows).reshape(len(lines), len(RANDOM_TERMS) + len(times))


def independent_variance(
    m: Ints, stride: Ints, count: Ints, samples: int, segments: int, lines: Sequence[Process]
) -> Floats:
    """Return the variance of each Allan variance due to sinusoids, (2, sinusoids, factors).

    Only the part that is uncorrelated between averaging factors is included.

    - Row 0: due to white noise at aliases of the sinusoid, per A^2 w for the amplitude A and the
      white noise coefficient w.
    - Row 1: due to the random phase of the sinusoid, per A^4.

    The arguments are the averaging factors, the samples between two start positions, the numbers
    of differences, the numbers of samples and of segments, and the sinusoids.
    """
    # An Allan variance contains the means of l d and l^2 over C = ``count`` starts at a distance of
    # s = ``stride`` samples, where l are the differences of the sinusoid and d those of the noise.
    # Row 0: mean(l d) has the variance E[l^2]/C sum_k (1 - |k|/C) cos(omega s k) R_d(s k), with the
    # autocovariance R_d of d. The part of `amplitude_variance` is subtracted.
    # Row 1: mean(l^2) has the relative standard deviation sqrt(``segments``)/(2 C sin(omega s)), or
    # 1/sqrt2 if all starts have the same phase.
    out = np.zeros((2, len(lines), len(m)))
    if not lines:
        return out
    shapes = np.array([line.shape for line in lines])
    column = sinusoid_avar(m, shapes[:, None])
    omega = 2.0 * np.pi * shapes
    for n, (factor, s, number) in enumerate(zip(m, stride, count)):
        lag = np.arange(min((2 * factor - 1) // s + 1, number))
        h = (lag * s)[:, None] + np.array([0, -factor, factor])
        overlap = np.maximum(factor - np.abs(h), 0) @ np.array([2.0, -1.0, -1.0])
        weight = np.where(lag > 0, 2.0, 1.0) * (1.0 - lag / number) * overlap / float(factor) ** 2
        level = 2.0 / number * (np.cos(np.outer(omega, lag * s)) @ weight)
        level -= 8.0 / samples * column[:, n]
        out[0, :, n] = column[:, n] * np.maximum(level, 0.0)
        swing = number * np.abs(np.sin(omega * s))
        share = np.minimum(1.0, segments / np.maximum(swing, 1e-9) ** 2 / 2.0)
        out[1, :, n] = column[:, n] ** 2 / 2.0 * share
    return out


# --- covariance of Gauss-Markov processes ---------------------------------------------------------
#
# The scaling between octaves that `covariance` uses does not hold for a correlation time, so these
# sums are computed for each table. Three facts reduce the effort to about 50 ms:
#
# - C_g is A times the covariance of white noise, minus B/2 times a sum of nine exponentials, with A
#   and B of `gauss_markov_sums`.
# - C(u) and the number of pairs of differences are even functions of the lag u, counted from
#   m_j - m_i, so half of the lags is enough. The number of pairs depends only on max(2 m_j, m_i +
#   m_j + u) and decreases linearly until the segment ends, so all segments share the values of C.
# - C is smooth between the lags u = 0, m_i, m_j - m_i, m_j and m_i + m_j (called corners), and is
#   integrated there by Gauss-Legendre quadrature. The Euler-Maclaurin formula converts the integral
#   to the sum over lags: it adds 1/12 of the change of slope at each corner.

NODES = 14
"""Number of quadrature points between two corners."""

TAIL = (1.5, 9.0)
"""Distances of the last two ends of the quadrature from the last corner, in units of the longest
correlation time."""

PAIRS_AT_ONCE = 512
"""Number of pairs of factors that are computed together, which limits the memory to a few
megabytes."""

CORNER_WEIGHTS = np.array([4.0, -4.0, -4.0, 2.0, 2.0])
"""Weights of C at the corners, for both signs of u together: products of the coefficients (1, -2,
1) of two differences."""

_GAUSS, _GAUSS_WEIGHTS = legendre.leggauss(NODES)
_EVEN, _WEIGHTS = (1.0 + _GAUSS) / 2.0, _GAUSS_WEIGHTS / 2.0
_DENSITY = _EVEN**2 + (1.0 - _EVEN) ** 2
_GRADED = _EVEN**2 / _DENSITY
"""Quadrature points on 0..1 that are denser at both ends, where C changes within a correlation
time."""
_SLOPES = 2.0 * _EVEN * (1.0 - _EVEN) / _DENSITY**2
_POLYNOMIALS = (_WEIGHTS[:, None] * legendre.legvander(_GAUSS, NODES - 1)).T
_UP_TO = 0.5 * _POLYNOMIALS
"""Maps P_k+1 - P_k-1 of Legendre polynomials at a point to the weights of an integral from 0 to
this point."""
_AT = (2.0 * np.arange(NODES) + 1.0)[:, None] * _POLYNOMIALS
"""Maps Legendre polynomials P_k at a point to the weights of a value at this point."""


def process_pairs(processes: int) -> list[tuple[int, int]]:
    """Return the pairs of coefficients (a, b) in a covariance that include a process.

    Indices 0..3 are the four random terms, index 4 is the first process: (0, 4), (1, 4) .. (4, 4),
    (0, 5) .. (5, 5) and so on.
    """
    four = len(RANDOM_TERMS)
    return [(a, b) for b in range(four, four + processes) for a in range(b + 1)]


def process_squares(
    m: Ints,
    stride: Ints,
    lengths: Sequence[tuple[float, int]],
    times: Sequence[float],
) -> Floats:
    """Return the covariance that Gauss-Markov processes add to Allan sums, per unit coefficients.

    An Allan sum is the sum of d^2/(2 m^2) over all differences d at an averaging factor m.

    Parameters
    ----------
    m, stride : (factors,) int64 arrays
        Averaging factors, and samples between two start positions of differences.
    lengths : sequence of (samples, number)
        Segment lengths and the number of segments of each.
    times : sequence of float
        Correlation times in samples.

    Returns
    -------
    (products, pairs) float64 array
        One row for each of the `process_pairs` of coefficients, one column for each pair of
        factors i <= j of `numpy.triu_indices`.
    """
    # Sums of 2 C_a C_b over all pairs of differences, doubled if a and b differ.
    i, j = np.triu_indices(len(m))
    segments = _Segments(lengths)
    products = process_pairs(len(times))
    out = np.empty((len(products), len(i)))
    for first in range(0, len(i), PAIRS_AT_ONCE):
        part = slice(first, first + PAIRS_AT_ONCE)
        lags = _Lags(m[i[part]], m[j[part]], stride[i[part]], stride[j[part]], segments)
        out[:, part] = lags.sums(times, products)
    return out


class _Segments:
    """Counts of segments and of their differences, from (samples, number of segments) pairs."""

    def __init__(self, lengths: Sequence[tuple[float, int]]) -> None:
        by_length = sorted(lengths)
        self.samples = np.array([n for n, _ in by_length], float)
        self.number = np.array([count for _, count in by_length], float)
        self._number = np.append(np.cumsum(self.number[::-1])[::-1], 0.0)
        total = np.cumsum((self.number * self.samples)[::-1])[::-1]
        self._total = np.append(total, 0.0)

    def longer(self, than: Floats) -> tuple[Floats, Floats]:
        """Return the number and the total length of segments longer than ``than`` samples."""
        at = np.searchsorted(self.samples, than, side='right')
        return self._number[at], self._total[at]

    def differences(self, reach: Floats, stride: Floats) -> Floats:
        """Return the number of differences over ``reach`` samples, with starts ``stride`` apart."""
        each = np.floor((self.samples - reach[:, None]) / stride[:, None]) + 1.0
        return np.asarray(np.maximum(each, 0.0) @ self.number)

    def unused(self, reach: Floats, stride: Floats, least: Floats) -> Floats:
        """Return the mean number of samples after the last difference of a segment.

        Segments shorter than ``least`` samples are ignored.
        """
        enough = (self.samples >= least[:, None]) * self.number
        remainder = np.mod(self.samples - reach[:, None], stride[:, None])
        return np.asarray((remainder * enough).sum(axis=1) / np.maximum(enough.sum(axis=1), 1.0))


class _Lags:
    """Sums over lags of products of covariances, for given pairs of averaging factors."""

    def __init__(self, mi: Ints, mj: Ints, si: Ints, sj: Ints, segments: _Segments) -> None:
        self.mi, self.mj = mi.astype(float), mj.astype(float)
        self.stride = si.astype(float)
        stride_j = sj.astype(float)
        self.norm = 1.0 / (2.0 * self.mi * self.mj)
        self.near, self.far = self.mj - self.mi, self.mj + self.mi
        self.ratio = stride_j / self.stride
        self.lost = (1.0 - 1.0 / self.ratio) / 2.0
        self.segments, self.stride_j = segments, stride_j
        self.plateau = segments.differences(2.0 * self.mj, stride_j)
        self.dense = self.mj < NODES * self.stride
        # Largest lag of a pair of differences = samples of the segment - self.less. The last
        # difference is one of m_i for positive lags, and one of m_j for negative lags.
        unused = [
            segments.unused(2.0 * m, s, 2.0 * self.mj)
            for m, s in ((self.mi, self.stride), (self.mj, stride_j))
        ]
        self.less = self.far - stride_j * (1.0 - self.lost) + (unused[0] + unused[1]) / 2.0
        self.end = segments.samples[-1] - self.less

    def pairs_at(self, u: Floats) -> Floats:
        """Return the number of pairs of differences at lags u, (pairs, lags)."""
        lost = u + self.less[:, None]
        number, samples = self.segments.longer(np.maximum(lost, 2.0 * self.mj[:, None] - 0.5))
        falling = (samples - number * lost) / self.stride_j[:, None]
        return np.where(u <= self.near[:, None], self.plateau[:, None], falling)

    def covariances(self, u: Floats, times: Sequence[float]) -> Floats:
        """Return the covariances of differences at lags u, (3 + processes, pairs, lags)."""
        # The rows are w, b and k, then the processes, all of unit size.
        norm, scale = self.norm[:, None], self.mj[:, None]
        absolute = 4.0 * u
        flicker = _square_log(u, scale) * 4.0
        cubic = 4.0 * u**3
        decays = [np.exp(-u / time) for time in times]
        exponentials = [4.0 * decay for decay in decays]
        for weight, offset in zip((-2.0, -2.0, 1.0, 1.0), (self.mi, self.mj, self.near, self.far)):
            shift = offset[:, None]
            for t in (u + shift, np.abs(u - shift)):
                absolute += weight * t
                flicker += weight * _square_log(t, scale)
                cubic += weight * t**3
            for e, decay, time in zip(exponentials, decays, times):
                e += weight * (decay * np.exp(-shift / time) + np.exp(-t / time))
        white = -0.5 * norm * absolute
        out = [
            white,
            flicker * norm / (2.0 * np.pi),
            walk_from_cubic(white, cubic * norm / 12.0),
        ]
        for e, time in zip(exponentials, times):
            slope, step = (float(x[0]) for x in gauss_markov_sums(time))
            out.append(slope * white - 0.5 * step * norm * e)
        return np.stack(out)

    def sums(self, times: Sequence[float], products: Sequence[tuple[int, int]]) -> Floats:
        """Return the covariances of Allan sums per product of coefficients, (products, pairs)."""
        u, weight = self._weights(max(times))
        c = self.covariances(u, times)
        corners = np.stack([np.zeros_like(self.mi), self.mi, self.mj, self.near, self.far], axis=1)
        at_corners = self.pairs_at(corners) * CORNER_WEIGHTS * self.norm[:, None]
        c_corners = self.covariances(corners, times)
        near = 3
        inner, _ = self._step_corrections()
        longer, _ = self.segments.longer(2.0 * self.mj - 0.5)
        at_near = np.where(self.dense, 0.0, 2.0 * longer * inner)
        slope_change = [1.0, 0.0, 1.0 / 6.0]  # of C of w, b and k at a corner
        for time in times:
            slope, step = (float(x[0]) for x in gauss_markov_sums(time))
            slope_change.append(slope - step / time)
        twelfth = np.where(self.dense, 0.0, self.stride / 12.0)[:, None]
        out = np.empty((len(products), len(self.mi)))
        for row, (a, b) in enumerate(products):
            if a == Q:  # white phase: C differs from 0 only at the corners
                out[row] = 4.0 * (at_corners * c_corners[b - 1]).sum(axis=1)
                continue
            total = np.einsum('pu,pu,pu->p', weight, c[a - 1], c[b - 1])
            total += at_near * c_corners[a - 1, :, near] * c_corners[b - 1, :, near]
            slope_part = (
                slope_change[a - 1] * c_corners[b - 1] + slope_change[b - 1] * c_corners[a - 1]
            )
            total += (at_corners * slope_part * twelfth).sum(axis=1)
            out[row] = (2.0 if a == b else 4.0) * total
        return out

    def _weights(self, longest: float) -> tuple[Floats, Floats]:
        """Return lags and weights for numerical integration over the lag, (pairs, points) each.

        ``longest`` is the longest correlation time in samples.
        """
        # The slope of the number of pairs changes where a segment ends. A segment that ends between
        # two corners is integrated up to its end, with the polynomial through the nodes.
        lags, weights = [], []
        for low, high in pairwise(self._bounds(longest)):
            width = (high - low)[:, None]
            u = low[:, None] + width * _GRADED
            number, samples = self.segments.longer(high + self.less)
            level = (samples - number * self.less)[:, None] - number[:, None] * u
            inside = high <= self.near
            level[inside] = (self.plateau * self.stride_j)[inside, None]
            weight = level / self.stride_j[:, None] * (width * _SLOPES * _WEIGHTS)
            weight *= (2.0 / self.stride)[:, None]
            self._add_ends(weight, low, high, u)
            lags.append(u)
            weights.append(weight)
        u, weight = np.concatenate(lags, axis=1), np.concatenate(weights, axis=1)
        # If corners are a few samples apart, all lags are summed; lag 0 counts half.
        each, dense = np.arange(u.shape[1]), self.dense
        u[dense] = each * self.stride[dense, None]
        weight[dense] = np.where(each == 0, 1.0, 2.0) * self.pairs_at(u)[dense]
        return u, weight

    def _add_ends(self, weight: Floats, low: Floats, high: Floats, u: Floats) -> None:
        """Add to ``weight``, in place, segments whose longest lag is between low and high."""
        _, outer = self._step_corrections()
        width = (high - low)[:, None]
        first = np.maximum(np.maximum(low, self.near) + self.less, 2.0 * self.mj - 1.0)
        for samples, number in zip(self.segments.samples, self.segments.number):
            at = np.flatnonzero((first < samples) & (samples <= high + self.less))
            if not len(at):
                continue
            end = samples - self.less[at]
            part = np.clip((end - low[at]) / width[at, 0], 0.0, 1.0)
            part = np.sqrt(part) / (np.sqrt(part) + np.sqrt(1.0 - part))
            powers = legendre.legvander(2.0 * part - 1.0, NODES)
            falling = (end[:, None] - u[at]) / self.stride_j[at, None] * (width[at] * _SLOPES)
            before = np.concatenate([np.full((len(at), 1), -1.0), powers[:, : NODES - 1]], axis=1)
            integral = (powers[:, 1:] - before) @ _UP_TO
            weight[at] += (2.0 * number / self.stride[at, None]) * falling * integral
            weight[at] += 2.0 * number * outer[at, None] * (powers[:, :NODES] @ _AT)

    def _bounds(self, longest: float) -> list[Floats]:
        """Return the limits of the lag ranges in which the covariance is smooth."""
        corners = np.sort(
            np.stack([np.zeros_like(self.mi), self.mi, self.near, self.mj, self.far]), axis=0
        )
        tail = [self.far + end * longest for end in TAIL]
        return [np.minimum(lag, np.maximum(self.end, 0.0)) for lag in (*corners, *tail)]

    def _step_corrections(self) -> tuple[Floats, Floats]:
        """Return corrections of the quadrature for the stepwise decrease of the number of pairs."""
        # A step is ``ratio`` lags wide. The corrections are the differences between a sum over the
        # steps and the integral of a straight line at the beginning and at the end of the decrease,
        # in units of the squared covariance.
        ratio, lost = self.ratio, self.lost
        bend = np.where(ratio <= self.mi / self.stride, (ratio - 1.0 / ratio) / 12.0, lost / 2.0)
        inner = lost / 2.0 - bend + 1.0 / (12.0 * ratio)
        outer = (1.0 - lost) / 2.0 + bend - (1.0 - lost) ** 2 * ratio / 2.0 - 1.0 / (12.0 * ratio)
        return inner, outer


def _square_log(t: Floats, scale: Floats) -> Floats:
    """Return t^2 ln(t/scale)."""
    # ``scale`` has no effect on the covariance of differences.
    return np.asarray(t * t * np.log(np.maximum(t, 1e-9) / scale))
