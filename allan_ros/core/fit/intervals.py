# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Intervals by inversion of the score test: the values that the test does not reject.

To test a value c of one variance coefficient, fix it, refit the others, and compute how many
standard deviations *at that fit* the free estimate lies from c: z(c) = (p - c)/se(c). The 95 %
interval is where |z| < 1.96 (Rao 1948). The usual interval, estimate +- 1.96 se, uses se at the
estimate. For K of a short record, se is too small if the estimate is too small, so these intervals
miss the truth in 9 to 13 % of records instead of 5.

An estimate that depends on a few long averages is skewed like a chi^2 of few degrees of freedom.
The estimate is a sum l_i V_i, whose third cumulant is 2 sum_i l_i (C l)_i^2 / V_i if the V_i are
treated as gamma variables of the covariance C. With this skewness, the cube root of Wilson &
Hilferty (PNAS 17, 1931) transforms z into a normal deviate.
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
    K,
    Misfit,
    PointFit,
    Q,
    Whitening,
    iterate,
    solve,
    weights_at,
    white_floor,
    with_floor,
)
from .model import RANDOM_TERMS, Z_95, Floats, GaussMarkov, Processes, Sinusoid
from .processes import Extra, GaussMarkovTerm
from .table import PooledTable, Table

Z_DETECT = 2.33
"""Normal quantile of 99 %: an absent term is resolved by mistake in 1 % of records."""


ENOUGH = 1e-3
"""Tolerance of z at its target: a twentieth of a percent of the half-width."""


SLOW = 2
"""Number of steps that may leave more than half of the bracket, or find no bracket, before a longer
step is taken."""


FARTHEST = 5.0
"""Largest factor by which a step increases the distance from the start."""


NOWHERE = 1e8
"""Largest distance, in units of the first guess, at which an end is searched."""


LITTLE_SKEW = 1e-3
"""Skewness whose effect is negligible."""


@dataclass(frozen=True)
class CoefficientInterval:
    """The interval of one variance coefficient and z at zero; an unresolved one begins at 0."""

    z_zero: float
    low: float
    high: float

    @property
    def observable(self) -> bool:
        """Whether zero is rejected."""
        return self.z_zero > Z_DETECT


class Score:
    """Score test of one variance coefficient: z(c) with all other terms refitted.

    Attributes
    ----------
    estimate, deviation : float
        Estimate of the term in the last fit, and its standard deviation.
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
        """Return z(c) as a normal deviate; estimates below ``at_least`` are replaced by it."""
        variances, whitening, white = iterate(
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
        model = self.table.terms @ with_floor(self.table, variances)
        weights, scatter = whitening.weights(contrast), whitening.scatter(contrast)
        third = 2.0 * float(np.sum(weights * scatter**2 / model))
        z = (max(self.estimate, at_least) - c) / self.deviation
        return normal_deviate(z, third / self.deviation**3)


def _inverse(design: Floats) -> tuple[Floats, Floats]:
    """Return the inverse of the normal equations of unit columns, and the norms of the columns."""
    size = np.linalg.norm(design, axis=0)
    size[size == 0.0] = 1.0
    unit = design / size
    return np.linalg.inv(unit.T @ unit + RIDGE * np.eye(len(size))), size


def _contrast(design: Floats, at: int) -> Floats:
    """Return weights w such that w @ (whitened table) is the estimate of one column."""
    inverse, size = _inverse(design)
    return np.asarray(design / size @ inverse[:, at] / size[at])


def standard_errors(design: Floats) -> Floats:
    """Return the standard deviations of the estimates of whitened columns, (columns,)."""
    inverse, size = _inverse(design)
    return np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size


def normal_deviate(z: float, skewness: float) -> float:
    """Return the normal deviate of a gamma variable's standardised value z.

    Cube root of Wilson & Hilferty: ((1 + g z/2)^(1/3) - 1) 6/g + g/6.
    """
    if abs(skewness) < LITTLE_SKEW:
        return z
    root = np.cbrt(max(1.0 + skewness * z / 2.0, 0.0))
    return float((root - 1.0) * 6.0 / skewness + skewness / 6.0)


def coefficient_interval(
    table: Table, term: int, variances: Floats, misfit: Misfit = NO_MISFIT
) -> CoefficientInterval:
    """Return the interval of one variance coefficient about a fit of the table."""
    score = Score(table, term, variances, misfit)
    z_zero = score(0.0)
    deviation = max(score.deviation, white_floor(table))
    # Not the estimate with the weights at zero, if there is another one: it can be far outside.
    middle = variances[term] if variances[term] > 0.0 else max(score.estimate, 0.0)
    if z_zero > Z_DETECT:
        known = [(0.0, z_zero), (middle, score(middle))]
        reach = Z_95 * score.deviation
        high = cross(score, -Z_95, known, middle + reach, np.inf)
        low = cross(score, Z_95, known, middle - reach, 0.0)
        return CoefficientInterval(z_zero, low, high)
    # An estimate below zero counts as zero: the limit then depends on the length of the record.
    known = [(0.0, max(z_zero, 0.0))]
    reach = middle + Z_95 * deviation
    upper = cross(lambda c: score(c, 0.0), -Z_95, known, reach, np.inf)
    return CoefficientInterval(z_zero, 0.0, upper)


def cross(
    z: Callable[[float], float],
    target: float,
    known: Sequence[tuple[float, float]],
    guess: float,
    limit: float,
) -> float:
    """Return the value at which a decreasing z reaches the target, between the last known point and
    the limit.

    Each step goes to the intersection of the target with the hyperbola (alpha - c) / (beta + gamma
    c) through the last three points, which equals z if the deviation is linear in c. A step outside
    the bracket is replaced by half the bracket, or by twice the distance if there is no bracket
    yet.

    Parameters
    ----------
    z : callable
    target : float
    known : sequence of (c, z)
        Points that are known already; the search starts from the last.
    guess : float
        Where to evaluate first.
    limit : float
        Returned if z does not reach the target before.
    """
    points = list(known)
    start, value = points[-1]
    side = 1.0 if limit > start else -1.0
    if side * (value - target) <= 0.0 or guess == start:
        return start
    inner, outer, met = start, limit, False
    c, first, steps = side * min(side * guess, side * limit), abs(guess - start), 0
    while abs(c - start) <= NOWHERE * first:
        value = z(c)
        points.append((c, value))
        width = abs(outer - inner)
        if side * (value - target) <= 0.0:
            outer, met = c, True
        elif c == limit:
            return limit
        else:
            inner = c
        precise = ENOUGH / 2.0 * max(abs(outer - start), ENOUGH * first)
        if abs(value - target) < ENOUGH or (met and abs(outer - inner) <= precise):
            return c
        # z jumps where another term becomes 0: only bisection is certain to converge there.
        steps = steps + 1 if not met or abs(outer - inner) > width / 2.0 else 0
        c = _hyperbola(points[-3:], target)
        far = start + side * FARTHEST * (abs(inner - start) or first)
        ends = (inner, outer if met else side * min(side * outer, side * far))
        if steps > SLOW or not min(ends) < c < max(ends):
            c, steps = (inner + outer) / 2.0 if met else ends[1], 0
    return limit


def _hyperbola(points: Sequence[tuple[float, float]], target: float) -> float:
    """Return the value at which the hyperbola, or the line, through the last points reaches the
    target.
    """
    c, z = np.array(points).T
    columns = [np.ones_like(c), -z, -c * z][: len(points)]
    try:
        alpha, beta, *gamma = np.linalg.solve(np.stack(columns, axis=1), c)
    except np.linalg.LinAlgError:
        return np.nan
    return float((alpha - beta * target) / (1.0 + sum(gamma) * target))


WIDEST_SHAPE = 100.0
"""Largest ratio of a correlation time or frequency to an end of its interval."""


def processes_of(fit: PointFit, table: Table, tau0: float) -> Processes:
    """Return the processes of a fit in SI units; ``table`` is the table of the fit with
    tangents."""
    number = len(fit.options.extras)
    if not number:
        return Processes()
    variances = np.concatenate([fit.variances, np.zeros(number)])
    active = np.flatnonzero((variances != 0.0) | (np.arange(len(variances)) >= len(RANDOM_TERMS)))
    whitening = Whitening.of(weights_at(table, variances, fit.options.misfit))
    errors = np.zeros(len(variances))
    errors[active] = standard_errors(whitening.apply(table.terms[:, active]))
    return processes_in_si(fit.options.extras, variances, errors, tau0)


def processes_in_si(
    extras: Sequence[Extra], variances: Floats, errors: Floats, tau0: float
) -> Processes:
    """Return processes with intervals that are symmetric in the logarithm.

    Parameters
    ----------
    extras : sequence of Extra
    variances : float64 array
        Variance coefficients of the four terms and of the processes.
    errors : (4 + 2 extras,) float64 array
        Standard errors of these, and of the factors of the derivatives of the columns of the
        processes by the logarithms of their shapes.
    tau0 : float
        Sample period in s.
    """
    gauss_markov, sinusoid = [], []
    for k, extra in enumerate(extras, start=len(RANDOM_TERMS)):
        if not variances[k] > 0.0:
            continue
        reach = Z_95 * errors[[k, k + len(extras)]] / float(variances[k])
        of_power, of_shape = np.exp(np.minimum(reach, np.log(WIDEST_SHAPE))).tolist()
        size = math.sqrt(variances[k])
        ends = (size / math.sqrt(of_power), size * math.sqrt(of_power))
        low, high = extra.shape / of_shape, extra.shape * of_shape
        if isinstance(extra, GaussMarkovTerm):
            times = (low * tau0, high * tau0)
            gauss_markov.append(GaussMarkov(size, ends, extra.shape * tau0, times))
        else:
            sinusoid.append(Sinusoid(size, ends, extra.shape / tau0, (low / tau0, high / tau0)))
    return Processes(tuple(gauss_markov), tuple(sinusoid))


Z_DETECT_RAMP = 2.58
"""Normal quantile of 99.5 %: R has a sign, so both tails contribute to 1 % false alarms."""


AGREE = 0.01
"""p value of the test that all segments have the same ramp; below it, they have different ramps."""


@dataclass(frozen=True)
class RampInterval:
    """A ramp per sample, its 95 % interval and verdicts.

    ``shared`` is False if the ramps of the segments differ; the ramp is then that of the longest
    segment.
    """

    value: float
    low: float
    high: float
    observable: bool
    shared: bool


def ramp_interval(
    pooled: PooledTable, axis: int, fit: PointFit, walk: float
) -> RampInterval | None:
    """Return the ramp of one axis, or None if no segment determines it.

    Parameters
    ----------
    pooled : PooledTable
    axis : int
    fit : PointFit
    walk : float
        The upper limit of k.
    """
    variance = fit.ramp_variance
    counted = np.flatnonzero(variance > 0.0)
    if not len(counted):
        return None
    ramps = fit.table.ramps[counted]
    value, deviation = _mean(ramps, variance[counted])
    spread = float(np.sum((ramps - value) ** 2 / variance[counted]))
    shared = len(counted) == 1 or bool(special.chdtrc(len(counted) - 1, spread) > AGREE)
    if not shared:
        counted, ramps = counted[:1], ramps[:1]
        value, deviation = _mean(ramps, variance[counted])

    ignored = np.zeros(len(variance))
    ignored[counted] = np.nan
    # With known ramps, the Allan variance is quadratic in the ramps, and nothing else depends on
    # them.
    at = value + deviation * np.array([-1.0, 0.0, 1.0])
    tables = []
    for c in at:
        known = np.where(np.isnan(ignored), c, np.nan)
        tables.append(fit.options.table(pooled, axis, fit.options.noise(fit.variances), known))
    below, middle, above = (table.avar for table in tables)
    slope, bend = (above - below) / 2.0, (above + below) / 2.0 - middle
    held = fit.variances

    def z(c: float) -> float:
        nonlocal held
        x = (c - value) / deviation
        less = replace(tables[1], avar=middle + slope * x + bend * x * x)
        held = solve(less, held, signed=fit.options.signed, misfit=fit.options.misfit)
        noise = fit.options.noise(with_floor(less, held))
        free, weights = pooled.ramps(axis, noise, ignored)
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
    low = cross(z, Z_95, start, value - half, value - reach)
    high = cross(z, -Z_95, start, value + half, value + reach)
    observable = abs(value) > Z_DETECT_RAMP * bound or abs(start[0][1]) > Z_DETECT_RAMP
    return RampInterval(value, low, high, observable, shared)


def _mean(ramps: Floats, variance: Floats) -> tuple[float, float]:
    """Return the mean weighted by 1/variance, and its standard deviation."""
    weight = 1.0 / variance
    return float(weight @ ramps / weight.sum()), float(1.0 / np.sqrt(weight.sum()))
