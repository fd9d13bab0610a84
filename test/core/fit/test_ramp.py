# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from allan_ros.core.allan.engine import RunningAllan
from allan_ros.core.allan.sums import AllanSums, counts, grid_for
from allan_ros.core.fit.model import DIFFERENCE, phase_covariance
from allan_ros.core.fit.ramp import ramp_geometry
from allan_ros.core.fit.table import PooledTable

SAMPLES = 300
POWERS = np.array(
    [[3.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 1.0, 0.1, 0.0], [0, 1, 0.1, 0.01]]
)


def one_segment(y):
    engine = RunningAllan(axes=('gyro_x',))
    engine.update(np.reshape(y, (-1, 1)), 0, len(y) - 1)
    engine.end_segment()
    return engine.sums


@pytest.mark.parametrize('samples', [2, 7, 127, 128, 129, 5000])
def test_points_are_those_the_engine_keeps(samples):
    record = one_segment(np.zeros(samples)).segments[0]
    geometry = ramp_geometry(samples)
    assert (geometry.points, geometry.step) == (len(record.phase), record.phase_step)


@pytest.mark.parametrize('power', POWERS)
def test_best_weights_find_a_ramp_and_nothing_else(power):
    geometry = ramp_geometry(SAMPLES)
    weights = geometry.best_weights(power)
    t = np.arange(geometry.points) * float(geometry.step)
    assert weights @ np.ones_like(t) == pytest.approx(0.0, abs=1e-12)
    assert weights @ t == pytest.approx(0.0, abs=1e-9)
    assert weights @ (0.5 * t * t) == pytest.approx(1.0)


@pytest.mark.parametrize('power', POWERS)
def test_no_other_weights_are_better(power):
    geometry = ramp_geometry(SAMPLES)
    best = geometry.best_weights(power)
    variance = geometry.effect(best).variance @ power
    for other in POWERS:
        assert geometry.effect(geometry.best_weights(other)).variance @ power >= variance * (
            1 - 1e-9
        )


@pytest.mark.parametrize('power', POWERS)
def test_expectation_less_the_ramp_is_exact(power):
    """sum over starts of E (d - r m^2)^2, every d and r as weights on the phase."""
    sums = one_segment(np.random.default_rng(0).normal(size=SAMPLES))
    table = PooledTable(sums).table(0, power)
    geometry = ramp_geometry(SAMPLES)
    weights = geometry.best_weights(power)
    x = np.arange(geometry.points) * geometry.step
    m, stride = grid_for(SAMPLES)
    count = counts(SAMPLES, m, stride)
    at = np.arange(SAMPLES + 1.0)
    covariance = np.tensordot(power, phase_covariance(at[:, None] - at[None, :]), axes=1)
    for i in np.flatnonzero(np.isin(m, table.m)):
        functionals = np.zeros((count[i], SAMPLES + 1))
        functionals[:, x] -= m[i] ** 2 * weights
        for a, c in enumerate(DIFFERENCE):
            functionals[np.arange(count[i]), np.arange(count[i]) * stride[i] + a * m[i]] += c
        total = np.sum((functionals @ covariance) * functionals)
        want = total / (2.0 * m[i] ** 2 * count[i])
        row = int(np.flatnonzero(table.m == m[i])[0])
        # The sum over starts is taken as an integral: 1 % off in so short a record.
        assert table.terms[row] @ power == pytest.approx(want, rel=0.012)


def test_pooled_segments_keep_their_own_ramps():
    rng = np.random.default_rng(1)
    sums = AllanSums.empty(axes=('gyro_x',))
    for s in range(60):
        y = rng.normal(size=400) + rng.normal() * 0.2 * np.arange(400.0)
        segment = one_segment(y)
        sums = sums + segment.__class__(**{**segment.__dict__, 'intervals': 0, 'elapsed_ns': 0})
        assert len(sums.segments) == min(s + 1, 32)
    table = PooledTable(sums).table(0, POWERS[1])
    # 60 segments of 400 white samples: the longest factors have few degrees of freedom each, but
    # 60 times as many together; 5 sigma.
    assert np.all(
        np.abs(table.avar / table.terms[:, 1] - 1.0) < 5.0 * np.sqrt(3.0 * table.m / 24000)
    )
