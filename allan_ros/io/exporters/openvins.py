# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""OpenVINS' ``kalibr_imu_chain.yaml``: Kalibr's keys below ``imu0``, read by cv::FileStorage.

The densities are continuous: the state propagation makes them discrete with its own time steps
(ov_msckf/src/state/Propagator.cpp; config/euroc_mav/kalibr_imu_chain.yaml names the keys).
"""

from __future__ import annotations

from collections.abc import Iterator

from .kalibr import imu_entries
from .model import FilterNoise
from .target import Entry, Target, Value
from .yaml_form import YamlForm

PARENT = ('imu0',)


def _identity(size: int) -> list[list[float]]:
    return [[float(i == j) for j in range(size)] for i in range(size)]


NOT_MEASURED: dict[str, Value] = {
    'T_i_b': _identity(4),
    'time_offset': 0.0,
    'model': 'kalibr',
    'Tw': _identity(3),
    'R_IMUtoGYRO': _identity(3),
    'Ta': _identity(3),
    'R_IMUtoACC': _identity(3),
    'Tg': [[0.0] * 3] * 3,
}
"""What the file must have besides: that of an IMU without scale, axis and time errors."""


def _entries(model: FilterNoise) -> Iterator[Entry]:
    yield from imu_entries(model, PARENT)
    for key, value in NOT_MEASURED.items():
        yield Entry((*PARENT, key), value, keep=True)


TARGET = Target(
    'kalibr_imu_chain.yaml',
    'continuous time; OpenVINS makes them discrete by its time steps '
    '(ov_msckf/src/state/Propagator.cpp)',
    _entries,
    YamlForm(opencv=True),
    notes=(
        'T_i_b, time_offset, model, Tw, Ta, Tg and the rotations are no noise and not measured '
        'here: identity unless your file has them',
    ),
)
