# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""FAST-LIO and FAST-LIO2: variances of one sample.

src/IMU_Processing.hpp puts them on the diagonal of Q and the filter adds (dt F) Q (dt F)'
(IKFoM_toolkit/esekfom/esekfom.hpp): N^2 dt needs a variance of N^2 f, K^2 dt one of K^2 f.
"""

from __future__ import annotations

from collections.abc import Iterator

from ...core.filters.noise_parameters import walk_rate_std, white_std
from ...core.imu import SI_UNITS
from .model import FilterNoise
from .target import Entry, Target
from .yaml_form import YamlForm

PARENT = ('/**', 'ros__parameters', 'mapping')


def _entries(model: FilterNoise) -> Iterator[Entry]:
    for key, sensor in (('acc_cov', 'accel'), ('gyr_cov', 'gyro')):
        yield model.number(
            (*PARENT, key),
            sensor,
            'N',
            'N^2 f',
            f'({SI_UNITS[sensor]["B"]})^2',
            lambda n: white_std(n, model.rate) ** 2,
        )
    for key, sensor in (('b_acc_cov', 'accel'), ('b_gyr_cov', 'gyro')):
        yield model.number(
            (*PARENT, key),
            sensor,
            'K',
            'K^2 f',
            f'({SI_UNITS[sensor]["R"]})^2',
            lambda k: walk_rate_std(k, model.rate) ** 2,
        )


TARGET = Target(
    'fast_lio_imu.yaml',
    'variance per sample (src/IMU_Processing.hpp, IKFoM_toolkit/esekfom/esekfom.hpp)',
    _entries,
    YamlForm(),
    notes=(
        'what FAST-LIO ships (0.1 and 0.0001) is tuning, far above any noise at rest; go there in '
        'steps with --inflate',
    ),
)
