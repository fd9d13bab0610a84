# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ORB-SLAM3: continuous densities, which it scales by sqrt(IMU.Frequency) itself.

src/Tracking.cc multiplies the noises by sqrt(Frequency) and divides the walks by it;
src/Settings.cc reads real numbers, hence ``200.0``.
"""

from __future__ import annotations

from collections.abc import Iterator

from ...core.imu import SI_UNITS
from .model import FilterNoise
from .target import Entry, Target
from .yaml_form import YamlForm

KEYS = {
    'IMU.NoiseGyro': ('gyro', 'N'),
    'IMU.NoiseAcc': ('accel', 'N'),
    'IMU.GyroWalk': ('gyro', 'K'),
    'IMU.AccWalk': ('accel', 'K'),
}
"""Key -> the sensor and term it is."""


def _entries(model: FilterNoise) -> Iterator[Entry]:
    for key, (sensor, term) in KEYS.items():
        yield model.number((key,), sensor, term, '', SI_UNITS[sensor][term])
    yield Entry(('IMU.Frequency',), model.rate)


TARGET = Target(
    'orb_slam3_imu.yaml',
    'continuous time; ORB-SLAM3 scales by sqrt(IMU.Frequency) itself (src/Tracking.cc)',
    _entries,
    YamlForm(opencv=True),
)
