# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From stamps to sample numbers: gaps, bursts, and changes of the rate."""

import numpy as np
import pytest

from allan_ros.core.imu import ImuBatch, joined
from allan_ros.core.settings import SegmenterSettings
from allan_ros.core.stream import timing
from allan_ros.core.stream.health import Counts
from allan_ros.core.stream.timing import Clock, SampleClock, learn_clock

MS = 1_000_000


def even(n, period_ns=10 * MS, start=10**18):
    return start + np.arange(n) * period_ns


def bursts(n, period_ns=10 * MS, size=5, within_ns=200_000):
    """Return stamps of samples that arrive in bursts, as a busy computer stamps them."""
    i = np.arange(n)
    return 10**18 + (i // size + 1) * size * period_ns + (i % size) * within_ns


def run(stamps, rows=None, max_bridge=3):
    """Return the blocks between gaps, the counts, and the stage after all stamps."""
    counts = Counts()
    rows = np.arange(float(len(stamps)))[None, :] if rows is None else rows
    stage = SampleClock(len(rows), SegmenterSettings(max_bridge=max_bridge), False, counts)
    runs = stage.feed(ImuBatch.of_rows(stamps, rows)) + stage.flush()
    segments = []
    for r in runs:
        if segments and not r.cut:
            r = joined([segments.pop(), r])
        segments.append(r)
    return segments, counts, stage


@pytest.mark.parametrize(
    'stamps, rate, bursty',
    [
        (even(1024), 100, False),
        (np.delete(even(1500), slice(300, 700)), 100, False),
        (np.sort(even(1024) + np.random.default_rng(0).integers(-3, 4, 1024) * MS), 100, False),
        (even(1024)[np.random.default_rng(1).random(1024) > 0.3], 100, False),
        (even(1024) // (10 * MS) * (10 * MS), 100, False),
        (np.arange(1024) * 1000 // 300 * MS, 300, False),
        (bursts(1024), 100, True),
        (bursts(1024, size=20), 100, True),
    ],
    ids=['even', 'gap', 'jitter', '30 % lost', 'exact', 'ms ticks', 'bursts', 'long bursts'],
)
def test_rate_is_found_from_the_stamps(stamps, rate, bursty):
    clock = learn_clock(stamps)
    assert clock.bursty == bursty
    assert 1e9 / clock.period_ns == pytest.approx(rate, rel=0.05 if bursty else 0.01)


def test_stamps_before_an_earlier_stamp_do_not_change_the_period_of_stamps_with_jitter():
    stamps = np.sort(even(1024) + np.random.default_rng(0).integers(-4 * MS, 4 * MS, 1024))
    stamps[500:] -= 100 * 10**9
    clock = learn_clock(stamps)
    assert clock.jitter
    assert clock.period_ns == pytest.approx(10 * MS, rel=1e-3)


def runs(n, pause_s, size=100, period_ns=10 * MS):
    """Return even stamps in runs of ``size`` samples, with pauses between them."""
    pauses = np.cumsum(np.resize(np.asarray(pause_s, float), n // size + 1))
    i = np.arange(n)
    return 10**18 + i * period_ns + (pauses[i // size] * 1e9).astype(np.int64)


@pytest.mark.parametrize(
    'stamps, rate',
    [
        (runs(1024, 1.0), 100),
        (runs(1024, 60.0), 100),
        (runs(1024, 5.0, size=400), 100),
        (runs(1024, [1.0, 7.0, 20.0, 3.0], period_ns=MS), 1000),
    ],
    ids=['1 s', '60 s', 'long runs', '1 kHz'],
)
def test_even_runs_with_pauses_have_gaps(stamps, rate):
    clock = learn_clock(stamps)
    assert not clock.bursty and 1e9 / clock.period_ns == pytest.approx(rate, rel=1e-3)
    late = learn_clock(stamps, declared=1e9 * 1023 / (stamps[-1] - stamps[0]))
    assert late.bursty, 'the declared rate decides'
    parts, counts, _ = run(np.concatenate([stamps, stamps[-1] + 10**10 + np.arange(999) * 10**7]))
    assert len(parts) == counts.splits['gap'] + 1 > 2


@pytest.mark.parametrize('declared, rate', [(100.0, 100.0), (300.0, 102.3)])
def test_the_declared_rate_counts_for_bursts(declared, rate):
    clock = learn_clock(bursts(1024, size=80), declared=declared)
    assert clock.bursty and 1e9 / clock.period_ns == pytest.approx(rate, rel=0.1)
    assert (1e9 / clock.period_ns == pytest.approx(declared)) == (declared == 100.0)


def stepped(*values):
    """Return 20,000 stamps in s as ns: equal parts with these values."""
    return np.repeat(np.asarray(values) * 10**9, 20_000 // len(values)).astype(np.int64)


@pytest.mark.parametrize(
    'stamps',
    [
        stepped(5),
        stepped(5, 6),
        stepped(5, 6, 7, 8),
        np.append(stepped(5), 6 * 10**9),
        np.append(4 * 10**9, stepped(5)),
        stepped(*range(6, 46)),
    ],
    ids=['equal', 'two', 'four', 'last', 'first', 'bursts of 500'],
)
def test_stamps_with_too_few_steps_have_no_time(stamps):
    parts, counts, stage = run(stamps)
    assert parts == [] and stage.clock is None and counts.untimed == len(stamps)


def test_equal_stamps_at_the_start_do_not_change_the_period():
    stamps = np.concatenate([np.full(5000, 10**18), even(15_000)])
    parts, counts, stage = run(stamps)
    assert stage.clock.period_ns == 10 * MS and counts.untimed == 5001
    assert sum(map(len, parts)) == 14_999


def test_isolated_losses_are_bridged_on_the_line_between_their_neighbors():
    stamps = even(3000)
    lost = np.array([500, 501, 1700])
    keep = np.delete(np.arange(3000), lost)
    (one,), counts, _ = run(stamps[keep], np.stack([keep * 1.0, keep * -2.0]))
    assert np.array_equal(one.stamps_ns, stamps)
    assert one.rows == pytest.approx(np.stack([np.arange(3000.0), np.arange(3000) * -2.0]))
    assert (counts.lost, counts.interpolated, counts.splits) == (3, 3, {})


@pytest.mark.parametrize('day', [0, 1])
def test_losses_with_jitter_are_not_a_change_of_the_rate(day):
    """Normal jitter of 30 % of the period and 3 % random losses, also with a gap of a day.

    With such jitter some losses are missed, and nearly as many are detected where there is none.
    """
    n, rng = 40_000, np.random.default_rng(1)
    stamps = np.maximum.accumulate(even(n) + (rng.standard_normal(n) * 3 * MS).astype(int))
    stamps[500:] += day * 86_400_000 * MS
    runs, counts, stage = run(stamps[rng.random(n) > 0.03])
    assert stage.clock.jitter and not stage.rate_changed
    assert stage.clock.period_ns == pytest.approx(10 * MS, rel=1e-3)
    assert sum(len(r.stamps_ns) for r in runs) == pytest.approx(n, rel=0.01)
    assert counts.splits['gap'] <= 1 + day


def test_random_losses_of_a_fifth_do_not_split_the_data():
    keep = np.random.default_rng(0).random(20_000) > 0.2
    runs, counts, _ = run(even(20_000)[keep], max_bridge=20)
    assert len(runs) == 1 and counts.interpolated == counts.lost


def test_a_longer_gap_splits_the_data_without_interpolation():
    keep = np.delete(np.arange(3000), slice(1000, 1004))
    (a, b), counts, _ = run(even(3000)[keep], keep[None, :] * 1.0)
    assert (a.cut, b.cut) == ('', 'gap')
    assert np.array_equal(np.concatenate([a.rows, b.rows], axis=1), keep[None, :])
    assert (counts.lost, counts.interpolated) == (4, 0) and counts.splits == {'gap': 1}
    # without interpolation, every loss splits the data
    runs, counts, _ = run(np.delete(even(2000), [400, 900]), max_bridge=0)
    assert len(runs) == 3 and counts.splits == {'gap': 2}


def test_a_late_sample_is_not_a_lost_one():
    """One interval is 1.9 periods long and the next one 0.1 periods."""
    stamps = even(3000)
    stamps[1500] += 9 * MS
    (one,), counts, _ = run(stamps)
    assert len(one.stamps_ns) == 3000 and counts.lost == 0


@pytest.mark.parametrize('silence_ms', [300, 500, 1500])
def test_a_pause_followed_by_a_burst_is_not_a_gap(silence_ms):
    stamps = bursts(6000)
    late = stamps[3000] + silence_ms * MS
    held = (stamps >= stamps[3000]) & (stamps < late)
    stamps[held] = late + np.arange(held.sum()) * 200_000
    stamps = np.maximum.accumulate(stamps)
    runs, counts, stage = run(stamps)
    assert len(runs) == 1 and counts.lost == 0 and not stage.rate_changed


def test_a_pause_in_bursty_stamps_without_a_burst_is_a_gap():
    stamps = bursts(6000)
    stamps[3000:] += 1000 * MS
    runs, counts, _ = run(stamps)
    assert [len(r.stamps_ns) for r in runs] == [3000, 3000]
    assert counts.lost == pytest.approx(100, abs=5)


def test_slow_wander_of_the_period_is_followed():
    """The period grows by 1 % over 20,000 samples: no loss, no gap, no change of the rate."""
    step = 10 * MS * (1 + 0.01 * np.arange(20_000) / 20_000)
    stamps = 10**18 + np.cumsum(step).astype(np.int64)
    runs, counts, stage = run(stamps)
    assert len(runs) == 1 and counts.lost == 0 and not stage.rate_changed
    # it lags by the tracking interval and a half
    assert stage.clock.period_ns == pytest.approx(step[-1], rel=1.5 * 0.01 * 4096 / 20_000)


@pytest.mark.parametrize('factor', [0.5, 0.8, 0.97, 1.04, 1.3, 1.6, 2.0, 3.0])
def test_another_rate_is_reported(factor):
    stamps = np.concatenate([even(3000), even(3000)[-1] + even(2000, round(10 * MS * factor), 0)])
    runs, _, stage = run(np.unique(stamps))
    assert stage.rate_changed
    assert 3000 - 256 <= sum(len(r.stamps_ns) for r in runs) <= 3256
    assert len(stage.pending) > 1700


def test_learning_the_rate_always_ends(monkeypatch):
    """Samples from which the rate was learned never count as a new rate, so learning ends."""
    stamps = np.concatenate([even(512), even(512)[-1] + even(3000, 13 * MS, 0)[1:]])
    clock = Clock(10.0 * MS, 10.0 * MS, bursty=False)
    monkeypatch.setattr(timing, 'learn_clock', lambda *_: clock)
    _, _, stage = run(stamps)
    assert len(stage.pending) <= len(stamps) - timing.learned_from(stamps)


@pytest.mark.parametrize('rate', [30, 50, 80])
def test_a_change_of_the_rate_is_found_at_the_same_sample_in_batches_of_any_size(rate):
    """At these rates, the period is not learned from a whole number of blocks."""
    period = 10**9 // rate
    later = even(2001, round(period / 1.2), 0)[1:]
    stamps = np.concatenate([even(2900, period), even(2900, period)[-1] + later])
    pending = []
    for size in (64, 500, len(stamps)):
        stage = SampleClock(1, SegmenterSettings(), False, Counts())
        rest = [stamps[i : i + size] for i in range(0, len(stamps), size)]
        while rest and not stage.rate_changed:
            part = rest.pop(0)
            stage.feed(ImuBatch.of_rows(part, np.zeros((1, len(part)))))
        assert stage.rate_changed
        pending.append(int(stage.pending.stamps_ns[0]))
    assert len(set(pending)) == 1
