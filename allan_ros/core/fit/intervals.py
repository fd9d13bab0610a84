# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Confidence intervals by inversion of the score test.

To test a value c of one variance coefficient, the coefficient is fixed at c and the others are
fitted again. z(c) = (p - c)/se(c) compares the free estimate p with c, where the standard error
se(c) is computed from the covariance of that fit. The 95 % interval contains the values with
|z| < 1.96 (Rao 1948). The Wald interval, estimate +- 1.96 se, would miss the true K of short
records in 9 to 13 % of cases instead of 5 %.

An estimate that depends on few long averaging times is skewed like a chi^2 variable of few degrees
of freedom. The cube root transformation of Wilson & Hilferty (PNAS 17, 1931) therefore converts z
to a normal deviate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..deferred import special
from .gls_solver import (
    NO_MISFIT,
    RIDGE,
    Misfit,
    PointFit,
    Whitening,
    covariance_at,
    noise_floor,
    solve,
    with_noise_floor,
)
from .model import RANDOM_TERMS, Z_95, Floats, GaussMarkov, K, Processes, Q, Sinusoid
from .processes import GaussMarkovTerm, Process
from .table import PooledTable, Table

Z_DETECT = 2.33
"""Normal quantile of 99 %. Above it a term is resolved; an absent term is resolved by mistake in
one of 100 records."""

Z_TOLERANCE = 1e-3
"""Tolerance of z at the end of an interval, about 0.05 % of the half-width."""

MAX_SLOW_STEPS = 2
"""Number of slow steps (bracket not halved, or no bracket found) after which a longer step is
taken."""

MAX_STEP_RATIO = 5.0
"""Largest factor by which a step increases the distance from the start."""

MAX_DISTANCE = 1e8
"""Distance, relative to the first guess, at which the search for an end of an interval stops."""

NEGLIGIBLE_SKEWNESS = 1e-3
"""Skewness whose effect is negligible."""


@dataclass(frozen=True)
class CoefficientInterval:
    """95 % interval of one variance coefficient.

    Attributes
    ----------
    z_zero : float
        Score test of the value 0, as a normal deviate.
    low, high : float
        Ends of the interval. ``low`` is 0 and ``high`` is an upper limit if the term is not
        resolved.
    """

    z_zero: float
    low: float
    high: float

    @property
    def observable(self) -> bool:
        """Whether the test rejects the value 0."""
        return self.z_zero > Z_DETECT


class ScoreTest:
    """Score test of one variance coefficient.

    A call with a value c returns (estimate - c)/(standard error) as a normal deviate. The other
    coefficients and the standard error are those of a fit with the coefficient fixed at c.

    Attributes
    ----------
    estimate, deviation : float
        Estimate of the coefficient and its standard error in the last test.
    """

    def __init__(
        self, table: Table, term: int, variances: Floats, misfit: Misfit = NO_MISFIT
    ) -> None:
        self.table = table
        self.term = term
        self.misfit = misfit
        self.estimate = 0.0
        self.deviation = 0.0
        self._start = variances

    def __call__(self, c: float, at_least: float = -np.inf) -> float:
        """Return the test of the value c as a normal deviate.

        An estimate below ``at_least`` is replaced by ``at_least``.
        """
        variances, whitening, white = solve(
            self.table,
            self._start,
            fixed={self.term: c},
            signed=self.term != Q,
            misfit=self.misfit,
        )
        self._start = variances
        active = [a for a, p in enumerate(variances) if a == self.term or p != 0.0]
        contrast = _contrast(white[:, active], active.index(self.term))
        self.estimate = float(contrast @ white[:, -1])
        self.deviation = float(np.sqrt(contrast @ contrast))
        model = self.table.terms @ with_noise_floor(self.table, variances)
        weights, covariance = whitening.weights(contrast), whitening.covariance_with(contrast)
        # Third cumulant of the estimate sum_i l_i V_i, if the Allan variances V_i are gamma
        # variables with the covariance C: 2 sum_i l_i (C l)_i^2 / V_i.
        third = 2.0 * float(np.sum(weights * covariance**2 / model))
        z = (max(self.estimate, at_least) - c) / self.deviation
        return normal_deviate(z, third / self.deviation**3)


def _inverse(design: Floats) -> tuple[Floats, Floats]:
    """Return (X'X)^-1 of the columns X scaled to norm 1, and the norms."""
    size = np.linalg.norm(design, axis=0)
    size[size == 0.0] = 1.0
    unit = design / size
    return np.linalg.inv(unit.T @ unit + RIDGE * np.eye(len(size))), size


def _contrast(design: Floats, at: int) -> Floats:
    """Return weights w such that w @ y is the least-squares estimate of one coefficient."""
    inverse, size = _inverse(design)
    return np.asarray(design / size @ inverse[:, at] / size[at])


def standard_errors(design: Floats) -> Floats:
    """Return the standard errors of least-squares coefficients, (columns,).

    The fitted values are uncorrelated and have unit variance.
    """
    inverse, size = _inverse(design)
    return np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size


def normal_deviate(z: float, skewness: float) -> float:
    """Convert a standardized gamma variable z of given skewness to a normal deviate.

    The cube root transformation of Wilson & Hilferty (1931) is used.
    """
    if abs(skewness) < NEGLIGIBLE_SKEWNESS:
        return z
    root = np.cbrt(max(1.0 + skewness * z / 2.0, 0.0))
    return float((root - 1.0) * 6.0 / skewness + skewness / 6.0)


def coefficient_interval(
    table: Table, term: int, variances: Floats, misfit: Misfit = NO_MISFIT
) -> CoefficientInterval:
    """Return the 95 % interval of one variance coefficient, by inversion of the score test.

    ``term`` is its column in the table, ``variances`` are the fitted variance coefficients, and
    ``misfit`` is the relative model error.
    """
    score = ScoreTest(table, term, variances, misfit)
    z_zero = score(0.0)
    deviation = max(score.deviation, noise_floor(table))
    # The fitted coefficient is preferred: the estimate of the test at 0 can be far off.
    middle = variances[term] if variances[term] > 0.0 else max(score.estimate, 0.0)
    if z_zero > Z_DETECT:
        known = [(0.0, z_zero), (middle, score(middle))]
        reach = Z_95 * score.deviation
        high = find_crossing(score, -Z_95, known, middle + reach, np.inf)
        low = find_crossing(score, Z_95, known, middle - reach, 0.0)
        return CoefficientInterval(z_zero, low, high)
    # An estimate below zero is replaced by zero, so the limit reflects the length of the record.
    known = [(0.0, max(z_zero, 0.0))]
    reach = middle + Z_95 * deviation
    upper = find_crossing(lambda c: score(c, 0.0), -Z_95, known, reach, np.inf)
    return CoefficientInterval(z_zero, 0.0, upper)


LONGEST_IN_LIMIT = 10
"""Length of the longest segment divided by the longest averaging time of `limit_of_averages`. The
ramp that is subtracted from the averages affects longer ones."""


def limit_of_averages(table: Table, term: int, samples: int) -> float:
    """Return a 95 % upper limit of one variance coefficient, without assumptions on other terms.

    It is the largest coefficient with which the term alone does not significantly exceed any
    measured Allan variance (one-sided 2.5 %, Bonferroni), or infinity without data. ``term`` is
    its column in the table, and ``samples`` the length of the longest segment.
    """
    # An Allan variance of expectation V is distributed as V chi^2_nu / nu with nu = 2 V^2 / Var V
    # (NIST SP 1065 eq. 45).
    used = (table.m <= samples / LONGEST_IN_LIMIT) & (table.avar > 0.0)
    if not used.any():
        return np.inf
    unit = table.terms[:, term]
    alone = np.zeros(table.terms.shape[1])
    alone[term] = float(np.min(table.avar[used] / unit[used]))
    half = (unit * alone[term]) ** 2 / np.diag(covariance_at(table, alone))
    probability = special.ndtr(-Z_95) / np.count_nonzero(used)
    smallest = special.gammaincinv(half[used], probability) / half[used]
    return float(np.min(table.avar[used] / (unit[used] * smallest)))


def find_crossing(
    z: Callable[[float], float],
    target: float,
    known: Sequence[tuple[float, float]],
    guess: float,
    limit: float,
) -> float:
    """Return the value c at which a decreasing function z(c) equals ``target``.

    ``known`` contains points (c, z) that are already computed. The search starts at the last of
    them, continues at ``guess``, and ends at ``limit``, which is returned if z does not reach the
    target.
    """
    # Each step goes to the target on the hyperbola (alpha - c) / (beta + gamma c) through the last
    # three points, which equals z if the standard error is linear in c. A step outside the bracket
    # is replaced by bisection or, without a bracket, by a larger step.
    points = list(known)
    start, value = points[-1]
    side = 1.0 if limit > start else -1.0
    if side * (value - target) <= 0.0 or guess == start:
        return start
    inner, outer, bracketed = start, limit, False
    c, first, steps = side * min(side * guess, side * limit), abs(guess - start), 0
    while abs(c - start) <= MAX_DISTANCE * first:
        value = z(c)
        points.append((c, value))
        width = abs(outer - inner)
        if side * (value - target) <= 0.0:
            outer, bracketed = c, True
        elif c == limit:
            return limit
        else:
            inner = c
        precise = Z_TOLERANCE / 2.0 * max(abs(outer - start), Z_TOLERANCE * first)
        if abs(value - target) < Z_TOLERANCE or (bracketed and abs(outer - inner) <= precise):
            return c
        # z is discontinuous where another term becomes 0. Only bisection converges there.
        steps = steps + 1 if not bracketed or abs(outer - inner) > width / 2.0 else 0
        c = _hyperbola(points[-3:], target)
        far = start + side * MAX_STEP_RATIO * (abs(inner - start) or first)
        ends = (inner, outer if bracketed else side * min(side * outer, side * far))
        if steps > MAX_SLOW_STEPS or not min(ends) < c < max(ends):
            c, steps = (inner + outer) / 2.0 if bracketed else ends[1], 0
    return limit


def _hyperbola(points: Sequence[tuple[float, float]], target: float) -> float:
    """Return c at which the hyperbola through the points (c, z) equals the target, or NaN."""
    c, z = np.array(points).T
    columns = [np.ones_like(c), -z, -c * z][: len(points)]
    try:
        alpha, beta, *gamma = np.linalg.solve(np.stack(columns, axis=1), c)
    except np.linalg.LinAlgError:
        return np.nan
    return float((alpha - beta * target) / (1.0 + sum(gamma) * target))


MAX_SHAPE_RATIO = 100.0
"""Largest ratio of a correlation time or frequency to an end of its interval."""


def processes_of(fit: PointFit, table: Table, tau0: float) -> Processes:
    """Return the processes of a fit with 95 % intervals, in SI units.

    ``table`` also contains the derivatives of the process columns (`Table.tangents`). ``tau0`` is
    the sample period in s.
    """
    number = len(fit.options.extras)
    if not number:
        return Processes()
    variances = np.concatenate([fit.variances, np.zeros(number)])
    active = np.flatnonzero((variances != 0.0) | (np.arange(len(variances)) >= len(RANDOM_TERMS)))
    whitening = Whitening.of(covariance_at(table, variances, fit.options.misfit))
    errors = np.zeros(len(variances))
    errors[active] = standard_errors(whitening.apply(table.terms[:, active]))
    return processes_in_si(fit.options.extras, variances, errors, tau0)


def processes_in_si(
    extras: Sequence[Process], variances: Floats, errors: Floats, tau0: float
) -> Processes:
    """Return processes with 95 % intervals that are symmetric in the logarithm, in SI units.

    ``variances`` are the coefficients of the four random terms and of the processes ``extras``.
    ``errors`` are the standard errors of these coefficients, then those of the coefficients of
    `Table.tangents`. ``tau0`` is the sample period in s.
    """
    gauss_markov, sinusoid = [], []
    for k, extra in enumerate(extras, start=len(RANDOM_TERMS)):
        if not variances[k] > 0.0:
            continue
        reach = Z_95 * errors[[k, k + len(extras)]] / float(variances[k])
        variance_ratio, shape_ratio = np.exp(np.minimum(reach, np.log(MAX_SHAPE_RATIO))).tolist()
        size = math.sqrt(variances[k])
        ends = (size / math.sqrt(variance_ratio), size * math.sqrt(variance_ratio))
        low, high = extra.shape / shape_ratio, extra.shape * shape_ratio
        if isinstance(extra, GaussMarkovTerm):
            times = (low * tau0, high * tau0)
            gauss_markov.append(GaussMarkov(size, ends, extra.shape * tau0, times))
        else:
            sinusoid.append(Sinusoid(size, ends, extra.shape / tau0, (low / tau0, high / tau0)))
    return Processes(tuple(gauss_markov), tuple(sinusoid))


Z_DETECT_RAMP = 2.58
"""Normal quantile of 99.5 %. R has a sign, so both tails contribute to 1 % false alarms."""

SAME_RAMP_P = 0.01
"""p value below which the test rejects that all segments have the same ramp."""


@dataclass(frozen=True)
class RampInterval:
    """Estimated linear drift (ramp) of an axis, its 95 % interval and two test results.

    Attributes
    ----------
    value : float
        Drift per sample: the weighted mean of the segments, or the drift of the longest segment if
        they differ significantly.
    low, high : float
        Ends of the interval.
    observable : bool
        Whether the value 0 is rejected.
    other : float or None
        Drift per sample of the segment that differs most significantly from the longest one, or
        None if the ramps of all segments agree within their uncertainty.
    """

    value: float
    low: float
    high: float
    observable: bool
    other: float | None


def ramp_interval(
    pooled: PooledTable, axis: int, fit: PointFit, walk: float
) -> RampInterval | None:
    """Return the linear drift (ramp) of one axis with its 95 % interval, or None if it is unknown.

    ``walk`` is the upper limit of k, which limits the width of the interval.
    """
    variance = fit.ramp_variance
    counted = np.flatnonzero(variance > 0.0)
    if not len(counted):
        return None
    ramps = fit.table.ramps[counted]
    value, deviation = _mean(ramps, variance[counted])
    spread = float(np.sum((ramps - value) ** 2 / variance[counted]))
    shared = len(counted) == 1 or bool(special.chdtrc(len(counted) - 1, spread) > SAME_RAMP_P)
    other = None
    if not shared:
        difference = np.abs(ramps - ramps[0]) / np.sqrt(variance[counted] + variance[counted[0]])
        other = float(ramps[np.argmax(difference)])
        counted, ramps = counted[:1], ramps[:1]
        value, deviation = _mean(ramps, variance[counted])

    known_or_free = np.zeros(len(variance))
    known_or_free[counted] = np.nan
    # The Allan variance is quadratic in a known ramp: three values determine it.
    at = value + deviation * np.array([-1.0, 0.0, 1.0])
    tables = []
    for c in at:
        known = np.where(np.isnan(known_or_free), c, np.nan)
        tables.append(fit.options.table(pooled, axis, fit.options.noise(fit.variances), known))
    below, middle, above = (table.avar for table in tables)
    slope, curvature = (above - below) / 2.0, (above + below) / 2.0 - middle
    start_values = fit.variances

    def z(c: float) -> float:
        nonlocal start_values
        x = (c - value) / deviation
        shifted = replace(tables[1], avar=middle + slope * x + curvature * x * x)
        start_values = solve(
            shifted, start_values, signed=fit.options.signed, misfit=fit.options.misfit
        ).variances
        noise = fit.options.noise(with_noise_floor(shifted, start_values))
        free, weights = pooled.ramps(axis, noise, known_or_free)
        of_ramps = pooled.ramp_variance(weights, noise.times) @ noise.variances
        r, sd = _mean(free[counted], of_ramps[counted])
        return (r - c) / sd

    bound = np.inf
    if np.isfinite(walk):
        most = fit.variances.copy()
        most[K] = max(walk, most[K])
        bound = _mean(ramps, replace(fit, variances=most).ramp_variance[counted])[1]
    reach, half = Z_95 * bound, Z_95 * deviation
    start = [(0.0, z(0.0)), (value, z(value))]
    low = find_crossing(z, Z_95, start, value - half, value - reach)
    high = find_crossing(z, -Z_95, start, value + half, value + reach)
    observable = abs(value) > Z_DETECT_RAMP * bound or abs(start[0][1]) > Z_DETECT_RAMP
    return RampInterval(value, low, high, observable, other)


def _mean(ramps: Floats, variance: Floats) -> tuple[float, float]:
    """Return the mean weighted by 1/variance, and its standard error."""
    weight = 1.0 / variance
    return float(weight @ ramps / weight.sum()), float(1.0 / np.sqrt(weight.sum()))
