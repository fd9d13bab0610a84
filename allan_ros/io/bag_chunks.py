# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What an mcap file and a ROS 1 bag have in common: messages in chunks, compressed one by one."""

from __future__ import annotations

import os
import zlib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, ClassVar, Generic, TypeVar

import numpy as np

from .bag_storage import (
    Block,
    Cut,
    Payloads,
    Storage,
    Topic,
    as_list,
    damaged,
    decompress,
    translated,
)


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
