# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise coefficients and processes of one axis, and their Allan variance."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import AllanError

FLICKER_FLOOR = 2.0 * math.log(2.0) / math.pi
"""Ratio of the Allan variance of bias instability to B^2: (0.664)^2 (IEEE Std 952-1997, C.1.3)."""


@dataclass(frozen=True)
class NoiseTerms:
    """The coefficients of IEEE Std 952-1997 annex C for one axis, in SI.

    Attributes
    ----------
    Q : float
        Quantization: rad (gyro) or m/s (accelerometer).
    N : float
        Angle or velocity random walk: rad/sqrt(s) or m/s/sqrt(s).
    B : float
        Bias instability: rad/s or m/s^2 (the coefficient, not the curve's minimum).
    K : float
        Rate or acceleration random walk: rad/s/sqrt(s) or m/s^2/sqrt(s).
    R : float
        Rate or acceleration ramp, with its sign: rad/s^2 or m/s^3.

    Raises
    ------
    AllanError
        If a value is not finite, or one of Q, N, B, K is negative.
    """

    Q: float = 0.0
    N: float = 0.0
    B: float = 0.0
    K: float = 0.0
    R: float = 0.0

    def __post_init__(self) -> None:
        for name, value in zip('QNBKR', astuple(self)):
            if not math.isfinite(value) or (value < 0.0 and name != 'R'):
                least = '' if name == 'R' else ' of 0 or above'
                raise AllanError(f'{name} is {value}: give a finite number{least}')

    def in_sample_units(self, tau0: float) -> tuple[float, float, float, float, float]:
        """Return the coefficients (q, w, b, k, r) with the sample period ``tau0`` (s) as time unit.

        q = Q^2/tau0^2, w = N^2/tau0, b = B^2, k = K^2 tau0 are variances in the squared unit of
        the samples; r = R tau0 is the ramp per sample.
        """
        return (
            (self.Q / tau0) ** 2,
            self.N**2 / tau0,
            self.B**2,
            self.K**2 * tau0,
            self.R * tau0,
        )


def term_avar(m: ArrayLike, tau0: float, terms: NoiseTerms) -> NDArray[np.float64]:
    """Return the expected Allan variance of each term at the averaging factors m.

    The terms are 3 q/m^2, w/m, (2 ln2/pi) b, k (m/3 + 1/(6 m)) and r^2 m^2/2, with q, w, b, k, r
    from `NoiseTerms.in_sample_units` (IEEE Std 952-1997 eq. C.14, for samples of period tau0). The
    part 1/(6 m) arises because the random walk steps once per sample; it is negligible at large m.

    Parameters
    ----------
    m : (factors,) array
        Averaging factors in samples.
    tau0 : float
        Sample period in s.
    terms : NoiseTerms
        The coefficients in SI.

    Returns
    -------
    (factors, 5) float64 array
        In the squared unit of the samples, columns in the order Q, N, B, K, R. The sum of the
        columns is the Allan variance of the sum of all terms.
    """
    m = np.asarray(m, float)
    q, w, b, k, r = terms.in_sample_units(tau0)
    one = np.ones_like(m)
    return np.stack(
        [
            3.0 * q / m**2,
            w / m,
            FLICKER_FLOOR * b * one,
            k * (m / 3.0 + 1.0 / (6.0 * m)),
            r**2 * m**2 / 2.0,
        ],
        axis=-1,
    )


def gauss_markov_avar(m: ArrayLike, correlation: float) -> NDArray[np.float64]:
    """Return the Allan variance of first-order Gauss-Markov noise of unit variance.

    The noise is continuous in time: (2 T/m) (1 - T/(2 m) (3 - 4 exp(-m/T) + exp(-2 m/T))), IEEE Std
    952-2020 annex C (exponentially correlated noise). The averaging times ``m`` and the
    ``correlation`` time T have the same unit.
    """
    x = np.asarray(m, float) / correlation
    return np.asarray(_gauss_markov_growth(x) / x**2)


def sampled_gauss_markov_avar(m: ArrayLike, correlation: ArrayLike) -> NDArray[np.float64]:
    """Return the Allan variance of sampled first-order Gauss-Markov noise of unit variance.

    It is (4 D(m) - D(2m)) / (2 m^2), where D(n) is the variance of the sum of n samples from
    `gauss_markov_sums`. For T and m of many samples, it approaches `gauss_markov_avar`.

    The averaging factors ``m`` and the ``correlation`` times T are in samples. The result is
    (factors,) for a single T, and (factors, processes) for an array.
    """
    correlation = np.asarray(correlation, float)
    x = np.asarray(m, float).reshape(-1, *(1,) * correlation.ndim) / correlation
    slope, step = gauss_markov_sums(correlation)
    step /= 2.0 * correlation**2
    excess = slope / (2.0 * correlation) - step
    return np.asarray((step * _gauss_markov_growth(x) + 2.0 * excess * x) / x**2)


def _gauss_markov_growth(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 2x - 3 + 4 exp(-x) - exp(-2x), with relative rounding errors of 1e-16/x^2."""
    return np.asarray(2.0 * x + 4.0 * np.expm1(-x) - np.expm1(-2.0 * x))


def gauss_markov_sums(
    correlation: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return A and B of D(n) = A n - B (1 - exp(-n/T)), the variance of the sum of n samples.

    The samples are those of a first-order Gauss-Markov process of unit variance, with the
    autocovariance exp(-k/T) at a lag of k samples: A = coth(1/(2T)), B = 1 / (2 sinh(1/(2T))^2).
    The ``correlation`` times T are in samples; A and B are (processes,).
    """
    half = np.atleast_1d(0.5 / np.asarray(correlation, float))
    # A and B/T are much larger than their difference of about 1/2: a series avoids rounding errors
    small = half < 1e-4
    slope = np.where(small, 1.0 / half + half / 3.0, 1.0 / np.tanh(half))
    step = np.where(small, 0.5 / half**2 - 1.0 / 6.0, 0.5 / np.sinh(np.minimum(half, 300.0)) ** 2)
    return slope, step


def sinusoid_avar(m: ArrayLike, frequency: ArrayLike) -> NDArray[np.float64]:
    """Return the Allan variance of a sampled sinusoid of unit amplitude, averaged over its phase.

    It is sin^4(pi f m) / (m sin(pi f))^2, which is the formula of IEEE Std 952-2020 annex C
    (sinusoidal noise) with sums of samples instead of integrals. The ``frequency`` f is in cycles
    per sample; it broadcasts with the averaging factors ``m``.
    """
    m, turn = np.asarray(m, float), np.pi * np.asarray(frequency, float)
    return np.asarray(np.sin(turn * m) ** 4 / (m * np.sin(turn)) ** 2)


@dataclass(frozen=True)
class ProcessModel:
    """Noise model of one axis: the five terms, Gauss-Markov processes and sinusoids.

    Terms that are not in the model are 0. If the terms alone describe the Allan deviation curve of
    a sensor, its model has no processes and sinusoids.

    Attributes
    ----------
    terms : NoiseTerms
        Coefficients Q, N, B, K, R in SI.
    gauss_markov : tuple of (sigma, tau)
        First-order Gauss-Markov processes: stationary standard deviation in the unit of the
        samples, correlation time in s.
    sinusoids : tuple of (amplitude, frequency)
        Amplitude in the unit of the samples, frequency in Hz.
    """

    terms: NoiseTerms = field(default_factory=NoiseTerms)
    gauss_markov: tuple[tuple[float, float], ...] = ()
    sinusoids: tuple[tuple[float, float], ...] = ()

    def avar(self, tau: ArrayLike, tau0: float = 0.0) -> NDArray[np.float64]:
        """Return the Allan variance at the averaging times ``tau``.

        Parameters
        ----------
        tau : (times,) array
            Averaging times in s.
        tau0 : float
            Sample period in s; the result is for sampled noise (discrete random walk, aliased
            sinusoids). With 0, it is for continuous time.

        Returns
        -------
        (times,) float64 array
            Squared unit of the samples.

        Examples
        --------
        >>> ProcessModel(NoiseTerms(N=2.0)).avar([1.0, 4.0])
        array([4., 1.])
        """
        tau = np.asarray(tau, float)
        return np.asarray(sum(self.parts(tau, tau0).values(), np.zeros_like(tau)))

    def parts(self, tau: ArrayLike, tau0: float = 0.0) -> dict[str, NDArray[np.float64]]:
        """Return the Allan variance of each term and process that is not 0; their sum is `avar`.

        Parameters
        ----------
        tau, tau0
            As for `avar`.

        Returns
        -------
        dict of name to (times,) float64 array
            Names are the letters of the terms, then 'GM' with the correlation time of a
            Gauss-Markov process, and 'sine' with the frequency of a sinusoid.

        Examples
        --------
        >>> list(ProcessModel(NoiseTerms(N=2.0, K=1e-3), ((0.1, 300.0),)).parts([1.0]))
        ['N', 'K', 'GM 300 s']
        """
        tau = np.asarray(tau, float)
        # continuous time is approximated by a sample period far below every tau
        step = tau0 or 1e-6 * float(tau.min(initial=1.0))
        m = tau / step
        columns = term_avar(m, step, self.terms)
        parts = {
            name: columns[..., i]
            for i, (name, value) in enumerate(zip('QNBKR', astuple(self.terms)))
            if value
        }
        for sigma, time in (each for each in self.gauss_markov if each[0]):
            unit = sampled_gauss_markov_avar(m, time / step)
            parts[f'GM {_two_digits(time)} s'] = sigma**2 * unit
        for amplitude, frequency in (each for each in self.sinusoids if each[0]):
            unit = sinusoid_avar(m, frequency * step)
            parts[f'sine {_two_digits(frequency)} Hz'] = amplitude**2 * unit
        return parts


def _two_digits(value: float) -> str:
    return f'{float(f"{value:.2g}"):g}'
