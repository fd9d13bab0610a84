# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write Imu batches as a recording: rosbag2 (mcap, sqlite3), ROS 1 bag, CSV or npz.

A recording appears under its name only when it is whole: it is written beside the target and then
renamed. Every form keeps int64 stamps and all bits of the samples, so reading any of them back
gives the same numbers.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..core.errors import AllanError
from ..core.imu import ImuBatch
from .readers.cdr import encode_imus

IMU_TYPE = 'sensor_msgs/msg/Imu'
METADATA_VERSION = 8
"""rosbag2 metadata as Jazzy writes it."""
COMPRESSIONS: dict[str, tuple[str, ...]] = {
    'mcap': ('none', 'chunk', 'message', 'file'),
    'sqlite3': ('none', 'message', 'file'),
    'ros1': ('none', 'bz2', 'lz4'),
    'csv': ('none',),
    'npz': ('none', 'deflate'),
}
"""storage -> the ways it can be compressed; those of rosbag2 use zstd."""
STORAGE_OF_SUFFIX = {'.bag': 'ros1', '.csv': 'csv', '.tsv': 'csv', '.npz': 'npz'}
DEFAULT_STORAGE = 'mcap'
URI_CHARACTERS = frozenset('?#%')
"""The sqlite3 writer of rosbags opens its file as a URI without quoting these."""


def write_recording(
    path: str | os.PathLike[str],
    batches: Iterable[ImuBatch],
    *,
    storage: str | None = None,
    compression: str = 'none',
    topic: str = '/imu/data',
    overwrite: bool = False,
) -> int:
    """Write the batches to a new recording and return how many samples it holds.

    Parameters
    ----------
    path : path
        The bag directory (rosbag2) or file (ROS 1, CSV, TSV, npz).
    batches : iterable of ImuBatch
        In the order in which they were recorded; taken one at a time.
    storage : 'mcap', 'sqlite3', 'ros1', 'csv' or 'npz', optional
        By default as the suffix says: .bag, .csv, .tsv, .npz, else an mcap bag.
    compression : str
        One of `COMPRESSIONS` for that storage.
    topic : str
        Topic name in a bag.
    overwrite : bool
        Replace what stands at ``path`` if it is a recording of that kind.

    Raises
    ------
    AllanError
        When the target exists, cannot be written, or the storage or compression is unknown.
    """
    path = Path(path)
    storage = storage or STORAGE_OF_SUFFIX.get(path.suffix.lower(), DEFAULT_STORAGE)
    if storage not in COMPRESSIONS:
        raise AllanError(f'storage {storage!r} is unknown: choose one of {", ".join(COMPRESSIONS)}')
    if compression not in COMPRESSIONS[storage]:
        raise AllanError(
            f'{storage} cannot be compressed by {compression!r}: '
            f'choose one of {", ".join(COMPRESSIONS[storage])}'
        )
    if storage == 'sqlite3' and (special := set(str(path.absolute())) & URI_CHARACTERS):
        raise AllanError(
            f'{path}: a sqlite3 bag cannot be written to a path with {" ".join(sorted(special))}: '
            'choose another name, or mcap'
        )
    try:
        with _appears_whole(path, overwrite) as draft:
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
        return _write_rosbag2(path, batches, storage, compression, topic)
    if storage == 'ros1':
        return _write_ros1(path, batches, compression, topic)
    if storage == 'csv':
        from .readers.tables import write_table

        return write_table(path, batches)
    from .readers.arrays import write_npz

    return write_npz(path, batches, deflate=compression == 'deflate')


@contextmanager
def _appears_whole(path: Path, overwrite: bool) -> Iterator[Path]:
    """Yield a hidden place of the same name; what is written there is moved to ``path``."""
    if path.exists() and not overwrite:
        raise AllanError(f'{path} exists already: choose another name, or --overwrite it')
    if path.is_dir() and not (path / 'metadata.yaml').is_file():
        raise AllanError(f'{path} is a folder that is no bag: choose another name')
    path.parent.mkdir(parents=True, exist_ok=True)
    # A folder of its own, because the files inside a rosbag2 carry the name of the bag.
    scratch = Path(tempfile.mkdtemp(prefix=f'.{path.name}.', dir=path.parent))
    try:
        draft = scratch / path.name
        yield draft
        if path.is_dir():
            path.rename(scratch / 'replaced')
        draft.replace(path)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _write_rosbag2(
    path: Path, batches: Iterable[ImuBatch], storage: str, compression: str, topic: str
) -> int:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    modes = {
        'none': CompressionMode.NONE,
        'chunk': CompressionMode.STORAGE,
        'message': CompressionMode.MESSAGE,
        'file': CompressionMode.FILE,
    }
    plugin = StoragePlugin.MCAP if storage == 'mcap' else StoragePlugin.SQLITE3
    writer = Writer(path, version=METADATA_VERSION, storage_plugin=plugin)
    writer.set_compression(modes[compression], CompressionFormat.ZSTD)
    typestore = get_typestore(Stores.ROS2_JAZZY)
    with writer:
        connection = writer.add_connection(topic, IMU_TYPE, typestore=typestore)
        return _feed(batches, 'cdr', lambda ns, data: writer.write(connection, ns, data))


def _write_ros1(path: Path, batches: Iterable[ImuBatch], compression: str, topic: str) -> int:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    writer = Writer(path)
    if compression != 'none':
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    typestore = get_typestore(Stores.ROS1_NOETIC)
    with writer:
        connection = writer.add_connection(topic, IMU_TYPE, typestore=typestore)
        return _feed(batches, 'ros1', lambda ns, data: writer.write(connection, ns, data))


def _feed(batches: Iterable[ImuBatch], encoding: Any, write: Callable[[int, Any], None]) -> int:
    """Hand every sample to ``write(record time, payload)`` and return their number."""
    written = 0
    for batch in batches:
        times = batch.stamps_ns if batch.record_ns is None else batch.record_ns
        for time_ns, payload in zip(times.tolist(), encode_imus(batch, encoding)):
            write(time_ns, payload)
        written += len(batch)
    return written
