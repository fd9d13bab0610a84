# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads samples from memory and from numpy files: ``.npz`` with the array ``imu``, or ``.npy``.

The columns of a file are t, gx, gy, gz, ax, ay, az (s, rad/s, m/s^2), or some of them (`NAMES`), or
those in the options. In a ``.npz`` file, the array ``stamps_ns`` (int64) replaces t, and
``record_ns`` (int64) and ``frame_id`` (one string) are optional. Files are read in blocks of rows,
so the memory does not depend on their size.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from io import BytesIO
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ...core.errors import AllanError
from ...core.fields import MAX_INTEGER
from ...core.findings import finding
from ...core.imu import AXES, SENSORS, STAMP_UNITS, ImuBatch, even_stamps
from ..files import open_regular
from .columns import Columns, columns_of, listed
from .recording import BATCH, ReadOptions, Recording, Report, SourceInfo, in_batches
from .storage import translated

COLUMNS = 't, gx, gy, gz, ax, ay, az'

NAMES = {1: 'gx', 3: 'gx,gy,gz', 4: 't,gx,gy,gz', 6: 'gx,gy,gz,ax,ay,az', 7: 't,gx,gy,gz,ax,ay,az'}
"""Number of columns of an array -> their names."""

SAMPLES, STAMPS, RECORD, FRAME = 'imu', 'stamps_ns', 'record_ns', 'frame_id'

FIRST_ROWS = 200
"""Number of rows from which the unit of the stamps is recognized."""

MAX_FRAME_BYTES = 4096
"""Largest size of a frame_id in bytes."""

MAX_HEADER_BYTES = 1 << 16
"""Number of bytes within which the header of an array ends."""


class _Column:
    """An array in a numpy file, which is read block by block.

    ``name`` is its name in a .npz file, or '' for a .npy file. ``stack`` closes the files.
    """

    def __init__(self, path: Path, name: str, stack: ExitStack) -> None:
        self.name = name
        self.where = f'{path}: array {name!r}' if name else f'{path}'
        self._file = stack.enter_context(_opened(path, name))
        self.shape, fortran, self.dtype = _read_header(self._file, self.where)
        if self.dtype.kind not in 'fiu':
            raise AllanError(f'{self.where} is of type {self.dtype}: save it as float64 or int64')
        self._by_column: list[IO[bytes]] = []
        if fortran and len(self.shape) == 2:
            # stored column by column: each is read with a separate file, so that memory is constant
            start = self._file.tell()
            for column in range(self.shape[1]):
                file = stack.enter_context(_opened(path, name))
                file.seek(start + column * self.shape[0] * self.dtype.itemsize)
                self._by_column.append(file)

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(np.prod(self.shape[1:], dtype=np.int64))

    def take(self, rows: int) -> NDArray[Any]:
        """Return the next ``rows`` rows; raise AllanError if the file has fewer.

        Samples are (rows, columns), and times (rows,).
        """
        if self._by_column:
            return np.column_stack([self._block(file, rows) for file in self._by_column])
        block = self._block(self._file, rows * self.width)
        return block if self.name in (STAMPS, RECORD) else block.reshape(rows, self.width)

    def _block(self, file: IO[bytes], count: int) -> NDArray[Any]:
        data = file.read(count * self.dtype.itemsize)
        if len(data) != count * self.dtype.itemsize:
            raise AllanError(f'{self.where} ends early: the file is truncated; copy it again')
        return np.frombuffer(data, self.dtype)


def open_array(path: Path, options: ReadOptions) -> Recording:
    """Open a ``.npz`` or ``.npy`` file as a recording.

    Raises AllanError when it is not a numpy file, or the shapes of its arrays do not match.
    """
    with open_regular(path) as file:
        zipped = file.read(4) == b'PK\x03\x04'
    with translated(path, _LIBRARY_ERRORS, REMEDY):
        members = _members(path) if zipped else ('',)
        with ExitStack() as stack:
            samples, stamps, _ = _open_arrays(path, members, stack)
            n, width = samples.shape[0], samples.width
            names = tuple(options.columns or NAMES.get(width, '').split(','))
            if len(names) != width or any('=' in name for name in names):
                raise AllanError(
                    f'{samples.where} has shape {samples.shape}: name each of its columns, such '
                    f'as --columns {",".join(["t", *AXES][:width])} (- leaves one out)'
                )
            columns = columns_of(path, names, options)
            if len(columns.stamp) == 1 and stamps is None:
                first = samples.take(min(n, FIRST_ROWS))[:, columns.stamp[0][0]].astype(float)
                columns = columns.with_time_unit(samples.where, first, options.stamp_unit)
    if not columns.axes:
        raise AllanError(f'{path}: no column ({listed(names)}) is an axis: correct --columns')
    if not columns.stamp and stamps is None and not options.rate_hz:
        raise AllanError(
            f'{samples.where} has {width} columns and no time: add {STAMPS!r}, put t first, '
            'or state the sample rate with --rate'
        )
    info = SourceInfo(str(path), SAMPLES if zipped else '', 'array', 'npz' if zipped else 'npy')

    def read(report: Report) -> Iterator[ImuBatch]:
        if unit := columns.time_unit:
            name = names[columns.stamp[0][0]]
            report(finding('stamp_unit_assumed', path=path, unit=unit, name=name))
        yield from _read(path, members, columns, options)

    known = options.with_units(columns.units)
    return Recording(info, n, read, options=known, axes=columns.given)


_LIBRARY_ERRORS = (
    *(zipfile.BadZipFile, zlib.error, struct.error, ValueError, KeyError, EOFError, OSError),
    RuntimeError,  # encrypted file, or unknown compression (NotImplementedError)
    *(OverflowError, MemoryError, SyntaxError, TokenError, TypeError),
)
"""Exceptions of zipfile and numpy for damaged files."""

REMEDY = 'save it again with numpy, or copy it again'


def _members(path: Path) -> tuple[str, ...]:
    with open_regular(path) as file, zipfile.ZipFile(file) as archive:
        members = tuple(name[:-4] for name in archive.namelist() if name.endswith('.npy'))
    if SAMPLES not in members:
        raise AllanError(
            f'{path}: has no array {SAMPLES!r} (it has {", ".join(members[:10]) or "none"}): '
            f'save the samples as {SAMPLES!r} with columns {COLUMNS}'
        )
    return members


@contextmanager
def _opened(path: Path, name: str) -> Iterator[IO[bytes]]:
    """Open the array ``name`` of a zip archive, or the file itself if the name is ''."""
    with open_regular(path) as file:
        if name:
            with zipfile.ZipFile(file) as archive:
                yield archive.open(f'{name}.npy')
        else:
            yield file


def _read_header(file: IO[bytes], where: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    head = BytesIO(file.read(MAX_HEADER_BYTES))
    version = npy.read_magic(head)
    if version == (1, 0):
        header = npy.read_array_header_1_0(head)
    elif version == (2, 0):
        header = npy.read_array_header_2_0(head)
    else:
        raise AllanError(f'{where} has numpy format {version}: save plain numbers with numpy.save')
    file.seek(head.tell())
    return header


def _open_arrays(
    path: Path, members: tuple[str, ...], stack: ExitStack
) -> tuple[_Column, _Column | None, _Column | None]:
    """Return the arrays of samples, stamps and record times, after checking their shapes.

    ``members`` are the names of the arrays in the file. Missing times are None.
    """
    samples = _Column(path, SAMPLES if SAMPLES in members else '', stack)
    stamps = _Column(path, STAMPS, stack) if STAMPS in members else None
    record = _Column(path, RECORD, stack) if RECORD in members else None
    if len(samples.shape) not in (1, 2):
        raise AllanError(
            f'{samples.where} has shape {samples.shape}: give one row per sample with columns '
            f'{COLUMNS}'
        )
    if not samples.shape[0]:
        raise AllanError(f'{samples.where} contains no sample: record or export it again')
    for times in (stamps, record):
        if times is None:
            continue
        if times.shape != samples.shape[:1] or times.dtype.kind not in 'iu':
            raise AllanError(
                f'{times.where} is {times.dtype} of shape {times.shape}: it must be int64, one '
                f'for each of the {samples.shape[0]} samples'
            )
    return samples, stamps, record


def _read(
    path: Path, members: tuple[str, ...], columns: Columns, options: ReadOptions
) -> Iterator[ImuBatch]:
    with translated(path, _LIBRARY_ERRORS, REMEDY):
        frame_id = _frame_id(path) if FRAME in members else ''
        with ExitStack() as stack:
            samples, stamps, record = _open_arrays(path, members, stack)
            for first in range(0, samples.shape[0], BATCH):
                rows = min(BATCH, samples.shape[0] - first)
                block = samples.take(rows)
                if stamps is not None:
                    stamps_ns = stamps.take(rows).astype(np.int64)
                elif columns.stamp:
                    parts = (
                        _to_nanoseconds(block[:, at], size, samples.where, first)
                        for at, size in columns.stamp
                    )
                    stamps_ns = sum(parts, np.zeros(rows, np.int64))
                else:
                    stamps_ns = even_stamps(first, rows, options.rate_hz)
                values = np.full((rows, len(AXES)), np.nan)
                for axis, (at, scale) in columns.axes.items():
                    values[:, axis] = block[:, at] * scale
                record_ns = None if record is None else record.take(rows).astype(np.int64)
                yield ImuBatch(stamps_ns, values, record_ns, frame_id)


def _to_nanoseconds(times: NDArray[Any], unit: int, where: str, first: int) -> NDArray[np.int64]:
    if times.dtype.kind in 'iu' and unit == 1:
        return times.astype(np.int64)
    with np.errstate(over='ignore'):  # checked below
        stamps: NDArray[np.float64] = times.astype(np.float64) * unit
    bad = ~(np.abs(stamps) < np.iinfo(np.int64).max)
    if bad.any():
        raise AllanError(
            f'{where}: the time of row {first + int(np.argmax(bad))} is not a valid stamp: '
            'correct it, or state the unit of t with --stamp-unit (s, ms, us, ns)'
        )
    return np.rint(stamps).astype(np.int64)


def _frame_id(path: Path) -> str:
    with _opened(path, FRAME) as file:
        shape, _, dtype = _read_header(file, f'{path}: array {FRAME!r}')
        if shape not in ((), (1,)) or dtype.kind != 'U' or dtype.itemsize > MAX_FRAME_BYTES:
            raise AllanError(f'{path}: array {FRAME!r} must be one string: save it as a string')
        return str(np.frombuffer(file.read(dtype.itemsize), dtype)[0]) if dtype.itemsize else ''


def write_npz(path: Path, batches: Iterable[ImuBatch], *, deflate: bool = False) -> int:
    """Write the batches to a .npz file, and return the number of samples.

    With ``deflate`` it is compressed. The arrays are ``imu`` (column t in s), ``stamps_ns``,
    ``frame_id`` and, if known, ``record_ns``. All samples are in memory while it is written.

    Raises AllanError when the batches have several frame_ids, or only some of them have record
    times.
    """
    parts = list(batches)
    frames = list(dict.fromkeys(batch.frame_id for batch in parts)) or ['']
    if len(frames) > 1:
        raise AllanError(f'{path}: npz stores one frame_id, not {len(frames)}: write a bag')
    record = [batch.record_ns for batch in parts if batch.record_ns is not None]
    if len(record) not in (0, len(parts)):
        raise AllanError(f'{path}: some batches have record times and some do not: write a bag')
    stamps = np.concatenate([np.empty(0, np.int64), *(batch.stamps_ns for batch in parts)])
    samples = np.concatenate([np.empty((0, len(AXES))), *(batch.samples for batch in parts)])
    arrays: dict[str, Any] = {
        SAMPLES: np.column_stack([stamps / STAMP_UNITS['s'], samples]),
        STAMPS: stamps,
        FRAME: np.array(frames[0]),
    }
    if record:
        arrays[RECORD] = np.concatenate(record)
    with path.open('wb') as file:
        (np.savez_compressed if deflate else np.savez)(file, **arrays)
    return len(stamps)


# --- samples in memory --------------------------------------------------------------------------

NAME = 'array'
"""Path of samples that are not read from a file."""

DEFAULT_AXES = {1: AXES[:1], 3: AXES[:3], 6: AXES}
"""Number of columns -> default axes."""


def recording_in_memory(
    samples: Any, options: ReadOptions, axes: str | Sequence[str] | None = None
) -> Recording:
    """Return samples in memory as a recording.

    ``samples`` is an ImuBatch, an array with one row per sample, a DataFrame, or a mapping from
    column name to array. Named columns are recognized as in a table. The times are computed from
    the rate in the options; without it, they are a column such as ``t`` or ``time``, or the index
    of the DataFrame if it consists of dates or durations. Units in the options apply to columns
    whose names have no unit.
    ``axes`` are the names of the axes, or 'gyro' or 'accel' for three of them; by default, the
    columns of an array are gyro x, y, z and accel x, y, z. Raises AllanError when a shape, name,
    unit or rate is invalid, or the times are missing.
    """
    if isinstance(samples, ImuBatch):
        return _recording(samples)
    rate = options.rate_hz
    if rate and not (np.isfinite(rate) and rate > 0.0):
        raise AllanError(f'rate is {rate} Hz: give a positive number')
    if isinstance(samples, Mapping) or hasattr(samples, 'columns'):
        keys = list(samples.columns if hasattr(samples, 'columns') else samples)
        names = tuple(map(str, keys))
        if len(set(names)) < len(names):
            ((twice, _),) = Counter(names).most_common(1)
            raise AllanError(f'the column {twice!r} occurs more than once: rename it')
        wanted = AXES if axes is None else _axis_names(axes)
        columns: Any = [samples[key] for key in keys]
    else:
        columns = _numbers(samples).T
        names = wanted = _axis_names(axes, len(columns))
    found = columns_of('the samples', names, options)
    scales = {axis: scale for axis, scale in found.axes.items() if AXES[axis] in wanted}
    if not scales:
        raise AllanError(
            f'none of the columns {listed(names)} is an axis: name them {", ".join(AXES)}'
        )
    values = {axis: _numbers(columns[at])[:, 0] * s for axis, (at, s) in scales.items()}
    n = len(next(iter(values.values())))
    if any(len(column) != n for column in values.values()):
        raise AllanError('the columns have different lengths: give one row per sample')
    rows = np.full((n, len(AXES)), np.nan)
    for axis, column in values.items():
        rows[:, axis] = column
    index = np.asarray(getattr(getattr(samples, 'index', None), 'values', ()))
    if rate:
        stamps = even_stamps(0, n, rate)
    elif found.stamp:
        found = _with_times(found, columns, options)
        stamps = np.sum([_stamps(columns[at], size) for at, size in found.stamp], axis=0)
    elif index.dtype.kind in 'Mm':
        stamps = _stamps(index, 1)
    else:
        raise AllanError('the samples have no times: give the sample rate, such as rate=200')
    given = tuple(AXES[axis] for axis in values)
    return _recording(ImuBatch(stamps, rows), options.with_units(found.units), given)


def _recording(
    batch: ImuBatch, options: ReadOptions = ReadOptions(), axes: tuple[str, ...] = AXES
) -> Recording:
    if len(batch) and np.abs(batch.stamps_ns.astype(float)).max() > MAX_INTEGER:
        raise AllanError('some times are more than a hundred years from 1970: check their unit')
    if not len(batch):
        raise AllanError('there are no samples: give an array with at least some thousand rows')
    info = SourceInfo(NAME, '', 'array', 'memory')
    return Recording(info, len(batch), lambda _: in_batches(batch), options=options, axes=axes)


def _numbers(samples: Any) -> NDArray[np.float64]:
    """Return samples as a float64 array (n, k); raise AllanError when this is impossible."""
    try:
        values = np.asarray(np.ma.filled(samples, np.nan) if np.ma.is_masked(samples) else samples)
        if values.dtype.kind == 'c':
            raise TypeError('complex values')
        values = np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise AllanError(
            f'the samples are not numbers ({error}): give an array, a DataFrame or paths'
        ) from None
    values = values[:, None] if values.ndim == 1 else values
    if values.ndim != 2:
        raise AllanError(
            f'the samples have shape {values.shape}: give (n,) or (n, axes), one row per sample'
        )
    return values


def _axis_names(axes: str | Sequence[str] | None, columns: int = 0) -> tuple[str, ...]:
    """Return the names of the axes of an array with this number of columns; 0: any number."""
    if axes is None:
        if columns not in DEFAULT_AXES:
            raise AllanError(
                f'the axes of {columns} columns are unknown: name them, such as axes=["gyro_z", '
                '...]'
            )
        return DEFAULT_AXES[columns]
    names = AXES[SENSORS[axes]] if isinstance(axes, str) and axes in SENSORS else axes
    names = (names,) if isinstance(names, str) else tuple(names)
    for name in names:
        if name not in AXES:
            raise AllanError(f'axis {name!r} is unknown: choose from {", ".join(AXES)}')
    columns = columns or len(names)
    if len(set(names)) < len(names) or len(names) != columns:
        raise AllanError(
            f'{columns} columns, but {len(names)} axes ({", ".join(names)}): name one axis per '
            'column'
        )
    return names


def _with_times(found: Columns, columns: Any, options: ReadOptions) -> Columns:
    """Return the columns with the unit of the stamps, unless these are dates or durations."""
    first = np.asarray(columns[found.stamp[0][0]][:FIRST_ROWS])
    if first.dtype.kind in 'Mm' or len(found.stamp) > 1:
        return found
    return found.with_time_unit('the samples', _numbers(first)[:, 0], options.stamp_unit)


def _stamps(times: Any, scale: int) -> NDArray[np.int64]:
    """Convert times to int64 ns: dates, durations, or numbers in a unit of ``scale`` ns."""
    values = np.asarray(times)
    if values.dtype.kind in 'Mm':
        return values.astype(f'{values.dtype.kind}8[ns]').astype(np.int64)
    if values.dtype.kind in 'iu':
        return values.astype(np.int64) * scale
    values = _numbers(values)[:, 0]
    if not np.isfinite(values).all():
        raise AllanError('some times are NaN or infinite: drop these rows, or give the rate')
    return np.rint(values * scale).astype(np.int64)
