# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy import special

from allan_ros.core.allan.engine import RunningAllan
from allan_ros.core.errors import AllanError
from allan_ros.core.fit import gls
from allan_ros.core.fit.gls_solver import JITTER, NO_MISFIT, Whitening, covariance_at, point_fit
from allan_ros.core.fit.intervals import (
    CoefficientInterval,
    ScoreTest,
    coefficient_interval,
    find_crossing,
    limit_of_averages,
    normal_deviate,
)
from allan_ros.core.fit.model import B, K, N
from allan_ros.core.fit.table import PooledTable
from allan_ros.core.simulate import NoiseTerms, simulate_axis


@pytest.fixture(scope='module')
def fit():
    """Ten minutes of white noise and a walk that shows, at 100 Hz."""
    engine = RunningAllan(axes=('gyro_x',))
    rng = np.random.default_rng(11)
    y = simulate_axis(60000, 0.01, NoiseTerms(N=1e-3, K=3e-4), rng)
    engine.update(y[:, None], 0, 599_990_000_000)
    engine.end_segment()
    return point_fit(PooledTable(engine.sums), 0)


@pytest.mark.parametrize('freedom', [6.0, 15.0, 60.0])
@pytest.mark.parametrize('tail', [0.01, 0.05, 0.5, 0.95, 0.975])
def test_chi_squared_becomes_normal(freedom, tail):
    z = (special.chdtri(freedom, 1.0 - tail) - freedom) / np.sqrt(2.0 * freedom)
    assert normal_deviate(z, np.sqrt(8.0 / freedom)) == pytest.approx(special.ndtri(tail), abs=0.08)


def test_without_skewness_nothing_changes():
    assert normal_deviate(1.7, 0.0) == 1.7
    assert normal_deviate(1.7, 2e-3) == pytest.approx(1.7, abs=1e-3)


@pytest.mark.parametrize('outer', [1.1, 2.0, 50.0])
def test_the_end_is_found_from_any_first_guess(outer):
    up, down = [(1.0, -1.0)], [(-1.0, 1.0)]
    assert find_crossing(lambda c: -(c**3), -27.0, up, outer, np.inf) == pytest.approx(
        3.0, abs=1e-3
    )
    assert find_crossing(lambda c: -(c**3), 27.0, down, -outer, -np.inf) == pytest.approx(
        -3.0, abs=1e-3
    )


def test_two_evaluations_suffice_for_a_linear_standard_error():
    asked = []

    def z(c):
        asked.append(c)
        return (5.0 - c) / (1.0 + 0.3 * c)

    end = (5.0 + 1.96) / (1.0 - 0.3 * 1.96)
    known = [(0.0, 5.0), (5.0, 0.0)]
    assert find_crossing(z, -1.96, known, 9.0, np.inf) == pytest.approx(end, rel=1e-9)
    assert len(asked) == 2


def test_the_end_is_at_a_jump_of_z_over_its_target():
    end = find_crossing(lambda c: 1.0 - c - (c > 2.5), -2.0, [(0.0, 1.0)], 1.0, np.inf)
    assert end == pytest.approx(2.5, rel=1e-3)
    end = find_crossing(lambda c: -1.0 - 5.0 * (c > 0.0), -2.0, [(0.0, -1.0)], 1.0, np.inf)
    assert end == pytest.approx(0.0, abs=1e-6)
    assert find_crossing(lambda c: -1.0, -2.0, [(0.0, -1.0)], 0.0, np.inf) == 0.0


def test_a_bound_that_is_never_reached_is_the_limit():
    assert find_crossing(lambda c: -np.arctan(c), -5.0, [(0.0, 0.0)], 1.0, np.inf) == np.inf
    assert find_crossing(lambda c: -c, -5.0, [(0.0, 0.0)], 1.0, 2.0) == 2.0


@pytest.mark.parametrize('term', [N, K])
def test_interval_ends_are_roots_of_the_score(fit, term):
    interval = coefficient_interval(fit.table, term, fit.variances)
    assert interval.observable
    assert interval.low < fit.variances[term] < interval.high
    score = ScoreTest(fit.table, term, fit.variances)
    assert score(interval.high) == pytest.approx(-1.96, abs=3e-3)
    assert score(interval.low) == pytest.approx(1.96, abs=3e-3)


def test_an_interval_contains_the_value_also_at_zero():
    # Two hours of the paper's z gyro: held at zero, K is estimated at 2.3 times its value.
    axis_seed = np.random.SeedSequence(0).spawn(2)[0].spawn(6)[2]
    terms = NoiseTerms(Q=1e-7, N=7.13e-5, B=2.94e-5, K=4.09e-6, R=8.92e-8)
    y = simulate_axis(720_000, 0.01, terms, np.random.default_rng(axis_seed))
    engine = RunningAllan(axes=('gyro_z',))
    engine.update(y[:, None], 0, 7_199_990_000_000)
    engine.end_segment()
    fit = point_fit(PooledTable(engine.sums), 0)
    at_zero = ScoreTest(fit.table, K, fit.variances)
    at_zero(0.0)
    assert at_zero.estimate > 2.0 * fit.variances[K]
    interval = coefficient_interval(fit.table, K, fit.variances)
    assert interval.low < 0.7 * fit.variances[K] < 1.5 * fit.variances[K] < interval.high
    assert interval.high < at_zero.estimate


def test_an_absent_term_has_an_upper_limit(fit):
    interval = coefficient_interval(fit.table, B, fit.variances)
    assert not interval.observable
    assert interval.low == 0.0
    assert 0.0 < interval.high < np.inf


@pytest.mark.parametrize(
    ('truth', 'term'), [(NoiseTerms(N=1e-3, K=1e-3), K), (NoiseTerms(N=1e-3, B=1e-3), B)]
)
def test_the_limit_of_the_averages_is_above_the_truth(truth, term):
    """At most one of 40 records may have a lower limit; none of these 20 at fixed seeds."""
    size = truth.K if term == K else truth.B
    for seed in range(20):
        engine = RunningAllan(axes=('gyro_x',))
        y = simulate_axis(4000, 1.0, truth, np.random.default_rng(seed))
        engine.update(y[:, None], 0, 3999 * 10**9)
        engine.end_segment()
        limit = limit_of_averages(PooledTable(engine.sums).table(0), term, 4000)
        assert size < np.sqrt(limit) < 2.0 * size


def test_a_term_whose_test_rejects_no_value_has_a_limit(monkeypatch):
    """Regression: K had neither a value nor a limit next to two Gauss-Markov processes."""
    monkeypatch.setattr(
        gls, 'coefficient_interval', lambda *_: CoefficientInterval(0.0, 0.0, np.inf)
    )
    engine = RunningAllan(axes=('gyro_x',))
    y = simulate_axis(4000, 1.0, NoiseTerms(N=1e-3, K=1e-4), np.random.default_rng(0))
    engine.update(y[:, None], 0, 3999 * 10**9)
    engine.end_segment()
    noise = gls.fit_gls(engine.sums).axes['gyro_x'].noise
    assert all(noise[term].upper95 for term in 'NBK')
    assert 1e-4 < noise['K'].upper95 < 1e-3


@pytest.mark.parametrize('factor', [30.0, 1e4])
def test_the_covariance_of_a_distant_random_walk_is_valid(fit, factor):
    """The weights of the ramps were computed for another random walk."""
    variances = fit.variances * np.array([1.0, 1.0, 1.0, factor])
    covariance = covariance_at(fit.table, variances, NO_MISFIT)
    deviation = np.sqrt(np.diag(covariance))
    assert np.linalg.eigvalsh(covariance / np.outer(deviation, deviation))[0] > -JITTER


def test_an_indefinite_matrix_is_replaced_by_the_nearest_covariance():
    correlation = np.array([[1.0, 0.9, 0.5], [0.9, 1.0, 0.9], [0.5, 0.9, 1.0]])
    least = np.linalg.eigvalsh(correlation)[0]
    assert least < -JITTER
    lower = Whitening.of(correlation).lower
    change = np.linalg.norm(lower @ lower.T - correlation, 2)
    assert change == pytest.approx(JITTER - least, rel=1e-6)


def test_z_decreases_with_the_tested_value(fit):
    score = ScoreTest(fit.table, K, fit.variances)
    z = [score(fit.variances[K] * factor) for factor in (1.0, 2.0, 5.0, 10.0, 30.0, 100.0, 1e3)]
    assert np.all(np.diff(z) < 0.0)


@pytest.mark.parametrize('wrong', [np.nan, np.inf, 1e30])
def test_an_invalid_covariance_is_rejected(wrong):
    with np.errstate(all='ignore'), pytest.raises(AllanError, match='accumulate them again'):
        Whitening.of(np.array([[1.0, wrong, 0.0], [wrong, 1.0, 0.0], [0.0, 0.0, 1.0]]))
