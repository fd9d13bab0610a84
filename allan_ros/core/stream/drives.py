# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of an IMU over a drive between two rests, and what could have caused them.

Gyro and accelerometer are integrated from one rest to the next. At the second rest the velocity is
0 again, and the accelerometer shows the direction of gravity.

Notation
--------
C(t) rotates from the sensor at time t to the sensor at the first rest. It is integrated from the
rates w minus their mean at the first rest. f are the specific forces, f1 and f2 their means at the
two rests, and T is the duration of the drive. The residuals of a drive are

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

Floats = NDArray[np.float64]

EARTH_RATE = 7.292115e-5
"""Rotation rate of the Earth in rad/s (WGS 84). Its direction relative to the sensor is unknown."""

REST_S = 30.0
"""Longest part of a rest, next to the drive, over which its samples are averaged, in s."""

ROWS = 9
ROTATION, VELOCITY, RATE = slice(0, 3), slice(3, 6), slice(6, 9)
"""Number of residuals of a drive, and the place of each of the three vectors among them."""

SLOW_BLOCKS = 96
"""Number of blocks into which a drive with its rests is divided for the effect of slow noise."""


SlowNoise = Callable[[float, ArrayLike], Floats]
"""Autocovariance of means over M s at a lag of j means, (M, j) -> array, in the squared unit of the
samples, up to a constant that is the same for all M."""


@dataclass(frozen=True)
class Rest:
    """Means of the samples next to a drive at one of its rests.

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
    """Samples between two rests.

    Attributes
    ----------
    start : float
        Time of the first sample in s; only differences between drives matter.
    tau0 : float
        Sample period in s.
    gyro, accel : (n, 3) array
        Evenly spaced samples in rad/s and m/s^2.
    before, after : Rest
        The rests at its ends.
    follows : bool
        Whether the drive before it ended at the rest ``before``.
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
        """Duration in s."""
        return len(self.gyro) * self.tau0


@dataclass(frozen=True)
class DriveErrors:
    """Residuals of one drive and the effect of everything that may have caused them.

    The nine residuals are rotation, velocity and rate of the module text. The effect of an error
    with k numbers is a (9, k) array: residuals per unit of each number. The samples are not kept.

    Attributes
    ----------
    start, duration : float
        As in `Drive`, in s.
    turned : float
        Angle by which the sensor turned, summed over the drive, in rad.
    follows : bool
        Whether the drive before it ended at the first rest.
    force, end : (3,) array, (3, 3) array
        f1 in m/s^2, and C(T).
    residual : (9,) array
        Residuals in m/s^2 (rotation), m/s (velocity) and rad/s (rate).
    white, rests : (6, 9, 9) array
        Covariance due to white noise with N = 1 of each axis, during the drive and at the rests.
    slow : (blocks, 9, 6) array
        Weights of the block means of the errors of each axis. The weights of an axis sum to 0: a
        bias that is constant over drive and rests has its effect in ``accel_bias`` only.
    block : float
        Duration of these blocks in s.
    accel_bias : (9, 3) array
        Effect of the bias of the accelerometer at the first rest.
    gyro_matrix, accel_matrix, g_sensitivity : (9, 9) array
        Effect of the elements of three matrices, row by row: scale factors and misalignments of the
        gyro, of the accelerometer (errors are matrix times true value), and the sensitivity of the
        gyro to specific force, in rad/s per m/s^2.
    earth : (9, 3) array
        Effect of the rotation rate of the Earth at the first rest.
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
        """Return covariances (9, 9) due to white noise: of 'gyro', 'accel' and at the 'rests'.

        ``density`` has the N of the six axes in SI.
        """
        squares = np.square(density)[:, None, None]
        during = squares * self.white
        return {
            'gyro': during[:3].sum(axis=0),
            'accel': during[3:].sum(axis=0),
            'rests': (squares * self.rests).sum(axis=0),
        }

    def slow_covariance(self, axis: int, slow: SlowNoise) -> Floats:
        """Return the covariance (9, 9) due to noise of an axis that is not white."""
        lags = np.arange(len(self.slow))
        weights, gamma = self.slow[:, :, axis], np.asarray(slow(self.block, lags))
        return np.asarray(weights.T @ gamma[np.abs(lags[:, None] - lags)] @ weights)


def drive_errors(drive: Drive) -> DriveErrors:
    """Return the residuals of a drive and the effect of everything that may cause them.

    All effects are of first order in the errors.

    Parameters
    ----------
    drive : Drive
        The samples and the rests at both ends.

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
    n, total = len(rates), drive.duration
    ends = _cumulative_products(rotation_matrices(rates * dt))
    halves = rotation_matrices(rates * (dt / 2.0))
    turned = np.concatenate([halves[:1], ends[:-1] @ halves[1:]])  # at the middle of each sample
    first, last, end = drive.before.accel, drive.after.accel, ends[-1]
    parts = np.einsum('nij,nj->ni', turned, force)
    velocity = np.cumsum(parts, axis=0) * dt
    residual = np.concatenate(
        [end @ last - first, velocity[-1] - first * total, drive.after.gyro - drive.before.gyro]
    )

    # weights of the errors of each sample, and of the means at the rests; the mean of the gyro at
    # the first rest is subtracted from its samples
    samples = np.zeros((n, ROWS, 6))
    rest_of_velocity = velocity[-1] - velocity + parts * (dt / 2.0)
    samples[:, ROTATION, :3] = -(cross_matrices(end @ last) @ turned) * dt
    samples[:, VELOCITY, :3] = -(cross_matrices(rest_of_velocity) @ turned) * dt
    samples[:, VELOCITY, 3:] = turned * dt
    on_gyro, on_accel = samples[:, :, :3], samples[:, :, 3:]
    at_first, at_last = np.zeros((ROWS, 6)), np.zeros((ROWS, 6))
    at_last[ROTATION, 3:], at_last[RATE, :3] = end, np.eye(3)
    at_first[:, :3] = -on_gyro.sum(axis=0) - at_last[:, :3]
    at_first[ROTATION, 3:], at_first[VELOCITY, 3:] = -np.eye(3), -total * np.eye(3)

    bias = on_accel.sum(axis=0) + at_first[:, 3:] + at_last[:, 3:]
    from_first = at_first.copy()  # errors relative to the mean error of the first rest
    from_first[:, 3:] -= bias
    blocks = _Blocks.of(drive)
    return DriveErrors(
        start=drive.start,
        duration=total,
        turned=float(np.linalg.norm(rates, axis=1).sum() * dt),
        follows=drive.follows,
        force=first,
        end=end,
        residual=residual,
        white=np.einsum('nia,nja->aij', samples, samples, optimize=True) / dt,
        rests=np.einsum('ia,ja->aij', at_first, at_first) / drive.before.duration
        + np.einsum('ia,ja->aij', at_last, at_last) / drive.after.duration,
        slow=blocks.weights(samples, from_first, at_last),
        block=blocks.duration,
        accel_bias=bias,
        gyro_matrix=np.einsum('nij,nk->ijk', on_gyro, rates).reshape(ROWS, 9),
        accel_matrix=(
            np.einsum('nij,nk->ijk', on_accel, force)
            + np.einsum('ij,k->ijk', at_first[:, 3:], first)
            + np.einsum('ij,k->ijk', at_last[:, 3:], last)
        ).reshape(ROWS, 9),
        g_sensitivity=(
            np.einsum('nij,nk->ijk', on_gyro, force - first)
            + np.einsum('ij,k->ijk', at_last[:, :3], last - first)
        ).reshape(ROWS, 9),
        earth=np.einsum('nij,nkj->ik', on_gyro, turned) + at_last[:, :3] @ end.T + at_first[:, :3],
    )


def cross_matrices(v: Floats) -> Floats:
    """Return the matrices [v]x of vectors v, (..., 3), with [v]x a = v x a; (..., 3, 3)."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return np.asarray(out - np.swapaxes(out, -1, -2))


def rotation_matrices(v: Floats) -> Floats:
    """Return the rotation matrices (n, 3, 3) of rotation vectors (n, 3) in rad (Rodrigues)."""
    angle = np.linalg.norm(v, axis=-1)[:, None, None]
    cross = cross_matrices(v)
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    sine = np.where(small, 1.0, np.sin(safe) / safe)
    cosine = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + sine * cross + cosine * (cross @ cross))


def _cumulative_products(matrices: Floats) -> Floats:
    """Return the products of the first k + 1 matrices for all k, in log2(n) vector operations."""
    out, step = matrices.copy(), 1
    while step < len(out):
        out[step:] = out[:-step] @ out[step:]
        step *= 2
    return out


class _Blocks(NamedTuple):
    """Division of a drive and its rests into blocks of equal duration."""

    duration: float  # of a block in s
    number: int
    before: Floats  # share of the first rest in each block
    inside: NDArray[np.intp]  # block of each sample of the drive
    after: Floats  # share of the second rest in each block

    @classmethod
    def of(cls, drive: Drive) -> _Blocks:
        begins = drive.before.duration
        ends = begins + drive.duration
        total = ends + drive.after.duration
        edges = np.linspace(0.0, total, SLOW_BLOCKS + 1)
        before = np.diff(np.minimum(edges, begins)) / begins
        after = np.diff(np.maximum(edges, ends)) / drive.after.duration
        middle = begins + (np.arange(len(drive.gyro)) + 0.5) * drive.tau0
        inside = np.minimum((middle / edges[1]).astype(np.intp), SLOW_BLOCKS - 1)
        return cls(float(edges[1]), SLOW_BLOCKS, before, inside, after)

    def weights(self, samples: Floats, first: Floats, last: Floats) -> Floats:
        """Return the weights (blocks, 9, 6) of block means.

        ``samples``, (n, 9, 6), are the weights of the samples. ``first`` and ``last``, (9, 6), are
        the weights of the means at the rests.
        """
        starts = np.flatnonzero(np.diff(self.inside, prepend=-1))
        out = np.zeros((self.number, *first.shape))
        out[self.inside[starts]] = np.add.reduceat(samples, starts, axis=0)
        out += self.before[:, None, None] * first + self.after[:, None, None] * last
        return out
