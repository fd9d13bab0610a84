# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Long records without gaps, and clean records whose long averages are low by chance."""

import numpy as np
import pytest

from allan_ros.core.allan.engine import RunningAllan
from allan_ros.core.fit.gls import fit_gls
from allan_ros.core.fit.gls_solver import point_fit
from allan_ros.core.fit.goodness import DEFICIT_LIMIT, long_tau_deficit
from allan_ros.core.fit.table import PooledTable
from allan_ros.core.imu import AXES
from allan_ros.core.simulate import NoiseTerms, simulate_axis


def sums_of_noise(samples, tau0, terms, seed):
    """Return the sums of six independent records of the same noise."""
    rng = np.random.default_rng(seed)
    rows = np.stack([simulate_axis(samples, tau0, terms, rng) for _ in AXES], axis=1)
    engine = RunningAllan(axes=AXES)
    engine.update(rows, 0, round((samples - 1) * tau0 * 1e9))
    engine.end_segment()
    return engine.sums


def test_the_ramp_is_included_at_every_factor_of_a_long_record():
    """The random walk dominates far below a thousandth of the record; chi^2 rejects one axis in
    700.
    """
    truth = NoiseTerms(N=5e-5, B=6e-6, K=5e-7)
    axes = fit_gls(sums_of_noise(600_000, 1.0, truth, 42)).axes
    assert max(fit.gof_z for fit in axes.values()) < 3.0
    assert all(fit.sinusoid is None and fit.misfit == 0.0 for fit in axes.values())
    # six 95 % intervals: fewer than four hold the truth with a probability of 1/700
    held = [fit.noise['K'].ci95[0] < truth.K < fit.noise['K'].ci95[1] for fit in axes.values()]
    assert sum(held) >= 4


@pytest.mark.parametrize('terms', [NoiseTerms(N=1e-3), NoiseTerms(N=1e-3, B=3e-4)])
def test_long_averages_are_rarely_low_without_a_walk(terms):
    """120 records with 0.1 % false alarms each: more than two have a probability of 1/450."""
    low = 0
    for seed in range(20):
        sums = sums_of_noise(7200, 1.0, terms, seed)
        fits = [point_fit(PooledTable(sums), axis) for axis in range(6)]
        low += sum(long_tau_deficit(f.table, f.variances) < DEFICIT_LIMIT for f in fits)
    assert low <= 2
