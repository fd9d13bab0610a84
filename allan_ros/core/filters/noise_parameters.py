# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise parameters for a state estimator, computed from the noise models of the axes.

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

    With the limit, a state estimator overestimates the noise and gives other sensors more weight.

    Parameters
    ----------
    axis : str
        Name of the axis in messages.
    fit : AxisFit
        Fit of the axis.
    term : str
        'Q', 'N', 'B', 'K' or 'R'; for R, the magnitude is returned.

    Raises
    ------
    AllanError
        When the term has neither a positive resolved estimate nor a positive finite limit.
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
    """Return the reduced-order model of one axis with its N and K.

    If N is not resolved, its upper limit is used. K or its upper limit is added if the complete
    model has no drift, or if the reduced-order model for 'walk' would have no random walk.

    Parameters
    ----------
    axis : str
        Name of the axis in messages.
    fit : AxisFit
        Fit of the axis.
    states : {'none', 'walk', 'processes'}
        States with which the state estimator models the bias (see `reduce_model`).
    horizon : float
        Longest time in s that the state estimator integrates without a correction.

    Returns
    -------
    Reduction
        ``levels`` are N and, if the model has a random walk or K was added, K. With 'none' and
        'walk', the interval of an increased value comes from the reduced-order models of two
        complete models: one with all coefficients at the lower ends of their 95 % intervals, and
        one with all coefficients at the upper ends. It is unknown with 'processes', or if a term of
        the model has neither an interval nor a limit.

    Raises
    ------
    AllanError
        When N, or K where it is added, has neither a resolved estimate nor a limit.
    """
    white, walk = axis_level(axis, fit, 'N'), None
    model = fit.model.changed(N=white.value)
    resolved_walk = model.value('K')
    reduction = reduce_model(model, states, horizon)
    # the model has no drift, or all its drift is fast and was replaced by white noise
    if not model.has_drift or (states == 'walk' and not reduction.model.value('K')):
        walk = axis_level(axis, fit, 'K')
        reduction = reduce_model(model.changed(K=walk.value), states, horizon)
    n, k = reduction.model.value('N'), reduction.model.value('K')
    raises_walk = walk is None and k > 1.001 * resolved_walk
    raises_white = n > 1.001 * white.value
    if walk is None and k > 0.0:
        walk = FilterLevel(Estimate(k, fit.noise['K'].ci95, name='K', axis=axis))
    if raises_walk or raises_white:
        end_models = interval_models(fit) if states in ('none', 'walk') else None
        end_reductions = [
            reduce_model(end_model, states, horizon).model for end_model in end_models or ()
        ]
        if walk is not None and raises_walk:
            measured = resolved_walk if fit.noise['K'].status == 'estimated' else 0.0
            walk = walk.raised(
                k, measured, _range(k, [end_model.value('K') for end_model in end_reductions])
            )
        if raises_white:
            white = white.raised(
                n, white.value, _range(n, [end_model.value('N') for end_model in end_reductions])
            )
    return reduction._replace(levels={'N': white, **({'K': walk} if walk else {})})


def _range(value: float, ends: Sequence[float]) -> tuple[float, float] | None:
    return (min(*ends, value), max(*ends, value)) if ends else None


Variances = tuple[float, float, float]
"""Variances of x, y and z, in the squared unit of the samples."""


def white_variances(
    axes: Mapping[str, AxisFit], rate: float, inflation: float = 1.0, horizon: float = 0.0
) -> dict[str, Variances]:
    """Return the variance of the white noise of one sample, (inflation N)^2 f, for each axis.

    Parameters
    ----------
    axes : mapping of axis name to AxisFit
        Fits of the axes.
    rate : float
        Sample rate f in Hz.
    inflation : float
        Factor by which N is multiplied.
    horizon : float
        If not 0, the longest time in s that a state estimator without bias states integrates. N is
        then increased until white noise alone predicts at least the error of the complete model.

    Returns
    -------
    dict of 'gyro' and 'accel' to (x, y, z)
        The variances in the squared unit of the samples. A sensor is excluded if N of one of its
        axes has neither a resolved estimate nor a limit, or if an axis is missing. With a horizon,
        the same holds for K of an axis whose model has no drift.
    """
    stds: dict[str, float] = {}
    for name, fit in axes.items():
        with suppress(AllanError):
            if horizon:
                white_noise = reduce_axis(name, fit, 'none', horizon).model.value('N')
            else:
                white_noise = axis_level(name, fit, 'N').value
            stds[name] = white_noise * rate**0.5
    variances = {}
    for sensor, rows in SENSORS.items():
        axis_stds = [stds[name] for name in AXES[rows] if name in stds]
        if len(axis_stds) == 3:
            x, y, z = ((inflation * std) ** 2 for std in axis_stds)
            variances[sensor] = (x, y, z)
    return variances


def white_ratio(axes: Mapping[str, AxisFit], horizon: float) -> float:
    """Return the largest ratio, over all axes, of the upper to the lower end of the interval of N.

    N is increased for a ``horizon`` in s as in `white_variances`. The ratio is infinite if the
    lower end is 0, or if a term of the model of an axis has neither an interval nor a limit.
    """
    ratios = [1.0]
    for fit in axes.values():
        end_models = interval_models(fit) or (Model(),) * 2
        low, high = (
            reduce_model(end_model, 'none', horizon).model.value('N') for end_model in end_models
        )
        ratios.append(high / low if low > 0.0 else math.inf)
    return max(ratios)


def measure_inflation(
    rest: Mapping[str, AxisFit], running: Mapping[str, AxisFit], horizon: float = HORIZON_S
) -> dict[str, dict[str, Check]]:
    """Return the ratios of N and K of a robot with motors on to N and K with motors off.

    N and K are the parameters of reduced-order models with white noise and a random walk.

    Parameters
    ----------
    rest, running : mapping of axis name to AxisFit
        Fits of two recordings of a robot at rest, with motors off and with motors on.
    horizon : float
        Longest time in s that the state estimator integrates without a correction.

    Returns
    -------
    dict of axis name to dict of 'N' or 'K' to Check
        The ratios are `Check.ratio`.

    Raises
    ------
    AllanError
        When the fits have no axis in common, or if N, or K of an axis without another random walk,
        has neither a resolved estimate nor a limit.
    """
    common = [axis for axis in rest if axis in running]
    if not common:
        raise AllanError('the two results have no axis in common: give two recordings of one IMU')
    inflation = {}
    for axis in common:
        levels_off, levels_on = (
            reduce_axis(axis, fits[axis], 'walk', horizon).levels for fits in (rest, running)
        )
        inflation[axis] = {
            term: check_limits(
                axis,
                term,
                'motors off',
                Estimate(levels_on[term].value),
                upper=levels_off[term].value,
            )
            for term in 'NK'
        }
    return inflation
