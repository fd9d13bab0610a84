# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of an IMU whose five noise terms are known exactly.

The bias of a sensor wanders without bound, but the steps dy from one sample to the next are
stationary. They are drawn by circulant embedding (Davies & Harte, Biometrika 74 (1987); Dietrich
& Newsam, SIAM J. Sci. Comput. 18 (1997)): their autocovariance over all lags of the record is the
first row of a circulant matrix, whose eigenvalues are its Fourier transform; white noise times
the root of the eigenvalues, transformed back, has that autocovariance exactly. The samples are the
running sum. So the expected Allan variance is `terms.term_avar` at every factor, with no filter
order, cut-off or start-up of the approximations that are usual for flicker noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from .batch import AXES, SENSORS, ImuBatch
from .errors import AllanError
from .fault_effects import disturb_samples, disturb_stamps, lost_samples
from .faults import Faults
from .terms import NoiseTerms
from .units import STANDARD_GRAVITY

__all__ = ['NoiseTerms', 'simulate_axis', 'simulate_imu']

Floats = NDArray[np.float64]

BATCH_SAMPLES = 32768
"""Samples in one yielded batch: enough to make the cost of a batch vanish."""

ASYMPTOTIC_LAG = 20
"""From this lag on the series of `_flicker_autocovariance` is better than the difference."""

LEVEL = (0.0, 0.0, 0.0, 0.0, 0.0, STANDARD_GRAVITY)
"""Mean of the six axes of an IMU that lies still and level, z up; rad/s and m/s^2."""


def simulate_axis(n: int, tau0: float, terms: NoiseTerms, rng: np.random.Generator) -> Floats:
    """Return samples of one axis whose expected Allan variance is `term_avar` at every factor.

    Parameters
    ----------
    n : int
        How many samples, at least 1.
    tau0 : float
        Sample period in s.
    terms : NoiseTerms
        The coefficients.
    rng : numpy.random.Generator
        Source of the 2 n or so normal deviates.

    Returns
    -------
    (n,) float64 array
        In the unit of the samples, beginning at 0.

    Raises
    ------
    AllanError
        When n or tau0 is not positive.
    """
    if n < 1 or not tau0 > 0.0:
        raise AllanError(f'cannot simulate {n} samples of {tau0} s: give positive numbers')
    q, w, b, k, r = terms.in_sample_units(tau0)
    half = fft.next_fast_len(max(n - 1, ASYMPTOTIC_LAG), real=True)
    # (2 sin(pi f))^2 at the frequencies of the circulant of 2*half lags: |transfer|^2 of a step.
    step = 4.0 * np.sin(np.pi * np.arange(half + 1) / (2 * half)) ** 2
    # Of the steps dy, white theta (Q) is a second difference, white y (N) a first one, and a
    # random walk (K) white.
    eigenvalues = (q * step + w) * step + k
    if b > 0.0:
        eigenvalues += b * _flicker_eigenvalues(half)
    dy = _draw(eigenvalues, rng)[: n - 1]
    y = np.zeros(n)
    np.cumsum(dy, out=y[1:])
    if r != 0.0:
        y += r * np.arange(n)
    return y


def _draw(eigenvalues: Floats, rng: np.random.Generator) -> Floats:
    """Return one draw of the stationary sequence with these circulant eigenvalues.

    Parameters
    ----------
    eigenvalues : (half + 1,) float64 array
        Of the even circulant of 2 half lags, at its frequencies 0 .. 1/2.

    Returns
    -------
    (2 half,) float64 array
        Its first half + 1 values have the wanted autocovariance.
    """
    size = 2 * (len(eigenvalues) - 1)
    spectrum = rng.standard_normal(2 * len(eigenvalues)).view(complex)
    # A real sequence has a real value at the frequencies 0 and 1/2, of the full variance.
    spectrum[[0, -1]] = spectrum.real[[0, -1]] * math.sqrt(2.0)
    spectrum *= np.sqrt(eigenvalues * (size / 2.0))
    return np.asarray(fft.irfft(spectrum, size, overwrite_x=True))


@lru_cache(maxsize=1)
def _flicker_eigenvalues(half: int) -> Floats:
    """Return the eigenvalues of the steps of flicker noise with B = 1, (half + 1,).

    Kept for one length, since all axes of an IMU ask for the same.
    """
    # The transform of an even sequence is the cosine transform of its half.
    eigenvalues = fft.dct(_flicker_autocovariance(half), type=1, overwrite_x=True)
    eigenvalues.flags.writeable = False
    return np.asarray(eigenvalues)


def _flicker_autocovariance(lags: int) -> Floats:
    """Return the autocovariance at lags 0 .. ``lags`` of the steps of flicker noise with B = 1.

    The phase has the generalised autocovariance G(t) = t^2 ln|t| / (2 pi) (Greenhall, 34th PTTI,
    2002: flicker FM; scaled so that its Allan variance is 2 ln2/pi), the steps of the samples
    are its second differences, so theirs is the fourth central difference of G. At long lags that
    difference cancels, and its expansion in derivatives, f'''' + f''''''/6 + f^(8)/80
    + 17 f^(10)/30240 with f = t^2 ln t, is used instead (relative error 1e-9 at the seam).
    """
    t = np.arange(-2.0, ASYMPTOTIC_LAG + 3.0)
    square_log = t**2 * np.log(np.maximum(np.abs(t), 1.0))
    near = np.convolve(square_log, [1.0, -4.0, 6.0, -4.0, 1.0], mode='valid')
    u = 1.0 / np.arange(ASYMPTOTIC_LAG + 1.0, lags + 1.0) ** 2
    far = -u * (2.0 + u * (2.0 + u * (3.0 + u * 17.0 / 3.0)))
    return np.concatenate([near, far]) / (2.0 * np.pi)


def simulate_imu(
    seconds: float,
    rate: float,
    gyro: Sequence[NoiseTerms],
    accel: Sequence[NoiseTerms],
    *,
    mean: ArrayLike = LEVEL,
    seed: int = 0,
    faults: Faults = Faults(),
    start_ns: int = 0,
    frame_id: str = 'imu_link',
) -> Iterator[ImuBatch]:
    """Yield the recording of an IMU with known noise, in order.

    Every axis and every fault draws from its own stream of random numbers, so that asking for a
    fault changes nothing else.

    Parameters
    ----------
    seconds, rate : float
        Length in s and samples per second.
    gyro, accel : three NoiseTerms each
        Of x, y and z.
    mean : (6,) array
        What the noise is added to, rad/s and m/s^2; still and level by default.
    seed : int
        Not negative; the same seed gives the same recording.
    faults : Faults
        What is wrong with it; nothing by default.
    start_ns : int
        Stamp of the first sample.
    frame_id : str
        Of every batch.

    Raises
    ------
    AllanError
        When the length or rate is not positive, or there are not three axes to a sensor.
    """
    if not (seconds > 0.0 and rate > 0.0 and round(seconds * rate) >= 1):
        raise AllanError(f'cannot simulate {seconds} s at {rate} Hz: give positive numbers')
    terms = (*gyro, *accel)
    if len(gyro) != len(accel) or len(terms) != len(AXES):
        raise AllanError(f'{len(gyro)} gyro and {len(accel)} accelerometer axes: give three each')
    n, tau0 = round(seconds * rate), 1.0 / rate
    axis_seeds, fault_seed = (s for s in np.random.SeedSequence(seed).spawn(2))
    samples = np.empty((n, len(AXES)))
    for i, (axis_terms, axis_seed) in enumerate(zip(terms, axis_seeds.spawn(len(AXES)))):
        samples[:, i] = simulate_axis(n, tau0, axis_terms, np.random.default_rng(axis_seed))
    samples += np.asarray(mean, float)
    sample_seed, stamp_seed, loss_seed = fault_seed.spawn(3)
    for sensor, axes in SENSORS.items():
        disturb_samples(samples[:, axes], tau0, faults, sensor, sample_seed)
    stamps_ns = start_ns + np.round(np.arange(n) * (tau0 * 1e9)).astype(np.int64)
    kept = np.flatnonzero(~lost_samples(n, tau0, faults, np.random.default_rng(loss_seed)))
    header_ns, record_ns = disturb_stamps(stamps_ns[kept], faults, stamp_seed)
    for first in range(0, len(kept), BATCH_SAMPLES):
        rows = slice(first, first + BATCH_SAMPLES)
        yield ImuBatch(header_ns[rows], samples[kept[rows]], record_ns[rows], frame_id)
