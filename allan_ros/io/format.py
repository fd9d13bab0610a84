# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Format numbers with units and significant digits, and format findings."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

from ..core.findings import SEVERITIES, Finding
from ..core.fit import Coefficient, Deviation
from ..core.fit.interpretation import Region
from ..core.imu import DATASHEET_UNITS, SI_UNITS, UNITS, sensor_of

SENSOR_NAMES = {'gyro': 'Gyroscope', 'accel': 'Accelerometer'}
"""Sensor -> name in a heading."""

SHOWN_UNITS = {
    'datasheet': {
        'gyro': {**DATASHEET_UNITS['gyro'], 'signal': 'deg/s', 'density': 'deg/s/sqrt(Hz)'},
        'accel': {**DATASHEET_UNITS['accel'], 'signal': 'mg', 'density': 'ug/sqrt(Hz)'},
    },
    'si': {
        sensor: {**units, 'signal': units['B'], 'density': units['N']}
        for sensor, units in SI_UNITS.items()
    },
}
"""Units of the output -> sensor -> quantity -> unit. A quantity is a term (Q, N, B, K or R), the
samples ('signal'), or the root of their power spectral density ('density')."""

VALUE_DIGITS, LIMIT_DIGITS = 4, 3
"""Significant digits of a value, and of the ends of its interval."""

PRETTY = (
    ('sqrt(Hz)', '√Hz'),
    ('sqrt(h)', '√h'),
    ('^1.5', '¹·⁵'),
    ('^2', '²'),
    ('^3', '³'),
    ('deg', '°'),
    ('urad', 'µrad'),
    ('um/', 'µm/'),
    ('ug', 'µg'),
)
"""Part of a unit in plain text -> its spelling in reports and plots."""

NOTHING_KNOWN = '-'
"""Text for a term with neither a value nor a limit."""

READ_AT = {'Q': math.sqrt(3.0), 'N': 1.0, 'K': 3.0, 'R': math.sqrt(2.0)}
"""Term -> averaging time in s at which its deviation equals its coefficient (IEEE Std 952)."""

SHARP = 0.02
"""If the width of an interval is below this fraction of its upper end, its ends are printed with as
many digits as a value."""


class ShownUnit(NamedTuple):
    """A unit of the output, and the factor that converts an SI value to it."""

    name: str
    factor: float


def shown_unit(axis: str, quantity: str, units: str) -> ShownUnit:
    """Return the unit in which a quantity of an axis or sensor is printed.

    ``quantity`` is a key of `SHOWN_UNITS`, such as 'N' or 'signal'; the Allan deviation has the
    unit of 'B'. ``units`` is 'datasheet' or 'si'.
    """
    unit = SHOWN_UNITS[units][sensor_of(axis)][quantity]
    return ShownUnit(unit, 1.0 / UNITS[unit].factor)


def pretty_unit(name: str) -> str:
    """Return a unit in typographic spelling.

    >>> pretty_unit('deg/sqrt(h)'), pretty_unit('ug'), pretty_unit('m/s^2/sqrt(Hz)')
    ('°/√h', 'µg', 'm/s²/√Hz')
    """
    for plain, typeset in PRETTY:
        name = name.replace(plain, typeset)
    return name


def significant(value: float, digits: int) -> str:
    """Return a number rounded to ``digits`` significant digits, with trailing zeros.

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


def value_text(coefficient: Coefficient, unit: ShownUnit) -> str:
    """Return a coefficient as text: its value, ``< limit`` if it has only a limit, or '-'."""
    if coefficient.status == 'estimated' and coefficient.value is not None:
        sign = '-' if coefficient.sign < 0 else ''
        return sign + significant(coefficient.value * unit.factor, VALUE_DIGITS)
    if coefficient.upper95 is not None and math.isfinite(coefficient.upper95):
        return f'< {significant(coefficient.upper95 * unit.factor, LIMIT_DIGITS)}'
    return NOTHING_KNOWN


def interval_text(coefficient: Coefficient, unit: ShownUnit) -> str:
    """Return the 95 % interval of an estimated coefficient as ``low..high``, else ''."""
    if coefficient.status != 'estimated' or coefficient.ci95 is None:
        return ''
    low, high = coefficient.ci95
    digits = VALUE_DIGITS if high - low < SHARP * high else LIMIT_DIGITS
    return '..'.join(significant(limit * unit.factor, digits) for limit in (low, high))


NUMBER_DIGITS = 6
"""Significant digits of a number for other programs: more than the accuracy of any interval."""


def known_numbers(c: Coefficient, unit: ShownUnit) -> tuple[float | None, ...]:
    """Return the signed value, the two ends of the interval of its magnitude, and the upper limit.

    All are in ``unit``, and None if unknown. A coefficient that is not resolved has only a limit,
    and one that is resolved has no limit.
    """
    resolved = c.status == 'estimated'
    low, high = c.ci95 if resolved and c.ci95 is not None else (None, None)
    sign = -1.0 if c.sign < 0 else 1.0
    value = c.value * sign if resolved and c.value is not None else None
    numbers = (value, low, high, None if resolved else c.upper95)
    return tuple(
        None if n is None else float(f'{n * unit.factor:.{NUMBER_DIGITS}g}') for n in numbers
    )


def markdown_rows(rows: Iterable[Sequence[str]]) -> str:
    """Return rows of cells as a Markdown table; the first row is its header."""
    lines = [[cell.replace('|', r'\|') for cell in row] for row in rows]
    lines.insert(1, ['---'] * len(lines[0]))
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines) + '\n'


def part_text(part: str, likely: Collection[str]) -> str:
    """Return the name of a part of the model, with '?' after each term in ``likely``.

    ``part`` is a term, a process, or several of them joined by '+'. Likely terms are not resolved,
    but the model contains them.

    >>> part_text('B+GM 110 s', ['B'])
    'B?+GM 110 s'
    """
    return '+'.join(f'{name}?' if name in likely else name for name in part.split('+'))


def region_text(region: Region, likely: Collection[str] = ()) -> str:
    """Return a region as text: its averaging times, the dominant noise and the slope of the curve.

    The terms in ``likely``, which the model contains although they are not resolved, get a '?'.
    """
    low, high = significant(region.tau_low, 2), significant(region.tau_high, 2)
    return f'{low}-{high} s {part_text(region.term, likely)} (slope {region.slope:+.2f})'


def deviation_text(deviation: Deviation | None) -> str:
    """Return a deviation of a curve from its model, such as '+12% at 3.4 s'; '' for None."""
    if deviation is None:
        return ''
    return f'{deviation.relative:+.0%} at {significant(deviation.tau, 2)} s'


def text_in_units(text: str, units: str, typeset: bool = False) -> str:
    """Convert the coefficients in a message to the given units ('datasheet' or 'si').

    Every number that is followed by a unit of a coefficient is converted, as is an interval after
    it. With ``typeset``, the spelling of units is that of `pretty_unit`, such as ``°/√h``.

    >>> text_in_units('N is 0.60 deg/sqrt(h) (0.59..0.61).', 'si')
    'N is 0.0001745 rad/s/sqrt(Hz) (0.0001716..0.0001774).'
    """
    text = _QUANTITY.sub(lambda match: _in_other_units(match, units), text)
    return _UNIT.sub(lambda match: pretty_unit(match[0]), text) if typeset else text


_NUMBER = r'-?\d+(?:\.\d+)?(?:e[-+]?\d+)?'

_OTHER_UNIT = {
    units: {unit: new[sensor][term] for sensor in old for term, unit in old[sensor].items()}
    for units, old, new in (
        ('si', DATASHEET_UNITS, SI_UNITS),
        ('datasheet', SI_UNITS, DATASHEET_UNITS),
    )
}
"""Requested units -> unit of the other system -> requested unit."""

_NAMES = '|'.join(sorted(map(re.escape, UNITS), key=len, reverse=True))

_UNIT = re.compile(rf'(?<=\d )({_NAMES})(?![\w/^(])')

_QUANTITY = re.compile(
    rf'({_NUMBER})(?: to ({_NUMBER}))? '
    rf'({_NAMES})(?![\w/^(])'
    rf'(?: \(({_NUMBER})\.\.({_NUMBER})\))?'
)


def _in_other_units(match: re.Match[str], units: str) -> str:
    new = _OTHER_UNIT[units].get(match[3])
    if new is None:
        return match[0]
    factor = UNITS[match[3]].factor / UNITS[new].factor
    value, second, low, high = (
        significant(float(number) * factor, VALUE_DIGITS) if number else ''
        for number in match.group(1, 2, 4, 5)
    )
    to = f' to {second}' if second else ''
    return f'{value}{to} {new}{f" ({low}..{high})" if low else ""}'


NUMBER = re.compile(
    r'(?<![\w^])(?<!\w\.)(-?\d+(?:\.\d+)?(?:e[-+]?\d+)?)'
    r'(?:\.\.(-?\d+(?:\.\d+)?(?:e[-+]?\d+)?))?(?!\w)'
)
"""A number in a message, or an interval ``low..high``, but no part of a name or a unit."""


def grouped(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Merge equal findings of several axes, and sort all findings, the most severe first.

    The texts of merged findings may differ in numbers, which are replaced by their ranges:
    "Vibration at 0.573 to 0.579 Hz".
    """
    groups: dict[tuple[str, ...], list[Finding]] = {}
    for each in findings:
        texts = each.message, each.remedy
        alike = (NUMBER.sub('#', text) for text in texts) if each.axes else texts
        groups.setdefault((each.id, each.severity, *alike), []).append(each)
    merged = [
        replace(
            alike[0],
            message=_merged([each.message for each in alike]),
            remedy=_merged([each.remedy for each in alike]),
            axes=tuple(dict.fromkeys(axis for each in alike for axis in each.axes)),
        )
        for alike in groups.values()
    ]
    return tuple(sorted(merged, key=lambda each: SEVERITIES.index(each.severity)))


def _merged(texts: Sequence[str]) -> str:
    """Return texts that differ only in numbers as one text with ranges."""
    columns = zip(*(NUMBER.findall(text) for text in texts))
    ranges = []
    for column in columns:
        lows, highs = (sorted(set(ends), key=lambda end: float(end or 0)) for ends in zip(*column))
        if highs[-1]:
            ranges.append(f'{lows[0]}..{highs[-1]}')
        else:
            ranges.append(lows[0] if len(lows) == 1 else f'{lows[0]} to {lows[-1]}')
    numbers = iter(ranges)
    return NUMBER.sub(lambda _: next(numbers), texts[0])
