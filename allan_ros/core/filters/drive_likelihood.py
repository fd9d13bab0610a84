# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Likelihood of the errors of drives.

The residuals y of all drives are normally distributed with mean 0 and the covariance

    V = s_1^2 M_1 + s_2^2 M_2 + ... + F.

M_i are covariances due to noise of the sensors, as at rest. F is the covariance of what is unknown
in any case: white noise in the means of the rests, the bias of the accelerometer, the rotation of
the Earth, errors of second order, and, if they are to be estimated, calibration errors.
The factors s_i maximize the likelihood (Fisher scoring; variance components, H. D. Patterson,
R. Thompson, Biometrika 1971).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..stream.drives import (
    EARTH_RATE,
    ROTATION,
    ROWS,
    VELOCITY,
    DriveErrors,
    SlowNoise,
    cross_matrices,
)

Floats = NDArray[np.float64]

SIGMA_BIAS = 0.5
"""Prior standard deviation of the bias of the accelerometer in m/s^2."""

GRAVITY, SIGMA_GRAVITY = 9.806, 0.03
"""Gravity on the surface of the Earth and its prior standard deviation in m/s^2: 9.78 at the
equator, 9.83 at the poles (WGS 84), with a scale factor of the accelerometer of 0.2 %."""

CAUSES: Mapping[str, float] = {
    'rotation': 0.01,
    'gyro_matrix': 0.01,
    'accel_matrix': 0.01,
    'g_sensitivity': 1e-3,
}
"""Errors of calibration that may be estimated, and the prior standard deviation of their elements:
0.01 rad or 1 %, and 1e-3 rad/s per m/s^2 (0.6 deg/s per g), typical limits of MEMS datasheets. Both
matrices include a rotation of one sensor against the other, which alone has three elements."""

SIGMA_LOG = 2.0 * math.log(5.0)
"""Prior standard deviation of the logarithms of s_i^2: factors of 1/25 to 25 within two standard
deviations. It only matters if the drives do not determine a factor."""

MOST_STEPS, STEP, CONVERGED = 60, 1.5, 3e-3
"""Largest number of steps of the logarithms of s_i^2, the largest step, and the last one."""

Groups = tuple[tuple[str, ...], ...]
"""Names of the covariances that have a common factor, for each factor."""


class NoiseAtRest(NamedTuple):
    """Noise of one axis at rest.

    Attributes
    ----------
    white : float
        White noise density N in SI.
    slow : function
        Noise that is not white.
    unknown : float
        Standard deviation of the logarithm of the power of ``slow``; 0 if it was measured. The
        drives then show how much the bias changes from rest to rest, and this drift is no error in
        motion.
    """

    white: float
    slow: SlowNoise
    unknown: float = 0.0


class Fit(NamedTuple):
    """Maximum of the likelihood.

    Attributes
    ----------
    groups : tuple of tuple of str
        Names of the noise of each factor.
    causes : tuple of str
        Calibration errors in the model, of `CAUSES`.
    log_factors : (k,) array
        Logarithms of s_i^2.
    value : float
        2 log L up to a constant.
    weighted : (n,) array
        V^-1 y.
    inverse : (n, n) array
        V^-1.
    information : (k, k) array
        Fisher information of the logarithms.
    scores : (drives, k) array
        Derivatives of log L by the logarithms, share of each drive.
    """

    groups: Groups
    causes: tuple[str, ...]
    log_factors: Floats
    value: float
    weighted: Floats
    inverse: Floats
    information: Floats
    scores: Floats

    @property
    def errors(self) -> Floats:
        """Standard errors of the logarithms: from the likelihood or, if larger, from the scatter of
        the scores of the drives (sandwich), which needs no normal distribution.
        """
        drives = len(self.scores)
        covariance = np.linalg.inv(self.information)
        spread = self.scores.T @ self.scores * (drives / (drives - 2))
        robust = covariance @ spread @ covariance
        return np.asarray(np.sqrt(np.maximum(np.diag(covariance), np.diag(robust))))


@dataclass(frozen=True)
class DriveLikelihood:
    """Residuals of drives and the covariances of everything that may have caused them.

    Attributes
    ----------
    y : (n,) array
        Residuals of all drives.
    noise : mapping of str to (n, n) array
        Covariances M: 'gyro_white', 'gyro_slow', 'accel_white' and 'accel_slow' as measured at
        rest, 'gyro_drift' and 'accel_drift' if drift is unknown.
    own : (n, n) array
        Covariance of white noise at the rests, and of errors of second order.
    common : (n, n) array
        Covariance of what drives have in common: bias of the accelerometer, rotation of the Earth.
    unknown : mapping of str to float
        Standard deviation of the logarithm of the factor of each unknown drift.
    effects : mapping of str to (n, 9) or (n, 3) array
        Effects of the elements of `CAUSES`.
    """

    y: Floats
    noise: Mapping[str, Floats]
    own: Floats
    common: Floats
    unknown: Mapping[str, float]
    effects: Mapping[str, Floats]

    @classmethod
    def of(cls, drives: Sequence[DriveErrors], noise: Sequence[NoiseAtRest]) -> DriveLikelihood:
        """Return the likelihood of drives, if the axes have this noise at rest."""
        h = np.array([each.accel_bias for each in drives])
        bias, prior = _accel_bias(drives)
        y = (np.array([each.residual for each in drives]) - h @ bias).ravel()
        n = len(y)
        density = [axis.white for axis in noise]
        whites = [each.white_covariances(density) for each in drives]
        covariances = {
            f'{sensor}_white': _diagonal([white[sensor] for white in whites])
            for sensor in ('gyro', 'accel')
        }
        unknown: dict[str, float] = {}
        own = _diagonal([white['rests'] for white in whites])
        own += np.diag(np.concatenate([_second_order(each) ** 2 for each in drives]))
        for axis, one in enumerate(noise):
            name = f'{"gyro" if axis < 3 else "accel"}_{"drift" if one.unknown else "slow"}'
            if one.unknown:
                unknown[name] = max(unknown.get(name, 0.0), one.unknown)
            part = _diagonal([each.slow_covariance(axis, one.slow) for each in drives])
            if axis >= 3:
                on_bias = _diagonal(h[:, :, axis - 3, None])
                part += on_bias @ _changes(one.slow, drives) @ on_bias.T
            covariances[name] = covariances.get(name, 0.0) + part
        constant, earth = h.reshape(n, 3), _turned_earth(drives).reshape(n, -1)
        common = constant @ prior @ constant.T + EARTH_RATE**2 / 3.0 * earth @ earth.T
        effects = {
            name: np.array([getattr(each, name) for each in drives]).reshape(n, 9)
            for name in CAUSES
            if name != 'rotation'
        }
        effects['rotation'] = effects['gyro_matrix'] @ cross_matrices(np.eye(3)).reshape(3, 9).T
        return cls(y, covariances, own, common, unknown, effects)

    @property
    def drives(self) -> int:
        """Number of drives."""
        return len(self.y) // ROWS

    def fit(self, groups: Groups, causes: tuple[str, ...] = (), start: Fit | None = None) -> Fit:
        """Maximize the likelihood over the factors.

        Parameters
        ----------
        groups : tuple of tuple of str
            Names of the noise of each factor. An unknown drift has a factor of its own in any case,
            and other noise is as at rest.
        causes : tuple of str
            Calibration errors in the model.
        start : Fit, optional
            A fit with as many factors, at which the search begins.

        Returns
        -------
        Fit
        """
        groups = (*groups, *((name,) for name in self.unknown))
        theta = np.zeros(len(groups)) if start is None else start.log_factors
        raised, fixed = self._parts(groups, causes)
        sigma = np.array([self.unknown.get(names[0], SIGMA_LOG) for names in groups])
        evaluated = partial(self._evaluated, groups, causes, raised, fixed, sigma)
        step, found = 1.0, evaluated(theta)
        for _ in range(MOST_STEPS):
            gradient = found.scores.sum(axis=0) - found.log_factors / sigma**2
            move = np.linalg.solve(found.information, gradient)
            move *= step * min(1.0, STEP / max(np.abs(move).max(), 1e-300))
            new = evaluated(found.log_factors + move)
            if new.value < found.value - 1e-9:
                step *= 0.5
                if step < 1e-3:
                    break
                continue
            found, step = new, min(2.0 * step, 1.0)
            if np.abs(move).max() < CONVERGED:
                break
        return found

    def covariance(self, fit: Fit) -> Floats:
        """Return V with the factors and causes of a fit."""
        raised, fixed = self._parts(fit.groups, fit.causes)
        return sum((factor * m for factor, m in zip(np.exp(fit.log_factors), raised)), fixed)

    def _parts(self, groups: Groups, causes: tuple[str, ...]) -> tuple[list[Floats], Floats]:
        """Return the covariances that have a factor each, and the others."""
        zero = np.zeros_like(self.own)
        raised = [sum((self.noise.get(name, zero) for name in names), zero) for names in groups]
        named = {name for names in groups for name in names}
        others = [v for name, v in self.noise.items() if name not in named]
        matrices = [CAUSES[name] * self.effects[name] for name in causes]
        others += [x @ x.T for x in matrices]
        return raised, sum(others, self.own + self.common)

    def _evaluated(
        self,
        groups: Groups,
        causes: tuple[str, ...],
        raised: Sequence[Floats],
        fixed: Floats,
        sigma: Floats,
        theta: Floats,
    ) -> Fit:
        """Return the likelihood, its derivatives and the inverse of V at some factors."""
        each = [math.exp(t) * v for t, v in zip(theta, raised)]
        v = sum(each, fixed)
        scale = np.sqrt(np.diag(v))  # residuals have different units
        root = np.linalg.cholesky(v / np.outer(scale, scale))
        half = np.linalg.inv(root) / scale
        inverse = half.T @ half
        white = half @ self.y
        weighted = half.T @ white
        value = -float(white @ white) - 2.0 * float(np.log(np.diag(root) * scale).sum())
        value -= float(np.square(theta / sigma).sum())
        products = [inverse @ m for m in each]
        terms = [weighted * (m @ weighted) - np.diag(p) for m, p in zip(each, products)]
        scores = np.stack([0.5 * one.reshape(-1, ROWS).sum(axis=1) for one in terms], axis=1)
        information = np.array([[0.5 * np.sum(a * b.T) for b in products] for a in products])
        information += np.diag(sigma**-2)
        return Fit(groups, causes, theta, value, weighted, inverse, information, scores)

    def elements(self, fit: Fit, name: str) -> tuple[Floats, Floats]:
        """Return the posterior means and standard deviations of the elements of a cause, (k,)."""
        sigma, x = CAUSES[name], self.effects[name]
        variance = sigma**2 - sigma**4 * np.einsum('ij,ik,kj->j', x, fit.inverse, x, optimize=True)
        return sigma**2 * x.T @ fit.weighted, np.sqrt(np.maximum(variance, 0.0))

    def ratios(self, fit: Fit) -> Floats:
        """Return the lengths of rotation and velocity errors over their predicted rms, (drives, 2).

        The errors are without what the drives tell about `common` (best linear prediction), and the
        prediction is that of the noise at rest.
        """
        y = self.y - self.common @ fit.weighted
        noise = sum((self.variances(name, fit) for name in self.noise), np.diag(self.own))
        squares, variances = (x.reshape(-1, ROWS) for x in (y**2, noise))
        return np.stack(
            [
                np.sqrt(squares[:, rows].sum(axis=1) / variances[:, rows].sum(axis=1))
                for rows in (ROTATION, VELOCITY)
            ],
            axis=1,
        )

    def variances(self, name: str, fit: Fit) -> Floats:
        """Return the variances due to a noise at rest, (n,); drift has the level of a fit."""
        drift = {names[0]: x for names, x in zip(fit.groups, fit.log_factors) if len(names) == 1}
        level = math.exp(drift[name]) if name in self.unknown else 1.0
        return np.asarray(level * np.diag(self.noise[name]))


def _second_order(drive: DriveErrors) -> Floats:
    """Return the size of errors of second order in the rotation, (9,).

    A rotation error psi moves the vector of gravity g by psi g to first order, and by psi^2 g / 2
    to second order. psi is known at the end from the rotation, and its mean from the velocity.
    """
    at_end = float(np.linalg.norm(drive.residual[ROTATION])) / GRAVITY
    mean = float(np.linalg.norm(drive.residual[VELOCITY])) / (GRAVITY * drive.duration)
    out = np.zeros(ROWS)
    out[ROTATION] = at_end**2 * GRAVITY / 2.0
    out[VELOCITY] = (at_end**2 + mean**2) * GRAVITY / 2.0 * drive.duration
    return out


def _accel_bias(drives: Sequence[DriveErrors]) -> tuple[Floats, Floats]:
    """Return the mean, (3,), and covariance, (3, 3), of the bias from the length of gravity."""
    force = np.array([each.force for each in drives])
    length = np.linalg.norm(force, axis=1)
    up = force / length[:, None]
    known = up.T @ up / len(drives) / SIGMA_GRAVITY**2
    covariance = np.linalg.inv(np.eye(3) / SIGMA_BIAS**2 + known)
    return covariance @ up.T @ (length - GRAVITY) / len(drives) / SIGMA_GRAVITY**2, covariance


def _changes(slow: SlowNoise, drives: Sequence[DriveErrors]) -> Floats:
    """Return the covariance of the changes of a bias since the first drive, (drives, drives)."""
    start = np.array([each.start for each in drives])
    mean_over = 10.0  # s
    lags = np.abs(start[:, None] - start) / mean_over
    at_lags, at_zero = slow(mean_over, np.maximum(lags, 1.0)), slow(mean_over, np.zeros(1))
    change = 2.0 * (float(at_zero[0]) - np.asarray(at_lags)) * np.minimum(lags, 1.0)
    return np.asarray((change[:, :1] + change[:1] - change) / 2.0)


def _turned_earth(drives: Sequence[DriveErrors]) -> Floats:
    """Return the effects of the rotation rate of the Earth in one frame, (drives, 6, 3 drives).

    Drives that follow on each other have their columns in common, in the frame of the first.
    """
    out = np.zeros((len(drives), ROWS, len(drives), 3))
    column, frame = 0, np.eye(3)  # from the sensor at the first rest to the common frame
    for i, each in enumerate(drives):
        if not each.follows:
            column, frame = i, np.eye(3)
        out[i, :, column] = each.earth @ frame.T
        frame = frame @ each.end
    return out


def _diagonal(blocks: Sequence[Floats] | Floats) -> Floats:
    """Return the matrix with blocks on its diagonal."""
    d, (rows, columns) = len(blocks), np.shape(blocks[0])
    out = np.zeros((d, rows, d, columns))
    out[np.arange(d), :, np.arange(d)] = blocks
    return out.reshape(d * rows, d * columns)
