# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Coefficients of one axis in SI, with intervals and limits, from the selected model.

A fit has variances in units of `AxisData.scale`, and shapes in samples. This module converts
variances and shapes to the terms and processes of a `Model` in SI, with the covariance of the
squared coefficients.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..estimate import RESOLVED_HALF_WIDTHS, UNKNOWN, Z_95, Estimate, Status
from ..noise import RANDOM_TERMS, Model, Part, Process
from ..noise.model import Covariance
from ..noise.process import GAIN_RESOLVED
from ..noise.processes.low_pass import LowPass
from .frequency_range import SelectedModel
from .likelihood import (
    AxisData,
    Fit,
    Interval,
    RampEstimate,
    Shape,
    information_with_shapes,
    inverse,
    profile_interval,
    ramp_estimate,
)
from .result import AxisFit, Floats, Q


def without_estimates() -> AxisFit:
    """Return the result for an axis that cannot be fitted."""
    return AxisFit(dict.fromkeys('QNBKR', UNKNOWN))


class Errors(NamedTuple):
    """Errors of the coefficients and shapes of a fit, in the units of the fit."""

    information: Floats  # Fisher information of the coefficients, then of the shapes

    # covariance of the coefficients, which includes the uncertainty of the shapes; 0 for
    # coefficients that are not in `Fit.free`
    covariance: Floats
    # for each fitted shape parameter: coefficient times standard error of the parameter's logarithm
    shape_errors: Mapping[Shape, float]

    @classmethod
    def of(cls, data: AxisData, fit: Fit, known: Sequence[Process]) -> Errors:
        """Return the errors of a fit; the shapes of the processes ``known`` have no errors."""
        shapes = [
            Shape(k, parameter)
            for k, process in enumerate(fit.components)
            for parameter in process.parameters
            if fit.p[k] > 0.0 and process not in known
        ]
        information = information_with_shapes(data, fit, shapes)
        number = len(fit.p)
        free = [*fit.free, *range(number, len(information))]
        covariance = np.zeros_like(information)
        covariance[np.ix_(free, free)] = inverse(information[np.ix_(free, free)])
        shape_errors = np.sqrt(np.maximum(np.diag(covariance)[number:], 0.0))
        return cls(
            information, covariance[:number, :number], dict(zip(shapes, shape_errors.tolist()))
        )


def axis_fit(selected: SelectedModel, tau0: float, brief: bool = False) -> AxisFit:
    """Return the result for one axis: its terms with intervals or limits, and its model, in SI.

    ``tau0`` is the sample period in s. A ``brief`` recording is too short for drift: B, K and R get
    no values.
    """
    rules, data, start = selected.rules, selected.rules.data, selected.fit
    fit = data.solve(start.components, start.columns, start.p, signed=rules.signed)
    tested = selected._replace(fit=fit)
    errors = Errors.of(data, fit, rules.base)
    intervals = [
        profile_interval(data, fit, i, errors.information) for i in range(len(RANDOM_TERMS))
    ]
    if not rules.signed and intervals[Q].gain <= GAIN_RESOLVED:
        # if an unresolved Q were fitted, the error of N would be nearly twice as large
        fit = data.solve(fit.components, fit.columns, fit.p, {Q: 0.0})
    variances, covariance = fit.p * data.scale, errors.covariance * data.scale**2
    noise = {
        term.letter: random_coefficient(
            term,
            variance=float(variances[i]),
            error=math.sqrt(covariance[i, i]),
            interval=intervals[i].times(data.scale),
            tau0=tau0,
        )
        for i, term in enumerate(RANDOM_TERMS)
    }
    ramp = ramp_estimate(data, fit)
    ramp = None if ramp is None else ramp.times(math.sqrt(data.scale) / tau0)
    noise['R'] = _ramp(ramp)
    if rules.signed:
        noise['Q'] = UNKNOWN
    if brief:
        noise |= dict.fromkeys('BKR', UNKNOWN)
    # a term that another process replaces is not in the model
    values = {
        term.letter: 0.0 if component.parameters else noise[term.letter].value or 0.0
        for term, component in zip(RANDOM_TERMS, fit.components)
    }
    values['R'] = 0.0 if brief else _ramp_of_model(ramp, noise['R'].resolved)
    order = _indices_with_shape(fit)
    parts = [
        *Model.of(**values).parts,
        *(_part(fit, k, errors, data.scale, tau0) for k in order),
    ]
    low_pass = selected._replace(fit=fit).low_pass * data.scale * tau0**2
    if low_pass:
        parts.append(Part(LowPass(), low_pass))
    return AxisFit(
        noise=noise,
        model=Model(tuple(parts), _covariance(fit.components, covariance, order, tau0)),
        m_min=selected.shortest_factor,
        filtered=bool(rules.signed),
        gof_z=tested.goodness,
        lack_of_fit=selected.lack_of_fit(tau0),
    )


def random_coefficient(
    term: Process, variance: float, error: float, interval: Interval, tau0: float
) -> Estimate:
    """Return the coefficient of a random term in SI, with its interval or its upper limit.

    It has neither an interval nor a limit if the upper end of the interval is infinite.

    Parameters
    ----------
    term : Process
        One of `RANDOM_TERMS`.
    variance : float
        Square of the coefficient in the squared unit of the samples; the unit of time is the sample
        period.
    error : float
        Standard error of ``variance``, in the same unit.
    interval : Interval
        95 % interval of ``variance``, in the same unit.
    tau0 : float
        Sample period in s.
    """
    value, low, high = (
        term.coefficient_of(v, tau0) for v in (variance, interval.low, interval.high)
    )
    if interval.gain > GAIN_RESOLVED and math.isfinite(high):
        return Estimate(value, (min(low, value), max(high, value)))
    status: Status = 'likely' if variance > error > 0.0 else 'not_observable'
    limit = max(high, value) if math.isfinite(high) else None
    return Estimate(value or None, None, limit, status)


def _ramp(ramp: RampEstimate | None) -> Estimate:
    """Return the estimate of a ramp, with its sign; unknown if ``ramp`` is None."""
    if ramp is None:
        return UNKNOWN
    size, half_width = abs(ramp.value), ramp.half_width
    if size > RESOLVED_HALF_WIDTHS * half_width:
        estimate = Estimate(size, (max(size - half_width, 0.0), size + half_width))
    else:
        limit = size + half_width if math.isfinite(half_width) else None
        estimate = Estimate(size or None, None, limit, 'not_observable')
    return estimate.times(-1.0) if ramp.value < 0.0 else estimate


def _ramp_of_model(ramp: RampEstimate | None, resolved: bool) -> float:
    """Return the ramp of the model in SI.

    The random processes of the fit alone cause a ramp whose variance is ``ramp.error``^2. If the
    ramp is not resolved, this variance is subtracted from the square of the ramp, so that drift is
    not counted twice. The result is 0 if the square is smaller, or if ``ramp`` is None.
    """
    if ramp is None:
        return 0.0
    excess = ramp.value**2 - (0.0 if resolved else ramp.error**2)
    return math.copysign(math.sqrt(max(excess, 0.0)), ramp.value)


def _indices_with_shape(fit: Fit) -> list[int]:
    """Return the indices of the processes with a shape and a variance above 0.

    The indices are sorted by name and shape of the processes.
    """
    processes = fit.components
    indices = (k for k, process in enumerate(processes) if process.parameters and fit.p[k] > 0.0)
    return sorted(indices, key=lambda k: (processes[k].name, processes[k].shape))


def _part(fit: Fit, index: int, errors: Errors, scale: float, tau0: float) -> Part:
    """Return one process of a fit as a part of a model in SI.

    ``index`` is the index of the process in the fit. ``scale`` is the unit of the variances of the
    fit, in the squared unit of the samples.
    """
    variance, process = float(fit.p[index]), fit.components[index]
    value, in_si = process.coefficient_of(variance * scale, tau0), process.in_unit(1.0 / tau0)
    relative_error = math.sqrt(max(float(errors.covariance[index, index]), 0.0)) / variance
    shape_intervals = (
        _around(number, errors.shape_errors.get(Shape(index, parameter), 0.0) / variance)
        for parameter, number in zip(in_si.parameters, in_si.shape)
    )
    return Part(in_si, value, _around(value, relative_error / 2.0), tuple(shape_intervals))


def _around(value: float, relative: float) -> tuple[float, float]:
    """Return the 95 % interval of a positive value, symmetric on a logarithmic scale.

    ``relative`` is the relative standard error of the value.
    """
    factor = math.exp(min(Z_95 * relative, 50.0))
    return value / factor, value * factor


def _covariance(
    components: Sequence[Process], covariance: Floats, order: Sequence[int], tau0: float
) -> Covariance:
    """Return the covariance of the squared coefficients in SI.

    ``order`` contains indices of components, in the order of the model. The first four rows are for
    the random terms, or for the processes that replace them. The following rows are for the
    components in ``order`` that are not among the first four.
    """
    names, factors = [], []
    numbers: Counter[str] = Counter()
    indices = [*range(len(RANDOM_TERMS)), *(k for k in order if k >= len(RANDOM_TERMS))]
    for k in indices:
        process = RANDOM_TERMS[k] if k < len(RANDOM_TERMS) else components[k]
        names.append(process.letter or f'{process.name} {numbers[process.name]}')
        numbers[process.name] += 1
        factors.append(process.coefficient_of(1.0, tau0) ** 2)
    return Covariance(
        tuple(names), covariance[np.ix_(indices, indices)] * np.outer(factors, factors)
    )
