# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read samples from memory and from numpy files: ``.npz`` with the array ``imu``, or ``.npy``.

Columns
-------
`ReadOptions.columns` names the columns of a file. By default, the columns are t, gx, gy, gz, ax,
ay, az in rad/s and m/s^2, or some of these (`COLUMN_NAMES`). In a ``.npz`` file, the array
``stamps_ns`` (int64) is used instead of t. The arrays ``record_ns`` (int64) and ``frame_id`` (one
string) are optional.
"""

from __future__ import annotations

import os
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from io import BytesIO
from math import prod
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ..core.errors import AllanError
from ..core.fields import MAX_INTEGER
from ..core.findings import finding
from ..core.imu import AXES, MAX_NAME, SENSORS, ImuBatch, even_stamps, real_numbers
from ..core.stream.signal import MAX_BINS, TemperatureTrace, trace_of
from .columns import EXAMPLE_COLUMNS, FIRST_ROWS, ColumnLayout, columns_of
from .files import open_regular
from .recording import (
    MAX_CHUNK_BYTES,
    MAX_FILE_RATIO,
    ZIP_MAGIC,
    ReadOptions,
    Recording,
    Report,
    SourceInfo,
    first_bytes,
    in_batches,
    translated,
)
from .unit_names import to_celsius

COLUMN_NAMES = {1: 'gx', 3: 'gx,gy,gz', 4: 't,gx,gy,gz', 6: 'gx,gy,gz,ax,ay,az', 7: EXAMPLE_COLUMNS}
"""Number of columns of an array -> default names of the columns."""

SAMPLES, STAMPS, RECORD_STAMPS, FRAME = 'imu', 'stamps_ns', 'record_ns', 'frame_id'
"""Names of the arrays in a ``.npz`` file."""

MAX_FRAME_ARRAY_BYTES = 4 * MAX_NAME
"""Largest accepted size of the array ``frame_id`` in bytes. numpy stores four bytes for each
character."""

MAX_HEADER_BYTES = 1 << 16
"""Largest accepted size of the header of a numpy file in bytes."""

_LIBRARY_ERRORS = (
    *(zipfile.BadZipFile, zlib.error, struct.error, ValueError, KeyError, EOFError, OSError),
    RuntimeError,  # encrypted file, or unknown compression (NotImplementedError)
    *(OverflowError, MemoryError, SyntaxError, TokenError, TypeError),
)
"""Exceptions that zipfile and numpy raise for damaged files."""

REMEDY = 'save it again with numpy, or copy it again'


def open_array(path: Path, options: ReadOptions) -> Recording:
    """Open a ``.npz`` or ``.npy`` file as a recording.

    The samples stay in memory until they are read, or until the recording is closed. Raises
    AllanError when ``path`` is not a numpy file or has no samples, when the shapes or types of the
    arrays do not match, or when the axes, times or units are unknown or invalid.
    """
    with translated(path, _LIBRARY_ERRORS, REMEDY):
        batch, layout, time_name = _load(path, options)
    unread_batch = [batch]

    def read(report: Report) -> Iterator[ImuBatch]:
        if unit := layout.time_unit:
            report(finding('stamp_unit_assumed', path=path, unit=unit, name=time_name))
        with translated(path, _LIBRARY_ERRORS, REMEDY):
            yield from in_batches(unread_batch.pop() if unread_batch else _load(path, options)[0])

    is_zip = first_bytes(path).startswith(ZIP_MAGIC)
    info = SourceInfo(str(path), SAMPLES if is_zip else '', 'array', 'npz' if is_zip else 'npy')
    read_options = options.with_units(layout.units)
    return Recording(
        *(info, len(batch), read),
        options=read_options,
        axes=layout.given,
        close=unread_batch.clear,
    )


def _load(path: Path, options: ReadOptions) -> tuple[ImuBatch, ColumnLayout, str]:
    """Return the samples of a file, the layout of the columns, and the name of a time column.

    The name is '' if no column contains times.
    """
    arrays = _arrays(path)
    samples = arrays[SAMPLES]
    if samples.ndim not in (1, 2):
        raise AllanError(
            f'{path} has shape {samples.shape}: give one row per sample with columns '
            f'{EXAMPLE_COLUMNS}'
        )
    n, width = len(samples), prod(samples.shape[1:])
    if not n:
        raise AllanError(f'{path} contains no sample: record or export it again')
    for name in {STAMPS, RECORD_STAMPS} & arrays.keys():
        times = arrays[name]
        if times.shape != (n,) or times.dtype.kind not in 'iu':
            raise AllanError(
                f'{path}: array {name!r} is {times.dtype} of shape {times.shape}: it must be '
                f'int64, one for each of the {n} samples'
            )
    frame_id = arrays.get(FRAME, np.array(''))
    if frame_id.size != 1 or frame_id.itemsize > MAX_FRAME_ARRAY_BYTES:
        raise AllanError(f'{path}: array {FRAME!r} must be one short string: save it as a string')
    names = tuple(options.columns or COLUMN_NAMES.get(width, '').split(','))
    if len(names) != width or any('=' in name for name in names):
        raise AllanError(
            f'{path} has shape {samples.shape}: give one row per sample, and name each column, '
            f'such as --columns {",".join(["t", *AXES][:width])} (- excludes a column)'
        )
    layout = columns_of(path, names, options)
    columns = samples.reshape(n, width).T
    stamps = arrays[STAMPS].astype(np.int64) if STAMPS in arrays else None
    batch, layout = _batch(path, names, columns, layout, options, stamps)
    record = arrays[RECORD_STAMPS].astype(np.int64) if RECORD_STAMPS in arrays else None
    batch = replace(batch, record_ns=record, frame_id=str(frame_id.reshape(-1)[0]))
    return batch, layout, names[layout.stamp[0][0]] if layout.stamp else ''


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    with open_regular(path) as file:
        limit = os.fstat(file.fileno()).st_size * MAX_FILE_RATIO + MAX_CHUNK_BYTES
        if not first_bytes(path).startswith(ZIP_MAGIC):
            return {SAMPLES: _array(file, f'{path}', 'fiu', limit)}
        with zipfile.ZipFile(file) as archive:
            members = [name[:-4] for name in archive.namelist() if name.endswith('.npy')]
            if SAMPLES not in members:
                raise AllanError(
                    f'{path}: has no array {SAMPLES!r} (it has '
                    f'{", ".join(members[:10]) or "none"}): save the samples as {SAMPLES!r} with '
                    f'columns {EXAMPLE_COLUMNS}'
                )
            arrays = {}
            for name in (
                name for name in (SAMPLES, STAMPS, RECORD_STAMPS, FRAME) if name in members
            ):
                with archive.open(f'{name}.npy') as member:
                    kinds = 'U' if name == FRAME else 'fiu'
                    arrays[name] = _array(member, f'{path}: array {name!r}', kinds, limit)
            return arrays


def array_in(path: Path, name: str) -> NDArray[Any]:
    """Return the array ``name`` of numbers or strings in a ``.npz`` file, in any shape.

    The result is an empty array, (0,), if the file has no such array. Raises AllanError when the
    file cannot be read, or when the array contains neither real numbers nor Unicode strings.
    """
    with (
        translated(path, _LIBRARY_ERRORS, REMEDY),
        open_regular(path) as file,
        zipfile.ZipFile(file) as archive,
    ):
        if f'{name}.npy' not in archive.namelist():
            return np.empty(0)
        limit = os.fstat(file.fileno()).st_size * MAX_FILE_RATIO + MAX_CHUNK_BYTES
        with archive.open(f'{name}.npy') as member:
            return _array(member, f'{path}: array {name!r}', 'fiuU', limit)


def _array(file: IO[bytes], where: str, kinds: str, limit: int) -> NDArray[Any]:
    """Return the array in an open file in numpy format.

    ``where`` is the name of the array in error messages. ``kinds`` are the accepted values of
    ``dtype.kind``, such as 'fi'. ``limit`` is the largest accepted size of the array in bytes.
    """
    head = BytesIO(file.read(MAX_HEADER_BYTES))
    if not head.getvalue().startswith(npy.MAGIC_PREFIX):
        raise AllanError(f'{where} is not in numpy format: {REMEDY}')
    version = npy.read_magic(head)
    if version not in ((1, 0), (2, 0)):
        raise AllanError(f'{where} has numpy format {version}: save plain numbers with numpy.save')
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, is_fortran_order, dtype = read_header(head)
    if dtype.kind not in kinds:
        wanted_type = 'a string' if kinds == 'U' else 'float64 or int64'
        raise AllanError(f'{where} is of type {dtype}: save it as {wanted_type}')
    size_bytes = prod(shape) * dtype.itemsize
    if not 0 <= size_bytes <= limit:
        raise ValueError(f'an array of {size_bytes} bytes')
    file.seek(head.tell())
    data = file.read(size_bytes)
    if len(data) != size_bytes:
        raise AllanError(f'{where} ends early: the file is truncated; copy it again')
    return np.ndarray(shape, dtype, data, order='F' if is_fortran_order else 'C')


# --- samples in memory --------------------------------------------------------------------------

NAME = 'array'
"""Name of samples from memory, which results state in place of a path."""

DEFAULT_AXES = {1: AXES[:1], 3: AXES[:3], 6: AXES}
"""Number of columns of an array in memory -> default names of the axes."""


def recording_in_memory(
    samples: Any, options: ReadOptions, axes: str | Sequence[str] | None = None
) -> Recording:
    """Return samples in memory as a recording.

    Parameters
    ----------
    samples : ImuBatch, (n,) or (n, axes) array, DataFrame, or mapping of column name to (n,) array
        The samples, with one row per sample. Named columns are recognized as in a table. An
        ImuBatch is used unchanged: the options and axes do not apply to it.
    options : ReadOptions
        If the options contain a rate, the times are computed from the rate. Otherwise the times
        are a column such as ``t`` or ``time``, or the index of a DataFrame, if the index consists
        of dates or durations. The units of samples in the options apply to columns whose names
        state no unit. The unit of times in the options applies to numbers in one column of times,
        whatever its name states.
    axes : sequence of str or str, optional
        Names of the axes, or 'gyro' or 'accel' for three axes. By default, an array with six
        columns contains gyro x, y, z and accel x, y, z, an array with three columns contains gyro
        x, y, z, and a single column contains gyro x. Of named columns, only these axes are used;
        by default, all axes are used.

    Raises
    ------
    AllanError
        When a shape, name, unit, time or rate is invalid, the times are missing, there are no
        samples, or the samples are not numbers. For an ImuBatch also when it does not have six
        axes.
    """
    if isinstance(samples, ImuBatch):
        kinds = samples.stamps_ns.dtype.kind, samples.samples.dtype.kind
        if samples.samples.shape[1] != len(AXES) or kinds != ('i', 'f'):
            raise AllanError(
                f'the ImuBatch has {kinds[0]!r} stamps and {kinds[1]!r} samples of shape '
                f'{samples.samples.shape}: give int64 stamps and float64 samples of six axes'
            )
        return _recording(samples)
    rate = options.rate_hz
    if rate and not (np.isfinite(rate) and rate > 0.0):
        raise AllanError(f'rate is {rate} Hz: give a positive number')
    if isinstance(samples, Mapping) or hasattr(samples, 'columns'):
        keys = list(samples.columns if hasattr(samples, 'columns') else samples)
        names = tuple(map(str, keys))
        if len(set(names)) < len(names):
            ((repeated_name, _),) = Counter(names).most_common(1)
            raise AllanError(f'the column {repeated_name!r} occurs more than once: rename it')
        used_axes = AXES if axes is None else _axis_names(axes)
        columns: Any = [samples[key] for key in keys]
    else:
        columns = _numbers(samples).T
        names = used_axes = _axis_names(axes, len(columns))
    layout = columns_of('the samples', names, options)
    axis_columns = {i: column for i, column in layout.axes.items() if AXES[i] in used_axes}
    layout = replace(layout, axes=axis_columns)
    index = np.asarray(getattr(getattr(samples, 'index', None), 'values', ()))
    stamps = None
    if rate:
        layout = replace(layout, stamp=())
    elif index.dtype.kind in 'Mm' and not layout.stamp:
        stamps = _nanoseconds('the samples', index, 1)
    batch, layout = _batch('the samples', names, columns, layout, options, stamps)
    recording = _recording(batch, options.with_units(layout.units), layout.given)
    trace = _temperature(names, columns, layout, batch)
    return replace(recording, temperature=lambda frame_id: trace)


def _temperature(
    names: Sequence[str], columns: Any, layout: ColumnLayout, batch: ImuBatch
) -> TemperatureTrace | None:
    """Return the temperature over time from a column; None if no column contains temperatures."""
    if layout.temperature is None:
        return None
    column, unit = layout.temperature
    values = _numbers(columns[column])[:, 0]
    if len(values) != len(batch):
        raise AllanError(
            f'the column {names[column]!r} has {len(values)} values, but there are {len(batch)} '
            'samples: give one value for each sample'
        )
    rows = slice(None, None, len(values) // MAX_BINS + 1)
    stamps, values = batch.stamps_ns[rows].tolist(), values[rows].tolist()
    return trace_of(names[column], ((t, t, to_celsius(v, unit)) for t, v in zip(stamps, values)))


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
    """Return samples as a float64 array, (n, axes); raise AllanError when this is impossible."""
    try:
        values = real_numbers(samples)
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


def _axis_names(axes: str | Sequence[str] | None, columns: int | None = None) -> tuple[str, ...]:
    """Return the names of the axes of an array with ``columns`` columns.

    If ``columns`` is None, any number of names is accepted. Raises AllanError when a name is
    unknown or occurs twice, when the numbers of names and columns differ, or when ``axes`` is None
    and there are no default names for this number of columns.
    """
    if axes is None:
        if columns not in DEFAULT_AXES:
            raise AllanError(
                f'the axes of {columns} columns are unknown: give one row per sample, and name the '
                'columns, such as axes=["gyro_z", ...]'
            )
        return DEFAULT_AXES[columns]
    names = AXES[SENSORS[axes]] if isinstance(axes, str) and axes in SENSORS else axes
    names = (names,) if isinstance(names, str) else tuple(names)
    for name in names:
        if not isinstance(name, str) or name not in AXES:
            raise AllanError(f'axis {name!r:.40} is unknown: choose from {", ".join(AXES)}')
    columns = len(names) if columns is None else columns
    if len(set(names)) < len(names) or len(names) != columns:
        raise AllanError(
            f'{columns} columns, but {len(names)} axes ({", ".join(names)}): give one row per '
            'sample, and one axis per column'
        )
    return names


def _batch(
    where: object,
    names: Sequence[str],
    columns: Any,
    layout: ColumnLayout,
    options: ReadOptions,
    stamps: NDArray[np.int64] | None,
) -> tuple[ImuBatch, ColumnLayout]:
    """Return the samples in ``columns``, and the layout with the unit of the stamps added.

    If ``stamps`` in ns, (n,), are given, columns of times are not used. Raises AllanError when no
    column is an axis, the times are missing, a column is not numeric, the columns of the axes have
    different lengths, or a time or the unit of the times is invalid.
    """
    layout.check(where, names, stamps is not None or bool(options.rate_hz))
    with np.errstate(all='ignore'):  # a damaged file may contain any value
        values = {
            axis: _numbers(columns[i])[:, 0] * scale for axis, (i, scale) in layout.axes.items()
        }
    n = len(next(iter(values.values())))
    if any(len(column) != n for column in values.values()):
        raise AllanError('the columns have different lengths: give one row per sample')
    rows = np.full((n, len(AXES)), np.nan)
    for axis, column in values.items():
        rows[:, axis] = column
    if stamps is None and layout.stamp:
        first_rows = np.atleast_1d(np.asarray(columns[layout.stamp[0][0]]))[:FIRST_ROWS]
        # a unit is needed only for times that are neither dates nor durations
        if first_rows.dtype.kind not in 'Mm' and len(layout.stamp) == 1:
            times = _numbers(first_rows)[:, 0]
            layout = layout.with_time_unit(where, times, options.stamp_unit)
        time_parts = [_nanoseconds(where, columns[i], scale) for i, scale in layout.stamp]
        stamps = np.asarray(np.sum(time_parts, axis=0), np.int64)
    elif stamps is None:
        stamps = even_stamps(0, n, options.rate_hz)
    return ImuBatch(stamps, rows), layout


def _nanoseconds(where: object, times: Any, scale: int) -> NDArray[np.int64]:
    """Return dates, durations, or numbers in units of ``scale`` ns as times in ns, (n,)."""
    values = np.asarray(times)
    if values.dtype.kind in 'Mm' and values.ndim == 1:
        return values.astype(f'{values.dtype.kind}8[ns]').astype(np.int64)
    with np.errstate(all='ignore'):
        in_ns = _numbers(values)[:, 0] * scale
    is_invalid = ~(np.abs(in_ns) < np.iinfo(np.int64).max)  # true for NaN, too
    if is_invalid.any():
        raise AllanError(
            f'{where}: the time of row {int(np.argmax(is_invalid))} is not a valid stamp: correct '
            'it, or state the unit of the times (s, ms, us, ns)'
        )
    if values.dtype.kind in 'iu':
        return values.astype(np.int64) * scale
    return np.rint(in_ns).astype(np.int64)
