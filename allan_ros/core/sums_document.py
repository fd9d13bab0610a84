# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`AllanSums` as a plain document (dicts, lists, numbers, strings) and back, without loss.

The same document is the checkpoint, ``sums.json`` and the payload of the sums topic, so it may come
from a stranger: reading is strict and bounded, and never trusts a length.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .batch import AXES
from .cascade import PHASE_POINTS
from .errors import AllanError
from .grid import FIRST_FACTORS, LEVEL_FACTORS, MAX_LEVELS
from .sums import KEPT_SEGMENTS, AllanSums, ImuIdentity, LengthClass, SegmentRecord

SUMS_SCHEMA = 'allan_ros/sums/1'
"""Name and version of the document; a reader refuses any other."""

MAX_FACTORS = len(FIRST_FACTORS) + len(LEVEL_FACTORS) * MAX_LEVELS
"""More factors than that are centuries of samples."""

MAX_CLASSES = 500
"""1.1^500 is 5e20 samples: no stream has a longer segment."""

MAX_INTEGER = 2**62
"""Counts and stamps stay below this, so that sums of two fit 64 bits."""

MAX_FLOAT = float(np.finfo(float).max)
"""No finite float64 is beyond this, either way."""

MAX_TEXT = 1000
"""Longest frame_id or hardware id."""

Floats = NDArray[np.float64]


def sums_to_document(sums: AllanSums) -> dict[str, Any]:
    """Return the sums as a document; floats survive a round trip through JSON unchanged."""
    return {
        'schema': SUMS_SCHEMA,
        'frame_id': sums.identity.frame_id,
        'hardware_id': sums.identity.hardware_id,
        'axes': list(sums.axes),
        'elapsed_ns': int(sums.elapsed_ns),
        'intervals': int(sums.intervals),
        'm': sums.m.tolist(),
        'count': sums.count.tolist(),
        'sum_sq': sums.sum_sq.tolist(),
        'group_count': sums.group_count.tolist(),
        'group_sum_sq': sums.group_sum_sq.tolist(),
        'segments': [
            {
                'start_ns': int(s.start_ns),
                'samples': int(s.samples),
                'phase_step': int(s.phase_step),
                'signed': s.signed.tolist(),
                'phase': s.phase.tolist(),
            }
            for s in sums.segments
        ],
        'classes': [
            {
                'index': int(c.index),
                'count': int(c.count),
                'samples': int(c.samples),
                'ramp_correction': c.ramp_correction.tolist(),
            }
            for c in sums.classes
        ],
    }


def sums_from_document(document: object) -> AllanSums:
    """Return the sums of a document.

    Raises
    ------
    AllanError
        When the document is of another version, or anything in it is missing, of the wrong kind or
        shape, not finite, or beyond its bounds.
    """
    top = _Reader(document, 'sums')
    schema = top.text('schema')
    if schema != SUMS_SCHEMA:
        raise AllanError(
            f'sums: schema is "{schema}", this version reads "{SUMS_SCHEMA}": '
            'use the version of allan_ros that wrote it, or accumulate anew'
        )
    axes = tuple(top.items('axes', len(AXES)))
    if not axes or axes != tuple(a for a in AXES if a in axes):
        raise AllanError(f'sums: axes is {axes!r}: expected some of {", ".join(AXES)}, in order')
    n = len(top.items('count', MAX_FACTORS))
    segments = tuple(
        _segment(_Reader(item, f'sums: segments[{i}]'), len(axes), n)
        for i, item in enumerate(top.items('segments', KEPT_SEGMENTS))
    )
    classes = tuple(
        _length_class(_Reader(item, f'sums: classes[{i}]'), len(axes), n)
        for i, item in enumerate(top.items('classes', MAX_CLASSES))
    )
    sums = AllanSums(
        ImuIdentity(top.text('frame_id'), top.text('hardware_id')),
        axes,
        top.integers('count', n),
        top.table('sum_sq', n, len(axes), least=0.0),
        top.integers('group_count', n),
        top.table('group_sum_sq', n, len(axes), least=0.0),
        segments,
        classes,
        top.integer('elapsed_ns'),
        top.integer('intervals'),
    )
    if not np.array_equal(top.integers('m', n), sums.m):
        raise AllanError('sums: m is not the grid of this version: accumulate anew')
    return sums


def _segment(item: _Reader, axes: int, factors: int) -> SegmentRecord:
    signed = item.items('signed', factors)
    phase = item.items('phase', PHASE_POINTS)
    step = item.integer('phase_step', least=1)
    if step & (step - 1):
        raise AllanError(f'{item.where}: phase_step is {step}: expected a power of two')
    return SegmentRecord(
        item.integer('start_ns', least=-MAX_INTEGER),
        item.integer('samples', least=1),
        item.table('signed', len(signed), axes),
        item.table('phase', len(phase), axes),
        step,
    )


def _length_class(item: _Reader, axes: int, factors: int) -> LengthClass:
    rows = item.items('ramp_correction', factors)
    return LengthClass(
        item.integer('index'),
        item.integer('count', least=1),
        item.integer('samples', least=1),
        item.table('ramp_correction', len(rows), axes),
    )


class _Reader:
    """Reads the fields of one mapping, and says where a wrong one stands."""

    def __init__(self, item: object, where: str) -> None:
        if not isinstance(item, Mapping):
            raise AllanError(f'{where}: expected an object, got {type(item).__name__}')
        self._item = item
        self.where = where

    def _get(self, key: str) -> object:
        try:
            return self._item[key]
        except KeyError:
            raise AllanError(f'{self.where}: {key} is missing') from None

    def text(self, key: str) -> str:
        value = self._get(key)
        if not isinstance(value, str) or len(value) > MAX_TEXT:
            raise AllanError(f'{self.where}: {key} must be a string of at most {MAX_TEXT}')
        return value

    def integer(self, key: str, least: int = 0) -> int:
        value = self._get(key)
        if isinstance(value, bool) or not isinstance(value, int):
            raise AllanError(f'{self.where}: {key} must be a whole number, got {value!r:.40}')
        if not least <= value < MAX_INTEGER:
            raise AllanError(f'{self.where}: {key} is {value}: out of bounds')
        return value

    def items(self, key: str, most: int) -> Sequence[Any]:
        value = self._get(key)
        if not isinstance(value, list) or len(value) > most:
            raise AllanError(f'{self.where}: {key} must be a list of at most {most}')
        return value

    def integers(self, key: str, n: int) -> NDArray[np.int64]:
        values = self.items(key, n)
        if len(values) != n or not all(type(v) is int and 0 <= v < MAX_INTEGER for v in values):
            raise AllanError(f'{self.where}: {key} must be {n} whole numbers, 0 or above')
        return np.array(values, np.int64)

    def table(self, key: str, rows: int, columns: int, least: float = -MAX_FLOAT) -> Floats:
        """Return a (rows, columns) table of finite numbers of at least ``least``."""
        value = self.items(key, rows)
        regular = len(value) == rows and all(
            isinstance(row, list)
            and len(row) == columns
            and all(
                type(x) in (int, float) and -math.inf < x < math.inf and x >= least for x in row
            )
            for row in value
        )
        if not regular:
            raise AllanError(
                f'{self.where}: {key} must be a table of {rows} x {columns} finite numbers'
                + (' of 0 or above' if least == 0.0 else '')
            )
        try:
            return np.array(value, float).reshape(rows, columns)
        except OverflowError:
            raise AllanError(f'{self.where}: {key} has a number beyond float64') from None
