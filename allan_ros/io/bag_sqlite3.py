# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A rosbag2 storage file in SQLite (.db3), all schema versions."""

from __future__ import annotations

import sqlite3
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

import numpy as np

from .bag_storage import Block, Cut, Topic, damaged, normal_type, translated

ROWS = 2048
"""Most rows fetched at a time: those of an Imu are less than 1 MB and stay in the cache."""
FIRST_ROWS = 64
"""Rows of the first batch, when nothing is known of their size."""
BATCH_BYTES = 1 << 22
"""Batches are of about this many bytes."""
_USUAL_TABLE = """
SELECT 1 FROM pragma_table_info('messages') AS field, pragma_index_list('messages') AS list,
pragma_index_info(list.name) AS part
WHERE field.name = 'id' AND field.pk = 1 AND upper(field.type) = 'INTEGER'
AND NOT list.partial AND part.seqno = 0 AND part.name = 'timestamp'
"""
"""Has a row where ids are row numbers and there is an index of the record times."""
_LIBRARY_ERRORS = (sqlite3.Error, OverflowError, ValueError, TypeError, AttributeError)
"""What reading raises on a damaged database: SQLite's own, and cells of another type."""
REMEDY = 'copy it again, or mend it with "sqlite3 FILE .recover"'


class Sqlite3Storage:
    """An open .db3 file."""

    cut: Cut | None = None

    def __init__(self, path: Path, connection: sqlite3.Connection, is_settled: bool) -> None:
        self._path = path
        self._connection = connection
        self._is_settled = is_settled
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
        first, last = next(self._query('SELECT min(id), max(id) FROM messages'))
        if first is None:
            return
        done = first - 1
        if self._can_batch():
            done = yield from self._batches(ids, done, last)
        if done < last:
            # the plus keeps SQLite from sorting the whole file: it shall go by the time index
            yield from self._rows(ids, '+id > ? ORDER BY timestamp, id', done)

    def _can_batch(self) -> bool:
        """Return whether messages can be fetched many at a time: the usual file of a recorder."""
        ((encoding,),) = self._query('PRAGMA encoding')
        return encoding == 'UTF-8' and self._is_settled and bool(list(self._query(_USUAL_TABLE)))

    def _batches(self, ids: set[int], done: int, last: int) -> Generator[Block, None, int]:
        """Yield messages by ranges of ids while their order is that of time.

        Returns
        -------
        int
            The id up to which all messages have been yielded, in order.
        """
        of_topics = _topics(ids)
        first = (
            'SELECT id, timestamp, length(data) FROM messages '
            f'WHERE id > ? AND {of_topics} ORDER BY id LIMIT 1'
        )
        joined = (
            'SELECT CAST(group_concat(data, timestamp) AS BLOB) FROM messages '
            f'WHERE id > ? AND id <= ? AND {of_topics}'
        )
        rows, end_ns = FIRST_ROWS, None
        while found := next(self._query(first, done), None):
            start, start_ns, length = found
            until = start - 1 + rows
            ((data,),) = self._query(joined, start - 1, until)
            alike = _equal_block(length, start_ns, data)
            range_of_ids = 'id > ? AND id <= ? ORDER BY +timestamp, id'
            blocks = [alike] if alike else list(self._rows(ids, range_of_ids, start - 1, until))
            messages = sum(len(block.record_ns) for block in blocks)
            before_ns, end_ns = end_ns, int(blocks[-1].record_ns[-1])
            if self._is_overtaken(of_topics, before_ns, end_ns, messages, until):
                return done  # a later row was recorded earlier
            yield from blocks
            done = until
            rows = max(1, min(ROWS, BATCH_BYTES * rows // max(len(data or ''), 1)))
        return last

    def _is_overtaken(
        self, of_topics: str, before_ns: int | None, end_ns: int, messages: int, until: int
    ) -> bool:
        """Return whether a row behind id ``until`` was recorded before ``end_ns``.

        ``before_ns`` is where the batch before ended, from which on ``messages`` are known.
        """
        # SQLite skips entries of the index in a fifth of the time it takes to look at them: when
        # no more of them than those known come up to the end of the batch, all is said.
        known = messages if before_ns is None else messages + 1
        start_ns = -(2**63) if before_ns is None else before_ns
        behind = (
            'SELECT timestamp FROM messages WHERE timestamp >= ? '
            'ORDER BY timestamp LIMIT 1 OFFSET ?'
        )
        following = next(self._query(behind, start_ns, known), None)
        if following is None or following[0] > end_ns:
            return False
        earlier = (
            'SELECT 1 FROM messages WHERE timestamp >= ? AND timestamp < ? AND +id > ? '
            f'AND {of_topics} LIMIT 1'
        )
        return next(self._query(earlier, start_ns, end_ns, until), None) is not None

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


def _equal_block(length: int | None, start_ns: int, data: bytes) -> Block | None:
    """Return joined messages as a block, or None when they differ in length or are in disorder.

    Parameters
    ----------
    length, start_ns : int
        Bytes and record time of the first message.
    data : bytes
        The messages, before each but the first its record time in decimal digits: where all of
        these stand in their places, the messages between them are of one length. SQLite joins in
        whatever order it likes; the times tell.
    """
    digits = len(str(start_ns))
    if not length or start_ns < 0 or (len(data) + digits) % (length + digits):
        return None
    rows = (len(data) + digits) // (length + digits)
    step = (length + digits,)
    text = np.ndarray((rows - 1, digits), np.uint8, data, length, (*step, 1)) - ord('0')
    if (text > 9).any():
        return None
    times = np.append(start_ns, text.astype(np.int64) @ 10 ** np.arange(digits)[::-1])
    if (times[1:] < times[:-1]).any():
        return None
    return Block(times, np.ndarray((rows,), np.dtype((np.void, length)), data, strides=step))


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
    with closing(connection):
        with translated(shown, _LIBRARY_ERRORS, REMEDY):
            storage = Sqlite3Storage(shown, connection, is_settled)
        yield storage
