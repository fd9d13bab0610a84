# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Real recordings, good and damaged: equal to what rosbags reads, or one line with the reason."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recordings import imu_batches, read, refused

from allan_ros.core.errors import AllanError
from allan_ros.readers import format_of
from allan_ros.readers.bag import bag_of
from allan_ros.readers.files import config_file
from allan_ros.readers.writing import write_recording
from allan_ros.results.documents import load
from fuzz.reading import write_bag

pytest.importorskip('rosbags')

BAGS = {
    'phidgets_imu_upside_down.bag': ('/imu/data_raw', 'ros1', 13964),
    'plotjuggler_rosbag2_test': ('/imu', 'sqlite3', 1565),
    'robot_localization_test1.bag': ('/imu/data', 'ros1', 11865),
    'rosbags_rs_test_bag_mcap': ('/test/sensor_msgs/imu', 'mcap', 2),
    'rosbags_rs_test_bag_sqlite3': ('/test/sensor_msgs/imu', 'sqlite3', 2),
    'tilt_laser.bag': ('/imu_data', 'ros1', 356),
    'turtlebot3.bag': ('/imu', 'ros1', 2253),
}
LFS = 'is a Git-LFS pointer, not the recording: fetch it with "git lfs pull"'
NO_IMU = 'no sensor_msgs/Imu topic; it has '
ODD = {
    'cdr_test_mcap': NO_IMU + '/array_topic (test_msgs/msg/Arrays, 4)',
    'cdr_test_sqlite3': NO_IMU + '/array_topic (test_msgs/msg/Arrays, 4)',
    'empty_bag_rosbag2': NO_IMU + '/parameter_events (rcl_interfaces/msg/ParameterEvent, 0), /ros',
    'lfs_pointer.bag': LFS,
    'lfs_pointer.db3': LFS,
    'lfs_pointer.mcap': LFS,
    'metadata_present_db3_missing': '1 of the 1 files that metadata.yaml names are missing',
    'reindex_no_metadata_mcap': NO_IMU + '/chatter (std_msgs/msg/String, 3177)',
    'reindex_no_metadata_sqlite3': NO_IMU + '/chatter (std_msgs/msg/String, 3177)',
    'rosbagjs_empty-file.bag': 'is empty (0 bytes)',
    'rosbagjs_example-bz2.bag': NO_IMU + '/tf (tf/msg/tfMessage, 2688)',
    'rosbagjs_example-lz4.bag': NO_IMU + '/tf (tf/msg/tfMessage, 2688)',
    'rosbagjs_example-unsorted-chunks.bag': NO_IMU + 'foo (std_msgs/msg/String, 3)',
    'service_events_mcap': NO_IMU,
    'service_events_sqlite3': NO_IMU,
    'tiryoh_test_sample.mcap': NO_IMU + '/rosout (rcl_interfaces/msg/Log, 10)',
    'tiryoh_truncated.mcap': '1475 of 1533 bytes could be read',
    'wbag_split5_mcap': NO_IMU + 'AAA (std_msgs/msg/String, 804)',
    'wbag_split5_sqlite3': NO_IMU + 'AAA (std_msgs/msg/String, 804)',
    'wrong_rmw_mcap': 'serialized as wrong_format',
    'wrong_rmw_sqlite3': 'serialized as wrong_format',
}


def read_by_rosbags(path: Path, topic: str) -> tuple[list[int], list[int], np.ndarray]:
    """Return record times, stamps and axes, message by message."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    record, stamps, samples = [], [], []
    store = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([path], default_typestore=store) as reader:
        connections = [one for one in reader.connections if one.topic == topic]
        for connection, time, payload in reader.messages(connections):
            imu: Any = reader.deserialize(payload, connection.msgtype)
            row = []
            for vector, covariance in (
                (imu.angular_velocity, imu.angular_velocity_covariance),
                (imu.linear_acceleration, imu.linear_acceleration_covariance),
            ):
                absent = covariance[0] == -1
                row += [np.nan] * 3 if absent else [vector.x, vector.y, vector.z]
            record.append(time)
            stamps.append(imu.header.stamp.sec * 10**9 + imu.header.stamp.nanosec)
            samples.append(row)
    return record, stamps, np.array(samples)


@pytest.mark.parametrize('name', BAGS)
def test_real_bags_read_as_rosbags_reads_them(name: str, shared_data: Path) -> None:
    topic, storage, count = BAGS[name]
    path = shared_data / 'bags' / name
    back = read(path)
    record, stamps, samples = read_by_rosbags(path, topic)
    assert (back.recording.info.topic, back.recording.info.storage) == (topic, storage)
    assert back.recording.messages == len(stamps) == count
    np.testing.assert_array_equal(back.record_ns, record)
    np.testing.assert_array_equal(back.stamps_ns, stamps)
    np.testing.assert_array_equal(back.samples, samples)
    assert back.findings == ()


@pytest.mark.parametrize('name', ODD)
def test_odd_files_are_rejected_in_one_line(name: str, shared_data: Path) -> None:
    assert ODD[name] in refused(shared_data / 'odd' / name)


def test_every_shared_file_is_tested(shared_data: Path) -> None:
    assert {path.name for path in (shared_data / 'odd').iterdir()} == set(ODD)
    assert {path.name for path in (shared_data / 'bags').iterdir()} == set(BAGS)


def test_a_real_array_is_read(shared_data: Path) -> None:
    back = read(shared_data / 'mpu6050.npz')
    truth = np.load(shared_data / 'mpu6050.npz')['imu']
    np.testing.assert_array_equal(back.samples, truth[:, 1:])
    np.testing.assert_array_equal(back.stamps_ns, np.rint(truth[:, 0] * 1e9).astype(np.int64))


def test_bag_files_are_sorted_by_the_numbers_in_their_names(tmp_path: Path) -> None:
    names = ['a_2.mcap', 'a_10.mcap', 'a_10²11.mcap']
    for name in reversed(names):
        (tmp_path / name).write_bytes(b'x')
    assert [file.name for file in bag_of(tmp_path).files] == names


@pytest.mark.parametrize(('name', 'storage'), [('m', 'mcap'), ('s', 'sqlite3'), ('r.bag', 'ros1')])
def test_units_are_applied_to_bags(name: str, storage: str, tmp_path: Path) -> None:
    write_bag(tmp_path / name, imu_batches(30), storage)
    plain = read(tmp_path / name).samples
    back = read(tmp_path / name, gyro_unit='deg/s', accel_unit='g')
    np.testing.assert_array_equal(back.samples[:, :3], plain[:, :3] * (np.pi / 180))
    np.testing.assert_array_equal(back.samples[:, 3:], plain[:, 3:] * 9.80665)
    assert (back.recording.options.gyro_unit, back.recording.options.accel_unit) == ('deg/s', 'g')


READ_ALL = """
import sys
from allan_ros.core.errors import AllanError
from allan_ros.readers import open_recording

for name in {hidden}:
    sys.modules[name] = None
for path in sys.argv[1:]:
    try:
        recording = open_recording(path)
        print(sum(map(len, recording.batches())), recording.temperature('imu_link') is not None)
    except AllanError as error:
        print(error)
"""


def read_without(hidden: list[str], *paths: Path) -> list[str]:
    """Read recordings in a process in which these packages cannot be imported."""
    root = Path(__file__).resolve().parents[3]
    command = [sys.executable, '-c', READ_ALL.format(hidden=hidden), *map(str, paths)]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_bags_are_read_without_optional_packages(tmp_path: Path) -> None:
    """ROS 1 bags need rosbags, and compressed bags need a package."""
    paths = [tmp_path / name for name in ('m.mcap', 't.csv', 's')]
    for path in paths[:2]:
        write_recording(path, imu_batches(30))
    write_bag(paths[2], imu_batches(30), 'sqlite3')
    hidden = ['rosbags', 'zstandard', 'lz4', 'lz4.frame', 'pyulog']
    assert read_without(hidden, *paths) == ['30 False'] * 3


def test_a_missing_package_is_one_line(tmp_path: Path, shared_data: Path) -> None:
    write_bag(tmp_path / 'z', imu_batches(30), compression='storage')
    write_bag(tmp_path / 'r.bag', imu_batches(30), 'ros1')
    hidden = ['rosbags', 'zstandard', 'lz4', 'lz4.frame', 'pyulog']
    log = shared_data / 'ulog' / 'sample.ulg'
    said = read_without(hidden, tmp_path / 'z', tmp_path / 'r.bag', log)
    for line, package in zip(said, ('zstandard', 'rosbags', 'pyulog')):
        assert f'needs the Python package \'{package}\': "pip install {package}"' in line
        assert ('apt install python3-' in line) == (package == 'zstandard')


def test_a_name_that_the_system_rejects_is_one_line() -> None:
    with pytest.raises(AllanError, match='cannot be read'):
        format_of(Path('x' * 300))
    with pytest.raises(AllanError, match='cannot be read'):
        load('x' * 300)
    with pytest.raises(AllanError, match='no datasheet'):
        config_file('sensors', 'x' * 300, 'datasheet')


def test_a_compressed_file_is_read_with_any_name(tmp_path: Path) -> None:
    lz4_frame = pytest.importorskip('lz4.frame')
    write_bag(tmp_path / 'bag', imu_batches(30), 'mcap')
    (storage_file,) = (tmp_path / 'bag').glob('*.mcap')
    for name in ('one.mcap.lz4', 'one'):
        (tmp_path / name).write_bytes(lz4_frame.compress(storage_file.read_bytes()))
        assert len(read(tmp_path / name).samples) == 30
