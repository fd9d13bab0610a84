# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Iteratively reweighted generalized least squares on a table of Allan variances.

The covariance of the Allan variances depends on the coefficients. The solver therefore alternates:
it computes the covariance from the coefficients, and the coefficients with that covariance
(Davidian & Carroll, JASA 82 (1987)). Maximizing the likelihood over the coefficients inside the
covariance as well would be biased.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..deferred import lapack
from ..errors import AllanError
from .model import RANDOM_TERMS, Floats, K, N, Q
from .processes import Process, correlation_times
from .ramp import Noise
from .table import EMPTY_ROW, PooledTable, Table

RIDGE = 1e-12
"""Added to the diagonal of the normal equations of columns of norm 1. With too few points, the
result is then a wide interval instead of a singular matrix."""


def nonnegative_least_squares(
    columns: Floats, target: Floats, signed: Sequence[int] = ()
) -> Floats:
    """Return x >= 0 that minimizes |columns x - target|, (columns,).

    Elements of x at the indices ``signed`` may be negative. The columns may have any scale.
    """
    # The active set is guessed from the signs of the unconstrained solution, which is usually
    # correct. Otherwise the method of Lawson & Hanson (Solving Least Squares Problems, 1974, ch.
    # 23) finds it. `scipy.optimize.nnls` is not used, because its import takes longer than all fits
    # of an IMU.
    scale = np.sqrt(np.einsum('ij,ij->j', columns, columns))
    scale[scale == 0.0] = 1.0
    scaled = columns / scale
    gram = scaled.T @ scaled
    gram.flat[:: len(scale) + 1] += RIDGE
    moment = scaled.T @ target
    bound = np.ones(len(scale), bool)
    bound[list(signed)] = False

    def unconstrained(active: NDArray[np.bool_]) -> Floats:
        out = np.zeros(len(scale))
        at = np.flatnonzero(active)
        if len(at):
            out[at] = lapack.dposv(gram[at[:, None], at], moment[at])[1]
        return out

    active = np.ones(len(scale), bool)
    for _ in range(NNLS_GUESSES):
        x = unconstrained(active)
        gain = moment - gram @ x > NNLS_TOLERANCE * np.abs(moment)
        wrong = np.where(active, bound & (x < 0.0), gain)
        if not wrong.any():
            return np.asarray(x / scale)
        active ^= wrong
    active = ~bound
    x = unconstrained(active)
    for _ in range(NNLS_ROUNDS * len(scale)):
        slope = np.where(active, -np.inf, moment - gram @ x)
        enter = int(np.argmax(slope))
        if slope[enter] <= NNLS_TOLERANCE * abs(moment[enter]):
            break
        active[enter] = True
        while True:
            wanted = unconstrained(active)
            below = active & bound & (wanted <= 0.0)
            if not below.any():
                break
            # Move from x toward the solution until the first coefficient becomes 0.
            step = np.min(x[below] / (x[below] - wanted[below]))
            x = x + step * (wanted - x)
            active &= ~(bound & (x <= NNLS_TOLERANCE * np.max(np.abs(x))))
            x[~active] = 0.0
            if not active.any():
                break
        x = unconstrained(active)
    return np.asarray(x / scale)


NNLS_GUESSES = 5
"""Number of attempts to guess the active set."""

NNLS_ROUNDS = 3
"""Largest number of iterations of the method of Lawson & Hanson, per column."""

NNLS_TOLERANCE = 1e-10
"""Relative size below which a gradient or a coefficient is a rounding error."""

JITTER = 1e-4
"""Added to the diagonal of the correlation matrix of the table before its Cholesky decomposition.
Neighboring averaging factors are nearly identical, and the covariance is only accurate to about
this value."""

TOLERANCE = 1e-3
"""Relative change of the modeled Allan variance below which the iteration stops. The covariance
depends on this variance, and its error changes the coefficients only in second order."""

ROUNDS = 12
"""Largest number of iterations of a fit; two to five are usual."""

LONGEST_STEP = 9.0
"""Largest extrapolation of an iteration, relative to the change since the previous one."""

NOISE_FLOOR = 1e-6
"""Smallest white noise in the covariance, relative to the smallest that affects the table."""


@dataclass(frozen=True)
class Misfit:
    """Relative model error: ``size`` at averaging factors from ``m_min`` on, 0 below.

    It is added to the covariance of the Allan variances as (size * model)^2 on the diagonal.
    """

    size: float = 0.0
    m_min: int = 1

    def at(self, m: NDArray[np.int64]) -> Floats:
        """Return the relative model error at the averaging factors m, (factors,)."""
        return np.where(m >= self.m_min, self.size, 0.0)


NO_MISFIT = Misfit()


def initial_variances(table: Table) -> Floats:
    """Return a first estimate of q, w, b, k by nonnegative weighted least squares, (4,)."""
    # Residuals are relative, with the weights 1/sqrt(m).
    weight = np.sqrt(1.0 / table.m) / np.where(table.avar > 0.0, table.avar, np.inf)
    terms = table.terms[:, : len(RANDOM_TERMS)]
    return nonnegative_least_squares(terms * weight[:, None], table.avar * weight)


@dataclass(frozen=True)
class Whitening:
    """Linear transformation that gives correlated Allan variances unit covariance.

    The covariance is D L L' D with the standard deviations D (``deviation``) and the Cholesky
    factor L (``lower``) of the correlation matrix.
    """

    lower: Floats
    deviation: Floats

    @classmethod
    def of(cls, covariance: Floats) -> Whitening:
        """Return the whitening of a covariance; `JITTER` is added to its correlation for stability.

        A slightly indefinite matrix is replaced by the nearest positive semidefinite one (Higham,
        LAA 103, 1988).

        Raises
        ------
        AllanError
            If the matrix contains NaN or is far from a covariance.
        """
        deviation = np.sqrt(np.diag(covariance))
        correlation = covariance / deviation / deviation[:, None]
        # For matrices with NaN, LAPACK returns NaN or an error code.
        if np.isfinite(correlation).all():
            lower = _cholesky(correlation)
            if lower is None:
                values, vectors = np.linalg.eigh(correlation)
                lower = _cholesky((vectors * np.maximum(values, 0.0)) @ vectors.T)
            if lower is not None:
                return cls(lower, deviation)
        raise AllanError(
            'no noise model can be computed for these sums: their values are damaged or span too '
            'large a range; accumulate them again'
        )

    def apply(self, columns: Floats) -> Floats:
        """Return columns multiplied by L^-1 D^-1, so that their errors are uncorrelated."""
        return np.asarray(lapack.dtrtrs(self.lower, columns / self.deviation[:, None], lower=1)[0])

    def weights(self, contrast: Floats) -> Floats:
        """Convert weights of the whitened values to the same combination of original values."""
        return np.asarray(lapack.dtrtrs(self.lower, contrast, lower=1, trans=1)[0] / self.deviation)

    def covariance_with(self, contrast: Floats) -> Floats:
        """Return the covariance of each value with a linear combination of whitened values."""
        return np.asarray(self.lower @ contrast * self.deviation)


def _cholesky(correlation: Floats) -> Floats | None:
    """Return the Cholesky factor of the matrix plus `JITTER` times I; None if there is none."""
    jittered = correlation.copy()
    jittered.flat[:: len(correlation) + 1] += JITTER
    lower, info = lapack.dpotrf(jittered, lower=1)
    return None if info else np.asarray(lower, float)


class Solution(NamedTuple):
    """Fitted variance coefficients, and the whitening of the last iteration.

    ``white`` contains the whitened columns of the table and, last, its whitened Allan variances,
    (factors, terms + 1).
    """

    variances: Floats
    whitening: Whitening
    white: Floats


def solve(
    table: Table,
    variances: Floats,
    *,
    fixed: Mapping[int, float] | None = None,
    columns: Sequence[int] | None = None,
    signed: bool = False,
    misfit: Misfit = NO_MISFIT,
) -> Solution:
    """Fit variance coefficients to Allan variances by iterated generalized least squares.

    Parameters
    ----------
    table : Table
        Allan variances, and their expectation and covariance per unit coefficient.
    variances : (terms,) float64 array
        Initial coefficients.
    fixed : mapping of column to coefficient, optional
        Columns whose coefficient is fixed.
    columns : sequence of int, optional
        Columns whose coefficient may differ from 0; all by default.
    signed : bool
        Whether q may be negative (the effect of a low-pass filter).
    misfit : Misfit
        Relative model error that is added to the covariance.
    """
    known = dict(fixed or {})
    size = table.terms.shape[1]
    columns = range(size) if columns is None else columns
    free = [c for c in columns if c not in known]
    tangents = range(table.noises + table.lines, size)
    negative = [i for i, c in enumerate(free) if (c == Q and signed) or c in tangents]
    new = np.zeros(size)
    for c, value in known.items():
        new[c] = value
    now = new.copy()
    now[free] = variances[free]
    both = np.column_stack([table.terms, table.avar])
    floor = noise_floor(table)
    before = table.terms @ with_noise_floor(table, now, floor)
    last: tuple[Floats, Floats] | None = None
    for _ in range(ROUNDS):
        whitening = Whitening.of(covariance_at(table, now, misfit, floor))
        white = whitening.apply(both)
        target = white[:, -1]
        for c, value in known.items():
            target = target - value * white[:, c]
        new = new.copy()
        new[free] = nonnegative_least_squares(white[:, free], target, negative)
        # Only the modeled variance must converge: it determines the covariance, while the
        # coefficients of two similar terms may still change.
        change = table.terms @ with_noise_floor(table, new, floor) / before - 1.0
        if np.all(np.abs(change) <= TOLERANCE):
            break
        now = new
        if last is not None:
            # Extrapolation for slow convergence or oscillation: Anderson (JACM 12, 1965).
            turn = change - last[1]
            share = float(change @ turn) / max(float(turn @ turn), np.finfo(float).tiny)
            now = new - np.clip(share, -LONGEST_STEP, 1.0) * (new - last[0])
        last = new, change
        before = table.terms @ with_noise_floor(table, now, floor)
    return Solution(new, whitening, white)


def noise_floor(table: Table) -> float:
    """Return a white noise coefficient w that has a negligible effect on the Allan variances."""
    positive = table.avar > 0.0
    return NOISE_FLOOR * float(np.min((table.avar * table.m)[positive])) if positive.any() else 1.0


def with_noise_floor(table: Table, variances: Floats, floor: float | None = None) -> Floats:
    """Return coefficients for which the covariance of the Allan variances is not singular.

    Negative coefficients are set to 0, and the white noise w to at least ``floor`` (by default a
    negligible value).
    """
    p = np.maximum(variances, 0.0)
    p[table.noises + table.lines :] = 0.0  # columns that are derivatives
    p[N] = max(p[N], noise_floor(table) if floor is None else floor)
    return p


def covariance_at(
    table: Table, variances: Floats, misfit: Misfit = NO_MISFIT, floor: float | None = None
) -> Floats:
    """Return the covariance of the Allan variances for given coefficients, (factors, factors).

    It includes the relative model error ``misfit``. The coefficients are first limited by
    `with_noise_floor`.
    """
    p = with_noise_floor(table, variances, floor)
    covariance = table.covariance(p)
    square = (table.terms @ p) ** 2
    diagonal = covariance.reshape(-1)[:: len(square) + 1]
    np.maximum(diagonal, EMPTY_ROW * square, out=diagonal)
    if misfit.size:
        diagonal += misfit.at(table.m) ** 2 * square
    return covariance


RAMP_ROUNDS = 4
"""Largest number of iterations between ramps and coefficients; two or three are usual."""

RAMP_TOLERANCE = 1e-2
"""Relative change of the coefficients whose effect on the ramps is negligible."""


@dataclass(frozen=True)
class FitOptions:
    """Settings of the fit of one axis: range of averaging factors, constraints, processes.

    Attributes
    ----------
    m_min : int
        Smallest averaging factor that is used.
    signed : bool
        Whether q (quantization) may be negative, the effect of a low-pass filter.
    misfit : Misfit
        Relative model error that is added to the covariance.
    extras : tuple of Process
        Processes in addition to the five terms, Gauss-Markov processes before sinusoids.
    walk : bool
        Whether k (random walk) may differ from 0.
    """

    m_min: int = 1
    signed: bool = False
    misfit: Misfit = NO_MISFIT
    extras: tuple[Process, ...] = ()
    walk: bool = True

    def table(
        self,
        pooled: PooledTable,
        axis: int,
        noise: Noise,
        ramps: Floats | None = None,
        tangents: bool = False,
    ) -> Table:
        """Return the `Table` of an axis with the processes and averaging factors of these options.

        ``noise`` is the noise model that determines the weights of the ramp estimates. ``ramps``
        contains known ramps per sample, NaN for those to be estimated. ``tangents`` adds the
        derivatives of the process columns with respect to log correlation time or log frequency.
        """
        return pooled.table(axis, noise, ramps, self.extras, self.m_min, tangents)

    @property
    def columns(self) -> tuple[int, ...]:
        """Indices of the coefficients that may differ from 0."""
        every = range(len(RANDOM_TERMS) + len(self.extras))
        return tuple(c for c in every if self.walk or c != K)

    def noise(self, variances: Floats) -> Noise:
        """Return the random noise of the model (no sinusoids), with negative coefficients as 0."""
        times = correlation_times(self.extras)
        return Noise(np.maximum(variances[: len(RANDOM_TERMS) + len(times)], 0.0), times)


@dataclass(frozen=True)
class PointFit:
    """Fitted variance coefficients of one axis, with the Allan variances and options of the fit."""

    variances: Floats
    table: Table
    options: FitOptions = field(default_factory=FitOptions)

    @property
    def ramp_variance(self) -> Floats:
        """Variance of the linear drift of each segment, (segments,); 0 if it is not estimated."""
        return np.asarray(self.table.ramp_variance @ self.options.noise(self.variances).variances)


def point_fit(
    pooled: PooledTable,
    axis: int,
    options: FitOptions = FitOptions(),
    variances: Floats | None = None,
) -> PointFit:
    """Fit one axis, alternating between the linear drifts (ramps) and the coefficients.

    ``axis`` is the position among the axes of the sums. ``variances`` are initial coefficients;
    missing ones of processes are 0.
    """
    if variances is None:
        variances = initial_variances(pooled.table(axis))
    variances = np.concatenate(
        [variances, np.zeros(len(RANDOM_TERMS) + len(options.extras) - len(variances))]
    )
    table = options.table(pooled, axis, options.noise(variances))
    for _ in range(RAMP_ROUNDS):
        solution = solve(
            table, variances, columns=options.columns, signed=options.signed, misfit=options.misfit
        )
        new = solution.variances
        settled = np.all(np.abs(new - variances) <= RAMP_TOLERANCE * np.abs(variances))
        variances = new
        if settled:
            break
        table = options.table(pooled, axis, options.noise(variances))
    return PointFit(variances, table, options)
