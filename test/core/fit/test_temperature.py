# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bias over temperature: truth within the intervals, and no claim where there is none to make."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.fit.result import TemperatureModel
from allan_ros.core.fit.stationary import fit_likelihood
from allan_ros.core.fit.temperature import _rises_and_falls, temperature_models
from allan_ros.core.imu import AXES, from_datasheet
from allan_ros.core.noise import Model
from allan_ros.core.simulator import simulate_axis

Floats = NDArray[np.float64]

HOUR, NS = 3600, 10**9
DEG_H = from_datasheet('B', 'gyro', 1.0)
B0, B1, B2 = 100.0 * DEG_H, 5.0 * DEG_H, 0.3 * DEG_H
NOISE = {t: from_datasheet(t, 'gyro', v) for t, v in (('N', 0.242), ('B', 5.2), ('K', 31.8))}

CYCLES = 30.0 + 6.0 * np.sin(np.linspace(0.0, 4.0 * np.pi, 2 * HOUR) - 1.0)
"""Temperature of each s of two hours."""


def drifts(seed: int, n: int = 2 * HOUR, axes: int = 3) -> Floats:
    """Return bias instability and random walk at 1 Hz, (n, axes)."""
    rng, slow = np.random.default_rng(seed), Model.of(B=NOISE['B'], K=NOISE['K'])
    return np.stack([simulate_axis(n, 1.0, slow, rng) for _ in range(axes)], axis=1)


def sums_of(drift: Floats, celsius: Floats, factor: float = 1.0, start: int = 0) -> AllanSums:
    """Return the sums of a drift with white noise, the bias over temperature, and a gap."""
    warmer = (celsius - 30.0)[:, None]
    white = np.random.default_rng(1).normal(size=drift.shape) * NOISE['N']
    y = drift + white + B0 + factor * warmer * (B1 + B2 * warmer)
    engine, half = RunningSums(axes=AXES[: y.shape[1]]), len(y) // 2
    for begin, end in ((0, half), (half + 60, len(y))):
        engine.update(y[begin:end], (start + begin) * NS, (start + end - 1) * NS)
        engine.end_segment()
    return engine.sums


def models_of(
    sums: AllanSums, celsius: Floats, start: int = 0
) -> tuple[dict[str, TemperatureModel], list[Any]]:
    read = start + np.arange(0, len(celsius), 10)
    return temperature_models(sums, read * NS, celsius[read - start], fit_likelihood(sums))


def test_the_truth_lies_within_the_intervals() -> None:
    missed = 0
    for seed in (1, 2, 3):
        drift = drifts(seed)
        models, findings = models_of(sums_of(drift, CYCLES), CYCLES)
        assert findings == [] and list(models) == ['gyro_x', 'gyro_y', 'gyro_z']
        for (axis, m), level in zip(models.items(), drift.mean(axis=0)):
            off = m.reference - 30.0
            truth = B0 + level + off * (B1 + B2 * off), B1 + 2.0 * B2 * off, B2, 0.0
            ends = m.b0_ci95, m.b1_ci95, m.b2_ci95, m.hysteresis_ci95
            missed += sum(not low <= t <= high for t, (low, high) in zip(truth, ends))
            warmer = CYCLES - 30.0
            bias = drift[:, AXES.index(axis)] + warmer * (B1 + B2 * warmer)
            share = 1.0 - (bias - m.bias(CYCLES)).var() / bias.var()
            assert m.resolved and m.explained == pytest.approx(share, abs=0.05)
            assert m.bias(np.array([m.reference])) == m.b0
            # the temperature alone looks like a random walk
            k = m.corrected.K
            low, high = k.ci95 or (0.0, k.upper95 or 0.0)
            missed += not low <= NOISE['K'] <= high
            assert m.measured.K.value is not None and m.measured.K.value > 1.4 * NOISE['K']
    # more than 7 of 45 intervals of 95 % miss in 0.2 % of independent draws
    assert missed <= 7


def test_without_a_dependence_none_is_resolved() -> None:
    models, _ = models_of(sums_of(drifts(7), CYCLES, 0.0), CYCLES)
    assert [m.resolved for m in models.values()] == 3 * [False]  # false alarms: 1 % per axis
    assert all(m.b1_ci95[0] < 0.0 < m.b1_ci95[1] for m in models.values())


@pytest.mark.parametrize(
    ('celsius', 'ids'),
    [
        # a warm-up; the cooling at its end is too small
        (45.0 - 20.0 * np.exp(-np.arange(2 * HOUR) / 1200.0), ['temperature_one_way']),
        (np.minimum(25.0 + np.arange(2 * HOUR) / 600.0, 36.0), ['temperature_one_way']),
        (30.0 + (CYCLES - 30.0) * 2.9 / 12.0, []),  # a range of 2.9 K
        (np.full(2 * HOUR, 30.0), []),
    ],
)
def test_there_is_no_model_where_the_effect_cannot_be_told(celsius: Floats, ids: list[str]) -> None:
    models, findings = models_of(sums_of(drifts(2), celsius), celsius)
    assert models == {} and [f.id for f in findings] == ids


def test_two_temperatures_show_a_dependence_but_no_slope_and_curvature() -> None:
    second = np.arange(2 * HOUR)
    celsius = np.where(second // 1000 % 2, 36.0, 24.0)
    sums = sums_of(drifts(8), celsius, 2.0)
    read = second[abs(second % 1000 - 500) < 400]  # none for 200 s around each change
    models, _ = temperature_models(sums, read * NS, celsius[read], fit_likelihood(sums))
    for m in models.values():
        assert m.resolved and m.b2_ci95[0] < 2.0 * B2 < m.b2_ci95[1]
        warm, cold = m.bias(np.array([36.0, 24.0]))
        assert warm - cold == pytest.approx(2.0 * 12.0 * B1, rel=0.3)


def test_recordings_may_differ_in_their_bias() -> None:
    days = [sums_of(drifts(s) + s * 1e3 * DEG_H, CYCLES, 1.0, s * 9 * HOUR) for s in (1, 2)]
    sums = days[0] + days[1]
    read = np.concatenate([s * 9 * HOUR + np.arange(0, 2 * HOUR, 10) for s in (1, 2)])
    celsius = np.tile(CYCLES[::10], 2)
    both, _ = temperature_models(sums, read * NS, celsius, fit_likelihood(sums))
    one, _ = models_of(days[0], CYCLES, 9 * HOUR)
    for axis, m in both.items():
        assert abs(m.b1 - (B1 + 2.0 * B2 * (m.reference - 30.0))) < 2.0 * np.ptp(m.b1_ci95) / 2.0
        assert np.ptp(m.b1_ci95) < np.ptp(one[axis].b1_ci95)
        assert m.b0 == pytest.approx(B0 + 1500.0 * DEG_H, abs=100.0 * DEG_H)


@pytest.mark.parametrize('lag', [-180, 180])
def test_a_lag_of_the_bias_is_a_hysteresis(lag: int) -> None:
    later = 30.0 + 6.0 * np.sin(
        np.linspace(0.0, 4.0 * np.pi, 2 * HOUR) - 1.0 - 4.0 * np.pi * lag / 7200.0
    )
    bias = (later - CYCLES)[:, None] * B1 * 6.0
    warmer = (CYCLES - 30.0)[:, None]
    drift = drifts(4) + bias + warmer * B1 * 5.0 - warmer**2 * B2
    models, _ = models_of(sums_of(drift, CYCLES), CYCLES)
    rate = float(np.abs(np.gradient(CYCLES)).mean())
    for m in models.values():
        assert m.rate == pytest.approx(rate, rel=0.02)
        half = np.ptp(m.hysteresis_ci95) / 2.0
        assert m.hysteresis == pytest.approx(-2.0 * 6.0 * B1 * lag * rate, abs=1.5 * half)
        assert m.lag == pytest.approx(lag, abs=1.5 * half / (2.0 * 6.0 * B1 * rate))
        assert half < 0.5 * abs(m.hysteresis)


def test_blocks_without_a_temperature_are_not_used() -> None:
    sums, read = sums_of(drifts(5), CYCLES), np.arange(0, 2 * HOUR, 10)
    fit = fit_likelihood(sums)
    known = (read < 3000) | (read > 4500)
    some, _ = temperature_models(sums, read[known] * NS, CYCLES[read[known]], fit)
    wrong = np.where(known, CYCLES[read], 99.0)[known]
    assert (wrong == CYCLES[read[known]]).all() and list(some) == list(fit.axes)
    for begin, end in ((0, 100), (3 * HOUR, 4 * HOUR)):  # too few readings, and none during it
        few = (read + begin)[: (end - begin) // 10]
        assert temperature_models(sums, few * NS, CYCLES[: len(few)], fit) == ({}, [])


def test_an_axis_without_white_noise_has_no_model() -> None:
    sums = sums_of(drifts(6), CYCLES)
    fit = fit_likelihood(sums)
    dead = replace(
        fit.axes['gyro_y'],
        noise={**fit.axes['gyro_y'].noise, 'N': replace(fit.axes['gyro_y'].noise['N'], value=None)},
    )
    read = np.arange(0, 2 * HOUR, 10)
    known = replace(fit, axes={**fit.axes, 'gyro_y': dead})
    models, _ = temperature_models(sums, read * NS, CYCLES[read], known)
    assert list(models) == ['gyro_x', 'gyro_z']


def test_a_small_return_is_none() -> None:
    wave = np.array([0.0, 1.0, 2.0, 1.75, 2.5])
    assert _rises_and_falls(wave, 0.25) and not _rises_and_falls(wave, 0.26)
    assert _rises_and_falls(-wave, 0.25) and not _rises_and_falls(np.arange(5.0), 0.1)
