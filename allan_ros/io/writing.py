# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write samples as a recording: rosbag2 (mcap, sqlite3), ROS 1 bag, CSV or npz.

Bags are written by the package ``rosbags``. A recording is written to a temporary folder next to
its path and renamed when it is complete. Every format stores int64 stamps and float64 samples, so
reading returns exactly the same numbers.
"""

from __future__ import annotations

import os
import shutil
import struct
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import AllanError
from ..core.imu import AXES, NANOSECONDS, ImuBatch
from .readers.cdr import IMU_TYPE, encode_imus
from .readers.storage import optional_package
from .readers.tables import FRAME_COMMENT

COMPRESSIONS: dict[str, tuple[str, ...]] = {
    'mcap': ('none', 'chunk', 'message', 'file'),
    'sqlite3': ('none', 'message', 'file'),
    'ros1': ('none', 'bz2', 'lz4'),
    'csv': ('none',),
    'npz': ('none', 'deflate'),
}
"""Storage -> possible kinds of compression; rosbag2 (mcap, sqlite3) uses zstd."""
STORAGE_OF_SUFFIX = {'.bag': 'ros1', '.csv': 'csv', '.tsv': 'csv', '.npz': 'npz'}
DEFAULT_STORAGE = 'mcap'
FILE_SUFFIXES = {'.mcap': 'mcap', '.db3': 'sqlite3'}
"""Suffix of a single file, instead of a bag with metadata.yaml -> its storage."""

METADATA_VERSION = 8
"""Version of metadata.yaml, as of ROS 2 Jazzy."""


def write_recording(
    path: str | os.PathLike[str],
    batches: Iterable[ImuBatch],
    *,
    storage: str | None = None,
    compression: str = 'none',
    topic: str = '/imu/data',
    overwrite: bool = False,
) -> int:
    """Write samples to a new recording, and return their number.

    Parameters
    ----------
    path : path
        The bag directory (rosbag2) or file (ROS 1, CSV, TSV, npz).
    batches : iterable of ImuBatch
        The batches in recorded order.
    storage : 'mcap', 'sqlite3', 'ros1', 'csv' or 'npz', optional
        By default from the suffix: .mcap, .db3, .bag, .csv, .tsv, .npz; otherwise an mcap bag.
    compression : str
        'none'; also 'chunk' (mcap), 'message', 'file' (mcap, sqlite3), 'bz2', 'lz4' (ros1) or
        'deflate' (npz).
    topic : str
        Topic name in a bag.
    overwrite : bool
        Replace an existing recording at ``path``.

    Raises
    ------
    AllanError
        When the path exists or cannot be written, or the storage or compression is unknown.
    """
    path = Path(path)
    by_suffix = {**STORAGE_OF_SUFFIX, **FILE_SUFFIXES}
    storage = storage or by_suffix.get(path.suffix.lower(), DEFAULT_STORAGE)
    if storage not in COMPRESSIONS:
        raise AllanError(f'storage {storage!r} is unknown: choose one of {", ".join(COMPRESSIONS)}')
    if compression not in COMPRESSIONS[storage]:
        raise AllanError(
            f'{storage} cannot be compressed with {compression!r}: '
            f'choose one of {", ".join(COMPRESSIONS[storage])}'
        )
    try:
        with _draft(path, overwrite) as draft:
            return _write(draft, batches, storage, compression, topic)
    except OSError as error:
        raise AllanError(
            f'{path} cannot be written ({error.strerror or error}): '
            'check the folder, its permissions and the free space'
        ) from error
    except (struct.error, OverflowError) as error:
        raise AllanError(f'{path} cannot be written ({error}): check the stamps') from error


def _write(
    path: Path, batches: Iterable[ImuBatch], storage: str, compression: str, topic: str
) -> int:
    if storage in ('mcap', 'sqlite3', 'ros1'):
        written = _write_bag(path, batches, storage, compression, topic)
        if path.suffix.lower() in FILE_SUFFIXES and path.is_dir():
            _keep_storage_file(path)
        return written
    if storage == 'csv':
        return write_table(path, batches)
    return _write_npz(path, batches, deflate=compression == 'deflate')


def _keep_storage_file(bag: Path) -> None:
    """Replace the folder of a bag by its storage file, for a path such as ``name.mcap``."""
    (file,) = (child for child in bag.iterdir() if child.name != 'metadata.yaml')
    kept = file.rename(bag.with_name(f'{bag.name}.file'))
    shutil.rmtree(bag)
    kept.rename(bag)


@contextmanager
def _draft(path: Path, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary path with the same name; its content is then moved to ``path``."""
    if path.exists() and not overwrite:
        raise AllanError(f'{path} exists already: choose another name, or use --overwrite')
    if path.is_dir() and not (path / 'metadata.yaml').is_file():
        raise AllanError(f'{path} is a folder, but not a bag: choose another name')
    path.parent.mkdir(parents=True, exist_ok=True)
    # a folder, because the files in a rosbag2 are named after the bag
    scratch = Path(tempfile.mkdtemp(prefix=f'.{path.name}.', dir=path.parent))
    try:
        draft = scratch / path.name
        yield draft
        if path.is_dir():
            path.rename(scratch / 'replaced')
        draft.replace(path)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _write_bag(
    path: Path, batches: Iterable[ImuBatch], storage: str, compression: str, topic: str
) -> int:
    purpose = f'{path}: writing a bag'
    typesys = optional_package('rosbags.typesys', purpose)
    package = 'rosbags.rosbag1' if storage == 'ros1' else 'rosbags.rosbag2'
    rosbag: Any = optional_package(package, purpose)
    if storage == 'ros1':
        writer, store = rosbag.Writer(path), typesys.Stores.ROS1_NOETIC
        if compression != 'none':
            writer.set_compression(writer.CompressionFormat[compression.upper()])
    else:
        plugin = rosbag.StoragePlugin[storage.upper()]
        writer = rosbag.Writer(path, version=METADATA_VERSION, storage_plugin=plugin)
        store = typesys.Stores.ROS2_JAZZY
        mode = {'chunk': 'STORAGE'}.get(compression, compression.upper())
        writer.set_compression(rosbag.CompressionMode[mode], rosbag.CompressionFormat.ZSTD)
    written = 0
    with writer:
        connection = writer.add_connection(topic, IMU_TYPE, typestore=typesys.get_typestore(store))
        for batch in batches:
            times = batch.stamps_ns if batch.record_ns is None else batch.record_ns
            payloads = encode_imus(batch, 'ros1' if storage == 'ros1' else 'cdr')
            for time_ns, payload in zip(times.tolist(), payloads):
                writer.write(connection, time_ns, payload)
            written += len(batch)
    return written


MIXED = '{}: some batches have record times and some do not: write a bag'


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
                raise AllanError(MIXED.format(path))
            columns = [map(str, batch.stamps_ns.tolist())]
            columns += [map(repr, axis) for axis in batch.samples.T.tolist()]
            if batch.record_ns is not None:
                columns.append(map(str, batch.record_ns.tolist()))
            file.writelines(delimiter.join(row) + '\n' for row in zip(*columns))
            written += len(batch)
    return written


def _write_npz(path: Path, batches: Iterable[ImuBatch], deflate: bool) -> int:
    """Write the arrays ``imu`` (with t in s), ``stamps_ns``, ``frame_id`` and, if known,
    ``record_ns``, of which all are in memory; return the number of samples."""
    parts = list(batches)
    frames = list(dict.fromkeys(batch.frame_id for batch in parts)) or ['']
    if len(frames) > 1:
        raise AllanError(f'{path}: npz stores one frame_id, not {len(frames)}: write a bag')
    record = [batch.record_ns for batch in parts if batch.record_ns is not None]
    if len(record) not in (0, len(parts)):
        raise AllanError(MIXED.format(path))
    stamps = np.concatenate([np.empty(0, np.int64), *(batch.stamps_ns for batch in parts)])
    samples = np.concatenate([np.empty((0, len(AXES))), *(batch.samples for batch in parts)])
    arrays: dict[str, Any] = {
        'imu': np.column_stack([stamps / NANOSECONDS, samples]),
        'stamps_ns': stamps,
        'frame_id': np.array(frames[0]),
    }
    if record:
        arrays['record_ns'] = np.concatenate(record)
    with path.open('wb') as file:
        (np.savez_compressed if deflate else np.savez)(file, **arrays)
    return len(stamps)
