# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bias and noise over time, bias against temperature, and the marks of sinusoids, as drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.exports import warmed
from support.sums import TICK_NS, sums_of

import allan_ros as ar
from allan_ros.core.allan.curve import noise_density
from allan_ros.core.fit.result import AxisFit
from allan_ros.core.noise import PROCESSES, Model
from allan_ros.core.simulator import simulate_axis
from allan_ros.core.stream.signal import SignalSummary, SignalTemperature, summarize_signal
from allan_ros.results.axis_result import AxisResult
from allan_ros.results.results import Results
from allan_ros.view.report.chart_data import model_density, sensor_charts, trends

RATE, SECONDS, DRIFT, DENSITY = 50.0, 600.0, 2e-5, 1e-4


@pytest.fixture(scope='module')
def drifting() -> Results:
    """Return a gyro whose x axis drifts evenly and whose y noise grows in the second half."""
    n = int(RATE * SECONDS)
    noise = np.random.default_rng(8).normal(size=(n, 3)) * DENSITY * np.sqrt(RATE)
    noise[n // 2 :, 1] *= 1.5
    noise[:, 0] += DRIFT * np.arange(n) / RATE
    return ar.analyze(noise, rate=RATE, axes='gyro')


def summary_of(results: Results) -> SignalSummary:
    recorded = results.recorded
    assert recorded is not None
    summary = summarize_signal(recorded.signals, results.provenance.segments, 1000)
    assert summary is not None
    return summary


def test_bias_and_noise_are_shown_as_they_were(drifting: Results) -> None:
    bias, noise = trends(drifting, 'gyro', summary_of(drifting))
    assert [line['name'] for line in bias['lines']] == ['gyro_x', 'gyro_y', 'gyro_z']
    # all intervals are equally long, except the last one
    assert np.diff(bias['x'])[:-1] == pytest.approx(bias['span'], rel=1e-3)
    means = np.array(bias['lines'][0]['values'], float)
    known = np.isfinite(means)
    slope = np.polyfit(np.array(bias['x'])[known], means[known], 1)[0]
    # the slope scatters by 0.25 % of this drift, so that this fails once in 10^15
    assert slope == pytest.approx(DRIFT, rel=0.02)
    assert bias['x'][0] < 10.0 and bias['x'][-1] == pytest.approx(SECONDS, rel=0.02)
    levels = np.array(noise['lines'][1]['values'], float)
    late = np.array(noise['x']) > SECONDS / 2.0
    # 15,000 differences in each half: 0.8 % scatter, six times less than the bound
    first, second = (np.sqrt(np.nanmean(levels[part] ** 2)) for part in (~late, late))
    assert first == pytest.approx(DENSITY * np.sqrt(RATE), rel=0.05)
    assert second / first == pytest.approx(1.5, rel=0.05)


def test_the_bias_over_temperature_is_shown_with_its_model(drifting: Results) -> None:
    time = np.array([0.0, SECONDS])
    heated = SignalTemperature('/temp', time, 20.0 + time / 60.0)  # a degree a minute
    summary = replace(summary_of(drifting), temperature=heated)
    for results, lines in ((drifting, 0), (warmed(drifting), 3)):
        kinds = {trend['kind']: trend for trend in trends(results, 'gyro', summary)}
        assert list(kinds) == ['bias', 'temperature', 'noise']
        chart = kinds['temperature']
        assert chart['x'] == sorted(chart['x'])
        assert len(chart['fits']) == lines and bool(chart['text']['SI']) == bool(lines)
    fit, points = (np.array(line) for line in (chart['fits'][2], chart['lines'][2]['values']))
    # the curve b1 (T - T0) + b2 (T - T0)^2 at the height of the points
    warmer = np.array(chart['x']) - 25.0
    expected = -1e-5 * warmer + 1e-7 * warmer**2
    assert fit - fit.mean() == pytest.approx(expected - expected.mean(), abs=1e-8)
    assert fit.mean() == pytest.approx(points.mean(), abs=1e-8)
    assert chart['text']['SI'].startswith('x -6.00e-06 ± 2.0e-06, y -8.00e-06 ± 2.0e-06 (not res')


def test_excluded_intervals_are_missing_in_the_trends(drifting: Results) -> None:
    summary = summary_of(drifting)
    moved = (summary.time_s > 200.0) & (summary.time_s < 300.0)
    for trend in trends(drifting, 'gyro', replace(summary, used=~moved)):
        x, values = np.array(trend['x']), np.array(trend['lines'][0]['values'], float)
        assert np.isnan(values[(x > 205.0) & (x < 295.0)]).all()
        assert np.isfinite(values[(x < 195.0) | ((x > 305.0) & (x < 590.0))]).all()
    assert trends(drifting, 'gyro', None) == trends(drifting, 'accel', summary) == []


def test_a_sinusoid_is_marked_with_its_frequency_and_axes() -> None:
    n = 20_000
    samples = np.random.default_rng(4).normal(size=(n, 3)) * DENSITY * np.sqrt(RATE)
    samples[:, :2] += 5e-4 * np.sin(2.0 * np.pi * 3.0 * np.arange(n)[:, None] / RATE)
    results = ar.analyze(samples, rate=RATE, axes='gyro', motion_gate=False)
    assert results.recorded is not None
    chart = sensor_charts(results, 'gyro', None)
    [(frequency, axes)] = chart['density']['lines']
    assert frequency == pytest.approx(3.0, rel=0.01) and axes == 'x y'


def test_the_density_of_the_model_is_the_mean_of_measured_densities() -> None:
    """Of all processes at once; 40 records, false alarms below 1e-3 by 5 standard errors."""
    rate, n, rng = 1e9 / TICK_NS, 1 << 13, np.random.default_rng(6)
    model = Model.of(
        *((1e-2, PROCESSES['resonance'](12.0, 0.2)), (2e-2, PROCESSES['gauss_markov'](0.5))),
        *((3e-2, PROCESSES['sinusoid'](3.1)), (1e-3, PROCESSES['low_pass']())),
        Q=1e-5,
        N=1e-3,
        B=5e-3,
        K=1e-2,
        R=1e-3,
    )
    samples = model.where(lambda process: not process.is_regressor)
    found = []
    for _ in range(40):
        y = simulate_axis(n, 1.0 / rate, samples, rng)
        spectrum = noise_density(sums_of(y[:, None]))
        assert spectrum is not None
        found.append(spectrum.psd[:, 0])
    expected = model_density(AxisResult(1.0 / rate, AxisFit({}, model), name='gyro_x'), spectrum)
    error = np.std(found, axis=0) / np.sqrt(len(found))
    assert np.all(np.abs(np.mean(found, axis=0) - expected) < 5.0 * error)
