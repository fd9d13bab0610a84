# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An mcap file, with or without its summary (https://mcap.dev/spec).

A file whose recorder was killed has no footer: its chunks are then found one by one, and what is
whole is read. Whole chunks are decompressed at a time, so memory does not grow with the file.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from .storage import (
    Block,
    ChunkStorage,
    Cut,
    Payloads,
    Stretch,
    Topic,
    among,
    damaged,
    gathered,
    normal_type,
)

MESSAGE, MESSAGE_INDEX = 0x05, 0x07

RECORD = struct.Struct('<BQ')
"""Opcode and length in front of every record."""

MESSAGE_HEAD = struct.Struct('<HIQQ')
"""Channel, sequence, log time, publish time."""

INDEX_HEAD = struct.Struct('<HI')
"""Channel, and bytes of the pairs (log time, offset) that follow."""

HEAD = np.dtype(
    [('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'), ('sequence', '<u4')]
    + [('log_time', '<i8'), ('publish_time', '<u8')]
)
"""A message record up to its payload."""

MOST_GAPS = 64
"""Stretches of a chunk that hold other records than messages: beyond, walking is as fast."""


def chunk_messages(data: bytes, ids: set[int], index: Callable[[], bytes] = bytes) -> Block:
    """Return the messages of these channels in the order of the chunk.

    Parameters
    ----------
    data : bytes
        The records of the chunk, decompressed; or a run of records outside of chunks.
    index : callable
        Reads the MessageIndex records that belong to it, empty where there are none.

    Raises
    ------
    struct.error
        When a record is longer than what holds it.
    """
    return _uniform(data, ids) or _by_index(data, ids, index()) or _one_by_one(data, ids)


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, first byte and end of each record."""
    at, size = 0, len(data)
    while at + RECORD.size <= size:
        opcode, length = RECORD.unpack_from(data, at)
        start = at + RECORD.size
        at = start + length
        if at > size:
            raise struct.error('a record is longer than what holds it')
        yield opcode, start, at


def _uniform(data: bytes, ids: Collection[int]) -> Block | None:
    """Take the messages of a chunk as one array, if behind its first all are of one length."""
    found = next((record for record in records(data) if record[0] == MESSAGE), None)
    if found is None:
        return None
    _, start, end = found
    first, length = start - RECORD.size, end - start
    dtype = _message_dtype(length)
    if dtype is None or (len(data) - first) % dtype.itemsize:
        return None
    messages = np.frombuffer(data, dtype, offset=first)
    if (messages['opcode'] != MESSAGE).any() or (messages['length'] != length).any():
        return None
    mine = among(messages['channel'], ids)
    if not mine.all():
        messages = messages[mine]
    return Block(messages['log_time'].astype(np.int64), messages['payload'])


def _by_index(data: bytes, ids: Collection[int], index: bytes) -> Block | None:
    """Take the messages from where the index says they are; None if that is not true."""
    start = np.sort(_offsets(index))
    if not len(start) or start[0] < 0 or start[-1] > len(data) - HEAD.itemsize:
        return None
    head = gathered(data, start, HEAD)
    end = start + (RECORD.size + head['length'].astype(np.int64))
    if (head['opcode'] != MESSAGE).any() or (head['length'] < MESSAGE_HEAD.size).any():
        return None
    # The index is complete if what lies between its messages holds no other.
    before, behind = np.append(0, end), np.append(start, len(data))
    gaps = np.flatnonzero(before != behind)
    if (before > behind).any() or len(gaps) > MOST_GAPS:
        return None
    for gap in gaps:
        between = data[before[gap] : behind[gap]]
        if any(opcode == MESSAGE for opcode, _, _ in records(between)):
            return None
    mine = among(head['channel'], ids)
    head, start, end = head[mine], start[mine], end[mine]
    return Block(head['log_time'].astype(np.int64), _payloads(data, start, end))


def _offsets(index: bytes) -> NDArray[np.int64]:
    """Return where the messages of all channels begin in the chunk, by its index."""
    found = [np.empty(0, np.int64)]
    for opcode, at, _ in records(index):
        if opcode == MESSAGE_INDEX:
            _, size = INDEX_HEAD.unpack_from(index, at)
            pairs = np.frombuffer(index, '<i8', size // 8, at + INDEX_HEAD.size)
            found.append(pairs.reshape(-1, 2)[:, 1].astype(np.int64))
    return np.concatenate(found)


def _payloads(data: bytes, start: NDArray[np.int64], end: NDArray[np.int64]) -> Payloads:
    """Return the payloads of message records: one array where they are of one length."""
    lengths = end - start
    if len(lengths) and (lengths == lengths[0]).all():
        dtype = _message_dtype(int(lengths[0]) - RECORD.size)
        if dtype is not None:
            return gathered(data, start, dtype)['payload']
    view, head = memoryview(data), HEAD.itemsize
    return [view[a + head : b] for a, b in zip(start.tolist(), end.tolist())]


@lru_cache(maxsize=64)
def _message_dtype(length: int) -> np.dtype[np.void] | None:
    """Return the layout of message records of that length, or None when they hold nothing."""
    if length <= MESSAGE_HEAD.size:
        return None
    return np.dtype([*HEAD.descr, ('payload', np.void, length - MESSAGE_HEAD.size)])


def _one_by_one(data: bytes, ids: Collection[int]) -> Block:
    """Take the messages of a chunk, whatever their lengths."""
    view = memoryview(data)
    times: list[int] = []
    payloads: list[bytes | memoryview] = []
    for opcode, start, end in records(data):
        if opcode == MESSAGE:
            channel, _, log_time, _ = MESSAGE_HEAD.unpack_from(data, start)
            if channel in ids:
                times.append(log_time)
                payloads.append(view[start + MESSAGE_HEAD.size : end])
    return Block(np.array(times, dtype=np.int64), payloads)


MAGIC = b'\x89MCAP0\r\n'

FOOTER, SCHEMA, CHANNEL, CHUNK = 0x02, 0x03, 0x04, 0x06

CHUNK_INDEX, STATISTICS, DATA_END, LAST_OPCODE = 0x08, 0x0B, 0x0F, 0x7F

CHUNK_HEAD = struct.Struct('<QQQI')
"""First and last log time, uncompressed size, CRC-32 (0: none)."""

CHUNK_INDEX_HEAD = struct.Struct('<QQQQI')
"""First and last log time, start and length of the chunk, bytes of the map that follows."""

FOOTER_BYTES = RECORD.size + 20 + len(MAGIC)

LOOSE_BYTES = 1 << 20
"""Messages outside of chunks are read in runs of about this many bytes."""


@dataclass(frozen=True, order=True)
class ChunkSpan(Stretch):
    """A chunk record, or a run of loose messages.

    Behind a chunk lie ``index_length`` bytes of records that say where its messages begin.
    """

    is_chunk: bool
    index_length: int = 0


class McapStorage(ChunkStorage[ChunkSpan]):
    """An open .mcap file."""

    DAMAGE = (struct.error, ValueError, OSError, OverflowError, MemoryError)
    REMEDY = 'copy it again, or mend it with "mcap recover"'

    def _survey(self) -> None:
        self._schemas: dict[int, tuple[str, str, str]] = {}
        if self._read(0, len(MAGIC)) != MAGIC:
            raise damaged(self._path, 'it does not begin like an mcap file', 'give a recording')
        if not self._read_summary():
            self._scan()

    def _messages(self, chunk: ChunkSpan, ids: set[int]) -> Block:
        index = partial(self._read, chunk.offset + chunk.length, chunk.index_length)
        return chunk_messages(self._data(chunk), ids, index)

    def _data(self, span: ChunkSpan) -> bytes:
        """Return the records of a span, decompressed."""
        data = self._read(span.offset, span.length)
        if not span.is_chunk:
            return data
        _, _, size, checksum = CHUNK_HEAD.unpack_from(data)
        compression, at = _text(data, CHUNK_HEAD.size)
        (stored,) = struct.unpack_from('<Q', data, at)
        packed = memoryview(data)[at + 8 : at + 8 + stored]
        return self._unpacked(span.offset, packed, compression, size, checksum)

    def _read_summary(self) -> bool:
        """Take schemas, channels, chunks and counts from the end; False if they are not there."""
        footer = self._read(max(0, self._size - FOOTER_BYTES), FOOTER_BYTES)
        if not footer.endswith(MAGIC) or footer[0] != FOOTER:
            return False
        (start,) = struct.unpack_from('<Q', footer, RECORD.size)
        end = self._size - FOOTER_BYTES
        if not 0 < start <= end:
            return False
        data = self._read(start, end - start)
        has_counts = False
        for opcode, at, stop in records(data):
            self._learn(opcode, data, at, stop)
            if opcode == CHUNK_INDEX:
                self._chunks.append(_chunk_span(data, at))
            elif opcode == STATISTICS:
                has_counts = True
                (size,) = struct.unpack_from('<I', data, at + 42)
                pairs = data[at + 46 : at + 46 + size]
                self._counts.update(dict(struct.iter_unpack('<HQ', pairs)))
        if (
            has_counts
            and set(self._counts) <= set(self._topics)
            and (self._chunks or not sum(self._counts.values()))
        ):
            return True
        self._chunks.clear()
        self._counts.clear()
        return False

    def _scan(self) -> None:
        """Walk over the whole file to learn what a summary would say, up to where it is cut."""
        at = len(MAGIC)
        whole = False
        while at + RECORD.size <= self._size:
            opcode, length = RECORD.unpack(self._read(at, RECORD.size))
            start, end = at + RECORD.size, at + RECORD.size + length
            if end > self._size or opcode == 0:
                break
            if opcode in (DATA_END, FOOTER):
                whole = self._read(self._size - len(MAGIC), len(MAGIC)) == MAGIC
                break
            if opcode == CHUNK:
                first, _, _, _ = CHUNK_HEAD.unpack(self._read(start, CHUNK_HEAD.size))
                span = ChunkSpan(first, start, length, True)
                self._chunks.append(span)
                data = self._data(span)
                for inner, inner_at, stop in records(data):
                    self._learn(inner, data, inner_at, stop, count=True)
            elif opcode == MESSAGE:
                data = self._read(start, MESSAGE_HEAD.size)
                self._learn(opcode, data, 0, len(data), count=True)
                self._add_loose(data, at, end - at)
            elif opcode in (SCHEMA, CHANNEL):
                self._learn(opcode, self._read(start, length), 0, length)
            at = end
        if not whole:
            self.cut = Cut(at, self._size)

    def _add_loose(self, head: bytes, offset: int, length: int) -> None:
        """Add a message outside of chunks to the run before it, or begin a new one."""
        log_time = MESSAGE_HEAD.unpack(head)[2]
        last = self._chunks[-1] if self._chunks else None
        adjoins = last and not last.is_chunk and last.offset + last.length == offset
        if last and adjoins and last.length < LOOSE_BYTES:
            start = min(last.start_ns, log_time)
            self._chunks[-1] = ChunkSpan(start, last.offset, last.length + length, False)
        else:
            self._chunks.append(ChunkSpan(log_time, offset, length, False))

    def _learn(self, opcode: int, data: bytes, at: int, stop: int, count: bool = False) -> None:
        """Take note of a schema, a channel, or (to count it) a message."""
        if opcode == MESSAGE and count:
            self._counts[MESSAGE_HEAD.unpack_from(data, at)[0]] += 1
        elif opcode == SCHEMA:
            (number,) = struct.unpack_from('<H', data, at)
            name, at = _text(data, at + 2)
            form, at = _text(data, at)
            text, at = _text(data, at)
            self._schemas[number] = (name, form, text)
        elif opcode == CHANNEL:
            number, schema = struct.unpack_from('<HH', data, at)
            topic, at = _text(data, at + 4)
            encoding, at = _text(data, at)
            name, form, text = self._schemas.get(schema, ('', '', ''))
            self._topics[number] = Topic(number, topic, normal_type(name), encoding, form, text)


def _chunk_span(data: bytes, at: int) -> ChunkSpan:
    """Return the chunk that a ChunkIndex record speaks of."""
    first, _, offset, length, map_bytes = CHUNK_INDEX_HEAD.unpack_from(data, at)
    (index_length,) = struct.unpack_from('<Q', data, at + CHUNK_INDEX_HEAD.size + map_bytes)
    return ChunkSpan(first, offset + RECORD.size, length - RECORD.size, True, index_length)


def _text(data: bytes, at: int) -> tuple[str, int]:
    """Return a string and where the next field begins."""
    (length,) = struct.unpack_from('<I', data, at)
    end = at + 4 + length
    return data[at + 4 : end].decode(errors='replace'), end
