# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Result types of a fit: five terms per axis with intervals, and additional processes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..findings import Finding
from ..noise import NoiseTerms, ProcessModel, term_avar

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


RANDOM_TERMS = ('Q', 'N', 'B', 'K')
"""The random terms, in the order of all arrays of variance coefficients (q, w, b, k)."""

Q, N, B, K = range(len(RANDOM_TERMS))

WHITE = np.array([0.0, 1.0, 0.0, 0.0])
"""Variance coefficients of white noise of unit variance."""

TAU0_EXPONENT = {'Q': 1.0, 'N': 0.5, 'B': 0.0, 'K': -0.5}
"""SI coefficient = sqrt(variance coefficient) * tau0**exponent, where tau0 is in s."""

DIFFERENCE = (1.0, -2.0, 1.0)
"""Coefficients of the second difference theta(u + 2m) - 2 theta(u + m) + theta(u) of the phase."""


def avar_terms(m: NDArray[np.int64]) -> Floats:
    """Return the Allan variance of each random term with unit variance coefficient, (factors, 4).

    ``m`` are averaging factors. The order of the terms is Q, N, B, K.
    """
    return term_avar(m, 1.0, NoiseTerms(1.0, 1.0, 1.0, 1.0))[:, : len(RANDOM_TERMS)]


def walk_from_cubic(white: Floats, cubic: Floats) -> Floats:
    """Return the covariance of a sampled random walk, from that of a continuous one (``cubic``).

    ``white`` is the covariance of unit white noise. Sums of covariances can be given as well.
    """
    # (|t|^3 - |t|)/12 = |t|^3/12 + (-|t|/2)/6 for the phase.
    return cubic + white / 6.0


def phase_covariance(t: Floats) -> Floats:
    """Return the generalized covariance of the phase of each random term at lags t, (4, ...).

    The variance coefficients q, w, b, k are 1. The result gives the covariance of weighted sums of
    the phase whose weights cancel a straight line, such as second differences (Matheron 1973).
    """
    a = np.abs(t)
    white = -a / 2
    log = np.log(np.where(a > 0.0, a, 1.0))
    return np.stack(
        [(a == 0.0).astype(float), white, a * a * log / (2 * math.pi), a**3 / 12 + white / 6]
    )


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


Status = Literal['estimated', 'not_observable']


@dataclass(frozen=True)
class Coefficient:
    """One of the five terms on one axis, in SI units.

    Attributes
    ----------
    value : float or None
        Estimate (|R| for the ramp), or None if there is none.
    ci95 : (low, high) or None
        95 % interval; None for a term that is not observable, or if the method gives none.
    upper95 : float or None
        95 % upper limit of a term that is not observable; None if there is no limit.
    status : 'estimated' or 'not_observable'
        'estimated' if the data show that the term is not 0.
    sign : int
        Sign of the ramp; 0 for the other terms.
    """

    value: float | None
    ci95: tuple[float, float] | None = None
    upper95: float | None = None
    status: Status = 'estimated'
    sign: int = 0


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
class Processes:
    """Processes that are added to the five terms if these do not describe the curve.

    Attributes
    ----------
    gauss_markov : tuple of GaussMarkov
        Sorted by correlation time, shortest first.
    sinusoid : tuple of Sinusoid
        Sorted by frequency, lowest first.
    """

    gauss_markov: tuple[GaussMarkov, ...] = ()
    sinusoid: tuple[Sinusoid, ...] = ()


class Deviation(NamedTuple):
    """Largest relative difference between the measured Allan deviation and the model.

    Attributes
    ----------
    relative : float
        Measured Allan deviation divided by that of the model, minus 1. Points above the model are
        compared with the model that contains unresolved terms at their upper limits.
    tau : float
        Averaging time of the point in s.
    """

    relative: float
    tau: float


@dataclass(frozen=True)
class AxisFit:
    """Fit of one axis.

    Attributes
    ----------
    noise : mapping of term to Coefficient
        All five of `TERMS`.
    misfit : float
        Relative model error that was added to the covariance of the Allan variances; 0 if the model
        passes the test of fit.
    m_min : int
        Smallest averaging factor used; above 1 if a filter or vibration affects shorter ones.
    gof_z : float or None
        Goodness of fit of the five terms as a normal deviate; above 3 they are rejected. None if
        the method has no test of fit.
    processes : Processes
        Gauss-Markov processes and sinusoids; empty if the five terms describe the curve.
    deviation : Deviation or None
        Largest deviation of the data from the selected model; None if no deviation is significant.
    signed : bool
        Whether q was allowed to be negative, as for low-pass filtered samples. It is not saved.
    """

    noise: Mapping[str, Coefficient]
    misfit: float = 0.0
    m_min: int = 1
    gof_z: float | None = None
    processes: Processes = Processes()
    deviation: Deviation | None = None
    signed: bool = False

    @property
    def gauss_markov(self) -> GaussMarkov | None:
        """The Gauss-Markov process with the largest standard deviation, or None."""
        return max(self.processes.gauss_markov, key=lambda p: p.sigma, default=None)

    @property
    def sinusoid(self) -> Sinusoid | None:
        """The sinusoid with the largest amplitude, or None."""
        return max(self.processes.sinusoid, key=lambda p: p.amplitude, default=None)

    @property
    def selected(self) -> ProcessModel:
        """Model for drawing and prediction: resolved and likely terms, and the processes.

        A term that is not resolved is likely if its squared estimate is more than one standard
        deviation above zero.
        """
        # Without likely drift terms, the model would predict too little drift.
        values = {
            term: c.value * (c.sign or 1)
            for term, c in self.noise.items()
            if c.value is not None and math.isfinite(c.value) and _is_likely(term, c)
        }
        return ProcessModel(
            NoiseTerms(**values),
            tuple((p.sigma, p.correlation_time) for p in self.processes.gauss_markov),
            tuple((p.amplitude, p.frequency) for p in self.processes.sinusoid),
        )

    @property
    def likely(self) -> tuple[str, ...]:
        """Terms that are not resolved but are part of the selected model."""
        noise, terms = self.noise, self.selected.terms
        return tuple(t for t in noise if getattr(terms, t) and noise[t].status != 'estimated')

    @property
    def selected_at_limits(self) -> ProcessModel:
        """The selected model with every unresolved term at its 95 % upper limit."""
        model = self.selected
        limits = {
            term: max(c.upper95, abs(getattr(model.terms, term)))
            for term, c in self.noise.items()
            if c.status != 'estimated' and c.upper95 is not None and math.isfinite(c.upper95)
        }
        return replace(model, terms=replace(model.terms, **limits))

    @property
    def is_filtered(self) -> bool:
        """Whether the samples are low-pass filtered, so that Q cannot be measured."""
        q, n = self.noise['Q'], self.noise['N']
        return self.m_min == 1 and q.value is q.upper95 is None and n.value is not None


def _is_likely(term: str, c: Coefficient) -> bool:
    """Return whether a term is resolved, or its square exceeds 0 by one standard deviation."""
    if c.status == 'estimated':
        return True
    if term not in 'NBK' or c.value is None or c.upper95 is None:
        return False
    # The limit of the square is `Z_95` standard deviations above its estimate. With a few seconds
    # of data, an estimate above its own limit contradicts the interval: the limit is used.
    return c.value < c.upper95 and Z_95 * c.value**2 > c.upper95**2 - c.value**2


@dataclass(frozen=True)
class NoiseModel:
    """Fit of all axes of one `AllanSums`.

    Attributes
    ----------
    method : str
        'gls', 'relative' or 'paper'.
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
