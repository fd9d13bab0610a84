# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The player publishes every message with its time; allan_watch shows every status."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy')

from sensor_msgs.msg import Imu

from allan_ros.core.imu import ImuBatch
from allan_ros.io.writing import write_recording
from allan_ros.nodes.imu_input import ImuInput
from allan_ros.nodes.player import Handshake, due_times
from allan_ros.nodes.settings import InputSettings


class Ear:
    """Collects the played messages."""

    def __init__(self, graph) -> None:
        self._graph = graph
        start = 'qos_overrides./imu/data.subscription'
        graph.override(**{f'{start}.reliability': 'reliable', f'{start}.history': 'keep_all'})
        self._input = ImuInput(graph.node, 'imu/data', InputSettings())
        self._batches: list[ImuBatch] = []

    def hear(self, count: int) -> np.ndarray:
        """Return the first ``count`` stamps, as soon as they have arrived."""

        def enough() -> bool:
            self._input.drain()
            self._batches += self._input.batches()
            return sum(map(len, self._batches)) >= count

        self._graph.until(enough)
        return np.concatenate([b.stamps_ns for b in self._batches])[:count]


@pytest.fixture
def bag(still_imu, tmp_path: Path) -> Path:
    write_recording(tmp_path / 'bag', [still_imu(200)])
    return tmp_path / 'bag'


def test_the_schedule_follows_the_stamps_at_any_speed(still_imu):
    batch = still_imu(3, rate=4.0)
    elapsed_ns = batch.stamps_ns - batch.stamps_ns[0]
    assert due_times(elapsed_ns, 5.0, 2.0) == [5.0, 5.125, 5.25]
    assert due_times(elapsed_ns, 5.0, 0.0) is None


def test_it_keeps_the_stamps_of_the_recording(graph, still_imu, bag):
    ear = Ear(graph)
    player = graph.start('player', str(bag), '--rate', '2')
    assert np.array_equal(ear.hear(200), still_imu(200).stamps_ns)
    graph.until(lambda: player.poll() is not None)  # the player asks whether the end has arrived
    assert player.wait() == 0
    assert f'plays {bag} on /imu/data; number of subscribers to wait for: 1' in player.output
    assert 'played 200 messages' in player.output and 'does not answer' not in player.output


def test_a_loop_with_current_stamps_continues_evenly(graph, bag):
    ear = Ear(graph)
    player = graph.start('player', str(bag), '--rate', '0', '--loop', '--stamps', 'rebase')
    stamps = ear.hear(600)
    assert np.array_equal(np.diff(stamps), np.full(599, 5_000_000))
    assert abs(stamps[0] - time.time_ns()) < 60 * 10**9
    assert player.stop(signal.SIGINT, signal.SIGTERM) == 0, player.output


def test_the_end_needs_a_new_answer(graph):
    """An earlier answer does not prove that the last messages arrived, since a frozen node gives
    none.
    """
    accumulator = graph.start('accumulator')
    publisher = graph.node.create_publisher(Imu, 'imu/data', 10)
    handshake = Handshake(graph.node, publisher)
    graph.until(lambda: handshake.update() and not handshake.unanswered())
    accumulator.send_signal(signal.SIGSTOP)
    state = Path(f'/proc/{accumulator.pid}/stat')
    graph.until(lambda: state.read_text().rpartition(') ')[2][0] == 'T')
    handshake.restart()
    for _ in range(10):
        graph.spin(0.05)
        assert not handshake.update()
    accumulator.send_signal(signal.SIGCONT)
    graph.until(handshake.update)
    assert not handshake.unanswered()
    handshake.close()


def test_the_clock_is_published(graph, bag):
    from rosgraph_msgs.msg import Clock

    times: list[int] = []
    graph.node.create_subscription(
        Clock, '/clock', lambda m: times.append(m.clock.sec * 10**9 + m.clock.nanosec), 100
    )
    ear = Ear(graph)
    graph.start('player', str(bag), '--clock', '--wait', '1')
    last = int(ear.hear(200)[-1])
    graph.until(lambda: len(times) >= 10)
    assert times == sorted(times) and times[0] >= 10**18 and times[-1] <= last


def test_it_simulates_an_imu(graph):
    ear = Ear(graph)
    graph.start('player', '--simulate', '2', '--frequency', '100', '--rate', '0')
    assert np.array_equal(np.diff(ear.hear(200)), np.full(199, 10_000_000))


def test_a_recording_that_cannot_be_played_is_reported(graph, tmp_path: Path):
    ear = Ear(graph)  # the player needs a subscriber
    (tmp_path / 'no.mcap').write_bytes(b'')
    nothing = graph.start('player')
    missing = graph.start('player', str(tmp_path / 'missing'))
    broken = graph.start('player', str(tmp_path / 'no.mcap'))
    for player, reason in ((nothing, 'nothing to play'), (missing, 'missing'), (broken, 'no.mcap')):
        graph.until(lambda ended=player.poll: ended() is not None)
        assert player.wait() == 1
        assert reason in player.output and 'Traceback' not in player.output
    assert ear is not None


def test_the_watcher_shows_each_status(graph, still_imu):
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    watch = graph.start('watch', '--plain')
    publisher = graph.node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    graph.introduce(publisher, wanted=2)
    good = DiagnosticStatus(name='allan_monitor: imu gyro x', message='N 0.172 deg/sqrt(h)')
    bad = DiagnosticStatus(
        name='allan_monitor: input', message='nothing comes', level=DiagnosticStatus.ERROR
    )
    unrelated = DiagnosticStatus(name='battery: charge', message='full')
    publisher.publish(DiagnosticArray(status=[good, bad, unrelated]))
    graph.until(lambda: 'imu gyro x' in watch.output)
    assert watch.stop() == 0
    assert 'ERROR input: nothing comes' in watch.output
    assert 'imu gyro x' in watch.output and '0.172 deg/sqrt(h)' in watch.output
    assert 'battery' not in watch.output


def test_a_subscriber_that_has_gone_is_not_waited_for(graph):
    from rclpy.node import Node

    mute = Node('mute', context=graph.node.context, start_parameter_services=False)
    mute.create_subscription(Imu, 'imu/data', lambda message: None, 10)
    publisher = graph.node.create_publisher(Imu, 'imu/data', 10)
    handshake = Handshake(graph.node, publisher, 0)
    graph.until(lambda: not handshake.update() and handshake.unanswered() == ('/mute',))
    mute.destroy_node()
    graph.until(lambda: handshake.update() and not handshake.unanswered())
    handshake.close()
