# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Coefficients with their intervals as text and as numbers, in the unit of an output."""

from __future__ import annotations

import math

from .fit.model import Coefficient
from .imu import ShownUnit
from .number_text import LIMIT_DIGITS, VALUE_DIGITS, significant

NOTHING_KNOWN = '-'
"""Text for a term with neither a value nor a limit."""


def value_text(coefficient: Coefficient, unit: ShownUnit) -> str:
    """Return a coefficient as text: its value, ``< limit`` if it has only a limit, or '-'."""
    if coefficient.status == 'estimated' and coefficient.value is not None:
        sign = '-' if coefficient.sign < 0 else ''
        return sign + significant(coefficient.value * unit.factor, VALUE_DIGITS)
    if coefficient.upper95 is not None and math.isfinite(coefficient.upper95):
        return f'< {significant(coefficient.upper95 * unit.factor, LIMIT_DIGITS)}'
    return NOTHING_KNOWN


def interval_text(coefficient: Coefficient, unit: ShownUnit) -> str:
    """Return the 95 % interval of an estimated coefficient as ``low..high``, else ''.

    It has the sign of the coefficient.
    """
    if coefficient.status != 'estimated' or coefficient.ci95 is None:
        return ''
    low, high = _signed_interval(coefficient)
    narrow = high - low < 0.02 * max(abs(low), abs(high))
    digits = VALUE_DIGITS if narrow else LIMIT_DIGITS
    return '..'.join(significant(limit * unit.factor, digits) for limit in (low, high))


def _signed_interval(coefficient: Coefficient) -> tuple[float, float]:
    """Return the interval of the signed value, from the interval of its magnitude."""
    low, high = coefficient.ci95 or (math.nan, math.nan)
    return (-high, -low) if coefficient.sign < 0 else (low, high)


def known_numbers(c: Coefficient, unit: ShownUnit) -> tuple[float | None, ...]:
    """Return the signed value, the two ends of its interval, and the upper limit.

    All are in ``unit`` with six digits, and None if unknown. A coefficient that is not resolved has
    only a limit, and one that is resolved has no limit.
    """
    resolved = c.status == 'estimated'
    low, high = _signed_interval(c) if resolved and c.ci95 is not None else (None, None)
    sign = -1.0 if c.sign < 0 else 1.0
    value = c.value * sign if resolved and c.value is not None else None
    numbers = (value, low, high, None if resolved else c.upper95)
    return tuple(None if n is None else float(f'{n * unit.factor:.6g}') for n in numbers)
