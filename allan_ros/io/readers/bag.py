# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of a bag: a folder with or without metadata.yaml, or a single file."""

from __future__ import annotations

import os
import re
import tempfile
import weakref
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, cast

from ...core.errors import AllanError
from ..files import read_bounded
from .storage import (
    METADATA,
    Storage,
    damaged,
    decompress_file,
    first_bytes,
    frame_compression,
    normal_type,
    translated,
)

_FORMATS = {b'\x89MCAP0\r\n': 'mcap', b'SQLite format 3\0': 'sqlite3', b'#ROSBAG': 'ros1'}
"""First bytes of a bag file -> its format, which is also the name of the module that reads it."""

METADATA_KEY = 'rosbag2_bagfile_information'

MAX_METADATA = 16 * 2**20
"""Largest size in bytes of metadata.yaml; that of a bag of 50,000 files is smaller."""

SPLITS = ('.db3', '.mcap', '.db3.zstd', '.mcap.zstd', '.db3.lz4', '.mcap.lz4')


class Stated(NamedTuple):
    """Number of messages of a topic, and their serialization, as stated in metadata.yaml."""

    messages: int
    encoding: str


Described = dict[tuple[str, str], Stated]
"""(topic name, type) -> what metadata.yaml states."""


class Bag:
    """The files of one bag in order, and the topics that metadata.yaml states (None without it).

    One file is open at a time; it stays open until another one is needed.
    """

    def __init__(self, path: Path, files: tuple[Path, ...], described: Described | None) -> None:
        self.path = path
        self.files = files
        self.described = described
        self.format = ''  # of the files: 'mcap', 'sqlite3' or 'ros1'
        self._open: tuple[Path, Storage] | None = None
        self._stack = ExitStack()
        weakref.finalize(self, self._stack.close)

    def storage(self, file: Path) -> Storage:
        """Return one of the files, opened; a compressed file is decompressed to a temporary one.

        Raises AllanError when it is missing, damaged, or not a bag.
        """
        if self._open is None or self._open[0] != file:
            self.close()
            with ExitStack() as stack:  # closes everything when opening fails
                self._open = file, self._opened(file, stack)
                self._stack.enter_context(stack.pop_all())
        return self._open[1]

    def _opened(self, file: Path, stack: ExitStack) -> Storage:
        plain = file
        head = first_bytes(file)
        if compression := frame_compression(head):
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix='allan_ros.'))
            plain = Path(folder, file.stem)
            decompress_file(file, compression, plain)
            head = first_bytes(plain)
        found = [name for magic, name in _FORMATS.items() if head.startswith(magic)]
        if not found:
            raise damaged(file, 'it is not a bag', 'give a rosbag2 .db3 or .mcap, or a ROS 1 .bag')
        (self.format,) = found
        module = import_module(f'.{self.format}', __package__)
        return cast(Storage, stack.enter_context(module.open_storage(plain, file)))

    def close(self) -> None:
        """Close the open file."""
        self._open = None
        self._stack.close()


def bag_of(path: Path) -> Bag:
    """Return the bag at a path, which is a folder (with or without metadata.yaml) or one file.

    Raises AllanError when the folder contains no bag, or one of its files is missing or not a
    regular file.
    """
    if not path.is_dir():
        return Bag(path, (path,), None)
    with translated(path, (OSError,), 'check its permissions'):
        files, described = _read_metadata(path) if os.path.lexists(path / METADATA) else ((), None)
        if not files:
            splits = [child for child in path.iterdir() if child.name.endswith(SPLITS)]
            files = tuple(sorted(splits, key=_natural))
        if not files:
            raise _no_bag_in(path)
        for file in files:
            first_bytes(file)
        return Bag(path, files, described)


def _natural(path: Path) -> list[tuple[int, str]]:
    """Return a key that sorts file names by the numbers in them: 10 comes after 9."""
    parts = re.split(r'(\d+)', path.name)
    return [(int(part), '') if part.isdecimal() else (-1, part) for part in parts]


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


def _read_metadata(path: Path) -> tuple[tuple[Path, ...], Described]:
    """Return the files and topics that metadata.yaml in the folder ``path`` states."""
    import yaml

    from ..files import parse_yaml

    first_bytes(path / METADATA)
    remedy = f'restore {METADATA}, or remove it to read the .db3 or .mcap files without it'
    described: Described = {}
    # all exceptions that unexpected content can cause
    errors = (yaml.YAMLError, LookupError, TypeError, ValueError, AttributeError, OSError)
    with translated(path / METADATA, errors, remedy):
        text = read_bounded(path / METADATA, MAX_METADATA).decode()
        info: dict[str, Any] = parse_yaml(text)[METADATA_KEY]
        # in older bags, the file names include the folder
        files = [path / PurePosixPath(name).name for name in info.get('relative_file_paths') or []]
        for entry in info.get('topics_with_message_count') or []:
            topic, count = entry['topic_metadata'], entry['message_count']
            names = [topic['name'], topic['type'], topic['serialization_format']]
            if not all(isinstance(name, str) and name.isprintable() for name in names):
                raise ValueError('the name of a topic is not a printable text')
            if isinstance(count, bool) or not isinstance(count, int) or not 0 <= count < 2**63:
                raise ValueError(f'message_count of {names[0]} is not a number of messages')
            key = (names[0], normal_type(names[1]))
            count += described[key].messages if key in described else 0
            described[key] = Stated(count, names[2])
    if missing := [file.name for file in files if not file.exists()]:
        raise AllanError(
            f'{path}: {len(missing)} of the {len(files)} files that {METADATA} names are missing '
            f'({missing[0]}): copy the whole folder'
        )
    return tuple(files), described
