# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics of a recording for the fit, and the expectation of the statistics for each noise type.

Frequency bands
---------------
Above the crossover frequency, the statistics are the octave spectra (averaged periodograms). Their
expectation is a linear function of gamma(M, j) (`Process.gamma`). This function includes the
leakage of the taper and the aliases of the decimation.

Below the crossover frequency, the statistics are contrasts: sums of the block means of a segment,
weighted with cosines that are orthogonal to a constant and to a linear change with time. The
covariance of the contrasts is a linear function of gamma(M, j), too. Segments of equal length share
one Gram matrix.

Contrasts whose weights are symmetric in time are uncorrelated with contrasts whose weights are
antisymmetric, because the autocovariance does not depend on the direction of time. If there are
many contrasts and no settling, the contrasts are therefore divided into two groups, so that the
matrices are small.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..allan.cascade import MAX_INTERPOLATED
from ..allan.curve import pooled_spectra
from ..allan.grid import LONGEST_BLOCK, SAMPLE_OCTAVES, bins_up_to, octave, tapers
from ..allan.periods import BlockMeans, RecordedPeriods
from ..allan.replaced_stretches import replaced_excess
from ..allan.sums import AllanSums
from ..noise import Gamma, Process
from ..noise.processes.quantization import Quantization
from ..noise.processes.white import White

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class LowPassCurvature(Process):
    """Term in f^4 of the spectrum of a low-pass filter; the term in f^2 is quantization noise.

    This process has no effect on block means, and exists only within a fit.
    """


class Size(NamedTuple):
    """Numbers that determine the contrasts of a group of segments."""

    points: int  # number of block means of each segment
    high: int  # number of cosines with which the block means are weighted

    # time constant, in block means, of a settling to which the contrasts are orthogonal; 0 for none
    decay: float = 0.0

    symmetry: int = 0  # 1 if all weights are symmetric in time, -1 if antisymmetric, 0 for both

    @property
    def lines(self) -> int:
        """1 if the first contrast measures a linear change with time, 0 if no contrast does."""
        return 0 if self.symmetry > 0 else 1

    def halves(self) -> list[Size]:
        """Return the sizes of the antisymmetric and of the symmetric contrasts.

        The contrasts are not divided if they are orthogonal to a settling, which is neither
        symmetric nor antisymmetric, or if there are fewer cosines than `LEAST_DIVIDED`. In both
        cases, the result contains only the original size.
        """
        if self.decay or self.high < LEAST_DIVIDED:
            return [self]
        antisymmetric = self._replace(high=(self.high + 1) // 2, symmetry=-1)
        return [antisymmetric, self._replace(high=self.high // 2, symmetry=1)]


Sizes = tuple[Size, ...]
"""Numbers that determine the contrasts of each group of segments."""

LOWEST_BLOCKS = 2
"""Least length of the longest segment, in spectral blocks of the lowest octave. With this length,
at least three overlapping blocks are averaged. Octave 0 is used if it has at least one
block."""

LEAST_POINTS = 4
"""Fewest block means of a segment from which contrasts are formed."""

MOST_CONTRASTS = 300
"""Largest number of cosines with which the block means of a segment are weighted. Each cosine gives
one contrast. If there are spectra, only cosines below the crossover frequency are used."""

LEAST_DIVIDED = 32
"""Least number of cosines of a segment for which the contrasts are divided into antisymmetric and
symmetric contrasts. With fewer cosines, the computation with two small covariance matrices takes as
much time as the computation with one large matrix."""

SETTLED = 5.0
"""Time, in time constants, after which a settling has ended: 0.7 % of its size is left."""

LARGEST_SETTLING_SHARE = 0.99
"""Largest share that a settling is assumed to have in the power of a bin. The larger the share of
the settling is, the less weight the bin has in the fit."""

MOST_LENGTHS = 8
"""Largest number of different segment lengths for which whole segments are used. If there are more
lengths, segments are divided into pieces of a few lengths."""


@lru_cache
def _kernels() -> tuple[Floats, Floats]:
    """Return the matrices, (bins, lags), that turn autocovariances into the expected power.

    The autocovariances are gamma(M, j) (`Process.gamma`) at the lags j = 0, 1, ... The first matrix
    is for the bins of all octaves that are computed from samples. The second matrix is for the bins
    of one octave that is computed from means of samples.
    """

    def kernel(octave_index: int) -> Floats:
        _, size, bins = octave(octave_index)
        a = tapers(size, bins)
        r = np.fft.ifft(np.abs(np.fft.fft(a, 2 * size)) ** 2).real[:, :size]
        r[:, 1:] *= 2.0
        return np.pad(r, ((0, 0), (0, LONGEST_BLOCK - size)))

    return np.concatenate([kernel(o) for o in range(SAMPLE_OCTAVES)]), kernel(SAMPLE_OCTAVES)


@lru_cache(maxsize=1024)
def expected_power(process: Process, octaves: int) -> Floats:
    """Return the expected power in the bins of the first ``octaves`` octaves, (bins,).

    The coefficient of the process is 1, and its shape is in samples.
    """
    return _power_of(process.gamma, octaves)


def _power_of(gamma: Gamma, octaves: int) -> Floats:
    """Return the expected power, (bins,), of noise with the autocovariance ``gamma``."""
    octaves_of_means = max(octaves - SAMPLE_OCTAVES, 0)
    step = 1 << np.arange(octaves_of_means + 1)
    values = gamma(step[:, None], np.arange(LONGEST_BLOCK))
    kernel_of_samples, kernel_of_means = _kernels()
    power = np.append(kernel_of_samples @ values[0], values[1:] @ kernel_of_means.T)
    return np.asarray(power[: bins_up_to(octaves)])


@lru_cache(maxsize=64)
def contrasts(size: Size) -> Floats:
    """Return the weights of block means in each contrast, (points, contrasts).

    The columns are a linear function of time, unless all weights are symmetric, and `Size.high`
    cosines of 1, 2, ... half periods. Antisymmetric cosines have an odd number of half periods,
    symmetric cosines an even number. The columns are made orthonormal, and orthogonal to a constant
    and to the settling, if there is one.
    """
    points, high, decay, symmetry = size
    t = np.arange(points)
    excluded = [np.ones(points)]
    if decay:
        excluded.append(np.exp(-t / decay))
    lines = [t - t.mean()] * size.lines
    half_periods = np.arange(1, high + 1) if not symmetry else 2 * np.arange(1, high + 1)
    half_periods -= symmetry < 0
    cosines = np.cos(np.pi * np.outer(t + 0.5, half_periods) / points)
    q, _ = np.linalg.qr(np.column_stack([*excluded, *lines, cosines]))
    return np.asarray(q[:, len(excluded) :])


def without_lines(low: Iterable[Floats], sizes: Sizes) -> list[Floats]:
    """Return matrices without the row and column of the contrast for a linear change with time.

    Each matrix belongs to a group of segments, is (contrasts, contrasts), and may have any unit.
    """
    return [a[size.lines :, size.lines :] for a, size in zip(low, sizes)]


# without a settling, there are at most 16 groups, or 36 if segments are divided into pieces
@lru_cache(maxsize=48)
def _transformed(size: Size) -> Floats:
    """Return the Fourier transform of the contrasts, (rows, contrasts): real, then imaginary parts.

    The covariance of two contrasts is the sum over the rows of the product of two columns, weighted
    with the eigenvalues of a circulant matrix. The matrix is for twice as many block means. The
    origin of time is the middle of the segment, so that the transform of symmetric contrasts is
    real, and the transform of antisymmetric contrasts is imaginary. Parts that are 0 are omitted.
    """
    f = np.fft.rfft(contrasts(size), 2 * size.points, axis=0) / math.sqrt(size.points)
    f *= np.exp(0.5j * np.pi * (1.0 - 1.0 / size.points) * np.arange(len(f)))[:, None]
    f[[0, -1]] *= math.sqrt(0.5)
    return np.concatenate([f.real] * (size.symmetry >= 0) + [f.imag] * (size.symmetry <= 0))


@lru_cache(maxsize=96)  # enough for all processes of a fit and the shapes that were tried last
def _low_covariances(process: Process, step: int, sizes: Sizes) -> list[Floats]:
    """Return the covariance of the contrasts of block means for unit noise, for each size."""
    return _covariances_of(process.gamma, step, sizes)


def _covariances_of(gamma: Gamma, step: int, sizes: Sizes) -> list[Floats]:
    """Return the covariance of the contrasts of block means with the autocovariance ``gamma``.

    There is one matrix for each size.
    """
    lags = gamma(step, np.arange(max((size.points for size in sizes), default=0)))
    covariances = []
    for size in sizes:
        values = lags[: size.points]
        eigenvalues = np.fft.rfft(np.concatenate([values, values[-1:], values[:0:-1]])).real
        v = _transformed(size)
        # real and imaginary parts have the same eigenvalues
        covariances.append(v.T @ (np.resize(eigenvalues, len(v))[:, None] * v))
    return covariances


class Group(NamedTuple):
    """Contrasts of the block means of all segments of one size."""

    size: Size
    segments: int  # number of segments
    sums: Floats  # (axes, contrasts) sum of the contrasts over the segments

    # (axes, contrasts, contrasts) sum over the segments of z z^T, where z are the contrasts of a
    # segment
    gram: Floats

    @classmethod
    def of(cls, size: Size, pieces: Floats) -> Group:
        """Return the group of all segments of one size, computed from their block means.

        ``size`` determines the weights of the block means (`contrasts`). ``pieces`` are the block
        means, (segments, axes, points), in the unit of the samples.
        """
        z = pieces @ contrasts(size)
        return cls(size, len(pieces), z.sum(0), np.einsum('sai,saj->aij', z, z))


class Column(NamedTuple):
    """Expectation of the statistics for a process with the coefficient 1."""

    power: Floats  # (bins,) expected power

    # covariance of the contrasts of each group, (contrasts, contrasts); if one of the contrasts
    # measures a linear change with time, it is the first
    low: list[Floats]


@dataclass(frozen=True, eq=False)
class Statistics:
    """Octave spectra and block means of all axes of a recording.

    Attributes
    ----------
    samples, longest : int
        Number of samples of all segments, and of the longest segment with block means.
    octave, f : (bins,) arrays
        Octave of each bin, and frequency of each bin in cycles per sample.
    power : (bins, axes) array
        Mean power of the blocks in the squared unit of the samples (two-sided density).
    settling : (bins, axes) array
        Share of the power that is due to a settling of the bias.
    dof, dof_alone : (bins,) arrays
        Degrees of freedom of a bin: as part of a sum over many bins, which are correlated, and of
        the bin alone.
    correlation : float
        Sum of the squared correlations of the mean power of a bin with all bins of its block, in
        the lowest octave; 1 without spectra.
    step : int
        Samples per block mean.
    groups : tuple of Group
        Contrasts of the block means, in groups of segments of equal size.
    replaced : (stretches, 2 + axes) array
        Stretches of replaced samples, as in `AllanSums`.
    """

    samples: int
    longest: int
    octave: Ints
    f: Floats
    power: Floats
    settling: Floats
    dof: Floats
    dof_alone: Floats
    correlation: float
    step: int
    groups: tuple[Group, ...]
    replaced: Ints

    @cached_property
    def octaves(self) -> int:
        """Number of octaves."""
        return int(self.octave[-1]) + 1 if len(self.octave) else 0

    @cached_property
    def sizes(self) -> Sizes:
        """Numbers that determine the contrasts of each group."""
        return tuple(group.size for group in self.groups)

    @cached_property
    def crossover(self) -> float:
        """Frequency in cycles per sample below which the block means are used."""
        return lower_edge(self.octaves)

    @cached_property
    def white(self) -> list[Column]:
        """Expected statistics, for each axis, of unit white noise in which samples were replaced.

        A spectral block is excluded from the sums if a share of more than `MAX_INTERPOLATED` is
        replaced. If a replaced stretch is longer than this share of a block, only its two ends
        are in blocks that are not excluded. Weighted with the squared taper, both ends together
        count like half a block on average.
        """
        power = self.power_of(White())
        covariances = _low_covariances(White(), self.step, self.sizes)
        sizes = np.array([octave(o).length for o in range(self.octaves)])
        length = self.replaced[:, 0]
        is_short = length[:, None] <= MAX_INTERPOLATED * sizes  # shape (stretches, octaves)
        first_octave = np.argmax(np.column_stack([is_short, np.ones(len(length), bool)]), axis=1)
        columns = []
        for stretches_per_sample in self.replaced[:, 2:].T / max(self.samples, 1):
            if not stretches_per_sample.any():
                columns.append(Column(power, covariances))
                continue
            share_of_ends = stretches_per_sample @ np.where(is_short, 0.0, sizes / 2.0)
            excluded_share = stretches_per_sample @ np.where(
                is_short, 0.0, length[:, None] - sizes / 2.0
            )
            axis_power = power * (1.0 - share_of_ends / (1.0 - excluded_share))[self.octave]
            for o in np.unique(first_octave).tolist():
                gamma = replaced_excess(
                    self.replaced, np.where(first_octave == o, stretches_per_sample, 0.0)
                )
                excess_power = np.where(self.octave >= o, _power_of(gamma, self.octaves), 0.0)
                axis_power = axis_power + excess_power
            gamma = replaced_excess(self.replaced, stretches_per_sample)
            excess_covariances = _covariances_of(gamma, self.step, self.sizes)
            axis_covariances = [a + b for a, b in zip(covariances, excess_covariances)]
            columns.append(Column(axis_power, axis_covariances))
        return columns

    def dof_of(self, axis: int) -> Floats:
        """Return the degrees of freedom of the bins of an axis, (bins,), reduced by a settling."""
        share_of_noise = 1.0 - self.settling[:, axis]
        return np.asarray(self.dof * share_of_noise**2)

    def power_of(self, process: Process) -> Floats:
        """Return the expected power, (bins,), of a process with the coefficient 1.

        The power is for a recording without interpolated samples.
        """
        return expected_power(process, self.octaves)

    def column(self, process: Process, axis: int = 0) -> Column:
        """Return the expected statistics of an axis for a process with the coefficient 1."""
        if process == LowPassCurvature():
            q = self.column(Quantization())
            return Column(q.power**2, [0.0 * covariance for covariance in q.low])
        if process == White():
            return self.white[axis]
        aliases = mean_alias(process, self.step)
        if aliases:
            covariances = [aliases * covariance for covariance in self.white[axis].low]
        else:
            covariances = _low_covariances(process, self.step, self.sizes)
        return Column(self.power_of(process), covariances)


def mean_alias(process: Process, step: int) -> float:
    """Return the variance of white noise that replaces the alias of a fast sinusoid.

    The frequency of an alias in the means of ``step`` samples depends on more digits of the
    frequency of the sinusoid than are known. Instead of the alias, the expectation contains white
    noise with the mean power of all possible aliases. The result is the variance of this white
    noise per sample, for a ``process`` with the coefficient 1; it is 0 for a process without alias.
    """
    return 0.5 * step * process.alias_variance(step)


def lower_edge(octaves: int) -> float:
    """Return the lower edge of the lowest octave in cycles per sample; 1 without octaves.

    ``octaves`` is the number of octaves.
    """
    if not octaves:
        return 1.0
    means, size, bins = octave(octaves - 1)
    return float((bins[0] - 0.5) / (means * size))


@dataclass(frozen=True)
class Settling:
    """Settling A exp(-t/T) of the bias of a sensor after the start of each recording.

    Attributes
    ----------
    time : float
        Time constant T in samples.
    sizes : mapping of int to (axes,) array
        Index of a recording -> A of each axis at the start of the recording, in the unit of the
        samples. A recording that is not in the mapping has no settling.
    """

    time: float
    sizes: Mapping[int, Floats]


def statistics(sums: AllanSums, settling: Settling | None = None) -> Statistics:
    """Return the statistics of Allan sums for a fit that takes a settling into account.

    A settling is an exponential change of the bias after the start of a recording. The contrasts of
    segments that contain the settling are orthogonal to its exponential, so that the size of the
    settling has no effect. The share of the settling in the power of the octave spectra is
    computed, and a fit subtracts it. If ``settling`` is None, no settling is assumed.
    """
    spectra = pooled_spectra(sums)
    longest = sums.longest
    octaves = 0
    for o, blocks in enumerate(spectra.blocks.tolist()):
        if blocks < 1 or (o and LOWEST_BLOCKS * octave(o).length > longest):
            break
        octaves = o + 1
    is_used = spectra.octave < octaves
    power, settling_share = spectra.power[is_used], np.zeros_like(spectra.power[is_used])
    if settling is not None:
        blocks_of_bins = np.maximum(spectra.blocks[spectra.octave[is_used]], 1)[:, None]
        mean_settling_power = settling_power(sums, settling, octaves) / blocks_of_bins
        settling_share = np.clip(
            mean_settling_power / np.maximum(power, 1e-300), 0.0, LARGEST_SETTLING_SHARE
        )
    step, groups = _groups(sums, lower_edge(octaves), settling)
    return Statistics(
        sums.samples,
        longest,
        spectra.octave[is_used],
        spectra.f[is_used],
        power,
        settling_share,
        spectra.shared_dof[is_used],
        spectra.dof[is_used],
        float(spectra.squared_correlations[is_used][-1]) if octaves else 1.0,
        step,
        groups,
        sums.replaced,
    )


def decay_of_means(time: float, step: int, number: int) -> Floats:
    """Return consecutive means of exp(-t/T) over ``step`` samples, from t = 0 on, (number,).

    ``time`` is T in samples.
    """
    first_mean = math.expm1(-step / time) / math.expm1(-1.0 / time) / step
    return np.asarray(first_mean * np.exp(-step / time * np.arange(number)))


def settling_power(sums: AllanSums, settling: Settling, octaves: int) -> Floats:
    """Return the power of a settling, (bins, axes), summed over all spectral blocks.

    The power is in the squared unit of the samples. Segments without block means are ignored.
    """
    segments = [
        (settling.sizes[i] * math.exp(-elapsed(r, m, sums.tau0 or 1.0) / settling.time), m.samples)
        for i, r in enumerate(sums.recordings)
        if i in settling.sizes
        for m in r.means
    ]
    power = [np.zeros((0, len(sums.axes)))]
    for o in range(octaves):
        step, size, bins = octave(o)
        block_power = np.abs(tapers(size, bins) @ decay_of_means(settling.time, step, size)) ** 2
        hop = octave(o).length // 2
        total = np.zeros(len(sums.axes))
        for start, samples in segments:
            blocks = max(samples // hop - 1, 0)
            # logarithm of the ratio of the powers of two successive blocks
            log_ratio = -2.0 * hop / settling.time
            total += start**2 * math.expm1(log_ratio * blocks) / math.expm1(log_ratio)
        power.append(block_power[:, None] * total)
    return np.concatenate(power)


def _groups(
    sums: AllanSums, edge: float, settling: Settling | None
) -> tuple[int, tuple[Group, ...]]:
    """Return the samples per block mean, and the contrasts in groups of segments of equal size.

    The block means of all segments are first averaged to the longest blocks of any segment. A
    segment, or a piece of a divided segment, contains a settling if it begins within `SETTLED` time
    constants after the start of its recording. ``edge`` is the crossover frequency in cycles per
    sample.
    """
    means = [(r, m) for r in sums.recordings for m in r.means]
    step = max((m.step for _, m in means), default=1)
    segments = [(r, m, _coarser(m.values.T, step // m.step)) for r, m in means]
    uses_whole_segments = len({y.shape[1] for *_, y in segments}) <= MOST_LENGTHS
    decay = settling.time / step if settling is not None else 0.0
    pieces: dict[tuple[int, float], list[Floats]] = {}
    for recording, m, y in segments:
        offset = 0
        start = elapsed(recording, m, sums.tau0 or 1.0) / step
        for points in [y.shape[1]] if uses_whole_segments else _lengths(y.shape[1]):
            if points >= LEAST_POINTS:
                has_settling = start + offset < SETTLED * decay
                pieces.setdefault((points, has_settling * decay), []).append(
                    y[:, offset : offset + points]
                )
            offset += points
    groups = []
    for (points, piece_decay), pieces_of_size in sorted(pieces.items()):
        most_cosines = points - 2 - bool(piece_decay)
        size = Size(
            points, min(int(2.0 * points * step * edge), most_cosines, MOST_CONTRASTS), piece_decay
        )
        if size.high >= 2:
            stacked = np.stack(pieces_of_size)
            groups += [Group.of(half, stacked) for half in size.halves()]
    return step, tuple(groups)


def elapsed(recording: RecordedPeriods, means: BlockMeans, tau0: float) -> float:
    """Return the time in samples from the start of a recording to the start of a segment.

    The recording starts with its first period, also if earlier periods were excluded.
    """
    return (means.start_ns - recording.periods[0].begin_ns) * 1e-9 / tau0


def _coarser(y: Floats, factor: int) -> Floats:
    """Return the means over groups of ``factor`` neighboring columns of y, (axes, columns)."""
    points = y.shape[1] // factor
    return np.asarray(y[:, : points * factor].reshape(len(y), points, factor).mean(axis=2))


def _lengths(points: int) -> list[int]:
    """Return the lengths of pieces into which ``points`` block means are divided.

    The lengths are 4, 6, 8, 12, 16 ..., the longest first. Fewer than 4 remaining block means are
    omitted.
    """
    lengths, sizes = [], sorted((s << k for k in range(9) for s in (4, 6)), reverse=True)
    for size in sizes:
        while points >= size:
            lengths.append(size)
            points -= size
    return lengths
