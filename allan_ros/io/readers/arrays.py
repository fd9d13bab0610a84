# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads samples from memory and from numpy files: ``.npz`` with the array ``imu``, or ``.npy``.

``imu`` is float64 with columns t, gx, gy, gz, ax, ay, az (s, rad/s, m/s^2). The array ``stamps_ns``
(int64) replaces t. ``record_ns`` (int64) and ``frame_id`` (one string) are optional. Files are read
in blocks of rows, so the memory does not depend on their size.
"""

from __future__ import annotations

import shutil
import struct
import tempfile
import zipfile
import zlib
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
from ...core.findings import Finding
from ...core.imu import AXES, SENSORS, STAMP_UNITS, ImuBatch, even_stamps
from ..files import open_regular
from .columns import columns_of, listed
from .recording import BATCH, ReadOptions, Recording, SourceInfo, in_batches
from .storage import translated

COLUMNS = 't, gx, gy, gz, ax, ay, az'

SAMPLES, STAMPS, RECORD, FRAME = 'imu', 'stamps_ns', 'record_ns', 'frame_id'

MAX_FRAME_BYTES = 4096
"""Largest size of a frame_id in bytes."""

MAX_HEADER_BYTES = 1 << 16
"""Number of bytes within which the header of an array ends."""


class _Column:
    """An array in a numpy file, which is read block by block.

    ``name`` is its name in a .npz file, or '' for a .npy file. ``stack`` closes the files.
    """

    def __init__(self, path: Path, name: str, stack: ExitStack) -> None:
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

    def take(self, rows: int) -> NDArray[Any]:
        """Return the next ``rows`` rows; raise AllanError if the file has fewer."""
        if self._by_column:
            return np.column_stack([self._block(file, rows) for file in self._by_column])
        width = int(np.prod(self.shape[1:], dtype=np.int64))
        return self._block(self._file, rows * width).reshape(rows, *self.shape[1:])

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
            n = _open_columns(path, members, options, stack)[0].shape[0]
    storage = 'npz' if zipped else 'npy'
    info = SourceInfo(str(path), SAMPLES if zipped else '', 'array', storage)
    return Recording(info, n, lambda _: _read(path, members, options), options=options)


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


def _open_columns(
    path: Path, members: tuple[str, ...], options: ReadOptions, stack: ExitStack
) -> tuple[_Column, _Column | None, _Column | None]:
    """Return the arrays of samples, stamps and record times, after checking their shapes.

    ``members`` are the names of the arrays in the file. Missing times are None.
    """
    name = SAMPLES if SAMPLES in members else ''
    samples = _Column(path, name, stack)
    stamps = _Column(path, STAMPS, stack) if STAMPS in members else None
    record = _Column(path, RECORD, stack) if RECORD in members else None
    if len(samples.shape) != 2 or samples.shape[1] not in (len(AXES), len(AXES) + 1):
        raise AllanError(
            f'{samples.where} has shape {samples.shape}: give one row per sample with columns '
            f'{COLUMNS}'
        )
    if not samples.shape[0]:
        raise AllanError(f'{samples.where} contains no sample: record or export it again')
    if samples.shape[1] == len(AXES) and stamps is None and not options.rate_hz:
        raise AllanError(
            f'{samples.where} has six columns and no time: add {STAMPS!r}, put t first, '
            'or state the sample rate with --rate'
        )
    for times in (stamps, record):
        if times is None:
            continue
        if times.shape != samples.shape[:1] or times.dtype.kind not in 'iu':
            raise AllanError(
                f'{times.where} is {times.dtype} of shape {times.shape}: it must be int64, one '
                f'for each of the {samples.shape[0]} samples'
            )
    return samples, stamps, record


def _read(path: Path, members: tuple[str, ...], options: ReadOptions) -> Iterator[ImuBatch]:
    with translated(path, _LIBRARY_ERRORS, REMEDY):
        frame_id = _frame_id(path) if FRAME in members else ''
        with ExitStack() as stack:
            samples, stamps, record = _open_columns(path, members, options, stack)
            for first in range(0, samples.shape[0], BATCH):
                rows = min(BATCH, samples.shape[0] - first)
                block = samples.take(rows)
                if stamps is not None:
                    stamps_ns = stamps.take(rows).astype(np.int64)
                elif block.shape[1] > len(AXES):
                    unit = STAMP_UNITS[options.stamp_unit]
                    stamps_ns = _to_nanoseconds(block[:, 0], unit, samples.where, first)
                else:
                    stamps_ns = even_stamps(first, rows, options.rate_hz)
                values = block[:, -len(AXES) :].astype(np.float64)
                record_ns = None if record is None else record.take(rows).astype(np.int64)
                yield options.in_si(ImuBatch(stamps_ns, values, record_ns, frame_id))


def _to_nanoseconds(
    times: NDArray[np.float64], unit: int, where: str, first: int
) -> NDArray[np.int64]:
    with np.errstate(over='ignore'):  # checked below
        times = times * unit
    bad = ~(np.abs(times) < np.iinfo(np.int64).max)
    if bad.any():
        raise AllanError(
            f'{where}: the time of row {first + int(np.argmax(bad))} is not a valid stamp: '
            'correct it, or state the unit of t with --stamp-unit (s, ms, us, ns)'
        )
    return np.rint(times).astype(np.int64)


def _frame_id(path: Path) -> str:
    with _opened(path, FRAME) as file:
        shape, _, dtype = _read_header(file, f'{path}: array {FRAME!r}')
        if shape not in ((), (1,)) or dtype.kind != 'U' or dtype.itemsize > MAX_FRAME_BYTES:
            raise AllanError(f'{path}: array {FRAME!r} must be one string: save it as a string')
        return str(np.frombuffer(file.read(dtype.itemsize), dtype)[0]) if dtype.itemsize else ''


def write_npz(path: Path, batches: Iterable[ImuBatch], *, deflate: bool = False) -> int:
    """Write the batches to a .npz file, and return the number of samples.

    With ``deflate`` it is compressed. The arrays are ``imu`` (column t in s), ``stamps_ns``,
    ``frame_id`` and, if known, ``record_ns``. They are written to temporary files first, because
    their length is known only at the end.

    Raises AllanError when the batches have several frame_ids, or only some of them have record
    times.
    """
    frames: list[str] = []
    counts = {SAMPLES: 0, STAMPS: 0, RECORD: 0}
    with ExitStack() as stack:
        files = {
            name: stack.enter_context(tempfile.TemporaryFile(dir=path.parent)) for name in counts
        }
        for batch in batches:
            if batch.frame_id not in frames:
                frames.append(batch.frame_id)
            seconds = batch.stamps_ns / STAMP_UNITS['s']
            arrays = {
                SAMPLES: np.column_stack([seconds, batch.samples]),
                STAMPS: batch.stamps_ns,
                RECORD: batch.record_ns,
            }
            for name, array in arrays.items():
                if array is not None:
                    files[name].write(np.ascontiguousarray(array).tobytes())
                    counts[name] += len(array)
        n = counts[SAMPLES]
        if len(frames) > 1:
            raise AllanError(f'{path}: npz stores one frame_id, not {len(frames)}: write a bag')
        if counts[RECORD] not in (0, n):
            raise AllanError(f'{path}: some batches have record times and some do not: write a bag')
        how = zipfile.ZIP_DEFLATED if deflate else zipfile.ZIP_STORED
        with zipfile.ZipFile(path, 'w', how) as archive:
            for name, shape, dtype in (
                (SAMPLES, (n, len(AXES) + 1), np.dtype('<f8')),
                (STAMPS, (n,), np.dtype('<i8')),
                (RECORD, (n,), np.dtype('<i8')),
            ):
                if counts[name] or name != RECORD:
                    files[name].seek(0)
                    header = {'descr': npy.dtype_to_descr(dtype), 'shape': shape}
                    with archive.open(f'{name}.npy', 'w', force_zip64=True) as member:
                        npy.write_array_header_1_0(member, {**header, 'fortran_order': False})
                        shutil.copyfileobj(files[name], member)
            with archive.open(f'{FRAME}.npy', 'w') as member:
                npy.write_array(member, np.array(frames[0] if frames else ''))
    return n


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


def without_absent(findings: Sequence[Finding], axes: tuple[str, ...]) -> tuple[Finding, ...]:
    """Return the findings except those about absent sensors and about axes not in ``axes``."""
    return tuple(
        f
        for f in findings
        if f.id != 'sensor_absent' and not (f.id == 'axis_absent' and set(axes).isdisjoint(f.axes))
    )


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
