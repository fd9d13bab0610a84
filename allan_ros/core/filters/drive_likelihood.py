# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Likelihood of the errors of drives: by which factors the noise is larger than at rest.

Model
-----
The residuals y of all drives are normally distributed with mean 0 and the covariance

    V = D + U U',   D = s_1^2 M_1 + s_2^2 M_2 + ... + F.

D has one block per drive, because its causes are independent from drive to drive. M_i are the
covariances due to the noise of the sensors as measured at rest. F is the covariance of white noise
in the means of the rests, and of errors of second order.

U contains the effects of unknowns that all drives have in common, times their prior standard
deviations: the bias of the accelerometer, the rotation of the Earth and, if they are to be
estimated, calibration errors.

The factors s_i maximize the likelihood (Fisher scoring; variance components, H. D. Patterson,
R. Thompson, Biometrika 1971). With S = I + U' D^-1 U, V^-1 is D^-1 - D^-1 U S^-1 U' D^-1, and S^-1
is the posterior covariance of the coefficients of U.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..imu import SENSORS
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
"""Prior standard deviation of the bias of an axis of the accelerometer in m/s^2 (about 50 mg)."""

GRAVITY, SIGMA_GRAVITY = 9.806, 0.03
"""Gravity on the surface of the Earth and its prior standard deviation in m/s^2: 9.78 at the
equator, 9.83 at the poles (WGS 84), with a scale factor of the accelerometer of 0.2 %."""

CAUSES: Mapping[str, float] = {
    'rotation': 0.01,
    'gyro_matrix': 0.01,
    'accel_matrix': 0.01,
    'g_sensitivity': 1e-3,
}
"""Calibration error -> prior standard deviation of its elements. They are typical limits of MEMS
datasheets: 0.01 rad or 1 %, and 1e-3 rad/s per m/s^2 (0.6 deg/s per g). A rotation of one sensor
against the other has three elements. Both matrices of nine elements include such a rotation."""

SIGMA_LOG = 2.0 * math.log(5.0)
"""Prior standard deviation of the logarithm of s_i^2: within two standard deviations, s_i is
between 1/25 and 25. The prior only matters if the drives do not determine a factor."""

MOST_STEPS, STEP, CONVERGED = 60, 1.5, 3e-3
"""Fisher scoring of the logarithms of s_i^2: largest number of steps, largest change in one step,
and largest change in the step after which the iteration ends."""

Groups = tuple[tuple[str, ...], ...]
"""For each factor s_i, the names of the covariances that are multiplied by it."""


class NoiseAtRest(NamedTuple):
    """Noise of one axis at rest.

    Attributes
    ----------
    white : float
        White noise density N in SI.
    slow : function
        Autocovariance of the noise that is not white.
    unknown : float
        Standard deviation of the logarithm of the power of ``slow``; 0 if ``slow`` was measured. If
        it is unknown, the drives show how much the bias changes from rest to rest, and this drift
        does not count as an error in motion.
    """

    white: float
    slow: SlowNoise
    unknown: float = 0.0


class Fit(NamedTuple):
    """Maximum of the likelihood over the factors.

    Attributes
    ----------
    groups : tuple of tuple of str
        For each factor, the names of the covariances that are multiplied by it.
    causes : tuple of str
        Calibration errors in the model, of `CAUSES`.
    log_factors : (k,) array
        Logarithms of s_i^2.
    value : float
        2 log L up to a constant.
    mean, covariance : (r,) array, (r, r) array
        Posterior mean and covariance of the coefficients of U.
    information : (k, k) array
        Fisher information of the logarithms.
    scores : (drives, k) array
        Part of each drive in the derivatives of log L with respect to the logarithms.
    """

    groups: Groups
    causes: tuple[str, ...]
    log_factors: Floats
    value: float
    mean: Floats
    covariance: Floats
    information: Floats
    scores: Floats

    @property
    def errors(self) -> Floats:
        """Standard errors of ``log_factors``, (k,).

        They are computed from the likelihood or, if this gives larger errors, from the scatter of
        the scores of the drives (sandwich estimate), which assumes no normal distribution.
        """
        drives = len(self.scores)
        covariance = np.linalg.inv(self.information)
        spread = self.scores.T @ self.scores * (drives / (drives - 2))
        robust = covariance @ spread @ covariance
        return np.asarray(np.sqrt(np.maximum(np.diag(covariance), np.diag(robust))))


@dataclass(frozen=True)
class DriveLikelihood:
    """Residuals of drives, and the covariances of everything that may have caused them.

    All arrays except ``scale`` are divided by ``scale``, so that residuals with different units of
    measurement have similar sizes.

    Attributes
    ----------
    scale : (9,) array
        Typical size of the residuals (rotation, velocity, rate) in the units of `DriveErrors`.
    y : (drives, 9) array
        Residuals, without the effect of the bias of the accelerometer that gravity shows.
    noise : mapping of str to (drives, 9, 9) array
        Covariances M_i: 'gyro_white', 'gyro_slow', 'accel_white' and 'accel_slow' as measured at
        rest, and 'gyro_drift' and 'accel_drift' if the drift is unknown.
    own : (drives, 9, 9) array
        Covariance F.
    common : (drives, 9, r) array
        U without calibration errors.
    effects : mapping of str to (drives, 9, k) array
        Part of U that belongs to each of `CAUSES`.
    unknown : mapping of str to float
        Name of each unknown drift -> standard deviation of the logarithm of its factor.
    """

    scale: Floats
    y: Floats
    noise: Mapping[str, Floats]
    own: Floats
    common: Floats
    effects: Mapping[str, Floats]
    unknown: Mapping[str, float]

    @classmethod
    def of(cls, drives: Sequence[DriveErrors], noise: Sequence[NoiseAtRest]) -> DriveLikelihood:
        """Return the likelihood of drives; ``noise`` is the noise of the six axes at rest."""
        white = [each.white_covariances([axis.white for axis in noise]) for each in drives]
        covariances = {
            f'{sensor}_white': np.array([one[sensor] for one in white]) for sensor in SENSORS
        }
        unknown: dict[str, float] = {}
        bias_effects = np.array([each.accel_bias for each in drives])
        for axis, one in enumerate(noise):
            name = f'{"gyro" if axis < 3 else "accel"}_{"drift" if one.unknown else "slow"}'
            if one.unknown:
                unknown[name] = max(unknown.get(name, 0.0), one.unknown)
            part = np.array([each.slow_covariance(axis, one.slow) for each in drives])
            if axis >= 3:
                h = bias_effects[:, :, axis - 3]
                part += _bias_scatter(one.slow, drives) * np.einsum('di,dj->dij', h, h)
            covariances[name] = covariances.get(name, 0.0) + part
        own = np.array([one['rests'] for one in white])
        own += np.array([np.diag(_second_order(each) ** 2) for each in drives])
        bias, prior = _accel_bias(drives)
        effects = {
            name: np.array([getattr(each, name) for each in drives])
            for name in CAUSES
            if name != 'rotation'
        }
        effects['rotation'] = effects['gyro_matrix'] @ cross_matrices(np.eye(3)).reshape(3, 9).T
        typical = np.einsum('dii->i', sum(covariances.values(), own)) / len(drives)
        scale = np.sqrt(np.repeat(typical.reshape(-1, 3).mean(axis=1), 3))
        common = [bias_effects @ np.linalg.cholesky(prior), _turned_earth(drives)]
        both = np.outer(scale, scale)
        return cls(
            scale,
            (np.array([each.residual for each in drives]) - bias_effects @ bias) / scale,
            {name: each / both for name, each in covariances.items()},
            own / both,
            np.concatenate(common, axis=2) / scale[:, None],
            {name: CAUSES[name] * x / scale[:, None] for name, x in effects.items()},
            unknown,
        )

    def part(self, drives: slice) -> DriveLikelihood:
        """Return the likelihood of the drives in a range of indices."""
        return DriveLikelihood(
            self.scale,
            self.y[drives],
            {name: each[drives] for name, each in self.noise.items()},
            self.own[drives],
            self.common[drives],
            {name: each[drives] for name, each in self.effects.items()},
            self.unknown,
        )

    def fit(self, groups: Groups, causes: tuple[str, ...] = (), start: Fit | None = None) -> Fit:
        """Maximize the likelihood over the factors.

        Parameters
        ----------
        groups : tuple of tuple of str
            For each factor, the names of the covariances that are multiplied by it. Each unknown
            drift has an additional factor of its own. Other noise is as at rest.
        causes : tuple of str
            Calibration errors in the model, of `CAUSES`.
        start : Fit, optional
            A fit with as many factors, from which the search begins.

        Returns
        -------
        Fit
            The last step of the search, also if it has not converged after `MOST_STEPS` steps.
        """
        groups = (*groups, *((name,) for name in self.unknown))
        theta = np.zeros(len(groups)) if start is None else start.log_factors
        sigma = np.array([self.unknown.get(names[0], SIGMA_LOG) for names in groups])
        evaluated = partial(self._evaluated, groups, causes, sigma)
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

    def covariances(self, groups: Groups, log_factors: Floats) -> tuple[list[Floats], Floats]:
        """Return s_i^2 M_i for each factor, and D; all arrays are (drives, 9, 9)."""
        zero = np.zeros_like(self.own)
        each = [
            math.exp(x) * sum((self.noise.get(name, zero) for name in names), zero)
            for names, x in zip(groups, log_factors.tolist())
        ]
        named = {name for names in groups for name in names}
        others = (noise for name, noise in self.noise.items() if name not in named)
        return each, sum(each, sum(others, self.own))

    def all_effects(self, causes: tuple[str, ...]) -> Floats:
        """Return U with the calibration errors ``causes``, (drives, 9, r)."""
        return np.concatenate([self.common, *(self.effects[name] for name in causes)], axis=2)

    def _evaluated(
        self, groups: Groups, causes: tuple[str, ...], sigma: Floats, theta: Floats
    ) -> Fit:
        """Return the likelihood and its derivatives at some factors."""
        each, own = self.covariances(groups, theta)
        inverse = np.linalg.inv(own)
        u = self.all_effects(causes)
        w = inverse @ u  # D^-1 U
        precision = np.eye(u.shape[2]) + np.einsum('dir,dis->rs', u, w)
        covariance = np.linalg.inv(precision)
        weighted_by_d = np.einsum('dij,dj->di', inverse, self.y)  # D^-1 y
        mean = covariance @ np.einsum('dir,di->r', u, weighted_by_d)
        weighted = weighted_by_d - w @ mean  # V^-1 y
        value = -float((self.y * weighted).sum()) - float(np.linalg.slogdet(precision)[1])
        value -= float(np.linalg.slogdet(own)[1].sum()) + float(np.square(theta / sigma).sum())
        blocks = inverse - w @ covariance @ w.swapaxes(1, 2)  # blocks of V^-1 on the diagonal
        scores = np.empty((len(self.y), len(each)))
        for k, m in enumerate(each):
            scores[:, k] = np.einsum('di,dij,dj->d', weighted, m, weighted)
            scores[:, k] -= np.einsum('dij,dji->d', blocks, m)
        from_common = [
            covariance @ np.einsum('dir,dij,djs->rs', w, m, w, optimize=True) for m in each
        ]
        products = [inverse @ m for m in each]
        information = np.empty((len(each), len(each)))
        for i, (a, m) in enumerate(zip(products, each)):
            for j, b in enumerate(products):
                shared = np.einsum('dir,dij,djk,dks->rs', w, m, b, w, optimize=True)
                information[i, j] = (
                    np.einsum('dij,dji->', a, b)
                    - 2.0 * np.sum(covariance * shared.T)
                    + np.sum(from_common[i] * from_common[j].T)
                )
        information = information / 2.0 + np.diag(sigma**-2)
        return Fit(groups, causes, theta, value, mean, covariance, information, scores / 2.0)

    def elements(self, fit: Fit, name: str) -> tuple[Floats, Floats]:
        """Return the posterior means, (k,), and standard deviations, (k,), of a calibration error.

        ``name`` is one of the causes of the fit.
        """
        first = self.common.shape[2]
        for each in fit.causes[: fit.causes.index(name)]:
            first += self.effects[each].shape[2]
        own = slice(first, first + self.effects[name].shape[2])
        deviations = np.sqrt(np.diag(fit.covariance)[own])
        return CAUSES[name] * fit.mean[own], CAUSES[name] * deviations

    def ratios(self, fit: Fit) -> Floats:
        """Return the lengths of rotation and velocity errors over their predicted rms, (drives, 2).

        The fitted effects of the bias and of the rotation of the Earth are subtracted from the
        errors. The prediction is from the noise at rest, and from unknown drift as fitted.
        """
        y = self.y - self.common @ fit.mean[: self.common.shape[2]]
        at_rest = np.where([names[0] in self.unknown for names in fit.groups], fit.log_factors, 0.0)
        variances = np.einsum('dii->di', self.covariances(fit.groups, at_rest)[1])
        return np.stack(
            [
                np.sqrt(np.square(y[:, rows]).sum(axis=1) / variances[:, rows].sum(axis=1))
                for rows in (ROTATION, VELOCITY)
            ],
            axis=1,
        )


def _second_order(drive: DriveErrors) -> Floats:
    """Return the size of errors of second order in the rotation, (9,).

    A rotation error psi moves the vector of gravity g by psi g to first order, and by psi^2 g / 2
    to second order. The rotation residual determines psi at the end of the drive, and the velocity
    residual the mean of psi.
    """
    at_end = float(np.linalg.norm(drive.residual[ROTATION])) / GRAVITY
    mean = float(np.linalg.norm(drive.residual[VELOCITY])) / (GRAVITY * drive.duration)
    out = np.zeros(ROWS)
    out[ROTATION] = at_end**2 * GRAVITY / 2.0
    out[VELOCITY] = (at_end**2 + mean**2) * GRAVITY / 2.0 * drive.duration
    return out


def _accel_bias(drives: Sequence[DriveErrors]) -> tuple[Floats, Floats]:
    """Return mean, (3,), and covariance, (3, 3), of the accelerometer bias as gravity shows it."""
    force = np.array([each.force for each in drives])
    length = np.linalg.norm(force, axis=1)
    up = force / length[:, None]
    known = up.T @ up / len(drives) / SIGMA_GRAVITY**2
    covariance = np.linalg.inv(np.eye(3) / SIGMA_BIAS**2 + known)
    return covariance @ up.T @ (length - GRAVITY) / len(drives) / SIGMA_GRAVITY**2, covariance


def _turned_earth(drives: Sequence[DriveErrors]) -> Floats:
    """Return the effects of the rotation of the Earth times its prior deviation, (drives, 9, r).

    Consecutive drives with a rest in common share three columns, in the frame of the first drive.
    """
    chains = [i for i, each in enumerate(drives) if i == 0 or not each.follows]
    out = np.zeros((len(drives), ROWS, len(chains), 3))
    column, frame = -1, np.eye(3)  # from the sensor at the first rest to the common frame
    for i, each in enumerate(drives):
        if i in chains:
            column, frame = column + 1, np.eye(3)
        out[i, :, column] = each.earth @ frame.T * (EARTH_RATE / math.sqrt(3.0))
        frame = frame @ each.end
    return out.reshape(len(drives), ROWS, -1)


def _bias_scatter(slow: SlowNoise, drives: Sequence[DriveErrors]) -> float:
    """Return the expected variance of a bias about its mean over the starts of the drives."""
    start = np.array([each.start for each in drives])
    mean_over = 10.0  # s
    lags = np.abs(start[:, None] - start) / mean_over
    at_lags, at_zero = slow(mean_over, np.maximum(lags, 1.0)), slow(mean_over, np.zeros(1))
    return float(np.mean((at_zero[0] - np.asarray(at_lags)) * np.minimum(lags, 1.0)))
