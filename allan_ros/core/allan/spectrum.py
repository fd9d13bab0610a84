# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Power spectral density of a stream in one pass and in constant memory.

Welch's method (IEEE Trans. Audio Electroacoustics 15(2), 1967): periodograms of Hann-windowed
blocks that overlap by half are averaged. Lower frequencies come from decimated samples: each level
of a cascade averages `DECIMATION` samples of the level before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from .curve import chi_squared_limits

Floats = NDArray[np.float64]

BLOCK = 1024
"""Samples per block; the frequency resolution is 0.1 % of the sample rate."""

DECIMATION = 4
"""Number of samples of one level that are averaged to one sample of the next."""

LEVELS = 12
"""Number of levels; a sample of the last level is the mean of 4^11 samples, 12 h at 100 Hz."""

KEPT_BELOW = 1.0 / 16.0
"""Highest frequency that is used from decimated samples, relative to their rate. Below it,
averaging removes at most 1.3 % of the power (sinc^2)."""

LOWEST_BIN = 2
"""Lowest frequency bin that is used; lower bins contain leakage of the mean."""

PER_DECADE = 40
"""Number of points of the result per decade of frequency."""

OVERLAP_LOSS = 1.0 + 2.0 * (1.0 / 6.0) ** 2
"""Variance of the mean over half-overlapping Hann blocks, relative to as many independent blocks
(Welch 1967, eq. 17; the amplitudes of neighboring blocks have the correlation 1/6)."""

BIN_LOSS = 1.0 + 2.0 * ((2.0 / 3.0) ** 2 + (1.0 / 6.0) ** 2)
"""Variance of the mean over neighboring frequency bins, relative to as many independent bins
(their amplitudes have the correlations 2/3 and 1/6 because of the Hann window)."""


@dataclass(frozen=True)
class SpectrumSums:
    """Sums of periodograms of one sensor."""

    axes: tuple[str, ...]  # names of the axes
    # (LEVELS, BLOCK/2 + 1, axes) sum of the one-sided periodograms of each level, for a sample
    # period of 1
    power: Floats
    blocks: NDArray[np.int64]  # (LEVELS,) number of blocks in each sum

    def __add__(self, other: SpectrumSums) -> SpectrumSums:
        """Return the sums of both; raise `AllanError` if the axes differ."""
        if self.axes != other.axes:
            raise AllanError(f'spectra of {self.axes} and {other.axes} cannot be added')
        return SpectrumSums(self.axes, self.power + other.power, self.blocks + other.blocks)


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral density of all axes, with 68.3 % confidence limits."""

    axes: tuple[str, ...]  # names of the axes
    frequency: Floats  # (points,) in Hz, ascending, logarithmically spaced where possible
    psd: Floats  # (points, axes) density in the squared unit of the samples per Hz
    low: Floats  # (points, axes) lower limit of ``psd``
    high: Floats  # (points, axes) upper limit of ``psd``


class RunningSpectrum:
    """Running sums of periodograms of one stream of evenly spaced samples.

    Examples
    --------
    >>> import numpy as np
    >>> running = RunningSpectrum(('gyro_x',))
    >>> running.update(np.random.default_rng(0).normal(size=(1, 4096)))
    >>> running.sums.blocks[:3]
    array([7, 1, 0])
    """

    def __init__(self, axes: tuple[str, ...]) -> None:
        self._power = np.zeros((LEVELS, BLOCK // 2 + 1, len(axes)))
        self._blocks = np.zeros(LEVELS, np.int64)
        self._axes = axes
        self.end_segment()

    def update(self, rows: Floats) -> None:
        """Add samples, (axes, n), that directly follow the previous ones."""
        for level in range(LEVELS):
            samples = np.concatenate([self._in_block[level], rows], axis=1)
            self._in_block[level] = self._add_blocks(level, samples)
            if level + 1 == LEVELS:
                return
            samples = np.concatenate([self._in_mean[level], rows], axis=1)
            complete = samples.shape[1] // DECIMATION * DECIMATION
            self._in_mean[level] = samples[:, complete:].copy()
            if not complete:
                return
            rows = samples[:, :complete].reshape(len(samples), -1, DECIMATION).mean(axis=2)

    def end_segment(self) -> None:
        """End the segment; samples of incomplete blocks are dropped."""
        nothing = np.empty((len(self._axes), 0))
        self._in_block = [nothing] * LEVELS  # samples of each level in its incomplete block
        self._in_mean = [nothing] * LEVELS  # samples of each level in its incomplete mean

    @property
    def sums(self) -> SpectrumSums:
        """Copy of the current sums."""
        return SpectrumSums(self._axes, self._power.copy(), self._blocks.copy())

    def _add_blocks(self, level: int, samples: Floats) -> Floats:
        """Add the complete blocks to the sums; return the samples from the next block on."""
        step = BLOCK // 2
        count = (samples.shape[1] - step) // step
        if count < 1:
            return samples.copy()
        blocks = np.lib.stride_tricks.sliding_window_view(samples, BLOCK, axis=1)[:, ::step]
        windowed = (blocks - blocks.mean(axis=2, keepdims=True)) * _WINDOW
        spectrum = np.fft.rfft(windowed, axis=2)
        power = (spectrum.real**2 + spectrum.imag**2).sum(axis=1).T
        self._power[level] += power * _ONE_SIDED[:, None]
        self._blocks[level] += count
        return samples[:, count * step :].copy()


def spectrum_of(sums: SpectrumSums, tau0: float) -> Spectrum | None:
    """Return the spectral density of samples with the period ``tau0`` in s.

    It is None if no block is complete.
    """
    some = np.flatnonzero(sums.blocks)
    if not len(some):
        return None
    frequency, psd, blocks = [], [], []
    for level in some:
        period = tau0 * DECIMATION**level
        top = BLOCK // 2 if level == 0 else int(BLOCK * KEPT_BELOW)
        bottom = LOWEST_BIN if level == some[-1] else int(BLOCK * KEPT_BELOW) // DECIMATION
        bins = np.arange(bottom, top)  # the next level ends at the lowest frequency of this one
        frequency.append(bins / (BLOCK * period))
        psd.append(sums.power[level, bins] * period / sums.blocks[level])
        blocks.append(np.full(len(bins), float(sums.blocks[level])))
    f = np.concatenate(frequency)
    return _in_log_bins(sums.axes, f, np.concatenate(psd), np.concatenate(blocks))


def _in_log_bins(axes: tuple[str, ...], f: Floats, psd: Floats, blocks: Floats) -> Spectrum:
    """Return the mean density in logarithmic intervals, weighted by the number of blocks."""
    order = np.argsort(f)
    f, psd, blocks = f[order], psd[order], blocks[order]
    groups = np.floor(np.log10(f) * PER_DECADE).astype(int)
    starts = np.flatnonzero(np.diff(groups, prepend=groups[0] - 1))
    weight = np.add.reduceat(blocks, starts)
    number = np.diff(np.append(starts, len(f)))
    mean = np.add.reduceat(psd * blocks[:, None], starts, axis=0) / weight[:, None]
    frequency = np.exp(np.add.reduceat(np.log(f) * blocks, starts) / weight)
    degrees = 2.0 * weight / OVERLAP_LOSS / np.where(number > 1, BIN_LOSS, 1.0)
    spread = np.broadcast_to(degrees[:, None], mean.shape)
    # `chi_squared_limits` returns limits of a deviation; their squares are limits of the density
    low, high = chi_squared_limits(mean, spread)
    return Spectrum(axes, frequency, mean, low**2, high**2)


_WINDOW = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(BLOCK) / BLOCK)
"""Periodic Hann window."""

_ONE_SIDED = np.full(BLOCK // 2 + 1, 2.0 / float(np.sum(_WINDOW**2)))
"""Factor from |FFT|^2 to a one-sided periodogram; it is halved at frequency 0 and at Nyquist."""

_ONE_SIDED[[0, -1]] /= 2.0
