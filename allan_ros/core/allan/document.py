# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`AllanSums` as a plain document (dicts, lists, numbers, strings) and back, without loss.

The same document is the checkpoint, ``sums.json`` and the payload of the sums topic. The document
is not trusted: the reader checks every length and bound, and the consistency of the parts.
"""

from __future__ import annotations

import base64
import dataclasses
import math
import zlib
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..fields import MAX_INTEGER, Fields
from ..imu import AXES, MAX_NAME, ImuIdentity
from .engine import PHASE_POINTS
from .history import (
    CELLS,
    FIRST_EDGE,
    KEPT_RECORDINGS,
    AgeBin,
    History,
    Recording,
    add_padded,
    age_bin,
    edge_age,
    short,
)
from .sums import (
    FIRST_FACTORS,
    KEPT_SEGMENTS,
    LEVEL_FACTORS,
    LONGEST_FILLED,
    MAX_LEVELS,
    AllanSums,
    LengthClass,
    SegmentRecord,
    counts,
    grid_for,
)

SUMS_SCHEMA = 'allan_ros/sums/1'
"""Name and version of the document; the reader rejects any other."""

MAX_FACTORS = len(FIRST_FACTORS) + len(LEVEL_FACTORS) * MAX_LEVELS
"""Largest number of averaging factors: more would be centuries of samples."""

MAX_CLASSES = 500
"""Largest number of length classes: 1.1^500 is 5e20 samples."""

MAX_BINS = 120
"""Largest number of bins by age: the last edge is at 2^66 samples."""

MOST_PERIODS = 1024
"""Largest number of periods: a recording of 2^60 samples has about 300."""

MAX_SUM = 1e80
"""Largest sum of squares; the covariance in a fit uses its fourth power."""

MAX_PERIOD_NS = 10**13
"""Longest sample period, nearly three hours."""

SAME = 1e-4
"""Largest relative difference of the sums by age, added up, from the sums."""


def sums_to_document(sums: AllanSums) -> dict[str, Any]:
    """Return the sums as a document; floats survive a round trip through JSON unchanged."""
    tables = ('m', 'count', 'sum_sq', 'group_count', 'group_sum_sq')
    return {
        'schema': SUMS_SCHEMA,
        'frame_id': sums.identity.frame_id,
        'hardware_id': sums.identity.hardware_id,
        'axes': list(sums.axes),
        'elapsed_ns': int(sums.elapsed_ns),
        'intervals': int(sums.intervals),
        **{key: getattr(sums, key).tolist() for key in tables},
        'segments': [_plain(s) for s in sums.segments],
        'classes': [_plain(c) for c in sums.classes],
        **({'filled': sums.filled.tolist()} if len(sums.filled) else {}),
        **({'history': _history_to_document(sums.history)} if sums.history.recordings else {}),
    }


def _plain(values: Any) -> dict[str, Any]:
    """Return a dataclass of whole numbers and arrays as a dict with lists of numbers."""
    found = {f.name: getattr(values, f.name) for f in dataclasses.fields(values)}
    return {k: v.tolist() if isinstance(v, np.ndarray) else int(v) for k, v in found.items()}


def _history_to_document(history: History) -> dict[str, Any]:
    return {
        'first_age': edge_age(history.first),
        'recording_count': history.recording_count,
        'bins': [
            {
                'age': edge_age(b.index),
                'count': _packed(b.count),
                'sum_sq': _packed(b.sum_sq),
                **({'pooled': [list(p) for p in b.pooled]} if b.pooled else {}),
                **({'ramp_correction': b.ramp.tolist()} if len(b.ramp) else {}),
            }
            for b in history.bins
        ],
        'recordings': [
            _plain(r) | {key: _packed(getattr(r, key)) for key in PACKED}
            for r in history.recordings
        ],
    }


PACKED = ('cell_samples', 'cell_means', 'period_begin', 'level_count', 'level_sum_sq')
"""Arrays of a recording that are stored as text."""


def _packed(values: NDArray[Any]) -> str:
    """Return an array as text: its numbers in little-endian bytes, byte by byte, compressed.

    Floats are shortened by `history.short` to the upper half of double precision. The base64 text
    begins with 'z4:' (floats) or 'z8:' (whole numbers), the number of bytes per number.
    """
    kind, size = ('<f8', 4) if values.dtype.kind == 'f' else ('<i8', 8)
    data = np.ascontiguousarray(values, kind).view(np.uint8).reshape(-1, 8)[:, 8 - size :]
    return f'z{size}:' + base64.b64encode(zlib.compress(data.T.tobytes(), 9)).decode('ascii')


def _unpacked(fields: Fields, key: str, most: int, former: str) -> NDArray[Any]:
    """Return the at most ``most`` numbers of a packed text.

    Texts of earlier versions are not compressed; their numbers have the type ``former``.
    """
    where = f'{fields.where}.{key}'
    kind, _, coded = fields.text(key, longest=12 * most + 100).rpartition(':')
    try:
        data = base64.b64decode(coded, validate=True)
        if not kind:
            return np.frombuffer(data, former)
        size = {'z4': 4, 'z8': 8}[kind]
        stream = zlib.decompressobj()
        planes = np.frombuffer(stream.decompress(data, size * most + 1), np.uint8)
        full = np.zeros((len(planes) // size, 8), np.uint8)
        full[:, 8 - size :] = planes.reshape(size, -1).T
    except (ValueError, KeyError, zlib.error) as error:
        raise AllanError(f'{where} cannot be unpacked: {error!r}') from error
    if not stream.eof:
        raise AllanError(f'{where} is cut off, or has more than {most} numbers')
    return full.view('<f8' if kind == 'z4' else '<i8').ravel()


def _floats(
    fields: Fields, key: str, former: str, shape: tuple[int, ...], least: float = -MAX_SUM
) -> NDArray[np.float64]:
    """Return the array of a packed text."""
    values = _unpacked(fields, key, math.prod(shape), former).astype(float)
    if values.size != math.prod(shape):
        raise AllanError(f'{fields.where}.{key} has {values.size} numbers: {shape} are expected')
    if not np.all((least <= values) & (values <= MAX_SUM)):  # this also excludes NaN
        raise AllanError(f'{fields.where}.{key} is not from {least:g} to {MAX_SUM:g}')
    return short(values).reshape(shape)


def _integers(fields: Fields, key: str, most: int) -> NDArray[np.int64]:
    """Return whole numbers of 0 or above, packed or, in earlier versions, as a list."""
    if isinstance(fields.value(key), list):
        return fields.integers(key, len(fields.sequence(key, most)))
    values = _unpacked(fields, key, most, '<i8').astype(np.int64)
    if np.any((values < 0) | (values >= MAX_INTEGER)):
        raise AllanError(f'{fields.where}.{key}: whole numbers of 0 or above are expected')
    return values


def sums_from_document(document: object, where: str = 'sums') -> AllanSums:
    """Return the sums of a document.

    Raises
    ------
    AllanError
        When the document has another version, or when a field is missing, has a wrong type or
        shape, is not finite, exceeds its bounds, or contradicts other fields.
    """
    top = Fields(document, where)
    top.schema(SUMS_SCHEMA)
    axes = tuple(top.sequence('axes', len(AXES)))
    if not axes or axes != tuple(a for a in AXES if a in axes):
        raise AllanError(
            f'{where}.axes is {axes!r:.80}: some of {", ".join(AXES)} are expected, in order'
        )
    n = len(top.sequence('count', MAX_FACTORS))
    width = len(axes)
    sums = AllanSums(
        ImuIdentity(*(top.text(key, longest=MAX_NAME) for key in ('frame_id', 'hardware_id'))),
        axes,
        top.integers('count', n),
        _table(top, 'sum_sq', n, width, 0.0),
        top.integers('group_count', n),
        _table(top, 'group_sum_sq', n, width, 0.0),
        tuple(_segment(f, width, n) for f in top.each('segments', KEPT_SEGMENTS)),
        tuple(_length_class(f, width, n) for f in top.each('classes', MAX_CLASSES)),
        top.integer('elapsed_ns', least=0),
        top.integer('intervals', least=0),
        _history(top.fields('history'), width, n) if 'history' in top else History(),
        _filled(top, width) if 'filled' in top else np.zeros((0, 0), np.int64),
    )
    if not np.array_equal(top.integers('m', n), sums.m):
        raise AllanError(f'{where}.m is not the grid of this version: accumulate the data again')
    _check(sums, where)
    return sums


def _check(sums: AllanSums, where: str) -> None:
    """Raise `AllanError` naming a part of the sums that contradicts the others."""
    if sums.intervals != sums.samples - sums.segment_count:
        raise AllanError(
            f'{where}.intervals is {sums.intervals}: {sums.samples} samples in '
            f'{sums.segment_count} segments have {sums.samples - sums.segment_count}'
        )
    longest_ns = sums.intervals * MAX_PERIOD_NS
    if not sums.intervals <= sums.elapsed_ns <= longest_ns:
        raise AllanError(
            f'{where}.elapsed_ns is {sums.elapsed_ns}: {sums.intervals} sample periods take from '
            f'{sums.intervals} to {longest_ns} ns'
        )
    lengths = np.arange(1, len(sums.filled) + 1)
    if np.any(lengths @ sums.filled > sums.samples):
        raise AllanError(f'{where}.filled has more samples than the segments: the file is damaged')
    m, stride, none = sums.m, sums.stride, np.zeros_like(sums.count)
    pooled = sums.count - sum((counts(s.samples, m, stride) for s in sums.segments), none)
    most = sum((c.samples // stride + c.count for c in sums.classes), none)
    if np.any(pooled < 0) or np.any(pooled > most):
        raise AllanError(
            f'{where}.count differs from the segments and length classes: the file is damaged'
        )
    if np.any(sums.group_count > sums.count):
        raise AllanError(f'{where}.group_count exceeds count: the file is damaged')
    bins = sums.history.bins
    if bins:
        number = reduce(add_padded, (b.count for b in bins), none)
        total = reduce(add_padded, (b.sum_sq for b in bins), np.zeros_like(sums.sum_sq))
        near = np.abs(total - sums.sum_sq) <= SAME * sums.sum_sq
        if not np.array_equal(number, sums.count) or not near.all():
            raise AllanError(f'{where}.history does not add up to the sums: the file is damaged')


def _table(
    fields: Fields,
    key: str,
    rows: int,
    columns: int,
    least: float = -MAX_SUM,
    most: float = MAX_SUM,
) -> NDArray[np.float64]:
    """Return a table of numbers in the range of an IMU."""
    values = fields.table(key, rows, columns, least=max(least, -most))
    if np.any(values > most):
        raise AllanError(f'{fields.where}.{key} is above {most:g}: too large for samples of an IMU')
    return values


def _filled(fields: Fields, axes: int) -> NDArray[np.int64]:
    """Return the numbers of filled gaps by length."""
    rows = len(fields.sequence('filled', LONGEST_FILLED))
    values = fields.table('filled', rows, axes, least=0.0)
    if np.any(values >= MAX_INTEGER) or np.any(values % 1.0):
        raise AllanError(f'{fields.where}.filled is expected to be a table of whole numbers')
    return values.astype(np.int64)


def _power_of_two(fields: Fields, key: str) -> int:
    value = fields.integer(key, least=1)
    if value & (value - 1):
        raise AllanError(f'{fields.where}.{key} is {value}: a power of two is expected')
    return value


def _segment(fields: Fields, axes: int, factors: int) -> SegmentRecord:
    step, samples = _power_of_two(fields, 'phase_step'), fields.integer('samples', least=1)
    signed = len(grid_for(samples)[0])
    if signed > factors or samples // step >= PHASE_POINTS:
        raise AllanError(
            f'{fields.where}.samples is {samples}: too many for {factors} factors or for phase '
            f'points {step} samples apart'
        )
    return SegmentRecord(
        fields.integer('start_ns'),
        samples,
        _table(fields, 'signed', signed, axes, most=MAX_SUM**0.5),
        _table(fields, 'phase', samples // step + 1, axes, most=MAX_SUM**0.5),
        step,
        fields.integer('age', 0, least=0),
    )


def _length_class(fields: Fields, axes: int, factors: int) -> LengthClass:
    rows = len(fields.sequence('ramp_correction', factors))
    count, samples = fields.integer('count', least=1), fields.integer('samples', least=1)
    if not count <= samples or len(grid_for(samples // count)[0]) > factors:
        raise AllanError(
            f'{fields.where}.samples is {samples}, in {count} segments of at most {factors} factors'
        )
    ramp = _table(fields, 'ramp_correction', rows, axes)
    return LengthClass(fields.integer('index', least=0), count, samples, ramp)


def _history(fields: Fields, axes: int, factors: int) -> History:
    bins = tuple(_age_bin(f, axes, factors) for f in fields.each('bins', MAX_BINS))
    if [b.index for b in bins] != sorted({b.index for b in bins}):
        raise AllanError(f'{fields.where}.bins: the ages must increase')
    recordings = tuple(_recording(f, axes) for f in fields.each('recordings', KEPT_RECORDINGS))
    first = age_bin(fields.integer('first_age', least=FIRST_EDGE))
    return History(first, bins, recordings, fields.integer('recording_count', least=1))


def _age_bin(fields: Fields, axes: int, factors: int) -> AgeBin:
    age = fields.integer('age', least=0)
    if edge_age(age_bin(age)) != age:
        raise AllanError(f'{fields.where}.age is {age}: not an edge between two bins')
    count = _integers(fields, 'count', factors)
    pooled = fields.sequence('pooled', MAX_CLASSES) if 'pooled' in fields else []
    for each in pooled:
        if (
            not isinstance(each, list)
            or len(each) != 3
            or not all(type(v) is int and 0 <= v < MAX_INTEGER for v in each)
        ):
            raise AllanError(f'{fields.where}.pooled: each entry must be three whole numbers')
    ramp = np.zeros((0, axes))
    if 'ramp_correction' in fields:
        rows = len(fields.sequence('ramp_correction', factors))
        ramp = _table(fields, 'ramp_correction', rows, axes)
    return AgeBin(
        age_bin(age),
        count,
        _floats(fields, 'sum_sq', '<f8', (len(count), axes), 0.0),
        tuple((each[0], each[1], each[2]) for each in pooled),
        ramp,
    )


def _recording(fields: Fields, axes: int) -> Recording:
    step = _power_of_two(fields, 'step')
    samples = fields.integer('samples', least=1)
    length = fields.integer('length', least=samples)
    number = _integers(fields, 'cell_samples', CELLS)
    cells = len(number)
    begins, count = _period_counts(fields, length)
    if len(fields.sequence('reference', axes)) != axes:
        raise AllanError(f'{fields.where}.reference: {axes} numbers are expected')
    if np.any(number > step) or cells * step > length + step:
        raise AllanError(f'{fields.where}: the cells do not fit the length of {length}')
    return Recording(
        fields.integer('start_ns'),
        length,
        samples,
        step,
        number,
        _floats(fields, 'cell_means', '<f4', (cells, axes)),
        fields.numbers('reference'),
        begins,
        count,
        _floats(fields, 'level_sum_sq', '<f4', (*count.shape, axes), 0.0),
    )


def _period_counts(fields: Fields, length: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the ages at which periods begin, and the counts (periods, levels) in them."""
    if 'period' in fields:  # earlier versions had periods of equal length
        rows = fields.sequence('level_count', MOST_PERIODS)
        levels = len(rows[0]) if rows and isinstance(rows[0], list) else 0
        count = fields.table('level_count', len(rows), levels, least=0.0).astype(np.int64)
        begins = np.arange(len(rows)) * _power_of_two(fields, 'period')
    else:
        begins = _integers(fields, 'period_begin', MOST_PERIODS)
        count = _integers(fields, 'level_count', MOST_PERIODS * MAX_LEVELS)
        levels = len(count) // max(len(begins), 1)
        if levels * len(begins) != len(count):
            raise AllanError(f'{fields.where}.level_count: {len(begins)} rows are expected')
        count = count.reshape(len(begins), levels)
    if levels > MAX_LEVELS or np.any(np.diff(begins, append=length + 1) <= 0):
        raise AllanError(f'{fields.where}: the periods do not fit the length of {length}')
    return begins, count
