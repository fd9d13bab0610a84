# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From batches to sums: any chunking, any fault, and every sample accounted for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.streams import (
    FAULTS,
    START,
    accumulate,
    assert_accounted,
    assert_same,
    faulty,
    ids,
    still,
)
from support.sums import assert_identical

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import AXES, ImuBatch, ImuIdentity, even_stamps
from allan_ros.core.stream.pipeline import ImuStream


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(sorted(FAULTS)),
    st.integers(0, 9000),
    st.lists(st.integers(1, 3000), min_size=1, max_size=4),
    st.integers(0, 99),
    st.booleans(),
)
def test_any_chunking_of_any_stream_gives_the_same(fault, n, chunks, seed, gated):
    t, x = faulty(fault, n, seed)
    whole = accumulate(t, x, (len(t) + 1,), motion_gate=gated)
    assert_same(whole, accumulate(t, x, chunks, motion_gate=gated))
    # samples that repeat the previous one or belong to no sensor are not counted
    has_uncounted = fault == 'nan first' or ids(whole) & {'held', 'sensor_absent'}
    if len(whole.sums) < 2 and not has_uncounted:
        assert_accounted(whole)
    assert np.isfinite([v for s in whole.sums for v in s.sum_sq.ravel()]).all()


@pytest.mark.parametrize(
    'fault', ['scatter', 'quieter', 'nan first', 'equal first', 'jump', 'twice']
)
def test_what_is_learned_on_the_way_does_not_depend_on_the_chunks(fault):
    """Period, noise floor, sensors, and backward stamps of duplicates or after a new rate."""
    t, x = still(40_000)
    rng, i = np.random.default_rng(2), np.arange(len(t))
    if fault == 'twice':  # samples with a backward stamp, and their duplicates
        twice = np.sort(np.concatenate([i, i[7::500]]))
        t, x = (t - (i % 500 == 7) * 10**9)[twice], x[twice]
    elif fault in FAULTS:
        t, x = faulty(fault, len(t))
    elif fault == 'quieter':
        x = x * (1.0 - 2e-5 * i[:, None]) + 5e-3 * (rng.random(x.shape) < 0.002)
    elif fault == 'equal first':
        t = np.maximum(t, t[2500])
    else:
        t = faulty('rate', len(t))[0] - (i > 12_000) * 3600 * 10**9
    whole = accumulate(t, x, (len(t),))
    assert_same(whole, accumulate(t, x, (32,)))
    assert whole.sums[0].samples > 20_000


def test_a_clean_stream_gives_the_same_sums_as_the_engine():
    t, x = still(20_000)
    engine = RunningSums(ImuIdentity(), AXES)
    engine.update(x, int(t[0]), int(t[-1]))
    engine.end_segment()
    result = accumulate(t, x)
    assert_identical(result.sums[0], engine.sums)
    assert result.health.rate_hz == pytest.approx(200.0)
    assert result.health.still_share == 1.0 and result.health.state == 'at_rest'
    assert [(s.start_ns, s.samples) for s in result.segments] == [(START, 20_000)]


def test_every_segment_states_why_it_begins():
    t, x = still(30_000)
    t[10_000:] += 5 * 10**9
    x[20_000:20_400] += 50.0 * np.random.default_rng(0).normal(size=(400, 6))
    assert [s.cut for s in accumulate(t, x).segments] == ['', 'gap', 'motion']


@pytest.mark.parametrize('fault', FAULTS)
def test_the_present_health_is_that_of_the_result_but_for_buffered_samples(fault):
    t, x = faulty(fault, 12_000)
    stream = ImuStream()
    for at in range(0, len(t), 1500):
        stream.update(ImuBatch(t[at : at + 1500], x[at : at + 1500]))
        known = stream.result()
        health, _ = stream.present_health(known.sums)
        assert (health.state, health.frame_id) == (known.health.state, known.health.frame_id)
        assert health.counts.received == known.health.counts.received
        assert 0 <= known.health.counts.used - health.counts.used < 2000
    stream.end()
    assert_same(stream.result(), accumulate(t, x))  # reading has changed nothing
    stream.update(ImuBatch(t, x, frame_id='another'))
    stream.end()
    known = stream.result()
    assert stream.present_health(known.sums) == (known.health, known.findings)


@pytest.mark.parametrize('fault', [name for name in FAULTS if FAULTS[name][0] is not None])
def test_each_fault_is_reported_by_its_finding(fault):
    expected, found = {*FAULTS[fault][0].split()}, ids(accumulate(*faulty(fault, 9000)))
    assert expected <= found
    assert not found - expected - {'interpolated', 'gaps', 'motion', 'not_finite'}


def test_record_times_replace_constant_stamps():
    t, x = still(5000)
    reference = accumulate(t, x).sums[0]
    for stamps in ('header', 'record'):
        result = accumulate(t * 0 + 7, x, record=t, stamps=stamps)
        assert_identical(result.sums[0], reference)
        assert result.health.stamps == 'record'
        assert ('stamps_unusable' in ids(result)) == (stamps == 'header')


def test_header_stamps_are_used_and_examined_without_the_requested_record_times():
    t, x = still(5000)
    result = accumulate(t, x, stamps='record')
    assert_identical(result.sums[0], accumulate(t, x).sums[0])
    assert result.health.stamps == 'header'
    assert 'stamps_missing' in ids(accumulate(t * 0, x, stamps='record'))


@pytest.mark.parametrize('declared', [100.0, 200.0])
def test_a_declared_rate_is_only_checked_unless_there_are_no_stamps(declared):
    t, x = still(5000)
    result = accumulate(t, x, declared_rate=declared)
    assert_identical(result.sums[0], accumulate(t, x).sums[0])
    assert ids(result) == ({'rate_differs'} if declared == 100.0 else set())
    without = accumulate(t * 0, x, declared_rate=declared)
    assert without.sums[0].tau0 == pytest.approx(1 / declared)
    assert ids(without) == {'stamps_from_rate'}


@pytest.mark.parametrize('rate, reported', [(3e5, True), (5e4, False), (1.0, False), (0.05, True)])
def test_a_rate_that_no_imu_has_is_reported(rate, reported):
    _, x = still(3000)
    result = accumulate(np.rint(np.arange(3000) * 1e9 / rate).astype(np.int64), x)
    assert ('rate_implausible' in ids(result)) == reported


def test_mostly_equal_stamps_are_replaced_by_the_declared_rate():
    t, x = still(5000)
    result = accumulate(t[np.arange(5000) // 500 * 500], x, declared_rate=200.0)
    assert ids(result) == {'stamps_from_rate'} and result.health.counts.used == 5000


def test_the_warm_up_is_left_out():
    t, x = still(6000)
    result = accumulate(t, x, skip=5.0)
    assert result.health.counts.skipped == 1000
    assert_identical(result.sums[0], accumulate(t[1000:], x[1000:]).sums[0])


@pytest.mark.parametrize(
    'frames, used',
    [
        ('a' * 3000 + 'b' * 6000, 'b'),
        ('a' * 6000 + 'b' * 3000, 'a'),
        ('a' * 4000 + 'b' * 1500 + 'a' * 3500, 'a'),
        ('ab' * 1500, 'a'),
    ],
)
def test_another_frame_is_another_imu(frames, used):
    t, x = still(len(frames))
    t[2000:] += 10**9  # a gap
    frames = np.array(list(frames))
    result, own = accumulate(t, x, frames=frames), frames == used
    alone = accumulate(t[own], x[own], frames=frames[own])
    assert_identical(result.sums[0], alone.sums[0])
    assert result.segments == alone.segments and result.sums[0].identity.frame_id == used
    assert result.health.frame_changes == np.count_nonzero(frames[1:] != frames[:-1])
    assert [f.id for f in result.findings].count('frame_changed') == 1
    assert_accounted(result)


@pytest.mark.parametrize(
    'frame_ids, absent, axes',
    [
        (('five axes', 'gyro'), (slice(2, 3), slice(3, 6)), (AXES[:3], (*AXES[:2], *AXES[3:]))),
        (('imu', 'imu'), (slice(0, 3), slice(0, 0)), (AXES, AXES[3:])),
        (('imu', 'imu'), (slice(3, 6), slice(0, 0)), (AXES, AXES[:3])),
    ],
    ids=['two frame_ids', 'the gyro begins later', 'the accelerometer begins later'],
)
def test_the_longer_sums_of_an_axis_come_last(frame_ids, absent, axes):
    """The first 60 s have other axes than the last 30 s."""
    stream, (t, x) = ImuStream(), still(18_000)
    for frame_id, columns, rows in zip(frame_ids, absent, (slice(12_000), slice(12_000, None))):
        x[rows, columns] = np.nan
        stream.update(ImuBatch(t[rows], x[rows], frame_id=frame_id))
    stream.end()
    shorter, longer = stream.result().sums
    assert (shorter.axes, longer.axes) == axes
    assert shorter.elapsed_ns * 1e-9 == pytest.approx(30, abs=1)
    assert longer.elapsed_ns * 1e-9 == pytest.approx(60, abs=1)


@pytest.mark.parametrize('ordered', [0, 2000])
@pytest.mark.parametrize('length', [100, 20_000])
def test_stamps_without_order_are_not_used(ordered, length):
    """Each segment costs about as much as a thousand samples, so their number is limited."""
    t, x = still(20_000)
    times, rest = t.copy(), len(t) - ordered
    random = np.random.default_rng(0).permutation(rest)
    times[ordered:] = t[ordered:][np.arange(rest) % 100 if length == 100 else random]
    result = accumulate(times, x)
    if length > 100 and not ordered:
        assert ids(result) == {'stamps_missing', 'nothing_left'}
        same = accumulate(times, x, record=t)
        assert_identical(same.sums[0], accumulate(t, x).sums[0])
    else:
        assert 'backward_stamps' in ids(result)
    assert sum(result.health.counts.splits.values()) < 0.01 * len(t)
    assert_accounted(result)


def test_frames_without_end_take_no_memory_without_end():
    t, x = still(300)
    result = accumulate(t, x, frames=[f'imu_{i}' for i in range(300)])
    assert_accounted(result)
    (found,) = [f for f in result.findings if f.id == 'frames_dropped']
    assert found.values['count'] == 298


@pytest.mark.parametrize(
    'slow, now', [(slice(5000, 7000), 200), (slice(9000, None), 100)], ids=['returns', 'changes']
)
def test_sums_are_for_the_longest_rate_and_health_shows_the_present_one(slow, now):
    t, x = still(12_000)
    steps = np.diff(t, prepend=t[0])
    steps[slow] *= 2
    steps[2000] += 10**9  # a gap
    result = accumulate(t[0] + np.cumsum(steps), x)
    (sums,) = result.sums
    assert 1 / sums.tau0 == pytest.approx(200, rel=1e-3)
    assert result.health.rate_hz == pytest.approx(now, rel=1e-3)
    assert result.health.counts.splits['rate change'] == (2 if now == 200 else 1)
    assert sums.samples == pytest.approx(10_000 if now == 200 else 9000, abs=300)
    starts = [s.start_ns for s in result.segments]
    assert starts[:2] == [t[0], t[2000] + 10**9]
    assert sum(s.samples for s in result.segments) == sums.samples
    assert sums.segment_count == len(result.segments)
    assert_accounted(result)


def test_an_empty_stream_gives_empty_results():
    empty = ImuStream().result()
    assert empty.sums == () and empty.findings == () and empty.health.state == 'waiting'
    one = accumulate(*still(1))
    assert one.sums == () and 'nothing_left' in ids(one)


def test_real_bursty_stamps_are_one_segment_at_the_true_rate(shared_data):
    table = np.load(shared_data / 'mpu6050.npz')['imu']
    stamps = np.rint(table[:, 0] * 1e9).astype(np.int64)
    result = accumulate(stamps, table[:, 1:])
    (sums,) = result.sums
    assert sums.segment_count == 1 and sums.samples == len(table) == 65_067
    assert 1 / sums.tau0 == pytest.approx(99.3, abs=0.05)
    assert result.health.counts.interpolated == 0 and result.health.bursty


def test_a_real_static_recording_is_used_completely_and_equals_a_reference(shared_data):
    """ADIS16405, 1,000,000 samples at 100 Hz, compared with allantools' overlapping deviations."""
    counts = np.load(shared_data / 'adis16405' / 'imu2_counts.npz')
    samples = np.hstack([counts['gyro'] * np.radians(0.05), counts['accel'] * (0.00333 * 9.80665)])
    times = np.arange(1_000_000) * 10_000_000
    (sums,) = accumulate(times, samples, (32768,), motion_gate=False).sums
    assert sums.samples == 1_000_000 and sums.segment_count == 1
    reference = shared_data / 'adis16405' / 'oadev_allantools.csv'
    table = np.genfromtxt(reference, delimiter=',', names=True, dtype=None, encoding='utf-8')
    columns = {name: i for i, name in enumerate(('gx', 'gy', 'gz', 'ax', 'ay', 'az'))}
    compared = 0
    for row in table:
        at = np.flatnonzero(sums.m == row['m'])
        if len(at) and row['m'] <= 100_000:
            adev = np.sqrt(sums.avar[at[0], columns[row['axis']]])
            exact = sums.stride[at[0]] == 1
            assert adev == pytest.approx(row['oadev'], rel=1e-9 if exact else 0.02)
            compared += 1
    assert compared == 6 * 17


def test_replaced_stretches_are_counted_by_length():
    t, x = still(9000)
    x[5000, 2] += 1.0  # an isolated spike in one axis
    moving = x.copy()
    moving[4500:] += np.random.default_rng(0).normal(size=(4500, 6))
    kept = ~np.isin(np.arange(9000), [2000, 3000, 3001, 4000, 4001, 4002])
    numbers = np.ones((3, 6), int)
    numbers[0, 2] += 1
    expected = np.column_stack([[1, 2, 3], [1, 1, 1], numbers])  # length and level first
    for chunk in (1, 7, 9000):
        (sums,) = accumulate(t[kept], x[kept], (chunk,)).sums
        assert np.array_equal(sums.replaced, expected), chunk
    assert np.array_equal((sums + sums).replaced[:, 2:], 2 * numbers)
    (sums,) = accumulate(t[kept], moving[kept]).sums
    assert np.array_equal(sums.replaced[:, 2], [1, 1, 1]), 'excluded samples do not count'


@pytest.mark.parametrize('places', [2, 8, 30])
@pytest.mark.parametrize('begin', [0, 5040])
def test_samples_that_arrive_out_of_order_are_sorted(places, begin):
    t, x = still(20_160)
    at = np.arange(len(t))
    order = np.where(at < begin, at, at // places * places + places - 1 - at % places)
    result = accumulate(t[order], x[order])
    assert ids(result) == {'reordered'}
    assert_identical(result.sums[0], accumulate(t, x).sums[0])


def test_a_rate_whose_stamps_do_not_fit_into_64_bits_is_refused():
    with pytest.raises(AllanError, match='too low'):
        even_stamps(0, 10, 1e-300)
