# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read tables of samples: CSV, TSV, and columns separated by spaces.

`write_recording` writes tables without loss of precision, with stamps in ns, samples in SI, and
the frame_id in a comment::

    # frame_id: imu_link
    stamp_ns,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z
    1600000000000000000,0.001,-0.002,0.0,0.01,-0.02,9.81
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from decimal import Decimal, DecimalException
from io import TextIOWrapper
from itertools import chain, islice, takewhile
from pathlib import Path
from typing import TextIO, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..core.errors import AllanError
from ..core.findings import finding
from ..core.imu import AXES, SAMPLE_SI, ImuBatch, even_stamps
from ..core.stream.signal import Decimated, TemperatureTrace, trace_of
from .columns import (
    DATES,
    EXAMPLE_COLUMNS,
    FIRST_ROWS,
    LEFT_OUT,
    ColumnLayout,
    column_list,
    columns_of,
    names_by_file,
    picked_names,
)
from .files import open_regular
from .recording import BATCH, ReadOptions, Recording, Report, SourceInfo
from .unit_names import to_celsius

T = TypeVar('T')

COMMENT_MARKS, FRAME_COMMENT = ('#', '//'), '# frame_id:'

INT64 = np.iinfo(np.int64)

MAX_LINE = 1 << 20
"""Largest number of characters in a line of a table, including the line end."""

QUOTED = re.compile('"[^"]*"')
"""Regular expression for a quoted part of a line."""

CONTROL_CHARACTER = re.compile('[\x00-\x08\x0e-\x1f]')
"""Regular expression for a control character other than white space; text files contain none."""

DATE = re.compile(r'\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d')
"""Regular expression for the start of a date with a time (ISO 8601)."""

WHOLE_DATE = re.compile(
    r'\s*(?P<minute>\d{4}-\d\d-\d\d[T ]\d\d:\d\d)'
    r'(?::(?P<second>[0-5]\d|60)(?:\.(?P<part>\d*))?)?'
    r'\s*(?:Z|UTC|GMT|(?P<sign>[+-])(?P<hours>[01]\d|2[0-3]):?(?P<minutes>[0-5]\d)?)?\s*'
)
"""Regular expression for a date with a time (ISO 8601), with or without a time zone."""

TOPIC_NAMES = ('sec', 'nanosec', LEFT_OUT, *[LEFT_OUT] * 13, 'angular_velocity_x')
TOPIC_NAMES += ('angular_velocity_y', 'angular_velocity_z', *[LEFT_OUT] * 9)
TOPIC_NAMES += tuple(f'linear_acceleration_{axis}' for axis in 'xyz') + (LEFT_OUT,) * 9
"""Names of the columns that ``ros2 topic echo --csv`` writes without a header; '-' for columns that
are not used. The third column is the frame_id."""


def open_table(path: Path, options: ReadOptions) -> Recording:
    """Open a table of numbers in a text file as a recording.

    Raises AllanError when the file is not a table, when it has no rows, when neither the file nor
    the options name its columns, when no column is an axis, when two columns are the same axis,
    when the unit of an axis or of the times is unknown, or when there are neither times nor a rate
    in the options.
    """
    with _text(path) as file:
        table = _layout(path, file, options)
    info = SourceInfo(str(path), '', 'table', 'tsv' if table.delimiter == '\t' else 'csv')
    read_options = options.with_units(table.columns.units)
    return Recording(info, None, table.read, table.temperature, read_options, table.columns.given)


@dataclass
class _SampleTable:
    """A table of samples: its layout, and temperatures in some of the rows that were read."""

    path: Path
    delimiter: str  # ',', ';' or tab; '' for white space
    width: int  # number of columns
    names: tuple[str, ...]
    header_line: int  # number of the line with the names; 0 without a header
    columns: ColumnLayout
    rate_hz: float  # sample rate if there are no stamps
    # stamp in ns, and temperature in degC, of some of the rows
    _temperatures: Decimated[tuple[int, float]] = field(default_factory=Decimated)

    def read(self, report: Report) -> Iterator[ImuBatch]:
        """Yield the samples in order, in SI; call ``report`` with each finding."""
        self._temperatures = Decimated()
        for sensor, name in self.columns.assumed.items():
            unit = SAMPLE_SI[sensor]
            report(finding('unit_assumed', path=self.path, sensor=sensor, unit=unit, name=name))
        if unit := self.columns.time_unit:
            name = self.names[self.columns.stamp[0][0]]
            report(finding('stamp_unit_assumed', path=self.path, unit=unit, name=name))
        unrecognized, missing_axes = self.columns.unrecognized, len(AXES) - len(self.columns.axes)
        if 0 < missing_axes <= len(unrecognized):
            report(finding('columns_unrecognized', path=self.path, names=column_list(unrecognized)))
        column, unit = self.columns.temperature or (None, '')
        with _text(self.path) as file:
            for rows in self._rows(file, report):
                batch = rows.batch()
                if column is not None:
                    celsius = (row[column] for row in rows.cells)
                    for stamp, cell in zip(batch.stamps_ns.tolist(), celsius):
                        value = _number(cell) if _is_number(cell) else np.nan
                        self._temperatures.add((stamp, to_celsius(value, unit)))
                yield batch

    def temperature(self, frame_id: str = '') -> TemperatureTrace | None:
        """Return the temperature over time; None if no row that was read has a plausible one."""
        if self.columns.temperature is None:
            return None
        column, _ = self.columns.temperature
        readings = [(stamp, stamp, celsius) for stamp, celsius in self._temperatures]
        return trace_of(self.names[column].strip(), readings)

    def _rows(self, file: TextIO, report: Report) -> Iterator[_TableRows]:
        """Yield the rows in groups of at most `BATCH` rows with one frame_id each.

        A last line without a line end is not used, because the last number in it may be truncated.
        """
        lines, rows = _Lines(self, file), _TableRows(self)
        try:
            for cells in _split(lines, self.delimiter):
                if not lines.complete:
                    report(finding('table_cut', path=self.path, line=lines.number))
                    break
                if len(rows.cells) == BATCH or lines.frame_id != rows.frame_id:
                    if rows.cells:
                        yield rows
                    rows = _TableRows(self, rows.first + len(rows.cells), lines.frame_id)
                rows.numbers.append(lines.number)
                rows.cells.append(cells)
        except csv.Error as error:
            if lines.complete:
                raise AllanError(
                    f'{self.path}: line {lines.number} is not a row of a table ({error}): '
                    'correct or remove it'
                ) from error
            report(finding('table_cut', path=self.path, line=lines.number))
        if rows.cells:
            yield rows


def _layout(path: Path, file: TextIO, options: ReadOptions) -> _SampleTable:
    comment = ''
    lines = _bounded_lines(path, file)
    number = 0
    for number, line in enumerate(lines, 1):  # noqa: B007
        if line.startswith(COMMENT_MARKS):
            comment = line
        elif not line.isspace():
            break
    else:
        raise AllanError(f'{path}: has no line of data: record or export it again')
    if CONTROL_CHARACTER.search(line):
        raise AllanError(f'{path}: is UTF-16 or not text: save the table as UTF-8')
    delimiter = next((mark for mark in '\t;,' if mark in QUOTED.sub('', line)), '')
    further_lines = (
        further_line
        for further_line in lines
        if not further_line.startswith(COMMENT_MARKS) and not further_line.isspace()
    )
    rows = _split(chain([line], further_lines), delimiter)
    try:
        first_cells = tuple(cell.strip() for cell in next(rows))
        number += getattr(rows, 'line_num', 1) - 1  # a header may contain quoted line breaks
        comment_cells = next(_split([comment.lstrip('#/ ')], delimiter)) if comment else []
    except (csv.Error, StopIteration) as error:
        raise AllanError(
            f'{path}: line {number} is not a row of a table: correct the file'
        ) from error
    names, header_line = _names(path, first_cells, comment_cells, number, options.columns)
    next_rows = [] if header_line else [list(first_cells)]
    try:
        next_rows += islice(rows, FIRST_ROWS)
    except csv.Error:  # `_SampleTable.read` reports the error
        next_rows = next_rows or [[]]
    columns = columns_of(path, names, options)
    columns.check(path, names, bool(options.rate_hz), header_line)
    if not next_rows:
        raise AllanError(f'{path}: has no line after its header: record or export it again')
    if len(columns.stamp) == 1:
        ((column, _),) = columns.stamp
        cells = [row[column] for row in next_rows if len(row) > column]
        if cells and DATE.match(cells[0]):
            columns = replace(columns, stamp=((column, DATES),))
        else:
            times = list(map(_number, takewhile(_is_number, cells))) or [0.0]
            columns = columns.with_time_unit(path, np.array(times), options.stamp_unit)
    return _SampleTable(
        path, delimiter, len(first_cells), names, header_line, columns, options.rate_hz
    )


def _names(
    path: Path,
    first_cells: tuple[str, ...],
    comment_cells: list[str],
    number: int,
    columns: tuple[str, ...],
) -> tuple[tuple[str, ...], int]:
    """Return the names of the columns, and the number of the header line (0 without a header).

    Parameters
    ----------
    path : Path
        Path of the table.
    first_cells : tuple of str
        Cells of the first row, before which there are only comments and blank lines.
    comment_cells : list of str
        Cells of the last comment before the first row.
    number : int
        Number of the line in the file in which the first row ends; a quoted cell may contain line
        breaks.
    columns : tuple of str
        Names of the columns according to the options.

    Raises
    ------
    AllanError
        When neither the file nor the options state names, or the names in the options do not match
        the columns.
    """
    given_names = tuple(name.strip() for name in columns)
    are_pairs = bool(given_names) and all('=' in name for name in given_names)
    if given_names and not are_pairs:
        if len(given_names) != len(first_cells):
            raise AllanError(
                f'{path}: line {number} has {len(first_cells)} columns, but --columns names '
                f'{len(given_names)}: name each ({LEFT_OUT} excludes a column), state some as in '
                'gx=NAME, or remove lines above the table'
            )
        used_cells = [cell for name, cell in zip(given_names, first_cells) if name != LEFT_OUT]
        return given_names, 0 if all(map(_is_value, used_cells)) else number
    are_values = [_is_value(cell) for cell in first_cells]
    if len(first_cells) == len(TOPIC_NAMES) and are_values.count(False) == 1 and not are_values[2]:
        return TOPIC_NAMES, 0
    if not all(are_values):
        names, header_line = first_cells, number
    elif len(comment_cells) == len(first_cells) and not all(map(_is_value, comment_cells)):
        names, header_line = tuple(cell.strip() for cell in comment_cells), 0
    else:
        raise AllanError(
            f'{path}: has {len(first_cells)} columns of numbers and no header: '
            f'name them in their order in the file, such as --columns {EXAMPLE_COLUMNS} '
            f'({LEFT_OUT} excludes a column)'
        )
    if are_pairs:
        return picked_names(f'{path}: line {number}', names, given_names), header_line
    return names_by_file(path.stem, names), header_line


def _number(cell: str) -> float:
    """Convert a cell to a number; a cell in quotes may contain a decimal comma."""
    return float(cell.replace(',', '.'))


def _is_number(cell: str) -> bool:
    try:
        _number(cell)
    except ValueError:
        return False
    return True


def _is_value(cell: str) -> bool:
    return _is_number(cell) or bool(DATE.match(cell))


def _text(path: Path) -> TextIO:
    # an invalid byte is replaced by a character that is later reported as not a number
    return TextIOWrapper(open_regular(path), encoding='utf-8-sig', errors='replace', newline=None)


def _bounded_lines(path: Path, file: TextIO) -> Iterator[str]:
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
    """Yield the cells of each row.

    If ``delimiter`` is '', cells are separated by white space, and quotes have no meaning.
    Otherwise, a quoted cell may contain line breaks and delimiters, and csv.Error is raised when a
    quote is misplaced or not closed, or a cell has more than 128 Ki characters. A comma that is not
    the delimiter is a decimal mark.
    """
    if delimiter != ',':
        lines = (line.replace(',', '.') for line in lines)
    if not delimiter:
        return map(str.split, lines)
    return csv.reader(lines, delimiter=delimiter, skipinitialspace=True, strict=True)


class _Lines:
    """Iterates over the lines of a table after its header, without comments and empty lines.

    ``number`` is the number of the last line that was read; the first line has the number 1.
    ``frame_id`` is taken from the last comment that contains a frame_id. ``complete`` states
    whether the last row that was read has a line end.
    """

    def __init__(self, table: _SampleTable, file: TextIO) -> None:
        self.number = 0
        self.frame_id = ''
        self.complete = True
        self._table, self._file = table, file

    def __iter__(self) -> Iterator[str]:
        for line in _bounded_lines(self._table.path, self._file):
            self.number += 1
            if line.startswith(COMMENT_MARKS):
                if line.startswith(FRAME_COMMENT):
                    self.frame_id = line[len(FRAME_COMMENT) :].strip()
            elif self.number > self._table.header_line and not line.isspace():
                self.complete = line.endswith('\n')
                yield line


@dataclass
class _TableRows:
    """Consecutive rows of a table with one frame_id, as text."""

    table: _SampleTable
    first: int = 0  # index of the first of these rows in the table
    frame_id: str = ''
    numbers: list[int] = field(default_factory=list)  # line number of each row
    cells: list[list[str]] = field(default_factory=list)

    def batch(self) -> ImuBatch:
        """Convert the rows to samples; raise AllanError when a row or value is invalid."""
        table, n = self.table, len(self.cells)
        layout = table.columns
        for number, row in zip(self.numbers, self.cells):
            if len(row) != table.width:
                raise AllanError(
                    f'{table.path}: line {number} has {len(row)} columns, {table.width} expected: '
                    'correct or remove the line'
                )
        samples = np.full((n, len(AXES)), np.nan)
        for axis, (column, scale) in layout.axes.items():
            samples[:, axis] = self._floats(column)
            if scale != 1.0:
                samples[:, axis] *= scale
        stamps, record = (
            sum((self._nanoseconds(*entry) for entry in entries), np.zeros(n, np.int64))
            for entries in (layout.stamp, layout.record)
        )
        if not layout.stamp:
            stamps = even_stamps(self.first, n, table.rate_hz)
        return ImuBatch(stamps, samples, record if layout.record else None, self.frame_id)

    def _floats(self, column: int) -> NDArray[np.float64]:
        """Convert a column to numbers; an empty cell becomes NaN."""
        with suppress(ValueError):
            return np.array([float(row[column]) for row in self.cells])
        return np.array(self._converted(column, lambda cell: float(cell or 'nan')))

    def _nanoseconds(self, column: int, scale: int) -> NDArray[np.int64]:
        """Convert a column of times to ns; the only error is the rounding to whole ns.

        Dates are rounded down. ``scale`` is the size of the unit of the times in ns, or `DATES`.
        """
        if scale == 1:
            with suppress(ValueError, OverflowError):
                return np.array([int(row[column]) for row in self.cells], dtype=np.int64)
        in_ns = _date if scale == DATES else lambda cell: round(Decimal(cell) * scale)
        times = self._converted(column, in_ns)
        for row, time in enumerate(times):
            if not INT64.min <= time <= INT64.max:
                raise AllanError(
                    f'{self.table.path}: line {self.numbers[row]}, column {column + 1}: the time '
                    f'{self.cells[row][column].strip()} does not fit the range of stamps: state '
                    'its unit with --stamp-unit (s, ms, us, ns)'
                )
        return np.array(times, np.int64)

    def _converted(self, column: int, convert: Callable[[str], T]) -> list[T]:
        converted = []
        for row, cells in enumerate(self.cells):
            cell = cells[column].strip().replace(',', '.')
            try:
                converted.append(convert(cell))
            except (DecimalException, ValueError, OverflowError):
                name = f' ({self.table.names[column]})' if self.table.names else ''
                raise AllanError(
                    f'{self.table.path}: line {self.numbers[row]}, column {column + 1}{name}: '
                    f'{cell[:40]!r} is not a number: correct or remove the line'
                ) from None
        return converted


def _date(text: str) -> int:
    """Convert a date with a time (ISO 8601) to ns since 1970; raise ValueError for invalid text."""
    match = WHOLE_DATE.fullmatch(text)
    if not match:
        raise ValueError('not a date')
    minutes = int(np.datetime64(match['minute'].replace(' ', 'T'), 'm').astype(np.int64))
    if match['sign']:
        offset = 60 * int(match['hours']) + int(match['minutes'] or 0)
        minutes -= int(f'{match["sign"]}1') * offset
    fraction = f'{match["part"] or "":0<9}'[:9]
    return (60 * minutes + int(match['second'] or 0)) * 10**9 + int(fraction)
