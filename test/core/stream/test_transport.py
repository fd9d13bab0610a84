# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings of a live input exist while the problem lasts, and no longer."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from allan_ros.core.findings import finding
from allan_ros.core.imu import ImuBatch
from allan_ros.core.stream.health import Counts, StreamHealth
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.core.stream.transport import (
    LATELY_S,
    Arrivals,
    ConstantAxes,
    TransportMonitor,
    TransportStatistics,
)

ONE = ('/driver',)
CUTS = {'rate_changes': 'rate change', 'jumps': 'clock jump'}


class Input:
    """An input watched once a second."""

    def __init__(self) -> None:
        self.watch = TransportMonitor('/imu', 0.0)
        self.time_s = 0.0
        self.reception = TransportStatistics()
        self.counts = Counts()
        self.frames = ['imu', 'imu', 0]
        self.rate_hz: float | None = 200.0

    def second(
        self, publishers=ONE, stream=(), messages: int = 200, graph=(), **changes: int
    ) -> list[str]:
        """Advance by a second in which counts grow; return the ids of the findings."""
        self.time_s += 1.0
        self.reception.received += messages
        self.counts.received += messages
        for name, more in changes.items():
            if name in CUTS:
                self.counts.splits[CUTS[name]] += more
            else:
                where = self.counts if hasattr(self.counts, name) else self.reception
                setattr(where, name, getattr(where, name) + more)
        counts = replace(self.counts, splits=Counter(self.counts.splits))
        health = StreamHealth(
            counts,
            'at_rest',
            self.rate_hz,
            frame_id=self.frames[0],
            sums_frame_id=self.frames[1],
            frame_changes=self.frames[2],
        )
        found = self.watch.observe(
            self.time_s, self.reception, health, publishers, 2.0, tuple(stream), graph
        )
        return [f.id for f in found]


def test_a_good_input_has_no_findings():
    source = Input()
    assert [source.second() for _ in range(100)] == [[]] * 100


def test_silence_is_reported_with_its_cause():
    source = Input()
    # discovery takes some seconds at the start
    assert [source.second((), messages=0) for _ in range(4)] == [[]] * 4
    assert source.second((), messages=0) == ['no_publisher']
    assert source.second(messages=0) == ['input_silent']
    assert source.second() == []
    for _ in range(2):
        source.second(messages=0)
    assert source.second(messages=0) == ['input_silent']
    assert source.second((), messages=0) == ['input_stopped']


def test_messages_of_no_use_are_an_error():
    source = Input()
    source.second()
    found = [source.second(not_finite=200) for _ in range(3)]
    assert found[-1] == ['input_unusable', 'not_finite']
    assert source.second() == ['not_finite']


def test_messages_without_data_of_any_sensor_are_an_error():
    """All values are NaN, infinite or zero, so no rate is ever learned."""
    source = Input()
    source.rate_hz = None
    assert ['input_unusable'] in [source.second() for _ in range(20)]


def test_a_problem_is_reported_for_a_limited_time():
    names = ('stuck', 'not_finite', 'duplicate', 'backward', 'rate_changes', 'reported_lost')
    for name in (*names, 'jumps'):
        source = Input()
        source.second()
        assert len(source.second(**{name: 20})) == 1
        for _ in range(int(LATELY_S) - 1):
            assert len(source.second()) == 1
        source.second()
        assert source.second() == []


def test_a_message_lost_in_a_thousand_is_not_worth_a_word():
    source = Input()
    for _ in range(60):
        source.second()
    assert source.second(reported_lost=1) == []
    assert source.second(reported_lost=30) == ['messages_lost']


def test_counts_of_a_new_run_begin_at_zero():
    source = Input()
    for _ in range(5):
        source.second(stuck=100)
    source.counts = Counts()
    assert source.second() == []
    assert source.second(stuck=5) == ['stuck']


def test_samples_that_the_driver_never_sent_are_counted_separately():
    source = Input()
    source.second()
    assert source.second(messages=190, lost=10) == []
    assert source.second() == ['samples_missing']
    # of the latest samples the judgment may be taken back, as where the rate changes
    assert source.second(lost=90) == source.second(lost=-90) == ['samples_missing']
    # what is dropped, or lost on the way, is missing by the stamps as well
    source = Input()
    for _ in range(100):
        assert 'samples_missing' not in source.second(not_finite=200)
    assert source.second(lost=20_000) == ['not_finite']
    source = Input()
    source.second()
    assert source.second(messages=190, lost=10, reported_lost=10) == ['messages_lost']
    assert source.second() == ['messages_lost']


def test_a_clock_step_is_reported_with_its_direction():
    source = Input()
    source.second()
    source.reception.leapt_s += 3600.0
    assert source.second(lost=720_000) == ['stamps_leapt']
    source = Input()
    source.second()
    assert source.second(jumps=1, backward=15) == ['clock_jumps']
    assert source.second(backward=2) == ['clock_jumps', 'backward_stamps']


def test_another_frame_id_is_reported_until_its_data_are_shown():
    source = Input()
    source.second()
    source.frames = ['other', 'imu', 1]
    assert {*source.second()} == {'frame_changed', 'frame_waits'}
    for _ in range(int(LATELY_S)):
        source.second()
    assert source.second() == ['frame_waits']
    source.frames = ['other', 'other', 1]
    assert source.second() == []
    source.frames = ['imu', 'imu', 2]  # its samples of that minute are no gap of the driver
    assert source.second(lost=12_000) == source.second() == ['frame_changed']


def test_a_malformed_message_before_a_silence_hides_nothing():
    source = Input()
    source.second()
    source.reception.received += 1
    source.second(stuck=30)
    assert source.second(messages=0) == ['stuck']


def test_present_problems_precede_past_events():
    source = Input()
    for _ in range(3):
        source.second()
    two = ('/a', '/b')
    live = finding('rate_differs', measured=100.0, declared=200.0)
    past = finding('gaps', lost=3, splits=1)
    found = source.second(two, [past, live])
    assert found == ['several_publishers', 'rate_differs']


def test_silence_is_first_explained_by_the_graph():
    source = Input()
    source.second()
    wrong = finding('wrong_type', topic='/imu', types='std_msgs/msg/String', candidates='')
    for _ in range(5):
        found = source.second(messages=0, graph=(wrong,))
    assert found == ['wrong_type']
    assert source.second(messages=0) == ['input_silent']


def test_a_changed_rate_is_not_reported_as_missing_samples():
    source = Input()
    source.second()
    assert source.second(messages=100, lost=100, rate_changes=1) == ['rate_changed']
    assert source.second(messages=100) == ['rate_changed']


def test_lost_messages_are_counted_by_the_better_witness():
    assert TransportStatistics(skipped_numbers=3, reported_lost=7).lost == 7
    assert TransportStatistics(skipped_numbers=9, reported_lost=7).lost == 9


RATE = 100.0


def live_findings(
    stamps_s, arrival_s, kept, phase: float, samples=None
) -> tuple[set[str], set[str]]:
    """Return ids of the warnings of a watched stream, and those in the last 20 s.

    Messages with ``kept`` are received. Their number is observed once a second, at a ``phase``.
    """
    statistics = TransportStatistics()
    arrivals, stream = Arrivals(statistics), ImuStream()
    watch = TransportMonitor('/imu', 0.0)
    if samples is None:
        samples = np.random.default_rng(1).normal(0.0, 1e-3, (len(stamps_s), 6)) + [
            0,
            0,
            0,
            0,
            0,
            9.8,
        ]
    stamps = np.round(np.asarray(stamps_s) * 1e9).astype(np.int64) + 10**18
    seen: list[set[str]] = []
    low = 0
    for now in np.arange(phase, arrival_s[-1] + 3.0, 0.5):
        high = int(np.searchsorted(arrival_s, now))
        rows = np.arange(low, high)[kept[low:high]]
        statistics.received += len(rows)
        statistics.skipped_numbers += int((~kept[low : rows[-1] + 1]).sum()) if len(rows) else 0
        low = rows[-1] + 1 if len(rows) else low
        arrivals.update(stamps[rows], arrival_s[rows])
        stream.update(ImuBatch(stamps[rows], samples[rows], frame_id='imu'))
        if (now - phase) % 1.0:
            continue
        health, found = stream.present_health(())
        found = watch.observe(now, statistics, health, ONE, 2.0, found)
        seen.append({f.id for f in found if f.severity != 'info'} - {'short'})
    return set().union(*seen), set().union(*seen[-20:])


@pytest.mark.parametrize('phase', [0.03, 0.31, 0.77])
@pytest.mark.parametrize(
    'event, expected',
    [
        ('silence', {'interrupted', 'input_silent'}),
        ('loss', {'messages_lost', 'input_silent'}),
        ('step', {'stamps_leapt'}),
        ('step and silence', {'stamps_leapt', 'interrupted', 'input_silent'}),
        ('backlog', {'input_silent'}),
        ('missing', {'samples_missing'}),
        ('nothing', set()),
    ],
)
def test_each_event_in_the_stamps_has_its_own_cause(event, expected, phase):
    """Silence, loss in transport, clock steps and samples that were never sent look alike."""
    rng = np.random.default_rng(round(100 * phase))
    n = 6000
    sent = np.arange(n) / RATE
    delay = rng.exponential(2e-3, n)
    kept = np.ones(n, bool)
    at = 2000 + int(rng.integers(0, 100))
    stamps = sent.copy()
    arrival = sent + delay
    if event in ('silence', 'step and silence'):
        stamps[at:] += 6.0
        arrival[at:] += 6.0
    if event == 'loss':
        kept[at : at + 600] = False
    if event in ('step', 'step and silence'):
        stamps[at:] += 2.0
    if event == 'backlog':  # the network holds messages back, and then delivers them
        arrival[at : at + 600] = arrival[at + 600]
    if event == 'missing':
        present = rng.random(n) > 0.05
        stamps, arrival, kept = stamps[present], arrival[present], kept[present]
    found, _ = live_findings(stamps, np.maximum.accumulate(arrival), kept, phase)
    assert found == expected


def test_a_recording_played_fast_has_no_clock_steps():
    stamps = np.arange(20_000) / RATE
    stamps[10_000:] += 30.0
    statistics = TransportStatistics()
    arrivals = Arrivals(statistics)
    for rows in np.split(np.arange(20_000), 40):
        arrivals.update((stamps[rows] * 1e9).astype(np.int64), stamps[rows] / 10.0)
    assert statistics.leapt_s == 0.0


def test_a_stuck_axis_is_named():
    rng = np.random.default_rng(3)
    samples = np.round(rng.normal(0.0, 2.0, (4000, 6)))  # coarse: values repeat by chance
    samples[2000:, 2] = samples[2000, 2]
    samples[:, 4] = 9.8  # never changed: another finding
    constant, found = ConstantAxes(), []
    for rows in np.split(samples, 80):
        constant.update(rows)
        found.append(constant.stuck(RATE))
    assert not any(found[:42])
    assert all(one == ('gyro_z',) for one in found[46:])


def test_a_past_event_does_not_precede_a_present_fault():
    source = Input()
    for _ in range(3):
        source.second()
    unit = finding('gyro_unit', ('gyro_x',), n=1.0, rate=1.0)
    assert source.second(stream=[unit], reported_lost=50)[0] == 'gyro_unit'
    for _ in range(5):
        assert source.second(stream=[unit]) == ['gyro_unit', 'messages_lost']
    assert source.second(stream=[unit], not_finite=200, messages=200)[:1] == ['gyro_unit']
