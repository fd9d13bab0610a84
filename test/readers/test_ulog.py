# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""PX4 logs: topics, instances, delta angles, dropouts, damage."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from support.recordings import outcome, read, refused

from allan_ros.core.imu import ImuBatch
from allan_ros.view.finding_text import finding_line

pytest.importorskip('pyulog')

START_US = 50_000_000
IMU_FORMAT = (
    'vehicle_imu:uint64_t timestamp;uint64_t timestamp_sample;float[3] delta_angle;'
    'float[3] delta_velocity;uint16_t delta_angle_dt;uint16_t delta_velocity_dt;'
)
COMBINED_FORMAT = (
    'sensor_combined:uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;'
    'int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;'
)


def message(kind: str, body: bytes) -> bytes:
    return struct.pack('<HB', len(body), ord(kind)) + body


def log(topics: list[tuple[str, str, int, list[bytes]]], dropout: bytes = b'') -> bytes:
    """Return a log with topics of (format, name, instance, messages)."""
    out = b'ULog\x01\x12\x35\x01' + struct.pack('<Q', START_US)
    for text in dict.fromkeys(form for form, *_ in topics):
        out += message('F', text.encode())
    for number, (_, name, instance, _) in enumerate(topics):
        out += message('A', struct.pack('<BH', instance, number) + name.encode())
    for number, (*_, bodies) in enumerate(topics):
        for body in bodies:
            out += message('D', struct.pack('<H', number) + body)
        out += dropout
    return out


def delta(i: int, dt: int = 5000, scale: float = 1.0) -> bytes:
    rates = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * scale
    stamp = START_US + 5000 * i
    return struct.pack('<QQ6fHH', stamp + 400, stamp, *(rates * dt * 1e-6), dt, dt)


def combined(i: int, period: int = 5000, relative: int = 0) -> bytes:
    stamp = START_US + period * i
    return struct.pack('<Q3fIi3f', stamp, 1.0, 2.0, 3.0, 5000, relative, 4.0, 5.0, 6.0)


def example(path: Path, batch: ImuBatch) -> None:
    """Write samples in this format."""
    stamps_us = (batch.stamps_ns - batch.stamps_ns[0]) // 1000 + START_US
    bodies = [
        struct.pack('<Q3fIi3f', stamp, *row[:3], 5000, 0, *row[3:])
        for stamp, row in zip(stamps_us.tolist(), batch.samples.tolist())
    ]
    path.write_bytes(log([(COMBINED_FORMAT, 'sensor_combined', 0, bodies)]))


def test_delta_angles_are_divided_by_their_time(tmp_path: Path) -> None:
    path = tmp_path / 'a.ulg'
    dts = [5000, 4900, 5100, 0]
    path.write_bytes(
        log([(IMU_FORMAT, 'vehicle_imu', 0, [delta(i, t) for i, t in enumerate(dts)])])
    )
    back = read(path)
    np.testing.assert_allclose(back.samples[:3], [[1, 2, 3, 4, 5, 6]] * 3, rtol=1e-6)
    assert np.isnan(back.samples[3]).all()
    np.testing.assert_array_equal(back.stamps_ns, (START_US + 5000 * np.arange(4)) * 1000)
    np.testing.assert_array_equal(back.record_ns, back.stamps_ns + 400_000)
    assert back.recording.info.type == 'vehicle_imu'
    assert back.findings == ()


def test_instances_are_chosen_by_topic(tmp_path: Path) -> None:
    path = tmp_path / 'a.ulg'
    topics = [
        (IMU_FORMAT, 'vehicle_imu', n, [delta(i, scale=n + 1.0) for i in range(5)])
        for n in range(3)
    ]
    path.write_bytes(log(topics))
    assert 'has 3 IMUs: vehicle_imu:0, vehicle_imu:1, vehicle_imu:2' in refused(path)
    back = read(path, topic='vehicle_imu:2')
    np.testing.assert_allclose(back.samples[0], [3, 6, 9, 12, 15, 18], rtol=1e-6)
    assert 'has no topic imu' in refused(path, topic='imu')
    path.write_bytes(
        log([*topics, (COMBINED_FORMAT, 'sensor_combined', 0, [combined(i) for i in range(9)])])
    )
    assert len(read(path).stamps_ns) == 9


def test_an_absent_accelerometer_and_other_units(tmp_path: Path) -> None:
    path = tmp_path / 'a.ulg'
    bodies = [combined(0), combined(1, relative=0x7FFFFFFF)]
    path.write_bytes(log([(COMBINED_FORMAT, 'sensor_combined', 0, bodies)]))
    back = read(path, accel_unit='g')
    np.testing.assert_allclose(back.samples[0, 3:], np.array([4, 5, 6]) * 9.80665)
    assert np.isnan(back.samples[1, 3:]).all()


def test_dropouts_and_decimated_topics_are_reported(tmp_path: Path) -> None:
    path = tmp_path / 'a.ulg'
    bodies = [combined(i, period=50_000) for i in range(9)]
    dropout = message('O', struct.pack('<H', 250))
    path.write_bytes(log([(COMBINED_FORMAT, 'sensor_combined', 0, bodies)], dropout))
    back = read(path)
    assert [finding.id for finding in back.findings] == ['log_dropouts', 'log_decimated']
    assert '1 time, for 0.25 s in total' in finding_line(back.findings[0])
    assert 'at 20 Hz, but sampled at 200 Hz' in finding_line(back.findings[1])


def test_damaged_logs_are_rejected_or_read(tmp_path: Path) -> None:
    good = log([(COMBINED_FORMAT, 'sensor_combined', 0, [combined(i) for i in range(30)])])
    path, rng = tmp_path / 'a.ulg', np.random.default_rng(3)
    for _ in range(150):
        bad = bytearray(good[: rng.integers(20, len(good))])
        for at in rng.integers(8, len(bad), size=rng.integers(4)):
            bad[at] = rng.integers(256)
        path.write_bytes(bad)
        _, said = outcome(path)
        assert '\n' not in said


def test_a_long_damaged_part_ends_reading(tmp_path: Path) -> None:
    path = tmp_path / 'a.ulg'
    good = log([(COMBINED_FORMAT, 'sensor_combined', 0, [combined(i) for i in range(30)])])
    with path.open('wb') as file:
        file.write(good)
        file.truncate(1 << 30)
    back = read(path)
    assert len(back.stamps_ns) == 30
    assert [finding.id for finding in back.findings] == ['log_damaged']


@pytest.mark.parametrize(
    'name, samples, rate', [('sample', 17070, 250.0), ('sample_log_small', 1298, 204.6)]
)
def test_real_logs(name: str, samples: int, rate: float, shared_data: Path) -> None:
    back = read(shared_data / 'ulog' / f'{name}.ulg')
    assert back.recording.info.topic == 'sensor_combined'
    assert len(back.stamps_ns) == samples == back.recording.messages
    assert 1e9 / np.median(np.diff(back.stamps_ns)) == pytest.approx(rate, rel=1e-3)
    assert 8.0 < np.linalg.norm(np.median(back.samples[:, 3:], axis=0)) < 11.0
    assert 'log_dropouts' in [finding.id for finding in back.findings]


def test_real_instances(shared_data: Path) -> None:
    path = shared_data / 'ulog' / 'sample_log_small.ulg'
    for n in range(3):
        back = read(path, topic=f'vehicle_imu:{n}')
        assert len(back.stamps_ns) == 12
        assert 9.4 < np.linalg.norm(back.samples[:, 3:].mean(axis=0)) < 10.2
        assert 'log_decimated' in [finding.id for finding in back.findings]


GYRO_FORMAT = 'sensor_gyro:uint64_t timestamp;uint32_t device_id;float temperature;'
SELECTION_FORMAT = 'sensor_selection:uint64_t timestamp;uint32_t gyro_device_id;'


@pytest.mark.parametrize(
    ('selected', 'instances', 'expected'),
    [
        (8, (7, 8), ('sensor_gyro:1', 38.0)),  # the temperature of the gyro in use
        (9, (7, 8), None),
        (None, (7, 8), None),  # one of two, unknown which
        (None, (7,), ('sensor_gyro', 37.0)),
        (None, (), None),
    ],
)
def test_the_temperature_is_that_of_the_same_gyro(
    selected: int | None,
    instances: tuple[int, ...],
    expected: tuple[str, float] | None,
    tmp_path: Path,
) -> None:
    def warm(i: int, device: int) -> bytes:
        return struct.pack('<QIf', START_US + 10_000 * i, device, 30.0 + device + i)

    topics = [(COMBINED_FORMAT, 'sensor_combined', 0, [combined(i) for i in range(6)])]
    topics += [
        (GYRO_FORMAT, 'sensor_gyro', k, [warm(i, device) for i in range(3)])
        for k, device in enumerate(instances)
    ]
    if selected is not None:
        one = struct.pack('<QI', START_US, selected)
        topics.append((SELECTION_FORMAT, 'sensor_selection', 0, [one]))
    (tmp_path / 'a.ulg').write_bytes(log(topics))
    trace = read(tmp_path / 'a.ulg').recording.temperature('')
    if expected is None:
        assert trace is None
        return
    source, first = expected
    assert trace.source == source and trace.celsius.tolist() == [first, first + 1.0, first + 2.0]
    assert trace.header_ns.tolist() == [(START_US + 10_000 * i) * 1000 for i in range(3)]
