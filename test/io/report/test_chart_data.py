# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bias and noise over time, and bias against temperature, as the page draws them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import allan_ros as ar
from allan_ros.io.report.chart_data import trends
from allan_ros.io.results import Results
from allan_ros.io.signal import SignalTemperature, summarize_signal

RATE, SECONDS, DRIFT, DENSITY = 50.0, 600.0, 2e-5, 1e-4


@pytest.fixture(scope='module')
def drifting() -> Results:
    """Return a gyro whose x axis drifts evenly and whose y noise grows in the second half."""
    n = int(RATE * SECONDS)
    noise = np.random.default_rng(8).normal(size=(n, 3)) * DENSITY * np.sqrt(RATE)
    noise[n // 2 :, 1] *= 1.5
    noise[:, 0] += DRIFT * np.arange(n) / RATE
    return ar.analyze(noise, rate=RATE, axes='gyro')


def test_bias_and_noise_are_shown_as_they_were(drifting: Results) -> None:
    bias, noise = trends(drifting, 'gyro', None)
    assert [line['name'] for line in bias['lines']] == ['gyro_x', 'gyro_y', 'gyro_z']
    means = np.array(bias['lines'][0]['values'], float)  # NaN where a cell has few samples
    known = np.isfinite(means)
    slope = np.polyfit(np.array(bias['x'])[known], means[known], 1)[0]
    # the slope scatters by 0.25 % of this drift, so that this fails once in 10^15
    assert slope == pytest.approx(DRIFT, rel=0.02)
    assert bias['x'][0] < 10.0 and bias['x'][-1] == pytest.approx(SECONDS, rel=0.02)
    levels = np.array(noise['lines'][1]['values'], float)
    late = np.array(noise['x']) > SECONDS / 2.0
    # 500 independent differences a half: 3 % scatter of each mean, eight times less than the bound
    first, second = (np.sqrt(np.nanmean(levels[part] ** 2)) for part in (~late, late))
    assert first == pytest.approx(DENSITY / np.sqrt(noise['span']), rel=0.25)
    assert second / first == pytest.approx(1.5, rel=0.25)


def test_a_recorded_temperature_gives_the_slope_of_the_bias(drifting: Results) -> None:
    recorded = drifting.recorded
    assert recorded is not None
    summary = summarize_signal(recorded.signals, drifting.provenance.segments, 100)
    assert summary is not None
    time = np.array([0.0, SECONDS])
    heated = SignalTemperature('/temp', time, 20.0 + time / 60.0)  # a degree a minute
    summary = replace(summary, temperature=heated)
    kinds = {trend['kind']: trend for trend in trends(drifting, 'gyro', summary)}
    assert list(kinds) == ['bias', 'temperature', 'noise']
    assert kinds['temperature']['x'] == sorted(kinds['temperature']['x'])
    assert kinds['temperature']['slopes'][0] == pytest.approx(60.0 * DRIFT, rel=0.02)


def test_results_without_sums_have_no_trends(drifting: Results) -> None:
    assert trends(replace(drifting, recorded=None), 'gyro', None) == []
    assert trends(drifting, 'accel', None) == []
