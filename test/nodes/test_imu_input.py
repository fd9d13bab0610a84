# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Draining the queue and callbacks give the same messages."""

from __future__ import annotations

import time

import numpy as np
import pytest

pytest.importorskip('rclpy')

from allan_ros.core.imu import ImuBatch
from allan_ros.nodes.imu_input import ImuInput
from allan_ros.nodes.node_settings import InputSettings
from allan_ros.readers.cdr import encode_imus

SETTINGS = InputSettings()


def receive(graph, imu_input: ImuInput, count: int) -> list[ImuBatch]:
    batches: list[ImuBatch] = []

    def enough() -> bool:
        imu_input.drain()
        batches.extend(imu_input.batches())
        return sum(map(len, batches)) >= count

    graph.until(enough)
    return batches


@pytest.mark.parametrize('polled', [True, False])
def test_messages_are_complete_and_in_order(graph, still_imu, monkeypatch, polled: bool):
    """Also with a version of rclpy that cannot take messages."""

    def missing(subscription: object) -> None:
        raise AttributeError('take_message')

    if not polled:
        monkeypatch.setattr('allan_ros.nodes.imu_input._take', missing)
    imu_input = ImuInput(graph.node, 'imu/data', SETTINGS)
    assert imu_input.polled == polled
    publisher = graph.publisher()
    sent = still_imu(300)
    graph.send(publisher, sent)
    got = receive(graph, imu_input, len(sent))
    assert np.array_equal(np.concatenate([b.stamps_ns for b in got]), sent.stamps_ns)
    assert np.array_equal(np.concatenate([b.samples for b in got]), sent.samples)
    assert {b.frame_id for b in got} == {'imu'}
    received = np.concatenate([b.record_ns for b in got])
    assert np.all(np.diff(received) >= 0) and received[0] > 10**18
    assert imu_input.statistics().received == len(sent)
    assert imu_input.statistics().lost == 0
    assert imu_input.publishers() == (('/test_client',), ())


def test_a_node_that_computes_for_a_second_loses_no_message_at_20_khz(graph, still_imu):
    """The publisher is reliable, so that nothing but the queue of the input can lose messages."""
    queue = 'qos_overrides./imu/data.subscription'
    graph.run('accumulator', **{f'{queue}.history': 'keep_last'})
    publisher = graph.publisher()
    payloads = [bytes(p) for p in encode_imus(still_imu(20_000, rate=20_000.0), 'cdr')]
    began = time.monotonic()
    for i, payload in enumerate(payloads):  # nothing is executed meanwhile
        publisher.publish(payload)
        while time.monotonic() - began < i / 20_000:
            time.sleep(0.001)
    graph.until(lambda: graph.value('input', 'received') == '20000')
    assert graph.value('input', 'lost on the way') == '0'


def test_messages_lost_by_a_full_queue_are_counted(graph, still_imu, monkeypatch):
    """The memory for messages is full while the node computes, and then the queue."""
    monkeypatch.setattr('allan_ros.nodes.imu_input.QUEUE_DEPTH', 10)
    monkeypatch.setattr('allan_ros.nodes.imu_input.BUFFER_BYTES', 3000)
    imu_input = ImuInput(graph.node, 'imu/data', SETTINGS)
    publisher = graph.publisher()
    graph.send(publisher, still_imu(1))
    receive(graph, imu_input, 1)
    graph.send(publisher, still_imu(100))
    graph.spin(0.5)
    receive(graph, imu_input, 10)
    graph.send(publisher, still_imu(1))
    receive(graph, imu_input, 1)
    reception = imu_input.statistics()
    assert reception.received + reception.lost == 102
    assert reception.lost >= 60


def test_a_drained_subscription_is_not_in_the_wait_set(graph):
    """Events in the wait set would wake the executor as long as there are unread messages."""
    before = list(graph.node.waitables)
    imu_input = ImuInput(graph.node, 'imu/data', SETTINGS)
    assert list(graph.node.waitables) == before
    groups = [s.callback_group for s in graph.node.subscriptions if s.topic_name == imu_input.topic]
    assert len(groups) == 1 and not groups[0].can_execute(None)


def test_absent_sensor_bad_payload_and_frames(graph, still_imu):
    imu_input = ImuInput(graph.node, 'imu/data', SETTINGS)
    publisher = graph.publisher()
    gyro_only = still_imu(3, frame_id='left')
    gyro_only.samples[:, 3:] = np.nan
    graph.send(publisher, gyro_only)
    publisher.publish(b'\x00\x01\x00\x00garbage')
    graph.send(publisher, still_imu(2, frame_id='right'))
    got = receive(graph, imu_input, 5)
    assert [(b.frame_id, len(b)) for b in got] == [('left', 3), ('right', 2)]
    assert np.isnan(got[0].samples[:, 3:]).all() and not np.isnan(got[0].samples[:, :3]).any()
    assert imu_input.statistics().malformed == 1
