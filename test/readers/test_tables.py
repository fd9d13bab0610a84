# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables with many kinds of headers, units and time columns, and faulty tables."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.recordings import read, refused

import allan_ros as ar
from allan_ros.cli.main import main
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import AXES, STANDARD_GRAVITY, ImuBatch
from allan_ros.readers import tables, writing
from allan_ros.readers.columns import picked_names
from allan_ros.view.finding_text import finding_line

DEG = np.pi / 180
ROW = '1,2,3,4,5,6'
VALUES = np.arange(1.0, 7.0)


def table(folder: Path, text: str) -> Path:
    (folder / 'imu.csv').write_text(text, encoding='utf-8')
    return folder / 'imu.csv'


def example(path: Path, batch: ImuBatch) -> None:
    """Write samples in this format."""
    writing.write_recording(path, [batch])


def echoed(name: str) -> str:
    return f'field.{name}.x,field.{name}.y,field.{name}.z,field.{name}_covariance0'


@pytest.mark.parametrize(
    'header, row, stamp_ns',
    [
        ('t,gx,gy,gz,ax,ay,az', f'0.005,{ROW}', 5_000_000),
        ('stamp_ns,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z', f'5,{ROW}', 5),
        ('time_ms;wx;wy;wz;ax;ay;az', f'7.5,{ROW}'.replace(',', ';'), 7_500_000),
        ('Time [us]\tGyro X\tGyro Y\tGyro Z\tAcc X\tAcc Y\tAcc Z', '9\t1\t2\t3\t4\t5\t6', 9000),
        ('t gx gy gz ax ay az', '  1   1 2  3 4 5  6', 10**9),
        (
            '#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],'
            'a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]',
            f'1403636579758555392,{ROW}',
            1403636579758555392,
        ),
        (
            '/imu/header/stamp/sec,/imu/header/stamp/nanosec,/imu/header/frame_id,'
            '/imu/angular_velocity/x,/imu/angular_velocity/y,/imu/angular_velocity/z,'
            '/imu/linear_acceleration/x,/imu/linear_acceleration/y,/imu/linear_acceleration/z',
            f'1700000000,123456789,imu,{ROW}',
            1_700_000_000_123_456_789,
        ),
        (
            'time,stamp,temperature,mag_x,gx,gy,gz,ax,ay,az',
            f'1,1700000000.123456789,20.5,0.1,{ROW}',
            1_700_000_000_123_456_789,
        ),
        ('t,"gx","gy","gz",ax,ay,az', '"1","1",2,3,4,5,6', 10**9),
        ('"t; s",gx,gy,gz,ax,ay,az', '"0,005","1,0", "2,0",3,4,5,6', 5_000_000),
        ('t,gx,gy,gz,ax,ay,az', f'"2023-11-14 22:13:20,125",{ROW}', 1_700_000_000_125_000_000),
        ('// Start Time: 9:00\n# Rate: 100 Hz\nt,gx,gy,gz,ax,ay,az', f'1,{ROW}', 10**9),
        ('\ufefft,gx,gy,gz,ax,ay,az', f'1,{ROW}', 10**9),
        ('t,gx,gy,gz,ax,ay,az\r', f'1,{ROW}\r', 10**9),
        (
            '%time,field.header.seq,field.header.stamp,field.header.frame_id,'
            f'{echoed("angular_velocity")},{echoed("linear_acceleration")}',
            '1700000000000000001,7,1700000000000000000,imu,1,2,3,0,4,5,6,0',
            1_700_000_000_000_000_000,
        ),
        ('', ','.join(['1700000000', '5', 'imu', *'0' * 13, *'123', *'0' * 9, *'456', *'0' * 9]),
         1_700_000_000_000_000_005),
        ('"Time (s)";gx;gy;gz;ax;ay;az', '0,5;1,0;2,0;3,0;4,0;5,0;6,0', 500_000_000),
        (
            'time;gx_rads;gy_rads;gz_rads;ax_ms2;ay_ms2;az_ms2',
            '2026-01-31T12:00:00,250+01:00;1;2;3;4;5;6',
            1_769_857_200_250_000_000,
        ),
        (
            'Timestamp,gx,gy,gz,ax,ay,az',
            '2026-01-31 12:00:00.000000001,1,2,3,4,5,6',
            1_769_860_800_000_000_001,
        ),
    ],
)  # fmt: skip
def test_headers_of_many_tools_are_understood(
    header: str, row: str, stamp_ns: int, tmp_path: Path
) -> None:
    path = tmp_path / 'imu.csv'
    path.write_bytes(f'{header}\n{row}\n{row}\n'.lstrip('\n').encode())
    back = read(path)
    np.testing.assert_array_equal(back.samples, [VALUES, VALUES])
    assert back.stamps_ns.tolist() == [stamp_ns] * 2


@pytest.mark.parametrize(
    'header, options',
    [
        ('t,gx,gy,gz,ax,ay,az', {'gyro_unit': 'deg/s', 'accel_unit': 'g'}),
        ('t,gx [deg/s],gy [°/s],gz (dps),ax [g],ay [G],az (g)', {}),
        ('t,gyro_x_dps,gyro_y_dps,gyro_z_dps,ax_g,ay_g,az_g', {}),
    ],
)
def test_units_are_scaled_to_si(header: str, options: Any, tmp_path: Path) -> None:
    path = table(tmp_path, f'{header}\n1,{ROW}\n')
    scale = np.repeat([DEG, STANDARD_GRAVITY], 3)
    np.testing.assert_array_equal(read(path, **options).samples, [VALUES * scale])


@pytest.mark.parametrize(
    'column, seconds',
    [
        *((f'time [{unit}]', 1.0) for unit in ('s', 'sec', 'Seconds')),
        *((f'Timestamp ({unit})', 1e-3) for unit in ('ms', 'msec', 'milliseconds')),
        *((f't [{unit}]', 1e-6) for unit in ('us', 'usec', 'µs', 'μs', 'microseconds')),
        *((f'stamp [{unit}]', 1e-9) for unit in ('ns', 'nsec', 'nanoseconds')),
        *((f'time [{unit}]', 60.0) for unit in ('min', 'Minutes')),
        *((f'Zeit ({unit})', 3600.0) for unit in ('h', 'hr', 'hours')),
        ('time [days]', 86400.0),
        ('time_usec', 1e-6),
        ('time_min', 60.0),
        ('millis', 1e-3),
        ('seconds_elapsed', 1.0),
        ('time [UTC]', 1.0),
    ],
)
def test_the_unit_of_a_time_is_read_from_its_name(
    column: str, seconds: float, tmp_path: Path
) -> None:
    times = np.arange(150) * 0.01
    rows = ''.join(f'{time / seconds:.17g},1\n' for time in times)
    back = read(table(tmp_path, f'{column},gx\n{rows}'))
    np.testing.assert_allclose(back.stamps_ns * 1e-9, times, atol=2e-9)
    assert {f.id for f in back.findings} == {'unit_assumed'}


@pytest.mark.parametrize('column', ['time [fortnight]', 'stamp (ticks)', 'record_time [lsb]'])
def test_an_unknown_unit_of_a_time_is_refused(column: str, tmp_path: Path) -> None:
    path = table(tmp_path, f'{column},t_s,gx\n0,0,1\n1,1,1\n')
    assert 'is unknown: ' in refused(path)
    if 'record' not in column:
        assert read(path, stamp_unit='ms').stamps_ns.tolist() == [0, 1_000_000]


@pytest.mark.parametrize(
    'header, factor',
    [
        ('gx [Degrees per second]', DEG),
        ('gyro_x (rad·s⁻¹)', 1.0),
        ('Gyroskop x (°/s)', DEG),
        ('w_x [mdps]', 1e-3 * DEG),
        ('gyro_x [deg/hr]', DEG / 3600),
        ('Drehrate x (rad/s)', 1.0),
    ],
)
def test_units_of_angular_rates_have_many_spellings(
    header: str, factor: float, tmp_path: Path
) -> None:
    back = read(table(tmp_path, f't,{header}\n0,2\n1,2\n'))
    np.testing.assert_allclose(back.samples[:, 0], 2.0 * factor)
    assert back.findings == ()


@pytest.mark.parametrize(
    'header, factor',
    [
        ('gFx', STANDARD_GRAVITY),
        ('ax(g)', STANDARD_GRAVITY),
        ('gx [g]', STANDARD_GRAVITY),
        ('accel_g_x', STANDARD_GRAVITY),
        ('acc_x_mg', 1e-3 * STANDARD_GRAVITY),
        ('a_x [m s⁻²]', 1.0),
        ('Beschleunigung x (m/s²)', 1.0),
    ],
)
def test_accelerations_are_recognized_by_name_or_unit(
    header: str, factor: float, tmp_path: Path
) -> None:
    back = read(table(tmp_path, f't,{header}\n0,2\n1,2\n'))
    assert np.isnan(back.samples[:, :3]).all()
    np.testing.assert_allclose(back.samples[:, 3], 2.0 * factor)
    assert back.findings == ()


@pytest.mark.parametrize('header', ['gyro_x [lsb]', 'gx [m/s^3]', 'accel_x [deg/s]', 'ax [T]'])
def test_another_unit_of_samples_is_refused(header: str, tmp_path: Path) -> None:
    path = table(tmp_path, f't,{header}\n0,2\n1,2\n')
    assert f'the unit of column {header!r} is unknown' in refused(path)


def test_two_columns_of_one_axis_are_refused_or_chosen(tmp_path: Path) -> None:
    path = table(
        tmp_path, f't,{",".join(f"imu{n}_g{a}" for n in (1, 2) for a in "xyz")}\n0,{ROW}\n'
    )
    assert "the columns 'imu1_gx' and 'imu2_gx' both contain gyro_x" in refused(path)
    chosen = read(path, columns=('gx=imu2_gx', 'gy=imu2_gy', 'gz=imu2_gz'))
    assert chosen.samples[0, :3].tolist() == [4.0, 5.0, 6.0]


def test_repeated_names_are_refused_with_names_that_are_accepted(tmp_path: Path) -> None:
    path = table(tmp_path, f't [s],gx,gx,gz,ax,ay,az\n0,{ROW}\n')
    for options in ({}, {'columns': ('gx=gx',)}):
        _, _, advice = refused(path, **options).partition(' --columns ')
        assert advice == "'t [s],gx,-,gz,ax,ay,az'"
    columns = tuple(shlex.split(advice)[0].split(','))
    assert read(path, columns=columns).samples[0, 0] == VALUES[0]


def test_naming_the_time_keeps_the_other_columns(tmp_path: Path) -> None:
    path = table(tmp_path, f'clock,gx,gy,gz,ax,ay,az\n0.5,{ROW}\n')
    back = read(path, columns=('t=clock',))
    np.testing.assert_array_equal(back.samples, [VALUES])


def phone(folder: Path, gyro: str, accel: str, later_s: float = 0.0) -> tuple[Path, Path]:
    """Write the gyro and the accelerometer of 60 s as two tables with the columns of an app."""
    rng, t = np.random.default_rng(5), np.arange(6000) / 100.0
    for name, sigma, shift in ((gyro, 1e-3, 0.0), (accel, 1e-2, 0.003 + later_s)):
        values = rng.normal(0.0, sigma, (len(t), 3)) + ([0, 0, 9.8] if name == accel else 0.0)
        rows = np.column_stack([t + shift, values[:, ::-1]])
        header = 'seconds_elapsed,z,y,x'
        np.savetxt(folder / f'{name}.csv', rows, '%.9g', ',', header=header, comments='')
    return folder / f'{gyro}.csv', folder / f'{accel}.csv'


@pytest.mark.parametrize('accel', ['Accelerometer', 'TotalAcceleration'])
def test_two_tables_of_a_phone_are_one_imu(
    tmp_path: Path, accel: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Their columns are only called x, y and z: the name of the file states the sensor."""
    files = phone(tmp_path, 'Gyroscope', accel)
    results = ar.analyze([*files])
    assert tuple(results.axes) == AXES
    assert results['gyro_x'].N.value == pytest.approx(1e-4, rel=0.05)
    assert results['accel_z'].N.value == pytest.approx(1e-3, rel=0.05)
    assert main(['analyze', str(tmp_path), '--json']) == 0
    folder = json.loads(capsys.readouterr().out)
    assert main(['analyze', *map(str, reversed(files)), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['axes'] == folder['axes']
    assert set(folder['axes']) == set(AXES)


def test_raw_counts_are_divided_by_the_sensitivity(tmp_path: Path) -> None:
    counts = np.arange(12.0).reshape(2, 6)
    batch = ImuBatch(np.array([10**18, 10**18 + 10**7]), counts)
    sensitivity = {'gyro_counts': 131.0, 'accel_counts': 16384.0}
    units = {'gyro_unit': 'deg/s', 'accel_unit': 'g'}
    expected = np.column_stack(
        [np.deg2rad(counts[:, :3] / 131.0), counts[:, 3:] / 16384.0 * STANDARD_GRAVITY]
    )
    for name in ('counts.csv', 'counts.npz', 'counts.mcap'):
        writing.write_recording(tmp_path / name, [batch])
        found = read(tmp_path / name, **sensitivity, **units)
        np.testing.assert_allclose(found.samples, expected, rtol=1e-12)


def test_tables_of_two_sensors_at_different_times_are_not_one_imu(tmp_path: Path) -> None:
    files = phone(tmp_path, 'Gyroscope', 'Accelerometer', later_s=3600.0)
    with pytest.raises(AllanError, match='the sensors differ'):
        ar.analyze([*files])


def test_columns_that_are_not_recognized_are_listed(tmp_path: Path) -> None:
    text = 't,gx [rad/s],gy [rad/s],yaw rate,p,q,r\n0,1,2,3,4,5,6\n'
    (found,) = read(table(tmp_path, text)).findings
    assert found.id == 'columns_unrecognized'
    assert found.values['names'] == 'yaw rate, p, q, r'
    assert '--columns' in finding_line(found)


@pytest.mark.parametrize(
    'name, value, celsius',
    [
        ('temp', 25.0, 25.0),
        ('temp', 298.15, 25.0),
        ('Temperature [K]', 298.15, 25.0),
        ('temp_f', 77.0, 25.0),
        ('temperature (°C)', 25.0, 25.0),
    ],
)
def test_temperatures_are_converted_to_celsius(
    name: str, value: float, celsius: float, tmp_path: Path
) -> None:
    back = read(table(tmp_path, f't,gx,{name}\n0,1,{value}\n1,1,{value}\n'))
    trace = back.recording.temperature('')
    assert trace is not None and trace.celsius == pytest.approx([celsius] * 2)


def test_columns_can_be_named_and_left_out(tmp_path: Path) -> None:
    path = tmp_path / 'imu.txt'
    path.write_text(f'x,0.5,{ROW}\ny,0.6,{ROW}\n')
    back = read(path, columns=('-', 't', 'gx', 'gy', 'gz', 'ax', 'ay', 'az'))
    assert back.stamps_ns.tolist() == [500_000_000, 600_000_000]
    np.testing.assert_array_equal(back.samples, [VALUES, VALUES])


def test_a_rate_replaces_missing_times(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, 'BATCH', 7)  # stamps must continue across batches
    path = table(tmp_path, 'gx,gy,gz\n' + '1,2,3\n' * 20)
    back = read(path, rate_hz=200.0)
    np.testing.assert_array_equal(back.stamps_ns, np.arange(20) * 5_000_000)
    assert len(back.frame_ids) == 3


def test_missing_values_are_nan(tmp_path: Path) -> None:
    path = table(tmp_path, 't;gx;gy;gz\n\n1;1;;3\n# a pause\n2;nan;2,5;inf\n')
    expected = [[1, np.nan, 3], [np.nan, 2.5, np.inf]]
    np.testing.assert_array_equal(read(path).samples[:, :3], expected)


def test_each_date_has_its_own_time_zone(tmp_path: Path) -> None:
    path = tmp_path / 'imu.csv'
    dates = ['2026-03-29T00:59:59Z', '2026-03-29T03:00:00+02:00', '2026-03-28T20:00:01-0500']
    text = 't,gx\n' + ''.join(f'{date},1\n' for date in dates)
    path.write_text(text)
    assert np.diff(read(path).stamps_ns).tolist() == [10**9, 10**9]
    path.write_text(text + ',1\n')
    assert "line 5, column 1 (t): '' is not a number" in refused(path)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize(
    'date, seconds',
    [
        ('2026-01-31T12:00:00.5 +01:00', 1_769_857_200.5),
        ('2026-01-31T12:00:00+01', 1_769_857_200.0),
        ('2026-01-31 12:00 UTC', 1_769_860_800.0),
        ('2262-04-11T23:47:16Z', 9_223_372_036.0),
        ('1969-12-31T23:59:59', -1.0),
    ],
)
def test_dates_with_zones_are_read_without_warnings(
    date: str, seconds: float, tmp_path: Path
) -> None:
    assert read(table(tmp_path, f't,gx\n{date},1\n')).stamps_ns.tolist() == [int(seconds * 1e9)]


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('date', ['2262-04-12T00:00:00', '9999-01-01T00:00Z'])
def test_dates_out_of_range_are_refused(date: str, tmp_path: Path) -> None:
    assert 'does not fit the range' in refused(table(tmp_path, f't,gx\n{date},1\n'))


@pytest.mark.parametrize(
    'date',
    [
        '2026-13-01T00:00',
        '2026-01-01T00:00:61',
        '2026-01-01T00:00:00+24:00',
        '2026-01-01T00:00:00+01:60',
    ],
)
def test_invalid_dates_are_refused(date: str, tmp_path: Path) -> None:
    assert 'is not a number' in refused(table(tmp_path, f't,gx\n{date},1\n'))


def test_a_column_can_have_record_times(tmp_path: Path) -> None:
    back = read(table(tmp_path, 'stamp_ns,gx,record_time [ms]\n1,1,5\n2,1,6.5\n'))
    assert back.record_ns is not None and back.record_ns.tolist() == [5_000_000, 6_500_000]
    assert back.stamps_ns.tolist() == [1, 2]


def test_a_comment_can_name_the_frame(tmp_path: Path) -> None:
    path = table(tmp_path, '# frame_id: left\nt,gx\n1,1\n2,1\n# frame_id: right\n3,1\n')
    assert read(path).frame_ids == ['left', 'right']


@pytest.mark.parametrize('last', ['3,1,2', '3,1,2,1', '3,1,2,1.23', '3,1,2,"1'])
def test_a_last_line_without_a_line_end_is_not_used(last: str, tmp_path: Path) -> None:
    """A number may be truncated, such as 1.23e-05 to 1.23, and still be a number."""
    path = table(tmp_path, f't,gx[rad/s],gy[rad/s],gz[rad/s]\n1,1,2,3\n2,1,2,3\n{last}')
    back = read(path)
    assert len(back.stamps_ns) == 2
    assert [finding.id for finding in back.findings] == ['table_cut']
    assert 'line 4' in finding_line(back.findings[0])


def test_a_quoted_cell_may_contain_line_breaks(tmp_path: Path) -> None:
    header = 't,"gx\n[deg/s]",gy [deg/s],gz [deg/s],note'
    back = read(table(tmp_path, f'{header}\n1,1,2,3,"first\n\nline"\n2,1,2,3,x\n'))
    np.testing.assert_allclose(back.samples[:, :3], [[DEG, 2 * DEG, 3 * DEG]] * 2)
    assert back.findings == ()


def test_columns_can_be_picked_by_their_names(tmp_path: Path) -> None:
    path = tmp_path / 'wide.csv'
    path.write_text('id,Clock,rate_a [deg/s],rate_b,rate_c,x\n7,1,10,20,30,0\n7,2,10,20,30,0\n')
    columns = ('t=clock', 'gx=rate_a', 'gy[deg/s]=rate_b', 'gz[rad/s]=rate_c')
    back = read(path, columns=columns)
    assert back.stamps_ns.tolist() == [10**9, 2 * 10**9]
    np.testing.assert_allclose(back.samples[0, :3], [10 * DEG, 20 * DEG, 30.0])
    assert back.findings == ()
    assert '0 columns (' in refused(path, columns=('t=Clock', 'gx=rate_d'))


def test_an_unknown_name_excludes_no_other_column() -> None:
    names = ('t', 'gx', 'humidity', 'pressure')
    assert picked_names('a.csv', names, ('wet=humidity',)) == ('t', 'gx', 'wet', 'pressure')
    assert picked_names('a.csv', names, ('-=humidity',)) == ('t', 'gx', '-', 'pressure')


@pytest.mark.parametrize(
    'header, options, assumed, gyro_unit',
    [
        ('t,w_x,w_y,w_z', {}, ['gyro'], 'rad/s'),
        ('t,w_x,w_y,w_z', {'gyro_unit': 'rad/s'}, [], 'rad/s'),
        ('t,gx [deg/s],gy [deg/s],gz [deg/s]', {}, [], 'deg/s'),
        ('t,gx [deg/s],gy [deg/s],gz [deg/s]', {'gyro_unit': 'rad/s'}, [], 'deg/s'),
        ('stamp_ns,gyro_x,gyro_y,gyro_z', {}, [], 'rad/s'),
        ('t,angular_velocity.x,angular_velocity.y,angular_velocity.z', {}, [], 'rad/s'),
    ],
)
def test_an_unstated_unit_is_a_warning(
    header: str, options: Any, assumed: list[str], gyro_unit: str, tmp_path: Path
) -> None:
    path = table(tmp_path, f'{header}\n1,1,2,3\n2,1,2,3\n')
    back = read(path, **options)
    found = [f for f in back.findings if f.id == 'unit_assumed']
    assert [f.severity for f in found] == ['warning'] * len(assumed)
    assert all('--gyro-unit' in finding_line(f) for f in found)
    assert back.recording.options.gyro_unit == gyro_unit
    assert back.recording.options.accel_unit == 'm/s^2'


HEADER = 't,gx,gy,gz,ax,ay,az\n'
COLUMNS = tuple(HEADER.strip().split(','))


@pytest.mark.parametrize(
    'text, options, says',
    [
        (HEADER, {}, 'has no line after its header'),
        ('\n\n# nothing\n', {}, 'has no line of data'),
        (f'{HEADER}1,{ROW}\n2,1,2,oops,4,5,6\n', {}, "line 3, column 4 (gz): 'oops' is not"),
        (f'{HEADER}1,{ROW}\nnoon,{ROW}\n', {}, "line 3, column 1 (t): 'noon' is not a number"),
        (f'{HEADER}1,{ROW}\n' + '1' * (tables.MAX_LINE + 5), {}, 'line 3 has more than'),
        ('t\0,\0g\0x\0', {}, 'is UTF-16 or not text: save the table as UTF-8'),
        (f'{HEADER}1,{ROW}\n2,1,2,3\n3,{ROW}\n', {}, 'line 3 has 4 columns, 7 expected'),
        (f'{HEADER}1,{ROW}\n2,{ROW},8\n', {}, 'line 3 has 8 columns, 7 expected'),
        (f'{HEADER}1700000000000000000,{ROW}\n', {'stamp_unit': 's'}, 'state its unit with'),
        (
            'stamp_ns,gx\n' + ''.join(f'{17 * 10**14 + 5000 * i},1\n' for i in range(120)),
            {},
            'which are times since 1970 in us: use --stamp-unit us',
        ),
        ('time,z,y,x\n1,2,3,4\n', {}, 'or t=NAME,gx=NAME'),
        (f'1,{ROW}\n', {}, 'no header: name them in their order in the file'),
        (f'1,{ROW}\n', {'columns': ('t', 'gx')}, 'has 7 columns, but --columns names 2'),
        ('gx,gy,gz\n1,2,3\n', {}, 'state the sample rate (--rate'),
        ('t,a,b\n1,2,3\n', {}, 'line 1: no column (t, a, b) is a gyro or accel axis'),
        (f'\nDevice: Foo\n{HEADER}1,{ROW}\n', {}, 'line 2: no column (Device:, Foo) is a'),
        (f'Device: Foo\n{HEADER}1,{ROW}\n', {}, 'remove lines above the header'),
        (f'Foo\n{HEADER}1,{ROW}\n', {'columns': ('gx=w_x',)}, 'line 1: 0 columns (Foo) are'),
        (f'Device: Foo\n{HEADER}1,{ROW}\n', {'columns': COLUMNS}, 'line 1 has 2 columns, but'),
        ('\x7fELF\x02,\n', {}, 'not text'),
        (f'{"a" * 5000}\n1\n', {}, f'no column ({"a" * 40}...) is a gyro'),
        ('<html><h1>404</h1></html>', {}, 'line 1: no column (<html><h1>404</h1></html>) is a'),
        ('t,gx [mph],gy,gz\n1,2,3,4\n', {}, "the unit of column 'gx [mph]' is unknown"),
        ('t,gx,gy,gz\n1,"2,3,4\n', {}, 'line 2 is not a row of a table'),
        (f'{HEADER}1,\0,2,3,4,5,6\n', {}, 'line 2'),
    ],
)
def test_errors_are_reported_with_line_and_column(
    text: str, options: Any, says: str, tmp_path: Path
) -> None:
    path = table(tmp_path, text)
    assert says in refused(path, **options)


RATE_STEPS_S = (1 / 400, 1 / 100, 1 / 10)


@pytest.mark.parametrize('unit', ['s', 'ms', 'us', 'ns'])
@pytest.mark.parametrize('start_s', [0.0, 3.5, 1.7e9])
@pytest.mark.parametrize('step_s', RATE_STEPS_S)
def test_the_unit_of_times_is_recognized(
    unit: str, start_s: float, step_s: float, tmp_path: Path
) -> None:
    path = tmp_path / 'imu.csv'
    stamps_ns = int(start_s * 1e9) + np.arange(300) * round(step_s * 1e9)
    scale = {'s': 9, 'ms': 6, 'us': 3, 'ns': 0}[unit]
    times = [f'{stamp}e-{scale}' for stamp in stamps_ns.tolist()]
    path.write_text('time,gx\n' + ''.join(f'{time},{i}\n' for i, time in enumerate(times)))
    back = read(path)
    np.testing.assert_array_equal(back.stamps_ns, stamps_ns)
    assumed = unit != 's' and start_s < 1e9
    expected = {'unit_assumed'} | ({'stamp_unit_assumed'} if assumed else set())
    assert {f.id for f in back.findings} == expected
    assert back.recording.axes == ('gyro_x',)
    assert read(path, stamp_unit=unit).stamps_ns.tolist() == stamps_ns.tolist()


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 9).flatmap(
        lambda n: st.tuples(
            arrays(np.int64, n),
            arrays(np.float64, (n, 6), elements=st.floats(allow_nan=True)),
        )
    )
)
def test_any_batch_is_read_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, drawn: Any
) -> None:
    from allan_ros.readers import open_recording

    stamps, samples = drawn
    path = tmp_path_factory.mktemp('table') / 'imu.csv'
    writing.write_table(path, [ImuBatch(stamps, samples, None, 'imu')])
    [batch] = open_recording(path).batches()
    np.testing.assert_array_equal(batch.stamps_ns, stamps)
    np.testing.assert_array_equal(batch.samples, samples)
    assert (np.signbit(batch.samples) == np.signbit(samples)).all() or np.isnan(samples).any()
    assert batch.record_ns is None
