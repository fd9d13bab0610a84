# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Any recording of an IMU as a stream of `ImuBatch`: the one door to bags, tables and arrays.

Each family is read by a file of its own (`bags`, `tables`, `arrays`), imported only when such a
recording is opened. All stream in constant memory and speak SI.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from ...core.errors import AllanError
from .recording import (
    ReadOptions,
    Recording,
)

_LFS_MAGIC = b'version https://git-lfs'

_MAGICS = (
    (b'\x89MCAP0\r\n', 'bag'),
    (b'SQLite format 3\0', 'bag'),
    (b'#ROSBAG', 'bag'),
    (b'\x28\xb5\x2f\xfd', 'bag'),  # zstd: a file-compressed split
    (b'PK\x03\x04', 'array'),
    (b'\x93NUMPY', 'array'),
)

_FAMILIES = {
    **dict.fromkeys(('.db3', '.mcap', '.bag', '.zstd', '.zst', '.active'), 'bag'),
    **dict.fromkeys(('.npz', '.npy'), 'array'),
    **dict.fromkeys(('.csv', '.tsv', '.txt', '.dat'), 'table'),
}


def open_recordings(
    paths: Iterable[str | os.PathLike[str]], options: ReadOptions | None = None
) -> list[Recording]:
    """Open each input as one recording, whatever its form; the splits of a bag are one.

    Raises
    ------
    AllanError
        One line for the first input that cannot be used: what, where, and what to do.
    """
    options = options or ReadOptions()
    return [_open(Path(path), options) for path in paths]


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
    from .tables import open_table

    return open_table(path, options)


def _family(path: Path) -> str:
    """Tell which reader the file is for, by its first bytes rather than by its name."""
    head = first_bytes(path)
    for magic, family in _MAGICS:
        if head.startswith(magic):
            return family
    try:
        return _FAMILIES[path.suffix.lower()]
    except KeyError:
        raise AllanError(
            f'{path}: not a recording this tool knows: give a rosbag2 folder, .db3, .mcap, '
            'ROS 1 .bag, .csv, .tsv, .npz or .npy'
        ) from None


def first_bytes(path: Path) -> bytes:
    """Return the first bytes of a file that is there and holds something of its own.

    Raises
    ------
    AllanError
        When it is missing, unreadable, empty, or a Git-LFS pointer in its stead.
    """
    try:
        with path.open('rb') as file:
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
