# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Methods 'relative' and 'paper': least squares without the covariance of the curve.

They are kept for comparison, and give no intervals.

'relative' minimises the relative residuals of the overlapped curve with no term negative, as
several open tools do. No decade of tau dominates, but N is less precise than with method gls,
because the short averaging times, which are known best, have no larger weight.

'paper' is Cong, Wang, Yan, Industry and Mine Automation 45(10), 2019: sigma^2(tau) = sum A_p tau^p,
p = -2..2, fitted without weights up to 1300 s over groups that do not overlap, and each coefficient
from its A_p. Long averaging times, which scatter most, have the largest weight, so Q, K and R are
often negative. A finding reports the same fit on overlapping groups, which the paper names as
future work.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..allan.curve import degrees_of_freedom, noise_types_of_avar, sample_period
from ..allan.sums import AllanSums
from ..findings import Finding, finding
from ..imu import sensor_of, to_datasheet
from ..noise import FLICKER_FLOOR, NoiseTerms, term_avar
from .model import TERMS, AxisFit, Coefficient, Floats, NoiseModel
from .solve import nonnegative_least_squares

MIN_GROUPS = 9
"""Averaging times that must fit into the record for method 'relative'. Beyond, a point may be
several times too low by chance, and its relative residual then outweighs all the others."""

LONGEST_TAU = 1300.0
"""Seconds: where the paper's curves end."""

POWERS = (-2, -1, 0, 1, 2)
"""Of tau, in the order of `TERMS`."""

SQUARE_OF = (3.0, 1.0, FLICKER_FLOOR, 1.0 / 3.0, 0.5)
"""A_p over the squared coefficient: 3 Q^2, N^2, (2 ln2/pi) B^2, K^2/3, R^2/2 (the paper's eq. 3;
IEEE Std 952-1997 annex C)."""


def fit_relative(sums: AllanSums) -> NoiseModel:
    """Return the coefficients by relative least squares; a term that is 0 is not resolved."""
    findings: list[Finding] = []
    axes: dict[str, AxisFit] = {}
    tau0, signs = sample_period(sums), _signs_of_ramps(sums)
    unit_terms = term_avar(sums.m, tau0, NoiseTerms(1.0, 1.0, 1.0, 1.0, 1.0))
    short = MIN_GROUPS * sums.m <= sums.samples
    for axis, avar, sign in zip(sums.axes, sums.avar.T, signs):
        used = short & (avar > 0.0)
        squares = np.zeros(len(TERMS))
        points = int(np.count_nonzero(used))
        if points >= len(TERMS):
            relative = unit_terms[used] / avar[used, None]
            squares = nonnegative_least_squares(relative, np.ones(points))
        else:
            findings.append(_too_few((axis,), points))
        axes[axis] = _axis_fit(squares, sign)
    return NoiseModel('relative', tau0, axes, tuple(findings))


def fit_paper(sums: AllanSums) -> NoiseModel:
    """Return the coefficients as the paper computed them.

    A term whose A_p is negative has no value and is reported as a finding. Another finding states
    the fit on overlapping groups and by how much its standard errors are smaller.
    """
    groups, overlapped = fit_polynomials(sums)
    findings: list[Finding] = []
    axes = {}
    points = len(fitted_factors(sums))
    if points < len(TERMS):
        findings.append(_too_few(sums.axes, points))
    for i, (axis, sign) in enumerate(zip(sums.axes, _signs_of_ramps(sums))):
        a = groups.value[:, i]
        axes[axis] = _axis_fit(a / SQUARE_OF, sign)
        negative = ', '.join(term for term, value in zip(TERMS, a) if value < 0.0)
        if negative:
            findings.append(finding('negative_coefficient', (axis,), terms=negative))
        findings += _gain(axis, groups.error[:, i], overlapped.value[:, i], overlapped.error[:, i])
    return NoiseModel('paper', sample_period(sums), axes, tuple(findings))


class Polynomial(NamedTuple):
    """A_-2 .. A_2 and their standard errors, (5, axes) each."""

    value: Floats
    error: Floats


def fitted_factors(sums: AllanSums) -> NDArray[np.int64]:
    """Return the indices of the factors the paper's fit uses: up to 1300 s, at least one group."""
    tau = sums.m * sample_period(sums)
    return np.flatnonzero((tau <= LONGEST_TAU) & (sums.group_count > 0))


def fit_polynomials(sums: AllanSums) -> tuple[Polynomial, Polynomial]:
    """Return the fits on groups that do not overlap and on those that do, at the same factors.

    A = P sigma^2 is linear, so its standard error follows from the variances of the points, 2
    sigma^4/edf, with edf from the noise type and sigma^2 from the overlapped curve, which is more
    precise; their correlation is ignored. NaN with fewer than five points.
    """
    some = fitted_factors(sums)
    m, stride = sums.m[some], sums.stride[some]
    group_avar, avar = sums.group_avar[some], sums.avar[some]
    if len(some) < len(TERMS):
        nothing = np.full((len(TERMS), len(sums.axes)), np.nan)
        return Polynomial(nothing, nothing), Polynomial(nothing, nothing)
    tau = m * sample_period(sums)
    columns = tau[:, None] ** np.array(POWERS, float)
    scale = np.sqrt((columns**2).sum(axis=0))
    solve = np.linalg.pinv(columns / scale) / scale[:, None]
    types = noise_types_of_avar(m, avar, sums.samples)
    fits = []
    for v, starts in ((group_avar, m), (avar, stride)):
        variance = 2.0 * avar**2 / degrees_of_freedom(sums, m, starts, types)
        fits.append(Polynomial(solve @ v, np.sqrt(solve**2 @ variance)))
    return fits[0], fits[1]


def _signs_of_ramps(sums: AllanSums) -> list[int]:
    """Return the sign of the least-squares ramp of the longest segments, for each axis."""
    total = np.zeros(len(sums.axes))
    for segment in sums.segments:
        total += segment.samples * segment.ols_ramp()
    return [int(sign) for sign in np.sign(total)]


def _axis_fit(squares: Floats, sign: int) -> AxisFit:
    """Return the fit of an axis from the squares of its coefficients; none where not above 0."""
    noise = {term: Coefficient(None, status='not_observable') for term in TERMS}
    for term, square in zip(TERMS, squares.tolist()):
        if square > 0.0:
            noise[term] = Coefficient(math.sqrt(square), sign=sign if term == 'R' else 0)
    return AxisFit(noise)


def _too_few(axes: tuple[str, ...], points: int) -> Finding:
    return finding('too_few_points', axes, points=points, needed=len(TERMS))


def _gain(axis: str, error: Floats, a: Floats, error_overlapped: Floats) -> list[Finding]:
    """Return the finding of the fit on overlapping groups, if it resolves a term of this axis."""
    values, gains = [], []
    for k, term in enumerate(TERMS):
        if a[k] > 0.0:
            value = math.sqrt(a[k] / SQUARE_OF[k])
            shown, unit = to_datasheet(term, sensor_of(axis), value)
            values.append(f'{term} {shown:.4g} {unit}')
            gains.append(f'{term} {error[k] / error_overlapped[k]:.2f}')
    if not values:
        return []
    return [finding('overlap_gain', (axis,), values=', '.join(values), gains=', '.join(gains))]
