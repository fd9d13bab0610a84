# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a fit says: five terms per axis, each with its interval and verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from ..findings import Finding

TERMS = ('Q', 'N', 'B', 'K', 'R')
"""Quantization, angle/velocity random walk, bias instability, rate random walk, rate ramp."""

Status = Literal['estimated', 'not_observable']


@dataclass(frozen=True)
class Coefficient:
    """One of the five terms on one axis, in SI units.

    Attributes
    ----------
    value : float or None
        The point estimate; None where none can be given. |R| for the ramp.
    ci95 : (low, high) or None
        95 % interval; None where the method gives none.
    upper95 : float or None
        95 % upper limit: what is known of a term that is not observable.
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
    """First-order Gauss-Markov noise (IEEE 952's exponentially correlated noise).

    ``sigma`` is its standard deviation in the unit of the samples, ``correlation_time`` in s.
    """

    sigma: float
    sigma_ci95: tuple[float, float]
    correlation_time: float
    correlation_time_ci95: tuple[float, float]


@dataclass(frozen=True)
class Sinusoid:
    """A line in the spectrum (IEEE 952's sinusoidal noise): amplitude and frequency in Hz."""

    amplitude: float
    amplitude_ci95: tuple[float, float]
    frequency: float
    frequency_ci95: tuple[float, float]


@dataclass(frozen=True)
class AxisFit:
    """The fit of one axis.

    Attributes
    ----------
    noise : mapping of term to Coefficient
        All five of `TERMS`.
    misfit : float
        Fractional model error eps that makes the five terms fit (0: they describe the curve).
    m_min : int
        Smallest averaging factor used; above 1 where a low-pass filter hides the shorter ones.
    gof_z : float or None
        Goodness of fit as a normal deviate, before eps; None where the method has none.
    gauss_markov, sinusoid : extra terms, only where the fit demanded them.
    """

    noise: Mapping[str, Coefficient]
    misfit: float = 0.0
    m_min: int = 1
    gof_z: float | None = None
    gauss_markov: GaussMarkov | None = None
    sinusoid: Sinusoid | None = None


@dataclass(frozen=True)
class NoiseFit:
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
