# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fit method 'likelihood': estimates of all axes in SI, with intervals, limits and findings."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from ..allan.sums import AllanSums
from ..estimate import Estimate, Status
from ..findings import Finding, finding
from ..noise import Model, Part, Process
from ..noise.model import Covariance
from ..noise.process import GAIN_RESOLVED
from ..noise.processes.low_pass import LowPass
from ..noise.processes.sinusoid import daily_cycle
from .estimate import SelectedModel, estimate
from .findings import axis_findings, merge_equal
from .likelihood import (
    AxisData,
    Interval,
    RampEstimate,
    Shape,
    information_with_shapes,
    inverse,
    profile_interval,
    ramp_estimate,
)
from .model import (
    RANDOM_TERMS,
    TERMS,
    Z_95,
    AxisFit,
    Floats,
    K,
    LackOfFit,
    NoiseModel,
    Q,
    coefficient_to_si,
)
from .selection import Candidates
from .statistics import Statistics, statistics

RAMP_RESOLVED = 2.58 / 1.96
"""Least |R| in units of the half width of its interval for R to be resolved: two-sided 1 % (1.0 %
of the 900 axes without R)."""

LEAST_DRIFT_S = 10.0
"""Shortest time at rest in s for which B, K and R are estimated."""

LEAST_STATISTICS = 12
"""Fewest bins and contrasts of a fit."""


def fit_likelihood(sums: AllanSums, known: Statistics | None = None) -> NoiseModel:
    """Estimate the noise of every axis by maximum likelihood.

    ``known`` are the statistics of the sums, if already computed.

    Too few data raise no error: a term that the data do not determine has no value and no limit.
    """
    tau0 = sums.tau0 or 1.0
    known = statistics(sums) if known is None else known
    candidates = Candidates(known)
    daily = daily_cycle(known.longest, tau0)
    axes: dict[str, AxisFit] = {}
    findings: list[Finding] = []
    for a, name in enumerate(sums.axes):
        size = len(known.f) + sum(g.high for g in known.groups)
        if size < LEAST_STATISTICS or _is_constant(sums, a):
            axes[name] = without_estimates()
            constant = len(sums.count) > 0 and _is_constant(sums, a)
            id, numbers = (
                ('no_noise', {}) if constant else ('record_too_short', {'samples': sums.samples})
            )
            findings.append(finding(id, (name,), **numbers))
            continue
        if not np.all(np.isfinite(known.power[:, a])):  # the stream reports impossible units
            axes[name] = without_estimates()
            continue
        brief = sums.samples * tau0 < LEAST_DRIFT_S
        try:
            result = estimate(AxisData.of(known, a), candidates, daily)
            axes[name] = axis_fit(result, tau0, brief)
        except np.linalg.LinAlgError:  # a periodic signal: all digits beside it are rounding errors
            axes[name] = without_estimates()
            findings.append(finding('no_noise', (name,)))
            continue
        if brief:
            findings.append(finding('rest_too_short', (name,), rest=sums.samples * tau0))
        findings += axis_findings(sums, a, axes[name], tau0)
    return NoiseModel('likelihood', tau0, axes, merge_equal(findings))


def _is_constant(sums: AllanSums, axis: int) -> bool:
    return not np.any(sums.avar[:, axis] > 0.0)


def without_estimates() -> AxisFit:
    """Return the result for an axis that cannot be fitted."""
    return AxisFit({term: Estimate(None, status='not_observable') for term in TERMS})


def axis_fit(result: SelectedModel, tau0: float, brief: bool = False) -> AxisFit:
    """Return an estimate with its intervals in SI.

    A ``brief`` recording is too short for drift: only N and Q get values.
    """
    rules, data, fit = result.rules, result.rules.data, result.fit
    fit = data.solve(fit.components, fit.columns, fit.p, signed=rules.signed)
    shaped = [
        Shape(k, parameter)
        for k, c in enumerate(fit.components)
        for parameter in c.parameters
        if fit.p[k] > 0.0 and c not in rules.base
    ]
    information = information_with_shapes(data, fit, shaped)
    intervals = [profile_interval(data, fit, i, information) for i in range(len(RANDOM_TERMS))]
    n, scale = len(fit.p), data.scale
    on = [*fit.free, *range(n, len(information))]
    every = np.zeros_like(information)
    every[np.ix_(on, on)] = inverse(information[np.ix_(on, on)])
    covariance = every[:n, :n] * scale**2
    result = result._replace(fit=fit)
    value, number = result.chi_squared if len(data.power) else (0.0, 0.0)
    if not rules.signed and intervals[Q].gain <= GAIN_RESOLVED:
        # A q that is not resolved nearly doubles the error of N.
        fit = data.solve(fit.components, fit.columns, fit.p, {Q: 0.0})
        result = result._replace(fit=fit)
    noise = {
        name: random_coefficient(name, float(fit.p[t]) * scale, covariance[t, t], each, scale, tau0)
        for t, (name, each) in enumerate(zip(RANDOM_TERMS, intervals))
    }
    ramp = ramp_estimate(data, fit)
    if ramp is not None:
        root = math.sqrt(scale)
        ramp = ramp._replace(value=ramp.value * root, error=ramp.error * root)
    noise['R'] = _ramp(ramp, tau0)
    if rules.signed:
        noise['Q'] = Estimate(None, status='not_observable')
    if brief:
        noise |= {t: Estimate(None, status='not_observable') for t in 'BKR'}
    errors = {
        one: math.sqrt(max(every[n + i, n + i], 0.0)) / float(fit.p[one.at])
        for i, one in enumerate(shaped)
        if fit.p[one.at] > 0.0
    }
    parts, order = _processes(fit.components, fit.p * scale, covariance, errors, tau0)
    walk = 0.0 if fit.components[K].parameters else noise['K'].value
    terms = Model.of(
        **{t: noise[t].value or 0.0 for t in 'QNB'},
        K=walk or 0.0,
        R=0.0 if brief else _drift_of_model(ramp, noise['R'].status == 'estimated', tau0),
    )
    low_pass = result.low_pass * scale * tau0**2
    parts += [Part(LowPass(), low_pass)] if low_pass else []
    model = Model((*terms.parts, *parts), _covariance(fit.components, covariance, order, tau0))
    return AxisFit(
        noise,
        model,
        round(4.0 / result.top) if result.top < 0.5 else 1,
        bool(rules.signed),
        # Wilson & Hilferty 1931
        ((value / number) ** (1 / 3) - 1 + 2 / (9 * number)) / math.sqrt(2 / (9 * number))
        if number
        else None,
        tuple(
            LackOfFit(float(f[0]) / tau0, float(f[-1]) / tau0, ratio)
            for o, ratio in sorted(result.lack.items())
            for f in [data.statistics.f[data.statistics.octave == o]]
        ),
    )


def random_coefficient(
    name: str, variance: float, scatter: float, interval: Interval, scale: float, tau0: float
) -> Estimate:
    """Return a random term in SI, with its interval (divided by ``scale``) or its upper limit."""
    value, low, high = (
        coefficient_to_si(name, v, tau0)
        for v in (variance, interval.low * scale, interval.high * scale)
    )
    if interval.gain > GAIN_RESOLVED and math.isfinite(high):
        return Estimate(value, (min(low, value), max(high, value)))
    status: Status = 'likely' if variance > math.sqrt(scatter) > 0.0 else 'not_observable'
    limit = max(high, value) if math.isfinite(high) else None
    return Estimate(value or None, None, limit, status)


def _ramp(ramp: RampEstimate | None, tau0: float) -> Estimate:
    """Return the ramp in SI, with its sign."""
    if ramp is None:
        return Estimate(None, status='not_observable')
    size, half = abs(ramp.value), ramp.half_width
    if size > RAMP_RESOLVED * half:
        found = Estimate(size / tau0, (max(size - half, 0.0) / tau0, (size + half) / tau0))
    else:
        limit = (size + half) / tau0 if math.isfinite(half) else None
        found = Estimate(size / tau0 or None, None, limit, 'not_observable')
    return found.times(-1.0) if ramp.value < 0.0 else found


def _drift_of_model(ramp: RampEstimate | None, resolved: bool, tau0: float) -> float:
    """Return the ramp of the model in SI.

    The other terms alone cause a random ramp, whose variance is ``ramp.error``^2. If the ramp is
    not resolved, this is subtracted from its square, so that drift is not counted twice.
    """
    if ramp is None:
        return 0.0
    excess = ramp.value**2 - (0.0 if resolved else ramp.error**2)
    return math.copysign(math.sqrt(max(excess, 0.0)), ramp.value) / tau0


def _processes(
    components: Sequence[Process],
    p: Floats,
    covariance: Floats,
    errors: Mapping[Shape, float],
    tau0: float,
) -> tuple[list[Part], list[int]]:
    """Return the processes with a shape in SI, and the indices of their coefficients.

    ``errors`` are the relative errors of the numbers of the shapes.
    """
    found = []
    for k, process in enumerate(components):
        variance = float(p[k])
        if not process.parameters or variance <= 0.0:
            continue
        value = process.coefficient_of(variance, tau0)
        process = process.in_unit(1.0 / tau0)
        relative = math.sqrt(max(covariance[k, k], 0.0)) / variance
        ends = (
            _around(process.numbers[parameter.name], errors.get(Shape(k, parameter), 0.0))
            for parameter in process.parameters
        )
        found.append((Part(process, value, _around(value, relative / 2.0), tuple(ends)), k))
    found.sort(key=lambda one: (one[0].process.name, one[0].process.shape))
    return [part for part, _ in found], [k for _, k in found]


def _around(value: float, relative: float) -> tuple[float, float]:
    """Return the 95 % interval of a positive value with a relative standard error."""
    factor = math.exp(min(Z_95 * relative, 50.0))
    return value / factor, value * factor


def _covariance(
    components: Sequence[Process], covariance: Floats, order: list[int], tau0: float
) -> Covariance:
    """Return the covariance of the squared coefficients in SI."""
    order = [k for k in order if k >= len(RANDOM_TERMS)]
    units = [coefficient_to_si(t, 1.0, tau0) ** 2 for t in RANDOM_TERMS]
    names = list(RANDOM_TERMS)
    numbers: Counter[str] = Counter()
    for k in order:
        name = components[k].name
        names.append(f'{name} {numbers[name]}')
        numbers[name] += 1
        units.append(components[k].coefficient_of(1.0, tau0) ** 2)
    at = [*range(len(RANDOM_TERMS)), *order]
    return Covariance(tuple(names), covariance[np.ix_(at, at)] * np.outer(units, units))
