# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Method 'paper': plain least squares over groups that do not overlap.

Cong, Wang, Yan, Industry and Mine Automation 45(10), 2019: sigma^2(tau) = sum A_p tau^p, p = -2..2,
fitted without weights up to 1300 s, and each coefficient from its A_p. It is kept for comparison:
long averaging times, which scatter most, have the largest weight, so Q, K and R are often negative.
The same fit on overlapping groups is reported as well, which the paper names as future work.
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
from ..noise import FLICKER_FLOOR
from .model import TERMS, AxisFit, Coefficient, NoiseModel

Floats = NDArray[np.float64]

LONGEST_TAU = 1300.0
"""Seconds: where the paper's curves end."""

POWERS = (-2, -1, 0, 1, 2)
"""Of tau, in the order of `TERMS`."""

SQUARE_OF = (3.0, 1.0, FLICKER_FLOOR, 1.0 / 3.0, 0.5)
"""A_p over the squared coefficient: 3 Q^2, N^2, (2 ln2/pi) B^2, K^2/3, R^2/2 (the paper's eq. 3;
IEEE Std 952-1997 annex C)."""


class Polynomial(NamedTuple):
    """A_-2 .. A_2 and their standard errors, (5, axes) each."""

    value: Floats
    error: Floats


def fit_paper(sums: AllanSums) -> NoiseModel:
    """Return the coefficients as the paper computed them; no intervals.

    A term whose A_p is negative has no value and is reported as a finding. Another finding carries
    the fit on overlapping groups and by how much its standard errors are smaller.
    """
    groups, overlapped = fit_polynomials(sums)
    findings: list[Finding] = []
    axes = {}
    points = len(fitted_factors(sums))
    if points < len(TERMS):
        findings.append(finding('too_few_points', sums.axes, points=points, needed=len(TERMS)))
    ramp_sign = sign_of_ramp(sums)
    for i, axis in enumerate(sums.axes):
        axes[axis] = AxisFit(
            {
                term: _coefficient(value, ramp_sign[i] if term == 'R' else 0)
                for term, value in _coefficients(groups.value[:, i]).items()
            }
        )
        negative = [t for t, a in zip(TERMS, groups.value[:, i]) if a < 0.0]
        if negative:
            findings.append(finding('negative_coefficient', (axis,), terms=', '.join(negative)))
        gain = _gain(axis, groups, overlapped, i)
        if gain:
            findings.append(gain)
    return NoiseModel('paper', sample_period(sums), axes, tuple(findings))


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


def sign_of_ramp(sums: AllanSums) -> NDArray[np.int64]:
    """Return the sign of the least-squares ramp of the longest segments, (axes,)."""
    total = np.zeros(len(sums.axes))
    for segment in sums.segments:
        total += segment.samples * segment.ols_ramp()
    return np.sign(total).astype(np.int64)


def _coefficients(a: Floats) -> dict[str, float | None]:
    """Return term -> coefficient from one axis's A_-2 .. A_2; None where A is not positive."""
    return {
        term: math.sqrt(value / square) if value > 0.0 else None
        for term, square, value in zip(TERMS, SQUARE_OF, a.tolist())
    }


def _coefficient(value: float | None, sign: int) -> Coefficient:
    if value is None:
        return Coefficient(None, status='not_observable')
    return Coefficient(value, sign=int(sign))


def _gain(axis: str, groups: Polynomial, overlapped: Polynomial, i: int) -> Finding | None:
    """Return the gain of overlapping groups on one axis; None without a comparison."""
    values, gains = [], []
    for k, (term, value) in enumerate(_coefficients(overlapped.value[:, i]).items()):
        if value is None:
            continue
        shown, unit = to_datasheet(term, sensor_of(axis), value)
        values.append(f'{term} {shown:.4g} {unit}')
        gains.append(f'{term} {groups.error[k, i] / overlapped.error[k, i]:.2f}')
    if not values:
        return None
    return finding('overlap_gain', (axis,), values=', '.join(values), gains=', '.join(gains))
