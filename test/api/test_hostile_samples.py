# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Impossible samples and stamps: the valid data are analyzed and drawn, or one line states the
error.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import allan_ros as ar
from allan_ros.core.imu import ImuBatch

ROW, N = 700, 3600


def at_one_row(value: float) -> Callable[[ImuBatch], None]:
    def change(batch: ImuBatch) -> None:
        batch.samples[ROW, 2] = value

    return change


def a_sensor(value: float) -> Callable[[ImuBatch], None]:
    def change(batch: ImuBatch) -> None:
        batch.samples[:, 3:] = value

    return change


def the_first(batch: ImuBatch) -> None:
    batch.samples[0] = np.inf


def wild_stamps(batch: ImuBatch) -> None:
    batch.stamps_ns[:] = np.random.default_rng(0).integers(-(2**61), 2**61, len(batch))


HOSTILE = {
    **{str(v): at_one_row(v) for v in (np.inf, np.nan, -1.7e308, 1e29)},
    **{f'accel {v}': a_sensor(v) for v in (np.inf, 1.7e308, 0.0)},
    'first': the_first,
    'stamps': wild_stamps,
}


@pytest.mark.parametrize('name', HOSTILE)
def test_the_rest_is_analyzed_and_drawn(name: str, tmp_path: Path) -> None:
    batch = ar.simulate(hours=N / 50 / 3600, rate=50, seed=1)
    HOSTILE[name](batch)
    results = ar.analyze(batch, method='paper')
    assert 'allan_gyro.png' in {path.name for path in results.save(tmp_path, plots=('png',))}
    assert results.samples <= N


@pytest.mark.parametrize('stamp', [-(2**63), 2**63 - 1])
def test_impossible_times_are_rejected(stamp: int) -> None:
    batch = ar.simulate(hours=0.01, rate=50)
    batch.stamps_ns[3] = stamp
    with pytest.raises(ar.AllanError, match='check their unit'):
        ar.analyze(batch)


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_an_axis_without_a_finite_value_is_reported(value: float) -> None:
    samples = np.random.default_rng(0).normal(size=(2000, 3))
    samples[:, 1] = value
    results = ar.analyze(samples, rate=100.0)
    assert list(results) == ['gyro_x', 'gyro_z']
    assert [f.axes for f in results.findings if f.id == 'axis_absent'] == [('gyro_y',)]
    others = ar.analyze(samples[:, ::2], rate=100.0, axes=['gyro_x', 'gyro_z'])
    assert 'axis_absent' not in {f.id for f in others.findings}


def test_masked_values_are_not_samples() -> None:
    samples = np.ma.masked_greater(np.random.default_rng(0).normal(size=2000), 2.0)
    found = {f.id for f in ar.analyze(samples, rate=100.0).findings}
    assert found & {'not_finite', 'interpolated'}


def test_durations_are_times() -> None:
    pd = pytest.importorskip('pandas', reason='skipped: no pandas')
    samples = pd.DataFrame({'gyro_x': np.random.default_rng(0).normal(size=2000)})
    at = pd.to_timedelta(np.arange(2000) * 0.02, unit='s')
    assert ar.analyze(samples.set_index(at)).rate_hz == pytest.approx(50.0)
    assert ar.analyze(samples.assign(time=at)).rate_hz == pytest.approx(50.0)
