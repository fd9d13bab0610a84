# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Makes the `/diagnostics` status of the errors of an IMU in motion."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticStatus

from ..core.estimate import significant
from ..core.findings import finding
from ..core.imu import AXES, sensor_of
from ..core.stream.drive_recorder import LEAST_DRIVES, Drives
from ..results.motion import INTEGRAL_NAMES, LEAST_REST_S, causes_text
from ..results.results import Results
from .diagnostics import status_of

ENDS = ('', ' low', ' high')
"""Suffixes of the keys for a value, and for the lower and upper end of its 95 % interval."""


def motion_status(
    name: str, hardware_id: str, drives: Drives, results: Results | None, limit: float
) -> DiagnosticStatus:
    """Return the status of the errors in motion of one IMU.

    ``drives`` are the latest drives. ``results`` contain the factors in motion, and are None before
    the first noise model. A factor in motion is the error in motion divided by its prediction from
    the noise at rest. If the 95 % interval of a factor lies above ``limit``, there is a warning.
    """
    unused = sum(drives.unused.values())
    pairs: list[tuple[str, object]] = [('drives', len(drives.errors)), ('drives not used', unused)]
    motion = results.motion if results is not None else None
    if motion is None:
        rest_s = results.duration_s if results is not None else 0.0
        text = (
            f'not measured yet: {len(drives.errors)} of at least {LEAST_DRIVES} drives between '
            f'rests, {rest_s:.0f} of at least {LEAST_REST_S:g} s at rest'
        )
        if len(drives.errors) >= LEAST_DRIVES and rest_s >= LEAST_REST_S:
            text = 'not measured: the rests do not show the noise of the sensor'
        return status_of(name, [], text, pairs, hardware_id=hardware_id)
    findings, error_texts = [], []
    for sensor, sensor_motion in motion.sensors.items():
        low, high = sensor_motion.factor.ci95 or (0.0, math.inf)
        ratio, error = sensor_motion.factor.value or 1.0, INTEGRAL_NAMES[sensor]
        ratio_and_ends = [significant(value, 2) for value in (ratio, low, high)]
        error_texts.append('{} error {} ({} to {})'.format(error, *ratio_and_ends))
        factor_key = f'factor of the {error} error'
        pairs += [(f'{factor_key}{end}', text) for end, text in zip(ENDS, ratio_and_ends)]
        for term, factor in sensor_motion.raised.items():
            pairs.append((f'factor of {term} of the {sensor}', significant(factor.value or 1.0, 2)))
        if low > limit:
            axes = tuple(axis for axis in AXES if sensor_of(axis) == sensor)
            findings.append(
                finding(
                    'worse_in_motion',
                    axes,
                    error=error,
                    ratio=ratio,
                    low=low,
                    high=high,
                    drives=len(motion.drives),
                    limit=limit,
                )
            )
    pairs.append(('cause', causes_text(motion) or None))
    text = (
        f'in motion: {", ".join(error_texts)} times the noise at rest, {len(motion.drives)} drives'
    )
    return status_of(name, findings, text, pairs, hardware_id=hardware_id)
