# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The motion gate: what is trimmed, and that honest noise is not."""

import numpy as np
import pytest

from allan_ros.core.imu import AXES
from allan_ros.core.noise import NoiseTerms
from allan_ros.core.simulate import simulate_axis
from allan_ros.core.stream.health import Counts
from allan_ros.core.stream.motion import RELEARNED, StillnessStage
from allan_ros.core.stream.timing import Block

RATE = 200
SIGMA = np.array([1e-3] * 3 + [2e-2] * 3)[:, None]
MEAN = np.array([0.01, -0.02, 0.0, 0.1, 0.0, 9.8])[:, None]


def white(seconds, seed=0):
    n = round(seconds * RATE)
    return MEAN + SIGMA * np.random.default_rng(seed).normal(size=(6, n))


def gate(rows, cut_at=()):
    """Return the stage's output, its counts, and whether each sample was passed on."""
    counts = Counts()
    stage = StillnessStage(1e9 / RATE, AXES, counts, 3.0, 0.0087)
    index = np.arange(rows.shape[1])
    out = []
    for a, b in zip([0, *cut_at], [*cut_at, len(index)]):
        out += stage.feed([Block(index[a:b], rows[:, a:b], 'gap' if a else '')])
    out += stage.flush()
    begin = max([i for i, r in enumerate(out) if r.cut == RELEARNED], default=0)
    passed = np.zeros(len(index), bool)
    for r in out[begin:]:
        passed[r.stamps] = True
        assert np.array_equal(r.rows, rows[:, r.stamps])
    return out, counts, passed


def test_honest_noise_is_not_trimmed_so_its_level_has_no_bias():
    """Half an hour of white noise, six axes: no window is hot (chance below 1e-6 in all)."""
    _, counts, passed = gate(white(1800))
    assert passed.all() and counts.moving == 0


@pytest.mark.parametrize(
    'terms',
    [
        NoiseTerms(N=1e-4, B=5e-5, K=2e-6),
        NoiseTerms(N=1e-5, B=2e-4),
        NoiseTerms(N=1e-5, K=3e-5),
        NoiseTerms(Q=1e-5, N=1e-5),
    ],
    ids=['typical', 'flicker', 'random walk', 'quantization'],
)
def test_slow_noise_is_not_trimmed(terms):
    rng = np.random.default_rng(3)
    rows = np.stack([simulate_axis(200_000, 1 / RATE, terms, rng) for _ in range(6)])
    assert gate(rows)[2].all()


def test_rounded_noise_is_not_trimmed():
    for lsb_per_sigma in (0.3, 1.0, 3.0, 10.0):
        lsb = lsb_per_sigma * SIGMA
        assert gate(np.round(white(120) / lsb) * lsb)[2].all(), lsb_per_sigma


def test_single_outliers_of_the_sensor_are_its_noise():
    """As on a real accelerometer at rest: a sample at 10 deviations every 20 s."""
    rows = white(600)
    rows[4, 1000::4000] += 10 * SIGMA[4, 0]
    assert gate(rows)[2].all()


def test_noise_that_grows_by_half_is_told_not_trimmed():
    rows = white(240)
    rows[:, 24_000:] += 0.5 * (rows[:, 24_000:] - MEAN)
    assert gate(rows)[2].all()


def test_a_motion_is_left_out_with_its_margins():
    rows = white(120)
    rows[:, 10_000:12_000] += 30 * SIGMA * np.random.default_rng(1).normal(size=(6, 2000))
    out, counts, passed = gate(rows)
    assert not passed[9_900:12_300].any()
    assert passed[:9_700].all() and passed[12_700:].all()
    assert [r.cut for r in out if r.cut] == ['motion'] and counts.cuts == {'motion': 1}
    assert counts.moving == np.count_nonzero(~passed)


@pytest.mark.parametrize('axis', [0, 3, 5])
def test_a_single_knock_is_seen(axis):
    rows = white(60)
    rows[axis, 7_000] += 25 * SIGMA[axis, 0]
    passed = gate(rows)[2]
    assert not passed[6_900:7_400].any() and passed[:6_700].all() and passed[7_700:].all()


def test_a_steady_turn_is_motion_though_it_is_smooth():
    rows = white(120)
    ramp = np.clip((np.arange(rows.shape[1]) - 8000) / 2000, 0, 1)
    rows[2] += np.radians(2.0) * ramp * (np.arange(rows.shape[1]) < 14_000)
    passed = gate(rows)[2]
    assert not passed[9_000:14_000].any() and passed[15_000:].all()


def test_evidence_gathered_in_motion_is_void_once_the_floor_is_known():
    rows = white(120)
    rows[:, :8_000] += 50 * SIGMA * np.random.default_rng(1).normal(size=(6, 8000))
    out, _, passed = gate(rows)
    assert next(r.cut for r in out if r.cut) == RELEARNED
    assert not passed[:8_000].any() and passed[9_000:].all()


def test_an_axis_that_is_stuck_is_none():
    rows = white(120)
    rows[1, 12_000:] = rows[1, 12_000]
    _, counts, passed = gate(rows)
    assert passed[:11_800].all() and not passed[12_000:].any()
    assert counts.stuck >= 11_900 and counts.cuts == {'stuck': 1}


def test_a_gap_ends_a_stretch_but_no_evidence():
    out, _, passed = gate(white(60), cut_at=(3_333, 9_001))
    assert passed.all()
    assert [(r.cut, int(r.stamps[0])) for r in out if r.cut] == [('gap', 3_333), ('gap', 9_001)]


def test_a_range_that_is_exceeded_is_counted():
    rows = white(60)
    rows[3, 6_000:6_500] = np.clip(40 * np.sin(np.arange(500) / 20), -19.6, 19.6)
    assert gate(rows)[1].saturated > 100


def test_what_is_shorter_than_a_window_passes():
    assert gate(white(0.05))[2].all()
    assert gate(np.full((6, 5000), 1.25))[2].all()
