# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Allan deviation curves and spectra, with chi-squared limits and degrees of freedom.

Degrees of freedom
------------------
The estimate V of a variance from M second differences has edf = 2 V^2 / Var V equivalent degrees of
freedom. For Gaussian noise, Var V = (2 V^2 / M^2) sum of rho^2 over all pairs of differences, where
rho is the correlation of a pair (Greenhall & Riley, Uncertainty of stability variances based on
finite differences, 35th PTTI, 2003, eq. 10; NIST SP 1065 section 5.4.1). Segments are independent,
so the sums of the segments add up.

The sum is computed directly over all lags at which rho is not negligible. The approximations of the
source are not used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import AllanError
from .grid import counts, octave, overlap
from .periods import ByValue, totals
from .sums import AllanSums

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CI_LEVEL = 0.683
"""Confidence level of the limits of a curve: one standard deviation, as in NIST SP 1065 and
Stable32."""

WHITE_PHASE, WHITE, FLICKER, RANDOM_WALK = 2, 0, -1, -2
"""Noise types: exponents alpha of the power spectral density ~ f^alpha of the samples (NIST SP 1065
table 2). Flicker phase noise (1) counts as white phase noise, whose curve has the same slope."""

LONGEST_LAG = 6
"""Largest lag, in averaging factors m, up to which squared correlations of second differences are
summed. For flicker noise, larger lags would change the sum by about 5e-4 of itself."""


def edf(noise_type: int, m: int, stride: int, counts: ArrayLike, number: ArrayLike = 1) -> float:
    """Return the equivalent degrees of freedom of an Allan variance over one or more segments.

    Parameters
    ----------
    noise_type : int
        Exponent alpha of the spectrum ~ f^alpha of the samples: 2, 0, -1 or -2.
    m : int
        Averaging factor.
    stride : int
        Samples from the start of one second difference to the next.
    counts : int or (kinds,) array
        Number of second differences in a segment, for each kind (length) of segment.
    number : int or (kinds,) array
        Number of segments of each kind; broadcasts with ``counts``.

    Returns
    -------
    float
        NaN if all counts are 0.
    """
    counts = np.atleast_1d(np.asarray(counts, np.int64))
    segments = np.broadcast_to(np.asarray(number), counts.shape)
    segments, counts = segments[counts > 0], counts[counts > 0]
    if not len(counts):
        return float('nan')
    lags = min(int(counts.max()) - 1, LONGEST_LAG * m // stride)
    sum_squares, sum_lag_squares = _correlation_sums(noise_type, m, stride, lags)
    last_lag = np.minimum(counts, len(sum_squares)) - 1
    variance = np.sum(segments * (counts * sum_squares[last_lag] - sum_lag_squares[last_lag]))
    # float, because the square of a count above 3e9 overflows int64
    return float(np.sum(segments * counts)) ** 2 / float(variance)


@lru_cache(maxsize=1024)
def _correlation_sums(noise_type: int, m: int, stride: int, lags: int) -> tuple[Floats, Floats]:
    """Return the sums of rho^2 and of |j| rho^2 over j = -L .. L, for each L from 0 to ``lags``.

    Both results are (lags + 1,). rho is the correlation of two second differences whose starts are
    ``stride * j`` samples apart. Among M differences, there are M - |j| pairs with the lag j, so
    that the variance of the sum of squares of the differences needs both results.
    """
    lag = np.arange(1, lags + 1)
    squares = correlation(noise_type, m, stride * lag) ** 2
    sum_squares = np.concatenate([[1.0], 1.0 + 2.0 * np.cumsum(squares)])
    sum_lag_squares = np.concatenate([[0.0], 2.0 * np.cumsum(lag * squares)])
    return sum_squares, sum_lag_squares


def correlation(noise_type: int, m: int, lags: ArrayLike) -> Floats:
    """Return the correlation of two second differences at the averaging factor m, (lags,).

    The covariance is the fourth difference, with step m, of the generalized autocovariance of the
    phase.

    Parameters
    ----------
    noise_type : int
        Exponent alpha of the spectrum ~ f^alpha of the samples: 2, 0, -1 or -2.
    m : int
        Averaging factor.
    lags : (lags,) array of int
        Distances of the starts of the two differences in samples.

    Returns
    -------
    (lags,) float64 array
    """
    steps = np.arange(-2, 3) * m
    weights = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    lags = np.atleast_1d(np.asarray(lags, np.int64))
    covariance = _phase_autocovariance(noise_type, m, lags[:, None] + steps) @ weights
    variance = _phase_autocovariance(noise_type, m, steps) @ weights
    return np.asarray(covariance / variance)


def _phase_autocovariance(noise_type: int, m: int, t: Ints) -> Floats:
    """Return the generalized autocovariance of the phase at lags of t samples, up to a factor.

    The autocovariance is delta(t) for white phase noise, -|t| for white noise, t^2 ln|t| for
    flicker noise and |t|^3 - |t| for a random walk of the samples (Greenhall & Riley eq. 7, for
    discrete time). Except for phase noise, lags are divided by m. For flicker noise, this adds a
    multiple of t^2, whose fourth difference is 0.
    """
    if noise_type == WHITE_PHASE:
        return np.asarray(t == 0, float)
    u = np.abs(t) / m
    if noise_type == WHITE:
        return -u
    if noise_type == FLICKER:
        return np.asarray(u**2 * np.log(np.where(t == 0, 1.0, u)))
    return np.asarray(u**3 - u / m**2)


def chi_squared_limits(avar: ArrayLike, degrees: ArrayLike) -> tuple[Floats, Floats]:
    """Return the lower and upper limits of the deviation sqrt(avar) at the level `CI_LEVEL`.

    ``degrees`` are the equivalent degrees of freedom of ``avar``, in an array of the same shape;
    NaN gives NaN limits. The limits are sqrt(avar degrees / chi^2) at two quantiles of chi^2 (NIST
    SP 1065 section 5.3.1), in the unit of sqrt(avar).
    """
    from scipy import special

    avar, degrees = np.asarray(avar, float), np.asarray(degrees, float)
    tail = (1.0 - CI_LEVEL) / 2.0
    low, high = (np.sqrt(avar * degrees / special.chdtri(degrees, p)) for p in (tail, 1.0 - tail))
    return low, high


SLOPE_RANGE = 4.0
"""The slope of the curve at the averaging factor m is fitted to the points from m/4 to 4 m."""

MIN_AVERAGES = 16
"""Least duration of all data, in averaging times, for which the slope of the curve at an averaging
time is reliable."""

QUANTIZATION_SLOPE = -1.5
"""Slope of log avar over log tau below which the noise type is white phase noise."""


def noise_types_of_avar(m: Ints, avar: Floats, samples: int) -> Ints:
    """Return the noise type at each averaging factor from the slope of the Allan variance.

    The type is the exponent alpha = -1 - mu of the spectrum, rounded and at least -2, where mu is
    the slope of log avar over log tau (NIST SP 1065 table 4). A slope below -1.5 is classified as
    white phase noise, which in an IMU is quantization. If the slope is unknown, or all data
    together are shorter than 16 averaging times, the type at the previous factor is used, and white
    noise (0) at the first factor.

    Parameters
    ----------
    m : (factors,) int64 array
        Averaging factors, ascending.
    avar : (factors, axes) array
        Allan variances; NaN or 0 without data.
    samples : int
        Number of samples in all segments.

    Returns
    -------
    (factors, axes) int64 array
    """
    slopes = _local_slopes(m, avar, np.where(MIN_AVERAGES * m <= samples, samples / m, 0.0))
    types = np.empty(avar.shape, np.int64)
    for axis in range(avar.shape[1]):
        noise_type = WHITE
        for i, slope in enumerate(slopes[:, axis]):
            if MIN_AVERAGES * m[i] <= samples and np.isfinite(slope):
                is_white_phase = slope < QUANTIZATION_SLOPE
                noise_type = (
                    WHITE_PHASE if is_white_phase else max(round(-1.0 - slope), RANDOM_WALK)
                )
            types[i, axis] = noise_type
    return types


def _local_slopes(m: Ints, avar: Floats, weights: Floats) -> Floats:
    """Return the slope of log avar over log m near each factor; NaN with fewer than two points.

    The points are weighted by ``weights``, (factors,).
    """
    log_m = np.log(m.astype(float))
    distance = np.log(SLOPE_RANGE) * (1.0 + 1e-9)
    slopes = np.full(avar.shape, np.nan)
    for axis in range(avar.shape[1]):
        has_variance = (weights > 0.0) & (avar[:, axis] > 0.0)
        log_avar = np.log(avar[has_variance, axis])
        used_log_m, used_weights = log_m[has_variance], weights[has_variance]
        for i in range(len(m)):
            is_near = np.abs(used_log_m - log_m[i]) <= distance
            if np.count_nonzero(is_near) < 2:
                continue
            share = used_weights[is_near] / used_weights[is_near].sum()
            distances = used_log_m[is_near] - share @ used_log_m[is_near]
            slopes[i, axis] = (share * distances) @ log_avar[is_near]
            slopes[i, axis] /= (share * distances) @ distances
    return slopes


UNCERTAIN = 1.5
"""A point of the curve is compared with a model only if its upper limit is at most this multiple of
its value. With a higher upper limit, the point has fewer than six degrees of freedom."""


@dataclass(frozen=True, eq=False)
class AxisCurve(ByValue):
    """Overlapping Allan deviation with its 68.3 % confidence limits.

    Attributes
    ----------
    m : (factors,) int64 array
        Averaging factors in samples. If `fit` was called with lists tau and adev, the ratios of tau
        to the shortest tau, rounded.
    tau : (factors,) float64 array
        Averaging times in s, ascending.
    n : (factors,) int64 array
        Number of second differences in each point; 0 if `fit` was called with lists.
    adev, ci_low, ci_high : (factors,) float64 arrays
        Allan deviation and its limits in the unit of the samples; the limits are NaN if `fit` was
        called with lists. The shape is (factors, axes) in an `AllanCurve`, and (factors, columns)
        for samples with several columns.

    Examples
    --------
    >>> import allan_ros as ar
    >>> ar.adev([1.0, 2.0, 1.0, 3.0, 1.0], rate=2.0).tau
    array([0.5, 1. ])
    """

    m: Ints
    tau: Floats
    n: Ints
    adev: Floats
    ci_low: Floats
    ci_high: Floats

    @property
    def is_uncertain(self) -> NDArray[np.bool_]:
        """Whether each point is too uncertain for a comparison with a model (shape of ``adev``).

        >>> import allan_ros as ar
        >>> ar.adev([1.0, 2.0, 1.0, 3.0, 1.0], rate=2.0).is_uncertain
        array([ True,  True])
        """
        return ~(self.ci_high <= UNCERTAIN * self.adev)


@dataclass(frozen=True, eq=False)
class AllanCurve(AxisCurve):
    """Overlapping Allan deviation of all axes: an `AxisCurve` with one column for each axis.

    Attributes
    ----------
    axes : tuple of str
        Names of the columns.
    edf : (factors, axes) float64 array
        Equivalent degrees of freedom.
    noise_type : (factors, axes) int64 array
        Noise type for which ``edf`` was computed, as exponent alpha of the spectrum ~ f^alpha:
        2 (Q), 0 (N), -1 (B), -2 (K, R).
    """

    axes: tuple[str, ...]
    edf: Floats
    noise_type: Ints

    def axis(self, i: int) -> AxisCurve:
        """Return the curve of the axis in column ``i``."""
        columns = (column[:, i] for column in (self.adev, self.ci_low, self.ci_high))
        return AxisCurve(self.m, self.tau, self.n, *columns)


def sample_period(sums: AllanSums) -> float:
    """Return the sample period in s; raise `AllanError` if no segment has two samples."""
    if sums.tau0 is None:
        raise AllanError(
            'an Allan curve needs at least two samples without a gap: record for some minutes'
        )
    return sums.tau0


def allan_curve(sums: AllanSums) -> AllanCurve:
    """Return the Allan deviation curve of Allan sums, at the averaging factors that have data.

    Raises
    ------
    AllanError
        If no segment has two samples.
    """
    tau0 = sample_period(sums)
    has_data = sums.count > 0
    m, stride, avar = sums.m[has_data], sums.stride[has_data], sums.avar[has_data]
    types = noise_types_of_avar(m, avar, sums.samples)
    adev, n = np.sqrt(avar), sums.count[has_data]
    # a part of a recording has fewer differences than complete segments of the same lengths have
    complete_count = sum(k * counts(round(size), m, stride) for size, k in sums.length_histogram)
    complete_share = np.minimum(n / np.maximum(complete_count, 1), 1.0)[:, None]
    degrees = complete_share * degrees_of_freedom(sums, m, stride, types)
    low, high = chi_squared_limits(avar, degrees)
    tau = np.asarray(m * tau0, float)
    return AllanCurve(m, tau, n, adev, low, high, sums.axes, degrees, types)


def degrees_of_freedom(sums: AllanSums, m: Ints, stride: Ints, types: Ints) -> Floats:
    """Return the equivalent degrees of freedom of the Allan variances from Allan sums.

    All segments of a length class are assumed to have the mean length of the class.

    Parameters
    ----------
    sums : AllanSums
    m : (factors,) int64 array
        Averaging factors.
    stride : (factors,) int64 array
        Samples from the start of one second difference to the next; m for the non-overlapping Allan
        variance.
    types : (factors, axes) int64 array
        Noise types from `noise_types_of_avar`.

    Returns
    -------
    (factors, axes) float64 array
        NaN at factors for which no segment is long enough.
    """
    dof = np.empty(types.shape)
    lengths = [round(samples) for samples, _ in sums.length_histogram]
    segments_of_length = [number for _, number in sums.length_histogram]
    for i in range(len(m)):
        differences_per_segment = np.array([counts(n, m[i], stride[i]) for n in lengths])
        degrees_of_type = {
            t: edf(t, int(m[i]), int(stride[i]), differences_per_segment, segments_of_length)
            for t in set(types[i].tolist())
        }
        dof[i] = [degrees_of_type[t] for t in types[i].tolist()]
    return dof


# --- spectra --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Spectra:
    """Mean power of the spectral blocks in all bins, from octave 0 (high frequencies) on.

    From octave 5 on, the blocks consist of means of samples. The powers of two bins of a block are
    correlated, and so are the powers of overlapping blocks. ``dof`` are the degrees of freedom of
    the mean power of one bin. A sum over all bins is about as accurate as if each bin was
    independent and had ``shared_dof`` degrees of freedom.
    """

    octave: Ints  # (bins,) octave of each bin
    f: Floats  # (bins,) center frequencies in cycles per sample
    power: Floats  # (bins, axes) in the squared unit of the samples
    dof: Floats  # (bins,) degrees of freedom of the mean power of a bin
    shared_dof: Floats  # (bins,) degrees of freedom that a bin contributes to a sum over all bins
    # (bins,) sum of the squared correlations of the mean power of a bin with all bins
    squared_correlations: Floats
    blocks: Ints  # (octaves,) number of spectral blocks
    pairs: Ints  # (octaves,) number of pairs of overlapping spectral blocks

    @property
    def octaves(self) -> int:
        """Number of octaves."""
        return len(self.blocks)


def pooled_spectra(sums: AllanSums) -> Spectra:
    """Return the mean power in each bin over all spectral blocks of Allan sums."""
    periods = sums.periods
    no_counts, axis_count = np.zeros(0, np.int64), len(sums.axes)
    blocks, pairs = (
        totals([no_counts, *(getattr(p, k) for p in periods)]) for k in ('blocks', 'pairs')
    )
    power = totals([np.zeros((0, axis_count)), *(p.power for p in periods)])
    octaves = [octave(o) for o in range(len(blocks))]
    octave_of_bin = np.repeat(np.arange(len(blocks)), [len(band.bins) for band in octaves])
    f = [np.array(band.bins) / band.length for band in octaves]
    values_of_octaves = np.zeros((3, len(blocks)))
    for o in np.flatnonzero(blocks):  # the values of other octaves stay 0
        same_block, next_blocks = overlap(int(o))
        covariance = (blocks[o] * same_block + pairs[o] * next_blocks) / float(blocks[o]) ** 2
        variance = covariance[np.argmax(same_block)]
        squared_correlations = np.sum((covariance / variance) ** 2)
        values_of_octaves[:, o] = 2.0 / variance, 2.0 / covariance.sum(), squared_correlations
    mean_power = power / np.maximum(blocks[octave_of_bin], 1)[:, None]
    frequency = np.concatenate([np.zeros(0), *f])
    dof, shared_dof, squared_correlations = values_of_octaves[:, octave_of_bin]
    return Spectra(
        octave_of_bin, frequency, mean_power, dof, shared_dof, squared_correlations, blocks, pairs
    )


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral density of all axes, with 68.3 % confidence limits."""

    axes: tuple[str, ...]  # names of the axes
    frequency: Floats  # (points,) in Hz, ascending
    psd: Floats  # (points, axes) density in the squared unit of the samples per Hz
    low: Floats  # (points, axes) lower limit of ``psd``
    high: Floats  # (points, axes) upper limit of ``psd``
    bin: NDArray[np.int64]  # (points,) index of the bin of each point, counted over all octaves
    octaves: int  # number of octaves, from octave 0 to the octave of the lowest frequency
    step: NDArray[np.int64]  # (points,) samples averaged into each value of the spectral blocks


def noise_density(sums: AllanSums) -> Spectrum | None:
    """Return the power spectral density of the samples; None if it is unknown.

    The density is unknown if the sums contain no spectral block, or if the sample period is unknown
    or 0.
    """
    spectra = pooled_spectra(sums)
    used_bins = np.flatnonzero(spectra.dof > 0.0)
    if not len(used_bins) or not sums.tau0:
        return None
    used_bins = used_bins[np.argsort(spectra.f[used_bins])]
    step = np.array([octave(o).step for o in spectra.octave[used_bins].tolist()])
    psd = 2.0 * sums.tau0 * step[:, None] * spectra.power[used_bins]
    degrees = np.broadcast_to(spectra.dof[used_bins, None], psd.shape)
    # `chi_squared_limits` returns limits of a deviation; their squares are limits of the density
    low, high = chi_squared_limits(psd, degrees)
    octaves = int(spectra.octave[used_bins].max()) + 1
    f = spectra.f[used_bins] / sums.tau0
    return Spectrum(sums.axes, f, psd, low**2, high**2, used_bins, octaves, step)
