# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The default method: generalised least squares with the model's own covariance, and intervals."""

from __future__ import annotations

import math

import numpy as np

from ..allan.sums import AllanSums
from ..findings import Finding
from .findings import explain, explain_nothing, joined
from .intervals import CoefficientInterval, RampInterval, coefficient_interval, ramp_interval
from .model import (
    RANDOM_TERMS,
    TERMS,
    AxisFit,
    Coefficient,
    Floats,
    GaussMarkov,
    NoiseModel,
    Processes,
    Sinusoid,
    coefficient_to_si,
)
from .select import Candidate, SelectedOptions, select_options
from .solve import K, Misfit, N, Q, solve
from .table import GaussMarkovTerm, PooledTable, Table

LEAST_FACTORS = 5
"""With no more averaging factors than terms a table says nothing of the terms."""

AT_AN_END = 1e-9
"""A value this close to an end of its interval, relative, stands on it: the rest is rounding."""


def fit_gls(sums: AllanSums) -> NoiseModel:
    """Return the five terms of every axis with 95 % intervals and verdicts.

    Never fails for want of data: a term of which the sums say nothing has neither value nor limit.
    """
    evidence = PooledTable(sums)
    tau0 = sums.tau0 or 1.0
    axes: dict[str, AxisFit] = {}
    findings: list[Finding] = []
    for a, name in enumerate(sums.axes):
        fit, found = _fit_axis(evidence, a, tau0)
        axes[name] = fit
        findings += found
    return NoiseModel('gls', tau0, axes, joined(findings))


def _fit_axis(evidence: PooledTable, axis: int, tau0: float) -> tuple[AxisFit, list[Finding]]:
    """Return the fit of one axis, and what to know of it."""
    constant = evidence.is_noiseless(axis)
    if constant or len(evidence.m) <= LEAST_FACTORS:
        return _nothing(), explain_nothing(evidence, axis, constant)
    chosen = select_options(evidence, axis)
    table, power, frame = chosen.fit.table, chosen.fit.power, chosen.fit.frame
    if len(table.m) <= LEAST_FACTORS:
        return _nothing(), explain_nothing(evidence, axis, constant)
    intervals = [coefficient_interval(table, t, power, frame.misfit) for t in range(len(power))]
    values = _consistent(table, power, intervals, frame.misfit)
    noise = {
        name: _coefficient(name, float(values[t]), intervals[t], tau0)
        for t, name in enumerate(RANDOM_TERMS)
    }
    if chosen.filtered or frame.m_min > 1:
        noise['Q'] = _unseen(None, np.inf)
    elif noise['Q'].status == 'not_observable':
        # A q that cannot be told from 0 nearly doubles the error of N; its interval keeps q.
        others = tuple(t for t in range(len(power)) if t != Q)
        alone = solve(table, power, columns=others, misfit=frame.misfit)
        value = _consistent(table, alone, intervals, frame.misfit)[N]
        noise['N'] = _coefficient('N', float(value), intervals[N], tau0)
    ramp = ramp_interval(evidence, axis, chosen.fit, intervals[K].upper)
    noise['R'] = _ramp(ramp, tau0)
    processes = _processes(chosen, intervals[len(RANDOM_TERMS) :], tau0)
    fit = AxisFit(noise, frame.misfit.size, frame.m_min, chosen.first.z, processes)
    return fit, explain(evidence, axis, chosen, fit, ramp, tau0)


def _consistent(
    table: Table, power: Floats, intervals: list[CoefficientInterval], misfit: Misfit
) -> Floats:
    """Return the powers, those outside of their interval replaced by what the interval is about.

    Intervals leave q its sign, values do not. Where a negative q matters, in one record of a
    hundred, a value without it would lie outside and claim to be exact on one side.
    """
    above, below = 1.0 + AT_AN_END, 1.0 - AT_AN_END
    seen = [(t, each) for t, each in enumerate(intervals) if each.observable]
    outside = [t for t, i in seen if not above * i.low < power[t] < below * i.high]
    if not outside:
        return power
    out = power.copy()
    out[outside] = solve(table, power, signed=True, misfit=misfit)[outside]
    return out


def _coefficient(
    name: str, power: float, interval: CoefficientInterval, tau0: float
) -> Coefficient:
    """Return a random term in SI units."""
    if not (interval.observable and math.isfinite(interval.high)):
        return _unseen(
            coefficient_to_si(name, power, tau0), coefficient_to_si(name, interval.upper, tau0)
        )
    ends = (min(interval.low, power), max(interval.high, power))
    return Coefficient(
        coefficient_to_si(name, power, tau0),
        (coefficient_to_si(name, ends[0], tau0), coefficient_to_si(name, ends[1], tau0)),
    )


def _ramp(ramp: RampInterval | None, tau0: float) -> Coefficient:
    """Return the ramp in SI units, its size and its sign."""
    if ramp is None:
        return _unseen(None, np.inf)
    sign = int(np.sign(ramp.value))
    near, far = sorted(end * (sign or 1) / tau0 for end in (ramp.low, ramp.high))
    if ramp.observable:
        return Coefficient(abs(ramp.value) / tau0, (max(near, 0.0), far), sign=sign)
    return _unseen(abs(ramp.value) / tau0, max(-near, far), sign)


def _unseen(value: float | None, upper: float, sign: int = 0) -> Coefficient:
    """Return a term that is not observable, with its limit if the sums set any."""
    limit = upper if np.isfinite(upper) else None
    return Coefficient(value or None, None, limit, 'not_observable', sign)


def _nothing() -> AxisFit:
    """Return the fit of an axis that says nothing."""
    return AxisFit({term: _unseen(None, np.inf) for term in TERMS})


def _size_ends(term: Candidate, power: float, interval: CoefficientInterval) -> tuple[float, float]:
    """Return the interval of the size of an extra term: at its shape, and over its shapes.

    The two are independent, so their half-widths add as squares.
    """
    low = math.hypot(power - min(interval.low, power), power * (1.0 - term.power_low))
    high = math.hypot(max(interval.high, power) - power, power * (term.power_high - 1.0))
    return math.sqrt(max(power - low, 0.0)), math.sqrt(power + high)


def _processes(
    chosen: SelectedOptions, intervals: list[CoefficientInterval], tau0: float
) -> Processes:
    """Return the extra terms in SI units."""
    gauss_markov: list[GaussMarkov] = []
    sinusoid: list[Sinusoid] = []
    powers = chosen.fit.power[len(RANDOM_TERMS) :]
    for term, interval, power in zip(chosen.terms, intervals, powers):
        size = math.sqrt(max(float(power), 0.0))
        ends = _size_ends(term, float(power), interval)
        shape, low, high = term.extra.shape, term.low, term.high
        if isinstance(term.extra, GaussMarkovTerm):
            drift = GaussMarkov(size, ends, shape * tau0, (low * tau0, high * tau0))
            gauss_markov.append(drift)
        else:
            sinusoid.append(Sinusoid(size, ends, shape / tau0, (low / tau0, high / tau0)))
    return Processes(
        tuple(sorted(gauss_markov, key=lambda p: p.correlation_time)),
        tuple(sorted(sinusoid, key=lambda p: p.frequency)),
    )
