# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Opens any recording of an IMU: bags (also the files of a folder), tables, arrays and PX4 logs.

Each family of formats has a module (`rosbag2`, `tables`, `arrays`, `ulog`), which is imported when
such a recording is opened. All of them return a `Recording`, which yields `ImuBatch` in SI units.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import cast

from ..core.errors import AllanError
from .recording import METADATA, ReadOptions, Recording, SourceInfo, first_bytes

__all__ = ['ReadOptions', 'Recording', 'SourceInfo', 'family_of', 'open_recordings', 'topics_of']

_MAGICS = {
    b'\x89MCAP0\r\n': 'bag',
    b'SQLite format 3\0': 'bag',
    b'#ROSBAG': 'bag',
    b'\x28\xb5\x2f\xfd': 'bag',  # zstd: a compressed file of a bag
    b'ULog\x01\x12\x35': 'ulog',
    b'PK\x03\x04': 'array',
    b'\x93NUMPY': 'array',
}
"""First bytes of a file -> family of formats."""

_FAMILIES = {
    **dict.fromkeys(('.db3', '.mcap', '.bag', '.zstd', '.zst', '.active'), 'bag'),
    **dict.fromkeys(('.npz', '.npy'), 'array'),
    '.ulg': 'ulog',
    **dict.fromkeys(('.csv', '.tsv', '.txt', '.dat'), 'table'),
}
"""Suffix of a file -> family of formats, if the first bytes are unknown."""

_OPENERS = {
    'bag': ('.rosbag2', 'open_bag'),
    'table': ('.tables', 'open_table'),
    'array': ('.arrays', 'open_array'),
    'ulog': ('.ulog', 'open_ulog'),
}
"""Family of formats -> module, and its function that opens a recording."""


def open_recordings(
    paths: Iterable[str | os.PathLike[str]], options: ReadOptions | None = None
) -> list[Recording]:
    """Open each path as one recording; a folder with a bag is one recording.

    Raises AllanError for the first path that cannot be read.
    """
    options = options or ReadOptions()
    return [_open(Path(path), options) for path in paths]


def topics_of(path: str | os.PathLike[str]) -> list[str]:
    """Return the Imu topics of a bag; the list is empty for other formats and unreadable files."""
    place = Path(path)
    try:
        if family_of(place) != 'bag':
            return []
        from .rosbag2 import imu_topics

        return imu_topics(place)
    except AllanError:
        return []


def _open(path: Path, options: ReadOptions) -> Recording:
    if path.name == METADATA:
        path = path.parent
    family = family_of(path)
    if options.accel_topic and family != 'bag':
        raise AllanError(f'{path}: is not a bag: omit --accel-topic')
    module, opener = _OPENERS[family]
    return cast(Recording, getattr(import_module(module, __package__), opener)(path, options))


def family_of(path: Path) -> str:
    """Return the family of formats of a path: by its first bytes, else by its suffix.

    Raises AllanError when it is unknown.
    """
    if path.is_dir():
        return 'bag'
    head = first_bytes(path)
    family = next((kind for magic, kind in _MAGICS.items() if head.startswith(magic)), None)
    family = family or _FAMILIES.get(path.suffix.lower())
    if family is None:
        raise AllanError(
            f'{path}: not a known type of recording: give a rosbag2 folder, .db3, .mcap, '
            'ROS 1 .bag, .csv, .tsv, .npz, .npy or .ulg'
        )
    return family
