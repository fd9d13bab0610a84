# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the columns of a table mean: from its header, or from the names the user gives.

Names are known by how they end, so ``gx``, ``gyro_x [deg/s]``, ``angular_velocity.x``,
``/imu/angular_velocity/x`` and ``w_RS_S_x [rad s^-1]`` are one axis. A unit in brackets counts
more than the unit stated in the options.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from ...core.errors import AllanError
from ...core.imu import AXES, SENSORS
from .recording import ACCEL_UNITS, GYRO_UNITS, STAMP_UNITS, ReadOptions

LEFT_OUT = '-'

EXAMPLE_COLUMNS = 't,gx,gy,gz,ax,ay,az'


_BRACKET = re.compile(r'^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]$')

_GYRO = re.compile(
    r'(?:^|_)(?:g|w|gyro|gyr|gyroscope|omega|ang_vel|angular_velocity|angular_rate|w_rs_s)_?([xyz])$'
)

_ACCEL = re.compile(
    r'(?:^|_)(?:a|acc|accel|accelerometer|acceleration|lin_acc|linear_acceleration|a_rs_s)_?([xyz])$'
)

_TIME = re.compile(r'(?:^|_)(t|time|timestamp|timestamps|stamp|stamps)(?:_(s|ms|us|ns))?$')

_RECORD = re.compile(r'^record(?:_time|_stamp)?(?:_(s|ms|us|ns))?$')

_TEMPERATURE = re.compile(r'(?:^|_)(?:temp|temperature)(?:_(?:c|degc|celsius))?$')

_SECONDS = re.compile(r'(?:^|_)secs?$')

_NANOSECONDS = re.compile(r'(?:^|_)(?:nanosecs?|nsecs?|nanoseconds)$')


@dataclass(frozen=True)
class TableLayout:
    """Where everything stands in a row.

    Attributes
    ----------
    delimiter : str
        ',', ';' or tab; '' for any white space.
    width : int
        Number of columns of every row.
    names : tuple of str
        Column names, for messages; empty without a header.
    header_line : int
        Number of the line that holds the header; 0 without one.
    axes : dict
        Index of the axis in `AXES` -> (column, factor to SI).
    stamp, record : tuple of (column, factor to nanoseconds)
        Columns whose sum is the stamp (``sec`` and ``nanosec``, or one); empty if there is none.
    rate_hz : float
        Sample rate where there is no stamp.
    temperature : int or None
        Column of the temperature in degC.
    """

    delimiter: str
    width: int
    names: tuple[str, ...]
    header_line: int
    axes: dict[int, tuple[int, float]]
    stamp: tuple[tuple[int, int], ...]
    record: tuple[tuple[int, int], ...]
    rate_hz: float
    temperature: int | None = None

    def split(self, lines: Iterable[str]) -> list[list[str]]:
        """Split lines into cells."""
        return _split(lines, self.delimiter)


def _split(lines: Iterable[str], delimiter: str) -> list[list[str]]:
    if not delimiter:
        return [line.split() for line in lines]
    return list(csv.reader(lines, delimiter=delimiter))


def is_number(cell: str) -> bool:
    """Tell whether a cell holds a number (NaN and infinity are numbers here)."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_layout(path: Path, file: TextIO, options: ReadOptions) -> TableLayout:
    """Find the columns of a table from its first lines.

    Raises
    ------
    AllanError
        When there is no row, no name for the columns, or no sensor among them.
    """
    comment = ''
    number = 0
    for line in file:
        number += 1
        if line.startswith('#'):
            comment = line
        elif not line.isspace():
            break
    else:
        raise AllanError(f'{path}: has no line of data: record or export it again')
    delimiter = next((mark for mark in '\t;,' if mark in line), '')
    try:
        first = _split([line], delimiter)[0]
        above = _split([comment.lstrip('# ')], delimiter)[0] if comment else []
    except (csv.Error, IndexError) as error:
        raise AllanError(f'{path}: line {number} is no row of a table: mend the file') from error

    names = tuple(name.strip() for name in options.columns)
    if names:
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
    if header_line and all(line.startswith('#') or line.isspace() for line in file):
        raise AllanError(f'{path}: holds no line behind its header: record or export it again')
    axes, stamp, record = _roles(path, names, options)
    if not stamp and not options.rate_hz:
        raise AllanError(
            f'{path}: none of its columns ({_listed(names)}) is a time: state the sample rate '
            'with --rate, or name the column with --columns'
        )
    return TableLayout(
        delimiter,
        len(first),
        names,
        header_line,
        axes,
        stamp,
        record,
        options.rate_hz,
        next((column for column, name in enumerate(names) if _is_celsius(name)), None),
    )


def _check_names(path: Path, names: tuple[str, ...], first: list[str]) -> None:
    if len(names) != len(first):
        raise AllanError(
            f'{path}: has {len(first)} columns, {len(names)} are named by --columns: '
            f'name each, {LEFT_OUT} for one to leave out'
        )


def _roles(
    path: Path, names: tuple[str, ...], options: ReadOptions
) -> tuple[dict[int, tuple[int, float]], tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]]:
    """Return the axes, stamp and record columns that the names tell of."""
    axes: dict[int, tuple[int, float]] = {}
    times: list[tuple[bool, int, int]] = []
    record: tuple[tuple[int, int], ...] = ()
    parts: dict[str, int] = {}
    for column, name in enumerate(names):
        base, unit = _base_and_unit(name)
        if match := _GYRO.search(base):
            scale = _size(path, name, unit or options.gyro_unit, GYRO_UNITS)
            axes.setdefault('xyz'.index(match[1]), (column, scale))
        elif match := _ACCEL.search(base):
            scale = _size(path, name, unit or options.accel_unit, ACCEL_UNITS)
            axes.setdefault(3 + 'xyz'.index(match[1]), (column, scale))
        elif match := _RECORD.match(base):
            record = ((column, STAMP_UNITS[match[1] or options.stamp_unit]),)
        elif _SECONDS.search(base):
            parts.setdefault('s', column)
        elif _NANOSECONDS.search(base):
            parts.setdefault('ns', column)
        elif match := _TIME.search(base):
            known = unit if unit in STAMP_UNITS else match[2] or options.stamp_unit
            times.append(('stamp' not in match[1], column, STAMP_UNITS[known]))
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
            f'name them, such as --columns {EXAMPLE_COLUMNS} (- leaves one out)'
        )
    if len(parts) == 2:
        stamp: tuple[tuple[int, int], ...] = (
            (parts['s'], STAMP_UNITS['s']),
            (parts['ns'], STAMP_UNITS['ns']),
        )
    else:
        # A stamp of the sensor is preferred to any other time.
        stamp = tuple((column, scale) for _, column, scale in sorted(times)[:1])
    return axes, stamp, record


def axis_of_column(name: str) -> tuple[str, str] | None:
    """Return the axis that a column is named after and the unit in its name ('' for none).

    Examples
    --------
    >>> axis_of_column('gyro_x [deg/s]'), axis_of_column('az'), axis_of_column('label')
    (('gyro_x', 'deg/s'), ('accel_z', ''), None)
    """
    base, unit = _base_and_unit(name)
    for sensor, pattern in (('gyro', _GYRO), ('accel', _ACCEL)):
        if match := pattern.search(base):
            return f'{sensor}_{match[1]}', unit
    return None


def time_of_column(name: str) -> int | None:
    """Return the nanoseconds in the unit of a time column, or None for another column."""
    base, unit = _base_and_unit(name)
    match = _TIME.search(base)
    return STAMP_UNITS[unit if unit in STAMP_UNITS else match[2] or 's'] if match else None


def _size(path: Path, name: str, unit: str, units: dict[str, float]) -> float:
    try:
        return units[unit]
    except KeyError:
        raise AllanError(
            f'{path}: the unit of column {name!r} is not known: use one of {", ".join(units)}'
        ) from None


def _base_and_unit(name: str) -> tuple[str, str]:
    """Split 'Gyro X [deg/s]' into 'gyro_x' and 'deg/s', in our spelling of units."""
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
    """Tell whether a column is a temperature in degC, or in no unit that it names."""
    base, unit = _base_and_unit(name)
    return bool(_TEMPERATURE.search(base)) and unit in ('', 'c', 'degc', 'celsius')


def _listed(names: tuple[str, ...], most: int = 10) -> str:
    text = ', '.join(names[:most])
    return f'{text} and {len(names) - most} more' if len(names) > most else text
