# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulation of a robot that drives and stops, with errors of its IMU that only motion shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .imu import STANDARD_GRAVITY
from .noise import Model
from .settings import CheckedSettings, parameter
from .simulator import simulate_imu
from .stream.drives import EARTH_RATE, rotation_matrices

Floats = NDArray[np.float64]

WAVE_S = 8.0
"""Period in s of the waves that tilt a ferry."""


@dataclass(frozen=True)
class Route(CheckedSettings):
    """Motion of a simulated robot, which rests and drives in turn.

    Raises
    ------
    AllanError
        When a value lies outside its range.
    """

    drives: int = parameter(20, 'number of drives', low=0)
    first: float = parameter(20.0, 'duration of the first rest', unit='s', low=0.1)
    rest: float = parameter(10.0, 'duration of the other rests', unit='s', low=0.1)
    shortest: float = parameter(15.0, 'duration of the shortest drive', unit='s', low=1.0)
    longest: float = parameter(60.0, 'duration of the longest drive', unit='s', low=1.0)
    speed: float = parameter(1.0, 'typical speed', unit='m/s', low=0.0)
    turn: float = parameter(0.5, 'typical yaw rate', unit='rad/s', low=0.0)
    tilt: float = parameter(0.08, 'typical slope of the ground', unit='rad', low=0.0)


@dataclass(frozen=True)
class MotionErrors(CheckedSettings):
    """Errors of an IMU that only motion shows; all are 0 by default.

    The elements of the error matrices are random. ``gyro_scale`` and ``accel_scale`` are the
    standard deviations of the diagonal elements, ``gyro_misalignment`` of the other elements, and
    ``g_sensitivity`` of all elements.

    Raises
    ------
    AllanError
        When a value lies outside its range.
    """

    gyro_scale: float = parameter(0.0, 'scale factors of the gyro', low=0.0)
    gyro_misalignment: float = parameter(0.0, 'misalignments of the gyro', unit='rad', low=0.0)
    accel_scale: float = parameter(0.0, 'scale factors of the accelerometer', low=0.0)
    g_sensitivity: float = parameter(
        0.0, 'sensitivity of the gyro to specific force', unit='rad/s/(m/s^2)', low=0.0
    )
    gyro_noise: float = parameter(1.0, 'factor of N of the gyro in motion', low=1.0)
    accel_noise: float = parameter(1.0, 'factor of N of the accelerometer in motion', low=1.0)
    vibration: float = parameter(
        0.0,
        'standard deviation of the accelerometer error by vibration, at frequencies up to a tenth '
        'of the rate; its logarithm varies from drive to drive with a standard deviation of 0.5',
        unit='m/s^2',
        low=0.0,
    )
    growth: float = parameter(
        0.0,
        'additional N of the gyro for each m/s^2 of vibration, as a multiple of N at rest',
        unit='1/(m/s^2)',
        low=0.0,
    )
    hits: float = parameter(
        0.0,
        'standard deviation of the velocity error of the accelerometer at a shock, one in each '
        'drive',
        unit='m/s',
        low=0.0,
    )
    waves: float = parameter(
        0.0, 'amplitude of the tilt by waves of a ferry, also at rest', unit='rad', low=0.0
    )
    heating: float = parameter(
        0.0,
        'standard deviation of the change of the gyro bias that the heat of motors causes',
        unit='rad/s',
        low=0.0,
    )
    heating_time: float = parameter(120.0, 'time constant of the heating', unit='s', low=1.0)
    creep: float = parameter(
        0.0, 'standard deviation of the speed of wheels that creep at rest', unit='m/s', low=0.0
    )
    latitude: float = parameter(
        48.0,
        'latitude, which determines the measured rotation of the Earth',
        unit='deg',
        low=-90.0,
        high=90.0,
    )


@dataclass(frozen=True)
class SimulatedDrives:
    """IMU samples of a simulated robot, with the true angles and errors.

    Attributes
    ----------
    rate : float
        Sample rate in Hz.
    samples : (n, 6) array
        Measured angular rate in rad/s and specific force in m/s^2.
    drives : tuple of (start, end)
        Index of the first sample of each drive, and of the first sample after the drive.
    angles : (n + 1, 3) array
        True roll, pitch and yaw in rad at the start of each sample and at the end of the last.
    gyro_matrix : (3, 3) array
        Matrix whose product with the true angular rate is an error of the gyro.
    accel_matrix : (3, 3) array
        Matrix whose product with the true specific force is an error of the accelerometer.
    g_sensitivity : (3, 3) array
        Matrix in rad/s/(m/s^2) whose product with the true specific force is an error of the gyro.
    """

    rate: float
    samples: Floats
    drives: tuple[tuple[int, int], ...]
    angles: Floats
    gyro_matrix: Floats
    accel_matrix: Floats
    g_sensitivity: Floats


def simulate_drives(
    rate: float,
    gyro: Sequence[Model],
    accel: Sequence[Model],
    route: Route = Route(),
    errors: MotionErrors = MotionErrors(),
    seed: int = 0,
) -> SimulatedDrives:
    """Simulate the IMU of a robot that rests and drives in turn, beginning and ending at rest.

    Parameters
    ----------
    rate : float
        Sample rate in Hz.
    gyro, accel : sequence of three Model
        Noise of the axes at rest.
    route : Route
        The motion.
    errors : MotionErrors
        Errors that only motion shows.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    SimulatedDrives

    Examples
    --------
    >>> quiet = [Model.of(N=1e-4)] * 3
    >>> robot = simulate_drives(50.0, quiet, quiet, Route(drives=2))
    >>> len(robot.drives), robot.samples.shape[1]
    (2, 6)
    """
    rng = np.random.default_rng(seed)
    dt = 1.0 / rate
    path = _Path.of(rate, route, errors, rng)
    n = len(path.moving)
    attitude = _from_euler(path.angles)
    rates = _rotation_vectors(np.swapaxes(attitude[:-1], 1, 2) @ attitude[1:]) * rate
    middle = attitude[:-1] @ rotation_matrices(rates * (dt / 2.0))
    north, up = math.cos(math.radians(errors.latitude)), math.sin(math.radians(errors.latitude))
    rates = rates + np.einsum('nji,j->ni', middle, EARTH_RATE * np.array([north, 0.0, up]))
    velocity = attitude[:, :, 0] * path.speed[:, None]
    specific = np.diff(velocity, axis=0) * rate + [0.0, 0.0, STANDARD_GRAVITY]
    force = np.einsum('nji,nj->ni', middle, specific)
    gyro_matrix = errors.gyro_misalignment * rng.standard_normal((3, 3))
    np.fill_diagonal(gyro_matrix, errors.gyro_scale * rng.standard_normal(3))
    accel_matrix = np.diag(errors.accel_scale * rng.standard_normal(3))
    sensitivity = errors.g_sensitivity * rng.standard_normal((3, 3))
    heat = _first_order(path.moving, errors.heating_time * rate)[:, None] * rng.standard_normal(3)
    measured = [
        rates + rates @ gyro_matrix.T + force @ sensitivity.T + errors.heating * heat,
        force + force @ accel_matrix.T,
    ]
    at_rest = np.concatenate(
        [batch.samples for batch in simulate_imu(n * dt, rate, gyro, accel, seed=seed + 1)]
    )[:n] - [0, 0, 0, 0, 0, STANDARD_GRAVITY]
    white = np.array([model.value('N') for model in (*gyro, *accel)])
    return SimulatedDrives(
        rate,
        np.concatenate(measured, axis=1) + at_rest + _noise_in_motion(path, white, errors, rng),
        path.drives,
        path.angles,
        gyro_matrix,
        accel_matrix,
        sensitivity,
    )


class _Path(NamedTuple):
    """Motion of the robot. Angles and speed are given at the n + 1 edges of the n samples."""

    rate: float
    drives: tuple[tuple[int, int], ...]
    moving: Floats  # (n,); 1 in drives, 0 at rest
    angles: Floats  # (n + 1, 3); roll, pitch, yaw in rad
    speed: Floats  # (n + 1,); forward speed in m/s

    @classmethod
    def of(cls, rate: float, route: Route, errors: MotionErrors, rng: np.random.Generator) -> _Path:
        """Draw a random path. The slope of the ground changes during each drive."""
        lengths = rng.uniform(route.shortest, max(route.longest, route.shortest), route.drives)
        at, drives = round(route.first * rate), []
        for length in lengths:
            drives.append((at, at + round(length * rate)))
            at = drives[-1][1] + round(route.rest * rate)
        moving, speed = np.zeros(at), np.zeros(at + 1)
        angles = np.zeros((at + 1, 3))
        angles[:] = rng.normal(0.0, route.tilt, 3) * [1, 1, 0]
        for start, end in drives:
            moving[start:end] = 1.0
            size = end - start + 1
            envelope = _envelope(size, 2.0 * rate)
            slopes = np.stack([_smooth(size, 4.0 * rate, rng) for _ in range(2)], axis=1)
            ends = rng.normal(0.0, route.tilt, 2) - angles[start, :2]
            passed = np.linspace(0.0, 1.0, size)[:, None]
            tilt = route.tilt * slopes * envelope[:, None] + passed**2 * (3.0 - 2.0 * passed) * ends
            yaw = np.cumsum(route.turn * _smooth(size, 2.0 * rate, rng) * envelope) / rate
            angles[start : end + 1, :2] = angles[start, :2] + tilt
            angles[start : end + 1, 2] = angles[start, 2] + yaw
            angles[end + 1 :] = angles[end]
            speed[start : end + 1] = route.speed * _smooth(size, 3.0 * rate, rng) * envelope
            speed[end + 1 :] = errors.creep * rng.standard_normal()
        phase = rng.uniform(0.0, 2.0 * math.pi, 2)
        waves = np.sin(2.0 * math.pi * np.arange(at + 1)[:, None] / (WAVE_S * rate) + phase)
        angles[:, :2] += errors.waves * waves
        return cls(rate, tuple(drives), moving, angles, speed)


def _noise_in_motion(
    path: _Path, white: Floats, errors: MotionErrors, rng: np.random.Generator
) -> Floats:
    """Return the noise that is added in the drives, (n, 6), in rad/s and m/s^2.

    ``white`` is N of the six axes at rest, (6,).
    """
    n = len(path.moving)
    level = np.zeros((n, 1))
    noise = np.zeros((n, 6))
    for start, end in path.drives:
        level[start:end] = errors.vibration * math.exp(0.5 * rng.standard_normal())
        if errors.hits:
            size = round(0.1 * path.rate)
            at = rng.integers(start, end - size)
            noise[at : at + size, 3:] += errors.hits * rng.standard_normal(3) / 0.1
    noise[:, 3:] += level * np.stack([_smooth(n, 10.0, rng) for _ in range(3)], axis=1)
    factors = np.repeat([errors.gyro_noise, errors.accel_noise], 3) ** 2 - 1.0
    squares = path.moving[:, None] * factors
    squares[:, :3] += (errors.growth * level) ** 2
    return np.asarray(noise + white * np.sqrt(squares * path.rate) * rng.standard_normal((n, 6)))


def _smooth(n: int, width: float, rng: np.random.Generator) -> Floats:
    """Return smooth noise of unit variance, (n,), correlated over about ``width`` samples."""
    k = max(round(width), 2)
    kernel = np.hanning(2 * k + 1)
    kernel /= math.sqrt(float(kernel @ kernel))
    return np.convolve(rng.standard_normal(n + 2 * k), kernel, 'valid')


def _envelope(n: int, ramp: float) -> Floats:
    """Return a window, (n,): 0 at both ends, 1 between, and ramps of at most ``ramp`` samples."""
    at = np.arange(n)
    x = np.clip(np.minimum(at, n - 1 - at) / max(min(ramp, n / 4.0), 1.0), 0.0, 1.0)
    return np.asarray(x**2 * (3.0 - 2.0 * x))


def _first_order(x: Floats, time: float) -> Floats:
    """Return the response of a first-order system to x, (n,); ``time`` is in samples."""
    decay = math.exp(-1.0 / time)
    out, last = np.empty(len(x)), 0.0
    for i, value in enumerate(x.tolist()):
        last = decay * last + (1.0 - decay) * value
        out[i] = last
    return out


def _from_euler(angles: Floats) -> Floats:
    """Return the matrices Rz(yaw) Ry(pitch) Rx(roll), (n, 3, 3), of roll, pitch and yaw, (n, 3)."""
    zero = np.zeros(len(angles))
    roll = rotation_matrices(np.stack([angles[:, 0], zero, zero], axis=1))
    pitch = rotation_matrices(np.stack([zero, angles[:, 1], zero], axis=1))
    yaw = rotation_matrices(np.stack([zero, zero, angles[:, 2]], axis=1))
    return np.asarray(yaw @ pitch @ roll)


def _rotation_vectors(matrices: Floats) -> Floats:
    """Return the rotation vectors, (n, 3), of matrices of small rotations, (n, 3, 3)."""
    skew = (matrices - np.swapaxes(matrices, 1, 2)) / 2.0
    sine = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    size = np.linalg.norm(sine, axis=1)[:, None]
    return np.asarray(sine * np.where(size < 1e-8, 1.0, np.arcsin(size) / np.maximum(size, 1e-300)))
