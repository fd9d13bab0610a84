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
from ..stream.drives import ROTATION, ROWS, VELOCITY, DriveErrors, cross_matrices
from .drive_likelihood import CAUSES, DriveLikelihood, Fit, NoiseAtRest

Floats = NDArray[np.float64]

LEAST_DRIVES = 5
"""Fewest drives for a result: the quantile of the intervals, t with this number minus 2, is 3.2."""

DRIFT_S = 100.0
"""Time in s after which an unknown drift adds as much to an integral as white noise does, as an
average over sensors. The drives show whether it is 4 or 2500 s."""

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
    """Factor of one sensor: its errors in motion over the prediction from its noise at rest.

    Attributes
    ----------
    factor : Estimate
        Ratio of the rms errors of all drives to their prediction, of the angle for the gyro and of
        the velocity for the accelerometer, without any calibration error in the model.
    part : 'white', 'slow' or 'all'
        Which noise is larger in motion: 'white' if the errors grow with the root of the duration of
        a drive (raise N), 'slow' if they grow faster (raise K), 'all' if the drives do not tell. If
        the rests do not resolve the drift, it is only known together with the drives, and the part
        is 'white'.
    raised : Estimate
        Factor of the noise of this part.
    explained : Estimate or None
        ``factor`` with the matrices of all causes in the model; None without causes.
    """

    factor: Estimate
    part: Part
    raised: Estimate
    explained: Estimate | None = None


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


def axis_noise(model: Model, tau0: float) -> NoiseAtRest:
    """Return the noise of an axis whose sample period is ``tau0`` (s) from its model.

    The ramp of a recording is no noise, and the bias at the rest before each drive is subtracted. A
    model without any drift means that the drift is unknown.
    """
    white = model.value('N')
    drift = [p for p in model.drift.parts if not (p.process.is_white or p.process.is_regressor)]
    walk = white * math.sqrt(3.0) / DRIFT_S
    parts = drift or Model.of(B=walk * math.sqrt(FLICKER_S), K=walk).parts
    slow = [
        (part.process.variance_of(part.value, tau0), part.process.in_unit(tau0)) for part in parts
    ]

    def gamma(M: float, j: ArrayLike) -> Floats:
        values = (variance * unit.gamma(max(M / tau0, 1.0), j) for variance, unit in slow)
        return np.asarray(sum(values, np.zeros(np.shape(j))))

    return NoiseAtRest(white, gamma, bool(drift))


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
        factor, raised = _factor(data, fit, sensor)
        explained = _factor(data, best, sensor)[0] if gains else None
        sensors[sensor] = SensorInMotion(factor, part, raised, explained)
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
    used: Sequence[DriveErrors], others: Sequence[DriveErrors], noise: Sequence[NoiseAtRest]
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

    Returns
    -------
    (float, float, float)
        Mean of the squared errors of rotation and velocity over their predicted variance: with the
        noise at rest, with the factors, and with factors and causes. 1 is right.
    """
    data = DriveLikelihood.of(used, noise)
    plain = data.fit(BOTH)
    motion = noise_in_motion(used, noise)
    names = () if motion is None else tuple(each.name for each in motion.causes)
    whole = DriveLikelihood.of([*used, *others], noise)
    n, d = len(data.y), len(others)
    out = []
    at_rest = plain.log_factors.copy()
    at_rest[:2] = 0.0
    rows = np.arange(ROWS)[ROTATION.start : VELOCITY.stop]
    ahead = n + (np.arange(d)[:, None] * ROWS + rows).ravel()
    for fit in (plain._replace(log_factors=at_rest), plain, data.fit(BOTH, names, plain)):
        v = whole.covariance(fit)
        known = np.linalg.solve(v[:n, :n], np.column_stack([whole.y[:n], v[:n, ahead]]))
        left = (whole.y[ahead] - v[ahead, :n] @ known[:, 0]).reshape(d, -1)
        spread = v[np.ix_(ahead, ahead)] - v[ahead, :n] @ known[:, 1:]
        spread = spread.reshape(d, len(rows), d, len(rows))
        own = spread[np.arange(d), :, np.arange(d), :]
        squares = np.einsum('di,dij,dj->d', left, np.linalg.inv(own), left)
        out.append(float(squares.mean()) / len(rows))
    return out[0], out[1], out[2]


def _factor(data: DriveLikelihood, fit: Fit, sensor: str) -> tuple[Estimate, Estimate]:
    """Return the ratio of the errors of a sensor to the prediction, and the factor of its noise."""
    index = list(SENSORS).index(sensor)
    rows = {'gyro': ROTATION, 'accel': VELOCITY}[sensor]
    sizes = {
        name: float(data.variances(name, fit).reshape(-1, ROWS)[:, rows].sum())
        for name in data.noise
        if name.startswith(sensor)
    }
    share = sum(sizes[name] for name in fit.groups[index] if name in sizes) / sum(sizes.values())
    log, half = fit.log_factors[index], _quantile(fit) * fit.errors[index]
    raised = [math.exp(x / 2.0) for x in (log, log - half, log + half)]
    total = [math.sqrt(1.0 - share + share * x**2) for x in raised]
    ratio, factor = (Estimate(x[0], (x[1], x[2])) for x in (total, raised))
    return ratio, factor


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
