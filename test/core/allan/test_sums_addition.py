# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums of recordings of one IMU are added sensor by sensor; others are rejected."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from allan_ros.core.allan.engine import RunningAllan
from allan_ros.core.allan.sums import AllanSums, add_sums
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import AXES, ImuIdentity
from allan_ros.io.recorded import RecordingSums, add_recordings


def sums(seed: int, axes: tuple[str, ...] = AXES, frame: str = 'imu', start: int = 0) -> AllanSums:
    running = RunningAllan(ImuIdentity(frame), axes)
    noise = np.random.default_rng(seed).normal(size=(500, len(axes)))
    running.update(noise, start, start + 499 * 10**7)
    running.end_segment()
    return running.sums


def test_sums_of_the_same_sensor_are_added():
    a, b = [(sums(i, AXES[:3]), sums(i + 10, AXES[3:])) for i in (1, 2)]
    total = add_sums(a, b)
    for mine, x, y in zip(total, a, b):
        assert np.array_equal(mine.sum_sq, (x + y).sum_sq)
        assert mine.samples == 1000
    assert a[0].samples == 500


def test_a_recording_without_samples_adds_nothing():
    a = (sums(1),)
    assert add_sums(a, ()) == a and add_sums((), a) == a and add_sums((), ()) == ()


def test_other_sensors_and_other_imus_are_rejected():
    with pytest.raises(AllanError, match='the sensors differ'):
        add_sums((sums(1),), (sums(1, AXES[:3]),))
    with pytest.raises(AllanError, match='different IMUs'):
        add_sums((sums(1),), (sums(1, frame='other'),))


def test_recordings_added_in_any_order_give_the_same_sums_bit_for_bit():
    recordings = [RecordingSums(str(i), (sums(i, start=i * 10**12),)) for i in range(3)]
    first, *others = (add_recordings(order).sums for order in permutations(recordings))
    assert all(other == first for other in others)


def test_sums_added_in_any_order_agree_to_rounding():
    a, b, c = (sums(i, start=i * 10**12) for i in range(3))
    assert ((c + b) + a).sum_sq == pytest.approx((a + (b + c)).sum_sq, rel=1e-12)
