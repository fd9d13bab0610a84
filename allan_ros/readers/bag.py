# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of a bag: a folder with or without metadata.yaml, or a single file.

ROS 1 bags, which must be closed and indexed, are read with the package ``rosbags``; it does not
limit the memory for a chunk.
"""

from __future__ import annotations

import os
import re
import tempfile
import threading
import weakref
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from importlib import import_module
from io import BytesIO
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, TypeAlias

import numpy as np
import yaml
from numpy.typing import NDArray

from ..core.errors import AllanError
from . import (
    MAX_CHUNK_BYTES,
    MAX_FILE_RATIO,
    METADATA,
    damaged,
    first_bytes,
    optional_package,
    translated,
)
from .files import MAX_BYTES, open_regular, parse_yaml, read_bounded

_FORMATS = {b'\x89MCAP0\r\n': 'mcap', b'SQLite format 3\0': 'sqlite3', b'#ROSBAG': 'ros1'}
"""First bytes of a bag file -> its format. The modules `mcap` and `sqlite3` read theirs."""

SPLITS = ('.db3', '.mcap', '.db3.zstd', '.mcap.zstd', '.db3.lz4', '.mcap.lz4')

MAX_MESSAGE_BYTES = 2**16
"""Largest decompressed size of a single message in bytes; an Imu message has less than 2 kB."""

_FRAME_MAGIC = {b'\x28\xb5\x2f\xfd': 'zstd', b'\x04\x22\x4d\x18': 'lz4'}


if TYPE_CHECKING:
    from .mcap import McapStorage
    from .sqlite3 import Sqlite3Storage

    Storage: TypeAlias = 'McapStorage | Sqlite3Storage | Ros1Storage'


@dataclass(frozen=True)
class Topic:
    """A topic of one bag file: its number in the file, name, and type (``package/msg/Name``).

    ``encoding`` is the serialization of the messages: 'cdr', 'ros1', or one that cannot be read.
    Raises ValueError when a name contains control characters, because then the file is damaged.
    """

    id: int
    name: str
    type: str
    encoding: str

    def __post_init__(self) -> None:
        if not (self.name + self.type + self.encoding).isprintable():
            raise ValueError('a topic name contains control characters')


Payloads = list[bytes | memoryview] | NDArray[np.void]
"""Serialized messages: one array if all have the same length, else a list."""


@dataclass
class Messages:
    """Consecutive messages of a bag: topic ids and record times in ns, (n,), and their content."""

    topics: NDArray[np.integer[Any]]
    record_ns: NDArray[np.int64]
    payloads: Payloads

    @staticmethod
    def none() -> Messages:
        """Return no messages."""
        return Messages(np.empty(0, np.int64), np.empty(0, np.int64), [])

    def __len__(self) -> int:
        return len(self.record_ns)

    def chosen(self, rows: NDArray[np.intp]) -> Messages:
        """Return the messages at these positions as copies."""
        payloads: Payloads
        if isinstance(self.payloads, np.ndarray):
            payloads = self.payloads[rows]
        else:
            payloads = [bytes(self.payloads[i]) for i in rows.tolist()]
        return Messages(self.topics[rows], self.record_ns[rows], payloads)

    def followed_by(self, other: Messages) -> Messages:
        """Return these messages and the others."""
        return Messages(
            np.concatenate([self.topics, other.topics]),
            np.concatenate([self.record_ns, other.record_ns]),
            [*self.payloads, *other.payloads],
        )


@dataclass(frozen=True)
class Truncation:
    """Readable bytes of a damaged file, and its original size (its current size if unknown)."""

    read: int
    size: int


def among(numbers: NDArray[Any], ids: Collection[int]) -> NDArray[np.bool_]:
    """Return a mask (n,) of the numbers that are in ``ids``, a collection of few ids."""
    mask = np.zeros(len(numbers), bool)
    for number in ids:
        mask |= numbers == number
    return mask


def normal_type(name: str) -> str:
    """Return a message type in ROS 2 notation: ``sensor_msgs/msg/Imu`` for ``sensor_msgs/Imu``."""
    package, *rest = name.split('/')
    return f'{package}/msg/{rest[0]}' if len(rest) == 1 else name


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
        opener: Any = _open_ros1
        if self.format != 'ros1':
            opener = import_module(f'.{self.format}', __package__).open_storage
        storage: Storage = stack.enter_context(opener(plain, file))
        return storage

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
    first_bytes(path / METADATA)
    remedy = f'restore {METADATA}, or remove it to read the .db3 or .mcap files without it'
    described: Described = {}
    # all exceptions that unexpected content can cause
    errors = (yaml.YAMLError, LookupError, TypeError, ValueError, AttributeError, OSError)
    with translated(path / METADATA, errors, remedy):
        text = read_bounded(path / METADATA, MAX_BYTES).decode()  # 50,000 files need less
        info: dict[str, Any] = parse_yaml(text)['rosbag2_bagfile_information']
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


# --- decompression with a limit ------------------------------------------------------------------


def frame_compression(head: bytes | memoryview) -> str:
    """Return how a file or message is compressed, by its first bytes: 'zstd', 'lz4' or ''."""
    return _FRAME_MAGIC.get(bytes(head[:4]), '')


def decompress(data: bytes | memoryview, compression: str, limit: int) -> bytes:
    """Return the decompressed content of a chunk or message.

    ``compression`` is 'zstd', 'lz4', 'none' or ''. Raises ValueError when it is another one, when
    the data are damaged, or when the content is longer than ``limit`` bytes.
    """
    if compression in ('', 'none'):
        return bytes(data)
    try:
        size = _stated_size(data, compression)
        if 0 <= size <= limit:
            if not hasattr(_local, 'zstd'):
                _local.zstd = _zstd().ZstdDecompressor()
            return bytes(_local.zstd.decompress(data))
        if size < 0:
            plain = bytes(_expanding(BytesIO(data), compression).read(limit + 1))
            size = len(plain)
    except AllanError:
        raise
    except Exception as error:  # each library raises its own exceptions
        raise ValueError(str(error) or type(error).__name__) from error
    if size > limit:
        raise ValueError(f'the data expand to more than {limit} bytes')
    return plain


def _stated_size(head: bytes | memoryview, compression: str) -> int:
    """Return the decompressed size stated in the header of zstd data, or -1 if there is none."""
    return int(_zstd().frame_content_size(head)) if compression == 'zstd' else -1


def _expanding(file: BinaryIO, compression: str) -> Any:
    if compression == 'zstd':
        return _zstd().ZstdDecompressor().stream_reader(file, read_across_frames=True)
    if compression == 'lz4':
        return optional_package('lz4.frame', 'reading lz4 data').open(file)
    raise ValueError(f'compression {compression!r} is unknown')


def decompress_file(source: Path, compression: str, target: Path) -> None:
    """Decompress the bag file ``source`` into the file ``target``.

    Raises AllanError when it is damaged, expands by more than `MAX_FILE_RATIO`, or the disk is
    full.
    """
    remedy = 'copy it again; check the space for temporary files'
    with (
        translated(source, (Exception,), remedy),  # each library raises its own exceptions
        open_regular(source) as file,
        target.open('wb') as out,
    ):
        limit = os.fstat(file.fileno()).st_size * MAX_FILE_RATIO + MAX_CHUNK_BYTES
        stated = _stated_size(file.read(18), compression)  # longest header, RFC 8878, 3.1.1
        file.seek(0)
        plain = _expanding(file, compression)
        size = 0
        while data := plain.read(1 << 20):
            size += len(data)
            if size > limit:
                raise ValueError(f'it expands more than {MAX_FILE_RATIO} times')
            out.write(data)
        if size < max(stated, 1):
            raise ValueError(f'{compression} data that end early')


def _zstd() -> Any:
    return optional_package('zstandard', 'reading zstd data')


_local = threading.local()
"""The decompressor of each thread, which is slow to create and must not be shared."""


# --- ROS 1 ----------------------------------------------------------------------------------------

ROS1_MAGIC = b'#ROSBAG V2.0\n'

ROS1_MESSAGES = 2048
"""Number of messages that are read at a time."""

ROS1_REMEDY = 'copy it again, or repair it with "rosbag reindex" or "rosbag fix"'


class Ros1Storage:
    """A ROS 1 bag that ``reader`` has opened; error messages name it ``path``."""

    truncation: Truncation | None = None

    def __init__(self, path: Path, reader: Any) -> None:
        self._path = path
        self._reader = reader
        self.topics = [Topic(c.id, c.topic, c.msgtype, 'ros1') for c in reader.connections]

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages."""
        return {connection.id: connection.msgcount for connection in self._reader.connections}

    def stated(self, ids: set[int], read: int) -> int:
        """Return the number of messages of these topics according to the list of chunks."""
        stated: Counter[int] = Counter()
        for chunk in self._reader.chunk_infos:
            stated.update(chunk.connection_counts)
        return sum(stated[number] for number in ids)

    def blocks(self, ids: set[int]) -> Iterator[Messages]:
        """Yield the next messages of these topics, in the order of record time."""
        with translated(self._path, (Exception,), ROS1_REMEDY):
            messages = self._reader.messages([c for c in self._reader.connections if c.id in ids])
            while batch := list(islice(messages, ROS1_MESSAGES)):
                connections, times, payloads = zip(*batch)
                topics = np.array([connection.id for connection in connections])
                yield Messages(topics, np.array(times, np.int64), list(payloads))


@contextmanager
def _open_ros1(path: Path, shown: Path) -> Iterator[Ros1Storage]:
    """Open a ROS 1 bag for reading.

    Error messages name it ``shown``, because ``path`` may be a decompressed copy. Raises AllanError
    when it is of another version or damaged, or the package ``rosbags`` is missing.
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
