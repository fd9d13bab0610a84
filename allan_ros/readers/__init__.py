# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Open recordings of IMUs: a bag (a folder or a file), a table, an array or a PX4 log.

`FORMATS` states the module and the function that open a recording of each format. The function
returns a `Recording`, which yields samples in SI units as `ImuBatch`.
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import NamedTuple, cast

from ..core.errors import AllanError
from .recording import (
    BAG_MAGICS,
    COMPRESSION_MAGICS,
    METADATA,
    ZIP_MAGIC,
    ReadOptions,
    Recording,
    SourceInfo,
    first_bytes,
)

__all__ = [
    'FORMATS',
    'SUFFIXES',
    'ReadOptions',
    'Recording',
    'SourceInfo',
    'open_recording',
    'topics_of',
]


class Format(NamedTuple):
    """A format of recordings, and the function that opens a recording of this format.

    The function ``opener`` of ``module`` has the arguments path and `ReadOptions`, and returns a
    `Recording`. A file has the format if it begins with one of ``magics``. If the first bytes of
    the file belong to no format, its suffix must be in ``suffixes`` or ``other_suffixes``. In a
    folder of recordings, only files with one of ``suffixes`` are read. ``has_topics`` states
    whether a file can contain several topics.
    """

    module: str
    opener: str
    suffixes: tuple[str, ...]
    other_suffixes: tuple[str, ...] = ()
    magics: tuple[bytes, ...] = ()
    has_topics: bool = False


FORMATS = {
    'bag': Format(
        'rosbag2',
        'open_bag',
        ('.mcap', '.db3', '.bag'),
        ('.zstd', '.zst', '.lz4', '.active'),
        (*BAG_MAGICS, *COMPRESSION_MAGICS),
        has_topics=True,
    ),
    'table': Format('tables', 'open_table', ('.csv', '.tsv'), ('.txt', '.dat')),
    'array': Format('arrays', 'open_array', ('.npz', '.npy'), magics=(ZIP_MAGIC, b'\x93NUMPY')),
    'ulog': Format('ulog', 'open_ulog', ('.ulg',), magics=(b'ULog\x01\x12\x35',), has_topics=True),
}
"""Name of a format -> description of this format. A folder always has the format 'bag'."""

SUFFIXES = tuple(suffix for file_format in FORMATS.values() for suffix in file_format.suffixes)
"""Suffixes of the files that are read as recordings if they are in a folder."""


def open_recording(path: str | os.PathLike[str], options: ReadOptions = ReadOptions()) -> Recording:
    """Open the recording at a path: a file, a folder that contains a bag, or its metadata.yaml.

    Raises AllanError when the recording cannot be opened, when the options select a topic but the
    format has no topics, or when they select an accelerometer topic but the recording is not a bag.
    """
    recording_path = _recording_path(path)
    name = format_of(recording_path)
    if options.accel_topic and name != 'bag':
        raise AllanError(f'{recording_path}: is not a bag: omit --accel-topic')
    if options.topic and not FORMATS[name].has_topics:
        raise AllanError(f'{recording_path}: has no topics: omit --topic')
    module = import_module(f'.{FORMATS[name].module}', __package__)
    return cast(Recording, getattr(module, FORMATS[name].opener)(recording_path, options))


def topics_of(path: str | os.PathLike[str]) -> list[str]:
    """Return the Imu topics of a bag; the list is empty for other formats and unreadable files.

    Topics without messages are included only if no Imu topic has messages. The list is also empty
    if the bag has more Imu topics than `rosbag2.MAX_TOPICS`.
    """
    bag_path = _recording_path(path)
    try:
        if format_of(bag_path) != 'bag':
            return []
        from .rosbag2 import imu_topics

        return imu_topics(bag_path)
    except AllanError:
        return []


def _recording_path(path: str | os.PathLike[str]) -> Path:
    """Return ``path`` or, if it is the metadata.yaml of a bag, the folder of this bag."""
    recording_path = Path(path)
    return recording_path.parent if recording_path.name == METADATA else recording_path


def format_of(path: Path) -> str:
    """Return the name of the format of a recording, as in `FORMATS`.

    A folder is a bag, whatever it contains. The first bytes of a file determine its format. If they
    belong to no format, the suffix determines it. Raises AllanError when a file is missing, empty,
    unreadable, not regular, a Git-LFS pointer or of an unknown format.
    """
    if os.path.isdir(path):  # unlike `Path.is_dir`, it raises no error if a folder is unreadable
        return 'bag'
    head, suffix = first_bytes(path), path.suffix.lower()
    formats_by_magic = [
        name for name, file_format in FORMATS.items() if head.startswith(file_format.magics)
    ]
    formats_by_suffix = [
        name
        for name, file_format in FORMATS.items()
        if suffix in (*file_format.suffixes, *file_format.other_suffixes)
    ]
    for name in (*formats_by_magic, *formats_by_suffix):
        return name
    raise AllanError(
        f'{path}: not a known type of recording: give a rosbag2 folder, or a file of the type '
        f'{", ".join(SUFFIXES[:-1])} or {SUFFIXES[-1]}'
    )
