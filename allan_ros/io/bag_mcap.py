# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An mcap file, with or without its summary (https://mcap.dev/spec).

A file whose recorder was killed has no footer: its chunks are then found one by one, and what is
whole is read. Whole chunks are decompressed at a time, so memory does not grow with the file.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO

from .bag_storage import Block, Cut, InOrder, Topic, damaged, decompress, normal_type, translated
from .mcap_chunk import MESSAGE, MESSAGE_HEAD, RECORD, chunk_messages, records

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
_DAMAGE = (struct.error, ValueError, OSError, OverflowError, MemoryError)
"""What reading a damaged file raises."""
REMEDY = 'copy it again, or mend it with "mcap recover"'


@dataclass(frozen=True, order=True)
class Span:
    """A stretch of the file that holds messages: a chunk record, or a run of loose messages.

    Behind a chunk lie ``index_length`` bytes of records that say where its messages begin.
    """

    start_ns: int
    offset: int
    length: int
    is_chunk: bool
    index_length: int = 0


class McapStorage:
    """An open .mcap file."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file
        self._size = os.fstat(file.fileno()).st_size
        self._schemas: dict[int, tuple[str, str, str]] = {}
        self._channels: dict[int, Topic] = {}
        self._counts: Counter[int] = Counter()
        self._spans: list[Span] = []
        self.cut: Cut | None = None
        if self._read(0, len(MAGIC)) != MAGIC:
            raise damaged(path, 'it does not begin like an mcap file', 'give a recording')
        if not self._read_summary():
            self._scan()
        self._spans.sort()
        self.topics = list(self._channels.values())

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages."""
        return dict(self._counts)

    def blocks(self, ids: set[int]) -> Iterator[Block]:
        """Yield the messages of these topics in the order of their record time."""
        with translated(self._path, _DAMAGE, REMEDY):
            yield from self._blocks(ids)

    def _blocks(self, ids: set[int]) -> Iterator[Block]:
        in_order = InOrder()
        ends = [span.start_ns for span in self._spans[1:]] + [None]
        for span, until in zip(self._spans, ends):
            index = partial(self._read, span.offset + span.length, span.index_length)
            yield in_order.add(chunk_messages(self._data(span), ids, index), until)

    def _read(self, offset: int, length: int) -> bytes:
        self._file.seek(offset)
        return self._file.read(length)

    def _data(self, span: Span) -> bytes:
        """Return the records of a span, decompressed."""
        data = self._read(span.offset, span.length)
        if not span.is_chunk:
            return data
        _, _, size, checksum = CHUNK_HEAD.unpack_from(data)
        compression, at = _text(data, CHUNK_HEAD.size)
        (stored,) = struct.unpack_from('<Q', data, at)
        try:
            records = decompress(memoryview(data)[at + 8 : at + 8 + stored], compression)
            if len(records) != size:
                raise ValueError(f'{len(records)} bytes in place of {size}')
            if checksum and zlib.crc32(records) != checksum:
                raise ValueError('its checksum does not match')
        except ValueError as error:
            raise damaged(
                self._path, f'the chunk at byte {span.offset} is damaged: {error}', REMEDY
            ) from error
        return records

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
                self._spans.append(_chunk_span(data, at))
            elif opcode == STATISTICS:
                has_counts = True
                (size,) = struct.unpack_from('<I', data, at + 42)
                pairs = data[at + 46 : at + 46 + size]
                self._counts.update(dict(struct.iter_unpack('<HQ', pairs)))
        if (
            has_counts
            and set(self._counts) <= set(self._channels)
            and (self._spans or not sum(self._counts.values()))
        ):
            return True
        self._spans.clear()
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
                span = Span(first, start, length, True)
                self._spans.append(span)
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
        last = self._spans[-1] if self._spans else None
        adjoins = last and not last.is_chunk and last.offset + last.length == offset
        if last and adjoins and last.length < LOOSE_BYTES:
            start = min(last.start_ns, log_time)
            self._spans[-1] = Span(start, last.offset, last.length + length, False)
        else:
            self._spans.append(Span(log_time, offset, length, False))

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
            self._channels[number] = Topic(number, topic, normal_type(name), encoding, form, text)


def _chunk_span(data: bytes, at: int) -> Span:
    """Return the chunk that a ChunkIndex record speaks of."""
    first, _, offset, length, map_bytes = CHUNK_INDEX_HEAD.unpack_from(data, at)
    (index_length,) = struct.unpack_from('<Q', data, at + CHUNK_INDEX_HEAD.size + map_bytes)
    return Span(first, offset + RECORD.size, length - RECORD.size, True, index_length)


def _text(data: bytes, at: int) -> tuple[str, int]:
    """Return a string and where the next field begins."""
    (length,) = struct.unpack_from('<I', data, at)
    end = at + 4 + length
    return data[at + 4 : end].decode(errors='replace'), end


@contextmanager
def open_mcap(path: Path, shown: Path) -> Iterator[McapStorage]:
    """Open an mcap file.

    ``shown`` is the name used in messages, which differs for a decompressed copy.

    Raises
    ------
    AllanError
        When it is no mcap file or damaged.
    """
    with translated(shown, (OSError,), REMEDY):
        file = path.open('rb')
    with file:
        with translated(shown, _DAMAGE, REMEDY):
            storage = McapStorage(shown, file)
        yield storage
