# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Open any recording of an IMU: bags, tables, arrays and PX4 logs.

Each family has a module (`rosbag2`, `tables`, `arrays`, `ulog`) that is imported when such a
recording is opened. All readers yield `ImuBatch` in SI units, in constant memory.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from ...core.errors import AllanError
from ..files import open_regular
from .recording import ReadOptions, Recording

_LFS_MAGIC = b'version https://git-lfs'

_MAGICS = (
    (b'\x89MCAP0\r\n', 'bag'),
    (b'SQLite format 3\0', 'bag'),
    (b'#ROSBAG', 'bag'),
    (b'ULog\x01\x12\x35', 'ulog'),
    (b'\x28\xb5\x2f\xfd', 'bag'),  # zstd: a compressed split
    (b'PK\x03\x04', 'array'),
    (b'\x93NUMPY', 'array'),
)

_FAMILIES = {
    **dict.fromkeys(('.db3', '.mcap', '.bag', '.zstd', '.zst', '.active'), 'bag'),
    **dict.fromkeys(('.npz', '.npy'), 'array'),
    '.ulg': 'ulog',
    **dict.fromkeys(('.csv', '.tsv', '.txt', '.dat'), 'table'),
}


def open_recordings(
    paths: Iterable[str | os.PathLike[str]], options: ReadOptions | None = None
) -> list[Recording]:
    """Open each path as one recording; the splits of a bag are one recording.

    Parameters
    ----------
    paths : iterable of path
    options : ReadOptions, optional

    Raises AllanError for the first path that cannot be read.
    """
    options = options or ReadOptions()
    return [_open(Path(path), options) for path in paths]


def topics_of(path: str | os.PathLike[str]) -> list[str]:
    """Return the Imu topics of a bag; none of another recording, or where it cannot be read."""
    place = Path(path)
    try:
        if not place.is_dir() and _family(place) != 'bag':
            return []
        from .rosbag2 import imu_topics

        return imu_topics(place)
    except AllanError:
        return []


def _open(path: Path, options: ReadOptions) -> Recording:
    if path.name == 'metadata.yaml':
        path = path.parent
    family = 'bag' if path.is_dir() else _family(path)
    if family == 'bag':
        from .rosbag2 import open_bag

        return open_bag(path, options)
    if family == 'array':
        from .arrays import open_array

        return open_array(path, options)
    if family == 'ulog':
        from .ulog import open_ulog

        return open_ulog(path, options)
    from .tables import open_table

    return open_table(path, options)


def _family(path: Path) -> str:
    """Return the reader for the file, by its first bytes and, failing that, its suffix."""
    head = first_bytes(path)
    for magic, family in _MAGICS:
        if head.startswith(magic):
            return family
    try:
        return _FAMILIES[path.suffix.lower()]
    except KeyError:
        raise AllanError(
            f'{path}: not a known form of recording: give a rosbag2 folder, .db3, .mcap, '
            'ROS 1 .bag, .csv, .tsv, .npz, .npy or .ulg'
        ) from None


def first_bytes(path: Path) -> bytes:
    """Return the first bytes of a file.

    Raises AllanError when it is missing, unreadable, not a regular file, empty, or a Git-LFS
    pointer.
    """
    try:
        with open_regular(path) as file:
            head = file.read(64)
    except FileNotFoundError:
        raise AllanError(f'{path}: no such file or folder: check the path') from None
    except OSError as error:
        raise AllanError(
            f'{path}: cannot be read ({error.strerror}): check its permissions'
        ) from error
    if not head:
        raise AllanError(f'{path}: is empty (0 bytes): record or copy it again')
    if head.startswith(_LFS_MAGIC):
        raise AllanError(
            f'{path}: is a Git-LFS pointer, not the recording: fetch it with "git lfs pull"'
        )
    return head
