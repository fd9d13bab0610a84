# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`AllanSums` as a plain document (dicts, lists, numbers, strings) and back, without loss.

The same document is the checkpoint, ``sums.json`` and the payload of the sums topic, so it may come
from a stranger: reading is strict and bounded, and never trusts a length.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import AllanError
from ..fields import Fields
from ..imu import AXES, MAX_NAME, ImuIdentity
from .engine import PHASE_POINTS
from .sums import (
    FIRST_FACTORS,
    KEPT_SEGMENTS,
    LEVEL_FACTORS,
    MAX_LEVELS,
    AllanSums,
    LengthClass,
    SegmentRecord,
)

SUMS_SCHEMA = 'allan_ros/sums/1'
"""Name and version of the document; a reader refuses any other."""


MAX_FACTORS = len(FIRST_FACTORS) + len(LEVEL_FACTORS) * MAX_LEVELS
"""More factors than that are centuries of samples."""


MAX_CLASSES = 500
"""1.1^500 is 5e20 samples: no stream has a longer segment."""


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
    top = Fields(document, 'sums')
    top.schema(SUMS_SCHEMA)
    axes = tuple(top.sequence('axes', len(AXES)))
    if not axes or axes != tuple(a for a in AXES if a in axes):
        raise AllanError(
            f'sums.axes is {axes!r:.80}: some of {", ".join(AXES)} are expected, in order'
        )
    n = len(top.sequence('count', MAX_FACTORS))
    segments = tuple(_segment(f, len(axes), n) for f in top.each('segments', KEPT_SEGMENTS))
    classes = tuple(_length_class(f, len(axes), n) for f in top.each('classes', MAX_CLASSES))
    sums = AllanSums(
        ImuIdentity(*(top.text(key, longest=MAX_NAME) for key in ('frame_id', 'hardware_id'))),
        axes,
        top.integers('count', n),
        top.table('sum_sq', n, len(axes), least=0.0),
        top.integers('group_count', n),
        top.table('group_sum_sq', n, len(axes), least=0.0),
        segments,
        classes,
        top.integer('elapsed_ns', least=0),
        top.integer('intervals', least=0),
    )
    if not np.array_equal(top.integers('m', n), sums.m):
        raise AllanError('sums.m is not the grid of this version: accumulate anew')
    return sums


def _segment(fields: Fields, axes: int, factors: int) -> SegmentRecord:
    signed = fields.sequence('signed', factors)
    phase = fields.sequence('phase', PHASE_POINTS)
    step = fields.integer('phase_step', least=1)
    if step & (step - 1):
        raise AllanError(f'{fields.where}.phase_step is {step}: a power of two is expected')
    return SegmentRecord(
        fields.integer('start_ns'),
        fields.integer('samples', least=1),
        fields.table('signed', len(signed), axes),
        fields.table('phase', len(phase), axes),
        step,
    )


def _length_class(fields: Fields, axes: int, factors: int) -> LengthClass:
    rows = fields.sequence('ramp_correction', factors)
    return LengthClass(
        fields.integer('index', least=0),
        fields.integer('count', least=1),
        fields.integer('samples', least=1),
        fields.table('ramp_correction', len(rows), axes),
    )
