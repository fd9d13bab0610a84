# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names what is wrong with the latest samples, which are no measurements of the IMU at rest."""

from __future__ import annotations

import numpy as np

from ..findings import Finding, finding
from ..imu import SENSORS, STANDARD_GRAVITY, Floats, sensor_of
from .health import WEIGHTLESS, are_degrees, gravity_findings, gravity_unit
from .noise_floor import SAME_GRAVITY, NoiseFloor, Windows
from .sensors import zeros_and_repeats

STEADY = 0.1
"""Largest step between the means of neighboring windows, and largest standard deviation in a
window, as a fraction of gravity, at which the magnitude of the mean acceleration is judged."""


def present_faults(
    axes: tuple[str, ...], floor: NoiseFloor, rows: Floats, windows: Windows
) -> tuple[Finding, ...]:
    """Return the known faults that explain why the latest windows are not at rest.

    ``rows``, (axes, n), are the samples of the windows, and ``floor`` is the noise of the IMU.
    """
    found: list[Finding] = []
    for sensor in SENSORS:
        own = [i for i, axis in enumerate(axes) if sensor_of(axis) == sensor]
        if own and (floor.foreign(rows, windows, floor.size)).all():
            found += zeros_and_repeats(sensor, tuple(axes[i] for i in own), rows[own])
    variance = np.median(windows.variance, axis=1)
    with np.errstate(invalid='ignore', divide='ignore'):
        ratio = np.sqrt(variance / floor.scale)[floor.gyro]
    if are_degrees(ratio):
        gyro = tuple(axis for axis in axes if sensor_of(axis) == 'gyro')
        found.append(finding('gyro_unit_changed', gyro, ratio=float(ratio.max())))
    accel = tuple(axis for axis in axes if sensor_of(axis) == 'accel')
    if not found and len(accel) == 3:
        found += _gravity(accel, floor, windows, variance[~floor.gyro])
    return tuple(found)


def _gravity(
    accel: tuple[str, ...], floor: NoiseFloor, windows: Windows, variance: Floats
) -> list[Finding]:
    """Return a finding if the specific force at rest is no longer gravity in m/s^2."""
    means = windows.mean[~floor.gyro]
    norm, known = float(np.linalg.norm(means.mean(axis=1))), floor.gravity
    weightless = WEIGHTLESS * STANDARD_GRAVITY
    largest = STEADY * max(norm, weightless)
    steps = np.abs(np.diff(means, axis=1)).max(initial=0.0)
    if steps > largest or np.sqrt(variance).max() > largest or gravity_unit(known) != 'm/s^2':
        return []
    if abs(norm - known) < SAME_GRAVITY * known:
        return []
    if norm < weightless and not gravity_unit(norm):
        return [finding('gravity_removed', accel, norm=norm, before=known)]
    return gravity_findings(norm, accel)
