# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Units of the five terms: SI inside, the datasheets' when shown or read.

Needs only the standard library, so that option parsers can name units.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from .errors import AllanError

DEGREE = math.pi / 180.0
HOUR = 3600.0
STANDARD_GRAVITY = 9.80665
"""m/s^2 (BIPM, The International System of Units, 9th ed., 2019)."""
MICRO_G = STANDARD_GRAVITY * 1e-6


class Unit(NamedTuple):
    """The SI unit of the same quantity, and how much of it one is."""

    si: str
    factor: float


SI_UNITS = {
    'gyro': {
        'Q': 'rad',
        'N': 'rad/s/sqrt(Hz)',
        'B': 'rad/s',
        'K': 'rad/s^2/sqrt(Hz)',
        'R': 'rad/s^2',
    },
    'accel': {
        'Q': 'm/s',
        'N': 'm/s^2/sqrt(Hz)',
        'B': 'm/s^2',
        'K': 'm/s^3/sqrt(Hz)',
        'R': 'm/s^3',
    },
}
"""sensor -> term -> SI unit. The deviation itself is in the unit of B."""

DATASHEET_UNITS = {
    'gyro': {'Q': 'urad', 'N': 'deg/sqrt(h)', 'B': 'deg/h', 'K': 'deg/h^1.5', 'R': 'deg/h^2'},
    'accel': {'Q': 'um/s', 'N': 'm/s/sqrt(h)', 'B': 'ug', 'K': 'ug/sqrt(h)', 'R': 'ug/h'},
}
"""sensor -> term -> unit of the datasheets (and of the paper, for gyros)."""

UNITS = {
    'rad': Unit('rad', 1.0),
    'urad': Unit('rad', 1e-6),
    'deg': Unit('rad', DEGREE),
    'rad/s/sqrt(Hz)': Unit('rad/s/sqrt(Hz)', 1.0),
    'rad/sqrt(s)': Unit('rad/s/sqrt(Hz)', 1.0),
    'deg/s/sqrt(Hz)': Unit('rad/s/sqrt(Hz)', DEGREE),
    'mdeg/s/sqrt(Hz)': Unit('rad/s/sqrt(Hz)', 1e-3 * DEGREE),
    'deg/h/sqrt(Hz)': Unit('rad/s/sqrt(Hz)', DEGREE / HOUR),
    'deg/sqrt(h)': Unit('rad/s/sqrt(Hz)', DEGREE / math.sqrt(HOUR)),
    'rad/s': Unit('rad/s', 1.0),
    'deg/s': Unit('rad/s', DEGREE),
    'deg/h': Unit('rad/s', DEGREE / HOUR),
    'rad/s^2/sqrt(Hz)': Unit('rad/s^2/sqrt(Hz)', 1.0),
    'rad/s/sqrt(s)': Unit('rad/s^2/sqrt(Hz)', 1.0),
    'deg/h^1.5': Unit('rad/s^2/sqrt(Hz)', DEGREE / HOUR**1.5),
    'rad/s^2': Unit('rad/s^2', 1.0),
    'deg/h^2': Unit('rad/s^2', DEGREE / HOUR**2),
    'm/s': Unit('m/s', 1.0),
    'um/s': Unit('m/s', 1e-6),
    'm/s^2/sqrt(Hz)': Unit('m/s^2/sqrt(Hz)', 1.0),
    'm/s/sqrt(s)': Unit('m/s^2/sqrt(Hz)', 1.0),
    'm/s/sqrt(h)': Unit('m/s^2/sqrt(Hz)', 1.0 / math.sqrt(HOUR)),
    'mg/sqrt(Hz)': Unit('m/s^2/sqrt(Hz)', 1e3 * MICRO_G),
    'ug/sqrt(Hz)': Unit('m/s^2/sqrt(Hz)', MICRO_G),
    'm/s^2': Unit('m/s^2', 1.0),
    'um/s^2': Unit('m/s^2', 1e-6),
    'g': Unit('m/s^2', STANDARD_GRAVITY),
    'mg': Unit('m/s^2', 1e3 * MICRO_G),
    'ug': Unit('m/s^2', MICRO_G),
    'mGal': Unit('m/s^2', 1e-5),
    'm/s^3/sqrt(Hz)': Unit('m/s^3/sqrt(Hz)', 1.0),
    'm/s^2/sqrt(s)': Unit('m/s^3/sqrt(Hz)', 1.0),
    'ug/sqrt(h)': Unit('m/s^3/sqrt(Hz)', MICRO_G / math.sqrt(HOUR)),
    'm/s^3': Unit('m/s^3', 1.0),
    'ug/h': Unit('m/s^3', MICRO_G / HOUR),
}
"""Every unit we read or show."""


def sensor_of(axis: str) -> str:
    """Return 'gyro' or 'accel' for an axis name such as 'gyro_x'."""
    return axis.split('_', 1)[0]


def to_datasheet(term: str, sensor: str, value: float) -> tuple[float, str]:
    """Return an SI coefficient in the datasheets' unit, and that unit."""
    unit = DATASHEET_UNITS[sensor][term]
    return value / UNITS[unit].factor, unit


def from_datasheet(term: str, sensor: str, value: float) -> float:
    """Return the SI value of a coefficient given in the datasheets' unit."""
    return value * UNITS[DATASHEET_UNITS[sensor][term]].factor


def to_si(value: float, unit: str, si: str) -> float:
    """Return a value in the SI unit ``si``.

    Raises
    ------
    AllanError
        When the unit is unknown, or one of another quantity; it lists those that fit.
    """
    known = UNITS.get(unit)
    if known is None or known.si != si:
        fitting = ', '.join(name for name, u in UNITS.items() if u.si == si)
        raise AllanError(f'unit {unit!r} does not fit here: use one of {fitting}')
    return value * known.factor
