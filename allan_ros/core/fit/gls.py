# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The default method: generalised least squares with the model's own covariance, and intervals."""

from __future__ import annotations

import numpy as np

from ..findings import Finding
from ..sums import AllanSums
from .evidence import Evidence
from .frame import choose_frame
from .intervals import power_interval
from .model import RANDOM_TERMS, to_si
from .point import PointFit
from .ramp_interval import ramp_interval
from .solve import Q, solve
from .values import TERMS, AxisFit, Coefficient, NoiseFit

LEAST_FACTORS = 5
"""With no more averaging factors than terms a table says nothing of the terms."""


def fit_gls(sums: AllanSums) -> NoiseFit:
    """Return the five terms of every axis with 95 % intervals and verdicts.

    Never fails for want of data: a term that the sums say nothing of has no value.
    """
    evidence = Evidence(sums)
    tau0 = sums.tau0 or 1.0
    findings: list[Finding] = []
    axes = {}
    for a, name in enumerate(sums.axes):
        axes[name] = _fit_axis(evidence, a, tau0)
    return NoiseFit('gls', tau0, axes, tuple(findings))


def _fit_axis(evidence: Evidence, axis: int, tau0: float) -> AxisFit:
    """Return the fit of one axis."""
    if not np.any(evidence.sums.sum_sq[:, axis] > 0.0) or len(evidence.m) <= LEAST_FACTORS:
        return AxisFit({term: _unseen(None, np.inf) for term in TERMS})
    chosen = choose_frame(evidence, axis)
    fit = chosen.fit
    if len(fit.table.m) <= LEAST_FACTORS:
        return AxisFit({term: _unseen(None, np.inf) for term in TERMS})
    noise = {}
    walk = np.inf
    misfit, signed = fit.frame.misfit, fit.frame.signed
    best_n = fit.power
    for term, name in enumerate(RANDOM_TERMS):
        interval = power_interval(fit.table, term, fit.power, misfit)
        power = best_n if name == 'N' else fit.power
        if name == 'K':
            walk = interval.upper
        if name == 'Q' and not interval.observable and not signed:
            columns = tuple(c for c in range(len(fit.power)) if c != Q)
            best_n = solve(fit.table, fit.power, columns=columns, misfit=misfit)
        value = to_si(name, float(power[term]), tau0) or None
        if interval.observable and np.isfinite(interval.high):
            low, high = min(interval.low, power[term]), max(interval.high, power[term])
            noise[name] = Coefficient(value, (to_si(name, low, tau0), to_si(name, high, tau0)))
        else:
            noise[name] = _unseen(value, to_si(name, interval.upper, tau0))
    noise['R'] = _ramp(evidence, axis, fit, walk, tau0)
    return AxisFit(noise, misfit, fit.frame.m_min, chosen.first.z)


def _ramp(evidence: Evidence, axis: int, fit: PointFit, walk: float, tau0: float) -> Coefficient:
    """Return the ramp that the segments share, or that of the longest where they disagree."""
    ramp = ramp_interval(evidence, axis, fit, walk)
    if ramp is None:
        return _unseen(None, np.inf)
    sign = int(np.sign(ramp.value))
    near, far = sorted((ramp.low * sign / tau0, ramp.high * sign / tau0))
    if ramp.observable:
        return Coefficient(abs(ramp.value) / tau0, (max(near, 0.0), far), sign=sign)
    return _unseen(abs(ramp.value) / tau0, max(-near, far), sign)


def _unseen(value: float | None, upper: float, sign: int = 0) -> Coefficient:
    """Return a term that is not observable, with its limit if the sums set any."""
    limit = upper if np.isfinite(upper) else None
    return Coefficient(value or None, None, limit, 'not_observable', sign)
