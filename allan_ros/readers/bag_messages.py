# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages and topics of bag files, and decompression with a limit."""

from __future__ import annotations

import os
import threading
from collections.abc import Collection
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..core.errors import AllanError
from .files import open_regular
from .recording import (
    COMPRESSION_MAGICS,
    MAX_CHUNK_BYTES,
    MAX_FILE_RATIO,
    optional_package,
    translated,
)


@dataclass(frozen=True)
class Topic:
    """A topic of one bag file: number in the file, name, and type (``package/msg/Name``).

    ``encoding`` is the serialization of the messages: 'cdr', 'ros1', or a serialization that cannot
    be read. Raises ValueError when the name, the type or the encoding contains unprintable
    characters, because then the file is damaged.
    """

    id: int
    name: str
    type: str
    encoding: str

    def __post_init__(self) -> None:
        if not (self.name + self.type + self.encoding).isprintable():
            raise ValueError('the name of a topic contains unprintable characters')


Payloads = list[bytes | memoryview] | NDArray[np.void]
"""Serialized messages: a list, or an array, in which all messages have the same length."""


@dataclass
class Messages:
    """n messages of a bag: topic ids, (n,), record times in ns, (n,), and n payloads."""

    topics: NDArray[np.integer[Any]]
    record_ns: NDArray[np.int64]
    payloads: Payloads

    @staticmethod
    def none() -> Messages:
        """Return an empty `Messages` object."""
        return Messages(np.empty(0, np.int64), np.empty(0, np.int64), [])

    def __len__(self) -> int:
        return len(self.record_ns)

    def chosen(self, rows: NDArray[np.intp]) -> Messages:
        """Return copies of the messages at the positions ``rows``, (k,)."""
        payloads: Payloads
        if isinstance(self.payloads, np.ndarray):
            payloads = self.payloads[rows]
        else:
            payloads = [bytes(self.payloads[i]) for i in rows.tolist()]
        return Messages(self.topics[rows], self.record_ns[rows], payloads)

    def followed_by(self, other: Messages) -> Messages:
        """Return these messages followed by the messages ``other``."""
        return Messages(
            np.concatenate([self.topics, other.topics]),
            np.concatenate([self.record_ns, other.record_ns]),
            [*self.payloads, *other.payloads],
        )


@dataclass(frozen=True)
class Truncation:
    """How much of a truncated or damaged file can be read: ``read`` of ``size`` bytes.

    ``size`` is the original size of the file, or its present size if the original one is unknown.
    """

    read: int
    size: int


def among(numbers: NDArray[Any], ids: Collection[int]) -> NDArray[np.bool_]:
    """Return whether each of n numbers is one of ``ids``, (n,); this is fast for a few ids."""
    mask = np.zeros(len(numbers), bool)
    for number in ids:
        mask |= numbers == number
    return mask


def normal_type(name: str) -> str:
    """Return the ROS 2 name of a message type: ``sensor_msgs/msg/Imu`` for ``sensor_msgs/Imu``.

    A name without exactly one slash is returned unchanged.
    """
    package, *rest = name.split('/')
    return f'{package}/msg/{rest[0]}' if len(rest) == 1 else name


# --- decompression with a limit ------------------------------------------------------------------


def frame_compression(head: bytes | memoryview) -> str:
    """Return the compression that the first bytes of data indicate: 'zstd', 'lz4' or ''."""
    return COMPRESSION_MAGICS.get(bytes(head[:4]), '')


def decompress(data: bytes | memoryview, compression: str, limit: int) -> bytes:
    """Return the decompressed content of a chunk or message.

    Parameters
    ----------
    data : bytes
        The compressed data.
    compression : str
        'zstd' or 'lz4'; 'none' or '' for data that are not compressed.
    limit : int
        Largest permitted size of the decompressed content in bytes. Data that are not compressed
        may be larger.

    Raises
    ------
    ValueError
        When the compression is unknown, the library finds that the data are damaged, or the content
        exceeds the limit.
    AllanError
        When the Python package for this compression is missing.
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
            content = bytes(_expanding(BytesIO(data), compression).read(limit + 1))
            size = len(content)
    except AllanError:
        raise
    except Exception as error:  # each library raises its own exceptions
        raise ValueError(str(error) or type(error).__name__) from error
    if size > limit:
        raise ValueError(f'the data expand to more than {limit} bytes')
    return content


def _stated_size(head: bytes | memoryview, compression: str) -> int:
    """Return the decompressed size that the header of zstd data states; -1 if no size is stated."""
    return int(_zstd().frame_content_size(head)) if compression == 'zstd' else -1


def _expanding(file: BinaryIO, compression: str) -> Any:
    if compression == 'zstd':
        return _zstd().ZstdDecompressor().stream_reader(file, read_across_frames=True)
    if compression == 'lz4':
        return optional_package('lz4.frame', 'reading lz4 data').open(file)
    raise ValueError(f'compression {compression!r} is unknown')


def decompress_file(source: Path, compression: str, target: Path) -> None:
    """Decompress the bag file ``source`` into the file ``target``.

    ``compression`` is 'zstd' or 'lz4'. Raises AllanError when ``source`` is damaged or cannot be
    read, when the decompressed file is larger than `MAX_FILE_RATIO` permits, when the disk is full,
    or when the Python package for this compression is missing.
    """
    remedy = 'copy it again; check the space for temporary files'
    with (
        translated(source, (Exception,), remedy),  # each library raises its own exceptions
        open_regular(source) as file,
        target.open('wb') as target_file,
    ):
        limit = os.fstat(file.fileno()).st_size * MAX_FILE_RATIO + MAX_CHUNK_BYTES
        # the longest zstd header has 18 bytes (RFC 8878, 3.1.1)
        stated_size = _stated_size(file.read(18), compression)
        file.seek(0)
        content = _expanding(file, compression)
        size = 0
        while data := content.read(1 << 20):
            size += len(data)
            if size > limit:
                raise ValueError(f'it expands more than {MAX_FILE_RATIO} times')
            target_file.write(data)
        if size < max(stated_size, 1):
            raise ValueError(f'the {compression} data end early')


def _zstd() -> Any:
    return optional_package('zstandard', 'reading zstd data')


_local = threading.local()
"""Holds one decompressor for each thread: a decompressor is slow to create and must not be shared.
"""
