# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise parameters for a state estimator, from fitted coefficients and reduced-order models.

N and K are continuous-time noise densities: roots of two-sided power spectral densities. They are
the fitted coefficients (`axis_level`) or the parameters of a reduced-order model (`reduce_axis`).

Reduced-order models
--------------------
A state estimator with the parameters N and K underestimates its error if the sensor also has bias
instability. A `Reduction` has larger parameters where needed. With these, the state estimator
predicts at least the error of the complete model at the compared horizons. With the bias model
'processes', it may predict 5 % less, or still less if the longest horizon is shorter than 1 s.

Horizons
--------
A horizon is a time of integration without a correction. It is assumed that the bias was averaged,
before the integration, over a time of the length of the longest horizon.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..check import Check, check_limits
from ..errors import AllanError
from ..estimate import Estimate
from ..fit.result import AxisFit
from ..noise import Model, Process
from ..noise.model import BY_LETTER
from .state_space import has_states, state_space, white_density

Floats = NDArray[np.float64]

States = Literal['none', 'walk', 'processes']
"""Bias model of a state estimator: no bias state ('none'), a random walk ('walk'), or a random walk
and all other processes that have states ('processes')."""

HORIZON_S = 30.0
"""Longest horizon in s by default: a state estimator that is corrected by a camera or a lidar
integrates for at most this time between two corrections."""

HORIZONS_PER_RANGE = 30
"""Number of horizons at which the predicted errors of two models are compared."""

POOR_RATIO = 2.0
"""Largest accepted ratio of the error that a reduced-order model predicts to the error that the
complete model predicts. The smallest accepted ratio is the inverse of this number."""


def shortest_horizon(longest: float) -> float:
    """Return the shortest horizon in s: 1 s, or a tenth of ``longest`` if this is shorter."""
    return min(1.0, longest / 10.0)


def horizon_text(longest: float) -> str:
    """Return the range of horizons up to ``longest`` as text.

    >>> horizon_text(30.0)
    '1 to 30 s'
    """
    return f'{shortest_horizon(longest):g} to {longest:g} s'


class FilterLevel(NamedTuple):
    """Noise parameter for a state estimator: an estimate or its upper limit, possibly increased.

    Attributes
    ----------
    estimate : Estimate
        Positive number in SI: N, B, K or R of an axis, or another parameter. `Estimate.name` states
        which one. If the number is not resolved, the state estimator gets its 95 % upper limit.
    raised_from : float or None
        Fitted coefficient before the increase. If this coefficient is not resolved: 0 for K, and
        the upper limit for N. Also 0 for K if a bounded random walk replaces the random walk. None
        if the value was not increased. Values are increased so that the state estimator does not
        underestimate its error.
    """

    estimate: Estimate
    raised_from: float | None = None

    @property
    def value(self) -> float:
        """Number for the state estimator: a resolved estimate, else its upper limit."""
        estimate = self.estimate
        return (estimate.value if estimate.resolved else estimate.upper95) or 0.0

    @property
    def is_limit(self) -> bool:
        """Whether the value is an upper limit."""
        return not self.estimate.resolved

    @property
    def no_interval(self) -> bool:
        """Whether the value is a resolved estimate that has no interval and was not increased."""
        estimate = self.estimate
        return estimate.resolved and estimate.ci95 is None and self.raised_from is None

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval: (0, value) for a limit, (0, inf) if the interval is unknown."""
        low, high = (0.0, self.value) if self.is_limit else self.estimate.ci95 or (0.0, math.inf)
        return max(low, 0.0), high

    def raised(self, value: float, fitted: float, ci95: tuple[float, float] | None) -> FilterLevel:
        """Return this noise parameter, increased from the coefficient ``fitted`` to ``value``.

        ``ci95`` is the 95 % interval of the increased value; None if it is unknown.
        """
        if self.is_limit:
            return FilterLevel(replace(self.estimate, upper95=value), fitted)
        estimate = replace(self.estimate, value=value, recording_ci95=ci95, predictive_ci95=None)
        return FilterLevel(estimate, fitted)


class Reduction(NamedTuple):
    """Reduced-order model of one axis."""

    model: Model  # N, K and the processes with states that the state estimator assumes
    # smallest and largest ratio, over the compared horizons, of the root mean square error that the
    # reduced-order model predicts to the root mean square error that the complete model predicts
    ratio: tuple[float, float]
    # N, and possibly K, with their intervals (see `reduce_axis`); empty if the model did not come
    # from the fit of an axis
    levels: Mapping[str, FilterLevel]

    @property
    def poor(self) -> bool:
        """Whether the reduced-order and the complete model disagree by more than a factor of 2.

        The errors that the two models predict are compared at several horizons, and the largest
        difference counts.
        """
        return self.ratio[1] > POOR_RATIO or self.ratio[0] < 1.0 / POOR_RATIO


# --- reduced-order models -------------------------------------------------------------------------


@lru_cache(maxsize=64)
def reduce_model(model: Model, states: States = 'walk', horizon: float = HORIZON_S) -> Reduction:
    """Return a reduced-order model for a state estimator, in place of the complete noise model.

    The errors that the reduced-order model predicts are at least as large as the errors that the
    complete model predicts, except as stated under Returns. Processes whose integral is bounded,
    such as quantization and vibration, are excluded.

    Parameters
    ----------
    model : Model
        Complete model of one axis.
    states : {'none', 'walk', 'processes'}
        Bias states of the state estimator. They determine which parameters are increased (see
        Notes).
    horizon : float
        Longest horizon in s, above 0. The shortest horizon is 1 s, or a tenth of the longest
        horizon if this is shorter.

    Returns
    -------
    Reduction
        With 'none' and 'walk', `Reduction.ratio` is at least 1, except for rounding errors. With
        'processes', the predicted error may be up to 5 % smaller than with the complete model,
        because B is approximated. If ``horizon`` is shorter than 1 s, the predicted error may be
        much smaller.

    Notes
    -----
    ============  ================================================================================
    none          N is increased, because white noise represents all drift.
    walk          K is increased, N is kept. If the result would be poor (see `Reduction.poor`), the
                  processes with the shortest correlation times are treated as white noise, which
                  increases N.
    processes     B becomes four Gauss-Markov processes, and other processes with states are kept.
                  K is increased for the slowest part of B, and for a ramp and slow sinusoids, which
                  have no states.
    ============  ================================================================================

    Examples
    --------
    With 'walk', a model with N and K only is not changed:

    >>> reduction = reduce_model(Model.of(N=1e-3, K=1e-5))
    >>> round(reduction.model.value('K'), 9), [round(ratio, 3) for ratio in reduction.ratio]
    (1e-05, [1.0, 1.0])
    """
    complete = model.drift
    reductions = [_reduced(complete, 0, states, horizon)]
    stationary_count = len(_fastest_first(complete))
    while states == 'walk' and reductions[-1].poor and len(reductions) <= stationary_count:
        reductions.append(_reduced(complete, len(reductions), states, horizon))
    return min(reductions, key=lambda reduction: reduction.poor * reduction.ratio[1])


def _fastest_first(model: Model) -> list[Process]:
    """Return the processes with states and a correlation time, the fastest process first."""
    stationary = (p.process for p in model.parts if p.process.parameters and has_states(p.process))
    return sorted(stationary, key=lambda process: process.slowest_time)


def _reduced(complete: Model, fast_count: int, states: States, horizon: float) -> Reduction:
    """Return the reduced-order model with the ``fast_count`` fastest processes as white noise."""
    fast_processes = _fastest_first(complete)[:fast_count]
    added_variance = sum(
        (part.value * white_density(part.process)) ** 2
        for part in complete.parts
        if part.process in fast_processes
    )
    white_noise, walk = math.sqrt(complete.value('N') ** 2 + added_variance), 0.0
    drift = complete.where(lambda process: process not in fast_processes).changed(N=0.0)
    processes: tuple[tuple[float, Process], ...] = ()
    if states == 'none':
        squared_level = _growth(drift, horizon) ** 2 / _unit_variance(BY_LETTER['N'], horizon)
        white_noise = math.sqrt(white_noise**2 + float(np.max(squared_level)))
    else:
        # with 'processes', K must cover only noise without states, such as a ramp or sinusoids
        if states == 'processes':
            space = state_space(drift.changed(N=white_noise))
            processes = space.processes
            drift = drift.where(lambda process: not has_states(process))
            drift = drift.changed(N=0.0, B=0.0, K=space.walk)
        squared_level = _growth(drift, horizon) ** 2 / _unit_variance(BY_LETTER['K'], horizon)
        walk = math.sqrt(float(np.max(squared_level)))
    model = Model.of(*processes, N=white_noise, K=walk)
    reduced_errors, complete_errors = (
        _growth(compared_model, horizon) for compared_model in (model, complete)
    )
    if np.any(complete_errors > 0.0):
        ratio = reduced_errors / complete_errors
        return Reduction(model, (float(ratio.min()), float(ratio.max())), {})
    undefined_ratio = math.inf if np.any(reduced_errors > 0.0) else 1.0
    return Reduction(model, (undefined_ratio, undefined_ratio), {})


def horizons(longest: float) -> Floats:
    """Return the horizons in s, (30,), at which the predicted errors of two models are compared."""
    return np.geomspace(shortest_horizon(longest), longest, HORIZONS_PER_RANGE)


def _growth(model: Model, horizon: float) -> Floats:
    """Return the predicted standard deviation of the angle or velocity error, (30,).

    The elements are for the 30 horizons up to ``horizon`` (`horizons`).
    """
    return model.growth(horizons(horizon), horizon)


@lru_cache(maxsize=512)
def _unit_variance(process: Process, horizon: float) -> Floats:
    """Return the variance of the angle or velocity error due to a process, (30,).

    The process has the coefficient 1. The elements are for the 30 horizons up to ``horizon``
    (`horizons`).
    """
    variance = np.asarray(_growth(Model.of((1.0, process)), horizon) ** 2)
    variance.setflags(write=False)
    return variance


def closest_process(
    model: Model,
    kind: Callable[[float], Process],
    horizon: float,
    tau: float | None = None,
    bound: bool = True,
) -> tuple[float, float] | None:
    """Return the parameters of the process that best replaces all drift of a model.

    For each process that is tried, the error due to this process and the white noise of the model
    is compared with the error of the complete model. The process for which these errors differ
    least, on a logarithmic scale at the worst of 30 horizons, is returned.

    Parameters
    ----------
    model : Model
        Complete model of one axis.
    kind : function of float
        Returns the process with a given correlation time in s.
    horizon : float
        Longest horizon in s, above 0.
    tau : float, optional
        Correlation time of the process in s. If it is None, the best correlation time is selected.
    bound : bool
        Whether the predicted error must be at least the error of the complete model, as for a state
        estimator. If False, the predicted error may also be smaller.

    Returns
    -------
    (float, float) or None
        Coefficient in SI and correlation time in s; None if the model has no drift.
    """
    complete = model.drift
    if not complete.has_drift:
        return None
    white_variance = complete.value('N') ** 2 * _unit_variance(BY_LETTER['N'], horizon)
    # the minimum applies only if the drift is below the rounding error of the white noise
    drift_variance = np.maximum(
        _growth(complete, horizon) ** 2 - white_variance, np.finfo(float).tiny
    )
    grid = np.geomspace(shortest_horizon(horizon) / 3.0, 100.0 * horizon, 60).tolist()
    model_times = [process.slowest_time for process in _fastest_first(complete)]
    best, least_error = (0.0, 1.0), math.inf
    for time in [*model_times, *grid] if tau is None else [tau]:
        unit_variance = _unit_variance(kind(time), horizon)
        variance_ratio = drift_variance / unit_variance
        low, high = float(variance_ratio.min()), float(variance_ratio.max())
        variances = [high] if bound else np.geomspace(low, high, 9)
        for variance in variances:
            log_ratios = np.log(
                (white_variance + variance * unit_variance) / (white_variance + drift_variance)
            )
            error = float(np.abs(log_ratios).max())
            if error < least_error - 1e-9:
                best, least_error = (math.sqrt(variance), time), error
    return best


# --- parameters of an axis ------------------------------------------------------------------------


def axis_level(axis: str, fit: AxisFit, term: str) -> FilterLevel:
    """Return the fitted coefficient of a term, or its 95 % upper limit if it is not resolved.

    With the limit, a state estimator usually overestimates the noise, and gives other sensors more
    weight.

    Parameters
    ----------
    axis : str
        Name of the axis, for messages and for the estimate that is returned.
    fit : AxisFit
        Fit of the axis.
    term : str
        'Q', 'N', 'B', 'K' or 'R'; for R, the magnitude is returned.

    Raises
    ------
    AllanError
        When the term has neither a resolved estimate nor a limit that is positive and finite.
    """
    coefficient = fit.noise[term].magnitude if term == 'R' else fit.noise[term]
    value, limit = coefficient.value, coefficient.upper95
    if coefficient.status == 'estimated' and value is not None and 0.0 < value < math.inf:
        return FilterLevel(Estimate(value, coefficient.ci95, name=term, axis=axis))
    if limit is None or not 0.0 < limit < math.inf:
        raise AllanError(
            f'{term} of {axis} is not known, not even as a limit: record longer at rest (method '
            'paper gives no limits)'
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
        Name of the axis, for messages and for the estimates in ``levels``.
    fit : AxisFit
        Fit of the axis.
    states : {'none', 'walk', 'processes'}
        States with which the state estimator models the bias (see `reduce_model`).
    horizon : float
        Longest time in s, above 0, that the state estimator integrates without a correction.

    Returns
    -------
    Reduction
        ``levels`` are N and, if the reduced-order model has a random walk or K was added, K. A K of
        the model that is not resolved has no interval, unless it is increased. With 'none' and
        'walk', the interval of an increased value comes from the reduced-order models of two
        complete models, with coefficients at the lower and at the upper ends of their 95 %
        intervals (`AxisFit.models_at_ends`). The interval of an increased value is unknown with
        'processes', or if N, B, K or R of the model has neither an interval nor a finite limit. An
        upper limit of N that was increased remains an upper limit. An increase of up to 0.1 % does
        not count.

    Raises
    ------
    AllanError
        When N, or K where it is added, has neither a resolved estimate nor a limit that is positive
        and finite.
    """
    white, walk = axis_level(axis, fit, 'N'), None
    model = fit.model.changed(N=white.value)
    resolved_walk = model.value('K')
    reduction = reduce_model(model, states, horizon)
    # the model has no drift, or all its drift is fast and was replaced by white noise
    if not model.has_drift or (states == 'walk' and not reduction.model.value('K')):
        walk = axis_level(axis, fit, 'K')
        reduction = reduce_model(model.changed(K=walk.value), states, horizon)
    reduced_white, reduced_walk = (reduction.model.value(term) for term in 'NK')
    raises_walk = walk is None and reduced_walk > 1.001 * resolved_walk
    raises_white = reduced_white > 1.001 * white.value
    if walk is None and reduced_walk > 0.0:
        walk = FilterLevel(Estimate(reduced_walk, fit.noise['K'].ci95, name='K', axis=axis))
    if raises_walk or raises_white:
        end_models = fit.models_at_ends() if states in ('none', 'walk') else None
        end_reductions = [
            reduce_model(end_model, states, horizon).model for end_model in end_models or ()
        ]
        if walk is not None and raises_walk:
            measured = resolved_walk if fit.noise['K'].status == 'estimated' else 0.0
            walk_ends = [end_model.value('K') for end_model in end_reductions]
            walk = walk.raised(reduced_walk, measured, _range(reduced_walk, walk_ends))
        if raises_white:
            white_ends = [end_model.value('N') for end_model in end_reductions]
            white = white.raised(reduced_white, white.value, _range(reduced_white, white_ends))
    return reduction._replace(levels={'N': white, **({'K': walk} if walk else {})})


def _range(value: float, ends: Sequence[float]) -> tuple[float, float] | None:
    return (min(*ends, value), max(*ends, value)) if ends else None


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
        Longest time in s, above 0, that the state estimator integrates without a correction.

    Returns
    -------
    dict of axis name to dict of 'N' or 'K' to Check
        The ratios are `Check.ratio`.

    Raises
    ------
    AllanError
        When the fits have no axis in common, or N or K of an axis is unknown (see `reduce_axis`).
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
