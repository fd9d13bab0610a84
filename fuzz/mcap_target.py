# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""mcap files (https://mcap.dev/spec) with wrong values in some fields.

All other lengths, offsets, checksums and indexes are correct, so that the first checks of a reader
succeed, and the later code is tested, too.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from .damage import any_bytes, integers, texts
from .reading import MESSAGES, PERIOD_NS, START_NS, payloads, read_and_check

MAGIC = b'\x89MCAP0\r\n'
IMU_TYPE = 'sensor_msgs/msg/Imu'


@dataclass(frozen=True)
class Plan:
    """The content of a file. A field that is None or () is written correctly."""

    chunks: int = 2
    compression: str = ''
    loose: tuple[int, ...] = ()  # chunks whose messages are written outside chunks
    summary: bool = True
    checksum: bool = False
    channels: int = 1  # of the topic, in which its messages alternate
    encoding: str = 'cdr'
    topic: str = '/imu'
    type: str = IMU_TYPE
    message: bytes | None = None
    log_time: int | None = None
    channel: int | None = None
    chunk_head: tuple[int | None, ...] = (None,) * 4
    stored_bytes: int | None = None
    index_offset: int | None = None
    chunk_index: tuple[int | None, ...] = (None,) * 5
    summary_start: int | None = None
    counted: int | None = None


def record(opcode: int, body: bytes) -> bytes:
    """Return a record with its opcode and length."""
    return struct.pack('<BQ', opcode, len(body)) + body


def _text(text: str) -> bytes:
    data = text.encode('utf-8', 'surrogatepass')
    return struct.pack('<I', len(data)) + data


def _number(form: str, value: int) -> bytes:
    return struct.pack(form, value % (1 << (8 * struct.calcsize(form))))


def _or(value: int | None, otherwise: int) -> int:
    return otherwise if value is None else value


def build(plan: Plan) -> bytes:
    """Return the file of a plan."""
    schema = record(3, _number('<H', 1) + _text(plan.type) + _text('ros2msg') + _text(''))
    channel = b''.join(
        record(4, struct.pack('<HH', n, 1) + _text(plan.topic) + _text(encoding) + _text(''))
        for n, encoding in ((1, plan.encoding), (2, f'{plan.encoding}1'))[: plan.channels]
    )
    out = MAGIC + record(1, _text('ros2') + _text('fuzz')) + schema + channel
    indexes = []
    each = MESSAGES // plan.chunks
    imus = payloads('ros1' if plan.encoding == 'ros1' else 'cdr')
    for number in range(plan.chunks):
        times = [START_NS + i * PERIOD_NS for i in range(number * each, (number + 1) * each)]
        inner, offsets = b'', []
        for i, time_ns in enumerate(times):
            is_odd = i == each // 2
            logged = _or(plan.log_time, time_ns) if is_odd else time_ns
            to = _or(plan.channel, 1) if is_odd else 1 + i % plan.channels
            body = imus[number * each + i]
            if is_odd and plan.message is not None:
                body = plan.message
            offsets.append((logged, len(inner)))
            head = _number('<H', to) + _number('<I', i) + _number('<Q', logged)
            inner += record(5, head + _number('<Q', time_ns) + body)
        if number in plan.loose:
            out += inner
            continue
        stored = _compressed(inner, plan.compression)
        fields = zip(plan.chunk_head, (times[0], times[-1], len(inner), zlib.crc32(inner)))
        forms = ('<Q', '<Q', '<Q', '<I')
        head = b''.join(_number(form, _or(odd, right)) for form, (odd, right) in zip(forms, fields))
        head += _text(plan.compression) + _number('<Q', _or(plan.stored_bytes, len(stored)))
        chunk = record(6, head + stored)
        pairs = b''.join(_number('<Q', t) + _number('<Q', o) for t, o in offsets)
        if plan.index_offset is not None:
            pairs = pairs[:-8] + _number('<Q', plan.index_offset)
        index = record(7, struct.pack('<HI', 1, len(pairs)) + pairs)
        right = (times[0], times[-1], len(out), len(chunk), 0)
        listed_forms = ('<Q', '<Q', '<Q', '<Q', '<I')
        body = b''.join(
            _number(form, _or(odd, r))
            for form, odd, r in zip(listed_forms, plan.chunk_index, right)
        )
        body += struct.pack('<Q', len(index)) + _text(plan.compression)
        indexes.append(record(8, body + struct.pack('<QQ', len(stored), len(inner))))
        out += chunk + index
    out += record(0x0F, struct.pack('<I', 0))
    if not plan.summary:
        return out + record(2, struct.pack('<QQI', 0, 0, 0)) + MAGIC
    start = len(out)
    total = _or(plan.counted, MESSAGES) % 2**64
    counted = b''.join(
        struct.pack('<HQ', n, total // plan.channels) for n in range(1, plan.channels + 1)
    )
    numbers = MESSAGES, 1, plan.channels, 0, 0, len(indexes), 0, 0, len(counted)
    out += schema + channel + b''.join(indexes)
    out += record(0x0B, struct.pack('<QHIIIIQQI', *numbers) + counted)
    footer = struct.pack('<BQ', 2, 20) + _number('<Q', _or(plan.summary_start, start)) + bytes(8)
    checksum = zlib.crc32(out[start:] + footer) if plan.checksum else 0
    return out + footer + struct.pack('<I', checksum) + MAGIC


def _compressed(data: bytes, how: str) -> bytes:
    if how == 'zstd':
        import zstandard

        return bytes(zstandard.ZstdCompressor().compress(data))
    if how == 'lz4':
        import lz4.frame

        return bytes(lz4.frame.compress(data))
    return data


def boundaries(data: bytes) -> Iterator[int]:
    """Yield the offset of each record of an intact file, in uncompressed chunks too."""
    at = len(MAGIC)
    while at + 9 <= len(data):
        yield at
        opcode, length = struct.unpack_from('<BQ', data, at)
        if opcode == 6:
            (named,) = struct.unpack_from('<I', data, at + 9 + 28)
            inner = at + 9 + 28 + 4 + named + 8
            while inner + 9 <= at + 9 + length:
                yield inner
                inner += 9 + struct.unpack_from('<Q', data, inner + 1)[0]
        at += 9 + length
    yield len(data)


@lru_cache(maxsize=1)
def seeds() -> tuple[bytes, ...]:
    """Return intact files of every form."""
    plans = (
        Plan(),
        Plan(summary=False),
        Plan(loose=(0, 1), summary=False),
        Plan(compression='zstd', loose=(1,)),
        Plan(compression='lz4', summary=False),
    )
    return tuple(map(build, plans))


@st.composite
def _planned(draw: Any) -> bytes:
    """Draw a file with at most three damaged fields."""
    plan = Plan(
        chunks=draw(st.sampled_from([1, 2, 4])),
        compression=draw(st.sampled_from(['', '', 'zstd', 'lz4'])),
        loose=draw(st.sampled_from([(), (), (), (0,), (0, 1, 2, 3)])),
        summary=draw(st.booleans()),
    )
    odd: dict[str, Any] = {
        'message': any_bytes(payloads('cdr', 2)),
        'log_time': integers,
        'channel': st.integers(0, 3),
        'chunk_head': st.tuples(*[st.none() | integers] * 4),
        'stored_bytes': integers,
        'index_offset': integers,
        'chunk_index': st.tuples(*[st.none() | integers] * 5),
        'summary_start': integers,
        'counted': integers,
        'encoding': texts | st.sampled_from(['ros1', 'json']),
        'topic': texts,
        'type': texts | st.sampled_from(['a/b', 'a/msg/B', 'sensor_msgs/Imu']),
    }
    chosen = draw(st.lists(st.sampled_from(list(odd)), max_size=3, unique=True))
    return build(replace(plan, **{name: draw(odd[name]) for name in chosen}))


@st.composite
def _files(draw: Any) -> bytes:
    data: bytes = draw(_planned() if draw(st.integers(0, 2)) else any_bytes(seeds()))
    return data


def check(data: bytes, folder: Path) -> bool:
    """Read the file."""
    path = folder / 'bag.mcap'
    path.write_bytes(data)
    return read_and_check(path)


INPUTS = _files()
