# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads and writes tables of samples: CSV, TSV, and columns separated by spaces.

Tables are written without loss of precision, with stamps in ns, samples in SI, and the frame_id in
a comment::

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

from ...core.errors import AllanError
from ...core.findings import finding
from ...core.imu import AXES, SAMPLE_SI, ImuBatch, even_stamps
from ..files import open_regular
from ..signal import Decimated, TemperatureTrace, trace_of
from .columns import DATES, LEFT_OUT, Columns, columns_of, listed, picked_names
from .recording import BATCH, ReadOptions, Recording, Report, SourceInfo

T = TypeVar('T')

FRAME_COMMENT = '# frame_id:'

COMMENT = '#'

INT64 = np.iinfo(np.int64)

MAX_LINE = 1 << 20
"""Longest line of a table, in characters."""

EXAMPLE_COLUMNS = 't,gx,gy,gz,ax,ay,az'

FIRST_ROWS = 200
"""Number of rows from which the unit of the stamps is recognized."""

DATE = re.compile(r'\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d')
"""Start of a date with a time (ISO 8601)."""

TIME_ZONE = re.compile(r'([+-])(\d\d):?(\d\d)$|Z$')
"""End of a date with a time zone."""

TOPIC_NAMES = ('sec', 'nanosec', LEFT_OUT, *[LEFT_OUT] * 13, 'angular_velocity_x')
TOPIC_NAMES += ('angular_velocity_y', 'angular_velocity_z', *[LEFT_OUT] * 9)
TOPIC_NAMES += tuple(f'linear_acceleration_{axis}' for axis in 'xyz') + (LEFT_OUT,) * 9
"""Columns of ``ros2 topic echo --csv``, which writes no header. The third is the frame_id."""


@dataclass(frozen=True)
class _Table:
    """The layout of a table."""

    path: Path
    delimiter: str  # ',', ';' or tab; '' for white space
    width: int  # number of columns
    names: tuple[str, ...]
    header_line: int  # number of the line with the names; 0 without a header
    columns: Columns
    rate_hz: float  # sample rate if there are no stamps


def open_table(path: Path, options: ReadOptions) -> Recording:
    """Open a table of numbers in a text file as a recording.

    Raises AllanError when it has no rows, when it has no axis, or when the times are unknown.
    """
    with _text(path) as file:
        table = _read_layout(path, file, options)
    info = SourceInfo(str(path), '', 'table', 'tsv' if table.delimiter == '\t' else 'csv')
    reader = _Reader(table)
    return Recording(
        info,
        None,
        reader.read,
        lambda frame_id: reader.temperature(),
        options.with_units(table.columns.units),
        table.columns.given,
    )


def _read_layout(path: Path, file: TextIO, options: ReadOptions) -> _Table:
    """Return the layout of a table, from its first lines and the options."""
    comment = ''
    lines = _bounded_lines(path, file)
    number = 0
    for number, line in enumerate(lines, 1):  # noqa: B007
        if line.startswith(COMMENT):
            comment = line
        elif not line.isspace():
            break
    else:
        raise AllanError(f'{path}: has no line of data: record or export it again')
    if '\0' in line:
        raise AllanError(f'{path}: is UTF-16 or not text: save the table as UTF-8')
    delimiter = next((mark for mark in '\t;,' if mark in line), '')
    more = (one for one in lines if not one.startswith(COMMENT) and not one.isspace())
    rows = _split(chain([line], more), delimiter)
    try:
        first = tuple(cell.strip() for cell in next(rows))
        number += getattr(rows, 'line_num', 1) - 1  # a header may contain quoted line breaks
        above = next(_split([comment.lstrip('# ')], delimiter)) if comment else []
    except (csv.Error, StopIteration) as error:
        raise AllanError(
            f'{path}: line {number} is not a row of a table: correct the file'
        ) from error
    names, header_line = _names(path, first, above, number, options.columns)
    next_rows = [] if header_line else [list(first)]
    empty = False
    with suppress(csv.Error):  # reported when the line is read
        next_rows += islice(rows, FIRST_ROWS)
        empty = not next_rows
    if empty:
        raise AllanError(f'{path}: has no line after its header: record or export it again')
    columns = columns_of(path, names, options)
    _check_complete(path, names, columns, options)
    if len(columns.stamp) == 1:
        columns = _with_times(path, columns, next_rows, options.stamp_unit)
    return _Table(path, delimiter, len(first), names, header_line, columns, options.rate_hz)


def _names(
    path: Path, first: tuple[str, ...], above: list[str], number: int, columns: tuple[str, ...]
) -> tuple[tuple[str, ...], int]:
    """Return the names of the columns, and the number of the line that contains them or 0.

    ``first`` are the cells of the first line, which is line ``number``, and ``above`` those of the
    last comment before it. ``columns`` are the names in the options.
    """
    given = tuple(name.strip() for name in columns)
    picked = bool(given) and all('=' in name for name in given)
    if given and not picked:
        if len(given) != len(first):
            raise AllanError(
                f'{path}: has {len(first)} columns, {len(given)} are named by --columns: '
                f'name each ({LEFT_OUT} leaves one out), or pick some as in gx=NAME'
            )
        used = [cell for name, cell in zip(given, first) if name != LEFT_OUT]
        return given, 0 if all(map(_is_value, used)) else number
    if not all(map(_is_value, first)):
        values = [_is_value(cell) for cell in first]
        if len(first) == len(TOPIC_NAMES) and values.index(False) == 2 and sum(values) == 39:
            return TOPIC_NAMES, 0
        names, line = first, number
    elif len(above) == len(first) and not all(map(_is_value, above)):
        names, line = tuple(cell.strip() for cell in above), 0
    else:
        raise AllanError(
            f'{path}: has {len(first)} columns of numbers and no header: '
            f'name them, such as --columns {EXAMPLE_COLUMNS} ({LEFT_OUT} leaves one out)'
        )
    return (picked_names(path, names, given) if picked else names), line


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_value(cell: str) -> bool:
    """Return whether a cell is a number or a date."""
    return _is_number(cell) or bool(DATE.match(cell))


def _with_times(path: Path, columns: Columns, rows: list[list[str]], stated: str) -> Columns:
    """Return the columns with the unit of the stamps, which is recognized from the first rows."""
    ((column, _),) = columns.stamp
    cells = [row[column] for row in rows if len(row) > column]
    if cells and DATE.match(cells[0]):
        return replace(columns, stamp=((column, DATES),))
    times = list(map(float, takewhile(_is_number, cells)))
    return columns.with_time_unit(path, np.array(times or [0.0]), stated)


def _check_complete(
    path: Path, names: tuple[str, ...], columns: Columns, options: ReadOptions
) -> None:
    """Raise AllanError if there is no axis, or if the times are missing."""
    if not columns.axes:
        raise AllanError(
            f'{path}: no column ({listed(names)}) is a gyro or accel axis: name them, such as '
            f'--columns {EXAMPLE_COLUMNS} ({LEFT_OUT} leaves one out), or t=NAME,gx=NAME,...'
        )
    if not columns.stamp and not options.rate_hz:
        raise AllanError(
            f'{path}: no column ({listed(names)}) contains the time: state the sample rate '
            'with --rate, or name the column with --columns'
        )


def write_table(path: Path, batches: Iterable[ImuBatch]) -> int:
    """Write the batches as a table, and return the number of rows.

    The delimiter is a tab if the suffix is .tsv, else a comma. Raises AllanError when only some of
    the batches have record times.
    """
    delimiter = '\t' if path.suffix.lower() == '.tsv' else ','
    written = 0
    frame_id: str | None = None
    with_record: bool | None = None
    with path.open('w', encoding='utf-8', newline='\n') as file:
        for batch in batches:
            if batch.frame_id != frame_id:
                frame_id = batch.frame_id
                file.write(f'{FRAME_COMMENT} {" ".join(frame_id.split())}\n')
            if with_record is None:
                with_record = batch.record_ns is not None
                names = ['stamp_ns', *AXES] + ['record_ns'] * with_record
                file.write(delimiter.join(names) + '\n')
            if with_record != (batch.record_ns is not None):
                raise AllanError(
                    f'{path}: some batches have record times and some do not: write a bag'
                )
            columns = [map(str, batch.stamps_ns.tolist())]
            columns += [map(repr, axis) for axis in batch.samples.T.tolist()]
            if batch.record_ns is not None:
                columns.append(map(str, batch.record_ns.tolist()))
            file.writelines(delimiter.join(row) + '\n' for row in zip(*columns))
            written += len(batch)
    return written


def _text(path: Path) -> TextIO:
    # an invalid byte is replaced, and then reported as a value that is not a number
    return TextIOWrapper(open_regular(path), encoding='utf-8-sig', errors='replace', newline=None)


def _bounded_lines(path: Path, file: TextIO) -> Iterator[str]:
    """Yield the lines of a text file; raise AllanError when one is longer than `MAX_LINE`."""
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
    """Yield the cells of each row; a quoted cell may contain line breaks.

    Without a delimiter, cells are separated by white space. A comma that is no delimiter is a
    decimal mark. Raises csv.Error when a quote is not closed, or a cell is longer than 128 kB.
    """
    if delimiter != ',':
        lines = (line.replace(',', '.') for line in lines)
    if not delimiter:
        return map(str.split, lines)
    return csv.reader(lines, delimiter=delimiter, strict=True)


class _Lines:
    """Iterates over the lines of a table after its header, without comments and empty lines.

    ``number`` is the number of the last line that was read, from 1 on. ``frame_id`` is taken from
    the last comment that contains one. ``complete`` is whether the last line has a line end.
    """

    def __init__(self, table: _Table, file: TextIO) -> None:
        self.number = 0
        self.frame_id = ''
        self.complete = True
        self._table, self._file = table, file

    def __iter__(self) -> Iterator[str]:
        for line in _bounded_lines(self._table.path, self._file):
            self.number += 1
            if line.startswith(COMMENT):
                if line.startswith(FRAME_COMMENT):
                    self.frame_id = line[len(FRAME_COMMENT) :].strip()
            elif self.number > self._table.header_line and not line.isspace():
                self.complete = line.endswith('\n')
                yield line


@dataclass
class _Rows:
    """Consecutive rows with one frame_id."""

    table: _Table
    first: int = 0  # index of the first row in the table
    frame_id: str = ''
    numbers: list[int] = field(default_factory=list)  # line number of each row
    cells: list[list[str]] = field(default_factory=list)

    def batch(self) -> ImuBatch:
        """Convert the rows to samples; raise AllanError when a row or value is invalid."""
        table, n = self.table, len(self.cells)
        meaning = table.columns
        for number, row in zip(self.numbers, self.cells):
            if len(row) != table.width:
                raise AllanError(
                    f'{table.path}: line {number} has {len(row)} columns, {table.width} expected: '
                    'correct or remove the line'
                )
        samples = np.full((n, len(AXES)), np.nan)
        for axis, (column, scale) in meaning.axes.items():
            samples[:, axis] = self._floats(column)
            if scale != 1.0:
                samples[:, axis] *= scale
        stamps, record = (
            sum((self._nanoseconds(*part) for part in parts), np.zeros(n, np.int64))
            for parts in (meaning.stamp, meaning.record)
        )
        if not meaning.stamp:
            stamps = even_stamps(self.first, n, table.rate_hz)
        return ImuBatch(stamps, samples, record if meaning.record else None, self.frame_id)

    def _floats(self, column: int) -> NDArray[np.float64]:
        """Convert a column to numbers; an empty cell becomes NaN."""
        with suppress(ValueError):
            return np.array([float(row[column]) for row in self.cells])
        return np.array(self._converted(column, lambda cell: float(cell or 'nan')))

    def _nanoseconds(self, column: int, scale: int) -> NDArray[np.int64]:
        """Convert a column of times exactly to ns; ``scale`` is the size of its unit in ns."""
        if scale == 1:
            with suppress(ValueError, OverflowError):
                return np.array([int(row[column]) for row in self.cells], dtype=np.int64)
        date = scale == DATES
        times = self._converted(
            column, _date if date else lambda cell: round(Decimal(cell) * scale)
        )
        for row, time in enumerate(times):
            if not INT64.min <= time <= INT64.max:
                raise AllanError(
                    f'{self.table.path}: line {self.numbers[row]}, column {column + 1}: the time '
                    f'{self.cells[row][column].strip()} does not fit the range of stamps: state '
                    'its unit with --stamp-unit (s, ms, us, ns)'
                )
        return np.array(times, np.int64)

    def _converted(self, column: int, convert: Callable[[str], T]) -> list[T]:
        """Convert each cell of a column; raise AllanError for the first invalid one."""
        converted = []
        for row, cells in enumerate(self.cells):
            try:
                converted.append(convert(cells[column].strip()))
            except (DecimalException, ValueError, OverflowError):
                raise self._not_a_number(row, column) from None
        return converted

    def _not_a_number(self, row: int, column: int) -> AllanError:
        cell = self.cells[row][column].strip()[:40]
        name = f' ({self.table.names[column]})' if self.table.names else ''
        return AllanError(
            f'{self.table.path}: line {self.numbers[row]}, column {column + 1}{name}: {cell!r} is '
            'not a number: correct or remove the line'
        )


def _date(text: str) -> int:
    """Convert a date with a time (ISO 8601) to ns since 1970; raise ValueError if it is invalid."""
    if not DATE.match(text):
        raise ValueError('not a date')
    zone = TIME_ZONE.search(text)
    stamp = int(np.datetime64(TIME_ZONE.sub('', text), 'ns').astype(np.int64))
    if zone and zone[1]:
        stamp -= int(zone[1] + '1') * (60 * int(zone[2]) + int(zone[3])) * 60 * 10**9
    return stamp


class _Reader:
    """Reads the samples of a table, and keeps rows for the temperature."""

    def __init__(self, table: _Table) -> None:
        self._table = table
        self._kept: Decimated[tuple[int, float]] = Decimated()

    def read(self, report: Report) -> Iterator[ImuBatch]:
        """Yield the samples in order."""
        table = self._table
        self._kept = Decimated()
        for sensor, name in table.columns.assumed.items():
            unit = SAMPLE_SI[sensor]
            report(finding('unit_assumed', path=table.path, sensor=sensor, unit=unit, name=name))
        if unit := table.columns.time_unit:
            name = table.names[table.columns.stamp[0][0]]
            report(finding('stamp_unit_assumed', path=table.path, unit=unit, name=name))
        column = table.columns.temperature
        with _text(table.path) as file:
            for rows in self._rows(file, report):
                batch = rows.batch()
                if column is not None:
                    celsius = (row[column] for row in rows.cells)
                    for stamp, cell in zip(batch.stamps_ns.tolist(), celsius):
                        self._kept.add((stamp, float(cell) if _is_number(cell) else np.nan))
                yield batch

    def temperature(self) -> TemperatureTrace | None:
        """Return the temperature over time; None if the table has no such column."""
        column = self._table.columns.temperature
        if column is None:
            return None
        readings = [(stamp, stamp, celsius) for stamp, celsius in self._kept]
        return trace_of(self._table.names[column].strip(), readings)

    def _rows(self, file: TextIO, report: Report) -> Iterator[_Rows]:
        """Yield the rows in groups of at most `BATCH` rows with one frame_id each.

        The last line is not used if it has no line end, because its last number may be truncated.
        """
        table = self._table
        lines, rows = _Lines(table, file), _Rows(table)
        try:
            for cells in _split(lines, table.delimiter):
                if not lines.complete:
                    report(finding('table_cut', path=table.path, line=lines.number))
                    break
                if len(rows.cells) == BATCH or lines.frame_id != rows.frame_id:
                    if rows.cells:
                        yield rows
                    rows = _Rows(table, rows.first + len(rows.cells), lines.frame_id)
                rows.numbers.append(lines.number)
                rows.cells.append(cells)
        except csv.Error as error:
            if lines.complete:
                raise AllanError(
                    f'{table.path}: line {lines.number} is not a row of a table ({error}): '
                    'correct or remove it'
                ) from error
            report(finding('table_cut', path=table.path, line=lines.number))
        if rows.cells:
            yield rows
