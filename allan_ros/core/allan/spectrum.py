# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Power spectral density of a stream in one pass and in constant memory.

Welch's method (IEEE Trans. Audio Electroacoustics 15(2), 1967): periodograms of Hann-windowed
blocks that overlap by half are averaged. For lower frequencies this is repeated with averages of
`DECIMATION` samples, then with averages of these averages, and so on. Each level costs a quarter of
the previous one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from .curve import chi_squared_limits

Floats = NDArray[np.float64]

BLOCK = 1024
"""Samples per block: frequencies 0.1 % of the sample rate apart are resolved."""

DECIMATION = 4
"""Number of samples of one level that are averaged to one sample of the next."""

LEVELS = 12
"""Number of levels: a sample of the last level is the mean of 4^11 samples, 12 h at 100 Hz."""

KEPT_BELOW = 1.0 / 16.0
"""Highest frequency that is used of averaged samples, relative to their rate. Below it, averaging
removes at most 1.3 % of the power (sinc^2), and aliased white noise has the correct level."""

LOWEST_BIN = 2
"""Lowest bin that is used: lower bins contain leakage of the mean."""

PER_DECADE = 40
"""Points per decade of frequency."""

OVERLAP_LOSS = 1.0 + 2.0 * (1.0 / 6.0) ** 2
"""Variance of a mean of Hann blocks that overlap by half, relative to the mean of as many
independent blocks (Welch 1967, eq. 17; the window correlates them by 1/6)."""

BIN_LOSS = 1.0 + 2.0 * ((2.0 / 3.0) ** 2 + (1.0 / 6.0) ** 2)
"""The same for neighbouring bins, whose amplitudes are correlated by 2/3 and 1/6 because of the
Hann window."""


@dataclass(frozen=True)
class SpectrumSums:
    """Sums of periodograms of one sensor; sums can be added."""

    axes: tuple[str, ...]
    # (LEVELS, BLOCK/2 + 1, axes) sum of the one-sided periodograms of each level, per sample of the
    # level
    power: Floats
    blocks: NDArray[np.int64]  # (LEVELS,) number of blocks of each level

    def __add__(self, other: SpectrumSums) -> SpectrumSums:
        if self.axes != other.axes:
            raise AllanError(f'spectra of {self.axes} and {other.axes} cannot be added')
        return SpectrumSums(self.axes, self.power + other.power, self.blocks + other.blocks)


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral density of all axes, with 68.3 % limits."""

    axes: tuple[str, ...]
    # (points,) in Hz, evenly spaced on a logarithmic scale if there are enough bins
    frequency: Floats
    # (points, axes) in the squared unit of the samples per Hz
    psd: Floats
    low: Floats
    high: Floats


class RunningSpectrum:
    """Sums of periodograms of one stream of evenly spaced samples.

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
            waiting = np.concatenate([self._waiting[level], rows], axis=1)
            self._waiting[level] = self._take_blocks(level, waiting)
            if level + 1 == LEVELS:
                return
            odd = np.concatenate([self._odd[level], rows], axis=1)
            complete = odd.shape[1] // DECIMATION * DECIMATION
            self._odd[level] = odd[:, complete:].copy()
            if not complete:
                return
            rows = odd[:, :complete].reshape(len(odd), -1, DECIMATION).mean(axis=2)

    def end_segment(self) -> None:
        """End the segment: no block contains samples before and after this point."""
        nothing = np.empty((len(self._axes), 0))
        self._waiting = [nothing] * LEVELS
        self._odd = [nothing] * LEVELS

    @property
    def sums(self) -> SpectrumSums:
        """Snapshot of the current sums."""
        return SpectrumSums(self._axes, self._power.copy(), self._blocks.copy())

    def _take_blocks(self, level: int, waiting: Floats) -> Floats:
        """Process the complete blocks, and return the samples that the next block needs."""
        step = BLOCK // 2
        count = (waiting.shape[1] - step) // step
        if count < 1:
            return waiting.copy()
        blocks = np.lib.stride_tricks.sliding_window_view(waiting, BLOCK, axis=1)[:, ::step]
        windowed = (blocks - blocks.mean(axis=2, keepdims=True)) * _WINDOW
        spectrum = np.fft.rfft(windowed, axis=2)
        power = (spectrum.real**2 + spectrum.imag**2).sum(axis=1).T
        self._power[level] += power * _ONE_SIDED[:, None]
        self._blocks[level] += count
        return waiting[:, count * step :].copy()


def spectrum_of(sums: SpectrumSums, tau0: float) -> Spectrum | None:
    """Return the density of the sums with sample period ``tau0`` in s; None without a complete
    block."""
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
    """Return the means of the bins in each of `PER_DECADE` intervals, weighted by number of
    blocks."""
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
    # the limits are for a deviation; their squares are limits of the density
    low, high = chi_squared_limits(mean, spread)
    return Spectrum(axes, frequency, mean, low**2, high**2)


_WINDOW = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(BLOCK) / BLOCK)
"""Hann's window, periodic."""

_ONE_SIDED = np.full(BLOCK // 2 + 1, 2.0 / float(np.sum(_WINDOW**2)))
"""Scale of |FFT|^2 in a one-sided periodogram, where the mean and the Nyquist bin count once."""

_ONE_SIDED[[0, -1]] /= 2.0
