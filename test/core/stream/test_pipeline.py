# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From batches to sums: any chunking, any fault, and every sample accounted for."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.sums import assert_identical

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.errors import AllanError
from allan_ros.core.fit import fit_noise
from allan_ros.core.imu import AXES, LARGEST, ImuBatch, ImuIdentity, even_stamps
from allan_ros.core.settings import SegmenterSettings
from allan_ros.core.stream.pipeline import ImuStream

PERIOD = 5_000_000
START = 10**18


def still(n, seed=0):
    """Return stamps and samples of an IMU at rest, 200 Hz."""
    noise = np.random.default_rng(seed).normal(size=(n, 6)) * 1e-3
    return START + np.arange(n) * PERIOD, noise + [0.01, 0.02, 0.03, 0.0, 0.0, 9.8]


def accumulate(times, samples, chunks=(4096,), record=None, frames=None, **settings_):
    """Return the result of a stream after samples, in chunks of the given lengths (repeated)."""
    stream, at = ImuStream(SegmenterSettings(**settings_)), 0
    frames = np.array([''] * len(times) if frames is None else frames)
    for length in itertools.cycle(chunks):
        rows = slice(at, at + length)
        other = np.flatnonzero(frames[rows] != frames[at]) if at < len(times) else []
        rows = slice(at, at + int(other[0])) if len(other) else rows
        if at >= len(times):
            break
        part = None if record is None else record[rows]
        stream.update(ImuBatch(times[rows], samples[rows], part, str(frames[at])))
        at = rows.stop
    stream.end()
    return stream.result()


def assert_same(a, b):
    assert a.health == b.health and a.findings == b.findings and a.segments == b.segments
    assert len(a.sums) == len(b.sums)
    for x, y in zip(a.sums, b.sums):
        assert_identical(x, y)


def ids(result):
    return {f.id for f in result.findings}


def mean_n(sums):
    return np.mean([fit.noise['N'].value for fit in fit_noise(sums).axes.values()])


def assert_accounted(result):
    """Check that every received or interpolated sample is counted exactly once."""
    c = result.health.counts
    fates = c.used + c.skipped + c.other_frame + c.not_finite + c.duplicate + c.backward
    assert c.received + c.interpolated == fates + c.untimed + c.moving + c.stuck + c.noise_increased


def swing(i):
    """Return a rotation of 0.3 Hz up to 0.5 rad/s at the samples i."""
    return 0.5 * np.sin(2 * np.pi * 0.3 * i / 200)


def repeated(samples, share, rng):
    """Return samples of which a share at random repeats the previous one."""
    fresh = rng.random(len(samples)) >= share
    fresh[:1] = True
    return samples[np.maximum.accumulate(np.where(fresh, np.arange(len(samples)), 0))]


def reversed_by(i, places):
    i = i[: len(i) // places * places]
    return i // places * places + places - 1 - i % places


# name -> ids of the findings (None if they depend on chance), and a function
KEPT = {  # samples that arrive, in the order of arrival
    'nothing': ('', lambda i, g: i),
    'drops': ('interpolated', lambda i, g: i[g.random(len(i)) > 0.02]),
    'many drops': (None, lambda i, g: i[g.random(len(i)) > 0.3]),
    'gap': ('gaps', lambda i, g: np.delete(i, slice(3000, 3500))),
    'third missing': ('rate_assumed', lambda i, g: i[i % 3 != 1]),
    'swapped': ('reordered', lambda i, g: reversed_by(i, 8)),
    'late': ('reordered', lambda i, g: np.argsort(i + 20 * (g.random(len(i)) < 0.01))),
    'twice': ('duplicates', lambda i, g: np.repeat(i, 2)),
}
TIMES = {
    'jitter': (None, lambda t, i, g: np.sort(t + g.integers(-1_000_000, 1_000_000, len(t)))),
    'scatter': (None, lambda t, i, g: t + g.normal(0.0, 0.2 * PERIOD, len(t)).astype(int)),
    'disorder': (None, lambda t, i, g: t + g.integers(-6_000_000, 6_000_000, len(t))),
    'bursts': ('bursty_stamps', lambda t, i, g: START + i // 8 * 8 * PERIOD),
    'two clocks': (
        'stamps_mixed bursty_stamps backward_stamps clock_jumps rate_assumed',
        lambda t, i, g: t + (g.random(len(t)) < 0.3) * 350_000_000,
    ),
    'microseconds': ('stamps_unit', lambda t, i, g: (t + 7 * 10**17) // 1000),
    'clock back': ('clock_jumps backward_stamps', lambda t, i, g: t - (i > 4000) * 3600 * 10**9),
    'clock forth': (None, lambda t, i, g: t + (i > 4000) * 3600 * 10**9),
    'rate': ('rate_changed', lambda t, i, g: t + np.maximum(0, i - 4100) * PERIOD),
    'no stamps': ('stamps_missing nothing_left', lambda t, i, g: t * 0),
    **{
        f'since {start} ns': ('', lambda t, i, g, start=start: t - START + start)
        for start in (0, 10**9, 10**12, 10**15)
    },
}
VALUES = {
    'nan': ('not_finite', lambda x, i, g: np.where(g.random(x.shape) < 0.001, np.nan, x)),
    'impossible': (
        'not_finite',
        lambda x, i, g: np.where(g.random(x.shape) < 0.001, 1.1 * LARGEST, x),
    ),
    'nan first': (None, lambda x, i, g: np.where(i > 3000, x, np.nan)),
    'motion': ('motion', lambda x, i, g: x + g.normal(size=x.shape) * (i % 5000 < 900)),
    'shocks': ('shocks', lambda x, i, g: x + g.normal(size=x.shape) * (i % 1500 < 90)[::-1]),
    'starts in motion': (
        'relearned motion',
        lambda x, i, g: x + g.normal(size=x.shape) * (i < 4500) / 9,
    ),
    'drives first': ('motion', lambda x, i, g: x + swing(i) * (i < 7000)),
    'drives': ('never_still nothing_left', lambda x, i, g: x + swing(i)),
    'spikes': ('spikes', lambda x, i, g: x + 0.02 * (g.random(x.shape) < 0.002)),
    'noise_increased': (None, lambda x, i, g: x + 0.02 * g.normal(size=x.shape) * (i > 1500)),
    'stuck': ('stuck', lambda x, i, g: x[np.minimum(i[:, 0], 5001)]),
    'held': ('held', lambda x, i, g: np.hstack([x[:, :3], x[i[:, 0] * 5 // 8, 3:]])),
    'zero filled': ('zero_filled', lambda x, i, g: x * (i % 2 == np.arange(6) // 3)),
    'repeats': ('repeated', lambda x, i, g: repeated(x, 0.2, g)),
    'repeats of each sensor': (
        'repeated',
        lambda x, i, g: np.hstack([repeated(x[:, :3], 0.2, g), repeated(x[:, 3:], 0.5, g)]),
    ),
    'no accel': ('sensor_absent', lambda x, i, g: x * [1, 1, 1, np.nan, np.nan, np.nan]),
    'no axis': (
        'axis_absent',
        lambda x, i, g: x * [1, g.choice([np.nan, np.inf, 1e305]), 1, 1, 1, 1],
    ),
    'zero gyro': ('sensor_all_zero', lambda x, i, g: x * [0, 0, 0, 1, 1, 1]),
    'constant': ('no_noise gyro_unit accel_scale', lambda x, i, g: x * 0 + 3.0),
    # coarse sensors, by their resolution in standard deviations: equal samples are no repeats
    **{
        f'coarse {step}': ('', lambda x, i, g, lsb=step * 1e-3: np.round(x / lsb) * lsb)
        for step in (0.1, 0.5, 1.0, 2.0, 3.0)
    },
    'coarse gyro': (
        '',
        lambda x, i, g: np.hstack([np.round(200 * (x - 0.02))[:, :3] * 1e-3, x[:, 3:]]),
    ),
}
FAULTS = {**KEPT, **TIMES, **VALUES}


def faulty(name, n, seed=0):
    """Return stamps and samples of an IMU with a fault."""
    (t, x), i, rng = still(n, seed), np.arange(n), np.random.default_rng(seed + 1)
    make = FAULTS[name][1]
    if name in KEPT:
        kept = make(i, rng)
        return t[kept], x[kept]
    return (make(t, i, rng), x) if name in TIMES else (t, make(x, i[:, None], rng))


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
    # samples that repeat the previous one or are those of no sensor are not counted
    if len(whole.sums) < 2 and not ids(whole) & {'held', 'sensor_absent'}:
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


def test_sensors_with_different_rates_have_separate_sums():
    """A 125 Hz accelerometer is repeated at 200 Hz; its white noise is measured at its own rate."""
    n = 40_000
    t, x = still(n)
    x[:, 3:] = np.random.default_rng(9).normal(size=(n, 3))[np.arange(n) * 5 // 8] * 0.02
    gyro, accel = accumulate(t, x).sums
    assert (gyro.axes, accel.axes) == (AXES[:3], AXES[3:])
    assert 1 / gyro.tau0 == pytest.approx(200) and 1 / accel.tau0 == pytest.approx(125, rel=1e-4)
    # sd of a variance of 25,000 white samples at m = 1 is 1 %, 5 sigma: false alarm 2e-6
    assert accel.avar[0] == pytest.approx([4e-4] * 3, rel=0.05)


@pytest.mark.parametrize(
    'share, together', [(0.02, True), (0.04, False), (0.2, True), (0.3, False)]
)
def test_random_repeats_are_interpolated_and_n_is_corrected(share, together):
    rng = np.random.default_rng(5)
    t, x = still(60_000)
    parts = [x] if together else [x[:, :3], x[:, 3:]]
    result = accumulate(t, np.hstack([repeated(part, share, rng) for part in parts]))
    (sums,) = result.sums
    (note,) = result.findings
    assert note.id == 'repeated' and note.axes == AXES
    assert sums.samples == len(t) and 1 / sums.tau0 == pytest.approx(200)
    lengths = np.arange(1, len(sums.filled) + 1)
    # 5 sigma of the number of repeats is 12 % at 2 %: false alarm 6e-7
    assert lengths @ sums.filled == pytest.approx([share * len(t)] * 6, rel=0.15)
    # sd of the mean N of six axes is at most 0.3 %, 5 sigma: false alarm 6e-7
    assert mean_n(sums) == pytest.approx(1e-3 * 200**-0.5, rel=0.015)


@pytest.mark.parametrize('rate', [166.0, 150.0, 133.0, 110.0, 100.0])
def test_a_sensor_that_is_polled_faster_than_its_rate_has_its_own_rate(rate):
    n = 20_000
    t, x = still(n)
    result = accumulate(t, x[(np.arange(n) * rate / 200).astype(int)])
    (sums,) = result.sums
    assert ids(result) == {'held'} and len(result.segments) == 1
    assert sums.axes == AXES and sums.samples == n * rate / 200
    assert 1 / sums.tau0 == pytest.approx(rate, rel=1e-3)


def test_losses_that_scattered_stamps_hide_increase_n_as_the_finding_states():
    t, x = still(60_000)
    rng = np.random.default_rng(2)
    t = np.sort(t + (rng.normal(size=len(t)) * 0.5 * PERIOD).astype(np.int64))
    kept = rng.random(len(t)) > 0.05
    result = accumulate(t[kept], x[kept])
    assert ids(result) == {'bursty_stamps'}
    # sd of the mean N of six axes is below 0.3 %, 5 sigma: false alarm 6e-7
    assert mean_n(result.sums[0]) == pytest.approx(1.025 * 1e-3 * 200**-0.5, rel=0.015)


def test_a_stuck_sensor_is_no_repeated_sample():
    t, x = still(20_000)
    x[300:340] = x[300]
    assert not ids(accumulate(t, x)) & {'held', 'repeated'}
    x = repeated(x, 0.1, np.random.default_rng(0))
    x[9000:9300] = x[9000]
    result = accumulate(t, x)
    assert {'repeated', 'stuck'} <= ids(result)
    assert result.health.counts.stuck > 200


def test_record_times_replace_constant_stamps():
    t, x = still(5000)
    reference = accumulate(t, x).sums[0]
    for stamps in ('header', 'record'):
        result = accumulate(t * 0 + 7, x, record=t, stamps=stamps)
        assert_identical(result.sums[0], reference)
        assert result.health.stamps == 'record'
        assert ('stamps_unusable' in ids(result)) == (stamps == 'header')


@pytest.mark.parametrize('declared', [100.0, 200.0])
def test_a_declared_rate_is_only_checked_unless_there_are_no_stamps(declared):
    t, x = still(5000)
    result = accumulate(t, x, declared_rate=declared)
    assert_identical(result.sums[0], accumulate(t, x).sums[0])
    assert ids(result) == ({'rate_differs'} if declared == 100.0 else set())
    without = accumulate(t * 0, x, declared_rate=declared)
    assert without.sums[0].tau0 == pytest.approx(1 / declared)
    assert ids(without) == {'stamps_from_rate'}


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
    assert '298' in found.message


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


def test_filled_gaps_are_counted_by_length():
    t, x = still(9000)
    x[5000, 2] += 1.0  # an isolated spike in one axis
    moving = x.copy()
    moving[4500:] += np.random.default_rng(0).normal(size=(4500, 6))
    kept = ~np.isin(np.arange(9000), [2000, 3000, 3001, 4000, 4001, 4002])
    expected = np.ones((3, 6), int)
    expected[0, 2] += 1
    for chunk in (1, 7, 9000):
        (sums,) = accumulate(t[kept], x[kept], (chunk,)).sums
        assert np.array_equal(sums.filled, expected), chunk
    assert np.array_equal((sums + sums).filled, 2 * expected)
    (sums,) = accumulate(t[kept], moving[kept]).sums
    assert np.array_equal(sums.filled[:, 0], [1, 1, 1]), 'those that are dropped do not count'


def test_heavy_tails_are_reported_with_the_share_of_outliers():
    t, x = still(20_000)
    x[:, 4] += 5e-3 * np.random.default_rng(1).standard_t(3, len(x))
    (found,) = [f for f in accumulate(t, x).findings if f.severity == 'warning']
    # the share of |t| > 6 median absolute deviations is 1.9 %
    assert found.id == 'outliers' and found.axes == ('accel_y',) and ' 1.' in found.message


@pytest.mark.parametrize('places', [2, 8, 30])
@pytest.mark.parametrize('begin', [0, 5040])
def test_samples_that_arrive_out_of_order_are_sorted(places, begin):
    t, x = still(20_160)
    at = np.arange(len(t))
    order = np.where(at < begin, at, at // places * places + places - 1 - at % places)
    result = accumulate(t[order], x[order])
    assert ids(result) == {'reordered'}
    assert_identical(result.sums[0], accumulate(t, x).sums[0])


@pytest.mark.parametrize('difference', [3.0, 100.0])
@pytest.mark.parametrize('delay', [0.0, 0.2, 0.5])
def test_two_imus_with_one_frame_id_are_reported(difference, delay):
    t, x = still(12_000)
    y = x + difference * 1e-3 * np.random.default_rng(3).choice([-1, 1], 6)
    times = np.sort(np.concatenate([t, t + int(delay * PERIOD)]))
    both = np.empty((2 * len(t), 6))
    both[::2], both[1::2] = x, y
    assert 'interleaved' in ids(accumulate(times, both))


def test_differences_of_a_pulse_counter_are_not_clipped():
    """The differences have rounding errors, so one value of the counter becomes several."""
    t, x = still(12_000)
    angle = np.cumsum(0.1 * x[:, :3] + [3e-4, 5e-4, 7e-4], axis=0)
    x[:, :3] = np.diff(np.floor(angle / 2e-3) * 2e-3, axis=0, prepend=0.0)
    assert 'clipped' not in ids(accumulate(t, x))


@pytest.mark.parametrize('declared, rate', [(0.0, 400 / 3), (200.0, 200.0)])
def test_samples_that_are_missing_regularly_are_reported_with_the_assumed_rate(declared, rate):
    t, x = faulty('third missing', 15_000)
    result = accumulate(t, x, declared_rate=declared)
    assert result.health.rate_hz == pytest.approx(rate, rel=1e-3) and len(result.segments) == 1
    assert ids(result) == ({'interpolated'} if declared else {'rate_assumed'})


@pytest.mark.parametrize('bias', [0.0, 2e-3])
def test_a_gyro_whose_unit_becomes_degrees_does_not_seem_to_rotate(bias):
    """As degrees, a bias of 0.1 deg/s looks like a rotation by 7 deg/s."""
    t, x = still(40_000)
    x[:, :3] += bias
    x[20_000:, :3] = np.degrees(x[20_000:, :3])
    result = accumulate(t, x)
    assert result.health.state == 'noise_increased'
    assert {f.axes for f in result.findings if f.id == 'gyro_unit_changed'} == {AXES[:3]}
    assert result.sums[0].samples == pytest.approx(20_000, abs=400)


def test_louder_noise_at_rest_is_a_warning_with_its_size_and_no_motion():
    t, x = still(40_000)
    x[20_000:] += 3.9 * np.random.default_rng(3).normal(size=(20_000, 6)) * 1e-3
    result = accumulate(t, x)
    (found,) = [f for f in result.findings if f.id == 'noise_increased']
    assert result.health.state == 'noise_increased' and found.axes == AXES
    # the largest of six standard deviations over the lowest quarter of the floor: 4.0 to 4.6
    assert 3.9 < found.values['ratio'] < 4.8 and found.severity == 'warning'
    assert result.sums[0].samples == pytest.approx(20_000, abs=400)


def test_sums_of_motion_are_discarded_and_this_is_reported():
    t, x = still(12_000)
    x[:6000] += np.random.default_rng(0).normal(size=(6000, 6)) * 0.1  # vibration only
    before, after = accumulate(t[:6000], x[:6000]), accumulate(t, x)
    assert before.health.discarded == 0 and after.health.discarded == 1
    (found,) = [f for f in after.findings if f.id == 'relearned']
    excluded_s = (after.segments[0].start_ns - t[0]) * 1e-9
    assert found.values['seconds'] == pytest.approx(excluded_s, abs=1.0)
    assert after.segments[0].start_ns > before.segments[0].start_ns


@pytest.mark.parametrize(
    'scale, expected',
    [
        ([1.0] * 6, set()),
        ([57.3] * 3 + [1.0] * 3, {'gyro_unit'}),
        ([1.0] * 3 + [1 / 9.80665] * 3, {'accel_unit'}),
        ([1.0] * 3 + [1000 / 9.80665] * 3, {'accel_unit'}),
        ([1.0] * 3 + [0.5] * 3, {'accel_scale'}),
        ([1.0] * 5 + [0.0], set()),
    ],
    ids=['SI', 'deg/s', 'g', 'mg', 'wrong scale', 'without gravity'],
)
def test_units_that_cannot_be_si_are_named(scale, expected):
    t, x = still(12_000)
    found = [f for f in accumulate(t, x * scale).findings if 'unit' in f.id or 'scale' in f.id]
    assert {f.id for f in found} == expected
    for f in found:
        assert f.severity == 'error' and ('deg/s' in f.remedy or 'accelerometer' in f.remedy)


@pytest.mark.parametrize('lsb', [0.0, 0.1, 0.5, 2.0])
def test_an_axis_at_the_end_of_its_range_is_reported(lsb):
    times, noise = still(3000)
    noise = noise / noise.std(axis=0)
    samples = np.round(noise / lsb) * lsb if lsb else noise
    assert 'clipped' not in ids(accumulate(times, samples))
    if lsb < 0.5:
        end = np.median(samples[:, 5])
        samples[:, 5] = np.minimum(samples[:, 5], end)
        clipped = [f for f in accumulate(times, samples).findings if f.id == 'clipped']
        assert [f.axes for f in clipped] == [('accel_z',)]


def test_a_rate_whose_stamps_do_not_fit_into_64_bits_is_refused():
    with pytest.raises(AllanError, match='too low'):
        even_stamps(0, 10, 1e-300)
