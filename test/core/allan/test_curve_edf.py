# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from support.allan_table import allan_table

from allan_ros.core.allan.curve import chi_squared_limits, correlation, edf
from allan_ros.core.noise import Model
from allan_ros.core.simulator import simulate_axis

ALPHA = {'Q': 2, 'N': 0, 'B': -1, 'K': -2}


def test_published_limits_of_phase_dat(shared_data):
    """Compare with the octaves table of Stable32, within 1e-4 (deviation) and 1 % (limits)."""
    folder = shared_data / 'truth' / 'phase_dat'
    y = np.diff(np.loadtxt(folder / 'PHASE.DAT'))
    published = np.loadtxt(folder / 'phase_dat_oadev_octave.txt')
    m, n = published[:, 0].astype(int), published[:, 2].astype(int)
    table = allan_table(y, m)
    assert np.array_equal(table.n, n)
    np.testing.assert_allclose(np.sqrt(table.avar), published[:, 5], rtol=5e-5)
    for i in range(len(m)):
        limits = chi_squared_limits(table.avar[i], edf(int(published[i, 3]), m[i], 1, n[i]))
        np.testing.assert_allclose(limits, published[i, [4, 6]], rtol=0.01)


@pytest.mark.parametrize('alpha', [2, 0, -1, -2])
@pytest.mark.parametrize('m', [16, 64, 300])
def test_agrees_with_the_combined_algorithm_at_long_tau(alpha, m):
    oracle = pytest.importorskip('allantools.ci')
    n = 2000
    expected = oracle.edf_greenhall(alpha, 2, m, n + 1, overlapping=True)
    # The combined algorithm filters the phase within a sample and fits its tables to 5 %.
    assert edf(alpha, m, 1, n + 1 - 2 * m) == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize('term', 'QNBK')
@pytest.mark.parametrize('m, stride', [(1, 1), (8, 1), (16, 2), (48, 4)])
def test_degrees_of_freedom_agree_with_simulated_variances(term, m, stride):
    """2 mean^2/var over 4000 draws determines edf to sqrt((2 + 12/edf)/4000); bound 5 sigma."""
    n, draws = 128, 4000
    rng = np.random.default_rng(3)
    y = np.stack([simulate_axis(n, 1.0, Model.of(**{term: 1.0}), rng) for _ in range(draws)])
    table = allan_table(y.T, np.array([m]), stride=stride)
    v = table.avar[0]
    expected = edf(ALPHA[term], m, stride, table.n[0])
    found = 2 * v.mean() ** 2 / v.var()
    assert found == pytest.approx(expected, rel=5 * np.sqrt((2 + 12 / expected) / draws))


def test_equal_segments_add_their_degrees_of_freedom():
    one = edf(-1, 32, 4, 50)
    assert edf(-1, 32, 4, 50, 7) == pytest.approx(7 * one)
    assert edf(-1, 32, 4, [50] * 7) == pytest.approx(7 * one)
    # A segment without differences changes nothing; an empty record has no degrees of freedom.
    assert edf(-1, 32, 4, [50, 0]) == one
    assert np.isnan(edf(-1, 32, 4, [0]))


def test_unequal_segments_are_weighted_by_their_counts():
    m, stride, lengths = 8, 1, np.array([40, 7, 1])
    one = np.array([edf(0, m, stride, n) for n in lengths])
    expected = lengths.sum() ** 2 / np.sum(lengths**2 / one)
    assert edf(0, m, stride, lengths) == pytest.approx(expected)


@pytest.mark.parametrize('alpha', [1, 0, -1, -2])
def test_correlation_does_not_depend_on_scale_at_long_tau(alpha):
    """The result for m = 1e4 is valid for m = 1e9: no difference cancels into rounding."""
    shares = np.array([0.25, 0.5, 1.0, 1.5, 2.0, 3.0])
    a, b = (correlation(alpha, m, (shares * m).astype(int)) for m in (10**4, 10**9))
    np.testing.assert_allclose(a, b, atol=0.06 if alpha == 1 else 2e-4)


def test_limits_cover_the_true_variance_at_their_confidence_level():
    """White noise, 3000 draws: the coverage is 0.683 +- 0.0085; bound 5 sigma."""
    n, m, draws = 200, 20, 3000
    y = np.random.default_rng(0).standard_normal((n, draws))
    table = allan_table(y, np.array([m]))
    low, high = chi_squared_limits(table.avar[0], np.full(draws, edf(0, m, 1, table.n[0])))
    inside = (low < m**-0.5) & (m**-0.5 < high)
    assert inside.mean() == pytest.approx(0.683, abs=0.043)
