# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Running sums: equal for any chunking, and equal to their definition."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.allan_table import allan_table, grid_for
from support.sums import TICK_NS, feed, noise, sums_of

from allan_ros.core.allan.cascade import BLOCK, FIRST_BLOCK, FIRST_PART
from allan_ros.core.allan.grid import counts, octave, overlap, tapers
from allan_ros.core.allan.periods import MAX_MEANS, MAX_PERIODS, totals
from allan_ros.core.allan.running import RunningSums
from allan_ros.core.imu import ImuIdentity


@pytest.mark.parametrize('n', [1, 2, 3, 16, 17, 56, 2047, 2048, 2049, 4096, 4097, 50_000])
def test_allan_sums_equal_the_definition(n):
    y = noise(n, n, 3)
    sums = sums_of(y)
    m, stride = grid_for(n)
    table, groups = allan_table(y, m, stride), allan_table(y, m, m)
    assert np.array_equal(sums.m, m) and np.array_equal(sums.stride, stride)
    assert np.array_equal(sums.count, table.n)
    assert np.array_equal(sums.group_count, groups.n)
    assert sums.avar == pytest.approx(table.avar, rel=1e-10)
    assert sums.group_avar == pytest.approx(groups.avar, rel=1e-10)
    assert sums.tau0 == (0.01 if n > 1 else None)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 5 * BLOCK),
    st.lists(st.integers(1, 2 * BLOCK), min_size=1, max_size=5),
    st.lists(st.integers(1, 5 * BLOCK), max_size=3),
    st.integers(0, 2**32 - 1),
)
def test_any_chunking_gives_the_same_sums(n, chunks, cuts, seed):
    y = noise(n, seed)
    mask = np.random.default_rng(seed).random(n) < 0.02
    cuts = {c for c in cuts if c < n}
    assert sums_of(y, None, cuts, interpolated=mask) == sums_of(y, chunks, cuts, interpolated=mask)


def test_reading_the_sums_does_not_change_them():
    y = noise(9 * BLOCK)
    running = RunningSums(ImuIdentity('imu'), ('axis_0', 'axis_1'))
    for at in range(0, len(y), 1000):
        feed(running, y[at : at + 1000], first=at)
        assert running.sums == sums_of(y[: at + 1000])
    running.end_segment()
    assert running.sums == sums_of(y)


@pytest.mark.parametrize('cuts', [[], [5000], [*range(700, 100_000, 701)]])
def test_periods_add_up_to_the_whole(cuts):
    y = noise(100_000)
    sums = sums_of(y, cuts=cuts)
    periods = sums.periods
    assert 12 < len(periods) <= MAX_PERIODS
    assert [p.end for p in periods] == [*(p.begin for p in periods[1:]), len(y)]
    assert np.array_equal(totals(p.count for p in periods), sums.count)
    assert totals(p.sum_sq for p in periods) == pytest.approx(sums.sum_sq, rel=1e-5)
    assert [p.begin_ns for p in periods] == [p.begin * TICK_NS for p in periods]
    reference = sums.recordings[0].reference
    for p in periods:
        expected = (y[p.begin : p.end] - reference).sum(axis=0)
        assert p.total == pytest.approx(expected, rel=1e-9, abs=1e-6)
    lengths = np.diff([0, *cuts, len(y)])
    assert sums.samples == len(y) and sums.segment_count == len(lengths)
    assert sums.intervals == len(y) - len(lengths)
    m, stride = sums.m, sums.stride
    assert np.array_equal(sums.count, sum(counts(n, m, stride) for n in lengths))


def test_periods_are_short_at_both_ends_at_any_length():
    for n in (500_000, 1_000_000):
        lengths = np.array([p.samples for p in sums_of(np.zeros((n, 1))).periods])
        assert lengths[0] == FIRST_BLOCK and lengths[-1] <= FIRST_PART
        ends = np.cumsum(lengths)
        distance = np.minimum(ends, n - ends + lengths)
        far = distance > 8 * FIRST_PART
        assert far.sum() > 8 and np.all(lengths[far] <= 0.5 * distance[far])


def test_means_are_the_means_of_the_samples():
    y = noise(300_000)
    cuts = [4000, 5000, 5003, 200_000]
    sums = sums_of(y, cuts=cuts)
    (recording,) = sums.recordings
    assert recording.mean == pytest.approx(y.mean(axis=0), rel=1e-12)
    kept = [(0, 4000), (5003, 194_997), (200_000, 100_000)]
    assert [(m.age, m.samples) for m in recording.means] == kept
    assert len({m.step for m in recording.means}) == 1
    assert 256 < sum(len(m.values) for m in recording.means) <= MAX_MEANS
    for m in recording.means:
        assert len(m.values) == m.samples // m.step and m.start_ns == m.age * TICK_NS
        used = y[m.age : m.age + len(m.values) * m.step]
        expected = used.reshape(-1, m.step, 2).mean(axis=1) - recording.reference
        assert m.values == pytest.approx(expected, rel=1e-8, abs=1e-8)


def block_powers(y, o):
    """Return the power of each block of octave o, (blocks, bins, axes), from the definition."""
    step, size, bins = octave(o)
    means = y[: len(y) // step * step].reshape(-1, step, y.shape[1]).mean(axis=1)
    blocks = [means[a : a + size] for a in range(0, len(means) - size + 1, size // 2)]
    return np.array([np.abs(tapers(size, bins) @ b) ** 2 for b in blocks])


@pytest.mark.parametrize('n', [64, 1000, 2048, 70_000])
def test_spectra_equal_the_definition(n):
    y = noise(n, n)
    (recording,) = sums_of(y).recordings
    power, blocks, pairs = (
        totals(getattr(p, key) for p in recording.periods) for key in ('power', 'blocks', 'pairs')
    )
    row = 0
    for o in range(len(blocks)):
        expected = block_powers(y, o)
        assert blocks[o] == len(expected) and pairs[o] == len(expected) - 1
        found = power[row : row + expected.shape[1]]
        assert found == pytest.approx(expected.sum(axis=0), rel=1e-5)
        row += expected.shape[1]
    assert row == len(power) and octave(len(blocks)).length > n


def test_blocks_with_many_interpolated_samples_are_excluded():
    """Of a block that is used, at most three quarters are interpolated."""
    y = noise(70_000)
    mask = np.random.default_rng(1).random(len(y)) < 0.0005
    for begin, length in ((3000, 7), (9000, 60), (30_000, 130), (50_000, 3000)):
        mask[begin : begin + length] = True
    sums = sums_of(y, [999], interpolated=mask)
    assert np.array_equal(sums.sum_sq, sums_of(y).sum_sq)
    assert sum(p.interpolated for p in sums.periods) == mask.sum()
    power = totals(p.power for p in sums.periods)
    blocks, pairs = (totals(getattr(p, k) for p in sums.periods) for k in ('blocks', 'pairs'))
    row = 0
    for o in range(len(blocks)):
        step, size, bins = octave(o)
        length = step * size
        share = [mask[a : a + length].mean() for a in range(0, len(y) - length + 1, length // 2)]
        used = np.array(share) <= 0.75
        assert blocks[o] == used.sum() and pairs[o] == (used[1:] & used[:-1]).sum()
        expected = block_powers(y, o)[used].sum(axis=0)
        assert power[row : row + len(bins)] == pytest.approx(expected, rel=1e-5)
        row += len(bins)
    assert blocks[0] < len(y) // 32 - 80


@pytest.mark.parametrize('o', [0, 3, 5])
def test_covariances_of_the_powers_are_those_of_white_noise(o):
    step, size, bins = octave(o)
    y = np.random.default_rng(o).normal(size=(2000 * size, 1))
    means = np.repeat(y, step, axis=0)  # white noise of the means
    power = block_powers(means, o)[..., 0]
    same, near = overlap(o)
    k = int(np.argmax(same))
    deviations = power - 1.0
    one = deviations[:, bins.index(k + 1)]
    assert power.mean() == pytest.approx(1.0, rel=0.01)
    for j, b in enumerate(bins):
        other = deviations[:, j]
        assert (one * other).mean() == pytest.approx(same[b - 1], abs=0.12)
        late = (one[1:] * other[:-1]).mean() + (one[:-1] * other[1:]).mean()
        assert late == pytest.approx(near[b - 1], abs=0.12)
