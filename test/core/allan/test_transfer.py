# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Factors, lever arms and delays between sensors with a common signal."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from allan_ros.core.allan.transfer import Transfer, cross_spectra, transfer

Floats = NDArray[np.float64]
SAMPLES = 60_000


def vibration(rng: np.random.Generator, colored: bool) -> Floats:
    """Return a common signal with unit variance, (SAMPLES + 1,): white, or of a resonance."""
    y = rng.normal(size=SAMPLES + 1)
    y = lfilter([1.0], [1.0, -1.85, 0.9], y) if colored else y
    return np.asarray(y / y.std())


def measured(number: int, colored: bool, ratio: float, fault: str, seed: int = 1) -> Transfer:
    """Return the transfer of sensors of which the second one has a fault.

    The signal is ``ratio`` times the own noise of the sensors.
    """
    rng = np.random.default_rng(seed)
    signal = ratio * vibration(rng, colored)
    now, before = signal[1:], signal[:-1]
    faulty = {
        '': now,
        'factor': 1.2 * now,
        'delay': 0.6 * now + 0.4 * before,
        'lever arm': now + 0.5 * np.gradient(now),
    }[fault]
    own = rng.normal(size=(number, SAMPLES)) * np.linspace(0.8, 1.2, number)[:, None]
    both = [faulty if i == 1 else now for i in range(number)]
    return transfer([np.array(both) + own])


@pytest.mark.parametrize('number', [2, 3, 4])
@pytest.mark.parametrize('colored', [False, True])
@pytest.mark.parametrize('ratio', [0.0, 1.0, 10.0])
def test_equal_sensors_are_equal(number: int, colored: bool, ratio: float) -> None:
    found = measured(number, colored, ratio, '')
    assert found.is_equal and found.leak < 0.02
    assert (found.gains == 1.0).all()


@pytest.mark.parametrize(('number', 'colored'), [(2, True), (3, True), (3, False), (4, False)])
def test_a_factor_is_corrected(number: int, colored: bool) -> None:
    found = measured(number, colored, 10.0, 'factor')
    assert found.is_equal
    assert found.gains[1] / found.gains[0] == pytest.approx(1.2, rel=0.01)
    assert np.exp(np.log(found.gains).mean()) == pytest.approx(1.0)


@pytest.mark.parametrize('number', [2, 3, 4])
@pytest.mark.parametrize('colored', [False, True])
@pytest.mark.parametrize('fault', ['delay', 'lever arm'])
def test_a_transfer_that_depends_on_the_frequency_is_found(
    number: int, colored: bool, fault: str
) -> None:
    assert measured(number, colored, 10.0, fault).leak > 0.15


def test_too_few_samples_are_not_tested() -> None:
    rng = np.random.default_rng(2)
    found = transfer([rng.normal(size=(3, 4000))])
    assert found.is_equal and (found.gains == 1.0).all()
    assert transfer([]).is_equal


def test_the_factors_are_1_if_a_sensor_has_constant_samples() -> None:
    rng = np.random.default_rng(4)
    common = np.cumsum(rng.normal(size=SAMPLES)) / 5.0
    own = rng.normal(size=(2, SAMPLES))
    found = transfer([np.array([np.zeros(SAMPLES), common + own[0], 1.5 * common + own[1]])])
    assert (found.gains == 1.0).all() and not found.is_equal


def test_the_cross_spectra_of_parts_are_their_mean() -> None:
    y = np.random.default_rng(3).normal(size=(2, 128 * 100))
    both, number = cross_spectra([y, y])
    one, half = cross_spectra([y])
    np.testing.assert_allclose(both, one)
    assert number == 2 * half
