# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""MSCKF_VIO: continuous densities; src/msckf_vio.cpp squares them and adds Phi G Qc G' Phi' dt."""

from __future__ import annotations

from collections.abc import Iterator

from ...core.imu import SI_UNITS
from .model import FilterNoise
from .target import Entry, Target
from .yaml_form import YamlForm

PARENT = ('noise',)

KEYS = {
    'gyro': ('gyro', 'N'),
    'acc': ('accel', 'N'),
    'gyro_bias': ('gyro', 'K'),
    'acc_bias': ('accel', 'K'),
}
"""Key -> the sensor and term it is."""


def _entries(model: FilterNoise) -> Iterator[Entry]:
    for key, (sensor, term) in KEYS.items():
        yield model.number((*PARENT, key), sensor, term, '', SI_UNITS[sensor][term])


TARGET = Target(
    'msckf_vio_imu.yaml',
    'continuous time (src/msckf_vio.cpp, processModel)',
    _entries,
    YamlForm(),
    notes=('load it in the node: <rosparam command="load" file="..."/>, below its other noise',),
)
