# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from allan_ros.core.allan.engine import RunningAllan
from allan_ros.core.fit.gls_solver import NO_MISFIT, point_fit, solve
from allan_ros.core.fit.goodness import (
    DEFICIT_LIMIT,
    goodness,
    long_tau_deficit,
    misfit_of_long_averages,
    misfit_of_table,
)
from allan_ros.core.fit.table import PooledTable
from allan_ros.core.simulate import NoiseTerms, simulate_axis

TAU0 = 0.01


def fit_of(seed, samples=20000, terms=NoiseTerms(N=1e-3, B=3e-4)):
    engine = RunningAllan(axes=('gyro_x',))
    rng = np.random.default_rng(seed)
    y = simulate_axis(samples, TAU0, terms, rng)
    engine.update(y[:, None], 0, round((samples - 1) * TAU0 * 1e9))
    engine.end_segment()
    return point_fit(PooledTable(engine.sums), 0)


def test_the_exact_model_has_no_residual():
    fit = fit_of(0)
    table = replace(fit.table, avar=fit.table.terms @ fit.variances)
    assert goodness(table, fit.variances).chi_squared < 1e-6


def test_chi_squared_of_simulated_noise_is_as_expected():
    """40 records: the mean of z is 0 within 4 standard errors (false alarm 6e-5)."""
    z = []
    for seed in range(40):
        fit = fit_of(seed)
        z.append(goodness(fit.table, fit.variances).z)
    assert abs(np.mean(z)) < 4.0 / np.sqrt(40)
    assert 0.5 < np.std(z) < 1.7


@pytest.mark.parametrize('error', [0.03, 0.2])
def test_the_misfit_equals_the_simulated_error(error):
    fit = fit_of(1, 400000)
    rng = np.random.default_rng(2)
    wrong = 1.0 + error * rng.standard_normal(len(fit.table.m))
    table = replace(fit.table, avar=fit.table.avar * np.abs(wrong))
    assert goodness(table, fit.variances).fails
    misfit = misfit_of_table(table, fit.variances, signed=False)
    assert 0.5 * error < misfit.size < 1.6 * error
    loose = goodness(table, fit.variances, misfit)
    assert loose.chi_squared < 2.0 * loose.freedom


@pytest.mark.parametrize('terms', [NoiseTerms(N=1e-3, B=3e-4), NoiseTerms(N=1e-3, K=2e-3)])
def test_long_averages_of_simulated_noise_have_no_deficit(terms):
    """40 records each. The fit follows their long averages, so none comes near the limit."""
    fits = [fit_of(seed, terms=terms) for seed in range(40)]
    assert min(long_tau_deficit(f.table, f.variances) for f in fits) > DEFICIT_LIMIT


def test_a_curve_that_levels_off_has_a_deficit_without_a_model_error():
    fit = fit_of(3, samples=200_000, terms=NoiseTerms(N=1e-3, K=2e-3))
    model = fit.table.terms @ fit.variances
    bend = len(model) - 32
    level = np.where(np.arange(len(model)) < bend, model, model[bend])
    table = replace(fit.table, avar=level)
    assert long_tau_deficit(table, fit.variances) < DEFICIT_LIMIT - 1.0
    eps = misfit_of_long_averages(table, fit.variances, False, NO_MISFIT)
    assert 0.0 < eps.size < 1.0
    assert eps.m_min > 1000  # only long averages have the error
    again = solve(table, fit.variances, misfit=eps).variances
    assert (
        long_tau_deficit(table, again, eps) > DEFICIT_LIMIT - 0.1
    )  # the fit ends where it began, to its tolerance
