# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The expected table of pooled segments, compared with the tables of the single segments."""

import gc
from collections import Counter

import numpy as np
import pytest

from allan_ros.core.allan.sums import LENGTH_CLASS_RATIO, LengthClass, counts, grid_for
from allan_ros.core.fit.model import avar_terms
from allan_ros.core.fit.ramp import least_squares_effect, pooled_shift, ramp_geometry
from allan_ros.core.fit.table import PooledTable

POWER = np.array([0.0, 1.0, 0.01, 1e-4])
"""A random walk that dominates from 100 samples on."""


def draw(kind):
    rng = np.random.default_rng(7)
    return {
        'cut at random': rng.exponential(300.0, 200).astype(int) + 2,
        'all alike': np.full(300, 545),
        'nearly alike': rng.normal(640.0, 10.0, 100).astype(int),
        'two kinds': np.repeat([600, 1500], [200, 100]),
        'single': np.array([90, 333, 700, 1111]),
        'of no use': np.array([1, 2, 3]),
    }[kind]


def classes_of(lengths):
    index = [int(np.log(n) / np.log(LENGTH_CLASS_RATIO)) for n in lengths]
    total = Counter()
    for i, n in zip(index, lengths):
        total[i] += int(n)
    none = np.zeros((0, 1))
    return [LengthClass(i, number, total[i], none) for i, number in Counter(index).items()]


def one_by_one(lengths, m, stride):
    """Return the sums over all differences, (factors, 4), and their number."""
    shift, number = np.zeros((len(m), 4)), np.zeros(len(m), np.int64)
    for n in lengths:
        effect, count = least_squares_effect(int(n)), counts(int(n), m, stride)
        number += count
        if effect is not None:
            own = ramp_geometry(int(n)).m
            shift[: len(own)] += count[: len(own), None] * effect.shift(own)
    return shift, number


@pytest.mark.parametrize(
    ('kind', 'allowed'),
    [
        ('cut at random', 0.02),
        ('all alike', 1e-9),
        ('nearly alike', 0.03),
        ('two kinds', 0.02),
        ('single', 1e-9),
        ('of no use', 1e-9),
    ],
)
def test_the_expectation_of_pooled_segments_is_that_of_single_ones(kind, allowed):
    lengths = draw(kind)
    m, stride = grid_for(int(lengths.max()))
    want, number = one_by_one(lengths, m, stride)
    got = pooled_shift(classes_of(lengths), m, stride, number)
    seen = number > 0
    each = ((got - want)[seen] @ POWER) / number[seen]
    left = avar_terms(m[seen]) @ POWER + (want[seen] @ POWER) / number[seen]
    assert np.max(np.abs(each) / left) <= allowed


def test_the_tables_of_a_fit_are_not_in_a_reference_cycle(small_run) -> None:
    """A cycle would keep some MB until the garbage collector runs, so the memory of a node would
    grow.
    """
    sums, _ = small_run
    gc.collect()
    gc.disable()
    try:
        PooledTable(sums)
        assert gc.collect() == 0
    finally:
        gc.enable()
