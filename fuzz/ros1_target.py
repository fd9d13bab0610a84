# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS 1 bags (https://wiki.ros.org/Bags/Format/2.0) with damage in chosen fields."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from .damage import any_bytes, integers, texts
from .harness import Target
from .reading import MESSAGES, PERIOD_NS, START_NS, payloads, read_and_check

MAGIC = b'#ROSBAG V2.0\n'
CHUNKS = 2
FIELDS = (
    'op',
    'conn',
    'time',
    'topic',
    'compression',
    'size',
    'type',
    'message_definition',
    'count',
)
SECOND = 10**9


@dataclass
class Damage:
    """Changes of an intact bag; ``fields`` maps (opcode, field) to bytes, or to None to omit it."""

    fields: dict[tuple[int, str], bytes | None] = field(default_factory=dict)
    message: bytes | None = None
    compression: str = 'none'
    index: bool = True
    connection: bool = True


def _record(damage: Damage, opcode: int, data: bytes, **fields: bytes) -> bytes:
    """Return a record with this opcode, data and header fields."""
    pairs = {'op': bytes([opcode]), **fields}
    pairs.update({name: v for (code, name), v in damage.fields.items() if code == opcode and v})
    gone = {name for (code, name), v in damage.fields.items() if code == opcode and v is None}
    head = b''.join(
        struct.pack('<I', len(name) + 1 + len(value)) + name.encode() + b'=' + value
        for name, value in pairs.items()
        if name not in gone
    )
    return struct.pack('<I', len(head)) + head + struct.pack('<I', len(data)) + data


def _time(ns: int) -> bytes:
    return struct.pack('<II', *divmod(ns, SECOND))


def build(damage: Damage) -> bytes:
    """Return a bag with these changes."""
    one = struct.pack('<I', 0)
    described = _fields(
        topic=b'/imu',
        type=damage.fields.get((7, 'type')) or b'sensor_msgs/Imu',
        md5sum=b'*',
        message_definition=damage.fields.get((7, 'message_definition')) or b'Header header\n',
    )
    connection = _record(damage, 7, described, conn=one, topic=b'/imu')
    out = MAGIC + _record(damage, 3, b' ' * 64, index_pos=bytes(8), conn_count=one, chunk_count=one)
    imus = payloads('ros1')
    each = MESSAGES // CHUNKS
    for number in range(CHUNKS):
        inner, entries = connection if damage.connection else b'', b''
        for i in range(number * each, (number + 1) * each):
            stamp = _time(START_NS + i * PERIOD_NS)
            entries += stamp + struct.pack('<I', len(inner))
            body = damage.message if damage.message is not None and i % each == 3 else imus[i]
            inner += _record(damage, 2, body, conn=one, time=stamp)
        data = bz2.compress(inner) if damage.compression == 'bz2' else inner
        size = struct.pack('<I', len(inner))
        out += _record(damage, 5, data, compression=damage.compression.encode(), size=size)
        if damage.index:
            count = struct.pack('<I', each)
            out += _record(damage, 4, entries, ver=count, conn=one, count=count)
    return out + (connection if damage.index else b'')


def _fields(**fields: bytes) -> bytes:
    return b''.join(
        struct.pack('<I', len(name) + 1 + len(value)) + name.encode() + b'=' + value
        for name, value in fields.items()
    )


def boundaries(data: bytes) -> Iterator[int]:
    """Yield the offset of each record of an intact bag, in uncompressed chunks too."""
    at = len(MAGIC)
    while at + 8 <= len(data):
        yield at
        (head,) = struct.unpack_from('<I', data, at)
        (length,) = struct.unpack_from('<I', data, at + 4 + head)
        is_chunk = b'op=\x05' in data[at : at + 4 + head]
        at += 8 + head + (0 if is_chunk else length)
    yield len(data)


@lru_cache(maxsize=1)
def seeds() -> tuple[bytes, ...]:
    """Return intact bags of every form."""
    return (build(Damage()), build(Damage(index=False)), build(Damage(compression='bz2')))


@st.composite
def _bags(draw: Any) -> bytes:
    if not draw(st.integers(0, 2)):
        damaged: bytes = draw(any_bytes(seeds()))
        return damaged
    values = (
        st.none()
        | st.binary(max_size=12)
        | integers.map(lambda i: struct.pack('<Q', i)[:4])
        | texts.map(lambda text: text.encode('utf-8', 'surrogatepass'))
    )
    keys = st.tuples(st.sampled_from([2, 3, 4, 5, 7]), st.sampled_from(FIELDS))
    return build(
        Damage(
            draw(st.dictionaries(keys, values, max_size=3)),
            draw(st.none() | any_bytes(payloads('ros1', 2))),
            draw(st.sampled_from(['none', 'none', 'bz2', 'lz4', 'x\n'])),
            draw(st.booleans()),
            draw(st.integers(0, 3)) > 0,
        )
    )


def check(data: bytes, folder: Path) -> bool:
    """Read the bag."""
    path = folder / 'run.bag'
    path.write_bytes(data)
    return read_and_check(path)


TARGET = Target('ros1', _bags(), check)
