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

from allan_ros.core.allan.curve import pooled_spectra
from allan_ros.core.fit.statistics import (
    LEAST_DIVIDED,
    Settling,
    Size,
    contrasts,
    settling_power,
    statistics,
    without_lines,
)
from allan_ros.core.noise import RANDOM_TERMS, GaussMarkov, Model
from allan_ros.core.noise.processes.bounded_walk import BoundedWalk
from allan_ros.core.noise.processes.resonance import Resonance
from allan_ros.core.noise.processes.sinusoid import Sinusoid
from allan_ros.core.noise.processes.white import White
from allan_ros.core.simulator import simulate_axis

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


def _whitened(expected, gram):
    """Return the squares of the whitened contrasts, summed over the axes."""
    root = np.linalg.cholesky(expected + 1e-12 * np.trace(expected) * np.eye(len(expected)))
    return np.diag(np.linalg.solve(root, np.linalg.solve(root, gram).T))


@pytest.mark.parametrize('component', COMPONENTS, ids=str)
def test_expected_covariances_of_contrasts_equal_simulated_ones(component):
    """chi^2 of the squares, whitened with the expected covariance (without the line)."""
    found = known(component)
    low = without_lines(found.column(component).low, found.sizes)
    grams = [without_lines(each, found.sizes) for each in zip(*(g.gram for g in found.groups))]
    if component.is_line:  # not Gaussian, and of rank 2: the trace alone
        trace = np.array([sum(map(np.trace, each)) for each in grams])
        error = trace.std() / math.sqrt(AXES) + 1e-9
        if component.frequency * found.step < 1.0:
            assert abs(trace.mean() - sum(map(np.trace, low))) < 3.9 * error
        return
    eigenvalues = np.concatenate([_whitened(*each) for each in zip(low, map(sum, zip(*grams)))])
    low_end, high_end = chi2.ppf([ALARM / 2, 1.0 - ALARM / 2], AXES * len(eigenvalues))
    assert low_end < eigenvalues.sum() < high_end
    corner = ALARM / len(eigenvalues) / 2
    assert chi2.ppf(corner, AXES) < eigenvalues.min()
    assert eigenvalues.max() < chi2.ppf(1.0 - corner, AXES)


@pytest.mark.parametrize(
    'size',
    [
        Size(4, 2),
        Size(31, 12),
        Size(200, 40),
        Size(5, 2, 3.0),
        Size(200, 40, 9.0),
        Size(99, 9, 200.0),
        *Size(200, 41).halves(),
    ],
)
def test_contrasts_are_orthonormal_and_see_only_the_size_of_a_ramp(size: Size):
    v, t = contrasts(size), np.arange(size.points)
    assert v.shape == (size.points, size.lines + size.high)
    np.testing.assert_allclose(v.T @ v, np.eye(v.shape[1]), atol=1e-12)
    np.testing.assert_allclose(v.T @ np.ones(size.points), 0.0, atol=1e-12)
    np.testing.assert_allclose(v.T[size.lines :] @ t, 0.0, atol=1e-9)
    if size.decay:
        np.testing.assert_allclose(v.T @ np.exp(-t / size.decay), 0.0, atol=1e-12)


@pytest.mark.parametrize('high', [40, 41])
def test_antisymmetric_and_symmetric_contrasts_are_uncorrelated(high: int):
    """The contrasts of both halves are the contrasts of the whole, up to their signs."""
    size = Size(200, high)
    halves = size.halves()
    assert [half.symmetry for half in halves] == [-1, 1]
    whole = contrasts(size)
    order = [0, *range(1, high + 1, 2), *range(2, high + 1, 2)]
    both = np.concatenate([contrasts(half) for half in halves], axis=1)
    np.testing.assert_allclose(np.abs(both.T @ whole[:, order]), np.eye(high + 1), atol=1e-12)
    np.testing.assert_allclose(contrasts(halves[0]), -contrasts(halves[0])[::-1], atol=1e-12)
    np.testing.assert_allclose(contrasts(halves[1]), contrasts(halves[1])[::-1], atol=1e-12)


@pytest.mark.parametrize('size', [Size(200, LEAST_DIVIDED - 1), Size(200, 40, 9.0)])
def test_few_contrasts_and_contrasts_beside_a_settling_are_not_divided(size: Size):
    assert size.halves() == [size]


@pytest.mark.parametrize('time', [50.0, 1000.0, 20_000.0])
def test_the_power_of_a_settling_is_computed_exactly(time: float):
    """Two segments of one recording; smaller powers are rounding errors of float32."""
    decay = np.exp(-np.arange(30_000) / time)[:, None]
    sums = sums_of(decay, cuts=(20_000,))
    settling = Settling(time, {0: np.array([1.0])})
    spectra = pooled_spectra(sums)
    octaves = int(spectra.octave[-1]) + 1
    expected = settling_power(sums, settling, octaves)[:, 0] / spectra.blocks[spectra.octave]
    large = expected > 1e-4 * expected.max()
    np.testing.assert_allclose(spectra.power[large, 0], expected[large], rtol=1e-3)


def test_a_settling_changes_no_contrast_and_little_of_the_spectra():
    rng = np.random.default_rng(3)
    y = rng.standard_normal((20_000, 2))
    decay = 40.0 * np.exp(-np.arange(20_000) / 1500.0)[:, None]
    settling = Settling(1500.0, {0: np.array([40.0, 40.0])})
    plain, moved = (statistics(sums_of(each), settling) for each in (y, y + decay))
    for a, b in zip(plain.groups, moved.groups):
        n = a.size.lines
        np.testing.assert_allclose(a.gram[:, n:, n:], b.gram[:, n:, n:], rtol=1e-4, atol=1e-6)
    left = moved.power * (1.0 - moved.settling)
    unsettled = statistics(sums_of(y))
    certain = moved.settling < 0.5
    ratio = left[certain] / unsettled.power[certain]
    assert certain.mean() > 0.8 and abs(ratio - 1.0).max() < 0.5


def test_an_offset_and_a_ramp_in_each_segment_change_nothing_but_the_line():
    rng = np.random.default_rng(1)
    y = rng.standard_normal((9000, 1))
    ramp = np.where(np.arange(9000) < 4000, 1e-4 * np.arange(9000), 5.0)[:, None]
    plain, moved = (statistics(sums_of(each, cuts=(4000,))) for each in (y, y + ramp))
    for a, b in zip(plain.groups, moved.groups):
        n = a.size.lines
        np.testing.assert_allclose(a.gram[:, n:, n:], b.gram[:, n:, n:], rtol=1e-5, atol=1e-9)


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
    number = sum(size.high for size in found.sizes)
    each = [_trace_ratio(found, a) for a in range(24)]
    assert abs(np.mean(each) - number) < 4.0 * math.sqrt(2.0 * number / 24)


def _trace_ratio(found, axis):
    """Return the sum of the squares of the contrasts of an axis, whitened for white noise."""
    low = without_lines(found.column(White(), axis).low, found.sizes)
    grams = without_lines([group.gram[axis] for group in found.groups], found.sizes)
    return sum(float(np.trace(np.linalg.solve(*each))) for each in zip(low, grams))
