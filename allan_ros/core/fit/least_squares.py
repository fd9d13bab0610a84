# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Least squares on the Allan variance: method 'paper', and curves of other tools.

Method 'paper'
--------------
This is the method of Cong, Wang & Yan, Industry and Mine Automation 45(10), 2019. It fits the
polynomial sigma^2(tau) = sum A_p tau^p, p = -2..2, to the Allan variances of non-overlapping
averages up to 1300 s, without weights. Each coefficient is computed from one A_p. The longest
averaging times, which are the least precise, have the most influence, so that A_p is often negative
for Q, K and R. The method gives no intervals.

Curves of other tools
---------------------
`fit_curve` fits a curve that another tool has computed. The covariance of the points is unknown
without the samples. The points are therefore decimated to about four per octave and treated as
independent, each with the degrees of freedom of an overlapping estimate. The intervals are
approximate.
"""

from __future__ import annotations

import math
import sys

import numpy as np
from numpy.typing import ArrayLike

from ..allan.curve import sample_period
from ..allan.sums import AllanSums
from ..errors import AllanError
from ..estimate import UNKNOWN, Z_95, Estimate, Status
from ..findings import Finding, finding
from ..noise import FLICKER_FLOOR
from ..nonnegative import nonnegative_least_squares
from .result import TERMS, AxisFit, Floats, NoiseModel, model_of_terms

LONGEST_TAU = 1300.0
"""Longest averaging time of method 'paper' in s."""

POWERS = (-2, -1, 0, 1, 2)
"""Exponents of tau, in the order of `TERMS`."""

PAPER_FACTORS = (3.0, 1.0, FLICKER_FLOOR, 1.0 / 3.0, 0.5)
"""Factors that convert the squares of Q, N, B, K and R to the coefficients A_p of tau^p in the
Allan variance: 3 Q^2, N^2, (2 ln2/pi) B^2, K^2/3 and R^2/2 (Cong et al. 2019, eq. 3; IEEE Std
952-1997 annex C)."""


def fit_paper(sums: AllanSums) -> NoiseModel:
    """Fit sum A_p tau^p to the Allan variances of all axes (Cong et al. 2019).

    A term whose A_p is negative has no value, and a finding reports the term. If fewer averaging
    times up to `LONGEST_TAU` have data than there are terms, no term has a value, and a finding
    reports this.

    Raises
    ------
    AllanError
        If no segment has two samples.
    """
    tau0 = sample_period(sums)
    tau = sums.m * tau0
    is_fitted = (tau <= LONGEST_TAU) & (sums.group_count > 0)
    columns = tau[is_fitted, None] ** np.array(POWERS, float)
    scale = np.sqrt((columns**2).sum(axis=0))
    points = int(is_fitted.sum())
    findings: list[Finding] = []
    axes = {}
    if points < len(TERMS):
        findings.append(finding('too_few_points', sums.axes, points=points, needed=len(TERMS)))
    for i, (axis, sign) in enumerate(zip(sums.axes, _signs_of_ramps(sums))):
        a = np.full(len(TERMS), np.nan)
        if points >= len(TERMS):
            a = (np.linalg.pinv(columns / scale) / scale[:, None]) @ sums.group_avar[is_fitted, i]
        axes[axis] = _axis_fit(a / PAPER_FACTORS, sign)
        negative_terms = ', '.join(term for term, value in zip(TERMS, a) if value < 0.0)
        if negative_terms:
            findings.append(finding('negative_coefficient', (axis,), terms=negative_terms))
    return NoiseModel('paper', tau0, axes, tuple(findings))


def _signs_of_ramps(sums: AllanSums) -> list[int]:
    """Return the sign of the least-squares slope of the block means, for each axis."""
    slopes = np.zeros(len(sums.axes))
    for means in sums.means:
        t = np.arange(len(means.values)) - (len(means.values) - 1) / 2.0
        slopes += t @ means.values
    return [int(sign) for sign in np.sign(slopes)]


def _axis_fit(squares: Floats, sign: int) -> AxisFit:
    """Return the fit of an axis; a term whose square is not above 0 has no value.

    ``squares``, (terms,), are the squared coefficients in SI, and ``sign`` is the sign of the ramp.
    """
    noise = dict.fromkeys(TERMS, UNKNOWN)
    for term, square in zip(TERMS, squares.tolist()):
        if square > 0.0:
            noise[term] = Estimate(math.copysign(math.sqrt(square), sign if term == 'R' else 1))
    return AxisFit(noise, model_of_terms(noise))


POINTS_PER_OCTAVE = 4
"""Number of intervals per octave into which a curve of another tool is divided. The first point in
each interval is used."""

DEFAULT_RECORD = 9.0
"""Length of a recording divided by the longest averaging time of its curve, if the length is
unknown. Most tools end their curves at a ninth of the recording."""

FREEDOM_PER_AVERAGE = 0.75
"""Degrees of freedom of an overlapping Allan variance at the averaging time tau, divided by
L/tau - 1, where L is the length of the recording."""

LEAST_ERROR = 0.05
"""Smallest relative standard error of an Allan variance. It accounts for errors that neighboring
points of a curve have in common, because the points are correlated."""

LEAST_POINTS = 6
"""Fewest points of a curve after decimation: one more than there are terms."""

RESOLVED = 2.33
"""A coefficient is resolved if its square is at least this multiple of the standard error of the
square. The expected rate of false alarms is 1 % (one-sided)."""


def fit_curve(tau: ArrayLike, adev: ArrayLike, record: float | None = None) -> AxisFit:
    """Fit noise coefficients to one Allan deviation curve by least squares on relative residuals.

    Parameters
    ----------
    tau : (points,) array
        Averaging times in s, in any order. Times that are not between 1e-12 and 1e12 are ignored.
    adev : (points,) array
        Allan deviations in SI. Values that are not between 1e-30 and 1e30 are ignored.
    record : float, optional
        Length of the recording in s; by default, nine times the longest averaging time that is
        used.

    Returns
    -------
    AxisFit
        Fit in SI. The intervals are approximate, and R is not fitted.

    Raises
    ------
    AllanError
        If fewer than `LEAST_POINTS` points remain after at most five valid points per octave are
        chosen. Also if ``record`` is not finite or is shorter than twice the longest averaging time
        of these points.

    Examples
    --------
    >>> import numpy as np
    >>> tau = np.geomspace(0.1, 1000.0, 60)
    >>> fit = fit_curve(tau, np.sqrt(1e-6 / tau + 1e-12 * tau / 3.0))
    >>> round(fit.noise['N'].value, 6), round(fit.noise['K'].value, 8)
    (0.001, 1e-06)
    """
    tau, avar = _decimated(np.asarray(tau, float), np.asarray(adev, float))
    if record is not None and not 2.0 * float(tau[-1]) <= record <= sys.float_info.max:
        raise AllanError(
            f'a recording of {record!s:.40} s has no average over {tau[-1]:g} s: give a length of '
            f'at least {2.0 * tau[-1]:g} s'
        )
    seconds = record or DEFAULT_RECORD * float(tau[-1])
    dof = np.maximum(FREEDOM_PER_AVERAGE * (seconds / tau - 1.0), 1.0)
    relative_errors = np.sqrt(2.0 / dof + LEAST_ERROR**2)
    unit_avar = (tau[:, None] ** np.array(POWERS, float) * PAPER_FACTORS)[:, : TERMS.index('R')]
    model = avar
    for _ in range(3):  # standard errors from the measured curve, then from the model
        rows = unit_avar / (relative_errors * model)[:, None]
        norms = np.linalg.norm(rows, axis=0)
        squares = nonnegative_least_squares(rows / norms, avar / (relative_errors * model)) / norms
        model = np.maximum(unit_avar @ squares, np.finfo(float).tiny)
    errors = np.sqrt(np.diag(np.linalg.pinv((rows / norms).T @ (rows / norms)))) / norms
    noise = {
        term: _coefficient(float(square), float(error))
        for term, square, error in zip('QNBK', squares, errors)
    }
    noise['R'] = UNKNOWN
    return AxisFit(noise, model_of_terms(noise))


def _decimated(tau: Floats, adev: Floats) -> tuple[Floats, Floats]:
    """Return ascending averaging times, and the squares of Allan deviations at these times.

    There are at most 5 points per octave.

    Raises AllanError if fewer than `LEAST_POINTS` points remain.
    """
    # with these limits, no product of powers in the fit overflows
    is_valid = (tau > 1e-12) & (tau < 1e12) & (adev > 1e-30) & (adev < 1e30)
    order = np.argsort(tau[is_valid])
    tau, avar = tau[is_valid][order], adev[is_valid][order] ** 2
    if len(tau):
        bins = np.round(np.log2(tau / tau[0]) * POINTS_PER_OCTAVE)
        first_points = np.unique(bins, return_index=True)[1]
        tau, avar = tau[first_points], avar[first_points]
    if len(tau) < LEAST_POINTS:
        raise AllanError(f'the curve has {len(tau)} usable points: give at least {LEAST_POINTS}')
    return tau, avar


def _coefficient(square: float, error: float) -> Estimate:
    """Return a coefficient with its interval or its upper limit.

    ``square`` is the square of the coefficient, and ``error`` is the standard error of the square.
    """
    value, high = math.sqrt(square), math.sqrt(square + Z_95 * error)
    if square < RESOLVED * error or not square:
        status: Status = 'likely' if square > error else 'not_observable'
        return Estimate(value or None, None, high, status)
    return Estimate(value, (math.sqrt(max(square - Z_95 * error, 0.0)), high))
