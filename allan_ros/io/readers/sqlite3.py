# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A rosbag2 storage file in SQLite (.db3), all schema versions."""

from __future__ import annotations

import sqlite3
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager, suppress
from io import FileIO
from pathlib import Path
from urllib.parse import quote

import numpy as np

from .sqlite3_pages import MessagePages, Rows, Unusual
from .storage import Block, Cut, Topic, damaged, normal_type, translated

ROWS = 2048
"""Rows fetched at a time where they are taken one by one."""

_COLUMNS = ('id', 'topic_id', 'timestamp', 'data')
"""Of the table ``messages``, in all versions of the schema."""

_TIME_INDEX = """
SELECT 1 FROM pragma_index_list('messages') AS list, pragma_index_info(list.name) AS part
WHERE NOT list.partial AND part.seqno = 0 AND part.name = 'timestamp'
"""
"""Has a row where there is an index of the record times."""

_LIBRARY_ERRORS = (
    sqlite3.Error,
    OSError,
    OverflowError,
    ValueError,
    TypeError,
    AttributeError,
)
"""What reading raises on a damaged database: SQLite's own, and cells of another type."""

REMEDY = 'copy it again, or mend it with "sqlite3 FILE .recover"'


class Sqlite3Storage:
    """An open .db3 file.

    ``pages`` is the file itself, None where that alone does not tell all.
    """

    cut: Cut | None = None

    def __init__(self, path: Path, connection: sqlite3.Connection, pages: FileIO | None) -> None:
        self._path = path
        self._connection = connection
        self._pages = pages
        self.topics = self._read_topics()

    def _read_topics(self) -> list[Topic]:
        # A view in the place of a table may compute whatever its author liked, without an end.
        self._query('PRAGMA trusted_schema = OFF')
        tables = {n for (n,) in self._query("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if missing := {'topics', 'messages'} - tables:
            raise damaged(
                self._path,
                f'a database without the table {" and ".join(sorted(missing))}',
                'it is no rosbag2 file; give the .db3 that ros2 bag recorded',
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
        """Return topic id -> number of messages (reads the whole table)."""
        with translated(self._path, _LIBRARY_ERRORS, REMEDY):
            return dict(self._query('SELECT topic_id, count(*) FROM messages GROUP BY topic_id'))

    def blocks(self, ids: set[int]) -> Iterator[Block]:
        """Yield the messages of these topics in the order of their record time."""
        with translated(self._path, _LIBRARY_ERRORS, REMEDY):
            yield from self._blocks(ids)

    def _blocks(self, ids: set[int]) -> Iterator[Block]:
        # in one query of their own each: both in one, SQLite goes through the whole table
        (first,), (last,) = (
            next(self._query(f'SELECT {which}(id) FROM messages')) for which in ('min', 'max')
        )
        if first is None:
            return
        done = first - 1
        if self._pages is not None and self._is_usual():
            done = yield from self._batches(ids, done, self._pages)
        if done < last:
            # the plus keeps SQLite from sorting the whole file: it shall go by the time index
            yield from self._rows(ids, '+id > ? ORDER BY timestamp, id', done)

    def _is_usual(self) -> bool:
        """Return whether the table is as recorders make it: ids are row numbers, times indexed."""
        columns = list(
            self._query("SELECT name, upper(type), pk FROM pragma_table_xinfo('messages')")
        )
        of_ids = columns and columns[0][1:] == ('INTEGER', 1)
        names = tuple(name for name, _, _ in columns)
        return bool(of_ids and names == _COLUMNS and list(self._query(_TIME_INDEX)))

    def _batches(self, ids: set[int], done: int, file: FileIO) -> Generator[Block, None, int]:
        """Yield messages by ranges of ids while their order is that of time.

        Returns
        -------
        int
            The id up to which all messages have been yielded, in order.
        """
        (root,) = next(self._query("SELECT rootpage FROM sqlite_master WHERE name = 'messages'"))
        end_ns, seen_ns = -(2**63), np.empty(0, np.int64)
        with suppress(Unusual):
            for rows in MessagePages(file, root).rows():
                blocks = self._blocks_of(rows, ids, done)
                times = [block.record_ns for block in blocks if len(block.record_ns)]
                seen_ns = np.append(seen_ns, rows.record_ns) if times else seen_ns[:0]
                if times:
                    start_ns, end_ns = end_ns, int(times[-1][-1])
                    seen_ns = seen_ns[seen_ns >= start_ns]
                    known = int(np.count_nonzero(seen_ns <= end_ns))
                    if self._is_overtaken(ids, start_ns, end_ns, known, rows.last_id):
                        return done  # a later row was recorded earlier
                    yield from blocks
                done = rows.last_id
        return done

    def _blocks_of(self, rows: Rows, ids: set[int], done: int) -> list[Block]:
        """Return the messages among some rows, which begin behind the id ``done``."""
        try:
            return [rows.block(ids)]
        except Unusual:
            which = 'id > ? AND id <= ? ORDER BY +timestamp, id'
            return list(self._rows(ids, which, done, rows.last_id))

    def _is_overtaken(
        self, ids: set[int], start_ns: int, end_ns: int, known: int, last_id: int
    ) -> bool:
        """Return whether a message behind ``last_id`` was recorded before ``end_ns``.

        None was before ``start_ns``, and from there to ``end_ns`` so many rows are known.
        """
        # SQLite skips entries of the index in a fifth of the time it takes to look at them: when
        # no more of them than those known come up to the end, all is said.
        behind = (
            'SELECT timestamp FROM messages WHERE timestamp >= ? '
            'ORDER BY timestamp LIMIT 1 OFFSET ?'
        )
        following = next(self._query(behind, start_ns, known), None)
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
                raise ValueError('a message is no BLOB')
            yield Block(np.array(times, dtype=np.int64), list(payloads))

    def _query(self, sql: str, *values: int) -> sqlite3.Cursor:
        return self._connection.execute(sql, values)


def _topics(ids: set[int]) -> str:
    return f'topic_id IN ({", ".join(str(int(number)) for number in sorted(ids))})'


@contextmanager
def open_sqlite3(path: Path, shown: Path) -> Iterator[Sqlite3Storage]:
    """Open a .db3 file for reading only.

    ``shown`` is the name used in messages, which differs for a decompressed copy.

    Raises
    ------
    AllanError
        When it is no rosbag2 database or damaged.
    """
    # A write-ahead log beside it holds the last messages of a recorder that was killed. Without
    # one the file is taken as it stands, which works on read-only media too.
    log = path.with_name(path.name + '-wal')
    is_settled = not (log.exists() and log.stat().st_size)
    how = 'immutable=1' if is_settled else 'mode=ro'
    with translated(shown, _LIBRARY_ERRORS, REMEDY):
        connection = sqlite3.connect(f'file:{quote(str(path.absolute()))}?{how}', uri=True)
        file = FileIO(path)
    with closing(connection), file:
        with translated(shown, _LIBRARY_ERRORS, REMEDY):
            storage = Sqlite3Storage(shown, connection, file if is_settled else None)
        yield storage
