# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Common parts of the readers of bag files: topics, messages, chunks, decompression."""

from __future__ import annotations

import bz2
import importlib
import os
import zlib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from ...core.errors import AllanError
from ..files import open_regular

MAX_CHUNK_BYTES = 128 * 2**20
"""Largest size in bytes of a chunk or record, compressed or not; recorders write about 1 MB."""

MAX_MESSAGE_BYTES = 4 * 2**20
"""Largest decompressed size of a single message in bytes."""

MAX_FILE_RATIO = 250
"""Largest expansion of a compressed bag file; `MAX_CHUNK_BYTES` more are always allowed."""

MAX_SORT_BYTES = 512 * 2**20
"""Largest size in bytes of the messages that are kept in memory to sort overlapping chunks."""

MAX_FRAME_HEADER = 18
"""Longest header of a zstd frame in bytes (RFC 8878, section 3.1.1)."""

_COPY_BYTES = 1 << 20

_FRAME_MAGIC = {b'\x28\xb5\x2f\xfd': 'zstd', b'\x04\x22\x4d\x18': 'lz4'}


@dataclass(frozen=True)
class Topic:
    """A topic of one bag file: its number in the file, name, and type (``package/msg/Name``).

    ``encoding`` is the serialization of the messages: 'cdr', 'ros1', or one that cannot be read.
    ``schema`` is the text that defines the message type, and ``schema_format`` its format, such as
    'ros2msg'; both are '' if the file has none. Raises ValueError when a name contains control
    characters, because then the file is damaged.
    """

    id: int
    name: str
    type: str
    encoding: str
    schema_format: str = ''
    schema: str = ''

    def __post_init__(self) -> None:
        if not (self.name + self.type + self.encoding).isprintable():
            raise ValueError('a topic name contains control characters')


Payloads = list[bytes | memoryview] | NDArray[np.void]
"""Serialized messages: one array if all have the same length, else a list."""


@dataclass
class Messages:
    """Consecutive messages of a bag: record times in ns, (n,), and serialized content."""

    record_ns: NDArray[np.int64]
    payloads: Payloads


@dataclass(frozen=True)
class Truncation:
    """Readable bytes of a damaged file, and its original size (its current size if unknown)."""

    read: int
    size: int


class Storage(Protocol):
    """An open bag file; ``truncation`` is None if it is complete."""

    topics: list[Topic]
    truncation: Truncation | None

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages."""

    def blocks(self, ids: set[int]) -> Iterator[Messages]:
        """Yield the messages of the topics with these ids in the order of their record time."""

    def stated(self, ids: set[int], read: int) -> int:
        """Return how many messages of these topics the file contains, according to its index.

        Call it after `blocks` with the number of messages that were read, which is returned if the
        file has no index.
        """


def gathered(data: Any, start: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return copies of the records, of type ``dtype``, that begin at these byte offsets, (n,)."""
    if not len(start):
        return np.empty(0, dtype)
    anywhere = np.ndarray((len(data) - dtype.itemsize + 1,), dtype, data, strides=(1,))
    return anywhere[start]


def among(numbers: NDArray[Any], ids: Collection[int]) -> NDArray[np.bool_]:
    """Return a mask (n,) of the numbers that are in ``ids``, a collection of few ids."""
    mask = np.zeros(len(numbers), bool)
    for number in ids:
        mask |= numbers == number
    return mask


def as_list(payloads: Payloads) -> list[bytes | memoryview]:
    """Return the messages as a list."""
    return payloads if isinstance(payloads, list) else payloads.tolist()


def normal_type(name: str) -> str:
    """Return a message type in ROS 2 notation: ``sensor_msgs/msg/Imu`` for ``sensor_msgs/Imu``."""
    package, *rest = name.split('/')
    return f'{package}/msg/{rest[0]}' if len(rest) == 1 else name


def damaged(path: Path, reason: object, remedy: str) -> AllanError:
    """Return the error for a file that cannot be read; ``remedy`` is the advice to the user."""
    words = ' '.join(str(reason).split())[:160] or type(reason).__name__
    return AllanError(f'{path}: cannot be read ({words}): {remedy}')


@contextmanager
def translated(path: Path, errors: tuple[type[Exception], ...], remedy: str) -> Iterator[None]:
    """Context manager that converts the given exceptions to AllanError for a damaged file."""
    try:
        yield
    except AllanError:
        raise
    except errors as error:
        raise damaged(path, error, remedy) from error


DEBIAN_PACKAGES = {name: f' or "apt install python3-{name}"' for name in ('lz4', 'zstandard')}
"""Package -> hint that it can be installed with apt, because Ubuntu blocks pip (PEP 668)."""


def optional_package(module: str, purpose: str) -> Any:
    """Import and return a module; if missing, raise AllanError with the command to install it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        package = module.split('.')[0]
        raise AllanError(
            f'{purpose} needs the Python package {package!r}: "pip install {package}"'
            f'{DEBIAN_PACKAGES.get(package, "")}'
        ) from None


# --- decompression with a limit ------------------------------------------------------------------


def frame_compression(head: bytes | memoryview) -> str:
    """Return how a file or message is compressed, by its first bytes: 'zstd', 'lz4' or ''."""
    return _FRAME_MAGIC.get(bytes(head[:4]), '')


def decompress(data: bytes | memoryview, compression: str, limit: int) -> bytes:
    """Return the decompressed content of a chunk or message.

    ``compression`` is 'zstd', 'lz4', 'bz2', 'none' or ''. Raises ValueError when it is another one,
    when the data are damaged, or when the content is longer than ``limit`` bytes.
    """
    if compression in ('', 'none'):
        return bytes(data)
    try:
        size = _stated_size(data, compression)
        if size > limit:
            raise ValueError(f'it states {size} bytes, the limit is {limit}')
        if size >= 0:
            return bytes(_zstd_decompressor().decompress(data))
        plain = bytes(_expanding(BytesIO(data), compression).read(limit + 1))
    except AllanError:
        raise
    except Exception as error:  # each library raises its own exceptions
        raise ValueError(str(error) or type(error).__name__) from error
    if len(plain) > limit:
        raise ValueError(f'the data expand to more than {limit} bytes')
    return plain


def _stated_size(head: bytes | memoryview, compression: str) -> int:
    """Return the decompressed size stated in the header of zstd data, or -1 if there is none."""
    return int(_zstd().frame_content_size(head)) if compression == 'zstd' else -1


def _expanding(file: BinaryIO, compression: str) -> Any:
    """Return a file object with the decompressed content of ``file``."""
    if compression == 'zstd':
        return _zstd().ZstdDecompressor().stream_reader(file, read_across_frames=True)
    if compression == 'lz4':
        return optional_package('lz4.frame', 'reading lz4 data').open(file)
    if compression == 'bz2':
        return bz2.open(file)
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
        stated = _stated_size(file.read(MAX_FRAME_HEADER), compression)
        file.seek(0)
        plain = _expanding(file, compression)
        size = 0
        while data := plain.read(_COPY_BYTES):
            size += len(data)
            if size > limit:
                raise ValueError(f'it expands more than {MAX_FILE_RATIO} times')
            out.write(data)
        if size < max(stated, 1):
            raise ValueError(f'{compression} data that end early')


@lru_cache(maxsize=1)
def _zstd() -> Any:
    return optional_package('zstandard', 'reading zstd data')


@lru_cache(maxsize=1)
def _zstd_decompressor() -> Any:
    """Return a cached decompressor, because creating one takes longer than using it."""
    return _zstd().ZstdDecompressor()


# --- files that consist of chunks ----------------------------------------------------------------


@dataclass(frozen=True, order=True)
class Chunk:
    """A part of a file that contains messages: time of the first one, offset and length in bytes.

    In mcap, an index of ``index_length`` bytes follows the chunk, and ``loose`` marks a sequence of
    messages outside chunks.
    """

    start_ns: int
    offset: int
    length: int
    index_length: int = 0
    loose: bool = False


class ChunkStorage(ABC):
    """An open bag file that consists of chunks; subclasses implement the format.

    `DAMAGE` are the exceptions caused by a damaged file, and `REMEDY` is the advice to the user.
    """

    DAMAGE: ClassVar[tuple[type[Exception], ...]]
    REMEDY: ClassVar[str]

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file
        self._size = os.fstat(file.fileno()).st_size
        self._topics: dict[int, Topic] = {}
        self._counts: Counter[int] = Counter()
        self._stated: Counter[int] = Counter()
        self._chunks: list[Chunk] = []
        self.truncation: Truncation | None = None
        self._survey()
        self._chunks.sort()
        self.topics = list(self._topics.values())

    @classmethod
    @contextmanager
    def open(cls, path: Path, shown: Path) -> Iterator[Storage]:
        """Open the file ``path``.

        Error messages name it ``shown``, because it may be a decompressed copy. Raises AllanError
        when the file is of another format or damaged.
        """
        with translated(shown, (OSError,), cls.REMEDY):
            file = open_regular(path)
        with file:
            with translated(shown, cls.DAMAGE, cls.REMEDY):
                storage = cls(shown, file)
            yield storage

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages."""
        return dict(self._counts)

    def stated(self, ids: set[int], read: int) -> int:
        """Return the number of messages of these topics in the index; ``read`` if there is none."""
        if not self._stated:
            return read
        stated = sum(self._stated[number] for number in ids)
        return max(stated, read) if self.truncation else stated  # the index may be truncated, too

    def blocks(self, ids: set[int]) -> Iterator[Messages]:
        """Yield the messages of the topics with these ids in the order of their record time."""
        with translated(self._path, self.DAMAGE, self.REMEDY):
            in_order = ChunkSorter()
            ends = [chunk.start_ns for chunk in self._chunks[1:]] + [None]
            for chunk, until in zip(self._chunks, ends):
                yield in_order.add(self._messages(chunk, ids), until)

    @abstractmethod
    def _survey(self) -> None:
        """Find the topics, the chunks, the number of messages, and whether data are missing."""

    @abstractmethod
    def _messages(self, chunk: Chunk, ids: set[int]) -> Messages:
        """Return the messages of these topics in a chunk, in the order of the chunk."""

    def _read(self, offset: int, length: int) -> bytes:
        if length > MAX_CHUNK_BYTES:
            raise ValueError(
                f'a record of {length} bytes at byte {offset}, the limit is {MAX_CHUNK_BYTES}'
            )
        self._file.seek(offset)
        return self._file.read(length)

    def _unpacked(
        self, offset: int, stored: bytes | memoryview, compression: str, size: int, crc: int = 0
    ) -> bytes:
        """Decompress a chunk to ``size`` bytes and check its CRC-32 unless ``crc`` is 0.

        ``stored`` is the compressed chunk, and ``offset`` its position for error messages.
        """
        try:
            data = decompress(stored, compression, min(size, MAX_CHUNK_BYTES))
            if len(data) != size:
                raise ValueError(f'{len(data)} bytes instead of {size}')
            if crc and zlib.crc32(data) != crc:
                raise ValueError('its checksum is wrong')
        except ValueError as error:
            reason = f'the chunk at byte {offset} is damaged: {error}'
            raise damaged(self._path, reason, self.REMEDY) from error
        return data


class ChunkSorter:
    """Sorts the messages of overlapping chunks by record time.

    The chunks are added in the order of their start times. Only messages that were recorded after
    the start of the next chunk are kept in memory.
    """

    def __init__(self) -> None:
        self._pending = Messages(np.empty(0, np.int64), [])

    def add(self, chunk: Messages, until: int | None) -> Messages:
        """Add the messages of a chunk, and return all messages recorded before ``until``.

        ``until`` is the start of the next chunk in ns, or None after the last chunk.
        """
        pending, times = self._pending, chunk.record_ns
        complete = until is None or not len(times) or times[-1] < until
        if complete and not len(pending.record_ns) and (times[1:] >= times[:-1]).all():
            return chunk
        payloads = _joined(pending.payloads, chunk.payloads)
        times = np.concatenate([pending.record_ns, times])
        order = np.argsort(times, kind='stable')
        times = times[order]
        ready = len(times) if until is None else int(np.searchsorted(times, until))
        later = _copied(payloads, order[ready:])
        size = sum(map(len, later)) if isinstance(later, list) else later.nbytes
        if size > MAX_SORT_BYTES:
            raise ValueError(f'chunks overlap by more than {MAX_SORT_BYTES} bytes')
        self._pending = Messages(times[ready:], later)
        return Messages(times[:ready], _copied(payloads, order[:ready]))


def _joined(first: Payloads, second: Payloads) -> Payloads:
    """Concatenate messages: to one array if all have the same length, else to a list."""
    if not len(first):
        return second
    if isinstance(first, list) or isinstance(second, list) or first.dtype != second.dtype:
        return [*as_list(first), *as_list(second)]
    return np.concatenate([first, second])


def _copied(payloads: Payloads, rows: NDArray[np.intp]) -> Payloads:
    """Return the messages at these positions as copies, so that their chunk can be freed."""
    if isinstance(payloads, np.ndarray):
        return payloads[rows]
    return [bytes(payloads[row]) for row in rows.tolist()]
