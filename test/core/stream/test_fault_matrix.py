# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The worst cells of the table of faults: named, healed, N afterwards, good data used."""

import sys
from pathlib import Path

import numpy as np
import pytest
from support.streams import START, accumulate, assert_accounted, assert_same

BENCH = Path(__file__).resolve().parents[3] / 'bench'
if not BENCH.exists():
    pytest.skip('without the folder bench', allow_module_level=True)
sys.path.insert(0, str(BENCH))
import bench_faults as bench  # noqa: E402


# sd of the white noise of 120 s is .6 %, limit 3 %: false alarm 6e-7
@pytest.mark.parametrize(
    'fault, begin, lasts',
    [
        ('frozen', 0, 30),
        ('zero_filled', 0, 120),
        ('every_second_zero', 0, 30),
        ('held', 0, 30),
        ('stamps_zero', 0, 30),
        ('every_second_zero', 120, 30),
        ('held', 120, 120),
        ('unit_g', 0, 30),
        ('unit_g', 120, 120),
        ('unit_g', 120, None),
        ('unit_deg', 0, 120),
        ('unit_deg', 120, 30),
        ('no_gravity', 120, 30),
        ('15_percent', 120, 120),
        ('clipped', 120, 30),
        ('toggling', 120, 120),
    ],
)
def test_a_fault_is_named_and_leaves_nothing_behind(fault, begin, lasts):
    outcome = bench.run(bench.FAULTS[fault], begin, lasts, seed=11)
    assert all(flag is not False for flag in outcome.flags), outcome


@pytest.mark.parametrize('fault', ['15_percent', 'clipped', 'toggling'])
def test_a_fault_from_boot_is_replaced_by_what_lasts_longer(fault):
    """It looks like noise that increases, until the noise has lasted longer than the fault."""
    outcome = bench.run(bench.FAULTS[fault], 0, 30, seed=11)
    assert outcome.error < bench.N_ERROR and outcome.used > 0.85


def test_sums_of_before_continue_when_a_fan_is_switched_off_after_a_long_time():
    rng = np.random.default_rng(4)
    x = bench.simulated(400, rng)
    fan = slice(100 * bench.RATE, 300 * bench.RATE)
    x[fan] = bench.FAULTS['fan'].change(x[fan], rng)
    x = bench.rounded(x)
    times = START + np.arange(len(x)) * (10**9 // bench.RATE)
    during = accumulate(times[: fan.stop], x[: fan.stop])
    assert during.health.discarded == 1 and during.health.state == 'at_rest'
    assert 150 < during.sums[0].elapsed_ns * 1e-9 < 200
    after = accumulate(times, x)
    assert after.health.discarded == 0 and after.health.state == 'at_rest'
    assert after.sums[0].samples > 0.9 * 200 * bench.RATE
    assert after.sums[0].avar[0] == pytest.approx(bench.SIGMA**2 + bench.LSB**2 / 12, rel=0.06)
    assert_accounted(after)
    assert_same(after, accumulate(times, x, chunks=(37,)))


@pytest.mark.parametrize('fault', ['zero_filled', 'held', 'every_second_zero'])
@pytest.mark.parametrize('end', [1, 2000, 2049, 2950])
def test_streams_that_begin_after_a_fault_do_not_depend_on_the_chunks(fault, end):
    rng = np.random.default_rng(6)
    x = bench.rounded(bench.simulated(50, rng))
    x[:end] = bench.FAULTS[fault].change(x[:end], rng)
    times = START + np.arange(len(x)) * (10**9 // bench.RATE)
    one = accumulate(times, x)
    assert_same(one, accumulate(times, x, chunks=(53, 700)))
    assert len(one.sums) == 1 or end > 1
    gyro = [sums for sums in one.sums if 'gyro_x' in sums.axes]
    assert gyro and gyro[0].samples >= 0.9 * (len(x) - end) - 128


@pytest.mark.parametrize('fault', ['held', 'unit_g', 'unit_deg', 'every_second_zero'])
def test_faults_that_are_named_do_not_depend_on_the_chunks(fault):
    rng = np.random.default_rng(5)
    x = bench.rounded(bench.simulated(90, rng))
    x[4000:] = bench.FAULTS[fault].change(x[4000:], rng)
    times = START + np.arange(len(x)) * (10**9 // bench.RATE)
    one = accumulate(times, x)
    assert {f.id for f in one.findings} & set(bench.FAULTS[fault].names.split())
    assert_accounted(one)
    assert_same(one, accumulate(times, x, chunks=(53, 700)))
