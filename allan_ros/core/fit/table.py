# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Allan table of pooled segments without their ramps, with its expectation and covariance.

Segments are independent, so their sums add, and so do the sums over pairs that make up the
covariance: V = sum M_s V_s / sum M_s, C = sum (M_s/M)^2 C_s. Every segment has a ramp of its own;
it is taken out of every difference with weights that are fixed before the table is fitted, which
leaves both moments exact (module `ramp`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..allan.sums import (
    LENGTH_CLASS_RATIO,
    AllanSums,
    LengthClass,
    SegmentRecord,
    allan_variance,
    counts,
    ols_ramp_weights,
)
from .covariance import TERM_PAIRS, PairSums, clear_pair_sums, filled_white, pair_sums
from .model import RANDOM_TERMS, WHITE, Floats, avar_terms
from .process_covariance import process_pairs, process_squares
from .ramp import RampEffect, RampGeometry, ramp_geometry, ramp_shift

Ints = NDArray[np.int64]


ROUNDING = 1e-12
"""Fraction of the variance below which the rest, without the ramp, is rounding."""


EMPTY_ROW = 1e-6
"""A factor whose differences keep less than this part of their variance without the ramp is left
out: a record of two differences is mostly its own ramp."""


KEPT_PROCESS_SQUARES = 16
"""Sets of correlation times whose covariance is kept."""


@dataclass(frozen=True)
class Table:
    """The pooled Allan table of one axis and its first two moments under the noise model.

    Attributes
    ----------
    m, count : (factors,) int64 arrays
        Averaging factors and numbers of differences.
    avar : (factors,) float64 array
        Allan variance of the samples less the ramps.
    terms : (factors, 4) float64 array
        Its expectation for unit q, w, b, k; further columns where terms were added.
    squares : (10, pairs) float64 array
        Its covariance for the products of coefficients `TERM_PAIRS`, at pairs i <= j.
    ramps : (segments,) float64 array
        The ramp taken out of each kept segment, per sample; 0 where none could be estimated.
    ramp_variance : (segments, 4) float64 array
        Its variance per unit coefficient.
    ramp_squares : (10, pairs) float64 array
        The part of ``squares`` that removing the ramps has added.
    noises : int
        Columns that scatter: the four terms and Gauss-Markov processes. ``squares`` has their
        products.
    line_scatter : (lines, noises) float64 array
        For each sinusoid, whose columns follow, the variance of its squared amplitude over the
        squared amplitude, per unit variance of each noise. Further columns only shift the
        expectation.
    line_rest : (2, lines, factors) float64 array
        The other variance of ``avar`` that a sinusoid causes, independent at each factor: over its
        squared amplitude and w, and over its squared amplitude squared.
    filled : (factors,) float64 array
        What interpolated samples have added to the column of white noise.
    """

    m: Ints
    count: Ints
    avar: Floats
    terms: Floats
    squares: Floats
    ramps: Floats
    ramp_variance: Floats
    ramp_squares: Floats
    noises: int = len(RANDOM_TERMS)
    line_scatter: Floats = field(default_factory=lambda: np.zeros((0, len(RANDOM_TERMS))))
    line_rest: Floats = field(default_factory=lambda: np.zeros((2, 0, 0)))
    filled: Floats | float = 0.0

    @property
    def lines(self) -> int:
        """How many sinusoids there are."""
        return len(self.line_scatter)

    def covariance(self, power: Floats) -> Floats:
        """Return the covariance of ``avar`` under these coefficients, (factors, factors).

        A sinusoid multiplies with the noise at its frequency, which changes its amplitude alone,
        and with that at its aliases where not every start is used (``line_rest``).
        """
        p = np.maximum(power, 0.0)
        pairs = (*TERM_PAIRS, *process_pairs(self.noises - len(RANDOM_TERMS)))
        packed = np.array([p[a] * p[b] for a, b in pairs]) @ self.squares
        covariance = packed[_packing(len(self.m))]
        for k, scatter in enumerate(self.line_scatter, start=self.noises):
            column = self.terms[:, k]
            covariance += p[k] * (scatter @ p[: self.noises]) * np.outer(column, column)
            of_noise, of_itself = self.line_rest[:, k - self.noises]
            covariance[np.diag_indices_from(covariance)] += p[k] * (
                p[N] * of_noise + p[k] * of_itself
            )
        return covariance

    def rows(self, keep: NDArray[np.bool_]) -> Table:
        """Return the table of some of its factors."""
        i, j = np.triu_indices(len(self.m))
        return replace(
            self,
            m=self.m[keep],
            count=self.count[keep],
            avar=self.avar[keep],
            terms=self.terms[keep],
            squares=self.squares[:, keep[i] & keep[j]],
            ramp_squares=self.ramp_squares[:, keep[i] & keep[j]],
            line_rest=self.line_rest[:, :, keep] if self.lines else self.line_rest,
            filled=self.filled if isinstance(self.filled, float) else self.filled[keep],
        )


@lru_cache(maxsize=8)
def _packing(size: int) -> Ints:
    """Return the index of each element of a symmetric matrix in the list of its pairs i <= j."""
    at = np.empty((size, size), np.int64)
    i, j = np.triu_indices(size)
    at[i, j] = at[j, i] = np.arange(len(i))
    at.flags.writeable = False
    return at


@dataclass(frozen=True)
class _Part:
    """One kept segment, or the segments of one length class.

    Attributes
    ----------
    number : int
        How many segments of this length.
    pairs : PairSums
    geometry : RampGeometry
    at : (pairs,) int64 array
        Positions of its pairs i <= j among those of the pooled table.
    """

    number: int
    pairs: PairSums
    geometry: RampGeometry
    at: Ints

    @classmethod
    def of(cls, samples: int, number: int, factors: int, step: int = 0) -> _Part:
        pairs = pair_sums(samples)
        i, j = np.triu_indices(len(pairs.m))
        at = i * factors - i * (i - 1) // 2 + (j - i)
        return cls(number, pairs, ramp_geometry(samples, step), at)

    def add(self, squares: Floats) -> None:
        """Add its pair sums to the pooled ones, (10, pairs), before its ramps are removed."""
        squares[:, self.at] += self.number * self.pairs.squares

    def add_ramp(self, effect: RampEffect, terms: Floats, ramp_squares: Floats) -> None:
        """Add what removing its ramps does to the expectation, (factors, 4), and pair sums."""
        m = self.pairs.m
        shift = ramp_shift(m, effect)
        terms[: len(m)] += (self.number * self.pairs.count)[:, None] * shift
        self.add_ramp_squares(effect, ramp_squares)

    def add_ramp_squares(self, effect: RampEffect, ramp_squares: Floats) -> None:
        """Add what removing its ramps does to the pooled pair sums, (10, pairs)."""
        m = self.pairs.m.astype(float)
        # d' = d - r m^2 has at every lag the covariance C - D; in units of 1/(2 m_i m_j) D is
        # the same for all starts when r is the best estimate, and near it for any good one.
        i, j = np.triu_indices(len(m))
        less = (effect.cross[:, j] * m[i] + effect.cross[:, i] * m[j]) / np.sqrt(2.0)
        less -= effect.variance[:, None] * (m[i] * m[j] / 2.0)
        pairs = self.pairs.count[i].astype(float) * self.pairs.count[j]
        single = self.pairs.singles
        for n, (a, b) in enumerate(TERM_PAIRS):
            twice = 2.0 if a == b else 4.0
            change = pairs * less[a] * less[b] - less[a] * single[b] - less[b] * single[a]
            ramp_squares[n, self.at] += self.number * twice * change


N = RANDOM_TERMS.index('N')


class PooledTable:
    """The sums of all segments and the covariances of their record lengths, for all axes."""

    def __init__(self, sums: AllanSums) -> None:
        self.sums = sums
        factors = len(sums.count)
        self.m = sums.m
        self.terms = avar_terms(self.m)
        self._kept = [_Part.of(s.samples, 1, factors, s.phase_step) for s in sums.segments]
        self._filled = filled_white(self.m, sums.filled, max(sums.samples, 1))
        self._pooled_sums = sums.sum_sq.copy()
        self._pooled_squares = np.zeros((len(TERM_PAIRS), factors * (factors + 1) // 2))
        self._pooled_ramp_squares = np.zeros_like(self._pooled_squares)
        self._process_squares: dict[tuple[float, ...], Floats] = {}
        pooled = sums.count.copy()
        for part in self._kept:
            part.add(self._pooled_squares)
            pooled[: len(part.pairs.m)] -= part.pairs.count
        for length_class in sums.classes:
            self._pool(length_class, factors)
        self._pooled_terms = pooled_shift(sums.classes, self.m, sums.stride, pooled)

    def _pool(self, pool: LengthClass, factors: int) -> None:
        part = _Part.of(round(pool.samples / pool.count), pool.count, factors)
        effect = fixed_effect(part.pairs.samples)
        part.add(self._pooled_squares)
        if effect is not None:
            part.add_ramp_squares(effect, self._pooled_ramp_squares)
        self._pooled_sums[: len(pool.ramp_correction)] += pool.ramp_correction

    @property
    def segments(self) -> Sequence[SegmentRecord]:
        """The kept segments, longest first."""
        return self.sums.segments

    def is_noiseless(self, axis: int) -> bool:
        """Return whether the samples of an axis are constant or a straight line, to rounding."""
        if not np.any(self.sums.avar[:, axis] > 0.0):
            return True
        table = self.table(axis, WHITE)
        raw = self.sums.avar[np.isin(self.m, table.m), axis]
        return not np.any(table.avar > ROUNDING * raw)

    def ramps(
        self, axis: int, power: Floats, known: Floats
    ) -> tuple[Floats, list[RampEffect | None]]:
        """Return the ramp of each kept segment, and the effect of its estimation.

        Parameters
        ----------
        axis : int
        power : (4,) float64 array
            The noise that the weights of the ramps are made for.
        known : (segments,) float64 array
            Known ramps per sample, NaN where the ramp is to be estimated.
        """
        found = np.where(np.isfinite(known), known, 0.0)
        effects: list[RampEffect | None] = []
        for s, (part, record) in enumerate(zip(self._kept, self.segments)):
            weights = None if np.isfinite(known[s]) else part.geometry.best_weights(power)
            effects.append(None if weights is None else part.geometry.effect(weights))
            if weights is not None:
                found[s] = weights @ record.phase[:, axis]
        return found, effects

    def table(self, axis: int, power: Floats, ramps: Floats | None = None) -> Table:
        """Return the table of one axis, with the best ramps under these coefficients.

        Parameters
        ----------
        axis : int
            Position among the axes of the sums.
        power : (4,) float64 array
            The noise that the weights of the ramps are made for; white noise if all are 0, as
            where a sinusoid describes the complete curve.
        ramps : (segments,) float64 array, optional
            Known ramps per sample, NaN where the ramp is to be estimated.
        """
        power = power if np.any(power > 0.0) else WHITE
        sum_sq = self._pooled_sums[:, axis].copy()
        terms, ramp_squares = self._pooled_terms.copy(), self._pooled_ramp_squares.copy()
        known = np.full(len(self._kept), np.nan) if ramps is None else ramps
        found, effects = self.ramps(axis, power, known)
        for part, record, r, effect in zip(self._kept, self.segments, found, effects):
            if effect is not None:
                part.add_ramp(effect, terms, ramp_squares)
            m2 = part.pairs.m.astype(float) ** 2
            sum_sq[: len(m2)] += (
                -2.0 * r * m2 * record.signed[:, axis] + part.pairs.count * (m2 * r) ** 2
            )
        count, number = self.sums.count.astype(float), self._pair_counts
        expected = self.terms + terms / count[:, None]
        filled = self._filled[:, axis] if self.sums.filled.any() else 0.0
        expected[:, N] += filled
        table = Table(
            self.m,
            self.sums.count,
            allan_variance(sum_sq[:, None], self.m, self.sums.count)[:, 0],
            expected,
            (self._pooled_squares + ramp_squares) / number,
            found,
            variances(effects),
            ramp_squares / number,
            filled=filled,
        )
        return table.rows(_informative(table, self.terms, power))

    @property
    def _pair_counts(self) -> Floats:
        """Products of the numbers of differences at the pairs of factors i <= j."""
        count = self.sums.count.astype(float)
        i, j = np.triu_indices(len(count))
        return np.asarray(count[i] * count[j])

    def process_squares(self, times: tuple[float, ...], keep: NDArray[np.bool_]) -> Floats:
        """Return the covariance of some factors for products with Gauss-Markov processes.

        Parameters
        ----------
        times : tuple of float
            Correlation times in samples. The sums for the last few are kept.
        keep : (factors,) bool array
            Which factors of the grid.

        Returns
        -------
        (products, pairs) float64 array
            For the `process_pairs`, the ramps left in.
        """
        if times not in self._process_squares:
            while len(self._process_squares) >= KEPT_PROCESS_SQUARES:
                del self._process_squares[next(iter(self._process_squares))]
            lengths = [(float(n), count) for n, count in self.sums.length_histogram]
            squares = process_squares(self.m, self.sums.stride, lengths, times)
            self._process_squares[times] = squares / self._pair_counts
        i, j = np.triu_indices(len(self.m))
        return self._process_squares[times][:, keep[i] & keep[j]]


def clear_cache() -> None:
    """Clear the tables kept by record length: some 20 MB, computed again in 0.2 s."""
    clear_pair_sums()
    ramp_geometry.cache_clear()


def variances(effects: Sequence[RampEffect | None]) -> Floats:
    """Return the variance of each ramp per unit coefficient, (segments, 4); 0 where it has none."""
    none = np.zeros(len(RANDOM_TERMS))
    return np.array([none if e is None else e.variance for e in effects]).reshape(-1, len(none))


def _informative(table: Table, whole: Floats, power: Floats) -> NDArray[np.bool_]:
    """Return which factors keep enough variance after the ramps are removed."""
    p = np.maximum(power, 0.0)
    keep = (table.count > 0) & (table.terms @ p > EMPTY_ROW * (whole @ p))
    diagonal = np.diag(table.covariance(power))
    return np.asarray(keep & (diagonal > (EMPTY_ROW * (whole @ p)) ** 2))


def pooled_shift(classes: Sequence[LengthClass], m: Ints, stride: Ints, count: Ints) -> Floats:
    """Return what removing the ramps adds to the expected sums over the pooled differences.

    Parameters
    ----------
    classes : sequence of LengthClass
    m, stride, count : (factors,) int64 arrays
        Averaging factors, samples between two starts, and differences of all pooled segments.

    Returns
    -------
    (factors, 4) float64 array
        Per unit coefficient, for sums of d^2/(2 m^2).
    """
    taken = np.zeros((len(m), len(RANDOM_TERMS)))
    number = np.zeros(len(m))
    partly = np.zeros(len(m), np.int64)
    for pool in classes:
        mean, low, high = _lengths(pool)
        whole = np.flatnonzero(2 * m <= low)
        here = pool.count * _differences(pool, mean, m[whole], stride[whole])
        number[whole] += here
        taken[whole] += here[:, None] * _shift(round(mean))[whole]
        partly[(2 * m > low) & (2 * m < high)] = round(mean)
    for i in np.flatnonzero(partly):
        rest = max(count[i] - number[i], 0.0)
        number[i] += rest
        taken[i] += rest * _shift(max(int(partly[i]), 2 * int(m[i])))[i]
    return np.asarray(taken * (count / np.maximum(number, 1.0))[:, None])


def fixed_effect(samples: int) -> RampEffect | None:
    """Return the effect of the least-squares ramp of a pooled segment; None where it has none."""
    geometry = ramp_geometry(samples)
    if geometry.points < 3:
        return None
    return geometry.effect(ols_ramp_weights(geometry.points, geometry.step))


def _lengths(pool: LengthClass) -> tuple[float, float, float]:
    """Return the mean length of the segments of a class, and the bounds of their lengths."""
    mean = pool.samples / pool.count
    if pool.count == 1:
        return mean, mean, mean
    low = LENGTH_CLASS_RATIO ** np.floor(np.log(mean) / np.log(LENGTH_CLASS_RATIO))
    return mean, min(low, mean), low * LENGTH_CLASS_RATIO


def _differences(pool: LengthClass, mean: float, m: Ints, stride: Ints) -> Floats:
    """Return how many differences a segment of a class has at the factors, on average."""
    if pool.count == 1:
        return counts(pool.samples, m, stride).astype(float)
    # The mean of floor((n - 2 m)/s) + 1 over lengths n of any remainder.
    return np.asarray((mean - 2 * m) / stride + (1.0 + 1.0 / stride) / 2.0)


def _shift(samples: int) -> Floats:
    """Return what removing the ramp of a segment adds to each difference, (its factors, 4)."""
    m, effect = ramp_geometry(samples).m, fixed_effect(samples)
    if effect is None:
        return np.zeros((len(m), len(RANDOM_TERMS)))
    return ramp_shift(m, effect)
