# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of motion and of a warm-up are not taken for recordings of noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import allan_ros as ar
from allan_ros.cli.main import main
from allan_ros.core.estimate import Estimate
from allan_ros.core.fit.fit_findings import is_disturbed
from allan_ros.core.fit.result import AxisFit, LackOfFit
from allan_ros.core.noise import Model, Process
from allan_ros.core.noise.processes.resonance import Resonance
from allan_ros.core.noise.processes.rounded_angle import RoundedAngle
from allan_ros.core.noise.processes.sinusoid import Sinusoid

RATE, SECONDS = 50.0, 240.0
SIGMA = np.array([2e-3] * 3 + [2e-2] * 3)
"""Standard deviations of the white noise of a sample in rad/s and m/s^2."""

N = float(SIGMA[0] / RATE**0.5)
HALF_WIDTH = 0.009
"""Relative half width of the interval of N that white noise of this length has."""


def axis(*shaped: tuple[float, Process], width: float = HALF_WIDTH) -> AxisFit:
    """Return the fit of an axis with oscillations; their sizes are relative to the white noise."""
    parts = [(size * float(SIGMA[0]), process) for size, process in shaped]
    n = Estimate(N, (N * (1.0 - width), N * (1.0 + width)))
    unknown = Estimate(None, status='not_observable')
    return AxisFit({'Q': unknown, 'N': n}, Model.of(*parts, N=N))


def test_an_axis_with_few_narrow_lines_is_not_disturbed() -> None:
    fan = [(30.0, Sinusoid(each)) for each in (6.3, 12.6, 18.9)]
    assert not is_disturbed(axis(*fan), 1.0 / RATE, SECONDS)
    assert is_disturbed(axis(*fan, (1.0, Sinusoid(21.0))), 1.0 / RATE, SECONDS)


def test_several_slow_or_broad_oscillations_disturb_an_axis_if_they_outweigh_the_noise() -> None:
    for process in (Sinusoid(0.2), Resonance(5.0, 0.5)):
        beside = Resonance(1.4, 0.7)
        assert not is_disturbed(axis((3.0, process)), 1.0 / RATE, SECONDS)
        assert not is_disturbed(axis((0.5, process), (0.5, beside)), 1.0 / RATE, SECONDS)
        assert is_disturbed(axis((3.0, process), (0.5, beside)), 1.0 / RATE, SECONDS)


def test_the_rounding_errors_of_a_counter_are_no_oscillation() -> None:
    counter = (1e-3, RoundedAngle(4.0, 0.1))
    assert not is_disturbed(axis((3.0, Resonance(5.0, 0.5)), counter), 1.0 / RATE, SECONDS)


def test_a_white_noise_that_is_hidden_disturbs_an_axis() -> None:
    assert not is_disturbed(axis(width=0.09), 1.0 / RATE, SECONDS)
    assert is_disturbed(axis(width=0.3), 1.0 / RATE, SECONDS)
    assert not is_disturbed(axis(width=0.3), 1.0 / RATE, 0.002 * SECONDS)  # of a short recording
    limit = Estimate(None, upper95=N, status='not_observable')
    quantized = {'Q': Estimate(1e-4, (9e-5, 1.1e-4)), 'N': limit}
    assert is_disturbed(AxisFit({'Q': limit, 'N': limit}), 1.0 / RATE, SECONDS)
    assert not is_disturbed(AxisFit(quantized), 1.0 / RATE, SECONDS)


@pytest.mark.parametrize(('octaves', 'disturbed'), [(4, False), (5, True)])
def test_a_model_that_does_not_fit_in_a_third_of_the_octaves(octaves: int, disturbed: bool) -> None:
    fit = axis()  # 12.6 octaves
    misfit = tuple(LackOfFit(0.1 * 2.0**i, 0.2 * 2.0**i, 2.0) for i in range(octaves))
    fit = AxisFit(fit.noise, fit.model, lack_of_fit=misfit)
    assert is_disturbed(fit, 1.0 / RATE, SECONDS) is disturbed


def white(seed: int) -> np.ndarray:
    """Return white noise of six axes at rest, (n, 6)."""
    values = np.random.default_rng(seed).normal(size=(round(RATE * SECONDS), 6)) * SIGMA
    values[:, 5] += 9.81
    return values


def shaken(seed: int, *kinds: tuple[float, float, float]) -> np.ndarray:
    """Return noise with motion of some kinds: frequency and bandwidth in Hz, relative size."""
    rng, values = np.random.default_rng(seed), white(seed)
    for frequency, width, size in kinds:
        radius, turn = np.exp(-np.pi * width / RATE), 2.0 * np.pi * frequency / RATE
        force = rng.normal(size=values.shape)
        motion = lfilter([1.0], [1.0, -2.0 * radius * np.cos(turn), radius**2], force, axis=0)
        values += size * SIGMA * motion / motion.std(axis=0)
    return values


ROAD = ((1.5, 0.8, 5.0), (11.0, 6.0, 6.0), (0.05, 0.05, 3.0))
"""Body of a vehicle on its springs, its engine, and the road."""


def test_a_vehicle_is_not_judged() -> None:
    results = ar.analyze(shaken(1, *ROAD), rate=RATE, motion_gate=False)
    assert next(f.id for f in results.findings if f.severity != 'info') == 'not_noise'
    assert results.verdict.level == 'unknown'
    assert 'not a noise recording' in results.verdict.summary


def test_clean_noise_is_judged() -> None:
    """No axis is disturbed in 4 records of 6 axes."""
    for seed in range(4):
        results = ar.analyze(white(seed), rate=RATE)
        assert results.verdict.level == 'measured', results.findings


def test_a_recording_that_ends_during_the_warm_up_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    decay = np.exp(-np.arange(round(RATE * SECONDS)) / (RATE * 120.0))[:, None]
    table = np.column_stack([np.arange(len(decay)) / RATE, white(2) + 5.0 * SIGMA * decay])
    names = 'time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z'
    np.savetxt(tmp_path / 'cold.csv', table, delimiter=',', header=names, comments='')
    assert main(['check', str(tmp_path / 'cold.csv')]) == 4
    assert 'has not settled' in capsys.readouterr().out
    assert main(['analyze', str(tmp_path / 'cold.csv'), '-o', str(tmp_path / 'out')]) == 0
    export = ['export', str(tmp_path / 'out'), '--to', 'kalibr', '-o', str(tmp_path / 'imu.yaml')]
    assert main(export) == 1
    assert 'has not settled' in capsys.readouterr().err
    assert main([*export, '--force']) == 0
