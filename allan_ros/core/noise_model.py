# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From coefficients to the numbers a filter takes: which axis, value or limit, per which rate.

N and K are continuous-time densities: the roots of two-sided power spectral densities. A filter
that steps at f Hz sees them as discrete noise. Over one step of 1/f seconds white noise must add
N^2/f to the variance of its integral, and a random walk K^2/f to the variance of the bias
(N. Trawny, S. I. Roumeliotis, Indirect Kalman Filter for 3D Attitude Estimation, University of
Minnesota, 2005, eqs. 129, 130). Which number does that depends on what the filter multiplies it by:

=====================  ==============  =======================================================
the filter multiplies  write           by
=====================  ==============  =======================================================
N by sqrt(f) itself    N, K            nothing: it takes continuous densities
a std by 1/f           N sqrt(f)       `white_std`
a bias std by 1/f      K sqrt(f)       `walk_rate_std`
a variance by 1/f^2    N^2 f, K^2 f    the squares of these
=====================  ==============  =======================================================
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from .errors import AllanError
from .fit.values import AxisFit
from .terms import FLICKER_FLOOR

RULES = ('worst', 'mean', 'each')
"""Which axis speaks for a sensor: the largest of three, their root mean square, or each itself."""

MADGWICK_FACTOR = math.sqrt(3.0 / 4.0)
"""Gain over gyro error (S. O. H. Madgwick, An efficient orientation filter for inertial and
inertial/magnetic sensor arrays, 2010, on the filter gains)."""


@dataclass(frozen=True)
class Level:
    """How much of one term one axis has, in SI.

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
    """

    axis: str
    term: str
    value: float
    ci95: tuple[float, float] | None = None
    is_limit: bool = False


@dataclass(frozen=True)
class SensorLevel:
    """What a file says of one term of one sensor.

    Attributes
    ----------
    values : (x, y, z)
        In SI, inflation included; three times the same unless each axis speaks for itself.
    levels : tuple of Level
        The axes that the values come from.
    """

    values: tuple[float, float, float]
    levels: tuple[Level, ...]


def axis_level(axis: str, fit: AxisFit, term: str, strict: bool = False) -> Level:
    """Return the level of a term on one axis: its estimate, else its 95 % upper limit.

    The limit errs on the safe side: a filter that believes in more noise than there is trusts its
    other sensors more.

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


def bias_level(axis: str, fit: AxisFit, strict: bool = False) -> Level:
    """Return the standard deviation of the bias of one axis.

    It is sigma of the Gauss-Markov process where the fit found one, else B.

    Raises
    ------
    AllanError
        As `axis_level`.
    """
    process = fit.gauss_markov
    if process is None:
        return axis_level(axis, fit, 'B', strict)
    return Level(axis, 'sigma', process.sigma, process.sigma_ci95)


def sensor_level(levels: Sequence[Level], rule: str, inflation: float = 1.0) -> SensorLevel:
    """Return what the three axes of a sensor say together.

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

    ``density`` is in unit/sqrt(Hz), ``rate`` in Hz, the result in the unit. A step of 1/f with it
    adds (N sqrt(f) / f)^2 = N^2/f to the variance of the integral.
    """
    return density * math.sqrt(rate)


def midpoint_white_std(density: float, rate: float) -> float:
    """Return N sqrt(2 f), for a step that halves two samples and takes them for independent.

    Such a step adds 2 (s/2)^2 / f^2 = s^2 / (2 f^2) for samples of standard deviation s; N^2/f
    needs s = N sqrt(2 f).
    """
    return density * math.sqrt(2.0 * rate)


def walk_rate_std(density: float, rate: float) -> float:
    """Return K sqrt(f), the standard deviation of a bias rate that is held for 1/f seconds.

    ``density`` is in unit/s/sqrt(Hz), ``rate`` in Hz, the result in unit/s. A step of 1/f with it
    adds (K sqrt(f) / f)^2 = K^2/f to the variance of the bias.
    """
    return density * math.sqrt(rate)


def madgwick_gain(n: float, b: float, horizon: float) -> float:
    """Return Madgwick's gain beta (rad/s) for a gyro with N and B, corrected over ``horizon`` s.

    beta = sqrt(3/4) times the gyro's zero error; over a horizon h its standard deviation is
    sqrt(N^2/h + (2 ln2/pi) B^2), the Allan deviation at h.
    """
    return MADGWICK_FACTOR * math.sqrt(n * n / horizon + FLICKER_FLOOR * b * b)


def madgwick_drift_gain(k: float, horizon: float) -> float:
    """Return Madgwick's drift gain zeta (rad/s^2) for a gyro with rate random walk K.

    zeta = sqrt(3/4) times the drift of the gyro; over a horizon h a random walk drifts by
    K sqrt(h), at a rate of K / sqrt(h).
    """
    return MADGWICK_FACTOR * k / math.sqrt(horizon)


def madgwick_ramp_gain(r: float) -> float:
    """Return Madgwick's drift gain zeta (rad/s^2) for a gyro with rate ramp R: sqrt(3/4) |R|."""
    return MADGWICK_FACTOR * abs(r)
