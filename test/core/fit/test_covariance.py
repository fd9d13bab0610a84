# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from allan_ros.core.allan import likelihood
from allan_ros.core.allan.sums import counts, grid_for
from allan_ros.core.errors import AllanError
from allan_ros.core.fit import clear_cache
from allan_ros.core.fit.covariance import MOST_SAMPLES, TERM_PAIRS, pair_sums
from allan_ros.core.fit.model import DIFFERENCE, avar_terms, phase_covariance


def by_enumeration(samples):
    """Return the results of `pair_sums`, computed by enumerating every pair of differences."""
    m, stride = grid_for(samples)
    count = counts(samples, m, stride)
    i, j = np.triu_indices(len(m))
    squares, singles = np.zeros((len(TERM_PAIRS), len(i))), np.zeros((4, len(i)))
    for n, (a, b) in enumerate(zip(i, j)):
        starts_a, starts_b = np.arange(count[a]) * stride[a], np.arange(count[b]) * stride[b]
        lag, number = np.unique(starts_a[:, None] - starts_b[None, :], return_counts=True)
        c = sum(
            ca * cb * phase_covariance(lag + float(p * m[a] - q * m[b]))
            for p, ca in enumerate(DIFFERENCE)
            for q, cb in enumerate(DIFFERENCE)
        ) / (2.0 * m[a] * m[b])
        singles[:, n] = c @ number
        for t, (k, other) in enumerate(TERM_PAIRS):
            squares[t, n] = (2.0 if k == other else 4.0) * np.sum(number * c[k] * c[other])
    return squares, singles


@pytest.mark.parametrize('samples', [20, 100, 401])
def test_sums_over_lags_are_those_over_all_pairs(samples):
    pairs = pair_sums(samples)
    squares, singles = by_enumeration(samples)
    i, j = np.triu_indices(len(pairs.m))
    for got, want in zip(pairs.squares, squares):
        size = np.sqrt(np.abs(want[i == j]))
        # The jitter of the fit is 1e-4 of a correlation; the steps of cnt leave four times that.
        np.testing.assert_allclose(got, want, rtol=0.0, atol=6e-4 * np.max(size) ** 2)
        assert np.max(np.abs(got - want) / (size[i] * size[j])) < 6e-4
    long = pairs.m[j] > samples / 20
    np.testing.assert_allclose(pairs.singles[0], singles[0], atol=1e-9)
    for got, want, whole in zip(pairs.singles, singles, avar_terms(pairs.m).T):
        scale = pairs.count[j] * pairs.count[i] * np.sqrt(whole[i] * whole[j])
        assert np.max(np.abs(got - want)[long] / scale[long]) < 2e-3


def test_one_difference_of_white_noise_has_the_variance_of_a_chi_squared():
    pairs = pair_sums(1 << 12)
    last = len(pairs.m) - 1
    assert pairs.count[last] == 1
    i, j = np.triu_indices(len(pairs.m))
    at = np.flatnonzero((i == last) & (j == last))[0]
    white = TERM_PAIRS.index((1, 1))
    assert pairs.squares[white, at] == pytest.approx(2.0 / pairs.m[last] ** 2)


def test_covariance_of_long_records_is_positive():
    pairs = pair_sums(720_000)
    size = len(pairs.m)
    i, j = np.triu_indices(size)
    for n, (k, other) in enumerate(TERM_PAIRS):
        if k == other:
            c = np.empty((size, size))
            c[i, j] = c[j, i] = pairs.squares[n]
            d = np.sqrt(np.diag(c))
            assert np.linalg.eigvalsh(c / np.outer(d, d)).min() > -2e-4


def test_cleared_values_are_computed_again():
    import allan_ros.core.fit.table  # noqa: F401  (which remembers; a method loads it)

    before = pair_sums(1000)
    clear_cache()
    assert pair_sums.cache_info().currsize == 0
    assert np.array_equal(pair_sums(1000).squares, before.squares)


def test_sums_do_not_depend_on_earlier_longer_records():
    clear_cache()
    before = pair_sums(1000)
    clear_cache()
    pair_sums(100_000)
    after = pair_sums(1000)
    assert np.array_equal(after.squares, before.squares)
    assert np.array_equal(after.singles, before.singles)


def test_the_longest_record_does_not_change_shorter_ones_and_a_longer_one_is_an_error():
    """Regression: the table of a record of impossible length was wrong, and then reused for
    others.
    """
    clear_cache()
    before = pair_sums(1000)
    clear_cache()
    with pytest.raises(AllanError, match='accumulate them again'):
        pair_sums(MOST_SAMPLES + 1)
    pair_sums(MOST_SAMPLES)
    assert np.array_equal(pair_sums(1000).squares, before.squares)
    clear_cache()


def test_cached_likelihood_models_are_cleared():
    likelihood._model((0.0, 1.0, 2.0, 3.0), (1.0, 2.0, 3.0, 4.0))
    clear_cache()
    assert likelihood._model.cache_info().currsize == 0
