# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""rosbag2's SQLite files: unusual schemas and cells, written with SQL, and damaged pages."""

from __future__ import annotations

import sqlite3
import struct
import tempfile
from collections.abc import Iterator
from contextlib import closing, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from .damage import any_bytes, floats, signed, texts
from .harness import Target
from .mcap_target import IMU_TYPE, NESTED_SCHEMA
from .reading import PERIOD_NS, START_NS, payloads, read_and_check

COLUMNS = {
    'topics': ('id', 'name', 'type', 'serialization_format'),
    'messages': ('id', 'topic_id', 'timestamp', 'data'),
    'message_definitions': ('topic_type', 'encoding', 'encoded_message_definition'),
}
FILE_HEAD, INNER, LEAF = 100, 5, 13
KEY = 'id INTEGER PRIMARY KEY'
USUAL = 'CREATE TABLE messages({key}, topic_id INTEGER, timestamp INTEGER, data BLOB){end}'
ODD_STATEMENTS = (
    'DROP TABLE messages',
    'DROP TABLE topics',
    'DROP INDEX timestamp_idx',
    'ALTER TABLE messages RENAME COLUMN data TO payload',
    'ALTER TABLE topics RENAME COLUMN name TO topic',
    'UPDATE messages SET timestamp = -timestamp',
    'UPDATE messages SET timestamp = 0',
    'UPDATE messages SET id = id * 1000000000000',
    'UPDATE messages SET id = -id',
    'UPDATE messages SET data = NULL WHERE id % 7 = 3',
    "UPDATE messages SET data = 'text' WHERE id % 7 = 3",
    "UPDATE messages SET data = ''",
    'UPDATE messages SET data = data || data',
    'DELETE FROM messages WHERE id % 2',
    'DELETE FROM messages',
    'DELETE FROM topics',
    'INSERT INTO topics SELECT id + 1, name, type, serialization_format FROM topics',
    'CREATE VIEW topics2 AS SELECT * FROM topics',
    # a view without end in place of the table
    'DROP TABLE messages; CREATE VIEW messages AS WITH RECURSIVE n(id) AS '
    '(SELECT 1 UNION ALL SELECT id + 1 FROM n) SELECT id, 1 AS topic_id, id AS timestamp, '
    "x'00' AS data FROM n",
    'ALTER TABLE messages ADD COLUMN more AS (length(data))',
)


def _make(path: Path, encoding: str, key: str, end: str, index: bool) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None)
    connection.executescript(f'PRAGMA encoding={encoding!r}; PRAGMA synchronous=OFF; BEGIN')
    connection.execute(
        f'CREATE TABLE topics({KEY}, name TEXT, type TEXT, serialization_format TEXT)'
    )
    connection.execute('CREATE TABLE message_definitions(topic_type TEXT, encoding TEXT, '
                       'encoded_message_definition TEXT)')  # fmt: skip
    connection.execute(USUAL.format(key=key, end=end))
    if index:
        connection.execute('CREATE INDEX timestamp_idx ON messages (timestamp ASC)')
    connection.execute('INSERT INTO topics VALUES (1, "/imu", ?, "cdr")', (IMU_TYPE,))
    connection.execute('INSERT INTO message_definitions VALUES ("a/msg/B", "ros2msg", ?)',
                       (NESTED_SCHEMA,))  # fmt: skip
    connection.executemany(
        'INSERT INTO messages VALUES (?, 1, ?, ?)',
        ((i + 1, START_NS + i * PERIOD_NS, p) for i, p in enumerate(payloads('cdr'))),
    )
    return connection


@lru_cache(maxsize=1)
def seeds() -> tuple[bytes, ...]:
    """Return intact files, with and without an index."""
    found = []
    for index in (True, False):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, 'seed.db3')
            with closing(_make(path, 'UTF-8', KEY, '', index)) as connection:
                connection.execute('COMMIT')
            found.append(path.read_bytes())
    return tuple(found)


def boundaries(data: bytes) -> Iterator[int]:
    """Yield the offset of each page of an intact file, and of each cell that contains a row.

    The header of a b-tree page is at 0, or after the file header on the first page. The offsets of
    its cells begin at byte 8, or 12 on an inner page (https://sqlite.org/fileformat2.html).
    """
    (size,) = struct.unpack_from('>H', data, 16)
    for page in range(0, len(data), size):
        yield page
        head = page + (FILE_HEAD if page == 0 else 0)
        if data[head] in (INNER, LEAF):
            (cells,) = struct.unpack_from('>H', data, head + 3)
            first = head + (12 if data[head] == INNER else 8)
            places = struct.unpack_from(f'>{cells}H', data, first)
            yield from sorted(page + place for place in places)
    yield len(data)


CELLS: SearchStrategy[Any] = (
    st.none() | signed.map(lambda i: (i + 2**63) % 2**64 - 2**63) | floats | texts
)
CELLS |= st.binary(max_size=20) | any_bytes(payloads('cdr', 2))


@st.composite
def _edits(draw: Any) -> tuple[Any, ...]:
    """Draw how the file is created, which cells change, and statements on the tables."""
    table = st.sampled_from(list(COLUMNS)).flatmap(
        lambda name: st.tuples(st.just(name), st.sampled_from(COLUMNS[name]), CELLS, signed)
    )
    return (
        draw(st.sampled_from(['UTF-8', 'UTF-8', 'UTF-16le'])),
        draw(st.sampled_from([KEY, KEY, 'id INT PRIMARY KEY', 'id', 'id TEXT PRIMARY KEY'])),
        draw(st.booleans()),
        draw(st.lists(table, max_size=3)),
        draw(st.lists(st.sampled_from(ODD_STATEMENTS), max_size=2)),
    )


def _edited(path: Path, edits: tuple[Any, ...]) -> None:
    encoding, key, index, cells, statements = edits
    with closing(_make(path, encoding, key, '', index)) as connection:
        for table, column, value, which in cells:
            with suppress(sqlite3.Error, UnicodeEncodeError):
                connection.execute(
                    f'UPDATE {table} SET {column} = ? WHERE rowid % 5 = ?', (value, which % 5)
                )
        connection.execute('COMMIT')
        for statement in statements:
            with suppress(sqlite3.Error):
                connection.executescript(statement)


def check(made: Any, folder: Path) -> bool:
    """Read the file."""
    path = folder / 'bag.db3'
    if isinstance(made, bytes):
        path.write_bytes(made)
    else:
        _edited(path, made)
    return read_and_check(path)


@st.composite
def _files(draw: Any) -> Any:
    return draw(_edits() if draw(st.integers(0, 2)) else any_bytes(seeds()))


TARGET = Target('sqlite3', _files(), check)
