# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The meaning of the columns of a table, from its header or from the names the user gives.

Names are recognized by how they end, so ``gx``, ``gyro_x [deg/s]``, ``angular_velocity.x``,
``/imu/angular_velocity/x`` and ``w_RS_S_x [rad s^-1]`` are the same axis. A unit in brackets takes
precedence over the unit in the options.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TextIO

from ...core.errors import AllanError
from ...core.imu import AXES, SAMPLE_SI, SAMPLE_UNITS, SENSORS, STAMP_UNITS, UNITS, sensor_of
from .recording import ReadOptions

LEFT_OUT = '-'

MAX_LINE = 1 << 20
"""Longest line of a table, in characters."""

EXAMPLE_COLUMNS = 't,gx,gy,gz,ax,ay,az'

_BRACKET = re.compile(r'^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]$')

_SENSORS = {
    sensor: re.compile(f'(?:^|_)(?:{names})_?([xyz])$')
    for sensor, names in (
        ('gyro', 'g|w|gyro|gyr|gyroscope|omega|ang_vel|angular_velocity|angular_rate|w_rs_s'),
        ('accel', 'a|acc|accel|accelerometer|acceleration|lin_acc|linear_acceleration|a_rs_s'),
    )
}


_TIME = re.compile(r'(?:^|_)(t|time|timestamp|timestamps|stamp|stamps)(?:_(s|ms|us|ns))?$')

_RECORD = re.compile(r'^record(?:_time|_stamp)?(?:_(s|ms|us|ns))?$')

_TEMPERATURE = re.compile(r'(?:^|_)(?:temp|temperature)(?:_(?:c|degc|celsius))?$')

_SECONDS = re.compile(r'(?:^|_)secs?$')

_NANOSECONDS = re.compile(r'(?:^|_)(?:nanosecs?|nsecs?|nanoseconds)$')


@dataclass(frozen=True)
class TableLayout:
    """The columns of a table.

    Attributes
    ----------
    delimiter, width : str, int
        ',', ';', tab, or '' for white space; and the number of columns of every row.
    names, header_line : tuple of str, int
        Column names, and the number of their line; empty and 0 without a header.
    axes : dict
        Index of the axis in `AXES` -> (column, factor to SI).
    stamp, record : tuple of (column, factor to nanoseconds)
        Columns whose sum is the stamp (``sec`` and ``nanosec``, or one); empty if there is none.
    rate_hz : float
        Sample rate where there is no stamp.
    temperature : int or None
        Column of the temperature in degC.
    units, assumed : dict
        Sensor -> unit of its columns; and sensor -> (unit, name of a column), where neither the
        header nor the options state a unit.
    """

    delimiter: str
    width: int
    names: tuple[str, ...]
    header_line: int
    axes: dict[int, tuple[int, float]]
    stamp: tuple[tuple[int, int], ...]
    record: tuple[tuple[int, int], ...]
    rate_hz: float
    temperature: int | None
    units: dict[str, str]
    assumed: dict[str, tuple[str, str]]

    def rows(self, lines: Iterable[str]) -> Iterator[list[str]]:
        """Yield the cells of each row; a quoted cell may contain line breaks.

        Raises csv.Error when a quote is not closed, or a cell is longer than 128 kB.
        """
        return _split(lines, self.delimiter)


def bounded_lines(path: Path, file: TextIO) -> Iterator[str]:
    """Yield the lines of a text file.

    Raises AllanError when one is longer than `MAX_LINE`.
    """
    number, read = 0, file.readline
    while line := read(MAX_LINE):
        number += 1
        if len(line) == MAX_LINE and not line.endswith('\n'):
            raise AllanError(
                f'{path}: line {number} has more than {MAX_LINE} characters: '
                'give a table of numbers'
            )
        yield line


def _split(lines: Iterable[str], delimiter: str) -> Iterator[list[str]]:
    if not delimiter:
        return map(str.split, lines)
    return csv.reader(lines, delimiter=delimiter, strict=True)


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, NaN and infinity included."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_layout(path: Path, file: TextIO, options: ReadOptions) -> TableLayout:
    """Return the columns of a table, from its first lines.

    Raises AllanError when there is no row, no name for the columns, or no sensor among them.
    """
    comment = ''
    lines = bounded_lines(path, file)
    number = 0
    for number, line in enumerate(lines, 1):  # noqa: B007
        if line.startswith('#'):
            comment = line
        elif not line.isspace():
            break
    else:
        raise AllanError(f'{path}: has no line of data: record or export it again')
    delimiter = next((mark for mark in '\t;,' if mark in line), '')
    try:
        rows = _split(chain([line], lines), delimiter)
        first = next(rows)
        number += getattr(rows, 'line_num', 1) - 1  # a header may have quoted line breaks
        above = next(_split([comment.lstrip('# ')], delimiter)) if comment else []
    except (csv.Error, StopIteration) as error:
        raise AllanError(
            f'{path}: line {number} is not a row of a table: correct the file'
        ) from error

    names = tuple(name.strip() for name in options.columns)
    picked = bool(names) and all('=' in name for name in names)
    if names and not picked:
        _check_names(path, names, first)
        used = [cell for name, cell in zip(names, first) if name != LEFT_OUT]
        header_line = 0 if all(map(is_number, used)) else number
    elif not all(map(is_number, first)):
        names, header_line = tuple(cell.strip() for cell in first), number
    elif len(above) == len(first) and not all(map(is_number, above)):
        names, header_line = tuple(cell.strip() for cell in above), 0
    else:
        raise AllanError(
            f'{path}: has {len(first)} columns of numbers and no header: '
            f'name them, such as --columns {EXAMPLE_COLUMNS} (- leaves one out)'
        )
    if header_line and all(line.startswith('#') or line.isspace() for line in lines):
        raise AllanError(f'{path}: has no line after its header: record or export it again')
    if picked:
        names = _picked(path, names, options.columns)
    return _layout(path, names, options, delimiter, len(first), header_line)


def _picked(path: Path, names: tuple[str, ...], columns: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of all columns, from pairs such as ``gx=w_x``.

    The unit of a header name is kept; columns that are not in the pairs are left out.
    """
    meanings = [LEFT_OUT] * len(names)
    for pair in columns:
        meaning, _, wanted = (word.strip() for word in pair.partition('='))
        places = [at for at, name in enumerate(names) if name == wanted]
        places = places or [at for at, name in enumerate(names) if _bare(name) == _bare(wanted)]
        if len(places) != 1:
            raise AllanError(
                f'{path}: {len(places)} of its columns ({_listed(names)}) are named {wanted!r}: '
                f'correct --columns {pair}'
            )
        unit = _BRACKET.match(names[places[0]])
        if unit and not _BRACKET.match(meaning):
            meaning = f'{meaning} [{unit[2]}]'
        meanings[places[0]] = meaning
    return tuple(meanings)


def _bare(name: str) -> str:
    """Return a column name in lower case, without its unit."""
    match = _BRACKET.match(name)
    return (match[1] if match else name).strip().lower()


def _check_names(path: Path, names: tuple[str, ...], first: list[str]) -> None:
    if len(names) != len(first):
        raise AllanError(
            f'{path}: has {len(first)} columns, {len(names)} are named by --columns: '
            f'name each ({LEFT_OUT} leaves one out), or pick some as in gx=NAME'
        )


def _layout(
    path: Path,
    names: tuple[str, ...],
    options: ReadOptions,
    delimiter: str,
    width: int,
    header_line: int,
) -> TableLayout:
    """Return the layout of a table with columns of these names."""
    axes: dict[int, tuple[int, float]] = {}
    units: dict[str, str] = {}
    assumed: dict[str, tuple[str, str]] = {}
    times: list[tuple[bool, int, int]] = []
    record: tuple[tuple[int, int], ...] = ()
    parts: dict[str, tuple[int, int]] = {}
    for column, name in enumerate(names):
        base, unit = _base_and_unit(name)
        if known := axis_of_column(name):
            axis, sensor = known[0], sensor_of(known[0])
            stated = unit or getattr(options, f'{sensor}_unit')
            if not stated and not _is_si(base):
                assumed.setdefault(sensor, (SAMPLE_SI[sensor], name))
            stated = stated or SAMPLE_SI[sensor]
            if stated not in SAMPLE_UNITS[sensor]:
                raise AllanError(
                    f'{path}: the unit of column {name!r} is unknown: use one of '
                    f'{", ".join(SAMPLE_UNITS[sensor])}'
                )
            units.setdefault(sensor, stated)
            axes.setdefault(AXES.index(axis), (column, UNITS[stated].factor))
        elif match := _RECORD.match(base):
            record = ((column, STAMP_UNITS[match[1] or options.stamp_unit]),)
        elif _SECONDS.search(base):
            parts.setdefault('s', (column, STAMP_UNITS['s']))
        elif _NANOSECONDS.search(base):
            parts.setdefault('ns', (column, STAMP_UNITS['ns']))
        elif match := _TIME.search(base):
            size = STAMP_UNITS[unit if unit in STAMP_UNITS else match[2] or options.stamp_unit]
            times.append(('stamp' not in match[1], column, size))
    for sensor, place in SENSORS.items():
        have = [AXES[axis] for axis in range(place.start, place.stop) if axis in axes]
        if have and len(have) < 3:
            raise AllanError(
                f'{path}: has {", ".join(have)} only: name all three {sensor} columns in the '
                'header or with --columns'
            )
    if not axes:
        raise AllanError(
            f'{path}: none of its columns ({_listed(names)}) is a gyro or accel axis: '
            f'name them, such as --columns {EXAMPLE_COLUMNS} (- leaves one out) or gx=NAME,...'
        )
    # a stamp of the sensor has precedence over other times
    stamp = tuple((column, scale) for _, column, scale in sorted(times)[:1])
    if len(parts) == 2:
        stamp = (parts['s'], parts['ns'])
    if not stamp and not options.rate_hz:
        raise AllanError(
            f'{path}: none of its columns ({_listed(names)}) is a time: state the sample rate '
            'with --rate, or name the column with --columns'
        )
    return TableLayout(
        delimiter,
        width,
        names,
        header_line,
        axes,
        stamp,
        record,
        options.rate_hz,
        next((column for column, name in enumerate(names) if _is_celsius(name)), None),
        units,
        assumed,
    )


def axis_of_column(name: str) -> tuple[str, str] | None:
    """Return the axis that a column is named after and the unit in its name ('' for none).

    Examples
    --------
    >>> axis_of_column('gyro_x [deg/s]'), axis_of_column('az'), axis_of_column('label')
    (('gyro_x', 'deg/s'), ('accel_z', ''), None)
    """
    base, unit = _base_and_unit(name)
    for sensor, pattern in _SENSORS.items():
        if match := pattern.search(base):
            return f'{sensor}_{match[1]}', unit
    return None


def time_of_column(name: str) -> int | None:
    """Return the nanoseconds in the unit of a time column, or None for another column."""
    base, unit = _base_and_unit(name)
    match = _TIME.search(base)
    return STAMP_UNITS[unit if unit in STAMP_UNITS else match[2] or 's'] if match else None


def _is_si(base: str) -> bool:
    """Return whether a column is named as in `write_table` or in a ROS message, which are SI."""
    return base in AXES or 'angular_velocity' in base or 'linear_acceleration' in base


def _base_and_unit(name: str) -> tuple[str, str]:
    """Split 'Gyro X [deg/s]' into 'gyro_x' and 'deg/s', with units as in `UNITS`."""
    text = name.strip().lower()
    unit = ''
    if match := _BRACKET.match(text):
        text, unit = match[1], match[2].replace(' ', '').replace('°', 'deg')
        unit = {
            'rads^-1': 'rad/s', 'degs^-1': 'deg/s', 'dps': 'deg/s', 'deg/sec': 'deg/s',
            'rad/sec': 'rad/s', 'm/s2': 'm/s^2', 'm/s/s': 'm/s^2', 'ms^-2': 'm/s^2',
            'm/s²': 'm/s^2', 'sec': 's', 'µs': 'us',
        }.get(unit, unit)  # fmt: skip
    return re.sub(r'[^a-z0-9]+', '_', text).strip('_'), unit


def _is_celsius(name: str) -> bool:
    """Return whether a column is a temperature in degC, or without a unit."""
    base, unit = _base_and_unit(name)
    return bool(_TEMPERATURE.search(base)) and unit in ('', 'c', 'degc', 'celsius')


def _listed(names: tuple[str, ...], most: int = 10) -> str:
    text = ', '.join(names[:most])
    return f'{text} and {len(names) - most} more' if len(names) > most else text
