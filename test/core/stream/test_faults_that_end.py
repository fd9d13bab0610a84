# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults that end: they teach no noise floor, and leave nothing behind in the sums."""

import numpy as np
import pytest
from support.streams import START, accumulate, assert_accounted, assert_same, ids

from allan_ros.core.imu import AXES, ImuBatch
from allan_ros.core.stream.pipeline import ImuStream

LSB = np.array([np.radians(1 / 131)] * 3 + [9.80665 / 16384] * 3)
SIGMA = np.array([1.5e-3] * 3 + [2e-2] * 3)
WINDOW_S, BLOCK_S = 0.5, 16.0
SETS = {'y gyro': [1], 'z accel': [5], 'gyro': [0, 1, 2], 'all': [0, 1, 2, 3, 4, 5]}


def imu(seconds, rate, rng):
    """Return samples of an IMU with a bias, a drift and 16 bits, before rounding, (n, 6)."""
    n = round(seconds * rate)
    bias = np.append(rng.normal(size=5) * ([2e-3] * 3 + [0.1] * 2), 9.8)
    drift = rng.normal(size=6) * ([1e-3] * 3 + [1e-2] * 3)
    return bias + np.linspace(0.0, 1.0, n)[:, None] * drift + SIGMA * rng.normal(size=(n, 6))


def rounded(x):
    return np.round(x / LSB) * LSB


def toggling(x, rng):
    return LSB * (rng.random(x.shape) < 0.3)


FAULTS = {
    'frozen': lambda x, rng: rounded(x[:1]) + 0.0 * x,
    'dead': lambda x, rng: 0.0 * x,
    'toggling': toggling,
    'clipped': lambda x, rng: np.minimum(x, np.quantile(x, 0.02, axis=0)),
    'filtered': lambda x, rng: x.mean(axis=0) + 0.15 * (x - x.mean(axis=0)),
}


def with_fault(x, fault, axes, begin, end, rng):
    """Return the rounded samples with a fault of some axes in the samples begin to end."""
    x = rounded(x)
    x[begin:end, axes] = rounded(FAULTS[fault](x[begin:end], rng))[:, axes]
    return x


def stream(x, rate, **options):
    return accumulate(
        START + np.rint(np.arange(len(x)) * 1e9 / rate).astype(np.int64), x, **options
    )


def check(result, expected, share):
    """Check that a share of the expected number of samples is used, and their noise level."""
    (sums,) = result.sums
    assert sums.axes == AXES and share * expected <= sums.samples <= expected
    # sd of a variance of 5000 white samples at m = 1 is at most 1.8 %, 5 sigma: false alarm 6e-7
    assert sums.avar[0] == pytest.approx(SIGMA**2 + LSB**2 / 12, rel=0.09)
    assert_accounted(result)


@pytest.mark.parametrize('fault', FAULTS)
@pytest.mark.parametrize('axes', SETS)
@pytest.mark.parametrize('offset', [-2, 1, 17])
def test_a_fault_of_half_a_minute_changes_nothing_but_its_own_stretch(fault, axes, offset):
    """It begins or ends beside the border of a window or of a block, or within a window."""
    rate, rng = 100, np.random.default_rng([sorted(FAULTS).index(fault), offset + 2])
    for begin in (round(2 * BLOCK_S * rate), round((3 * BLOCK_S + 9 * WINDOW_S) * rate)):
        end = begin + 30 * rate + offset
        x = with_fault(imu(120, rate, rng), fault, SETS[axes], begin + offset, end, rng)
        result = stream(x, rate)
        # up to half of a block is needed to find that the noise is as before
        check(result, len(x) - 27.5 * rate, 83 / 92.5)
        assert result.health.discarded == 0 and result.health.state == 'at_rest'
        found = ids(result) & {'stuck', 'noise_decreased', 'motion'}
        assert found & {'stuck', 'noise_decreased'} or (fault == 'clipped' and found)


@pytest.mark.parametrize(
    'fault, axes', [('dead', 'y gyro'), ('dead', 'z accel'), *(('frozen', axes) for axes in SETS)]
)
@pytest.mark.parametrize('begin', [0.0, 0.3, 5.0, 14.0])
def test_an_axis_that_is_stuck_at_first_is_no_axis_without_noise(fault, axes, begin):
    rate, rng = 100, np.random.default_rng(round(10 * begin))
    end = round((begin + 40.0) * rate)
    x = with_fault(imu(150, rate, rng), fault, SETS[axes], round(begin * rate), end, rng)
    result = stream(x, rate)
    check(result, len(x) - 37.5 * rate, 0.8)
    assert 'no_noise' not in ids(result) and result.health.state == 'at_rest'
    (found,) = [f for f in result.findings if f.id == 'stuck']
    assert found.axes == tuple(AXES[i] for i in SETS[axes])


@pytest.mark.parametrize('rate', [20, 1000])
@pytest.mark.parametrize('fault', ['filtered', 'frozen'])
def test_the_rate_does_not_matter(rate, fault):
    rng = np.random.default_rng(7)
    x = with_fault(imu(400, rate, rng), fault, SETS['all'], 150 * rate, 190 * rate, rng)
    # up to two checks of eight windows of at least 16 samples are needed to find that it ended
    check(stream(x, rate), len(x) - 37.5 * rate, 0.96)


def test_less_noise_is_named_while_it_lasts_and_becomes_normal_after_ten_minutes():
    rate, rng = 20, np.random.default_rng(3)
    x = rounded(imu(800, rate, rng))
    x[60 * rate :] = rounded(x[-1] + 0.15 * (x[60 * rate :] - x[-1]))
    live, states, used = ImuStream(), [], []
    times = START + np.arange(len(x)) * 50_000_000
    for at in range(0, len(x), 5 * rate):
        live.update(ImuBatch(times[at : at + 5 * rate], x[at : at + 5 * rate]))
        states.append(live.result().health.state)
        used.append(sum(each.samples for each in live.result().sums) / rate)
    assert states[6:12] == ['at_rest'] * 6 and states[14:130] == ['noise_decreased'] * 116
    assert states[140:] == ['at_rest'] * 20
    # the sums are the sums of before, until the noise has been less for ten minutes
    assert max(used[14:130]) <= 60.0 and used[-1] > 700.0
    result = stream(x, rate)
    assert 'relearned' in ids(result) and 'noise_decreased' not in ids(result)
    # one check of eight windows of 16 samples passes until the other level begins
    assert result.health.discarded_s == pytest.approx(66.0, abs=8.0)
    assert_accounted(result)
    assert_same(result, stream(x, rate, chunks=(37,)))


def test_noise_that_decreases_twice_resumes_the_first_sums():
    rate, rng = 100, np.random.default_rng(4)
    x = imu(240, rate, rng)
    for begin, end, factor in ((80, 100, 0.15), (100, 120, 0.02)):
        part = slice(begin * rate, end * rate)
        x[part, :3] = factor * x[part, :3]
    result = stream(rounded(x), rate)
    # up to half of a block is needed to find that the noise is as before
    check(result, len(x) - 37.5 * rate, 1.0 - 0.75 * BLOCK_S / 200)
    assert_same(result, stream(rounded(x), rate, chunks=(999, 5)))


@pytest.mark.parametrize('limits', [0.9, 1.0, 1.1, 3.0])
def test_another_bias_of_the_gyro_becomes_normal(limits):
    """Near the limit of a rotation, noise decides about each window."""
    rate, rng = 100, np.random.default_rng(8)
    x = imu(150, rate, rng)
    x[63 * rate :, 1] += limits * np.radians(0.5)
    result = stream(rounded(x), rate)
    # the mean is updated at the end of a block, and two more seconds are excluded
    check(result, len(x), 1.0 - (2 * BLOCK_S + 2 + 1) / 150)
    assert result.health.state == 'at_rest' and result.health.discarded == 0
    assert_same(result, stream(rounded(x), rate, chunks=(999, 5)))


@pytest.mark.parametrize('share', [0.045, 0.055, 0.07, 0.095, 0.105])
@pytest.mark.parametrize('begin_s', [0, 100])
def test_clipping_near_a_limit_does_not_change_the_level_again_and_again(share, begin_s):
    rate, rng = 100, np.random.default_rng(10)
    x = imu(300, rate, rng)
    begin = begin_s * rate
    x[:, 1] = SIGMA[1] * rng.normal(size=len(x))
    x[begin:, 1] = np.minimum(x[begin:, 1], np.quantile(x[:, 1], 1.0 - share))
    result = stream(rounded(x), rate)
    (sums,) = result.sums
    assert sum(result.health.counts.splits.values()) <= 2
    assert sums.samples > 0.9 * (begin or len(x))
    assert_same(result, stream(rounded(x), rate, chunks=(999, 5)))


@pytest.mark.parametrize('samples, has_finding', [(2, False), (60, False), (1000, True)])
def test_few_equal_samples_do_not_show_that_a_sensor_has_no_noise(samples, has_finding):
    assert ('no_noise' in ids(stream(np.full((samples, 6), 9.8), 100))) == has_finding
