# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""LIO-SAM: continuous densities; src/imuPreintegration.cpp squares them for GTSAM.

The walks become the noise of the factor between two biases, times the root of the time between.
"""

from __future__ import annotations

from collections.abc import Iterator

from ...core.imu import SI_UNITS
from .model import FilterNoise
from .target import Entry, Target
from .yaml_form import YamlForm

PARENT = ('/**', 'ros__parameters')

KEYS = {
    'imuAccNoise': ('accel', 'N'),
    'imuGyrNoise': ('gyro', 'N'),
    'imuAccBiasN': ('accel', 'K'),
    'imuGyrBiasN': ('gyro', 'K'),
}
"""Key -> the sensor and term it is."""


def _entries(model: FilterNoise) -> Iterator[Entry]:
    for key, (sensor, term) in KEYS.items():
        yield model.number((*PARENT, key), sensor, term, '', SI_UNITS[sensor][term])


TARGET = Target(
    'lio_sam_imu.yaml',
    'continuous time, as GTSAM has it (src/imuPreintegration.cpp)',
    _entries,
    YamlForm(),
)
