# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise parameters of a filter from the noise of the axes of a sensor.

N and K are continuous-time densities: the roots of two-sided power spectral densities. A filter
that steps at f Hz uses discrete noise. Over one step of 1/f seconds, white noise must add N^2/f to
the variance of its integral, and a random walk K^2/f to the variance of the bias (N. Trawny, S. I.
Roumeliotis, Indirect Kalman Filter for 3D Attitude Estimation, University of Minnesota, 2005, eqs.
129, 130). The number to write depends on the scaling in the filter:

=====================  ==============  =======================================================
the filter multiplies  write           computed by
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
from ..fit.model import AxisFit
from ..imu import AXES, SENSORS
from ..noise import ProcessModel
from .growth import drift_model, expected_model, has_drift, has_intervals, interval_models
from .reductions import Horizons, Reduction, States, reduce_model

RULES = ('worst', 'mean', 'each')
"""Value of a sensor with three axes: the largest, the root mean square, or three values."""

MADGWICK_FACTOR = math.sqrt(3.0 / 4.0)
"""Ratio of the gain to the gyro error (S. O. H. Madgwick, An efficient orientation filter for
inertial and inertial/magnetic sensor arrays, 2010, on the filter gains)."""

Ends = tuple[float, float, float]
"""Lower end, value and upper end."""


@dataclass(frozen=True)
class Level:
    """Level of one noise term on one axis, in SI."""

    # N, B, K or R, or 'sigma' of a Gauss-Markov process
    axis: str
    term: str
    value: float  # finite and above 0: the estimate, or the 95 % upper limit without an estimate
    ci95: tuple[float, float] | None = None  # interval of an estimate, if the method gives one
    is_limit: bool = False  # whether the value is only an upper limit
    # the coefficient (0 outside the selected model), if the value was raised to bound the growth of
    # the error
    raised_from: float | None = None

    @property
    def no_interval(self) -> bool:
        """Whether it is an estimate without an interval, because the method gives none or it is
        only likely.
        """
        return self.ci95 is None and not self.is_limit and self.raised_from is None

    @property
    def ends(self) -> Ends:
        """The value with its interval, which ranges from 0 to a limit, or to infinity if
        unknown."""
        low, high = (0.0, self.value) if self.is_limit else self.ci95 or (0.0, math.inf)
        return max(low, 0.0), self.value, high


@dataclass(frozen=True)
class SensorLevel:
    """One noise term of a sensor: inflated values of x, y, z, and the levels from which they
    come."""

    values: tuple[float, float, float]
    levels: tuple[Level, ...]


@dataclass(frozen=True)
class AxisReduction:
    """The reduction of one axis, with the levels of N and, if there is a walk, of K."""

    reduction: Reduction
    levels: dict[str, Level]


def axis_level(axis: str, fit: AxisFit, term: str, strict: bool = False) -> Level:
    """Return the level of a term on one axis: its estimate, or else its 95 % upper limit.

    With the limit, a filter overestimates the noise and relies more on its other sensors.

    Raises
    ------
    AllanError
        When there is neither a positive estimate nor a finite limit, or no 95 % interval and
        ``strict`` is set. The message names ``axis``.
    """
    coefficient = fit.noise[term]
    value, limit = coefficient.value, coefficient.upper95
    if coefficient.status == 'estimated' and value is not None and 0.0 < value < math.inf:
        return _accepted(Level(axis, term, value, coefficient.ci95), strict)
    if limit is None or not 0.0 < limit < math.inf:
        raise AllanError(
            f'{term} of {axis} has neither a value nor a limit: record longer, or fit with '
            'method gls'
        )
    if strict:
        raise AllanError(
            f'{term} of {axis} is not observable (below {limit:.3g}): record longer, or omit '
            '--strict to write the limit'
        )
    return Level(axis, term, limit, is_limit=True)


def _accepted(level: Level, strict: bool) -> Level:
    """Return the level; raise AllanError if it has no interval and ``strict`` is set."""
    if strict and level.no_interval:
        raise AllanError(
            f'{level.term} of {level.axis} has no 95 % interval: record longer, fit with method '
            'gls, or omit --strict'
        )
    return level


def reduce_axis(
    axis: str,
    fit: AxisFit,
    states: States = 'walk',
    horizons: Horizons = Horizons(1.0, 30.0),
    strict: bool = False,
    expect_walk: bool = False,
) -> AxisReduction:
    """Return the reduction of the selected model of one axis for the states of a filter.

    Terms outside the selected model count as 0, with two exceptions: N is replaced by its upper
    limit, and K is, too, if the model has no drift.

    Parameters
    ----------
    axis : str
        Its name, for messages.
    fit : AxisFit
    states : one of `STATES`
    horizons : Horizons
        Range of times over which the filter integrates.
    strict : bool
        Whether to reject upper limits, values without a 95 % interval, and reductions that are off
        by more than `POOR_RATIO`. Values raised by the reduction are accepted.
    expect_walk : bool
        Whether an unresolved K counts as in `expected_model`.

    Raises
    ------
    AllanError
        When a needed term has neither a value nor a limit, or ``strict`` rejects the result.
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
        model = _with_walk(model, expected_model(fit).terms.K)
    reduction = reduce_model(model, states, horizons)
    if states == 'walk' and not reduction.walk:  # all drift is fast, and counts as white noise
        walk = axis_level(axis, fit, 'K', strict)
        reduction = reduce_model(_with_walk(model, walk.value), states, horizons)
    if strict and reduction.poor:
        raise AllanError(
            f'{axis}: {_NAMES[states]} misstates the growth of the error by a factor of '
            f'{max(reduction.ratio[1], 1.0 / reduction.ratio[0]):.1f} over {horizons}: choose '
            'another --horizon, write state_space, or omit --strict'
        )
    if walk is None and reduction.walk > 0.0:
        walk = Level(axis, 'K', reduction.walk, fit.noise['K'].ci95)
        if reduction.walk > 1.001 * resolved_walk:
            walk = replace(walk, ci95=None, raised_from=resolved_walk)
        walk = _accepted(walk, strict)
    if reduction.white > 1.001 * white.value:
        white = replace(white, value=reduction.white, ci95=None, raised_from=white.value)
    return AxisReduction(reduction, {'N': white, **({'K': walk} if walk else {})})


_NAMES = {
    'none': 'white noise alone',
    'walk': 'a random walk',
    'gauss_markov': 'one Gauss-Markov process',
    'processes': 'the process model',
}


def _with_walk(model: ProcessModel, walk: float) -> ProcessModel:
    return replace(model, terms=replace(model.terms, K=walk))


def reduced_ends(axis: str, fit: AxisFit, horizons: Horizons) -> dict[str, Ends]:
    """Return `Level.ends` of N and K of the reduction to a random walk.

    The ends are the reductions of the models at the ends of the 95 % intervals.

    Raises
    ------
    AllanError
        When a needed term has neither a value nor a limit.
    """
    levels = reduce_axis(axis, fit, 'walk', horizons).levels
    bottom, top = (reduce_model(one, 'walk', horizons) for one in interval_models(fit))
    intervals = {'N': (bottom.white, top.white), 'K': (bottom.walk, top.walk)}
    ends = {}
    for term, level in levels.items():
        low, high = intervals[term]
        interval = min(low, level.value), max(high, level.value)
        ends[term] = replace(level, ci95=interval if has_intervals(fit) else None).ends
    return ends


def sensor_level(levels: Sequence[Level], rule: str, inflation: float = 1.0) -> SensorLevel:
    """Return the level of a sensor from the levels of x, y, z by one of `RULES`, times the
    inflation.

    The rule 'mean' averages the variances.
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

    A step of 1/f with this value adds (N sqrt(f) / f)^2 = N^2/f to the variance of the integral.
    The same holds for K and the rate of the bias.
    """
    return density * math.sqrt(rate)


def midpoint_white_std(density: float, rate: float) -> float:
    """Return N sqrt(2 f), for a step that averages two samples and treats them as independent.

    For samples of standard deviation s, such a step adds 2 (s/2)^2 / f^2; it should add N^2/f.
    """
    return white_std(density, 2.0 * rate)


def madgwick_gain(model: ProcessModel, horizon: float) -> float:
    """Return Madgwick's gain beta (rad/s) of a gyro that is corrected over ``horizon`` s.

    beta = sqrt(3/4) times the zero error of the gyro: the Allan deviation at the horizon, without
    quantization and vibration.
    """
    return MADGWICK_FACTOR * math.sqrt(float(drift_model(model).avar([horizon])[0]))


SAMPLE_WINDOW_S = 1.0
"""Longest window in s of `sample_variance`: slower noise counts as bias."""

Variances = tuple[float, float, float]
"""Variances of x, y and z, in the squared unit of the samples."""


def sample_variance(
    m: NDArray[np.int64], adev: NDArray[np.float64], tau0: float, window: float = SAMPLE_WINDOW_S
) -> float | None:
    """Return the variance of samples about the mean of 2^k samples, with 2^k tau0 <= window.

    The mean square deviation within 2^k samples is the sum of avar(2^j)/2 over j < k for any noise
    (Percival & Guttorp, Long-memory processes, the Allan variance and wavelets, 1994: the Haar
    wavelet divides the variance among the scales); n/(n - 1) removes the bias of a mean of n
    independent samples.

    Parameters
    ----------
    m, adev : (factors,) arrays
        Averaging factors, including every power of two of the window, and their Allan deviations.
    tau0, window : float
        Sample period and longest window in s.

    Returns
    -------
    float or None
        None if the window is shorter than two samples, or a deviation is unknown.
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

    With a horizon in s, N is raised until white noise bounds the growth of the error up to this
    time. This is for filters without a state for the bias.
    """
    densities: dict[str, float | None] = {}
    for name, fit in axes.items():
        try:
            if horizon:
                reduced = reduce_axis(name, fit, 'none', Horizons.up_to(horizon))
                densities[name] = white_std(reduced.reduction.white, rate)
            else:
                densities[name] = white_std(axis_level(name, fit, 'N').value, rate)
        except AllanError:
            densities[name] = None
    return measured_variances(densities, inflation)


def measured_variances(
    stds: Mapping[str, float | None], inflation: float = 1.0
) -> dict[str, Variances]:
    """Return the squared sample standard deviations of each sensor for which all three are
    known."""
    variances = {}
    for sensor, rows in SENSORS.items():
        known = [std for name in AXES[rows] if (std := stds.get(name))]
        if len(known) == 3:
            x, y, z = ((inflation * std) ** 2 for std in known)
            variances[sensor] = (x, y, z)
    return variances


@dataclass(frozen=True)
class TermInflation:
    """N or K of a reduction, at rest with motors off and with motors on, in SI."""

    rest: float
    running: float

    @property
    def use(self) -> float:
        """Value for a filter: the larger of the two."""
        return max(self.rest, self.running)

    @property
    def factor(self) -> float:
        """Ratio of this value to the value with motors off, at least 1."""
        return self.use / self.rest


@dataclass(frozen=True)
class AxisInflation:
    """Inflation of N and K of one axis."""

    white: TermInflation
    walk: TermInflation


def measure_inflation(
    rest: Mapping[str, AxisFit],
    running: Mapping[str, AxisFit],
    horizons: Horizons = Horizons(1.0, 30.0),
) -> dict[str, AxisInflation]:
    """Return the increase of N and K of each common axis of a robot at rest due to running motors.

    Parameters
    ----------
    rest, running : mapping of axis name to AxisFit
        Fits with motors off and with motors on.
    horizons : Horizons
        Range over which the reductions bound the growth of the error.

    Raises
    ------
    AllanError
        When there is no common axis, or an axis has neither a value nor a limit of N or K.
    """
    common = [axis for axis in rest if axis in running]
    if not common:
        raise AllanError('the two results have no axis in common: give two recordings of one IMU')
    inflation = {}
    for axis in common:
        quiet, loud = (
            reduce_axis(axis, fits[axis], 'walk', horizons).levels for fits in (rest, running)
        )
        inflation[axis] = AxisInflation(
            *(TermInflation(quiet[term].value, loud[term].value) for term in 'NK')
        )
    return inflation
