# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import math
from dataclasses import replace

import numpy as np
import pytest
from support.sums import sums_of

from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.errors import AllanError
from allan_ros.core.fit.least_squares import fit_curve, fit_paper
from allan_ros.core.fit.result import TERMS
from allan_ros.core.fit.stationary import fit_stationary
from allan_ros.core.imu import from_datasheet
from allan_ros.core.noise import FLICKER_FLOOR, Model
from allan_ros.core.simulator import simulate_axis
from allan_ros.view.finding_text import texts_of

AXES = ('gyro_x', 'accel_z')
TRUTH = Model.of(Q=4e-6, N=7e-5, B=2.5e-5, K=2.6e-6, R=1e-7)


@pytest.fixture(scope='module')
def white():
    """An hour of white noise at 100 Hz."""
    rng = np.random.default_rng(2)
    return sums_of(np.stack([simulate_axis(360000, 0.01, Model.of(N=1e-3), rng)] * 2, 1), axes=AXES)


def with_curve(sums, variance):
    """The sums with another curve, given as a function of tau, in groups and overlapped."""
    v = variance(sums.m * sums.tau0)[:, None] * np.ones(len(sums.axes))
    m2 = 2.0 * sums.m[:, None].astype(float) ** 2
    return replace(
        sums,
        sum_sq=v * m2 * sums.count[:, None],
        group_sum_sq=v * m2 * sums.group_count[:, None],
    )


def polynomial(terms, tau):
    q, n, b, k, r = map(terms.value, 'QNBKR')
    flicker = 2 * math.log(2) / math.pi * b * b
    return 3 * q * q / tau**2 + n * n / tau + flicker + k * k * tau / 3 + r * r * tau**2 / 2


def test_paper_finds_the_coefficients_of_its_polynomial(white):
    fit = fit_paper(with_curve(white, lambda tau: polynomial(TRUTH, tau)))
    assert fit.method == 'paper'
    for axis in AXES:
        found = [fit.axes[axis].noise[term].value for term in TERMS]
        np.testing.assert_allclose(found, [TRUTH.value(t) for t in TERMS], rtol=1e-5)
        assert all(fit.axes[axis].noise[term].ci95 is None for term in TERMS)


def test_paper_reports_a_negative_coefficient_without_a_value(white):
    k2 = TRUTH.value('K') ** 2 / 3
    bent = with_curve(white, lambda tau: polynomial(TRUTH, tau) - 2 * k2 * tau)
    fit = fit_paper(bent)
    walk = fit.axes['gyro_x'].noise['K']
    assert (walk.value, walk.status) == (None, 'not_observable')
    assert fit.axes['gyro_x'].noise['N'].value == pytest.approx(TRUTH.value('N'), rel=1e-5)
    said = [f for f in fit.findings if f.id == 'negative_coefficient']
    assert [f.axes for f in said] == [('gyro_x',), ('accel_z',)]
    assert 'gives a negative variance for K' in texts_of(said[0]).message


def test_paper_uses_averages_up_to_1300_s(white):
    """The curve beyond is far above the polynomial."""
    bent = with_curve(white, lambda tau: polynomial(TRUTH, tau) * np.where(tau > 1300.0, 9.0, 1.0))
    fit = fit_paper(bent)
    assert fit.axes['gyro_x'].noise['K'].value == pytest.approx(TRUTH.value('K'), rel=1e-5)


@pytest.mark.parametrize('sign', [1, -1])
def test_a_ramp_keeps_its_sign(sign):
    rng = np.random.default_rng(4)
    terms = Model.of(N=1e-4, R=sign * from_datasheet('R', 'gyro', 2000.0))
    y = np.stack([simulate_axis(180000, 0.01, terms, rng)] * 2, 1)
    fit = fit_paper(sums_of(y, axes=AXES))
    ramp = fit.axes['gyro_x'].noise['R']
    assert ramp.value == pytest.approx(terms.value('R'), rel=0.1)


def test_short_or_constant_records_have_no_coefficients():
    for y in (np.random.default_rng(0).standard_normal((6, 2)), np.full((1000, 2), 9.81)):
        fit = fit_paper(sums_of(y, axes=AXES))
        assert all(c.value is None for axis in AXES for c in fit.axes[axis].noise.values())
        assert len(y) > 6 or {f.id for f in fit.findings} == {'too_few_points'}


def test_unknown_methods_and_empty_sums_are_rejected(white):
    with pytest.raises(AllanError, match='choose one of likelihood, paper'):
        fit_stationary(white, 'magic')
    with pytest.raises(AllanError, match='at least two samples'):
        fit_paper(AllanSums.empty())


@pytest.mark.parametrize('adev', [1e-29, 1e29])
@pytest.mark.parametrize('tau', [(1.1e-12, 1e-9), (1e-12, 1e12), (1e9, 9e11)])
def test_a_curve_of_extreme_numbers_is_fitted(tau, adev):
    taus = np.geomspace(*tau, 200)
    fit = fit_curve(taus, np.full(len(taus), adev))
    assert fit.noise['B'].value == pytest.approx(adev / math.sqrt(FLICKER_FLOOR), rel=1e-3)


def test_a_curve_of_impossible_numbers_has_no_points():
    tau = np.geomspace(1.0, 1000.0, 40)
    for curve in ((tau * 1e180, tau), (tau * 1e-200, tau), (tau, tau * 1e149), (tau, tau * 1e-150)):
        with pytest.raises(AllanError, match='0 usable points'):
            fit_curve(*curve)
