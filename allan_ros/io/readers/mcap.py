# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads an mcap file, with or without its summary (https://mcap.dev/spec).

The summary at the end lists the chunks. The rest of the file is searched for messages outside
chunks, and for chunks that the summary does not list. If there is no summary, because the recorder
was killed, or if it contradicts itself, the complete file is searched. One chunk is decompressed at
a time, so the memory does not depend on the size of the file.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..files import open_regular
from .storage import (
    MAX_CHUNK_BYTES,
    Messages,
    Payloads,
    Storage,
    Topic,
    Truncation,
    among,
    as_list,
    damaged,
    decompress,
    normal_type,
    translated,
)

MAGIC = b'\x89MCAP0\r\n'

FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07

CHUNK_INDEX, STATISTICS, DATA_END, LAST_OPCODE = 0x08, 0x0B, 0x0F, 0x7F

FIXED_BYTES = {DATA_END: 4, FOOTER: 20}
"""Opcode -> only valid length of a record."""

RECORD = struct.Struct('<BQ')
"""Opcode and length at the start of each record."""

MESSAGE_HEAD = struct.Struct('<HIQQ')
"""Channel, sequence, log time, publish time."""

INDEX_HEAD = struct.Struct('<HI')
"""Channel, and size of the pairs (log time, offset) that follow."""

CHUNK_HEAD = struct.Struct('<QQQI')
"""First and last log time, uncompressed size, CRC-32 (0: none)."""

CHUNK_INDEX_HEAD = struct.Struct('<QQQQI')
"""First and last log time, start and length of the chunk, size of the map that follows."""

STATISTICS_HEAD = struct.Struct('<QHIIIIQQI')
"""Numbers of messages, schemas, channels, attachments, metadata and chunks, first and last log
time, and size of the map from channel to number of messages that follows."""

CRC_BYTES = 4
"""Size of the CRC-32 of the summary, the last field of the footer; 0 if there is none."""

FOOTER_BYTES = RECORD.size + FIXED_BYTES[FOOTER] + len(MAGIC)

HEAD = np.dtype(
    [('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'), ('sequence', '<u4')]
    + [('log_time', '<i8'), ('publish_time', '<u8')]
)
"""A message record up to its payload."""

LOOSE_BYTES = 1 << 20
"""Messages outside chunks are read about this many bytes at a time."""

MAX_SORT_BYTES = 512 * 2**20
"""Largest size in bytes of the messages that are kept in memory to sort overlapping chunks."""

DAMAGE = (struct.error, ValueError, OSError, OverflowError, MemoryError)
"""Exceptions when a file is damaged."""

REMEDY = 'copy it again, or repair it with "mcap recover"'


@dataclass(frozen=True, order=True)
class Chunk:
    """A part of a file that contains messages: time of the first one, offset and length in bytes.

    An index of ``index_length`` bytes follows the chunk. ``loose`` marks a sequence of messages
    outside chunks.
    """

    start_ns: int
    offset: int
    length: int
    index_length: int = 0
    loose: bool = False


class McapStorage:
    """An open mcap file; error messages name it ``path``.

    Raises one of `DAMAGE` when it is of another format or damaged.
    """

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file
        self._size = os.fstat(file.fileno()).st_size
        self._clear()
        if self._read(0, len(MAGIC)) != MAGIC:
            raise damaged(path, 'it is not an mcap file', 'give a recording')
        if not self._survey_by_summary():
            self._clear()
            self._survey_all()
        self._chunks.sort()
        self.topics = list(self._topics.values())

    def _clear(self) -> None:
        self._topics: dict[int, Topic] = {}
        self._schemas: dict[int, str] = {}  # number -> name of the type
        self._counts: Counter[int] = Counter()
        # number of messages in the statistics
        self._stated: Counter[int] = Counter()
        # number of messages in MessageIndex records and outside chunks
        self._indexed: Counter[int] = Counter()
        self._chunks: list[Chunk] = []
        self.truncation: Truncation | None = None

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages."""
        return dict(self._counts)

    def stated(self, ids: set[int], read: int) -> int:
        """Return the number of messages of these topics in the index; ``read`` if there is none."""
        if not self._stated:
            return read
        stated = sum(self._stated[number] for number in ids)
        return max(stated, read) if self.truncation else stated  # the index may be truncated, too

    def blocks(self, groups: Sequence[set[int]]) -> Iterator[list[Messages]]:
        """Yield the next messages of each group of topic ids, in the order of record time."""
        with translated(self._path, DAMAGE, REMEDY):
            sorters = [ChunkSorter() for _ in groups]
            ends = [chunk.start_ns for chunk in self._chunks[1:]] + [None]
            for chunk, until in zip(self._chunks, ends):
                found = self._messages(chunk, groups)
                yield [sorter.add(one, until) for sorter, one in zip(sorters, found)]

    def _messages(self, chunk: Chunk, groups: Sequence[set[int]]) -> list[Messages]:
        """Return the messages of each group of topics in a chunk, in the order of the chunk."""
        data = self._data(chunk)
        start, others = message_starts(data)
        for opcode, at, _ in others:
            self._check_known(opcode, data, at)
        head = _records_at(data, start, HEAD)
        return [_of_channels(data, start, head, ids) for ids in groups]

    def _check_known(self, opcode: int, data: bytes, at: int) -> None:
        """Raise ValueError if a schema or channel in a chunk differs from the known one."""
        if opcode == SCHEMA:
            number, schema = _schema(data, at)
            if self._schemas.get(number, schema) != schema:
                raise ValueError(f'schema {number} is {schema} in a chunk only')
        elif opcode == CHANNEL:
            found = self._topic(data, at)
            known = self._topics.get(found.id)
            if known is None or (known.name, known.type) != (found.name, found.type):
                raise ValueError(
                    f'channel {found.id} is {found.name} in a chunk, but not elsewhere'
                )

    def _read(self, offset: int, length: int) -> bytes:
        if length > MAX_CHUNK_BYTES:
            raise ValueError(
                f'a record of {length} bytes at byte {offset}, the limit is {MAX_CHUNK_BYTES}'
            )
        self._file.seek(offset)
        return self._file.read(length)

    def _data(self, chunk: Chunk) -> bytes:
        """Return the decompressed records of a chunk, after checking its CRC-32."""
        data = self._read(chunk.offset, chunk.length)
        if chunk.loose:
            return data
        _, _, size, checksum = CHUNK_HEAD.unpack_from(data)
        compression, at = _text(data, CHUNK_HEAD.size)
        (stored,) = struct.unpack_from('<Q', data, at)
        packed = memoryview(data)[at + 8 : at + 8 + stored]
        try:
            plain = decompress(packed, compression, min(size, MAX_CHUNK_BYTES))
            if len(plain) != size:
                raise ValueError(f'{len(plain)} bytes instead of {size}')
            if checksum and zlib.crc32(plain) != checksum:
                raise ValueError('its checksum is wrong')
        except ValueError as error:
            reason = f'the chunk at byte {chunk.offset} is damaged: {error}'
            raise damaged(self._path, reason, REMEDY) from error
        return plain

    def _survey_by_summary(self) -> bool:
        """Find topics, counts and chunks by the summary; return False if there is no valid one."""
        try:
            chunks, end = self._read_summary()
        except (struct.error, ValueError):
            return False
        if not chunks:
            return False
        at = len(MAGIC)
        for chunk in chunks:
            after = chunk.offset + chunk.length + chunk.index_length
            at = max(self._scan(at, chunk.offset - RECORD.size), after)
            self._chunks.append(chunk)
        self._scan(at, end)
        self._counts = Counter(self._stated)
        return True

    def _read_summary(self) -> tuple[list[Chunk], int]:
        """Read topics and counts from the summary; return the chunks in order, and its offset.

        There are no chunks if its records contradict each other.
        """
        unusable: tuple[list[Chunk], int] = ([], self._size)
        footer = self._read(max(0, self._size - FOOTER_BYTES), FOOTER_BYTES)
        if not footer.endswith(MAGIC) or footer[0] != FOOTER:
            return unusable
        start, _, checksum = struct.unpack_from('<QQI', footer, RECORD.size)
        end = self._size - FOOTER_BYTES
        if not 0 < start <= end:
            return unusable
        data = self._read(start, end - start)
        if checksum and zlib.crc32(data + footer[: -CRC_BYTES - len(MAGIC)]) != checksum:
            return unusable
        chunks: dict[int, Chunk] = {}
        channels: set[int] = set()
        totals: tuple[int, ...] = ()
        for opcode, at, stop in records(data):
            self._store_record(opcode, data, at, stop)
            if opcode == CHUNK_INDEX:
                chunk, inside = _listed_chunk(data, at)
                chunks[chunk.offset] = chunk
                channels |= inside
            elif opcode == STATISTICS:
                totals = STATISTICS_HEAD.unpack_from(data, at)
        counted = sum(self._stated.values()), len(self._topics), len(chunks)
        agrees = totals and (totals[0], totals[2], totals[5]) == counted
        if not (agrees and counted[0] and channels | {*self._stated} <= {*self._topics}):
            return unusable
        return [chunks[offset] for offset in sorted(chunks)], start

    def _survey_all(self) -> None:
        """Find topics, counts and chunks in the complete file."""
        at = self._scan(len(MAGIC), self._size)
        if not self._stated:
            self._stated = self._counts | self._indexed
        magic_at = self._size - len(MAGIC)
        ended = at >= magic_at > 0 and self._read(magic_at, len(MAGIC)) == MAGIC
        if not self.truncation and not ended:
            self.truncation = Truncation(at, self._size)

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
            number, schema = _schema(data, at)
            self._schemas[number] = schema
        elif opcode == CHANNEL:
            topic = self._topic(data, at)
            self._topics[topic.id] = topic
        elif opcode == STATISTICS:
            *_, size = STATISTICS_HEAD.unpack_from(data, at)
            at += STATISTICS_HEAD.size
            self._stated = Counter(dict(struct.iter_unpack('<HQ', data[at : min(at + size, stop)])))

    def _topic(self, data: bytes, at: int) -> Topic:
        """Return the topic of the channel record at ``data[at:]``."""
        number, schema = struct.unpack_from('<HH', data, at)
        topic, at = _text(data, at + 4)
        encoding, at = _text(data, at)
        return Topic(number, topic, normal_type(self._schemas.get(schema, '')), encoding)


def _schema(data: bytes, at: int) -> tuple[int, str]:
    """Return number and name of the schema record at ``data[at:]``."""
    (number,) = struct.unpack_from('<H', data, at)
    return number, _text(data, at + 2)[0]


def _listed_chunk(data: bytes, at: int) -> tuple[Chunk, set[int]]:
    """Return the chunk that the ChunkIndex record at ``data[at:]`` describes, and its channels."""
    first, _, offset, length, map_bytes = CHUNK_INDEX_HEAD.unpack_from(data, at)
    at += CHUNK_INDEX_HEAD.size
    channels = {n for n, _ in struct.iter_unpack('<HQ', data[at : at + map_bytes])}
    (index_length,) = struct.unpack_from('<Q', data, at + map_bytes)
    start, length = offset + RECORD.size, length - RECORD.size
    return Chunk(first, start, length, index_length=index_length), channels


def _text(data: bytes, at: int) -> tuple[str, int]:
    """Return the string at ``data[at:]``, and the offset of the next field."""
    (length,) = struct.unpack_from('<I', data, at)
    end = at + 4 + length
    return data[at + 4 : end].decode(errors='replace'), end


@contextmanager
def open_mcap(path: Path, shown: Path) -> Iterator[Storage]:
    """Open an mcap file for reading.

    Error messages name it ``shown``, because ``path`` may be a decompressed copy. Raises AllanError
    when it is of another format or damaged.
    """
    with translated(shown, DAMAGE, REMEDY):
        file = open_regular(path)
    with file:
        with translated(shown, DAMAGE, REMEDY):
            storage = McapStorage(shown, file)
        yield storage


# --- messages in a chunk -----------------------------------------------------------------------

Record = tuple[int, int, int]
"""Opcode, offset and end offset of the content of a record."""


def records(data: bytes) -> Iterator[Record]:
    """Yield the records in the data.

    Raises struct.error when a record extends beyond the end.
    """
    at, size = 0, len(data)
    while at + RECORD.size <= size:
        opcode, length = RECORD.unpack_from(data, at)
        start = at + RECORD.size
        at = start + length
        if at > size or not opcode:
            raise struct.error('a record extends beyond the end of its chunk')
        yield opcode, start, at


def message_starts(data: bytes) -> tuple[NDArray[np.int64], list[Record]]:
    """Return the offsets of the messages in a decompressed chunk, and its other records.

    Raises struct.error when a record extends beyond the end of the data.
    """
    others: list[Record] = []
    start = _starts_if_equal(data, others)
    return _starts_by_search(data) if start is None else (start, others)


def _starts_if_equal(data: bytes, others: list[Record]) -> NDArray[np.int64] | None:
    """Return the message offsets if only messages of equal length follow the first, else None.

    The records before the first message are appended to ``others``.
    """
    for record in records(data):
        if record[0] == MESSAGE:
            break
        others.append(record)
    else:
        return np.empty(0, np.int64)
    _, start, end = record
    first, size = start - RECORD.size, end - start + RECORD.size
    if (len(data) - first) % size or size < HEAD.itemsize:
        return None
    starts = np.arange(first, len(data), size)
    head = _records_at(data, starts, HEAD)
    equal = (head['opcode'] == MESSAGE) & (head['length'] == size - RECORD.size)
    return starts if equal.all() else None


def _starts_by_search(data: bytes) -> tuple[NDArray[np.int64], list[Record]]:
    """Return the offset of each message, found record by record, and the other records."""
    starts, others = [], []
    for record in records(data):
        opcode, at, end = record
        if opcode != MESSAGE:
            others.append(record)
        elif end - at < MESSAGE_HEAD.size:
            raise struct.error('a message record is too short')
        else:
            starts.append(at - RECORD.size)
    return np.array(starts, dtype=np.int64), others


def _records_at(data: bytes, start: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the records at these offsets, (n,); a view of the data if they are evenly spaced."""
    step = np.diff(start)
    if len(step) and (step == step[0]).all():
        return np.ndarray((len(start),), dtype, data, int(start[0]), (int(step[0]),))
    return _gathered(data, start, dtype)


def _gathered(data: Any, start: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return copies of the records, of type ``dtype``, that begin at these byte offsets, (n,)."""
    if not len(start):
        return np.empty(0, dtype)
    anywhere = np.ndarray((len(data) - dtype.itemsize + 1,), dtype, data, strides=(1,))
    return anywhere[start]


def _of_channels(
    data: bytes, start: NDArray[np.int64], head: NDArray[Any], ids: set[int]
) -> Messages:
    """Return the messages of the channels ``ids``, in the order stored."""
    mine = among(head['channel'], ids)
    if not mine.all():
        head, start = head[mine], start[mine]
    return Messages(head['log_time'].astype(np.int64), _payloads(data, start, head['length']))


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
        both = _joined(pending, chunk)
        order = np.argsort(both.record_ns, kind='stable')
        times = both.record_ns[order]
        ready = len(times) if until is None else int(np.searchsorted(times, until))
        self._pending = both.chosen(order[ready:])
        later = self._pending.payloads
        size = sum(map(len, later)) if isinstance(later, list) else later.nbytes
        if size > MAX_SORT_BYTES:
            raise ValueError(f'chunks overlap by more than {MAX_SORT_BYTES} bytes')
        return both.chosen(order[:ready])


def _joined(first: Messages, second: Messages) -> Messages:
    """Concatenate messages: to one array if all have the same length, else to a list."""
    times = np.concatenate([first.record_ns, second.record_ns])
    a, b = first.payloads, second.payloads
    if not len(a):
        return Messages(times, b)
    if isinstance(a, list) or isinstance(b, list) or a.dtype != b.dtype:
        return Messages(times, [*as_list(a), *as_list(b)])
    return Messages(times, np.concatenate([a, b]))
