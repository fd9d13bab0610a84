# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of `AllanSums` to a plain document (dicts, lists, numbers, strings) and back.

The same document is used in checkpoints, in ``sums.json`` and on the topic ``~/sums``. Because it
may be damaged, the reader checks all lengths and bounds, and that the fields are consistent.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..fields import MAX_INTEGER, Fields
from ..imu import AXES, LARGEST, MAX_NAME, ImuIdentity
from .grid import FIRST_FACTORS, LEVEL_FACTORS, MAX_LEVELS, SAMPLE_OCTAVES, bins_up_to, octave
from .periods import (
    KEPT_SEGMENTS,
    MAX_MEANS,
    MAX_PERIODS,
    MEAN_BYTES,
    SUM_BYTES,
    BlockMeans,
    Period,
    Recording,
    totals,
)
from .sums import LONGEST_FILLED, AllanSums, length_class

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SUMS_SCHEMA = 'allan_ros/sums/2'
"""Name and version of the document format; the reader rejects any other."""

MAX_FACTORS = len(FIRST_FACTORS) + len(LEVEL_FACTORS) * MAX_LEVELS
"""Largest accepted number of averaging factors; more would require centuries of samples."""

MAX_OCTAVES = SAMPLE_OCTAVES + MAX_LEVELS
"""Largest accepted number of octaves."""

MAX_CLASSES = 500
"""Largest accepted number of length classes; class 500 has segments of 1.1^500 = 5e20 samples."""

MAX_SUM = 1e80
"""Largest accepted sum of squares. A fit uses its fourth power, which must not overflow."""

MAX_PERIOD_NS = 10**13
"""Longest accepted sample period in ns, nearly three hours."""

PERIOD_TOLERANCE = 1e-4
"""Largest relative difference between the total of the periods and the sums of the recordings; the
sums of periods are rounded to 21 significant bits at each addition."""


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
        'lengths': [list(pair) for pair in sums.lengths],
        **({'filled': sums.filled.tolist()} if len(sums.filled) else {}),
        'recordings': [_recording_to_document(r) for r in sums.recordings],
    }


def _recording_to_document(recording: Recording) -> dict[str, Any]:
    """Return a recording; the arrays of all periods are joined, which compresses better."""
    periods = recording.periods

    def joined(key: str, size: int) -> str:
        return _packed(np.concatenate([getattr(p, key) for p in periods]), size)

    return {
        'age': periods[0].begin,
        'reference': recording.reference.tolist(),
        'samples': [p.samples for p in periods],
        'begin_ns': [p.begin_ns for p in periods],
        'interpolated': [p.interpolated for p in periods],
        'total': [p.total.tolist() for p in periods],
        'factors': [len(p.count) for p in periods],
        'octaves': [len(p.blocks) for p in periods],
        **{key: joined(key, 8) for key in ('count', 'blocks', 'pairs')},
        **{key: joined(key, SUM_BYTES) for key in ('sum_sq', 'power')},
        'means': [
            {
                'age': m.age,
                'start_ns': m.start_ns,
                'samples': m.samples,
                'step': m.step,
                'values': _packed(m.values, MEAN_BYTES),
            }
            for m in recording.means
        ],
    }


def _packed(values: NDArray[Any], size: int) -> str:
    """Return an array as 'z<size>:' and its zlib-compressed bytes in base64.

    ``size`` is the number of bytes per number: 8 for int64, 4 or 5 for the upper bytes of a
    little-endian float64, of which the others are 0 (`rounded`). The bytes are transposed: first
    byte 0 of all numbers, then byte 1, and so on, which compresses better.
    """
    kind = '<f8' if values.dtype.kind == 'f' else '<i8'
    data = np.ascontiguousarray(values, kind).view(np.uint8).reshape(-1, 8)[:, 8 - size :]
    return f'z{size}:' + base64.b64encode(zlib.compress(data.T.tobytes(), 9)).decode('ascii')


def _unpacked(fields: Fields, key: str, size: int, number: int) -> NDArray[Any]:
    """Return the ``number`` numbers in a text of `_packed`: float64, or int64 if size is 8."""
    where = f'{fields.where}.{key}'
    text = fields.text(key, longest=12 * number + 100)
    if not text.startswith(f'z{size}:'):
        raise AllanError(f'{where} begins with {text[:3]!r}: {f"z{size}:"!r} is expected')
    try:
        data = base64.b64decode(text[3:], validate=True)
        stream = zlib.decompressobj()
        planes = np.frombuffer(stream.decompress(data, size * number + 1), np.uint8)
    except (ValueError, zlib.error) as error:
        raise AllanError(f'{where} cannot be unpacked: {error!r}') from error
    if not stream.eof or len(planes) != size * number:
        raise AllanError(f'{where} does not have the expected {number} numbers')
    full = np.zeros((number, 8), np.uint8)
    full[:, 8 - size :] = planes.reshape(size, number).T
    return full.view('<i8' if size == 8 else '<f8').reshape(number)


def _packed_floats(
    fields: Fields, key: str, size: int, rows: int, columns: int, least: float, most: float
) -> Floats:
    """Return a packed table, (rows, columns), of numbers from ``least`` to ``most``."""
    values = _unpacked(fields, key, size, rows * columns).astype(float)
    if not np.all((least <= values) & (values <= most)):  # this also excludes NaN
        raise AllanError(f'{fields.where}.{key}: numbers from {least:g} to {most:g} are expected')
    return values.reshape(rows, columns)


def _packed_counts(fields: Fields, key: str, number: int) -> Ints:
    values = _unpacked(fields, key, 8, number).astype(np.int64)
    if np.any((values < 0) | (values >= MAX_INTEGER // MAX_PERIODS)):
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
    n, width = len(top.sequence('count', MAX_FACTORS)), len(axes)
    lengths = [_whole(pair, 2, f'{where}.lengths') for pair in top.sequence('lengths', MAX_CLASSES)]
    sums = AllanSums(
        ImuIdentity(*(top.text(key, longest=MAX_NAME) for key in ('frame_id', 'hardware_id'))),
        axes,
        top.integers('count', n),
        _table(top, 'sum_sq', n, width),
        top.integers('group_count', n),
        _table(top, 'group_sum_sq', n, width),
        top.integer('elapsed_ns', least=0),
        top.integer('intervals', least=0),
        tuple(_recording(f, width, n) for f in top.each('recordings', MAX_PERIODS)),
        tuple((samples, number) for samples, number in lengths),
        _filled(top, width) if 'filled' in top else np.zeros((0, 0), np.int64),
    )
    if not np.array_equal(top.integers('m', n), sums.m):
        raise AllanError(f'{where}.m is not the grid of this version: accumulate the data again')
    _check_lengths(sums, where)
    _check_recordings(sums, where)
    return sums


def _check_lengths(sums: AllanSums, where: str) -> None:
    """Raise `AllanError` if the lengths of the segments contradict each other or the counts."""
    for samples, number in sums.lengths:
        if not 1 <= number <= samples < MAX_INTEGER:
            raise AllanError(f'{where}.lengths: {samples} samples in {number} segments')
    classes = [length_class(samples / number) for samples, number in sums.lengths]
    if classes != sorted(set(classes)):
        raise AllanError(f'{where}.lengths: the lengths are expected to increase by classes')
    if sums.samples >= MAX_INTEGER or sums.intervals != sums.samples - sums.segment_count:
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
    most = sums.samples // sums.stride + sums.segment_count
    if np.any(sums.count > most) or np.any(sums.group_count > sums.count):
        raise AllanError(f'{where}.count differs from the lengths: the file is damaged')


def _check_recordings(sums: AllanSums, where: str) -> None:
    """Raise `AllanError` if the periods do not add up to the sums."""
    periods, means = sums.periods, [m for r in sums.recordings for m in r.means]
    if len(periods) > MAX_PERIODS or len({m.step for m in means}) > 1:
        raise AllanError(f'{where}.recordings: too many periods, or different steps of the means')
    if len(means) > KEPT_SEGMENTS or sum(len(m.values) for m in means) > MAX_MEANS:
        raise AllanError(f'{where}.recordings: too many means')
    if sum(p.samples for p in periods) != sums.samples:
        raise AllanError(f'{where}.recordings: the samples do not add up: the file is damaged')
    count = totals([np.zeros_like(sums.count), *(p.count for p in periods)])
    total = totals([np.zeros_like(sums.sum_sq), *(p.sum_sq for p in periods)])
    near = np.abs(total - sums.sum_sq) <= PERIOD_TOLERANCE * sums.sum_sq
    if not np.array_equal(count, sums.count) or not near.all():
        raise AllanError(f'{where}.recordings: the periods do not add up: the file is damaged')


def _table(fields: Fields, key: str, rows: int, columns: int) -> Floats:
    """Return a table of numbers from 0 to `MAX_SUM`."""
    values = fields.table(key, rows, columns, least=0.0)
    if np.any(values > MAX_SUM):
        raise AllanError(
            f'{fields.where}.{key} is above {MAX_SUM:g}: too large for samples of an IMU'
        )
    return values


def _filled(fields: Fields, axes: int) -> Ints:
    """Return the number of interpolated gaps of each length, (lengths, axes)."""
    rows = len(fields.sequence('filled', LONGEST_FILLED))
    values = fields.table('filled', rows, axes, least=0.0)
    if np.any(values >= MAX_INTEGER) or np.any(values % 1.0):
        raise AllanError(f'{fields.where}.filled is expected to be a table of whole numbers')
    return values.astype(np.int64)


def _whole(values: object, number: int, where: str) -> list[int]:
    """Return a list of ``number`` whole numbers of 0 or above."""
    found = values if isinstance(values, list) else []
    if len(found) != number or not all(type(v) is int and 0 <= v < MAX_INTEGER for v in found):
        raise AllanError(f'{where}: {number} whole numbers, 0 or above, are expected')
    return found


def _recording(fields: Fields, axes: int, factors: int) -> Recording:
    number = len(fields.sequence('samples', MAX_PERIODS))
    samples, of_factors, of_octaves, interpolated = (
        fields.integers(key, number) for key in ('samples', 'factors', 'octaves', 'interpolated')
    )
    age, begin_ns = fields.integer('age', least=0), fields.sequence('begin_ns', number)
    if not number or np.any((samples < 1) | (interpolated > samples)):
        raise AllanError(f'{fields.where}.samples: at least one in each period is expected')
    if len(begin_ns) != number or not all(
        type(ns) is int and abs(ns) < MAX_INTEGER for ns in begin_ns
    ):
        raise AllanError(f'{fields.where}.begin_ns: {number} whole numbers are expected')
    if age + sum(samples.tolist()) >= MAX_INTEGER:
        raise AllanError(f'{fields.where}.samples are too many')
    if np.any(of_factors > factors) or np.any(of_octaves > MAX_OCTAVES):
        raise AllanError(f'{fields.where}: too many factors or octaves')
    total = fields.table('total', number, axes)
    reference = fields.numbers('reference')
    if len(reference) != axes or not np.all(np.abs(reference) <= LARGEST):
        raise AllanError(f'{fields.where}.reference: {axes} numbers are expected')
    if np.any(np.abs(total) > 2.0 * LARGEST * samples[:, None]):
        raise AllanError(f'{fields.where}.total is too large for the samples')
    rows, octaves = int(of_factors.sum()), int(of_octaves.sum())
    of_bins = np.array([bins_up_to(n) for n in of_octaves.tolist()], int)
    split = [np.cumsum(n)[:-1] for n in (of_factors, of_octaves, of_bins)]
    blocks, pairs = (_packed_counts(fields, key, octaves) for key in ('blocks', 'pairs'))

    def squares(key: str, number: int) -> Floats:
        return _packed_floats(fields, key, SUM_BYTES, number, axes, 0.0, MAX_SUM)

    columns = zip(
        (age + np.cumsum(samples) - samples).tolist(),
        samples.tolist(),
        begin_ns,
        np.split(_packed_counts(fields, 'count', rows), split[0]),
        np.split(squares('sum_sq', rows), split[0]),
        np.split(blocks, split[1]),
        np.split(pairs, split[1]),
        np.split(squares('power', int(of_bins.sum())), split[2]),
        total,
        interpolated.tolist(),
    )
    periods = tuple(Period(*column) for column in columns)
    _check_blocks(periods, fields.where)
    means = tuple(_means(f, axes, periods) for f in fields.each('means', KEPT_SEGMENTS))
    return Recording(periods, means, reference)


def _check_blocks(periods: tuple[Period, ...], where: str) -> None:
    """Raise `AllanError` if there are more spectral blocks than the samples can have."""
    blocks, pairs = (totals(getattr(p, key) for p in periods) for key in ('blocks', 'pairs'))
    for o, number in enumerate(blocks.tolist()):
        if number * octave(o).length // 2 > periods[-1].end or pairs[o] > number:
            raise AllanError(f'{where}.blocks: too many for the samples')


def _means(fields: Fields, axes: int, periods: tuple[Period, ...]) -> BlockMeans:
    step, samples = fields.integer('step', least=1), fields.integer('samples', least=1)
    age = fields.integer('age', least=periods[0].begin)
    if step & (step - 1):
        raise AllanError(f'{fields.where}.step is {step}: a power of two is expected')
    if age + samples > periods[-1].end or samples // step > MAX_MEANS:
        raise AllanError(f'{fields.where}.samples is {samples}: too many')
    limit = 2.0 * LARGEST
    values = _packed_floats(fields, 'values', MEAN_BYTES, samples // step, axes, -limit, limit)
    return BlockMeans(age, fields.integer('start_ns'), samples, step, values)
