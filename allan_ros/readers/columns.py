# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recognizes the columns of a table or DataFrame by their names.

Only the end of a name matters, so ``gx``, ``gyro_x [deg/s]``, ``angular_velocity.x``,
``/imu/angular_velocity/x`` and ``w_RS_S_x [rad s^-1]`` are the same axis. A unit in brackets takes
precedence over the unit in the options.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.errors import AllanError
from ..core.imu import AXES, SAMPLE_SI, SAMPLE_UNITS, SENSORS, STAMP_UNITS, UNITS
from . import ReadOptions

LEFT_OUT = '-'
"""Name of a column that is not used."""

EXAMPLE = 't,gx,gy,gz,ax,ay,az'

FIRST_ROWS = 200
"""Number of rows from which the unit of the stamps is recognized."""

UNKNOWN, DATES = 0, -1
"""In place of a factor to ns: times whose unit is not stated, and dates such as 2026-01-31T12:00.
"""

_BRACKET = re.compile(r'^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]$')

_KINDS = {
    kind: re.compile(pattern)
    for kind, pattern in {
        'gyro': '(?:^|_)(?:g|w|gyro|gyr|gyroscope|omega|ang_vel|angular_velocity|angular_rate|'
        'w_rs_s)_?([xyz])$',
        'accel': '(?:^|_)(?:a|acc|accel|accelerometer|acceleration|lin_acc|linear_acceleration|'
        'a_rs_s)_?([xyz])$',
        'record': '^record(?:_time|_stamp)?(?:_(s|ms|us|ns))?$',
        'sec': '(?:^|_)secs?()$',
        'nanosec': '(?:^|_)(?:nanosecs?|nsecs?|nanoseconds)()$',
        'stamp': '(?:^|_)(?:timestamp|stamp)s?(?:_(s|ms|us|ns))?$',
        'time': '(?:^|_)(?:t|time|seconds_elapsed)(?:_(s|ms|us|ns))?$',
        'temperature': '(?:^|_)(?:temp|temperature)(?:_(c|degc|celsius))?$',
    }.items()
}
"""Kind of a column -> pattern of its names, with a group for the axis or the unit."""

_STAMPS = (('sec', 'nanosec'), ('stamp',), ('time',))
"""Kinds of columns whose sum is the stamp; the first that are present are used."""

_UNIT_SUFFIX = re.compile(r'^(.*[xyz])_(dps|deg_s|degs|rad_s|rads|m_s2|m_s_2|ms2|mps2|mg|g)$')
"""Axis name that ends with a unit, in which all other characters are replaced by _."""

_UNIT_SPELLINGS = {
    'rads^-1': 'rad/s', 'degs^-1': 'deg/s', 'dps': 'deg/s', 'deg/sec': 'deg/s', 'rad/sec': 'rad/s',
    'm/s2': 'm/s^2', 'm/s/s': 'm/s^2', 'ms^-2': 'm/s^2', 'm/s²': 'm/s^2', 'sec': 's', 'µs': 'us',
    'deg_s': 'deg/s', 'degs': 'deg/s', 'rad_s': 'rad/s', 'rads': 'rad/s', 'm_s2': 'm/s^2',
    'm_s_2': 'm/s^2', 'ms2': 'm/s^2', 'mps2': 'm/s^2',
}  # fmt: skip


class Meaning(NamedTuple):
    """What a column contains, according to its name."""

    kind: str  # a key of `_KINDS`, '' if unknown
    detail: str  # axis 'x', 'y' or 'z', or the unit of a time in the name; '' if there is none
    unit: str  # in brackets after the name; '' if there is none
    is_si: bool  # whether samples with this name are always in SI


@dataclass(frozen=True)
class Columns:
    """Which columns of a table contain samples, times and temperature."""

    axes: dict[int, tuple[int, float]]  # index of the axis in `AXES` -> column, factor to SI
    stamp: tuple[tuple[int, int], ...]  # (column, factor to ns); their sum is the stamp
    record: tuple[tuple[int, int], ...]  # the same for the record time
    temperature: int | None  # column of the temperature in degC
    units: dict[str, str]  # sensor -> unit of its columns
    assumed: dict[str, str]  # sensor -> name of a column whose unit is not stated anywhere
    time_unit: str = ''  # unit of the stamps if only their increments suggest it

    @property
    def given(self) -> tuple[str, ...]:
        """The names of the axes that have a column."""
        return tuple(AXES[axis] for axis in sorted(self.axes))

    def check(self, where: object, names: Sequence[str], with_times: bool) -> None:
        """Raise AllanError if no column is an axis or, unless ``with_times``, the time."""
        if not self.axes:
            raise AllanError(
                f'{where}: no column ({listed(names)}) is a gyro or accel axis: name them, such as '
                f'--columns {EXAMPLE} ({LEFT_OUT} leaves one out), or t=NAME,gx=NAME,...'
            )
        if not self.stamp and not with_times:
            raise AllanError(
                f'{where}: no column ({listed(names)}) contains the time: name one t, or state the '
                'sample rate (--rate 200, rate=200)'
            )

    def with_time_unit(self, where: object, times: NDArray[np.float64], stated: str) -> Columns:
        """Return the columns with the unit of the stamps.

        ``times`` are the first stamps. The unit is ``stated`` in the options, or in the name of the
        column, or is recognized from the stamps: by their size if they are times since 1970, else
        by their increments. Raises AllanError when the name contradicts the stamps.
        """
        if len(self.stamp) != 1 or not len(times):
            return self
        ((column, factor),) = self.stamp
        by_size, by_step = _unit_by_size(times), _unit_by_step(times)
        if stated:
            unit = stated
        elif factor == UNKNOWN:
            unit = by_size or by_step
        elif by_size and len(times) >= ENOUGH and _step(times) * factor < SHORTEST_NS:
            raise AllanError(
                f'{where}: the name of column {column + 1} states another unit of time than its '
                f'values, which are times since 1970 in {by_size}: use --stamp-unit {by_size}'
            )
        else:
            return self
        doubtful = unit != 's' or (len(times) >= ENOUGH and _step(times) >= FASTEST_MS)
        assumed = unit if not stated and not by_size and doubtful else ''
        return replace(self, stamp=((column, STAMP_UNITS[unit]),), time_unit=assumed)


EPOCH_S = (9.4e8, 4.2e9)
"""Seconds since 1970 of the years 1999 and 2103."""

SHORTEST_NS, LONGEST_NS = 1e4, 1e12
"""Range of sample periods in ns that are plausible for an IMU."""

FASTEST_MS = 0.3
"""Increment from which times in seconds could also be in milliseconds."""

ENOUGH = 100
"""Number of times from which a doubtful unit is reported: fewer are no measurement."""

LONGEST_STEP = {'s': 2.0, 'ms': 300.0, 'us': 3e5}
"""Unit -> increments above which the next unit is more plausible: IMUs have 3 Hz to 3 kHz."""


def _step(times: NDArray[np.float64]) -> float:
    """Return the median increment of the times; 0 if they do not advance."""
    steps = np.diff(times)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


def _unit_by_size(times: NDArray[np.float64]) -> str:
    """Return the unit in which these are times since 1970, or '' if there is none."""
    for unit, size in STAMP_UNITS.items():
        is_epoch = EPOCH_S[0] <= times[0] * size * 1e-9 <= EPOCH_S[1]
        if is_epoch and (not _step(times) or SHORTEST_NS <= _step(times) * size <= LONGEST_NS):
            return unit
    return ''


def _unit_by_step(times: NDArray[np.float64]) -> str:
    """Return the most plausible unit of the times, judged by their increments."""
    step = _step(times)
    return next((unit for unit, longest in LONGEST_STEP.items() if step < longest), 'ns')


def columns_of(where: object, names: Iterable[str], options: ReadOptions) -> Columns:
    """Find the columns of samples, times and temperature by the names of all columns.

    If two columns have the same meaning, the first is used. Raises AllanError when the unit of a
    column is unknown; ``where`` is the name of the table in the error message.
    """
    axes: dict[int, tuple[int, float]] = {}
    units: dict[str, str] = {}
    assumed: dict[str, str] = {}
    times: dict[str, tuple[int, int]] = {}
    temperature = None
    for column, name in enumerate(names):
        kind, detail, unit, is_si = _meaning(name)
        if kind in SENSORS:
            stated = unit or getattr(options, f'{kind}_unit')
            if not stated and not is_si:
                assumed.setdefault(kind, name)
            stated = stated or SAMPLE_SI[kind]
            if stated not in SAMPLE_UNITS[kind]:
                raise AllanError(
                    f'{where}: the unit of column {name!r} is unknown: use one of '
                    f'{", ".join(SAMPLE_UNITS[kind])}'
                )
            units.setdefault(kind, stated)
            axes.setdefault(AXES.index(f'{kind}_{detail}'), (column, UNITS[stated].factor))
        elif kind in ('sec', 'nanosec'):
            times.setdefault(kind, (column, STAMP_UNITS['s' if kind == 'sec' else 'ns']))
        elif kind == 'temperature':
            if temperature is None and unit in ('', 'c', 'degc', 'celsius'):
                temperature = column
        elif kind:
            stated = (unit if unit in STAMP_UNITS else detail) or options.stamp_unit
            otherwise = STAMP_UNITS['s'] if kind == 'record' else UNKNOWN
            times.setdefault(kind, (column, STAMP_UNITS.get(stated, otherwise)))
    stamp: tuple[str, ...] = next((kinds for kinds in _STAMPS if times.keys() >= set(kinds)), ())
    return Columns(
        axes,
        tuple(times[kind] for kind in stamp),
        (times['record'],) if 'record' in times else (),
        temperature,
        units,
        assumed,
    )


def picked_names(where: object, names: tuple[str, ...], pairs: tuple[str, ...]) -> tuple[str, ...]:
    """Rename columns by pairs such as ``gx=w_x`` (new name, name in the header).

    Returns one name per column: the new name and the unit in the header, or '-' for a column that
    is not in the pairs. Raises AllanError when a pair does not match exactly one column; ``where``
    is the name of the table in the error message.
    """
    renamed = [LEFT_OUT] * len(names)
    bases = [_base_and_unit(name)[0] for name in names]
    for pair in pairs:
        new, _, wanted = (word.strip() for word in pair.partition('='))
        places = [at for at, name in enumerate(names) if name == wanted]
        base = _base_and_unit(wanted)[0]
        places = places or [at for at, name in enumerate(bases) if name == base]
        if len(places) != 1:
            raise AllanError(
                f'{where}: {len(places)} columns ({listed(names)}) are named {wanted!r}: '
                f'correct --columns {pair}'
            )
        unit = _BRACKET.match(names[places[0]])
        if unit and not _BRACKET.match(new):
            new = f'{new} [{unit[2]}]'
        renamed[places[0]] = new
    return tuple(renamed)


MOST_LISTED = 10
"""Largest number of columns or topics that a message names; the others are counted."""


def listed(names: Sequence[str]) -> str:
    """Return the first `MOST_LISTED` names and the number of the others, as text."""
    text = ', '.join(names[:MOST_LISTED])
    more = len(names) - MOST_LISTED
    return f'{text} and {more} more' if more > 0 else text


def _meaning(name: str) -> Meaning:
    """Return what a column contains, from the end of its name.

    Examples
    --------
    >>> _meaning('Gyro X [deg/sec]'), _meaning('label').kind
    (Meaning(kind='gyro', detail='x', unit='deg/s', is_si=True), '')
    """
    base, unit = _base_and_unit(name)
    unit = unit.replace(' ', '').replace('°', 'deg')
    unit = _UNIT_SPELLINGS.get(unit, unit)
    base = re.sub(r'[^a-z0-9]+', '_', base).strip('_')
    if not unit and (suffix := _UNIT_SUFFIX.match(base)):
        base, unit = suffix[1], _UNIT_SPELLINGS.get(suffix[2], suffix[2])
    # names in tables written by this package and in ROS messages, which are in SI
    is_si = base in AXES or 'angular_velocity' in base or 'linear_acceleration' in base
    for kind, pattern in _KINDS.items():
        if match := pattern.search(base):
            return Meaning(kind, match[1] or '', unit, is_si)
    return Meaning('', '', unit, is_si)


def _base_and_unit(name: str) -> tuple[str, str]:
    """Return a column name in lower case without its unit, and the unit."""
    text = name.strip().lower()
    match = _BRACKET.match(text)
    return (match[1], match[2]) if match else (text, '')
