# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Samples are read back bit for bit from every format, and no incomplete file remains."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.recordings import imu_batches, joined, read

from allan_ros.core.errors import AllanError
from allan_ros.core.imu import ImuBatch
from allan_ros.io.writing import COMPRESSIONS, write_recording

pytest.importorskip('rosbags')

FORMS = [(storage, how) for storage, hows in COMPRESSIONS.items() for how in hows]
SUFFIX = {'ros1': '.bag', 'csv': '.csv', 'npz': '.npz'}


@pytest.mark.parametrize('storage, compression', FORMS)
def test_every_form_keeps_every_bit(storage: str, compression: str, tmp_path: Path) -> None:
    batches = imu_batches(5000)
    truth = joined(batches)
    path = tmp_path / f'run{SUFFIX.get(storage, "")}'
    assert write_recording(path, batches, storage=storage, compression=compression) == 5000
    back = read(path)
    np.testing.assert_array_equal(back.stamps_ns, truth.stamps_ns)
    np.testing.assert_array_equal(back.samples, truth.samples)
    np.testing.assert_array_equal(back.record_ns, truth.record_ns)
    assert set(back.frame_ids) == {'imu_link'}
    assert back.findings == ()
    assert back.recording.messages in (5000, None)
    assert back.recording.info.storage == storage


def test_tsv_is_a_table_with_tabs(tmp_path: Path) -> None:
    write_recording(tmp_path / 'run.tsv', imu_batches(20))
    assert (tmp_path / 'run.tsv').read_text().splitlines()[2].count('\t') == 7
    assert len(read(tmp_path / 'run.tsv').stamps_ns) == 20


@pytest.mark.parametrize('name', ['run', 'run.bag', 'run.csv', 'run.npz'])
def test_a_recording_that_fails_leaves_nothing_behind(name: str, tmp_path: Path) -> None:
    def broken() -> Iterator[ImuBatch]:
        yield from imu_batches(10)
        raise RuntimeError('the source broke')

    with pytest.raises(RuntimeError, match='the source broke'):
        write_recording(tmp_path / name, broken())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('name', ['run', 'run.bag', 'run.csv', 'run.npz'])
def test_existing_files_are_replaced_only_on_request(name: str, tmp_path: Path) -> None:
    write_recording(tmp_path / name, imu_batches(10))
    with pytest.raises(AllanError, match='exists already'):
        write_recording(tmp_path / name, imu_batches(20))
    assert len(read(tmp_path / name).stamps_ns) == 10
    write_recording(tmp_path / name, imu_batches(20), overwrite=True)
    assert len(read(tmp_path / name).stamps_ns) == 20
    assert [child.name for child in tmp_path.iterdir()] == [name]


def test_a_folder_that_is_not_a_bag_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / 'thesis').mkdir()
    with pytest.raises(AllanError, match='not a bag'):
        write_recording(tmp_path / 'thesis', imu_batches(10), overwrite=True)


@pytest.mark.parametrize(
    'how, says',
    [
        ({'storage': 'tape'}, "storage 'tape' is unknown: choose one of mcap"),
        ({'storage': 'sqlite3', 'compression': 'chunk'}, 'choose one of none, message, file'),
    ],
)
def test_a_file_that_cannot_be_written_is_reported(
    how: dict[str, str], says: str, tmp_path: Path
) -> None:
    with pytest.raises(AllanError, match=says):
        write_recording(tmp_path / 'run', imu_batches(10), **how)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_no_character_of_a_path_is_special(storage: str, tmp_path: Path) -> None:
    assert write_recording(tmp_path / 'run?a=1#50%', imu_batches(10), storage=storage) == 10


@pytest.mark.parametrize(
    'storage, compression', [(s, c) for s in ('mcap', 'sqlite3') for c in COMPRESSIONS[s]]
)
def test_others_read_our_bags(storage: str, compression: str, tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    batches = [*imu_batches(4000), *imu_batches(50, frame_id='another_frame')]
    write_recording(tmp_path / 'run', batches, storage=storage, compression=compression)
    rows = []
    with AnyReader([tmp_path / 'run']) as reader:
        [connection] = reader.connections
        assert (connection.topic, connection.msgcount) == ('/imu/data', 4050)
        for _, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            v, a = message.angular_velocity, message.linear_acceleration
            rows.append((time, stamp.sec * 10**9 + stamp.nanosec, v.x, v.y, v.z, a.x, a.y, a.z))
    parts = [joined(batches[:3]), joined(batches[3:])]
    expected = [
        (int(part.record_ns[i]), int(part.stamps_ns[i]), *part.samples[i].tolist())
        for part in parts
        for i in range(len(part))
    ]
    assert rows == sorted(expected, key=lambda row: row[0])


def test_a_ros1_bag_without_rosbags_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, 'rosbags.rosbag1', None)
    with pytest.raises(AllanError, match="needs the Python package 'rosbags': \"pip install ros"):
        write_recording(tmp_path / 'run.bag', imu_batches(10))
    assert list(tmp_path.iterdir()) == []


def test_npz_refuses_two_frames(tmp_path: Path) -> None:
    two = [*imu_batches(10, frame_id='left'), *imu_batches(10, frame_id='right')]
    with pytest.raises(AllanError, match='one frame_id'):
        write_recording(tmp_path / 'run.npz', two)
