# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Open any recording of an IMU: bags (the files of a folder too), tables, arrays and PX4 logs.

Each family has a module (`rosbag2`, `tables`, `arrays`, `ulog`) that is imported when such a
recording is opened. All readers yield `ImuBatch` in SI units, in constant memory.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from ...core.errors import AllanError
from ..files import open_regular, read_bounded
from .recording import ReadOptions, Recording
from .storage import Storage, damaged, decompress_file, frame_compression, normal_type, translated

_LFS_MAGIC = b'version https://git-lfs'

_MAGICS = {
    b'\x89MCAP0\r\n': ('bag', 'mcap'),
    b'SQLite format 3\0': ('bag', 'sqlite3'),
    b'#ROSBAG': ('bag', 'ros1'),
    b'\x28\xb5\x2f\xfd': ('bag', ''),  # zstd: a compressed split
    b'ULog\x01\x12\x35': ('ulog', ''),
    b'PK\x03\x04': ('array', ''),
    b'\x93NUMPY': ('array', ''),
}
"""First bytes of a file -> family, and storage of a bag."""

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

    Raises AllanError for the first path that cannot be read.
    """
    options = options or ReadOptions()
    return [_open(Path(path), options) for path in paths]


def topics_of(path: str | os.PathLike[str]) -> list[str]:
    """Return the Imu topics of a bag; an empty list for other formats and unreadable files."""
    place = Path(path)
    try:
        if not place.is_dir() and _family(place) != 'bag':
            return []
        from .bag_topics import imu_topics

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
    for magic, (family, _) in _MAGICS.items():
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


# --- the storage files of a bag ------------------------------------------------------------------

METADATA = 'metadata.yaml'

METADATA_KEY = 'rosbag2_bagfile_information'

MAX_METADATA = 16 * 2**20
"""Largest metadata.yaml that is read; one of 50,000 splits is smaller."""

SPLITS = ('.db3', '.mcap', '.db3.zstd', '.mcap.zstd', '.db3.lz4', '.mcap.lz4')


@dataclass(frozen=True)
class Described:
    """Number of messages of a topic, and their encoding, as metadata.yaml states."""

    count: int
    encoding: str


class BagFiles(NamedTuple):
    """The storage files of one bag in order, and what metadata.yaml states about its topics.

    ``described`` maps (topic, type) to that; None without metadata.
    """

    path: Path
    files: tuple[Path, ...]
    described: dict[tuple[str, str], Described] | None = None


def bag_files(path: Path) -> BagFiles:
    """Return the files of a bag: a folder with or without metadata.yaml, or one file.

    Raises AllanError when the folder contains no bag, or one of its files is missing or not a
    regular file.
    """
    if not path.is_dir():
        return BagFiles(path, (path,))
    with translated(path, (OSError,), 'check its permissions'):
        return _folder_files(path)


def _folder_files(path: Path) -> BagFiles:
    bag = _described(path) if os.path.lexists(path / METADATA) else None
    if bag is None or not bag.files:
        splits = [child for child in path.iterdir() if child.name.endswith(SPLITS)]
        if not splits:
            raise _no_bag_in(path)
        bag = BagFiles(path, tuple(sorted(splits, key=_natural)), bag.described if bag else None)
    for file in bag.files:
        first_bytes(file)
    return bag


def _natural(path: Path) -> list[tuple[int, str]]:
    """Return a sort key that puts split 10 after split 9."""
    parts = re.split(r'(\d+)', path.name)
    return [(int(part), '') if part.isdigit() else (-1, part) for part in parts]


def _no_bag_in(path: Path) -> AllanError:
    inside = sorted(
        child.name
        for child in path.iterdir()
        if child.suffix == '.bag' or (child / METADATA).is_file()
    )
    if inside:
        shown = ', '.join(inside[:5]) + (' ...' if len(inside) > 5 else '')
        return AllanError(
            f'{path}: is a folder of {len(inside)} recordings ({shown}): give each of them'
        )
    return AllanError(
        f'{path}: no bag in this folder (no {METADATA}, .db3 or .mcap): give the folder that '
        'ros2 bag recorded'
    )


def _described(path: Path) -> BagFiles:
    """Return what metadata.yaml states."""
    import yaml

    from ..files import parse_yaml

    remedy = f'restore {METADATA}, or remove it to read the .db3 or .mcap files without it'
    first_bytes(path / METADATA)
    try:
        text = read_bounded(path / METADATA, MAX_METADATA).decode()
        info: dict[str, Any] = parse_yaml(text)[METADATA_KEY]
        # Older bags include the folder that they were recorded to in the file names.
        files = [path / PurePosixPath(name).name for name in info.get('relative_file_paths') or []]
        described: dict[tuple[str, str], Described] = {}
        for entry in info.get('topics_with_message_count') or []:
            topic = entry['topic_metadata']
            key = (_text(topic['name']), normal_type(_text(topic['type'])))
            before = described[key].count if key in described else 0
            count = before + _count(entry['message_count'])
            described[key] = Described(count, _text(topic['serialization_format']))
    except (yaml.YAMLError, LookupError, TypeError, ValueError, AttributeError, OSError) as error:
        raise damaged(path / METADATA, error, remedy) from error
    if missing := [file.name for file in files if not file.exists()]:
        raise AllanError(
            f'{path}: {len(missing)} of the {len(files)} files that {METADATA} names are missing '
            f'({missing[0]}): copy the whole folder'
        )
    return BagFiles(path, tuple(files), described)


def _text(value: object) -> str:
    """Return a printable text; a damaged file may contain anything else."""
    if not isinstance(value, str):
        raise TypeError(f'a text is expected, not {type(value).__name__}')
    if not value.isprintable():
        raise ValueError('a name contains control characters')
    return value


def _count(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
        # A list may refer to itself so often that its text fills the memory.
        shown = str(value)[:40] if isinstance(value, (int, float, str)) else type(value).__name__
        raise ValueError(f'message_count is {shown!r}, not a number of messages')
    return value


@contextmanager
def open_storage(path: Path) -> Iterator[tuple[Storage, str]]:
    """Open one storage file, decompressed if necessary, and return it with its format.

    Raises AllanError when it is missing, not a storage file, or damaged.
    """
    compression = frame_compression(first_bytes(path))
    if not compression:
        with _open_plain(path, path) as storage:
            yield storage
        return
    with tempfile.TemporaryDirectory(prefix='allan_ros.') as folder:
        plain = Path(folder, path.stem)
        decompress_file(path, compression, plain)
        with _open_plain(plain, path) as storage:
            yield storage


@contextmanager
def _open_plain(path: Path, shown: Path) -> Iterator[tuple[Storage, str]]:
    from .mcap import McapStorage
    from .ros1 import Ros1Storage
    from .sqlite3 import open_sqlite3

    openers: dict[str, Any] = {
        'mcap': McapStorage.open,
        'sqlite3': open_sqlite3,
        'ros1': Ros1Storage.open,
    }
    head = first_bytes(path)
    for magic, (_, kind) in _MAGICS.items():
        if kind and head.startswith(magic):
            with openers[kind](path, shown) as storage:
                yield storage, kind
            return
    raise damaged(shown, 'it is not a bag', 'give a rosbag2 .db3 or .mcap, or a ROS 1 .bag')
