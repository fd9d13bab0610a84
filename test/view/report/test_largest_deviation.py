# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The stated largest deviation is the largest one of the chart, and can be read from it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import allan_ros as ar
from allan_ros.core.fit.result import SIGNIFICANT
from allan_ros.view.format import deviation_text
from allan_ros.view.report.chart_data import rounded, sensor_charts
from allan_ros.view.report.sensor_tables import model_html

ADIS_LSB = np.repeat([0.05 * np.pi / 180.0, 0.00333 * 9.80665], 3)
GYRO = {'N': 0.2, 'B': 5.0, 'K': 20.0}


def read_off(
    chart: dict[str, Any], axis: dict[str, Any], uncertain: list[float | None]
) -> tuple[float, float] | None:
    """Return the largest deviation and its tau, computed from the numbers of the chart alone.

    Points at the averaging times ``uncertain`` are not compared.
    """
    largest = (0.0, 0.0)
    columns = (axis[name] for name in ('adev', 'low', 'high', 'fit', 'most'))
    for tau, adev, low, high, line, most in zip(chart['tau'], *columns):
        if None in (adev, low, high, line, most) or tau in uncertain:
            continue
        edge = min(max(adev, line), most)
        bar = adev / low if adev > edge else high / adev
        off = math.log(adev / edge)
        if abs(off) > SIGNIFICANT * math.log(bar) and abs(off) > abs(math.log1p(largest[0])):
            largest = (adev / edge - 1.0, tau)
    return largest if largest[1] else None


def check(results: ar.Results) -> list[tuple[float, float] | None]:
    """Compare each stated deviation with the chart; return the stated deviations."""
    stated = []
    for sensor in sorted({name.split('_')[0] for name in results}):
        chart = sensor_charts(results, sensor, None)
        axes = {a['name']: a for a in chart['axes'] if 'adev' in a}
        page = ''.join(model_html({name: results.axes[name] for name in axes}))
        for name, axis in axes.items():
            deviation = results.axes[name].fit.deviation
            curve = results.axes[name].curve
            expected = read_off(chart, axis, rounded(curve.tau[curve.is_uncertain]))
            assert (deviation is None) == (expected is None), name
            if deviation is not None and expected is not None:
                assert deviation.relative == pytest.approx(expected[0], abs=2e-4), name
                assert deviation.tau == pytest.approx(expected[1], rel=1e-4), name
                assert f'>{deviation_text(deviation)}</td>' in page
            stated.append(expected)
    return stated


@pytest.mark.parametrize(
    ('hours', 'gyro'),
    [(1 / 3, GYRO), (2.0, {**GYRO, 'R': 200.0})],
    ids=['short', 'ramp'],
)
def test_five_terms_do_not_deviate(hours: float, gyro: dict[str, float]) -> None:
    """Terms that are not resolved cause no stated deviation; fixed seeds.

    Some of about twenty independent points exceed three error bars by chance in up to a tenth of
    the axes.
    """
    samples = ar.simulate(hours=hours, rate=20, gyro=gyro, seed=3)
    assert len([d for d in check(ar.analyze(samples)) if d is not None]) <= 1


def test_a_filter_is_not_a_deviation() -> None:
    """The line begins where the effect of the filter ends: at shorter times Q would be negative."""
    white = np.random.default_rng(1).normal(size=100_000)
    results = ar.analyze(np.convolve(white, np.ones(4) / 4.0, 'valid'), rate=100.0, axes='gyro_z')
    axis = results['gyro_z']
    assert axis.fit.noise['Q'].upper95 is None
    check(results)
    line = axis.model_line().adev
    first = int(np.flatnonzero(np.isfinite(line))[0])
    assert 0.01 < axis.curve.tau[first] < 1.0
    assert np.isfinite(line[first:]).all()


def test_a_broad_hump_deviates() -> None:
    t = np.arange(20_000) / 10.0
    phase = 2.0 * np.pi * np.cumsum(0.5 + 0.4 * np.sin(2.0 * np.pi * t / 50.0)) / 10.0
    white = np.random.default_rng(2).normal(size=len(t))
    results = ar.analyze(white + 1.0 * np.sin(phase), rate=10.0, axes='gyro_z', motion_gate=False)
    ((relative, _),) = check(results)  # type: ignore[misc]
    assert abs(relative) > 0.05
    assert 'lack_of_fit' in {f.id for f in results.findings}


@pytest.mark.parametrize('name', ['imu1', 'imu2', 'mpu6050'])
def test_real_sensors(shared_data: Path, name: str) -> None:
    if name == 'mpu6050':
        check(ar.analyze(shared_data / 'mpu6050.npz'))
        return
    counts = np.load(shared_data / 'adis16405' / f'{name}_counts.npz')
    samples = np.column_stack([counts['gyro'], counts['accel']]) * ADIS_LSB
    results = ar.analyze(samples[:200_000, [1, 3]], rate=100.0, axes=('gyro_y', 'accel_x'))
    assert all(d is None or abs(d[0]) < 0.25 for d in check(results))
