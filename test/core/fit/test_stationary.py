# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise that changes with time: warm-up, steps of the bias, level of the white noise."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.allan.sums import AllanSums, part
from allan_ros.core.fit.bias_changes import step_findings
from allan_ros.core.fit.stationary import fit_stationary
from allan_ros.core.fit.statistics import statistics
from allan_ros.core.fit.white_noise_levels import present_part, white_noise_levels
from allan_ros.core.imu import AXES, from_datasheet
from allan_ros.core.noise import Model
from allan_ros.core.simulate import simulate_axis

Floats = NDArray[np.float64]

DEG_H = from_datasheet('B', 'gyro', 1.0)
HOUR = 3600
CHANGES = {
    'warm_up', 'not_settled', 'settled_part', 'bias_steps', 'level_changes', 'level_changed',
}  # fmt: skip


def draw(seed: int, samples: int, rate: float = 1.0, terms: str = 'NB', axes: int = 3) -> Floats:
    """Return noise of a common MEMS gyroscope."""
    values = {'N': 0.242, 'B': 5.237, 'K': 31.807}
    noise = Model.of(**{t: from_datasheet(t, 'gyro', values[t]) for t in terms})
    rng = np.random.default_rng(seed)
    return np.stack([simulate_axis(samples, 1.0 / rate, noise, rng) for _ in range(axes)], axis=1)


def sums_of(*segments: Floats, rate: float = 1.0, pause: float = 1.0) -> AllanSums:
    """Return the sums of segments with pauses between them."""
    engine, start = RunningSums(axes=AXES[: segments[0].shape[1]]), 0.0
    for y in segments:
        engine.update(y, round(start * 1e9), round((start + (len(y) - 1) / rate) * 1e9))
        engine.end_segment()
        start += len(y) / rate + pause
    return engine.sums


def changes(sums: AllanSums, settle: bool = True) -> dict[str, tuple[str, ...]]:
    """Return the axes of each finding about noise that changes with time."""
    _, model = fit_stationary(sums, settle=settle)
    found: dict[str, tuple[str, ...]] = {}
    for each in model.findings:
        if each.id in CHANGES:
            found[each.id] = (*found.get(each.id, ()), *each.axes)
    return found


@pytest.mark.parametrize('terms', ['N', 'NB', 'NK'])
def test_clean_noise_is_used_completely(terms: str) -> None:
    sums = sums_of(draw(1, 2 * HOUR, terms=terms))
    used, _ = fit_stationary(sums)
    assert used is sums
    assert not changes(sums)


def test_a_warm_up_is_excluded_and_the_drift_is_that_without_it() -> None:
    y = draw(2, 8 * HOUR)
    decay = 300.0 * DEG_H * np.exp(-np.arange(len(y)) / 600.0)[:, None]
    sums = sums_of(y + decay)
    used, model = fit_stationary(sums)
    lost = 1.0 - used.samples / sums.samples
    assert 2 * 600.0 / len(y) < lost < 0.4
    assert 'settled_part' in {f.id for f in model.findings}
    for fit in model.axes.values():
        b, k = fit.noise['B'], fit.noise['K']
        assert b.value == pytest.approx(5.237 * DEG_H, rel=0.2)
        assert k.status != 'estimated'
    kept, _ = fit_stationary(sums, settle=False)
    assert kept is sums
    assert 'warm_up' in changes(sums, settle=False)


def test_a_warm_up_that_does_not_end_is_reported() -> None:
    y = draw(3, 2 * HOUR)
    decay = 3000.0 * DEG_H * np.exp(-np.arange(len(y)) / HOUR)[:, None]
    sums = sums_of(y + decay)
    used, _ = fit_stationary(sums)
    assert used is sums
    assert 'not_settled' in changes(sums)


def test_steps_of_the_bias_are_located() -> None:
    y = draw(4, 8 * HOUR)
    y[3 * HOUR :, 1] += 100.0 * DEG_H
    y[6 * HOUR :, 1] -= 60.0 * DEG_H
    sums = sums_of(y)
    _, model = fit_stationary(sums)
    (found,) = (f for f in model.findings if f.id in CHANGES)
    assert found.id == 'bias_steps' and found.axes == ('gyro_y',)
    assert found.values['size'].value == pytest.approx(100.0 * DEG_H, rel=0.15)
    assert 0.8 < found.values['share'] <= 1.0
    assert found.values['at'] == '3 h, 6 h'
    later_part = part(sums, first=4)
    (later,) = step_findings(
        later_part, statistics(later_part), set()
    )  # times are still from the start
    assert later.values['at'] == '3 h, 6 h'


@pytest.mark.parametrize('at', [44_000, 52_000, 60_000])
def test_the_period_within_which_the_white_noise_changes_is_excluded(at: int) -> None:
    y = draw(7, 108_000, 100.0, 'N')
    y[at:] *= 2.0
    sums = sums_of(y, rate=100.0)
    first, _ = present_part(sums, white_noise_levels(sums)) or (0, ())
    assert 0 < sum(p.samples for p in sums.periods[first:]) <= 108_000 - at


@pytest.mark.parametrize(
    ('seed', 'samples', 'at', 'factor', 'error'),
    [  # 3 and 5 % are more than four standard errors of N
        *((7, 108_000, 90_000, factor, 0.03) for factor in (2.0, 0.7)),
        *((11, 18_000, 12_000, factor, 0.05) for factor in (2.0, 0.5)),
    ],
)
def test_the_model_follows_a_change_of_the_white_noise(
    seed: int, samples: int, at: int, factor: float, error: float
) -> None:
    y = draw(seed, samples, 100.0, 'N')
    y[at:] *= factor
    sums = sums_of(y, rate=100.0)
    used, model = fit_stationary(sums)
    assert used.samples <= samples - at
    n = from_datasheet('N', 'gyro', 0.242)
    for fit in model.axes.values():
        assert fit.noise['N'].value == pytest.approx(factor * n, rel=error)
    assert set(changes(sums)['level_changed']) == set(AXES[:3])
    assert set(changes(sums, settle=False)) == {'level_changes'}


def test_a_short_burst_of_noise_excludes_nothing() -> None:
    y = draw(8, 108_000, 100.0, 'N')
    y[40_000:50_000] *= 2.0
    sums = sums_of(y, rate=100.0)
    used, _ = fit_stationary(sums)
    assert used is sums
    assert 'level_changes' in changes(sums)


def test_a_noisier_recording_of_the_same_sensor_replaces_earlier_ones() -> None:
    y = draw(9, 3 * HOUR, terms='N')
    earlier = sums_of(y[:HOUR]) + sums_of(y[HOUR : 2 * HOUR], pause=0.0)
    sums = earlier + sums_of(2.0 * y[2 * HOUR :])
    used, _ = fit_stationary(sums)
    assert used.samples <= HOUR


def test_impulsive_noise_has_a_constant_level() -> None:
    rng = np.random.default_rng(10)
    sums = sums_of(rng.laplace(size=(200_000, 3)) * 1e-3, rate=100.0)
    used, _ = fit_stationary(sums)
    assert used is sums
    assert not changes(sums)
