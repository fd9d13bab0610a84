# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fit method 'gls': generalized least squares with the covariance of the Allan variances.

It gives 95 % intervals and upper limits, adds processes to the five terms where the data need them,
and reports findings.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..allan.sums import AllanSums
from ..findings import Finding
from .findings import axis_findings, findings_without_estimates, merge_equal
from .gls_solver import FitOptions, Misfit, solve
from .intervals import (
    CoefficientInterval,
    RampInterval,
    coefficient_interval,
    limit_of_averages,
    processes_of,
    ramp_interval,
)
from .model import (
    RANDOM_TERMS,
    TERMS,
    AxisFit,
    Coefficient,
    Floats,
    K,
    N,
    NoiseModel,
    Processes,
    Q,
    Sinusoid,
    coefficient_to_si,
)
from .model_selection import select_model
from .processes import GaussMarkovTerm, SinusoidTerm
from .table import PooledTable, Table

LEAST_FACTORS = 5
"""A table with this many averaging factors or fewer is not fitted: there are five terms."""

MAIN_LOBE = 2.0
"""Width of the spectral line of a sinusoid between its zeros, times the length of the record."""

WIDEST_N_INTERVAL = 1.1
"""Largest ratio of the ends of the interval of N for which N is reported if the model includes
sinusoids and fails the test of fit. Above it, the estimate may be wrong by a third."""

END_TOLERANCE = 1e-9
"""Relative tolerance for a value that equals an end of its interval."""


def fit_gls(sums: AllanSums, like: NoiseModel | None = None) -> NoiseModel:
    """Estimate the five terms of every axis by generalized least squares.

    Too few data raise no error: a term that the data do not determine has no value and no limit. If
    ``like`` is given, the processes and shortest averaging times of that fit are used, and no model
    is selected.
    """
    pooled = PooledTable(sums)
    tau0 = sums.tau0 or 1.0
    axes: dict[str, AxisFit] = {}
    findings: list[Finding] = []
    for a, name in enumerate(sums.axes):
        fit, found = _fit_axis(pooled, a, tau0, like.axes[name] if like else None)
        axes[name] = fit
        findings += found
    return NoiseModel('gls', tau0, axes, merge_equal(findings))


def _fit_axis(
    pooled: PooledTable, axis: int, tau0: float, like: AxisFit | None
) -> tuple[AxisFit, list[Finding]]:
    """Return the fit of one axis and its findings."""
    constant = pooled.is_noiseless(axis)
    if constant or len(pooled.m) <= LEAST_FACTORS:
        return _without_estimates(), findings_without_estimates(pooled, axis, constant)
    selected = select_model(pooled, axis, _options_of(like, tau0) if like else None)
    variances, options = selected.fit.variances, selected.fit.options
    if len(selected.fit.table.m) <= LEAST_FACTORS:
        return _without_estimates(), findings_without_estimates(pooled, axis, constant)
    # The columns of the derivatives add the uncertainty of the shapes to the intervals.
    table = options.table(pooled, axis, options.noise(variances), tangents=True)
    variances = np.concatenate([variances, np.zeros(table.terms.shape[1] - len(variances))])
    sizes = range(table.noises + table.lines)
    terms = range(len(RANDOM_TERMS))
    intervals = [coefficient_interval(table, t, variances, options.misfit) for t in terms]
    longest = pooled.segments[0].samples
    # If shapes of processes are fitted as well, the test may reject no value of a coefficient.
    intervals = [
        each
        if math.isfinite(each.high)
        else replace(each, high=limit_of_averages(selected.fit.table, t, longest))
        for t, each in enumerate(intervals)
    ]
    values = _refit_outside_intervals(table, variances, intervals, options.misfit)
    noise = {
        name: _coefficient(name, float(values[t]), intervals[t], tau0)
        for t, name in enumerate(RANDOM_TERMS)
    }
    if selected.filtered or options.m_min > 1:
        noise['Q'] = _unresolved(None, np.inf)
    elif noise['Q'].status == 'not_observable':
        # A q that is not significant nearly doubles the error of N. Only the interval of N allows
        # for q.
        others = tuple(t for t in sizes if t != Q)
        alone = solve(
            selected.fit.table, variances[: len(sizes)], columns=others, misfit=options.misfit
        )
        value = _refit_outside_intervals(
            selected.fit.table, alone.variances, intervals, options.misfit
        )[N]
        noise['N'] = _coefficient('N', float(value), intervals[N], tau0)
    if options.misfit.size and any(isinstance(e, SinusoidTerm) for e in options.extras):
        # A small relative error of a strong sinusoid is as large as the white noise.
        noise['N'] = _limit_if_uncertain(noise['N'])
    ramp = ramp_interval(pooled, axis, selected.fit, intervals[K].high)
    noise['R'] = _ramp(ramp, tau0)
    fit = AxisFit(
        noise,
        options.misfit.size,
        options.m_min,
        selected.first.z,
        _merge_close_sinusoids(
            processes_of(selected.fit, table, tau0), MAIN_LOBE / (pooled.segments[0].samples * tau0)
        ),
        signed=options.signed,
    )
    return fit, axis_findings(pooled, axis, selected, fit, ramp, tau0)


def _options_of(fit: AxisFit, tau0: float) -> FitOptions | None:
    """Return the fit options of a selected model; None for an axis without estimates."""
    if fit.noise['N'].value is None:
        return None
    drifts = fit.processes.gauss_markov
    extras = [GaussMarkovTerm(p.correlation_time / tau0) for p in drifts]
    lines = [SinusoidTerm(line.frequency * tau0) for line in fit.processes.sinusoid]
    walk = not drifts or fit.noise['K'].value is not None
    return FitOptions(fit.m_min, fit.signed, extras=(*extras, *lines), walk=walk)


def _refit_outside_intervals(
    table: Table, variances: Floats, intervals: list[CoefficientInterval], misfit: Misfit
) -> Floats:
    """Replace coefficients outside their interval by those of a fit in which q may be negative."""
    # The intervals of the other terms allow a negative q, but the estimates do not. In about one
    # record in a hundred, an estimate therefore lies outside its interval.
    above, below = 1.0 + END_TOLERANCE, 1.0 - END_TOLERANCE
    resolved = [(t, each) for t, each in enumerate(intervals) if each.observable]
    outside = [t for t, i in resolved if not above * i.low < variances[t] < below * i.high]
    if not outside:
        return variances
    out = variances.copy()
    out[outside] = solve(table, variances, signed=True, misfit=misfit).variances[outside]
    return out


def _coefficient(
    name: str, variance: float, interval: CoefficientInterval, tau0: float
) -> Coefficient:
    """Return a random term in SI units, with its interval or its upper limit."""
    if not (interval.observable and math.isfinite(interval.high)):
        return _unresolved(
            coefficient_to_si(name, variance, tau0), coefficient_to_si(name, interval.high, tau0)
        )
    ends = (min(interval.low, variance), max(interval.high, variance))
    return Coefficient(
        coefficient_to_si(name, variance, tau0),
        (coefficient_to_si(name, ends[0], tau0), coefficient_to_si(name, ends[1], tau0)),
    )


def _limit_if_uncertain(n: Coefficient) -> Coefficient:
    """Return N, or its upper limit if the interval is wider than `WIDEST_N_INTERVAL`."""
    if n.ci95 is None or n.ci95[1] <= WIDEST_N_INTERVAL * n.ci95[0]:
        return n
    return _unresolved(n.value, n.ci95[1])


def _ramp(ramp: RampInterval | None, tau0: float) -> Coefficient:
    """Return the ramp in SI units: its magnitude and its sign."""
    if ramp is None:
        return _unresolved(None, np.inf)
    sign = int(np.sign(ramp.value))
    near, far = sorted(end * (sign or 1) / tau0 for end in (ramp.low, ramp.high))
    if ramp.observable:
        return Coefficient(abs(ramp.value) / tau0, (max(near, 0.0), far), sign=sign)
    return _unresolved(abs(ramp.value) / tau0, max(-near, far), sign)


def _unresolved(value: float | None, upper: float, sign: int = 0) -> Coefficient:
    """Return a coefficient of status 'not_observable'; an infinite limit becomes None."""
    limit = upper if np.isfinite(upper) else None
    return Coefficient(value or None, None, limit, 'not_observable', sign)


def _without_estimates() -> AxisFit:
    """Return the result for an axis that cannot be fitted."""
    return AxisFit({term: _unresolved(None, np.inf) for term in TERMS})


def _merge_close_sinusoids(processes: Processes, resolution: float) -> Processes:
    """Merge sinusoids whose frequencies differ by less than a resolution in Hz."""
    # The mean square of the differences of a sinusoid depends on its phase. To describe this, the
    # fit of a strong sinusoid needs two sinusoids of almost equal frequency.
    out: list[Sinusoid] = []
    for line in processes.sinusoid:
        if out and line.frequency - out[-1].frequency < resolution:
            both = (out.pop(), line)
            size = math.hypot(*(each.amplitude for each in both))
            strong = max(both, key=lambda each: each.amplitude)
            low, high = (end * size / strong.amplitude for end in strong.amplitude_ci95)
            middle = sum(each.frequency * (each.amplitude / size) ** 2 for each in both)
            ends = [end for each in both for end in each.frequency_ci95]
            line = Sinusoid(size, (low, high), middle, (min(ends), max(ends)))
        out.append(line)
    return replace(processes, sinusoid=tuple(out))
