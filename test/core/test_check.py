# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two runs differ only if the difference is significant, whatever the number of comparisons."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtr

from allan_ros.core.allan.curve import AxisCurve, chi_squared_limits
from allan_ros.core.check import (
    FAMILY_ERROR,
    AxisNoise,
    Check,
    _term_difference,
    _with_verdicts,
    check_limits,
    differences,
)
from allan_ros.core.estimate import Estimate
from allan_ros.core.fit.result import TERMS

UNSEEN = Estimate(None, None, 0.5, 'not_observable')


def compare(first: Estimate, second: Estimate) -> Check:
    """Return the difference of N as the only comparison, so without correction for several
    tests.
    """
    others = {term: Estimate(None) for term in TERMS}
    runs = ({'gyro_x': AxisNoise(others | {'N': c}, None)} for c in (first, second))
    [found] = differences([('May', *runs)])
    return next(d for d in found if d.quantity == 'N')


def of_curves(*curves: AxisCurve) -> tuple[Check, ...]:
    [found] = differences([('May', *({'gyro_x': AxisNoise(None, c)} for c in curves))])
    return found


def curve(adev: np.ndarray, edf: np.ndarray, tau: np.ndarray) -> AxisCurve:
    unused = np.zeros(len(tau), np.int64)
    return AxisCurve(unused, tau, unused, adev, *chi_squared_limits(adev**2, edf))


@pytest.mark.parametrize(
    'first, second, expected',
    [
        (Estimate(1.0, (0.99, 1.01)), Estimate(1.5, (1.48, 1.52)), 'higher'),
        (Estimate(1.5, (1.48, 1.52)), Estimate(1.0, (0.99, 1.01)), 'lower'),
        (Estimate(1.0, (0.9, 1.1)), Estimate(1.12, (1.0, 1.25)), 'alike'),
        (Estimate(3.0, (2.7, 3.3)), UNSEEN, 'lower'),
        (UNSEEN, Estimate(3.0, (2.7, 3.3)), 'higher'),
        (UNSEEN, Estimate(0.6, (0.3, 0.9)), 'undecided'),
        (UNSEEN, UNSEEN, 'undecided'),
        (Estimate(1.0), Estimate(9.0), 'undecided'),
        (Estimate(1.0, (0.0, 2.0)), Estimate(9.0, (8.9, 9.1)), 'undecided'),
    ],
)
def test_verdicts(first, second, expected):
    assert compare(first, second).verdict == expected


def test_the_ratio_has_the_widths_that_face():
    """Zou & Donner: the lower limit has the lower width of one and the upper width of the other."""
    d = compare(Estimate(1.0, (0.8, 1.1)), Estimate(2.0, (1.6, 3.0)))
    low, high = d.ratio.ci95
    assert d.ratio.value == pytest.approx(2.0)
    whole = math.log(3.0 / 1.6) / 2, math.log(1.1 / 0.8) / 2
    assert math.log(2.0 / low) == pytest.approx(math.hypot(whole[0], whole[1]))
    assert math.log(high / 2.0) == pytest.approx(math.hypot(math.log(1.5), math.log(1.25)))


def test_an_estimate_at_the_end_of_its_interval_is_not_known_the_better():
    d = compare(Estimate(1.0, (0.98, 1.0001)), Estimate(1.005, (1.0, 1.01)))
    assert d.verdict == 'alike'
    assert d.p > 0.3


def test_the_comparison_is_symmetric():
    a, b = Estimate(1.0, (0.8, 1.1)), Estimate(2.0, (1.6, 3.0))
    there, back = compare(a, b), compare(b, a)
    assert there.ratio.value == pytest.approx(1 / back.ratio.value)
    assert there.ratio.ci95 == pytest.approx([1 / end for end in reversed(back.ratio.ci95)])
    assert there.p == pytest.approx(back.p)
    assert compare(a, UNSEEN).p == pytest.approx(compare(UNSEEN, a).p)


def test_a_limit_leaves_the_ratio_open_at_one_end():
    assert compare(Estimate(1.0, (0.8, 1.1)), UNSEEN).ratio.ci95 == pytest.approx((0.0, 0.5 / 0.8))
    d = compare(UNSEEN, Estimate(1.0, (0.8, 1.1)))
    assert d.ratio.value is None and d.ratio.ci95 == (pytest.approx(1.6), math.inf)


@pytest.mark.parametrize(('term', 'z'), [('N', 1.96 * 2.0**2), ('R', 1.96 * 2.0)])
def test_the_p_value_of_a_limit_follows_from_what_has_normal_errors(term, z):
    """A known value of twice the limit: the squares of coefficients are estimated, but R itself."""
    exact = Estimate(1.0, (1.0, 1.0))
    hidden = Estimate(None, upper95=0.5, status='not_observable')
    check = _term_difference('gyro_x', term, '', exact, hidden)
    assert check.p == pytest.approx(4.0 * ndtr(-z), rel=1e-6)


def test_holm_by_hand():
    """p of 0.01, 0.03, 0.04 and 0.005 at 5 %: limits are 0.05/4, /3, /2, /1."""
    twice = Estimate(2.0, (1.5, 3.0))
    raw = [Check('gyro_x', 'N', ratio=twice, p=p) for p in (0.01, 0.03, 0.04, 0.005)]
    assert [d.verdict for d in _with_verdicts(raw, 0.05)] == ['higher', 'alike', 'alike', 'higher']
    assert [d.verdict for d in _with_verdicts(raw, 0.2)] == ['higher'] * 4
    assert differences([]) == []


def test_curves_are_compared_where_both_have_data():
    tau = np.geomspace(0.01, 100.0, 60)
    edf = 1000.0 / tau
    a, b = curve(tau**-0.5, edf, tau), curve(2.0 * tau[10:] ** -0.5, edf[10:], tau[10:])
    found = of_curves(a, b)
    times = [d.tau for d in found]
    assert times[0] == pytest.approx(tau[10])
    assert times[-1] <= tau[-1] and np.diff(np.log(times)) == pytest.approx(math.log(4.0))
    assert [d.ratio.value for d in found] == pytest.approx([2.0] * len(found), rel=1e-6)
    assert all(d.ratio.ci95[0] < 2.0 < d.ratio.ci95[1] for d in found)
    assert found[0].verdict == 'higher'
    nothing = curve(np.full(60, np.nan), edf, tau)
    assert of_curves(a, nothing) == ()


def test_runs_of_equal_noise_rarely_differ():
    """400 pairs of 20 deviations: more than 35 false alarms have a probability of 0.1 %."""
    rng = np.random.default_rng(8)
    tau = 4.0 ** np.arange(20)
    edf = np.geomspace(1e5, 4.0, 20)
    alarms = 0
    for _ in range(400):
        a, b = (curve(np.sqrt(rng.chisquare(edf) / edf), edf, tau) for _ in range(2))
        found = of_curves(a, b)
        assert len(found) == 20
        alarms += any(d.verdict != 'alike' for d in found)
    assert 5 <= alarms <= 35
    assert FAMILY_ERROR == 0.05


def test_all_pairs_are_one_family():
    """A p of 1 % is significant alone, but not as one of ten pairs."""
    tau = np.array([1.0, 4.0])
    edf = np.array([200.0, 200.0])
    a, b = curve(np.ones(2), edf, tau), curve(np.array([1.2, 1.0]), edf, tau)
    assert [d.verdict for d in of_curves(a, b)] == ['higher', 'alike']
    pair = 'May', {'gyro_x': AxisNoise(None, a)}, {'gyro_x': AxisNoise(None, b)}
    assert {d.verdict for of_pair in differences([pair] * 10) for d in of_pair} == {'alike'}


@pytest.mark.parametrize(
    'second, expected',
    [
        (Estimate(1.0, (0.95, 1.05)), 'within'),
        (Estimate(1.15, (1.13, 1.17)), 'within'),  # significant, within the margin
        (Estimate(1.5, (1.45, 1.55)), 'exceeds'),
        (Estimate(0.5, (0.45, 0.55)), 'within'),
        (Estimate(1.5, (0.8, 2.2)), 'within'),  # not significant
        (Estimate(None, None, 0.9, 'not_observable'), 'within'),
        (Estimate(None, None, 5.0, 'not_observable'), 'undecided'),
        (Estimate(None), None),
    ],
)
def test_an_earlier_run_is_exceeded_only_significantly_and_by_the_margin(second, expected):
    found = compare(Estimate(1.0, (0.98, 1.02)), second).as_limit(0.2)
    known = found and (found.reference, found.quantity, found.verdict)
    assert known == (expected and ('May', 'N', expected))


@pytest.mark.parametrize(
    'coefficient, expected',
    [
        (Estimate(0.9, (0.8, 1.0)), 'within'),
        (Estimate(1.1, (1.0, 1.2)), 'within'),  # by the margin
        (Estimate(1.2, (1.1, 1.3)), 'undecided'),
        (Estimate(1.3, (1.25, 1.35)), 'exceeds'),
        (Estimate(2.0, (0.5, 3.5)), 'undecided'),
        (UNSEEN, 'within'),
        (Estimate(None, None, 5.0, 'not_observable'), 'undecided'),
        (Estimate(9.0, (8.0, 10.0), 10.0, 'not_observable'), 'undecided'),
        (Estimate(9.0), 'undecided'),
    ],
)
def test_verdicts_at_a_limit_of_one_and_a_margin_of_a_fifth(coefficient, expected):
    assert check_limits('gyro_x', 'N', 'X1', coefficient, upper=1.0, margin=0.2).verdict == expected


@pytest.mark.parametrize(
    ('ratio', 'ci95', 'answer'),
    [
        (1.0, (0.97, 1.03), 'same'),
        (1.03, (1.01, 1.051), 'same'),  # the 90 % interval ends at 1.0476
        (1.04, (1.02, 1.06), 'undecided'),
        (1.1, (1.06, 1.14), 'different'),
        (1.0 / 1.1, (1.0 / 1.14, 1.0 / 1.06), 'different'),
        (None, (0.0, 1.01), 'undecided'),
    ],
)
def test_equality_up_to_a_fraction_is_tested_from_both_sides(ratio, ci95, answer):
    d = Check('gyro_x', 'N', ratio=Estimate(ratio, ci95), p=0.5)
    assert d.equivalence(0.05) == answer


@pytest.mark.parametrize('value', [0.0, -1.0])
def test_a_ratio_of_0_or_below_shows_no_equivalence(value: float) -> None:
    ratio = Estimate(value, (value - 0.5, value + 0.5))
    assert Check('gyro_x', 'R', ratio=ratio).equivalence(0.05) == 'undecided'


@pytest.mark.parametrize(
    ('ends', 'expected'),
    [
        ((1.2, 1.8), 'within'),
        ((1.8, 2.2), 'undecided'),
        ((2.1, 2.4), 'exceeds'),
        ((0.5, 0.9), 'exceeds'),
        ((0.8, 1.5), 'undecided'),
    ],
)
def test_an_interval_is_compared_with_both_limits(ends, expected):
    found = check_limits('gyro_x', 'bias', 'plan', Estimate(sum(ends) / 2.0, ends), 1.0, 2.0)
    assert found.verdict == expected
    assert found.ratio.ci95 == pytest.approx([end / 2.0 for end in ends])
    assert found.at_least == pytest.approx(ends[0] / 2.0)
