# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of `AllanSums` to a document of dicts, lists, numbers and strings, and back.

The same document is used in checkpoints, in ``sums.json`` and on the topic ``~/sums``. Because a
document may be damaged, it contains a checksum, and the reader checks all lengths and bounds.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..fields import MAX_INTEGER, Fields
from ..imu import AXES, LARGEST, MAX_NAME, ImuIdentity
from .grid import FIRST_FACTORS, LEVEL_FACTORS, MAX_LEVELS, SAMPLE_OCTAVES, bins_up_to
from .periods import KEPT_SEGMENTS, MAX_MEANS, MAX_PERIODS, BlockMeans, Period, RecordedPeriods
from .sums import AllanSums

Ints = NDArray[np.int64]

SUMS_SCHEMA = 'allan_ros/sums/5'
"""Name and version of the document format; the reader rejects other formats."""

MAX_FACTORS = len(FIRST_FACTORS) + len(LEVEL_FACTORS) * MAX_LEVELS
"""Largest accepted number of averaging factors; more would require centuries of samples."""

MAX_OCTAVES = SAMPLE_OCTAVES + MAX_LEVELS
"""Largest accepted number of octaves."""

MAX_CLASSES = 500
"""Largest accepted number of length classes; class 500 has segments of 1.1^500 = 5e20 samples."""

MAX_STRETCHES = 10_000
"""Largest accepted number of rows in the table of stretches of replaced samples."""

MAX_SUM = 1e80
"""Largest accepted sum of squares. A fit computes the third power of a sum, which must not
overflow."""

TEXT_KEYS = ('frame_id', 'hardware_id', 'checksum')
"""Keys that the checksum does not cover. A name that is not UTF-8 is written with escapes, which
would change the checksum."""


def sums_to_document(sums: AllanSums) -> dict[str, Any]:
    """Return Allan sums as a JSON-compatible dict; `sums_from_document` restores the sums."""
    tables = ('m', 'count', 'sum_sq', 'group_count', 'group_sum_sq', 'replaced')
    document = {
        'schema': SUMS_SCHEMA,
        'frame_id': sums.identity.frame_id,
        'hardware_id': sums.identity.hardware_id,
        'axes': list(sums.axes),
        'elapsed_ns': int(sums.elapsed_ns),
        'intervals': int(sums.intervals),
        'lengths': [list(pair) for pair in sums.lengths],
        **{key: getattr(sums, key).tolist() for key in tables},
        'recordings': [_recording_to_document(r, len(sums.m)) for r in sums.recordings],
    }
    return {**document, 'checksum': checksum_of(document)}


def checksum_of(document: Mapping[str, Any]) -> str:
    """Return the checksum of a document without its `TEXT_KEYS`, as 16 hex digits."""
    covered_values = {key: value for key, value in document.items() if key not in TEXT_KEYS}
    text = json.dumps(covered_values, sort_keys=True, separators=(',', ':'))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _recording_to_document(recording: RecordedPeriods, factors: int) -> dict[str, Any]:
    """Return the periods and block means of a recording as a JSON-compatible dict.

    Each quantity of the periods is stored as one array for all periods, because one array
    compresses better than many.
    """
    periods = recording.periods
    octaves = max(len(p.blocks) for p in periods)
    row_counts = {'count': factors, 'sum_sq': factors, 'blocks': octaves, 'pairs': octaves}
    row_counts['power'] = bins_up_to(octaves)
    keys_without_rows = ('samples', 'begin_ns', 'interpolated', 'total')
    return {
        'age': periods[0].begin,
        'periods': len(periods),
        'octaves': octaves,
        'reference': _packed(recording.reference),
        **{key: _packed(np.array([getattr(p, key) for p in periods])) for key in keys_without_rows},
        **{
            key: _packed(_padded([getattr(p, key) for p in periods], n))
            for key, n in row_counts.items()
        },
        'means': [
            {
                'age': m.age,
                'start_ns': m.start_ns,
                'samples': m.samples,
                'step': m.step,
                'values': _packed(m.values),
            }
            for m in recording.means
        ],
    }


def _padded(arrays: Sequence[NDArray[Any]], rows: int) -> NDArray[Any]:
    """Return arrays of different lengths as one array, (arrays, rows, ...), padded with zeros."""
    padded_arrays = np.zeros((len(arrays), rows, *arrays[0].shape[1:]), arrays[0].dtype)
    for row, array in zip(padded_arrays, arrays):
        row[: len(array)] = array
    return padded_arrays


def _packed(values: NDArray[Any]) -> str:
    """Return an array of int64 or float64 as zlib-compressed bytes in base64.

    The least significant bytes of all numbers come first, then the second least significant bytes
    of all numbers, and so on. This order compresses better, in particular if the least significant
    bytes are 0 (see `rounded`).
    """
    dtype = '<f8' if values.dtype.kind == 'f' else '<i8'
    data = np.ascontiguousarray(values, dtype).view(np.uint8).reshape(-1, 8)
    return base64.b64encode(zlib.compress(data.T.tobytes(), 9)).decode('ascii')


def _array(fields: Fields, key: str, shape: tuple[int, ...], least: Any, most: Any) -> NDArray[Any]:
    """Return an array that was written by `_packed`, with numbers from ``least`` to ``most``.

    The numbers are float64 if ``least`` is a float or an array of floats, else int64.
    """
    location, number = f'{fields.where}.{key}', math.prod(shape)
    text = fields.text(key, longest=12 * number + 100)
    try:
        decompressor = zlib.decompressobj()
        data = decompressor.decompress(base64.b64decode(text, validate=True), 8 * number + 1)
    except (ValueError, zlib.error) as error:
        raise AllanError(f'{location} cannot be unpacked: {error!r}') from error
    if not decompressor.eof or len(data) != 8 * number:
        raise AllanError(f'{location} does not have the expected {number} numbers')
    dtype = '<f8' if np.asarray(least).dtype.kind == 'f' else '<i8'
    bytes_by_place = np.frombuffer(data, np.uint8).reshape(8, number)
    values = np.ascontiguousarray(bytes_by_place.T).view(dtype).reshape(shape)
    if not np.all((least <= values) & (values <= most)):  # NaN is not in the range, either
        raise AllanError(f'{location} has numbers outside of the expected range')
    return values.astype(dtype[1:])


def sums_from_document(document: object, where: str = 'sums') -> AllanSums:
    """Return the Allan sums from a dict that `sums_to_document` has returned.

    The dict may have been written to JSON and read again. ``where`` is the name of the document in
    error messages.

    Raises
    ------
    AllanError
        If the document has another version or a wrong checksum, or if a field is missing, has a
        wrong type or shape, is not finite, or exceeds its bounds.
    """
    fields = Fields(document, where)
    fields.schema(SUMS_SCHEMA)
    if isinstance(document, dict) and fields.text('checksum') != checksum_of(document):
        raise AllanError(
            f'{where} is damaged (its checksum is wrong): accumulate the data again, or use a copy'
        )
    axes = tuple(fields.sequence('axes', len(AXES)))
    if not axes or axes != tuple(a for a in AXES if a in axes):
        raise AllanError(
            f'{where}.axes is {axes!r:.80}: give some of {", ".join(AXES)}, in this order'
        )
    factor_count, axis_count = len(fields.sequence('count', MAX_FACTORS)), len(axes)
    replaced = _whole_table(fields, 'replaced', MAX_STRETCHES, 2 + axis_count)
    sums = AllanSums(
        ImuIdentity(*(fields.text(key, longest=MAX_NAME) for key in ('frame_id', 'hardware_id'))),
        axes,
        fields.integers('count', factor_count),
        fields.table('sum_sq', factor_count, axis_count, least=0.0),
        fields.integers('group_count', factor_count),
        fields.table('group_sum_sq', factor_count, axis_count, least=0.0),
        fields.integer('elapsed_ns', least=0),
        fields.integer('intervals', least=0),
        tuple(
            _recording(recording, factor_count, axis_count)
            for recording in fields.each('recordings', MAX_PERIODS)
        ),
        tuple((a, b) for a, b in _whole_table(fields, 'lengths', MAX_CLASSES, 2).tolist()),
        replaced,
    )
    if not np.array_equal(fields.integers('m', factor_count), sums.m):
        raise AllanError(
            f'{where}.m has other averaging factors than this version: accumulate the data again'
        )
    if max(sums.sum_sq.max(initial=0.0), sums.group_sum_sq.max(initial=0.0)) > MAX_SUM:
        raise AllanError(f'{where}.sum_sq is above {MAX_SUM:g}: too large for samples of an IMU')
    if not all(1 <= number <= samples for samples, number in sums.lengths):
        raise AllanError(f'{where}.lengths has a segment without samples')
    if sums.samples >= MAX_INTEGER:
        raise AllanError(f'{where}.lengths has too many samples')
    return sums


def _whole_table(fields: Fields, key: str, most: int, columns: int) -> Ints:
    """Return a table, (rows, columns), of whole numbers of 0 or above; at most ``most`` rows."""
    values = fields.table(key, len(fields.sequence(key, most)), columns, least=0.0)
    if np.any(values >= MAX_INTEGER) or np.any(values % 1.0):
        raise AllanError(f'{fields.where}.{key} is expected to be a table of whole numbers')
    return values.astype(np.int64)


def _recording(fields: Fields, factors: int, axes: int) -> RecordedPeriods:
    age, octaves = fields.integer('age', least=0), fields.integer('octaves', least=0)
    n, largest_count = fields.integer('periods', least=1), MAX_INTEGER // MAX_PERIODS
    if n > MAX_PERIODS or octaves > MAX_OCTAVES:
        raise AllanError(f'{fields.where} has too many periods or octaves')
    reference = _array(fields, 'reference', (axes,), -LARGEST, LARGEST)
    samples = _array(fields, 'samples', (n,), 1, largest_count)
    if age + int(samples.sum()) >= MAX_INTEGER:
        raise AllanError(f'{fields.where}.samples contains too many samples')
    limit = 2.0 * LARGEST * samples[:, None]
    columns = zip(
        (age + np.cumsum(samples) - samples).tolist(),
        samples.tolist(),
        _array(fields, 'begin_ns', (n,), -MAX_INTEGER, MAX_INTEGER).tolist(),
        _array(fields, 'count', (n, factors), 0, largest_count),
        _array(fields, 'sum_sq', (n, factors, axes), 0.0, MAX_SUM),
        _array(fields, 'blocks', (n, octaves), 0, largest_count),
        _array(fields, 'pairs', (n, octaves), 0, largest_count),
        _array(fields, 'power', (n, bins_up_to(octaves), axes), 0.0, MAX_SUM),
        _array(fields, 'total', (n, axes), -limit, limit),
        _array(fields, 'interpolated', (n,), 0, samples).tolist(),
    )
    periods = tuple(Period(*column).stored() for column in columns)
    means = tuple(_means(f, axes) for f in fields.each('means', KEPT_SEGMENTS))
    return RecordedPeriods(periods, means, reference)


def _means(fields: Fields, axes: int) -> BlockMeans:
    step, samples = fields.integer('step', least=1), fields.integer('samples', least=1)
    age = fields.integer('age', least=0)
    if step & (step - 1):
        raise AllanError(f'{fields.where}.step is {step}: a power of two is expected')
    if samples // step > MAX_MEANS:
        raise AllanError(f'{fields.where}.samples is {samples}: too many')
    limit = 2.0 * LARGEST
    values = _array(fields, 'values', (samples // step, axes), -limit, limit)
    return BlockMeans(age, fields.integer('start_ns'), samples, step, values)
