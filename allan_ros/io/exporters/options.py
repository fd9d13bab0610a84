# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Options of a file for a filter, with their defaults."""

from __future__ import annotations

from dataclasses import dataclass

from ...core.settings import check, parameter

AXIS_RULE = 'worst'
"""Default axis rule of files with one number per sensor, as Kalibr users expect it."""

FIDELITIES = ('reduction', 'coefficients')


@dataclass(frozen=True)
class ExportOptions:
    """Options of a file for a filter."""

    axis: str = parameter(
        '',
        'Value of a sensor: the worst of three axes, their root mean square, or each axis where '
        'the file takes three numbers. Default: each where possible, else worst.',
        choices=('', 'worst', 'mean', 'each'),
    )
    inflate: float = parameter(
        1.0,
        'Factor on every noise level, for vibration and model errors that add to the noise at '
        'rest; measure it with `allan inflate`.',
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
        False,
        'Refuse to write 95 % upper limits, and reductions that misstate the error growth by more '
        'than a factor of 2.',
    )
    exact: bool = parameter(
        False,
        'vins_fusion only: write what its midpoint rule needs, N sqrt(2f), instead of the '
        'customary N sqrt(f).',
    )
    fidelity: str = parameter(
        'reduction',
        'N and K of the file: a reduction, with K raised so that the predicted error growth covers '
        'the complete model, or the bare coefficients.',
        choices=FIDELITIES,
    )
    horizon: float = parameter(
        0.0,
        'Longest time that the filter integrates without correction, over which the reduction '
        'holds; 0: the default of the target (30 s for cameras and lidars, 100 s for GNSS).',
        unit='s',
        low=0.0,
        high=1e6,
    )
    topic: str = parameter(
        '', 'The Imu topic to name in the file; empty: the topic of the recording.'
    )
    date: str = parameter(
        '', 'The date to name in the file; empty: the time of the first recorded sample.'
    )

    def __post_init__(self) -> None:
        check(self)
