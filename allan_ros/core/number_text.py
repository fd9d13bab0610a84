# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of numbers and durations to text, and choice of the prefix of a unit."""

from __future__ import annotations

import math

from .imu import ShownUnit

VALUE_DIGITS, LIMIT_DIGITS = 4, 3
"""Numbers of significant digits of a value, and of a limit or an end of an interval."""


def significant(value: float, digits: int) -> str:
    """Return a number rounded to ``digits`` significant digits, with trailing zeros.

    Rounded magnitudes below 1e-4, or of 1e6 or more, are in exponential notation. Zero, NaN and
    infinity have no digits: '0', 'nan' and 'inf'.

    >>> significant(0.24199, 4), significant(31.8, 4), significant(12345.6, 3)
    ('0.2420', '31.80', '12300')
    """
    if not math.isfinite(value) or value == 0.0:
        return f'{value:g}'
    exponent = math.floor(math.log10(abs(float(f'{value:.{digits - 1}e}'))))
    if not -4 <= exponent <= 5:
        return f'{value:.{digits - 1}e}'
    decimals = digits - 1 - exponent
    return f'{round(value, decimals):.{max(decimals, 0)}f}'


def duration_text(seconds: float, digits: int = 2) -> str:
    """Return a duration as text in s, min, h or days, with ``digits`` significant digits.

    >>> duration_text(90.0), duration_text(1234.0, digits=3), duration_text(86400.0 * 3.456)
    ('90 s', '20.6 min', '3.5 days')
    """
    for unit, size in (('days', 86400.0), ('h', 3600.0), ('min', 60.0)):
        if seconds >= 2.0 * size:
            return f'{float(f"{seconds / size:.{digits}g}"):g} {unit}'
    return f'{float(f"{seconds:.{digits}g}"):g} s'


def prefixed(unit: ShownUnit, size: float) -> ShownUnit:
    """Return ``unit``, or this unit with a larger prefix if ``size`` would be 1000 or more in it.

    ``size`` is a value in SI. Only the prefixes u and m of units that begin with g, rad or m/ are
    replaced; any other unit is returned unchanged.

    >>> prefixed(ShownUnit('ug', 1e6 / 9.80665), 0.0274).name
    'mg'
    """
    name, factor = unit
    for prefix, larger_prefix in (('u', 'm'), ('m', '')):
        rest = name[1:] if name.startswith(prefix) else ''
        if rest.startswith(('g', 'rad', 'm/')) and size * factor >= 1000.0:
            name, factor = larger_prefix + rest, 1e-3 * factor
    return ShownUnit(name, factor)
