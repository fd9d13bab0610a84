# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recognize the spellings of units of measurement in the column names of tables."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence

from ..core.stream.signal import ABSOLUTE_ZERO

TIME_SPELLINGS = {
    's': ('s', 'sec', 'secs', 'second', 'seconds'),
    'ms': ('ms', 'msec', 'msecs', 'millis', 'millisec', 'millisecond', 'milliseconds'),
    'us': ('us', 'usec', 'usecs', 'micros', 'microsec', 'microsecond', 'microseconds'),
    'ns': ('ns', 'nsec', 'nsecs', 'nanos', 'nanosec', 'nanosecond', 'nanoseconds'),
    'min': ('min', 'mins', 'minute', 'minutes'),
    'h': ('h', 'hr', 'hrs', 'hour', 'hours'),
    'd': ('d', 'day', 'days'),
}
"""Unit of time -> its spellings, as `plain_unit` returns them."""

SAMPLE_SPELLINGS = {
    'rad/s': ('rad/s', 'rads', 'rads-1', 'radps', 'r/s'),
    'mrad/s': ('mrad/s', 'mrads', 'mrads-1', 'mradps'),
    'deg/s': ('deg/s', 'degs', 'degs-1', 'degps', 'dps'),
    'mdeg/s': ('mdeg/s', 'mdegs', 'mdegs-1', 'mdegps', 'mdps'),
    'deg/h': ('deg/h', 'degh', 'degh-1', 'degph', 'dph'),
    'm/s^2': ('m/s2', 'm/s/s', 'ms-2', 'm/s-2', 'mps2', 'ms2', 'm/s/2', 'mss'),
    'g': ('g', 'gs', 'g0', 'gn', 'gee'),
    'mg': ('mg', 'mgs', 'millig'),
}
"""Unit of samples -> its spellings, as `plain_unit` returns them."""

TEMPERATURE_SPELLINGS = {
    'degC': ('c', 'degc', 'celsius', 'degcelsius', 'centigrade'),
    'K': ('k', 'degk', 'kelvin', 'degkelvin'),
    'degF': ('f', 'degf', 'fahrenheit', 'degfahrenheit'),
}
"""Unit of temperature -> its spellings, as `plain_unit` returns them."""

NO_UNITS = ('', 'utc', 'gmt', 'local', 'unix', 'epoch', 'posix', 'ros', 'iso', 'iso8601')
"""Words that occur in place of a unit in the name of a time column, but are not units."""

_SPELLINGS = {
    'deg': 'degrees|degree|degs|deg',
    'rad': 'radians|radian|rad',
    'h': 'hours|hour|hrs|hr',
    's': 'seconds|second|secs|sec',
    'm': 'meters|metres|meter|metre',
}
"""Part of a unit, such as deg in deg/s -> regular expression for its spellings."""


def plain_unit(text: str) -> str:
    """Return a unit in lower case, without spaces, dots, parentheses and the signs ^ and *.

    Superscripts, the sign of degrees, and the letter of micro are replaced by ASCII, and so are
    units in one character, such as ℃. The words of units are abbreviated only if the unit has
    several parts. The sign _ becomes /.

    Examples
    --------
    >>> plain_unit('°/s'), plain_unit('m s⁻²'), plain_unit('Degrees per second'), plain_unit('µs')
    ('deg/s', 'ms-2', 'deg/s', 'us')
    """
    text = unicodedata.normalize('NFKC', re.sub('[°º˚]', 'deg', text)).lower()
    for sign, replacement in (('°', 'deg'), ('μ', 'u'), ('−', '-'), ('∕', '/')):
        text = text.replace(sign, replacement)
    text = re.sub(r'\s*\bper\b\s*', '/', text)
    if re.search(r'[/^\s*·-]', text):
        for word, spellings in _SPELLINGS.items():
            text = re.sub(rf'(?<![a-z])(?:{spellings})(?![a-z])', word, text)
    return re.sub(r'[\s^*·.()]', '', text).replace('_', '/')


def unit_named(text: str, spellings: Mapping[str, Sequence[str]]) -> str:
    """Return the unit that is spelled ``text``; '' if the spelling is unknown.

    ``spellings`` maps units to spellings, as in `TIME_SPELLINGS`.
    """
    plain = plain_unit(text)
    return next((unit for unit, unit_spellings in spellings.items() if plain in unit_spellings), '')


def to_celsius(value: float, unit: str) -> float:
    """Convert a temperature in 'degC', 'K' or 'degF' to degC; the unit '' stands for degC."""
    if unit == 'K':
        return value + ABSOLUTE_ZERO
    return (value - 32.0) / 1.8 if unit == 'degF' else value
