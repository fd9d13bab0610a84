# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest
from scipy import fft

from allan_ros.core.errors import AllanError
from allan_ros.core.noise import FLICKER_FLOOR, term_avar
from allan_ros.core.simulate import (
    BATCH_SAMPLES,
    NoiseTerms,
    _flicker_autocovariance,
    _flicker_eigenvalues,
    simulate_axis,
    simulate_imu,
)

MIXED = NoiseTerms(Q=2e-3, N=0.03, B=0.1, K=0.02, R=1e-3)
QUIET = [NoiseTerms(N=1e-3)] * 3


def avar(y, m):
    """Return the fully overlapping Allan variance along the last axis, from its definition."""
    theta = np.concatenate([np.zeros((*y.shape[:-1], 1)), np.cumsum(y, axis=-1)], axis=-1)
    d = theta[..., 2 * m :] - 2 * theta[..., m:-m] + theta[..., : -2 * m]
    return (d**2).mean(axis=-1) / (2 * m**2)


def recording(seconds=20.0, rate=100.0, **options):
    batches = list(simulate_imu(seconds, rate, QUIET, QUIET, **options))
    return np.concatenate([b.stamps_ns for b in batches]), np.concatenate(
        [b.samples for b in batches]
    )


@pytest.mark.parametrize('m', [1, 2, 3, 7, 30, 200])
def test_flicker_steps_have_a_flat_allan_variance_exactly(m):
    # d is a triangular moving sum of the steps, so E d^2 is a sum over their autocovariance.
    triangle = np.concatenate([np.arange(1.0, m), np.arange(float(m), 0.0, -1.0)])
    weights = np.correlate(triangle, triangle, mode='full')[len(triangle) - 1 :]
    steps = _flicker_autocovariance(max(2 * m, 40))[: len(weights)]
    variance = weights[0] * steps[0] + 2 * weights[1:] @ steps[1:]
    assert variance / (2 * m**2) == pytest.approx(FLICKER_FLOOR, rel=1e-8)


@pytest.mark.parametrize('half', [20, 100, 3000, 100000])
def test_the_circulant_is_a_covariance_with_the_autocovariance(half):
    eigenvalues = _flicker_eigenvalues(half)
    assert eigenvalues.min() > 0
    np.testing.assert_allclose(
        fft.irfft(eigenvalues, 2 * half)[: half + 1], _flicker_autocovariance(half), atol=1e-14
    )


@pytest.mark.parametrize(
    'terms', [*(dataclasses.replace(NoiseTerms(), **{t: 0.1}) for t in 'QNBKR'), MIXED]
)
def test_mean_allan_variance_is_the_expected_one_at_every_factor(terms):
    """False alarm probability below 1e-3: 60 comparisons of a nearly normal mean at 4.5 sigma."""
    n, tau0, draws = 1024, 0.1, 1000
    rng = np.random.default_rng(11)
    y = np.stack([simulate_axis(n, tau0, terms, rng) for _ in range(draws)])
    for m in (1, 2, 3, 8, 20, 50, 128, 200, 350, 512):
        ratio = avar(y, m) / term_avar(m, tau0, terms).sum()
        spread = ratio.std(ddof=1) / np.sqrt(draws) + 1e-9
        assert abs(ratio.mean() - 1) < 4.5 * spread, f'm = {m}'


def test_the_seed_decides_everything():
    again = [recording(seed=5)[1] for _ in range(2)]
    assert np.array_equal(*again)
    assert not np.array_equal(again[0], recording(seed=6)[1])


def test_axes_are_independent_and_centered_on_the_mean():
    """False alarm probability below 1e-5: 15 correlations of 20000 samples at 5 sigma."""
    _, samples = recording(200.0, mean=[1, 2, 3, 4, 5, 6])
    assert np.abs(samples.mean(axis=0) - [1, 2, 3, 4, 5, 6]).max() < 0.05
    steps = np.diff(samples, axis=0)
    correlation = np.corrcoef(steps.T) - np.eye(6)
    assert np.abs(correlation).max() < 5 / np.sqrt(len(steps)) * np.sqrt(1.5)


def test_stamps_start_at_the_given_time_and_batches_are_bounded():
    batches = list(simulate_imu(500.0, 100.0, QUIET, QUIET, start_ns=10**18, frame_id='a'))
    assert [len(b) for b in batches] == [BATCH_SAMPLES, 50000 - BATCH_SAMPLES]
    stamps = np.concatenate([b.stamps_ns for b in batches])
    assert np.array_equal(stamps, 10**18 + 10_000_000 * np.arange(50000))
    assert {b.frame_id for b in batches} == {'a'}


@pytest.mark.parametrize('arguments', [(0.0, 100.0), (1.0, -1.0), (float('nan'), 1.0)])
def test_nothing_to_simulate_is_rejected(arguments):
    with pytest.raises(AllanError, match=r'must lie between|longer time'):
        next(simulate_imu(*arguments, QUIET, QUIET))
