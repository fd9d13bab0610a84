# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The motion gate: motion is excluded, stationary noise is not."""

import itertools
from functools import partial

import numpy as np
import pytest

from allan_ros.core.imu import AXES, ImuBatch, ImuIdentity
from allan_ros.core.noise import Model
from allan_ros.core.settings import SegmenterSettings
from allan_ros.core.simulator import simulate_axis
from allan_ros.core.stream.health import Counts, Longest
from allan_ros.core.stream.motion import MotionGate
from allan_ros.core.stream.noise_levels import NoiseLevel, NoiseLevels

RATE = 200
SIGMA = np.array([1e-3] * 3 + [2e-2] * 3)[:, None]
MEAN = np.array([0.01, -0.02, 0.0, 0.1, 0.0, 9.8])[:, None]


def white(seconds, seed=0):
    n = round(seconds * RATE)
    return MEAN + SIGMA * np.random.default_rng(seed).normal(size=(6, n))


def start():
    """Return the noise levels, counts and the stage."""
    levels = NoiseLevels(partial(NoiseLevel, ImuIdentity(), AXES, True))
    counts, events = Counts(), Longest(200)
    return levels, counts, events, partial(MotionGate, 1e9 / RATE, AXES, levels, counts)


def gate(rows, events=None):
    """Return the output of the stage, its counts, and whether each sample is in the result."""
    levels, counts, all_events, stage_of = start()
    stage = stage_of(events or all_events, SegmenterSettings())
    index = np.arange(rows.shape[1])
    out = stage.feed([ImuBatch.of_rows(index, rows)]) + stage.flush()
    passed = np.zeros(len(index), bool)
    for block in levels.published.kept:
        passed[block.stamps_ns] = True
        same = block.rows == rows[:, block.stamps_ns]
        assert same.all() if block.filled is None else (same | block.filled).all()
    counts.add(levels.counts)
    return out, counts, passed


def noise(**terms):
    rng = np.random.default_rng(3)
    return np.stack([simulate_axis(200_000, 1 / RATE, Model.of(**terms), rng) for _ in range(6)])


def rounded(lsb):
    """Return white noise with a resolution of ``lsb`` standard deviations."""
    return np.round(white(120) / (lsb * SIGMA)) * lsb * SIGMA


AT_REST = {
    # six axes: false alarm below 1e-6
    'white noise for half an hour': lambda: white(1800),
    'typical': lambda: noise(N=1e-4, B=5e-5, K=2e-6),
    'flicker': lambda: noise(N=1e-5, B=2e-4),
    'random walk': lambda: noise(N=1e-5, K=3e-5),
    'quantization': lambda: noise(Q=1e-5, N=1e-5),
    **{f'rounded to {lsb} sigma': partial(rounded, lsb) for lsb in (0.3, 1.0, 3.0, 10.0)},
    'noise that grows by half': lambda: (white(240) - MEAN) * np.repeat([1.0, 1.5], 24_000) + MEAN,
    'shorter than a window': lambda: white(0.05),
    'constant': lambda: np.full((6, 5000), 1.25),
}


@pytest.mark.parametrize('name', AT_REST)
def test_all_samples_at_rest_are_kept_so_their_level_has_no_bias(name):
    _, counts, passed = gate(AT_REST[name]())
    assert passed.all() and counts.moving == 0


def test_isolated_spikes_are_replaced_by_the_mean_of_their_neighbors():
    """Spikes of a real accelerometer at rest: 10 deviations every 20 s, and one of 100."""
    rows = white(600)
    rows[4, 1000::4000] += 10 * SIGMA[4, 0]
    rows[2, 99] += 100 * SIGMA[2, 0]  # the last sample of a window
    out, counts, passed = gate(rows)
    assert passed.all() and counts.moving == 0
    # a spike is missed when its own noise is below -3.3 deviations: 30 of them, chance 0.015
    assert counts.spikes == 31
    (block,) = [b for b in out if b.stamps_ns[0] <= 99 <= b.stamps_ns[-1]]
    at = 99 - int(block.stamps_ns[0])
    assert block.rows[2, at] == 0.5 * (block.rows[2, at - 1] + block.rows[2, at + 1])


def test_spikes_are_excluded_without_bias():
    """The reference is the same samples without the motion gate, so there is no scatter."""
    rows = white(1000)
    spikes = np.random.default_rng(1).random(rows.shape) < 1e-3
    for added in (0.0, 10 * SIGMA * spikes):
        out, counts, passed = gate(rows + added)
        # in 1.2 million samples of white noise, 0.07 are expected: chance of more than 3 is 1e-6
        assert passed.all() and counts.spikes == pytest.approx(np.count_nonzero(added), 0.01, abs=3)
        deviation = np.concatenate([b.rows for b in out], axis=1).std(axis=1)
        assert deviation / rows.std(axis=1) == pytest.approx(np.ones(6), abs=5e-4)


def test_large_values_are_spikes_or_noise_for_a_whole_recording_and_for_any_start():
    rng = np.random.default_rng(4)
    white_part, n = white(900), 900 * RATE
    tails = 5 * SIGMA * rng.normal(size=(6, n)) * (rng.random((6, n)) < 0.05)
    large = 60 * SIGMA * (rng.random((6, n)) < 2e-4)
    for rows, heavy in ((white_part + large, False), (white_part + tails + large, True)):
        for start in (0, 7_000, 31_000):
            _, counts, passed = gate(rows[:, start:])
            expected = 0 if heavy else np.count_nonzero(large[:, start:])
            # some are in shocks or next to another one
            assert counts.spikes == pytest.approx(expected, rel=0.05)
            assert counts.moving < 0.01 * passed.size


def test_a_motion_is_left_out_with_its_margins():
    rows = white(120)
    rows[:, 10_000:12_000] += 30 * SIGMA * np.random.default_rng(1).normal(size=(6, 2000))
    out, counts, passed = gate(rows)
    assert not passed[9_900:12_300].any()
    assert passed[:9_700].all() and passed[12_700:].all()
    assert [r.cut for r in out if r.cut] == ['motion'] and counts.splits == {'motion': 1}
    assert counts.moving == np.count_nonzero(~passed)


def shock(axis, size=25.0):
    """Return a damped oscillation of ``size`` standard deviations, (6, 40)."""
    ringing = size * np.exp(-np.arange(40) / 8) * np.cos(np.arange(40) * 0.7)
    return ringing * SIGMA * (np.arange(6) == axis)[:, None]


def flagged(out, samples):
    """Return which samples are flagged in the output, (samples,)."""
    flags = np.zeros(samples, bool)
    for block in out:
        if block.filled is not None:
            flags[block.stamps_ns] = block.filled.any(axis=0)
    return flags


@pytest.mark.parametrize('axis', [0, 3, 5])
@pytest.mark.parametrize('times', [1, 4])
def test_a_shock_is_replaced_and_does_not_end_the_segment(axis, times):
    rows, events = white(120), Longest(200)
    for at in range(7_000, 7_000 + 3_000 * times, 3_000):
        rows[axis, at : at + 40] += shock(axis)[axis]
    out, counts, passed = gate(rows, events=events)
    assert passed.all() and not counts.splits and counts.moving == 0
    assert [e.kind for e in events.items] == ['shock'] * counts.shocks == ['shock'] * times
    flags = flagged(out, rows.shape[1])
    assert flags[7_000:7_040].all() and np.count_nonzero(flags) == counts.replaced
    # half a second before and after the window of the shock
    assert counts.replaced <= times * 2.1 * RATE and not flags[:6_800].any()
    # the mean of 2 s before and after: deviates from the truth by less than 5 sigma
    level = np.concatenate([b.rows for b in out], axis=1)[:, flags] - MEAN
    assert np.abs(level).max() < 5 * SIGMA.max() / np.sqrt(300)


@pytest.mark.parametrize('seconds, split', [(0.5, False), (4.0, False), (30.0, True)])
def test_a_disturbance_of_a_few_seconds_is_a_shock(seconds, split):
    rows = white(120)
    n = int(seconds * RATE)
    rows[:, 7_000 : 7_000 + n] += 30 * SIGMA * np.random.default_rng(1).normal(size=(6, n))
    _, counts, passed = gate(rows)
    # half a minute of white noise is noise that increased and decreased again
    assert set(counts.splits) == ({'motion', 'noise_decreased'} if split else set())
    assert passed.all() != split and passed[: 7_000 - RATE].all()


def test_a_shock_that_changes_a_mean_splits_the_data_and_the_change_is_listed():
    rows, events = white(120), Longest(200)
    rows[3, 7_000:7_040] += shock(3)[3]
    rows[3, 7_040:] += SIGMA[3, 0]
    _, counts, passed = gate(rows, events=events)
    assert counts.splits == {'motion': 1} and counts.shocks == 0 and not passed.all()
    (event,) = events.items
    assert event.kind == 'motion' and list(event.changes) == ['accel_x']
    # 5 sigma of the difference of two means over 2 s
    assert event.changes['accel_x'] == pytest.approx(SIGMA[3, 0], rel=5 * (2 / 400) ** 0.5)


def test_an_imu_that_is_seldom_at_rest_has_no_shocks_but_motion():
    rows = white(300)
    for at in range(5_000, rows.shape[1] - 5_000, 5 * RATE):
        rows[:, at : at + RATE] += 30 * SIGMA * np.random.default_rng(at).normal(size=(6, RATE))
    _, counts, passed = gate(rows)
    assert counts.splits['motion'] > 10 and counts.replaced < 0.5 * np.count_nonzero(passed)


def test_a_turn_is_motion_though_it_is_smooth_or_all_means_are_as_before():
    smooth, short = white(120), white(120)
    ramp = np.clip((np.arange(smooth.shape[1]) - 8000) / 2000, 0, 1)
    smooth[2] += np.radians(2.0) * ramp * (np.arange(smooth.shape[1]) < 14_000)
    passed = gate(smooth)[2]
    assert not passed[9_000:14_000].any() and passed[15_000:].all()
    short[2, 7_000 : 7_000 + RATE] += np.radians(5.0)
    assert gate(short)[1].splits == {'motion': 1}


def test_a_shock_directly_after_a_motion_does_not_hide_the_split():
    rows = white(120)
    rows[2, 7_000 : 7_000 + RATE] += np.radians(5.0)  # excluded up to sample 7700
    rows[3, 7_700:7_740] += shock(3)[3]
    out, counts, passed = gate(rows)
    assert counts.shocks == 0 and not passed[7_000:7_740].any() and passed[8_200:].all()
    follows_gap = [a.stamps_ns[-1] + 1 != b.stamps_ns[0] for a, b in itertools.pairwise(out)]
    assert [bool(b.cut) for b in out[1:]] == follows_gap and sum(follows_gap) == 1


def states(rows):
    """Return 'noise_increased' or 'moving' or 'at_rest' after each second."""
    *_, events, stage_of = start()
    stage, out = stage_of(events, SegmenterSettings()), []
    for at in range(0, rows.shape[1], RATE):
        part = slice(at, at + RATE)
        stage.feed([ImuBatch.of_rows(np.arange(at, at + RATE), rows[:, part])])
        out.append(stage.state)
    return out


@pytest.mark.parametrize('ratio', [3.0, 3.6, 10.0, 40.0])
def test_louder_stationary_noise_is_distinguished_from_motion(ratio):
    rows = white(240)
    rows[1:, 60 * RATE : 180 * RATE] = MEAN[1:] + ratio * (rows - MEAN)[1:, 60 * RATE : 180 * RATE]
    _, counts, passed = gate(rows)
    assert counts.noise_increased > 60 * RATE and counts.moving < 60 * RATE
    assert not passed[63 * RATE : 179 * RATE].any() and passed[200 * RATE :].all()
    found = states(rows)
    assert found[59] == found[-1] == 'at_rest'
    # it becomes normal when it has lasted longer than the time before
    assert set(found[100:118]) == {'noise_increased'} and set(found[160:180]) == {'at_rest'}


@pytest.mark.parametrize(
    'frequency, gyro, accel', [(0.3, 0.5, 1.0), (1.0, 0.3, 2.0), (2.0, 0.1, 1.0), (5.0, 0.1, 3.0)]
)
def test_motion_is_not_reported_as_louder_noise(frequency, gyro, accel):
    rows = white(240)
    angle = 2 * np.pi * frequency * np.arange(rows.shape[1]) / RATE
    swing = np.sin(angle + np.arange(6)[:, None]) * np.array([gyro] * 3 + [accel] * 3)[:, None]
    rows[:, 60 * RATE :] += swing[:, 60 * RATE :]
    assert gate(rows)[1].noise_increased == 0


def test_vibration_while_tilted_or_turning_is_motion():
    for change in ([0.0, 0.0, 0.05, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, 0.0, -0.05]):
        rows = white(240)
        rows[:, 60 * RATE :] += 4 * (rows - MEAN)[:, 60 * RATE :] + np.array(change)[:, None]
        assert gate(rows)[1].noise_increased == 0
