# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads a bag file of rosbag2 in SQLite format (.db3), in all versions of its schema."""

from __future__ import annotations

import os
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO
from urllib.parse import quote

import numpy as np

from ..files import open_regular
from .sqlite3_pages import MessagePages, MessageRows, Unusual
from .storage import Messages, Topic, Truncation, damaged, normal_type, translated

ROWS = 2048
"""Number of rows that are fetched from SQLite at a time."""

_COLUMNS = ('id', 'topic_id', 'timestamp', 'data')
"""Columns of the table ``messages`` in all versions of the schema."""

_TIME_INDEX = """
SELECT list.name FROM pragma_index_list('messages') AS list, pragma_index_info(list.name) AS part
WHERE NOT list.partial AND part.seqno = 0 AND part.name = 'timestamp'
"""
"""Query for the names of the indexes on the record times."""

_LIBRARY_ERRORS = (sqlite3.Error, OSError, OverflowError, ValueError, TypeError, AttributeError)
"""Exceptions when a database is damaged: of SQLite, or because a value has another type."""

REMEDY = 'copy it again, or repair it with "sqlite3 FILE .recover"'

HEAD = struct.Struct('>16xH6xII60xI')
"""Fields at the start of a database (file format, section 1.3): page size (1 means 65536), change
counter, number of pages, and value of the change counter for which this number is valid."""


class Sqlite3Storage:
    """An open .db3 file; error messages name it ``path``.

    ``pages`` is the open file, from which rows are read directly; None if a write-ahead log
    contains some of the rows.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection, pages: BinaryIO | None) -> None:
        self._path = path
        self._connection = connection
        self._pages = pages
        # number of rows that were read directly; None if SQLite read some of them
        self._rows_read: int | None = 0
        self.truncation = _truncation(pages) if pages else None
        self.topics = self._read_topics()

    def _read_topics(self) -> list[Topic]:
        # otherwise a view instead of a table could run an endless computation
        self._query('PRAGMA trusted_schema = OFF')
        tables = {n for (n,) in self._query("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if missing := {'topics', 'messages'} - tables:
            raise damaged(
                self._path,
                f'a database without the table {" and ".join(sorted(missing))}',
                'it is not a rosbag2 file; give the .db3 that ros2 bag recorded',
            )
        schemas: dict[str, tuple[str, str]] = {}
        if 'message_definitions' in tables:
            rows = self._query(
                'SELECT topic_type, encoding, encoded_message_definition FROM message_definitions'
            )
            schemas = {name: (form, text) for name, form, text in rows}
        rows = self._query('SELECT id, name, type, serialization_format FROM topics ORDER BY id')
        return [
            Topic(number, name, normal_type(kind), encoding, *schemas.get(kind, ('', '')))
            for number, name, kind, encoding in rows
        ]

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages; this reads the complete table."""
        with translated(self._path, _LIBRARY_ERRORS, REMEDY):
            return dict(self._query('SELECT topic_id, count(*) FROM messages GROUP BY topic_id'))

    def stated(self, ids: set[int], read: int) -> int:
        """Return ``read``, the number of messages that were read, plus the number of missing rows.

        These rows are listed in the time index but cannot be read. They may be of any topic.
        """
        with translated(self._path, _LIBRARY_ERRORS, REMEDY):
            index = next(self._query(_TIME_INDEX), None)
            if index is None:
                return read
            (listed,) = next(self._query('SELECT count(*) FROM messages'))
            rows = self._rows_read
            if rows is None:
                name = index[0].replace('"', '""')
                # reads each row that the index lists; count(*) would read only the index
                sql = f'SELECT count(topic_id) FROM messages INDEXED BY "{name}"'
                (rows,) = next(self._query(f'{sql} WHERE timestamp >= ?', -(2**63)))
        return read + max(0, int(listed) - int(rows or 0))

    def blocks(self, ids: set[int]) -> Iterator[Messages]:
        """Yield the messages of the topics with these ids in the order of their record time."""
        with translated(self._path, _LIBRARY_ERRORS, REMEDY):
            yield from self._blocks(ids)

    def _blocks(self, ids: set[int]) -> Iterator[Messages]:
        # two queries, because SQLite reads the complete table for a query of both
        (first,), (last,) = (
            next(self._query(f'SELECT {which}(id) FROM messages')) for which in ('min', 'max')
        )
        if first is None:
            return
        done, self._rows_read = first - 1, 0
        if self._pages is not None and self._is_usual():
            done = yield from self._direct_blocks(ids, done, self._pages)
        if done < last:
            self._rows_read = None
            # because of the plus sign, SQLite uses the time index and does not sort the table
            yield from self._rows(ids, '+id > ? ORDER BY timestamp, id', done)

    def _is_usual(self) -> bool:
        """Return whether the table has row ids and a time index, as recorders create it."""
        columns = list(
            self._query("SELECT name, upper(type), pk FROM pragma_table_xinfo('messages')")
        )
        of_ids = columns and columns[0][1:] == ('INTEGER', 1)
        names = tuple(name for name, _, _ in columns)
        return bool(of_ids and names == _COLUMNS and list(self._query(_TIME_INDEX)))

    def _direct_blocks(
        self, ids: set[int], done: int, file: BinaryIO
    ) -> Generator[Messages, None, int]:
        """Yield messages read directly from the pages, as long as their times increase.

        ``done`` is the id before the first row. The generator returns the last id that was read.
        """
        (root,) = next(self._query("SELECT rootpage FROM sqlite_master WHERE name = 'messages'"))
        end_ns, known_ns = -(2**63), np.empty(0, np.int64)
        with suppress(Unusual):
            for rows in MessagePages(file, root).rows():
                if rows.first_id <= done:
                    return done  # a damaged tree contains a page twice
                self._rows_read = (self._rows_read or 0) + len(rows.topics)
                blocks = self._blocks_of(rows, ids, done)
                times = [block.record_ns for block in blocks if len(block.record_ns)]
                known_ns = np.append(known_ns, rows.record_ns) if times else known_ns[:0]
                if times:
                    start_ns, end_ns = end_ns, int(times[-1][-1])
                    known_ns = known_ns[known_ns >= start_ns]
                    known = int(np.count_nonzero(known_ns <= end_ns))
                    if self._has_earlier(ids, start_ns, end_ns, known, rows.last_id):
                        return done
                    yield from blocks
                done = rows.last_id
        return done

    def _blocks_of(self, rows: MessageRows, ids: set[int], done: int) -> list[Messages]:
        """Return the messages of rows after the id ``done``; unusual ones are read by SQLite."""
        try:
            return [rows.block(ids)]
        except Unusual:
            which = 'id > ? AND id <= ? ORDER BY +timestamp, id'
            return list(self._rows(ids, which, done, rows.last_id))

    def _has_earlier(
        self, ids: set[int], start_ns: int, end_ns: int, known: int, last_id: int
    ) -> bool:
        """Return whether a message after the row ``last_id`` was recorded before ``end_ns``.

        None of them was recorded before ``start_ns``. ``known`` is the number of rows up to
        ``last_id`` with times from ``start_ns`` to ``end_ns``.
        """
        # If the index has no more than the known entries up to the end, no further check is needed.
        # SQLite skips entries of the index in a fifth of the time that it needs to read them.
        sql = 'SELECT timestamp FROM messages WHERE timestamp >= ? ORDER BY timestamp LIMIT 1'
        following = next(self._query(f'{sql} OFFSET ?', start_ns, known), None)
        if following is None or following[0] > end_ns:
            return False
        earlier = (
            'SELECT 1 FROM messages WHERE timestamp >= ? AND timestamp < ? AND +id > ? '
            f'AND {_topics(ids)} LIMIT 1'
        )
        return next(self._query(earlier, start_ns, end_ns, last_id), None) is not None

    def _rows(self, ids: set[int], which: str, *values: int) -> Iterator[Messages]:
        """Yield messages from SQLite; ``which`` is an SQL condition, ``values`` its parameters."""
        sql = f'SELECT timestamp, data FROM messages WHERE {_topics(ids)} AND {which}'
        rows = self._query(sql, *values)
        while batch := rows.fetchmany(ROWS):
            times, payloads = zip(*batch)
            if set(map(type, payloads)) != {bytes}:
                raise ValueError('a message is not a BLOB')
            yield Messages(np.array(times, dtype=np.int64), list(payloads))

    def _query(self, sql: str, *values: int) -> sqlite3.Cursor:
        return self._connection.execute(sql, values)


def _topics(ids: set[int]) -> str:
    return f'topic_id IN ({", ".join(str(int(number)) for number in sorted(ids))})'


def _truncation(file: BinaryIO) -> Truncation | None:
    """Return the existing and the original size of a truncated database; None if complete."""
    file.seek(0)
    head = file.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    page_size, changes, pages, counted_at = HEAD.unpack(head)
    size, stated = os.fstat(file.fileno()).st_size, pages * (65536 if page_size == 1 else page_size)
    return Truncation(size, stated) if changes == counted_at and size < stated else None


@contextmanager
def open_sqlite3(path: Path, shown: Path) -> Iterator[Sqlite3Storage]:
    """Open a .db3 file for reading; no file is created next to it.

    Error messages name it ``shown``, because ``path`` may be a decompressed copy. Raises AllanError
    when it is not a rosbag2 database, or is damaged.
    """
    # If the recorder was killed, a write-ahead log contains the last messages. Without a log, the
    # file is opened as immutable, which also works on read-only media.
    log, shared = (path.with_name(f'{path.name}-{suffix}') for suffix in ('wal', 'shm'))
    with translated(shown, _LIBRARY_ERRORS, REMEDY):
        file = open_regular(path)
    with file:
        if not (log.is_file() and log.stat().st_size):
            with _opened(path, shown, 'immutable=1', file) as storage:
                yield storage
        elif shared.is_file():
            with _opened(path, shown, 'mode=ro', None) as storage:
                yield storage
        else:  # SQLite would create the -shm file and not remove it
            with tempfile.TemporaryDirectory(prefix='allan_ros.') as folder:
                with translated(shown, (OSError,), 'check the space for temporary files'):
                    size = path.stat().st_size + log.stat().st_size
                    if size > shutil.disk_usage(folder).free:
                        raise OSError(f'its log requires a temporary copy of {size} bytes')
                    copy = Path(folder, 'bag.db3')
                    shutil.copyfile(path, copy)
                    shutil.copyfile(log, copy.with_name('bag.db3-wal'))
                with _opened(copy, shown, 'mode=ro', None) as storage:
                    yield storage


@contextmanager
def _opened(path: Path, shown: Path, mode: str, pages: BinaryIO | None) -> Iterator[Sqlite3Storage]:
    with translated(shown, _LIBRARY_ERRORS, REMEDY):
        connection = sqlite3.connect(f'file:{quote(str(path.absolute()))}?{mode}', uri=True)
    with closing(connection):
        with translated(shown, _LIBRARY_ERRORS, REMEDY):
            storage = Sqlite3Storage(shown, connection, pages)
        yield storage
