# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of the axes of a sensor as the numbers that a filter takes.

N and K are continuous-time densities: the roots of two-sided power spectral densities. A filter
that steps at f Hz sees them as discrete noise. Over one step of 1/f seconds white noise must add
N^2/f to the variance of its integral, and a random walk K^2/f to the variance of the bias
(N. Trawny, S. I. Roumeliotis, Indirect Kalman Filter for 3D Attitude Estimation, University of
Minnesota, 2005, eqs. 129, 130). Which number does that depends on how the filter scales it:

=====================  ==============  =======================================================
the filter multiplies  write           by
=====================  ==============  =======================================================
N by sqrt(f) itself    N, K            nothing: it takes continuous densities
a std by 1/f           N sqrt(f)       `white_std`
a bias std by 1/f      K sqrt(f)       `white_std` of K
a variance by 1/f^2    N^2 f, K^2 f    the squares of these
=====================  ==============  =======================================================

N and K are either the bare coefficients (`axis_level`) or a reduction of the selected model
(`reduce_axis`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..fit.model import AxisFit, Coefficient
from ..imu import AXES, SENSORS
from ..noise import NoiseTerms, ProcessModel
from .growth import growth_interval, predicted_growth
from .reductions import Horizons, Reduction, States, drift_model, has_drift, reduce_model

NORMAL_LIMIT = 1.6448536269514722
"""Standard deviations below which 95 % of the errors lie."""

RULES = ('worst', 'mean', 'each')
"""Value of a sensor with three axes: the largest, the root mean square, or three values."""

MADGWICK_FACTOR = math.sqrt(3.0 / 4.0)
"""Gain over gyro error (S. O. H. Madgwick, An efficient orientation filter for inertial and
inertial/magnetic sensor arrays, 2010, on the filter gains)."""


@dataclass(frozen=True)
class Level:
    """Level of one noise term on one axis, in SI.

    Attributes
    ----------
    axis : str
    term : str
        N, B, K or R, or 'sigma' of a Gauss-Markov process.
    value : float
        Finite and above 0: the estimate, or the 95 % upper limit where there is none.
    ci95 : (low, high) or None
        95 % interval of an estimate, where the method gives one.
    is_limit : bool
        Whether the value is only an upper limit.
    raised_from : float or None
        The coefficient (0 where it is not resolved), if the value was raised to bound the growth of
        the error.
    """

    axis: str
    term: str
    value: float
    ci95: tuple[float, float] | None = None
    is_limit: bool = False
    raised_from: float | None = None


@dataclass(frozen=True)
class SensorLevel:
    """Level of one noise term of a sensor.

    Attributes
    ----------
    values : (x, y, z)
        In SI, including the inflation; three times the same unless each axis has its own.
    levels : tuple of Level
        The axes that determine the values.
    """

    values: tuple[float, float, float]
    levels: tuple[Level, ...]


@dataclass(frozen=True)
class AxisReduction:
    """The reduction of one axis, and the levels that its N and K have.

    Attributes
    ----------
    reduction : Reduction
    white, walk : Level
        N and K of the reduction. K is present even where the states have no walk.
    """

    reduction: Reduction
    white: Level
    walk: Level | None


def axis_level(axis: str, fit: AxisFit, term: str, strict: bool = False) -> Level:
    """Return the level of a term on one axis: its estimate, else its 95 % upper limit.

    With the limit a filter overestimates the noise and relies more on its other sensors.

    Parameters
    ----------
    axis : str
        Its name, for messages.
    fit : AxisFit
    term : str
        One of Q, N, B, K, R.
    strict : bool
        Refuse an upper limit.

    Raises
    ------
    AllanError
        When there is neither a positive estimate nor a finite limit, or ``strict`` and only a
        limit.
    """
    coefficient = fit.noise[term]
    value, limit = coefficient.value, coefficient.upper95
    if coefficient.status == 'estimated' and value is not None and 0.0 < value < math.inf:
        return Level(axis, term, value, coefficient.ci95)
    if limit is None or not 0.0 < limit < math.inf:
        raise AllanError(
            f'{term} of {axis} has neither a value nor a limit: record longer, or fit by method gls'
        )
    if strict:
        raise AllanError(
            f'{term} of {axis} is not observable (below {limit:.3g}): record longer, or write the '
            'limit by leaving out --strict'
        )
    return Level(axis, term, limit, is_limit=True)


def reduce_axis(
    axis: str,
    fit: AxisFit,
    states: States = 'walk',
    horizons: Horizons = Horizons(1.0, 30.0),
    strict: bool = False,
    expect_walk: bool = False,
) -> AxisReduction:
    """Return the reduction of the selected model of one axis for the states of a filter.

    Terms that are not resolved count as 0, with two exceptions: N is replaced by its upper limit,
    and if nothing drifts, K is.

    Parameters
    ----------
    axis : str
        Its name, for messages.
    fit : AxisFit
    states : str
        The states of the filter, one of `STATES`.
    horizons : Horizons
        Range of times over which the filter integrates.
    strict : bool
        Refuse upper limits and reductions that are off by more than `POOR_RATIO`.
    expect_walk : bool
        Whether an unresolved K counts with `UNRESOLVED_SHARE` of its expected variance: for a
        filter with all processes as states, which has nothing else to cover slow drift.

    Raises
    ------
    AllanError
        When a needed term has neither a value nor a limit, or ``strict`` refuses.
    """
    white = axis_level(axis, fit, 'N', strict)
    model = drift_model(fit.selected)
    model = replace(model, terms=replace(model.terms, N=white.value))
    walk = None
    if not has_drift(model):
        walk = axis_level(axis, fit, 'K', strict)
        model = _with_walk(model, walk.value)
    resolved_walk = model.terms.K
    if expect_walk and not resolved_walk:
        hidden = UNRESOLVED_SHARE * expected_variance(fit.noise['K'])
        model = _with_walk(model, math.sqrt(hidden))
    reduction = reduce_model(model, states, horizons)
    if states == 'walk' and not reduction.walk:  # all that drifts is quick, and counts as white
        walk = axis_level(axis, fit, 'K', strict)
        reduction = reduce_model(_with_walk(model, walk.value), states, horizons)
    if strict and reduction.poor:
        raise AllanError(
            f'{axis}: {_NAMES[states]} misstates the growth of the error by a factor of '
            f'{max(reduction.ratio[1], 1.0 / reduction.ratio[0]):.1f} over {horizons}: choose '
            'another --horizon, write state_space, or leave out --strict'
        )
    if walk is None and reduction.walk > 0.0:
        raised = reduction.walk > 1.001 * resolved_walk
        walk = Level(
            axis,
            'K',
            reduction.walk,
            None if raised else fit.noise['K'].ci95,
            raised_from=resolved_walk if raised else None,
        )
    if reduction.white > 1.001 * white.value:
        white = Level(axis, 'N', reduction.white, raised_from=white.value)
    return AxisReduction(reduction, white, walk)


UNRESOLVED_SHARE = 0.25
"""Probability that a K exists which a record does not resolve: 1/2 before the record, and a K of a
size near the limit stays unresolved in a third of the records. With it the errors after 300 s are
1.06 of the predicted ones on sensor Y of docs/filters.md (1.3 without), and 0.90 where K is 0."""


def expected_variance(coefficient: Coefficient) -> float:
    """Return the mean of the squared coefficient of a term that exists but is not resolved.

    Estimate and 95 % limit of the square give a normal distribution, which is truncated at 0.
    """
    mean, limit = (coefficient.value or 0.0) ** 2, coefficient.upper95 or 0.0
    error = (limit**2 - mean) / NORMAL_LIMIT
    if not 0.0 < error < math.inf:
        return mean
    x = mean / error
    density = math.exp(-x * x / 2.0) / math.sqrt(2.0 * math.pi)
    return mean + error * density / (0.5 * math.erfc(-x / math.sqrt(2.0)))


def reduced_ends(
    axis: str, fit: AxisFit, horizons: Horizons
) -> dict[str, tuple[float, float, float]]:
    """Return lower end, value and upper end of N and K of the reduction to a random walk.

    The ends are the reductions of the models at the ends of the 95 % intervals; (0, limit, limit)
    for an upper limit, (0, value, inf) where a term has no interval.

    Raises
    ------
    AllanError
        When a needed term has neither a value nor a limit.
    """
    reduced = reduce_axis(axis, fit, 'walk', horizons)
    low, high = (reduce_model(one, 'walk', horizons) for one in _interval_models(fit))
    known = _has_intervals(fit)
    assert reduced.walk is not None
    ends = {}
    for level, bottom, top in (
        (reduced.white, low.white, high.white),
        (reduced.walk, low.walk, high.walk),
    ):
        if level.is_limit:
            ends[level.term] = (0.0, level.value, level.value)
        elif not known:
            ends[level.term] = (0.0, level.value, math.inf)
        else:
            ends[level.term] = (min(bottom, level.value), level.value, max(top, level.value))
    return ends


@dataclass(frozen=True)
class Growth:
    """Error of the angle (gyro) or velocity (accelerometer) some time after the last correction.

    Attributes
    ----------
    horizon, window : float
        Time without correction, and time before over which the bias was averaged, in s.
    std : float
        Standard deviation that the selected model predicts: the unit of the samples times s.
    ci95 : (low, high) or None
        95 % interval from those of the terms; None where a term has no interval.
    """

    horizon: float
    window: float
    std: float
    ci95: tuple[float, float] | None


def growth_table(fit: AxisFit) -> tuple[Growth, ...]:
    """Return the predicted growth of the error at `GROWTH_S`, with its intervals.

    Terms that are not resolved are 0 in the prediction and at their 95 % limit at the upper end.
    """
    h = np.array(GROWTH_S)
    model = drift_model(fit.selected)
    std = predicted_growth(model, h, GROWTH_WINDOW_S)
    ends: list[tuple[float, float] | None] = [None] * len(h)
    if _has_intervals(fit):
        low, high = (drift_model(one) for one in _interval_models(fit))
        limits = {
            term: getattr(high.terms, term) or _finite(fit.noise[term].upper95) for term in 'NBKR'
        }
        high = replace(high, terms=NoiseTerms(**limits))
        bounds = growth_interval(model, low, high, h, GROWTH_WINDOW_S)
        ends = [(float(bottom), float(top)) for bottom, top in zip(*bounds)]
    return tuple(
        Growth(float(one), GROWTH_WINDOW_S, float(value), ci95)
        for one, value, ci95 in zip(h, std, ends)
    )


GROWTH_S = (1.0, 10.0, 30.0, 100.0, 300.0)
GROWTH_WINDOW_S = 100.0
"""Horizons of `growth_table`, and the time over which the bias was averaged before, in s."""


def _finite(value: float | None) -> float:
    return value if value is not None and math.isfinite(value) else 0.0


def _has_intervals(fit: AxisFit) -> bool:
    """Return whether every term of the selected model has an interval."""
    return all(_interval(fit, term) is not None for term in 'NBKR')


def _interval(fit: AxisFit, term: str) -> tuple[float, float] | None:
    """Return the interval of a term of the selected model, from 0 to its limit if it has only one.

    (0, 0) for a term that is not in the model.
    """
    if not getattr(fit.selected.terms, term):
        return 0.0, 0.0
    coefficient = fit.noise[term]
    if coefficient.ci95 is not None:
        return max(coefficient.ci95[0], 0.0), coefficient.ci95[1]
    limit = _finite(coefficient.upper95)
    return (0.0, limit) if limit else None


def _interval_models(fit: AxisFit) -> tuple[ProcessModel, ProcessModel]:
    """Return the selected model with every level at the lower, and at the upper end."""
    intervals = {
        term: _interval(fit, term) or (abs(getattr(fit.selected.terms, term)),) * 2
        for term in 'NBKR'
    }
    low, high = (
        ProcessModel(
            NoiseTerms(**{term: ends[end] for term, ends in intervals.items()}),
            tuple(
                (max(p.sigma_ci95[end], 0.0), p.correlation_time)
                for p in fit.processes.gauss_markov
            ),
            fit.selected.sinusoids,
        )
        for end in (0, 1)
    )
    return low, high


_NAMES = {
    'none': 'white noise alone',
    'walk': 'a random walk',
    'gauss_markov': 'one Gauss-Markov process',
    'processes': 'the process model',
}


def _with_walk(model: ProcessModel, walk: float) -> ProcessModel:
    return replace(model, terms=replace(model.terms, K=walk))


def sensor_level(levels: Sequence[Level], rule: str, inflation: float = 1.0) -> SensorLevel:
    """Return the level of a sensor with three axes.

    Parameters
    ----------
    levels : three of Level
        Of x, y and z.
    rule : str
        One of `RULES`. The mean is of the variances.
    inflation : float
        Factor on the values.
    """
    x, y, z = (level.value * inflation for level in levels)
    if rule == 'each':
        return SensorLevel((x, y, z), tuple(levels))
    if rule == 'mean':
        mean = math.sqrt((x * x + y * y + z * z) / 3.0)
        return SensorLevel((mean, mean, mean), tuple(levels))
    worst = max(levels, key=lambda level: level.value)
    value = worst.value * inflation
    return SensorLevel((value, value, value), (worst,))


def white_std(density: float, rate: float) -> float:
    """Return N sqrt(f), the standard deviation of one sample of white noise of density N.

    A step of 1/f with it adds (N sqrt(f) / f)^2 = N^2/f to the variance of the integral. The same
    holds for K and the rate of the bias.

    Parameters
    ----------
    density : float
        N or K.
    rate : float
        f in Hz.
    """
    return density * math.sqrt(rate)


def midpoint_white_std(density: float, rate: float) -> float:
    """Return N sqrt(2 f), for a step that averages two samples and treats them as independent.

    Such a step adds 2 (s/2)^2 / f^2 = s^2 / (2 f^2) for samples of standard deviation s; N^2/f
    needs s = N sqrt(2 f).
    """
    return density * math.sqrt(2.0 * rate)


def madgwick_gain(model: ProcessModel, horizon: float) -> float:
    """Return Madgwick's gain beta (rad/s) of a gyro that is corrected over ``horizon`` s.

    beta = sqrt(3/4) times the gyro's zero error; over a horizon h its standard deviation is the
    Allan deviation at h, here without quantization and vibration.
    """
    return MADGWICK_FACTOR * math.sqrt(float(drift_model(model).avar([horizon])[0]))


def madgwick_drift_gain(k: float, horizon: float) -> float:
    """Return Madgwick's drift gain zeta (rad/s^2) of a gyro with rate random walk K.

    zeta = sqrt(3/4) times the drift of the gyro; over a horizon h a random walk drifts by
    K sqrt(h), at a rate of K / sqrt(h).
    """
    return MADGWICK_FACTOR * k / math.sqrt(horizon)


def madgwick_ramp_gain(r: float) -> float:
    """Return Madgwick's drift gain zeta (rad/s^2) of a gyro with rate ramp R: sqrt(3/4) |R|."""
    return MADGWICK_FACTOR * abs(r)


SAMPLE_WINDOW_S = 1.0
"""`sample_variance` is about the mean of at most so long: slower noise counts as bias."""

Variances = tuple[float, float, float]
"""Of x, y and z, in the squared unit of the samples."""


def sample_variance(
    m: NDArray[np.int64], adev: NDArray[np.float64], tau0: float, window: float = SAMPLE_WINDOW_S
) -> float | None:
    """Return the variance of samples about the mean of 2^k of them, 2^k tau0 <= window.

    The mean square deviation within 2^k samples is the sum of avar(2^j)/2 over j < k, whatever the
    noise (Percival & Guttorp, Long-memory processes, the Allan variance and wavelets, 1994: the
    Haar wavelet divides the variance among the scales); n/(n - 1) removes the bias of a mean of n
    independent samples.

    Parameters
    ----------
    m : (factors,) array
        With every power of two of the window among them.
    adev : (factors,) array
    tau0 : float
        Sample period in s.

    Returns
    -------
    float or None
        None where two samples do not fit the window, or a deviation is not known.
    """
    levels = math.floor(math.log2(window / tau0 * (1.0 + 1e-9))) if tau0 <= window else 0
    known = {int(factor): float(deviation) for factor, deviation in zip(m, adev)}
    parts = [known.get(1 << j, math.nan) ** 2 / 2.0 for j in range(levels)]
    total = sum(parts) * (1 << levels) / ((1 << levels) - 1) if levels else math.nan
    return total if math.isfinite(total) else None


def white_variances(
    axes: Mapping[str, AxisFit], rate: float, inflation: float = 1.0, horizon: float = 0.0
) -> dict[str, Variances]:
    """Return (inflation N)^2 f of each sensor that has three axes with a value or a limit of N.

    Parameters
    ----------
    axes : mapping of axis name to AxisFit
    rate : float
        f in Hz.
    inflation : float
        Factor on N.
    horizon : float
        0: N is the white noise alone. Else N is raised until white noise bounds the growth of the
        error up to this time in s: for a filter without a state for the bias.
    """
    variances = {}
    for sensor, names in _sensors(axes):
        try:
            x, y, z = (
                white_std(inflation * _white(name, axes[name], horizon), rate) ** 2
                for name in names
            )
        except AllanError:
            continue
        variances[sensor] = (x, y, z)
    return variances


def _white(axis: str, fit: AxisFit, horizon: float) -> float:
    if not horizon:
        return axis_level(axis, fit, 'N').value
    return reduce_axis(axis, fit, 'none', Horizons.up_to(horizon)).reduction.white


def measured_variances(
    stds: Mapping[str, float | None], inflation: float = 1.0
) -> dict[str, Variances]:
    """Return the squares of the sample standard deviations of each sensor that has all three."""
    variances = {}
    for sensor, names in _sensors(stds):
        known = [std for name in names if (std := stds[name])]
        if len(known) == len(names):
            x, y, z = ((inflation * std) ** 2 for std in known)
            variances[sensor] = (x, y, z)
    return variances


def _sensors(axes: Mapping[str, object]) -> list[tuple[str, Sequence[str]]]:
    """Return the sensors whose axes are all there, with the names of these."""
    named = [(sensor, AXES[rows]) for sensor, rows in SENSORS.items()]
    return [(sensor, names) for sensor, names in named if all(name in axes for name in names)]
