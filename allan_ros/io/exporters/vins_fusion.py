# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""VINS-Mono and VINS-Fusion: ``acc_n gyr_n acc_w gyr_w``, standard deviations per sample.

The midpoint rule of vins_estimator/src/factor/integration_base.h halves two samples and gives
each a noise of its own: V noise V' adds gyr_n^2 dt^2 / 2 to the variance of the angle, though
white noise adds N^2 dt. The customary gyr_n = N sqrt(f) thus propagates half the variance;
N sqrt(2f) propagates all. The bias block of V is dt, so K^2 dt needs gyr_w = K sqrt(f).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from ...core.filters.noise_parameters import midpoint_white_std, walk_rate_std, white_std
from ...core.findings import finding
from ...core.imu import SI_UNITS
from .model import FilterNoise
from .target import Entry, Target
from .yaml_form import YamlForm

SENSORS = {'acc': 'accel', 'gyr': 'gyro'}
"""Prefix of the keys -> sensor."""


def _entries(model: FilterNoise) -> Iterator[Entry]:
    exact = model.options.exact
    white, formula = (midpoint_white_std, 'N sqrt(2 f)') if exact else (white_std, 'N sqrt(f)')
    said = () if exact else (finding('export_half_of_noise', keys='acc_n and gyr_n'),)
    for prefix, sensor in SENSORS.items():
        entry = model.number(
            (f'{prefix}_n',),
            sensor,
            'N',
            formula,
            SI_UNITS[sensor]['B'],
            partial(white, rate=model.rate),
        )
        yield replace(entry, findings=said)
    for prefix, sensor in SENSORS.items():
        yield model.number(
            (f'{prefix}_w',),
            sensor,
            'K',
            'K sqrt(f)',
            SI_UNITS[sensor]['R'],
            partial(walk_rate_std, rate=model.rate),
        )


TARGET = Target(
    'vins_fusion_imu.yaml',
    'standard deviation per sample (vins_estimator/src/factor/integration_base.h)',
    _entries,
    YamlForm(opencv=True),
    exact=True,
)
