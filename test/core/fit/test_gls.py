# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from allan_ros.core.allan.engine import RunningAllan
from allan_ros.core.fit.gls import fit_gls
from allan_ros.core.fit.model import TERMS
from allan_ros.core.imu import from_datasheet
from allan_ros.core.simulate import NoiseTerms, simulate_axis

TAU0 = 0.01


def sums_of(*segments, axes=('gyro_x',)):
    engine = RunningAllan(axes=axes)
    start = 0
    for y in segments:
        rows = np.reshape(y, (len(y), -1))
        engine.update(rows, start, start + round((len(rows) - 1) * TAU0 * 1e9))
        engine.end_segment()
        start += round(2 * len(rows) * TAU0 * 1e9)
    return engine.sums


def noise_of(sums):
    return fit_gls(sums).axes[sums.axes[0]].noise


def numbers(coefficient):
    return (coefficient.value, coefficient.upper95, *(coefficient.ci95 or ()))


def same(noise, other, factor=1.0):
    """Return whether the second noise is ``factor`` times the first, to rounding, with equal
    verdicts.
    """
    return all(
        a.status == b.status
        and [x is None for x in numbers(a)] == [x is None for x in numbers(b)]
        and all(
            x is None or y == pytest.approx(factor * x, rel=1e-4)
            for x, y in zip(numbers(a), numbers(b))
        )
        for a, b in ((noise[term], other[term]) for term in noise)
    )


@pytest.mark.parametrize(
    'samples',
    [
        [],
        [np.zeros(1)],
        [np.arange(2.0)],
        [np.zeros(1000)],
        [np.arange(1000.0)],
        [np.random.default_rng(1).normal(size=10)],
        [np.random.default_rng(1).normal(size=3)] * 40,
        [np.r_[np.zeros(500), np.ones(500)]],
    ],
    ids=['none', 'one', 'two', 'constant', 'ramp', 'ten', 'many short', 'step'],
)
def test_poor_records_give_finite_numbers_or_null(samples):
    for coefficient in noise_of(sums_of(*samples)).values():
        assert all(x is None or (np.isfinite(x) and x >= 0.0) for x in numbers(coefficient))
        assert coefficient.status == 'estimated' or coefficient.ci95 is None


def test_constant_axis_does_not_disturb_its_neighbor():
    rng = np.random.default_rng(3)
    white = simulate_axis(20000, TAU0, NoiseTerms(N=1e-3), rng)
    both = fit_gls(
        sums_of(np.column_stack([np.full(20000, 9.8), white]), axes=('gyro_x', 'accel_z'))
    )
    alone = fit_gls(sums_of(white, axes=('accel_z',)))
    assert all(c.value is None for c in both.axes['gyro_x'].noise.values())
    assert same(both.axes['accel_z'].noise, alone.axes['accel_z'].noise)


def test_scaled_samples_scale_the_fit():
    rng = np.random.default_rng(4)
    y = simulate_axis(30000, TAU0, NoiseTerms(N=1e-3, K=2e-4), rng)
    one, other = noise_of(sums_of(y)), noise_of(sums_of(1e-6 * y))
    assert same(one, other, 1e-6)


def test_an_offset_and_a_ramp_change_only_the_ramp():
    rng = np.random.default_rng(5)
    y = simulate_axis(100000, TAU0, NoiseTerms(N=1e-3, B=3e-4), rng)
    ramp = 0.02 * TAU0 * np.arange(len(y))
    plain, moved = noise_of(sums_of(y)), noise_of(sums_of(9.8 + y + ramp))
    for term in 'QNBK':
        assert moved[term].status == plain[term].status
        assert same({term: plain[term]}, {term: moved[term]})
    assert moved['R'].status == 'estimated'
    assert moved['R'].sign == 1
    low, high = moved['R'].ci95
    assert low <= 0.02 <= high


def test_opposite_ramps_of_two_segments_are_not_a_random_walk():
    rng = np.random.default_rng(6)
    truth = NoiseTerms(N=from_datasheet('N', 'gyro', 0.242), B=from_datasheet('B', 'gyro', 5.2))
    rate = from_datasheet('R', 'gyro', 76.0)
    spans = [
        simulate_axis(360000, TAU0, truth, rng) + sign * rate * TAU0 * np.arange(360000)
        for sign in (1.0, -1.0)
    ]
    assert noise_of(sums_of(*spans))['K'].status == 'not_observable'


def test_no_value_is_at_the_end_of_its_interval():
    """In this record (one of a hundred) q is far below zero by chance, so N is low if q is left
    out.
    """
    rng = np.random.default_rng(12)
    y = [simulate_axis(8000, TAU0, NoiseTerms(N=1e-3), rng) for _ in range(6)][5]
    noise = noise_of(sums_of(y))
    assert noise['Q'].status == 'not_observable'
    low, high = noise['N'].ci95
    assert 0.8 < (noise['N'].value - low) / (high - noise['N'].value) < 1.2


def test_intervals_have_their_stated_coverage():
    """20 records of 10 min: 7 or more misses of 95 % intervals have a probability of 1/30,000."""
    truth = NoiseTerms(N=1e-3, B=4e-4, K=1.5e-4)
    rng = np.random.default_rng(7)
    missed = dict.fromkeys(TERMS, 0)
    for _ in range(20):
        for term, c in noise_of(sums_of(simulate_axis(60000, TAU0, truth, rng))).items():
            low, high = c.ci95 or (0.0, c.upper95)
            missed[term] += not low <= getattr(truth, term) <= high
    assert max(missed.values()) < 7
    assert sum(missed.values()) < 15


def test_white_noise_resolves_no_other_term():
    """60 absent terms with 1 % false alarms each: 5 or more have a probability of 1/2,500."""
    rng = np.random.default_rng(8)
    seen = 0
    for _ in range(15):
        noise = noise_of(sums_of(simulate_axis(30000, TAU0, NoiseTerms(N=1e-3), rng)))
        seen += sum(noise[term].status == 'estimated' for term in 'QBKR')
        assert noise['N'].status == 'estimated'
    assert seen < 5
