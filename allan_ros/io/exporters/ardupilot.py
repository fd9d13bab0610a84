# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ArduPilot EK3 as a parameter file of Mission Planner and MAVProxy.

libraries/AP_NavEKF3/AP_NavEKF3_core.cpp, CovariancePrediction, uses them; the ranges are those of
libraries/AP_NavEKF3/AP_NavEKF3.cpp.
"""

from __future__ import annotations

from collections.abc import Iterator

from .autopilot import FLOOR_NOTE, Parameter, step_entries
from .line_form import LineForm
from .model import FilterNoise
from .target import Entry, Target

EKF_RATE_HZ = 1.0 / 0.012
"""EKF_TARGET_DT is 12 ms (libraries/AP_NavEKF3/AP_NavEKF3_core.h)."""

PARAMETERS = {
    'EK3_GYRO_P_NSE': Parameter('gyro', 'N', 1e-4, 0.1),
    'EK3_ACC_P_NSE': Parameter('accel', 'N', 0.01, 1.0),
    'EK3_GBIAS_P_NSE': Parameter('gyro', 'K', 1e-5, 1e-3),
    'EK3_ABIAS_P_NSE': Parameter('accel', 'K', 1e-5, 0.02),
}


def _entries(model: FilterNoise) -> Iterator[Entry]:
    return step_entries(model, PARAMETERS)


TARGET = Target(
    'ardupilot_imu.parm',
    'standard deviation per EK3 step (libraries/AP_NavEKF3/AP_NavEKF3_core.cpp)',
    _entries,
    LineForm('{key},{value}'),
    rate_hz=EKF_RATE_HZ,
    notes=(FLOOR_NOTE,),
)
