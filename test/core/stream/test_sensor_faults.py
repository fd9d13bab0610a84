# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of sensors and drivers: what is reported, and N without the fault."""

import numpy as np
import pytest
from support.streams import PERIOD, accumulate, faulty, ids, repeated, still

from allan_ros.core.fit.stationary import fit_likelihood
from allan_ros.core.imu import AXES
from allan_ros.core.stream.health import unit_findings
from allan_ros.view.finding_text import texts_of


def mean_n(sums):
    return np.mean([fit.noise['N'].value for fit in fit_likelihood(sums).axes.values()])


def test_sensors_with_different_rates_have_separate_sums():
    """A 125 Hz accelerometer is repeated at 200 Hz; its white noise is measured at its own rate."""
    n = 40_000
    t, x = still(n)
    x[:, 3:] = np.random.default_rng(9).normal(size=(n, 3))[np.arange(n) * 5 // 8] * 0.02
    gyro, accel = accumulate(t, x).sums
    assert (gyro.axes, accel.axes) == (AXES[:3], AXES[3:])
    assert 1 / gyro.tau0 == pytest.approx(200) and 1 / accel.tau0 == pytest.approx(125, rel=1e-4)
    # sd of a variance of 25,000 white samples at m = 1 is 1 %, 5 sigma: false alarm 2e-6
    assert accel.avar[0] == pytest.approx([4e-4] * 3, rel=0.05)


@pytest.mark.parametrize(
    'share, together', [(0.02, True), (0.04, False), (0.2, True), (0.3, False)]
)
def test_random_repeats_are_interpolated_and_n_is_corrected(share, together):
    rng = np.random.default_rng(5)
    t, x = still(60_000)
    parts = [x] if together else [x[:, :3], x[:, 3:]]
    result = accumulate(t, np.hstack([repeated(part, share, rng) for part in parts]))
    (sums,) = result.sums
    (note,) = result.findings
    assert note.id == 'repeated' and note.axes == AXES
    assert sums.samples == len(t) and 1 / sums.tau0 == pytest.approx(200)
    # 5 sigma of the number of repeats is 12 % at 2 %: false alarm 6e-7
    length, level, *numbers = sums.replaced.T
    assert (level == 1).all()
    assert [length @ each for each in numbers] == pytest.approx([share * len(t)] * 6, rel=0.15)
    # sd of the mean N of six axes is at most 0.3 %, 5 sigma: false alarm 6e-7
    assert mean_n(sums) == pytest.approx(1e-3 * 200**-0.5, rel=0.015)


@pytest.mark.parametrize('rate', [166.0, 150.0, 133.0, 110.0, 100.0])
def test_a_sensor_that_is_polled_faster_than_its_rate_has_its_own_rate(rate):
    n = 20_000
    t, x = still(n)
    result = accumulate(t, x[(np.arange(n) * rate / 200).astype(int)])
    (sums,) = result.sums
    assert ids(result) == {'held'} and len(result.segments) == 1
    assert sums.axes == AXES and sums.samples == n * rate / 200
    assert 1 / sums.tau0 == pytest.approx(rate, rel=1e-3)


def test_losses_that_scattered_stamps_hide_increase_n_as_the_finding_states():
    t, x = still(60_000)
    rng = np.random.default_rng(2)
    t = np.sort(t + (rng.normal(size=len(t)) * 0.5 * PERIOD).astype(np.int64))
    kept = rng.random(len(t)) > 0.05
    result = accumulate(t[kept], x[kept])
    assert ids(result) == {'bursty_stamps'}
    # sd of the mean N of six axes is below 0.3 %, 5 sigma: false alarm 6e-7
    assert mean_n(result.sums[0]) == pytest.approx(1.025 * 1e-3 * 200**-0.5, rel=0.015)


def test_a_stuck_sensor_is_no_repeated_sample():
    t, x = still(20_000)
    x[300:340] = x[300]
    assert not ids(accumulate(t, x)) & {'held', 'repeated'}
    x = repeated(x, 0.1, np.random.default_rng(0))
    x[9000:9300] = x[9000]
    result = accumulate(t, x)
    assert {'repeated', 'stuck'} <= ids(result)
    assert result.health.counts.stuck > 200


def test_heavy_tails_are_reported_with_the_share_of_outliers():
    t, x = still(20_000)
    x[:, 4] += 5e-3 * np.random.default_rng(1).standard_t(3, len(x))
    (found,) = [f for f in accumulate(t, x).findings if f.severity == 'warning']
    # the share of |t| > 6 median absolute deviations is 1.9 %
    assert (
        found.id == 'outliers'
        and found.axes == ('accel_y',)
        and 0.01 < found.values['share'] < 0.02
    )


@pytest.mark.parametrize('difference', [3.0, 100.0])
@pytest.mark.parametrize('delay', [0.0, 0.2, 0.5])
def test_two_imus_with_one_frame_id_are_reported(difference, delay):
    t, x = still(12_000)
    y = x + difference * 1e-3 * np.random.default_rng(3).choice([-1, 1], 6)
    times = np.sort(np.concatenate([t, t + int(delay * PERIOD)]))
    both = np.empty((2 * len(t), 6))
    both[::2], both[1::2] = x, y
    assert 'interleaved' in ids(accumulate(times, both))


def test_differences_of_a_pulse_counter_are_not_clipped():
    """The differences have rounding errors, so one value of the counter becomes several."""
    t, x = still(12_000)
    angle = np.cumsum(0.1 * x[:, :3] + [3e-4, 5e-4, 7e-4], axis=0)
    x[:, :3] = np.diff(np.floor(angle / 2e-3) * 2e-3, axis=0, prepend=0.0)
    assert 'clipped' not in ids(accumulate(t, x))


@pytest.mark.parametrize('declared, rate', [(0.0, 400 / 3), (200.0, 200.0)])
def test_samples_that_are_missing_regularly_are_reported_with_the_assumed_rate(declared, rate):
    t, x = faulty('third missing', 15_000)
    result = accumulate(t, x, declared_rate=declared)
    assert result.health.rate_hz == pytest.approx(rate, rel=1e-3) and len(result.segments) == 1
    assert ids(result) == ({'interpolated'} if declared else {'rate_assumed'})


@pytest.mark.parametrize('bias', [0.0, 2e-3])
def test_a_gyro_whose_unit_becomes_degrees_does_not_seem_to_rotate(bias):
    """As degrees, a bias of 0.1 deg/s looks like a rotation by 7 deg/s."""
    t, x = still(40_000)
    x[:, :3] += bias
    x[20_000:, :3] = np.degrees(x[20_000:, :3])
    result = accumulate(t, x)
    assert result.health.state == 'noise_increased'
    assert [f.axes for f in result.findings if f.id == 'gyro_unit_changed'] == [AXES[:3]]
    assert result.sums[0].samples == pytest.approx(20_000, abs=400)


def test_louder_noise_at_rest_is_a_warning_with_its_size_and_no_motion():
    t, x = still(40_000)
    x[20_000:] += 3.9 * np.random.default_rng(3).normal(size=(20_000, 6)) * 1e-3
    result = accumulate(t, x)
    (found,) = [f for f in result.findings if f.id == 'noise_increased']
    assert result.health.state == 'noise_increased' and found.axes == AXES
    # the largest of six standard deviations over the lowest quarter of the floor: 4.0 to 4.6
    assert 3.9 < found.values['ratio'] < 4.8 and found.severity == 'warning'
    assert result.sums[0].samples == pytest.approx(20_000, abs=400)


def test_sums_of_motion_are_discarded_and_this_is_reported():
    t, x = still(12_000)
    x[:6000] += np.random.default_rng(0).normal(size=(6000, 6)) * 0.1  # vibration only
    before, after = accumulate(t[:6000], x[:6000]), accumulate(t, x)
    assert before.health.discarded == 0 and after.health.discarded == 1
    (found,) = [f for f in after.findings if f.id == 'relearned']
    excluded_s = (after.segments[0].start_ns - t[0]) * 1e-9
    assert found.values['seconds'] == pytest.approx(excluded_s, abs=1.0)
    assert after.segments[0].start_ns > before.segments[0].start_ns


@pytest.mark.parametrize(
    'scale, expected',
    [
        ([1.0] * 6, set()),
        ([57.3] * 3 + [1.0] * 3, {'gyro_unit'}),
        ([1.0] * 3 + [1 / 9.80665] * 3, {'accel_unit'}),
        ([1.0] * 3 + [1000 / 9.80665] * 3, {'accel_unit'}),
        ([1.0] * 3 + [9.80665] * 3, {'accel_unit'}),
        ([1.0] * 3 + [0.5] * 3, {'accel_scale'}),
        ([1.0] * 5 + [0.0], set()),
    ],
    ids=['SI', 'deg/s', 'g', 'mg', 'm/s^2 declared as g', 'wrong scale', 'without gravity'],
)
def test_units_that_cannot_be_si_are_named(scale, expected):
    t, x = still(12_000)
    found = [f for f in accumulate(t, x * scale).findings if 'unit' in f.id or 'scale' in f.id]
    assert {f.id for f in found} == expected
    for f in found:
        assert f.severity == 'error' and (
            'deg/s' in texts_of(f).remedy or 'accelerometer' in texts_of(f).remedy
        )


def test_no_unit_is_suggested_for_raw_counts():
    t, x = still(12_000)
    counts = np.round(x * ([131 * 180 / np.pi] * 3 + [16384 / 9.80665] * 3))
    gyro, accel = (f for f in accumulate(t, counts).findings if f.severity == 'error')
    assert (gyro.id, accel.id) == ('gyro_unit', 'accel_scale')
    assert gyro.values['unit'] is None and 'raw counts' in texts_of(gyro).remedy


EXCHANGED = [3, 4, 5, 0, 1, 2]


@pytest.mark.parametrize(
    'gyro_factor, accel_factor, expected',
    [
        (1.0, 1.0, ('rad/s', 'm/s^2')),
        (np.pi / 180, 1.0, ('deg/s', 'm/s^2')),
        (np.pi / 180, 9.80665, ('deg/s', 'm/s^2')),
        (1 / 9.80665, 1.0, ('rad/s', 'g')),
    ],
    ids=['SI', 'gyro declared as deg/s', 'declared as deg/s and g', 'accelerometer in g'],
)
def test_exchanged_sensors_are_named_also_if_a_unit_is_declared(
    gyro_factor, accel_factor, expected
):
    t, x = still(12_000)
    swapped = x[:, EXCHANGED] * ([gyro_factor] * 3 + [accel_factor] * 3)
    (found,) = [f for f in accumulate(t, swapped).findings if f.severity == 'error']
    assert found.id == 'sensors_exchanged'
    assert (found.values['unit'], found.values['other']) == expected


def test_exchanged_sensors_with_separate_sums_are_named():
    t, x = still(12_000)
    swapped = x[:, EXCHANGED]
    gyro, accel = ([1.0] * 3 + [0.0] * 3, [0.0] * 3 + [1.0] * 3)
    sums = [s for only in (gyro, accel) for s in accumulate(t, swapped * only).sums]
    assert [len(s.axes) for s in sums] == [3, 3]
    assert [f.id for f in unit_findings(sums)] == ['sensors_exchanged']


@pytest.mark.parametrize(
    'factor, expected', [(1.0, []), (180 / np.pi, ['gyro_unit'])], ids=['rad/s', 'deg/s']
)
def test_an_imu_without_gravity_is_not_taken_for_exchanged_sensors(factor, expected):
    t, x = still(12_000)
    x[:, 5] -= 9.8
    found = accumulate(t, x * ([factor] * 3 + [1.0] * 3)).findings
    assert [f.id for f in found if f.severity == 'error'] == expected
    (note,) = [f for f in found if f.id == 'no_gravity']
    assert note.severity == 'info' and note.axes == AXES[3:] and note.values['norm'] < 0.01


def test_a_stuck_axis_is_named():
    t, x = still(20_000)
    x[9_000:12_000, 4] = x[9_000, 4]
    (found,) = [f for f in accumulate(t, x).findings if f.id == 'stuck']
    # windows of half a second at the ends may count as moving
    assert found.axes == ('accel_y',) and found.values['count'] == pytest.approx(3_000, abs=250)


@pytest.mark.parametrize('first', [0, 12_000])
def test_an_axis_that_is_clipped_at_any_time_is_named(first):
    t, x = still(24_000)
    x[first:, 1] = np.minimum(x[first:, 1], np.quantile(x[:, 1], 0.8))
    (found,) = [f for f in accumulate(t, x).findings if f.id == 'clipped']
    # 4 s have 800 samples: sd 7 %
    assert found.axes == ('gyro_y',) and found.values['share'] == pytest.approx(0.2, rel=0.35)


def test_clipping_that_ends_is_named_with_its_time_and_excluded():
    t, x = still(36_000)
    x[12_000:24_000, 1] = np.minimum(x[12_000:24_000, 1], np.quantile(x[:, 1], 0.7))
    result = accumulate(t, x)
    (found,) = [f for f in result.findings if f.id in ('clipped', 'noise_decreased')]
    assert found.id == 'noise_decreased' and found.axes == ('gyro_y',)
    assert found.values['seconds'] == pytest.approx(60.0, abs=8.0)
    assert result.sums[0].samples == pytest.approx(24_000, abs=1600)


def test_a_copied_axis_is_named():
    t, x = still(6_000)
    assert 'axes_equal' not in ids(accumulate(t, x))
    x[:, 1] = x[:, 0] + 1.0
    (found,) = [f for f in accumulate(t, x).findings if f.id == 'axes_equal']
    assert found.axes == ('gyro_x', 'gyro_y') and found.severity == 'error'


@pytest.mark.parametrize('lsb', [0.0, 0.1, 0.5, 2.0])
def test_an_axis_at_the_end_of_its_range_is_reported(lsb):
    times, noise = still(3000)
    noise = noise / noise.std(axis=0)
    samples = np.round(noise / lsb) * lsb if lsb else noise
    assert 'clipped' not in ids(accumulate(times, samples))
    if lsb < 0.5:
        end = np.median(samples[:, 5])
        samples[:, 5] = np.minimum(samples[:, 5], end)
        clipped = [f for f in accumulate(times, samples).findings if f.id == 'clipped']
        assert [f.axes for f in clipped] == [('accel_z',)]
