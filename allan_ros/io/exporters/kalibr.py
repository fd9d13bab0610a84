# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kalibr's ``imu.yaml``: continuous-time noise densities N and random walks K.

Kalibr makes them discrete itself, dividing by sqrt(1/update_rate), and refuses a value <= 0
(kalibr_common/ConfigReader.py, ImuParameters).
"""

from __future__ import annotations

import yaml

from ..results import Results
from .levels import ExportOptions, header, sensor_level

FILE_NAME = 'imu.yaml'

KEYS = {
    'accelerometer_noise_density': ('accel', 'N'),
    'accelerometer_random_walk': ('accel', 'K'),
    'gyroscope_noise_density': ('gyro', 'N'),
    'gyroscope_random_walk': ('gyro', 'K'),
}
"""Key -> the sensor and term it is."""

DEFAULT_TOPIC = '/imu0'
"""What Kalibr's own examples call it."""


def render(results: Results, options: ExportOptions) -> str:
    """Return the text of the file.

    Raises
    ------
    AllanError
        When gyro or accel is absent, or a level has neither value nor limit.
    """
    levels = {key: sensor_level(results, *which, options) for key, which in KEYS.items()}
    lines = header(
        results,
        'IMU noise for Kalibr',
        'continuous time (Kalibr makes it discrete by update_rate)',
        options,
    )
    lines += [f'{key}: {level.comment}' for key, level in levels.items()]
    topics = [source.topic for source in results.provenance.sources if source.topic]
    body = {
        **{key: float(f'{level.value:.6g}') for key, level in levels.items()},
        'rostopic': options.topic or next(iter(topics), DEFAULT_TOPIC),
        'update_rate': float(f'{results.rate_hz:.6g}'),
    }
    text: str = yaml.safe_dump(body, sort_keys=False)
    return ''.join(f'# {line}\n' for line in lines) + text
