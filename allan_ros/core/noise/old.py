# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise types, and noise models of one axis.

Each noise type is one function gamma(M, j): the autocovariance of means over M samples at a lag of
j means. The expected spectrum, the covariance of block means and the Allan variance follow from it,
for example V(m) = gamma(m, 0) - gamma(m, 1). A constant may be added to gamma, because all three
depend only on its differences: bias instability and random walk have no other autocovariance
(G. Matheron, The intrinsic random functions and their applications, 1973).

The unit of time of these functions is the sample period, and the coefficient is 1.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import astuple, dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import AllanError
from ..fields import Signed

Floats = NDArray[np.float64]
Gamma = Callable[[ArrayLike, ArrayLike], Floats]
"""gamma(M, j), whose arguments broadcast."""

FLICKER_FLOOR = 2.0 * math.log(2.0) / math.pi
"""Ratio of the Allan variance of bias instability to B^2: (0.664)^2 (IEEE Std 952-1997, C.1.3)."""

SERIES_FROM = 30
"""Lag from which the autocovariance of flicker noise is computed by a series."""


# --- noise types ----------------------------------------------------------------------------------


def quantization(M: ArrayLike, j: ArrayLike) -> Floats:
    """Quantization noise: the difference of white noise of unit variance."""
    M, j = np.asarray(M, float), np.asarray(j, float)
    return np.asarray((2.0 * (j == 0) - (j == 1)) / M**2)


def white(M: ArrayLike, j: ArrayLike) -> Floats:
    """White noise of unit variance per sample."""
    return np.asarray((np.asarray(j) == 0) / np.asarray(M, float))


def flicker(M: ArrayLike, j: ArrayLike) -> Floats:
    """Flicker noise with B = 1; its autocovariance does not depend on M.

    It is the second difference of -t^2 ln|t| / (2 pi); at long lags, of its series.
    """
    j = np.asarray(j, float) + 0.0 * np.asarray(M, float)
    far = np.maximum(j, 1.0)
    u = far**-2
    series = -(2.0 * np.log(far) + 3.0 - u * (1.0 / 6.0 + u * (1.0 / 30.0 + u / 84.0)))
    near = 2.0 * _square_log(j) - _square_log(j + 1.0) - _square_log(np.abs(j - 1.0))
    return np.asarray(np.where(j > SERIES_FROM, series, near) / (2.0 * math.pi))


def random_walk(M: ArrayLike, j: ArrayLike) -> Floats:
    """Random walk with steps of unit variance per sample."""
    M, j = np.asarray(M, float), np.asarray(j, float)
    return np.asarray(np.where(j >= 1, -j * M / 2.0, 1.0 / (6.0 * M) - M / 6.0))


def gauss_markov(time: float) -> Gamma:
    """First-order Gauss-Markov process of unit variance with a correlation time in samples.

    The variance is subtracted, so that no digits are lost at long correlation times.
    """

    def gamma(M: ArrayLike, j: ArrayLike) -> Floats:
        M, j = np.asarray(M, float), np.asarray(j, float)
        x = M / time
        # lag j >= 1: exp(-((j - 1) M + 1)/T) times the square of the mean of exp(-i/T), i < M
        mean = np.expm1(-x) / math.expm1(-1.0 / time) / M
        decay = np.expm1(-((np.maximum(j, 1.0) - 1.0) * x + 1.0 / time))
        later = mean**2 * decay + (mean - 1.0) * (mean + 1.0)
        # lag 0: the mean of exp(-|a - b|/T) - 1 over all pairs of samples
        half = 0.5 / time
        pairs = (
            M / math.tanh(half) + np.expm1(-x) / (2.0 * math.sinh(min(half, 300.0)) ** 2)
        ) / M**2
        lag = (M - 1.0 / M) / (3.0 * time)  # mean of |a - b|/T, then of its square and cube
        series = -lag + (M**2 - 1.0) / (12.0 * time**2) - x**3 / 60.0 * (1.0 - 1.0 / M**2)
        return np.asarray(np.where(j >= 1, later, np.where(x < 1e-3, series, pairs - 1.0)))

    return gamma


def bounded_walk(time: float) -> Gamma:
    """Gauss-Markov process that grows like a random walk of unit steps before ``time`` samples."""
    unit = gauss_markov(time)
    return lambda M, j: np.asarray(time / 2.0 * unit(M, j))


def sinusoid(frequency: float) -> Gamma:
    """Sinusoid of unit amplitude and random phase; the frequency is in cycles per sample."""

    def gamma(M: ArrayLike, j: ArrayLike) -> Floats:
        M, turn = np.asarray(M, float), math.pi * frequency
        gain = np.sin(turn * M) / (M * math.sin(turn))
        return np.asarray(0.5 * gain**2 * np.cos(2.0 * turn * M * np.asarray(j, float)))

    return gamma


def resonance(frequency: float, time: float) -> Gamma:
    """Second-order process of unit variance: a damped oscillation of random phase.

    Its autocovariance at a lag of t samples is exp(-t/time) cos(2 pi frequency t).
    """
    z = cmath.exp(complex(-1.0 / time, 2.0 * math.pi * frequency))

    def gamma(M: ArrayLike, j: ArrayLike) -> Floats:
        M, j = np.asarray(M, float), np.asarray(j, float)
        sums = (1.0 - np.exp(M * cmath.log(z))) / (1.0 - z)
        zero = (M * (1.0 + z) / (1.0 - z) - 2.0 * z * sums / (1.0 - z)).real
        k = (np.maximum(j, 1.0) - 1.0) * M + 1.0
        wave = np.cos(2.0 * math.pi * frequency * k + 2.0 * np.angle(sums))
        later = np.abs(sums) ** 2 * np.exp(-k / time) * wave
        return np.asarray(np.where(j >= 1, later, zero) / M**2)

    return gamma


TERM_TYPES: dict[str, Gamma] = {
    'Q': quantization,
    'N': white,
    'B': flicker,
    'K': random_walk,
}
"""Noise types without a shape: the terms of the Allan variance."""


class ProcessType(NamedTuple):
    """Noise type with a shape: its gamma, and the meaning of each number of the shape."""

    gamma: Callable[..., Gamma]
    shape: tuple[Literal['time', 'frequency'], ...]  # in samples, in cycles per sample


PROCESS_TYPES = {
    'gauss_markov': ProcessType(gauss_markov, ('time',)),
    'bounded_walk': ProcessType(bounded_walk, ('time',)),
    'sinusoid': ProcessType(sinusoid, ('frequency',)),
    'resonance': ProcessType(resonance, ('frequency', 'time')),
}
"""Noise types with a shape."""


def gamma_of(kind: str, *shape: float) -> Gamma:
    """Return gamma(M, j) of a term or of a process with the given shape."""
    return PROCESS_TYPES[kind].gamma(*shape) if shape else TERM_TYPES[kind]


def unit_avar(m: ArrayLike, kind: str, *shape: float) -> Floats:
    """Return the Allan variance of a noise type with the coefficient 1 at averaging factors m."""
    gamma = gamma_of(kind, *shape)
    return np.asarray(gamma(m, 0) - gamma(m, 1))


def _square_log(t: Floats) -> Floats:
    """Return t^2 ln|t|, 0 at 0."""
    return np.asarray(t * t * np.log(np.where(t > 0.0, t, 1.0)))


# --- models ---------------------------------------------------------------------------------------


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
    R: Signed = 0.0

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


def term_avar(m: ArrayLike, tau0: float, terms: NoiseTerms) -> Floats:
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
    *variances, ramp = terms.in_sample_units(tau0)
    columns = [v * unit_avar(m, kind) for v, kind in zip(variances, TERM_TYPES)]
    return np.stack([*columns, ramp**2 * m**2 / 2.0], axis=-1)


def gauss_markov_avar(tau: ArrayLike, time: float) -> Floats:
    """Return the Allan variance of continuous first-order Gauss-Markov noise of unit variance.

    It is (2 T/m) (1 - T/(2 m) (3 - 4 exp(-m/T) + exp(-2 m/T))), IEEE Std 952-2020 annex C
    (exponentially correlated noise). The averaging times and the correlation time have one unit.
    """
    x = np.asarray(tau, float) / time
    return np.asarray((2.0 * x + 4.0 * np.expm1(-x) - np.expm1(-2.0 * x)) / x**2)


@dataclass(frozen=True)
class ProcessModel:
    """Noise model of one axis: the five terms, processes, and the effect of a low-pass filter.

    Attributes
    ----------
    terms : NoiseTerms
        Coefficients Q, N, B, K, R in SI.
    gauss_markov : tuple of (sigma, tau)
        First-order Gauss-Markov processes: stationary standard deviation in the unit of the
        samples, correlation time in s.
    sinusoids : tuple of (amplitude, frequency)
        Amplitude in the unit of the samples, frequency in Hz.
    resonances : tuple of (sigma, frequency, tau)
        Second-order processes: standard deviation in the unit of the samples, frequency in Hz,
        correlation time in s.
    low_pass : float
        Effect of a low-pass filter of the sensor on averages that are long compared with its
        response: 3 ``low_pass``/tau^2 is added to the Allan variance. It has the unit of Q^2 and is
        negative for most filters.
    """

    terms: NoiseTerms = field(default_factory=NoiseTerms)
    gauss_markov: tuple[tuple[float, float], ...] = ()
    sinusoids: tuple[tuple[float, float], ...] = ()
    low_pass: Signed = 0.0
    resonances: tuple[tuple[float, float, float], ...] = ()

    def avar(self, tau: ArrayLike, tau0: float = 0.0) -> Floats:
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

    def parts(self, tau: ArrayLike, tau0: float = 0.0) -> dict[str, Floats]:
        """Return the Allan variance of each part that is not 0; their sum is `avar`.

        Parameters
        ----------
        tau, tau0
            As for `avar`.

        Returns
        -------
        dict of name to (times,) float64 array
            Names are the letters of the terms, then 'GM' with the correlation time of a
            Gauss-Markov process, 'sine' or 'resonance' with the frequency of a sinusoid, and
            'filter'.

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
            unit = unit_avar(m, 'gauss_markov', time / step)
            parts[f'GM {_two_digits(time)} s'] = sigma**2 * unit
        for amplitude, frequency in (each for each in self.sinusoids if each[0]):
            unit = unit_avar(m, 'sinusoid', frequency * step)
            parts[f'sine {_two_digits(frequency)} Hz'] = amplitude**2 * unit
        for sigma, frequency, time in (each for each in self.resonances if each[0]):
            unit = unit_avar(m, 'resonance', frequency * step, time / step)
            parts[f'resonance {_two_digits(frequency)} Hz'] = sigma**2 * unit
        if self.low_pass:
            parts['filter'] = 3.0 * self.low_pass / tau**2
        return parts


def _two_digits(value: float) -> str:
    return f'{float(f"{value:.2g}"):g}'
