# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Factors by which the errors of an IMU in motion exceed the prediction from its noise at rest."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..estimate import UNKNOWN, Estimate
from ..fields import Fields
from ..imu import SENSORS
from ..noise import Model
from ..stream.drive_recorder import LEAST_DRIVES
from ..stream.drives import ROTATION, VELOCITY, DriveErrors, cross_matrices
from .drive_likelihood import CAUSES, DriveFit, DriveLikelihood, NoiseAtRest

Floats = NDArray[np.float64]

DRIFT_S, SPREAD = 100.0, 25.0
"""Assumed size of an unknown drift. The random walk of a typical drift adds as much variance to an
integral over `DRIFT_S` seconds as the white noise does. The amplitude of an unknown drift may be up
to `SPREAD` times larger or smaller than the amplitude of the typical drift."""

LIMIT = 2.0
"""Upper limit for an unknown drift. The logarithm of its power has a normal prior distribution; the
limit lies this number of standard deviations above the mean of this distribution."""

FLICKER_S = 30.0
"""Assumed ratio B^2/K^2 in s of an unknown drift. With this ratio, the Allan variance of flicker
noise exceeds the Allan variance of the random walk at averaging times up to 40 s."""

GAIN_CAUSE = 10.0
"""Smallest increase of 2 log L (L: the likelihood) for which a calibration error is named as a
cause."""

GAIN_PART = 4.0
"""Two fits are compared: one with a factor for the white noise alone, and one with a factor for the
drift alone. The better fit is used only if its 2 log L is larger by more than this number, and is
at most 1 smaller than with a common factor. Otherwise, one common factor multiplies white noise and
drift."""

TYPICAL_SHARE = 0.5
"""Assumed ratio of an unresolved term to its upper limit, if another drift is resolved. In 1 h at
rest of a typical MEMS IMU, B is 0.6 to 0.8 times its limit. The errors of drives of one minute
depend on B as much as on N."""

WORSE_QUANTILE = 0.995
"""Quantile at the upper end of a 99 % interval. A sensor is called worse in motion if the 99 %
interval of its factor lies above 1. With a 95 % interval, 4 % of the sensors without errors in
motion would be called worse, and with 99 % fewer than 1 % (measured with 640 sensors)."""

KNOWN_SHARE = 0.5
"""An element of a calibration error is resolved if its posterior standard deviation is below this
share of its prior standard deviation."""

NoisePart = Literal['all', 'white', 'slow']

WITH_COMMON_FACTOR = ('gyro_white', 'gyro_slow'), ('accel_white', 'accel_slow')
"""For each sensor, the names of the covariances that one common factor multiplies."""


@dataclass(frozen=True)
class Cause:
    """A calibration error that explains errors in motion.

    Attributes
    ----------
    name : str
        'rotation', 'gyro_matrix', 'accel_matrix' or 'g_sensitivity'.
    gain : float
        Increase of 2 log L when this cause is added to the model. If 'gyro_matrix' or
        'accel_matrix' replaces 'rotation', the increase compared with the model with 'rotation'.
    elements : tuple of Estimate
        For 'rotation', the three elements of the vector v in rad for which the error of the gyro is
        v x w, where w is the true rate in the axes of the accelerometer. For the other causes, the
        nine elements of a matrix, row by row; the error is the matrix times the true rate or
        specific force. Elements that the drives do not determine are not resolved. For example,
        gravity does not show a rotation about the vertical.
    """

    name: str
    gain: float
    elements: tuple[Estimate, ...]

    @property
    def matrix(self) -> Floats:
        """The matrix, (3, 3), with NaN for elements that are not resolved.

        For 'rotation', this is the cross-product matrix of the rotation vector in rad.
        """
        values = np.array(
            [np.nan if element.value is None else element.value for element in self.elements]
        )
        return values.reshape(3, 3) if len(values) == 9 else cross_matrices(values)

    @classmethod
    def from_document(cls, fields: Fields) -> Cause:
        """Return the cause from the fields of a JSON object; ``elements`` may be negative."""
        elements = (
            Estimate.from_document(element, signed=True) for element in fields.each('elements')
        )
        return cls(fields.text('name'), fields.number('gain'), tuple(elements))


@dataclass(frozen=True)
class DriveRatio:
    """Errors of one drive, divided by their predicted root mean square.

    The effects of the estimated bias of the accelerometer and of the rotation of the Earth are
    subtracted from the errors.

    Attributes
    ----------
    duration : float
        Duration of the drive in s.
    turned : float
        Angle by which the IMU turned during the drive, in rad.
    rotation, velocity : float
        Ratio of the rotation error, and of the velocity error, to its predicted root mean square.
    """

    duration: float
    turned: float
    rotation: float
    velocity: float


@dataclass(frozen=True)
class SensorInMotion:
    """Errors of one sensor in motion, relative to the prediction from its noise at rest.

    Attributes
    ----------
    factor : Estimate
        Root mean square, over all drives, of the error that the noise of the sensor in motion
        causes, divided by the error that its noise at rest would cause. For the gyro, this is the
        error of the angle; for the accelerometer, the error of the velocity. The model contains no
        calibration error.
    white, slow : Estimate or None
        Factors of N, and of K and other drift, that explain this ratio; None for noise that is
        taken to be the same as at rest. Errors due to white noise grow with the root of the
        duration of a drive, errors due to drift grow faster. If the drives do not show whether
        white noise or drift is larger in motion, and drift was measured at rest, both factors are
        the same.
    explained : Estimate or None
        The same ratio as ``factor``, but with the calibration errors of all causes in the model;
        None if there are no causes.
    """

    factor: Estimate
    white: Estimate | None
    slow: Estimate | None
    explained: Estimate | None = None

    @property
    def term_factors(self) -> Mapping[str, Estimate]:
        """Term ('N' or 'K') -> factor by which the coefficient of the term differs in motion.

        The factor of N is ``white``, and the factor of K is ``slow``. A term without a factor is
        omitted.
        """
        factors = (('N', self.white), ('K', self.slow))
        return {term: factor for term, factor in factors if factor is not None}


@dataclass(frozen=True)
class NoiseInMotion:
    """Errors of gyro and accelerometer in motion, and the causes of these errors.

    ``motion['gyro']`` is ``motion.gyro.factor``, and ``motion['accel']`` is
    ``motion.accel.factor``.

    Attributes
    ----------
    gyro, accel : SensorInMotion
        Errors of each sensor relative to the prediction.
    causes : tuple of Cause
        Calibration errors that explain a part of the errors.
    drives : tuple of DriveRatio
        Errors of each drive relative to the prediction.
    """

    gyro: SensorInMotion
    accel: SensorInMotion
    causes: tuple[Cause, ...]
    drives: tuple[DriveRatio, ...]

    def __getitem__(self, sensor: str) -> Estimate:
        return self.sensors[sensor].factor

    def is_worse(self, sensor: str) -> bool:
        """Return whether the 99 % interval of the factor of 'gyro' or 'accel' lies above 1.

        On a logarithmic scale, the widths of the 99 % and of the 95 % interval have the ratio of
        the quantiles of Student's t distribution.
        """
        value, ends = self[sensor].value, self[sensor].ci95
        if not value or ends is None or ends[0] <= 1.0:
            return False
        drives = len(self.drives)
        width_ratio = _quantile(drives, WORSE_QUANTILE) / _quantile(drives)
        return math.log(value) > width_ratio * math.log(value / ends[0])

    @property
    def sensors(self) -> Mapping[str, SensorInMotion]:
        """Sensor ('gyro', 'accel') -> its errors in motion."""
        return {'gyro': self.gyro, 'accel': self.accel}


def axis_noise(model: Model, tau0: float, limits: Mapping[str, float] = {}) -> NoiseAtRest:
    """Return the noise of an axis at rest, from which errors in motion are predicted.

    The ramp is excluded: it is not noise, and the bias at the rest before each drive is subtracted.

    Parameters
    ----------
    model : Model
        Resolved noise, which must contain white noise. If the model contains no drift, a drift of
        unknown size is assumed; ``limits`` limit this size.
    tau0 : float
        Sample period in s.
    limits : mapping of 'B' or 'K' to float
        Upper limits of terms that are not resolved, in SI. If another drift is resolved, each of
        these terms is assumed to be `TYPICAL_SHARE` times its limit.

    Returns
    -------
    NoiseAtRest
    """
    white, log_power_std = model.value('N'), 0.0
    drift_parts = [
        part
        for part in model.drift.parts
        if not (part.process.is_white or part.process.is_regressor)
    ]
    if not drift_parts:
        walk = white * math.sqrt(3.0) / DRIFT_S
        typical_drift = {'B': walk * math.sqrt(FLICKER_S), 'K': walk}
        high = min(
            [
                SPREAD,
                *(limits[name] / typical_drift[name] for name in typical_drift if limits.get(name)),
            ]
        )
        low = min(1.0, high) / SPREAD
        drift_parts = list(
            Model.of(**{term: x * math.sqrt(low * high) for term, x in typical_drift.items()}).parts
        )
        log_power_std = math.log(high / low) / LIMIT
    else:
        unresolved = {name: TYPICAL_SHARE * limit for name, limit in limits.items() if limit}
        drift_parts += Model.of(**unresolved).parts
    slow = [
        (part.process.variance_of(part.value, tau0), part.process.in_unit(tau0))
        for part in drift_parts
    ]

    def gamma(M: float, j: ArrayLike) -> Floats:
        values = (variance * process.gamma(max(M / tau0, 1.0), j) for variance, process in slow)
        return np.asarray(sum(values, np.zeros(np.shape(j))))

    return NoiseAtRest(white, gamma, log_power_std)


def noise_in_motion(
    drives: Sequence[DriveErrors], noise: Sequence[NoiseAtRest]
) -> NoiseInMotion | None:
    """Return the errors of an IMU in motion, relative to its noise at rest, and their causes.

    Parameters
    ----------
    drives : sequence of DriveErrors
        Drives of one IMU in the order of time.
    noise : sequence of NoiseAtRest
        Noise of the six axes at rest.

    Returns
    -------
    NoiseInMotion or None
        None for fewer than 5 drives (`LEAST_DRIVES`).
    """
    if len(drives) < LEAST_DRIVES:
        return None
    data = DriveLikelihood.of(drives, noise)
    fit_without_causes = data.fit(WITH_COMMON_FACTOR)
    fit_with_causes, gains = _with_causes(data, fit_without_causes)
    sensors = {}
    for sensor in SENSORS:
        part, fit = _part(data, fit_without_causes, sensor)
        explained = _ratio(data, fit_with_causes, sensor) if gains else None
        noise_factors = _noise_factors(data, fit, sensor, part)
        sensors[sensor] = SensorInMotion(_ratio(data, fit, sensor), *noise_factors, explained)
    ratios = zip(drives, data.ratios(fit_without_causes).tolist())
    return NoiseInMotion(
        **sensors,
        causes=tuple(
            Cause(name, gains[name], _elements(data, fit_with_causes, name))
            for name in fit_with_causes.causes
        ),
        drives=tuple(DriveRatio(drive.duration, drive.turned, *ratio) for drive, ratio in ratios),
    )


def _with_causes(
    data: DriveLikelihood, fit_without_causes: DriveFit
) -> tuple[DriveFit, dict[str, float]]:
    """Return the fit with all causes, and a dict: cause -> increase of 2 log L by this cause.

    The causes are added one by one, as long as the next cause increases 2 log L by at least
    `GAIN_CAUSE`. If the cause 'gyro_matrix' or 'accel_matrix' has replaced the cause 'rotation',
    which it includes, the dict still contains the increase by 'rotation'.
    """
    best, gains = fit_without_causes, {}
    while names := [name for name in CAUSES if name not in best.causes]:
        trials = {}
        for name in names:
            # a matrix replaces the rotation, which it includes
            other_causes = [
                x for x in best.causes if x != 'rotation' or not name.endswith('matrix')
            ]
            trials[name] = data.fit(WITH_COMMON_FACTOR, (*other_causes, name), best)
        name = max(trials, key=lambda each: trials[each].value)
        gain = trials[name].value - best.value
        if gain < GAIN_CAUSE:
            break
        best, gains[name] = trials[name], gain
    return best, gains


def _ratio(data: DriveLikelihood, fit: DriveFit, sensor: str) -> Estimate:
    """Return the fitted root mean square error of a sensor, divided by its prediction.

    In the prediction, an unknown drift has its fitted size, but not more than its upper limit
    (`LIMIT`).
    """
    rows = {'gyro': ROTATION, 'accel': VELOCITY}[sensor]
    sizes = {
        name: float(np.einsum('dii->di', noise)[:, rows].sum())
        for name, noise in data.noise.items()
        if name.startswith(sensor)
    }
    fixed = sum(size for name, size in sizes.items() if not any(name in g for g in fit.groups))

    def log_ratio(theta: Floats) -> float:
        total, predicted = fixed, fixed
        for names, x in zip(fit.groups, theta.tolist()):
            size, sigma = sum(sizes.get(name, 0.0) for name in names), data.unknown.get(names[0])
            total += math.exp(x) * size
            predicted += size if sigma is None else math.exp(min(x, LIMIT * sigma)) * size
        return math.log(total / predicted) / 2.0

    fitted, shifts = log_ratio(fit.log_factors), np.diag(_quantile(len(fit.scores)) * fit.errors)
    low, high = (
        fitted
        + sign * math.hypot(*(log_ratio(fit.log_factors + sign * h) - fitted for h in shifts))
        for sign in (-1.0, 1.0)
    )
    return Estimate(math.exp(fitted), (math.exp(low), math.exp(high)))


def _noise_factors(
    data: DriveLikelihood, fit: DriveFit, sensor: str, part: NoisePart
) -> tuple[Estimate | None, Estimate | None]:
    """Return the factors by which white noise and drift of a sensor are larger in motion.

    A factor is None for noise that is taken to be the same as at rest. If ``part`` is 'all', both
    factors are the same. Otherwise, a drift of unknown size counts only if it exceeds its upper
    limit (`LIMIT`), and its factor is relative to this limit.
    """
    half_widths = _quantile(len(fit.scores)) * fit.errors
    factors = {
        names[0]: tuple(math.exp((x + sign * h - offset) / 2.0) for sign in (0.0, -1.0, 1.0))
        for names, x, h in zip(fit.groups, fit.log_factors.tolist(), half_widths.tolist())
        for offset in [LIMIT * data.unknown.get(names[0], 0.0)]
    }
    estimates = {name: Estimate(x, (low, high)) for name, (x, low, high) in factors.items()}
    white = estimates.get(f'{sensor}_white')
    if part == 'all':
        return white, white
    drift = estimates.get(f'{sensor}_drift')
    is_above_limit = drift is not None and (drift.value or 0.0) > 1.0
    return white, drift if is_above_limit else estimates.get(f'{sensor}_slow')


def _quantile(drives: int, share: float = 0.975) -> float:
    """Return the value below which Student's t distribution has the probability ``share``.

    The distribution has ``drives`` - 2 degrees of freedom.
    """
    from scipy.special import stdtrit  # slow to import

    return float(stdtrit(drives - 2, share))


def _part(data: DriveLikelihood, fit: DriveFit, sensor: str) -> tuple[NoisePart, DriveFit]:
    """Return the noise of a sensor that a factor multiplies, and the fit with this factor.

    ``fit`` has a common factor for white noise and measured drift. If no drift of the sensor was
    measured, the result is 'white' and ``fit``. Otherwise, the result is 'white' or 'slow', and the
    fit with a factor for this noise alone, if this fit is better (`GAIN_PART`). In all other cases,
    the result is 'all' and ``fit``.
    """
    if f'{sensor}_slow' not in data.noise:
        return 'white', fit
    trials: dict[NoisePart, DriveFit] = {}
    for part in ('white', 'slow'):
        names = (f'{sensor}_{part}',)
        groups = tuple(names if both[0].startswith(sensor) else both for both in WITH_COMMON_FACTOR)
        trials[part] = data.fit(groups, fit.causes, fit)
    best, other = sorted(trials, key=lambda each: -trials[each].value)
    is_clear = trials[best].value - trials[other].value > GAIN_PART
    if is_clear and trials[best].value > fit.value - 1.0:
        return best, trials[best]
    return 'all', fit


def _elements(data: DriveLikelihood, fit: DriveFit, name: str) -> tuple[Estimate, ...]:
    """Return the elements of a calibration error; resolved elements have 95 % intervals."""
    means, deviations = data.elements(fit, name)
    half_widths = _quantile(len(fit.scores)) * deviations
    are_resolved = deviations < KNOWN_SHARE * CAUSES[name]
    return tuple(
        Estimate(x, (x - h, x + h)) if is_resolved else UNKNOWN
        for x, h, is_resolved in zip(means.tolist(), half_widths.tolist(), are_resolved.tolist())
    )
