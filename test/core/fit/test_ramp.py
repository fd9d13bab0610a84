# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from allan_ros.core.allan.engine import RunningAllan
from allan_ros.core.allan.sums import AllanSums, counts, grid_for
from allan_ros.core.fit.model import DIFFERENCE, phase_covariance
from allan_ros.core.fit.processes import GaussMarkovTerm
from allan_ros.core.fit.ramp import Noise, mean_covariances, ramp_geometry
from allan_ros.core.fit.table import PooledTable
from allan_ros.core.noise import gauss_markov_sums

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
def test_phase_points_are_those_of_the_engine(samples):
    record = one_segment(np.zeros(samples)).segments[0]
    geometry = ramp_geometry(samples)
    assert (geometry.points, geometry.step) == (len(record.phase), record.phase_step)


@pytest.mark.parametrize('variances', POWERS)
def test_best_weights_estimate_only_the_ramp(variances):
    geometry = ramp_geometry(SAMPLES)
    weights = geometry.best_weights(Noise(variances))
    t = np.arange(geometry.points) * float(geometry.step)
    assert weights @ np.ones_like(t) == pytest.approx(0.0, abs=1e-12)
    assert weights @ t == pytest.approx(0.0, abs=1e-9)
    assert weights @ (0.5 * t * t) == pytest.approx(1.0)


@pytest.mark.parametrize('variances', POWERS)
def test_best_weights_have_the_smallest_variance(variances):
    geometry = ramp_geometry(SAMPLES)
    best = geometry.best_weights(Noise(variances))
    variance = geometry.effect(best).variance @ variances
    for other in POWERS:
        assert geometry.effect(
            geometry.best_weights(Noise(other))
        ).variance @ variances >= variance * (1 - 1e-9)


@pytest.mark.parametrize('variances', POWERS)
def test_the_expectation_without_the_ramp_is_exact(variances):
    """The reference sums E (d - r m^2)^2 over all starts, with d and r as weights on the phase."""
    sums = one_segment(np.random.default_rng(0).normal(size=SAMPLES))
    table = PooledTable(sums).table(0, Noise(variances))
    geometry = ramp_geometry(SAMPLES)
    weights = geometry.best_weights(Noise(variances))
    x = np.arange(geometry.points) * geometry.step
    m, stride = grid_for(SAMPLES)
    count = counts(SAMPLES, m, stride)
    at = np.arange(SAMPLES + 1.0)
    covariance = np.tensordot(variances, phase_covariance(at[:, None] - at[None, :]), axes=1)
    for i in np.flatnonzero(np.isin(m, table.m)):
        functionals = np.zeros((count[i], SAMPLES + 1))
        functionals[:, x] -= m[i] ** 2 * weights
        for a, c in enumerate(DIFFERENCE):
            functionals[np.arange(count[i]), np.arange(count[i]) * stride[i] + a * m[i]] += c
        total = np.sum((functionals @ covariance) * functionals)
        want = total / (2.0 * m[i] ** 2 * count[i])
        row = int(np.flatnonzero(table.m == m[i])[0])
        assert table.terms[row] @ variances == pytest.approx(want, rel=1e-3)


def process_covariance(t, time):
    """Return the generalized covariance of the phase of a process of unit variance."""
    slope, size = (float(x[0]) for x in gauss_markov_sums(time))
    t = np.abs(t)
    return -0.5 * (slope * t + size * np.expm1(-t / time))


def mean_functional(samples, lag, stride, count):
    """Return the positions on the phase and the weights of S_i, the mean of d_i / (sqrt 2 m_i)."""
    u = np.arange(count) * stride
    share = np.full(count, 1.0 / (np.sqrt(2.0) * lag * count))
    at = np.concatenate([u, u + lag, u + 2 * lag])
    return at, np.concatenate([c * share for c in DIFFERENCE])


@pytest.mark.parametrize('time', [0.5, 6.0, 40.0, 400.0])
@pytest.mark.parametrize('samples', [100, 181])
def test_effect_on_a_process_is_exact(samples, time):
    geometry = ramp_geometry(samples)
    weights = geometry.best_weights(Noise(np.array([0.0, 1.0, 0.0, 0.0, 0.3]), (time,)))
    effect = geometry.effect(weights, (time, 2.0 * time))
    x = np.arange(geometry.points) * float(geometry.step)
    variance = weights @ process_covariance(x[:, None] - x, time) @ weights
    assert effect.variance[4] == pytest.approx(variance, rel=1e-6)
    m, stride = grid_for(samples)
    count = counts(samples, m, stride)
    every = [mean_functional(samples, *row) for row in zip(m, stride, count)]
    cross = [w @ process_covariance(at[:, None] - x, time) @ weights for at, w in every]
    np.testing.assert_allclose(effect.cross[4], cross, atol=5e-4 * np.max(np.abs(cross)))
    i, j = np.triu_indices(len(m))
    got = mean_covariances(samples, time)
    want = [
        wa @ process_covariance(a[:, None] - b, time) @ wb
        for (a, wa), (b, wb) in ((every[k], every[n]) for k, n in zip(i, j))
    ]
    np.testing.assert_allclose(got, want, atol=(1e-2 if time < 1.0 else 1e-3) * np.max(want))


@pytest.mark.parametrize('time', [2.0**1.5, 2.0**4.25, 2.0**5.625, 2.0**6.625])
def test_moments_without_the_ramp_with_a_process(time):
    """The reference computes expectation and covariance from all differences as weights on the
    phase.
    """
    noise = Noise(np.array([0.0, 1.0, 0.0, 0.0, 0.3]), (time,))
    sums = one_segment(np.random.default_rng(0).normal(size=SAMPLES))
    table = PooledTable(sums).table(0, noise, extras=(GaussMarkovTerm(time),))
    geometry = ramp_geometry(SAMPLES)
    weights = geometry.best_weights(noise)
    x = np.arange(geometry.points) * geometry.step
    m, stride = grid_for(SAMPLES)
    use = np.isin(m, table.m)
    m, stride, count = m[use], stride[use], counts(SAMPLES, m, stride)[use]
    lag = np.arange(SAMPLES + 1.0)[:, None] - np.arange(SAMPLES + 1.0)
    covariance = phase_covariance(lag)[1] + 0.3 * process_covariance(lag, time)
    every = []
    for lag, s, number in zip(m, stride, count):
        functionals = np.zeros((number, SAMPLES + 1))
        functionals[:, x] -= lag**2 * weights
        for a, c in enumerate(DIFFERENCE):
            functionals[np.arange(number), np.arange(number) * s + a * lag] += c
        every.append(functionals / (np.sqrt(2.0) * lag))
    after = [f @ covariance for f in every]
    mean = np.array([np.mean(np.sum(f * a, axis=1)) for f, a in zip(every, after)])
    assert table.terms @ noise.variances == pytest.approx(mean, rel=2e-4)
    want = np.array([[2.0 * np.mean((a @ f.T) ** 2) for f in every] for a in after])
    deviation = np.sqrt(np.diag(want))
    error = (table.covariance(noise.variances) - want) / np.outer(deviation, deviation)
    assert np.max(np.abs(error)) < 0.01


def test_column_of_the_search_is_that_of_the_fit():
    """The column of the search is interpolated between correlation times, that of the fit is
    exact.
    """
    rng = np.random.default_rng(3)
    sums = one_segment(rng.normal(size=3000))
    extras = tuple(GaussMarkovTerm(t) for t in (0.4, 7.0, 90.0, 400.0, 900.0))
    table = PooledTable(sums).table(0, Noise(), extras=extras)
    np.testing.assert_allclose(table.columns(extras), table.terms[:, 4:], rtol=2e-4)


def test_pooled_segments_keep_their_own_ramps():
    rng = np.random.default_rng(1)
    sums = AllanSums.empty(axes=('gyro_x',))
    for s in range(60):
        y = rng.normal(size=400) + rng.normal() * 0.2 * np.arange(400.0)
        segment = one_segment(y)
        sums = sums + segment.__class__(**{**segment.__dict__, 'intervals': 0, 'elapsed_ns': 0})
        assert len(sums.segments) == min(s + 1, 32)
    table = PooledTable(sums).table(0, Noise(POWERS[1]))
    # 60 segments of 400 white samples: the longest factors have few degrees of freedom each, but
    # 60 times as many together; 5 sigma.
    assert np.all(
        np.abs(table.avar / table.terms[:, 1] - 1.0) < 5.0 * np.sqrt(3.0 * table.m / 24000)
    )
