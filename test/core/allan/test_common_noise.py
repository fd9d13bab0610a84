# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Common and own noise of sensors on one body: alignment, coherence and three-cornered hat."""

from __future__ import annotations

import numpy as np
import pytest

from allan_ros.core.allan.common_noise import (
    CommonNoise,
    Samples,
    aligned,
    common_noise,
    common_of_axes,
)
from allan_ros.core.errors import AllanError

RATE = 100.0
OWN = np.array([1.0e-3, 1.2e-3, 0.8e-3, 1.1e-3])
"""N of each sensor."""


def sensors(
    rng: np.random.Generator, n: int, number: int = 3, common: float = 0.0
) -> list[Samples]:
    """Return white noise with N of `OWN`, and common white noise; each clock has its own offset."""
    shared = common * np.sqrt(RATE) * rng.normal(size=n)
    stamps = np.arange(n) * 10_000_000
    found = []
    for i in range(number):
        own = OWN[i] * np.sqrt(RATE) * rng.normal(size=n)
        found.append(Samples(stamps + 300_000 * i, own + shared))
    return found


def of(rows: list[CommonNoise]) -> list[float]:
    return [row.own.value or 0.0 for row in rows if row.own]


@pytest.mark.parametrize('number', [3, 4])
def test_the_own_noise_below_three_times_as_much_vibration(number: int) -> None:
    rng = np.random.default_rng(1)
    rows = common_noise('gyro_x', sensors(rng, 100_000, number, common=3e-3), 'abcd'[:number])
    for row, true in zip(rows, OWN):
        assert row.own is not None and row.own.value == pytest.approx(true, rel=0.05)
        assert row.measured is not None
        assert row.measured.value == pytest.approx(np.hypot(true, 3e-3), rel=0.05)
        assert (row.coherence.low[:20] > 0.8).all()


def test_two_sensors_have_the_mean_of_both() -> None:
    rows = common_noise('gyro_x', sensors(np.random.default_rng(2), 60_000, 2, 3e-3), 'ab')
    assert of(rows) == pytest.approx([np.sqrt((OWN[:2] ** 2).mean())] * 2, rel=0.05)


def test_the_interval_of_the_own_noise_covers_the_truth() -> None:
    rng, inside = np.random.default_rng(3), []
    for _ in range(30):
        for row, true in zip(common_noise('gyro_x', sensors(rng, 6000, 3, 3e-3), 'abc'), OWN):
            assert row.own is not None and row.own.ci95 is not None
            inside.append(row.own.ci95[0] <= true <= row.own.ci95[1])
    assert 0.91 <= np.mean(inside) <= 0.99


def test_the_coherence_of_independent_sensors_covers_zero() -> None:
    rng, covered = np.random.default_rng(4), []
    for _ in range(80):
        first, second, third = sensors(rng, 2048)
        streams = [Samples(first.stamps, one.values) for one in (first, second, third)]
        for row in common_of_axes(('gyro_x', 'gyro_y', 'gyro_z'), streams, 'a'):
            covered.append((row.coherence.low <= 0.0) & (row.coherence.high >= 0.0))
    assert 0.93 <= np.mean(covered) <= 0.97
    assert (np.mean(covered, axis=0) > 0.9).all()


def test_an_own_noise_that_is_not_resolved_has_a_limit() -> None:
    """A sensor without own noise, among noisy ones."""
    rng = np.random.default_rng(5)
    stamps, shared = sensors(rng, 20_000, 1)[0]
    noisy = [shared + rng.normal(scale=0.02, size=20_000) for _ in range(2)]
    rows = common_noise('gyro_x', [Samples(stamps, v) for v in (shared, *noisy)], 'abc')
    assert rows[0].own is not None and rows[0].own.value is None
    assert 0.0 < (rows[0].own.upper95 or 0.0) < 1e-3
    assert of(rows[1:]) == pytest.approx([2e-3] * 2, rel=0.05)


def test_stamps_that_differ_by_half_a_period_do_not_change_the_own_noise() -> None:
    """A vibration sampled at other times adds quantization noise to the differences, not N."""
    rng, n = np.random.default_rng(6), 60_000
    vibration = rng.normal(scale=0.03, size=n + 1)
    known = []
    for i, late in enumerate((0.0, 0.25, 0.5)):
        mean = (1.0 - late) * vibration[:n] + late * vibration[1:]
        own = OWN[i] * np.sqrt(RATE) * rng.normal(size=n)
        known.append(Samples(np.arange(n) * 10_000_000 + round(late * 1e7), mean + own))
    assert of(common_noise('gyro_x', known, 'abc')) == pytest.approx(OWN[:3], rel=0.1)


def test_the_samples_nearest_in_time_are_used_without_gaps() -> None:
    stamps = np.arange(1000) * 10_000_000
    first = Samples(stamps, np.arange(1000.0))
    keep = np.r_[0:300, 400:1000]  # a gap
    late = Samples(stamps[keep] + 4_000_000, np.arange(1000.0)[keep])
    short = Samples(stamps[50:] - 4_000_000, np.arange(1000.0)[50:])
    parts = aligned([first, late, short])
    assert [len(part.stamps) for part in parts] == [252, 600]
    for part in parts:
        difference = part.values - part.values[0]
        assert np.abs(difference).max() <= 1.0  # at the edges
        assert (difference[:, 1:-1] == 0.0).all()


def test_gaps_are_not_bridged() -> None:
    """A jump of the mean across a gap must not appear in the noise."""
    known = sensors(np.random.default_rng(7), 60_000, 3)
    keep = np.r_[0:25_000, 26_000:60_000]
    jumped = [Samples(s.stamps[keep], s.values[keep] + 5.0 * (keep > 25_500)) for s in known]
    assert of(common_noise('gyro_x', jumped, 'abc')) == pytest.approx(OWN[:3], rel=0.05)


def test_other_rates_and_times_are_rejected() -> None:
    rng = np.random.default_rng(8)
    first, second = sensors(rng, 4000, 2)
    with pytest.raises(AllanError, match=r'the rates differ \(100, 50 Hz\)'):
        common_noise('gyro_x', [first, Samples(second.stamps * 2, second.values)], 'ab')
    with pytest.raises(AllanError, match='too little time in common'):
        common_noise('gyro_x', [first, Samples(second.stamps + 10**12, second.values)], 'ab')


def test_constant_samples_have_no_own_noise() -> None:
    known = [Samples(s.stamps, s.values * 0.0) for s in sensors(np.random.default_rng(9), 4000)]
    for row in common_noise('gyro_x', known, 'abc'):
        assert row.own is None and row.measured is None
        assert np.isnan(row.coherence.value).all()
