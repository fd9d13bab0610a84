# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measure the noise in motion from drives: the motions between two rests in recordings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from ..core.filters.drive_likelihood import NoiseAtRest
from ..core.filters.motion_factors import (
    NoiseInMotion,
    axis_noise,
    noise_in_motion,
)
from ..core.findings import Finding, finding
from ..core.imu import AXES
from ..core.stream.drive_recorder import LEAST_DRIVES, Drives
from .axis_result import AxisResult
from .results import MOTION_MEASURED

if TYPE_CHECKING:
    from .results import Results

LEAST_REST_S = 60.0
"""Shortest duration of the data at rest, in s, for which the noise in motion is computed. From
shorter data, the noise at rest is not known well enough for a comparison."""

MOVING = 0.1
"""Smallest share of samples in motion in a recording of drives. With a smaller share, no finding
states that the noise in motion could not be measured."""

EXPLAINED = 0.7
"""Calibration errors are named as the cause of errors in motion if a model that contains them
reduces the ratio of measured to predicted errors below this fraction."""

INTEGRAL_NAMES = {'gyro': 'angle', 'accel': 'velocity'}
"""Sensor -> name of the integral of its samples."""

CAUSE_NAMES = {
    'rotation': 'a rotation between gyro and accelerometer',
    'gyro_matrix': 'scale factors or misalignments of the gyro',
    'accel_matrix': 'scale factors or misalignments of the accelerometer',
    'g_sensitivity': 'a sensitivity of the gyro to acceleration',
}


def with_motion(results: Results, drives: Drives) -> Results:
    """Return the results with the noise in motion that follows from the latest drives of a robot.

    If the drives or the data at rest do not suffice, the noise in motion is None, and no finding
    states this.
    """
    motion, motion_findings = measure_motion(
        drives, results.axes, results.duration_s, 0.0, hidden=is_hidden(results.findings)
    )
    other_findings = (f for f in results.findings if f.id not in MOTION_MEASURED)
    return replace(results, motion=motion, findings=(*other_findings, *motion_findings))


def is_hidden(findings: Iterable[Finding]) -> bool:
    """Return whether a finding states that motion or vibration hides the noise of the sensor."""
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
        The drives: the motions between two rests.
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
        None if there are too few drives, or if the noise at rest is not known well enough.
    findings : tuple of Finding
        Empty if there are no drives. Also empty if ``motion`` is None and less than a tenth of the
        samples were taken in motion, as in a recording at rest with a few disturbances.
    """
    unresolved_axes = [a for a in AXES if a not in noise or not noise[a].fit.noise['N'].resolved]
    is_known = not (unresolved_axes or hidden)
    if is_known and rest_s >= LEAST_REST_S and len(drives.errors) >= LEAST_DRIVES:
        motion = noise_in_motion(drives.errors, noise_at_rest(noise))
        assert motion is not None
        return motion, tuple(_factor_findings(motion))
    drive_count = len(drives.errors) + sum(drives.unused.values())
    if not drive_count or moving < MOVING:
        return None, ()
    if len(drives.errors) >= LEAST_DRIVES and not is_known:
        return None, (
            finding('motion_without_noise', tuple(unresolved_axes), drives=len(drives.errors)),
        )
    reasons = ', '.join(f'{number} {REASONS[reason]}' for reason, number in drives.unused.items())
    return None, (
        finding(
            'motion_not_measured',
            drives=len(drives.errors),
            seen=drive_count,
            unused=reasons or None,
            at_rest=rest_s,
            needed=LEAST_DRIVES,
            rest=LEAST_REST_S,
        ),
    )


def noise_at_rest(axes: Mapping[str, AxisResult]) -> list[NoiseAtRest]:
    """Return the noise of the six axes at rest, in the order of `AXES`.

    If B or K of an axis is not resolved, the estimate can exceed the true value by far. Instead of
    the estimate, the upper limit of the term, if it is known, is used as `axis_noise` describes.
    """
    noise_of_axes = []
    for name in AXES:
        fit, tau0 = axes[name].fit, axes[name].tau0
        unresolved_terms = {t: fit.noise[t] for t in 'BK' if not fit.noise[t].resolved}
        model = fit.model.changed(**dict.fromkeys(unresolved_terms, 0.0))
        limits = {t: e.upper95 for t, e in unresolved_terms.items() if e.upper95}
        noise_of_axes.append(axis_noise(model, tau0, limits))
    return noise_of_axes


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


def _factor_findings(motion: NoiseInMotion) -> Iterator[Finding]:
    for sensor, measured in motion.sensors.items():
        factor, explained = measured.factor, measured.explained
        ratio = factor.value or 1.0
        low, high = factor.ci95 or (0.0, math.inf)
        axes = tuple(axis for axis in AXES if axis.startswith(sensor))
        values = {
            'error': INTEGRAL_NAMES[sensor],
            'ratio': ratio,
            'low': low,
            'high': high,
            'drives': len(motion.drives),
        }
        if not motion.is_worse(sensor):
            yield finding('motion_as_at_rest', axes, **values)
            continue
        has_cause = explained is not None and (explained.value or 0.0) < EXPLAINED * ratio
        yield finding(
            'error_in_motion',
            axes,
            **values,
            cause=causes_text(motion) if has_cause else None,
            left=explained.value if explained is not None and has_cause else None,
            white=measured.white.value if measured.white else None,
            slow=measured.slow.value if measured.slow else None,
        )
