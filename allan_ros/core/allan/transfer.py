# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether several sensors measure a common signal equally, from their cross spectra.

Method
------
A sensor i measures the common signal c as H_i c, in addition to its own noise. If all H are equal,
the difference d of two sensors contains only the own noise of both, so d is incoherent with any
third sensor z. Otherwise d contains at least the power |S_dz|^2 / S_zz of the common signal (J. S.
Bendat, A. G. Piersol, Random Data, 2010, section 6.1), which would be mistaken for own noise.

If H_i is a factor g_i, it can be corrected: the cross spectrum of two sensors has the factor
g_i g_j and contains no own noise. A lever arm, a delay or a resonance cannot be corrected.
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
"""Samples of a block of the spectra; neighboring blocks overlap by half."""

LEAST_BLOCKS = 40
"""Fewest independent blocks for which the transfer is tested."""

HIGHEST = 1.0 / 16.0
"""Highest frequency of the test in cycles per sample. At higher frequencies, the differences
between the stamps of two IMUs, up to half a sample, have an effect. The fit of N contains a term
like Q for this effect."""

LARGEST_LEAK = 0.1
"""Largest share of the common signal in the power of a difference. This share increases N by 5
%."""

LEAST_CONTRAST = 0.5
"""Least standard deviation of the common power over the frequencies, relative to its mean, for
which two sensors alone determine the ratio of their factors."""


class Transfer(NamedTuple):
    """How several sensors measure a common signal.

    Attributes
    ----------
    gains : (sensors,) array
        Factor of each sensor; their geometric mean is 1.
    leak : float
        Largest share of the common signal in the power of the difference of two sensors, after the
        factors are corrected.
    """

    gains: Floats
    leak: float

    @property
    def is_equal(self) -> bool:
        """Whether the difference of any two sensors contains hardly more than their own noise."""
        return self.leak < LARGEST_LEAK


def transfer(parts: Sequence[Floats]) -> Transfer:
    """Return the factors with which sensors measure a common signal, and what remains of it.

    ``parts`` are samples without gaps, each (sensors, n). The factors are 1 if the share of the
    common signal in the differences is below `LARGEST_LEAK` without factors, if the factors do not
    reduce this share, or if there are too few samples.
    """
    equal = np.ones(len(parts[0]) if parts else 0)
    if not len(equal):
        return Transfer(equal, 0.0)
    spectra, blocks = cross_spectra(parts)
    if blocks < LEAST_BLOCKS:
        return Transfer(equal, 0.0)
    leak = _leak(spectra, blocks)
    if leak < LARGEST_LEAK:
        return Transfer(equal, leak)
    gains = _gains(spectra)
    corrected = _leak(spectra / np.outer(gains, gains), blocks)
    return Transfer(gains, corrected) if corrected < leak else Transfer(equal, leak)


def cross_spectra(parts: Sequence[Floats]) -> tuple[Spectra, float]:
    """Return the cross spectra, (frequencies, sensors, sensors), and the number of blocks.

    Overlapping blocks count as the number of independent blocks with the same errors. The
    frequencies are from two periods per block to `HIGHEST`.
    """
    window = np.hanning(BLOCK + 1)[:BLOCK]
    total, number = np.zeros((BLOCK // 2 + 1, *2 * (len(parts[0]),)), complex), 0
    for samples in parts:
        starts = np.arange(0, samples.shape[1] - BLOCK + 1, BLOCK // 2)
        for some in np.array_split(starts, max(len(starts) // 512, 1)):
            blocks = samples[:, some[:, None] + np.arange(BLOCK)]
            blocks = blocks - blocks.mean(axis=2, keepdims=True)
            f = np.fft.rfft(blocks * window, axis=2)
            total += np.einsum('akf,bkf->fab', f, f.conj())
            number += len(some)
    # from bin 2 on, because the window spreads the power of bin 0 into bin 1
    used = slice(2, round(HIGHEST * BLOCK) + 1)
    return np.asarray(total[used] / max(number, 1), np.complex128), 0.95 * number


def _leak(spectra: Spectra, blocks: float) -> float:
    """Return the largest share of the common signal in the difference of two sensors."""
    number = spectra.shape[1]
    found = [0.0]
    for i, j in combinations(range(number), 2):
        d = np.zeros(number)
        d[i], d[j] = 1.0, -1.0
        others = [np.eye(number)[k] for k in range(number) if k not in (i, j)]
        z = np.sum(others, axis=0) if others else np.abs(d)
        power, of_z = (np.einsum('a,fab,b->f', x, spectra, x).real for x in (d, z))
        cross = np.einsum('a,fab,b->f', d, spectra, z)
        if not power.all() or not of_z.all():  # a sensor without noise
            continue
        if not others:  # z is the sum of both sensors, so the cross spectrum contains own noise
            cross = cross - _intercept(of_z, cross.real)
        leak = np.abs(cross) ** 2 / of_z - power / blocks
        found.append(float(leak.sum() / power.sum()))
    return max(found)


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

    With three or more sensors, the factors follow from the products g_i g_j (one-factor model). Two
    sensors have the spectra g_i^2 S + N_i and the cross spectrum g_i g_j S. The slope of a spectrum
    over the cross spectrum is g_i/g_j, if S varies with the frequency.
    """
    number = spectra.shape[1]
    gains = np.ones(number)
    if number == 2:
        shared = np.maximum(spectra[:, 0, 1].real, 0.0)
        own = [spectra[:, i, i].real for i in range(2)]
        if shared.std() < LEAST_CONTRAST * shared.mean():
            return gains
        weight = 1.0 / (own[0] * own[1])
        mean = np.average(shared, weights=weight)
        slopes = [np.average((shared - mean) * one, weights=weight) for one in own]
        if min(slopes) > 0.0:
            gains = np.array([slopes[0] / slopes[1], 1.0]) ** 0.5
    else:
        products = spectra.real.sum(axis=0)
        scale = np.sqrt(np.diag(products))
        products = products / np.outer(scale, scale)
        factor = np.sqrt(np.maximum(products.mean(axis=1), 1e-3))
        for _ in range(100):
            np.fill_diagonal(products, factor**2)
            factor = products @ factor / (factor @ factor)
        gains = np.abs(factor * scale)
    return np.asarray(gains / np.exp(np.log(gains).mean()))
