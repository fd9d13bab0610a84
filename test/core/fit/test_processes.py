# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The covariance with Gauss-Markov processes, compared with sums over all lags one by one."""

import numpy as np
import pytest

from allan_ros.core.allan.sums import counts, grid_for
from allan_ros.core.fit.covariance import TERM_PAIRS, pair_sums
from allan_ros.core.fit.model import DIFFERENCE, phase_covariance
from allan_ros.core.fit.processes import process_pairs, process_squares
from allan_ros.core.noise import gauss_markov_sums, sampled_gauss_markov_avar

SAMPLES = 2048


def direct(samples, variances, times):
    """Return m and the covariance of the table, summed lag by lag."""
    m, stride = grid_for(samples)
    count = counts(samples, m, stride)

    def phase(t):
        out = variances[:4] @ phase_covariance(t.astype(float))
        for p, time in zip(variances[4:], times):
            slope, step = (float(x[0]) for x in gauss_markov_sums(time))
            out -= 0.5 * p * (slope * np.abs(t) + step * np.expm1(-np.abs(t) / time))
        return out

    out = np.zeros((len(m), len(m)))
    for i in range(len(m)):
        for j in range(i, len(m)):
            first = -(samples // stride[i] + 1) * stride[i]
            lag = np.arange(first, samples - 2 * m[i] + 1, stride[i])
            low = np.maximum(0, -lag)
            high = np.minimum((count[j] - 1) * stride[j], (count[i] - 1) * stride[i] - lag)
            number = high // stride[j] + (-low) // stride[j] + 1
            number = np.where(high >= low, np.maximum(number, 0), 0)
            c = sum(
                ca * cb * phase(lag + a * m[i] - b * m[j])
                for a, ca in enumerate(DIFFERENCE)
                for b, cb in enumerate(DIFFERENCE)
            ) / (2.0 * m[i] * m[j])
            out[i, j] = out[j, i] = 2.0 * np.sum(number * c**2) / (count[i] * count[j])
    return m, out


@pytest.mark.parametrize(
    ('variances', 'times'),
    [
        ((0.0, 1.0, 0.0, 0.0, 0.5), (10.0,)),
        ((0.3, 1.0, 0.01, 1e-5, 0.2), (3.0,)),
        ((0.0, 1.0, 0.0, 1e-5, 0.1, 0.3), (100.0, 7.0)),
    ],
)
def test_the_covariance_is_the_sum_over_all_lags(variances, times):
    variances = np.array(variances)
    m, expected = direct(SAMPLES, variances, times)
    stride = grid_for(SAMPLES)[1]
    count = counts(SAMPLES, m, stride).astype(float)
    squares = np.concatenate(
        [pair_sums(SAMPLES).squares, process_squares(m, stride, [(SAMPLES, 1)], times)]
    )
    pairs = (*TERM_PAIRS, *process_pairs(len(times)))
    found = np.array([variances[a] * variances[b] for a, b in pairs]) @ squares
    i, j = np.triu_indices(len(m))
    deviation = np.sqrt(np.diag(expected))
    error = (found / (count[i] * count[j]) - expected[i, j]) / (deviation[i] * deviation[j])
    inner = m[j] <= SAMPLES / 8
    assert np.abs(error[inner]).max() < 2e-3
    assert np.abs(error).max() < 2e-2  # one or two differences


@pytest.mark.parametrize('times', [(20.0,), (150.0, 9.0)])
def test_segments_of_several_lengths_add_up(times):
    rng = np.random.default_rng(3)
    lengths = [1500, 1000, 1000, *rng.integers(30, 1400, 40).tolist()]
    m, stride = grid_for(max(lengths))
    i, j = np.triu_indices(len(m))
    apart = np.zeros((len(process_pairs(len(times))), len(i)))
    for n in lengths:
        own = np.flatnonzero(j < len(grid_for(n)[0]))
        apart[:, own] += process_squares(*grid_for(n), [(n, 1)], times)
    together = process_squares(m, stride, [(n, 1) for n in lengths], times)
    deviation = np.sqrt(np.abs(apart[:, i == j]))
    scale = deviation[:, i] * deviation[:, j]
    error = np.abs(together - apart) / scale
    assert error[:, m[j] <= 400].max() < 2e-3
    assert error.max() < 0.06  # the longest averages of one to three segments


@pytest.mark.parametrize('samples', [260, 450, 1000])
def test_last_differences_of_a_segment_are_counted(samples):
    """The number of differences is an integer: one to four at the longest averaging times."""
    m, expected = direct(samples, np.array([0.0, 0.0, 0.0, 0.0, 1.0]), (20.0,))
    stride = grid_for(samples)[1]
    count = counts(samples, m, stride)
    i, j = np.triu_indices(len(m))
    found = process_squares(m, stride, [(samples, 1)], (20.0,))[4] / (count[i] * count[j])
    deviation = np.sqrt(np.diag(expected))
    assert np.max(np.abs(found - expected[i, j]) / (deviation[i] * deviation[j])) < 5e-3


@pytest.mark.parametrize('time', [0.5, 3.0, 40.0])
def test_allan_variance_of_a_sampled_process(time):
    keep = np.exp(-1.0 / time)

    def variance(n):
        lag = np.arange(1, n)
        return n + 2.0 * np.sum((n - lag) * keep**lag)

    m = np.array([1, 2, 7, 50])
    expected = [(4.0 * variance(k) - variance(2 * k)) / (2.0 * k * k) for k in m]
    np.testing.assert_allclose(sampled_gauss_markov_avar(m, time), expected, rtol=1e-10)


def test_allan_variance_of_a_slow_process_does_not_depend_on_how_it_is_computed():
    """The two ways of computing its sums meet at 5000 samples."""
    m = np.array([1, 100, 10_000])
    np.testing.assert_allclose(
        sampled_gauss_markov_avar(m, 4999.9), sampled_gauss_markov_avar(m, 5000.1), rtol=1e-4
    )
