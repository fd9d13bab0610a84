# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measure the noise in motion from the drives of the recordings of an analysis."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from ..core.filters.drive_likelihood import NoiseAtRest
from ..core.filters.motion_factors import (
    LEAST_DRIVES,
    NoiseInMotion,
    axis_noise,
    noise_in_motion,
)
from ..core.findings import Finding, finding
from ..core.imu import AXES
from ..core.stream.drive_recorder import Drives
from .axis_result import AxisResult

if TYPE_CHECKING:
    from .results import Results

LEAST_REST_S = 60.0
"""Shortest time at rest in s from which the noise at rest is known well enough for a comparison."""

MOVING = 0.1
"""Share of the samples in motion from which a recording is taken as a recording of drives. With a
smaller share, no finding says that the noise in motion could not be measured."""

EXPLAINED = 0.7
"""A cause is stated for a sensor if its factor with the cause is below this share of its factor
without the cause."""

INTEGRAL_NAMES = {'gyro': 'angle', 'accel': 'velocity'}
"""Sensor -> name of the integral of its samples."""

MEASURED = ('error_in_motion', 'motion_as_at_rest')
"""Ids of the findings that state a factor of the noise in motion to the noise at rest."""

CAUSE_NAMES = {
    'rotation': 'a rotation between gyro and accelerometer',
    'gyro_matrix': 'scale factors or misalignments of the gyro',
    'accel_matrix': 'scale factors or misalignments of the accelerometer',
    'g_sensitivity': 'a sensitivity of the gyro to acceleration',
}


def with_motion(results: Results, drives: Drives) -> Results:
    """Return the results of a robot in use, with the noise in motion of its latest drives.

    If there are too few drives or too little data at rest, ``results.motion`` is None, without a
    finding.
    """
    motion, found = measure_motion(
        drives, results.axes, results.duration_s, 0.0, hidden=is_hidden(results.findings)
    )
    others = (f for f in results.findings if f.id not in MEASURED)
    return replace(results, motion=motion, findings=(*others, *found))


def is_hidden(findings: Iterable[Finding]) -> bool:
    """Return whether motion or vibration hides the noise of the sensor at rest."""
    return any(f.id == 'not_noise' for f in findings)


def measure_motion(
    drives: Drives,
    noise: Mapping[str, AxisResult],
    rest_s: float,
    moving: float,
    *,
    hidden: bool = False,
) -> tuple[NoiseInMotion | None, tuple[Finding, ...]]:
    """Return the noise in motion and the findings about it.

    Parameters
    ----------
    drives : Drives
        Drives between rests.
    noise : mapping of axis name to AxisResult
        Noise at rest, from the same recordings or from other recordings of the same IMU.
    rest_s : float
        Duration of the data from which ``noise`` was measured, in s.
    moving : float
        Share of the samples that were taken in motion.
    hidden : bool
        Whether motion or vibration hides the noise at rest.

    Returns
    -------
    motion : NoiseInMotion or None
        None if there are too few drives, or if the noise at rest is not known.
    findings : tuple of Finding
        Empty without drives, and for a recording at rest that was disturbed only a few times.
    """
    unresolved = [a for a in AXES if a not in noise or not noise[a].fit.noise['N'].resolved]
    is_known = not (unresolved or hidden)
    if is_known and rest_s >= LEAST_REST_S and len(drives.errors) >= LEAST_DRIVES:
        motion = noise_in_motion(drives.errors, noise_at_rest(noise))
        assert motion is not None
        return motion, tuple(_factors(motion))
    seen = len(drives.errors) + sum(drives.unused.values())
    if not seen or moving < MOVING:
        return None, ()
    if len(drives.errors) >= LEAST_DRIVES and not is_known:
        return None, (
            finding('motion_without_noise', tuple(unresolved), drives=len(drives.errors)),
        )
    reasons = ', '.join(f'{number} {REASONS[why]}' for why, number in drives.unused.items())
    return None, (
        finding(
            'motion_not_measured',
            drives=len(drives.errors),
            seen=seen,
            unused=reasons or None,
            at_rest=rest_s,
            needed=LEAST_DRIVES,
            rest=LEAST_REST_S,
        ),
    )


def noise_at_rest(axes: Mapping[str, AxisResult]) -> list[NoiseAtRest]:
    """Return the noise of the six axes at rest, in the order of `AXES`.

    The model of an axis is without B and K that are not resolved, because their estimates can
    exceed the truth by far. Their upper limits are given instead.
    """
    found = []
    for name in AXES:
        fit, tau0 = axes[name].fit, axes[name].tau0
        unresolved = {letter: one for letter, one in fit.noise.items() if not one.resolved}
        model = fit.model.changed(**{letter: 0.0 for letter in 'BK' if letter in unresolved})
        limits = {letter: one.upper95 for letter, one in unresolved.items() if one.upper95}
        found.append(axis_noise(model, tau0, limits))
    return found


REASONS = {
    'short': 'shorter than 2 s',
    'long': 'longer than 3 min',
    'gap': 'with missing samples',
    'short_rest': 'next to a rest of less than 1 s',
}
"""Reason why a drive is not used -> its text."""


def causes_text(motion: NoiseInMotion) -> str:
    """Return the names of the causes of the errors in motion; '' if no cause was found."""
    return ' and '.join(CAUSE_NAMES[cause.name] for cause in motion.causes)


def _factors(motion: NoiseInMotion) -> Iterator[Finding]:
    for sensor, one in motion.sensors.items():
        factor, left, value = one.factor, one.explained, one.factor.value or 1.0
        low, high = factor.ci95 or (0.0, math.inf)
        axes = tuple(axis for axis in AXES if axis.startswith(sensor))
        numbers = {
            'error': INTEGRAL_NAMES[sensor],
            'ratio': value,
            'low': low,
            'high': high,
            'drives': len(motion.drives),
        }
        if not one.is_worse:
            yield finding('motion_as_at_rest', axes, **numbers)
            continue
        is_explained = left is not None and (left.value or 0.0) < EXPLAINED * value
        yield finding(
            'error_in_motion',
            axes,
            **numbers,
            cause=causes_text(motion) if is_explained else None,
            left=left.value if left is not None and is_explained else None,
            white=one.white.value if one.white else None,
            slow=one.slow.value if one.slow else None,
        )
