# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums by age add up to the sums, and the early part can be left out exactly."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.allan_table import allan_table
from support.sums import TICK_NS, sums_of

from allan_ros.core.allan.document import sums_from_document, sums_to_document
from allan_ros.core.allan.engine import BLOCK, RunningAllan
from allan_ros.core.allan.history import CELLS, age_bin, edge_age, period_begins, round_to_stored
from allan_ros.core.allan.parts import settled_sums
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import AXES


def noise(n, axes=2, seed=0):
    return np.random.default_rng(seed).normal(size=(n, axes)) + 9.8


def recording(y, gaps=(), axes=None):
    """Return the sums of one recording, without the samples of the gaps (first, last)."""
    engine = RunningAllan(axes=axes or AXES[: y.shape[1]])
    at = 0
    for first, last in (*gaps, (len(y), len(y))):
        engine.update(y[at:first], at * TICK_NS, (first - 1) * TICK_NS)
        engine.end_segment()
        at = last
    return engine.sums


def binned(sums):
    number, total = np.zeros_like(sums.count), np.zeros_like(sums.sum_sq)
    for each in sums.history.bins:
        number[: len(each.count)] += each.count
        total[: len(each.count)] += each.sum_sq
    return number, total


def test_edges_are_at_powers_of_two_and_halfway():
    assert [edge_age(i) for i in range(6)] == [0, 256, 384, 512, 768, 1024]
    for age in range(3000):
        assert edge_age(age_bin(age)) <= age < edge_age(age_bin(age) + 1)


@pytest.mark.parametrize('gaps', [(), ((500, 900),), ((300, 310), (7000, 30_000))])
def test_bins_add_up_to_the_sums(gaps):
    sums = recording(noise(50_000), gaps)
    number, total = binned(sums)
    assert np.array_equal(number, sums.count)
    assert total == pytest.approx(sums.sum_sq, rel=2**-16)  # the precision of the bins
    assert len(sums.history.bins) <= 15


def test_bins_are_not_rounded_after_each_segment():
    """If the bins were rounded after each of 3000 segments, small contributions would be lost."""
    sums = recording(noise(60_000), tuple((i, i + 1) for i in range(19, 59_980, 20)))
    number, total = binned(sums)
    assert np.array_equal(number, sums.count)
    assert total == pytest.approx(sums.sum_sq, rel=2**-16)


def test_rounding_keeps_16_bits_of_any_number():
    values = np.ldexp(np.random.default_rng(0).normal(size=1000), np.arange(-500, 500))
    assert round_to_stored(values) == pytest.approx(values, rel=2**-16, abs=0.0)
    assert np.array_equal(round_to_stored(round_to_stored(values)), round_to_stored(values))
    assert round_to_stored(np.zeros(2)).tolist() == [0.0, 0.0]


def test_periods_are_only_merged_as_the_recording_grows():
    before: set[int] = set()
    for length in [*range(1, 3000, 50), *(int(1.3**k) for k in range(31, 90))]:
        begins = period_begins(length)
        assert begins[0] == 0 and np.all(np.diff(begins) > 0)
        assert len(begins) < 64 + 4 * length.bit_length()
        assert set(begins[begins < max(before, default=0)].tolist()) <= before
        before = set(begins.tolist())
        periods, left = np.diff(begins), length - begins[1:]
        long = periods > 2048
        assert np.all(32 * periods[long] <= length) and np.all(4 * periods[long] <= left[long])


@pytest.mark.parametrize('gaps', [(), ((500, 900),), ((7000, 30_000),)])
def test_cells_and_periods_are_those_of_the_samples(gaps):
    y = noise(50_000)
    sums = recording(y, gaps)
    one = sums.history.recordings[0]
    assert len(one.cell_samples) <= CELLS and len(one.level_count) == len(one.period_begin)
    assert one.samples == sums.samples and one.length == 50_000
    full = np.flatnonzero(one.cell_samples == one.step)
    assert len(full) > 0.9 * sums.samples / one.step - 4
    for cell in full:
        mean = y[cell * one.step : (cell + 1) * one.step].mean(axis=0)
        assert one.cell_means[cell] + one.reference == pytest.approx(mean, abs=2**-13)
    rows = np.searchsorted(sums.m, one.level_m)
    count = one.level_count.sum(axis=0)
    # the last periods of a segment are too short for long factors
    assert np.all(count <= sums.count[rows]) and np.all(count > 0.5 * sums.count[rows])
    assert one.level_sum_sq[:, 0].sum(axis=0) == pytest.approx(sums.sum_sq[0], rel=2**-16)
    table = allan_table(y, one.level_m, np.maximum(one.level_m // 8, 1))
    if not gaps:
        found = one.level_sum_sq.sum(axis=0) / (2.0 * one.level_m**2 * count)[:, None]
        # of the differences of the last 1/32, up to a fifth of all, 4 sigma
        assert found == pytest.approx(table.avar, rel=0.1)
        assert count[0] == sums.count[0]
        first = slice(*one.period_begin[:2])
        theta = np.concatenate([[[0.0, 0.0]], np.cumsum(y - y[0], axis=0)])
        d = theta[8:] - 2.0 * theta[4:-4] + theta[:-8]
        assert one.level_sum_sq[0, 1] == pytest.approx((d[first] ** 2).sum(axis=0), rel=2**-15)


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 3 * BLOCK), st.lists(st.integers(1, 2 * BLOCK), min_size=1, max_size=4))
def test_any_chunking_gives_the_same_history(n, chunks):
    y = noise(n)
    assert sums_of(y, cuts=[n // 3]) == sums_of(y, chunks, cuts=[n // 3])


def test_the_settled_part_equals_the_sums_of_its_samples():
    y = noise(60_000) + np.cumsum(noise(60_000, seed=1) - 9.8, axis=0) * 0.01
    sums = recording(y)
    step = sums.segments[0].phase_step
    for age in sums.history.ages:
        if age % step or age > 50_000:
            continue
        found, expected = settled_sums(sums, age), recording(y[age:])
        assert np.array_equal(found.count, expected.count)
        assert found.sum_sq == pytest.approx(expected.sum_sq, rel=2**-15)
        assert found.samples == expected.samples and found.tau0 == pytest.approx(expected.tau0)
        assert found.segments[0].start_ns == age * TICK_NS
        scale = np.sqrt(expected.count[:, None] * expected.avar) * expected.m[:, None]
        # where strides are shorter than a phase step the signed sum is interpolated
        long = expected.stride >= step
        error = np.abs(found.segments[0].signed - expected.segments[0].signed) / scale
        assert error[long].max(initial=0.0) < 1e-9


def test_the_settled_part_between_phase_points_is_approximate():
    """At most 1/64 of all differences are assigned to the wrong part."""
    y = noise(60_000)
    sums = recording(y, ((100, 150),))
    for age in sums.history.ages[:-3]:
        found, expected = settled_sums(sums, age), recording(y[max(age, 150) :])
        n = min(len(found.count), len(expected.count)) - 8
        assert found.count[:n] == pytest.approx(expected.count[:n], rel=0.05)
        # 300 or more differences: 8 standard deviations of the effect of 1/64 of them
        many = expected.count[:n] // np.maximum(expected.m // expected.stride, 1)[:n] > 300
        assert found.avar[:n][many] == pytest.approx(expected.avar[:n][many], rel=0.06)


def test_the_settled_part_of_many_segments_has_consistent_counts():
    y = noise(80_000)
    sums = recording(y, tuple((i, i + 7) for i in range(1000, 79_000, 997)))
    assert sums.classes and len(sums.segments) == 32
    for age in sums.history.ages[4:-2]:
        found = settled_sums(sums, age)
        assert abs(found.samples - (80_000 - age)) < 0.05 * 80_000
        assert np.all(np.abs(found.avar[0] - 1.0) < 0.05)  # 6 sigma of 30 000 differences
        assert sum(c.count for c in found.classes) + len(found.segments) == found.segment_count


def test_only_complete_bins_can_be_left_out():
    with pytest.raises(AllanError, match='not the start'):
        settled_sums(recording(noise(5000)), 1234)


def test_recordings_add_at_equal_ages():
    a, b, c = (recording(noise(n, seed=n)) for n in (30_000, 50_000, 9000))
    left, right, other = (a + b) + c, a + (b + c), (c + b) + a
    for total in (right, other):
        assert np.array_equal(total.count, left.count)
        assert total.sum_sq == pytest.approx(left.sum_sq, rel=1e-12)
        assert total.history.recordings == left.history.recordings
        assert total.history.ages == left.history.ages
    assert left.history.recording_count == 3
    number, total = binned(left)
    assert np.array_equal(number, left.count)
    assert total == pytest.approx(left.sum_sq, rel=2**-15)


def test_sums_read_without_a_history_add_but_cannot_be_divided():
    old = sums_to_document(recording(noise(5000)))
    del old['history']
    total = sums_from_document(old) + recording(noise(5000, seed=1))
    assert total.samples == 10_000 and total.history.ages == ()


@pytest.mark.parametrize('gaps', [(), tuple((i, i + 7) for i in range(500, 29_000, 600))])
def test_a_document_restores_the_history_without_loss(gaps):
    sums = recording(noise(30_000, 6), gaps)
    both = sums + recording(noise(20_000, 6))
    for each in (sums, both):
        assert sums_from_document(json.loads(json.dumps(sums_to_document(each)))) == each


def test_equality_of_sums_is_by_value():
    a, b, c = (sums_of(noise(3000, seed=s)) for s in (1, 1, 2))
    assert a == b and a != c and a != 1


@pytest.mark.parametrize(
    'path, value',
    [
        (('elapsed_ns',), 0),
        (('elapsed_ns',), 10**40),
        (('intervals',), 5),
        (('segments', 0, 'samples'), 1),
        (('segments', 0, 'samples'), 2999),
        (('segments', 0, 'signed'), [[0.0] * 2]),
        (('segments', 0, 'phase'), [[0.0] * 2]),
        (('segments', 0, 'phase_step'), 3),
        (('sum_sq', 3, 0), 1e150),
        (('segments', 0, 'phase', 3, 0), 1e150),
        (('count', 0), 1),
        (('group_count', 0), 10**9),
        (('history', 'bins', 0, 'age'), 257),
        (('history', 'bins', 0, 'count'), [7] * 20),
        (('history', 'bins', 0, 'count'), 'z8:AAAA'),
        (('history', 'bins', 0, 'sum_sq'), 'z4:' + 'A' * 10),
        (('history', 'recordings', 0, 'period_begin'), [0, 0, 256]),
        (('history', 'bins', 0, 'sum_sq'), 'AAAA'),
        (('history', 'bins', 0, 'sum_sq'), 'not base64'),
        (('history', 'recordings', 0, 'step'), 3),
        (('history', 'recordings', 0, 'cell_samples'), [10**6] * 300),
        (('history', 'recordings', 0, 'reference'), []),
        (('history', 'recordings', 0, 'level_count'), [[]] * 20),
    ],
)
def test_a_document_that_contradicts_itself_is_rejected(path, value):
    document = json.loads(json.dumps(sums_to_document(recording(noise(3000)))))
    place = document
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(AllanError):
        sums_from_document(document)
