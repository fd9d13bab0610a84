# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gauss-Markov processes and sinusoids as columns of an Allan table.

Both are linear in their variance and have one more parameter, their shape: a correlation time or a
frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..noise import gauss_markov_sums, sampled_gauss_markov_avar, sinusoid_avar
from .covariance import TERM_PAIRS
from .model import RANDOM_TERMS, Floats, avar_terms
from .process_covariance import process_pairs
from .table import PooledTable, Table

Q, N, B, K = range(len(RANDOM_TERMS))

LINE_PEAK = 0.371
"""f m where sin^4(pi f m)/(pi f m)^2 is largest."""

SHARED = 24
"""Correlation times per octave at which covariances are computed: 1.5 % off at most."""

SHAPE_STEP = 1.02
"""Ratio of the two shapes whose difference is the derivative of a column."""


@dataclass(frozen=True)
class GaussMarkovTerm:
    """First-order Gauss-Markov process; its shape is the correlation time in samples."""

    shape: float

    @property
    def scale(self) -> float:
        """Averaging factor at which it is largest relative to white noise."""
        return 1.89 * self.shape

    def white(self) -> float:
        """Return the variance per sample of white noise of the same long-term level."""
        return float(gauss_markov_sums(self.shape)[0][0])


@dataclass(frozen=True)
class SinusoidTerm:
    """A sinusoid of random phase; its shape is the frequency in cycles per sample."""

    shape: float

    @property
    def scale(self) -> float:
        """Averaging factor at which it is largest."""
        return LINE_PEAK / self.shape

    def white(self) -> float:
        """Return 0: it has no long-term level."""
        return 0.0


Extra = GaussMarkovTerm | SinusoidTerm


def with_extras(
    table: Table, pooled: PooledTable, extras: tuple[Extra, ...], tangents: bool = False
) -> Table:
    """Return the table with a column for each process.

    Parameters
    ----------
    table : Table
        Of the four terms.
    pooled : PooledTable
        What it is made of.
    extras : tuple of Extra
        Gauss-Markov processes before sinusoids.
    tangents : bool
        Whether to add the derivatives of these columns by the logarithm of their shapes. Free
        multiples of them make intervals of the other columns account for uncertain shapes.
    """
    if not extras:
        return table
    drifts = [e for e in extras if isinstance(e, GaussMarkovTerm)]
    columns = [table.terms, columns_of(table, extras)]
    if tangents:
        columns.append(tangents_of(table, extras))
    squares = table.squares
    if drifts:
        # Rounded shapes, so that nearby shapes share their sums.
        times = tuple(2.0 ** (round(np.log2(e.shape) * SHARED) / SHARED) for e in drifts)
        raw = pooled.process_squares(times, np.isin(pooled.m, table.m))
        ramp = _ramp_squares(table, [GaussMarkovTerm(t).white() for t in times])
        squares = np.concatenate([squares, raw + ramp])
    return replace(
        table,
        terms=np.column_stack(columns),
        squares=squares,
        noises=len(RANDOM_TERMS) + len(drifts),
        line_scatter=_line_scatter(pooled, drifts, extras[len(drifts) :]),
        line_rest=_line_rest(pooled, table, extras[len(drifts) :]),
    )


def columns_of(table: Table, extras: Sequence[Extra]) -> Floats:
    """Return the Allan variance of processes of unit variance or amplitude, (factors, processes).

    Removing the ramps takes from a Gauss-Markov process what it takes from white noise of the same
    long-term level.
    """
    drift = np.array([isinstance(e, GaussMarkovTerm) for e in extras], bool)
    shapes = np.array([e.shape for e in extras])
    out = np.empty((len(table.m), len(extras)))
    if drift.any():
        taken = avar_terms(table.m)[:, N] + table.filled - table.terms[:, N]
        white = gauss_markov_sums(shapes[drift])[0]
        out[:, drift] = sampled_gauss_markov_avar(table.m, shapes[drift]) - np.outer(taken, white)
    if not drift.all():
        out[:, ~drift] = sinusoid_avar(table.m[:, None], shapes[~drift])
    return out


def tangents_of(table: Table, extras: Sequence[Extra]) -> Floats:
    """Return the derivatives of the columns by the logarithms of their shapes."""
    half = SHAPE_STEP**0.5
    above, below = (
        columns_of(table, [replace(e, shape=e.shape * factor) for e in extras])
        for factor in (half, 1.0 / half)
    )
    return np.asarray((above - below) / np.log(SHAPE_STEP))


def _line_scatter(
    pooled: PooledTable, drifts: Sequence[GaussMarkovTerm], lines: Sequence[Extra]
) -> Floats:
    """Return the variances of squared amplitudes for `Table.line_scatter`.

    Noise of the two-sided density S adds 8 A^2 S / n to the variance of the squared amplitude of a
    sinusoid of n samples.
    """
    samples = float(pooled.sums.samples)
    rows = []
    for line in lines:
        omega = 2.0 * np.pi * line.shape
        step = (2.0 * np.sin(omega / 2.0)) ** 2
        density = [step, 1.0, 1.0 / omega, 1.0 / step]
        for drift in drifts:
            keep = np.exp(-1.0 / drift.shape)
            lost = -np.expm1(-1.0 / drift.shape)
            # (1 - keep^2) / (1 - 2 keep cos(omega) + keep^2) without the loss of digits
            density.append(lost * (1.0 + keep) / (lost**2 + keep * step))
        rows.append(8.0 / samples * np.array(density))
    return np.array(rows).reshape(len(lines), len(RANDOM_TERMS) + len(drifts))


def _line_rest(pooled: PooledTable, table: Table, lines: Sequence[Extra]) -> Floats:
    """Return `Table.line_rest`.

    Differences at every s-th start also hold the noise at the aliases of the sinusoid. With C
    differences l_j of the sinusoid and d_j of white noise, the variance of mean(l d) is
    E[l^2]/C sum_k (1 - |k|/C) cos(omega s k) R_d(s k). The mean of l^2 itself depends on the phase
    by 1/(C sin(omega s)), or entirely where each start meets the same phase.
    """
    out = np.zeros((2, len(lines), len(table.m)))
    stride = pooled.sums.stride[np.isin(pooled.m, table.m)]
    column = columns_of(table, lines).T if lines else out[0]
    omega = 2.0 * np.pi * np.array([line.shape for line in lines])
    for n, (m, s, count) in enumerate(zip(table.m, stride, table.count)):
        lag = np.arange(min((2 * m - 1) // s + 1, count))
        h = (lag * s)[:, None] + np.array([0, -m, m])
        overlap = np.maximum(m - np.abs(h), 0) @ np.array([2.0, -1.0, -1.0]) / float(m) ** 2
        weight = np.where(lag > 0, 2.0, 1.0) * (1.0 - lag / count) * overlap
        level = 2.0 / count * (np.cos(np.outer(omega, lag * s)) @ weight)
        level -= 8.0 / pooled.sums.samples * column[:, n]
        out[0, :, n] = column[:, n] * np.maximum(level, 0.0)
        swing = count * np.abs(np.sin(omega * s))
        share = np.minimum(1.0, len(pooled.segments) / np.maximum(swing, 1e-9) ** 2 / 2.0)
        out[1, :, n] = column[:, n] ** 2 / 2.0 * share
    return out


def _ramp_squares(table: Table, white: Sequence[float]) -> Floats:
    """Return what removing the ramps does to products with processes of those white levels."""
    four = len(RANDOM_TERMS)
    of_white = {b if a == N else a: n for n, (a, b) in enumerate(TERM_PAIRS) if N in (a, b)}
    rows = []
    for a, b in process_pairs(len(white)):
        # `squares` counts products of two different noises twice, but w w once.
        factor = white[b - four]
        if a == N:
            factor *= 2.0
        elif a >= four:
            factor *= white[a - four] * (1.0 if a == b else 2.0)
        rows.append(factor * table.ramp_squares[of_white[N if a >= four else a]])
    return np.array(rows)
