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
        self, publishers=ONE, stream=(), messages=200, graph=(), frames=None, **changes
    ) -> list[str]:
        """Advance by a second in which counts grow; return the ids of the findings."""
        self.time_s += 1.0
        self.frames = frames or self.frames
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


TWO = ('/a', '/b')
SILENT, GONE = {'messages': 0}, {'messages': 0, 'publishers': ()}
LIVE = finding('rate_differs', measured=100.0, declared=200.0)
PAST = finding('gaps', lost=3, splits=1)
UNIT = finding('gyro_unit', ('gyro_x',), n=1.0, rate=1.0)
TYPE = finding('wrong_type', topic='/imu', types='std_msgs/msg/String', candidates='')
NUMBERS = {'frames': ['imu', 'imu', 2]}
OTHER, SHOWN = {'frames': ['other', 'imu', 1]}, {'frames': ['other', 'other', 1]}


@pytest.mark.parametrize(
    'seconds, expected',
    [
        ([{}] * 100, [''] * 100),
        # discovery takes some seconds at the start
        ([GONE] * 5 + [SILENT, {}], [''] * 4 + ['no_publisher', 'input_silent', '']),
        ([{}, SILENT, SILENT, SILENT, GONE], ['', '', '', 'input_silent', 'input_stopped']),
        (
            [{}] + [{'not_finite': 200}] * 3 + [{}],
            ['', 'not_finite', 'not_finite', 'input_unusable not_finite', 'not_finite'],
        ),
        ([{}] * 60 + [{'reported_lost': 1}, {'reported_lost': 30}], [''] * 61 + ['messages_lost']),
        ([{}, {'messages': 190, 'lost': 10}, {}], ['', '', 'samples_missing']),
        # of the latest samples the judgment may be taken back, as where the rate changes
        ([{}, {'lost': 90}, {'lost': -90}, {}], [''] * 4),
        # what is excluded, or lost on the way, is missing by the stamps as well
        ([{'not_finite': 200}] * 3 + [{'lost': 600}, {}], None),
        (
            [{}, {'messages': 190, 'lost': 10, 'reported_lost': 10}, {}],
            ['', *['messages_lost'] * 2],
        ),
        ([{}, {'leapt_s': 3600.0}, {'lost': 720_000}], ['', 'stamps_leapt', 'stamps_leapt']),
        (
            [{}, {'jumps': 1, 'backward': 15}, {'backward': 2}],
            ['', 'clock_jumps', 'clock_jumps backward_stamps'],
        ),
        (
            [{}, OTHER] + [{}] * 61 + [SHOWN],
            ['', *['frame_waits frame_changed'] * int(LATELY_S)]
            + ['frame_waits'] * (62 - int(LATELY_S))
            + [''],
        ),
        # the samples of a minute with another frame_id are no gap of the driver
        ([{}, {**NUMBERS, 'lost': 12_000}, {}], ['', 'frame_changed', 'frame_changed']),
        # a malformed message before a silence hides nothing
        ([{}, {'received': 1, 'stuck': 30}, SILENT], ['', 'stuck', 'stuck']),
        (
            [{}, {'publishers': TWO, 'stream': [PAST, LIVE]}],
            ['', 'several_publishers rate_differs'],
        ),
        (
            [{}] + [{**SILENT, 'graph': (TYPE,)}] * 5 + [SILENT],
            ['', *['wrong_type'] * 5, 'input_silent'],
        ),
        # a changed rate is not reported as missing samples
        (
            [{}, {'messages': 100, 'lost': 100, 'rate_changes': 1}, {'messages': 100}],
            ['', 'rate_changed', 'rate_changed'],
        ),
        # a past event does not precede a present fault
        (
            [{}, {'stream': [UNIT], 'reported_lost': 50}] + [{'stream': [UNIT]}] * 5,
            ['', *['gyro_unit messages_lost'] * 6],
        ),
    ],
)
def test_each_finding_is_reported_while_it_lasts(seconds, expected):
    source = Input()
    found = [' '.join(source.second(**each)) for each in seconds]
    if expected is None:
        assert not any('samples_missing' in each for each in found)
    else:
        assert found == expected


def test_messages_without_data_of_any_sensor_are_an_error():
    """All values are NaN, infinite or zero, so no rate is ever learned."""
    source = Input()
    source.rate_hz = None
    assert ['input_unusable'] in [source.second() for _ in range(20)]


@pytest.mark.parametrize(
    'name',
    ['stuck', 'not_finite', 'duplicate', 'backward', 'rate_changes', 'reported_lost', 'jumps'],
)
def test_a_problem_is_reported_for_a_limited_time(name):
    source = Input()
    source.second()
    assert len(source.second(**{name: 20})) == 1
    for _ in range(int(LATELY_S) - 1):
        assert len(source.second()) == 1
    source.second()
    assert source.second() == []


def test_counts_of_a_new_run_begin_at_zero():
    source = Input()
    for _ in range(5):
        source.second(stuck=100)
    source.counts = Counts()
    assert source.second() == []
    assert source.second(stuck=5) == ['stuck']


def test_a_count_that_decreases_is_no_event():
    """The counts of a result contain the buffered samples, the counts between two do not."""
    source = Input()
    source.second()
    assert source.second(stuck=20) == ['stuck']
    source.counts.stuck -= 20
    for _ in range(2):
        source.second()
    source.counts.stuck += 20
    for _ in range(int(LATELY_S) - 3):
        assert source.second() == ['stuck']
    source.second()
    assert source.second() == []


def test_lost_messages_are_counted_by_the_better_witness():
    assert TransportStatistics(skipped_numbers=3, reported_lost=7).lost == 7
    assert TransportStatistics(skipped_numbers=9, reported_lost=7).lost == 9


RATE = 100.0


def live_findings(stamps_s, arrival_s, kept, phase: float) -> set[str]:
    """Return the ids of the warnings of a watched stream.

    Messages with ``kept`` are received. Their number is observed once a second, at a ``phase``.
    """
    statistics = TransportStatistics()
    arrivals, stream = Arrivals(statistics), ImuStream()
    watch = TransportMonitor('/imu', 0.0)
    samples = np.random.default_rng(1).normal(0.0, 1e-3, (len(stamps_s), 6))
    samples[:, 5] += 9.8
    stamps = np.round(np.asarray(stamps_s) * 1e9).astype(np.int64) + 10**18
    seen: set[str] = set()
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
        seen |= {f.id for f in found if f.severity != 'info'}
    return seen


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
    assert live_findings(stamps, np.maximum.accumulate(arrival), kept, phase) == expected


def test_a_recording_played_fast_has_no_clock_steps():
    stamps = np.arange(20_000) / RATE
    stamps[10_000:] += 30.0
    statistics = TransportStatistics()
    arrivals = Arrivals(statistics)
    for rows in np.split(np.arange(20_000), 40):
        arrivals.update((stamps[rows] * 1e9).astype(np.int64), stamps[rows] / 10.0)
    assert statistics.leapt_s == 0.0


def test_arrivals_are_independent_of_the_batches():
    """Messages between two steps of the stamps are processed together."""
    rng = np.random.default_rng(5)
    n = 3000
    stamps = np.arange(n) / RATE + rng.normal(0.0, 0.02, n)  # some messages are out of order
    arrival = np.arange(n) / RATE
    for start, step in ((1000, 0.5), (1700, 3.0), (2400, 4.0), (2900, -2.0), (2903, 1.0)):
        stamps[start:] += step
    arrival[2400:] += 4.0  # no message was sent for 4 s
    found = []
    for size in (1, 7, n):
        statistics = TransportStatistics()
        arrivals = Arrivals(statistics)
        for first in range(0, n, size):
            rows = slice(first, first + size)
            arrivals.update((stamps[rows] * 1e9).astype(np.int64) + 10**18, arrival[rows])
        found.append(statistics)
    assert found[0] == found[1] == found[2]
    assert found[0].interruptions == 1
    assert 3.0 < found[0].leapt_s < 4.0


def test_a_stuck_axis_is_named():
    rng = np.random.default_rng(3)
    samples = np.round(rng.normal(0.0, 2.0, (4000, 6)))  # coarse: values repeat by chance
    samples[2000:3000, 2] = samples[2000, 2]
    samples[3200:, 2] = 7.0  # a loose contact: the axis is stuck again after a short time
    samples[:, 4] = 9.8  # never changed: another finding
    constant, found = ConstantAxes(), []
    for rows in np.split(samples, 80):
        constant.update(rows)
        found.append(constant.stuck(RATE))
    assert not any(found[:42])
    assert all(one == ('gyro_z',) for one in [*found[46:60], *found[70:]])
    assert not any(found[60:66])
    later = ConstantAxes()
    later.update(samples)
    assert later.stuck(RATE) == later.stuck(RATE) == ('gyro_z',)  # a query changes nothing
