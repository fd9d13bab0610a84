# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads the messages of a rosbag2 database directly from its pages, thousands at a time.

SQLite returns one row at a time, which takes three times as long as decoding the messages. The
file format is documented and stable (https://www.sqlite.org/fileformat2.html; the comments name
its sections). A table is a tree of pages, whose leaves contain the rows in the order of their ids.
If the file contains anything unexpected, `Unusual` is raised, and SQLite reads the rows instead.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from .storage import Messages, Payloads, among, gathered

LEAF, INTERIOR = 13, 5
"""Types of the pages of a table (section 1.6)."""

PAGE_SIZE = slice(16, 18)
"""Place of the page size in the file header; 1 means 65536 (section 1.3.2)."""

RESERVED = 20
"""Place, in the file header, of the number of unused bytes at the end of pages (section 1.3.4)."""

FILE_HEAD = 100
"""Size of the file header in bytes (section 1.3)."""

LEAF_HEAD = np.dtype([('kind', 'u1'), ('free', '>u2'), ('cells', '>u2'), ('content', 'V3')])
"""Header of a leaf. The offsets of its cells follow, two bytes each (section 1.6)."""

INTERIOR_HEAD = np.dtype([*LEAF_HEAD.descr, ('last', '>u4')])
"""Header of an interior page, which ends with the number of its last child (section 1.6)."""

OVERFLOW_MARGIN = 35
"""A row larger than a page minus this many bytes continues in other pages (section 1.6)."""

MAX_DEPTH = 20
"""Largest depth of a tree that SQLite allows."""

WORD = 8
"""Number of bytes at the start of a cell that contain two varints: size and id of the row."""

LAST_BYTES = np.uint64(0x8080808080808080)
"""Highest bit of each byte of a word. It is clear in the last byte of a varint (section 1.6)."""

INTEGER_BYTES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
"""Serial type of an integer -> its size in bytes. Types 8 and 9 are the constants 0 and 1 (section
2.1)."""

FIRST_BLOB = 12
"""Serial types from 12 on are blobs (even) and texts (odd) of (type - 12) / 2 bytes (section
2.1)."""

KIND_BYTES = 4
"""Number of bytes of a row header before the serial type of the blob. They are the header size and
the serial types of id, topic and time."""

READ_BYTES = 1 << 20
"""Leaves are read in parts of about this many bytes, which fit into the processor cache."""

CELL_HEAD = 4 * WORD
"""Largest number of bytes of a cell before the message: size, id, row header, topic, time."""

PADDING = CELL_HEAD
"""Number of bytes after the pages, so that `CELL_HEAD` bytes can be read from the last cell."""

Bytes = NDArray[np.uint8]


class Unusual(Exception):
    """The pages contain something other than usual rows of messages."""


@dataclass(frozen=True)
class MessageRows:
    """Consecutive rows of messages in the order of their ids; valid until the next are read."""

    first_id: int
    last_id: int
    topics: NDArray[np.int64]
    record_ns: NDArray[np.int64]
    _data: Bytes
    _start: NDArray[np.int64]
    _length: NDArray[np.int64]
    _page_end: NDArray[np.int64]  # 0 if a row continues in other pages

    def block(self, ids: set[int]) -> Messages:
        """Return the messages of the topics with these ids in the order of their record time.

        Raises Unusual when one of them continues in other pages.
        """
        mine = np.flatnonzero(among(self.topics, ids))
        times = self.record_ns[mine]
        if (times[1:] < times[:-1]).any():
            mine = mine[np.argsort(times, kind='stable')]
            times = self.record_ns[mine]
        start, end = self._start[mine], self._start[mine] + self._length[mine]
        if (end > self._page_end[mine]).any():
            raise Unusual('a message is larger than a page')
        return Messages(times, self._payloads(start, end))

    def _payloads(self, start: NDArray[np.int64], end: NDArray[np.int64]) -> Payloads:
        length = end - start
        if len(length) and length[0] and (length == length[0]).all():
            return gathered(self._data, start, np.dtype((np.void, int(length[0]))))
        view = memoryview(self._data.tobytes())
        return [view[a:b] for a, b in zip(start.tolist(), end.tolist())]


class MessagePages:
    """The table of messages in a database file to which no other program writes.

    ``root`` is the number of the root page of the table. Raises Unusual when the file is not an
    SQLite database.
    """

    def __init__(self, file: BinaryIO, root: int) -> None:
        self._file = file
        self._root = root
        self._buffer = np.empty(0, np.uint8)
        file.seek(0)
        head = file.read(FILE_HEAD)
        size = int.from_bytes(head[PAGE_SIZE], 'big')
        self._page_bytes = 65536 if size == 1 else size
        if self._page_bytes < 512:
            raise Unusual(f'pages of {self._page_bytes} bytes')
        self._usable = self._page_bytes - head[RESERVED]
        self._pages_left = os.fstat(file.fileno()).st_size // self._page_bytes

    def rows(self) -> Iterator[MessageRows]:
        """Yield the rows in the order of their ids.

        Raises Unusual when the next rows are not usual rows of messages.
        """
        at_a_time = max(1, READ_BYTES // self._page_bytes)
        pending = np.empty(0, np.int64)
        for leaves in self._leaves(self._root, MAX_DEPTH):
            pending = np.append(pending, leaves)
            while len(pending) >= at_a_time:
                yield self._rows_of(pending[:at_a_time])
                pending = pending[at_a_time:]
        if len(pending):
            yield self._rows_of(pending)

    def _leaves(self, number: int, depth: int) -> Iterator[NDArray[np.int64]]:
        """Yield the page numbers of all leaves below page ``number``, one array per parent page.

        The tree below this page has at most ``depth`` levels.
        """
        page = self._read(number)
        self._pages_left -= 1
        if page[0] == LEAF and depth == MAX_DEPTH:
            yield np.array([number])
            return
        if page[0] != INTERIOR or not depth or self._pages_left < 0:
            raise Unusual('not a table')
        head = gathered(page, np.zeros(1, np.int64), INTERIOR_HEAD)[0]
        places = np.frombuffer(page, '>u2', head['cells'], INTERIOR_HEAD.itemsize)
        left = gathered(page, places.astype(np.int64), np.dtype('>u4'))
        children = np.append(left, head['last']).astype(np.int64)
        if self._read(int(children[0]))[0] != LEAF:
            for child in children.tolist():
                yield from self._leaves(child, depth - 1)
            return
        self._pages_left -= len(children)
        if self._pages_left < 0:
            raise Unusual('a page is in the table twice')
        yield children

    def _read(self, first: int, count: int = 1) -> Bytes:
        """Return ``count`` pages from number ``first`` on, and `PADDING` more bytes.

        The next call overwrites them.
        """
        size = count * self._page_bytes
        if len(self._buffer) < size + PADDING:
            self._buffer = np.zeros(size + PADDING, np.uint8)
        if first < 1:
            raise Unusual('no such page')
        self._file.seek((first - 1) * self._page_bytes)
        if cast(Any, self._file).readinto(self._buffer[:size].data) < size:
            raise Unusual('a page is beyond the end of the file')
        return self._buffer[: size + PADDING]

    def _rows_of(self, leaves: NDArray[np.int64]) -> MessageRows:
        """Return the rows of the leaves with these page numbers."""
        try:
            return self._parsed(*self._pages(leaves))
        except IndexError as error:
            raise Unusual('a cell lies outside its page') from error

    def _parsed(self, data: Bytes, pages: NDArray[np.int64]) -> MessageRows:
        """Return the rows of the leaves that begin at the offsets ``pages``."""
        start, page_end, counts = self._cells(data, pages)
        # a copy without gaps, because it is read several times
        heads = gathered(data, start, np.dtype((np.void, CELL_HEAD))).view(np.uint8)
        cell = np.arange(len(start)) * CELL_HEAD
        header = cell + _varints_bytes(heads, cell)
        head = gathered(heads, header, np.dtype('<u8'))
        kind = head & (2 ** (8 * KIND_BYTES) - 1)
        columns = np.empty((4, len(start)), np.int64)
        if (kind == kind[0]).all():
            columns[:] = _columns(heads, header, head, int(kind[0]))
        else:
            for value in np.unique(kind).tolist():
                chosen = kind == value
                columns[:, chosen] = _columns(heads, header[chosen], head[chosen], value)
        topics, record_ns, blob, length = columns
        blob += start - cell
        row_bytes = blob + length - (header + start - cell)
        page_end[row_bytes > self._usable - OVERFLOW_MARGIN] = 0
        first_id, last_id = _id_range(heads.reshape(-1, CELL_HEAD), counts)
        return MessageRows(first_id, last_id, topics, record_ns, data, blob, length, page_end)

    def _pages(self, leaves: NDArray[np.int64]) -> tuple[Bytes, NDArray[np.int64]]:
        """Return the content of pages, and the offset of each page in it."""
        first, last = int(leaves.min()), int(leaves.max())
        size = self._page_bytes
        if last - first < 2 * len(leaves):  # few other pages are between them
            return self._read(first, last - first + 1), (leaves - first) * size
        parts = [self._read(number).copy() for number in leaves.tolist()]
        return np.concatenate(parts), np.arange(len(leaves)) * len(parts[0])

    def _cells(
        self, data: Bytes, pages: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return the offset of each cell, the end offset of its page, and the cells per page.

        The first two are (rows,), the last one is (pages,).
        """
        head = gathered(data, pages, LEAF_HEAD)
        counts = head['cells'].astype(np.int64)
        if (head['kind'] != LEAF).any() or not counts.all():
            raise Unusual('not a leaf')
        most = int(counts.max())
        places = gathered(data, pages + LEAF_HEAD.itemsize, np.dtype((np.void, 2 * most)))
        offsets = places.view('>u2').reshape(-1, most)
        start = (pages[:, None] + offsets)[np.arange(most) < counts[:, None]]
        return start, np.repeat(pages + self._usable, counts), counts


def _varints_bytes(data: Bytes, start: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the size in bytes of the first two varints of each cell (file format, section 1.6)."""
    last = ~gathered(data, start, np.dtype('<u8')) & LAST_BYTES
    second = last & (last - 1)  # without the lowest bit, which is in the first varint
    if not second.all():
        raise Unusual('an id of many bytes')
    # the position of the lowest bit is the exponent of its value as a floating-point number
    bit = (second & -second).astype(np.float64).view(np.int64) >> 52
    places: NDArray[np.int64] = (bit - (1023 - 1)) >> 3
    return places


def _columns(
    data: Bytes, header: NDArray[np.int64], head: NDArray[np.uint64], kind: int
) -> tuple[Any, ...]:
    """Return topics, record times, blob offsets and blob lengths of rows with equal columns.

    ``header`` are the offsets of the row headers, and ``head`` their first eight bytes. The first
    `KIND_BYTES` of these are ``kind``, the size and column types (file format, section 2.1).
    """
    size, id_type, topic_type, time_type = kind.to_bytes(KIND_BYTES, 'little')
    usual = id_type == 0 and {topic_type, time_type} <= set(INTEGER_BYTES)
    if not usual or not KIND_BYTES < size <= 2 * KIND_BYTES:
        raise Unusual('columns of other types')
    blob_type = np.zeros(len(head), np.int64)
    for byte in range(KIND_BYTES, size):
        blob_type = blob_type << 7 | (head >> np.uint64(8 * byte) & np.uint64(0x7F)).astype(
            np.int64
        )
    if (blob_type < FIRST_BLOB).any() or (blob_type & 1).any():
        raise Unusual('a message is not a blob')
    topic = header + size
    time = topic + INTEGER_BYTES[topic_type]
    return (
        _integers(data, topic, topic_type),
        _integers(data, time, time_type),
        time + INTEGER_BYTES[time_type],
        (blob_type - FIRST_BLOB) >> 1,
    )


def _integers(data: Bytes, at: NDArray[np.int64], serial: int) -> NDArray[np.int64]:
    """Return the integers of one serial type at the offsets ``at`` (file format, section 2.1)."""
    size = INTEGER_BYTES[serial]
    if not size:
        return np.full(len(at), serial == 9, np.int64)
    values: NDArray[np.int64] = gathered(data, at, np.dtype('>i8')).astype(np.int64)
    values >>= 64 - 8 * size
    return values


def _id_range(heads: Bytes, counts: NDArray[np.int64]) -> tuple[int, int]:
    """Return the first and the last id of the rows of several pages.

    ``heads`` are the first bytes of all cells, and ``counts`` the numbers of cells per page. Raises
    Unusual when the ids do not increase from page to page, as in a damaged file.
    """
    last = np.cumsum(counts) - 1
    ends = np.concatenate([last - counts + 1, last])
    first_ids, last_ids = _ids_of(heads[ends]).reshape(2, -1)
    if (last_ids - first_ids < counts - 1).any() or (first_ids[1:] <= last_ids[:-1]).any():
        raise Unusual('ids that do not increase')
    return int(first_ids[0]), int(last_ids[-1])


def _ids_of(heads: Bytes) -> NDArray[np.int64]:
    """Return the row ids from the first bytes of the cells (file format, section 1.6)."""
    ids = np.zeros(len(heads), np.int64)
    varint = np.zeros(len(heads), np.int64)
    for byte in heads[:, : 2 * WORD].T:
        ids = np.where(varint == 1, ids << 7 | byte & 0x7F, ids)
        varint += byte < 0x80
        if varint.min() > 1:
            break
    return ids
