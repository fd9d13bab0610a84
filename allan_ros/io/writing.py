# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write Imu batches as a recording: rosbag2 (mcap, sqlite3), ROS 1 bag, CSV or npz.

A recording is written to a temporary folder next to its path and renamed when it is complete. Every
form keeps int64 stamps and float64 samples, so reading any of them returns the same numbers.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ..core.errors import AllanError
from ..core.imu import ImuBatch
from .readers.cdr import encode_imus
from .readers.message_fields import IMU_TYPE
from .readers.storage import optional_package

COMPRESSIONS: dict[str, tuple[str, ...]] = {
    'mcap': ('none', 'chunk', 'message', 'file'),
    'sqlite3': ('none', 'message', 'file'),
    'ros1': ('none', 'bz2', 'lz4'),
    'csv': ('none',),
    'npz': ('none', 'deflate'),
}
"""Storage -> kinds of compression; those of rosbag2 use zstd."""
STORAGE_OF_SUFFIX = {'.bag': 'ros1', '.csv': 'csv', '.tsv': 'csv', '.npz': 'npz'}
DEFAULT_STORAGE = 'mcap'
FILE_SUFFIXES = {'.mcap': 'mcap', '.db3': 'sqlite3'}
"""Suffix of a single file instead of a bag with metadata.yaml -> its storage."""


def write_recording(
    path: str | os.PathLike[str],
    batches: Iterable[ImuBatch],
    *,
    storage: str | None = None,
    compression: str = 'none',
    topic: str = '/imu/data',
    overwrite: bool = False,
) -> int:
    """Write the batches to a new recording and return the number of samples.

    Parameters
    ----------
    path : path
        The bag directory (rosbag2) or file (ROS 1, CSV, TSV, npz).
    batches : iterable of ImuBatch
        In the order of recording.
    storage : 'mcap', 'sqlite3', 'ros1', 'csv' or 'npz', optional
        By default from the suffix: .mcap, .db3, .bag, .csv, .tsv, .npz; otherwise an mcap bag.
    compression : str
        One of `COMPRESSIONS` for that storage.
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
            f'{storage} cannot be compressed by {compression!r}: '
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


def _write(
    path: Path, batches: Iterable[ImuBatch], storage: str, compression: str, topic: str
) -> int:
    if storage in ('mcap', 'sqlite3'):
        from .rosbag2_writer import write_rosbag2

        written = write_rosbag2(path, batches, storage, compression, topic)
        if path.suffix.lower() in FILE_SUFFIXES and path.is_dir():
            _only_file(path)
        return written
    if storage == 'ros1':
        return _write_ros1(path, batches, compression, topic)
    if storage == 'csv':
        from .readers.tables import write_table

        return write_table(path, batches)
    from .readers.arrays import write_npz

    return write_npz(path, batches, deflate=compression == 'deflate')


def _only_file(bag: Path) -> None:
    """Replace a bag by its storage file, because the given name is that of a file."""
    (file,) = (child for child in bag.iterdir() if child.name != 'metadata.yaml')
    kept = file.rename(bag.with_name(f'{bag.name}.file'))
    shutil.rmtree(bag)
    kept.rename(bag)


@contextmanager
def _draft(path: Path, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary path of the same name; what is written there is moved to ``path``."""
    if path.exists() and not overwrite:
        raise AllanError(f'{path} exists already: choose another name, or --overwrite it')
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


def _write_ros1(path: Path, batches: Iterable[ImuBatch], compression: str, topic: str) -> int:
    rosbag1 = optional_package('rosbags.rosbag1', f'{path}: writing a ROS 1 bag')
    typesys = optional_package('rosbags.typesys', f'{path}: writing a ROS 1 bag')
    writer = rosbag1.Writer(path)
    if compression != 'none':
        writer.set_compression(rosbag1.Writer.CompressionFormat[compression.upper()])
    typestore = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    written = 0
    with writer:
        connection = writer.add_connection(topic, IMU_TYPE, typestore=typestore)
        for batch in batches:
            times = batch.stamps_ns if batch.record_ns is None else batch.record_ns
            for time_ns, payload in zip(times.tolist(), encode_imus(batch, 'ros1')):
                writer.write(connection, time_ns, payload)
            written += len(batch)
    return written
