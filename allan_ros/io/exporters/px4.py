# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""PX4 EKF2 as a QGroundControl parameter file.

src/modules/ekf2/EKF/covariance.cpp, predictCovariance, uses them; the ranges are those of the
parameter definitions in src/modules/ekf2.
"""

from __future__ import annotations

from collections.abc import Iterator

from .autopilot import FLOOR_NOTE, Parameter, step_entries
from .line_form import LineForm
from .model import FilterNoise
from .target import Entry, Target

EKF_RATE_HZ = 100.0
"""EKF2_PREDICT_US is 10,000 us."""

PARAMETERS = {
    'EKF2_GYR_NOISE': Parameter('gyro', 'N', 1e-4, 0.1),
    'EKF2_ACC_NOISE': Parameter('accel', 'N', 0.01, 1.0),
    'EKF2_GYR_B_NOISE': Parameter('gyro', 'K', 0.0, 0.01),
    'EKF2_ACC_B_NOISE': Parameter('accel', 'K', 0.0, 0.01),
}


def _entries(model: FilterNoise) -> Iterator[Entry]:
    return step_entries(model, PARAMETERS)


TARGET = Target(
    'px4_imu.params',
    'standard deviation per EKF2 step (src/modules/ekf2/EKF/covariance.cpp)',
    _entries,
    LineForm('1\t1\t{key}\t{value}\t9'),  # vehicle, component (the autopilot), 9: a real number
    rate_hz=EKF_RATE_HZ,
    notes=(FLOOR_NOTE,),
)
