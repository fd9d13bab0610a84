# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Addition of sums, and conversion to a document and back."""

import copy
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.allan_table import allan_table
from support.sums import assert_identical, sums_of

from allan_ros.core.allan.document import sums_from_document, sums_to_document
from allan_ros.core.allan.sums import KEPT_SEGMENTS, AllanSums, ols_ramp_weights
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import ImuIdentity

AXES = ('gyro_x', 'gyro_y', 'accel_z')


def noise(n, seed=0, axes=3):
    return np.random.default_rng(seed).normal(size=(n, axes))


def frozen(sums):
    """Return all fields of the sums as a value for comparison."""
    return json.dumps(sums_to_document(sums))


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(1, 400), min_size=2, max_size=6), st.integers(0, 99))
def test_adding_equals_accumulating_both_and_changes_neither(lengths, seed):
    y = noise(sum(lengths), seed)
    cuts = np.cumsum(lengths)[:-1].tolist()
    together = sums_of(y, cuts=cuts, axes=AXES)
    parts = [sums_of(y[a:b], axes=AXES) for a, b in zip([0, *cuts], [*cuts, len(y)])]
    before = [frozen(p) for p in parts]
    added = AllanSums.empty(ImuIdentity('imu'), AXES)
    for part in parts:
        added = added + part
    assert [frozen(p) for p in parts] == before
    assert np.array_equal(added.count, together.count)
    assert added.sum_sq == pytest.approx(together.sum_sq, rel=1e-12)
    assert added.group_sum_sq == pytest.approx(together.group_sum_sq, rel=1e-12)
    assert added.samples == together.samples == len(y)
    assert added.intervals == together.intervals == len(y) - len(parts)
    assert added.segment_count == len(parts)
    swapped = parts[-1] + added
    assert swapped.sum_sq == pytest.approx((added + parts[-1]).sum_sq, rel=1e-12)


def test_adding_empty_sums_changes_nothing():
    sums = sums_of(noise(500), axes=AXES)
    assert_identical(AllanSums.empty(ImuIdentity('imu'), AXES) + sums, sums)
    assert AllanSums.empty().tau0 is None and len(AllanSums.empty().avar) == 0


def test_the_longest_segments_are_kept_and_the_others_pooled():
    lengths = [50 + 7 * (i * 37 % 60) for i in range(60)]
    y = noise(sum(lengths))
    cuts = np.cumsum(lengths)[:-1].tolist()
    sums = sums_of(y, cuts=cuts, axes=AXES)
    assert [s.samples for s in sums.segments] == sorted(lengths, reverse=True)[:KEPT_SEGMENTS]
    assert sum(c.count for c in sums.classes) == 60 - KEPT_SEGMENTS
    assert sums.samples == sum(lengths)
    for c in sums.classes:
        assert 1.1**c.index <= c.samples / c.count <= 1.1 ** (c.index + 1)
    assert sum(n for _, n in sums.length_histogram) == 60


def test_ramps_of_pooled_segments_are_removed_exactly():
    """After the correction, the sums of pure ramps with different slopes are zero."""
    slopes = np.linspace(-3, 3, KEPT_SEGMENTS + 20)
    lengths = [400] * KEPT_SEGMENTS + [300] * 20
    parts = [r * np.arange(n)[:, None] for r, n in zip(slopes, lengths)]
    sums = sums_of(np.concatenate(parts), cuts=np.cumsum(lengths)[:-1].tolist())
    pooled = sum(
        (allan_table(p, sums.m[2 * sums.m <= 300], sums.stride[2 * sums.m <= 300]).avar)
        * (2 * sums.m[2 * sums.m <= 300, None] ** 2.0)
        * sums_of(p).count[: (2 * sums.m <= 300).sum(), None]
        for p in parts[KEPT_SEGMENTS:]
    )
    (pool,) = sums.classes
    assert pooled + pool.ramp_correction == pytest.approx(
        np.zeros_like(pooled), abs=1e-9 * pooled.max()
    )


@pytest.mark.parametrize('points, step', [(3, 1), (10, 4), (128, 1024)])
def test_ramp_weights_are_least_squares_on_the_samples(points, step):
    phase = np.random.default_rng(points).normal(size=points)
    k = np.arange(points - 1) * step
    expected = np.polyfit(k, np.diff(phase) / step, 1)[0]
    assert ols_ramp_weights(points, step) @ phase == pytest.approx(expected, rel=1e-9)


def test_sums_of_other_axes_or_rates_are_not_added():
    sums = sums_of(noise(500), axes=AXES)
    other = sums_of(noise(500, axes=2), axes=AXES[:2])
    with pytest.raises(AllanError, match='axes'):
        sums + other
    renamed = AllanSums(**{**sums.__dict__, 'identity': ImuIdentity('imu', 'serial 7')})
    with pytest.raises(AllanError, match='different IMUs'):
        sums + renamed
    # 1 % exceeds 0.1 % plus the ends of a segment of 500 samples (2 x 0.4 %)
    slower = AllanSums(**{**sums.__dict__, 'elapsed_ns': sums.elapsed_ns * 101 // 100})
    with pytest.raises(AllanError, match='rates are more than'):
        sums + slower
    close = AllanSums(**{**sums.__dict__, 'elapsed_ns': sums.elapsed_ns * 100_05 // 100_00})
    assert (sums + close).samples == 1000


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 5000), st.lists(st.integers(1, 4999), max_size=50))
def test_document_round_trips_through_json(n, cuts):
    sums = sums_of(noise(n), cuts=sorted({c for c in cuts if c < n}), axes=AXES)
    assert_identical(sums_from_document(json.loads(json.dumps(sums_to_document(sums)))), sums)


def spoilers():
    """Return changes that make a document invalid, each with a word of the error message."""
    return {
        'schema': (lambda d: d.update(schema='allan_ros/sums/2'), 'schema'),
        'no schema': (lambda d: d.pop('schema'), 'schema'),
        'axes': (lambda d: d.update(axes=['accel_z', 'gyro_x']), 'axes'),
        'no axes': (lambda d: d.update(axes=[]), 'axes'),
        'nan': (lambda d: d['sum_sq'][0].__setitem__(0, float('nan')), 'sum_sq'),
        'inf': (lambda d: d['segments'][0]['phase'][0].__setitem__(0, float('inf')), 'phase'),
        'negative': (lambda d: d['sum_sq'][0].__setitem__(0, -1.0), '0 or above'),
        'huge': (lambda d: d['sum_sq'][0].__setitem__(0, 10**400), 'sum_sq'),
        'ragged': (lambda d: d['sum_sq'][0].pop(), 'table'),
        'text': (lambda d: d.update(intervals='many'), 'whole number'),
        'true': (lambda d: d.update(intervals=True), 'whole number'),
        'overflow': (lambda d: d.update(elapsed_ns=2**63), 'whole number from'),
        'count': (lambda d: d['count'].__setitem__(0, 1.5), 'whole numbers'),
        'segments': (lambda d: d.update(segments=d['segments'] * 100), 'at most'),
        'step': (lambda d: d['segments'][0].update(phase_step=3), 'power of two'),
        'grid': (lambda d: d['m'].__setitem__(0, 2), 'grid'),
        'list': (lambda d: d.update(segments=[[]]), 'object is expected'),
        'name': (lambda d: d.update(frame_id='x' * 5000), 'frame_id'),
    }


@pytest.mark.parametrize('name', spoilers())
def test_an_invalid_document_is_rejected_with_one_line(name):
    document = copy.deepcopy(sums_to_document(sums_of(noise(200), axes=AXES)))
    spoil, word = spoilers()[name]
    spoil(document)
    with pytest.raises(AllanError, match=word) as error:
        sums_from_document(document)
    assert '\n' not in str(error.value) and len(str(error.value)) < 300


@pytest.mark.parametrize('thing', [None, 3, 'sums', [], {}])
def test_a_value_that_is_not_a_document_is_rejected(thing):
    with pytest.raises(AllanError):
        sums_from_document(thing)
