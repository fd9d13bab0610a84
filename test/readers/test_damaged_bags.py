# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged and hostile bags: lost messages are reported, and memory, disk and time are limited."""

from __future__ import annotations

import sqlite3
import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recordings import imu_batches, outcome, read, refused

from allan_ros.core.imu import joined
from allan_ros.readers import topics_of
from allan_ros.readers.cdr import IMU_TYPE, encode_imus
from allan_ros.view.finding_text import finding_line
from fuzz.hostile_target import KINDS, MAKE, PLACES
from fuzz.mcap_target import Plan, build
from fuzz.reading import small_batch, write_bag

zstandard = pytest.importorskip('zstandard')
yaml = pytest.importorskip('yaml')

MAGIC = b'\x89MCAP0\r\n'
CHUNK, CHUNK_INDEX, STATISTICS = 0x06, 0x08, 0x0B
DATA_END, FOOTER = 0x0F, 0x02


def ids(back: Any) -> list[str]:
    return [finding.id for finding in back.findings]


def mcap_file(tmp_path: Path, batches: list[Any]) -> bytes:
    """Return an mcap file of several chunks."""
    write_bag(tmp_path / 'run', batches)
    return (tmp_path / 'run/run.mcap').read_bytes()


def records(data: bytes) -> list[tuple[int, int, int]]:
    """Return opcode, start and end of each record, header included."""
    found, at = [], len(MAGIC)
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from('<BQ', data, at)
        found.append((opcode, at, at + 9 + length))
        at += 9 + length
    return found


# --- the number of messages read, and the stated one ---------------------------------------------


def test_chunks_the_summary_does_not_list_are_read(tmp_path: Path) -> None:
    data = bytearray(mcap_file(tmp_path, imu_batches(12_000)))
    for _, start, _ in [r for r in records(bytes(data)) if r[0] == CHUNK_INDEX][1:]:
        data[start] = 0x0D  # a metadata index, which no reader uses
    path = tmp_path / 'bad.mcap'
    path.write_bytes(data)
    back = read(path)
    assert len(back.stamps_ns) == 12_000 and ids(back) == []


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3', 'statistics'])
def test_a_count_that_differs_is_a_warning(storage: str, tmp_path: Path) -> None:
    path = tmp_path / 'bag.mcap'
    path.write_bytes(build(Plan(counted=3600)))
    if storage != 'statistics':
        path = tmp_path / 'run'
        write_bag(path, [small_batch()], storage)
        metadata = path / 'metadata.yaml'
        text = metadata.read_text()
        metadata.write_text(text.replace('message_count: 40', 'message_count: 3600'))
    back = read(path)
    assert [(f.id, f.severity) for f in back.findings] == [('count_differs', 'warning')]
    assert 'states 3600 messages, but 40 were read' in finding_line(back.findings[0])


@pytest.mark.parametrize('checksum', [True, False])
def test_a_flipped_bit_in_the_summary_loses_nothing_silently(
    checksum: bool, tmp_path: Path
) -> None:
    data = build(Plan(channels=2, checksum=checksum))
    path = tmp_path / 'flipped.mcap'
    path.write_bytes(data)
    assert len(read(path).stamps_ns) == 40
    (start,) = struct.unpack_from('<Q', data, len(data) - len(MAGIC) - 20)
    rng = np.random.default_rng(3)
    for bit in rng.choice(8 * (len(data) - len(MAGIC) - start), 150, replace=False).tolist():
        spoiled = bytearray(data)
        spoiled[start + bit // 8] ^= 1 << bit % 8
        path.write_bytes(spoiled)
        count, error = outcome(path)
        assert error or count == 40 or ids(read(path)), bit


def test_counts_of_zero_do_not_refuse_a_recording(tmp_path: Path) -> None:
    data = bytearray(mcap_file(tmp_path, imu_batches(600)))
    (place,) = [r[1] for r in records(bytes(data)) if r[0] == STATISTICS]
    data[place + 9 : place + 17] = data[place + 9 + 46 : place + 9 + 54] = bytes(8)
    (tmp_path / 'run/run.mcap').write_bytes(data)
    metadata = tmp_path / 'run/metadata.yaml'
    metadata.write_text(metadata.read_text().replace('message_count: 600', 'message_count: 0'))
    for path in (tmp_path / 'run', tmp_path / 'run/run.mcap'):
        back = read(path)
        assert len(back.stamps_ns) == 600 and ids(back) == ['count_differs']


@pytest.mark.parametrize('compression', ['storage', 'message'])
def test_threads_read_at_the_same_time(compression: str, tmp_path: Path) -> None:
    from concurrent.futures import ThreadPoolExecutor

    batches = imu_batches(6000)
    write_bag(tmp_path / 'run', batches, compression=compression)
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(read, [tmp_path / 'run'] * 24))
    for back in found:
        np.testing.assert_array_equal(back.samples, joined(batches).samples)


def test_many_topics_take_linear_time(tmp_path: Path) -> None:
    [payload] = encode_imus(imu_batches(1, parts=1)[0], 'cdr')
    path = database(tmp_path, imu_batches(1))
    with sqlite3.connect(path) as connection:
        topics = [(i, f'/imu{i}', IMU_TYPE, 'cdr', '', '') for i in range(2, 10_001)]
        connection.executemany('INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)', topics)
        rows = [(i, i, bytes(payload)) for i in range(2, 10_001)]
        connection.executemany(
            'INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)', rows
        )
    began = time.process_time()
    said = refused(path)
    assert 'has 10000 Imu topics: /imu/data (1)' in said and said.endswith('with --topic')
    assert len(said) < 600
    assert topics_of(path) == []
    assert time.process_time() - began < 5.0


@pytest.mark.parametrize('summary', [True, False])
@pytest.mark.parametrize('loose', [(), (1, 3), (0, 1, 2, 3)])
@pytest.mark.parametrize('ended', [True, False])
@pytest.mark.parametrize('encoding', ['cdr', 'ros1'])
def test_the_summary_the_chunks_and_the_end_are_optional(
    summary: bool, loose: tuple[int, ...], ended: bool, encoding: str, tmp_path: Path
) -> None:
    data = build(Plan(chunks=4, loose=loose, summary=summary, encoding=encoding))
    path = tmp_path / 'bag.mcap'
    path.write_bytes(data if ended else data[: -len(MAGIC) - 29])
    back = read(path)
    np.testing.assert_array_equal(back.stamps_ns, small_batch().stamps_ns)
    np.testing.assert_array_equal(back.samples, small_batch().samples)
    assert ids(back) == [] if ended else ids(back) == ['bag_cut']


@pytest.mark.parametrize('opcode, length', [(DATA_END, 4), (FOOTER, 20), (DATA_END, 7)])
def test_an_end_in_the_middle_does_not_end_reading(
    opcode: int, length: int, tmp_path: Path
) -> None:
    data = mcap_file(tmp_path, imu_batches(12_000))
    chunks = [r for r in records(data) if r[0] == CHUNK]
    inserted = struct.pack('<BQ', opcode, length) + bytes(length)
    at = chunks[1][1]
    path = tmp_path / 'bad.mcap'
    path.write_bytes(data[:at] + inserted + data[at : -len(MAGIC) - 29])  # without a footer
    back = read(path)
    assert len(back.stamps_ns) == 12_000
    assert ids(back) == ['bag_cut']


def test_a_chunk_that_became_another_record_is_missed(tmp_path: Path) -> None:
    data = bytearray(mcap_file(tmp_path, imu_batches(12_000)))
    chunks = [r for r in records(bytes(data)) if r[0] == CHUNK]
    data[chunks[1][1]] = 0x0A  # metadata
    path = tmp_path / 'bad.mcap'
    path.write_bytes(data[: -len(MAGIC) - 29])
    back = read(path)
    assert 6_000 < len(back.stamps_ns) < 12_000
    assert 'count_differs' in ids(back)
    says = f'states 12000 messages, but {len(back.stamps_ns)} were read'
    assert any(says in finding_line(found) for found in back.findings)


def database(tmp_path: Path, batches: list[Any], how: str = 'none') -> Path:
    write_bag(tmp_path / 'run', batches, 'sqlite3', how)
    return next((tmp_path / 'run').glob('*.db3*'))


def test_a_database_truncated_inside_its_last_page_is_reported(tmp_path: Path) -> None:
    data = database(tmp_path, imu_batches(3_600)).read_bytes()
    path = tmp_path / 'cut.db3'
    for lost in (1, 100, 4095, 4096, 40_000):
        path.write_bytes(data[:-lost])
        count, error = outcome(path)
        if not error:
            back = read(path)
            assert 'bag_cut' in ids(back) and (count == 3_600 or 'count_differs' in ids(back))


def test_a_damaged_pointer_to_the_last_page_is_reported(tmp_path: Path) -> None:
    data = database(tmp_path, imu_batches(3_600)).read_bytes()
    with sqlite3.connect(tmp_path / 'run/run.db3') as connection:
        (root,) = connection.execute(
            "SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
        ).fetchone()
    at = (root - 1) * 4096 + 8
    (right,) = struct.unpack_from('>I', data, at)
    path = tmp_path / 'bad.db3'
    silent = 0
    for page in range(1, len(data) // 4096 + 1, 9):
        path.write_bytes(data[:at] + struct.pack('>I', page) + data[at + 4 :])
        count, error = outcome(path)
        if page != right and not error:
            silent += 'count_differs' not in ids(read(path))
            assert count != 3_600
    assert not silent


@pytest.mark.parametrize('suffixes', [('', '-wal'), ('', '-wal', '-shm')])
def test_the_log_of_a_database_is_read_and_no_file_created(
    suffixes: tuple[str, ...], tmp_path: Path
) -> None:
    """A killed recorder leaves its last messages in a write-ahead log."""
    source = database(tmp_path, imu_batches(40))
    writer = sqlite3.connect(source)
    writer.execute('PRAGMA journal_mode=WAL')
    writer.execute(
        'INSERT INTO messages (topic_id, timestamp, data) '
        'SELECT topic_id, timestamp + 1000000000000, data FROM messages'
    )
    writer.commit()
    folder = tmp_path / 'copied'
    folder.mkdir()
    for suffix in suffixes:
        (folder / f'run.db3{suffix}').write_bytes(Path(f'{source}{suffix}').read_bytes())
    writer.close()
    assert len(read(folder / 'run.db3').stamps_ns) == 80
    assert {child.name for child in folder.iterdir()} == {f'run.db3{end}' for end in suffixes}


@pytest.mark.parametrize(
    'right, wrong, says',
    [
        *(
            ('message_count: 9', f'message_count: {count}', 'remove it to read')
            for count in ('.inf', '.nan', '-1', 'true', '1e3', '"12"', '9' * 400)
        ),
        (': cdr', ': "\\x1b[2J"', 'contains unprintable characters'),
        (': sensor_msgs/msg/Imu', ': "\\x1b[2J"', 'contains unprintable characters'),
    ],
)
def test_invalid_metadata_is_rejected(right: str, wrong: str, says: str, tmp_path: Path) -> None:
    write_bag(tmp_path / 'run', imu_batches(9))
    path = tmp_path / 'run/metadata.yaml'
    path.write_text(path.read_text().replace(right, wrong))
    said = refused(tmp_path / 'run')
    assert 'metadata.yaml: cannot be read' in said and says in said


# --- input is limited ----------------------------------------------------------------------------


def limited(path: Path, megabytes: int = 500) -> str:
    """Read a recording in a process whose memory is limited; return what it reports."""
    program = (
        'import resource, sys\n'
        'from allan_ros.core.errors import AllanError\n'
        'import allan_ros.readers.rosbag2, allan_ros.readers.tables, zstandard, yaml\n'
        'from allan_ros.readers import open_recording\n'
        'pages = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()\n'
        f'limit = pages + {megabytes} * 2**20\n'
        'resource.setrlimit(resource.RLIMIT_AS, (limit, limit))\n'
        'resource.setrlimit(resource.RLIMIT_FSIZE, (400 * 2**20, 400 * 2**20))\n'
        'try:\n'
        '    recording = open_recording(sys.argv[1])\n'
        '    print(sum(map(len, recording.batches())))\n'
        'except AllanError as error:\n'
        '    print(error)\n'
    )
    done = subprocess.run(
        [sys.executable, '-c', program, str(path)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


BIG = 1 << 30


@pytest.mark.parametrize(
    'made, says',
    [
        (('mcap', 'zstd', BIG, BIG, 1), 'the chunk at byte'),
        (('mcap', 'zstd', BIG, 1 << 20, 1), 'the chunk at byte'),
        (('mcap', 'zstd stated', BIG, BIG, 1), 'the chunk at byte'),
        (('mcap', 'zstd stated', BIG, 1 << 20, 1), 'the chunk at byte'),
        (('messages', 'zstd', BIG), 'message 4 of /imu/data is not a sensor_msgs/msg/Imu'),
        (('messages', 'zstd stated', BIG), 'message 4 of /imu/data is not a sensor_msgs/msg/Imu'),
        (('file', 'zstd', BIG, '.db3.zstd'), 'expands more than'),
        (('file', 'zstd stated', BIG, '.mcap.zstd'), 'expands more than'),
        (('line', 't,gx,gy,gz\n1,2,3,', 4 * BIG), 'line 2 has more than'),
        (('sparse', '.mcap', 16 * BIG), 'the limit is'),
        (('sparse', '.npy', 4 * BIG), 'save it again with numpy'),
        (('sparse', '.npz', 0), 'save it again with numpy'),
    ],
)
def test_a_file_that_expands_without_limit_is_rejected(
    made: tuple[Any, ...], says: str, tmp_path: Path
) -> None:
    kind, *how = made
    assert says in limited(MAKE[kind](tmp_path, *how))


def test_many_messages_that_expand_a_little(tmp_path: Path) -> None:
    """64 kB each is allowed, in blocks that fit into the memory."""
    path = database(tmp_path, imu_batches(2100), 'message')
    [payload] = encode_imus(imu_batches(1, parts=1)[0], 'cdr')
    packed = zstandard.ZstdCompressor().compress(bytes(payload) + bytes(65_000))
    with sqlite3.connect(path) as connection:
        connection.execute('UPDATE messages SET data = ?', (packed,))
    assert limited(path) == '2100\n'


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('place', PLACES)
def test_special_files_are_rejected_without_waiting(kind: str, place: str, tmp_path: Path) -> None:
    path = MAKE['special'](tmp_path, kind, place)
    count, said = outcome(path)
    ignored = place.endswith('-wal') or (kind, place) == ('gone', 'a/metadata.yaml')
    assert (count, bool(said)) == ((9, False) if ignored else (0, True))
    assert not said or said.startswith(str(path))


def test_checksums_are_verified(tmp_path: Path) -> None:
    data = bytearray(mcap_file(tmp_path, imu_batches(100)))
    at, end = next((start, end) for opcode, start, end in records(bytes(data)) if opcode == CHUNK)
    (named,) = struct.unpack_from('<I', data, at + 9 + 28)
    inner = at + 9 + 28 + 4 + named + 8
    data[at + 9 + 24 : at + 9 + 28] = struct.pack('<I', zlib.crc32(data[inner:end]) ^ 1)
    path = tmp_path / 'bad.mcap'
    path.write_bytes(data)
    assert 'its checksum is wrong' in refused(path)
