# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the bag reader asks of every storage file, be it sqlite3, mcap or ROS 1."""

from __future__ import annotations

import bz2
import os
import zlib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import IO, Any, BinaryIO, ClassVar, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...core.errors import AllanError

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'

LZ4_MAGIC = b'\x04\x22\x4d\x18'


@dataclass(frozen=True)
class Topic:
    """One topic of one storage file.

    Attributes
    ----------
    id : int
        Number inside that file.
    name, type : str
        Topic and message type, spelled ``package/msg/Name``.
    encoding : str
        Serialization of its messages: 'cdr', 'ros1', or one we cannot read.
    schema_format, schema : str
        Definition of the type: 'ros2msg', 'ros2idl' or 'ros1msg', or '' where the file has none.

    Raises
    ------
    ValueError
        When a name holds control characters, which only damage brings about.
    """

    id: int
    name: str
    type: str
    encoding: str
    schema_format: str = ''
    schema: str = ''

    def __post_init__(self) -> None:
        if not (self.name + self.type + self.encoding).isprintable():
            raise ValueError('the name of a topic is no text')


Payloads = list[bytes | memoryview] | NDArray[np.void]
"""Serialized messages; one array of them where all have the same length."""


@dataclass
class Block:
    """Consecutive messages: when each was recorded (ns), and its serialized bytes."""

    record_ns: NDArray[np.int64]
    payloads: Payloads


def gathered(data: Any, start: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the records of one type that begin at these bytes, wherever they are."""
    anywhere = np.ndarray((len(data) - dtype.itemsize + 1,), dtype, data, strides=(1,))
    return anywhere[start]


def among(numbers: NDArray[Any], ids: Collection[int]) -> NDArray[np.bool_]:
    """Return which topics are among the wanted ones, of which there are one or two."""
    mine = np.zeros(len(numbers), bool)
    for number in ids:
        mine |= numbers == number
    return mine


@dataclass(frozen=True)
class Cut:
    """How far a file that was cut off could be read."""

    read: int
    size: int


class Storage(Protocol):
    """An open storage file."""

    topics: list[Topic]
    cut: Cut | None

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages."""

    def blocks(self, ids: set[int]) -> Iterator[Block]:
        """Yield the messages of these topics in the order of their record time."""


def damaged(path: Path, reason: object, remedy: str) -> AllanError:
    """Return the error for a file whose insides are not what they should be."""
    words = ' '.join(str(reason).split())[:160] or type(reason).__name__
    return AllanError(f'{path}: cannot be read ({words}): {remedy}')


@contextmanager
def translated(path: Path, errors: tuple[type[Exception], ...], remedy: str) -> Iterator[None]:
    """Turn what a library raises on a damaged file into the one line for the user."""
    try:
        yield
    except errors as error:
        raise damaged(path, error, remedy) from error


def normal_type(name: str) -> str:
    """Spell a type as ROS 2 does: ``sensor_msgs/Imu`` is ``sensor_msgs/msg/Imu``."""
    package, *rest = name.split('/')
    return f'{package}/msg/{rest[0]}' if len(rest) == 1 else name


def decompress(data: bytes | memoryview, compression: str) -> bytes:
    """Return the bytes of a compressed chunk or message.

    Raises
    ------
    ValueError
        When the compression is unknown or the data are damaged.
    """
    if compression in ('', 'none'):
        return bytes(data)
    if compression == 'bz2':
        return _translated(OSError, bz2.decompress, data)
    if compression == 'lz4':
        import lz4.frame

        return _translated(RuntimeError, lz4.frame.decompress, data)
    if compression == 'zstd':
        if reused := _reused_zstd():
            with suppress(ValueError):  # a frame that does not state its size
                return _translated(reused.error, reused.decompress, data)
        zstd = _zstd()
        return _translated(zstd.ZstdError, zstd.decompress, data)
    raise ValueError(f'compression {compression!r} is not known')


def decompress_all(
    messages: list[bytes | memoryview], compression: str
) -> list[bytes | memoryview] | None:
    """Return messages that were compressed one by one, or None if they are not all plain sailing.

    Then `decompress` tells of each.
    """
    reused = _reused_zstd() if compression == 'zstd' else None
    if reused:
        with suppress(reused.error):  # one is damaged, or does not state its size
            return list(map(reused.decompress, messages))
    return None


def frame_compression(head: bytes | memoryview) -> str:
    """Tell by its first bytes how a whole file or message is compressed; '' if it is not."""
    start = bytes(head[:4])
    return {ZSTD_MAGIC: 'zstd', LZ4_MAGIC: 'lz4'}.get(start, '')


def open_decompressed(path: Path, compression: str) -> AbstractContextManager[IO[bytes]]:
    """Open a compressed file for reading what it holds."""
    opened: Any
    if compression == 'zstd':
        opened = _zstd().open(path, 'rb')
    else:
        import lz4.frame

        opened = lz4.frame.open(path, 'rb')
    file: AbstractContextManager[IO[bytes]] = opened
    return file


def decompression_errors() -> tuple[type[Exception], ...]:
    """Return what the libraries raise on damaged data while a file is read."""
    return (OSError, EOFError, RuntimeError, ValueError, _zstd().ZstdError)


def _translated(error_type: type[Exception], function: Any, data: bytes | memoryview) -> bytes:
    try:
        result: bytes = function(data)
    except (error_type, EOFError, OSError, ValueError) as error:
        raise ValueError(f'{error}') from error
    return result


class _ReusedZstd(NamedTuple):
    decompress: Callable[[bytes | memoryview], bytes]
    error: type[Exception]


@lru_cache(maxsize=1)
def _reused_zstd() -> _ReusedZstd | None:
    """Return one decompressor for all messages where the zstandard package is installed.

    The standard library makes a new one for each, which costs ten times the decompression.
    """
    try:
        import zstandard
    except ImportError:
        return None
    return _ReusedZstd(zstandard.ZstdDecompressor().decompress, zstandard.ZstdError)


def _zstd() -> Any:
    """Return the zstd of the standard library (Python 3.14), or its backport."""
    try:
        from compression import zstd
    except ImportError:
        from backports import zstd
    return zstd


def as_list(payloads: Payloads) -> list[bytes | memoryview]:
    """Return the messages one by one."""
    return payloads if isinstance(payloads, list) else payloads.tolist()


@dataclass(frozen=True, order=True)
class Stretch:
    """A stretch of the file that holds messages, and when the first of them was recorded."""

    start_ns: int
    offset: int
    length: int


Chunk = TypeVar('Chunk', bound=Stretch)


class ChunkStorage(ABC, Generic[Chunk]):
    """An open file of chunks, of a format that says where they are and what is in one.

    Attributes
    ----------
    DAMAGE : tuple of types
        What reading a damaged file raises.
    REMEDY : str
        What to do about one.
    """

    DAMAGE: ClassVar[tuple[type[Exception], ...]]
    REMEDY: ClassVar[str]

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file
        self._size = os.fstat(file.fileno()).st_size
        self._topics: dict[int, Topic] = {}
        self._counts: Counter[int] = Counter()
        self._chunks: list[Chunk] = []
        self.cut: Cut | None = None
        self._survey()
        self._chunks.sort()
        self.topics = list(self._topics.values())

    @classmethod
    @contextmanager
    def open(cls, path: Path, shown: Path) -> Iterator[Storage]:
        """Open a file.

        ``shown`` is the name used in messages, which differs for a decompressed copy.

        Raises
        ------
        AllanError
            When it is of another format or damaged.
        """
        with translated(shown, (OSError,), cls.REMEDY):
            file = path.open('rb')
        with file:
            with translated(shown, cls.DAMAGE, cls.REMEDY):
                storage = cls(shown, file)
            yield storage

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages."""
        return dict(self._counts)

    def blocks(self, ids: set[int]) -> Iterator[Block]:
        """Yield the messages of these topics in the order of their record time."""
        with translated(self._path, self.DAMAGE, self.REMEDY):
            in_order = InOrder()
            ends = [chunk.start_ns for chunk in self._chunks[1:]] + [None]
            for chunk, until in zip(self._chunks, ends):
                yield in_order.add(self._messages(chunk, ids), until)

    @abstractmethod
    def _survey(self) -> None:
        """Find the topics, the chunks and how many messages there are; and where it is cut."""

    @abstractmethod
    def _messages(self, chunk: Chunk, ids: set[int]) -> Block:
        """Return the messages of these topics in a chunk, in its order."""

    def _read(self, offset: int, length: int) -> bytes:
        self._file.seek(offset)
        return self._file.read(length)

    def _unpacked(
        self,
        offset: int,
        stored: bytes | memoryview,
        compression: str,
        size: int,
        checksum: int = 0,
    ) -> bytes:
        """Return the records of the chunk at ``offset``, decompressed; a CRC-32 of 0 is none."""
        try:
            data = decompress(stored, compression)
            if len(data) != size:
                raise ValueError(f'{len(data)} bytes in place of {size}')
            if checksum and zlib.crc32(data) != checksum:
                raise ValueError('its checksum does not match')
        except ValueError as error:
            raise damaged(
                self._path, f'the chunk at byte {offset} is damaged: {error}', self.REMEDY
            ) from error
        return data


@dataclass
class InOrder:
    """Puts the messages of overlapping chunks in the order of their record time.

    Feed the chunks by their start time; what lies before the start of the next one is complete.
    Only the overlap is held back, so memory does not grow with the file.
    """

    _held: list[Block] = field(default_factory=list)

    def add(self, block: Block, until: int | None) -> Block:
        """Take one chunk and return all messages recorded before ``until`` (None: all)."""
        times = np.concatenate([*(held.record_ns for held in self._held), block.record_ns])
        in_order = bool((times[1:] >= times[:-1]).all())
        if in_order and not self._held and (until is None or not len(times) or times[-1] < until):
            return block
        payloads = _joined([part.payloads for part in (*self._held, block)])
        if not in_order:
            order = np.argsort(times, kind='stable')
            times = times[order]
            payloads = (
                [payloads[row] for row in order.tolist()]
                if isinstance(payloads, list)
                else payloads[order]
            )
        ready = len(times) if until is None else int(np.searchsorted(times, until))
        self._held = [Block(times[ready:], payloads[ready:])] if ready < len(times) else []
        return Block(times[:ready], payloads[:ready])


def _joined(parts: list[Payloads]) -> Payloads:
    """Return the messages of all parts, as one array where all have the same length."""
    arrays = [part for part in parts if isinstance(part, np.ndarray) and len(part)]
    of_one_length = len({array.itemsize for array in arrays}) == 1
    if of_one_length and sum(map(len, arrays)) == sum(map(len, parts)):
        return np.concatenate(arrays)
    return [one for part in parts for one in as_list(part)]
