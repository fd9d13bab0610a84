# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads an mcap file, with or without its summary (https://mcap.dev/spec).

The summary at the end states the topics and their numbers of messages. If there is none, because
the recorder was killed, or if it contradicts itself, they are found by reading the chunks. Messages
are read in the order of the file, which is the order in which a recorder receives them. One chunk
is decompressed at a time, so the memory does not depend on the size of the file.
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
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..files import open_regular
from . import MAX_CHUNK_BYTES, damaged, translated
from .bag import Messages, Topic, Truncation, among, decompress, normal_type

MAGIC = b'\x89MCAP0\r\n'

FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07

STATISTICS, DATA_END, LAST_OPCODE = 0x0B, 0x0F, 0x7F

FIXED_BYTES = {DATA_END: 4, FOOTER: 20}
"""Opcode -> only valid length of a record."""

RECORD = struct.Struct('<BQ')
"""Opcode and length at the start of each record."""

MESSAGE_HEAD = struct.Struct('<HIqQ')
"""Channel, sequence, log time, publish time."""

INDEX_HEAD = struct.Struct('<HI')
"""Channel, and size of the pairs (log time, offset) that follow."""

CHUNK_HEAD = struct.Struct('<QQQI')
"""First and last log time, uncompressed size, CRC-32 (0: none)."""

STATISTICS_HEAD = struct.Struct('<QHIIIIQQI')
"""Numbers of messages, schemas, channels, attachments, metadata and chunks, first and last log
time, and size of the map from channel to number of messages that follows."""

CRC_BYTES = 4
"""Size of the CRC-32 of the summary, the last field of the footer; 0 if there is none."""

FOOTER_BYTES = RECORD.size + FIXED_BYTES[FOOTER] + len(MAGIC)

LOOSE_BYTES = 1 << 20
"""Messages outside chunks are read about this many bytes at a time."""

DAMAGE = (struct.error, ValueError, OSError, OverflowError, MemoryError)
"""Exceptions when a file is damaged."""

REMEDY = 'copy it again, or repair it with "mcap recover"'


class Chunk(NamedTuple):
    """Place of a chunk in a file, or of a sequence of messages outside chunks (``loose``)."""

    offset: int
    length: int
    loose: bool = False


@dataclass
class Contents:
    """Topics, message types and message counts according to the records of a file."""

    topics: dict[int, Topic] = field(default_factory=dict)
    schemas: dict[int, str] = field(default_factory=dict)  # number -> name of the type
    counted: Counter[int] = field(default_factory=Counter)  # message records of each channel
    stated: Counter[int] = field(default_factory=Counter)  # messages according to the statistics
    totals: tuple[int, ...] = ()  # the head of the statistics
    indexed: Counter[int] = field(default_factory=Counter)  # messages in MessageIndex records

    def add(self, opcode: int, data: bytes, at: int, stop: int) -> None:
        """Count the message, or store the schema, channel or statistics in ``data[at:stop]``."""
        if opcode == MESSAGE:
            self.counted[MESSAGE_HEAD.unpack_from(data, at)[0]] += 1
        elif opcode == SCHEMA:
            (number,) = struct.unpack_from('<H', data, at)
            self.schemas[number] = _text(data, at + 2)[0]
        elif opcode == CHANNEL:
            number, schema = struct.unpack_from('<HH', data, at)
            name, at = _text(data, at + 4)
            encoding, at = _text(data, at)
            kind = normal_type(self.schemas.get(schema, ''))
            self.topics[number] = Topic(number, name, kind, encoding)
        elif opcode == STATISTICS:
            self.totals = STATISTICS_HEAD.unpack_from(data, at)
            size = self.totals[-1]
            at += STATISTICS_HEAD.size
            self.stated = Counter(dict(struct.iter_unpack('<HQ', data[at : min(at + size, stop)])))

    def check(self, opcode: int, data: bytes, at: int) -> None:
        """Raise ValueError if a schema or channel in a chunk differs from the known one."""
        found = Contents(schemas=dict(self.schemas))
        found.add(opcode, data, at, at)
        for number, schema in self.schemas.items():
            if found.schemas[number] != schema:
                raise ValueError(f'schema {number} is {found.schemas[number]} in a chunk only')
        for number, topic in found.topics.items():
            known = self.topics.get(number)
            if known is None or (known.name, known.type) != (topic.name, topic.type):
                raise ValueError(f'channel {number} is {topic.name} in a chunk, but not elsewhere')


class McapStorage:
    """An open mcap file; error messages name it ``path``.

    Raises one of `DAMAGE` when it is of another format or damaged.
    """

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file
        self._size = os.fstat(file.fileno()).st_size
        self._chunks: list[Chunk] = []
        self.truncation: Truncation | None = None
        if self._read(0, len(MAGIC)) != MAGIC:
            raise damaged(path, 'it is not an mcap file', 'give a recording')
        summary, end = self._read_summary()
        self._contents = known = summary or Contents()
        at = self._scan(end, summary is not None)
        if summary is not None:
            known.counted = Counter(known.stated)
        else:
            known.stated = known.stated or known.counted | known.indexed
            end -= len(MAGIC)
        if not self.truncation and (at < end or not self._ends_with_magic()):
            self.truncation = Truncation(at, self._size)
        self.topics = list(known.topics.values())

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages."""
        return dict(self._contents.counted)

    def stated(self, ids: set[int], read: int) -> int:
        """Return how many messages of these topics the file contains, according to its index.

        ``read`` is the number of messages that were read, which is returned without an index.
        """
        if not self._contents.stated:
            return read
        stated = sum(self._contents.stated[number] for number in ids)
        return max(stated, read) if self.truncation else stated  # the index may be truncated, too

    def blocks(self, ids: set[int]) -> Iterator[Messages]:
        """Yield the next messages of these topics."""
        with translated(self._path, DAMAGE, REMEDY):
            for chunk in self._chunks:
                yield self._messages(chunk, ids)

    def _messages(self, chunk: Chunk, ids: set[int]) -> Messages:
        data = self._data(chunk)
        view = memoryview(data)
        channels: list[int] = []
        times: list[int] = []
        payloads: list[bytes | memoryview] = []
        unpack, head_bytes, first = MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size, True
        for opcode, start, end in records(data):
            if opcode != MESSAGE:
                self._contents.check(opcode, data, start)
                continue
            if first and (equal := equal_messages(data, start, end)) is not None:
                return _of_channels(equal, ids)
            first = False
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

    def _ends_with_magic(self) -> bool:
        end = self._size - len(MAGIC)
        return end > 0 and self._read(end, len(MAGIC)) == MAGIC

    def _read_summary(self) -> tuple[Contents | None, int]:
        """Return the contents according to the summary, and its offset.

        If it is missing, or if its records contradict each other, these are None and the size of
        the file.
        """
        unusable = None, self._size
        footer = self._read(max(0, self._size - FOOTER_BYTES), FOOTER_BYTES)
        if not footer.endswith(MAGIC) or footer[0] != FOOTER:
            return unusable
        start, _, checksum = struct.unpack_from('<QQI', footer, RECORD.size)
        end = self._size - FOOTER_BYTES
        if not 0 < start <= end:
            return unusable
        try:
            data = self._read(start, end - start)
            if checksum and zlib.crc32(data + footer[: -CRC_BYTES - len(MAGIC)]) != checksum:
                return unusable
            known = Contents()
            for opcode, at, stop in records(data):
                known.add(opcode, data, at, stop)
        except (struct.error, ValueError):
            return unusable
        counted = known.stated.total(), len(known.topics)
        agrees = known.totals and (known.totals[0], known.totals[2]) == counted
        if not (agrees and all(counted) and {*known.stated} <= {*known.topics}):
            return unusable
        return known, start

    def _scan(self, stop: int, has_summary: bool) -> int:
        """Find the chunks, and without a summary their contents; return the end of reading.

        Reading ends at ``stop``, or at the first record that extends beyond it.
        """
        at, skipped, known = len(MAGIC), 0, self._contents
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
                self._chunks.append(Chunk(start, length))
            elif opcode == MESSAGE:
                self._add_loose(at, end)
            if has_summary:
                pass
            elif opcode == CHUNK:
                data = self._data(self._chunks[-1])
                for inner, inner_at, inner_end in records(data):
                    known.add(inner, data, inner_at, inner_end)
            elif opcode == MESSAGE_INDEX:
                channel, size = INDEX_HEAD.unpack(self._read(start, INDEX_HEAD.size))
                known.indexed[channel] += size // 16
            elif opcode in (MESSAGE, SCHEMA, CHANNEL, STATISTICS):
                known.add(opcode, self._read(start, length), 0, length)
            at = end
        if skipped:
            self.truncation = Truncation(self._size - skipped, self._size)
        return at

    def _add_loose(self, start: int, end: int) -> None:
        """Add a message record outside chunks; adjacent ones form one chunk."""
        last = self._chunks[-1] if self._chunks else None
        if last and last.loose and last.offset + last.length == start and last.length < LOOSE_BYTES:
            start = last.offset
            self._chunks.pop()
        self._chunks.append(Chunk(start, end - start, loose=True))


def _text(data: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from('<I', data, at)
    end = at + 4 + length
    return data[at + 4 : end].decode(errors='replace'), end


@contextmanager
def open_storage(path: Path, shown: Path) -> Iterator[McapStorage]:
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


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, offset and end offset of the content of each record in the data.

    Raises struct.error when a record extends beyond the end.
    """
    at, size, unpack, head_bytes = 0, len(data), RECORD.unpack_from, RECORD.size
    while at + head_bytes <= size:
        opcode, length = unpack(data, at)
        start = at + head_bytes
        at = start + length
        if at > size or not opcode:
            raise struct.error('a record extends beyond the end of its chunk')
        yield opcode, start, at


def equal_messages(data: bytes, start: int, end: int) -> NDArray[np.void] | None:
    """Return all message records from ``data[start:end]`` on, (n,), without copying them.

    ``start`` and ``end`` are the offsets of the content of the first one. Returns None if they have
    different lengths, or other records follow.
    """
    first, length = start - RECORD.size, end - start
    count, rest = divmod(len(data) - first, RECORD.size + length)
    if rest or length <= MESSAGE_HEAD.size:
        return None
    found = np.ndarray((count,), _message_dtype(length), data, first)
    same = (found['opcode'] == MESSAGE) & (found['length'] == length)
    return found if same.all() else None


@lru_cache(maxsize=64)
def _message_dtype(length: int) -> np.dtype[Any]:
    fields = [('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'), ('sequence', '<u4')]
    fields += [('log_time', '<i8'), ('publish_time', '<u8')]
    return np.dtype([*fields, ('payload', f'V{length - MESSAGE_HEAD.size}')])


def _of_channels(found: NDArray[np.void], ids: set[int]) -> Messages:
    mine = among(found['channel'], ids)
    if not mine.all():
        found = found[mine]
    return Messages(found['channel'], found['log_time'].astype(np.int64), found['payload'])
