# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ramp of a segment, estimated from points of its phase, and the effect of removing it.

The second differences z of equally spaced phase points, divided by the square of their distance,
are estimates of the ramp r (per sample) with stationary noise. The best linear unbiased estimate
(Aitken 1935) is

    r = 1' Z^-1 z / 1' Z^-1 1        var r = 1 / 1' Z^-1 1

where Z is the Toeplitz covariance matrix of z under the noise model. The estimate is linear in the
phase, r = weights @ phase. If r m^2 is subtracted from every difference d, the expectation of the
Allan variances is still linear in the variance coefficients. For any fixed weights, the Allan
variance V_i at the averaging factor m_i becomes V'_i with the expectation

    E V'_i = E V_i - sqrt2 m_i Cov(S_i, r) + m_i^2 Var(r) / 2

where S_i is the mean of d/(sqrt2 m_i). `RampEffect` contains Cov(S_i, r) and Var(r) per unit
coefficient.
"""

# The phase of a Gauss-Markov process of unit variance and correlation time T has the generalized
# covariance -A |t|/2 - B/2 exp(-|t|/T), with A and B of `gauss_markov_sums`: A times the covariance
# of white noise, plus an exponential part.

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from ..allan.engine import PHASE_POINTS
from ..allan.history import cell_step
from ..allan.sums import LENGTH_CLASS_RATIO, LengthClass, counts, grid_for, ols_ramp_weights
from ..noise import gauss_markov_sums
from .covariance import pair_sums
from .model import (
    DIFFERENCE,
    RANDOM_TERMS,
    WHITE,
    Floats,
    Ints,
    N,
    phase_covariance,
    walk_from_cubic,
)

SHIFTS_PER_OCTAVE = 4
"""Number of correlation times per octave at which `ProcessShift` is computed; interpolation between
them is accurate to 1e-4."""

SHORTEST_SHIFT = 0.25
"""Shortest of these correlation times, in samples."""

_FOURTH_DIFFERENCE = np.convolve(DIFFERENCE, DIFFERENCE)
"""Coefficients of the fourth difference: the covariance of second differences of the phase is the
fourth difference of the covariance of the phase."""


class Noise(NamedTuple):
    """Random noise model: variance coefficients and correlation times.

    Attributes
    ----------
    variances : (4 + processes,) float64 array
        q, w, b, k and the variance of each Gauss-Markov process.
    times : tuple of float
        Correlation times of the processes in samples.
    """

    variances: Floats = WHITE
    times: tuple[float, ...] = ()

    def without_processes(self) -> Floats:
        """Return q, w, b, k >= 0 with each Gauss-Markov process replaced by white noise.

        The white noise has the spectral density of the process at low frequencies.
        """
        variances = np.maximum(self.variances, 0.0)
        four = variances[: len(RANDOM_TERMS)].copy()
        if self.times:
            four[N] += variances[len(RANDOM_TERMS) :] @ gauss_markov_sums(self.times)[0]
        return four


@dataclass(frozen=True)
class RampEffect:
    """Variance of an estimated linear drift (ramp), and its covariance with mean differences.

    Both are per unit coefficient; ``noises`` are the four random terms and the processes.

    Attributes
    ----------
    cross : (noises, factors) float64 array
        Covariance of the ramp with S_i, the mean of the differences d_i/(sqrt2 m_i).
    variance : (noises,) float64 array
        Variance of the ramp.
    """

    cross: Floats
    variance: Floats

    def shift(self, m: Ints) -> Floats:
        """Return the change of the expected Allan variances due to the removal of the ramp.

        It is -sqrt2 m ``cross`` + m^2 ``variance`` / 2 per unit coefficient, (factors, noises).
        """
        factor = m.astype(float)
        added = np.outer(self.variance, factor**2 / 2.0) - np.sqrt(2.0) * factor * self.cross
        return np.asarray(added.T)


@dataclass(frozen=True)
class RampGeometry:
    """Covariances that determine the best estimate of the linear drift (ramp) of a segment.

    Attributes
    ----------
    points, step : int
        Number of phase points and their distance in samples.
    m : (factors,) int64 array
        Averaging factors.
    second_differences : (4, points - 2) float64 array
        Covariance at lag 0, 1, .. of the second differences of the phase, per unit coefficient.
    cross : (4, factors, points) float64 array
        Covariance of S_i, the mean of the differences d_i/(sqrt2 m_i), with each phase point, per
        unit coefficient.
    ends, shares : (factors, 6) float64 arrays
        Approximation of ``cross`` by integrals over the start positions of the differences: the
        covariance of S_i with a phase point at x is sum_e share_e F(end_e - x), where F is the
        integral of the covariance of the phase.
    excess : (factors, points) float64 array
        Exact ``cross`` for white noise minus this approximation. They differ because the covariance
        has a discontinuous slope at lag 0.
    stride : (factors,) int64 array
        Samples between two start positions.
    """

    points: int
    step: int
    m: Ints
    second_differences: Floats
    cross: Floats
    ends: Floats
    shares: Floats
    excess: Floats
    stride: Ints

    def best_weights(self, noise: Noise) -> Floats | None:
        """Return the weights of the phase points in the best estimate of the ramp, (points,).

        None if there are fewer than three points, or the noise is 0.
        """
        z = self.points - 2
        if z < 1:
            return None
        rows = np.concatenate([self.second_differences, self._process_differences(noise.times)])
        row = np.maximum(noise.variances, 0.0) @ rows
        if not row[0] > 0.0:
            return None
        lag = np.abs(np.arange(z)[:, None] - np.arange(z))
        solution = np.linalg.solve(row[lag] / row[0], np.ones(z))
        return np.asarray(np.convolve(solution / solution.sum(), DIFFERENCE) / self.step**2)

    def effect(self, weights: Floats, times: Sequence[float] | Floats = ()) -> RampEffect:
        """Return the variance and the covariances of the ramp estimate ``weights @ phase``.

        ``times`` are the correlation times, in samples, of processes that follow the four terms.
        """
        cross = self.cross @ weights
        if len(times):
            cross = np.concatenate([cross, self._process_cross(weights, times, cross[N])])
        return RampEffect(cross, self.variance(weights, times))

    def variance(self, weights: Floats, times: Sequence[float] | Floats = ()) -> Floats:
        """Return the variance of the ramp estimate ``weights @ phase`` per unit coefficient.

        The shape is (4 + times,), where ``times`` are correlation times of processes in samples.
        """
        on_second = np.cumsum(np.cumsum(weights))[:-2]
        # w' Z w of a Toeplitz matrix Z is the sum of its lags times the autocorrelation of w.
        lags = np.correlate(on_second, on_second, 'full')[len(on_second) - 1 :]
        lags[1:] *= 2.0
        rows = [self.second_differences]
        if len(times):
            rows.append(self._process_differences(times))
        return np.asarray(np.concatenate(rows) @ lags)

    def _process_differences(self, times: Sequence[float] | Floats) -> Floats:
        """Return ``second_differences`` for unit processes, (processes, points - 2)."""
        slope, size = gauss_markov_sums(times)
        lags = np.abs(np.arange(-2, max(self.points, 3))) * float(self.step)
        decay = np.exp(-lags / np.reshape(times, (-1, 1)))
        fourth = sum(
            c * decay[:, n : n + self.points - 2] for n, c in enumerate(_FOURTH_DIFFERENCE)
        )
        return np.asarray(
            np.outer(slope, self.second_differences[N]) - size[:, None] / 2.0 * fourth
        )

    def _process_cross(
        self, weights: Floats, times: Sequence[float] | Floats, white: Floats
    ) -> Floats:
        """Return the covariances `RampEffect.cross` of unit processes, (processes, factors)."""
        # The integral of exp(-|t|/T) is T sign(t) (1 - exp(-|t|/T)). The sum of its values at t - x
        # over the points x follows from sums of the weights before and after t, with and without an
        # exponential factor. These are computed as convolutions.
        slope, size = gauss_markov_sums(times)
        time = np.reshape(times, (-1, 1))
        n = self.points
        kernel = np.fft.rfft(np.exp(-np.arange(n) * self.step / time), 2 * n)
        before = np.fft.irfft(kernel * np.fft.rfft(weights, 2 * n), 2 * n)[:, :n]
        after = np.fft.irfft(kernel * np.fft.rfft(weights[::-1], 2 * n), 2 * n)[:, n - 1 :: -1]
        t = self.ends.ravel()
        cell = np.clip(np.floor(t / self.step).astype(np.int64), -1, n - 1)
        past = np.maximum(t - cell * self.step, 0.0)
        ahead = np.maximum((cell + 1) * self.step - t, 0.0)
        value = np.pad(after, ((0, 0), (0, 1)))[:, cell + 1] * np.exp(-ahead / time)
        value -= np.pad(before, ((0, 0), (1, 0)))[:, cell + 1] * np.exp(-past / time)
        value *= np.repeat(_sum_over_integral(time, self.stride), self.ends.shape[1], axis=1)
        value += 2.0 * np.concatenate([[0.0], np.cumsum(weights)])[cell + 1]
        part = (value.reshape(-1, *self.ends.shape) * self.shares).sum(axis=2)
        smooth = np.outer(slope, white - self.excess @ weights) - size[:, None] / 2.0 * time * part
        return np.asarray(smooth + _slope_correction(time, self.stride) * (self.excess @ weights))


@lru_cache(maxsize=80)
def ramp_geometry(samples: int, step: int = 0) -> RampGeometry:
    """Return the `RampGeometry` of a segment of ``samples`` samples; the last 80 are cached.

    ``step`` is the number of samples between two phase points. If 0, it follows from the length.
    """
    if not step:
        step = cell_step(samples, PHASE_POINTS)
    points = samples // step + 1
    m, stride = grid_for(samples)
    count = counts(samples, m, stride)
    lags = np.arange(-2, max(points, 3), dtype=np.float64) * step
    second_differences = np.stack(
        [np.convolve(g, _FOURTH_DIFFERENCE, mode='valid') for g in phase_covariance(lags)]
    )[:, : points - 2]
    at = np.arange(points) * float(step)
    ends, shares = _integral_limits(samples)
    cross = np.zeros((len(RANDOM_TERMS), len(m), points))
    exact = np.zeros((len(m), points))
    for a, c in enumerate(DIFFERENCE):
        start = at - (a * m)[:, None]
        is_start = (start >= 0) & (start <= ((count - 1) * stride)[:, None])
        cross[0] += c * (is_start & (start % stride[:, None] == 0))
        # sum_k |k s - start| over 0 <= k < M
        below = np.clip(start // stride[:, None] + 1, 0, count[:, None])
        exact -= (
            c
            / 2.0
            * (start * (2 * below - count[:, None]) - (stride[:, None] * below * (below - 1)))
        )
    norm = (np.sqrt(2.0) * m * count)[:, None]
    cross[0] /= norm
    for end, share in zip(ends.T, shares.T):
        cross[1:] += share[:, None] * _phase_integrals(end[:, None] - at, at[-1], stride[:, None])
    excess = exact / norm - cross[N]
    cross[N:] += np.multiply.outer([1.0, 0.0, 1.0 / 6.0], excess)
    return RampGeometry(points, step, m, second_differences, cross, ends, shares, excess, stride)


def _slope_correction(time: Floats, stride: Ints) -> Floats:
    """Return a correction of integrals over start positions, relative to that of white noise."""
    # The covariance of a Gauss-Markov process has a discontinuous slope at lag 0, where a sum over
    # starts at a distance of s samples differs from an integral. The sum of exp(-|t|/T) is
    # coth(s/2T), its integral 2T/s. For white noise, -|t|/2, sum and integral differ by s/12.
    slope, size = (x.reshape(np.shape(time)) for x in gauss_markov_sums(np.ravel(time)))
    half = stride / (2.0 * time)
    large = np.maximum(half, 1e-3)
    excess = np.where(half < 1e-3, half / 3.0, 1.0 / np.tanh(large) - 1.0 / large)
    return np.asarray(slope - 6.0 * size / stride * excess)


def _sum_over_integral(time: Floats, stride: Ints) -> Floats:
    """Return the ratio of the sum of exp(-t/time) at steps of ``stride`` to its integral."""
    half = np.minimum(stride / (2.0 * time), 300.0)
    return np.asarray(half / np.sinh(half))


def _integral_limits(samples: int) -> tuple[Floats, Floats]:
    """Return limits and weights of the integrals over start positions, (factors, 6) each."""
    # The sum over starts u = 0, s .. (M-1) s of sum_a c_a G(u + a m - x) is replaced by the
    # integral from -s/2 to (M - 1/2) s. G is the covariance of the phase.
    m, stride = grid_for(samples)
    count = counts(samples, m, stride)
    share = 1.0 / (np.sqrt(2.0) * m * count * stride)
    ends = [(a * m + e) for a in range(3) for e in ((count - 0.5) * stride, -0.5 * stride)]
    shares = [sign * c * share for c in DIFFERENCE for sign in (1.0, -1.0)]
    return np.stack(ends, axis=1), np.stack(shares, axis=1)


def _phase_integrals(t: Floats, unit: float, stride: Ints) -> Floats:
    """Return the phase covariances of w, b and k integrated from 0 to t, (3, ...)."""
    # They are reduced by s^2/24 times the second derivative of the integral, which converts it to
    # the sum over starts (Euler-Maclaurin). ``unit`` scales the lags in the logarithm, which has no
    # effect on the result.
    size, end = np.abs(t), stride**2 / 24.0
    white = -t * size / 4.0 + end * np.where(t < 0.0, -0.5, 0.5)
    log = np.log(np.maximum(size, 1e-9) / unit)
    flicker = (t**3 * (log / 3.0 - 1.0 / 9.0) - end * t * (2.0 * log + 1.0)) / (2.0 * np.pi)
    return np.stack(
        [white, flicker, walk_from_cubic(white, t * size * (size**2 / 48.0 - end / 4.0))]
    )


@lru_cache(maxsize=256)
def mean_covariances(samples: int, time: float) -> Floats:
    """Return the covariances of the mean differences at two averaging factors, (pairs,).

    The noise is a Gauss-Markov process of unit variance with the correlation time ``time`` in
    samples. The pairs are the factors i <= j of `numpy.triu_indices`.
    """
    # The double sum over the starts is computed as a double integral of the covariance of the
    # phase, whose second antiderivative is -A |t|^3/12 - B/2 (T^2 exp(-|t|/T) + T |t|), with A and
    # B of `gauss_markov_sums`.
    slope, size = (float(x[0]) for x in gauss_markov_sums(time))
    ends, shares = _integral_limits(samples)
    t = np.abs(ends.reshape(-1, 1) - ends.ravel())
    stride = grid_for(samples)[1]
    end = np.repeat(stride**2 / 24.0, ends.shape[1])
    less = np.repeat(_sum_over_integral(np.array(time), stride), ends.shape[1])
    decay = time * np.exp(-t / time) * np.outer(less, less) + t
    second = np.stack([t**3 / 12.0 - np.add.outer(end, end) * t / 2.0, size / 2.0 * time * decay])
    full = (second.reshape(2, -1, *ends.shape) * shares).sum(axis=3)
    full = (full.reshape(2, *ends.shape, -1) * shares[:, :, None]).sum(axis=2)
    i, j = np.triu_indices(len(shares))
    white, decay = full[:, i, j]
    pairs = pair_sums(samples)
    exact = pairs.singles[N] / (pairs.count[i].astype(float) * pairs.count[j])
    level = _slope_correction(np.array(time), stride)[i]
    return np.asarray(slope * white + decay + level * (exact - white))


# --- segments that are pooled by length -----------------------------------------------------------


def least_squares_effect(samples: int, times: Sequence[float] | Floats = ()) -> RampEffect | None:
    """Return the `RampEffect` of a least-squares ramp, or None if the segment is too short.

    ``times`` are correlation times of processes in samples.
    """
    geometry = ramp_geometry(samples)
    if geometry.points < 3:
        return None
    return geometry.effect(ols_ramp_weights(geometry.points, geometry.step), times)


def pooled_shift(
    classes: Sequence[LengthClass],
    m: Ints,
    stride: Ints,
    count: Ints,
    times: Sequence[float] | Floats = (),
) -> Floats:
    """Return the change of expected Allan sums due to linear drifts removed from short segments.

    An Allan sum is the sum of d^2/(2 m^2) over all differences d. The result is per unit
    coefficient, (factors, 4 + processes). ``classes`` are groups of segments of similar length.
    ``m``, ``stride`` and ``count`` are the averaging factors, the samples between two start
    positions and the numbers of differences of all groups. ``times`` are correlation times of
    processes in samples.
    """
    change = np.zeros((len(m), len(RANDOM_TERMS) + len(times)))
    number = np.zeros(len(m))
    partly = np.zeros(len(m), np.int64)
    for pool in classes:
        mean, low, high = _length_bounds(pool)
        whole = np.flatnonzero(2 * m <= low)
        here = pool.count * _differences_per_segment(pool, mean, m[whole], stride[whole])
        number[whole] += here
        change[whole] += here[:, None] * _ramp_shift(round(mean), times)[whole]
        partly[(2 * m > low) & (2 * m < high)] = round(mean)
    for i in np.flatnonzero(partly):
        remaining = max(count[i] - number[i], 0.0)
        number[i] += remaining
        change[i] += remaining * _ramp_shift(max(int(partly[i]), 2 * int(m[i])), times)[i]
    return np.asarray(change * (count / np.maximum(number, 1.0))[:, None])


def _length_bounds(pool: LengthClass) -> tuple[float, float, float]:
    """Return the mean, least and largest possible length of the segments of a length class."""
    mean = pool.samples / pool.count
    if pool.count == 1:
        return mean, mean, mean
    low = LENGTH_CLASS_RATIO ** np.floor(np.log(mean) / np.log(LENGTH_CLASS_RATIO))
    return mean, min(low, mean), low * LENGTH_CLASS_RATIO


def _differences_per_segment(pool: LengthClass, mean: float, m: Ints, stride: Ints) -> Floats:
    """Return the mean number of differences per segment of a length class, (factors,)."""
    if pool.count == 1:
        return counts(pool.samples, m, stride).astype(float)
    # The mean of floor((n - 2 m)/s) + 1 over lengths n with any remainder.
    return np.asarray((mean - 2 * m) / stride + (1.0 + 1.0 / stride) / 2.0)


def _ramp_shift(samples: int, times: Sequence[float] | Floats) -> Floats:
    """Return the change of Allan variances due to the removal of a ramp, (factors, noises)."""
    effect = least_squares_effect(samples, times)
    m = ramp_geometry(samples).m
    return np.zeros((len(m), len(RANDOM_TERMS) + len(times))) if effect is None else effect.shift(m)


class ProcessShift:
    """Effect of the removal of linear drifts on the Allan variances of Gauss-Markov processes.

    It is computed at `SHIFTS_PER_OCTAVE` correlation times per octave and interpolated for others.

    Parameters
    ----------
    samples : int
        Length of the longest segment, which is also the longest correlation time.
    compute : callable
        Returns the change for given correlation times, (factors, processes).
    """

    def __init__(self, samples: int, compute: Callable[[Floats], Floats]) -> None:
        self._samples, self._compute = samples, compute

    @cached_property
    def _values(self) -> Floats:
        octaves = max(np.log2(self._samples / SHORTEST_SHIFT), 1.0)
        steps = np.arange(-1, int(octaves * SHIFTS_PER_OCTAVE) + 3)
        # Divided by the spectral density at low frequencies, the change is a smooth function of the
        # logarithm of the correlation time.
        times = SHORTEST_SHIFT * 2.0 ** (steps / SHIFTS_PER_OCTAVE)
        return np.asarray(self._compute(times) / gauss_markov_sums(times)[0])

    def __call__(self, times: Floats) -> Floats:
        """Return the change for unit processes, (factors, times); times are in samples."""
        u = SHIFTS_PER_OCTAVE * np.log2(times / SHORTEST_SHIFT)
        at = np.clip(np.floor(u).astype(np.int64), 0, self._values.shape[1] - 4)
        x = np.maximum(u - at, 0.0)
        weights = (
            -x * (x - 1.0) * (x - 2.0) / 6.0,
            (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
            -(x + 1.0) * x * (x - 2.0) / 2.0,
            (x + 1.0) * x * (x - 1.0) / 6.0,
        )
        out = sum(w * self._values[:, at + n] for n, w in enumerate(weights))
        return np.asarray(out * gauss_markov_sums(times)[0])
