# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Predicted error growth of an integrated sensor: angle of a gyro, velocity of an accelerometer.

The bias is averaged over the W seconds before time 0 and subtracted. At the prediction horizon h,
the integral theta of the samples (angle or velocity) has the error

    e(h) = theta(h) - theta(0) - (h/W) (theta(0) - theta(-W)).

A constant or linear theta does not change this linear combination, sum c_i theta(t_i). Its variance
is therefore sum c_i c_j G(t_i - t_j) with the generalized covariances G of theta (G. Matheron, The
intrinsic random functions and their applications, 1973), one per process:

    N: -N^2 |t|/2    B: B^2 t^2 ln|t|/(2 pi)    K: K^2 |t|^3/12
    Gauss-Markov (sigma, T): -sigma^2 T^2 (x - 1 + exp(-x) - x^2/2), x = |t|/T
    sinusoid (a, f): a^2 cos(w t)/(2 w^2), w = 2 pi f
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..estimate import Estimate
from ..fit.model import AxisFit
from ..noise import NoiseTerms, ProcessModel

Floats = NDArray[np.float64]

SLOW_SINUSOID_HZ = 0.1
"""Sinusoids up to this frequency are treated as drift of the sensor (temperature cycles); faster
ones as motion."""

LARGEST_ERROR = 1e150
"""Largest error of a ramp in the unit of the samples times s; its square is a float."""

GROWTH_S = (1.0, 10.0, 30.0, 100.0, 300.0)
GROWTH_WINDOW_S = 100.0
"""Prediction horizons of `growth_table` and averaging time of the bias before them, in s."""

_SERIES_BELOW, _SERIES_TERMS = 1.0, 23
"""Argument below which `_gauss_markov` uses a power series instead of differences, which would
cancel significant digits, and the power at which the series ends."""


def predicted_growth(model: ProcessModel, horizon: ArrayLike, window: ArrayLike) -> Floats:
    """Return the standard deviation of the error of the integrated samples, without quantization.

    Parameters
    ----------
    model : ProcessModel
        Noise of the samples.
    horizon : array
        Prediction horizons h in s, above 0.
    window : array
        Times W in s over which the bias was averaged before, above 0; broadcasts with ``horizon``.

    Returns
    -------
    float64 array
        In the unit of the samples times s.

    Examples
    --------
    White noise of 1 unit/sqrt(Hz), bias averaged over as long as it is integrated:

    >>> from allan_ros.core.noise import NoiseTerms
    >>> float(predicted_growth(ProcessModel(NoiseTerms(N=1.0)), 8.0, 8.0))
    4.0
    """
    variances = [variance for _, variance in growth_parts(model, horizon, window)]
    return np.asarray(np.sqrt(np.maximum(sum(variances, np.zeros(np.shape(horizon))), 0.0)))


def drift_model(model: ProcessModel) -> ProcessModel:
    """Return the model without quantization, resonances and sinusoids above 0.1 Hz.

    Their integrals are bounded, so they do not contribute to the growth of the error.
    """
    slow = tuple(pair for pair in model.sinusoids if pair[1] <= SLOW_SINUSOID_HZ)
    return replace(
        model, terms=replace(model.terms, Q=0.0), sinusoids=slow, low_pass=0.0, resonances=()
    )


def has_drift(model: ProcessModel) -> bool:
    """Return whether B, K, R, a Gauss-Markov process or a slow sinusoid is in the model."""
    one = drift_model(model)
    return bool(one.terms.B or one.terms.K or one.terms.R or one.gauss_markov or one.sinusoids)


@dataclass(frozen=True)
class Growth:
    """Predicted error of an angle or velocity at a time after the last correction.

    Attributes
    ----------
    horizon : float
        Time since the last correction in s.
    window : float
        Time in s before the correction, over which the bias was averaged.
    std : Estimate
        Predicted standard deviation of the error, in the unit of the samples times s. It has no
        interval if a term of the model has none.
    """

    horizon: float
    window: float
    std: Estimate


def growth_table(
    fit: AxisFit,
    horizons: tuple[float, ...] = GROWTH_S,
    window: float = GROWTH_WINDOW_S,
) -> tuple[Growth, ...]:
    """Return the predicted error at some times after the last correction.

    ``horizons`` are these times and ``window`` the time over which the bias was averaged before, in
    s. Terms that are not resolved are included with their estimates. For the upper end of
    the interval, all terms have their 95 % upper limits.

    The distances of the ends of the interval from the estimate are added in quadrature over the
    terms (method of variance estimates recovery; G. Y. Zou, A. Donner, Statistics in Medicine
    2008). This assumes uncorrelated estimates. Estimates of neighboring terms are negatively
    correlated, which makes the interval too wide rather than too narrow.
    """
    h = np.array(horizons)
    model = drift_model(fit.model)
    std = predicted_growth(model, h, window)
    intervals: list[tuple[float, float] | None] = [None] * len(h)
    if ends := interval_models(fit):
        low, high = map(drift_model, ends)
        limits = {t: getattr(high.terms, t) or _limit(fit, t) for t in 'NBKR'}
        high = replace(high, terms=NoiseTerms(**limits))
        parts = [dict(growth_parts(one, h, window)) for one in (model, low, high)]
        zero = np.zeros(len(h))
        total, below, above = zero, zero, zero
        for name in {**parts[0], **parts[2]}:
            middle, bottom, top = (part.get(name, zero) for part in parts)
            total = total + middle
            below = np.hypot(below, np.maximum(middle - bottom, 0.0))
            above = np.hypot(above, np.maximum(top - middle, 0.0))
        bounds = np.sqrt(np.maximum(total - below, 0.0)), np.sqrt(total + above)
        intervals = [(float(bottom), float(top)) for bottom, top in zip(*bounds)]
    return tuple(
        Growth(float(one), window, Estimate(float(value), ci95))
        for one, value, ci95 in zip(h, std, intervals)
    )


def _limit(fit: AxisFit, term: str) -> float:
    """Return the 95 % upper limit of a term, or 0 if it is unknown or infinite."""
    value = fit.noise[term].upper95
    return value if value is not None and math.isfinite(value) else 0.0


def interval_models(fit: AxisFit) -> tuple[ProcessModel, ProcessModel] | None:
    """Return the model at the lower and at the upper ends of all 95 % intervals.

    The interval of a term with only a limit begins at 0. Q is 0, and the ramp R is replaced by its
    magnitude. Correlation times and sinusoids are unchanged. The result is None if N, B, K or R of
    the model has neither an interval nor a limit.
    """
    intervals: dict[str, tuple[float, float]] = {}
    for term in 'NBKR':
        ci95, limit = fit.noise[term].magnitude.ci95, _limit(fit, term)
        if not getattr(fit.model.terms, term):
            intervals[term] = 0.0, 0.0
        elif ci95 is not None:
            intervals[term] = max(ci95[0], 0.0), ci95[1]
        elif limit:
            intervals[term] = 0.0, limit
        else:
            return None
    low, high = (
        ProcessModel(
            NoiseTerms(**{term: ends[end] for term, ends in intervals.items()}),
            tuple(
                (max(p.sigma_ci95[end], 0.0), p.correlation_time)
                for p in fit.processes.gauss_markov
            ),
            fit.model.sinusoids,
        )
        for end in (0, 1)
    )
    return low, high


def growth_parts(
    model: ProcessModel, horizon: ArrayLike, window: ArrayLike
) -> Iterator[tuple[str, Floats]]:
    """Yield (name, variance of the error due to it) for each process of the model that is not 0.

    The parameters are the same as in `predicted_growth`. The variance is an array over the
    horizons, in the squared unit of the samples times s^2.
    """
    h, w = np.broadcast_arrays(np.asarray(horizon, float), np.asarray(window, float))
    terms = model.terms
    if terms.N:
        yield 'N', terms.N**2 * _unit_error(_white, h, w)
    if terms.B:
        yield 'B', terms.B**2 * _unit_error(_flicker, h, w)
    if terms.K:
        yield 'K', terms.K**2 * _unit_error(_walk, h, w)
    if terms.R:
        ramp = h * (h + w) / 2.0
        # bounded, because a document may state any R
        yield 'R', np.minimum(abs(terms.R) * ramp, LARGEST_ERROR) ** 2
    # the kernels are in units of tau: the variance of theta scales with tau^2
    scaled = [
        *(('gauss_markov', i, *pair, _gauss_markov) for i, pair in enumerate(model.gauss_markov)),
        *(
            ('sinusoid', i, amplitude, 1.0 / (2.0 * math.pi * frequency), _sinusoid)
            for i, (amplitude, frequency) in enumerate(model.sinusoids)
        ),
    ]
    for name, i, level, tau, kernel in scaled:
        yield f'{name} {i}', level**2 * tau**2 * _unit_error(kernel, h / tau, w / tau)


def _unit_error(kernel: Callable[[Floats], Floats], h: Floats, w: Floats) -> Floats:
    """Return the variance of the integration error due to a process with coefficient 1."""
    ratio = h / w
    at = np.stack([h, np.zeros_like(h), -w], axis=-1)
    c = np.stack([np.ones_like(h), -(1.0 + ratio), ratio], axis=-1)
    covariance = kernel(at[..., :, None] - at[..., None, :])
    return np.asarray(np.einsum('...i,...ij,...j->...', c, covariance, c))


def _white(t: Floats) -> Floats:
    return -np.abs(t) / 2.0


def _flicker(t: Floats) -> Floats:
    a = np.abs(t)
    log = np.log(np.where(a > 0.0, a, 1.0))
    return 1.0 / (2.0 * math.pi) * t * t * log


def _walk(t: Floats) -> Floats:
    return np.abs(t) ** 3 / 12.0


def _gauss_markov(x: Floats) -> Floats:
    """Return 1 - x + x^2/2 - exp(-x) of the magnitude of x, to full precision."""
    a = np.abs(x)
    small = np.where(a < _SERIES_BELOW, a, 0.0)
    series = np.zeros_like(a)
    for j in range(_SERIES_TERMS, 2, -1):
        series = (-1.0) ** j / math.factorial(j) + series * small
    large = np.exp(-a)
    for j in range(3):
        large = large - (-a) ** j / math.factorial(j)
    return -np.where(a < _SERIES_BELOW, series * small**3, large)


def _sinusoid(x: Floats) -> Floats:
    return np.cos(x) / 2.0
