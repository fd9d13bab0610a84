# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of `AllanSums` to a plain document (dicts, lists, numbers, strings) and back.

The same document is used in checkpoints, in ``sums.json`` and on the topic ``~/sums``. Because it
may be damaged, the reader checks all lengths and bounds, and that the fields are consistent.
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
    round_to_stored,
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
"""Name and version of the document format; the reader rejects any other."""

MAX_FACTORS = len(FIRST_FACTORS) + len(LEVEL_FACTORS) * MAX_LEVELS
"""Largest accepted number of averaging factors; more would require centuries of samples."""

MAX_CLASSES = 500
"""Largest accepted number of length classes; class 500 has segments of 1.1^500 = 5e20 samples."""

MAX_BINS = 120
"""Largest accepted number of bins by age; the last of them begins at 2^66 samples."""

MAX_PERIODS = 1024
"""Largest accepted number of periods; a recording of 2^60 samples has about 300."""

MAX_SUM = 1e80
"""Largest accepted sum of squares. A fit uses its fourth power, which must not overflow."""

MAX_PERIOD_NS = 10**13
"""Longest accepted sample period in ns, nearly three hours."""

HISTORY_TOLERANCE = 1e-4
"""Largest relative difference between the total of the sums by age and the sums of the recording;
the sums by age are rounded to 16 significant bits."""


def sums_to_document(sums: AllanSums) -> dict[str, Any]:
    """Return the sums as a JSON-compatible dict, from which `sums_from_document` restores them."""
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
    """Return the fields of a dataclass (integers and arrays) as integers and lists."""
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
"""Arrays of a `Recording` that are stored as compressed text."""


def _packed(values: NDArray[Any]) -> str:
    """Return an array as 'z4:' (floats) or 'z8:' (integers) and its zlib-compressed base64 bytes.

    The digit is the number of bytes per number. Of the little-endian float64, only the upper 4
    bytes are stored: `round_to_stored` sets the others to 0. The bytes are transposed: first byte 0
    of all numbers, then byte 1, and so on, which compresses better.
    """
    kind, size = ('<f8', 4) if values.dtype.kind == 'f' else ('<i8', 8)
    data = np.ascontiguousarray(values, kind).view(np.uint8).reshape(-1, 8)[:, 8 - size :]
    return f'z{size}:' + base64.b64encode(zlib.compress(data.T.tobytes(), 9)).decode('ascii')


def _unpacked(fields: Fields, key: str, kind: str, most: int) -> NDArray[Any]:
    """Return the array from a text of `_packed`, up to ``most`` numbers; kind is 'z4' or 'z8'."""
    where, size = f'{fields.where}.{key}', int(kind[1])
    text = fields.text(key, longest=12 * most + 100)
    if not text.startswith(f'{kind}:'):
        raise AllanError(f'{where} begins with {text[:3]!r}: {kind!r} is expected')
    try:
        data = base64.b64decode(text[3:], validate=True)
        stream = zlib.decompressobj()
        planes = np.frombuffer(stream.decompress(data, size * most + 1), np.uint8)
        full = np.zeros((len(planes) // size, 8), np.uint8)
        full[:, 8 - size :] = planes.reshape(size, -1).T
    except (ValueError, zlib.error) as error:
        raise AllanError(f'{where} cannot be unpacked: {error!r}') from error
    if not stream.eof:
        raise AllanError(f'{where} is truncated, or has more than {most} numbers')
    return full.view('<f8' if kind == 'z4' else '<i8').ravel()


def _packed_floats(
    fields: Fields, key: str, shape: tuple[int, ...], least: float = -MAX_SUM
) -> NDArray[np.float64]:
    values = _unpacked(fields, key, 'z4', math.prod(shape)).astype(float)
    if values.size != math.prod(shape):
        raise AllanError(f'{fields.where}.{key} has {values.size} numbers: {shape} are expected')
    if not np.all((least <= values) & (values <= MAX_SUM)):  # this also excludes NaN
        raise AllanError(
            f'{fields.where}.{key}: numbers from {least:g} to {MAX_SUM:g} are expected'
        )
    return round_to_stored(values).reshape(shape)


def _packed_counts(fields: Fields, key: str, most: int) -> NDArray[np.int64]:
    values = _unpacked(fields, key, 'z8', most).astype(np.int64)
    if np.any((values < 0) | (values >= MAX_INTEGER)):
        raise AllanError(f'{fields.where}.{key}: whole numbers of 0 or above are expected')
    return values


def sums_from_document(document: object, where: str = 'sums') -> AllanSums:
    """Return the sums from a dict of `sums_to_document`; ``where`` is its name in error messages.

    Raises
    ------
    AllanError
        If the document has another version, or a field is missing, has a wrong type or shape, is
        not finite, exceeds its bounds, or contradicts other fields.
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
    _check_consistency(sums, where)
    return sums


def _check_consistency(sums: AllanSums, where: str) -> None:
    """Raise `AllanError` if fields of the sums contradict each other; the message names one."""
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
        near = np.abs(total - sums.sum_sq) <= HISTORY_TOLERANCE * sums.sum_sq
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
    """Return the table of a field; its numbers must be from ``least`` to ``most``."""
    values = fields.table(key, rows, columns, least=max(least, -most))
    if np.any(values > most):
        raise AllanError(f'{fields.where}.{key} is above {most:g}: too large for samples of an IMU')
    return values


def _filled(fields: Fields, axes: int) -> NDArray[np.int64]:
    """Return the number of interpolated gaps of each length, (lengths, axes)."""
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
    count = _packed_counts(fields, 'count', factors)
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
        _packed_floats(fields, 'sum_sq', (len(count), axes), 0.0),
        tuple((each[0], each[1], each[2]) for each in pooled),
        ramp,
    )


def _recording(fields: Fields, axes: int) -> Recording:
    step = _power_of_two(fields, 'step')
    samples = fields.integer('samples', least=1)
    length = fields.integer('length', least=samples)
    number = _packed_counts(fields, 'cell_samples', CELLS)
    cells = len(number)
    begins = _packed_counts(fields, 'period_begin', MAX_PERIODS)
    count = _packed_counts(fields, 'level_count', MAX_PERIODS * MAX_LEVELS)
    levels = len(count) // max(len(begins), 1)
    if levels * len(begins) != len(count):
        raise AllanError(f'{fields.where}.level_count: {len(begins)} rows are expected')
    if levels > MAX_LEVELS or np.any(np.diff(begins, append=length + 1) <= 0):
        raise AllanError(f'{fields.where}: the periods do not fit the length of {length}')
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
        _packed_floats(fields, 'cell_means', (cells, axes)),
        fields.numbers('reference'),
        begins,
        count.reshape(len(begins), levels),
        _packed_floats(fields, 'level_sum_sq', (len(begins), levels, axes), 0.0),
    )
