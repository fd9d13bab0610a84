# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counts of samples whose fate changes with the noise floor."""

from hypothesis import given
from hypothesis import strategies as st

from allan_ros.core.stream.floor_counts import FloorCounts
from allan_ros.core.stream.health import Counts

FATES = ('used', 'moving', 'stuck', 'noise_decreased', 'noise_increased')


def total(counts):
    return sum(getattr(counts, fate) for fate in FATES)


@given(
    st.lists(st.tuples(st.sampled_from(FATES), st.integers(1, 50)), max_size=20),
    st.sampled_from(['noise_decreased', 'noise_increased']),
)
def test_no_sample_is_lost_when_sums_are_set_aside_and_continued_or_discarded(added, excluded):
    for ends in (['resume'], ['accept'], ['discard'], ['accept', 'resume', 'resume']):
        counts = FloorCounts(Counts())
        counts.add('used', 100)
        counts.add('shocks', 3)
        counts.set_aside(excluded)
        for fate, number in added:
            counts.add(fate, number)
        passed = sum(number for fate, number in added if fate == 'used')
        assert counts.total.used == 100 and counts.lasts_longer == (passed > 100)
        for end in ends:
            counts.discard('moving') if end == 'discard' else getattr(counts, end)()
        assert total(counts.total) == 100 + sum(number for _, number in added)
        present = ends[0] == 'accept'
        assert counts.total.used == (passed if present else 100)
        assert counts.total.shocks == (0 if present else 3)


def test_the_counts_of_an_earlier_floor_return_with_it():
    counts = FloorCounts(Counts())
    counts.add('used', 10)
    counts.set_aside('noise_increased')
    counts.add('used', 20)
    counts.accept()
    assert (counts.total.used, counts.total.moving) == (20, 10)
    counts.resume()
    assert (counts.total.used, counts.total.noise_increased, counts.total.moving) == (10, 20, 0)


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
