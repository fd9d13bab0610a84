# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Mean, drift, slope over temperature, bandwidth and rounding step of the samples at rest.

`turn_on_bias` computes the repeatability of the mean from one recording to the next.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..estimate import Estimate, SignedEstimate
from ..fields import Signed
from .curve import Spectra, pooled_spectra
from .grid import octave
from .sums import AllanSums

Floats = NDArray[np.float64]

DRIFT_BLOCKS = 16
"""Largest number of means of equal length, over all recordings, from which the drift is
computed."""

LEAST_RANGE_K = 3.0
"""Least range of the temperature in K for which its effect on the samples is estimated."""

HALF_POWER = 0.5
"""Power at the upper end of the bandwidth, relative to the power of white noise (-3 dB)."""

SMOOTHED_BINS, LEAST_DOF = 5, 40.0
"""Number of neighboring bins of which the median power is taken, and fewest degrees of freedom of
each of these bins. With these numbers, the median power of white noise is below `HALF_POWER` with a
probability of about 4e-6."""


NEGLIGIBLE_STEP = 0.02
"""Largest rounding step that is ignored, as a fraction of the standard deviation of the white noise
of a sample. Such a step increases the variance of the samples by a fraction of only 3e-5."""

WHOLE_TOLERANCE = 0.05
"""A number is a multiple of a step if the ratio of the two differs from a whole number by less than
this value."""

LARGEST_SHARE = 1.05
"""Largest ratio of the variance of the rounding error to the variance of the white noise. The white
noise contains independent rounding errors. A larger ratio therefore shows that the rounding errors
of successive samples are not independent."""

LEAST_POINTS = 8
"""Fewest different numbers in which a rounding step is searched for. The numbers are cumulative
sums of the samples, and differences between sums of blocks. A few numbers can be multiples of some
step by chance."""

ROUNDING_SHARE = 0.1
"""Rounding is reported only if the variance of the rounding error is above this fraction of the
variance of the white noise."""


@dataclass(frozen=True)
class AtRest:
    """Mean, drift and bandwidth of the samples of one axis at rest, in SI.

    Attributes
    ----------
    mean : float
        Mean of all used samples: the bias, plus gravity for an accelerometer.
    drift : float or None
        Difference between the largest and the smallest of up to 16 means of equal length. The
        difference includes the noise of the means. None if there are fewer than two means.
    temperature : float or None
        Mean temperature in degC during the means from which ``drift`` is computed. The readings are
        interpolated at eight times in each mean. A mean is excluded if one of these times is before
        the first or after the last reading. None if no mean remains, or for fewer than two
        readings.
    slope : Estimate or None
        Change of the means per K, by least squares. A drift with time is not separated from the
        effect of the temperature. None if the temperatures of the means differ by less than 3 K, or
        are known for fewer than four means.
    bandwidth : float or None
        Frequency in Hz up to which the noise density, as a median over five bins, is at least
        0.71 N; half of the sample rate if the density is nowhere lower. None if N is unknown or 0,
        if fewer than five bins have enough spectral blocks, or if the density is below 0.71 N
        already at the lowest frequencies.
    """

    mean: Signed
    drift: float | None = None
    temperature: Signed | None = None
    slope: SignedEstimate | None = None
    bandwidth: float | None = None


def at_rest(
    sums: AllanSums, time_ns: NDArray[np.int64], celsius: Floats, white: Mapping[str, float | None]
) -> dict[str, AtRest]:
    """Return axis -> mean, drift, slope over temperature and bandwidth of the samples.

    Parameters
    ----------
    sums : AllanSums
        Allan sums with at least one recording.
    time_ns : (readings,) int64 array
        Times of the temperature readings in ns on the clock of the sums, ascending; may be empty.
    celsius : (readings,) array
        Temperatures in degC.
    white : mapping of axis to float or None
        Estimate of N of each axis in SI; None if it is unknown.

    Returns
    -------
    dict of axis to AtRest
    """
    sample_counts = np.array([r.samples for r in sums.recordings], float)
    mean = sample_counts @ np.array([r.mean for r in sums.recordings]) / sample_counts.sum()
    begin_ns, length_ns, means = _block_means(sums)
    block_celsius = np.full(len(means), np.nan)
    if len(celsius) > 1 and len(means):
        times_in_blocks = begin_ns[:, None] + length_ns * (np.arange(8) + 0.5) / 8.0
        block_celsius = np.interp(times_in_blocks, time_ns, celsius, np.nan, np.nan).mean(axis=1)
    has_temperature, spectra = np.isfinite(block_celsius), pooled_spectra(sums)
    temperature = float(block_celsius[has_temperature].mean()) if has_temperature.any() else None
    results = {}
    for i, axis in enumerate(sums.axes):
        drift = float(np.ptp(means[:, i])) if len(means) > 1 else None
        slope = _slope(block_celsius[has_temperature], means[has_temperature, i])
        bandwidth = _bandwidth(spectra, i, white.get(axis), sums.tau0)
        results[axis] = AtRest(float(mean[i]), drift, temperature, slope, bandwidth)
    return results


@dataclass(frozen=True)
class TurnOnBias:
    """Repeatability of the bias of one axis from one recording to the next.

    Attributes
    ----------
    recordings : int
        Number of recordings.
    mean : float
        Mean of the biases of the recordings (the means of their samples), in the unit of the
        samples.
    scatter : Estimate
        Standard deviation of the biases in the unit of the samples, after the variance of the noise
        was subtracted. The standard deviation is not resolved if the noise alone may explain the
        differences of the means. In that case, an upper limit is given instead, or no limit if the
        differences are improbably small even for the noise alone. The interval assumes normally
        distributed biases.
    """

    recordings: int
    mean: Signed
    scatter: Estimate


def turn_on_bias(means: Floats, variance: float = 0.0) -> TurnOnBias | None:
    """Return the repeatability of the bias from one recording to the next.

    Parameters
    ----------
    means : (recordings,) array
        Mean of each recording, in the unit of the samples.
    variance : float
        Variance of the means due to noise, in the squared unit of the samples: the Allan variance
        at an averaging time as long as a recording. This Allan variance is half of the mean squared
        difference of the means of two recordings that follow each other without a break. For white
        noise, it is the variance of each mean.

    Returns
    -------
    TurnOnBias or None
        None for fewer than two recordings.
    """
    from scipy.special import chdtrc, chdtri

    degrees = len(means) - 1
    if degrees < 1:
        return None
    total_variance = float(np.var(means, ddof=1))
    low, high = (
        total_variance * degrees / quantile for quantile in chdtri(degrees, [0.025, 0.975])
    )
    mean_bias = float(np.mean(means))
    scatter_limits = [math.sqrt(max(v - variance, 0.0)) for v in (low, high)]
    if total_variance <= variance or (
        variance and chdtrc(degrees, degrees * total_variance / variance) > 0.01
    ):
        limit = Estimate(None, None, scatter_limits[1] or None, 'not_observable')
        return TurnOnBias(len(means), mean_bias, limit)
    scatter = Estimate(math.sqrt(total_variance - variance), (scatter_limits[0], scatter_limits[1]))
    return TurnOnBias(len(means), mean_bias, scatter)


def equal_blocks(sums: AllanSums, most: int) -> tuple[int, list[tuple[int, int, Floats]]]:
    """Return a block length in samples, and the means of each segment over blocks of this length.

    Each item of the list contains the index of the recording of a segment, the stamp of the first
    sample of the segment in ns, and the means, (blocks, axes), in the unit of the samples. Segments
    without stored block means are omitted. The length is a power of two, chosen so that there are
    at most ``most`` blocks.
    """
    segments = [(r, m) for r, recording in enumerate(sums.recordings) for m in recording.means]
    step = max((m.step for _, m in segments), default=1)
    while sum(m.samples // step for _, m in segments) > most:
        step *= 2
    return step, [
        (r, m.start_ns, m.coarser(step).values + sums.recordings[r].reference) for r, m in segments
    ]


def _block_means(sums: AllanSums) -> tuple[Floats, float, Floats]:
    """Return the start of each block in ns, the length of a block in ns, and (blocks, axes) means.

    There are at most `DRIFT_BLOCKS` blocks.
    """
    step, segments = equal_blocks(sums, DRIFT_BLOCKS)
    length_ns = step * (sums.tau0 or 0.0) * 1e9
    begins: list[Floats] = [np.zeros(0)]
    means: list[Floats] = [np.zeros((0, len(sums.axes)))]
    for _, start_ns, values in segments:
        begins.append(start_ns + length_ns * np.arange(len(values), dtype=float))
        means.append(values)
    return np.concatenate(begins), length_ns, np.concatenate(means)


def _slope(celsius: Floats, values: Floats) -> Estimate | None:
    """Return the slope of ``values`` over temperature, per K, by least squares; None if unknown.

    ``celsius`` are the temperatures of the values in degC. The 95 % interval takes into account
    that the residuals are correlated in time: it assumes a first-order autoregressive process with
    the measured correlation of neighboring residuals, limited to the range from 0 to 0.9.
    """
    n = len(celsius)
    if n < 4 or float(np.ptp(celsius)) < LEAST_RANGE_K:
        return None
    x, y = celsius - celsius.mean(), values - values.mean()
    slope = float(x @ y / (x @ x))
    residuals = y - slope * x
    sum_sq = float(residuals @ residuals)
    rho = min(max(float(residuals[1:] @ residuals[:-1]) / sum_sq, 0.0), 0.9) if sum_sq else 0.0
    error = math.sqrt(sum_sq / (n - 2) / float(x @ x) * (1.0 + rho) / (1.0 - rho))
    return Estimate.normal(slope, error)


def _bandwidth(spectra: Spectra, i: int, white: float | None, tau0: float | None) -> float | None:
    """Return the frequency in Hz up to which the power spectral density is at least N^2/2.

    ``i`` is the index of the axis, and ``white`` is N of this axis in SI. Returns None if the
    frequency is unknown (`AtRest.bandwidth`).
    """
    if not white or not tau0:
        return None
    steps = np.array([octave(o).step for o in range(spectra.octaves)], float)
    is_precise = spectra.dof >= LEAST_DOF
    order_of_f = np.argsort(spectra.f[is_precise], kind='stable')
    f = spectra.f[is_precise][order_of_f]
    # the power of means over `step` samples is the power of the samples divided by `step`
    power = (spectra.power[is_precise, i] * steps[spectra.octave[is_precise]])[order_of_f]
    if len(f) < SMOOTHED_BINS:
        return None
    windows = np.lib.stride_tricks.sliding_window_view(power, SMOOTHED_BINS)
    relative_power = np.median(windows, axis=1) / (white**2 / tau0)
    center_f = f[SMOOTHED_BINS // 2 : len(f) - SMOOTHED_BINS // 2]
    (bins_below_half,) = np.nonzero(relative_power < HALF_POWER)
    if not len(bins_below_half):
        return 0.5 / tau0
    if bins_below_half[0] == 0:
        return None
    k = int(bins_below_half[0]) - 1
    log_before, log_after = (math.log(max(r, 1e-30)) for r in relative_power[k : k + 2])
    fraction = (log_before - math.log(HALF_POWER)) / (log_before - log_after)
    return float(center_f[k] * (center_f[k + 1] / center_f[k]) ** fraction) / tau0


def rounding_step(sums: AllanSums, axis: int, white: float) -> float | None:
    """Return the step to which the samples of an axis are rounded, or None.

    The result is None if no step is found, if the step is negligible (`ROUNDING_SHARE`), or if the
    rounding errors of successive samples are not independent (`LARGEST_SHARE`).

    ``white`` is the variance of the white noise of a sample. If the rounding errors of successive
    samples are independent, this variance contains the variance step^2/12 of these errors. A
    counter that carries its remainder to the next sample has less white noise: its rounding error
    is quantization noise (Q).
    """
    step = step_of_sums(sums, axis, math.sqrt(max(white, 0.0)))
    if step is None or not ROUNDING_SHARE < step * step / 12.0 / white < LARGEST_SHARE:
        return None
    return step


def step_of_sums(sums: AllanSums, axis: int, deviation: float) -> float | None:
    """Return the step of which the sums of samples of an axis are multiples, or None.

    The sums are cumulative sums at the ends of the blocks of the longest segment. The first sample
    of the recording is subtracted from all samples. ``deviation`` is the standard deviation of the
    white noise of a sample.
    """
    if not sums.means:
        return None
    longest = max(sums.means, key=lambda m: m.samples)
    totals = longest.step * longest.values[:, axis]
    return common_step(np.cumsum(totals), deviation)


def common_step(phase: Floats, deviation: float) -> float | None:
    """Return the largest step of which all phase values are nearly multiples, or None.

    The result is None if there is no such step, if there are too few different numbers
    (`LEAST_POINTS`), or if ``deviation`` is not above 0.

    ``phase``, (n,), contains cumulative sums of samples. ``deviation`` is the standard deviation of
    the white noise of a sample: steps below `NEGLIGIBLE_STEP` times ``deviation`` are ignored. All
    numbers have the unit of the samples.
    """
    least_step = NEGLIGIBLE_STEP * deviation
    # Sorted sums of blocks differ by only a few steps, so their differences are nearly exact.
    multiples = np.abs(np.concatenate([phase, np.diff(np.sort(np.diff(phase)))]))
    magnitudes = np.unique(multiples[multiples > least_step])
    if len(magnitudes) < LEAST_POINTS or not deviation > 0.0:
        return None
    step, values = 0.0, magnitudes.tolist()
    for i, value in enumerate(values):
        former_step, step = step, _common_divisor(value, step, least_step)
        if step < least_step:
            return None
        # Euclid's algorithm accumulates rounding errors. To remove them, the step is computed again
        # from each magnitude so far, the smallest first: magnitude / number of steps.
        for magnitude in [value] if step == former_step else values[: i + 1]:
            multiple = round(magnitude / step)
            if multiple < 1:
                return None  # the step exceeds a value that should be a multiple of it
            step = magnitude / multiple
    remainders = np.abs(magnitudes / step - np.round(magnitudes / step))
    return step if remainders.max() < WHOLE_TOLERANCE else None


def _common_divisor(a: float, b: float, least: float) -> float:
    """Return the greatest common divisor of two floats; remainders below ``least`` count as 0."""
    while b >= least:
        remainder = a % b
        a, b = b, min(remainder, b - remainder)
    return a
