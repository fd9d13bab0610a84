# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of a rosbag2 database straight from its pages, thousands at a time.

SQLite hands out one row after the other, which costs three times the decoding. Its file format is
documented and fixed (https://www.sqlite.org/fileformat2.html; the sections are named below): a
table is a tree of pages whose leaves hold the rows in the order of their ids. What is not a plain
row of such a table is `Unusual`, and SQLite is asked instead.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from io import FileIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .storage import Block, Payloads, among, gathered

LEAF, INTERIOR = 13, 5
"""Kinds of page of a table (section 1.6)."""

PAGE_SIZE = slice(16, 18)
"""Where the first page says how large pages are; 1 stands for 65536 (section 1.3.2)."""

RESERVED = 20
"""Where it says how many bytes at the end of each page are not SQLite's (section 1.3.4)."""

FILE_HEAD = 100
"""Bytes of the head of the file (section 1.3)."""

LEAF_HEAD = np.dtype([('kind', 'u1'), ('free', '>u2'), ('cells', '>u2'), ('content', 'V3')])
"""In front of the places of a leaf's cells, of two bytes each (section 1.6)."""

INTERIOR_HEAD = np.dtype([*LEAF_HEAD.descr, ('last', '>u4')])
"""In front of those of an interior page: also the number of its last child (section 1.6)."""

LEAST_OVER = 35
"""Rows that fit a page less so many bytes are whole in it, others go on elsewhere (section 1.6)."""

MOST_DEPTH = 20
"""Pages from the root of a tree to its leaves: SQLite itself allows no more."""

WORD = 8
"""Bytes of a cell that are looked at for its first two varints: the size of the row, and its id."""

LAST_BYTES = np.uint64(0x8080808080808080)
"""The bits of a word that are not set in the last byte of a varint (section 1.6)."""

INTEGER_BYTES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
"""Serial type of an integer -> its size; 8 and 9 are 0 and 1 without a byte (section 2.1)."""

FIRST_BLOB = 12
"""Serial types from here on are blobs (even) and texts (odd) of half so many bytes more."""

KIND_BYTES = 4
"""The head of a row up to the serial type of the blob: its own size, id, topic, time."""

READ_BYTES = 1 << 20
"""Leaves are read about so many bytes at a time: they stay in the cache."""

CELL_HEAD = 4 * WORD
"""Bytes of a cell that hold all but the message: size and id, head of the row, topic, time."""

PADDING = CELL_HEAD
"""Bytes behind what is read, so that so many may be taken from the last cell too."""


Bytes = NDArray[np.uint8]


class Unusual(Exception):
    """The pages hold something else than plain rows of messages."""


@dataclass(frozen=True)
class Rows:
    """Rows that follow on each other by their ids; good until the next are asked for.

    Attributes
    ----------
    last_id : int
    topics, record_ns : (n,) int64 arrays
    """

    last_id: int
    topics: NDArray[np.int64]
    record_ns: NDArray[np.int64]
    _data: Bytes
    _start: NDArray[np.int64]
    _length: NDArray[np.int64]
    _page_end: NDArray[np.int64]  # 0 where a row goes on in other pages

    def block(self, ids: set[int]) -> Block:
        """Return the messages of these topics in the order of their record time.

        Raises
        ------
        Unusual
            When one of them goes on in other pages.
        """
        mine = among(self.topics, ids)
        columns = (self.record_ns, self._start, self._length, self._page_end)
        times, start, length, page_end = (
            columns if mine.all() else (column[mine] for column in columns)
        )
        if (times[1:] < times[:-1]).any():
            order = np.argsort(times, kind='stable')
            times, start, length, page_end = (c[order] for c in (times, start, length, page_end))
        end = start + length
        if (end > page_end).any():
            raise Unusual('a message is larger than a page')
        return Block(times, self._payloads(start, end))

    def _payloads(self, start: NDArray[np.int64], end: NDArray[np.int64]) -> Payloads:
        length = end - start
        if len(length) and length[0] and (length == length[0]).all():
            return gathered(self._data, start, np.dtype((np.void, int(length[0]))))
        view = memoryview(self._data.tobytes())
        return [view[a:b] for a, b in zip(start.tolist(), end.tolist())]


class MessagePages:
    """The pages of the table ``messages``.

    Parameters
    ----------
    file : binary file
        Of the database, which nobody writes.
    root : int
        Number of the table's first page.

    Raises
    ------
    Unusual
        When the file is none of SQLite.
    """

    def __init__(self, file: FileIO, root: int) -> None:
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

    def rows(self) -> Iterator[Rows]:
        """Yield the rows in the order of their ids.

        Raises
        ------
        Unusual
            When what comes next is no plain row.
        """
        at_a_time = max(1, READ_BYTES // self._page_bytes)
        waiting = np.empty(0, np.int64)
        for leaves in self._leaves(self._root, MOST_DEPTH):
            waiting = np.append(waiting, leaves)
            while len(waiting) >= at_a_time:
                yield self._rows_of(waiting[:at_a_time])
                waiting = waiting[at_a_time:]
        if len(waiting):
            yield self._rows_of(waiting)

    def _leaves(self, number: int, depth: int) -> Iterator[NDArray[np.int64]]:
        """Yield the numbers of the leaves below a page in order, those of one parent together."""
        page = self._read(number)
        self._pages_left -= 1
        if page[0] == LEAF and depth == MOST_DEPTH:
            yield np.array([number])
            return
        if page[0] != INTERIOR or not depth or self._pages_left < 0:
            raise Unusual('no table')
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
            raise Unusual('pages that are in a table twice')
        yield children

    def _read(self, first: int, count: int = 1) -> Bytes:
        """Return so many pages from that number on, and `PADDING`; until the next are read."""
        size = count * self._page_bytes
        if len(self._buffer) < size + PADDING:
            self._buffer = np.zeros(size + PADDING, np.uint8)
        if first < 1:
            raise Unusual('no such page')
        self._file.seek((first - 1) * self._page_bytes)
        if self._file.readinto(self._buffer[:size].data) < size:
            raise Unusual('a page behind the end of the file')
        return self._buffer[: size + PADDING]

    def _rows_of(self, leaves: NDArray[np.int64]) -> Rows:
        """Return the rows of some leaves."""
        try:
            return self._parsed(*self._pages(leaves))
        except IndexError as error:
            raise Unusual('a cell lies outside its page') from error

    def _parsed(self, data: Bytes, pages: NDArray[np.int64]) -> Rows:
        """Return the rows of the leaves that begin at these bytes."""
        start, page_end = self._cells(data, pages)
        # what is looked at several times is brought together, to stay near at hand
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
        page_end[row_bytes > self._usable - LEAST_OVER] = 0
        return Rows(_id_of(heads[cell[-1] :]), topics, record_ns, data, blob, length, page_end)

    def _pages(self, leaves: NDArray[np.int64]) -> tuple[Bytes, NDArray[np.int64]]:
        """Return the bytes of leaves, and where in them each begins."""
        first, last = int(leaves.min()), int(leaves.max())
        size = self._page_bytes
        if last - first < 2 * len(leaves):  # few others lie between them
            return self._read(first, last - first + 1), (leaves - first) * size
        parts = [self._read(number).copy() for number in leaves.tolist()]
        return np.concatenate(parts), np.arange(len(leaves)) * len(parts[0])

    def _cells(
        self, data: Bytes, pages: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return where each cell begins, and where its page ends for SQLite."""
        head = gathered(data, pages, LEAF_HEAD)
        counts = head['cells'].astype(np.int64)
        if (head['kind'] != LEAF).any() or not counts.all():
            raise Unusual('no leaf')
        most = int(counts.max())
        places = gathered(data, pages + LEAF_HEAD.itemsize, np.dtype((np.void, 2 * most)))
        offsets = places.view('>u2').reshape(-1, most)
        start = (pages[:, None] + offsets)[np.arange(most) < counts[:, None]]
        return start, np.repeat(pages + self._usable, counts)


def _varints_bytes(data: Bytes, start: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how many bytes the first two varints of each cell take (section 1.6).

    The last byte of a varint is the one whose first bit is not set.
    """
    last = ~gathered(data, start, np.dtype('<u8')) & LAST_BYTES
    second = last & (last - 1)  # without the lowest bit, which ends the first varint
    if not second.all():
        raise Unusual('an id of many bytes')
    # of a power of two, the exponent of the floating-point number is the place of its bit
    bit = (second & -second).astype(np.float64).view(np.int64) >> 52
    places: NDArray[np.int64] = (bit - (1023 - 1)) >> 3
    return places


def _columns(
    data: Bytes, header: NDArray[np.int64], head: NDArray[np.uint64], kind: int
) -> tuple[Any, ...]:
    """Return topics, record times, and start and length of the blobs of rows of one kind.

    Parameters
    ----------
    header : (n,) array
        Where each row begins.
    head : (n,) array
        Its first eight bytes.
    kind : int
        The first `KIND_BYTES` of them, alike in all: what decides the layout (section 2.1).
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
        raise Unusual('a message that is no blob')
    topic = header + size
    time = topic + INTEGER_BYTES[topic_type]
    return (
        _integers(data, topic, topic_type),
        _integers(data, time, time_type),
        time + INTEGER_BYTES[time_type],
        (blob_type - FIRST_BLOB) >> 1,
    )


def _integers(data: Bytes, at: NDArray[np.int64], serial: int) -> NDArray[np.int64]:
    """Return the integers of a serial type that begin at these bytes (section 2.1)."""
    size = INTEGER_BYTES[serial]
    if not size:
        return np.full(len(at), serial == 9, np.int64)
    values: NDArray[np.int64] = gathered(data, at, np.dtype('>i8')).astype(np.int64)
    values >>= 64 - 8 * size
    return values


def _id_of(cell: Bytes) -> int:
    """Return the id of the row in a cell: its second varint (section 1.6)."""
    value, varints = 0, 0
    for byte in cell[: 2 * WORD].tolist():
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            varints += 1
            if varints == 2:
                break
            value = 0
    return value
