# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counts of samples whose fate changes with the noise floor."""

from hypothesis import given
from hypothesis import strategies as st

from allan_ros.core.stream.floor_counts import FloorCounts
from allan_ros.core.stream.health import Counts

FATES = ('used', 'moving', 'stuck', 'noise_decreased')


def total(counts):
    return sum(getattr(counts, fate) for fate in FATES)


@given(st.lists(st.tuples(st.sampled_from(FATES), st.integers(1, 50)), max_size=20))
def test_no_sample_is_lost_when_sums_are_set_aside_and_continued_or_discarded(added):
    for end in ('resume', 'accept', 'discard'):
        counts = FloorCounts(Counts())
        counts.add('used', 100)
        counts.set_aside()
        for fate, number in added:
            counts.add(fate, number)
        passed = sum(number for fate, number in added if fate == 'used')
        assert counts.total.used == 100 and counts.lasts_longer == (passed > 100)
        counts.discard('moving') if end == 'discard' else getattr(counts, end)()
        assert total(counts.total) == 100 + sum(number for _, number in added)
        assert counts.total.used == (passed if end == 'accept' else 100)


def test_a_block_that_is_classified_again_is_counted_once():
    counts = FloorCounts(Counts())
    counts.add('used', 90)
    counts.begin_block(10)  # of the block before
    counts.add('used', 30)
    counts.add('stuck', 40)
    counts.add('shocks', 1)
    counts.remove_block()
    assert (counts.total.used, counts.total.stuck, counts.total.shocks) == (100, 0, 0)
    counts.add('moving', 60)
    assert total(counts.total) == 160
