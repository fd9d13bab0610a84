# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Method 'relative': nonnegative least squares on the curve's relative residuals.

All points of the overlapped curve up to a ninth of the record have the same relative weight, so no
decade of tau dominates, and no term is negative. Several open tools fit in this way. There are no
intervals, and N is less precise than with method gls, because the short averaging times, which are
known best, have no larger weight.
"""

from __future__ import annotations

import math

import numpy as np

from ..allan.curve import sample_period
from ..allan.sums import AllanSums
from ..findings import Finding, finding
from ..noise import NoiseTerms, term_avar
from .model import TERMS, AxisFit, Coefficient, NoiseModel
from .paper import sign_of_ramp
from .solve import nonnegative_least_squares

MIN_GROUPS = 9
"""Averaging times that must fit into the record. Beyond, a point may be several times too low by
chance, and its relative residual then outweighs all the others."""


def fit_relative(sums: AllanSums) -> NoiseModel:
    """Return the coefficients by relative least squares over terms >= 0; no intervals.

    A term that the fit leaves at zero is not resolved and has no value.
    """
    findings: list[Finding] = []
    axes: dict[str, AxisFit] = {}
    tau0, avar, sign = sample_period(sums), sums.avar, sign_of_ramp(sums)
    unit_terms = term_avar(sums.m, tau0, NoiseTerms(1.0, 1.0, 1.0, 1.0, 1.0))
    sure = MIN_GROUPS * sums.m <= sums.samples
    for i, axis in enumerate(sums.axes):
        some = sure & (avar[:, i] > 0.0)
        points = int(np.count_nonzero(some))
        squares = np.zeros(len(TERMS))
        if points >= len(TERMS):
            squares = nonnegative_least_squares(
                unit_terms[some] / avar[some, i, None], np.ones(points)
            )
        else:
            findings.append(finding('too_few_points', (axis,), points=points, needed=len(TERMS)))
        axes[axis] = AxisFit(
            {
                term: Coefficient(math.sqrt(square), sign=int(sign[i]) if term == 'R' else 0)
                if square > 0.0
                else Coefficient(None, status='not_observable')
                for term, square in zip(TERMS, squares.tolist())
            }
        )
    return NoiseModel('relative', tau0, axes, tuple(findings))
