# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Basalt's calibration JSON: continuous densities of each axis.

It makes them discrete itself, times sqrt(imu_update_rate)
(basalt/calibration/calibration.hpp, dicrete_time_gyro_noise_std).
"""

from __future__ import annotations

from collections.abc import Iterator

from ...core.imu import SI_UNITS
from .json_form import JsonForm
from .model import FilterNoise
from .target import Entry, Target

PARENT = ('value0',)
"""What cereal calls the one object of the file."""

KEYS = {
    'accel_noise_std': ('accel', 'N'),
    'gyro_noise_std': ('gyro', 'N'),
    'accel_bias_std': ('accel', 'K'),
    'gyro_bias_std': ('gyro', 'K'),
}
"""Key -> the sensor and term it is."""


def _entries(model: FilterNoise) -> Iterator[Entry]:
    yield Entry((*PARENT, 'imu_update_rate'), model.rate)
    for key, (sensor, term) in KEYS.items():
        yield model.three((*PARENT, key), sensor, term, '', SI_UNITS[sensor][term])


TARGET = Target(
    'basalt_imu.json',
    'continuous time; Basalt multiplies by sqrt(imu_update_rate) itself '
    '(basalt/calibration/calibration.hpp)',
    _entries,
    JsonForm(),
    three=True,
    notes=('merge it into your calibration: the cameras stand in the same file',),
)
