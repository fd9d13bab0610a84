# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A rosbag2 storage file in SQLite (.db3), all schema versions."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

import numpy as np

from .bag_storage import Block, Cut, Topic, damaged, normal_type, translated

ROWS = 8192
"""Rows fetched at a time: a few MB."""
_LIBRARY_ERRORS = (sqlite3.Error, OverflowError, ValueError, TypeError)
"""What reading raises on a damaged database: SQLite's own, and cells of another type."""
REMEDY = 'copy it again, or mend it with "sqlite3 FILE .recover"'


class Sqlite3Storage:
    """An open .db3 file."""

    cut: Cut | None = None

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self._path = path
        self._connection = connection
        self.topics = self._read_topics()

    def _read_topics(self) -> list[Topic]:
        tables = {name for (name,) in self._query('SELECT name FROM sqlite_master')}
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
        marks = ', '.join('?' * len(ids))
        sql = (
            f'SELECT timestamp, data FROM messages WHERE topic_id IN ({marks}) '
            'ORDER BY timestamp, id'
        )
        with translated(self._path, _LIBRARY_ERRORS, REMEDY):
            rows = self._query(sql, *ids)
            while batch := rows.fetchmany(ROWS):
                times, payloads = zip(*batch)
                if set(map(type, payloads)) != {bytes}:
                    raise ValueError('a message is no BLOB')
                yield Block(np.array(times, dtype=np.int64), list(payloads))

    def _query(self, sql: str, *values: int) -> sqlite3.Cursor:
        return self._connection.execute(sql, values)


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
    how = 'mode=ro' if log.exists() and log.stat().st_size else 'immutable=1'
    with translated(shown, _LIBRARY_ERRORS, REMEDY):
        connection = sqlite3.connect(f'file:{quote(str(path.absolute()))}?{how}', uri=True)
    with closing(connection):
        with translated(shown, _LIBRARY_ERRORS, REMEDY):
            storage = Sqlite3Storage(shown, connection)
        yield storage
