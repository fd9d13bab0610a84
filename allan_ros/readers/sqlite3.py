# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read a bag file of rosbag2 in SQLite format (.db3), in all versions of its schema."""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from urllib.parse import quote

import numpy as np

from .bag_messages import Messages, Topic, Truncation, normal_type
from .files import open_regular
from .recording import damaged, translated

FETCHED_ROWS = 512
"""Number of rows that are fetched from SQLite at a time: few enough for the processor cache."""

BLOCK_ROWS = 4 * FETCHED_ROWS
"""Largest number of messages that are decoded together."""

_LIBRARY_ERRORS = (sqlite3.Error, OSError, OverflowError, ValueError, TypeError, AttributeError)
"""Exceptions that a damaged database can cause, for example because of a value of another type."""

REMEDY = 'copy it again, or repair it with "sqlite3 FILE .recover"'


class Sqlite3Storage:
    """An open .db3 file; ``path`` is its path in error messages."""

    def __init__(self, path: Path, connection: sqlite3.Connection, size: int | None) -> None:
        """Read the topics through an open ``connection`` to a database file of ``size`` bytes.

        ``size`` is None if a write-ahead log contains a part of the database.
        """
        self._path = path
        self._connection = connection
        self.truncation: Truncation | None = None
        self._counts: dict[int, int] | None = None
        self.topics = self._read_topics()
        ((pages,),), ((page_bytes,),) = map(self._query, ('PRAGMA page_count', 'PRAGMA page_size'))
        if size is not None and size < pages * page_bytes:
            self.truncation = Truncation(size, pages * page_bytes)

    def _read_topics(self) -> list[Topic]:
        # with a trusted schema, a view with the name of a table could run an endless computation
        self._query('PRAGMA trusted_schema = OFF')
        tables = {n for (n,) in self._query("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if missing := {'topics', 'messages'} - tables:
            raise damaged(
                self._path,
                f'a database without the table {" and ".join(sorted(missing))}',
                'it is not a rosbag2 file; give the .db3 that ros2 bag recorded',
            )
        rows = self._query('SELECT id, name, type, serialization_format FROM topics ORDER BY id')
        return [
            Topic(number, name, normal_type(type_name), encoding)
            for number, name, type_name, encoding in rows
        ]

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages; the first call reads the complete table."""
        if self._counts is None:
            with translated(self._path, _LIBRARY_ERRORS, REMEDY):
                self._counts = dict(
                    self._query('SELECT topic_id, count(*) FROM messages NOT INDEXED GROUP BY 1')
                )
        return self._counts

    def stated_count(self, ids: set[int], read_count: int) -> int:
        """Return the number of messages of the topics ``ids`` in the table.

        `blocks` finds the messages by the index on the record times, which can lack rows of the
        table if the file is damaged. ``read_count``, the number of messages that were read, is not
        used.
        """
        return sum(self.counts().get(topic_id, 0) for topic_id in ids)

    def blocks(self, ids: set[int]) -> Iterator[Messages]:
        """Yield all messages of the topics ``ids`` in blocks, in the order of record time."""
        # topic ids are read only if there are several topics: reading them takes a tenth more time
        columns = 'timestamp, data' + ', topic_id' * (len(ids) > 1)
        with translated(self._path, _LIBRARY_ERRORS, REMEDY):
            rows = self._query(
                f'SELECT {columns} FROM messages WHERE topic_id IN {_listed(ids)} '
                'ORDER BY timestamp, id'
            )
            while batch := rows.fetchmany(FETCHED_ROWS):
                times: list[int] = []
                payloads: list[bytes | memoryview] = []
                topics: list[int] = []
                while batch:
                    more_times, more_payloads, *more_topics = zip(*batch)
                    times += more_times
                    payloads += more_payloads
                    topics += more_topics[0] if more_topics else ()
                    batch = rows.fetchmany(FETCHED_ROWS) if len(times) < BLOCK_ROWS else []
                if set(map(type, payloads)) != {bytes}:
                    raise ValueError('a message is not a BLOB')
                topic_ids = np.array(topics) if topics else np.full(len(times), min(ids))
                yield Messages(topic_ids, np.array(times, np.int64), payloads)

    def _query(self, sql: str) -> sqlite3.Cursor:
        return self._connection.execute(sql)


def _listed(ids: set[int]) -> str:
    return f'({", ".join(str(int(number)) for number in ids)})'


@contextmanager
def open_storage(path: Path, shown: Path) -> Iterator[Sqlite3Storage]:
    """Open a .db3 file for reading; no file is created next to it.

    ``shown`` is the path in error messages, because ``path`` may be a decompressed copy. Raises
    AllanError when the file is not a rosbag2 database, or is damaged.
    """
    # If the recorder was killed, a write-ahead log contains the last messages. Without a log, the
    # file is opened as immutable, which also works on read-only media.
    log, shared_memory = (path.with_name(f'{path.name}-{suffix}') for suffix in ('wal', 'shm'))
    with ExitStack() as stack:
        with translated(shown, _LIBRARY_ERRORS, REMEDY):
            size: int | None = os.fstat(stack.enter_context(open_regular(path)).fileno()).st_size
        mode = 'immutable=1'
        if log.is_file() and log.stat().st_size:
            mode, size = 'mode=ro', None
            if not shared_memory.is_file():  # SQLite would create this file and not remove it
                folder = stack.enter_context(tempfile.TemporaryDirectory(prefix='allan_ros.'))
                path = _copied(path, log, Path(folder), shown)
        with translated(shown, _LIBRARY_ERRORS, REMEDY):
            connection = sqlite3.connect(
                f'file:{quote(os.fsencode(path.absolute()))}?{mode}',
                uri=True,
                check_same_thread=False,
            )
            stack.enter_context(closing(connection))
            storage = Sqlite3Storage(shown, connection, size)
        yield storage


def _copied(path: Path, log: Path, folder: Path, shown: Path) -> Path:
    """Copy a database and its log into a folder, and return the path of the copy."""
    with translated(shown, (OSError,), 'check the space for temporary files'):
        size = path.stat().st_size + log.stat().st_size
        if size > shutil.disk_usage(folder).free:
            raise OSError(f'its log requires a temporary copy of {size} bytes')
        copy = folder / 'bag.db3'
        shutil.copyfile(path, copy)
        shutil.copyfile(log, copy.with_name('bag.db3-wal'))
    return copy
