# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read an mcap file (https://mcap.dev/spec).

The summary at the end of a file lists its chunks. The rest of the file is searched for messages
outside chunks and for further chunks. If the summary is missing, because the recorder was killed,
or contradicts itself, the complete file is searched. One chunk is decompressed at a time, to limit
the memory.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from .bag_messages import Messages, Topic, Truncation, among, decompress, normal_type
from .files import open_regular
from .recording import MAX_CHUNK_BYTES, MCAP_MAGIC, damaged, translated

FOOTER, SCHEMA_OPCODE, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07

CHUNK_INDEX, STATISTICS_OPCODE, DATA_END, LAST_OPCODE = 0x08, 0x0B, 0x0F, 0x7F

FIXED_BYTES = {DATA_END: 4, FOOTER: 20}
"""Opcode -> length in bytes that the content of a record with this opcode must have."""

RECORD_HEAD = struct.Struct('<BQ')
"""Opcode and length at the start of each record."""

MESSAGE_HEAD = struct.Struct('<HIqQ')
"""First fields of a Message record: channel, sequence number, log time and publish time."""

INDEX_HEAD = struct.Struct('<HI')
"""First fields of a MessageIndex record: channel, and size in bytes of the pairs (log time, offset)
that follow."""

CHUNK_HEAD = struct.Struct('<QQQI')
"""First fields of a Chunk record: first and last log time, decompressed size in bytes, and CRC-32,
which is 0 if it is not stored."""

CHUNK_INDEX_HEAD = struct.Struct('<QQQQI')
"""First fields of a ChunkIndex record: first and last log time, offset and length of the chunk, and
size in bytes of the map from channel to offset that follows."""

STATISTICS_HEAD = struct.Struct('<QHIIIIQQI')
"""First fields of a Statistics record: numbers of messages, schemas, channels, attachments,
metadata records and chunks, first and last log time, and size in bytes of the map from channel to
number of messages that follows."""

CRC_BYTES = 4
"""Number of bytes of the CRC-32 of the summary, the last field of the footer."""

FOOTER_BYTES = RECORD_HEAD.size + FIXED_BYTES[FOOTER] + len(MCAP_MAGIC)
"""Number of bytes of the footer and the magic after it, at the end of a file."""

LOOSE_BYTES = 1 << 20
"""Adjacent messages outside chunks are read together, as one sequence. When a sequence has at least
this number of bytes, the next message starts another sequence."""

MAX_SORT_BYTES = 512 * 2**20
"""Largest size in bytes of the messages that are kept in memory to sort overlapping chunks."""

DAMAGE = (struct.error, ValueError, OSError, OverflowError, MemoryError)
"""Exceptions that a damaged file can cause."""

REMEDY = 'copy it again, or repair it with "mcap recover"'


@dataclass(frozen=True, order=True)
class Chunk:
    """A chunk of a file, or a sequence of messages outside chunks (``loose``).

    ``start_ns`` is the smallest record time of the messages, as the file states it. ``offset`` and
    ``length`` state where the content is in the file. ``next`` is the offset after the content or,
    if the summary lists the chunk, after the message index of the chunk.
    """

    start_ns: int
    offset: int
    length: int
    next: int
    loose: bool = False


@dataclass
class Contents:
    """Topics, message types and message counts according to the records of a file."""

    topics: dict[int, Topic] = field(default_factory=dict)
    schemas: dict[int, str] = field(default_factory=dict)  # number of a schema -> message type
    # channel -> number of messages, counted or, if a summary lists chunks, according to the summary
    counted: Counter[int] = field(default_factory=Counter)
    # channel -> number of messages according to the Statistics record
    stated: Counter[int] = field(default_factory=Counter)
    totals: tuple[int, ...] = ()  # fields of `STATISTICS_HEAD`; empty without a Statistics record

    def add(self, opcode: int, data: bytes, at: int, stop: int) -> None:
        """Count the message, or store the schema, channel or statistics in ``data[at:stop]``."""
        if opcode == MESSAGE:
            self.counted[MESSAGE_HEAD.unpack_from(data, at)[0]] += 1
        elif opcode == SCHEMA_OPCODE:
            (number,) = struct.unpack_from('<H', data, at)
            self.schemas[number] = _text(data, at + 2)[0]
        elif opcode == CHANNEL:
            number, schema = struct.unpack_from('<HH', data, at)
            name, at = _text(data, at + 4)
            encoding, at = _text(data, at)
            message_type = normal_type(self.schemas.get(schema, ''))
            self.topics[number] = Topic(number, name, message_type, encoding)
        elif opcode == STATISTICS_OPCODE:
            self.totals = STATISTICS_HEAD.unpack_from(data, at)
            size = self.totals[-1]
            at += STATISTICS_HEAD.size
            self.stated = Counter(dict(struct.iter_unpack('<HQ', data[at : min(at + size, stop)])))

    def check(self, opcode: int, data: bytes, at: int) -> None:
        """Raise ValueError if a schema or channel differs from the stored one, or a channel is new.

        Of a channel, the topic name and message type are compared.
        """
        found = Contents(schemas=dict(self.schemas))
        found.add(opcode, data, at, at)
        for number, schema in self.schemas.items():
            if found.schemas[number] != schema:
                raise ValueError(
                    f'schema {number} is {found.schemas[number]} in a chunk, but not elsewhere'
                )
        for number, topic in found.topics.items():
            stored = self.topics.get(number)
            if stored is None or (stored.name, stored.type) != (topic.name, topic.type):
                raise ValueError(f'channel {number} is {topic.name} in a chunk, but not elsewhere')


class McapStorage:
    """An open mcap file; ``path`` is its path in error messages.

    Raises AllanError when the file is not an mcap file or a chunk is damaged, and one of `DAMAGE`
    for other damage.
    """

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file
        self._size = os.fstat(file.fileno()).st_size
        self._chunks: list[Chunk] = []
        # channel -> number of messages in MessageIndex records and outside chunks
        self._indexed: Counter[int] = Counter()
        self.truncation: Truncation | None = None
        if self._read(0, len(MCAP_MAGIC)) != MCAP_MAGIC:
            raise damaged(path, 'it is not an mcap file', 'give a recording')
        self._contents, listed_chunks, end = self._read_summary()
        at = len(MCAP_MAGIC)
        for chunk in listed_chunks:
            at = max(self._scan(at, chunk.offset - RECORD_HEAD.size), chunk.next)
            self._chunks.append(chunk)
        at = self._scan(at, end)
        contents = self._contents
        if listed_chunks:
            contents.counted = Counter(contents.stated)
        else:
            contents.stated = contents.stated or contents.counted | self._indexed
            magic_at = self._size - len(MCAP_MAGIC)
            has_end = at >= magic_at > 0 and self._read(magic_at, len(MCAP_MAGIC)) == MCAP_MAGIC
            if not self.truncation and not has_end:
                self.truncation = Truncation(at, self._size)
        self._chunks.sort()
        self.topics = list(contents.topics.values())

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages, as stated in the summary or as counted."""
        return dict(self._contents.counted)

    def stated_count(self, ids: set[int], read_count: int) -> int:
        """Return how many messages of the topics ``ids`` the file states in its Statistics record.

        Without such a record, the number of messages or of index entries that were found when the
        file was opened is used, whichever is larger. If none were found of any topic, the result is
        ``read_count``, the number of messages that were read. If the file is truncated, the result
        is at least ``read_count``.
        """
        if not self._contents.stated:
            return read_count
        count = sum(self._contents.stated[channel] for channel in ids)
        # the index of a truncated file may be truncated, too
        return max(count, read_count) if self.truncation else count

    def blocks(self, ids: set[int]) -> Iterator[Messages]:
        """Yield all messages of the topics ``ids`` in blocks, in the order of record time."""
        with translated(self._path, DAMAGE, REMEDY):
            pending = Messages.none()
            next_starts = [chunk.start_ns for chunk in self._chunks[1:]] + [None]
            for chunk, until in zip(self._chunks, next_starts):
                ready, pending = sorted_until(until, pending, self._messages(chunk, ids))
                yield ready

    def _messages(self, chunk: Chunk, ids: set[int]) -> Messages:
        data = self._data(chunk)
        view = memoryview(data)
        channels: list[int] = []
        times: list[int] = []
        payloads: list[bytes | memoryview] = []
        unpack, head_bytes, is_first = MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size, True
        for opcode, start, end in records(data):
            if opcode != MESSAGE:
                self._contents.check(opcode, data, start)
                continue
            if is_first and (equal_records := equal_messages(data, start, end)) is not None:
                return _of_channels(equal_records, ids)
            is_first = False
            if end - start < head_bytes:
                raise struct.error('a message record is too short')
            channel, _, time_ns, _ = unpack(data, start)
            if channel in ids:
                channels.append(channel)
                times.append(time_ns)
                payloads.append(view[start + head_bytes : end])
        return Messages(np.array(channels, np.int64), np.array(times, np.int64), payloads)

    def _read(self, offset: int, length: int) -> bytes:
        if length > MAX_CHUNK_BYTES:
            raise ValueError(
                f'a record of {length} bytes at byte {offset}, the limit is {MAX_CHUNK_BYTES}'
            )
        self._file.seek(offset)
        return self._file.read(length)

    def _data(self, chunk: Chunk) -> bytes:
        """Return the decompressed records of a chunk, after checking its CRC-32 if it is stored."""
        data = self._read(chunk.offset, chunk.length)
        if chunk.loose:
            return data
        _, _, size, checksum = CHUNK_HEAD.unpack_from(data)
        compression, at = _text(data, CHUNK_HEAD.size)
        (stored,) = struct.unpack_from('<Q', data, at)
        packed = memoryview(data)[at + 8 : at + 8 + stored]
        try:
            content = decompress(packed, compression, min(size, MAX_CHUNK_BYTES))
            if len(content) != size:
                raise ValueError(f'{len(content)} bytes instead of {size}')
            if checksum and zlib.crc32(content) != checksum:
                raise ValueError('its checksum is wrong')
        except ValueError as error:
            reason = f'the chunk at byte {chunk.offset} is damaged: {error}'
            raise damaged(self._path, reason, REMEDY) from error
        return content

    def _read_summary(self) -> tuple[Contents, list[Chunk], int]:
        """Return the contents and chunks according to the summary, and the offset of the summary.

        If the summary is missing or damaged, lists no chunk, channel or message, or its records
        contradict each other, the contents and the chunks are empty, and the offset is the size of
        the file.
        """
        no_summary: tuple[Contents, list[Chunk], int] = (Contents(), [], self._size)
        footer = self._read(max(0, self._size - FOOTER_BYTES), FOOTER_BYTES)
        if not footer.endswith(MCAP_MAGIC) or footer[0] != FOOTER:
            return no_summary
        start, _, checksum = struct.unpack_from('<QQI', footer, RECORD_HEAD.size)
        end = self._size - FOOTER_BYTES
        if not 0 < start <= end:
            return no_summary
        try:
            data = self._read(start, end - start)
            if checksum and zlib.crc32(data + footer[: -CRC_BYTES - len(MCAP_MAGIC)]) != checksum:
                return no_summary
            contents = Contents()
            chunks: dict[int, Chunk] = {}
            channels: set[int] = set()
            for opcode, at, stop in records(data):
                contents.add(opcode, data, at, stop)
                if opcode == CHUNK_INDEX:
                    chunk, chunk_channels = _listed_chunk(data, at)
                    chunks[chunk.offset] = chunk
                    channels |= chunk_channels
        except (struct.error, ValueError):
            return no_summary
        counted = [contents.stated.total(), len(contents.topics), len(chunks)]
        counts_agree = contents.totals and [contents.totals[i] for i in (0, 2, 5)] == counted
        if not (
            counts_agree and all(counted) and channels | {*contents.stated} <= {*contents.topics}
        ):
            return no_summary
        return contents, [chunks[offset] for offset in sorted(chunks)], start

    def _scan(self, at: int, stop: int) -> int:
        """Read the records from offset ``at`` on, and return the offset of the first unread byte.

        Reading ends at the offset ``stop``, or at the first record that extends beyond ``stop`` or
        has the opcode 0.
        """
        damaged_bytes = 0
        while at + RECORD_HEAD.size <= stop:
            head = self._read(at, RECORD_HEAD.size)
            if head.startswith(MCAP_MAGIC):  # the magic follows the footer
                at += len(MCAP_MAGIC)
                continue
            opcode, length = RECORD_HEAD.unpack(head)
            start, end = at + RECORD_HEAD.size, at + RECORD_HEAD.size + length
            if end > stop or opcode == 0:
                break
            if FIXED_BYTES.get(opcode, length) != length or DATA_END < opcode <= LAST_OPCODE:
                damaged_bytes += end - at
            elif opcode == CHUNK:
                first, _, _, _ = CHUNK_HEAD.unpack(self._read(start, CHUNK_HEAD.size))
                self._chunks.append(Chunk(first, start, length, end))
                data = self._data(self._chunks[-1])
                for data_opcode, data_start, data_end in records(data):
                    self._contents.add(data_opcode, data, data_start, data_end)
            elif opcode == MESSAGE:
                data = self._read(start, MESSAGE_HEAD.size)
                self._contents.add(opcode, data, 0, len(data))
                self._add_loose(data, at, end)
            elif opcode == MESSAGE_INDEX:
                channel, size = INDEX_HEAD.unpack(self._read(start, INDEX_HEAD.size))
                self._indexed[channel] += size // 16
            elif opcode in (SCHEMA_OPCODE, CHANNEL, STATISTICS_OPCODE):
                self._contents.add(opcode, self._read(start, length), 0, length)
            at = end
        if damaged_bytes:
            self.truncation = Truncation(self._size - damaged_bytes, self._size)
        return at

    def _add_loose(self, head: bytes, offset: int, end: int) -> None:
        """Add a message record outside chunks to the list of chunks.

        ``head`` is the start of the content of the record. The record begins at ``offset`` in the
        file and stops before ``end``. Adjacent messages are joined to one chunk until this chunk
        has `LOOSE_BYTES`.
        """
        channel, _, log_time, _ = MESSAGE_HEAD.unpack(head)
        self._indexed[channel] += 1
        last_chunk = self._chunks[-1] if self._chunks else None
        if (
            last_chunk
            and last_chunk.loose
            and last_chunk.next == offset
            and last_chunk.length < LOOSE_BYTES
        ):
            log_time, offset = min(last_chunk.start_ns, log_time), last_chunk.offset
            self._chunks.pop()
        self._chunks.append(Chunk(log_time, offset, end - offset, end, loose=True))


def _listed_chunk(data: bytes, at: int) -> tuple[Chunk, set[int]]:
    """Return the chunk that the ChunkIndex record at ``data[at:]`` describes, and its channels."""
    first, _, offset, length, map_bytes = CHUNK_INDEX_HEAD.unpack_from(data, at)
    at += CHUNK_INDEX_HEAD.size
    channels = {n for n, _ in struct.iter_unpack('<HQ', data[at : at + map_bytes])}
    (index_length,) = struct.unpack_from('<Q', data, at + map_bytes)
    start, end = offset + RECORD_HEAD.size, offset + length
    return Chunk(first, start, end - start, end + index_length), channels


def _text(data: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from('<I', data, at)
    end = at + 4 + length
    return data[at + 4 : end].decode(errors='replace'), end


@contextmanager
def open_storage(path: Path, shown: Path) -> Iterator[McapStorage]:
    """Open an mcap file for reading.

    ``shown`` is the path in error messages, because ``path`` may be a decompressed copy. Raises
    AllanError when the file is of another format or damaged.
    """
    with translated(shown, DAMAGE, REMEDY):
        file = open_regular(path)
    with file:
        with translated(shown, DAMAGE, REMEDY):
            storage = McapStorage(shown, file)
        yield storage


# --- messages in a chunk -----------------------------------------------------------------------


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield the opcode of each record in the data, and the start and end offset of its content.

    Raises struct.error when the content of a record extends beyond the end of the data, or an
    opcode is 0.
    """
    at, size, unpack, head_bytes = 0, len(data), RECORD_HEAD.unpack_from, RECORD_HEAD.size
    while at + head_bytes <= size:
        opcode, length = unpack(data, at)
        start = at + head_bytes
        at = start + length
        if at > size or not opcode:
            raise struct.error('a record extends beyond the end of its chunk')
        yield opcode, start, at


def equal_messages(data: bytes, start: int, end: int) -> NDArray[np.void] | None:
    """Return the message records in the rest of ``data``, (n,), without copying them.

    The content of the first of these records is ``data[start:end]``. Returns None if the messages
    have no payload, or if any record after the first is incomplete, is not a message record, or has
    another length.
    """
    first, length = start - RECORD_HEAD.size, end - start
    count, rest_bytes = divmod(len(data) - first, RECORD_HEAD.size + length)
    if rest_bytes or length <= MESSAGE_HEAD.size:
        return None
    message_records = np.ndarray((count,), _message_dtype(length), data, first)
    is_equal = (message_records['opcode'] == MESSAGE) & (message_records['length'] == length)
    return message_records if is_equal.all() else None


@lru_cache(maxsize=64)
def _message_dtype(length: int) -> np.dtype[Any]:
    fields = [('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'), ('sequence', '<u4')]
    fields += [('log_time', '<i8'), ('publish_time', '<u8')]
    return np.dtype([*fields, ('payload', f'V{length - MESSAGE_HEAD.size}')])


def _of_channels(message_records: NDArray[np.void], ids: set[int]) -> Messages:
    is_selected = among(message_records['channel'], ids)
    if not is_selected.all():
        message_records = message_records[is_selected]
    return Messages(
        message_records['channel'],
        message_records['log_time'].astype(np.int64),
        message_records['payload'],
    )


def sorted_until(
    until: int | None, pending: Messages, chunk: Messages
) -> tuple[Messages, Messages]:
    """Sort messages by record time, and split them into messages before ``until`` and later ones.

    Parameters
    ----------
    until : int or None
        First record time of the next chunk in ns; None after the last chunk.
    pending : Messages
        The later messages that the previous call returned; they are sorted, too.
    chunk : Messages
        The messages of the present chunk.

    Raises
    ------
    ValueError
        When the later messages have more than `MAX_SORT_BYTES`.
    """
    times = chunk.record_ns
    is_complete = until is None or not len(times) or times[-1] < until
    if is_complete and not len(pending) and (times[1:] >= times[:-1]).all():
        return chunk, pending
    messages = pending.followed_by(chunk)
    order = np.argsort(messages.record_ns, kind='stable')
    n_ready = (
        len(order) if until is None else int(np.searchsorted(messages.record_ns[order], until))
    )
    later = messages.chosen(order[n_ready:])
    if sum(map(len, later.payloads)) > MAX_SORT_BYTES:
        raise ValueError(f'chunks overlap by more than {MAX_SORT_BYTES} bytes')
    return messages.chosen(order[:n_ready]), later
