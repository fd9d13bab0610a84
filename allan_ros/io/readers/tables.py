# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""CSV and TSV, read line by line and written so that every bit comes back.

The form written here has int64 nanosecond stamps, shortest round-trip floats in SI, and the frame
in a comment::

    # frame_id: imu_link
    stamp_ns,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z
    1600000000000000000,0.001,-0.002,0.0,0.01,-0.02,9.81
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from contextlib import suppress
from decimal import Decimal, DecimalException
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from ...core.errors import AllanError
from ...core.findings import finding
from ...core.imu import AXES, ImuBatch
from ..signal import Decimated, TemperatureTrace, trace_of
from .recording import BATCH, ReadOptions, Recording, Report, SourceInfo
from .table_columns import TableLayout, is_number, read_layout

FRAME_COMMENT = '# frame_id:'

COMMENT = '#'

INT64 = np.iinfo(np.int64)


def open_table(path: Path, options: ReadOptions) -> Recording:
    """Open a table of numbers as a recording.

    Raises
    ------
    AllanError
        When it has no rows, or its columns are not understood.
    """
    with _text(path) as file:
        layout = read_layout(path, file, options)
    info = SourceInfo(str(path), '', 'table', 'tsv' if layout.delimiter == '\t' else 'csv')
    return Recording(
        info,
        None,
        lambda report: _read(path, layout, report),
        lambda frame_id: _temperature(path, layout),
    )


def write_table(path: Path, batches: Iterable[ImuBatch]) -> int:
    """Write the batches in the form above and return how many rows there are.

    Raises
    ------
    AllanError
        When only some of the batches have record times.
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
    # A byte that is no text turns up as a cell that is no number, with its line and column.
    return path.open(encoding='utf-8-sig', errors='replace', newline=None)


def _read(path: Path, layout: TableLayout, report: Report) -> Iterator[ImuBatch]:
    """Yield the rows as batches; a comment that names another frame starts a new one."""
    frame_id = ''
    first_row = 0
    numbers: list[int] = []
    lines: list[str] = []
    with _text(path) as file:
        for number, line in enumerate(file, 1):
            if line.startswith(COMMENT):
                if line.startswith(FRAME_COMMENT):
                    if lines:
                        yield _batch(path, layout, numbers, lines, first_row, frame_id)
                        first_row += len(lines)
                        numbers, lines = [], []
                    frame_id = line[len(FRAME_COMMENT) :].strip()
                continue
            if number <= layout.header_line or line.isspace():
                continue
            numbers.append(number)
            lines.append(line)
            if len(lines) == BATCH:
                if not line.endswith('\n'):
                    _drop_cut_line(path, layout, numbers, lines, report)
                yield _batch(path, layout, numbers, lines, first_row, frame_id)
                first_row += len(lines)
                numbers, lines = [], []
    if lines and not lines[-1].endswith('\n'):
        _drop_cut_line(path, layout, numbers, lines, report)
    if lines:
        yield _batch(path, layout, numbers, lines, first_row, frame_id)


def _temperature(path: Path, layout: TableLayout) -> TemperatureTrace | None:
    """Return the column of the temperature, if there is one."""
    column = layout.temperature
    if column is None:
        return None
    kept: Decimated[tuple[int, str]] = Decimated()
    row = 0
    with _text(path) as file:
        for number, line in enumerate(file, 1):
            if number > layout.header_line and not line.startswith(COMMENT) and line.strip():
                kept.add((row, line))
                row += 1
    readings = []
    for row, line in kept:
        cells = layout.split([line])[0]
        with suppress(ValueError, IndexError, DecimalException):  # a line that is cut off
            if layout.stamp:
                stamp = sum(round(Decimal(cells[at].strip()) * size) for at, size in layout.stamp)
            else:
                stamp = round(row * 1e9 / layout.rate_hz)
            readings.append((stamp, stamp, float(cells[column])))
    return trace_of(layout.names[column].strip(), readings)


def _drop_cut_line(
    path: Path, layout: TableLayout, numbers: list[int], lines: list[str], report: Report
) -> None:
    """Leave out a last line that was not written to its end."""
    if len(layout.split(lines[-1:])[0]) < layout.width:
        report(finding('table_cut', path=path, line=numbers[-1]))
        del numbers[-1], lines[-1]


def _batch(
    path: Path,
    layout: TableLayout,
    numbers: list[int],
    lines: list[str],
    first_row: int,
    frame_id: str,
) -> ImuBatch:
    try:
        rows = layout.split(lines)
    except csv.Error as error:
        raise _no_table(path, layout, numbers, lines) from error
    if set(map(len, rows)) - {layout.width} or len(rows) != len(lines):
        raise _wrong_width(path, layout, numbers, rows)
    cells = list(zip(*rows))
    samples = np.full((len(rows), len(AXES)), np.nan)
    for axis, (column, scale) in layout.axes.items():
        samples[:, axis] = _floats(path, layout, numbers, cells[column], column)
        if scale != 1.0:
            samples[:, axis] *= scale

    def nanoseconds(columns: tuple[tuple[int, int], ...]) -> NDArray[np.int64]:
        total = np.zeros(len(rows), np.int64)
        for column, scale in columns:
            total += _nanoseconds(path, layout, numbers, cells[column], column, scale)
        return total

    if layout.stamp:
        stamps = nanoseconds(layout.stamp)
    else:
        rate_ns = 1e9 / layout.rate_hz
        stamps = np.rint(np.arange(first_row, first_row + len(rows)) * rate_ns).astype(np.int64)
    record = nanoseconds(layout.record) if layout.record else None
    return ImuBatch(stamps, samples, record, frame_id)


def _floats(
    path: Path, layout: TableLayout, numbers: list[int], cells: tuple[str, ...], column: int
) -> NDArray[np.float64]:
    """Return one column as numbers; an empty cell is a missing value."""
    try:
        return np.array(list(map(float, cells)))
    except ValueError:
        pass
    for number, cell in zip(numbers, cells):
        if cell.strip() and not is_number(cell):
            raise _not_a_number(path, layout, number, column, cell) from None
    return np.array([float(cell) if cell.strip() else np.nan for cell in cells])


def _nanoseconds(
    path: Path,
    layout: TableLayout,
    numbers: list[int],
    cells: tuple[str, ...],
    column: int,
    scale: int,
) -> NDArray[np.int64]:
    """Return one column of times in ns, exactly: a double has not the digits of a stamp."""
    if scale == 1:
        with suppress(ValueError, OverflowError):
            return np.array(list(map(int, cells)), dtype=np.int64)
    result = np.empty(len(cells), np.int64)
    for row, cell in enumerate(cells):
        try:
            value = round(Decimal(cell.strip()) * scale)
        except (DecimalException, ValueError, OverflowError):
            raise _not_a_number(path, layout, numbers[row], column, cell) from None
        if not INT64.min <= value <= INT64.max:
            raise AllanError(
                f'{path}: line {numbers[row]}, column {column + 1}: the time {cell.strip()} does '
                'not fit the years a stamp can hold: say its unit by --stamp-unit (s, ms, us, ns)'
            )
        result[row] = value
    return result


def _not_a_number(path: Path, layout: TableLayout, line: int, column: int, cell: str) -> AllanError:
    name = f' ({layout.names[column]})' if layout.names else ''
    return AllanError(
        f'{path}: line {line}, column {column + 1}{name}: {cell.strip()[:40]!r} is not a number: '
        'mend or remove the line'
    )


def _no_table(path: Path, layout: TableLayout, numbers: list[int], lines: list[str]) -> AllanError:
    for number, line in zip(numbers, lines):
        try:
            layout.split([line])
        except csv.Error as error:
            return AllanError(
                f'{path}: line {number} is no row of a table ({error}): mend the file'
            )
    return AllanError(f'{path}: is no table behind line {numbers[0]}: mend the file')


def _wrong_width(
    path: Path, layout: TableLayout, numbers: list[int], rows: list[list[str]]
) -> AllanError:
    for number, row in zip(numbers, rows):
        if len(row) != layout.width:
            return AllanError(
                f'{path}: line {number} has {len(row)} columns, {layout.width} expected: '
                'mend or remove the line'
            )
    return AllanError(f'{path}: a quote is not closed after line {numbers[0]}: mend the file')
