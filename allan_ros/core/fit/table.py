# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Allan variances of all segments without ramps, with their expectation and covariance.

Segments are independent, so their sums are added: V = sum M_s V_s / sum M_s with the covariance
C = sum (M_s/M)^2 C_s, where M_s is the number of differences of segment s. Each segment has its own
ramp, which is removed from every difference. The estimate of the ramp is linear in the phase, with
weights that are fixed before the table is fitted. Expectation and covariance therefore remain exact
(module `ramp`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from ..allan.sums import AllanSums, SegmentRecord, allan_variance
from ..noise import sampled_gauss_markov_avar, sinusoid_avar
from .covariance import TERM_PAIRS, PairSums, clear_pair_sums, interpolation_excess, pair_sums
from .model import RANDOM_TERMS, Floats, Ints, N, avar_terms
from .processes import (
    GaussMarkovTerm,
    Process,
    amplitude_variance,
    correlation_times,
    independent_variance,
    process_pairs,
    process_squares,
)
from .ramp import (
    Noise,
    ProcessShift,
    RampEffect,
    RampGeometry,
    least_squares_effect,
    mean_covariances,
    pooled_shift,
    ramp_geometry,
)

ROUNDING = 1e-12
"""Fraction of the variance below which the remainder after removal of the ramp is a rounding
error."""

EMPTY_ROW = 1e-6
"""An averaging factor is left out if the removal of the ramp leaves less than this fraction of its
variance. In a record of two differences, for example, the ramp describes almost everything."""

KEPT_PROCESS_SQUARES = 16
"""Number of sets of correlation times whose covariance is cached."""

SHARED = 24
"""Number of correlation times per octave for which covariances are computed; others are rounded by
at most 1.5 %."""

SHAPE_STEP = 1.02
"""Ratio of the two shapes of the difference quotient for the derivative of a column."""


@dataclass(frozen=True)
class Table:
    """Allan variances of one axis, and their expectation and covariance under the noise model.

    Attributes
    ----------
    m, count : (factors,) int64 arrays
        Averaging factors and numbers of differences.
    avar : (factors,) float64 array
        Allan variance of the samples without the ramps.
    terms : (factors, columns) float64 array
        Expectation per unit q, w, b, k, and per unit variance of each added process. Derivatives
        with respect to log correlation times and log frequencies may follow.
    squares : (products, pairs) float64 array
        Covariance per product of two coefficients (`TERM_PAIRS`, `process_pairs`), at pairs of
        factors i <= j.
    ramps : (segments,) float64 array
        Ramp per sample that was removed from each kept segment; 0 if none could be estimated.
    ramp_variance : (segments, noises) float64 array
        Variance of the estimated ramps per unit coefficient.
    noises : int
        Number of columns of random noise: the four terms and Gauss-Markov processes.
    amplitude_variance : (sinusoids, noises) float64 array
        Variance of the squared amplitude of each sinusoid, relative to the squared amplitude, per
        unit of each noise coefficient. The columns of sinusoids follow those of random noise.
    independent_variance : (2, sinusoids, factors) float64 array
        Part of the variance of ``avar`` due to sinusoids that is uncorrelated between factors: per
        A^2 w and per A^4, for the amplitude A.
    process_shift : callable or None
        Returns the change of the columns of Gauss-Markov processes due to the removal of ramps, for
        averaging factors and correlation times, (factors, processes); None for no change.
    """

    m: Ints
    count: Ints
    avar: Floats
    terms: Floats
    squares: Floats
    ramps: Floats = field(default_factory=lambda: np.zeros(0))
    ramp_variance: Floats = field(default_factory=lambda: np.zeros((0, len(RANDOM_TERMS))))
    noises: int = len(RANDOM_TERMS)
    amplitude_variance: Floats = field(default_factory=lambda: np.zeros((0, len(RANDOM_TERMS))))
    independent_variance: Floats = field(default_factory=lambda: np.zeros((2, 0, 0)))
    process_shift: Callable[[Ints, Floats], Floats] | None = None

    @property
    def lines(self) -> int:
        """Number of sinusoids."""
        return len(self.amplitude_variance)

    def columns(self, extras: Sequence[Process]) -> Floats:
        """Return the expected Allan variances of processes of unit size, (factors, processes)."""
        drift = np.array([isinstance(e, GaussMarkovTerm) for e in extras], bool)
        shapes = np.array([e.shape for e in extras])
        out = np.empty((len(self.m), len(extras)))
        if drift.any():
            out[:, drift] = sampled_gauss_markov_avar(self.m, shapes[drift])
            if self.process_shift is not None:
                out[:, drift] += self.process_shift(self.m, shapes[drift])
        if not drift.all():
            out[:, ~drift] = sinusoid_avar(self.m[:, None], shapes[~drift])
        return out

    def tangents(self, extras: Sequence[Process]) -> Floats:
        """Return the derivatives of `columns` with respect to log correlation time or frequency."""
        half = SHAPE_STEP**0.5
        above, below = (
            self.columns([replace(e, shape=e.shape * factor) for e in extras])
            for factor in (half, 1.0 / half)
        )
        return np.asarray((above - below) / np.log(SHAPE_STEP))

    def covariance(self, variances: Floats) -> Floats:
        """Return the covariance of the Allan variances for given coefficients."""
        # Noise at the frequency of a sinusoid changes the amplitude of the sinusoid
        # (``amplitude_variance``). If the differences do not start at every sample, noise at its
        # aliases contributes as well (``independent_variance``).
        p = np.maximum(variances, 0.0)
        a, b = _coefficient_indices(self.noises - len(RANDOM_TERMS))
        covariance = ((p[a] * p[b]) @ self.squares)[_pair_positions(len(self.m))]
        for k, scatter in enumerate(self.amplitude_variance, start=self.noises):
            column = self.terms[:, k]
            covariance += p[k] * (scatter @ p[: self.noises]) * np.outer(column, column)
            of_noise, of_itself = self.independent_variance[:, k - self.noises]
            covariance[np.diag_indices_from(covariance)] += p[k] * (
                p[N] * of_noise + p[k] * of_itself
            )
        return np.asarray(covariance)

    def rows(self, keep: NDArray[np.bool_]) -> Table:
        """Return the same table with only the averaging factors where ``keep`` is True."""
        i, j = np.triu_indices(len(self.m))
        return replace(
            self,
            m=self.m[keep],
            count=self.count[keep],
            avar=self.avar[keep],
            terms=self.terms[keep],
            squares=self.squares[:, keep[i] & keep[j]],
            independent_variance=self.independent_variance[:, :, keep]
            if self.lines
            else self.independent_variance,
        )


@lru_cache(maxsize=8)
def _pair_positions(size: int) -> Ints:
    """Return the index of each element of a symmetric matrix in its packed upper triangle."""
    at = np.empty((size, size), np.int64)
    i, j = np.triu_indices(size)
    at[i, j] = at[j, i] = np.arange(len(i))
    at.flags.writeable = False
    return at


@lru_cache(maxsize=8)
def _coefficient_indices(processes: int) -> tuple[Ints, Ints]:
    """Return the indices of the two coefficients of each row of `Table.squares`."""
    a, b = np.array((*TERM_PAIRS, *process_pairs(processes))).T
    return a, b


@dataclass(frozen=True)
class _SegmentGroup:
    """One separately stored segment, or several pooled segments of similar length.

    Attributes
    ----------
    number : int
        Number of segments.
    pairs : PairSums
        Covariance of the Allan sums of one segment.
    geometry : RampGeometry
        Covariances for the ramp estimate of one segment.
    at : (pairs,) int64 array
        Columns of `Table.squares` that correspond to the columns of ``pairs.squares``.
    """

    number: int
    pairs: PairSums
    geometry: RampGeometry
    at: Ints

    @classmethod
    def of(cls, samples: int, number: int, factors: int, step: int = 0) -> _SegmentGroup:
        pairs = pair_sums(samples)
        i, j = np.triu_indices(len(pairs.m))
        at = i * factors - i * (i - 1) // 2 + (j - i)
        return cls(number, pairs, ramp_geometry(samples, step), at)

    def ramp_squares(self, effect: RampEffect, times: Sequence[float]) -> Floats:
        """Return the change of the covariance sums due to removed ramps, (products, pairs)."""
        # The difference d - r m^2 has the covariance C - D at every lag. In units of 1/(2 m_i m_j),
        # D is the same for all starts if r is the best estimate, and nearly the same for any good
        # estimate.
        i, j = np.triu_indices(len(self.pairs.m))
        m = self.pairs.m.astype(float)
        number = self.pairs.count[i].astype(float) * self.pairs.count[j]
        processes = [mean_covariances(self.pairs.samples, time) for time in times]
        mean = np.stack([*(self.pairs.singles / number), *processes])
        removed = (effect.cross[:, j] * m[i] + effect.cross[:, i] * m[j]) / np.sqrt(2.0)
        reduced = removed - effect.variance[:, None] * (m[i] * m[j] / 2.0) - mean
        a, b = _coefficient_indices(len(times))
        twice = np.where(a == b, 2.0, 4.0)[:, None]
        change = reduced[a] * reduced[b] - mean[a] * mean[b]
        return np.asarray(self.number * twice * number * change)


class PooledTable:
    """Combined data of all segments, from which the `Table` of each axis is computed."""

    def __init__(self, sums: AllanSums) -> None:
        self.sums = sums
        factors = len(sums.count)
        self.m = sums.m
        self.terms = avar_terms(self.m)
        self._kept = [_SegmentGroup.of(s.samples, 1, factors, s.phase_step) for s in sums.segments]
        self._pooled = [
            _SegmentGroup.of(round(c.samples / c.count), c.count, factors) for c in sums.classes
        ]
        self._filled = interpolation_excess(self.m, sums.filled, max(sums.samples, 1))
        i, j = np.triu_indices(factors)
        self._pair_counts = sums.count[i].astype(float) * sums.count[j]
        squares = np.zeros((len(TERM_PAIRS), len(i)))
        for part in (*self._kept, *self._pooled):
            squares[:, part.at] += part.number * part.pairs.squares
        self._squares: dict[tuple[float, ...], Floats] = {}
        self._squares[()] = self._with_pooled_ramps(squares, ())
        self._pooled_sums = sums.sum_sq.copy()
        for pool in sums.classes:
            self._pooled_sums[: len(pool.ramp_correction)] += pool.ramp_correction
        self._pooled_count = sums.count.copy()
        for part in self._kept:
            self._pooled_count[: len(part.pairs.m)] -= part.pairs.count
        # without self: a reference cycle would keep the tables in memory until a garbage collection
        shift = partial(pooled_shift, sums.classes, self.m, sums.stride, self._pooled_count)
        self._pooled_terms = shift(())
        longest = max((s.samples for s in self.segments), default=1)
        self._pooled_drifts = ProcessShift(longest, lambda t: shift(t)[:, 4:])

    def _with_pooled_ramps(self, squares: Floats, times: tuple[float, ...]) -> Floats:
        """Add the effect of the removed ramps of pooled segments to ``squares`` and return it."""
        for part in self._pooled:
            effect = least_squares_effect(part.pairs.samples, times)
            if effect is not None:
                squares[:, part.at] += part.ramp_squares(effect, times)[-len(squares) :]
        return squares

    @property
    def segments(self) -> Sequence[SegmentRecord]:
        """The segments that are stored separately, longest first."""
        return self.sums.segments

    def is_noiseless(self, axis: int) -> bool:
        """Return whether the samples of an axis are constant or a straight line, up to rounding."""
        if not np.any(self.sums.avar[:, axis] > 0.0):
            return True
        table = self.table(axis)
        raw = self.sums.avar[np.isin(self.m, table.m), axis]
        return not np.any(table.avar > ROUNDING * raw)

    def ramps(
        self, axis: int, noise: Noise, known: Floats | None = None
    ) -> tuple[Floats, list[Floats | None]]:
        """Return the linear drift per sample of each segment, and the weights that estimate it.

        The estimate is ``weights @ phase``, with the least variance for the given noise. Drifts in
        ``known`` that are not NaN are returned unchanged, with None as weights.
        """
        known = np.full(len(self._kept), np.nan) if known is None else known
        found = np.where(np.isfinite(known), known, 0.0)
        every: list[Floats | None] = []
        for s, (part, record) in enumerate(zip(self._kept, self.segments)):
            weights = None if np.isfinite(known[s]) else part.geometry.best_weights(noise)
            every.append(weights)
            if weights is not None:
                found[s] = weights @ record.phase[:, axis]
        return found, every

    def ramp_variance(
        self, weights: Sequence[Floats | None], times: Sequence[float] | Floats
    ) -> Floats:
        """Return the variance of the estimated linear drift of each segment, (segments, noises).

        It is per unit coefficient, and 0 if the drift is known or cannot be estimated. ``weights``
        are those of `ramps`, ``times`` are correlation times of processes in samples.
        """
        out = np.zeros((len(weights), len(RANDOM_TERMS) + len(times)))
        for s, (part, w) in enumerate(zip(self._kept, weights)):
            if w is not None:
                out[s] = part.geometry.variance(w, times)
        return out

    def _ramp_effects(
        self, weights: Sequence[Floats | None], times: Sequence[float] | Floats
    ) -> list[tuple[_SegmentGroup, RampEffect]]:
        """Return the segments whose ramp is estimated, each with its `RampEffect`."""
        return [
            (part, part.geometry.effect(w, times))
            for part, w in zip(self._kept, weights)
            if w is not None
        ]

    def table(
        self,
        axis: int,
        noise: Noise = Noise(),
        ramps: Floats | None = None,
        extras: Sequence[Process] = (),
        m_min: int = 1,
        tangents: bool = False,
    ) -> Table:
        """Return the `Table` of one axis, with the linear drifts removed.

        Parameters
        ----------
        axis : int
            Position among the axes of the sums.
        noise : Noise
            Noise model for the weights of the ramps. Noise of 0, which occurs if a sinusoid
            describes the complete curve, is replaced by white noise.
        ramps : (segments,) float64 array, optional
            Known ramps per sample, NaN where the ramp is to be estimated.
        extras : sequence of Process
            Processes whose columns are added, Gauss-Markov processes before sinusoids.
        m_min : int
            Smallest averaging factor.
        tangents : bool
            Whether to add the derivatives of the columns of processes with respect to log
            correlation time or log frequency.
        """
        noise = noise if np.any(noise.variances > 0.0) else Noise()
        found, weights = self.ramps(axis, noise, ramps)
        times = correlation_times(extras)
        # Rounded, so that similar correlation times share their sums.
        near = tuple(2.0 ** (round(np.log2(t) * SHARED) / SHARED) for t in times)
        squares = self._process_squares(near).copy()
        for part, effect in self._ramp_effects(weights, near):
            squares[:, part.at] += part.ramp_squares(effect, near)
        sum_sq = self._pooled_sums[:, axis].copy()
        for part, record, r in zip(self._kept, self.segments, found):
            m2 = part.pairs.m.astype(float) ** 2
            signed = record.signed[:, axis]
            sum_sq[: len(m2)] += -2.0 * r * m2 * signed + part.pairs.count * (m2 * r) ** 2
        count = self.sums.count[:, None]
        terms = self.terms + (self._pooled_terms + self._stored_segment_shift(weights, ())) / count
        if self.sums.filled.any():
            terms[:, N] += self._filled[:, axis]

        def shift(times: Floats) -> Floats:
            added = self._pooled_drifts(times) if self._pooled else 0.0
            return np.asarray((added + self._stored_segment_shift(weights, times)[:, 4:]) / count)

        smooth = ProcessShift(self.sums.segments[0].samples if self.segments else 1, shift)
        table = Table(
            self.m,
            self.sums.count,
            allan_variance(sum_sq[:, None], self.m, self.sums.count)[:, 0],
            terms,
            squares / self._pair_counts,
            found,
            self.ramp_variance(weights, times),
            len(RANDOM_TERMS) + len(times),
            process_shift=lambda m, t: smooth(t)[np.searchsorted(self.m, m)],
        )
        table = table.rows(
            (self.m >= m_min) & _has_information(table, self.terms, noise.without_processes())
        )
        if not extras:
            return table
        exact = replace(table, process_shift=lambda m, t: shift(t)[np.searchsorted(self.m, m)])
        columns = [table.terms, exact.columns(extras)]
        if tangents:
            columns.append(exact.tangents(extras))
        lines = extras[len(times) :]
        samples, stride = self.sums.samples, self.sums.stride[np.isin(self.m, table.m)]
        return replace(
            table,
            terms=np.column_stack(columns),
            amplitude_variance=amplitude_variance(samples, times, lines),
            independent_variance=independent_variance(
                table.m, stride, table.count, samples, len(self.segments), lines
            ),
        )

    def _stored_segment_shift(
        self, weights: Sequence[Floats | None], times: Sequence[float] | Floats
    ) -> Floats:
        """Return the change of Allan sums due to ramps removed from stored segments."""
        out = np.zeros((len(self.m), len(RANDOM_TERMS) + len(times)))
        for part, effect in self._ramp_effects(weights, times):
            m, count = part.pairs.m, part.pairs.count
            out[: len(m)] += part.number * count[:, None] * effect.shift(m)
        return out

    def _process_squares(self, times: tuple[float, ...]) -> Floats:
        """Return the covariance sums with the given processes, (products, pairs)."""
        # They do not yet include the removal of ramps from separately stored segments.
        if times not in self._squares:
            while len(self._squares) > KEPT_PROCESS_SQUARES:
                del self._squares[list(self._squares)[1]]
            lengths = [(float(n), count) for n, count in self.sums.length_histogram]
            added = process_squares(self.m, self.sums.stride, lengths, times)
            self._squares[times] = self._with_pooled_ramps(added, times)
        four = self._squares[()]
        return np.concatenate([four, self._squares[times]]) if times else four


def clear_cache() -> None:
    """Free the cached covariances (about 20 MB); later fits compute them again in 0.2 s."""
    clear_pair_sums()
    ramp_geometry.cache_clear()
    mean_covariances.cache_clear()


def _has_information(table: Table, complete: Floats, variances: Floats) -> NDArray[np.bool_]:
    """Return a mask of averaging factors that keep variance after the removal of ramps."""
    p = np.zeros(table.noises)
    p[: len(variances)] = np.maximum(variances, 0.0)
    keep = (table.count > 0) & (
        table.terms @ p[: len(variances)] > EMPTY_ROW * (complete @ variances)
    )
    diagonal = np.diag(table.covariance(p))
    return np.asarray(keep & (diagonal > (EMPTY_ROW * (complete @ variances)) ** 2))
