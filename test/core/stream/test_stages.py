# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Single stages: repeated time, repeated samples, two IMUs, and means over a second."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from allan_ros.core.imu import ImuBatch, joined
from allan_ros.core.stream.cleaning import (
    LONGEST_REPEAT,
    MOST_COVERED,
    NEAR_NS,
    CoveredTime,
    RepeatFilter,
)
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.core.stream.sensor_stream import KEPT_MEANS, RunningMeans
from allan_ros.core.stream.sensors import _line_variance, are_interleaved


def batch(stamps):
    stamps = np.asarray(stamps, np.int64)
    return ImuBatch(stamps, np.repeat(stamps[:, None], 6, axis=1).astype(float), frame_id='imu')


def new_times(stamps, chunk, covered=()):
    time = CoveredTime(covered)
    pieces = [batch(stamps[i : i + chunk]) for i in range(0, len(stamps), chunk)]
    found = [stamp for piece in pieces for stamp in time.feed(piece).stamps_ns.tolist()]
    assert len(found) + time.dropped == len(stamps)
    return found


@pytest.mark.parametrize('chunk', [1, 7, 100, 1000])
def test_a_time_is_counted_once(chunk):
    once = list(range(100))
    assert new_times([*once * 3, *range(50, 150)], chunk) == list(range(150))
    assert new_times(once, chunk, covered=[(-5, 9)]) == once[10:]


@pytest.mark.parametrize('chunk', [1, 7, 1000])
def test_the_time_of_a_gap_is_not_covered(chunk):
    """One recording after the other, the later one first; and a single wrong stamp."""
    late, early = range(5 * NEAR_NS, 5 * NEAR_NS + 50), range(50)
    assert new_times([*late, *early, *late], chunk) == [*late, *early]
    assert new_times([*early, 10**12, *range(50, 90)], chunk) == [*early, 10**12, *range(50, 90)]


def test_only_the_latest_covered_stretches_are_stored():
    covered = [(i * 10**11, i * 10**11 + 9) for i in range(MOST_COVERED + 1)]
    assert new_times([0, 5, 3 * 10**11 + 5], 2, covered) == [0, 5]


def test_equal_stamps_are_kept():
    assert new_times([0, 0, 1, 1], 2) == [0, 0, 1, 1]


@pytest.mark.parametrize('chunk', [1, 2, 3])
def test_a_covered_stretch_inside_another_does_not_end_it(chunk):
    early = [0, NEAR_NS // 2, NEAR_NS]
    covered = [(NEAR_NS // 4, NEAR_NS // 4 + 1)]  # between two samples
    again = [NEAR_NS // 4, NEAR_NS // 2, NEAR_NS]
    assert new_times([*early, *again], chunk, covered) == early


@given(st.lists(st.integers(0, 40), max_size=120), st.integers(1, 50))
@example([1, 2, 0, 2], 1)  # a step over the begin of a covered stretch
def test_new_times_do_not_depend_on_chunks(steps, chunk):
    stamps = [step * NEAR_NS // 4 for step in steps]
    assert new_times(stamps, chunk) == new_times(stamps, max(len(stamps), 1))


def filtered(rows, groups, lengths):
    """Return the rows and the flags of interpolated values, fed in chunks of the given lengths."""
    repeats, blocks, at = RepeatFilter(groups, len(rows)), [], 0
    stamps = np.arange(rows.shape[1])
    for length in [*lengths, rows.shape[1]]:
        part = slice(at, at + length)
        blocks += repeats.feed([ImuBatch.of_rows(stamps[part], rows[:, part])])
        at += length
        # what is not returned yet is buffered
        assert min(at, rows.shape[1]) - sum(map(len, blocks)) <= LONGEST_REPEAT
    whole = joined(blocks + repeats.flush())
    assert (whole.stamps_ns == stamps).all()
    filled = np.zeros(rows.shape, bool) if whole.filled is None else whole.filled
    return whole.rows, filled


@given(
    flags=st.lists(st.booleans(), min_size=1, max_size=80),
    lengths=st.lists(st.integers(1, 20), max_size=20),
)
def test_repeats_of_a_straight_line_are_restored_for_any_chunking(flags, lengths):
    flags = np.array([False, *flags, False])
    new = np.maximum.accumulate(np.where(flags, 0, np.arange(len(flags))))
    line = 2.0 * np.arange(len(flags))
    next_new = np.minimum.accumulate(np.where(flags, len(flags), np.arange(len(flags)))[::-1])[::-1]
    short = flags & (next_new - new - 1 <= LONGEST_REPEAT)
    rows, filled = filtered(line[None, new], [[0]], lengths)
    assert rows[0] == pytest.approx(np.where(short, line, line[new]))
    assert (filled[0] == short).all()


def test_a_sample_is_repeated_only_if_all_axes_of_its_group_are_equal():
    rows = np.array([[0.0, 0.0, 2.0], [1.0, 3.0, 5.0], [4.0, 4.0, 8.0]])
    values, filled = filtered(rows, [[0, 1], [2]], [])
    assert values.tolist() == [[0.0, 0.0, 2.0], [1.0, 3.0, 5.0], [4.0, 6.0, 8.0]]
    assert filled.sum() == 1 and filled[2, 1]


@pytest.mark.parametrize('share', [0.05, 0.3])
def test_the_variance_about_a_line_of_random_flags_is_that_of_watson(share):
    flags = np.random.default_rng(0).random((4000, 1024)) < share
    binomial = 1024 * flags.mean(axis=1) * (1.0 - flags.mean(axis=1))
    ratio = np.array([_line_variance(one) for one in flags]) / binomial
    # U^2 has a standard deviation of 360**-0.5; 5 sigma of the mean of 4000: false alarm 6e-7
    assert ratio.mean() == pytest.approx(1.0 / 12.0, abs=5.0 * (360 * 4000) ** -0.5)
    assert _line_variance(np.arange(1024) % 4 == 0) < 0.5


STEP_NS = 10_000_000


@pytest.mark.parametrize('chunk', [1, 7, 100, 15_000])
def test_the_latest_means_of_complete_seconds_are_kept_for_any_chunking(chunk):
    stamps, rows = STEP_NS * np.arange(15_000), np.random.default_rng(1).normal(size=(2, 15_000))
    running, whole = RunningMeans(('gyro_x', 'gyro_y')), RunningMeans(('gyro_x', 'gyro_y'))
    for at in range(0, 15_000, chunk):
        running.update(stamps[at : at + chunk], rows[:, at : at + chunk])
    whole.update(stamps, rows)
    means = running.means
    assert np.array_equal(means.values, whole.means.values)
    # the last second is not complete
    expected = rows.reshape(2, 150, 100).mean(axis=2).T[-KEPT_MEANS - 1 : -1]
    np.testing.assert_allclose(means.values, expected)
    assert means.end_ns.tolist() == [10**9 * i for i in range(150 - KEPT_MEANS, 150)]


def test_a_gap_drops_the_mean_in_progress():
    rows = np.random.default_rng(1).normal(size=(2, 250))
    running = RunningMeans(('gyro_x', 'gyro_y'))
    running.update(STEP_NS * np.arange(150), rows[:, :150])
    running.cut()
    running.update(50 * 10**9 + STEP_NS * np.arange(250), rows)
    assert running.means.end_ns.tolist() == [10**9, 51 * 10**9, 52 * 10**9]
    np.testing.assert_allclose(running.means.values[1], rows[:, :100].mean(axis=1))


def test_a_stream_has_means_of_static_samples_only() -> None:
    rng = np.random.default_rng(2)
    count = 60_00
    values = rng.normal(0.5, 0.01, size=(count, 6))
    values[3000:3500, :3] += rng.normal(0.0, 1.0, size=(500, 3))  # 5 s of motion
    stream = ImuStream(with_means=True)
    stream.update(ImuBatch(10**18 + STEP_NS * np.arange(count), values))
    (means,) = stream.means()
    assert means.axes[0] == 'gyro_x'
    seconds = (means.end_ns - 10**18) * 1e-9
    assert not np.any((seconds > 30.5) & (seconds < 35.0))
    assert len(seconds) > 40
    np.testing.assert_allclose(means.values, 0.5, atol=0.01)


@pytest.mark.parametrize('step', [0.5, 1.0, 2.0, 3.0, 4.0, 6.0])
@pytest.mark.parametrize('mean', [0.0, 0.25, 0.5])
def test_coarse_samples_are_not_those_of_two_imus(step, mean):
    noise = np.random.default_rng(1).standard_normal((6, 2000))
    of_two = noise + 30.0 * (np.random.default_rng(2).random(2000) < 0.5)
    assert not are_interleaved(np.round(noise / step + mean) * step)
    assert are_interleaved(np.round(of_two / step + mean) * step)


@pytest.mark.parametrize('mean', [0.25, 0.5])
def test_a_pulse_counter_with_carry_is_not_two_imus(mean):
    jitter = 1e-3 * np.random.default_rng(1).standard_normal((6, 2000))
    counts = np.diff(np.floor(mean * np.arange(2001) + 0.1 + np.pad(jitter, ((0, 0), (1, 0)))))
    assert not are_interleaved(counts)
