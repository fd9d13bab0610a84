# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""numpy files in every layout that numpy writes, read in blocks, and faulty files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recordings import read, refused

from allan_ros.core.errors import AllanError
from allan_ros.core.imu import AXES, STANDARD_GRAVITY, ImuBatch, joined
from allan_ros.readers import ReadOptions, arrays, recording

RNG = np.random.default_rng(3)
N = 1000
IMU = np.column_stack([np.arange(N) * 0.005, RNG.normal(size=(N, 6))])
STAMPS = 1_700_000_000_000_000_001 + np.arange(N) * 5_000_000


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read every file in several blocks, of which the last is shorter."""
    monkeypatch.setattr(recording, 'BATCH', 300)


def example(path: Path, batch: ImuBatch) -> None:
    """Write samples in this format."""
    np.savez(path, imu=batch.samples, stamps_ns=batch.stamps_ns)


def test_dates_are_not_samples() -> None:
    dates = np.arange(300).astype('datetime64[s]')
    with pytest.raises(AllanError, match='not numbers'):
        arrays.recording_in_memory({'gx': dates}, ReadOptions(rate_hz=100.0))


@pytest.mark.parametrize('order', ['C', 'F'])
@pytest.mark.parametrize('save', [np.savez, np.savez_compressed])
def test_npz_with_time_in_seconds(save: Any, order: Any, tmp_path: Path) -> None:
    save(tmp_path / 'imu.npz', imu=np.array(IMU, order=order))
    back = read(tmp_path / 'imu.npz')
    np.testing.assert_array_equal(back.samples, IMU[:, 1:])
    np.testing.assert_array_equal(back.stamps_ns, np.arange(N) * 5_000_000)
    assert len(back.frame_ids) == 4
    assert (back.recording.messages, back.record_ns) == (N, None)


@pytest.mark.parametrize('columns', [IMU, IMU[:, 1:]])
def test_stamps_take_the_place_of_t(columns: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / 'imu.npz'
    np.savez(path, imu=columns, stamps_ns=STAMPS, record_ns=STAMPS + 7, frame_id='base')
    back = read(path)
    np.testing.assert_array_equal(back.samples, IMU[:, 1:])
    np.testing.assert_array_equal(back.stamps_ns, STAMPS)
    np.testing.assert_array_equal(back.record_ns, STAMPS + 7)
    assert set(back.frame_ids) == {'base'}


@pytest.mark.parametrize('order', ['C', 'F'])
@pytest.mark.parametrize('dtype', ['<f8', '>f8', '<f4'])
def test_npy_of_any_kind_of_float(dtype: str, order: Any, tmp_path: Path) -> None:
    stored = np.array(IMU, dtype=dtype, order=order)
    np.save(tmp_path / 'imu.npy', stored)
    back = read(tmp_path / 'imu.npy')
    np.testing.assert_array_equal(back.samples, stored[:, 1:].astype(float))
    assert back.recording.info.storage == 'npy'


def test_rate_and_units_are_stated(tmp_path: Path) -> None:
    np.save(tmp_path / 'imu.npy', IMU[:, 1:])
    back = read(tmp_path / 'imu.npy', rate_hz=100.0, gyro_unit='deg/s', accel_unit='g')
    np.testing.assert_array_equal(back.stamps_ns, np.arange(N) * 10_000_000)
    scale = np.repeat([np.pi / 180, STANDARD_GRAVITY], 3)
    np.testing.assert_array_equal(back.samples, IMU[:, 1:] * scale)


def test_a_closed_recording_is_loaded_again(tmp_path: Path) -> None:
    np.save(tmp_path / 'imu.npy', IMU)
    found = read(tmp_path / 'imu.npy').recording
    for _ in range(2):
        found.close()
        np.testing.assert_array_equal(joined(list(found.batches())).samples, IMU[:, 1:])


@pytest.mark.parametrize(
    'columns, options, axes',
    [
        (IMU[:, 1], {'rate_hz': 200.0}, ('gyro_x',)),
        (IMU[:, 1:4], {'rate_hz': 200.0}, AXES[:3]),
        (IMU[:, :4], {}, AXES[:3]),
        (IMU[:, [6, 0]], {'columns': ('az [g]', 't')}, ('accel_z',)),
    ],
)
def test_some_columns_are_enough(
    columns: np.ndarray, options: Any, axes: tuple[str, ...], tmp_path: Path
) -> None:
    np.save(tmp_path / 'imu.npy', columns)
    back = read(tmp_path / 'imu.npy', **options)
    assert back.recording.axes == axes
    np.testing.assert_array_equal(back.stamps_ns, np.arange(N) * 5_000_000)
    present = [axis in axes for axis in AXES]
    scale = STANDARD_GRAVITY if 'accel_z' in axes else 1.0
    np.testing.assert_array_equal(back.samples[:, present], IMU[:, 1:][:, present] * scale)
    assert np.isnan(back.samples[:, np.invert(present)]).all()


def test_duplicate_columns_are_rejected() -> None:
    pandas = pytest.importorskip('pandas')
    frame = pandas.DataFrame(IMU[:, :3], columns=['t', 'gx', 'gx'])
    with pytest.raises(AllanError, match="'gx' occurs more than once"):
        arrays.recording_in_memory(frame, ReadOptions())


@pytest.mark.parametrize('name', ['imu.npz', 'imu.npy'])
def test_a_text_with_the_name_of_an_array_is_rejected(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text('t,gx,gy,gz,ax,ay,az')
    assert 'is not in numpy format: save' in refused(tmp_path / name)


def test_an_array_without_columns_is_rejected() -> None:
    with pytest.raises(AllanError, match='0 columns, but 3 axes'):
        arrays.recording_in_memory(np.zeros((5, 0)), ReadOptions(rate_hz=100.0), 'gyro')


def with_time(value: float) -> np.ndarray:
    """Return the samples with one invalid time."""
    spoiled = IMU.copy()
    spoiled[700, 0] = value
    return spoiled


@pytest.mark.parametrize(
    'content, says',
    [
        ({'gyro': IMU}, "has no array 'imu' (it has gyro)"),
        ({'imu': IMU[:, :5]}, 'has shape (1000, 5): give one row per sample, and name each column'),
        ({'imu': np.zeros((9, 2, 3))}, 'has shape (9, 2, 3)'),
        ({'imu': IMU[:0]}, 'contains no sample'),
        ({'imu': IMU[:, 1:]}, 'state the sample rate (--rate'),
        ({'imu': IMU.astype(str)}, 'save it as float64'),
        ({'imu': np.array([[None] * 7])}, 'is of type object'),
        ({'imu': IMU, 'frame_id': 7}, 'save it as a string'),
        ({'imu': IMU, 'frame_id': ['a', 'b']}, 'must be one short string'),
        ({'imu': IMU, 'frame_id': 'a' * 5000}, 'must be one short string'),
        ({'imu': IMU, 'stamps_ns': STAMPS[:-1]}, 'one for each of the 1000 samples'),
        ({'imu': IMU, 'stamps_ns': STAMPS.astype(float)}, 'must be int64'),
        ({'imu': with_time(np.nan)}, 'the time of row 700 is not a valid stamp'),
        ({'imu': with_time(1e18)}, 'the time of row 700 is not a valid stamp'),
    ],
)
def test_errors_are_reported(content: dict[str, np.ndarray], says: str, tmp_path: Path) -> None:
    np.savez(tmp_path / 'imu.npz', **content)
    assert says in refused(tmp_path / 'imu.npz')


@pytest.mark.parametrize('name', ['imu.npz', 'imu.npy'])
def test_truncated_files_are_reported(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if name == 'imu.npz':
        np.savez_compressed(path, imu=IMU)
    else:
        np.save(path, IMU)
    data = path.read_bytes()
    for length in (5, 60, 100, 3000, len(data) - 1):
        path.write_bytes(data[:length])
        refused(path)


@pytest.mark.parametrize(
    'times',
    [
        {'stamp.sec': STAMPS // 10**9, 'stamp.nanosec': STAMPS % 10**9},
        {'time': np.zeros(N), 'stamp_ns': STAMPS},
        {'t [us]': STAMPS / 1e3},
    ],
)
def test_named_columns_are_understood_as_in_a_table(times: dict[str, np.ndarray]) -> None:
    columns = {f'gyro_{axis} [deg/s]': IMU[:, i] for i, axis in enumerate('xyz', 1)}
    found = arrays.recording_in_memory({**times, **columns}, ReadOptions())
    batch = joined(list(found.batches()))
    np.testing.assert_allclose(batch.stamps_ns, STAMPS, atol=200)  # of a float in us
    np.testing.assert_array_equal(batch.samples[:, :3], IMU[:, 1:4] * (np.pi / 180))
    assert found.options.gyro_unit == 'deg/s'


@pytest.mark.parametrize(('name', 'shift'), [('temp', 0.0), ('temperature [K]', 273.15)])
@pytest.mark.parametrize('kind', ['mapping', 'DataFrame'])
def test_a_temperature_column_is_used(name: str, shift: float, kind: str) -> None:
    n = 40_000
    celsius = np.linspace(20.0, 30.0, n)
    columns: Any = {'t': np.arange(n) / 100.0, 'gz': np.zeros(n), name: celsius + shift}
    if kind == 'DataFrame':
        columns = pytest.importorskip('pandas').DataFrame(columns)
    found = arrays.recording_in_memory(columns, ReadOptions())
    trace = found.temperature('')
    assert trace is not None and trace.source == name
    expected = 20.0 + 10.0 * trace.header_ns * 1e-9 / (n / 100.0)
    np.testing.assert_allclose(trace.celsius, expected, atol=1e-3)
    assert 1000 < len(trace.celsius) <= 2048


def test_a_temperature_column_has_one_value_for_each_sample() -> None:
    columns = {'t': np.arange(100) / 100.0, 'gz': np.zeros(100), 'temp': np.zeros(7)}
    with pytest.raises(AllanError, match="the column 'temp' has 7 values"):
        arrays.recording_in_memory(columns, ReadOptions())
