# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The result of a fit: five terms per axis with intervals and verdicts, and processes."""

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
"""The terms with a column, in the order of all arrays of variance coefficients."""


WHITE = np.array([0.0, 1.0, 0.0, 0.0])
"""Variance coefficients of pure white noise, for weights before the noise is known."""


TAU0_EXPONENT = {'Q': 1.0, 'N': 0.5, 'B': 0.0, 'K': -0.5}
"""SI coefficient = sqrt(variance coefficient) * tau0**exponent, tau0 in s."""


DIFFERENCE = (1.0, -2.0, 1.0)
"""d(u) = theta(u + 2m) - 2 theta(u + m) + theta(u)."""


def avar_terms(m: NDArray[np.int64]) -> Floats:
    """Return the Allan variance of unit q, w, b, k at averaging factors m, (factors, 4)."""
    return term_avar(m, 1.0, NoiseTerms(1.0, 1.0, 1.0, 1.0))[:, : len(RANDOM_TERMS)]


def walk_from_cubic(white: Floats, cubic: Floats) -> Floats:
    """Return the column of k, (|t|^3 - |t|)/12, computed from the columns -|t|/2 and |t|^3/12.

    The sampled walk is the continuous walk plus white noise of a sixth of its step.
    """
    return cubic + white / 6.0


def phase_covariance(t: Floats) -> Floats:
    """Return the generalised covariances of theta at lag t of unit q, w, b, k, (4, ...).

    They are valid for differences that do not depend on straight lines in theta (Matheron 1973):
    delta(t), -|t|/2, t^2 ln|t|/(2 pi), (|t|^3 - |t|)/12.
    """
    a = np.abs(t)
    white = -a / 2
    log = np.log(np.where(a > 0.0, a, 1.0))
    return np.stack(
        [(a == 0.0).astype(float), white, a * a * log / (2 * math.pi), a**3 / 12 + white / 6]
    )


def coefficient_to_si(term: str, variance: float, tau0: float) -> float:
    """Return the SI coefficient of a variance coefficient (q, w, b, k) or of the ramp r.

    A negative variance coefficient gives 0.
    """
    if term == 'R':
        return variance / tau0
    return math.sqrt(max(variance, 0.0)) * math.pow(tau0, TAU0_EXPONENT[term])


Z_95 = 1.96
"""Normal quantile of 97.5 %, for both ends of a 95 % interval and for a 95 % upper limit.

The same data decide whether a term gets an interval or a limit. With 1.645, the quantile of 95 %, a
term near the threshold would be missed in 5 % of records below and in 2.5 % above. With one
quantile, a limit is the upper end of an interval that begins at 0, as in the unified intervals of
Feldman & Cousins (Phys. Rev. D 57, 1998) for estimates of 0 and above."""


TERMS = ('Q', 'N', 'B', 'K', 'R')
"""Quantization, angle/velocity random walk, bias instability, rate random walk, rate ramp."""


Status = Literal['estimated', 'not_observable']


@dataclass(frozen=True)
class Coefficient:
    """One of the five terms on one axis, in SI units.

    Attributes
    ----------
    value : float or None
        The point estimate (|R| for the ramp), or None if there is none.
    ci95 : (low, high) or None
        95 % interval; None if the method gives none.
    upper95 : float or None
        95 % upper limit of a term that is not observable: the upper end of an interval that begins
        at 0.
    status : 'estimated' or 'not_observable'
    sign : int
        Sign of the ramp (R only), else 0.
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
        Stationary standard deviation in the unit of the samples.
    sigma_ci95 : (low, high)
        95 % interval.
    correlation_time : float
        In s.
    correlation_time_ci95 : (low, high)
        95 % interval.
    """

    sigma: float
    sigma_ci95: tuple[float, float]
    correlation_time: float
    correlation_time_ci95: tuple[float, float]


@dataclass(frozen=True)
class Sinusoid:
    """Sinusoidal noise of IEEE Std 952, e.g. vibration.

    Attributes
    ----------
    amplitude : float
        In the unit of the samples.
    amplitude_ci95 : (low, high)
        95 % interval.
    frequency : float
        In Hz, below half the sample rate. A faster vibration appears at its alias.
    frequency_ci95 : (low, high)
        95 % interval.
    """

    amplitude: float
    amplitude_ci95: tuple[float, float]
    frequency: float
    frequency_ci95: tuple[float, float]


@dataclass(frozen=True)
class Processes:
    """Processes in addition to the five terms, if these do not describe the curve.

    Attributes
    ----------
    gauss_markov : tuple of GaussMarkov
        Shortest correlation time first.
    sinusoid : tuple of Sinusoid
        Lowest frequency first.
    """

    gauss_markov: tuple[GaussMarkov, ...] = ()
    sinusoid: tuple[Sinusoid, ...] = ()


class Deviation(NamedTuple):
    """Largest deviation of the measured curve from the drawn line of the model.

    Attributes
    ----------
    relative : float
        Ratio of the measured Allan deviation to that of the model, less 1. For points above the
        line, the model includes the unresolved terms at their upper limits.
    tau : float
        Averaging time in s.
    """

    relative: float
    tau: float


@dataclass(frozen=True)
class AxisFit:
    """The fit of one axis.

    Attributes
    ----------
    noise : mapping of term to Coefficient
        All five of `TERMS`.
    misfit : float
        Fractional model error with which the selected model fits; 0 if it fits without one.
    m_min : int
        Smallest averaging factor used; above 1 if a low-pass filter affects the shorter ones.
    gof_z : float or None
        Goodness of fit of the five terms as a normal deviate; None if the method has none.
    processes : Processes
        Gauss-Markov processes and sinusoids; empty if the five terms describe the curve.
    deviation : Deviation or None
        Largest deviation of the data from the selected model; None if the model fits.
    signed : bool
        Whether q could be negative in the fit, as for filtered samples. It is not saved.
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
        """The selected model: likely terms and the processes, for drawing and prediction.

        It contains the processes, if there are any. A term that is not resolved is included if its
        square is more than one standard deviation above zero, because a model without likely drift
        predicts too little drift.
        """
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
        """Terms of the selected model that are not resolved."""
        noise, terms = self.noise, self.selected.terms
        return tuple(t for t in noise if getattr(terms, t) and noise[t].status != 'estimated')

    @property
    def selected_at_limits(self) -> ProcessModel:
        """The selected model with every term that is not resolved at its 95 % upper limit."""
        model = self.selected
        limits = {
            term: max(c.upper95, abs(getattr(model.terms, term)))
            for term, c in self.noise.items()
            if c.status != 'estimated' and c.upper95 is not None and math.isfinite(c.upper95)
        }
        return replace(model, terms=replace(model.terms, **limits))

    @property
    def is_filtered(self) -> bool:
        """Whether the fit describes the curve with a low-pass filter; Q then cannot be measured."""
        q, n = self.noise['Q'], self.noise['N']
        return self.m_min == 1 and q.value is q.upper95 is None and n.value is not None


def _is_likely(term: str, c: Coefficient) -> bool:
    """Return whether a term is resolved, or its square exceeds one standard deviation."""
    if c.status == 'estimated':
        return True
    if term not in 'NBK' or c.value is None or c.upper95 is None:
        return False
    # The limit of the square is `Z_95` standard deviations above its estimate. With a few seconds
    # of data, an estimate above its own limit contradicts the interval: the limit is used.
    return c.value < c.upper95 and Z_95 * c.value**2 > c.upper95**2 - c.value**2


@dataclass(frozen=True)
class NoiseModel:
    """The fit of all axes of one `AllanSums`.

    Attributes
    ----------
    method : str
        'gls', 'relative' or 'paper'.
    tau0 : float
        Sample period in s.
    axes : mapping of axis name to AxisFit
    findings : tuple of Finding
    """

    method: str
    tau0: float
    axes: Mapping[str, AxisFit]
    findings: tuple[Finding, ...] = field(default=())
