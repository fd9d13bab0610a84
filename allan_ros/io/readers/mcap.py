# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads an mcap file, with or without its summary (https://mcap.dev/spec).

The summary at the end lists the chunks. The rest of the file is searched for messages outside
chunks, and for chunks that the summary does not list. If the recorder was killed, there is no
summary, and the complete file is searched. One chunk is decompressed at a time, so the memory does
not depend on the size of the file.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .storage import (
    Chunk,
    ChunkStorage,
    Messages,
    Payloads,
    Topic,
    Truncation,
    among,
    damaged,
    gathered,
    normal_type,
)

MESSAGE, MESSAGE_INDEX = 0x05, 0x07

RECORD = struct.Struct('<BQ')
"""Opcode and length at the start of each record."""

MESSAGE_HEAD = struct.Struct('<HIQQ')
"""Channel, sequence, log time, publish time."""

INDEX_HEAD = struct.Struct('<HI')
"""Channel, and size of the pairs (log time, offset) that follow."""

HEAD = np.dtype(
    [('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'), ('sequence', '<u4')]
    + [('log_time', '<i8'), ('publish_time', '<u8')]
)
"""A message record up to its payload."""

MAX_GAPS = 64
"""Number of places in a chunk with records other than messages above which the index is not used,
because reading record by record is as fast."""


def chunk_messages(data: bytes, ids: set[int], index: Callable[[], bytes] = bytes) -> Messages:
    """Return the messages of the channels ``ids`` in a decompressed chunk, in the order stored.

    ``index`` returns the MessageIndex records of the chunk, or b''; it is only called if needed.
    Raises struct.error when a record extends beyond the end of the data.
    """
    start = _starts_if_equal(data)
    if start is None:
        start = _starts_by_index(data, index())
    if start is None:
        start = _starts_by_search(data)
    head = _records_at(data, start, HEAD)
    mine = among(head['channel'], ids)
    if not mine.all():
        head, start = head[mine], start[mine]
    return Messages(head['log_time'].astype(np.int64), _payloads(data, start, head['length']))


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, offset and end offset of the content of each record.

    Raises struct.error when a record extends beyond the end of the data.
    """
    at, size = 0, len(data)
    while at + RECORD.size <= size:
        opcode, length = RECORD.unpack_from(data, at)
        start = at + RECORD.size
        at = start + length
        if at > size or not opcode:
            raise struct.error('a record extends beyond the end of its chunk')
        yield opcode, start, at


def _starts_if_equal(data: bytes) -> NDArray[np.int64] | None:
    """Return the message offsets if only messages of equal length follow the first, else None."""
    message = next((record for record in records(data) if record[0] == MESSAGE), None)
    if message is None:
        return np.empty(0, np.int64)
    _, start, end = message
    first, size = start - RECORD.size, end - start + RECORD.size
    if (len(data) - first) % size or size < HEAD.itemsize:
        return None
    starts = np.arange(first, len(data), size)
    head = _records_at(data, starts, HEAD)
    equal = (head['opcode'] == MESSAGE) & (head['length'] == size - RECORD.size)
    return starts if equal.all() else None


def _starts_by_index(data: bytes, index: bytes) -> NDArray[np.int64] | None:
    """Return the offset of each message from the index; None if the index is wrong or missing."""
    found = [np.empty(0, np.int64)]
    for opcode, at, _ in records(index):
        if opcode == MESSAGE_INDEX:
            _, size = INDEX_HEAD.unpack_from(index, at)
            pairs = np.frombuffer(index, '<i8', size // 8, at + INDEX_HEAD.size)
            found.append(pairs.reshape(-1, 2)[:, 1].astype(np.int64))
    start = np.sort(np.concatenate(found))
    if not len(start) or start[0] < 0 or start[-1] > len(data) - HEAD.itemsize:
        return None
    head = gathered(data, start, HEAD)
    end = start + (RECORD.size + head['length'].astype(np.int64))
    if (head['opcode'] != MESSAGE).any() or (head['length'] < MESSAGE_HEAD.size).any():
        return None
    # The index is complete if there are no messages between the listed ones.
    gap_start, gap_end = np.append(0, end), np.append(start, len(data))
    gaps = np.flatnonzero(gap_start != gap_end)
    if (gap_start > gap_end).any() or len(gaps) > MAX_GAPS:
        return None
    others = [records(data[gap_start[gap] : gap_end[gap]]) for gap in gaps]
    unlisted = any(opcode == MESSAGE for opcode, _, _ in chain.from_iterable(others))
    return None if unlisted else start


def _starts_by_search(data: bytes) -> NDArray[np.int64]:
    """Return the offset of each message, found record by record."""
    found = [(at, end - at) for opcode, at, end in records(data) if opcode == MESSAGE]
    if any(length < MESSAGE_HEAD.size for _, length in found):
        raise struct.error('a message record is too short')
    return np.array([at - RECORD.size for at, _ in found], dtype=np.int64)


def _records_at(data: bytes, start: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the records at these offsets, (n,); a view of the data if they are evenly spaced."""
    step = np.diff(start)
    if len(step) and (step == step[0]).all():
        return np.ndarray((len(start),), dtype, data, int(start[0]), (int(step[0]),))
    return gathered(data, start, dtype)


def _payloads(data: bytes, start: NDArray[np.int64], length: NDArray[np.uint64]) -> Payloads:
    """Return the content of messages whose records begin at these offsets."""
    head = HEAD.itemsize
    if len(length) and (length == length[0]).all() and length[0] > MESSAGE_HEAD.size:
        dtype = _message_dtype(int(length[0]))
        return _records_at(data, start, dtype)['payload']
    view, end = memoryview(data), start + (RECORD.size + length.astype(np.int64))
    return [view[a + head : b] for a, b in zip(start.tolist(), end.tolist())]


@lru_cache(maxsize=64)
def _message_dtype(length: int) -> np.dtype[np.void]:
    """Return the layout of a message record whose content has ``length`` bytes."""
    return np.dtype([*HEAD.descr, ('payload', np.void, length - MESSAGE_HEAD.size)])


MAGIC = b'\x89MCAP0\r\n'

FOOTER, SCHEMA, CHANNEL, CHUNK = 0x02, 0x03, 0x04, 0x06

CHUNK_INDEX, STATISTICS, DATA_END, LAST_OPCODE = 0x08, 0x0B, 0x0F, 0x7F

FIXED_BYTES = {DATA_END: 4, FOOTER: 20}
"""Opcode -> only valid length of a record."""

CHUNK_HEAD = struct.Struct('<QQQI')
"""First and last log time, uncompressed size, CRC-32 (0: none)."""

CHUNK_INDEX_HEAD = struct.Struct('<QQQQI')
"""First and last log time, start and length of the chunk, size of the map that follows."""

STATISTICS_HEAD = struct.Struct('<QHIIIIQQI')
"""Numbers of messages, schemas, channels, attachments, metadata and chunks, first and last log
time, and size of the map from channel to number of messages that follows."""

FOOTER_BYTES = RECORD.size + FIXED_BYTES[FOOTER] + len(MAGIC)

LOOSE_BYTES = 1 << 20
"""Messages outside chunks are read about this many bytes at a time."""


class McapStorage(ChunkStorage):
    """An open mcap file."""

    DAMAGE = (struct.error, ValueError, OSError, OverflowError, MemoryError)
    REMEDY = 'copy it again, or repair it with "mcap recover"'

    def _survey(self) -> None:
        self._schemas: dict[int, tuple[str, str, str]] = {}
        # number of messages in MessageIndex records and outside chunks
        self._indexed: Counter[int] = Counter()
        if self._read(0, len(MAGIC)) != MAGIC:
            raise damaged(self._path, 'it is not an mcap file', 'give a recording')
        listed, end = self._read_summary()
        at = len(MAGIC)
        for chunk in listed:
            end_of_index = chunk.offset + chunk.length + chunk.index_length
            at = max(self._scan(at, chunk.offset - RECORD.size), end_of_index)
            self._chunks.append(chunk)
        at = self._scan(at, end)
        if listed:
            self._counts = Counter(self._stated)
            return
        if not self._stated:
            self._stated = self._counts | self._indexed
        magic_at = end - len(MAGIC)
        ended = at >= magic_at > 0 and self._read(magic_at, len(MAGIC)) == MAGIC
        if not self.truncation and not ended:
            self.truncation = Truncation(at, end)

    def _messages(self, chunk: Chunk, ids: set[int]) -> Messages:
        index = partial(self._read, chunk.offset + chunk.length, chunk.index_length)
        return chunk_messages(self._data(chunk), ids, index)

    def _data(self, chunk: Chunk) -> bytes:
        """Return the decompressed records of a chunk."""
        data = self._read(chunk.offset, chunk.length)
        if chunk.loose:
            return data
        _, _, size, checksum = CHUNK_HEAD.unpack_from(data)
        compression, at = _text(data, CHUNK_HEAD.size)
        (stored,) = struct.unpack_from('<Q', data, at)
        packed = memoryview(data)[at + 8 : at + 8 + stored]
        return self._unpacked(chunk.offset, packed, compression, size, checksum)

    def _read_summary(self) -> tuple[list[Chunk], int]:
        """Read schemas, channels and counts from the summary.

        Returns the chunks in the order of the file, and the offset of the summary. Without a valid
        summary, there are no chunks, and the offset is the end of the file.
        """
        unusable: tuple[list[Chunk], int] = ([], self._size)
        footer = self._read(max(0, self._size - FOOTER_BYTES), FOOTER_BYTES)
        if not footer.endswith(MAGIC) or footer[0] != FOOTER:
            return unusable
        (start,) = struct.unpack_from('<Q', footer, RECORD.size)
        end = self._size - FOOTER_BYTES
        if not 0 < start <= end:
            return unusable
        chunks: dict[int, Chunk] = {}
        data = self._read(start, end - start)
        for opcode, at, stop in records(data):
            self._store_record(opcode, data, at, stop)
            if opcode == CHUNK_INDEX:
                chunk = _listed_chunk(data, at)
                chunks[chunk.offset] = chunk
        if not self._stated or not set(self._stated) <= set(self._topics):
            return unusable
        return [chunks[offset] for offset in sorted(chunks)], start if chunks else self._size

    def _scan(self, at: int, stop: int) -> int:
        """Read the records from offset ``at`` on, and return the offset of the first unread byte.

        Reading ends at ``stop``, or at the first record that extends beyond it.
        """
        skipped = 0
        while at + RECORD.size <= stop:
            head = self._read(at, RECORD.size)
            if head.startswith(MAGIC):  # after the footer
                at += len(MAGIC)
                continue
            opcode, length = RECORD.unpack(head)
            start, end = at + RECORD.size, at + RECORD.size + length
            if end > stop or opcode == 0:
                break
            if FIXED_BYTES.get(opcode, length) != length or DATA_END < opcode <= LAST_OPCODE:
                skipped += end - at
            elif opcode == CHUNK:
                first, _, _, _ = CHUNK_HEAD.unpack(self._read(start, CHUNK_HEAD.size))
                chunk = Chunk(first, start, length)
                self._chunks.append(chunk)
                data = self._data(chunk)
                for inner, inner_at, inner_end in records(data):
                    self._store_record(inner, data, inner_at, inner_end)
            elif opcode == MESSAGE:
                data = self._read(start, MESSAGE_HEAD.size)
                self._store_record(opcode, data, 0, len(data))
                self._add_loose(data, at, end - at)
            elif opcode == MESSAGE_INDEX:
                channel, size = INDEX_HEAD.unpack(self._read(start, INDEX_HEAD.size))
                self._indexed[channel] += size // 16
            elif opcode in (SCHEMA, CHANNEL, STATISTICS):
                self._store_record(opcode, self._read(start, length), 0, length)
            at = end
        if skipped:
            self.truncation = Truncation(self._size - skipped, self._size)
        return at

    def _add_loose(self, head: bytes, offset: int, length: int) -> None:
        """Add the message record at ``offset``, which is outside chunks, to the list of chunks.

        ``head`` is the beginning of its content. Adjacent messages form one chunk.
        """
        channel, _, log_time, _ = MESSAGE_HEAD.unpack(head)
        self._indexed[channel] += 1
        last = self._chunks[-1] if self._chunks else None
        adjacent = last and last.loose and last.offset + last.length == offset
        if last and adjacent and last.length < LOOSE_BYTES:
            start = min(last.start_ns, log_time)
            self._chunks[-1] = Chunk(start, last.offset, last.length + length, loose=True)
        else:
            self._chunks.append(Chunk(log_time, offset, length, loose=True))

    def _store_record(self, opcode: int, data: bytes, at: int, stop: int) -> None:
        """Count the message, or store the schema, channel or statistics in ``data[at:stop]``."""
        if opcode == MESSAGE:
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
        elif opcode == STATISTICS:
            *_, size = STATISTICS_HEAD.unpack_from(data, at)
            at += STATISTICS_HEAD.size
            self._stated = Counter(dict(struct.iter_unpack('<HQ', data[at : min(at + size, stop)])))


def _listed_chunk(data: bytes, at: int) -> Chunk:
    """Return the chunk that the ChunkIndex record at ``data[at:]`` describes."""
    first, _, offset, length, map_bytes = CHUNK_INDEX_HEAD.unpack_from(data, at)
    (index_length,) = struct.unpack_from('<Q', data, at + CHUNK_INDEX_HEAD.size + map_bytes)
    start, length = offset + RECORD.size, length - RECORD.size
    return Chunk(first, start, length, index_length=index_length)


def _text(data: bytes, at: int) -> tuple[str, int]:
    """Return the string at ``data[at:]``, and the offset of the next field."""
    (length,) = struct.unpack_from('<I', data, at)
    end = at + 4 + length
    return data[at + 4 : end].decode(errors='replace'), end
