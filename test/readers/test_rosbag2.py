# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags found in practice: split, without metadata, truncated, with several topics, damaged."""

from __future__ import annotations

import os
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recordings import imu_batches, outcome, read, refused

from allan_ros.core.errors import AllanError
from allan_ros.core.imu import ImuBatch, joined
from allan_ros.readers import open_recording, topics_of
from allan_ros.readers.cdr import IMU_TYPE, encode_imus
from allan_ros.readers.writing import write_recording
from allan_ros.view.finding_text import finding_line
from fuzz.mcap_target import Plan, build
from fuzz.reading import write_bag

rosbag2 = pytest.importorskip('rosbags.rosbag2')
typesys = pytest.importorskip('rosbags.typesys')
highlevel = pytest.importorskip('rosbags.highlevel')
yaml = pytest.importorskip('yaml')

STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
SUFFIX = {'mcap': '.mcap', 'sqlite3': '.db3'}


def example(path: Path, batch: ImuBatch) -> None:
    """Write samples in this format."""
    write_recording(path, [batch])


def write_split(folder: Path, batches: list[Any], storage: str) -> None:
    """Write a bag with one split per batch, in the folder layout of ros2 bag."""
    described: dict[str, Any] = {}
    for number, batch in enumerate(batches):
        one = folder.parent / f'{folder.name}_{number}'
        write_bag(one, [batch], storage)
        info = yaml.safe_load((one / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
        described = described or {**info, 'relative_file_paths': [], 'message_count': 0}
        name = info['relative_file_paths'][0]
        folder.mkdir(exist_ok=True)
        shutil.move(one / name, folder / name)
        shutil.rmtree(one)
        described['relative_file_paths'].append(f'{folder.name}/{name}')
        described['message_count'] += info['message_count']
        described['topics_with_message_count'][0]['message_count'] = described['message_count']
    document = yaml.safe_dump({'rosbag2_bagfile_information': described})
    (folder / 'metadata.yaml').write_text(document)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize('metadata', [True, False])
def test_splits_are_one_recording(storage: str, metadata: bool, tmp_path: Path) -> None:
    batches = imu_batches(
        1200, parts=12
    )  # in alphabetical order the tenth split precedes the second
    write_split(tmp_path / 'bag', batches, storage)
    if not metadata:
        (tmp_path / 'bag' / 'metadata.yaml').unlink()
    back = read(tmp_path / 'bag')
    truth = joined(batches)
    np.testing.assert_array_equal(back.stamps_ns, truth.stamps_ns)
    np.testing.assert_array_equal(back.samples, truth.samples)
    assert back.recording.messages == 1200


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_bare_file_and_the_metadata_file_are_the_bag_too(storage: str, tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', imu_batches(30), storage)
    for path in (f'bag/bag{SUFFIX[storage]}', 'bag/metadata.yaml', 'bag'):
        assert topics_of(tmp_path / path) == ['/imu/data']
        assert len(read(tmp_path / path).stamps_ns) == 30


def test_a_path_is_text_or_a_path_and_a_recording_can_be_read_twice(tmp_path: Path) -> None:
    write_recording(tmp_path / 'a', imu_batches(10))
    write_recording(tmp_path / 'b.csv', imu_batches(20))
    recordings = [open_recording(path) for path in (tmp_path / 'a', str(tmp_path / 'b.csv'))]
    for _ in range(2):
        assert [sum(map(len, one.batches())) for one in recordings] == [10, 20]
    assert [one.info.path for one in recordings] == [str(tmp_path / 'a'), str(tmp_path / 'b.csv')]


@pytest.mark.parametrize('compression', ['none', 'storage'])
def test_a_truncated_file_yields_its_complete_chunks(compression: str, tmp_path: Path) -> None:
    batches = imu_batches(20_000)  # several chunks of 1 MB
    write_bag(tmp_path / 'run', batches, compression=compression)
    source = tmp_path / 'run/run.mcap'
    data = source.read_bytes()
    cut = tmp_path / f'cut{source.suffix}'
    cut.write_bytes(data[: int(0.7 * len(data))])
    back = read(cut)
    n = len(back.stamps_ns)
    assert 8_000 < n < 16_000
    truth = joined(batches)
    np.testing.assert_array_equal(back.stamps_ns, truth.stamps_ns[:n])
    np.testing.assert_array_equal(back.samples, truth.samples[:n])
    assert [finding.id for finding in back.findings] == ['bag_cut']
    assert str(int(0.7 * len(data))) in finding_line(back.findings[0])


def test_a_damaged_ros1_bag_is_read_or_reported_in_one_line(tmp_path: Path) -> None:
    write_bag(tmp_path / 'run.bag', imu_batches(40), 'ros1')
    data = np.frombuffer((tmp_path / 'run.bag').read_bytes(), np.uint8)
    rng = np.random.default_rng(4)
    spoiled = tmp_path / 'spoiled.bag'
    for length in rng.integers(1, len(data), size=60):
        spoiled.write_bytes(data[:length].tobytes())
        count, said = outcome(spoiled)
        assert said.startswith(str(spoiled)) if said else count == 40
        flipped = data.copy()
        flipped[rng.integers(0, len(data), size=20)] = rng.integers(0, 256, size=20)
        spoiled.write_bytes(flipped.tobytes())
        assert '\n' not in said + outcome(spoiled)[1]


def test_an_empty_topic_is_reported(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', imu_batches(20), 'sqlite3')
    with sqlite3.connect(tmp_path / 'bag/bag.db3') as database:
        database.execute('DELETE FROM messages')  # metadata.yaml still states 20
    assert 'topic /imu/data has no message' in refused(tmp_path / 'bag')


def write_topics(path: Path, topics: dict[str, tuple[str, int]], batch: Any) -> None:
    """Write a bag in which topics of several types hold some messages each."""
    with rosbag2.Writer(path, version=8, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        for topic, (msgtype, count) in topics.items():
            connection = writer.add_connection(topic, msgtype, typestore=STORE)
            for payload, stamp in zip(encode_imus(batch, 'cdr')[:count], batch.stamps_ns.tolist()):
                writer.write(connection, stamp, payload)


def test_topics_are_listed_and_chosen(tmp_path: Path) -> None:
    [batch] = imu_batches(20, parts=1)
    path, one = tmp_path / 'two', tmp_path / 'one'
    topics = {'/left': (IMU_TYPE, 12), '/right': (IMU_TYPE, 20), '/idle': (IMU_TYPE, 0)}
    write_topics(path, {**topics, '/text': ('std_msgs/msg/String', 0)}, batch)
    said = refused(path)
    assert said == f'{path}: has 2 Imu topics: /left (12), /right (20): choose one with --topic'
    assert len(read(path, topic='/left').stamps_ns) == 12
    assert len(read(path, topic='right').stamps_ns) == 20
    assert 'has no message' in refused(path, topic='/idle')
    assert 'has no topic /up; it has /left' in refused(path, topic='/up')
    assert 'std_msgs/msg/String, not sensor_msgs/Imu' in refused(path, topic='/text')
    write_topics(one, {**topics, '/left': (IMU_TYPE, 0)}, batch)
    assert read(one).recording.info.topic == '/right'


def test_payloads_that_are_not_an_imu_are_named(tmp_path: Path) -> None:
    (tmp_path / 'bag.mcap').write_bytes(build(Plan(chunks=1, message=b'\0\1' + bytes(98))))
    said = refused(tmp_path / 'bag.mcap')
    assert 'message 21 of /imu is not a sensor_msgs/msg/Imu (100 bytes are too few' in said


@pytest.mark.parametrize('name', ['a.csv', 'a.mcap', 'a.db3', 'a.npz'])
def test_a_name_of_any_bytes_is_shown_in_a_printable_line(name: str, tmp_path: Path) -> None:
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b'/\xff\x1b[31m\n 50%?a=1#[x]'))
    frame_id = 'f' * 1000
    batches = imu_batches(20, frame_id=frame_id)
    path.mkdir()
    if name == 'a.db3':
        write_bag(tmp_path / 'a', batches, 'sqlite3')
        (tmp_path / 'a' / name).rename(path / name)
    else:
        write_recording(path / name, batches)
    back = read(path / name)
    assert back.recording.info.path.isprintable() and set(back.frame_ids) == {frame_id}
    (path / name).write_bytes(b'')
    with pytest.raises(AllanError, match=r'x1b\[31m\\n.*/a.*: is empty') as caught:
        open_recording(path / name)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    'name, spoil, says',
    [
        ('gone', lambda path: None, 'no such file or folder'),
        ('empty.mcap', lambda path: path.write_bytes(b''), 'empty (0 bytes)'),
        ('empty', lambda path: path.mkdir(), 'no bag in this folder'),
        ('run.bag', lambda path: path.write_bytes(b'not a bag at all'), 'it is not a bag'),
        ('run.db3', lambda path: path.write_bytes(b'SQLite format 3\0'), 'cannot be read'),
        ('run.mcap', lambda path: path.write_bytes(b'\x89MCAP0\r\n'), 'it has no topic; only'),
        ('run.mcap.zstd', lambda path: path.write_bytes(b'\x28\xb5\x2f\xfd.'), 'cannot be read'),
        ('notes.pdf', lambda path: path.write_bytes(b'%PDF'), 'not a known type of recording'),
        (
            'v1.bag',
            lambda path: path.write_bytes(b'#ROSBAG V1.2\n'),
            "'#ROSBAG V1.2' is not ROS bag 2.0",
        ),
        (
            'lfs.mcap',
            lambda path: path.write_bytes(b'version https://git-lfs.github.com/spec/v1\n'),
            'git lfs pull',
        ),
    ],
)
def test_a_file_that_is_not_a_bag_is_reported_in_one_line(
    name: str, spoil: Any, says: str, tmp_path: Path
) -> None:
    spoil(tmp_path / name)
    assert says in refused(tmp_path / name)


@pytest.mark.parametrize(
    'spoil, says',
    [
        (lambda bag: (bag / 'bag.mcap').unlink(), '1 of the 1 files'),
        (lambda bag: (bag / 'metadata.yaml').write_text('a: ['), 'remove it to read'),
        (lambda bag: (bag / 'metadata.yaml').write_text('a: 1'), 'remove it to read'),
        (lambda bag: (bag / 'bag.mcap').write_bytes(b''), 'empty (0 bytes)'),
        (
            lambda bag: (bag / 'metadata.yaml').write_text(
                (bag / 'metadata.yaml').read_text().replace(': cdr', ': smoke')
            ),
            "serialized as 'smoke'",
        ),
    ],
)
def test_a_broken_bag_folder_is_reported_in_one_line(spoil: Any, says: str, tmp_path: Path) -> None:
    write_recording(tmp_path / 'bag', imu_batches(10))
    spoil(tmp_path / 'bag')
    assert says in refused(tmp_path / 'bag')


def test_a_folder_of_bags_names_them(tmp_path: Path) -> None:
    for name in ('a', 'b'):
        write_recording(tmp_path / name, imu_batches(10))
    assert '2 recordings (a, b): give each of them' in refused(tmp_path)
