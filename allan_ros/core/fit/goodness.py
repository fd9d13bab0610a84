# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of fit, likelihoods, and the relative model error of a fit that fails the tests."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..deferred import special
from .gls_solver import (
    JITTER,
    NO_MISFIT,
    Misfit,
    PointFit,
    Whitening,
    covariance_at,
    point_fit,
    solve,
)
from .intervals import coefficient_interval, standard_errors
from .model import RANDOM_TERMS, Floats, K, N
from .processes import GaussMarkovTerm
from .table import PooledTable, Table

Z_FAIL = 3.0
"""Normal deviate of chi^2 above which the model is rejected. It is exceeded by chance in one of
several hundred tables."""

Z_GIVE_UP = 50.0
"""Normal deviate above which the test is not repeated with a larger random walk."""

DEFICIT_FALSE_ALARM = 1e-3
"""Probability that `long_tau_deficit` is significant for a true model."""

DEFICIT_LIMIT = -3.090232306167813
"""Normal deviate below which Allan variances at long averaging times are significantly lower than
the model: the quantile of `DEFICIT_FALSE_ALARM`."""

POINTS_PER_TEST = 8.0
"""Number of neighboring averaging factors per independent test, because they are correlated."""

FEW_AVERAGES = 60.0
"""Degrees of freedom below which an Allan variance is too skewed for chi^2: it cannot be many
standard errors below the model, however unlikely it is."""

MISFIT_LIMIT = 10.0
"""Relative model error above which the terms do not describe the table at all."""

MISFIT_START = 0.1
"""Initial value of the search for the relative model error, typical of real sensors."""

MISFIT_GROWTH = 2.0
"""Largest factor by which the model error may increase when it applies to fewer averaging
factors."""

MISFIT_TOLERANCE = 0.04
"""Relative tolerance of chi^2 in the search for the model error, which is then accurate to 2 %."""

MISFIT_STEPS = 30
"""Largest number of steps of the search for the model error; four to eight are usual."""

MARGIN = 0.05
"""Smallest distance of a step from an end of its bracket, as a fraction of the bracket."""

LEAST_FREEDOM = 6.0
"""Degrees of freedom above which averages are used by `precise_rows`. The likelihood assumes
Gaussian averages and favors a bounded drift if the last few averages happen to be small."""

PROFILE_WALKS = (0.0, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0)
"""Values of k for the profile likelihood, relative to the largest k that the curve allows."""

Z_EXCLUDE_SHORT = 6.0
"""Normal deviate above which the shortest averages, which determine N, may be excluded. For
filtered samples there is no such condition. Real disturbances give values of hundreds."""

FILTERED_WHITE = ((1.5, 0.1), (32.0, 0.95))
"""Pairs of a correlation time in samples and a fraction of the long-term white noise level. The
samples are filtered if Gauss-Markov processes up to this correlation time exceed the fraction."""


@dataclass(frozen=True)
class Goodness:
    """Chi^2 test of a fit.

    Attributes
    ----------
    chi_squared : float
        Sum of the squared whitened residuals.
    freedom : float
        Degrees of freedom nu: the expected value of chi^2.
    """

    chi_squared: float
    freedom: float

    @property
    def z(self) -> float:
        """Standardized chi^2, (chi^2 - nu) / sqrt(2 nu)."""
        return float((self.chi_squared - self.freedom) / np.sqrt(2.0 * self.freedom))

    @property
    def fails(self) -> bool:
        """Whether the test rejects the model."""
        return self.z >= Z_FAIL


def goodness(table: Table, variances: Floats, misfit: Misfit = NO_MISFIT) -> Goodness:
    """Return the chi^2 test of the model that contains the terms with nonzero coefficients.

    These terms are fitted again by linear least squares, with the covariance of the given
    coefficients ``variances`` and relative model error ``misfit``.
    """
    # Degrees of freedom: effective number of independent points, minus the fitted parameters
    # (coefficients, correlation times and frequencies).
    covariance = covariance_at(table, variances, misfit)
    active = np.flatnonzero(variances != 0.0)
    white = Whitening.of(covariance).apply(np.column_stack([table.terms[:, active], table.avar]))
    design = white[:, :-1] / np.linalg.norm(white[:, :-1], axis=0)
    basis = np.linalg.qr(design)[0]
    residual = white[:, -1] - basis @ (basis.T @ white[:, -1])
    shapes = np.count_nonzero(active >= len(RANDOM_TERMS))
    freedom = degrees_of_freedom(covariance) - len(active) - shapes
    return Goodness(float(residual @ residual), max(freedom, 1.0))


def degrees_of_freedom(covariance: Floats) -> float:
    """Return the effective number of independent values among correlated values.

    It is the sum of lambda/(lambda + `JITTER`) over the eigenvalues lambda of their correlation
    matrix.
    """
    deviation = np.sqrt(np.diag(covariance))
    eigenvalues = np.linalg.eigvalsh(covariance / np.outer(deviation, deviation))
    eigenvalues = np.maximum(eigenvalues, 0.0)
    return float(np.sum(eigenvalues / (eigenvalues + JITTER)))


def long_tau_deficit(table: Table, variances: Floats, misfit: Misfit = NO_MISFIT) -> float:
    """Test whether Allan variances at long averaging times are lower than the model.

    Returns a normal deviate <= 0, corrected for the number of tests (Bonferroni). A value of
    `DEFICIT_LIMIT` or less is significant. Only Allan variances with few degrees of freedom are
    tested; the result is 0 if there are none.
    """
    # An Allan variance of expectation V is distributed as V chi^2_nu / nu with nu = 2 V^2 / Var V
    # (NIST SP 1065 eq. 45).
    model = table.terms @ variances
    few = few_averages(table, variances, misfit) & (model > 0.0)
    if not few.any():
        return 0.0
    half = model[few] ** 2 / np.diag(covariance_at(table, variances, misfit))[few]
    below = special.gammainc(half, half * np.maximum(table.avar[few], 0.0) / model[few])
    tests = max(1.0, np.count_nonzero(few) / POINTS_PER_TEST)
    return float(special.ndtri(np.clip(tests * below.min(), np.finfo(float).tiny, 0.5)))


def few_averages(table: Table, variances: Floats, misfit: Misfit = NO_MISFIT) -> NDArray[np.bool_]:
    """Return a mask of Allan variances with few degrees of freedom, (factors,)."""
    model = table.terms @ variances
    return np.asarray(
        2.0 * model**2 < FEW_AVERAGES * np.diag(covariance_at(table, variances, misfit))
    )


def best_case_goodness(table: Table, variances: Floats) -> Goodness:
    """Return the better of two chi^2 tests: with the fitted random walk k and with its upper limit.

    The second test is only made if the first fails narrowly.
    """
    # If a random walk dominates the longest averages, k depends on few degrees of freedom. If it is
    # estimated too low by chance, the other averages seem too large.
    first = goodness(table, variances)
    if not first.fails or first.z > Z_GIVE_UP:
        return first
    most = variances.copy()
    most[K] = coefficient_interval(table, K, variances).high
    if not np.isfinite(most[K]):
        return first
    other = goodness(table, most)
    return other if other.z < first.z else first


def misfit_of_long_averages(
    table: Table, variances: Floats, signed: bool, misfit: Misfit
) -> Misfit:
    """Return the smallest relative model error that explains low values at long averaging times.

    With it, `long_tau_deficit` is not significant. The result is at least ``misfit``. ``variances``
    are initial coefficients; ``signed`` allows a negative q.
    """
    # Without an earlier model error, only averaging factors with few degrees of freedom get one.
    # Terms that shorter averaging times determine then keep their values and intervals.
    m_min = int(table.m[few_averages(table, variances)].min())
    if misfit.size > 0.0:
        m_min = misfit.m_min
    low, high, eps = misfit.size, MISFIT_LIMIT, max(misfit.size, MISFIT_START / 2.0)
    for _ in range(MISFIT_STEPS):
        error = Misfit(eps, m_min)
        variances = solve(table, variances, signed=signed, misfit=error).variances
        large_enough = long_tau_deficit(table, variances, error) > DEFICIT_LIMIT
        low, high = (low, eps) if large_enough else (eps, high)
        if high - low < MISFIT_TOLERANCE * high:
            break
        eps = min(2.0 * eps, high) if high == MISFIT_LIMIT else (low + high) / 2.0
    return Misfit(high, m_min)


def misfit_of_table(table: Table, variances: Floats, signed: bool) -> Misfit:
    """Return the relative model error that makes chi^2 equal to its degrees of freedom.

    If the model describes the short averaging times, only longer ones get an error. ``variances``
    are initial coefficients; ``signed`` allows a negative q.
    """
    # Deviations at long averaging times, such as a daily cycle, do not affect N. An error of only
    # these times is at most `MISFIT_GROWTH` times the error that all averaging times would need.
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
            best = solve(table, variances, signed=signed, misfit=other).variances
            if other.size > most or goodness(short, best).fails:
                high = middle
                continue
            misfit = other
        low = middle + 1
    return misfit


def _misfit_from(table: Table, variances: Floats, signed: bool, m_min: int) -> Misfit:
    """Return the error of averaging factors >= m_min that gives chi^2 its expected value."""
    # chi^2 decreases about as the inverse square of the error.
    low, high, eps = 0.0, MISFIT_LIMIT, MISFIT_START
    for _ in range(MISFIT_STEPS):
        variances = solve(table, variances, signed=signed, misfit=Misfit(eps, m_min)).variances
        got = goodness(table, variances, Misfit(eps, m_min))
        ratio = got.chi_squared / got.freedom
        if abs(ratio - 1.0) < MISFIT_TOLERANCE:
            break
        low, high = (eps, high) if ratio > 1.0 else (low, eps)
        eps = float(np.clip(eps * np.sqrt(ratio), low + MARGIN * (high - low), MISFIT_LIMIT))
        eps = min(eps, high - MARGIN * (high - low))
    return Misfit(eps, m_min)


def passes(fit: PointFit) -> bool:
    """Return whether a fit passes the chi^2 test and has no deficit at long averaging times."""
    if goodness_z(fit) >= Z_FAIL:
        return False
    return long_tau_deficit(fit.table, fit.variances) > DEFICIT_LIMIT


def goodness_z(fit: PointFit) -> float:
    """Return the standardized chi^2 of a fit.

    If the fit fails narrowly, a larger random walk is tested as well (`best_case_goodness`).
    """
    z = goodness(fit.table, fit.variances).z
    return best_case_goodness(fit.table, fit.variances).z if Z_FAIL <= z < Z_EXCLUDE_SHORT else z


def passes_unfiltered(fit: PointFit) -> bool:
    """Return whether a fit passes both tests and the samples do not seem low-pass filtered."""
    return passes(fit) and not looks_filtered(fit)


def looks_filtered(fit: PointFit) -> bool:
    """Return whether the fitted processes indicate that the samples are low-pass filtered.

    Gauss-Markov processes of short correlation time then replace part of the white noise.
    """
    white = max(float(fit.variances[N]), 0.0)
    levels = [
        (e.shape / fit.options.m_min, float(p) * e.equivalent_white())
        for e, p in zip(fit.options.extras, fit.variances[len(RANDOM_TERMS) :])
        if isinstance(e, GaussMarkovTerm)
    ]
    return any(
        (level := sum(p for t, p in levels if t < longest)) > share * (white + level)
        for longest, share in FILTERED_WHITE
    )


def aic(fit: PointFit, misfit: Misfit = NO_MISFIT) -> float:
    """Return the Akaike information criterion of a fit, -2 log likelihood + 2 (parameters).

    The Allan variances are assumed Gaussian, and a constant is omitted.
    """
    parameters = np.count_nonzero(fit.variances) + len(fit.options.extras)
    return minus_log_likelihood(fit.table, fit.variances, misfit) + 2.0 * parameters


def minus_log_likelihood(table: Table, variances: Floats, misfit: Misfit = NO_MISFIT) -> float:
    """Return -2 log likelihood of the Allan variances for given coefficients, without a constant.

    The Allan variances are assumed Gaussian.
    """
    whitening = Whitening.of(covariance_at(table, variances, misfit))
    residual = whitening.apply((table.avar - table.terms @ variances)[:, None])
    size = np.log(np.diag(whitening.lower)).sum() + np.log(whitening.deviation).sum()
    return float(np.sum(residual**2) + 2.0 * size)


def precise_rows(fit: PointFit) -> NDArray[np.bool_]:
    """Return a mask of Allan variances that are nearly Gaussian, (factors,)."""
    variance = np.diag(covariance_at(fit.table, fit.variances, NO_MISFIT))
    return np.asarray(2.0 * (fit.table.terms @ fit.variances) ** 2 >= LEAST_FREEDOM * variance)


def minus_log_profile(table: Table, fit: PointFit) -> float:
    """Return -2 log likelihood of the Allan variances, minimized over the random walk k.

    The other coefficients are fitted again for each k. A constant is omitted.
    """
    # If a random walk dominates the longest averaging times, k depends on few degrees of freedom.
    # The likelihood at a single estimate of k would depend on chance.
    signed = fit.options.signed
    fits = [solve(table, fit.variances, columns=fit.options.columns, signed=signed)]
    if fit.options.walk:
        most = float(np.min(table.avar / table.terms[:, K]))
        fits += [
            solve(table, fit.variances, fixed={K: most * w}, signed=signed) for w in PROFILE_WALKS
        ]
    return min(minus_log_likelihood(table, each.variances) for each in fits)


def with_model_error(pooled: PooledTable, axis: int, fit: PointFit) -> PointFit:
    """Repeat a fit with the relative model error that `misfit_of_table` returns."""
    misfit = misfit_of_table(fit.table, fit.variances, fit.options.signed)
    return point_fit(pooled, axis, replace(fit.options, misfit=misfit), fit.variances)


def relative_error_of_n(pooled: PooledTable, axis: int, fit: PointFit) -> float:
    """Return the relative standard error of N; infinite if N is 0.

    It includes the model error and the uncertainty of the processes.
    """
    options = fit.options
    table = options.table(pooled, axis, options.noise(fit.variances), tangents=True)
    variances = np.concatenate([fit.variances, np.zeros(table.terms.shape[1] - len(fit.variances))])
    if not variances[N] > 0.0:
        return np.inf
    active = (variances != 0.0) | (np.arange(len(variances)) >= len(fit.variances))
    white = Whitening.of(covariance_at(table, variances, options.misfit)).apply(
        table.terms[:, active]
    )
    return float(standard_errors(white)[np.count_nonzero(active[:N])] / variances[N] / 2.0)
