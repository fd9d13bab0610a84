# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""imu_filter_madgwick: ``gain`` (rad/s) and ``zeta`` (rad/s^2) at a named horizon.

src/imu_filter.cpp takes a step of ``gain`` towards gravity (and north), and with a magnetometer
moves the gyro bias by ``zeta``; src/imu_filter_ros.cpp gives the ranges.
"""

from __future__ import annotations

from collections.abc import Iterator

from ...core.filters.noise_parameters import madgwick_drift_gain, madgwick_gain, madgwick_ramp_gain
from ...core.imu import AXES, SENSORS
from .model import FilterNoise, clamped, level_words, rounded
from .target import Entry, Target
from .yaml_form import YamlForm

PARENT = ('imu_filter', 'ros__parameters')

GAIN_RANGE = (0.0, 1.0)
ZETA_RANGE = (-1.0, 1.0)


def _entries(model: FilterNoise) -> Iterator[Entry]:
    yield clamped(_gain(model), *GAIN_RANGE)
    yield clamped(_zeta(model), *ZETA_RANGE)


def _gain(model: FilterNoise) -> Entry:
    horizon = model.options.horizon
    n, b = model.level('gyro', 'N'), model.level('gyro', 'B')
    levels = (*n.levels, *b.levels)
    formula = f'sqrt(3/4) sqrt(N^2/h + 0.441 B^2) with h = {horizon:g} s'
    return Entry(
        (*PARENT, 'gain'),
        rounded(madgwick_gain(n.values[0], b.values[0], horizon)),
        f'[rad/s] = {formula}: {"; ".join(level_words(level) for level in levels)}',
        any(level.is_limit for level in levels),
    )


def _zeta(model: FilterNoise) -> Entry:
    """Return zeta from the ramp where every axis shows one, else from the random walk."""
    horizon, path = model.options.horizon, (*PARENT, 'zeta')
    gyro = [model.results.axes[axis].fit.noise['R'] for axis in AXES[SENSORS['gyro']]]
    if all(ramp.status == 'estimated' for ramp in gyro):
        return model.number(path, 'gyro', 'R', 'sqrt(3/4) |R|', 'rad/s^2', madgwick_ramp_gain)
    formula = f'sqrt(3/4) K / sqrt(h) with h = {horizon:g} s'
    return model.number(
        path, 'gyro', 'K', formula, 'rad/s^2', lambda k: madgwick_drift_gain(k, horizon)
    )


TARGET = Target(
    'imu_filter_madgwick.yaml',
    "Madgwick's beta (rad/s) and zeta (rad/s^2): sqrt(3/4) times the error and the drift of the "
    'gyro (imu_filter_madgwick/src/imu_filter.cpp)',
    _entries,
    YamlForm(),
    notes=(
        'the gain allows for noise only: a bias at switching on that is not taken off comes on '
        'top, and the default of 0.1 allows for one',
        'zeta acts with a magnetometer (use_mag) only; without one the filter estimates no bias',
    ),
)
