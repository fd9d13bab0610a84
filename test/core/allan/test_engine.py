# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Running sums are equal for any chunking, equal to the definition and to published tables."""

import allantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.allan_table import allan_table
from support.sums import TICK_NS, assert_identical, feed, sums_of

from allan_ros.core.allan.engine import BLOCK, RunningAllan
from allan_ros.core.allan.sums import counts, grid_for
from allan_ros.core.imu import ImuIdentity


def nbs14(n):
    """Return the 1000-point data set NBS14 with n points: a linear congruential sequence."""
    value, out = 1234567890, np.empty(n)
    for i in range(n):
        out[i] = value / 2147483647
        value = 16807 * value % 2147483647
    return out


def test_nbs14_overlapping_table_to_seven_digits():
    table = allan_table(nbs14(1000), [1, 10, 100])
    assert np.sqrt(table.avar) == pytest.approx(
        [2.922319e-01, 9.159953e-02, 3.241343e-02], rel=2e-7
    )


@pytest.mark.parametrize('n', [17, 1000, 10_000])
def test_table_equals_an_independent_implementation(n):
    y = np.random.default_rng(n).normal(size=n).cumsum()
    m = np.unique(np.geomspace(1, n // 2 - 1, 20).astype(int))
    taus, adev, _, number = allantools.oadev(y, rate=1.0, data_type='freq', taus=m.astype(float))
    table = allan_table(y, taus.astype(int))
    assert np.array_equal(table.n, number)
    assert np.sqrt(table.avar) == pytest.approx(adev, rel=1e-12)


@pytest.mark.parametrize('n', [2, 3, 16, 17, 56, 2047, 2048, 2049, 4096, 10_000])
def test_running_sums_equal_the_definition_at_the_same_factors(n):
    y = np.random.default_rng(n).normal(size=(n, 3)) + [0.0, 9.8, -5.0]
    sums = sums_of(y)
    table = allan_table(y, sums.m, sums.stride)
    groups = allan_table(y, sums.m, sums.m)
    assert 2 * sums.m[-1] <= n < 4 * sums.m[-1]
    assert np.array_equal(sums.count, table.n)
    assert np.array_equal(sums.group_count, groups.n)
    assert sums.avar == pytest.approx(table.avar, rel=1e-12)
    assert sums.group_avar == pytest.approx(groups.avar, rel=1e-12)
    scale = np.sqrt(table.n[:, None] * table.avar) * sums.m[:, None]
    assert np.all(np.abs(sums.segments[0].signed - table.signed) <= 1e-10 * scale)


def test_running_sums_equal_the_definition_after_a_million_samples():
    y = np.random.default_rng(5).normal(size=(1_000_000, 1)) + 9.8
    sums = sums_of(y, [32768])
    table = allan_table(y, sums.m, sums.stride)
    assert sums.avar == pytest.approx(table.avar, rel=1e-10)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 3 * BLOCK),
    st.lists(st.integers(1, 2 * BLOCK), min_size=1, max_size=5),
    st.integers(0, 2**32 - 1),
)
def test_any_chunking_gives_the_same_sums(n, chunks, seed):
    y = np.random.default_rng(seed).normal(size=(n, 2))
    assert_identical(sums_of(y), sums_of(y, chunks))


def test_reading_the_sums_does_not_change_them():
    y = np.random.default_rng(3).normal(size=(3 * BLOCK, 2))
    engine = RunningAllan(ImuIdentity('imu'), ('axis_0', 'axis_1'))
    for at in range(0, len(y), 500):
        feed(engine, y[at : at + 500], first=at * TICK_NS)
        assert_identical(engine.sums, sums_of(y[: at + 500]))
    engine.end_segment()
    assert_identical(engine.sums, sums_of(y))


def test_no_difference_crosses_the_border_of_a_segment():
    y = np.random.default_rng(4).normal(size=(3000, 1))
    stepped = y.copy()
    stepped[1000:] += 1e3
    whole, cut = sums_of(y, cuts=[1000]), sums_of(stepped, cuts=[1000])
    assert np.array_equal(whole.count, cut.count)
    assert cut.avar == pytest.approx(whole.avar, rel=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.integers(40, 2500), st.floats(-1e3, 1e3), st.floats(1e-3, 1e3), st.integers(0, 999))
def test_sums_follow_an_offset_a_factor_and_a_permutation_of_axes(n, offset, factor, seed):
    y = np.random.default_rng(seed).normal(size=(n, 3))
    plain = sums_of(y).avar
    assert sums_of(y + offset).avar == pytest.approx(plain, rel=1e-6, abs=1e-12)
    assert sums_of(y * factor).avar == pytest.approx(plain * factor**2, rel=1e-9)
    assert np.array_equal(sums_of(y[:, [2, 0, 1]]).avar, plain[:, [2, 0, 1]])


def test_phase_record_is_the_phase_and_stays_small():
    y = np.random.default_rng(6).normal(size=(5000, 2))
    theta = np.concatenate([np.zeros((1, 2)), np.cumsum(y - y[0], axis=0)])
    for n in (1, 2, 127, 128, 129, 2048, 5000):
        record = sums_of(y[:n]).segments[0]
        expected = theta[: n + 1 : record.phase_step]
        assert 64 < len(record.phase) <= 128 or record.phase_step == 1
        assert record.phase == pytest.approx(expected, abs=1e-10)


def test_pure_ramp_has_its_known_variance():
    """V(m) = r^2 m^2 / 2 exactly, and the coarse phase record contains r."""
    r = 0.25
    sums = sums_of(r * np.arange(4000.0)[:, None])
    assert sums.avar[:, 0] == pytest.approx(0.5 * (r * sums.m) ** 2, rel=1e-12)
    assert sums.segments[0].ols_ramp() == pytest.approx([r], rel=1e-12)


def test_grid_is_four_to_an_octave_up_to_half_the_record():
    m, stride = grid_for(720_000)
    assert m[:9].tolist() == [1, 2, 3, 4, 6, 8, 10, 12, 14]
    assert 2 * m[-1] <= 720_000 < 2.5 * m[-1]
    assert np.all(np.diff(m) > 0) and np.all(m % stride == 0)
    assert np.all(counts(720_000, m, stride) >= 1)
