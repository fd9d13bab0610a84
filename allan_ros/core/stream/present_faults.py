# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Finds known faults of the latest samples, and noise that is larger than before."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..allan.sums import AllanSums
from ..findings import Finding, finding
from ..imu import SENSORS, STANDARD_GRAVITY, Floats, sensor_of
from .health import WEIGHTLESS, StreamHealth, gravity_findings, gravity_unit
from .noise_floor import SAME_GRAVITY, NoiseFloor, Windows, is_stuck
from .sensors import zeros_and_repeats

STEADY_CHANGE = 0.1
"""Largest step between the means of neighboring windows, and largest standard deviation in a
window, as fractions of the mean acceleration, at which its magnitude is compared with gravity."""

LARGER_NOISE = 1.3
"""Ratio of the present standard deviation to the Allan deviation at one sample period above which
the noise is reported as larger. The present standard deviation has an error of 4 % from 8 windows
of 50 samples, and of 8 % from 8 windows of 16 samples."""


def present_faults(
    axes: tuple[str, ...], floor: NoiseFloor, rows: Floats, windows: Windows, seconds: float
) -> tuple[Finding, ...]:
    """Return the known faults that explain why the latest windows are not at rest.

    ``rows``, (axes, n), are the samples of the windows in the unit of the messages, and ``floor``
    is the noise of the IMU. ``seconds`` is the time since the last sample at rest in s.
    """
    found: list[Finding] = []
    for sensor in SENSORS:
        columns = [i for i, axis in enumerate(axes) if sensor_of(axis) == sensor]
        if columns and (floor.foreign(rows, windows, floor.size)).all():
            found += zeros_and_repeats(sensor, tuple(axes[i] for i in columns), rows[columns])
    variance = np.median(windows.variance, axis=1)
    with np.errstate(invalid='ignore', divide='ignore'):
        ratio = np.sqrt(variance / floor.scale)
    if unit := floor.changed_unit(ratio):
        gyro = tuple(axis for axis in axes if sensor_of(axis) == 'gyro')
        found.append(
            finding('gyro_unit_changed', gyro, ratio=float(ratio[floor.gyro].max()), unit=unit)
        )
    accel = tuple(axis for axis in axes if sensor_of(axis) == 'accel')
    if not found and len(accel) == 3:
        found += _gravity(accel, floor, windows, variance[~floor.gyro])
    has_decreased = np.asarray((floor.decreased(windows) & ~is_stuck(rows, floor.size)).all(axis=1))
    if not found and has_decreased.any():
        smallest_ratio = float(
            np.sqrt(variance[has_decreased] / floor.variance[has_decreased]).min()
        )
        names = tuple(axis for axis, flag in zip(axes, has_decreased) if flag)
        found.append(finding('noise_decreased', names, ratio=smallest_ratio, seconds=seconds))
    return tuple(found)


def noise_now(health: StreamHealth, sums: Iterable[AllanSums]) -> list[Finding]:
    """Return a finding for each axis whose present noise is larger than in the Allan sums."""
    found = []
    for each in sums:
        for axis, avar in zip(each.axes, each.avar[0] if len(each.m) else ()):
            if avar > 0.0 and health.noise.get(axis, 0.0) > LARGER_NOISE * avar**0.5:
                ratio = health.noise[axis] / float(avar) ** 0.5
                found.append(finding('noise_now', (axis,), ratio=ratio))
    return found


def noise_ratios(findings: Iterable[Finding]) -> dict[str, float]:
    """Return axis -> ratio of the present noise to the Allan sums, from findings of `noise_now`."""
    return {f.axes[0]: float(f.values['ratio']) for f in findings if f.id == 'noise_now'}


def _gravity(
    accel: tuple[str, ...], floor: NoiseFloor, windows: Windows, variance: Floats
) -> list[Finding]:
    """Return a finding if the specific force at rest is no longer gravity in m/s^2."""
    means = windows.mean[~floor.gyro]
    norm, gravity = float(np.linalg.norm(means.mean(axis=1))), floor.gravity
    weightless = WEIGHTLESS * STANDARD_GRAVITY
    largest_change = STEADY_CHANGE * max(norm, weightless)
    steps = np.abs(np.diff(means, axis=1)).max(initial=0.0)
    if (
        steps > largest_change
        or np.sqrt(variance).max() > largest_change
        or gravity_unit(gravity) != 'm/s^2'
    ):
        return []
    if abs(norm - gravity) < SAME_GRAVITY * gravity:
        return []
    if norm < weightless and not gravity_unit(norm):
        return [finding('gravity_removed', accel, norm=norm, before=gravity)]
    return gravity_findings(norm, accel)
