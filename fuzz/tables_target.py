# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged tables (CSV, TSV, text) and numpy files (npy, npz)."""

from __future__ import annotations

import io
import tempfile
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from allan_ros.readers import ReadOptions
from allan_ros.readers.writing import write_table

from .damage import any_bytes, signed, texts
from .reading import read_and_check, small_batch

HEADERS = ['t,gx,gy,gz,ax,ay,az', 'stamp_ns;gyro_x;gyro_y;gyro_z', 'sec,nanosec,wx,wy,wz', '"']
HEADERS += ['Time [ms]\tax [g]\tay [g]\taz [g]', 't [fortnights],gx,gy,gz', 'gx,gy,gz', 'gx,gx']
CELLS = ['0', '1e308', '-1e308', '1e309', 'nan', 'inf', '-inf', '', ' ', '1e999999', '-1e-999999']
CELLS += ['1_000', '٣', '0x10', '"', '"a\nb"', '9' * 400, '1e19', '--1', 'é', '\0', "'", '1,5']
KINDS = ('<f8', '>f4', '<i8', '<u8', '<u1', '<f2', '<c16', '|O', '|S3', '<U4', '|V8', '<f16', '?')


@lru_cache(maxsize=2)
def _array(deflate: bool = False) -> bytes:
    out, batch = io.BytesIO(), small_batch()
    imu = np.column_stack([batch.stamps_ns * 1e-9, batch.samples])
    save = np.savez_compressed if deflate else np.savez
    save(out, imu=imu, stamps_ns=batch.stamps_ns, frame_id=np.array('imu'))
    return out.getvalue()


@lru_cache(maxsize=1)
def _table() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, 'seed.csv')
        write_table(path, [small_batch(12)])
        return path.read_bytes()


@st.composite
def _csv(draw: Any) -> bytes:
    """Draw a table with odd cells and an odd header."""
    header = draw(st.sampled_from(HEADERS) | texts)
    mark = draw(st.sampled_from(',;\t '))
    width = draw(st.integers(1, 8))
    cell = st.sampled_from(CELLS) | signed.map(str) | st.floats().map(repr)
    row = st.lists(cell, min_size=width, max_size=width).map(mark.join)
    rows = draw(st.lists(row, max_size=6))
    comment = draw(st.sampled_from(['', '# frame_id: a\n', '# t gx\n', '#', '\ufeff']))
    end = draw(st.sampled_from(['\n', '\r\n', '\r', '\n\n']))
    text: str = comment + end.join([header, *rows]) + end
    return text.encode('utf-8', 'surrogatepass')


def _header(kind: str, fortran: str, shape: str) -> bytes:
    """Return the header of an npy file with any content."""
    text = f"{{'descr': {kind}, 'fortran_order': {fortran}, 'shape': {shape}, }}\n".encode()
    return b'\x93NUMPY\x01\x00' + len(text).to_bytes(2, 'little') + text


@st.composite
def _npy(draw: Any) -> bytes:
    """Draw an npy file whose header does not match its data."""
    kind = draw(st.sampled_from(KINDS).map(repr) | st.just("[('a', '<f8')]") | texts.map(repr))
    number = signed | st.integers(0, 8)
    shape = draw(
        st.lists(number, max_size=3).map(lambda n: repr(tuple(n)))
        | number.map(lambda n: f'({n}, 7)')
        | st.sampled_from(['[7, 7]', '()', '(True, 7)', '(1e3, 7)', '(' * 300 + ')' * 300, '(7,'])
    )
    fortran = draw(st.sampled_from(['False', 'True', 'None', '1']))
    data: bytes = draw(st.binary(max_size=400))
    return _header(kind, fortran, shape) + data


@st.composite
def _npz(draw: Any) -> bytes:
    """Draw a zip archive of npy files, some of them odd."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, 'w', draw(st.sampled_from([0, 8]))) as archive:
        for name in ('imu', 'stamps_ns', 'record_ns', 'frame_id'):
            if draw(st.integers(0, 3)) or name == 'imu':
                whole = io.BytesIO()
                rows = draw(st.integers(0, 5))
                np.save(whole, np.zeros((rows, 7) if name == 'imu' else rows, '<f8'))
                archive.writestr(f'{name}.npy', draw(st.just(whole.getvalue()) | _npy()))
    return out.getvalue()


@st.composite
def _files(draw: Any) -> tuple[str, bytes]:
    match draw(st.sampled_from(['csv', 'csv', 'table', 'npy', 'npz', 'seed'])):
        case 'csv':
            return draw(st.sampled_from(['a.csv', 'a.tsv', 'a.txt'])), draw(_csv())
        case 'table':
            return 'a.csv', draw(any_bytes([_table()]))
        case 'npy':
            return 'a.npy', draw(_npy())
        case 'npz':
            return 'a.npz', draw(_npz())
    return 'a.npz', draw(any_bytes([_array(), _array(True)]))


def check(made: tuple[str, bytes], folder: Path) -> bool:
    """Read the file, with and without a rate."""
    name, data = made
    path = folder / name
    path.write_bytes(data)
    options = ReadOptions(rate_hz=100.0, stamp_unit='us', gyro_unit='deg/s')
    return read_and_check(path) | read_and_check(path, options)


INPUTS = _files()
