# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Likelihood of the errors of drives; its maximum gives the noise in motion relative to rest.

Model
-----
Each drive has nine residuals (`DriveErrors`). The residuals y of all drives are normally
distributed with mean 0 and the covariance

    V = D + U U',   D = s_1^2 M_1 + s_2^2 M_2 + ... + F.

D contains the errors that are independent from drive to drive, in one block per drive. M_i are
covariances due to the noise of the sensors at rest, as measured or assumed. s_i is the factor by
which this noise is larger in the drives. F is the covariance due to white noise in the means at the
rests, and due to errors of second order.

U U' is the covariance due to unknowns that several drives may have in common: the bias of the
accelerometer, the rotation of the Earth and, if they are to be estimated, calibration errors. The
columns of U are the effects of combinations of these unknowns with the prior variance 1.

The factors s_i maximize the product of the likelihood and their prior density. The method is Fisher
scoring of variance components (H. D. Patterson, R. Thompson, Biometrika 1971). With
S = I + U' D^-1 U, V^-1 is D^-1 - D^-1 U S^-1 U' D^-1, and S^-1 is the posterior covariance of the
coefficients of U.
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
    DriftCovariance,
    DriveErrors,
    cross_matrices,
)

Floats = NDArray[np.float64]

SIGMA_BIAS = 0.5
"""Prior standard deviation of the bias of an accelerometer axis in m/s^2 (about 50 mg)."""

GRAVITY, SIGMA_GRAVITY = 9.806, 0.03
"""Gravity on the surface of the Earth and its prior standard deviation in m/s^2. This standard
deviation covers the range from 9.78 at the equator to 9.83 at the poles (WGS 84), and a scale
factor error of the accelerometer of 0.2 %."""

CAUSES: Mapping[str, float] = {
    'rotation': 0.01,
    'gyro_matrix': 0.01,
    'accel_matrix': 0.01,
    'g_sensitivity': 1e-3,
}
"""Calibration error -> prior standard deviation of its elements. These standard deviations are
typical limits of MEMS datasheets: 0.01 rad or 1 %, and 1e-3 rad/s per m/s^2 (0.6 deg/s per g).
'rotation' is a rotation of one sensor relative to the other, with three elements. 'gyro_matrix' and
'accel_matrix' have nine elements each, and include such a rotation."""

SIGMA_LOG = 2.0 * math.log(5.0)
"""Prior standard deviation of the logarithm of s_i^2, where s_i is a factor of the noise in motion
and not the size of an unknown drift (`NoiseAtRest.unknown`).
Within two standard deviations, s_i is between 1/25 and 25. The prior only matters if the drives do
not determine a factor."""

MOST_STEPS, STEP, CONVERGED = 60, 1.5, 3e-3
"""Limits of the Fisher scoring: largest number of steps, largest change of the logarithm of a
factor s_i^2 of the noise power in one step, and change in one step below which the iteration
ends."""

Groups = tuple[tuple[str, ...], ...]
"""For each factor s_i of the noise in motion, the names of the covariances that are multiplied by
s_i^2."""


class NoiseAtRest(NamedTuple):
    """Noise of one axis at rest.

    Attributes
    ----------
    white : float
        White noise density N in SI.
    slow : function
        Autocovariance of the noise that is not white (the drift); see `DriftCovariance`.
    unknown : float
        Prior standard deviation of the logarithm of the power of the drift, if the size of the
        drift is unknown; 0 if the drift was measured. The size of an unknown drift is estimated
        from the drives. Up to a limit, this drift does not count as an error in motion.
    """

    white: float
    slow: DriftCovariance
    unknown: float = 0.0


class DriveFit(NamedTuple):
    """Factors of the noise in motion, with the likelihood and the posterior for these factors.

    Attributes
    ----------
    groups : tuple of tuple of str
        For each factor s_i of the noise, the names of the covariances that s_i^2 multiplies.
    causes : tuple of str
        Names of the calibration errors in the model, keys of `CAUSES`.
    log_factors : (k,) array
        Logarithms of s_i^2, one for each group.
    value : float
        2 log L with the prior of the factors, up to a constant.
    mean, covariance : (r,) array, (r, r) array
        Posterior mean and covariance of the coefficients of the columns of U. The columns are the
        effects of unknowns, such as the bias of the accelerometer, on the drives.
    information : (k, k) array
        Fisher information of ``log_factors``, with their prior.
    scores : (drives, k) array
        Contribution of each drive to the derivatives of log L with respect to ``log_factors``.
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
        """Standard errors of ``log_factors``, (k,), for at least three drives.

        Each standard error is the larger of two estimates: from ``information``, and from the
        scatter of the scores of the drives (sandwich estimate). The second estimate does not assume
        a normal distribution.
        """
        drives = len(self.scores)
        covariance = np.linalg.inv(self.information)
        score_products = self.scores.T @ self.scores * (drives / (drives - 2))
        robust_covariance = covariance @ score_products @ covariance
        return np.asarray(np.sqrt(np.maximum(np.diag(covariance), np.diag(robust_covariance))))


@dataclass(frozen=True)
class DriveLikelihood:
    """Residuals of drives, and the noise and the unknowns that may have caused these residuals.

    The text of the module defines the symbols M_i, s_i, F and U of the model. All arrays except
    ``scale`` are divided by ``scale``, and covariances by the products of two of its elements, so
    that residuals with different units of measurement have similar sizes.

    Attributes
    ----------
    scale : (9,) array
        Typical size of the three rotation, velocity and rate residuals, in the units of
        `DriveErrors`.
    y : (drives, 9) array
        Residuals, from which the effect of the bias of the accelerometer is subtracted. This bias
        is estimated from the known magnitude of gravity.
    noise : mapping of str to (drives, 9, 9) array
        Covariances M_i: 'gyro_white' and 'accel_white' for white noise, 'gyro_slow' and
        'accel_slow' for measured drift, 'gyro_drift' and 'accel_drift' for unknown drift.
    own : (drives, 9, 9) array
        Covariance F of the errors that no factor changes: white noise at the rests, and
        second-order effects.
    common : (drives, 9, r) array
        Columns of U for the bias of the accelerometer and for the rotation of the Earth.
    effects : mapping of str to (drives, 9, k) array
        Calibration error (key of `CAUSES`) -> columns of U for this error.
    unknown : mapping of str to float
        Name of each unknown drift in ``noise`` -> prior standard deviation of the logarithm of
        s_i^2.
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
        """Return the likelihood of the errors of one or more drives.

        The drives are in the order of time. ``noise`` is the noise at rest of the six axes, in the
        order of `AXES`.
        """
        white_covariances = [
            each.white_covariances([axis.white for axis in noise]) for each in drives
        ]
        covariances = {
            f'{sensor}_white': np.array([each[sensor] for each in white_covariances])
            for sensor in SENSORS
        }
        unknown: dict[str, float] = {}
        bias_effects = np.array([each.accel_bias for each in drives])
        for axis, axis_noise in enumerate(noise):
            kind = 'drift' if axis_noise.unknown else 'slow'
            name = f'{"gyro" if axis < 3 else "accel"}_{kind}'
            if axis_noise.unknown:
                unknown[name] = max(unknown.get(name, 0.0), axis_noise.unknown)
            covariance = np.array([each.slow_covariance(axis, axis_noise.slow) for each in drives])
            if axis >= 3:
                axis_effect = bias_effects[:, :, axis - 3]
                covariance += _bias_scatter(axis_noise.slow, drives) * np.einsum(
                    'di,dj->dij', axis_effect, axis_effect
                )
            covariances[name] = covariances.get(name, 0.0) + covariance
        fixed_covariances = np.array([each['rests'] for each in white_covariances])
        fixed_covariances += np.array([np.diag(_second_order(each) ** 2) for each in drives])
        mean_bias, bias_covariance = _accel_bias(drives)
        effects = {
            name: np.array([getattr(each, name) for each in drives])
            for name in CAUSES
            if name != 'rotation'
        }
        effects['rotation'] = effects['gyro_matrix'] @ cross_matrices(np.eye(3)).reshape(3, 9).T
        total = sum(covariances.values(), fixed_covariances)
        mean_variances = np.einsum('dii->i', total) / len(drives)
        scale = np.sqrt(np.repeat(mean_variances.reshape(-1, 3).mean(axis=1), 3))
        common_effects = [
            bias_effects @ np.linalg.cholesky(bias_covariance),
            _earth_rate_effects(drives),
        ]
        scale_products = np.outer(scale, scale)
        return cls(
            scale,
            (np.array([each.residual for each in drives]) - bias_effects @ mean_bias) / scale,
            {name: each / scale_products for name, each in covariances.items()},
            fixed_covariances / scale_products,
            np.concatenate(common_effects, axis=2) / scale[:, None],
            {name: CAUSES[name] * effect / scale[:, None] for name, effect in effects.items()},
            unknown,
        )

    def fit(
        self, groups: Groups, causes: tuple[str, ...] = (), start: DriveFit | None = None
    ) -> DriveFit:
        """Return a fit of the factors s_i, which maximizes the likelihood with their prior.

        Parameters
        ----------
        groups : tuple of tuple of str
            For each factor s_i, the names of the covariances that are multiplied by s_i^2. In
            addition, each unknown drift has its own factor. Noise in no group has the factor 1.
        causes : tuple of str
            Names of the calibration errors in the model, keys of `CAUSES`.
        start : DriveFit, optional
            A fit with the same number of factors, from which the search begins.

        Returns
        -------
        DriveFit
            The result at the end of the search, even if the search has not converged.
        """
        groups = (*groups, *((name,) for name in self.unknown))
        start_factors = np.zeros(len(groups)) if start is None else start.log_factors
        prior_stds = np.array([self.unknown.get(names[0], SIGMA_LOG) for names in groups])
        fit_at = partial(self._fit_at, groups, causes, prior_stds)
        step, best = 1.0, fit_at(start_factors)
        for _ in range(MOST_STEPS):
            gradient = best.scores.sum(axis=0) - best.log_factors / prior_stds**2
            change = np.linalg.solve(best.information, gradient)
            change *= step * min(1.0, STEP / max(np.abs(change).max(), 1e-300))
            trial = fit_at(best.log_factors + change)
            if trial.value < best.value - 1e-9:
                step *= 0.5
                if step < 1e-3:
                    break
                continue
            best, step = trial, min(2.0 * step, 1.0)
            if np.abs(change).max() < CONVERGED:
                break
        return best

    def covariances(self, groups: Groups, log_factors: Floats) -> tuple[list[Floats], Floats]:
        """Return the covariance of each group of noise, as a list, and the total covariance D.

        The covariance of a group is multiplied by its factor s_i^2; ``log_factors``, (groups,), are
        the logarithms of these factors. D is the sum of these covariances, of the covariances of
        the noise in no group, and of ``own``. All returned arrays are (drives, 9, 9).
        """
        zero = np.zeros_like(self.own)
        scaled = [
            math.exp(x) * sum((self.noise.get(name, zero) for name in names), zero)
            for names, x in zip(groups, log_factors.tolist())
        ]
        grouped_names = {name for names in groups for name in names}
        other_noise = (noise for name, noise in self.noise.items() if name not in grouped_names)
        return scaled, sum(scaled, sum(other_noise, self.own))

    def all_effects(self, causes: tuple[str, ...]) -> Floats:
        """Return the matrix U with columns for the calibration errors ``causes``.

        The result is (drives, 9, r).
        """
        return np.concatenate([self.common, *(self.effects[name] for name in causes)], axis=2)

    def _fit_at(
        self, groups: Groups, causes: tuple[str, ...], prior_stds: Floats, log_factors: Floats
    ) -> DriveFit:
        """Return the likelihood, its derivatives and the posterior for given factors of the noise.

        ``log_factors``, (groups,), are the logarithms of the factors s_i^2 of the noise power in
        each group, and ``prior_stds``, (groups,), are their prior standard deviations. The text of
        the module defines the matrices D, U and V.
        """
        scaled, drive_covariance = self.covariances(groups, log_factors)
        drive_precision = np.linalg.inv(drive_covariance)
        effects = self.all_effects(causes)
        weighted_effects = drive_precision @ effects  # D^-1 U
        precision = np.eye(effects.shape[2]) + np.einsum('dir,dis->rs', effects, weighted_effects)
        covariance = np.linalg.inv(precision)
        drive_weighted_residuals = np.einsum('dij,dj->di', drive_precision, self.y)
        mean = covariance @ np.einsum('dir,di->r', effects, drive_weighted_residuals)
        weighted_residuals = drive_weighted_residuals - weighted_effects @ mean  # V^-1 y
        value = -float((self.y * weighted_residuals).sum()) - float(np.linalg.slogdet(precision)[1])
        value -= float(np.linalg.slogdet(drive_covariance)[1].sum()) + float(
            np.square(log_factors / prior_stds).sum()
        )
        # diagonal blocks of V^-1, one for each drive
        total_precision = (
            drive_precision - weighted_effects @ covariance @ weighted_effects.swapaxes(1, 2)
        )
        scores = np.empty((len(self.y), len(scaled)))
        for k, m in enumerate(scaled):
            scores[:, k] = np.einsum('di,dij,dj->d', weighted_residuals, m, weighted_residuals)
            scores[:, k] -= np.einsum('dij,dji->d', total_precision, m)
        common_products = [
            covariance
            @ np.einsum('dir,dij,djs->rs', weighted_effects, m, weighted_effects, optimize=True)
            for m in scaled
        ]
        products = [drive_precision @ m for m in scaled]
        information = np.empty((len(scaled), len(scaled)))
        for i, (a, m) in enumerate(zip(products, scaled)):
            for j, b in enumerate(products):
                cross_products = np.einsum(
                    'dir,dij,djk,dks->rs', weighted_effects, m, b, weighted_effects, optimize=True
                )
                information[i, j] = (
                    np.einsum('dij,dji->', a, b)
                    - 2.0 * np.sum(covariance * cross_products.T)
                    + np.sum(common_products[i] * common_products[j].T)
                )
        information = information / 2.0 + np.diag(prior_stds**-2)
        return DriveFit(
            groups, causes, log_factors, value, mean, covariance, information, scores / 2.0
        )

    def elements(self, fit: DriveFit, name: str) -> tuple[Floats, Floats]:
        """Return the posterior means, (k,), and standard deviations, (k,), of a calibration error.

        ``name`` is one of the causes of the fit. The elements of 'rotation' are in rad, the
        elements of 'g_sensitivity' in rad/s/(m/s^2); other elements have no unit.
        """
        first_column = self.common.shape[2]
        for each in fit.causes[: fit.causes.index(name)]:
            first_column += self.effects[each].shape[2]
        columns = slice(first_column, first_column + self.effects[name].shape[2])
        deviations = np.sqrt(np.diag(fit.covariance)[columns])
        return CAUSES[name] * fit.mean[columns], CAUSES[name] * deviations

    def ratios(self, fit: DriveFit) -> Floats:
        """Return the rotation error and the velocity error of each drive, relative to predictions.

        The result is (drives, 2). The fitted effects of the accelerometer bias and of the rotation
        of the Earth are subtracted from the errors. The predicted root mean square error contains
        the noise at rest, the errors of second order, and the drift that the rests do not show,
        with its fitted size.
        """
        errors = self.y - self.common @ fit.mean[: self.common.shape[2]]
        log_factors_at_rest = np.where(
            [names[0] in self.unknown for names in fit.groups], fit.log_factors, 0.0
        )
        variances = np.einsum('dii->di', self.covariances(fit.groups, log_factors_at_rest)[1])
        return np.stack(
            [
                np.sqrt(np.square(errors[:, rows]).sum(axis=1) / variances[:, rows].sum(axis=1))
                for rows in (ROTATION, VELOCITY)
            ],
            axis=1,
        )


def _second_order(drive: DriveErrors) -> Floats:
    """Return the approximate size of the second-order error in each residual, (9,).

    A rotation error psi moves the vector of gravity g by up to psi g to first order, and by up to
    psi^2 g / 2 to second order. The rotation residual determines psi at the end of the drive, and
    the velocity residual the mean of psi.
    """
    end_angle = float(np.linalg.norm(drive.residual[ROTATION])) / GRAVITY
    mean_angle = float(np.linalg.norm(drive.residual[VELOCITY])) / (GRAVITY * drive.duration)
    sizes = np.zeros(ROWS)
    sizes[ROTATION] = end_angle**2 * GRAVITY / 2.0
    sizes[VELOCITY] = (end_angle**2 + mean_angle**2) * GRAVITY / 2.0 * drive.duration
    return sizes


def _accel_bias(drives: Sequence[DriveErrors]) -> tuple[Floats, Floats]:
    """Return the mean, (3,), and the covariance, (3, 3), of the accelerometer bias in m/s^2.

    The bias is estimated from the difference between the magnitude of the specific force at rest
    and gravity.
    """
    force = np.array([each.force for each in drives])
    force_norm = np.linalg.norm(force, axis=1)
    up = force / force_norm[:, None]
    information = up.T @ up / len(drives) / SIGMA_GRAVITY**2
    covariance = np.linalg.inv(np.eye(3) / SIGMA_BIAS**2 + information)
    return covariance @ up.T @ (force_norm - GRAVITY) / len(drives) / SIGMA_GRAVITY**2, covariance


def _earth_rate_effects(drives: Sequence[DriveErrors]) -> Floats:
    """Return the columns of the matrix U for the rotation of the Earth, (drives, 9, r).

    A chain is a sequence of drives in which each drive begins at the rest at which the previous
    drive ended. Each chain has three columns: the components of the rotation in the axes of the
    sensor at the start of the chain.
    """
    chain_starts = [i for i, drive in enumerate(drives) if i == 0 or not drive.follows]
    effects = np.zeros((len(drives), ROWS, len(chain_starts), 3))
    # ``frame`` rotates from the sensor axes at the start of a drive to the sensor axes at the start
    # of its chain
    column, frame = -1, np.eye(3)
    for i, drive in enumerate(drives):
        if i in chain_starts:
            column, frame = column + 1, np.eye(3)
        effects[i, :, column] = drive.earth @ frame.T * (EARTH_RATE / math.sqrt(3.0))
        frame = frame @ drive.end
    return effects.reshape(len(drives), ROWS, -1)


def _bias_scatter(slow: DriftCovariance, drives: Sequence[DriveErrors]) -> float:
    """Return the approximate expected variance of a bias among the starts of the drives.

    ``slow`` is the autocovariance of the bias. At each start, the bias is averaged over 10 s. The
    result is in the squared unit of the samples.
    """
    start_times = np.array([each.start for each in drives])
    averaging_s = 10.0
    lags = np.abs(start_times[:, None] - start_times) / averaging_s
    (variance,) = np.asarray(slow(averaging_s, np.zeros(1)))
    covariances = np.asarray(slow(averaging_s, np.maximum(lags, 1.0)))
    return float(np.mean((variance - covariances) * np.minimum(lags, 1.0)))
