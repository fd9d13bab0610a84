# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The temperature of an IMU is found, decimated, and used for the bias over temperature."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import allan_ros as ar
from allan_ros.cli.main import main
from allan_ros.core.stream.health import Segment
from allan_ros.core.stream.signal import Decimated, TemperatureTrace, trace_of
from allan_ros.readers import open_recording
from allan_ros.readers.recording_sums import Provenance, RecordingSums

rosbag2 = pytest.importorskip('rosbags.rosbag2')
typesys = pytest.importorskip('rosbags.typesys')

STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
TYPE = 'sensor_msgs/msg/Temperature'
NS = 10**9


def write_bag(path: Path, topics: dict[str, tuple[str, float]], imu_topic: str) -> None:
    """Write a bag of one Imu topic, and Temperature topics of a frame and a first value each."""
    types = STORE.types

    def header(second: int, frame_id: str) -> Any:
        return types['std_msgs/msg/Header'](
            types['builtin_interfaces/msg/Time'](second, 0), frame_id
        )

    vector, zeros = types['geometry_msgs/msg/Vector3'](0.0, 0.0, 9.8), np.zeros(9)
    turn = types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
    with rosbag2.Writer(path, version=9) as writer:
        imu = writer.add_connection(imu_topic, 'sensor_msgs/msg/Imu', typestore=STORE)
        warm = {t: writer.add_connection(t, TYPE, typestore=STORE) for t in topics}
        for second in range(1, 11):
            message = types['sensor_msgs/msg/Imu'](
                header(second, 'imu_link'), turn, zeros, vector, zeros, vector, zeros
            )
            at = second * NS + 7
            writer.write(imu, at, STORE.serialize_cdr(message, 'sensor_msgs/msg/Imu'))
            for topic, (frame_id, first) in topics.items():
                reading = types[TYPE](header(second, frame_id), first + second, 0.0)
                writer.write(warm[topic], at, STORE.serialize_cdr(reading, TYPE))


@pytest.mark.parametrize(
    ('topics', 'imu_topic', 'expected'),
    [
        ({'/thermo': ('somewhere', 20.0)}, '/imu/data', '/thermo'),
        ({'/imu/temp': ('', 20.0), '/motor/temp': ('', 70.0)}, '/imu/data', '/imu/temp'),
        ({'/a': ('base', 70.0), '/b': ('imu_link', 20.0)}, '/imu/data', '/b'),
        ({'/a': ('base', 70.0), '/b': ('arm', 20.0)}, '/imu/data', None),
        ({}, '/imu/data', None),
    ],
)
def test_the_temperature_topic_of_the_imu_is_found(
    topics: dict[str, tuple[str, float]], imu_topic: str, expected: str | None, tmp_path: Path
) -> None:
    write_bag(tmp_path / 'bag', topics, imu_topic)
    recording = open_recording(tmp_path / 'bag')
    assert sum(map(len, recording.batches())) == 10
    trace = recording.temperature('imu_link')
    if expected is None:
        assert trace is None
        return
    assert trace is not None and trace.source == expected
    assert trace.celsius.tolist() == [20.0 + second for second in range(1, 11)]
    assert trace.header_ns.tolist() == [second * NS for second in range(1, 11)]
    assert (trace.record_ns - trace.header_ns == 7).all()


@pytest.mark.parametrize('name', ['temperature', 'Temp [°C]', 'Temp [℃]', 'imu_temp_degC'])
def test_a_table_has_it_in_a_column(name: str, tmp_path: Path) -> None:
    rows = [f'{t},0,0,0,0,0,9.8,{20 + t}' for t in range(9)]
    text = '\n'.join([f't,gx,gy,gz,ax,ay,az,{name}', *rows, '9,0,0'])
    (tmp_path / 'one.csv').write_text(text)
    recording = open_recording(tmp_path / 'one.csv')
    assert sum(map(len, recording.batches())) == 9
    trace = recording.temperature('')
    assert trace is not None and trace.source == name
    assert trace.celsius.tolist() == [20.0 + t for t in range(9)]
    assert trace.header_ns.tolist() == [t * NS for t in range(9)]


def test_another_unit_is_not_read_as_celsius(tmp_path: Path) -> None:
    (tmp_path / 'one.csv').write_text('t,gx,gy,gz,ax,ay,az,temp [K]\n0,0,0,0,0,0,9.8,300\n')
    recording = open_recording(tmp_path / 'one.csv')
    assert recording.temperature('') is None


def test_invalid_temperatures_are_left_out() -> None:
    readings = [(0, 0, float('nan')), (1, 1, 20.0), (2, 2, -300.0), (3, 3, float('inf'))]
    trace = trace_of('/t', readings)
    assert trace is not None and trace.celsius.tolist() == [20.0]
    assert trace_of('/t', readings[:1]) is None


@pytest.mark.parametrize('count', [0, 5, 8, 9, 100, 1000])
def test_thinning_is_even_and_bounded(count: int) -> None:
    kept: Decimated[int] = Decimated(most=8)
    for i in range(count):
        kept.add(i)
    items = list(kept)
    steps = np.diff(items).tolist()
    assert len(items) <= 8 and len(set(steps)) <= 1
    if count > 1:
        assert items[0] == 0 and items[-1] >= count - steps[0]


def heated(rows: int = 2400) -> str:
    """Return a table at 1 Hz whose gyro follows a temperature with two cycles."""
    celsius = 30.0 + 5.0 * np.sin(np.linspace(0.0, 4.0 * np.pi, rows) - 1.0)
    samples = np.random.default_rng(3).normal(size=(rows, 3)) * 1e-4
    samples += np.outer(celsius - 30.0, [1e-4, 2e-4, -3e-4])
    columns = np.column_stack([np.arange(rows), samples, celsius])
    lines = [','.join(f'{value:.9g}' for value in row) for row in columns]
    return '\n'.join(['t_s,gx [rad/s],gy [rad/s],gz [rad/s],temp [degC]', *lines, ''])


def test_the_bias_over_temperature_is_in_results_file_and_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, folder = tmp_path / 'a.csv', tmp_path / 'results'
    table.write_text(heated())
    assert main(['analyze', str(table), '-o', str(folder), '--export', 'temperature']) == 0
    text = capsys.readouterr().out
    assert 'gyro bias from 25.0 to 35.0 degC: x 20.' in text and '100 % of the drift' in text
    results = ar.load(folder)
    for axis, slope in zip(results, (1e-4, 2e-4, -3e-4)):
        model = results[axis].temperature
        assert model is not None and model.resolved and model.reference == 30.0
        assert model.b1 == pytest.approx(slope, rel=0.02)
    written = yaml.safe_load((folder / 'temperature.yaml').read_text())
    assert written['gyro_b1'] == pytest.approx([1e-4, 2e-4, -3e-4], rel=0.02)
    assert list(written) == ['reference', 'gyro_b0', 'gyro_b1', 'gyro_b2']
    # the sums do not contain the temperature
    assert ar.load(folder / 'sums.json')['gyro_x'].temperature is None


def test_readings_on_another_clock_are_placed_by_their_record_times() -> None:
    stamps = np.arange(5) * NS
    traces = (
        TemperatureTrace('/boot', stamps, stamps + 100 * NS, np.arange(5.0)),
        None,
        TemperatureTrace('/imu', stamps + 200 * NS, stamps, np.arange(5.0) + 10.0),
    )
    used = Provenance(segments=(Segment(100 * NS, 10, 5.0), Segment(200 * NS, 10, 5.0)))
    times, celsius = RecordingSums('', (), used, temperatures=traces).temperature_readings()
    assert times.tolist() == [*(stamps + 100 * NS), *(stamps + 200 * NS)]
    assert celsius.tolist() == [*range(5), *range(10, 15)]
