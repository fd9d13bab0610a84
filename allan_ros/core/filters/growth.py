# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Predicted error growth of an integrated sensor: angle of a gyro, velocity and position.

The bias is averaged over the W seconds before time 0 and subtracted. At the prediction horizon h,
the integral theta of the samples (angle of a gyro, velocity of an accelerometer) has the error

    e(h) = theta(h) - theta(0) - (h/W) (theta(0) - theta(-W)).

A constant or linear theta does not change this linear combination, sum c_i theta(t_i). Its variance
is therefore sum c_i c_j G(t_i - t_j) with the generalized covariances G of theta (G. Matheron, The
intrinsic random functions and their applications, 1973), one per process:

    N: -N^2 |t|/2    B: B^2 t^2 ln|t|/(2 pi)    K: K^2 |t|^3/12
    Gauss-Markov (sigma, T): -sigma^2 T^2 (x - 1 + exp(-x) - x^2/2), x = |t|/T
    sinusoid (a, f): a^2 cos(w t)/(2 w^2), w = 2 pi f

The position error is the integral of e from 0 to h. It requires the generalized covariances C of
the integral of theta with theta (C' = G) and H of the integral with itself (H'' = -G).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..fit.model import AxisFit
from ..noise import NoiseTerms, ProcessModel

Floats = NDArray[np.float64]
Kernels = tuple[Floats, Floats, Floats]
"""Generalized covariances G, C and H at given lags."""

SLOW_SINUSOID_HZ = 0.1
"""Sinusoids up to this frequency are treated as drift of the sensor (temperature cycles); faster
ones as motion."""

LARGEST_ERROR = 1e150
"""Largest error of a ramp in the unit of the samples times s; its square is a float."""

GROWTH_S = (1.0, 10.0, 30.0, 100.0, 300.0)
GROWTH_WINDOW_S = 100.0
"""Prediction horizons of `growth_table` and averaging time of the bias before them, in s."""

_SERIES_BELOW = 1.0
"""Argument below which `_remainder` uses a power series instead of differences, which would cancel
significant digits."""

_SERIES_TERMS = 20
"""Number of terms of this series; the truncation error is below 1/20!."""


def predicted_growth(
    model: ProcessModel, horizon: ArrayLike, window: ArrayLike, integrals: int = 1
) -> Floats:
    """Return the standard deviation of the error of the integrated samples, without quantization.

    Parameters
    ----------
    model : ProcessModel
        Noise of the samples.
    horizon : array
        Prediction horizons h in s, above 0.
    window : array
        Times W in s over which the bias was averaged before, above 0; broadcasts with ``horizon``.
    integrals : 1 or 2
        1 for the angle of a gyro or the velocity of an accelerometer, 2 for its position.

    Returns
    -------
    float64 array
        In the unit of the samples times s (or s^2).

    Examples
    --------
    White noise of 1 unit/sqrt(Hz), bias averaged over as long as it is integrated:

    >>> from allan_ros.core.noise import NoiseTerms
    >>> float(predicted_growth(ProcessModel(NoiseTerms(N=1.0)), 8.0, 8.0))
    4.0
    """
    variances = [variance for _, variance in growth_parts(model, horizon, window, integrals)]
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
    """Predicted error of an angle, velocity or position at a time after the last correction.

    Attributes
    ----------
    horizon : float
        Time since the last correction in s.
    window : float
        Time in s before the correction, over which the bias was averaged.
    std : float
        Predicted standard deviation of the error, in the unit of the samples times s, or s^2 for a
        position.
    ci95 : (low, high) or None
        95 % interval of ``std``; None if a term of the model has no interval.
    """

    horizon: float
    window: float
    std: float
    ci95: tuple[float, float] | None


def growth_table(
    fit: AxisFit,
    integrals: int = 1,
    horizons: tuple[float, ...] = GROWTH_S,
    window: float = GROWTH_WINDOW_S,
) -> tuple[Growth, ...]:
    """Return the predicted error at some times after the last correction.

    ``horizons`` are these times and ``window`` the time over which the bias was averaged before, in
    s. ``integrals`` is 1 for the angle of a gyro or the velocity of an accelerometer, 2 for its
    position. Terms that are not resolved are included with their estimates. For the upper end of
    the interval, all terms have their 95 % upper limits.

    The distances of the ends of the interval from the estimate are added in quadrature over the
    terms (method of variance estimates recovery; G. Y. Zou, A. Donner, Statistics in Medicine
    2008). This assumes uncorrelated estimates. Estimates of neighboring terms are negatively
    correlated, which makes the interval too wide rather than too narrow.
    """
    h = np.array(horizons)
    model = drift_model(fit.model)
    std = predicted_growth(model, h, window, integrals)
    intervals: list[tuple[float, float] | None] = [None] * len(h)
    if ends := interval_models(fit):
        low, high = map(drift_model, ends)
        limits = {t: getattr(high.terms, t) or _limit(fit, t) for t in 'NBKR'}
        high = replace(high, terms=NoiseTerms(**limits))
        parts = [dict(growth_parts(one, h, window, integrals)) for one in (model, low, high)]
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
        Growth(float(one), window, float(value), ci95)
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
        ci95, limit = fit.noise[term].ci95, _limit(fit, term)
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
    model: ProcessModel, horizon: ArrayLike, window: ArrayLike, integrals: int = 1
) -> Iterator[tuple[str, Floats]]:
    """Yield (name, variance of the error due to it) for each process of the model that is not 0.

    The parameters are the same as in `predicted_growth`. The variance is an array over the
    horizons, in the squared unit of the samples times s^2 (or s^4).
    """
    h, w = np.broadcast_arrays(np.asarray(horizon, float), np.asarray(window, float))
    terms = model.terms
    if terms.N:
        yield 'N', terms.N**2 * _unit_error(_white, h, w, integrals)
    if terms.B:
        yield 'B', terms.B**2 * _unit_error(_flicker, h, w, integrals)
    if terms.K:
        yield 'K', terms.K**2 * _unit_error(_walk, h, w, integrals)
    if terms.R:
        ramp = h * (h + w) / 2.0 if integrals == 1 else h * h * (h / 6.0 + w / 4.0)
        # bounded, because a document may state any R
        yield 'R', np.minimum(abs(terms.R) * ramp, LARGEST_ERROR) ** 2
    # the kernels are in units of tau: the variance of theta scales with tau^2, and the variance of
    # its integral with tau^4
    scaled = [
        *(('gauss_markov', i, *pair, _gauss_markov) for i, pair in enumerate(model.gauss_markov)),
        *(
            ('sinusoid', i, amplitude, 1.0 / (2.0 * math.pi * frequency), _sinusoid)
            for i, (amplitude, frequency) in enumerate(model.sinusoids)
        ),
    ]
    for name, i, level, tau, kernel in scaled:
        scale = tau ** (2 * integrals)
        yield f'{name} {i}', level**2 * scale * _unit_error(kernel, h / tau, w / tau, integrals)


def _unit_error(
    kernel: Callable[[Floats], Kernels], h: Floats, w: Floats, integrals: int
) -> Floats:
    """Return the variance of the integration error due to a process with coefficient 1."""
    ratio = h / w
    zero = np.zeros_like(h)
    if integrals == 1:
        at = np.stack([h, zero, -w], axis=-1)
        c = np.stack([np.ones_like(h), -(1.0 + ratio), ratio], axis=-1)
        g, _, _ = kernel(at[..., :, None] - at[..., None, :])
        return np.asarray(np.einsum('...i,...ij,...j->...', c, g, c))
    # p = Psi(h) - Psi(0) - h theta(0) - (h^2/2W) (theta(0) - theta(-W)), Psi the integral of theta
    psi_at = np.stack([h, zero], axis=-1)
    psi = np.broadcast_to(np.array([1.0, -1.0]), psi_at.shape)
    theta_at = np.stack([zero, -w], axis=-1)
    theta = np.stack([-h * (1.0 + ratio / 2.0), h * ratio / 2.0], axis=-1)
    _, _, hh = kernel(psi_at[..., :, None] - psi_at[..., None, :])
    g, _, _ = kernel(theta_at[..., :, None] - theta_at[..., None, :])
    _, cc, _ = kernel(psi_at[..., :, None] - theta_at[..., None, :])
    return np.asarray(
        np.einsum('...i,...ij,...j->...', psi, hh, psi)
        + np.einsum('...i,...ij,...j->...', theta, g, theta)
        + 2.0 * np.einsum('...i,...ij,...j->...', psi, cc, theta)
    )


def _white(t: Floats) -> Kernels:
    a = np.abs(t)
    return -a / 2.0, -t * a / 4.0, a**3 / 12.0


def _flicker(t: Floats) -> Kernels:
    a = np.abs(t)
    log = np.log(np.where(a > 0.0, a, 1.0))
    unit = 1.0 / (2.0 * math.pi)
    return (
        unit * t * t * log,
        unit * t**3 * (log / 3.0 - 1.0 / 9.0),
        -unit * t**4 * (log / 12.0 - 7.0 / 144.0),
    )


def _walk(t: Floats) -> Kernels:
    a = np.abs(t)
    return a**3 / 12.0, t * a**3 / 48.0, -(a**5) / 240.0


def _gauss_markov(x: Floats) -> Kernels:
    a, sign = np.abs(x), np.sign(x)
    return -_remainder(a, 3), sign * _remainder(a, 4), _remainder(a, 5)


def _sinusoid(x: Floats) -> Kernels:
    return np.cos(x) / 2.0, np.sin(x) / 2.0, np.cos(x) / 2.0


def _remainder(x: Floats, order: int) -> Floats:
    """Return exp(-x) minus its Taylor polynomial of degree ``order`` - 1, to full precision."""
    small = np.where(x < _SERIES_BELOW, x, 0.0)
    series = np.zeros_like(x)
    for j in range(order + _SERIES_TERMS, order - 1, -1):
        series = (-1.0) ** j / math.factorial(j) + series * small
    large = np.exp(-x)
    for j in range(order):
        large = large - (-x) ** j / math.factorial(j)
    return np.where(x < _SERIES_BELOW, series * small**order, large)
