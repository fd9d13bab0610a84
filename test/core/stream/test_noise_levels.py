# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which noise levels are counted as discarded, and the time before the published level."""

from functools import partial

import numpy as np
import pytest

from allan_ros.core.imu import AXES, ImuBatch, ImuIdentity
from allan_ros.core.stream.noise_levels import NoiseLevel, NoiseLevels


@pytest.fixture
def levels():
    return NoiseLevels(partial(NoiseLevel, ImuIdentity(), AXES))


def add_samples(levels, start_s):
    """Add 100 samples at 100 Hz to the present level; the first stamp is ``start_s`` seconds."""
    rows = np.random.default_rng(0).normal(size=(6, 100))
    levels.present.add(ImuBatch.of_rows(start_s * 10**9 + np.arange(100) * 10**7, rows))


def try_another(levels):
    levels.try_another(levels.present.floor, 'noise_increased', 0)


def test_replacing_a_level_without_samples_does_not_change_the_time_of_the_discarded_data(levels):
    add_samples(levels, 1000)
    for _ in range(2):
        levels.replace_present(None, 'moving')
        assert levels.lost_s == pytest.approx(0.99)


@pytest.mark.parametrize('is_tried', [False, True])
def test_a_first_level_without_samples_was_not_the_result(levels, is_tried):
    if is_tried:
        try_another(levels)
        levels.accept()
    else:
        levels.replace_present(None, 'moving')
    add_samples(levels, 1000)
    assert (levels.lost, levels.lost_s) == (0, 0.0)


def test_the_discarded_time_is_known_before_the_accepted_level_has_samples(levels):
    for start_s in (1000, 1020):
        add_samples(levels, start_s)
        try_another(levels)
        levels.accept()
    assert levels.lost == 1 and levels.lost_s == pytest.approx(0.99)
    add_samples(levels, 1040)
    assert levels.lost == 2 and levels.lost_s == 40.0


def test_a_level_is_discarded_data_also_if_the_next_level_never_had_samples(levels):
    add_samples(levels, 1000)
    for _ in range(2):
        try_another(levels)
        levels.accept()
    assert levels.lost == 1 and levels.lost_s == pytest.approx(0.99)


def test_a_level_with_negative_stamps_is_counted_when_the_later_level_has_samples(levels):
    add_samples(levels, -1000)
    try_another(levels)
    levels.accept()
    assert levels.lost == 0
    add_samples(levels, -100)
    assert levels.lost == 1


def test_the_discarded_time_begins_with_the_first_level_that_had_samples(levels):
    try_another(levels)
    add_samples(levels, 1000)
    levels.accept()
    levels.resume()
    add_samples(levels, 1020)
    assert levels.lost == 1 and levels.lost_s == 20.0
    try_another(levels)
    assert levels.lost == 1 and levels.lost_s == 20.0
