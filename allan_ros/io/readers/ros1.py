# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads a ROS 1 bag, version 2.0, also without an index (https://wiki.ros.org/Bags/Format/2.0).

The file is searched for chunks record by record. So a bag that was not closed (``.bag.active``) or
that is truncated can be read up to its last complete chunk.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...core.imu import NANOSECONDS
from .storage import Chunk, ChunkStorage, Messages, Topic, Truncation, damaged, normal_type

MAGIC = b'#ROSBAG V2.0\n'

OP_MESSAGE, OP_BAG, OP_INDEX, OP_CHUNK, OP_CHUNK_INFO, OP_CONNECTION = 2, 3, 4, 5, 6, 7

LENGTH = struct.Struct('<I')

TIME = struct.Struct('<II')

INDEX_ENTRY = np.dtype([('sec', '<u4'), ('nanosec', '<u4'), ('offset', '<u4')])
"""Layout of an index entry: record time and offset of a message."""

CHUNK_COUNT = struct.Struct('<II')
"""Layout of a pair: connection, and its number of messages in a chunk."""

NO_INDEX = np.iinfo(np.int64).max
"""Start time of a chunk without an index."""

MAX_HEADER = 1 << 20
"""Length of a record header in bytes above which the bag is damaged."""


class Ros1Storage(ChunkStorage):
    """An open ROS 1 bag."""

    # LookupError: a missing field
    DAMAGE = (struct.error, LookupError, ValueError, OSError, OverflowError, MemoryError)
    REMEDY = 'copy it again, or repair it with "rosbag reindex" or "rosbag fix"'

    def _survey(self) -> None:
        magic = self._read(0, len(MAGIC))
        if magic != MAGIC:
            version = magic.split(b'\n')[0].decode(errors='replace')
            raise damaged(
                self._path, f'{version!r} is not ROS bag 2.0', 'update it with "rosbag fix"'
            )
        listed: Counter[int] = Counter()
        at = len(MAGIC)
        while record := self._record(at):
            header, start, end = record
            opcode = header['op'][0]
            if opcode == OP_BAG and header.get('encryptor'):
                raise damaged(self._path, 'it is encrypted', 'decrypt it first')
            if opcode == OP_CHUNK:
                self._chunks.append(Chunk(NO_INDEX, at, end - at))
            elif opcode == OP_INDEX:
                self._add_index(header, self._read(start, end - start))
            elif opcode == OP_CONNECTION:
                self._add_connection(header, self._read(start, end - start))
            elif opcode == OP_CHUNK_INFO:
                for connection, count in CHUNK_COUNT.iter_unpack(self._read(start, end - start)):
                    listed[connection] += count
            at = end
        complete = bool(self._topics) or not self._chunks
        if at < self._size or not complete:
            self.truncation = Truncation(at, self._size)
        self._chunks = [self._with_start(chunk, complete) for chunk in self._chunks]
        self._chunks = [chunk for chunk in self._chunks if chunk.start_ns != NO_INDEX]
        self._stated = self._counts | listed

    def _messages(self, chunk: Chunk, ids: set[int]) -> Messages:
        data = self._data(chunk)
        view = memoryview(data)
        times: list[int] = []
        payloads: list[bytes | memoryview] = []
        for header, start, end in _records(data):
            if header['op'][0] == OP_MESSAGE and _number(header['conn']) in ids:
                times.append(_time(header['time']))
                payloads.append(view[start:end])
        return Messages(np.array(times, dtype=np.int64), payloads)

    def _record(self, at: int) -> tuple[dict[str, bytes], int, int] | None:
        """Return header fields, offset and end offset of the data of the record at offset ``at``.

        Returns None if the record is incomplete.
        """
        self._file.seek(at)
        prefix = self._file.read(LENGTH.size)
        if len(prefix) < LENGTH.size:
            return None
        (header_length,) = LENGTH.unpack(prefix)
        start = at + 2 * LENGTH.size + header_length
        if start > self._size or not 0 < header_length < MAX_HEADER:
            return None
        raw = self._file.read(header_length + LENGTH.size)
        end = start + LENGTH.unpack_from(raw, header_length)[0]
        return None if end > self._size else (_fields(raw[:header_length]), start, end)

    def _add_index(self, header: dict[str, bytes], entries: bytes) -> None:
        """Count the messages in an index record, and update the start time of the last chunk."""
        index = np.frombuffer(entries, INDEX_ENTRY)
        times = index['sec'].astype(np.int64) * NANOSECONDS + index['nanosec']
        self._counts[_number(header['conn'])] += len(times)
        if self._chunks:
            last = self._chunks[-1]
            self._chunks[-1] = replace(last, start_ns=int(times.min(initial=last.start_ns)))

    def _with_start(self, chunk: Chunk, complete: bool) -> Chunk:
        """Return a chunk with its start time, found in its messages if the chunk has no index.

        If the file is not ``complete``, the connections are read from the chunk, too.
        """
        if complete and chunk.start_ns != NO_INDEX:
            return chunk
        data, start_ns = self._data(chunk), chunk.start_ns
        for header, start, end in _records(data):
            if header['op'][0] == OP_CONNECTION and not complete:
                self._add_connection(header, data[start:end])
            elif header['op'][0] == OP_MESSAGE and chunk.start_ns == NO_INDEX:
                self._counts[_number(header['conn'])] += 1
                start_ns = min(start_ns, _time(header['time']))
        return replace(chunk, start_ns=start_ns)

    def _add_connection(self, header: dict[str, bytes], data: bytes) -> None:
        """Add the topic of a connection record."""
        number = _number(header['conn'])
        fields = _fields(data)
        self._topics[number] = Topic(
            number,
            '/' * header['topic'].startswith(b'/')
            + '/'.join(part for part in header['topic'].decode().split('/') if part),
            normal_type(fields['type'].decode()),
            'ros1',
            'ros1msg',
            fields['message_definition'].decode(errors='replace'),
        )

    def _data(self, chunk: Chunk) -> bytes:
        """Return the decompressed records of a chunk."""
        record = self._read(chunk.offset, chunk.length)
        ((header, start, end),) = _records(record)
        compression, size = header['compression'].decode(errors='replace'), _number(header['size'])
        return self._unpacked(chunk.offset, record[start:end], compression, size)


def _records(data: bytes) -> Iterator[tuple[dict[str, bytes], int, int]]:
    """Yield header fields, offset and end offset of the data of each record in a chunk.

    Raises struct.error when a record extends beyond the end of the chunk.
    """
    at = 0
    while at < len(data):
        (header_length,) = LENGTH.unpack_from(data, at)
        head = at + LENGTH.size
        start = head + header_length + LENGTH.size
        at = start + LENGTH.unpack_from(data, head + header_length)[0]
        if at > len(data):
            raise struct.error('a record extends beyond the end of its chunk')
        yield _fields(data[head : head + header_length]), start, at


def _fields(raw: bytes) -> dict[str, bytes]:
    """Return the fields of a record header, by name."""
    fields = {}
    at = 0
    while at < len(raw):
        (length,) = LENGTH.unpack_from(raw, at)
        at += LENGTH.size
        name, _, value = raw[at : at + length].partition(b'=')
        fields[name.decode(errors='replace')] = value
        at += length
    return fields


def _number(value: bytes) -> int:
    return int.from_bytes(value, 'little')


def _time(value: bytes) -> int:
    sec, nsec = TIME.unpack(value)
    return int(sec) * NANOSECONDS + int(nsec)
