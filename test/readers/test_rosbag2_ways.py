# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The fast paths of the bag reader give the same samples as reading message by message."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from allan_ros.core.imu import ImuBatch
from allan_ros.readers import ReadOptions, open_recording
from allan_ros.readers import sqlite3 as bag_sqlite3
from allan_ros.readers.cdr import IMU_TYPE, decode_imus, encode_imus

rosbag2 = pytest.importorskip('rosbags.rosbag2')
highlevel = pytest.importorskip('rosbags.highlevel')
typesys = pytest.importorskip('rosbags.typesys')

STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
START_NS = 1_700_000_000_123_456_789
PERIOD_NS = 5_000_000
TOPICS = {'/imu': IMU_TYPE, '/other': IMU_TYPE, '/text': 'std_msgs/msg/String'}
WAYS = [
    (storage, compression)
    for storage, compressions in (('mcap', 'none chunk message'), ('sqlite3', 'none message'))
    for compression in compressions.split()
]


class Stretch(NamedTuple):
    """Consecutive messages of one topic with the same properties."""

    topic: str
    count: int
    frame_id: str
    order: str
    padding: int
    disorder_ns: int


STRETCHES = st.lists(
    st.builds(
        Stretch,
        st.sampled_from(['/imu', '/imu', '/imu', '/other', '/text']),
        st.integers(1, 40),
        st.sampled_from(['', 'a', 'imu_link', 'a_longer_frame_of_another_imu']),
        st.sampled_from('<<<>'),
        st.sampled_from([0, 0, 0, 4]),
        st.sampled_from([0, 0, 0, PERIOD_NS // 2, 50 * PERIOD_NS]),
    ),
    min_size=1,
    max_size=8,
)


def write_bag(
    path: Path, stretches: list[Stretch], storage: str, compression: str, seed: int
) -> None:
    """Write the stretches one after the other, or with the topics alternating."""
    rng = np.random.default_rng(seed)
    modes = rosbag2.CompressionMode
    mode = {'none': modes.NONE, 'chunk': modes.STORAGE, 'message': modes.MESSAGE}[compression]
    messages: list[tuple[int, str, Any]] = []
    for stretch in stretches:
        n = stretch.count
        stamps = START_NS + (len(messages) + np.arange(n)) * PERIOD_NS
        record = stamps + rng.integers(0, stretch.disorder_ns + 1, n)
        if stretch.topic == '/text':
            # some fill a chunk, so that there are several
            payloads = [bytes(int(size)) for size in rng.choice([1, 100, 100, 600_000], n)]
        else:
            batch = ImuBatch(stamps, rng.normal(size=(n, 6)), frame_id=stretch.frame_id)
            end = bytes(stretch.padding)
            payloads = [bytes(one) + end for one in encode_imus(batch, 'cdr', stretch.order)]
        messages += [(int(t), stretch.topic, one) for t, one in zip(record, payloads)]
    if seed % 2:
        messages = [messages[i] for i in sorted(range(len(messages)), key=lambda i: i % 7)]
        times = sorted(time for time, _, _ in messages)
        messages = [(t, topic, one) for t, (_, topic, one) in zip(times, messages)]
    plugin = rosbag2.StoragePlugin[storage.upper()]
    writer = rosbag2.Writer(path, version=8, storage_plugin=plugin)
    writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=STORE)
            for topic, kind in TOPICS.items()
        }
        for time, topic, payload in messages:
            writer.write(connections[topic], time, payload)


def one_by_one(path: Path) -> list[tuple[int, int, str, bytes]]:
    """Return record time, stamp, frame and samples of each message, read by rosbags."""
    rows = []
    with highlevel.AnyReader([path]) as reader:
        connections = [c for c in reader.connections if c.topic == '/imu']
        for _, time, raw in reader.messages(connections):
            one = decode_imus([raw], 'cdr')
            rows.append((time, int(one.stamps_ns[0]), one.frame_ids[0], one.samples.tobytes()))
    return rows


def our_way(path: Path) -> list[tuple[int, int, str, bytes]]:
    """Return record time, stamp, frame and samples of each message, read by this package."""
    recording = open_recording(path, ReadOptions(topic='/imu'))
    rows = []
    for batch in recording.batches():
        assert batch.record_ns is not None
        for i in range(len(batch)):
            sample = batch.samples[i].tobytes()
            times = int(batch.record_ns[i]), int(batch.stamps_ns[i])
            rows.append((*times, batch.frame_id, sample))
    return rows


@settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(STRETCHES, st.sampled_from(WAYS), st.integers(0, 999), st.sampled_from([1, 3, 512]))
def test_the_fast_paths_give_the_messages_of_the_plain_one(
    stretches: list[Stretch], way: tuple[str, str], seed: int, rows: int
) -> None:
    if not any(stretch.topic == '/imu' for stretch in stretches):
        stretches = [*stretches, stretches[0]._replace(topic='/imu')]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'bag'
        write_bag(path, stretches, *way, seed)
        with mock.patch.object(bag_sqlite3, 'FETCHED_ROWS', rows):
            assert our_way(path) == one_by_one(path)
