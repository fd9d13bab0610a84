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
from .noise_floor import SAME_GRAVITY, NoiseFloor
from .sensors import zeros_and_repeats
from .windows import Windows, is_stuck

STEADY_CHANGE = 0.1
"""A mean acceleration is compared with gravity if the steps between the means of neighboring
windows, and the median standard deviation in a window, are at most this fraction of the magnitude
of the mean acceleration. A magnitude below 0.49 m/s^2 (`WEIGHTLESS`) counts as 0.49 m/s^2."""

LARGER_NOISE = 1.3
"""The noise of an axis is reported as larger than before if the standard deviation of the white
noise now exceeds the Allan deviation at one sample period by more than this factor. The standard
deviation has an error of 4 % from 8 windows of 50 samples, and of 8 % from 8 windows of 16
samples."""


def present_faults(
    axes: tuple[str, ...], floor: NoiseFloor, rows: Floats, windows: Windows, seconds: float
) -> tuple[Finding, ...]:
    """Return the known faults that explain why the latest windows are not at rest.

    ``rows``, (axes, n), are the samples of the windows, and ``floor`` is the noise floor.
    ``seconds`` is the time in s for which the IMU has not been at rest.
    """
    findings: list[Finding] = []
    for sensor in SENSORS:
        indices = [i for i, axis in enumerate(axes) if sensor_of(axis) == sensor]
        if indices and (floor.foreign(rows, windows, floor.size)).all():
            findings += zeros_and_repeats(sensor, tuple(axes[i] for i in indices), rows[indices])
    variance = np.median(windows.variance, axis=1)
    with np.errstate(invalid='ignore', divide='ignore'):
        ratio = np.sqrt(variance / floor.scale)
    if unit := floor.changed_unit(ratio):
        gyro = tuple(axis for axis in axes if sensor_of(axis) == 'gyro')
        findings.append(
            finding('gyro_unit_changed', gyro, ratio=float(ratio[floor.gyro].max()), unit=unit)
        )
    accel = tuple(axis for axis in axes if sensor_of(axis) == 'accel')
    if not findings and len(accel) == 3:
        findings += _gravity(accel, floor, windows, variance[~floor.gyro])
    has_decreased = np.asarray((floor.decreased(windows) & ~is_stuck(rows, floor.size)).all(axis=1))
    if not findings and has_decreased.any():
        smallest_ratio = float(
            np.sqrt(variance[has_decreased] / floor.variance[has_decreased]).min()
        )
        decreased_axes = tuple(
            axis for axis, is_decreased in zip(axes, has_decreased) if is_decreased
        )
        findings.append(
            finding('noise_decreased', decreased_axes, ratio=smallest_ratio, seconds=seconds)
        )
    return tuple(findings)


def noise_now(health: StreamHealth, sums: Iterable[AllanSums]) -> list[Finding]:
    """Return a finding for each axis whose present noise exceeds the noise in the Allan sums.

    The ratio must exceed `LARGER_NOISE`.
    """
    findings = []
    for stream_sums in sums:
        avars = stream_sums.avar[0] if len(stream_sums.m) else ()
        for axis, avar in zip(stream_sums.axes, avars):
            if avar > 0.0 and health.noise.get(axis, 0.0) > LARGER_NOISE * avar**0.5:
                ratio = health.noise[axis] / float(avar) ** 0.5
                findings.append(finding('noise_now', (axis,), ratio=ratio))
    return findings


def noise_ratios(findings: Iterable[Finding]) -> dict[str, float]:
    """Return axis -> ratio of the present noise to the earlier noise, as `noise_now` found it."""
    return {f.axes[0]: float(f.values['ratio']) for f in findings if f.id == 'noise_now'}


def _gravity(
    accel: tuple[str, ...], floor: NoiseFloor, windows: Windows, variance: Floats
) -> list[Finding]:
    """Return a finding if the specific force at rest was gravity in m/s^2, but no longer is.

    There is no finding if the mean acceleration is not steady (`STEADY_CHANGE`).
    """
    means = windows.mean[~floor.gyro]
    norm, gravity = float(np.linalg.norm(means.mean(axis=1))), floor.gravity
    least_gravity = WEIGHTLESS * STANDARD_GRAVITY
    largest_change = STEADY_CHANGE * max(norm, least_gravity)
    largest_step = np.abs(np.diff(means, axis=1)).max(initial=0.0)
    if (
        largest_step > largest_change
        or np.sqrt(variance).max() > largest_change
        or gravity_unit(gravity) != 'm/s^2'
    ):
        return []
    if abs(norm - gravity) < SAME_GRAVITY * gravity:
        return []
    if norm < least_gravity and not gravity_unit(norm):
        return [finding('gravity_removed', accel, norm=norm, before=gravity)]
    return gravity_findings(norm, accel)
