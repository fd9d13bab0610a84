# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a user may set of a file for a filter: the one home of these defaults."""

from __future__ import annotations

from dataclasses import dataclass

from ...core.settings import check, parameter

AXIS_RULE = 'worst'
"""The rule where the file takes one number a sensor and none is given: Kalibr users expect it."""


@dataclass(frozen=True)
class ExportOptions:
    """What a user may set of a file for a filter."""

    axis: str = parameter(
        '',
        'Which axis speaks for a sensor: the worst of three, their root mean square, or each for '
        'itself where the file takes three numbers. Default: each where it does, else worst.',
        choices=('', 'worst', 'mean', 'each'),
    )
    inflate: float = parameter(
        1.0,
        'Factor on every noise level; 5 to 20 is customary where vibration and model errors come '
        'on top of the noise at rest.',
        low=1.0,
        high=1000.0,
    )
    filter_rate: float = parameter(
        0.0,
        'Rate at which the filter takes samples; 0: that of the recording, or of the filter where '
        'it has its own.',
        unit='Hz',
        low=0.0,
        high=1e6,
    )
    strict: bool = parameter(
        False, 'Refuse to write a level that is not observable, instead of its 95 % upper limit.'
    )
    exact: bool = parameter(
        False,
        'vins_fusion only: write what its midpoint rule needs, N sqrt(2f), instead of the '
        'customary N sqrt(f).',
    )
    horizon: float = parameter(
        10.0,
        'imu_filter_madgwick only: time over which the accelerometer corrects the gyro.',
        unit='s',
        low=1e-3,
        high=1e6,
    )
    topic: str = parameter('', 'The Imu topic to name in the file; empty: that of the recording.')
    date: str = parameter(
        '', 'The date to name in the file; empty: when the first sample was recorded.'
    )

    def __post_init__(self) -> None:
        check(self)
