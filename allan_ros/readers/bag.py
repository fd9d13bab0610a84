# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Find and open the files of a bag: a folder with or without metadata.yaml, or a single file.

ROS 1 bags must be closed and indexed. They are read with the package ``rosbags``, which does not
limit the memory for a chunk.
"""

from __future__ import annotations

import os
import re
import tempfile
import weakref
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from importlib import import_module
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import yaml

from ..core.errors import AllanError
from .bag_messages import (
    Messages,
    Topic,
    Truncation,
    decompress_file,
    frame_compression,
    normal_type,
)
from .files import MAX_BYTES, parse_yaml, read_bounded
from .recording import (
    METADATA,
    damaged,
    first_bytes,
    optional_package,
    translated,
)

_FORMATS = {b'\x89MCAP0\r\n': 'mcap', b'SQLite format 3\0': 'sqlite3', b'#ROSBAG': 'ros1'}
"""First bytes of a bag file -> format of the file. The modules `mcap` and `sqlite3` read the
formats with these names."""

SPLITS = ('.db3', '.mcap', '.db3.zstd', '.mcap.zstd', '.db3.lz4', '.mcap.lz4')
"""Suffixes of the files in the folder of a bag."""

MAX_MESSAGE_BYTES = 2**16
"""Largest accepted size in bytes of a message that is compressed separately, after decompression.
An Imu message has less than 2 kB."""


if TYPE_CHECKING:
    from .mcap import McapStorage
    from .sqlite3 import Sqlite3Storage

    Storage: TypeAlias = 'McapStorage | Sqlite3Storage | Ros1Storage'


class Stated(NamedTuple):
    """Number of messages of a topic, and their serialization, as stated in metadata.yaml."""

    messages: int
    encoding: str


Described = dict[tuple[str, str], Stated]
"""(topic name, type) -> number of messages and serialization according to metadata.yaml."""


class Bag:
    """The files of one bag in the order of recording, and its topics according to metadata.yaml.

    ``described`` is None without metadata.yaml. At most one file is open at a time.
    """

    def __init__(self, path: Path, files: tuple[Path, ...], described: Described | None) -> None:
        self.path = path
        self.files = files
        self.described = described
        # format of the file opened last: 'mcap', 'sqlite3' or 'ros1'; '' before a file is opened
        self.format = ''
        self._open: tuple[Path, Storage] | None = None
        self._stack = ExitStack()
        weakref.finalize(self, self._stack.close)

    def storage(self, file: Path) -> Storage:
        """Return one of the files, opened for reading; a compressed file is decompressed for this.

        The file that was open before is closed. Raises AllanError when the file is missing, empty,
        not a bag, or so damaged that it cannot be opened, or when a Python package that it needs is
        missing. Other damage is found when the messages are read.
        """
        if self._open is None or self._open[0] != file:
            self.close()
            with ExitStack() as stack:  # closes the file if opening fails
                self._open = file, self._opened(file, stack)
                self._stack.enter_context(stack.pop_all())
        return self._open[1]

    def _opened(self, file: Path, stack: ExitStack) -> Storage:
        decompressed = file
        head = first_bytes(file)
        if compression := frame_compression(head):
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix='allan_ros.'))
            decompressed = Path(folder, file.stem)
            decompress_file(file, compression, decompressed)
            head = first_bytes(decompressed)
        formats = [name for magic, name in _FORMATS.items() if head.startswith(magic)]
        if not formats:
            raise damaged(file, 'it is not a bag', 'give a rosbag2 .db3 or .mcap, or a ROS 1 .bag')
        (self.format,) = formats
        opener: Any = _open_ros1
        if self.format != 'ros1':
            opener = import_module(f'.{self.format}', __package__).open_storage
        storage: Storage = stack.enter_context(opener(decompressed, file))
        return storage

    def close(self) -> None:
        """Close the open file."""
        self._open = None
        self._stack.close()


def bag_of(path: Path) -> Bag:
    """Return the bag at a path, which is a folder (with or without metadata.yaml) or one file.

    Raises AllanError when the folder contains no bag, its metadata.yaml is invalid, or one of its
    files is missing, empty, unreadable or not a regular file. A path of one file is not checked.
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
    recordings = sorted(
        child.name
        for child in path.iterdir()
        if child.suffix == '.bag' or (child / METADATA).is_file()
    )
    if recordings:
        shown = ', '.join(recordings[:5]) + (' ...' if len(recordings) > 5 else '')
        return AllanError(
            f'{path}: is a folder of {len(recordings)} recordings ({shown}): give each of them'
        )
    return AllanError(
        f'{path}: no bag in this folder (no {METADATA}, .db3 or .mcap): give the folder that '
        'ros2 bag recorded'
    )


def _read_metadata(path: Path) -> tuple[tuple[Path, ...], Described]:
    first_bytes(path / METADATA)
    remedy = f'restore {METADATA}, or remove it to read the .db3 or .mcap files without it'
    described: Described = {}
    # all exceptions that unexpected content can cause
    errors = (yaml.YAMLError, LookupError, TypeError, ValueError, AttributeError, OSError)
    with translated(path / METADATA, errors, remedy):
        # the limit is larger than the metadata of a bag with 50,000 files
        text = read_bounded(path / METADATA, MAX_BYTES).decode()
        information: dict[str, Any] = parse_yaml(text)['rosbag2_bagfile_information']
        # in older bags, the file names include the folder
        files = [
            path / PurePosixPath(name).name for name in information.get('relative_file_paths') or []
        ]
        for entry in information.get('topics_with_message_count') or []:
            topic, count = entry['topic_metadata'], entry['message_count']
            names = [topic['name'], topic['type'], topic['serialization_format']]
            if not all(isinstance(name, str) and name.isprintable() for name in names):
                raise ValueError('the name of a topic contains unprintable characters')
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


# --- ROS 1 ----------------------------------------------------------------------------------------

ROS1_MAGIC = b'#ROSBAG V2.0\n'

ROS1_MESSAGES = 2048
"""Number of messages that are read together from a ROS 1 bag."""

ROS1_REMEDY = 'copy it again, or repair it with "rosbag reindex" or "rosbag fix"'


class Ros1Storage:
    """A ROS 1 bag that ``reader`` of the package ``rosbags`` has opened.

    Error messages name the bag ``path``.
    """

    truncation: Truncation | None = None

    def __init__(self, path: Path, reader: Any) -> None:
        self._path = path
        self._reader = reader
        self.topics = [Topic(c.id, c.topic, c.msgtype, 'ros1') for c in reader.connections]

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages in the bag."""
        return {connection.id: connection.msgcount for connection in self._reader.connections}

    def stated(self, ids: set[int], read: int) -> int:
        """Return the number of messages of the topics ``ids`` according to the list of chunks.

        ``read``, the number of messages that were read, is not used.
        """
        stated: Counter[int] = Counter()
        for chunk in self._reader.chunk_infos:
            stated.update(chunk.connection_counts)
        return sum(stated[number] for number in ids)

    def blocks(self, ids: set[int]) -> Iterator[Messages]:
        """Yield all messages of the topics ``ids`` in blocks, in the order of record time."""
        with translated(self._path, (Exception,), ROS1_REMEDY):
            messages = self._reader.messages([c for c in self._reader.connections if c.id in ids])
            while batch := list(islice(messages, ROS1_MESSAGES)):
                connections, times, payloads = zip(*batch)
                topics = np.array([connection.id for connection in connections])
                yield Messages(topics, np.array(times, np.int64), list(payloads))


@contextmanager
def _open_ros1(path: Path, shown: Path) -> Iterator[Ros1Storage]:
    """Open a ROS 1 bag for reading.

    Error messages name the bag ``shown``, because ``path`` may be a decompressed copy. Raises
    AllanError when the bag is of another version or damaged, or the package ``rosbags`` is missing.
    """
    with path.open('rb') as file:
        magic = file.read(len(ROS1_MAGIC))
    if magic != ROS1_MAGIC:
        version = magic.split(b'\n')[0].decode(errors='replace')
        raise damaged(shown, f'{version!r} is not ROS bag 2.0', 'update it with "rosbag fix"')
    rosbag1 = optional_package('rosbags.rosbag1', f'{shown}: reading a ROS 1 bag')
    with translated(shown, (Exception,), ROS1_REMEDY):
        reader = rosbag1.Reader(path)
        reader.open()
    with closing(reader):
        with translated(shown, (Exception,), ROS1_REMEDY):
            storage = Ros1Storage(shown, reader)
        yield storage
