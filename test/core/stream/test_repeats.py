# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The interpolation of repeated samples, and the statistic that separates their two causes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allan_ros.core.stream.sensors import LONGEST_REPEAT, RepeatFilter, _line_variance
from allan_ros.core.stream.timing import Block


def filtered(rows, groups, lengths):
    """Return the rows and the flags of interpolated values, fed in chunks of the given lengths."""
    repeats, blocks, at = RepeatFilter(groups, len(rows)), [], 0
    stamps = np.arange(rows.shape[1])
    for length in [*lengths, rows.shape[1]]:
        part = slice(at, at + length)
        blocks += repeats.feed([Block(stamps[part], rows[:, part])])
        at += length
        # what is not returned yet is buffered: the last new sample and the repeats after it
        assert min(at, rows.shape[1]) - sum(map(len, blocks)) <= LONGEST_REPEAT + 1
    joined = Block.joined(blocks + repeats.flush())
    assert (joined.stamps == stamps).all()
    filled = np.zeros(rows.shape, bool) if joined.filled is None else joined.filled
    return joined.rows, filled


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
