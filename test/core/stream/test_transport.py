# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings of a live input exist while the problem lasts, and no longer."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from allan_ros.core.findings import finding
from allan_ros.core.stream.health import Counts, StreamHealth
from allan_ros.core.stream.transport import LATELY_S, TransportMonitor, TransportStatistics

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
                self.counts.cuts[CUTS[name]] += more
            else:
                where = self.counts if hasattr(self.counts, name) else self.reception
                setattr(where, name, getattr(where, name) + more)
        counts = replace(self.counts, cuts=Counter(self.counts.cuts))
        health = StreamHealth(
            counts,
            'still',
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
    # after a silence the samples of that time are missing, and no more
    source = Input()
    source.second()
    for _ in range(100):
        source.second(messages=0)
    assert source.second(lost=20_000) == []
    assert source.second() == ['samples_missing']


def test_a_clock_step_is_reported_with_its_direction():
    source = Input()
    source.second()
    assert source.second(lost=720_000) == ['stamps_leapt']
    source = Input()
    source.second()
    assert source.second(jumps=1, backward=15) == ['clock_jumps']
    assert source.second(backward=2) == ['clock_jumps', 'backward_stamps']


def test_another_frame_id_is_reported_until_its_data_are_shown():
    source = Input()
    source.second()
    source.frames = ['other', 'imu', 1]
    assert source.second() == ['frame_changed', 'frame_waits']
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
    past = finding('gaps', lost=3, cuts=1)
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


def test_a_robot_that_drives_since_boot_is_a_warning():
    source = Input()
    source.second(stream=[finding('never_still', seconds=60.0)])
    (found,) = source.watch.observe(
        2.0,
        source.reception,
        StreamHealth(Counts()),
        ONE,
        2.0,
        (finding('never_still', seconds=61.0),),
    )
    assert found.severity == 'warning'


def test_motion_since_the_start_is_reported_after_ten_seconds():
    source = Input()
    moving = [
        source.second(stream=[finding('never_still', seconds=s)], moving=200) for s in range(20)
    ]
    assert moving == [[]] * 9 + [['never_still']] * 11
