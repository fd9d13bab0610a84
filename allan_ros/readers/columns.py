# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recognize the columns of a table or DataFrame by their names.

The end of a name states the axis, so ``gx``, ``gyro_x [deg/s]``, ``angular_velocity.x``,
``/imu/angular_velocity/x`` and ``w_RS_S_x [rad s^-1]`` are the same axis. For samples, the unit in
the name takes precedence over the unit in the options; for stamps in one column, the unit in the
options does.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.errors import AllanError
from ..core.imu import AXES, EPOCH_S, SAMPLE_SI, SAMPLE_UNITS, SENSORS, STAMP_UNITS, UNITS
from .recording import ReadOptions, listed
from .unit_names import (
    NO_UNITS,
    SAMPLE_SPELLINGS,
    TEMPERATURE_SPELLINGS,
    TIME_SPELLINGS,
    plain_unit,
    unit_named,
)

LEFT_OUT = '-'
"""Name that the user gives to a column to exclude it."""

EXAMPLE_COLUMNS = 't,gx,gy,gz,ax,ay,az'

FIRST_ROWS = 200
"""Largest number of rows from which the unit of the stamps is recognized. The first row of a text
file without a header is used in addition."""

NO_UNIT, DATES = 0, -1
"""Values that are used instead of a factor to ns: `NO_UNIT` if the unit of the times is not stated,
and `DATES` if the times are dates such as 2026-01-31T12:00."""

_BRACKET = re.compile(r'^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]$')


def _suffixes(spellings: Mapping[str, Sequence[str]]) -> str:
    """Return a regular expression for the spellings of units within a column name.

    In the name and in the spellings, all characters but letters and digits are replaced by _.
    """
    plain_spellings = {
        re.sub('[^a-z0-9]+', '_', spelling) for names in spellings.values() for spelling in names
    }
    return '|'.join(sorted(plain_spellings))


_TIME_UNIT = f'(?:_(?P<unit>{_suffixes(TIME_SPELLINGS)}))?$'
_DEGREES = f'(?:_(?P<unit>{_suffixes(TEMPERATURE_SPELLINGS)}))?$'
_SAMPLE_UNIT = _suffixes(SAMPLE_SPELLINGS)
_AXIS = f'(?:_(?P<inner>{_SAMPLE_UNIT}))?_?(?P<axis>[xyz])(?:_(?P<unit>{_SAMPLE_UNIT}))?$'

_KINDS = tuple(
    (kind, re.compile(f'(?:^|_)(?:{words}){end}'), unit)
    for kind, words, end, unit in (
        ('gyro', 'gyro|gyr|gyroscope|gyroskop|omega|ang_vel|angular_velocity|angular_rate|w_rs_s',
         _AXIS, ''),
        ('accel', 'acc|accel|accelerometer|acceleration|lin_acc|linear_acceleration|a_rs_s',
         _AXIS, ''),
        ('accel', 'gf', _AXIS, 'g'),
        ('gyro', 'g|w', _AXIS, ''),
        ('accel', 'a', _AXIS, ''),
        ('record', '(?<!_)record(?:_time|_stamp)?', _TIME_UNIT, ''),
        ('sec', 'secs?|seconds', '$', 's'),
        ('nanosec', 'nanosecs?|nsecs?|nanoseconds', '$', 'ns'),
        ('stamp', '(?:timestamp|stamp)s?', _TIME_UNIT, ''),
        ('time', 't|time|zeit|tiempo|temps|tempo', _TIME_UNIT, ''),
        ('elapsed', 'seconds_elapsed|elapsed_seconds', '$', 's'),
        *(('counter', f'(?<!_){word}', '$', unit)
          for word, unit in (('millis', 'ms'), ('micros', 'us'), ('nanos', 'ns'))),
        ('temperature', 'temp|temperature', _DEGREES, ''),
    )
)  # fmt: skip
"""For each kind of column: the kind, a regular expression for its names with groups for axis and
unit, and the unit if the name states none. The first expression that matches a name applies."""

_ONLY_AXIS = re.compile('(?:^|_)([xyz])$')

_STAMPS = (('sec', 'nanosec'), ('stamp',), ('time',), ('elapsed',), ('counter',), ('sec',))
"""Kinds of columns whose sum is the stamp. The first entry whose kinds are all present is used."""

_SPELLINGS = {
    **dict.fromkeys(SENSORS, SAMPLE_SPELLINGS),
    **dict.fromkeys(('record', 'stamp', 'time'), TIME_SPELLINGS),
    'temperature': TEMPERATURE_SPELLINGS,
}
"""Kind of a column -> spellings of the units that its name can state."""

RECOGNIZED_UNITS = ('s', 'ms', 'us', 'ns')
"""Units of time that are recognized from the stamps."""


class Meaning(NamedTuple):
    """What a column contains, according to its name."""

    kind: str  # kind of the column, as in `_KINDS`; '' if unknown
    axis: str = ''  # 'x', 'y' or 'z' for a column of a sensor
    unit: str = ''  # unit according to the name; '' if the name states none
    unknown: str = ''  # text at the place of the unit if it is not a known unit; else ''
    is_si: bool = False  # whether the column is known to be in SI if its name states no unit


LONGEST_NAME = 40
"""Number of characters to which messages shorten the name of a column."""


def column_list(names: Sequence[str]) -> str:
    """Return the first column names, shortened, and the number of further names, as text."""
    return listed(
        [name if len(name) <= LONGEST_NAME else f'{name[:LONGEST_NAME]}...' for name in names]
    )


@dataclass(frozen=True)
class ColumnLayout:
    """Which columns of a table contain samples, times and temperature."""

    axes: dict[int, tuple[int, float]]  # index of the axis in `AXES` -> column, factor to SI
    # (column, factor to ns) of each column of times; the stamp is the sum of these columns in ns
    stamp: tuple[tuple[int, int], ...]
    record: tuple[tuple[int, int], ...]  # (column, factor to ns) of the record time, if any
    temperature: tuple[int, str] | None  # column of the temperature, unit ('' if not stated)
    units: dict[str, str]  # sensor -> unit of its first column
    assumed: dict[str, str]  # sensor -> name of a column for which SI is assumed
    # unit of the stamps if it was inferred from their increments, and may be wrong; else ''
    time_unit: str = ''
    unclear_time: str = ''  # unknown unit in the name of the time column; '' if there is none
    unrecognized: tuple[str, ...] = ()  # names of columns without a known meaning, except '-'

    @property
    def given(self) -> tuple[str, ...]:
        """The names of the axes that have a column."""
        return tuple(AXES[axis] for axis in sorted(self.axes))

    def check(
        self, where: object, names: Sequence[str], with_times: bool, header_line: int = 0
    ) -> None:
        """Raise AllanError if no column is an axis, or if the times are missing.

        Parameters
        ----------
        where : object
            Name of the table, for error messages.
        names : sequence of str
            Names of the columns, for error messages.
        with_times : bool
            Whether the times are known without a column.
        header_line : int
            Number of the line of a text file that contains the names; 0 if there is no such line.
        """
        if header_line:
            where = f'{where}: line {header_line}'
        if not self.axes:
            preamble_advice = 'remove lines above the header, or ' if header_line else ''
            raise AllanError(
                f'{where}: no column ({column_list(names)}) is a gyro or accel axis: '
                f'{preamble_advice}name the columns, such as --columns {EXAMPLE_COLUMNS} '
                f'({LEFT_OUT} excludes a column), or t=NAME,gx=NAME,...'
            )
        if not self.stamp and not with_times:
            raise AllanError(
                f'{where}: no column ({column_list(names)}) contains the time: name it with '
                '--columns t=NAME, or state the sample rate (--rate 200; in Python, rate=200)'
            )

    def with_time_unit(
        self, where: object, times: NDArray[np.float64], stated: str
    ) -> ColumnLayout:
        """Return the layout with the unit of the stamps.

        The layout is returned unchanged if there are no times, if the stamp is not one column, or
        if only the name of the column states the unit. The unit is taken from the options,
        otherwise from the name of the column. If neither states a unit, the unit is recognized from
        the stamps: by their size if they are times since 1970, otherwise by their increments.

        Parameters
        ----------
        where : object
            Name of the table in error messages.
        times : (n,) array
            The first stamps, in the unit to be determined.
        stated : str
            The unit in the options; '' if the options state no unit.

        Raises
        ------
        AllanError
            When the options state no unit, and the unit in the name of the column is unknown or
            wrong. It is wrong if there are at least `ENOUGH` stamps, if the sample period in this
            unit is shorter than `SHORTEST_NS`, and if the stamps are times since 1970 in another
            unit.
        """
        if len(self.stamp) != 1 or not len(times):
            return self
        ((column, factor),) = self.stamp
        unit_by_size, unit_by_step = _unit_by_size(times), _unit_by_step(times)
        if stated:
            unit = stated
        elif self.unclear_time:
            raise AllanError(
                f'{where}: the unit {self.unclear_time!r} of column {column + 1}, the time, is '
                f'unknown: state it with --stamp-unit ({", ".join(STAMP_UNITS)})'
            )
        elif factor == NO_UNIT:
            unit = unit_by_size or unit_by_step
        elif unit_by_size and len(times) >= ENOUGH and 0.0 < _step(times) * factor < SHORTEST_NS:
            raise AllanError(
                f'{where}: the name of column {column + 1} states another unit of time than its '
                f'values, which are times since 1970 in {unit_by_size}: use --stamp-unit '
                f'{unit_by_size}'
            )
        else:
            return self
        is_doubtful = unit != 's' or (len(times) >= ENOUGH and _step(times) >= FASTEST_MS)
        assumed = unit if not stated and not unit_by_size and is_doubtful else ''
        return replace(self, stamp=((column, STAMP_UNITS[unit]),), time_unit=assumed)


SHORTEST_NS, LONGEST_NS = 1e4, 1e12
"""Range of sample periods in ns that are plausible for an IMU."""

FASTEST_MS = 0.3
"""Smallest increment of times for which the unit could be ms instead of s. An increment of 0.3 ms
is a sample rate of about 3 kHz; a smaller increment would mean an implausible rate."""

ENOUGH = 100
"""An implausible unit in a column name, and stamps that may be in ms and not in s, are reported
only for tables with at least this number of rows. Shorter tables are hardly measurements."""

LONGEST_STEP = {'s': 2.0, 'ms': 300.0, 'us': 3e5}
"""Unit of time -> smallest increment, in this unit, for which the next smaller unit is more
plausible. IMUs have sample rates of 3 Hz to 3 kHz."""


def _step(times: NDArray[np.float64]) -> float:
    """Return the median of the positive increments of times; 0 if no increment is positive."""
    steps = np.diff(times)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


def _unit_by_size(times: NDArray[np.float64]) -> str:
    """Return the unit in which stamps, (n,), are times since 1970; '' if there is no such unit.

    The first stamp decides. In this unit, the median of the positive increments, if any, must be a
    plausible period.
    """
    for unit in RECOGNIZED_UNITS:
        unit_ns = STAMP_UNITS[unit]
        is_epoch = EPOCH_S[0] <= times[0] * unit_ns * 1e-9 <= EPOCH_S[1]
        if is_epoch and (not _step(times) or SHORTEST_NS <= _step(times) * unit_ns <= LONGEST_NS):
            return unit
    return ''


def _unit_by_step(times: NDArray[np.float64]) -> str:
    """Return the most plausible unit of the times, judged by their increments."""
    step = _step(times)
    return next((unit for unit, longest in LONGEST_STEP.items() if step < longest), 'ns')


def columns_of(where: object, names: Sequence[str], options: ReadOptions) -> ColumnLayout:
    """Find the columns of samples, times and temperature by the names of all columns.

    Parameters
    ----------
    where : object
        Name of the table in error messages.
    names : sequence of str
        Names of the columns. If several columns contain times, `_STAMPS` states which of them are
        used. Of several columns with the same kind of time, or with a temperature, the first is
        used; a temperature in an unknown unit is ignored.
    options : ReadOptions
        Units for columns whose names state no unit, and raw counts per unit of the samples.

    Raises
    ------
    AllanError
        When the name of an axis or of the record times states an unknown unit (for an axis, only if
        the options state none, either), or when two columns contain the same axis.
    """
    axes: dict[str, tuple[int, float]] = {}
    units: dict[str, str] = {}
    assumed: dict[str, str] = {}
    times: dict[str, tuple[int, int]] = {}
    unknown_units: dict[str, str] = {}
    temperature = None
    unrecognized = []
    axis_names: dict[str, str] = {}
    for column, name in enumerate(names):
        kind, letter, unit, unknown, is_si = _meaning(name)
        if kind in SENSORS:
            axis = f'{kind}_{letter}'
            if axis in axes:
                is_repeated = axis_names[axis] == name
                choice = (
                    _without_repeated_names(names)
                    if is_repeated
                    else f'{kind[0]}{letter}={name},...'
                )
                raise AllanError(
                    f'{where}: the columns {axis_names[axis]!r} and {name!r} both contain {axis}: '
                    f'choose the columns of one IMU, such as --columns {choice}'
                )
            axis_names[axis] = name
            stated_unit = unit or getattr(options, f'{kind}_unit')
            if unknown and not stated_unit:
                raise AllanError(
                    f'{where}: the unit of column {name!r} is unknown: state it with --{kind}-unit '
                    f'({", ".join(SAMPLE_UNITS[kind])})'
                )
            if not stated_unit and not is_si:
                assumed.setdefault(kind, name)
            stated_unit = stated_unit or SAMPLE_SI[kind]
            units.setdefault(kind, stated_unit)
            axes[axis] = column, UNITS[stated_unit].factor / getattr(options, f'{kind}_counts')
        elif kind == 'temperature':
            if temperature is None and not unknown:
                temperature = column, unit
        elif kind:
            unknown_units.setdefault(kind, unknown)
            stated_unit = unit or options.stamp_unit or ('s' if kind == 'record' else '')
            times.setdefault(kind, (column, STAMP_UNITS.get(stated_unit, NO_UNIT)))
        elif name.strip() != LEFT_OUT:
            unrecognized.append(name.strip())
    if unknown_units.get('record'):
        raise AllanError(
            f'{where}: the unit {unknown_units["record"]!r} of the record times is unknown: use '
            f'one of {", ".join(STAMP_UNITS)}'
        )
    stamp_kinds: tuple[str, ...] = next(
        (kinds for kinds in _STAMPS if times.keys() >= set(kinds)), ()
    )
    return ColumnLayout(
        {AXES.index(axis): column_and_factor for axis, column_and_factor in axes.items()},
        tuple(times[kind] for kind in stamp_kinds),
        (times['record'],) if 'record' in times else (),
        temperature,
        units,
        assumed,
        unclear_time=unknown_units[stamp_kinds[0]] if stamp_kinds else '',
        unrecognized=tuple(unrecognized),
    )


def _without_repeated_names(names: Sequence[str]) -> str:
    """Return a value of --columns with all names; repetitions of a name are replaced by '-'.

    The value is quoted for a shell if necessary.
    """
    kept_names = [LEFT_OUT if name in names[:column] else name for column, name in enumerate(names)]
    return shlex.quote(','.join(kept_names))


_WORDS = re.compile(r'[A-Z]?[a-z]+|[A-Z]+')

_SENSOR_WORDS = {
    'gyro': ('gyro', 'gyroscope', 'gyroskop'),
    'accel': ('accel', 'accelerometer', 'acceleration', 'beschleunigung'),
}
"""Sensor -> words for the sensor in file names. Phone apps write one file for each sensor, and its
name contains such a word."""


def names_by_file(stem: str, names: tuple[str, ...]) -> tuple[str, ...]:
    """Add the sensor that a file name states to the column names x, y and z.

    If one of these columns is missing, or the file name does not contain exactly one word for a
    sensor, the names are returned unchanged. ``stem`` is the file name without suffix.

    Examples
    --------
    >>> names_by_file('TotalAcceleration', ('time', 'z', 'y', 'x'))
    ('time', 'acceleration_z', 'acceleration_y', 'acceleration_x')
    """
    if not {'x', 'y', 'z'} <= {name.strip().lower() for name in names}:
        return names
    file_words = [word.lower() for word in _WORDS.findall(stem)]
    sensor_words = [w for words in _SENSOR_WORDS.values() for w in words if w in file_words]
    if len(sensor_words) != 1:
        return names
    return tuple(
        f'{sensor_words[0]}_{n.strip()}' if n.strip().lower() in {'x', 'y', 'z'} else n
        for n in names
    )


def picked_names(where: object, names: tuple[str, ...], pairs: tuple[str, ...]) -> tuple[str, ...]:
    """Rename columns by pairs such as ``gx=w_x`` (new name, name in the header).

    Returns one name per column. A renamed column has the new name, and the unit in brackets in the
    header unless the new name has one. If the pairs contain an axis, a time or a temperature, all
    other columns of this kind get the name '-', which excludes them. Further columns keep their
    names. Raises AllanError when a pair does not match exactly one column; ``where`` is the name of
    the table in the message.
    """
    groups = {_group(pair.partition('=')[0]) for pair in pairs} - {''}
    renamed = [LEFT_OUT if _group(name) in groups else name for name in names]
    bases = [_base_and_unit(name)[0] for name in names]
    for pair in pairs:
        new_name, _, old_name = (word.strip() for word in pair.partition('='))
        positions = [i for i, name in enumerate(names) if name == old_name]
        base = _base_and_unit(old_name)[0]
        positions = positions or [i for i, name in enumerate(bases) if name == base]
        if len(positions) != 1:
            remedy = f'correct --columns {pair}'
            if names.count(old_name) > 1:
                remedy = (
                    f'name each column in order, such as --columns {_without_repeated_names(names)}'
                )
            raise AllanError(
                f'{where}: {len(positions)} columns ({column_list(names)}) are named {old_name!r}: '
                f'{remedy}'
            )
        unit = _BRACKET.match(names[positions[0]])
        if unit and not _BRACKET.match(new_name):
            new_name = f'{new_name} [{unit[2]}]'
        renamed[positions[0]] = new_name
    return tuple(renamed)


def _group(name: str) -> str:
    """Return 'sample', 'time' or 'temperature' for the name of a column; '' if it is unknown."""
    kind = _meaning(name).kind
    return 'sample' if kind in SENSORS else kind if kind in ('', 'temperature') else 'time'


def _meaning(name: str) -> Meaning:
    """Return what a column contains (its kind, axis and unit) according to its name.

    Examples
    --------
    >>> _meaning('Gyro X [deg/sec]')[:3], _meaning('label').kind
    (('gyro', 'x', 'deg/s'), '')
    """
    text, bracket_text = _base_and_unit(name)
    plain_name = re.sub(r'[^a-z0-9]+', '_', text).strip('_')
    # tables of this package and ROS messages have these names, and values in SI
    si_words = ('angular_velocity', 'linear_acceleration')
    is_si = plain_name in AXES or any(word in plain_name for word in si_words)
    bracket_unit = unit_named(bracket_text, SAMPLE_SPELLINGS)
    sensor = next((s for s in SENSORS if bracket_unit in SAMPLE_UNITS[s]), '')
    matches = ((k, pattern.search(plain_name), unit) for k, pattern, unit in _KINDS)
    first_match = next(((k, match, unit) for k, match, unit in matches if match), None)
    if first_match is None:
        axis = _ONLY_AXIS.search(plain_name)
        return Meaning(sensor, axis[1], bracket_unit) if sensor and axis else Meaning('')
    kind, match, implied_unit = first_match
    groups = match.groupdict()
    if kind not in _SPELLINGS:
        return Meaning(kind, '', implied_unit)
    if len(text) < 4 and kind in SENSORS and sensor:
        kind = sensor  # a unit is more reliable than the letter g, a or w in a name
    unit_text = bracket_text or groups['unit'] or groups.get('inner') or ''
    unit = unit_named(unit_text, _SPELLINGS[kind])
    if kind in SENSORS and unit and unit not in SAMPLE_UNITS[kind]:
        unit = ''  # this is a unit of the other sensor
    is_no_unit = kind not in (*SENSORS, 'temperature') and plain_unit(unit_text) in NO_UNITS
    unknown = unit_text if unit_text and not unit and not is_no_unit else ''
    return Meaning(kind, groups.get('axis') or '', unit or implied_unit, unknown, is_si)


def _base_and_unit(name: str) -> tuple[str, str]:
    """Return a column name in lower case without the text in brackets at its end, and this text."""
    text = name.strip().lower()
    match = _BRACKET.match(text)
    return (match[1], match[2]) if match else (text, '')
