# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""By which factors the errors of an IMU are larger in motion than its noise at rest predicts.

Model
-----
The residuals y of all drives are normally distributed with mean 0 and the covariance

    V = s_g^2 G + s_a^2 A + F.

G and A are the covariances due to the noise of gyro and accelerometer at rest, one block per drive.
F is the covariance of what is unknown but no noise: the bias of the accelerometer and its changes
between drives, local gravity, the rotation of the Earth, and, if they are to be estimated, matrices
of scale factors and misalignments. The factors s_g and s_a maximize the likelihood (Fisher
scoring; variance components, H. D. Patterson, R. Thompson, Biometrika 1971).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..estimate import Estimate
from ..fields import Fields
from ..noise import Model
from ..stream.drives import EARTH_RATE, DriveErrors, NoiseAtRest

Floats = NDArray[np.float64]

LEAST_DRIVES = 5
"""Fewest drives for a result: the quantile of the intervals, t with this number minus 2, is 3.2."""

SIGMA_BIAS = 0.5
"""Prior standard deviation of the bias of the accelerometer in m/s^2."""

GRAVITY, SIGMA_GRAVITY = 9.806, 0.03
"""Gravity on the surface of the Earth and its prior standard deviation in m/s^2: 9.78 at the
equator, 9.83 at the poles (WGS 84), with a scale factor of the accelerometer of 0.2 %."""

CAUSES: Mapping[str, float] = {
    'gyro_matrix': 0.01,
    'accel_matrix': 0.01,
    'g_sensitivity': 1e-3,
}
"""Errors of calibration that may be estimated, and the prior standard deviation of their elements:
0.01 rad or 1 %, and 1e-3 rad/s per m/s^2 (0.6 deg/s per g), typical limits of MEMS datasheets."""

GAIN_CAUSE = 10.0
"""Least gain in 2 log L for a matrix to be named as a cause."""

GAIN_PART = 4.0
"""Least gain in 2 log L for the white or the slow noise alone to carry a factor."""

KNOWN_SHARE = 0.5
"""An element of a matrix is determined if its standard deviation is below this share of the one
before the data."""

SIGMA_LOG = 2.0 * math.log(5.0)
"""Prior standard deviation of the logarithms of s_g^2 and s_a^2: factors of 1/25 to 25 within two
standard deviations. It only matters if the drives do not determine a factor."""

Part = Literal['all', 'white', 'slow']

RAISED: Mapping[str, Part] = {'gyro': 'all', 'accel': 'all'}
"""Sensors with a factor, and the noise that it multiplies unless the drives tell more."""

ROWS = 7
MOST_STEPS, STEP, CONVERGED = 60, 1.5, 1e-4


@dataclass(frozen=True)
class Cause:
    """A matrix of calibration errors that explains errors in motion.

    Attributes
    ----------
    name : str
        One of `CAUSES`.
    gain : float
        Gain in 2 log L.
    elements : tuple of nine Estimate
        Elements of the matrix, row by row; errors are the matrix times the true rates or specific
        forces. Elements that the drives do not determine are not resolved: gravity shows no
        rotation around the vertical.
    """

    name: str
    gain: float
    elements: tuple[Estimate, ...]

    @property
    def matrix(self) -> Floats:
        """The matrix, (3, 3); NaN for elements that are not resolved."""
        values = [np.nan if one.value is None else one.value for one in self.elements]
        return np.array(values).reshape(3, 3)

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
        Ratio of the standard deviations, without any calibration error in the model.
    part : 'white', 'slow' or 'all'
        Which noise the factor multiplies: 'white' if the errors grow with the root of the duration
        of a drive (raise N), 'slow' if they grow faster (raise K), 'all' if the drives do not tell.
    explained : Estimate or None
        The factor with the matrices of all causes in the model; None without causes.
    """

    factor: Estimate
    part: Part
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
        Matrices that explain errors, the largest gain first.
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

    The ramp of a recording is no noise, and the bias at the rest before each drive is subtracted.
    """
    drift = [p for p in model.drift.parts if not (p.process.is_white or p.process.is_regressor)]
    slow = [
        (part.process.variance_of(part.value, tau0), part.process.in_unit(tau0)) for part in drift
    ]

    def gamma(M: float, j: ArrayLike) -> Floats:
        values = (variance * unit.gamma(max(M / tau0, 1.0), j) for variance, unit in slow)
        return np.asarray(sum(values, np.zeros(np.shape(j))))

    return NoiseAtRest(model.value('N') ** 2, gamma)


def noise_in_motion(
    drives: Sequence[DriveErrors], noise: Sequence[NoiseAtRest]
) -> NoiseInMotion | None:
    """Return the factors of all drives; None for fewer than `LEAST_DRIVES`.

    Parameters
    ----------
    drives : sequence of DriveErrors
        Drives of one IMU.
    noise : sequence of NoiseAtRest
        Noise of the six axes at rest.

    Returns
    -------
    NoiseInMotion or None
    """
    if len(drives) < LEAST_DRIVES:
        return None
    data = _Stack.of(drives, noise)
    plain = data.fit(())
    names: list[str] = []
    gains: dict[str, float] = {}
    best = plain
    while True:
        trials = {name: data.fit((*names, name), best) for name in CAUSES if name not in names}
        if not trials:
            break
        name = max(trials, key=lambda each: trials[each].value)
        if trials[name].value - best.value < GAIN_CAUSE:
            break
        gains[name] = trials[name].value - best.value
        names.append(name)
        best = trials[name]
    parts, explained = data.parts(plain), data.factors(best) if names else {}
    sensors = {
        sensor: SensorInMotion(factor, parts[sensor], explained.get(sensor))
        for sensor, factor in data.factors(plain).items()
    }
    causes = tuple(data.cause(best, name, gains[name]) for name in names)
    ratios = zip(drives, data.ratios(plain).tolist())
    return NoiseInMotion(
        **sensors,
        causes=causes,
        drives=tuple(DriveRatio(each.duration, each.turned, *ratio) for each, ratio in ratios),
    )


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
    data = _Stack.of(used, noise)
    plain = data.fit(())
    motion = noise_in_motion(used, noise)
    names = () if motion is None else tuple(each.name for each in motion.causes)
    whole = _Stack.of([*used, *others], noise)
    n, d = len(data.y), len(others)
    out = []
    for fit in (plain._replace(log_factors=np.zeros(2)), plain, data.fit(names, plain)):
        v = whole.covariance(fit)
        known = np.linalg.solve(v[:n, :n], np.column_stack([whole.y[:n], v[:n, n:]]))
        left = (whole.y[n:] - v[n:, :n] @ known[:, 0]).reshape(d, ROWS)
        spread = (v[n:, n:] - v[n:, :n] @ known[:, 1:]).reshape(d, ROWS, d, ROWS)
        own = spread[np.arange(d), :, np.arange(d), :][:, :-1, :-1]
        squares = np.einsum('di,dij,dj->d', left[:, :-1], np.linalg.inv(own), left[:, :-1])
        out.append(float(squares.mean()) / (ROWS - 1))
    return out[0], out[1], out[2]


class _Fit(NamedTuple):
    """Maximum of the likelihood."""

    causes: tuple[str, ...]
    log_factors: Floats  # logarithms of s_g^2, s_a^2
    value: float  # 2 log L
    weighted: Floats  # V^-1 y, (n,)
    inverse: Floats  # V^-1, (drives, rows, drives, rows)
    information: Floats  # of the logarithms, (2, 2)
    scores: Floats  # of each drive, (drives, 2)


@dataclass(frozen=True)
class _Stack:
    """Residuals of all drives with the covariances of the model."""

    y: Floats  # (n,)
    noise: Mapping[str, Floats]  # part of a sensor -> (drives, rows, rows)
    fixed: Floats  # F without matrices, (n, n)
    own: Floats  # part of F that is independent from drive to drive, (drives, rows, rows)
    effects: Mapping[str, Floats]  # cause -> (n, 9)

    @classmethod
    def of(cls, drives: Sequence[DriveErrors], noise: Sequence[NoiseAtRest]) -> _Stack:
        residual = np.array([each.residual for each in drives])
        residual[:, -1] -= GRAVITY
        n, d = residual.size, len(drives)
        each_drive = [each.covariances(noise) for each in drives]
        predicted = {name: np.array([each[name] for each in each_drive]) for name in each_drive[0]}
        bias = np.array([each.accel_bias for each in drives])
        start = np.array([each.start for each in drives])
        apart = np.abs(start[:, None] - start)
        fixed = np.zeros((d, ROWS, d, ROWS))
        fixed[:, -1, :, -1] += SIGMA_GRAVITY**2
        for axis in range(3):
            h = bias[:, :, axis]
            change = _change_variance(noise[3 + axis], apart)
            between = SIGMA_BIAS**2 + (change[:, :1] + change[:1] - change) / 2.0
            fixed += np.einsum('di,de,ej->diej', h, between, h)
        at = np.arange(d)
        earth = np.array([each.earth for each in drives]) * (EARTH_RATE / math.sqrt(3.0))
        own = earth @ earth.transpose(0, 2, 1) + predicted.pop('rests')
        fixed[at, :, at, :] += own
        effects = {
            name: np.array([getattr(each, name) for each in drives]).reshape(n, 9)
            for name in CAUSES
        }
        return cls(residual.ravel(), predicted, fixed.reshape(n, n), own, effects)

    @property
    def drives(self) -> int:
        return len(self.y) // ROWS

    def fit(
        self,
        causes: tuple[str, ...],
        start: _Fit | None = None,
        parts: Mapping[str, str] = RAISED,
    ) -> _Fit:
        """Maximize the likelihood over both factors, with some matrices in the model."""
        fixed = self.fixed.copy()
        blocks = np.arange(self.drives)
        at = fixed.reshape(self.drives, ROWS, self.drives, ROWS)
        for name in causes:
            fixed += CAUSES[name] ** 2 * self.effects[name] @ self.effects[name].T
        raised: list[Floats] = []
        for sensor, part in parts.items():
            white, slow = (self.noise[f'{sensor}_{each}'] for each in ('white', 'slow'))
            raised.append({'all': white + slow, 'white': white, 'slow': slow}[part])
            at[blocks, :, blocks, :] += white + slow - raised[-1]
        theta = np.zeros(2) if start is None else start.log_factors
        step, found = 1.0, self._evaluated(theta, causes, raised, fixed)
        for _ in range(MOST_STEPS):
            gradient = found.scores.sum(axis=0) - found.log_factors / SIGMA_LOG**2
            move = np.linalg.solve(found.information, gradient)
            move *= step * min(1.0, STEP / max(np.abs(move).max(), 1e-300))
            moved = found.log_factors + move
            new = self._evaluated(moved, causes, raised, fixed)
            if new.value < found.value - 1e-9:
                step *= 0.5
                if step < 1e-3:
                    break
                continue
            done = np.abs(moved - found.log_factors).max() < CONVERGED
            found, step = new, min(2.0 * step, 1.0)
            if done:
                break
        return found

    def _evaluated(
        self,
        theta: Floats,
        causes: tuple[str, ...],
        raised: Sequence[Floats],
        fixed: Floats,
    ) -> _Fit:
        """Return the likelihood, its derivatives and the inverse of V at some factors."""
        d, n = self.drives, len(self.y)
        at = np.arange(d)
        each = [math.exp(t) * v for t, v in zip(theta, raised)]
        v = fixed.copy()
        v.reshape(d, ROWS, d, ROWS)[at, :, at, :] += each[0] + each[1]
        scale = np.sqrt(np.diag(v))  # residuals have three units
        root = np.linalg.cholesky(v / np.outer(scale, scale))
        half = np.linalg.inv(root) / scale
        inverse = half.T @ half
        white = half @ self.y
        weighted = half.T @ white
        value = -float(white @ white) - 2.0 * float(np.log(np.diag(root) * scale).sum())
        value -= float(theta @ theta) / SIGMA_LOG**2
        rows = weighted.reshape(d, ROWS)
        blocks = inverse.reshape(d, ROWS, d, ROWS)
        own = blocks[at, :, at, :]
        scores = np.stack(
            [
                0.5 * (np.einsum('di,dij,dj->d', rows, b, rows) - np.einsum('dij,dji->d', own, b))
                for b in each
            ],
            axis=1,
        )
        products = [np.matmul(inverse.reshape(n, d, ROWS).transpose(1, 0, 2), b) for b in each]
        products = [p.transpose(1, 0, 2).reshape(n, n) for p in products]  # V^-1 V_i
        information = np.array([[0.5 * np.sum(a * b.T) for b in products] for a in products])
        information += np.eye(2) / SIGMA_LOG**2
        return _Fit(causes, theta, value, weighted, blocks, information, scores)

    def covariance(self, fit: _Fit) -> Floats:
        """Return V with the factors and causes of a fit."""
        v = self.fixed.copy()
        for name in fit.causes:
            v += CAUSES[name] ** 2 * self.effects[name] @ self.effects[name].T
        at = np.arange(self.drives)
        blocks = v.reshape(self.drives, ROWS, self.drives, ROWS)
        for sensor, x in zip(RAISED, fit.log_factors.tolist()):
            noise = self.noise[f'{sensor}_white'] + self.noise[f'{sensor}_slow']
            blocks[at, :, at, :] += math.exp(x) * noise
        return v

    def factors(self, fit: _Fit) -> dict[str, Estimate]:
        """Return the factors of both sensors with their intervals."""
        t = _quantile_t(self.drives - 2)
        return {
            sensor: Estimate(
                math.exp(x / 2.0), (math.exp((x - t * e) / 2.0), math.exp((x + t * e) / 2.0))
            )
            for sensor, x, e in zip(RAISED, fit.log_factors.tolist(), self._errors(fit).tolist())
        }

    def parts(self, fit: _Fit) -> dict[str, Part]:
        """Return which noise of each sensor carries its factor."""
        chosen: dict[str, Part] = {}
        for sensor in RAISED:
            gains = {
                part: self.fit(fit.causes, fit, {**RAISED, sensor: part}).value
                for part in ('white', 'slow')
            }
            best = max(gains, key=lambda each: gains[each])
            is_clear = gains[best] - min(gains.values()) > GAIN_PART
            chosen[sensor] = best if is_clear and gains[best] > fit.value - 1.0 else 'all'  # type: ignore[assignment]
        return chosen

    def _errors(self, fit: _Fit) -> Floats:
        """Return the standard errors of the logarithms: from the likelihood or, if larger, from
        the scatter of the scores of the drives (sandwich), which needs no normal distribution.
        """
        covariance = np.linalg.inv(fit.information)
        spread = fit.scores.T @ fit.scores * (self.drives / (self.drives - 2))
        robust = covariance @ spread @ covariance
        return np.asarray(np.sqrt(np.maximum(np.diag(covariance), np.diag(robust))))

    def cause(self, fit: _Fit, name: str, gain: float) -> Cause:
        """Return the posterior mean and interval of the elements of a matrix."""
        sigma, x = CAUSES[name], self.effects[name]
        n = len(self.y)
        mean = sigma**2 * x.T @ fit.weighted
        covariance = sigma**2 * np.eye(9) - sigma**4 * x.T @ fit.inverse.reshape(n, n) @ x
        half = _quantile_t(self.drives - 2) * np.sqrt(np.maximum(np.diag(covariance), 0.0))
        known = np.diag(covariance) < (KNOWN_SHARE * sigma) ** 2
        elements = tuple(
            Estimate(x, (x - h, x + h)) if is_known else Estimate(None, status='not_observable')
            for x, h, is_known in zip(mean.tolist(), half.tolist(), known.tolist())
        )
        return Cause(name, gain, elements)

    def ratios(self, fit: _Fit) -> Floats:
        """Return the lengths of rotation and velocity errors over their predicted rms, (drives, 2).

        The prediction is that of the noise at rest, with what else is unknown in a single drive.
        The errors are without what all drives tell about the bias of the accelerometer (best
        linear prediction, which needs the covariance with the factors).
        """
        v = sum(self.noise.values(), self.own)
        weighted = fit.weighted.reshape(self.drives, ROWS)
        shared = (self.fixed @ fit.weighted).reshape(self.drives, ROWS)
        shared -= np.einsum('dij,dj->di', self.own, weighted)
        y = self.y.reshape(self.drives, ROWS) - shared
        squares = y**2, np.einsum('dii->di', v)
        return np.stack(
            [
                np.sqrt(np.divide(*(each[:, rows].sum(axis=1) for each in squares)))
                for rows in (slice(0, 3), slice(3, 6))
            ],
            axis=1,
        )


def _change_variance(noise: NoiseAtRest, apart: Floats) -> Floats:
    """Return the variance of the change of the bias between two times, ``apart`` in s."""
    block = 10.0
    j = np.maximum(apart / block, 0.0)
    gamma = np.asarray(noise.slow(block, np.maximum(j, 1.0)))
    zero = float(np.asarray(noise.slow(block, np.zeros(1)))[0])
    change = 2.0 * (zero - gamma)
    return np.asarray(np.where(j >= 1.0, change, change * j))


def _quantile_t(free: int) -> float:
    """Return the 97.5 % quantile of Student's t distribution, within 0.5 % from 3 degrees on.

    Expansion in 1/free (Abramowitz & Stegun 26.7.5).
    """
    z = 1.959963984540054
    terms = (
        (z**3 + z) / 4.0,
        (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0,
        (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0,
        (79.0 * z**9 + 776.0 * z**7 + 1482.0 * z**5 - 1920.0 * z**3 - 945.0 * z) / 92160.0,
    )
    return z + math.fsum(term / free ** (i + 1) for i, term in enumerate(terms))
