# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Find the files and topics of a bag: a folder with or without metadata.yaml, or a single file."""

from __future__ import annotations

import os
import re
import tempfile
import weakref
from collections import Counter
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, TypeAlias

import yaml

from ..core.errors import AllanError
from .bag_messages import Topic, Truncation, decompress_file, frame_compression, normal_type
from .cdr import IMU_TYPE
from .files import MAX_BYTES, parse_yaml, read_bounded
from .recording import (
    BAG_MAGICS,
    BAG_SUFFIXES,
    METADATA,
    damaged,
    first_bytes,
    listed,
    translated,
)

ENCODINGS = ('cdr', 'ros1')
"""Serializations of messages that can be read."""


if TYPE_CHECKING:
    from .mcap import McapStorage
    from .ros1 import Ros1Storage
    from .sqlite3 import Sqlite3Storage

    Storage: TypeAlias = 'McapStorage | Sqlite3Storage | Ros1Storage'


TopicKey = tuple[str, str]
"""Topic name and type, which identify a topic in all files of a bag."""


@dataclass
class Survey:
    """The topics of a bag, and the number of messages of each topic."""

    topics: dict[TopicKey, Topic] = field(default_factory=dict)
    counts: Counter[TopicKey] = field(default_factory=Counter)
    # truncation of the first truncated file; None if no file is truncated, or if the files were not
    # checked, because metadata.yaml states more than 0 Imu messages
    truncation: Truncation | None = None

    def listed(self, keys: Iterable[TopicKey]) -> str:
        """Return the name, type and number of messages of the topics ``keys``, as text.

        If there are more than `recording.MOST_LISTED` topics, the others are counted.
        """
        shown = []
        for key in keys:
            encoding = self.topics[key].encoding
            unsupported = '' if encoding in ENCODINGS else f', serialized as {encoding}'
            shown.append(f'{key[0]} ({key[1]}, {self.counts[key]}{unsupported})')
        return listed(shown)

    def imus(self) -> list[TopicKey]:
        """Return the Imu topics that have messages, or all Imu topics if none has messages."""
        imus = [key for key in self.topics if key[1] == IMU_TYPE]
        return [key for key in imus if self.counts[key]] or imus


class Bag:
    """The files of one bag in the order of recording, and its topics according to metadata.yaml.

    The order is stated by metadata.yaml or, without it, by the numbers in the file names.
    ``described`` is None without metadata.yaml, or if the bag is a single file. At most one file is
    open at a time.
    """

    def __init__(self, path: Path, files: tuple[Path, ...], described: Survey | None) -> None:
        self.path = path
        self.files = files
        self.described = described
        # format of the file opened last: 'mcap', 'sqlite3' or 'ros1'; '' before a file is opened
        self.format = ''
        self._open: tuple[Path, Storage] | None = None
        self._stack = ExitStack()
        weakref.finalize(self, self._stack.close)

    def storage(self, file: Path) -> Storage:
        """Open one of the files for reading; a compressed file is decompressed first.

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
        formats = [name for magic, name in BAG_MAGICS.items() if head.startswith(magic)]
        if not formats:
            raise damaged(file, 'it is not a bag', 'give a rosbag2 .db3 or .mcap, or a ROS 1 .bag')
        (self.format,) = formats
        opener: Any = import_module(f'.{self.format}', __package__).open_storage
        storage: Storage = stack.enter_context(opener(decompressed, file))
        return storage

    def close(self) -> None:
        """Close the open file."""
        self._open = None
        self._stack.close()

    def survey(self) -> Survey:
        """Return the topics of the bag, and the number of messages of each topic.

        The numbers are taken from metadata.yaml if it was read and states more than 0 Imu messages.
        Otherwise, the numbers in the files of the bag are determined as well, and the larger number
        is used for each topic. Raises AllanError when a file that is opened is missing, damaged, or
        not a bag; the first file is always opened.
        """
        metadata = self.described or Survey()
        survey = Survey(metadata.topics.copy(), metadata.counts.copy())
        self.storage(self.files[0])
        if any(key[1] == IMU_TYPE and count for key, count in survey.counts.items()):
            return survey
        counts_of_files: Counter[TopicKey] = Counter()
        for file in self.files:
            storage = self.storage(file)
            file_counts = storage.counts()
            for topic in storage.topics:
                key = (topic.name, topic.type)
                survey.topics.setdefault(key, topic)
                counts_of_files[key] += file_counts.get(topic.id, 0)
            survey.truncation = survey.truncation or storage.truncation
        survey.counts |= counts_of_files
        return survey


def bag_of(path: Path) -> Bag:
    """Return the bag at a path, which is a folder (with or without metadata.yaml) or one file.

    Raises AllanError when the folder contains no bag, its metadata.yaml is invalid, or one of its
    files is missing, empty, unreadable or not a regular file. A path of one file is not checked.
    """
    if not os.path.isdir(path):
        return Bag(path, (path,), None)
    with translated(path, (OSError,), 'check its permissions'):
        files, described = _read_metadata(path) if os.path.lexists(path / METADATA) else ((), None)
        if not files:
            splits = [child for child in path.iterdir() if child.name.endswith(BAG_SUFFIXES)]
            files = tuple(sorted(splits, key=_number_sort_key))
        if not files:
            raise _no_bag_in(path)
        for file in files:
            first_bytes(file)
        return Bag(path, files, described)


def _number_sort_key(path: Path) -> list[tuple[int, str]]:
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
        'ros2 bag recorded, or other recordings (.csv, .npz, .ulg ...)'
    )


def _read_metadata(path: Path) -> tuple[tuple[Path, ...], Survey]:
    first_bytes(path / METADATA)
    remedy = f'restore {METADATA}, or remove it to read the .db3 or .mcap files without it'
    described = Survey()
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
            key = (topic['name'], normal_type(topic['type']))
            described.topics[key] = Topic(0, *key, topic['serialization_format'])
            if isinstance(count, bool) or not isinstance(count, int) or not 0 <= count < 2**63:
                raise ValueError(f'message_count of {key[0]} is not a number of messages')
            described.counts[key] += count
    if missing := [file.name for file in files if not file.exists()]:
        raise AllanError(
            f'{path}: {len(missing)} of the {len(files)} files that {METADATA} names are missing '
            f'({missing[0]}): copy the whole folder'
        )
    return tuple(files), described
