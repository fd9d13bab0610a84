# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which storage files make up a bag, in which order; and opening one, whatever its kind."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from ...core.errors import AllanError
from .open import first_bytes
from .storage import (
    Storage,
    damaged,
    decompression_errors,
    frame_compression,
    normal_type,
    open_decompressed,
    translated,
)

METADATA = 'metadata.yaml'

METADATA_KEY = 'rosbag2_bagfile_information'

MAX_METADATA = 16 * 2**20
"""Bytes of a metadata.yaml that is read: one of 50 000 splits is smaller."""

SPLITS = ('.db3', '.mcap', '.db3.zstd', '.mcap.zstd', '.db3.lz4', '.mcap.lz4')

STORAGES = (
    (b'\x89MCAP0\r\n', 'mcap'),
    (b'SQLite format 3\0', 'sqlite3'),
    (b'#ROSBAG', 'ros1'),
)


@dataclass(frozen=True)
class Described:
    """What metadata.yaml says of a topic."""

    count: int
    encoding: str


@dataclass(frozen=True)
class BagFiles:
    """The storage files of one bag in order, and what metadata.yaml says of their topics.

    ``described`` maps (topic, type) to it; None without metadata.
    """

    path: Path
    files: tuple[Path, ...]
    described: dict[tuple[str, str], Described] | None = None


def bag_files(path: Path) -> BagFiles:
    """Return the files of a bag: a folder with or without metadata.yaml, or one file.

    Raises
    ------
    AllanError
        When the folder holds no bag, or one of its files is missing or no file of data.
    """
    if not path.is_dir():
        return BagFiles(path, (path,))
    with translated(path, (OSError,), 'check its permissions'):
        return _folder_files(path)


def _folder_files(path: Path) -> BagFiles:
    bag = _described(path) if (path / METADATA).exists() else None
    if bag is None or not bag.files:
        splits = [child for child in path.iterdir() if child.name.endswith(SPLITS)]
        if not splits:
            raise _no_bag_in(path)
        bag = BagFiles(path, tuple(sorted(splits, key=_natural)), bag.described if bag else None)
    for file in bag.files:
        first_bytes(file)
    return bag


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort key in which split 10 comes after split 9."""
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
    """Return what metadata.yaml says."""
    import yaml

    from ..text import parse_yaml

    remedy = f'restore {METADATA}, or remove it to read the .db3 or .mcap files without it'
    first_bytes(path / METADATA)
    try:
        if (path / METADATA).stat().st_size > MAX_METADATA:
            raise ValueError(f'it has more than {MAX_METADATA} bytes')
        text = (path / METADATA).read_text(encoding='utf-8')
        info: dict[str, Any] = parse_yaml(text)[METADATA_KEY]
        # Older bags name the files with the folder they were recorded to.
        files = [path / PurePosixPath(name).name for name in info.get('relative_file_paths') or []]
        described: dict[tuple[str, str], Described] = {}
        for entry in info.get('topics_with_message_count') or []:
            topic = entry['topic_metadata']
            key = (_text(topic['name']), normal_type(_text(topic['type'])))
            before = described[key].count if key in described else 0
            count = before + int(entry['message_count'])
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
    """Return a text; a list of lists of lists would be a long one."""
    if not isinstance(value, str):
        raise TypeError(f'a text is expected, not a {type(value).__name__}')
    return value


@contextmanager
def open_storage(path: Path) -> Iterator[tuple[Storage, str]]:
    """Open one storage file and name its kind; a compressed file is decompressed beforehand.

    Raises
    ------
    AllanError
        When it is missing, no storage file, or damaged.
    """
    compression = frame_compression(first_bytes(path))
    if not compression:
        with _open_plain(path, path) as storage:
            yield storage
        return
    with tempfile.TemporaryDirectory(prefix='allan_ros.') as folder:
        plain = Path(folder, path.stem)
        try:
            with open_decompressed(path, compression) as source, plain.open('wb') as target:
                shutil.copyfileobj(source, target, 1 << 20)
        except decompression_errors() as error:
            raise damaged(
                path,
                f'{compression}: {error}',
                'copy it again; check the space for temporary files',
            ) from error
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
    for magic, kind in STORAGES:
        if head.startswith(magic):
            with openers[kind](path, shown) as storage:
                yield storage, kind
            return
    raise damaged(
        shown, 'it does not begin like a bag', 'give a rosbag2 .db3 or .mcap, or a ROS 1 .bag'
    )
