# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The expected spectra and contrasts of each noise type are means of simulated ones."""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2
from support.sums import sums_of

from allan_ros.core.fit.statistics import contrasts, statistics
from allan_ros.core.noise import RANDOM_TERMS, GaussMarkov, Model
from allan_ros.core.noise.processes.bounded_walk import BoundedWalk
from allan_ros.core.noise.processes.resonance import Resonance
from allan_ros.core.noise.processes.sinusoid import Sinusoid
from allan_ros.core.noise.processes.white import White
from allan_ros.core.simulate import simulate_axis

SAMPLES, AXES = 6000, 150
ALARM = 1e-4
"""Probability that a correct expectation fails one of the tests below (seed fixed)."""


def draw(component, rng):
    """Return samples of unit noise, (samples, axes)."""
    kind, shape = component.name, component.shape
    if not shape:
        terms = Model.of(**{component.letter: 1.0})
        return np.stack([simulate_axis(SAMPLES, 1.0, terms, rng) for _ in range(AXES)], 1)
    if kind == 'sinusoid':
        turns = shape[0] * np.arange(SAMPLES)[:, None] + rng.uniform(size=AXES)
        return np.sin(2.0 * np.pi * turns)
    before = 20 * math.ceil(shape[-1])
    white = rng.standard_normal((before + SAMPLES, AXES))
    phi = math.exp(-1.0 / shape[-1])
    if kind == 'resonance':  # the real part of a complex Gauss-Markov process
        white = white + 1j * rng.standard_normal(white.shape)
        phi = phi * np.exp(2j * np.pi * shape[0])
    y = lfilter([math.sqrt(1.0 - abs(phi) ** 2)], [1.0, -phi], white, axis=0)[before:].real
    return y * math.sqrt(shape[-1] / 2.0) if kind == 'bounded_walk' else y


@lru_cache
def known(component):
    rng = np.random.default_rng(
        [ord(c) for c in (component.name if component.shape else component.letter)]
    )
    return statistics(sums_of(draw(component, rng)))


COMPONENTS = [
    *RANDOM_TERMS,
    *(GaussMarkov(time) for time in (2.0, 30.0, 500.0)),
    BoundedWalk(200.0),
    *(Sinusoid(f) for f in (0.137, 0.0021)),
    Resonance(0.11, 40.0),
]


@pytest.mark.parametrize('component', COMPONENTS, ids=str)
def test_expected_spectra_equal_simulated_ones(component):
    """Largest of about 100 normal deviates, and the scale of all bins together."""
    found = known(component)
    power, column = found.power, found.column(component).power
    error = power.std(axis=1) / math.sqrt(AXES) + 1e-6 * column.max()
    z = (power.mean(axis=1) - column) / error
    assert np.abs(z).max() < 5.6  # Student's t of 150: 1e-4/100 in both tails


@pytest.mark.parametrize('component', COMPONENTS, ids=str)
def test_expected_covariances_of_contrasts_equal_simulated_ones(component):
    """chi^2 of the squares, whitened with the expected covariance (without the line)."""
    found = known(component)
    (group,) = found.groups
    (low,) = found.column(component).low
    if component.is_line:  # not Gaussian, and of rank 2: the trace alone
        trace = np.trace(group.gram[:, 1:, 1:], axis1=1, axis2=2)
        error = trace.std() / math.sqrt(AXES) + 1e-9
        if component.frequency * found.step < 1.0:
            assert abs(trace.mean() - np.trace(low[1:, 1:])) < 3.9 * error
        return
    expected = low[1:, 1:]
    root = np.linalg.cholesky(expected + 1e-12 * np.trace(expected) * np.eye(len(expected)))
    white = np.linalg.solve(root, np.linalg.solve(root, group.gram[:, 1:, 1:].sum(0)).T)
    eigenvalues = np.diag(white)
    low_end, high_end = chi2.ppf([ALARM / 2, 1.0 - ALARM / 2], AXES * len(eigenvalues))
    assert low_end < eigenvalues.sum() < high_end
    corner = ALARM / len(eigenvalues) / 2
    assert chi2.ppf(corner, AXES) < eigenvalues.min()
    assert eigenvalues.max() < chi2.ppf(1.0 - corner, AXES)


@pytest.mark.parametrize(('points', 'high'), [(4, 2), (31, 12), (200, 40)])
def test_contrasts_are_orthonormal_and_see_neither_mean_nor_more_than_one_ramp(points, high):
    v = contrasts(points, high)
    np.testing.assert_allclose(v.T @ v, np.eye(v.shape[1]), atol=1e-12)
    both = v.T @ np.column_stack([np.ones(points), np.arange(points)])
    np.testing.assert_allclose(both[:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(both[1:, 1], 0.0, atol=1e-9)


def test_an_offset_and_a_ramp_in_each_segment_change_nothing_but_the_line():
    rng = np.random.default_rng(1)
    y = rng.standard_normal((9000, 1))
    ramp = np.where(np.arange(9000) < 4000, 1e-4 * np.arange(9000), 5.0)[:, None]
    plain, moved = (statistics(sums_of(each, cuts=(4000,))) for each in (y, y + ramp))
    for a, b in zip(plain.groups, moved.groups):
        np.testing.assert_allclose(a.gram[:, 1:, 1:], b.gram[:, 1:, 1:], rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize(('length', 'level'), [(1, 1), (2, 1), (5, 1), (60, 1), (40, 30), (75, 75)])
def test_the_white_noise_of_replaced_samples_is_expected(length, level):
    """White noise of 24 axes with 5 % of its samples replaced: each octave to 4 sigma.

    In octave 0, most blocks with a stretch of 60 or 75 samples are excluded.
    """
    rng = np.random.default_rng(length)
    spacing = 20 * length + 2 * level
    y = rng.standard_normal((200_000 if length > 9 else 40_000, 24))
    mask = np.zeros(len(y), bool)
    for start in range(level, len(y) - spacing, spacing):
        at = start + int(rng.integers(spacing - length - 2 * level))
        t = np.arange(1, length + 1)[:, None] / (length + 1)
        before, after = y[at - level : at].mean(0), y[at + length : at + length + level].mean(0)
        y[at : at + length] = before * (1.0 - t) + after * t
        mask[at : at + length] = True
    table = np.array([[length, level, *24 * [np.count_nonzero(mask) // length]]])
    found = statistics(replace(sums_of(y, interpolated=mask), replaced=table))
    ratio = found.power / np.stack([found.column(White(), a).power for a in range(24)], 1)
    for o in range(min(found.octaves, 8)):
        each = ratio[found.octave == o].mean(axis=0)
        assert abs(each.mean() - 1.0) < 4.0 * each.std() / math.sqrt(24), o
    (group,) = found.groups
    each = [
        np.linalg.solve(found.column(White(), a).low[0][1:, 1:], group.gram[a, 1:, 1:]).trace()
        for a in range(24)
    ]
    assert abs(np.mean(each) - group.high) < 4.0 * math.sqrt(2.0 * group.high / 24)
