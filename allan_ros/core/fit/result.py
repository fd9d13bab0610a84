# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Result of the fit of an axis: terms with intervals, model, and bias over temperature.

For a measured curve, this module computes the largest deviation from the model, and the dominant
term in each range of averaging times (as in Cong et al. 2019).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..allan.curve import AllanCurve, AxisCurve
from ..estimate import Estimate
from ..fields import Signed
from ..findings import Finding
from ..noise import LETTERS, Model

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


Q, N, B, K = range(4)
"""Indices of the four random terms in `RANDOM_TERMS`, and in all arrays of their coefficients."""

TERMS = tuple(LETTERS)
"""Letters of the five terms: Q, N, B, K and R (docs/glossary.md)."""


class Deviation(NamedTuple):
    """Point of a measured curve with the largest significant deviation from the model.

    Deviations are compared on a logarithmic axis.

    Attributes
    ----------
    relative : float
        Measured Allan deviation / Allan deviation of the model - 1. A point above the model is
        compared with the model in which all unresolved terms with a known finite limit are at their
        upper limits.
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
        Measured power / power of the model, as a mean over the bins of the octave.
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
        differ significantly.
    gof_z : float or None
        Goodness of fit of the model as a normal deviate; None if the method has no test, or if the
        data are too short for a spectrum.
    lack_of_fit : tuple of LackOfFit
        Octaves in which the data differ from the model; empty if the model passes the test.
    deviation : Deviation or None
        Largest significant deviation of the curve from the model; None if there is none, or if it
        was not computed (`with_deviations`).
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

        A term without a finite limit is unchanged. A term that exceeds its limit keeps its
        magnitude. R at its limit is positive.
        """
        limits = {
            term: max(c.upper95, abs(self.model.value(term)))
            for term, c in self.noise.items()
            if c.status != 'estimated' and c.upper95 is not None and math.isfinite(c.upper95)
        }
        return self.model.changed(**limits)

    def limit(self, term: str) -> float:
        """Return the 95 % upper limit of a term, or 0 if the limit is unknown or infinite."""
        value = self.noise[term].upper95
        return value if value is not None and math.isfinite(value) else 0.0

    def models_at_ends(self, predictive: bool = True) -> tuple[Model, Model] | None:
        """Return two models with coefficients at the ends of their 95 % intervals.

        The first model has all coefficients at the lower ends, the second model at the upper ends.
        The interval of a term that has only an upper limit begins at 0. A term that is not in the
        model is 0 in both models. R is replaced by its magnitude, and Q by 0. Shapes, sinusoids and
        processes without an interval are unchanged.

        Parameters
        ----------
        predictive : bool
            Whether predictive intervals are used where they are known; if not, only the intervals
            for the recording are used.

        Returns
        -------
        (Model, Model) or None
            None if N, B, K or R is in the model and has neither an interval nor a finite limit.
        """
        intervals: dict[str, tuple[float, float]] = {}
        for term in 'NBKR':
            coefficient, limit = self.noise[term].magnitude, self.limit(term)
            ci95 = coefficient.ci95 if predictive else coefficient.recording_ci95
            if not self.model.value(term):
                intervals[term] = 0.0, 0.0
            elif ci95 is not None:
                intervals[term] = max(ci95[0], 0.0), ci95[1]
            elif limit:
                intervals[term] = 0.0, limit
            else:
                return None
        low, high = (
            self.model.at_end(end, self.drift_scatter if predictive else 0.0).changed(
                Q=0.0, **{term: ends[end] for term, ends in intervals.items()}
            )
            for end in (0, 1)
        )
        return low, high


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


# --- curve of the model ---------------------------------------------------------------------------


SIGNIFICANT = 3.0
"""Least deviation of a point from the model that is significant, in error bars of the point."""

MIN_WIDTH = 3.0
"""Ratio tau_high/tau_low, about half a decade, below which a range is merged with narrow neighbors
or gets two terms."""


class ModelLine(NamedTuple):
    """Allan deviation of the model at the points of a curve, for drawing.

    Both arrays are NaN at averaging times that the model does not describe.

    Attributes
    ----------
    adev : (factors,) float64 array
        Allan deviation of the model.
    upper : (factors,) float64 array
        Allan deviation of the model with every unresolved term at its 95 % upper limit, if the
        limit is known and finite.
    """

    adev: Floats
    upper: Floats


def model_line(fit: AxisFit, tau0: float, curve: AxisCurve) -> ModelLine:
    """Return the Allan deviations of a fitted model, and of this model at its upper limits, in SI.

    They are computed at the averaging times of a curve, and have the shape (factors,). ``tau0`` is
    the sample period in s. Both arrays are NaN below the shortest averaging time that the model
    describes, and where the Allan variance of the model is not above 0.
    """
    # the Allan variance of a model with a low-pass filter may be negative at short times
    with np.errstate(invalid='ignore'):
        line, upper = (
            np.sqrt(model.avar(curve.tau, tau0)) for model in (fit.model, fit.model_at_limits)
        )
    is_described = (curve.m >= fit.m_min) & (line > 0.0)
    return ModelLine(np.where(is_described, line, np.nan), np.where(is_described, upper, np.nan))


def largest_deviation(line: ModelLine, curve: AxisCurve) -> Deviation | None:
    """Return the largest significant deviation of a measured curve from the model, or None.

    A point between ``line.adev`` and ``line.upper`` has no deviation. A higher point is compared
    with ``line.upper``, a lower point with ``line.adev``. A deviation is significant if it exceeds
    `SIGNIFICANT` error bars of the point on a logarithmic axis. Uncertain points are not compared.
    """
    adev, low, high = curve.adev, curve.ci_low, curve.ci_high
    with np.errstate(divide='ignore', invalid='ignore'):
        nearest = np.clip(adev, line.adev, line.upper)
        difference = np.log(adev / nearest)
        error_bar = np.where(difference > 0.0, np.log(adev / low), np.log(high / adev))
        is_large = np.abs(difference) > SIGNIFICANT * error_bar
        is_significant = ~curve.is_uncertain & (adev > 0.0) & is_large
    if not is_significant.any():
        return None
    largest = int(np.argmax(np.where(is_significant, np.abs(difference), -1.0)))
    return Deviation(math.expm1(difference[largest]), float(curve.tau[largest]))


@dataclass(frozen=True)
class Region:
    """Range of averaging times, and the noise that dominates in this range.

    Attributes
    ----------
    tau_low, tau_high : float
        Ends of the range in s.
    term : str
        Term or process with the largest share of the Allan variance. If no term or process
        dominates over a factor of 3 in tau, this can be several names, joined by '+'.
    """

    tau_low: float
    tau_high: float
    term: str


def dominant_regions(curve: AllanCurve, fit: AxisFit) -> list[Region]:
    """Return ranges of averaging times, each with its dominant term.

    A term or process dominates where it has the largest share of the Allan variance of the model.
    Adjacent ranges that are narrower than a factor of 3 in tau are merged. A narrow range without a
    narrow neighbor gets the two terms with the largest shares, if the model has two terms or more.

    The ranges are contiguous, cover the measured curve, and are sorted by tau. The list is empty if
    the model or the curve is empty.
    """
    tau0 = curve.tau[0] / curve.m[0] if len(curve.m) else math.nan
    parts = fit.model.contributions(curve.tau, tau0) if len(curve.m) else {}
    if not parts:
        return []
    names = list(parts)
    variances = np.stack(list(parts.values()), axis=1)
    shares = variances / variances.sum(axis=1, keepdims=True)
    edges = np.concatenate([curve.tau[:1], np.sqrt(curve.tau[1:] * curve.tau[:-1]), curve.tau[-1:]])
    largest = np.argmax(shares, axis=1)
    bounds = [0, *(np.flatnonzero(np.diff(largest)) + 1).tolist(), len(largest)]
    regions = []
    for is_wide, group in groupby(
        pairwise(bounds), key=lambda ends: bool(edges[ends[1]] >= MIN_WIDTH * edges[ends[0]])
    ):
        ranges = list(group)
        for first, end in ranges if is_wide else [(ranges[0][0], ranges[-1][1])]:
            dominant = np.unique(largest[first:end])
            if not is_wide and len(dominant) == 1:
                dominant = np.sort(np.argsort(shares[first:end].mean(axis=0))[-2:])
            term = '+'.join(names[k] for k in dominant.tolist())
            regions.append(Region(float(edges[first]), float(edges[end]), term))
    return regions


# --- bias over temperature ------------------------------------------------------------------------


@dataclass(frozen=True)
class SlowNoise:
    """Bias instability, and rate or acceleration random walk, fitted to the block means, in SI."""

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
        Bias at T0 as a mean over the block means of all recordings, slope at T0 per K, and
        coefficient of the square per K^2. The bias of an accelerometer contains gravity.
    b0_ci95, b1_ci95, b2_ci95 : (low, high)
        95 % intervals.
    hysteresis : float
        Bias while the temperature rises minus bias while it falls, at equal temperature and with
        the mean rate of change.
    hysteresis_ci95 : (low, high)
        95 % interval.
    rate : float
        Mean magnitude of the rate of change of the temperature, r = mean |dT/dt|, in K/s.
    resolved : bool
        Whether b1 or b2 differs from 0 (false-alarm probability 1 %).
    explained : float or None
        Share of the variance of the block means within the recordings that b1 and b2 explain. The
        variance of the white noise is subtracted first. None if white noise alone may explain the
        variance.
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
        """Time in s by which the bias lags behind the thermometer.

        The result is None if the interval of b1, the slope of the bias over temperature, contains
        0.
        """
        if self.b1_ci95[0] <= 0.0 <= self.b1_ci95[1]:
            return None
        return -self.hysteresis / (2.0 * self.b1 * self.rate)

    def bias(self, celsius: Floats) -> Floats:
        """Return b(T) in SI at temperatures in degC; the result has the shape of ``celsius``."""
        x = np.asarray(celsius, float) - self.reference
        return np.asarray(self.b0 + x * (self.b1 + x * self.b2))
