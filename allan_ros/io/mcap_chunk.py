# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of one mcap chunk, taken as arrays where that is possible (https://mcap.dev/spec).

There are three ways, of which the first that fits is taken; all give the same messages:

- nothing but messages of one length: the chunk itself is an array of records;
- several topics: the MessageIndex records behind the chunk say where each message begins;
- no index, or one that does not match the chunk: record by record.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .bag_storage import Block, Payloads, among, gathered

MESSAGE, MESSAGE_INDEX = 0x05, 0x07
RECORD = struct.Struct('<BQ')
"""Opcode and length in front of every record."""
MESSAGE_HEAD = struct.Struct('<HIQQ')
"""Channel, sequence, log time, publish time."""
INDEX_HEAD = struct.Struct('<HI')
"""Channel, and bytes of the pairs (log time, offset) that follow."""
HEAD = np.dtype(
    [('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'), ('sequence', '<u4')]
    + [('log_time', '<i8'), ('publish_time', '<u8')]
)
"""A message record up to its payload."""
MOST_GAPS = 64
"""Stretches of a chunk that hold other records than messages: beyond, walking is as fast."""


def chunk_messages(data: bytes, ids: set[int], index: Callable[[], bytes] = bytes) -> Block:
    """Return the messages of these channels in the order of the chunk.

    Parameters
    ----------
    data : bytes
        The records of the chunk, decompressed; or a run of records outside of chunks.
    index : callable
        Reads the MessageIndex records that belong to it, empty where there are none.

    Raises
    ------
    struct.error
        When a record is longer than what holds it.
    """
    return _uniform(data, ids) or _by_index(data, ids, index()) or _one_by_one(data, ids)


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, first byte and end of each record."""
    at, size = 0, len(data)
    while at + RECORD.size <= size:
        opcode, length = RECORD.unpack_from(data, at)
        start = at + RECORD.size
        at = start + length
        if at > size:
            raise struct.error('a record is longer than what holds it')
        yield opcode, start, at


def _uniform(data: bytes, ids: Collection[int]) -> Block | None:
    """Take the messages of a chunk as one array, if behind its first all are of one length."""
    found = next((record for record in records(data) if record[0] == MESSAGE), None)
    if found is None:
        return None
    _, start, end = found
    first, length = start - RECORD.size, end - start
    dtype = _message_dtype(length)
    if dtype is None or (len(data) - first) % dtype.itemsize:
        return None
    messages = np.frombuffer(data, dtype, offset=first)
    if (messages['opcode'] != MESSAGE).any() or (messages['length'] != length).any():
        return None
    mine = among(messages['channel'], ids)
    if not mine.all():
        messages = messages[mine]
    return Block(messages['log_time'].astype(np.int64), messages['payload'])


def _by_index(data: bytes, ids: Collection[int], index: bytes) -> Block | None:
    """Take the messages from where the index says they are; None if that is not true."""
    start = np.sort(_offsets(index))
    if not len(start) or start[0] < 0 or start[-1] > len(data) - HEAD.itemsize:
        return None
    head = gathered(data, start, HEAD)
    end = start + (RECORD.size + head['length'].astype(np.int64))
    if (head['opcode'] != MESSAGE).any() or (head['length'] < MESSAGE_HEAD.size).any():
        return None
    # The index is complete if what lies between its messages holds no other.
    before, behind = np.append(0, end), np.append(start, len(data))
    gaps = np.flatnonzero(before != behind)
    if (before > behind).any() or len(gaps) > MOST_GAPS:
        return None
    for gap in gaps:
        between = data[before[gap] : behind[gap]]
        if any(opcode == MESSAGE for opcode, _, _ in records(between)):
            return None
    mine = among(head['channel'], ids)
    head, start, end = head[mine], start[mine], end[mine]
    return Block(head['log_time'].astype(np.int64), _payloads(data, start, end))


def _offsets(index: bytes) -> NDArray[np.int64]:
    """Return where the messages of all channels begin in the chunk, by its index."""
    found = [np.empty(0, np.int64)]
    for opcode, at, _ in records(index):
        if opcode == MESSAGE_INDEX:
            _, size = INDEX_HEAD.unpack_from(index, at)
            pairs = np.frombuffer(index, '<i8', size // 8, at + INDEX_HEAD.size)
            found.append(pairs.reshape(-1, 2)[:, 1].astype(np.int64))
    return np.concatenate(found)


def _payloads(data: bytes, start: NDArray[np.int64], end: NDArray[np.int64]) -> Payloads:
    """Return the payloads of message records: one array where they are of one length."""
    lengths = end - start
    if len(lengths) and (lengths == lengths[0]).all():
        dtype = _message_dtype(int(lengths[0]) - RECORD.size)
        if dtype is not None:
            return gathered(data, start, dtype)['payload']
    view, head = memoryview(data), HEAD.itemsize
    return [view[a + head : b] for a, b in zip(start.tolist(), end.tolist())]


@lru_cache(maxsize=64)
def _message_dtype(length: int) -> np.dtype[np.void] | None:
    """Return the layout of message records of that length, or None when they hold nothing."""
    if length <= MESSAGE_HEAD.size:
        return None
    return np.dtype([*HEAD.descr, ('payload', np.void, length - MESSAGE_HEAD.size)])


def _one_by_one(data: bytes, ids: Collection[int]) -> Block:
    """Take the messages of a chunk, whatever their lengths."""
    view = memoryview(data)
    times: list[int] = []
    payloads: list[bytes | memoryview] = []
    for opcode, start, end in records(data):
        if opcode == MESSAGE:
            channel, _, log_time, _ = MESSAGE_HEAD.unpack_from(data, start)
            if channel in ids:
                times.append(log_time)
                payloads.append(view[start + MESSAGE_HEAD.size : end])
    return Block(np.array(times, dtype=np.int64), payloads)
