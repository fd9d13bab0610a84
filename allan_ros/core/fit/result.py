# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Result types of a fit: terms with intervals, model, and bias over temperature, for each axis."""

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
from ..noise import Model

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


Q, N, B, K = range(4)
"""Indices of `RANDOM_TERMS` in all arrays of variance coefficients (q, w, b, k)."""

TERMS = ('Q', 'N', 'B', 'K', 'R')
"""Quantization, angle/velocity random walk, bias instability, rate random walk, rate ramp."""


class Deviation(NamedTuple):
    """Largest relative difference between the measured Allan deviation and the model.

    Attributes
    ----------
    relative : float
        Measured Allan deviation / Allan deviation of the model - 1. A point above the model is
        compared with the model in which all unresolved terms are at their upper limits.
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
        Frequencies of the first and the last bin of the octave in Hz.
    ratio : float
        Measured power / power of the model.
    """

    low: float
    high: float
    ratio: float


@dataclass(frozen=True)
class AxisFit:
    """Fit of one axis.

    Attributes
    ----------
    noise : mapping of term to Estimate
        Estimates of all five terms in SI.
    model : Model
        The complete fitted model, which is tested, drawn and exported. Terms that are not resolved
        are included with their estimates. With method 'likelihood', there are two exceptions: an
        unresolved Q is 0, and an unresolved R is only the part that the random terms do not
        explain. Processes with a shape have intervals.
    m_min : int
        Smallest averaging factor that the model describes; above 1 if the samples are low-pass
        filtered.
    filtered : bool
        Whether the samples are low-pass filtered. Q is then not measured, and N is the density in
        the pass band.
    white_scatter, drift_scatter : float
        Half of the width of the 95 % interval of the logarithm of the amplitude in another hour of
        the same sensor, for white noise and for drift; 0 if the levels within the recording do not
        vary.
    gof_z : float or None
        Goodness of fit of the model as a normal deviate; None if the method has no test.
    lack_of_fit : tuple of LackOfFit
        Octaves in which the data differ from the model; empty if the model passes the test.
    deviation : Deviation or None
        Largest significant deviation of the curve from the model; None if there is none.
    """

    noise: Mapping[str, Estimate]
    model: Model = field(default_factory=Model)
    m_min: int = 1
    filtered: bool = False
    white_scatter: float = 0.0
    drift_scatter: float = 0.0
    gof_z: Signed | None = None
    lack_of_fit: tuple[LackOfFit, ...] = ()
    deviation: Deviation | None = None

    @property
    def likely(self) -> tuple[str, ...]:
        """Terms with the status 'likely' (`estimate.Status`)."""
        return tuple(t for t, c in self.noise.items() if c.status == 'likely')

    @property
    def model_at_limits(self) -> Model:
        """The model with every unresolved term at its 95 % upper limit.

        A term without a finite limit is unchanged, and so is the magnitude of a term that exceeds
        its limit.
        """
        limits = {
            term: max(c.upper95, abs(self.model.value(term)))
            for term, c in self.noise.items()
            if c.status != 'estimated' and c.upper95 is not None and math.isfinite(c.upper95)
        }
        return self.model.changed(**limits)


def with_scatter(fit: AxisFit, white: float, drift: float) -> AxisFit:
    """Return a fit with the predictive intervals of N, B and K.

    ``white`` and ``drift`` are `AxisFit.white_scatter` and `AxisFit.drift_scatter`. Upper limits
    are multiplied by the exponential of the scatter.
    """
    noise = dict(fit.noise)
    for letter, half in (('N', white), ('B', drift), ('K', drift)):
        if half:
            noise[letter] = _predicted(noise[letter], half)
    return replace(fit, noise=noise, white_scatter=white, drift_scatter=drift)


def _predicted(estimate: Estimate, half: float) -> Estimate:
    """Return an estimate with its predictive interval, or with a larger upper limit.

    ``half`` is half of the width of the 95 % interval of the logarithm in another hour.
    """
    value, interval, limit = estimate.value, estimate.recording_ci95, estimate.upper95
    if limit is not None:
        return replace(estimate, upper95=limit * math.exp(half))
    if not value or interval is None:
        return estimate
    low = math.hypot(math.log(value / interval[0]), half) if interval[0] > 0.0 else math.inf
    high = math.hypot(math.log(interval[1] / value), half)
    return replace(estimate, predictive_ci95=(value * math.exp(-low), value * math.exp(high)))


def model_of_terms(noise: Mapping[str, Estimate]) -> Model:
    """Return a model that contains only the five terms, with their estimates."""
    return Model.of(**{t: c.value for t, c in noise.items() if c.value})


METHODS = ('likelihood', 'paper')
"""Fit methods: maximum likelihood for octave spectra and block means, and least squares on Allan
variances as in Cong et al. 2019."""


@dataclass(frozen=True)
class NoiseModel:
    """Fit of all axes of one `AllanSums`.

    Attributes
    ----------
    method : str
        One of `METHODS`.
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


@dataclass(frozen=True)
class SlowNoise:
    """Bias instability and rate random walk, fitted to the block means."""

    B: Estimate
    K: Estimate


@dataclass(frozen=True)
class TemperatureModel:
    """Bias of one axis: b(T) = b0 + b1 (T - T0) + b2 (T - T0)^2, in SI and K.

    Attributes
    ----------
    reference, lowest, highest : float
        T0, and the lowest and highest temperature of the block means, in degC.
    b0, b1, b2 : float
        Mean over the recordings of the bias at T0, slope at T0 per K, and curvature per K^2. The
        bias of an accelerometer contains gravity.
    b0_ci95, b1_ci95, b2_ci95 : (low, high)
        95 % intervals.
    hysteresis : float
        Bias while the temperature rises minus bias while it falls, at equal temperature and with
        the mean rate of change.
    hysteresis_ci95 : (low, high)
        95 % interval.
    rate : float
        Mean rate of change of the temperature, r = mean |dT/dt|, in K/s.
    resolved : bool
        Whether b1 or b2 differs from 0 (false-alarm probability 1 %).
    explained : float or None
        Share of the variance of the block means, without their white noise, that the temperature
        explains; None if white noise alone explains that variance.
    averaging_time : float
        Length of the block means in s.
    measured, corrected : SlowNoise
        B and K of the block means, without and with the temperature in the model. Q and N do not
        change.
    """

    reference: Signed
    lowest: Signed
    highest: Signed
    b0: Signed
    b0_ci95: tuple[float, float]
    b1: Signed
    b1_ci95: tuple[float, float]
    b2: Signed
    b2_ci95: tuple[float, float]
    hysteresis: Signed
    hysteresis_ci95: tuple[float, float]
    rate: float
    resolved: bool
    explained: float | None
    averaging_time: float
    measured: SlowNoise
    corrected: SlowNoise

    @property
    def lag(self) -> float | None:
        """Time in s by which the bias lags behind the thermometer; None if b1 may be 0."""
        if self.b1_ci95[0] <= 0.0 <= self.b1_ci95[1]:
            return None
        return -self.hysteresis / (2.0 * self.b1 * self.rate)

    def bias(self, celsius: Floats) -> Floats:
        """Return b(T) in SI at temperatures in degC; the result has the shape of ``celsius``."""
        x = np.asarray(celsius, float) - self.reference
        return np.asarray(self.b0 + x * (self.b1 + x * self.b2))
