# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goodness of a fit, and the model error if the terms do not describe the table."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..deferred import special
from .gls_solver import (
    JITTER,
    NO_MISFIT,
    K,
    Misfit,
    N,
    PointFit,
    Whitening,
    point_fit,
    solve,
    weights_at,
)
from .intervals import coefficient_interval, standard_errors
from .model import RANDOM_TERMS, Floats
from .processes import GaussMarkovTerm
from .table import PooledTable, Table

Z_FAIL = 3.0
"""Normal deviate above which the model is rejected; by chance, one table in several hundred exceeds
it."""

Z_LOOK = 1.0

Z_HOPELESS = 50.0
"""A table with this deviation is not tested again with another walk."""

DEFICIT_FALSE_ALARM = 1e-3
"""Probability that the long averages of noise of the model are classified as too low."""

DEFICIT_LIMIT = -3.090232306167813
"""Normal deviate below the model at which long averages are significantly too low: the quantile of
`DEFICIT_FALSE_ALARM`."""

POINTS_PER_TEST = 8.0
"""Neighbouring long averages are correlated: this number counts as one independent test."""

FEW_AVERAGES = 60.0
"""Degrees of freedom below which an Allan variance is too skewed for chi^2. Such a variance cannot
be many standard errors below the model, however unlikely it is."""

MISFIT_LIMIT = 10.0
"""Fractional error above which the terms do not describe the table at all."""

MISFIT_START = 0.1
"""First value of the search for the misfit, typical of real sensors."""

MISFIT_GROWTH = 2.0
"""Largest factor by which the misfit may increase when fewer factors have a misfit."""

MISFIT_TOLERANCE = 0.04
"""Relative tolerance of chi^2 in this search; the misfit is then accurate to 2 %."""

MISFIT_STEPS = 30
"""Largest number of steps of this search, which needs four to eight."""

MARGIN = 0.05
"""Smallest distance of a step from either end of the bracket, as a fraction of the bracket."""


LEAST_FREEDOM = 6.0
"""Smallest degrees of freedom of the averages that must contribute the rest. The likelihood assumes
Gaussian averages, which favours a bounded drift if the last few averages happen to be small."""

WALKS = (0.0, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0)
"""Random walks for which a likelihood is computed, relative to the largest that the curve
allows."""

Z_CUT = 6.0
"""The shortest averages, which determine N, are left out only if the fit is worse than this or the
samples are filtered. Real disturbances give values of hundreds."""

FILTER_SHARES = ((1.5, 0.1), (32.0, 0.95))
"""Correlation time in samples, and fraction of the long-term white level. If Gauss-Markov processes
up to this time exceed the fraction, they have replaced white noise: the samples are filtered."""


@dataclass(frozen=True)
class Goodness:
    """chi^2 of the residual, its expectation, and the difference as a normal deviate."""

    chi_squared: float
    freedom: float

    @property
    def z(self) -> float:
        """(chi^2 - nu) / sqrt(2 nu)."""
        return float((self.chi_squared - self.freedom) / np.sqrt(2.0 * self.freedom))

    @property
    def fails(self) -> bool:
        """Whether the model is rejected."""
        return self.z >= Z_FAIL


def goodness(table: Table, variances: Floats, misfit: Misfit = NO_MISFIT) -> Goodness:
    """Return the goodness of fit of the active terms at their best fit.

    The degrees of freedom are the number of independent points of the table, less the active terms
    and the shapes of the processes.
    """
    covariance = weights_at(table, variances, misfit)
    active = np.flatnonzero(variances != 0.0)
    white = Whitening.of(covariance).apply(np.column_stack([table.terms[:, active], table.avar]))
    design = white[:, :-1] / np.linalg.norm(white[:, :-1], axis=0)
    basis = np.linalg.qr(design)[0]
    rest = white[:, -1] - basis @ (basis.T @ white[:, -1])
    shapes = np.count_nonzero(active >= len(RANDOM_TERMS))
    freedom = degrees_of_freedom(covariance) - len(active) - shapes
    return Goodness(float(rest @ rest), max(freedom, 1.0))


def degrees_of_freedom(covariance: Floats) -> float:
    """Return the number of independent points of a table with this covariance.

    sum lambda/(lambda + jitter) over the eigenvalues of the correlation matrix: the jitter removes
    directions without information.
    """
    deviation = np.sqrt(np.diag(covariance))
    eigenvalues = np.linalg.eigvalsh(covariance / np.outer(deviation, deviation))
    eigenvalues = np.maximum(eigenvalues, 0.0)
    return float(np.sum(eigenvalues / (eigenvalues + JITTER)))


def long_tau_deficit(table: Table, variances: Floats, misfit: Misfit = NO_MISFIT) -> float:
    """Return how far the lowest of the long averages lies below the model, as a normal deviate.

    An Allan variance of nu degrees of freedom is V chi^2_nu / nu (NIST SP 1065 eq. 45), with nu = 2
    V^2 / Var V of the model. Only averages of few degrees of freedom are tested. The deviate
    corresponds to the smallest probability, corrected for the number of tested averages
    (Bonferroni), so the limit is `DEFICIT_LIMIT` for any length of the record.
    """
    model = table.terms @ variances
    few = few_averages(table, variances, misfit) & (model > 0.0)
    if not few.any():
        return 0.0
    half = model[few] ** 2 / np.diag(weights_at(table, variances, misfit))[few]
    below = special.gammainc(half, half * np.maximum(table.avar[few], 0.0) / model[few])
    tests = max(1.0, np.count_nonzero(few) / POINTS_PER_TEST)
    return float(special.ndtri(np.clip(tests * below.min(), np.finfo(float).tiny, 0.5)))


def few_averages(table: Table, variances: Floats, misfit: Misfit = NO_MISFIT) -> NDArray[np.bool_]:
    """Return which factors have fewer than `FEW_AVERAGES` degrees of freedom."""
    model = table.terms @ variances
    return np.asarray(2.0 * model**2 < FEW_AVERAGES * np.diag(weights_at(table, variances, misfit)))


def best_case_goodness(table: Table, variances: Floats) -> Goodness:
    """Return the goodness at the fitted coefficients, or with the walk at its upper limit if
    better.

    If a random walk dominates the longest averages, k depends on few degrees of freedom. If its
    estimate is too low by chance, the other averages seem too large. Therefore a table is only
    rejected if no walk within the interval of k describes it.
    """
    first = goodness(table, variances)
    if not first.fails or first.z > Z_HOPELESS:
        return first
    most = variances.copy()
    most[K] = coefficient_interval(table, K, variances).high
    if not np.isfinite(most[K]):
        return first
    other = goodness(table, most)
    return other if other.z < first.z else first


def misfit_without_deficit(table: Table, variances: Floats, signed: bool, misfit: Misfit) -> Misfit:
    """Return the smallest fractional error of the long averages for which none of them is too low.

    Without a ``misfit`` of all averages, only those of few degrees of freedom get the error: the
    terms that the precise part of the curve determines keep their values and intervals.
    """
    m_min = int(table.m[few_averages(table, variances)].min())
    if misfit.size > 0.0:
        m_min = misfit.m_min
    low, high, eps = misfit.size, MISFIT_LIMIT, max(misfit.size, MISFIT_START / 2.0)
    for _ in range(MISFIT_STEPS):
        error = Misfit(eps, m_min)
        variances = solve(table, variances, signed=signed, misfit=error)
        fits = long_tau_deficit(table, variances, error) > DEFICIT_LIMIT
        low, high = (low, eps) if fits else (eps, high)
        if high - low < MISFIT_TOLERANCE * high:
            break
        eps = min(2.0 * eps, high) if high == MISFIT_LIMIT else (low + high) / 2.0
    return Misfit(high, m_min)


def misfit_of(table: Table, variances: Floats, signed: bool) -> Misfit:
    """Return the fractional error at which chi^2 is as expected, at as few factors as possible.

    If the terms describe the table up to some factor, only the larger factors get an error, because
    the cause of deviations of the long averages, such as a daily cycle, does not affect N. The
    error is at most `MISFIT_GROWTH` times the error of all factors, so that the long averages keep
    their weight.
    """
    misfit = _misfit_from(table, variances, signed, 1)
    most = MISFIT_GROWTH * misfit.size
    octaves = 2 ** np.arange(1, int(table.m.max()).bit_length())
    low, high = 0, len(octaves)
    while low < high:
        middle = (low + high) // 2
        split = int(octaves[middle])
        short = table.rows(table.m < split)
        if len(short.m) > 2 * len(RANDOM_TERMS):
            other = _misfit_from(table, variances, signed, split)
            best = solve(table, variances, signed=signed, misfit=other)
            if other.size > most or goodness(short, best).fails:
                high = middle
                continue
            misfit = other
        low = middle + 1
    return misfit


def _misfit_from(table: Table, variances: Floats, signed: bool, m_min: int) -> Misfit:
    """Return the fractional error eps, from ``m_min`` on, at which chi^2 is as expected.

    C + eps^2 diag(V_model^2): 0 where the terms describe the table; as eps grows the fit turns
    into one of relative residuals over the complete curve. chi^2 falls from its value at 0 about
    as 1/eps^2 does, so the search steps in the logarithms of both.
    """
    low, high, eps = 0.0, MISFIT_LIMIT, MISFIT_START
    for _ in range(MISFIT_STEPS):
        variances = solve(table, variances, signed=signed, misfit=Misfit(eps, m_min))
        got = goodness(table, variances, Misfit(eps, m_min))
        ratio = got.chi_squared / got.freedom
        if abs(ratio - 1.0) < MISFIT_TOLERANCE:
            break
        low, high = (eps, high) if ratio > 1.0 else (low, eps)
        eps = float(np.clip(eps * np.sqrt(ratio), low + MARGIN * (high - low), MISFIT_LIMIT))
        eps = min(eps, high - MARGIN * (high - low))
    return Misfit(eps, m_min)


def fits(fit: PointFit) -> bool:
    """Return whether a model describes its table, long averages included."""
    if deviate(fit) >= Z_FAIL:
        return False
    return long_tau_deficit(fit.table, fit.variances) > DEFICIT_LIMIT


def deviate(fit: PointFit) -> float:
    """Return the goodness of fit as a normal deviate."""
    z = goodness(fit.table, fit.variances).z
    return best_case_goodness(fit.table, fit.variances).z if Z_FAIL <= z < Z_CUT else z


def is_good(fit: PointFit) -> bool:
    """Return whether a model describes its table without replacing white noise."""
    return fits(fit) and not replaces_white(fit)


def replaces_white(fit: PointFit) -> bool:
    """Return whether a short Gauss-Markov process represents filtered white noise."""
    white = max(float(fit.variances[N]), 0.0)
    levels = [
        (e.shape / fit.options.m_min, float(p) * e.white())
        for e, p in zip(fit.options.extras, fit.variances[len(RANDOM_TERMS) :])
        if isinstance(e, GaussMarkovTerm)
    ]
    return any(
        (level := sum(p for t, p in levels if t < longest)) > share * (white + level)
        for longest, share in FILTER_SHARES
    )


def criterion(fit: PointFit, misfit: Misfit = NO_MISFIT) -> float:
    """Return -2 log likelihood of the table, assumed Gaussian, plus twice the number of
    parameters."""
    parameters = np.count_nonzero(fit.variances) + len(fit.options.extras)
    return minus_log_likelihood(fit.table, fit.variances, misfit) + 2.0 * parameters


def minus_log_likelihood(table: Table, variances: Floats, misfit: Misfit = NO_MISFIT) -> float:
    """Return -2 log likelihood of the table, assumed Gaussian, less a constant."""
    whitening = Whitening.of(weights_at(table, variances, misfit))
    rest = whitening.apply((table.avar - table.terms @ variances)[:, None])
    size = np.log(np.diag(whitening.lower)).sum() + np.log(whitening.deviation).sum()
    return float(np.sum(rest**2) + 2.0 * size)


def precise_rows(fit: PointFit) -> NDArray[np.bool_]:
    """Return which averages have at least `LEAST_FREEDOM` degrees of freedom."""
    variance = np.diag(weights_at(fit.table, fit.variances, NO_MISFIT))
    return np.asarray(2.0 * (fit.table.terms @ fit.variances) ** 2 >= LEAST_FREEDOM * variance)


def surprise(table: Table, fit: PointFit) -> float:
    """Return -2 log likelihood of the table with the most likely random walk.

    If a random walk dominates the longest averages, its estimate depends on few of them. If it is
    low by chance, the other averages become unlikely (`best_case_goodness`).
    """
    signed = fit.options.signed
    fits = [solve(table, fit.variances, columns=fit.options.columns, signed=signed)]
    if fit.options.walk:
        most = float(np.min(table.avar / table.terms[:, K]))
        fits += [solve(table, fit.variances, fixed={K: most * w}, signed=signed) for w in WALKS]
    return min(minus_log_likelihood(table, p) for p in fits)


def loosened(pooled: PooledTable, axis: int, fit: PointFit) -> PointFit:
    """Return the fit with the fractional model error with which it passes."""
    misfit = misfit_of(fit.table, fit.variances, fit.options.signed)
    return point_fit(pooled, axis, replace(fit.options, misfit=misfit), fit.variances)


def white_error(pooled: PooledTable, axis: int, fit: PointFit) -> float:
    """Return the relative standard error of N, including model error and uncertain shapes."""
    options = fit.options
    table = options.table(pooled, axis, options.noise(fit.variances), tangents=True)
    variances = np.concatenate([fit.variances, np.zeros(table.terms.shape[1] - len(fit.variances))])
    if not variances[N] > 0.0:
        return np.inf
    active = (variances != 0.0) | (np.arange(len(variances)) >= len(fit.variances))
    white = Whitening.of(weights_at(table, variances, options.misfit)).apply(table.terms[:, active])
    return float(standard_errors(white)[np.count_nonzero(active[:N])] / variances[N] / 2.0)
