# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""By which factors the errors of an IMU are larger in motion than its noise at rest predicts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..estimate import Estimate
from ..fields import Fields
from ..imu import SENSORS
from ..noise import Model
from ..stream.drives import ROTATION, VELOCITY, DriveErrors, cross_matrices
from .drive_likelihood import CAUSES, DriveLikelihood, Fit, NoiseAtRest

Floats = NDArray[np.float64]

LEAST_DRIVES = 5
"""Fewest drives for a result: the quantile of the intervals, t with this number minus 2, is 3.2."""

DRIFT_S, SPREAD = 100.0, 25.0
"""Time in s after which an unknown drift adds as much to an integral as white noise does, as an
average over sensors, and largest factor of its square root of power on both sides."""

LIMIT = 2.0
"""Logarithm of the power of an unknown drift at its limit, in standard deviations."""

FLICKER_S = 30.0
"""Time in s up to which an unknown drift is rather flicker noise than a random walk."""

GAIN_CAUSE = 10.0
"""Least gain in 2 log L for a matrix to be named as a cause."""

GAIN_PART = 4.0
"""Least gain in 2 log L for the white or the slow noise alone to carry a factor."""

KNOWN_SHARE = 0.5
"""An element of a matrix is determined if its standard deviation is below this share of the one
before the data."""

Part = Literal['all', 'white', 'slow']

BOTH = ('gyro_white', 'gyro_slow'), ('accel_white', 'accel_slow')
"""Noise that is multiplied by the factors of gyro and accelerometer."""


@dataclass(frozen=True)
class Cause:
    """A calibration error that explains errors in motion.

    Attributes
    ----------
    name : str
        One of `CAUSES`.
    gain : float
        Gain in 2 log L.
    elements : tuple of Estimate
        The nine elements of the matrix, row by row; errors are the matrix times the true rates or
        specific forces. Of a rotation, the vector in rad by which the axes of the gyro are turned
        against those of the accelerometer. Elements that the drives do not determine are not
        resolved: gravity shows no rotation around the vertical.
    """

    name: str
    gain: float
    elements: tuple[Estimate, ...]

    @property
    def matrix(self) -> Floats:
        """The matrix, (3, 3); NaN for elements that are not resolved."""
        values = np.array([np.nan if one.value is None else one.value for one in self.elements])
        return values.reshape(3, 3) if len(values) == 9 else cross_matrices(values)

    @classmethod
    def from_document(cls, fields: Fields) -> Cause:
        """Return the cause in a JSON object, whose elements may be negative."""
        elements = (Estimate.from_document(each, signed=True) for each in fields.each('elements'))
        return cls(fields.text('name'), fields.number('gain'), tuple(elements))


@dataclass(frozen=True)
class DriveRatio:
    """Lengths of the errors of one drive over their rms as predicted from the noise at rest.

    The errors are without the estimated bias of the accelerometer.
    ``duration`` is the duration of the drive in s, ``turned`` the angle it turned in rad;
    ``rotation`` is the ratio of the errors of the rotation, ``velocity`` of the velocity.
    """

    duration: float
    turned: float
    rotation: float
    velocity: float


@dataclass(frozen=True)
class SensorInMotion:
    """Errors of one sensor in motion over the prediction from its noise at rest.

    Attributes
    ----------
    factor : Estimate
        Ratio of the rms errors of all drives to their prediction, of the angle for the gyro and of
        the velocity for the accelerometer, without any calibration error in the model.
    white, slow : Estimate or None
        Factors of N and of K (and other drift) that explain this ratio; None for a term that is as
        at rest. The errors of white noise grow with the root of the duration of a drive, and those
        of drift faster. Both are the same if the drives do not tell.
    explained : Estimate or None
        ``factor`` with the calibration errors of all causes in the model; None without causes.
    """

    factor: Estimate
    white: Estimate | None
    slow: Estimate | None
    explained: Estimate | None = None

    @property
    def raised(self) -> Mapping[str, Estimate]:
        """Term -> its factor, of 'N' and 'K' if they are not as at rest."""
        return {term: one for term, one in (('N', self.white), ('K', self.slow)) if one is not None}


@dataclass(frozen=True)
class NoiseInMotion:
    """Errors of gyro and accelerometer in motion, and their causes.

    ``motion['gyro']`` is the factor of the gyro, ``motion['accel']`` that of the accelerometer.

    Attributes
    ----------
    gyro, accel : SensorInMotion
        The factors of both sensors.
    causes : tuple of Cause
        Calibration errors that explain the errors.
    drives : tuple of DriveRatio
        Errors of each drive relative to their prediction.
    """

    gyro: SensorInMotion
    accel: SensorInMotion
    causes: tuple[Cause, ...]
    drives: tuple[DriveRatio, ...]

    def __getitem__(self, sensor: str) -> Estimate:
        return self.sensors[sensor].factor

    @property
    def sensors(self) -> Mapping[str, SensorInMotion]:
        """Sensor -> its factor."""
        return {'gyro': self.gyro, 'accel': self.accel}


def axis_noise(model: Model, tau0: float, limits: Mapping[str, float] = {}) -> NoiseAtRest:
    """Return the noise of an axis at rest for the prediction of errors in motion.

    The ramp of a recording is no noise, and the bias at the rest before each drive is subtracted.

    Parameters
    ----------
    model : Model
        Resolved noise. Without any drift, the drift is unknown, within the limits.
    tau0 : float
        Sample period in s.
    limits : mapping of 'B' or 'K' to float
        Upper limits of terms that are not resolved, in SI.
    """
    white, sigma = model.value('N'), 0.0
    parts = [p for p in model.drift.parts if not (p.process.is_white or p.process.is_regressor)]
    if not parts:
        walk = white * math.sqrt(3.0) / DRIFT_S
        terms = {'B': walk * math.sqrt(FLICKER_S), 'K': walk}
        high = min([SPREAD, *(limits[name] / terms[name] for name in terms if limits.get(name))])
        low = min(1.0, high) / SPREAD
        parts = list(Model.of(**{n: x * math.sqrt(low * high) for n, x in terms.items()}).parts)
        sigma = math.log(high / low) / LIMIT  # of the power
    slow = [
        (part.process.variance_of(part.value, tau0), part.process.in_unit(tau0)) for part in parts
    ]

    def gamma(M: float, j: ArrayLike) -> Floats:
        values = (variance * unit.gamma(max(M / tau0, 1.0), j) for variance, unit in slow)
        return np.asarray(sum(values, np.zeros(np.shape(j))))

    return NoiseAtRest(white, gamma, sigma)


def noise_in_motion(
    drives: Sequence[DriveErrors], noise: Sequence[NoiseAtRest]
) -> NoiseInMotion | None:
    """Return the factors of all drives; None for fewer than `LEAST_DRIVES`.

    Parameters
    ----------
    drives : sequence of DriveErrors
        Drives of one IMU, in their order in time.
    noise : sequence of NoiseAtRest
        Noise of the six axes at rest.

    Returns
    -------
    NoiseInMotion or None
    """
    if len(drives) < LEAST_DRIVES:
        return None
    data = DriveLikelihood.of(drives, noise)
    plain = data.fit(BOTH)
    best, gains = _with_causes(data, plain)
    sensors = {}
    for sensor in SENSORS:
        part, fit = _part(data, plain, sensor)
        explained = _ratio(data, best, sensor) if gains else None
        raised = _raised(data, fit, sensor, part)
        sensors[sensor] = SensorInMotion(_ratio(data, fit, sensor), *raised, explained)
    ratios = zip(drives, data.ratios(plain).tolist())
    return NoiseInMotion(
        **sensors,
        causes=tuple(Cause(name, gains[name], _elements(data, best, name)) for name in best.causes),
        drives=tuple(DriveRatio(each.duration, each.turned, *ratio) for each, ratio in ratios),
    )


def _with_causes(data: DriveLikelihood, plain: Fit) -> tuple[Fit, dict[str, float]]:
    """Add causes one by one while they explain enough; return the fit and their gains."""
    best, gains = plain, {}
    while names := [name for name in CAUSES if name not in best.causes]:
        trials = {}
        for name in names:
            held = [one for one in best.causes if one != 'rotation' or not name.endswith('matrix')]
            trials[name] = data.fit(BOTH, (*held, name), best)
        name = max(trials, key=lambda each: trials[each].value)
        gain = trials[name].value - best.value
        if gain < GAIN_CAUSE:
            break
        best, gains[name] = trials[name], gain
    return best, gains


def predicted_errors(
    used: Sequence[DriveErrors],
    others: Sequence[DriveErrors],
    noise: Sequence[NoiseAtRest],
    causes: tuple[str, ...] = (),
) -> tuple[float, float, float]:
    """Return the squared errors of drives over their prediction from other drives.

    Parameters
    ----------
    used : sequence of DriveErrors
        Drives from which factors and causes are estimated.
    others : sequence of DriveErrors
        Drives that are predicted. What both have in common, such as the bias of the accelerometer,
        is predicted from the used ones.
    noise : sequence of NoiseAtRest
        Noise of the six axes at rest.
    causes : tuple of str
        Calibration errors that the used drives show, of `CAUSES`.

    Returns
    -------
    (float, float, float)
        Mean of the squared errors of rotation and velocity over their predicted variance: with the
        noise at rest, with the factors, and with factors and causes. 1 is right.
    """
    whole = DriveLikelihood.of([*used, *others], noise)
    data, ahead = whole.part(slice(0, len(used))), whole.part(slice(len(used), None))
    plain = data.fit(BOTH)
    most = [LIMIT * data.unknown.get(names[0], 0.0) for names in plain.groups]
    at_rest = np.minimum(plain.log_factors, most)
    at_rest[:2] = 0.0
    rows = slice(ROTATION.start, VELOCITY.stop)
    out = []
    for fit in (plain._replace(log_factors=at_rest), plain, data.fit(BOTH, causes, plain)):
        u = ahead.all_effects(fit.causes)
        left = (ahead.y - u @ fit.mean)[:, rows]
        own = ahead.covariances(fit.groups, fit.log_factors)[1]
        v = (own + u @ fit.covariance @ u.swapaxes(1, 2))[:, rows, rows]
        out.append(float(np.einsum('di,dij,dj->di', left, np.linalg.inv(v), left).mean()))
    return out[0], out[1], out[2]


def _ratio(data: DriveLikelihood, fit: Fit, sensor: str) -> Estimate:
    """Return the ratio of the rms errors of a sensor to their prediction.

    An unknown drift is predicted as the drives show it, but at most at its limit.
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

    middle, half = log_ratio(fit.log_factors), np.diag(_quantile(fit) * fit.errors)
    low, high = (
        middle + sign * math.hypot(*(log_ratio(fit.log_factors + sign * h) - middle for h in half))
        for sign in (-1.0, 1.0)
    )
    return Estimate(math.exp(middle), (math.exp(low), math.exp(high)))


def _raised(
    data: DriveLikelihood, fit: Fit, sensor: str, part: Part
) -> tuple[Estimate | None, Estimate | None]:
    """Return the factors of white noise and drift of a sensor."""
    halves = _quantile(fit) * fit.errors
    found = {
        names[0]: tuple(math.exp((x + s * h - offset) / 2.0) for s in (0.0, -1.0, 1.0))
        for names, x, h in zip(fit.groups, fit.log_factors.tolist(), halves.tolist())
        for offset in [LIMIT * data.unknown.get(names[0], 0.0)]
    }
    estimates = {name: Estimate(x, (low, high)) for name, (x, low, high) in found.items()}
    white = estimates.get(f'{sensor}_white')
    if part == 'all':
        return white, white
    drift = estimates.get(f'{sensor}_drift')
    is_above_limit = drift is not None and (drift.value or 0.0) > 1.0
    return white, drift if is_above_limit else estimates.get(f'{sensor}_slow')


def _quantile(fit: Fit) -> float:
    """Return the 97.5 % quantile of Student's t distribution for the number of drives."""
    from scipy.special import stdtrit  # slow to import

    return float(stdtrit(len(fit.scores) - 2, 0.975))


def _part(data: DriveLikelihood, fit: Fit, sensor: str) -> tuple[Part, Fit]:
    """Return which noise of a sensor is larger in motion, and the fit with the factor of it."""
    if f'{sensor}_slow' not in data.noise:
        return 'white', fit
    trials: dict[Part, Fit] = {}
    for part in ('white', 'slow'):
        names = (f'{sensor}_{part}',)
        groups = tuple(names if both[0].startswith(sensor) else both for both in BOTH)
        trials[part] = data.fit(groups, fit.causes, fit)
    best, other = sorted(trials, key=lambda each: -trials[each].value)
    is_clear = trials[best].value - trials[other].value > GAIN_PART
    if is_clear and trials[best].value > fit.value - 1.0:
        return best, trials[best]
    return 'all', fit


def _elements(data: DriveLikelihood, fit: Fit, name: str) -> tuple[Estimate, ...]:
    """Return the elements of the matrix of a cause with their intervals."""
    means, deviations = data.elements(fit, name)
    half = _quantile(fit) * deviations
    known = deviations < KNOWN_SHARE * CAUSES[name]
    return tuple(
        Estimate(x, (x - h, x + h)) if is_known else Estimate(None, status='not_observable')
        for x, h, is_known in zip(means.tolist(), half.tolist(), known.tolist())
    )
