# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Allan table of pooled segments, freed of their ramps, with its expectation and covariance.

Segments are independent, so their sums add, and so do the sums over pairs that make up the
covariance: V = sum M_s V_s / sum M_s, C = sum (M_s/M)^2 C_s. Every segment has a ramp of its own;
it is taken out of every difference with weights that are fixed before the table is fitted, which
leaves both moments exact (module `ramp`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..sums import AllanSums, LengthClass, SegmentRecord, ols_ramp_weights
from .covariance import TERM_PAIRS, PairSums, pair_sums
from .model import RANDOM_TERMS, WHITE, Floats, avar_terms
from .ramp import RampEffect, RampGeometry, ramp_geometry

Ints = NDArray[np.int64]

ROUNDING = 1e-12
"""Part of the variance that is rounding when all else of it is the ramp's."""

EMPTY_ROW = 1e-6
"""A factor whose differences keep less than this part of their variance without the ramp is left
out: a record of two differences is mostly its own ramp."""


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
        Its covariance for the products of powers `TERM_PAIRS`, at pairs i <= j.
    ramps : (segments,) float64 array
        The ramp taken out of each kept segment, per sample; 0 where none could be estimated.
    ramp_variance : (segments, 4) float64 array
        Its variance per unit power.
    exponents : tuple of float
        For each added term, the power of its relative share that the covariance grows with.
    """

    m: Ints
    count: Ints
    avar: Floats
    terms: Floats
    squares: Floats
    ramps: Floats
    ramp_variance: Floats
    exponents: tuple[float, ...] = ()

    def covariance(self, power: Floats) -> Floats:
        """Return the covariance of ``avar`` under the powers, (factors, factors)."""
        p = np.maximum(power, 0.0)
        packed = np.array([p[a] * p[b] for a, b in TERM_PAIRS]) @ self.squares
        covariance = packed[_packing(len(self.m))]
        shares = self.terms * p
        noise = shares[:, : len(RANDOM_TERMS)].sum(axis=1)
        for exponent, share in zip(self.exponents, shares.T[len(RANDOM_TERMS) :]):
            growth = (1.0 + share / noise) ** (exponent / 2.0)
            covariance *= np.outer(growth, growth)
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
        )


@lru_cache(maxsize=8)
def _packing(size: int) -> Ints:
    """Return where each element of a symmetric matrix stands among its pairs i <= j."""
    at = np.empty((size, size), np.int64)
    i, j = np.triu_indices(size)
    at[i, j] = at[j, i] = np.arange(len(i))
    at.flags.writeable = False
    return at


@dataclass(frozen=True)
class _Part:
    """One kept segment, or the segments of one length class."""

    number: int
    pairs: PairSums
    geometry: RampGeometry
    at: Ints
    """Positions of its pairs i <= j among those of the pooled table."""

    @classmethod
    def of(cls, samples: int, number: int, factors: int) -> _Part:
        pairs = pair_sums(samples)
        i, j = np.triu_indices(len(pairs.m))
        at = i * factors - i * (i - 1) // 2 + (j - i)
        return cls(number, pairs, ramp_geometry(samples), at)

    def add(self, effect: RampEffect | None, terms: Floats, squares: Floats) -> None:
        """Add its expectation, (factors, 4), and pair sums, (10, pairs), to the pooled ones."""
        i, j = np.triu_indices(len(self.pairs.m))
        m = self.pairs.m.astype(float)
        plain = self.number * self.pairs.squares
        if effect is None:
            squares[:, self.at] += plain
            return
        shift = -np.sqrt(2.0) * m * effect.cross + np.outer(effect.variance, m * m / 2.0)
        terms[: len(m)] += (self.number * self.pairs.count * shift).T
        # d' = d - r m^2 has at every lag the covariance C - D; in units of 1/(2 m_i m_j) D is
        # the same for all starts when r is the best estimate, and near it for any good one.
        less = (effect.cross[:, j] * m[i] + effect.cross[:, i] * m[j]) / np.sqrt(2.0)
        less -= effect.variance[:, None] * (m[i] * m[j] / 2.0)
        number = self.pairs.count[i].astype(float) * self.pairs.count[j]
        single = self.pairs.singles
        for n, (a, b) in enumerate(TERM_PAIRS):
            twice = 2.0 if a == b else 4.0
            change = number * less[a] * less[b] - less[a] * single[b] - less[b] * single[a]
            squares[n, self.at] += plain[n] + self.number * twice * change


class Evidence:
    """All that the sums say, ready to be fitted axis by axis."""

    def __init__(self, sums: AllanSums) -> None:
        self.sums = sums
        factors = len(sums.count)
        self.m = sums.m
        self.terms = avar_terms(self.m)
        self._kept = [_Part.of(s.samples, 1, factors) for s in sums.segments]
        self._pooled_sums = sums.sum_sq.copy()
        self._pooled_terms = np.zeros((factors, len(RANDOM_TERMS)))
        self._pooled_squares = np.zeros((len(TERM_PAIRS), factors * (factors + 1) // 2))
        for length_class in sums.classes:
            self._pool(length_class, factors)

    def _pool(self, pool: LengthClass, factors: int) -> None:
        part = _Part.of(round(pool.samples / pool.count), pool.count, factors)
        weights = ols_ramp_weights(part.geometry.points, part.geometry.step)
        effect = part.geometry.effect(weights) if part.geometry.points > 2 else None
        part.add(effect, self._pooled_terms, self._pooled_squares)
        self._pooled_sums[: len(pool.ramp_correction)] += pool.ramp_correction

    @property
    def segments(self) -> Sequence[SegmentRecord]:
        """The kept segments, longest first."""
        return self.sums.segments

    def is_noiseless(self, axis: int) -> bool:
        """Return whether the samples of an axis are constant or a straight line, to rounding."""
        if not np.any(self.sums.sum_sq[:, axis] > 0.0):
            return True
        table = self.table(axis, WHITE)
        raw = self.sums.avar[np.isin(self.m, table.m), axis]
        return not np.any(table.avar > ROUNDING * raw)

    def table(self, axis: int, power: Floats, ramps: Floats | None = None) -> Table:
        """Return the table of one axis, its ramps estimated as is best under the powers.

        Parameters
        ----------
        axis : int
            Position among the axes of the sums.
        power : (4,) float64 array
            The noise that the weights of the ramps are made for.
        ramps : (segments,) float64 array, optional
            Known ramps per sample, NaN where the ramp is to be estimated.
        """
        sum_sq = self._pooled_sums[:, axis].copy()
        terms, squares = self._pooled_terms.copy(), self._pooled_squares.copy()
        found = np.zeros(len(self._kept))
        variance = np.zeros((len(self._kept), len(RANDOM_TERMS)))
        for s, (part, record) in enumerate(zip(self._kept, self.segments)):
            known = ramps is not None and np.isfinite(ramps[s])
            weights = None if known else part.geometry.best_weights(power)
            effect = None
            if ramps is not None and known:
                found[s] = ramps[s]
            elif weights is not None:
                effect = part.geometry.effect(weights)
                found[s] = weights @ record.phase[:, axis]
                variance[s] = effect.variance
            part.add(effect, terms, squares)
            m2 = part.pairs.m.astype(float) ** 2
            sum_sq[: len(m2)] += (
                -2.0 * found[s] * m2 * record.signed[:, axis]
                + part.pairs.count * (m2 * found[s]) ** 2
            )
        count = self.sums.count.astype(float)
        i, j = np.triu_indices(len(count))
        table = Table(
            self.m,
            self.sums.count,
            sum_sq / (2.0 * self.m.astype(float) ** 2 * count),
            self.terms + terms / count[:, None],
            squares / (count[i] * count[j]),
            found,
            variance,
        )
        return table.rows(_informative(table, self.terms, power))


def _informative(table: Table, whole: Floats, power: Floats) -> NDArray[np.bool_]:
    """Return which factors still vary once the ramps are out."""
    p = np.maximum(power, 0.0)
    keep = (table.count > 0) & (table.terms @ p > EMPTY_ROW * (whole @ p))
    diagonal = np.diag(table.covariance(power))
    return np.asarray(keep & (diagonal > (EMPTY_ROW * (whole @ p)) ** 2))
