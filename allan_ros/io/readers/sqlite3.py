# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A rosbag2 storage file in SQLite (.db3), all schema versions."""

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
from .sqlite3_pages import MessagePages, Rows, Unusual
from .storage import Block, Cut, Topic, damaged, normal_type, translated

ROWS = 2048
"""Rows fetched at a time when SQLite returns them one by one."""

_COLUMNS = ('id', 'topic_id', 'timestamp', 'data')
"""Columns of the table ``messages`` in all versions of the schema."""

_TIME_INDEX = """
SELECT list.name FROM pragma_index_list('messages') AS list, pragma_index_info(list.name) AS part
WHERE NOT list.partial AND part.seqno = 0 AND part.name = 'timestamp'
"""
"""Query for the names of the indexes of the record times."""

_LIBRARY_ERRORS = (sqlite3.Error, OSError, OverflowError, ValueError, TypeError, AttributeError)
"""Exceptions while reading a damaged database: errors of SQLite, and cells of another type."""

REMEDY = 'copy it again, or repair it with "sqlite3 FILE .recover"'

HEAD = struct.Struct('>16xH6xII60xI')
"""Start of a database (file format, section 1.3): page size (1 stands for 65536), change counter,
number of pages, and the change counter when they were counted."""


class Sqlite3Storage:
    """An open .db3 file; ``path`` is its name for messages.

    ``pages`` reads the file directly; it is None if a log contains a part of the content.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection, pages: BinaryIO | None) -> None:
        self._path = path
        self._connection = connection
        self._pages = pages
        # number of rows read from the pages; None if SQLite read them
        self._rows_seen: int | None = 0
        self.cut = _truncation(pages) if pages else None
        self.topics = self._read_topics()

    def _read_topics(self) -> list[Topic]:
        # A view instead of a table could run an endless computation.
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
        """Return topic id -> number of messages (reads the complete table)."""
        with translated(self._path, _LIBRARY_ERRORS, REMEDY):
            return dict(self._query('SELECT topic_id, count(*) FROM messages GROUP BY topic_id'))

    def stated(self, ids: set[int], read: int) -> int:
        """Return ``read`` plus the number of messages of any topic that are only in the index of
        times.

        SQLite counts the index in a few milliseconds per million messages.
        """
        with translated(self._path, _LIBRARY_ERRORS, REMEDY):
            index = next(self._query(_TIME_INDEX), None)
            if index is None:
                return read
            (listed,) = next(self._query('SELECT count(*) FROM messages'))
            seen = self._rows_seen
            if seen is None:
                name = index[0].replace('"', '""')
                # counts the rows found by the index; count(*) would count only the index
                sql = f'SELECT count(topic_id) FROM messages INDEXED BY "{name}"'
                (seen,) = next(self._query(f'{sql} WHERE timestamp >= ?', -(2**63)))
        return read + max(0, int(listed) - int(seen or 0))

    def blocks(self, ids: set[int]) -> Iterator[Block]:
        """Yield the messages of these topics in the order of their record time."""
        with translated(self._path, _LIBRARY_ERRORS, REMEDY):
            yield from self._blocks(ids)

    def _blocks(self, ids: set[int]) -> Iterator[Block]:
        # two queries: for a single query with both, SQLite reads the complete table
        (first,), (last,) = (
            next(self._query(f'SELECT {which}(id) FROM messages')) for which in ('min', 'max')
        )
        if first is None:
            return
        done, self._rows_seen = first - 1, 0
        if self._pages is not None and self._is_usual():
            done = yield from self._batches(ids, done, self._pages)
        if done < last:
            self._rows_seen = None
            # the plus sign prevents SQLite from sorting the complete table instead of using the
            # time index
            yield from self._rows(ids, '+id > ? ORDER BY timestamp, id', done)

    def _is_usual(self) -> bool:
        """Return whether the table is as recorders create it: ids are row ids, and times are
        indexed."""
        columns = list(
            self._query("SELECT name, upper(type), pk FROM pragma_table_xinfo('messages')")
        )
        of_ids = columns and columns[0][1:] == ('INTEGER', 1)
        names = tuple(name for name, _, _ in columns)
        return bool(of_ids and names == _COLUMNS and list(self._query(_TIME_INDEX)))

    def _batches(self, ids: set[int], done: int, file: BinaryIO) -> Generator[Block, None, int]:
        """Yield messages by ranges of ids as long as these are in the order of time.

        Returns the id up to which all messages have been yielded.
        """
        (root,) = next(self._query("SELECT rootpage FROM sqlite_master WHERE name = 'messages'"))
        end_ns, seen_ns = -(2**63), np.empty(0, np.int64)
        with suppress(Unusual):
            for rows in MessagePages(file, root).rows():
                if rows.first_id <= done:
                    return done  # in a damaged tree, the same pages occur twice
                self._rows_seen = (self._rows_seen or 0) + len(rows.topics)
                blocks = self._blocks_of(rows, ids, done)
                times = [block.record_ns for block in blocks if len(block.record_ns)]
                seen_ns = np.append(seen_ns, rows.record_ns) if times else seen_ns[:0]
                if times:
                    start_ns, end_ns = end_ns, int(times[-1][-1])
                    seen_ns = seen_ns[seen_ns >= start_ns]
                    known = int(np.count_nonzero(seen_ns <= end_ns))
                    if self._is_overtaken(ids, start_ns, end_ns, known, rows.last_id):
                        return done  # a later row has an earlier record time
                    yield from blocks
                done = rows.last_id
        return done

    def _blocks_of(self, rows: Rows, ids: set[int], done: int) -> list[Block]:
        """Return the messages in rows after the id ``done``."""
        try:
            return [rows.block(ids)]
        except Unusual:
            which = 'id > ? AND id <= ? ORDER BY +timestamp, id'
            return list(self._rows(ids, which, done, rows.last_id))

    def _is_overtaken(
        self, ids: set[int], start_ns: int, end_ns: int, known: int, last_id: int
    ) -> bool:
        """Return whether a message after ``last_id`` was recorded before ``end_ns``.

        No message was recorded before ``start_ns``, and ``known`` rows are between the two times.
        """
        # SQLite skips entries of the index in a fifth of the time it takes to read them. If there
        # are not more entries up to the end than the known ones, no further check is needed.
        behind = 'SELECT timestamp FROM messages WHERE timestamp >= ? ORDER BY timestamp LIMIT 1'
        following = next(self._query(f'{behind} OFFSET ?', start_ns, known), None)
        if following is None or following[0] > end_ns:
            return False
        earlier = (
            'SELECT 1 FROM messages WHERE timestamp >= ? AND timestamp < ? AND +id > ? '
            f'AND {_topics(ids)} LIMIT 1'
        )
        return next(self._query(earlier, start_ns, end_ns, last_id), None) is not None

    def _rows(self, ids: set[int], which: str, *values: int) -> Iterator[Block]:
        """Yield messages row by row."""
        sql = f'SELECT timestamp, data FROM messages WHERE {_topics(ids)} AND {which}'
        rows = self._query(sql, *values)
        while batch := rows.fetchmany(ROWS):
            times, payloads = zip(*batch)
            if set(map(type, payloads)) != {bytes}:
                raise ValueError('a message is not a BLOB')
            yield Block(np.array(times, dtype=np.int64), list(payloads))

    def _query(self, sql: str, *values: int) -> sqlite3.Cursor:
        return self._connection.execute(sql, values)


def _topics(ids: set[int]) -> str:
    return f'topic_id IN ({", ".join(str(int(number)) for number in sorted(ids))})'


def _truncation(file: BinaryIO) -> Cut | None:
    """Return the part of the database that exists, if it has fewer pages than its header states."""
    file.seek(0)
    head = file.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    page_size, changes, pages, counted_at = HEAD.unpack(head)
    size, stated = os.fstat(file.fileno()).st_size, pages * (65536 if page_size == 1 else page_size)
    return Cut(size, stated) if changes == counted_at and size < stated else None


@contextmanager
def open_sqlite3(path: Path, shown: Path) -> Iterator[Sqlite3Storage]:
    """Open a .db3 file for reading only, without creating a file next to it.

    ``shown`` is the name in messages, which differs for a decompressed copy. Raises AllanError when
    it is not a rosbag2 database or damaged.
    """
    # A write-ahead log contains the last messages of a recorder that was killed. Without a log, the
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
