# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Covariance of Allan variances at different averaging factors, for a record of finite length.

For Gaussian noise, the covariance of two Allan variances is a sum over lags (Isserlis 1918):

    Cov(V_i, V_j) = 2/(M_i M_j) sum_s cnt_ij(s) C_ij(s)^2

- V_i is the mean of the squares of M_i normalized differences d_i/(sqrt2 m_i), where d_i is a
  second difference of the phase over m_i samples.
- C_ij(s) is the covariance of two normalized differences, at m_i and m_j, at lag s.
- cnt_ij(s) is the number of pairs of differences at this lag.

C is linear in the variance coefficients q, w, b, k: the squares of Q, N, B, K with the sample
period as unit of time. The covariance is therefore a sum of ten matrices, each multiplied by a
product of two coefficients. The matrices depend only on the length of the record.
"""

# cnt is piecewise linear in s. The sum therefore follows from the cumulative sums of C_k C_l and of
# s C_k C_l at four lags, where C_k is C for the unit coefficient k. The averaging factors of an
# octave are twice those of the octave before: C of the pair (2^a m, 2^a m') at lag 2^a s equals C
# of (m, m') at lag s times a power of 2^a. One table of cumulative sums, for the pairs whose
# smaller factor is in the first octaves (level 0), is therefore enough for all pairs and records.

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..allan.sums import FIRST_FACTORS, LEVEL_FACTORS, counts, grid
from ..errors import AllanError
from .model import DIFFERENCE, Floats, Ints, walk_from_cubic

TERM_PAIRS = tuple((a, b) for a in range(4) for b in range(a, 4))
"""The ten products of variance coefficients in a covariance: q q, q w, q b, .. k k."""

EXACT_POINTS = 14
"""Ranges of lags up to this length are summed point by point, longer ones by quadrature."""

EXACT_PANELS = 5
"""Number of ranges that are summed point by point on each side of the three lags at which C is not
smooth."""

PANEL_RATIO = 4
"""Factor by which each range is longer than the one before, away from the lags at which C is not
smooth."""

TAIL = 128
"""Flicker differences are uncorrelated (C^2 < 1e-8) at lags above this multiple of m_i + m_j."""

PANELS_AT_ONCE = 1024
"""Number of ranges that are summed together, which limits the memory to a few megabytes."""

MOST_SAMPLES = 1 << 47
"""Longest segment in samples, 4000 years at 1 kHz. The search keys of longer ones would
overflow."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(EXACT_POINTS + 1)
_KEY = np.int64(1) << 52
"""Distance between the search keys of two rows, larger than the largest lag of a row."""

_MAX_LAG = int(_KEY) // 4
"""Largest end of a range of lags; longer lags do not occur in `MOST_SAMPLES` samples."""

_SMOOTH_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
PRODUCTS = len(_SMOOTH_PAIRS) + 3
"""Number of cumulative sums: of the six products C_k C_l and of the three C_k."""


@dataclass(frozen=True)
class PairSums:
    """Covariance of the Allan variances of one record, per product of two variance coefficients.

    C_k(s) is the covariance of two normalized differences at lag s for a unit variance coefficient
    k, and cnt(s) is the number of pairs of differences at this lag.

    Attributes
    ----------
    samples : int
        Length of the record.
    m, count : (factors,) int64 arrays
        Averaging factors m <= samples/2, and the number M of differences at each.
    squares : (10, pairs) float64 array
        2 sum_s cnt C_k C_l for the `TERM_PAIRS` (k, l), twice this if k != l. The columns are the
        pairs of factors i <= j of `numpy.triu_indices`. With variance coefficients p, Cov(V_i, V_j)
        = sum_kl p_k p_l squares_kl / (M_i M_j).
    singles : (4, pairs) float64 array
        sum_s cnt C_k: the covariance of the sums of d_i/(sqrt2 m_i) and of d_j/(sqrt2 m_j).
    """

    samples: int
    m: Ints
    count: Ints
    squares: Floats
    singles: Floats


def lag_covariance(s: Floats, mi: Floats, mj: Floats) -> Floats:
    """Return the covariance at lag s of phase differences over mi and over mj samples, (3, ...).

    The differences are second differences of the phase divided by sqrt(2) m. The rows contain unit
    white noise, unit flicker and a unit continuous random walk.
    """
    # The sum over a, b = 0, 1, 2 of c_a c_b G(s + a m_i - b m_j) / (2 m_i m_j), c = (1, -2, 1),
    # where G is the generalized covariance of the phase: -|t|/2, t^2 ln|t|/(2 pi), |t|^3/12.
    out = np.zeros((3, *np.broadcast_shapes(np.shape(s), np.shape(mi), np.shape(mj))))
    for a, ca in enumerate(DIFFERENCE):
        for b, cb in enumerate(DIFFERENCE):
            t = np.abs(s + (a * mi - b * mj))
            square = t * t
            out[0] += ca * cb * t
            out[1] += ca * cb * square * np.log(np.maximum(t, 1e-9) / mj)
            out[2] += ca * cb * square * t
    out[0] *= -0.5
    out[1] /= 2.0 * np.pi
    out[2] /= 12.0
    return np.asarray(out / (2.0 * mi * mj))


def _covariance_products(s: Floats, mi: Floats, mj: Floats) -> Floats:
    """Return the six products of two rows of `lag_covariance` and the three rows, (9, ...)."""
    c = lag_covariance(s, mi, mj)
    return np.stack([*(c[a] * c[b] for a, b in _SMOOTH_PAIRS), *c])


def _panel_sums(mi: Floats, mj: Floats, a: Floats, b: Floats) -> Floats:
    """Return the sums of products, and of lag times products, over the lags a..b, (2, 9, n)."""
    # The first and the last lag count half.
    width = (b - a)[:, None]
    k = np.arange(EXACT_POINTS + 1)
    exact = width <= EXACT_POINTS
    ones = (k <= width) - 0.5 * (k == 0) - 0.5 * (k == width)
    s = a[:, None] + np.where(exact, np.minimum(k, width), width * (1.0 + _NODES) / 2.0)
    weight = np.where(exact, ones * (width > 0), _WEIGHTS * width / 2.0)
    f = _covariance_products(s, mi[:, None], mj[:, None])
    return np.stack([np.einsum('fnk,nk->fn', f, weight), np.einsum('fnk,nk->fn', f, weight * s)])


def _lag_limits(mi: int, mj: int) -> Ints:
    """Return the limits of the ranges into which the lags are divided for summation."""
    # Ranges are short where the covariance is not smooth.
    span = EXACT_POINTS * EXACT_PANELS
    near = np.arange(-EXACT_PANELS, EXACT_PANELS + 1) * EXACT_POINTS
    reach = [span]
    while reach[-1] < 2 * mj:
        reach.append(reach[-1] * PANEL_RATIO)
    around = np.concatenate([near, reach, np.negative(reach)])
    far = [2 * (mi + mj) * PANEL_RATIO**e for e in range(4)] + [TAIL * (mi + mj)]
    center = mj - mi
    lags = [around + b * mj - mi for b in range(3)]
    tail = np.minimum(far, _MAX_LAG)
    lags.append(center + np.concatenate([tail, -tail]))
    return np.unique(np.concatenate(lags)).astype(np.int64)


class _LagTable:
    """Cumulative sums over lags of covariance products, for pairs of averaging factors.

    They are stored for pairs whose smaller factor is in the first octaves of the grid (level 0).
    Other pairs follow by scaling.
    """

    def __init__(self, factors: int) -> None:
        first = len(FIRST_FACTORS) + len(LEVEL_FACTORS)
        m = grid(max(1, -(-(factors - len(FIRST_FACTORS)) // len(LEVEL_FACTORS))))[0][:factors]
        self.row = np.full((first, factors), -1)
        rows = [(i, j) for i in range(min(first, factors)) for j in range(i, factors)]
        self.row[tuple(np.array(rows).T)] = np.arange(len(rows))
        self.mi = m[[i for i, _ in rows]].astype(float)
        self.mj = m[[j for _, j in rows]].astype(float)
        edges = [_lag_limits(int(a), int(b)) for a, b in zip(self.mi, self.mj)]
        size = np.array([len(e) for e in edges])
        owner = np.repeat(np.arange(len(rows)), size)
        self.edge = np.concatenate(edges)
        self.key = owner * _KEY + self.edge
        self.low = np.array([e[0] for e in edges])
        self.high = np.array([e[-1] for e in edges])
        last = np.cumsum(size) - 1
        inner = np.setdiff1d(np.arange(len(owner)), last)
        self.sums = np.zeros((2, PRODUCTS, len(owner)))
        for part in np.array_split(inner, len(inner) // PANELS_AT_ONCE + 1):
            self.sums[:, :, part + 1] = _panel_sums(
                self.mi[owner[part]],
                self.mj[owner[part]],
                self.edge[part].astype(float),
                self.edge[part + 1].astype(float),
            )
        for a, z in zip(last - size + 1, last + 1):
            np.cumsum(self.sums[:, :, a:z], axis=2, out=self.sums[:, :, a:z])

    def up_to(self, row: Ints, lag: Ints) -> Floats:
        """Return the cumulative sums up to one lag in each of the given rows, (2, 9, n)."""
        # The last lag counts half.
        lag = np.clip(lag, self.low[row], self.high[row])
        at = np.searchsorted(self.key, row * _KEY + lag, side='right') - 1
        start = self.edge[at].astype(float)
        out = self.sums[:, :, at]
        for first in range(0, len(row), PANELS_AT_ONCE):
            part = slice(first, first + PANELS_AT_ONCE)
            mi, mj = self.mi[row[part]], self.mj[row[part]]
            out[:, :, part] += _panel_sums(mi, mj, start[part], lag[part].astype(float))
        return out


_lag_tables: list[_LagTable] = []
"""The largest table so far (8 MB for a day at 200 Hz), which also serves shorter records."""


def _lag_table(octaves: int) -> _LagTable:
    """Return a `_LagTable` of at least the given number of octaves."""
    factors = len(FIRST_FACTORS) + len(LEVEL_FACTORS) * octaves
    for table in _lag_tables:
        if table.row.shape[1] >= factors:
            return table
    _lag_tables.clear()  # before the next one is computed, so there is never more than one
    made = _LagTable(factors)
    _lag_tables.append(made)
    return made


@lru_cache(maxsize=80)
def pair_sums(samples: int) -> PairSums:
    """Return the `PairSums` of a record of ``samples`` samples; the last 80 are cached.

    Raises AllanError for more than `MOST_SAMPLES` samples.
    """
    if samples > MOST_SAMPLES:
        raise AllanError(
            f'the sums are damaged: a segment has {samples} samples, more than any recording; '
            'accumulate them again'
        )
    octaves = max(1, samples.bit_length() - 3)
    m, stride = grid(octaves)
    keep = 2 * m <= samples
    m, stride = m[keep], stride[keep]
    count = counts(samples, m, stride)
    i, j = np.triu_indices(len(m))
    squares, singles = _smooth_sums(_lag_table(octaves), i, j, stride, count)
    _add_quantization(squares, singles, i, j, m, stride, count)
    return PairSums(samples, m, count, squares, singles)


def clear_pair_sums() -> None:
    """Free the caches of `pair_sums` and of the sums over lags that it uses."""
    _lag_tables.clear()
    pair_sums.cache_clear()


def _smooth_sums(
    table: _LagTable, i: Ints, j: Ints, stride: Ints, count: Ints
) -> tuple[Floats, Floats]:
    """Return ``squares`` and ``singles`` of `PairSums` for all terms except quantization."""
    # With increasing lag, the number of pairs cnt rises from 1 by one every s_j samples to M_j,
    # remains constant, and falls to 1. A step is ``ratio`` = s_j/s_i lags wide. The sum over the
    # steps is that over a straight line ``fall`` = (1 - 1/ratio)/2 below their edges, plus
    # Euler-Maclaurin terms (``bend``) at both ends of the line.
    level = np.maximum(i - len(FIRST_FACTORS), 0) // len(LEVEL_FACTORS)
    row = table.row[i - len(LEVEL_FACTORS) * level, j - len(LEVEL_FACTORS) * level]
    mi, mj = table.mi[row], table.mj[row]
    ratio = stride[j] // stride[i]
    fall = (1.0 - 1.0 / ratio) / 2.0
    start = -(count[j] - 1) * ratio
    end = count[i] - 1
    lags = np.stack([start, np.zeros_like(start), end + start, end])
    sums = table.up_to(np.tile(row, len(lags)), lags.ravel()).reshape(2, 9, len(lags), -1)
    steps0, steps1 = np.moveaxis(np.diff(sums, axis=2), 2, 1)
    f = (
        ((count[j] - fall) * steps0[0] + steps1[0] / ratio)
        + count[j] * steps0[1]
        + ((end / ratio + 1.0 - fall) * steps0[2] - steps1[2] / ratio)
    )
    # If a step is longer than m_i, C is not smooth over it and the end terms are not valid.
    bend = np.where(ratio <= mi, (ratio - 1.0 / ratio) / 12.0, fall / 2.0)
    outer, inner = (1.0 - fall) / 2.0 + bend, fall / 2.0 - bend
    for lag, weight in zip(lags, (outer, inner, inner, outer)):
        f += weight * _covariance_products(lag.astype(float), mi, mj)
    return _assemble(f, 2.0 ** -level.astype(float))


def _assemble(f: Floats, scale: Floats) -> tuple[Floats, Floats]:
    """Combine sums over lags to ``squares`` and ``singles`` of `PairSums`."""
    # On level a, lags and factors are 2^a times those of level 0. The covariance of white noise is
    # multiplied by 2^-a (``scale``), that of flicker by 1 and that of the cubic part by 2^a.
    nn, nb, nc, bb, bc, cc = f[:6] * np.stack(
        [scale**2, scale, np.ones_like(scale), np.ones_like(scale), 1 / scale, scale**-2]
    )
    n, b, c = f[6:] * np.stack([scale, np.ones_like(scale), 1 / scale])
    zero = np.zeros_like(nn)
    products = {
        (1, 1): nn,
        (1, 2): nb,
        (1, 3): walk_from_cubic(nn, nc),
        (2, 2): bb,
        (2, 3): walk_from_cubic(nb, bc),
        (3, 3): walk_from_cubic(walk_from_cubic(nn, nc), walk_from_cubic(nc, cc)),
    }
    squares = [(2.0 if a == b else 4.0) * products.get((a, b), zero) for a, b in TERM_PAIRS]
    return np.stack(squares), np.stack([zero, n, b, walk_from_cubic(n, c)])


def _add_quantization(
    squares: Floats, singles: Floats, i: Ints, j: Ints, m: Ints, stride: Ints, count: Ints
) -> None:
    """Add the contribution of quantization noise to squares and singles, in place."""
    # Its covariance differs from 0 only at the nine lags b m_j - a m_i.
    mi, mj = m[i], m[j]
    norm = 2.0 * mi.astype(float) * mj
    lags = [
        (ca * cb, b * mj - a * mi)
        for a, ca in enumerate(DIFFERENCE)
        for b, cb in enumerate(DIFFERENCE)
    ]
    for weight, lag in lags:
        pairs = _count_pairs(lag, (count[i] - 1) * stride[i], (count[j] - 1) * stride[j], stride[j])
        pairs *= weight / norm
        # Lags coincide if m_j/m_i is 1 or 2; their weights are then added.
        here = sum(other * (lag == at) for other, at in lags) / norm
        smooth = lag_covariance(lag.astype(float), mi.astype(float), mj.astype(float))
        white, flicker, cubic = smooth
        squares[0] += 2.0 * pairs * here
        for n, c in enumerate((white, flicker, walk_from_cubic(white, cubic)), start=1):
            squares[n] += 4.0 * pairs * c
        singles[0] += pairs


def _count_pairs(lag: Ints, end_i: Ints, end_j: Ints, stride_j: Ints) -> Floats:
    """Return the number of pairs of differences at each lag."""
    # The lags are multiples of the stride of i.
    first = np.maximum(0, -lag)
    last = np.minimum(end_j, end_i - lag)
    number = last // stride_j + (-first) // stride_j + 1
    return np.where(last >= first, np.maximum(number, 0), 0).astype(float)


def interpolation_excess(m: Ints, filled: Ints, samples: int) -> Floats:
    """Return the increase of the Allan variance of unit white noise due to interpolated samples.

    The samples of a gap are interpolated linearly between its two neighbors. Only the numbers of
    gaps are known; their positions are assumed to be random and independent.

    Parameters
    ----------
    m : (factors,) int64 array
        Averaging factors.
    filled : (lengths, ...) int64 array
        Number of gaps of 1, 2, ... interpolated samples.
    samples : int
        Number of samples, including interpolated ones.

    Returns
    -------
    (factors, ...) float64 array
    """
    # The neighbors of a gap get a larger weight in a second difference, which increases its
    # variance. A sample between two gaps gets a larger weight from both.
    # Summed over all start positions, the squared weights increase linearly with m if m exceeds the
    # length of the gap.
    out = np.zeros((len(m), *filled.shape[1:]))
    scale = 2.0 * m.astype(float) ** 2
    for k, number in enumerate(filled, start=1):
        if number.any():
            slope = 2.0 * (k + k * k / 2.0)
            extra = np.array([_gap_excess(k, min(int(f), k)) + slope * max(f - k, 0) for f in m])
            out += np.multiply.outer(extra / scale, number / samples)
    lengths = np.arange(1, len(filled) + 1)
    recorded = np.maximum(samples - np.tensordot(lengths, filled, 1), 1)
    for k, number in enumerate(filled, start=1):
        for after, others in enumerate(filled, start=1):
            neighbors = number * (others / recorded / samples)
            if np.any(neighbors > NEGLIGIBLE_NEIGHBORS):
                both = k + after
                extra = np.array([_adjacent_gap_excess(k, after, min(int(f), both)) for f in m])
                extra += k * after * np.maximum(m - both, 0)
                out += np.multiply.outer(extra / scale, neighbors)
    return out


NEGLIGIBLE_NEIGHBORS = 1e-5
"""Fraction of all samples below which samples between two gaps are neglected."""


@lru_cache(maxsize=1024)
def _adjacent_gap_excess(k: int, after: int, m: int) -> float:
    """Return the correction of `_gap_excess` for two gaps with only one sample between them."""
    base = _difference_weights(m, k + after + 3)
    left = np.correlate(base, np.arange(1, k + 1) / (k + 1))
    right = np.correlate(base, np.arange(after, 0, -1) / (after + 1))
    n = len(right) - k - 1
    return float(2.0 * left[:n] @ right[k + 1 :])


def _difference_weights(m: int, margin: int) -> Floats:
    """Return the weight of each sample in a second difference, padded with zeros."""
    outside = np.zeros(margin)
    return np.concatenate([outside, -np.ones(m), np.ones(m), outside])


@lru_cache(maxsize=1024)
def _gap_excess(k: int, m: int) -> float:
    """Return the change of the sum of squared weights due to a gap of k interpolated samples."""
    length = k + 2
    base = _difference_weights(m, length)
    share = np.arange(1, k + 1) / (k + 1)
    change = 0.0
    for at in range(len(base) - length + 1):
        w = base[at : at + length]
        left = w[0] + (1.0 - share) @ w[1:-1]
        right = w[-1] + share @ w[1:-1]
        change += left**2 + right**2 - float(w @ w)
    return change
