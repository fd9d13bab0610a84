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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..fit.model import AxisFit
from ..imu import AXES, SENSORS
from ..noise import FLICKER_FLOOR

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


SAMPLE_WINDOW_S = 1.0
"""The scatter of samples is that about the mean of at most so long: slower noise is bias."""


Variances = tuple[float, float, float]
"""Of x, y and z, in the squared unit of the samples."""


def sample_variance(
    m: NDArray[np.int64], adev: NDArray[np.float64], tau0: float, window: float = SAMPLE_WINDOW_S
) -> float | None:
    """Return the variance of samples about the mean of 2^k of them, 2^k tau0 <= window.

    The mean square deviation within 2^k samples is the sum of avar(2^j)/2 over j < k, whatever the
    noise (Percival & Guttorp, Long-memory processes, the Allan variance and wavelets, 1994: the
    Haar wavelet shares the variance out over the scales); n/(n - 1) takes the bias of a mean of n
    independent samples away.

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
    axes: Mapping[str, AxisFit], rate: float, inflation: float = 1.0
) -> dict[str, Variances]:
    """Return (inflation N)^2 f of each sensor that has three axes with a value or a limit of N.

    ``rate`` is f in Hz. Where N is not observable its 95 % upper limit stands for it.
    """
    variances = {}
    for sensor, names in _sensors(axes):
        try:
            x, y, z = (
                white_std(inflation * axis_level(name, axes[name], 'N').value, rate) ** 2
                for name in names
            )
        except AllanError:
            continue
        variances[sensor] = (x, y, z)
    return variances


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
