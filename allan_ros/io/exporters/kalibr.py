# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kalibr's ``imu.yaml``: continuous-time densities N and K.

Kalibr makes them discrete itself, dividing by sqrt(1/update_rate), and refuses a value <= 0
(kalibr_common/ConfigReader.py, ImuParameters).
"""

from __future__ import annotations

from collections.abc import Iterator

from ...core.imu import SI_UNITS
from .model import FilterNoise
from .target import Entry, Target
from .yaml_form import YamlForm

KEYS = {
    'accelerometer_noise_density': ('accel', 'N'),
    'accelerometer_random_walk': ('accel', 'K'),
    'gyroscope_noise_density': ('gyro', 'N'),
    'gyroscope_random_walk': ('gyro', 'K'),
}
"""Key -> the sensor and term it is."""

DEFAULT_TOPIC = '/imu0'
"""What Kalibr's own examples call it."""


def imu_entries(model: FilterNoise, parent: tuple[str, ...] = ()) -> Iterator[Entry]:
    """Yield the keys of one IMU as Kalibr names them, below ``parent``."""
    for key, (sensor, term) in KEYS.items():
        unit = SI_UNITS[sensor][term]
        yield model.number((*parent, key), sensor, term, '', unit)
    given = model.options.topic
    topics = [source.topic for source in model.results.provenance.sources if source.topic]
    topic = given or next(iter(topics), DEFAULT_TOPIC)
    yield Entry((*parent, 'rostopic'), topic, keep=not given)
    yield Entry((*parent, 'update_rate'), model.rate)


TARGET = Target(
    'imu.yaml',
    'continuous time; Kalibr divides by sqrt(1/update_rate) itself (kalibr_common/ConfigReader.py)',
    imu_entries,
    YamlForm(),
)
