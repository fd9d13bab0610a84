# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulation of a robot that drives and stops, and of the errors that motion causes in its IMU."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allan_ros.core.imu import STANDARD_GRAVITY
from allan_ros.core.noise import Model
from allan_ros.core.settings import CheckedSettings, parameter
from allan_ros.core.simulator import simulate_imu
from allan_ros.core.stream.drives import EARTH_RATE, rotation_matrices

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
    """Errors that motion causes in an IMU, and motion that continues at rest; none by default.

    The elements of the three error matrices of `SimulatedDrives` are random. In ``gyro_matrix``,
    ``gyro_scale`` is the standard deviation of the diagonal elements, and ``gyro_misalignment`` of
    the other elements. In ``accel_matrix``, ``accel_scale`` is the standard deviation of the
    diagonal elements; the other elements are 0. In ``g_sensitivity``, all elements have the
    standard deviation ``g_sensitivity``.

    Raises
    ------
    AllanError
        When a value lies outside its range.
    """

    gyro_scale: float = parameter(0.0, 'scale factor errors of the gyro', low=0.0)
    gyro_misalignment: float = parameter(0.0, 'misalignments of the gyro', unit='rad', low=0.0)
    accel_scale: float = parameter(0.0, 'scale factor errors of the accelerometer', low=0.0)
    g_sensitivity: float = parameter(
        0.0, 'sensitivity of the gyro to specific force', unit='rad/s/(m/s^2)', low=0.0
    )
    gyro_noise: float = parameter(1.0, 'N of the gyro in motion, divided by N at rest', low=1.0)
    accel_noise: float = parameter(
        1.0, 'N of the accelerometer in motion, divided by N at rest', low=1.0
    )
    vibration: float = parameter(
        0.0,
        'standard deviation of the vibration that the accelerometer measures, at frequencies up to '
        'a tenth of the rate; its logarithm varies between drives with a standard deviation of 0.5',
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
        'standard deviation of the velocity error that a shock causes; each drive has one shock',
        unit='m/s',
        low=0.0,
    )
    waves: float = parameter(
        0.0,
        'amplitude of the tilt of a ferry on waves, which continues at rest',
        unit='rad',
        low=0.0,
    )
    heating: float = parameter(
        0.0,
        'standard deviation of the change of the gyro bias by the heat of the motors',
        unit='rad/s',
        low=0.0,
    )
    heating_time: float = parameter(
        120.0, 'time constant of this change of the gyro bias', unit='s', low=1.0
    )
    creep: float = parameter(
        0.0,
        'standard deviation of the speed at which the wheels creep at the rests',
        unit='m/s',
        low=0.0,
    )
    latitude: float = parameter(
        48.0,
        'latitude, which determines the direction of the rotation of the Earth',
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
        Index of the first sample of each drive, and index of the first sample after the drive.
    angles : (n + 1, 3) array
        True roll, pitch and yaw in rad at the start of each sample, and at the end of the last
        sample.
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
        Errors that motion causes, and motion that continues at rest.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    SimulatedDrives

    Raises
    ------
    AllanError
        When the rate is out of range.

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
    middle_attitude = attitude[:-1] @ rotation_matrices(rates * (dt / 2.0))
    north, up = math.cos(math.radians(errors.latitude)), math.sin(math.radians(errors.latitude))
    rates = rates + np.einsum('nji,j->ni', middle_attitude, EARTH_RATE * np.array([north, 0.0, up]))
    velocity = attitude[:, :, 0] * path.speed[:, None]
    earth_force = np.diff(velocity, axis=0) * rate + [0.0, 0.0, STANDARD_GRAVITY]
    sensor_force = np.einsum('nji,nj->ni', middle_attitude, earth_force)
    gyro_matrix = errors.gyro_misalignment * rng.standard_normal((3, 3))
    np.fill_diagonal(gyro_matrix, errors.gyro_scale * rng.standard_normal(3))
    accel_matrix = np.diag(errors.accel_scale * rng.standard_normal(3))
    sensitivity = errors.g_sensitivity * rng.standard_normal((3, 3))
    heat = _first_order(path.moving, errors.heating_time * rate)
    gyro_heat = heat[:, None] * rng.standard_normal(3)
    without_noise = [
        rates + rates @ gyro_matrix.T + sensor_force @ sensitivity.T + errors.heating * gyro_heat,
        sensor_force + sensor_force @ accel_matrix.T,
    ]
    noise_at_rest = np.concatenate(
        [batch.samples for batch in simulate_imu(n * dt, rate, gyro, accel, seed=seed + 1)]
    )[:n] - [0, 0, 0, 0, 0, STANDARD_GRAVITY]
    white_noise = np.array([model.value('N') for model in (*gyro, *accel)])
    return SimulatedDrives(
        rate,
        np.concatenate(without_noise, axis=1)
        + noise_at_rest
        + _noise_in_motion(path, white_noise, errors, rng),
        path.drives,
        path.angles,
        gyro_matrix,
        accel_matrix,
        sensitivity,
    )


class _Path(NamedTuple):
    """Motion of the robot during n samples.

    Angles and speed are given at the start of each sample and at the end of the last sample.
    """

    rate: float
    drives: tuple[tuple[int, int], ...]
    moving: Floats  # 1 in drives, 0 at rest, (n,)
    angles: Floats  # roll, pitch and yaw in rad, (n + 1, 3)
    speed: Floats  # forward speed in m/s, (n + 1,)

    @classmethod
    def of(cls, rate: float, route: Route, errors: MotionErrors, rng: np.random.Generator) -> _Path:
        """Return a random path, in which the slope of the ground changes during each drive."""
        durations = rng.uniform(route.shortest, max(route.longest, route.shortest), route.drives)
        end_of_path, drives = round(route.first * rate), []
        for duration in durations:
            drives.append((end_of_path, end_of_path + round(duration * rate)))
            end_of_path = drives[-1][1] + round(route.rest * rate)
        moving, speed = np.zeros(end_of_path), np.zeros(end_of_path + 1)
        angles = np.zeros((end_of_path + 1, 3))
        angles[:] = rng.normal(0.0, route.tilt, 3) * [1, 1, 0]
        for start, end in drives:
            moving[start:end] = 1.0
            size = end - start + 1
            envelope = _envelope(size, 2.0 * rate)
            slopes = np.stack([_smooth(size, 4.0 * rate, rng) for _ in range(2)], axis=1)
            tilt_change = rng.normal(0.0, route.tilt, 2) - angles[start, :2]
            progress = np.linspace(0.0, 1.0, size)[:, None]
            tilt = (
                route.tilt * slopes * envelope[:, None]
                + progress**2 * (3.0 - 2.0 * progress) * tilt_change
            )
            yaw = np.cumsum(route.turn * _smooth(size, 2.0 * rate, rng) * envelope) / rate
            angles[start : end + 1, :2] = angles[start, :2] + tilt
            angles[start : end + 1, 2] = angles[start, 2] + yaw
            angles[end + 1 :] = angles[end]
            speed[start : end + 1] = route.speed * _smooth(size, 3.0 * rate, rng) * envelope
            speed[end + 1 :] = errors.creep * rng.standard_normal()
        phase = rng.uniform(0.0, 2.0 * math.pi, 2)
        wave_tilt = np.sin(
            2.0 * math.pi * np.arange(end_of_path + 1)[:, None] / (WAVE_S * rate) + phase
        )
        angles[:, :2] += errors.waves * wave_tilt
        return cls(rate, tuple(drives), moving, angles, speed)


def _noise_in_motion(
    path: _Path, white: Floats, errors: MotionErrors, rng: np.random.Generator
) -> Floats:
    """Return the noise that motion adds to the noise at rest, (n, 6), in rad/s and m/s^2.

    ``white`` is N of the six axes at rest, (6,).
    """
    n = len(path.moving)
    vibration_std = np.zeros((n, 1))
    noise = np.zeros((n, 6))
    for start, end in path.drives:
        vibration_std[start:end] = errors.vibration * math.exp(0.5 * rng.standard_normal())
        if errors.hits:
            hit_samples = round(0.1 * path.rate)
            hit_start = rng.integers(start, end - hit_samples)
            noise[hit_start : hit_start + hit_samples, 3:] += (
                errors.hits * rng.standard_normal(3) / 0.1
            )
    noise[:, 3:] += vibration_std * np.stack([_smooth(n, 10.0, rng) for _ in range(3)], axis=1)
    factors = np.repeat([errors.gyro_noise, errors.accel_noise], 3) ** 2 - 1.0
    added_variance = path.moving[:, None] * factors
    added_variance[:, :3] += (errors.growth * vibration_std) ** 2
    return np.asarray(
        noise + white * np.sqrt(added_variance * path.rate) * rng.standard_normal((n, 6))
    )


def _smooth(n: int, width: float, rng: np.random.Generator) -> Floats:
    """Return smooth noise of unit variance, (n,), correlated over about ``width`` samples."""
    k = max(round(width), 2)
    kernel = np.hanning(2 * k + 1)
    kernel /= math.sqrt(float(kernel @ kernel))
    return np.convolve(rng.standard_normal(n + 2 * k), kernel, 'valid')


def _envelope(n: int, ramp: float) -> Floats:
    """Return a window, (n,), that rises from 0 to 1, and falls to 0 at its end.

    The rise and the fall each last ``ramp`` samples, but at most a quarter of the window.
    """
    index = np.arange(n)
    x = np.clip(np.minimum(index, n - 1 - index) / max(min(ramp, n / 4.0), 1.0), 0.0, 1.0)
    return np.asarray(x**2 * (3.0 - 2.0 * x))


def _first_order(x: Floats, time: float) -> Floats:
    """Return the response of a first-order system to the input ``x``, (n,).

    ``time`` is the time constant of the system in samples.
    """
    decay = math.exp(-1.0 / time)
    response, last_response = np.empty(len(x)), 0.0
    for i, value in enumerate(x.tolist()):
        last_response = decay * last_response + (1.0 - decay) * value
        response[i] = last_response
    return response


def _from_euler(angles: Floats) -> Floats:
    """Return the rotation matrices Rz(yaw) Ry(pitch) Rx(roll), (n, 3, 3).

    ``angles`` are roll, pitch and yaw in rad, (n, 3).
    """
    zero = np.zeros(len(angles))
    roll = rotation_matrices(np.stack([angles[:, 0], zero, zero], axis=1))
    pitch = rotation_matrices(np.stack([zero, angles[:, 1], zero], axis=1))
    yaw = rotation_matrices(np.stack([zero, zero, angles[:, 2]], axis=1))
    return np.asarray(yaw @ pitch @ roll)


def _rotation_vectors(matrices: Floats) -> Floats:
    """Return the rotation vectors in rad, (n, 3), of matrices of small rotations, (n, 3, 3)."""
    skew = (matrices - np.swapaxes(matrices, 1, 2)) / 2.0
    sine_vector = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    sine_norm = np.linalg.norm(sine_vector, axis=1)[:, None]
    return np.asarray(
        sine_vector
        * np.where(sine_norm < 1e-8, 1.0, np.arcsin(sine_norm) / np.maximum(sine_norm, 1e-300))
    )
