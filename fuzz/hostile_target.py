# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Special files in place of recordings, and small files that expand to gigabytes."""

from __future__ import annotations

import os
import resource
import sqlite3
import struct
import zlib
from collections.abc import Callable
from contextlib import closing
from functools import lru_cache
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from .mcap_target import MAGIC, record
from .reading import BrokenRule, read_and_check, small_batch, write_bag

GROWTH_BYTES = 450 << 20
"""Memory that reading one of these may take: three chunks of the largest size."""

EXPANDED = (1 << 20, 100 << 20, 1 << 30, 16 << 30)
RLE_BYTES = 128 << 10
"""Largest block of a zstd frame (RFC 8878, section 3.1.1.2.4)."""

KINDS = ('fifo', 'folder', 'zero', 'full', 'tty', 'memory', 'loop', 'gone')
LINKS = {'zero': '/dev/zero', 'full': '/dev/full', 'tty': '/dev/tty', 'memory': '/proc/self/mem'}
PLACES = ['a/metadata.yaml', 'a/a.mcap', 'a.mcap', 'b/b.db3', 'b/b.db3-wal', 'c.csv', 'c.npz']
PLACES += ['c.npy', 'c.bag', 'c.ulg', 'c.mcap.zstd', 'c']


def zstd_frame(size: int, states_size: bool, byte: bytes = b'\0') -> bytes:
    """Return a frame of equal bytes, made of run-length blocks."""
    head = b'\xc0\x38' + struct.pack('<Q', size) if states_size else b'\0\x38'
    whole, rest = divmod(size, RLE_BYTES)
    blocks = (struct.pack('<I', RLE_BYTES << 3 | 2)[:3] + byte) * whole
    return b'\x28\xb5\x2f\xfd' + head + blocks + struct.pack('<I', rest << 3 | 3)[:3] + byte


@lru_cache(maxsize=8)
def packed(how: str, size: int) -> bytes:
    """Return compressed zeros; slow compressors get fewer."""
    if how == 'lz4':
        import lz4.frame

        return bytes(lz4.frame.compress(bytes(min(size, 300 << 20))))
    return zstd_frame(size, how == 'zstd stated')


@lru_cache(maxsize=1)
def deflated() -> bytes:
    """Return the array of an npz file with a header of half a gigabyte."""
    packer = zlib.compressobj(1, zlib.DEFLATED, -15)
    head = b'\x93NUMPY\x02\x00' + struct.pack('<I', 2**32 - 16)
    body = [packer.compress(head), *(packer.compress(bytes(1 << 24)) for _ in range(32))]
    return b''.join(body) + packer.flush()


@st.composite
def _inputs(draw: Any) -> tuple[Any, ...]:
    match draw(st.sampled_from(['special', 'mcap', 'messages', 'file', 'line', 'sparse'])):
        case 'special':
            return 'special', draw(st.sampled_from(KINDS)), draw(st.sampled_from(PLACES))
        case 'mcap':
            how = draw(st.sampled_from(['zstd', 'zstd stated', 'lz4']))
            size = draw(st.sampled_from(EXPANDED))
            stated = draw(st.sampled_from([size, size, 0, 1000, 2**63, 64 << 20]))
            return 'mcap', how, size, stated, draw(st.integers(1, 3))
        case 'messages':
            how = draw(st.sampled_from(['zstd', 'zstd stated']))
            return 'messages', how, draw(st.integers(1, 1 << 32) | st.sampled_from(EXPANDED))
        case 'file':
            suffix = draw(st.sampled_from(['.db3.zstd', '.mcap.zstd', '.zst', '.bag.zstd']))
            how = draw(st.sampled_from(['zstd', 'zstd stated', 'lz4']))
            return 'file', how, draw(st.sampled_from(EXPANDED[1:])), suffix
        case 'line':
            text = draw(st.sampled_from(['', 't,gx,gy,gz\n', 't,gx,gy,gz\n1,2,3,"', '"', '# ']))
            return 'line', text, draw(st.sampled_from(EXPANDED))
    suffix = draw(st.sampled_from(['.mcap', '.bag', '.db3', '.npy', '.ulg', '.npz', '.csv']))
    return 'sparse', suffix, draw(st.sampled_from(EXPANDED))


HEADS = {
    '.mcap': MAGIC + struct.pack('<BQ', 3, 1 << 33),
    '.bag': b'#ROSBAG V2.0\n' + struct.pack('<I', 1 << 19),
    '.db3': b'SQLite format 3\0',
    '.npy': b'\x93NUMPY\x02\x00' + struct.pack('<I', 2**32 - 16),
    '.ulg': b'ULog\x01\x12\x35\x01' + bytes(8) + struct.pack('<HB', 65535, ord('F')),
    '.npz': b'PK\x03\x04',
    '.csv': b't,gx,gy,gz\n1,2,3,4\n',
}


def _special(folder: Path, kind: str, place: str) -> Path:
    write_bag(folder / 'a', [small_batch(9)])
    write_bag(folder / 'b', [small_batch(9)], 'sqlite3')
    path = folder / place
    path.unlink(missing_ok=True)
    if kind == 'fifo':
        os.mkfifo(path)
    elif kind == 'folder':
        path.mkdir()
    elif kind != 'gone':
        path.symlink_to(LINKS.get(kind, path.name))
    return path.parent if path.parent != folder else path


def _messages(folder: Path, how: str, size: int) -> Path:
    write_bag(folder / 'b', [small_batch(9)], 'sqlite3', 'message')
    bomb = packed(how, size)
    with closing(sqlite3.connect(folder / 'b/b.db3')) as connection, connection:
        connection.execute('UPDATE messages SET data = ? WHERE id > 3', (bomb,))
    return folder / 'b'


def _mcap(folder: Path, how: str, size: int, stated: int, chunks: int) -> Path:
    data, name = packed(how, size), how.split()[0].encode()
    head = struct.pack('<QQQII', 0, 1, stated, 0, len(name)) + name + struct.pack('<Q', len(data))
    path = folder / 'a.mcap'
    path.write_bytes(MAGIC + record(6, head + data) * chunks + record(0x0F, bytes(4)))
    return path


def _file(folder: Path, how: str, size: int, suffix: str) -> Path:
    path = folder / f'a{suffix}'
    path.write_bytes(packed(how, size))
    return path


def _sparse(folder: Path, suffix: str, size: int) -> Path:
    path = folder / f'a{suffix}'
    with path.open('wb') as file:
        file.write(HEADS[suffix] + (deflated() if suffix == '.npz' else b''))
        file.truncate(max(size, file.tell()))
    return path


def _line(folder: Path, text: str, size: int) -> Path:
    path = folder / 'a.csv'
    with path.open('wb') as file:
        file.write(text.encode())
        file.truncate(size)
    return path


MAKE: dict[str, Callable[..., Path]] = {
    'special': _special,
    'mcap': _mcap,
    'messages': _messages,
    'file': _file,
    'line': _line,
    'sparse': _sparse,
}


def check(made: tuple[Any, ...], folder: Path) -> bool:
    """Read the file; raise if this takes more memory than allowed."""
    kind, *how = made
    path = MAKE[kind](folder, *how)
    before = _peak()
    valid = read_and_check(path)
    if _peak() - before > GROWTH_BYTES:
        raise BrokenRule(f'{(_peak() - before) >> 20} MB of memory')
    return valid


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


INPUTS = _inputs()
