# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows read directly from the pages of a database equal the rows that SQLite returns."""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allan_ros.core.errors import AllanError
from allan_ros.io.readers import sqlite3_pages
from allan_ros.io.readers.sqlite3 import Sqlite3Storage, open_sqlite3
from allan_ros.io.readers.storage import as_list

START_NS = 1_700_000_000_123_456_789
TABLES = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
    timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""


class Stretch(NamedTuple):
    """Consecutive rows with the same properties."""

    count: int
    first_id: int
    topic: int
    start_ns: int
    step_ns: int
    size: int
    deleted: int


STRETCHES = st.lists(
    st.builds(
        Stretch,
        st.integers(1, 90),
        st.sampled_from([0, 1, 100, 20_000, 3 * 10**6, 2**31, 2**40, -(10**6)]),
        st.sampled_from([1, 1, 1, 0, 2, 300, -1]),
        st.sampled_from([START_NS, START_NS, START_NS + 10**12, 10**9, 5, -(2**50)]),
        st.sampled_from([5_000_000, 5_000_000, 0, -7]),
        # the ranges are sizes that just fit, or do not fit, on a page of 512 or 4096 bytes
        st.sampled_from([324, 324, 324, 332, 0, 1, 55, 9000])
        | st.integers(450, 500)
        | st.integers(4030, 4090),
        st.sampled_from([0, 0, 0, 2, 7]),
    ),
    min_size=1,
    max_size=5,
)


def write_database(path: Path, stretches: list[Stretch], page: int, seed: int) -> None:
    """Write rows in an unusual order, and delete some of them."""
    rng = np.random.default_rng(seed)
    database = sqlite3.connect(path)
    database.execute(f'PRAGMA page_size = {page}')
    database.execute(f'PRAGMA auto_vacuum = {seed % 3}')
    database.executescript(TABLES)
    for topic in (1, 2, 300):
        database.execute('INSERT INTO topics VALUES (?, ?, ?, ?)', (topic, f'/{topic}', 'T', 'cdr'))
    for s in stretches:
        for i in range(s.count):
            row = s.first_id + i, s.topic, s.start_ns + i * s.step_ns, rng.bytes(s.size)
            database.execute('INSERT OR REPLACE INTO messages VALUES (?, ?, ?, ?)', row)
        if s.deleted:
            database.execute('DELETE FROM messages WHERE id % ? = 1', (s.deleted,))
    database.commit()
    database.close()


def messages(path: Path, ids: set[int]) -> list[tuple[int, bytes]]:
    """Return record time and bytes of each message."""
    with open_sqlite3(path, path) as storage:
        return [
            (time, bytes(payload))
            for block in storage.blocks(ids)
            for time, payload in zip(block.record_ns.tolist(), as_list(block.payloads))
        ]


def row_by_row(path: Path, ids: set[int]) -> list[tuple[int, bytes]]:
    """Return record time and bytes of each message, read row by row with SQLite."""
    with mock.patch.object(Sqlite3Storage, '_is_usual', return_value=False):
        return messages(path, ids)


@settings(max_examples=60)
@given(
    STRETCHES,
    st.sampled_from([512, 4096, 4096, 65536]),
    st.integers(0, 99),
    st.sampled_from([{1}, {1}, {1, 300}, {0}]),
    st.sampled_from([1, 1 << 14, 1 << 20]),
)
def test_pages_contain_the_rows_of_the_table(
    stretches: list[Stretch], page: int, seed: int, ids: set[int], at_a_time: int
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, 'bag.db3')
        write_database(path, stretches, page, seed)
        with mock.patch.object(sqlite3_pages, 'READ_BYTES', at_a_time):
            assert messages(path, ids) == row_by_row(path, ids)


def recorded(path: Path, others: int = 0) -> Path:
    """Write a bag of an Imu topic, and of ``others`` messages of another topic."""
    stretches = [Stretch(3000, 1, 1, START_NS, 5_000_000, 324, 0)]
    stretches += [Stretch(others, 3001, 2, START_NS + 3000 * 5_000_000, 5_000_000, 9000, 0)]
    write_database(path, stretches, 4096, seed=0)
    return path


@pytest.mark.parametrize('others', [0, 50])
def test_a_usual_database_is_never_read_row_by_row(others: int, tmp_path: Path) -> None:
    path = recorded(tmp_path / 'bag.db3', others)
    whole = row_by_row(path, {1})
    with mock.patch.object(Sqlite3Storage, '_rows', side_effect=AssertionError):
        assert messages(path, {1}) == whole
    assert len(whole) == 3000


@pytest.mark.parametrize(
    'change',
    [
        'ALTER TABLE messages ADD COLUMN more INTEGER',
        'DROP INDEX timestamp_idx',
        'UPDATE messages SET data = CAST(data AS TEXT) WHERE id > 2000',
        'UPDATE messages SET timestamp = timestamp / 1e9 WHERE id > 2990',
        'UPDATE messages SET timestamp = 1.5e300 WHERE id > 2990',
        'DELETE FROM messages',
        'CREATE TABLE another AS SELECT * FROM messages; DROP TABLE messages; '
        'CREATE VIEW messages AS SELECT * FROM another',
    ],
)
def test_another_table_is_left_to_sqlite(change: str, tmp_path: Path) -> None:
    path = recorded(tmp_path / 'bag.db3')
    database = sqlite3.connect(path)
    database.executescript(change)
    database.close()
    assert outcome(messages, path) == outcome(row_by_row, path)


def outcome(read: Callable[..., Any], path: Path) -> Any:
    """Return the messages, or the error."""
    try:
        return read(path, {1})
    except AllanError as error:
        return str(error)


def test_a_damaged_database_is_read_or_reported_without_a_crash(tmp_path: Path) -> None:
    good = recorded(tmp_path / 'good.db3', 20).read_bytes()
    path, rng = tmp_path / 'bad.db3', np.random.default_rng(3)
    for _ in range(60):
        bad = bytearray(good)
        for at in rng.integers(len(bad), size=20):
            page = at // 4096 * 4096
            bad[page + int(rng.integers(16))] = rng.integers(256)
        path.write_bytes(bad[: len(bad) - 4096 * int(rng.integers(3))])
        outcome(messages, path)
