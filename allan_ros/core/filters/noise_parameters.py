# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise parameters of a filter, computed from the noise models of the axes.

N and K are continuous-time noise densities: roots of two-sided power spectral densities. They are
the fitted coefficients (`axis_level`) or the parameters of a reduced-order model (`reduce_axis`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress

from ..check import Check, check_limits
from ..errors import AllanError
from ..estimate import Estimate
from ..fit.result import AxisFit
from ..imu import AXES, SENSORS
from ..noise import Model
from .growth import interval_models
from .reductions import HORIZON_S, FilterLevel, Reduction, States, reduce_model


def axis_level(axis: str, fit: AxisFit, term: str) -> FilterLevel:
    """Return the fitted coefficient of a term, or its 95 % upper limit if it is not resolved.

    With the limit, a filter overestimates the noise and gives its other sensors more weight.
    ``axis`` is the name of the axis in messages. Raises AllanError if there is neither a positive
    estimate nor a finite limit.
    """
    coefficient = fit.noise[term].magnitude if term == 'R' else fit.noise[term]
    value, limit = coefficient.value, coefficient.upper95
    if coefficient.status == 'estimated' and value is not None and 0.0 < value < math.inf:
        return FilterLevel(Estimate(value, coefficient.ci95, name=term, axis=axis))
    if limit is None or not 0.0 < limit < math.inf:
        raise AllanError(
            f'{term} of {axis} is not known, not even as a limit: record longer, or fit with '
            'method likelihood'
        )
    unresolved = Estimate(None, upper95=limit, status='not_observable', name=term, axis=axis)
    return FilterLevel(unresolved)


def reduce_axis(
    axis: str, fit: AxisFit, states: States = 'walk', horizon: float = HORIZON_S
) -> Reduction:
    """Return the noise model of one axis, reduced to the states of a filter.

    N is replaced by its upper limit if it is not resolved, and so is K if the model has no drift.

    ``states`` are the states with which the filter models the bias, and ``horizon`` the longest
    time in s that it integrates without a correction. ``axis`` is the name of the axis in messages.

    The ``levels`` of the result are N and, if it has a random walk, K. The interval of an increased
    value ranges over the reductions of the models at the lower and at the upper ends of the 95 %
    intervals of all coefficients.

    Raises
    ------
    AllanError
        If a required coefficient has neither a value nor a limit.
    """
    white, walk = axis_level(axis, fit, 'N'), None
    model = fit.model.changed(N=white.value)
    resolved_walk = model.value('K')
    reduction = reduce_model(model, states, horizon)
    # without drift, or if all drift is fast and became white noise
    if not model.has_drift or (states == 'walk' and not reduction.model.value('K')):
        walk = axis_level(axis, fit, 'K')
        reduction = reduce_model(model.changed(K=walk.value), states, horizon)
    n, k = reduction.model.value('N'), reduction.model.value('K')
    raises_walk = walk is None and k > 1.001 * resolved_walk
    raises_white = n > 1.001 * white.value
    if walk is None and k > 0.0:
        walk = FilterLevel(Estimate(k, fit.noise['K'].ci95, name='K', axis=axis))
    if raises_walk or raises_white:
        ends = interval_models(fit) if states in ('none', 'walk') else None
        of_ends = [reduce_model(one, states, horizon).model for one in ends or ()]
        if walk is not None and raises_walk:
            measured = resolved_walk if fit.noise['K'].status == 'estimated' else 0.0
            walk = walk.raised(k, measured, _range(k, [one.value('K') for one in of_ends]))
        if raises_white:
            white = white.raised(n, white.value, _range(n, [one.value('N') for one in of_ends]))
    return reduction._replace(levels={'N': white, **({'K': walk} if walk else {})})


def _range(value: float, ends: Sequence[float]) -> tuple[float, float] | None:
    return (min(*ends, value), max(*ends, value)) if ends else None


Variances = tuple[float, float, float]
"""Variances of x, y and z, in the squared unit of the samples."""


def white_variances(
    axes: Mapping[str, AxisFit], rate: float, inflation: float = 1.0, horizon: float = 0.0
) -> dict[str, Variances]:
    """Return the sample variances (inflation N)^2 f of x, y, z for each sensor, 'gyro' and 'accel'.

    ``rate`` is the sample rate f in Hz. A sensor is left out if N of an axis has neither a value
    nor a limit. If ``horizon`` (in s) is not 0, N is increased until white noise alone covers the
    predicted error growth up to this time, for filters without a state for the bias.
    """
    stds: dict[str, float] = {}
    for name, fit in axes.items():
        with suppress(AllanError):
            if horizon:
                white = reduce_axis(name, fit, 'none', horizon).model.value('N')
            else:
                white = axis_level(name, fit, 'N').value
            stds[name] = white * rate**0.5
    variances = {}
    for sensor, rows in SENSORS.items():
        known = [stds[name] for name in AXES[rows] if name in stds]
        if len(known) == 3:
            x, y, z = ((inflation * std) ** 2 for std in known)
            variances[sensor] = (x, y, z)
    return variances


def white_ratio(axes: Mapping[str, AxisFit], horizon: float) -> float:
    """Return how well the densities of `white_variances` with a horizon are known.

    It is the largest ratio of the upper to the lower end of their 95 % intervals; infinite if one
    has no interval.
    """
    ratios = [1.0]
    for fit in axes.values():
        ends = interval_models(fit) or (Model(),) * 2
        low, high = (reduce_model(one, 'none', horizon).model.value('N') for one in ends)
        ratios.append(high / low if low > 0.0 else math.inf)
    return max(ratios)


def measure_inflation(
    rest: Mapping[str, AxisFit], running: Mapping[str, AxisFit], horizon: float = HORIZON_S
) -> dict[str, dict[str, Check]]:
    """Return the increase of N and K due to running motors: axis -> term -> comparison.

    ``rest`` and ``running`` are the fits of a robot at rest, with motors off and with motors on. N
    and K are taken from models reduced to white noise and a random walk. ``horizon`` is the
    longest time in s that the filter integrates without a correction.

    Raises
    ------
    AllanError
        If there is no common axis, or N or K of an axis has neither a value nor a limit.
    """
    common = [axis for axis in rest if axis in running]
    if not common:
        raise AllanError('the two results have no axis in common: give two recordings of one IMU')
    inflation = {}
    for axis in common:
        quiet, loud = (
            reduce_axis(axis, fits[axis], 'walk', horizon).levels for fits in (rest, running)
        )
        inflation[axis] = {
            term: check_limits(
                axis, term, 'motors off', Estimate(loud[term].value), upper=quiet[term].value
            )
            for term in 'NK'
        }
    return inflation
