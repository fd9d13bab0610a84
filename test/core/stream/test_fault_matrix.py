# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The worst cell of each row of the table of faults: named, healed, N afterwards, data used."""

import sys
from pathlib import Path

import numpy as np
import pytest
from support.streams import accumulate, assert_accounted, assert_same

BENCH = Path(__file__).resolve().parents[3] / 'bench'
if not BENCH.exists():
    pytest.skip('without the folder bench', allow_module_level=True)
sys.path.insert(0, str(BENCH))
import bench_faults as bench  # noqa: E402


# false alarm of the noise: `N_SIGMAS` of the benchmark
@pytest.mark.parametrize(
    'fault, at_boot, lasts',
    [
        ('stuck', True, 30),
        ('dead_sensor', True, 120),
        ('every_second_zero', True, 30),
        ('stamps_zero', True, 30),
        ('stamps_reversed', True, 30),
        ('nan', True, 30),
        ('bursts', False, 30),
        ('spikes', False, 30),
        ('second_imu', False, 120),
        ('flipped', True, 120),
        ('bias_step', False, None),
        ('permuted', False, None),
        ('half_rate', False, 30),
        ('every_second_zero', False, 30),
        ('held', False, 120),
        ('unit_g', True, 30),
        ('unit_g', False, None),
        ('unit_deg', True, 120),
        ('unit_mrad', False, 30),
        ('no_gravity', False, 30),
        ('15_percent', False, 120),
        ('clipped', False, 30),
        ('half_clipped', False, 120),
        ('toggling', False, 120),
        ('fan', False, 120),
        ('driving', False, 120),
    ],
)
def test_a_fault_is_named_and_leaves_nothing_behind(fault, at_boot, lasts):
    outcome = bench.run(bench.FAULTS[fault], at_boot, lasts, seed=11)
    assert all(flag is not False for flag in outcome.flags), outcome


def stream_with(fault, seconds, begin_s, end_s, seed):
    """Return stamps and samples of an IMU with a fault between two times in s."""
    rng = np.random.default_rng(seed)
    whole = bench.messages_of(bench.rounded(bench.simulated(seconds, rng)))
    place = slice(round(begin_s * bench.RATE), round(end_s * bench.RATE))
    messages = bench.with_fault(whole, bench.FAULTS[fault], place, rng)
    return messages.stamps, messages.samples


def test_sums_of_before_continue_when_a_fan_is_switched_off_after_a_long_time():
    times, x = stream_with('fan', 400, 100, 300, seed=4)
    end = 300 * bench.RATE
    during = accumulate(times[:end], x[:end])
    assert during.health.discarded == 1 and during.health.state == 'at_rest'
    assert 150 < during.sums[0].elapsed_ns * 1e-9 < 200
    after = accumulate(times, x)
    assert after.health.discarded == 0 and after.health.state == 'at_rest'
    assert after.sums[0].samples > 0.9 * 200 * bench.RATE
    assert after.sums[0].avar[0] == pytest.approx(bench.SIGMA**2 + bench.LSB**2 / 12, rel=0.06)
    assert_accounted(after)
    assert_same(after, accumulate(times, x, chunks=(37,)))


@pytest.mark.parametrize('fault', ['dead_sensor', 'held', 'every_second_zero', 'nan'])
@pytest.mark.parametrize('end', [0.01, 20.0, 20.49, 29.5])
def test_streams_that_begin_after_a_fault_do_not_depend_on_the_chunks(fault, end):
    times, x = stream_with(fault, 50, 0, end, seed=6)
    one = accumulate(times, x)
    assert_same(one, accumulate(times, x, chunks=(53, 700)))
    assert len(one.sums) == 1 or end > 1
    gyro = [sums for sums in one.sums if 'gyro_x' in sums.axes]
    assert gyro and gyro[0].samples >= 0.9 * (50 - end) * bench.RATE - 128


@pytest.mark.parametrize(
    'fault',
    [
        'held',
        'unit_g',
        'unit_deg',
        'every_second_zero',
        'driving',
        'fan',
        '15_percent',
        'lost',
        'bursts',
        'half_clipped',
    ],
)
def test_faults_do_not_depend_on_the_chunks(fault):
    times, x = stream_with(fault, 110, 40.3, 80.7, seed=5)
    one = accumulate(times, x)
    assert_accounted(one)
    assert_same(one, accumulate(times, x, chunks=(53, 700)))
    assert_same(one, accumulate(times, x, chunks=(1600,)))
