# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write samples as a recording: an mcap bag (a folder), or a file .mcap, .db3, .csv, .tsv or .npz.

The package ``rosbags`` writes bags. A recording is written to a temporary folder next to its path,
and renamed when it is complete. All formats store header stamps and samples without loss of
precision, so reading returns exactly the same numbers.
"""

from __future__ import annotations

import os
import shutil
import struct
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..core.errors import AllanError
from ..core.imu import AXES, NANOSECONDS, ImuBatch, joined
from .cdr import IMU_TYPE, encode_imus
from .recording import METADATA, optional_package
from .tables import FRAME_COMMENT

BAG_FILES = {'.mcap': 'MCAP', '.db3': 'SQLITE3'}
"""Suffix of a bag in a single file, without metadata.yaml -> storage plugin of rosbags."""

WRITTEN_SUFFIXES = (*BAG_FILES, '.csv', '.tsv', '.npz')
"""Suffixes of the files that can be written. A name without a suffix is the folder of a bag."""

METADATA_VERSION = 8
"""Version of the metadata.yaml that is written. Distributions before ROS 2 Jazzy cannot read the
QoS of topics in version 9."""


def write_recording(
    path: str | os.PathLike[str],
    batches: Iterable[ImuBatch],
    *,
    topic: str = '/imu/data',
    overwrite: bool = False,
) -> int:
    """Write samples to a new recording, and return the number of samples.

    Parameters
    ----------
    path : path
        A file .mcap, .db3, .csv, .tsv or .npz; without a suffix, the folder of an mcap bag.
    batches : iterable of ImuBatch
        The samples, (n, 6), in the order of time, all with the same frame_id.
    topic : str
        Topic name in a bag.
    overwrite : bool
        Whether an existing recording at ``path`` is replaced.

    Raises
    ------
    AllanError
        When the path exists and ``overwrite`` is not set, when it is a folder that is not a bag,
        when it cannot be written or has another suffix, or when a bag is to be written and a stamp
        does not fit into it or the package ``rosbags`` is missing.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix and suffix not in WRITTEN_SUFFIXES:
        raise AllanError(
            f'{path}: {suffix} files cannot be written: give a file '
            f'{", ".join(WRITTEN_SUFFIXES[:-1])} or {WRITTEN_SUFFIXES[-1]}, or a name without a '
            'dot for the folder of an mcap bag'
        )
    # rosbags passes the path to SQLite within a URI, in which these characters have a meaning
    if suffix == '.db3' and {*'?#%'} & {*str(path.absolute())}:
        raise AllanError(f'{path}: choose a path without "?", "#" and "%" for a .db3 file')
    try:
        with _draft(path, overwrite) as draft:
            if suffix in ('.csv', '.tsv'):
                return write_table(draft, batches)
            if suffix == '.npz':
                return _write_npz(draft, batches)
            return _write_bag(draft, batches, topic)
    except OSError as error:
        raise AllanError(
            f'{path} cannot be written ({error.strerror or error}): '
            'check the folder, its permissions and the free space'
        ) from error
    except (struct.error, OverflowError) as error:
        raise AllanError(f'{path} cannot be written ({error}): check the stamps') from error


def _keep_storage_file(bag: Path) -> None:
    """Replace the folder of a bag by its storage file."""
    (file,) = (child for child in bag.iterdir() if child.name != METADATA)
    file_next_to_bag = file.rename(bag.with_name(f'{bag.name}.file'))
    shutil.rmtree(bag)
    file_next_to_bag.rename(bag)


@contextmanager
def _draft(path: Path, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary path with the name of ``path``, and rename it to ``path`` at the end.

    Raises AllanError when ``path`` exists and may not be replaced.
    """
    if path.exists() and not overwrite:
        raise AllanError(f'{path} exists already: choose another name, or use --overwrite')
    if path.is_dir() and not (path / METADATA).is_file():
        raise AllanError(f'{path} is a folder, but not a bag: choose another name')
    path.parent.mkdir(parents=True, exist_ok=True)
    # the draft has the final name in a temporary folder, because rosbags names files after the bag
    temporary_folder = Path(tempfile.mkdtemp(prefix=f'.{path.name}.', dir=path.parent))
    try:
        draft = temporary_folder / path.name
        yield draft
        if path.is_dir():
            path.rename(temporary_folder / 'replaced')
        draft.replace(path)
    finally:
        shutil.rmtree(temporary_folder, ignore_errors=True)


def _write_bag(path: Path, batches: Iterable[ImuBatch], topic: str) -> int:
    purpose = f'{path}: writing a bag'
    typesys = optional_package('rosbags.typesys', purpose)
    rosbag2 = optional_package('rosbags.rosbag2', purpose)
    storage = BAG_FILES.get(path.suffix.lower())
    plugin = rosbag2.StoragePlugin[storage or 'MCAP']
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    written = 0
    with rosbag2.Writer(path, version=METADATA_VERSION, storage_plugin=plugin) as writer:
        connection = writer.add_connection(topic, IMU_TYPE, typestore=store)
        for batch in batches:
            for time_ns, payload in zip(batch.stamps_ns.tolist(), encode_imus(batch, 'cdr')):
                writer.write(connection, time_ns, payload)
            written += len(batch)
    if storage:
        _keep_storage_file(path)
    return written


def write_table(path: Path, batches: Iterable[ImuBatch]) -> int:
    """Write the batches as a table, and return the number of rows.

    The delimiter is a tab if the suffix is .tsv, else a comma.
    """
    delimiter = '\t' if path.suffix.lower() == '.tsv' else ','
    written = 0
    with path.open('w', encoding='utf-8', newline='\n') as file:
        for index, batch in enumerate(batches):
            if index == 0:
                file.write(f'{FRAME_COMMENT} {" ".join(batch.frame_id.split())}\n')
                file.write(delimiter.join(['stamp_ns', *AXES]) + '\n')
            columns = [map(str, batch.stamps_ns.tolist())]
            columns += [map(repr, axis) for axis in batch.samples.T.tolist()]
            file.writelines(delimiter.join(row) + '\n' for row in zip(*columns))
            written += len(batch)
    return written


def _write_npz(path: Path, batches: Iterable[ImuBatch]) -> int:
    """Write the arrays ``imu``, ``stamps_ns`` and ``frame_id``; return the number of samples.

    All samples are kept in memory.
    """
    all_samples = joined(list(batches) or [ImuBatch.empty(len(AXES))])
    imu = np.column_stack([all_samples.stamps_ns / NANOSECONDS, all_samples.samples])
    with path.open('wb') as file:
        np.savez(
            file, imu=imu, stamps_ns=all_samples.stamps_ns, frame_id=np.array(all_samples.frame_id)
        )
    return len(all_samples)
