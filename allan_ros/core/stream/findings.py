# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The findings about a stream, from its counts and its sums."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..allan.sums import AllanSums
from ..findings import Finding, finding
from ..imu import SENSORS, STANDARD_GRAVITY, sensor_of
from ..settings import SegmenterSettings
from .health import StreamHealth
from .timing import RATE_CHANGE

TOLD_BRIDGED_SHARE = 1e-3
"""Least share of interpolated samples that is reported."""


LOUDER_SHARE = 0.5
"""Axes with this share of the largest increase of noise are named."""


SHORT_S = 60.0
"""Less than a minute of data does not even give N within a few percent."""


LEAST_SPIKES, LEAST_SPIKE_SHARE = 3, 1e-6
"""Fewest isolated spikes, and their least share of the samples, that are reported: white noise has
less than 1e-7."""


LARGEST_N, LARGEST_REST_RATE = 3e-3, 0.2
"""Angle random walk in rad/s/sqrt(Hz) (10 deg/sqrt(h)) and mean rate at rest in rad/s (11 deg/s)
that gyros do not reach."""


G_BAND = 0.15
"""Relative tolerance within which a mean acceleration is gravity."""


WEIGHTLESS = 0.05
"""Mean acceleration, as a fraction of that of gravity in any unit, below which it was removed."""


def stream_findings(
    health: StreamHealth, sums: tuple[AllanSums, ...], settings: SegmenterSettings
) -> list[Finding]:
    """Return the findings about a stream and its sums."""
    counts = health.counts
    found: list[Finding] = []
    tau0 = sums[0].tau0 if sums else None
    rate = 1.0 / tau0 if tau0 else health.rate_hz
    declared = settings.declared_rate
    if declared and rate and abs(rate / declared - 1.0) > RATE_CHANGE:
        found.append(finding('rate_differs', measured=rate, declared=declared))
    if health.bursty and rate:
        found.append(finding('bursty_stamps', rate=rate))
    changes = counts.cuts['rate change']
    if changes:
        found.append(finding('rate_changed', times=changes, rate=health.rate_hz or 0.0))
    for name, count in (
        ('not_finite', counts.not_finite),
        ('duplicates', counts.duplicate),
        ('backward_stamps', counts.backward),
        ('clock_jumps', counts.cuts['clock jump']),
        ('stuck', counts.stuck),
        ('saturated', counts.saturated),
    ):
        if count:
            found.append(finding(name, count=count))
    if counts.cuts['gap']:
        found.append(finding('gaps', lost=counts.lost, cuts=counts.cuts['gap']))
    if counts.bridged > TOLD_BRIDGED_SHARE * counts.received:
        share = counts.bridged / counts.received
        found.append(finding('bridged', bridged=counts.bridged, share=share))
    if counts.spikes >= max(LEAST_SPIKES, LEAST_SPIKE_SHARE * counts.used):
        found.append(finding('spikes', count=counts.spikes, share=counts.spikes / counts.used))
    if health.discarded:
        found.append(finding('relearned'))
    if counts.louder and health.rate_hz and health.loudest:
        ratio = max(health.loudest.values())
        axes = tuple(axis for axis, r in health.loudest.items() if r > LOUDER_SHARE * ratio)
        seconds = counts.louder / health.rate_hz
        found.append(finding('noise_louder', axes, ratio=ratio, seconds=seconds))
    if counts.moving and not counts.used and health.rate_hz:
        found.append(finding('never_still', seconds=counts.moving / health.rate_hz))
    elif counts.moving:
        judged = counts.moving + counts.louder + counts.used
        found.append(finding('motion', share=counts.moving / judged))
    for each in sums:
        found += _signal_findings(each)
    if counts.received and not sums:
        found.append(finding('nothing_left', received=counts.received))
    return found


def sums_findings(sums: AllanSums) -> list[Finding]:
    """Return the findings on the sums of all recordings."""
    seconds = sums.elapsed_ns * 1e-9
    return [finding('short', seconds=seconds)] if seconds < SHORT_S else []


def _signal_findings(sums: AllanSums) -> list[Finding]:
    found: list[Finding] = []
    if len(sums.count):
        flat = tuple(np.array(sums.axes)[sums.sum_sq[0] == 0.0].tolist())
        if flat:
            found.append(finding('no_noise', flat))
    return found + _unit_findings(sums)


def _unit_findings(sums: AllanSums) -> list[Finding]:
    """Return a finding for each sensor whose values at rest are impossible in SI units."""
    if not sums.tau0 or not sums.history.recordings:
        return []
    mean = _mean_at_rest(sums)
    short = sums.m * sums.tau0 <= 1.0
    found: list[Finding] = []
    for sensor, place in SENSORS.items():
        own = [i for i, axis in enumerate(sums.axes) if sensor_of(axis) == sensor]
        axes = tuple(sums.axes[i] for i in own)
        if sensor == 'gyro' and own:
            rate = float(np.abs(mean[own]).max())
            tau = sums.m[short, None] * sums.tau0
            level = np.sqrt(sums.avar[short][:, own] * tau)
            n = float(np.median(level.min(axis=0))) if len(tau) else 0.0
            if n > LARGEST_N or rate > LARGEST_REST_RATE:
                found.append(finding('gyro_unit', axes, n=n, rate=rate))
        elif len(own) == place.stop - place.start:
            norm = float(np.linalg.norm(mean[own]))
            unit = gravity_unit(norm)
            if unit is None:
                found.append(finding('accel_scale', axes, norm=norm))
            elif unit != 'm/s^2':
                found.append(finding('accel_unit', axes, norm=norm, unit=unit))
    return found


def gravity_unit(norm: float) -> str | None:
    """Return the unit in which a mean acceleration is that of gravity.

    Returns
    -------
    str or None
        'm/s^2' also where gravity was removed; None for no usual unit.
    """
    for unit, gravity in (('m/s^2', STANDARD_GRAVITY), ('g', 1.0), ('mg', 1000.0)):
        if abs(norm / gravity - 1.0) < G_BAND:
            return unit
    return 'm/s^2' if norm < WEIGHTLESS else None


def _mean_at_rest(sums: AllanSums) -> NDArray[np.float64]:
    """Return the mean of each axis over the samples that count, (axes,)."""
    total = np.zeros(len(sums.axes))
    number = 0
    for recording in sums.history.recordings:
        total += recording.cell_samples @ recording.cell_means
        total += recording.cell_samples.sum() * recording.reference
        number += int(recording.cell_samples.sum())
    return np.asarray(total / max(number, 1))
