# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""CSV and TSV files: read row by row, and written without loss of precision.

The files written here have int64 nanosecond stamps, shortest round-trip floats in SI, and the
frame_id in a comment::

    # frame_id: imu_link
    stamp_ns,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z
    1600000000000000000,0.001,-0.002,0.0,0.01,-0.02,9.81
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from decimal import Decimal, DecimalException
from io import TextIOWrapper
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from ...core.errors import AllanError
from ...core.findings import finding
from ...core.imu import AXES, ImuBatch, even_stamps
from ..files import open_regular
from ..signal import Decimated, TemperatureTrace, trace_of
from .recording import BATCH, ReadOptions, Recording, Report, SourceInfo
from .table_columns import TableLayout, bounded_lines, is_number, read_layout

FRAME_COMMENT = '# frame_id:'

COMMENT = '#'

INT64 = np.iinfo(np.int64)


def open_table(path: Path, options: ReadOptions) -> Recording:
    """Open a table of numbers as a recording.

    Raises AllanError when it has no rows, or its columns are unknown.
    """
    with _text(path) as file:
        layout = read_layout(path, file, options)
    info = SourceInfo(str(path), '', 'table', 'tsv' if layout.delimiter == '\t' else 'csv')
    return Recording(
        info,
        None,
        lambda report: _read(path, layout, report),
        lambda frame_id: _temperature(path, layout),
        options.with_units(layout.units),
    )


def write_table(path: Path, batches: Iterable[ImuBatch]) -> int:
    """Write the batches in the form above and return the number of rows.

    Raises AllanError when only some of the batches have record times.
    """
    delimiter = '\t' if path.suffix.lower() == '.tsv' else ','
    written = 0
    frame_id = ''
    with_record: bool | None = None
    with path.open('w', encoding='utf-8', newline='\n') as file:
        for batch in batches:
            if with_record is None:
                with_record = batch.record_ns is not None
                names = ['stamp_ns', *AXES] + ['record_ns'] * with_record
                _write_frame(file, batch.frame_id)
                file.write(delimiter.join(names) + '\n')
            elif batch.frame_id != frame_id:
                _write_frame(file, batch.frame_id)
            frame_id = batch.frame_id
            if with_record != (batch.record_ns is not None):
                raise AllanError(f'{path}: some batches have record times and some have none')
            columns = [map(str, batch.stamps_ns.tolist())]
            columns += [map(repr, axis) for axis in batch.samples.T.tolist()]
            if batch.record_ns is not None:
                columns.append(map(str, batch.record_ns.tolist()))
            file.writelines(delimiter.join(row) + '\n' for row in zip(*columns))
            written += len(batch)
    return written


def _write_frame(file: TextIO, frame_id: str) -> None:
    file.write(f'{FRAME_COMMENT} {" ".join(frame_id.split())}\n')


def _text(path: Path) -> TextIO:
    # an invalid byte becomes a cell that is not a number, reported with its line and column
    return TextIOWrapper(open_regular(path), encoding='utf-8-sig', errors='replace', newline=None)


class _Lines:
    """The lines of a table after its header, without comments and empty lines.

    The last line has the ``number``, from 1, and the last comment that states one the ``frame_id``.
    """

    def __init__(self, path: Path, file: TextIO, layout: TableLayout) -> None:
        self.number = 0
        self.frame_id = ''
        self.complete = True
        self._path = path
        self._file = file
        self._header_line = layout.header_line

    def __iter__(self) -> Iterator[str]:
        for line in bounded_lines(self._path, self._file):
            self.number += 1
            if line.startswith(COMMENT):
                if line.startswith(FRAME_COMMENT):
                    self.frame_id = line[len(FRAME_COMMENT) :].strip()
            elif self.number > self._header_line and not line.isspace():
                self.complete = line.endswith('\n')
                yield line


@dataclass
class _Rows:
    """Consecutive rows of one frame: their line numbers and cells."""

    path: Path
    layout: TableLayout
    first: int = 0
    frame_id: str = ''
    numbers: list[int] = field(default_factory=list)
    cells: list[list[str]] = field(default_factory=list)

    def batch(self) -> ImuBatch:
        """Return the rows as samples."""
        layout, n = self.layout, len(self.cells)
        for number, row in zip(self.numbers, self.cells):
            if len(row) != layout.width:
                raise AllanError(
                    f'{self.path}: line {number} has {len(row)} columns, {layout.width} expected: '
                    'correct or remove the line'
                )
        columns = list(zip(*self.cells))
        samples = np.full((n, len(AXES)), np.nan)
        for axis, (column, scale) in layout.axes.items():
            samples[:, axis] = self._floats(columns[column], column)
            if scale != 1.0:
                samples[:, axis] *= scale
        times = []
        for parts in (layout.stamp, layout.record):
            total = np.zeros(n, np.int64)
            for column, scale in parts:
                total += self._nanoseconds(columns[column], column, scale)
            times.append(total)
        stamps, record = times
        if not layout.stamp:
            stamps = even_stamps(self.first, n, layout.rate_hz)
        return ImuBatch(stamps, samples, record if layout.record else None, self.frame_id)

    def _floats(self, cells: tuple[str, ...], column: int) -> NDArray[np.float64]:
        """Return one column as numbers; an empty cell is a missing value."""
        with suppress(ValueError):
            return np.array(list(map(float, cells)))
        for row, cell in enumerate(cells):
            if cell.strip() and not is_number(cell):
                raise self._not_a_number(row, column)
        return np.array([float(cell) if cell.strip() else np.nan for cell in cells])

    def _nanoseconds(self, cells: tuple[str, ...], column: int, scale: int) -> NDArray[np.int64]:
        """Return one column of times in ns, exactly: a float has too few digits for a stamp."""
        if scale == 1:
            with suppress(ValueError, OverflowError):
                return np.array(list(map(int, cells)), dtype=np.int64)
        result = np.empty(len(cells), np.int64)
        for row, cell in enumerate(cells):
            try:
                value = round(Decimal(cell.strip()) * scale)
            except (DecimalException, ValueError, OverflowError):
                raise self._not_a_number(row, column) from None
            if not INT64.min <= value <= INT64.max:
                raise AllanError(
                    f'{self.path}: line {self.numbers[row]}, column {column + 1}: the time '
                    f'{cell.strip()} does not fit the range of stamps: state its unit with '
                    '--stamp-unit (s, ms, us, ns)'
                )
            result[row] = value
        return result

    def _not_a_number(self, row: int, column: int) -> AllanError:
        cell = self.cells[row][column].strip()[:40]
        name = f' ({self.layout.names[column]})' if self.layout.names else ''
        return AllanError(
            f'{self.path}: line {self.numbers[row]}, column {column + 1}{name}: {cell!r} is not a '
            'number: correct or remove the line'
        )


def _rows(path: Path, file: TextIO, layout: TableLayout, report: Report) -> Iterator[_Rows]:
    """Yield the rows, about `BATCH` at a time; a comment with another frame_id begins new ones.

    The last line is not used if it has no line end, because its last number may be truncated.
    """
    lines = _Lines(path, file, layout)
    rows = _Rows(path, layout)
    try:
        for cells in layout.rows(lines):
            if not lines.complete:
                report(finding('table_cut', path=path, line=lines.number))
                break
            if len(rows.cells) == BATCH or lines.frame_id != rows.frame_id:
                if rows.cells:
                    yield rows
                rows = _Rows(path, layout, rows.first + len(rows.cells), lines.frame_id)
            rows.numbers.append(lines.number)
            rows.cells.append(cells)
    except csv.Error as error:
        if lines.complete:
            raise AllanError(
                f'{path}: line {lines.number} is not a row of a table ({error}): '
                'correct or remove it'
            ) from error
        report(finding('table_cut', path=path, line=lines.number))
    if rows.cells:
        yield rows


def _read(path: Path, layout: TableLayout, report: Report) -> Iterator[ImuBatch]:
    """Yield the rows as batches."""
    for sensor, (unit, name) in layout.assumed.items():
        report(finding('unit_assumed', path=path, sensor=sensor, unit=unit, name=name))
    with _text(path) as file:
        for rows in _rows(path, file, layout, report):
            yield rows.batch()


def _temperature(path: Path, layout: TableLayout) -> TemperatureTrace | None:
    """Return the temperature column, if there is one."""
    column = layout.temperature
    if column is None:
        return None
    kept: Decimated[tuple[int, list[str]]] = Decimated()
    with _text(path) as file:
        for row, cells in enumerate(layout.rows(_Lines(path, file, layout))):
            kept.add((row, cells))
    readings = []
    for row, cells in kept:
        with suppress(ValueError, IndexError, DecimalException):  # a truncated line
            if layout.stamp:
                stamp = sum(round(Decimal(cells[at].strip()) * size) for at, size in layout.stamp)
            else:
                stamp = round(row * 1e9 / layout.rate_hz)
            readings.append((stamp, stamp, float(cells[column])))
    return trace_of(layout.names[column].strip(), readings)
