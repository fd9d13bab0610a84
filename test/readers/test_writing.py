# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Samples are read back bit for bit from every format, and no incomplete file remains."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.recordings import imu_batches, read

from allan_ros.core.errors import AllanError
from allan_ros.core.imu import ImuBatch, joined
from allan_ros.readers.writing import write_recording
from fuzz.reading import write_bag

pytest.importorskip('rosbags')

FORMS = [
    *(('mcap', how) for how in ('none', 'storage', 'message', 'file')),
    *(('sqlite3', how) for how in ('none', 'message', 'file')),
    *(('ros1', how) for how in ('none', 'bz2', 'lz4')),
]
NAMES = ['run', 'run.mcap', 'run.db3', 'run.csv', 'run.tsv', 'run.npz']


@pytest.mark.parametrize('storage, compression', FORMS)
def test_bags_of_every_form_are_read(storage: str, compression: str, tmp_path: Path) -> None:
    batches = imu_batches(5000)
    truth = joined(batches)
    path = tmp_path / ('run.bag' if storage == 'ros1' else 'run')
    write_bag(path, batches, storage, compression)
    back = read(path)
    np.testing.assert_array_equal(back.stamps_ns, truth.stamps_ns)
    np.testing.assert_array_equal(back.samples, truth.samples)
    np.testing.assert_array_equal(back.record_ns, truth.record_ns)
    assert set(back.frame_ids) == {'imu_link'}
    assert back.findings == ()
    assert back.recording.messages == 5000
    assert back.recording.info.storage == storage


@pytest.mark.parametrize('name', NAMES)
def test_every_form_keeps_every_bit_and_is_replaced_only_on_request(
    name: str, tmp_path: Path
) -> None:
    truth = joined(imu_batches(5000))
    assert write_recording(tmp_path / name, imu_batches(5000), topic='/imu') == 5000
    with pytest.raises(AllanError, match='exists already'):
        write_recording(tmp_path / name, imu_batches(20))
    back = read(tmp_path / name)
    np.testing.assert_array_equal(back.stamps_ns, truth.stamps_ns)
    np.testing.assert_array_equal(back.samples, truth.samples)
    assert set(back.frame_ids) == {'imu_link'}
    assert back.findings == ()
    write_recording(tmp_path / name, imu_batches(20), overwrite=True)
    assert len(read(tmp_path / name).stamps_ns) == 20
    assert [child.name for child in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize('name', NAMES)
def test_a_recording_that_fails_leaves_nothing_behind(name: str, tmp_path: Path) -> None:
    def broken() -> Iterator[ImuBatch]:
        yield from imu_batches(10)
        raise RuntimeError('the source broke')

    with pytest.raises(RuntimeError, match='the source broke'):
        write_recording(tmp_path / name, broken())
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_a_bag_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / 'thesis').mkdir()
    with pytest.raises(AllanError, match='not a bag'):
        write_recording(tmp_path / 'thesis', imu_batches(10), overwrite=True)


def test_no_character_of_a_path_is_special(tmp_path: Path) -> None:
    write_recording(tmp_path / 'run?a=1#50%', imu_batches(10))
    assert len(read(tmp_path / 'run?a=1#50%').stamps_ns) == 10


@pytest.mark.parametrize('name', ['a.csv', 'a.npz'])
def test_batches_without_samples_change_no_file(name: str, tmp_path: Path) -> None:
    batches = [ImuBatch.empty(6), *imu_batches(10)]
    assert write_recording(tmp_path / name, batches) == 10
    assert np.array_equal(read(tmp_path / name).samples, joined(batches).samples)
    assert write_recording(tmp_path / f'no_{name}', []) == 0


def test_others_read_our_bags(tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    truth = joined(imu_batches(4000))
    write_recording(tmp_path / 'run', imu_batches(4000))
    rows = []
    with AnyReader([tmp_path / 'run']) as reader:
        [connection] = reader.connections
        assert (connection.topic, connection.msgcount) == ('/imu/data', 4000)
        for _, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            v, a = message.angular_velocity, message.linear_acceleration
            rows.append((time, stamp.sec * 10**9 + stamp.nanosec, v.x, v.y, v.z, a.x, a.y, a.z))
    stamps = truth.stamps_ns.tolist()
    assert rows == [(t, t, *row) for t, row in zip(stamps, truth.samples.tolist())]


def test_what_cannot_be_written_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ('run.bag', 'run.xyz', 'run.cvs', 'run.CSVX'):
        suffix = name[3:].lower()
        with pytest.raises(AllanError, match=f'\\{suffix} files cannot be written: give a file'):
            write_recording(tmp_path / name, imu_batches(10))
    with pytest.raises(AllanError, match='choose a path without'):
        write_recording(tmp_path / 'run?a=1.db3', imu_batches(10))
    stamp_of_2065 = np.array([3_000_000_000_000_000_000])
    with pytest.raises(AllanError, match='a stamp does not fit into a message'):
        write_recording(tmp_path / 'run', [ImuBatch(stamp_of_2065, np.zeros((1, 6)))])
    monkeypatch.setitem(sys.modules, 'rosbags.rosbag2', None)
    with pytest.raises(AllanError, match="needs the Python package 'rosbags': \"pip install ros"):
        write_recording(tmp_path / 'run', imu_batches(10))
    assert list(tmp_path.iterdir()) == []
