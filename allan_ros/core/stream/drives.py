# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of an IMU over a drive between two rests, and what could have caused them.

Gyro and accelerometer are integrated from one rest to the next. At the second rest the velocity is
0 again, and the accelerometer shows the direction of gravity.

Notation
--------
w is the measured angular rate minus its mean at the first rest. C(t) is integrated from w. It
rotates vectors from the axes of the sensor at time t to its axes at the first rest. f is the
specific force, f1 and f2 are its means at the two rests, and T is the duration of the drive. The
residuals are

    rotation:  C(T) f2 - f1                      (0 without errors: gravity is the same)
    velocity:  integral of C(t) f(t) dt - f1 T   (0 without errors: the velocity is 0 at both rests)
    rate:      mean of w at the second rest      (0 if the bias of the gyro is constant)

A gyro error n(t) rotates C by psi with psi' = C n. To first order it changes C(T) f2 by the
integral of A(t) n(t) dt with A(t) = -[C(T) f2]x C(t), and the velocity with
A(t) = -[v(T) - v(t)]x C(t), where v(t) is the integral of C f, and [a]x is the matrix of the cross
product with a.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..imu import Floats

EARTH_RATE = 7.292115e-5
"""Rotation rate of the Earth in rad/s (WGS 84). The direction of the axis of rotation relative to
the sensor is unknown."""

REST_S = 30.0
"""Longest time in s next to a drive over which the samples of a rest are averaged."""

ROWS = 9
"""Number of residuals of a drive."""

ROTATION, VELOCITY, RATE = slice(0, 3), slice(3, 6), slice(6, 9)
"""Indices of the three vectors among the residuals of a drive."""

SLOW_BLOCKS = 96
"""Number of blocks into which a drive and its two rests are divided to compute the effect of slow
noise."""


DriftCovariance = Callable[[float, ArrayLike], Floats]
"""Function (M, j) -> array: the autocovariance of the means of consecutive blocks of M seconds at a
lag of j blocks, in the squared unit of the samples. It may lack a constant that is the same for all
M."""


@dataclass(frozen=True)
class Rest:
    """Means of the samples at rest directly before or after a drive.

    Attributes
    ----------
    gyro, accel : (3,) array
        Means in rad/s and m/s^2.
    duration : float
        Duration of the averaged samples in s.
    """

    gyro: Floats
    accel: Floats
    duration: float


@dataclass(frozen=True)
class Drive:
    """Samples of a drive between two rests, and the means at the rests.

    Attributes
    ----------
    start : float
        Time of the first sample in s; only differences between drives matter.
    tau0 : float
        Sample period in s.
    gyro, accel : (n, 3) array
        Evenly spaced samples in rad/s and m/s^2.
    before, after : Rest
        The rests before and after the drive.
    follows : bool
        Whether another used drive ended at the rest ``before``.
    """

    start: float
    tau0: float
    gyro: Floats
    accel: Floats
    before: Rest
    after: Rest
    follows: bool = False

    @property
    def duration(self) -> float:
        """Duration of the drive in s."""
        return len(self.gyro) * self.tau0


@dataclass(frozen=True)
class DriveErrors:
    """Residuals of one drive, and the effect of each error that may have caused them.

    The nine residuals are the vectors rotation, velocity and rate of the module text. The effect of
    an error with k components is a (9, k) array: residuals per unit of each component.

    Attributes
    ----------
    start, duration : float
        As in `Drive`, in s.
    turned : float
        Integral of the magnitude of the angular rate over the drive, in rad.
    follows : bool
        Whether another used drive ended at the first rest.
    force, end : (3,) array, (3, 3) array
        f1 (mean specific force at the first rest) in m/s^2, and C(T) of the module text.
    residual : (9,) array
        Residuals in m/s^2 (rotation), m/s (velocity) and rad/s (rate).
    white, rests : (6, 9, 9) array
        Covariance of the residuals due to white noise with N = 1 of each axis, during the drive and
        at the rests.
    slow : (blocks, 9, 6) array
        Residuals per unit of the mean error of each axis in each block. The sum over the blocks is
        0 for each axis: the mean of the gyro at the first rest is subtracted, and ``accel_bias``
        contains the effect of a constant bias of the accelerometer.
    block : float
        Duration of a block of ``slow`` in s.
    accel_bias : (9, 3) array
        Effect of the bias of the accelerometer at the first rest.
    gyro_matrix, accel_matrix, g_sensitivity : (9, 9) array
        Effect of the elements of three matrices, row by row. The first two contain the scale factor
        errors and misalignments of the gyro and of the accelerometer: the error of a sensor is its
        matrix times the true value. The third is the sensitivity of the gyro to specific force, in
        rad/s per m/s^2.
    earth : (9, 3) array
        Effect of the rotation rate of the Earth, in the axes of the sensor at the first rest.
    """

    start: float
    duration: float
    turned: float
    follows: bool
    force: Floats
    end: Floats
    residual: Floats
    white: Floats
    rests: Floats
    slow: Floats
    block: float
    accel_bias: Floats
    gyro_matrix: Floats
    accel_matrix: Floats
    g_sensitivity: Floats
    earth: Floats

    def white_covariances(self, density: Sequence[float]) -> dict[str, Floats]:
        """Return cause -> covariance of the residuals, (9, 9), due to white noise.

        The causes are 'gyro' and 'accel' for the noise of each sensor during the drive, and 'rests'
        for the noise of both sensors at the rests. ``density``, (6,), contains N of the axes in SI.
        """
        squares = np.square(density)[:, None, None]
        drive_covariances = squares * self.white
        return {
            'gyro': drive_covariances[:3].sum(axis=0),
            'accel': drive_covariances[3:].sum(axis=0),
            'rests': (squares * self.rests).sum(axis=0),
        }

    def slow_covariance(self, axis: int, slow: DriftCovariance) -> Floats:
        """Return the covariance of the residuals, (9, 9), due to slow noise of one axis.

        ``axis`` is the index of the axis, and ``slow`` returns the autocovariance of this noise.
        """
        lags = np.arange(len(self.slow))
        weights, autocovariance = self.slow[:, :, axis], np.asarray(slow(self.block, lags))
        return np.asarray(weights.T @ autocovariance[np.abs(lags[:, None] - lags)] @ weights)


def drive_errors(drive: Drive) -> DriveErrors:
    """Return the residuals of a drive, and the effect of each error that may have caused them.

    All effects are of first order in the errors.

    Parameters
    ----------
    drive : Drive
        At least one sample, and the rests before and after the drive.

    Returns
    -------
    DriveErrors

    Examples
    --------
    A gyro with a scale factor of 1.01 turns by 90 degrees around the horizontal axis x:

    >>> import numpy as np
    >>> rest = lambda *up: Rest(np.zeros(3), 9.8 * np.array(up), 10.0)
    >>> angle = np.pi / 2 * (np.arange(100) + 0.5) / 100
    >>> up = 9.8 * np.stack([0 * angle, np.sin(angle), np.cos(angle)], axis=1)
    >>> rates = np.tile([1.01 * np.pi / 2, 0.0, 0.0], (100, 1))
    >>> drive = Drive(0.0, 0.01, rates, up, rest(0.0, 0.0, 1.0), rest(0.0, 1.0, 0.0))
    >>> found = drive_errors(drive)
    >>> bool(np.allclose(found.residual[:3], 0.01 * found.gyro_matrix[:3, 0], atol=2e-3))
    True
    """
    rates, force, dt = drive.gyro - drive.before.gyro, drive.accel, drive.tau0
    n, duration = len(rates), drive.duration
    rotations_after = _cumulative_products(rotation_matrices(rates * dt))
    half_rotations = rotation_matrices(rates * (dt / 2.0))
    # matrix C (see the module text) at the middle of each sample, (n, 3, 3)
    rotations = np.concatenate([half_rotations[:1], rotations_after[:-1] @ half_rotations[1:]])
    first_force, last_force = drive.before.accel, drive.after.accel
    last_rotation = rotations_after[-1]
    rotated_force = np.einsum('nij,nj->ni', rotations, force)
    velocity = np.cumsum(rotated_force, axis=0) * dt
    residual = np.concatenate(
        [
            last_rotation @ last_force - first_force,
            velocity[-1] - first_force * duration,
            drive.after.gyro - drive.before.gyro,
        ]
    )

    # A weight is the change of a residual per unit of the error of a sample, or of the mean at a
    # rest. The mean of the gyro at the first rest is subtracted from the samples of the gyro.
    sample_weights = np.zeros((n, ROWS, 6))
    remaining_velocity = velocity[-1] - velocity + rotated_force * (dt / 2.0)
    sample_weights[:, ROTATION, :3] = -(cross_matrices(last_rotation @ last_force) @ rotations) * dt
    sample_weights[:, VELOCITY, :3] = -(cross_matrices(remaining_velocity) @ rotations) * dt
    sample_weights[:, VELOCITY, 3:] = rotations * dt
    gyro_weights, accel_weights = sample_weights[:, :, :3], sample_weights[:, :, 3:]
    first_weights, last_weights = np.zeros((ROWS, 6)), np.zeros((ROWS, 6))
    last_weights[ROTATION, 3:], last_weights[RATE, :3] = last_rotation, np.eye(3)
    first_weights[:, :3] = -gyro_weights.sum(axis=0) - last_weights[:, :3]
    first_weights[ROTATION, 3:], first_weights[VELOCITY, 3:] = -np.eye(3), -duration * np.eye(3)

    accel_bias = accel_weights.sum(axis=0) + first_weights[:, 3:] + last_weights[:, 3:]
    # weights of the first rest with which a constant bias has no effect on the residuals
    change_weights = first_weights.copy()
    change_weights[:, 3:] -= accel_bias
    blocks = _DriveBlocks.of(drive)
    return DriveErrors(
        start=drive.start,
        duration=duration,
        turned=float(np.linalg.norm(rates, axis=1).sum() * dt),
        follows=drive.follows,
        force=first_force,
        end=last_rotation,
        residual=residual,
        white=np.einsum('nia,nja->aij', sample_weights, sample_weights, optimize=True) / dt,
        rests=np.einsum('ia,ja->aij', first_weights, first_weights) / drive.before.duration
        + np.einsum('ia,ja->aij', last_weights, last_weights) / drive.after.duration,
        slow=blocks.weights(sample_weights, change_weights, last_weights),
        block=blocks.duration,
        accel_bias=accel_bias,
        gyro_matrix=np.einsum('nij,nk->ijk', gyro_weights, rates).reshape(ROWS, 9),
        accel_matrix=(
            np.einsum('nij,nk->ijk', accel_weights, force)
            + np.einsum('ij,k->ijk', first_weights[:, 3:], first_force)
            + np.einsum('ij,k->ijk', last_weights[:, 3:], last_force)
        ).reshape(ROWS, 9),
        g_sensitivity=(
            np.einsum('nij,nk->ijk', gyro_weights, force - first_force)
            + np.einsum('ij,k->ijk', last_weights[:, :3], last_force - first_force)
        ).reshape(ROWS, 9),
        earth=np.einsum('nij,nkj->ik', gyro_weights, rotations)
        + last_weights[:, :3] @ last_rotation.T
        + first_weights[:, :3],
    )


def cross_matrices(v: Floats) -> Floats:
    """Return the matrix [v]x, for which [v]x a = v x a, of each vector v.

    ``v`` is (..., 3), and the result is (..., 3, 3).
    """
    matrices = np.zeros((*v.shape[:-1], 3, 3))
    matrices[..., 0, 1], matrices[..., 0, 2], matrices[..., 1, 2] = (
        -v[..., 2],
        v[..., 1],
        -v[..., 0],
    )
    return np.asarray(matrices - np.swapaxes(matrices, -1, -2))


def rotation_matrices(v: Floats) -> Floats:
    """Return the rotation matrices (n, 3, 3) of rotation vectors (n, 3) in rad (Rodrigues)."""
    angle = np.linalg.norm(v, axis=-1)[:, None, None]
    cross = cross_matrices(v)
    is_small = angle < 1e-8
    divisor = np.where(is_small, 1.0, angle)
    sine = np.where(is_small, 1.0, np.sin(divisor) / divisor)
    cosine = np.where(is_small, 0.5, (1.0 - np.cos(divisor)) / divisor**2)
    return np.asarray(np.eye(3) + sine * cross + cosine * (cross @ cross))


def _cumulative_products(matrices: Floats) -> Floats:
    """Return the products of the first 1, 2, ..., n of n matrices, (n, 3, 3).

    The products are computed in log2(n) steps, rounded up.
    """
    products, stride = matrices.copy(), 1
    while stride < len(products):
        products[stride:] = products[:-stride] @ products[stride:]
        stride *= 2
    return products


class _DriveBlocks(NamedTuple):
    """Division of a drive and its rests into blocks of equal duration."""

    duration: float  # duration of a block in s
    number: int  # number of blocks

    # (blocks,) share of the duration of the first rest that is in each block
    first_rest_shares: Floats
    # (n,) index of the block in which each sample of the drive lies
    block_of_sample: NDArray[np.intp]
    # (blocks,) share of the duration of the last rest that is in each block
    last_rest_shares: Floats

    @classmethod
    def of(cls, drive: Drive) -> _DriveBlocks:
        drive_begin = drive.before.duration
        drive_end = drive_begin + drive.duration
        end = drive_end + drive.after.duration
        edges = np.linspace(0.0, end, SLOW_BLOCKS + 1)
        first_shares = np.diff(np.minimum(edges, drive_begin)) / drive_begin
        last_shares = np.diff(np.maximum(edges, drive_end)) / drive.after.duration
        middle_times = drive_begin + (np.arange(len(drive.gyro)) + 0.5) * drive.tau0
        block_of_sample = np.minimum((middle_times / edges[1]).astype(np.intp), SLOW_BLOCKS - 1)
        return cls(float(edges[1]), SLOW_BLOCKS, first_shares, block_of_sample, last_shares)

    def weights(self, samples: Floats, first: Floats, last: Floats) -> Floats:
        """Return the weight of the mean error of each axis in each block, (blocks, 9, 6).

        A weight is the change of one of the 9 residuals of the drive per unit of an error of one of
        the 6 axes. ``samples``, (n, 9, 6), are the weights of the errors of the samples. ``first``
        and ``last``, (9, 6), are the weights of the errors of the means at the rests before and
        after the drive.
        """
        first_samples = np.flatnonzero(np.diff(self.block_of_sample, prepend=-1))
        weights = np.zeros((self.number, *first.shape))
        weights[self.block_of_sample[first_samples]] = np.add.reduceat(
            samples, first_samples, axis=0
        )
        first_shares, last_shares = self.first_rest_shares, self.last_rest_shares
        weights += first_shares[:, None, None] * first + last_shares[:, None, None] * last
        return weights
