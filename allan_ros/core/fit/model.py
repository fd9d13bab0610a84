# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Result types of a fit: five terms per axis with intervals, and additional processes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..estimate import Estimate
from ..fields import Signed
from ..findings import Finding
from ..noise import NoiseTerms, ProcessModel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


RANDOM_TERMS = ('Q', 'N', 'B', 'K')
"""The random terms, in the order of all arrays of variance coefficients (q, w, b, k)."""

Q, N, B, K = range(len(RANDOM_TERMS))

TAU0_EXPONENT = {'Q': 1.0, 'N': 0.5, 'B': 0.0, 'K': -0.5}
"""SI coefficient = sqrt(variance coefficient) * tau0**exponent, where tau0 is in s."""


def coefficient_to_si(term: str, variance: float, tau0: float) -> float:
    """Convert a variance coefficient (q, w, b, k), or the ramp per sample, to an SI coefficient.

    ``term`` is one of `TERMS`, and ``tau0`` the sample period in s. A negative variance coefficient
    gives 0.
    """
    if term == 'R':
        return variance / tau0
    return math.sqrt(max(variance, 0.0)) * math.pow(tau0, TAU0_EXPONENT[term])


Z_95 = 1.96
"""Normal quantile of 97.5 %, for both ends of a 95 % interval and for a 95 % upper limit.

The same data decide whether a term gets an interval or an upper limit. With 1.645, the quantile of
95 %, for limits, a term near the threshold would be missed in 5 % of records below and in 2.5 %
above. With one quantile, a limit is the upper end of an interval that begins at 0, as in the
unified intervals of Feldman & Cousins (Phys. Rev. D 57, 1998) for nonnegative estimates."""

TERMS = ('Q', 'N', 'B', 'K', 'R')
"""Quantization, angle/velocity random walk, bias instability, rate random walk, rate ramp."""


@dataclass(frozen=True)
class GaussMarkov:
    """First-order Gauss-Markov process (exponentially correlated noise of IEEE Std 952).

    Attributes
    ----------
    sigma : float
        Stationary standard deviation in SI units.
    sigma_ci95 : (low, high)
        95 % interval of sigma.
    correlation_time : float
        Correlation time in s.
    correlation_time_ci95 : (low, high)
        95 % interval of the correlation time.
    """

    sigma: float
    sigma_ci95: tuple[float, float]
    correlation_time: float
    correlation_time_ci95: tuple[float, float]


@dataclass(frozen=True)
class Sinusoid:
    """Sinusoidal noise of IEEE Std 952, for example vibration.

    Attributes
    ----------
    amplitude : float
        Amplitude in SI units.
    amplitude_ci95 : (low, high)
        95 % interval of the amplitude.
    frequency : float
        Frequency in Hz, below half the sample rate. A faster vibration appears at its alias.
    frequency_ci95 : (low, high)
        95 % interval of the frequency.
    """

    amplitude: float
    amplitude_ci95: tuple[float, float]
    frequency: float
    frequency_ci95: tuple[float, float]


@dataclass(frozen=True)
class Resonance:
    """Second-order process: a damped oscillation that noise excites, for example of a mounting.

    Attributes
    ----------
    sigma : float
        Standard deviation in SI units.
    sigma_ci95 : (low, high)
        95 % interval of sigma.
    frequency : float
        Frequency in Hz.
    frequency_ci95 : (low, high)
        95 % interval of the frequency.
    correlation_time : float
        Time in s in which the oscillation decays to 1/e; its width is 1/(pi times this) Hz.
    correlation_time_ci95 : (low, high)
        95 % interval of the correlation time.
    """

    sigma: float
    sigma_ci95: tuple[float, float]
    frequency: float
    frequency_ci95: tuple[float, float]
    correlation_time: float
    correlation_time_ci95: tuple[float, float]


@dataclass(frozen=True)
class Processes:
    """Processes that are added to the five terms if these do not describe the curve.

    Attributes
    ----------
    gauss_markov : tuple of GaussMarkov
        Sorted by correlation time, shortest first.
    sinusoid : tuple of Sinusoid
        Sorted by frequency, lowest first.
    resonance : tuple of Resonance
        Sorted by frequency, lowest first.
    """

    gauss_markov: tuple[GaussMarkov, ...] = ()
    sinusoid: tuple[Sinusoid, ...] = ()
    resonance: tuple[Resonance, ...] = ()


class Deviation(NamedTuple):
    """Largest relative difference between the measured Allan deviation and the model.

    Attributes
    ----------
    relative : float
        Measured Allan deviation / Allan deviation of the model - 1. Points above the model are
        compared with the model that contains unresolved terms at their upper limits.
    tau : float
        Averaging time of the point in s.
    """

    relative: Signed
    tau: float


class LackOfFit(NamedTuple):
    """Octave of frequencies in which the measured noise density differs from the model.

    Attributes
    ----------
    low, high : float
        Ends of the octave in Hz.
    ratio : float
        Measured power / power of the model.
    """

    low: float
    high: float
    ratio: float


@dataclass(frozen=True, eq=False)
class Covariance:
    """Covariance of the fitted coefficients of one axis.

    Attributes
    ----------
    names : tuple of str
        Parameters: 'Q', 'N', 'B', 'K', then 'gauss_markov', 'sinusoid' and 'resonance' with a
        number, in the order of `Processes`.
    matrix : (parameters, parameters) array
        Covariance of their squares (of N^2, of sigma^2, of amplitude^2 ...) in SI, with the
        uncertainty of correlation times and frequencies included.
    """

    names: tuple[str, ...]
    matrix: Floats


@dataclass(frozen=True)
class AxisFit:
    """Fit of one axis.

    Attributes
    ----------
    noise : mapping of term to Estimate
        All five of `TERMS`.
    model : ProcessModel
        The fitted model, complete: it is what is tested, drawn and exported. Terms that are not
        resolved are included with their estimates.
    processes : Processes
        Gauss-Markov processes, sinusoids and resonances of the model, with intervals.
    m_min : int
        Smallest averaging factor that the model describes; above 1 if the samples are low-pass
        filtered.
    filtered : bool
        Whether the samples are low-pass filtered. Q is then not measured, and N is the density in
        the pass band.
    gof_z : float or None
        Goodness of fit of the model as a normal deviate; None if the method has no test.
    lack_of_fit : tuple of LackOfFit
        Octaves in which the data differ from the model; empty if the model passes the test.
    deviation : Deviation or None
        Largest deviation of the curve from the model; None if no deviation is significant.
    covariance : Covariance or None
        Covariance of the coefficients; None if the method gives none.
    """

    noise: Mapping[str, Estimate]
    model: ProcessModel = field(default_factory=ProcessModel)
    processes: Processes = Processes()
    m_min: int = 1
    filtered: bool = False
    gof_z: Signed | None = None
    lack_of_fit: tuple[LackOfFit, ...] = ()
    deviation: Deviation | None = None
    covariance: Covariance | None = field(default=None, compare=False)

    @property
    def likely(self) -> tuple[str, ...]:
        """Terms that are not resolved, but likely."""
        return tuple(t for t, c in self.noise.items() if c.status == 'likely')

    @property
    def model_at_limits(self) -> ProcessModel:
        """The model with every unresolved term at its 95 % upper limit."""
        limits = {
            term: max(c.upper95, abs(getattr(self.model.terms, term)))
            for term, c in self.noise.items()
            if c.status != 'estimated' and c.upper95 is not None and math.isfinite(c.upper95)
        }
        return replace(self.model, terms=replace(self.model.terms, **limits))


def model_of_terms(noise: Mapping[str, Estimate]) -> ProcessModel:
    """Return the model that contains the estimates of the terms only."""
    values = {t: c.value for t, c in noise.items() if c.value}
    return ProcessModel(NoiseTerms(**values))


@dataclass(frozen=True)
class NoiseModel:
    """Fit of all axes of one `AllanSums`.

    Attributes
    ----------
    method : str
        'likelihood' or 'paper'.
    tau0 : float
        Sample period in s.
    axes : mapping of axis name to AxisFit
    findings : tuple of Finding
        Findings of the fit, for all axes.
    """

    method: str
    tau0: float
    axes: Mapping[str, AxisFit]
    findings: tuple[Finding, ...] = field(default=())
