# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Test by cross spectra whether several sensors measure a common signal equally.

Method
------
A sensor i measures the common signal c as H_i c, in addition to its own noise. If all H are equal,
the difference d of two sensors contains only the own noise of both, so d is incoherent with any
third sensor z. Otherwise d contains at least the power |S_dz|^2 / S_zz of the common signal (J. S.
Bendat, A. G. Piersol, Random Data, 2010, section 6.1), which would be mistaken for own noise.

If H_i is a constant factor g_i, it can be determined and corrected: the cross spectrum of two
sensors has the factor g_i g_j and contains no own noise. A lever arm, a delay or a resonance cannot
be corrected.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Spectra = NDArray[np.complex128]

BLOCK = 256
"""Number of samples in a block of the spectra; neighboring blocks overlap by half."""

LEAST_BLOCKS = 40
"""Fewest independent blocks for which it is tested whether the sensors measure a signal equally."""

HIGHEST = 1.0 / 16.0
"""Highest frequency of the test in cycles per sample. At higher frequencies, differences of up to
half a sample between the stamps of two IMUs have an effect. The fit of N contains a term like Q for
this effect."""

LARGEST_LEAK = 0.1
"""Sensors are treated as equal if the common signal makes up less than this share of the power of
the difference of any two sensors. With this share, N of the own noise of a sensor, measured from
differences, is 5 % too large."""

LEAST_CONTRAST = 0.5
"""The ratio of the factors of two sensors is determined only if the power of the common signal
varies with the frequency: its standard deviation must be at least this share of its mean."""


class Transfer(NamedTuple):
    """How several sensors measure a common signal.

    Attributes
    ----------
    gains : (sensors,) array
        Factor with which each sensor measures the signal; the geometric mean of the factors is 1.
    leak : float
        Share of the common signal in the power of the difference of two sensors, for the pair with
        the largest share, after the samples of each sensor are divided by its factor; 0 if there
        are too few samples.
    """

    gains: Floats
    leak: float

    @property
    def is_equal(self) -> bool:
        """Whether the difference of any two sensors contains hardly more than their own noise.

        The samples are divided by ``gains`` before the differences are computed. The result is also
        True if there are too few samples to compare the sensors.
        """
        return self.leak < LARGEST_LEAK


def transfer(parts: Sequence[Floats]) -> Transfer:
    """Return the factors with which sensors measure a common signal, and the leak that remains.

    The leak is the share of the common signal in differences of sensors (`Transfer`). ``parts`` are
    samples without gaps in any unit, each (sensors, n). The factors are 1 if the share of the
    common signal in the differences is below `LARGEST_LEAK` without factors, if the factors do not
    reduce this share, if the samples of a sensor are constant, or if there are too few samples; in
    the last case, the leak is 0.
    """
    unit_gains = np.ones(len(parts[0]) if parts else 0)
    if not len(unit_gains):
        return Transfer(unit_gains, 0.0)
    spectra, blocks = cross_spectra(parts)
    if blocks < LEAST_BLOCKS:
        return Transfer(unit_gains, 0.0)
    leak = _leak(spectra, blocks)
    if leak < LARGEST_LEAK:
        return Transfer(unit_gains, leak)
    gains = _gains(spectra)
    corrected_leak = _leak(spectra / np.outer(gains, gains), blocks)
    return Transfer(gains, corrected_leak) if corrected_leak < leak else Transfer(unit_gains, leak)


def cross_spectra(parts: Sequence[Floats]) -> tuple[Spectra, float]:
    """Return the cross spectra, (frequencies, sensors, sensors), and the number of blocks.

    The number of blocks is the number of independent blocks that would give about the same errors
    as the overlapping blocks. ``parts`` are samples without gaps, each (sensors, n). The
    frequencies are from two periods per block to `HIGHEST`.
    """
    window = np.hanning(BLOCK + 1)[:BLOCK]
    summed_spectra, block_count = np.zeros((BLOCK // 2 + 1, *2 * (len(parts[0]),)), complex), 0
    for samples in parts:
        starts = np.arange(0, samples.shape[1] - BLOCK + 1, BLOCK // 2)
        for block_starts in np.array_split(starts, max(len(starts) // 512, 1)):
            blocks = samples[:, block_starts[:, None] + np.arange(BLOCK)]
            blocks = blocks - blocks.mean(axis=2, keepdims=True)
            transforms = np.fft.rfft(blocks * window, axis=2)
            summed_spectra += np.einsum('akf,bkf->fab', transforms, transforms.conj())
            block_count += len(block_starts)
    # from bin 2 on, because the window spreads the power of bin 0 into bin 1
    used_bins = slice(2, round(HIGHEST * BLOCK) + 1)
    mean_spectra = summed_spectra[used_bins] / max(block_count, 1)
    return np.asarray(mean_spectra, np.complex128), 0.95 * block_count


def _leak(spectra: Spectra, blocks: float) -> float:
    """Return the largest share of the common signal in the power of a difference of two sensors.

    The difference of each pair of sensors is compared with the sum of the other sensors. Pairs for
    which the difference or this sum has no power at some frequency are excluded. If there are only
    two sensors, the sum of both is used instead. The result is at least 0. ``blocks`` is the number
    of independent blocks of the ``spectra``.
    """
    sensor_count = spectra.shape[1]
    shares = [0.0]
    for i, j in combinations(range(sensor_count), 2):
        pair_weights = np.zeros(sensor_count)
        pair_weights[i], pair_weights[j] = 1.0, -1.0
        third_sensors = [np.eye(sensor_count)[k] for k in range(sensor_count) if k not in (i, j)]
        third_weights = np.sum(third_sensors, axis=0) if third_sensors else np.abs(pair_weights)
        power, third_power = (
            np.einsum('a,fab,b->f', x, spectra, x).real for x in (pair_weights, third_weights)
        )
        cross_spectrum = np.einsum('a,fab,b->f', pair_weights, spectra, third_weights)
        if not power.all() or not third_power.all():  # the samples of a sensor are constant
            continue
        # without third sensors, the sum of both sensors is used instead, so that the cross spectrum
        # contains own noise
        if not third_sensors:
            cross_spectrum = cross_spectrum - _intercept(third_power, cross_spectrum.real)
        common_power = np.abs(cross_spectrum) ** 2 / third_power - power / blocks
        shares.append(float(common_power.sum() / power.sum()))
    return max(shares)


def _intercept(x: Floats, y: Floats) -> float:
    """Return a of y = a + b x by least squares with weights 1/x^2; b is 0 if x hardly varies."""
    weight = 1.0 / x**2
    mean = np.average(x, weights=weight)
    if x.std() < LEAST_CONTRAST * x.mean():
        return float(np.average(y, weights=weight))
    slope = np.average((x - mean) * y, weights=weight) / np.average((x - mean) ** 2, weights=weight)
    return float(np.average(y, weights=weight) - slope * mean)


def _gains(spectra: Spectra) -> Floats:
    """Return the factor g of each sensor, (sensors,), with the geometric mean 1.

    The factors are 1 if the samples of a sensor are constant.

    With three or more sensors, the factors follow from the products g_i g_j (one-factor model). Two
    sensors have the spectra g_i^2 S + N_i and the cross spectrum g_i g_j S. The slope of a spectrum
    over the cross spectrum is g_i/g_j, if S varies with the frequency.
    """
    sensor_count = spectra.shape[1]
    gains = np.ones(sensor_count)
    if not np.einsum('faa->fa', spectra).all():  # the samples of a sensor are constant
        return gains
    if sensor_count == 2:
        cross_spectrum = np.maximum(spectra[:, 0, 1].real, 0.0)
        auto_spectra = [spectra[:, i, i].real for i in range(2)]
        if cross_spectrum.std() < LEAST_CONTRAST * cross_spectrum.mean():
            return gains
        weight = 1.0 / (auto_spectra[0] * auto_spectra[1])
        weighted_mean = np.average(cross_spectrum, weights=weight)
        slopes = [
            np.average((cross_spectrum - weighted_mean) * auto_spectrum, weights=weight)
            for auto_spectrum in auto_spectra
        ]
        if min(slopes) > 0.0:
            gains = np.array([slopes[0] / slopes[1], 1.0]) ** 0.5
    else:
        products = spectra.real.sum(axis=0)
        scale = np.sqrt(np.diag(products))
        products = products / np.outer(scale, scale)
        factors = np.sqrt(np.maximum(products.mean(axis=1), 1e-3))
        for _ in range(100):
            np.fill_diagonal(products, factors**2)
            factors = products @ factors / (factors @ factors)
        gains = np.abs(factors * scale)
    return np.asarray(gains / np.exp(np.log(gains).mean()))
