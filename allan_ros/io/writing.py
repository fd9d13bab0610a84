# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write samples as a recording: rosbag2 (mcap, sqlite3), ROS 1 bag, CSV or npz.

A recording is written to a temporary folder next to its path and renamed when it is complete. Every
format stores int64 stamps and float64 samples, so reading returns exactly the same numbers.
"""

from __future__ import annotations

import copy
import os
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.errors import AllanError
from ..core.imu import ImuBatch
from .readers.cdr import IMU_TYPE, encode_imus, encode_records
from .readers.mcap import (
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    CHUNK_INDEX,
    CHUNK_INDEX_HEAD,
    DATA_END,
    FOOTER,
    HEAD,
    INDEX_HEAD,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    RECORD,
    SCHEMA,
    STATISTICS,
    STATISTICS_HEAD,
)
from .readers.storage import optional_package

COMPRESSIONS: dict[str, tuple[str, ...]] = {
    'mcap': ('none', 'chunk', 'message', 'file'),
    'sqlite3': ('none', 'message', 'file'),
    'ros1': ('none', 'bz2', 'lz4'),
    'csv': ('none',),
    'npz': ('none', 'deflate'),
}
"""Storage -> possible kinds of compression; those of rosbag2 (mcap, sqlite3) use zstd."""
STORAGE_OF_SUFFIX = {'.bag': 'ros1', '.csv': 'csv', '.tsv': 'csv', '.npz': 'npz'}
DEFAULT_STORAGE = 'mcap'
FILE_SUFFIXES = {'.mcap': 'mcap', '.db3': 'sqlite3'}
"""Suffix of a single file, instead of a bag with metadata.yaml -> its storage."""

METADATA_VERSION = 8
"""Version of metadata.yaml, as of ROS 2 Jazzy."""

IMU_HASH = 'RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b'
"""Type description hash of sensor_msgs/msg/Imu (REP 2011)."""

_VECTOR = 'float64 x\nfloat64 y\nfloat64 z\n'
IMU_DEFINITION = ('=' * 80 + '\nMSG: ').join(
    (
        'std_msgs/Header header\n'
        'geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n'
        'geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n'
        'geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n',
        'std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n',
        'builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n',
        f'geometry_msgs/Quaternion\n{_VECTOR}float64 w\n',
        f'geometry_msgs/Vector3\n{_VECTOR}',
    )
)

CHUNK_BYTES = 1 << 20
HEADER, METADATA, METADATA_INDEX = 0x01, 0x0C, 0x0D
CHANNEL_ID = SCHEMA_ID = 1

SQLITE_SCHEMA = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL,
    metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
    serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,
    type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL,
    encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL,
    type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
    timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""


def write_recording(
    path: str | os.PathLike[str],
    batches: Iterable[ImuBatch],
    *,
    storage: str | None = None,
    compression: str = 'none',
    topic: str = '/imu/data',
    overwrite: bool = False,
) -> int:
    """Write samples to a new recording, and return their number.

    Parameters
    ----------
    path : path
        The bag directory (rosbag2) or file (ROS 1, CSV, TSV, npz).
    batches : iterable of ImuBatch
        The batches in recorded order.
    storage : 'mcap', 'sqlite3', 'ros1', 'csv' or 'npz', optional
        By default from the suffix: .mcap, .db3, .bag, .csv, .tsv, .npz; otherwise an mcap bag.
    compression : str
        'none'; also 'chunk' (mcap), 'message', 'file' (mcap, sqlite3), 'bz2', 'lz4' (ros1) or
        'deflate' (npz).
    topic : str
        Topic name in a bag.
    overwrite : bool
        Replace an existing recording at ``path``.

    Raises
    ------
    AllanError
        When the path exists or cannot be written, or the storage or compression is unknown.
    """
    path = Path(path)
    by_suffix = {**STORAGE_OF_SUFFIX, **FILE_SUFFIXES}
    storage = storage or by_suffix.get(path.suffix.lower(), DEFAULT_STORAGE)
    if storage not in COMPRESSIONS:
        raise AllanError(f'storage {storage!r} is unknown: choose one of {", ".join(COMPRESSIONS)}')
    if compression not in COMPRESSIONS[storage]:
        raise AllanError(
            f'{storage} cannot be compressed with {compression!r}: '
            f'choose one of {", ".join(COMPRESSIONS[storage])}'
        )
    try:
        with _draft(path, overwrite) as draft:
            return _write(draft, batches, storage, compression, topic)
    except OSError as error:
        raise AllanError(
            f'{path} cannot be written ({error.strerror or error}): '
            'check the folder, its permissions and the free space'
        ) from error


def _write(
    path: Path, batches: Iterable[ImuBatch], storage: str, compression: str, topic: str
) -> int:
    if storage in ('mcap', 'sqlite3'):
        written = _write_rosbag2(path, batches, storage, compression, topic)
        if path.suffix.lower() in FILE_SUFFIXES and path.is_dir():
            _keep_storage_file(path)
        return written
    if storage == 'ros1':
        return _write_ros1(path, batches, compression, topic)
    if storage == 'csv':
        from .readers.tables import write_table

        return write_table(path, batches)
    from .readers.arrays import write_npz

    return write_npz(path, batches, deflate=compression == 'deflate')


def _keep_storage_file(bag: Path) -> None:
    """Replace the folder of a bag by its storage file, for a path such as ``name.mcap``."""
    (file,) = (child for child in bag.iterdir() if child.name != 'metadata.yaml')
    kept = file.rename(bag.with_name(f'{bag.name}.file'))
    shutil.rmtree(bag)
    kept.rename(bag)


@contextmanager
def _draft(path: Path, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary path with the same name; its content is then moved to ``path``."""
    if path.exists() and not overwrite:
        raise AllanError(f'{path} exists already: choose another name, or use --overwrite')
    if path.is_dir() and not (path / 'metadata.yaml').is_file():
        raise AllanError(f'{path} is a folder, but not a bag: choose another name')
    path.parent.mkdir(parents=True, exist_ok=True)
    # a folder, because the files in a rosbag2 are named after the bag
    scratch = Path(tempfile.mkdtemp(prefix=f'.{path.name}.', dir=path.parent))
    try:
        draft = scratch / path.name
        yield draft
        if path.is_dir():
            path.rename(scratch / 'replaced')
        draft.replace(path)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _write_ros1(path: Path, batches: Iterable[ImuBatch], compression: str, topic: str) -> int:
    rosbag1 = optional_package('rosbags.rosbag1', f'{path}: writing a ROS 1 bag')
    typesys = optional_package('rosbags.typesys', f'{path}: writing a ROS 1 bag')
    writer = rosbag1.Writer(path)
    if compression != 'none':
        writer.set_compression(rosbag1.Writer.CompressionFormat[compression.upper()])
    typestore = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    written = 0
    with writer:
        connection = writer.add_connection(topic, IMU_TYPE, typestore=typestore)
        for batch in batches:
            times = batch.stamps_ns if batch.record_ns is None else batch.record_ns
            for time_ns, payload in zip(times.tolist(), encode_imus(batch, 'ros1')):
                writer.write(connection, time_ns, payload)
            written += len(batch)
    return written


# --- rosbag2: https://mcap.dev/spec, and the schema of rosbag2_storage_sqlite3, version 4 -------


def _write_rosbag2(
    path: Path, batches: Iterable[ImuBatch], storage: str, compression: str, topic: str
) -> int:
    """Write a bag folder, and return the number of messages."""
    import yaml

    compress = None
    if compression != 'none':
        compress = optional_package('zstandard', f'{compression} compression').ZstdCompressor()
    path.mkdir()
    file = path / f'{path.name}{".mcap" if storage == "mcap" else ".db3"}'
    stored = file.with_name(f'{file.name}.zstd') if compression == 'file' else file
    times = _TimeRange()

    def messages() -> Iterable[tuple[NDArray[np.int64], NDArray[Any] | list[bytes]]]:
        for batch in batches:
            record_ns = batch.stamps_ns if batch.record_ns is None else batch.record_ns
            records = encode_records(batch, 'cdr')
            times.add(record_ns)
            if compression == 'message' and compress is not None:
                yield record_ns, [compress.compress(record.tobytes()) for record in records]
            elif len(batch):
                yield record_ns, records

    def metadata() -> dict[str, Any]:
        return _metadata(stored.name, storage, compression, topic, times)

    write = _write_mcap if storage == 'mcap' else _write_sqlite3
    chunk_compress = compress.compress if compress and compression == 'chunk' else None
    write(file, messages(), topic, lambda: str(yaml.safe_dump(metadata())), chunk_compress)
    if compress and stored != file:
        with file.open('rb') as plain, stored.open('wb') as out:
            compress.copy_stream(plain, out, size=file.stat().st_size)
        file.unlink()
    document = {'rosbag2_bagfile_information': metadata()}
    (path / 'metadata.yaml').write_text(yaml.safe_dump(document), encoding='utf-8')
    return times.count


class _TimeRange:
    """Number of messages, and the earliest and latest record time in ns."""

    def __init__(self) -> None:
        self.count = 0
        self.first: int | None = None
        self.last = 0

    def add(self, record_ns: NDArray[np.int64]) -> None:
        if len(record_ns):
            low, high = int(record_ns.min()), int(record_ns.max())
            self.last = high if self.first is None else max(self.last, high)
            self.first = low if self.first is None else min(self.first, low)
            self.count += len(record_ns)


def _metadata(
    file: str, storage: str, compression: str, topic: str, times: _TimeRange
) -> dict[str, Any]:
    """Return the content of metadata.yaml."""
    first = times.first or 0
    extent = {
        'duration': {'nanoseconds': times.last - first},
        'starting_time': {'nanoseconds_since_epoch': first},
        'message_count': times.count,
    }
    packed = compression in ('message', 'file')
    return {
        'version': METADATA_VERSION,
        'storage_identifier': storage,
        'relative_file_paths': [file],
        **extent,
        'compression_format': 'zstd' if packed else '',
        'compression_mode': compression.upper() if packed else '',
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': topic,
                    'type': IMU_TYPE,
                    'serialization_format': 'cdr',
                    'offered_qos_profiles': '',
                    'type_description_hash': IMU_HASH,
                },
                'message_count': times.count,
            }
        ],
        # copied, because YAML writes a reference for an object that occurs twice
        'files': [{'path': file, **copy.deepcopy(extent)}],
        'custom_data': None,
        'ros_distro': 'jazzy',
    }


Messages = Iterable[tuple[NDArray[np.int64], NDArray[Any] | list[bytes]]]


def _write_sqlite3(
    path: Path, messages: Messages, topic: str, metadata: Callable[[], str], _: object
) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.executescript('PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF;')
        connection.executescript(SQLITE_SCHEMA)
        connection.execute('INSERT INTO schema VALUES (4, ?)', ('jazzy',))
        row: tuple[object, ...] = (topic, IMU_TYPE, 'cdr', '', IMU_HASH)
        connection.execute('INSERT INTO topics VALUES (1, ?, ?, ?, ?, ?)', row)
        row = (IMU_TYPE, 'ros2msg', IMU_DEFINITION, IMU_HASH)
        connection.execute('INSERT INTO message_definitions VALUES (1, ?, ?, ?, ?)', row)
        insert = 'INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)'
        for record_ns, payloads in messages:
            blobs = payloads
            if isinstance(payloads, np.ndarray):
                blobs = payloads.view(np.dtype((np.void, payloads.itemsize))).tolist()
            connection.executemany(insert, zip(record_ns.tolist(), blobs))
        row = (METADATA_VERSION, metadata())
        connection.execute('INSERT INTO metadata VALUES (1, ?, ?)', row)


def _write_mcap(
    path: Path,
    messages: Messages,
    topic: str,
    metadata: Callable[[], str],
    compress: Callable[[bytes], bytes] | None,
) -> None:
    schema = _record(
        SCHEMA,
        struct.pack('<H', SCHEMA_ID) + _text(IMU_TYPE) + _text('ros2msg') + _text(IMU_DEFINITION),
    )
    qos = _text('offered_qos_profiles') + _text('')
    channel = _record(
        CHANNEL,
        struct.pack('<HH', CHANNEL_ID, SCHEMA_ID)
        + _text(topic)
        + _text('cdr')
        + struct.pack('<I', len(qos))
        + qos,
    )
    with path.open('wb') as file:
        file.write(MAGIC + _record(HEADER, _text('ros2') + _text('allan_ros')))
        listed: list[bytes] = []
        chunk = _Chunk(schema + channel)
        times = _TimeRange()
        for record_ns, payloads in messages:
            size = payloads.itemsize if isinstance(payloads, np.ndarray) else len(payloads[0])
            step = CHUNK_BYTES // size + 1
            for start in range(0, len(record_ns), step):
                part = record_ns[start : start + step]
                chunk.add(times.count, part, payloads[start : start + step])
                times.add(part)
                if len(chunk.data) > CHUNK_BYTES:
                    listed.append(_write_chunk(file, chunk, compress))
                    chunk = _Chunk()
        if chunk.times:
            listed.append(_write_chunk(file, chunk, compress))
        metadata_at = file.tell()
        name_and_map = _text('serialized_metadata') + _text(metadata())
        body = _text('rosbag2') + struct.pack('<I', len(name_and_map)) + name_and_map
        file.write(_record(METADATA, body))
        listed.append(
            _record(
                METADATA_INDEX,
                struct.pack('<QQ', metadata_at, file.tell() - metadata_at) + _text('rosbag2'),
            )
        )
        file.write(_record(DATA_END, struct.pack('<I', 0)))
        summary_at = file.tell()
        counts = struct.pack('<HQ', CHANNEL_ID, times.count)
        totals = times.count, 1, 1, 0, 1, len(listed) - 1, times.first or 0, times.last
        statistics = _record(STATISTICS, STATISTICS_HEAD.pack(*totals, len(counts)) + counts)
        file.write(schema + channel + b''.join(listed) + statistics)
        file.write(_record(FOOTER, struct.pack('<QQI', summary_at, 0, 0)) + MAGIC)


class _Chunk:
    """The content of an mcap chunk, and the recording time and offset of each of its messages."""

    def __init__(self, data: bytes = b'') -> None:
        self.data = bytearray(data)
        self.times: list[NDArray[np.int64]] = []
        self.offsets: list[NDArray[np.int64]] = []

    def add(
        self, first: int, record_ns: NDArray[np.int64], payloads: NDArray[Any] | list[bytes]
    ) -> None:
        """Add messages; ``first`` is the sequence number of the first one."""
        sequence = np.arange(first, first + len(record_ns)) & 0xFFFFFFFF
        if isinstance(payloads, np.ndarray):
            size = payloads.itemsize
            records = np.empty(len(payloads), [*HEAD.descr, ('payload', np.void, size)])
            records['opcode'], records['length'] = MESSAGE, MESSAGE_HEAD.size + size
            records['channel'], records['sequence'] = CHANNEL_ID, sequence
            records['log_time'] = records['publish_time'] = record_ns
            records['payload'] = payloads.view(np.dtype((np.void, size)))
            data, lengths = records.tobytes(), np.full(len(payloads), records.itemsize)
        else:
            parts = [
                _record(MESSAGE, MESSAGE_HEAD.pack(CHANNEL_ID, number, time, time) + payload)
                for number, time, payload in zip(sequence.tolist(), record_ns.tolist(), payloads)
            ]
            data, lengths = b''.join(parts), np.array(list(map(len, parts)))
        self.times.append(record_ns)
        self.offsets.append(len(self.data) + np.cumsum(lengths) - lengths)
        self.data += data


def _write_chunk(file: Any, chunk: _Chunk, compress: Callable[[bytes], bytes] | None) -> bytes:
    """Write an mcap chunk and its index, and return its record for the summary of the file."""
    inner = bytes(chunk.data)
    stored = compress(inner) if compress else inner
    name = _text('zstd' if compress else '')
    record_ns = np.concatenate(chunk.times)
    first, last = int(record_ns.min()), int(record_ns.max())
    head = CHUNK_HEAD.pack(first, last, len(inner), 0)  # without a checksum, for fast reading
    record = _record(CHUNK, head + name + struct.pack('<Q', len(stored)) + stored)
    pairs = np.stack([record_ns, np.concatenate(chunk.offsets)], axis=1).astype('<i8').tobytes()
    index = _record(MESSAGE_INDEX, INDEX_HEAD.pack(CHANNEL_ID, len(pairs)) + pairs)
    at = file.tell()
    file.write(record + index)
    where = struct.pack('<HQ', CHANNEL_ID, at + len(record))
    listed = CHUNK_INDEX_HEAD.pack(first, last, at, len(record), len(where)) + where
    sizes = struct.pack('<QQ', len(stored), len(inner))
    return _record(CHUNK_INDEX, listed + struct.pack('<Q', len(index)) + name + sizes)


def _record(opcode: int, body: bytes) -> bytes:
    return RECORD.pack(opcode, len(body)) + body


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack('<I', len(data)) + data
