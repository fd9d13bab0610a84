# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Octave spectra of all recordings together, for the fit and as a noise density in Hz."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .curve import chi_squared_limits
from .grid import octave, overlap
from .periods import totals
from .sums import AllanSums

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Spectra:
    """Mean power of the spectral blocks in all bins, from octave 0 (high frequencies) on.

    The bins of an octave, and overlapping blocks, are correlated. ``dof`` is the number of degrees
    of freedom of the mean power of a bin by itself. A sum over all bins is as accurate as if each
    bin was independent and had ``shared_dof`` degrees of freedom.
    """

    octave: Ints  # (bins,)
    f: Floats  # (bins,) center frequencies in cycles per sample
    power: Floats  # (bins, axes) in the squared unit of the samples
    dof: Floats  # (bins,)
    shared_dof: Floats  # (bins,)
    clump: Floats  # (bins,) variance of a sum over bins, relative to as many independent bins
    blocks: Ints  # (octaves,) number of blocks
    pairs: Ints  # (octaves,) number of pairs of overlapping blocks

    @property
    def octaves(self) -> int:
        """Number of octaves."""
        return len(self.blocks)


def pooled_spectra(sums: AllanSums) -> Spectra:
    """Return the mean power over all spectral blocks of the sums."""
    periods = sums.periods
    none, width = np.zeros(0, np.int64), len(sums.axes)
    blocks, pairs = (totals([none, *(getattr(p, k) for p in periods)]) for k in ('blocks', 'pairs'))
    power = totals([np.zeros((0, width)), *(p.power for p in periods)])
    octaves = [octave(o) for o in range(len(blocks))]
    of_bin = np.repeat(np.arange(len(blocks)), [len(one.bins) for one in octaves])
    f = [np.array(one.bins) / one.length for one in octaves]
    degrees = np.zeros((3, len(blocks)))
    for o in np.flatnonzero(blocks):  # 0 if all blocks of an octave were excluded
        same, following = overlap(int(o))
        covariance = (blocks[o] * same + pairs[o] * following) / float(blocks[o]) ** 2
        variance = covariance[np.argmax(same)]
        clump = np.sum((covariance / variance) ** 2)
        degrees[:, o] = 2.0 / variance, 2.0 / covariance.sum(), clump
    mean = power / np.maximum(blocks[of_bin], 1)[:, None]
    frequency = np.concatenate([np.zeros(0), *f])
    dof, shared, clump = degrees[:, of_bin]
    return Spectra(of_bin, frequency, mean, dof, shared, clump, blocks, pairs)


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral density of all axes, with 68.3 % confidence limits."""

    axes: tuple[str, ...]  # names of the axes
    frequency: Floats  # (points,) in Hz, ascending
    psd: Floats  # (points, axes) density in the squared unit of the samples per Hz
    low: Floats  # (points, axes) lower limit of ``psd``
    high: Floats  # (points, axes) upper limit of ``psd``


def noise_density(sums: AllanSums) -> Spectrum | None:
    """Return the power spectral density of the samples; None without a complete block."""
    spectra = pooled_spectra(sums)
    some = np.flatnonzero(spectra.dof > 0.0)
    if not len(some) or not sums.tau0:
        return None
    some = some[np.argsort(spectra.f[some])]
    step = np.array([octave(o).step for o in spectra.octave[some].tolist()])
    psd = 2.0 * sums.tau0 * step[:, None] * spectra.power[some]
    degrees = np.broadcast_to(spectra.dof[some, None], psd.shape)
    # `chi_squared_limits` returns limits of a deviation; their squares are limits of the density
    low, high = chi_squared_limits(psd, degrees)
    return Spectrum(sums.axes, spectra.f[some] / sums.tau0, psd, low**2, high**2)
