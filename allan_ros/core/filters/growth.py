# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Predicted error of the integrated samples of a sensor at given times, with intervals.

The integral is an angle for a gyro, and a velocity for an accelerometer. `Model.growth` defines the
error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..estimate import Z_95, Estimate
from ..fit.result import AxisFit
from ..imu import HOUR

Floats = NDArray[np.float64]

LARGEST_LOG = 100.0
"""Largest logarithm of the ratio between an estimate and an end of its predictive interval."""

INDEPENDENT = 2.0
"""Assumed number of independent errors in a time h + W, where h is the prediction horizon and W the
averaging time of the bias. If rho is the autocorrelation of the errors, their mean square over a
time T varies as much as the mean square of T / (integral of rho^2) independent errors. For h = W
and T = h + W, this number is 3.0 for white noise and 1.9 for a random walk."""

GROWTH_S = (1.0, 10.0, 30.0, 100.0, 300.0)
"""Default prediction horizons of `growth_table` in s."""

GROWTH_WINDOW_S = 100.0
"""Default time in s over which `growth_table` assumes that the bias was averaged."""


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
        Predicted standard deviation of the error, in the unit of the samples times s. The estimate
        has no interval if N, B, K or R of the model has neither an interval nor a finite limit, or
        if no noise is known.
    """

    horizon: float
    window: float
    std: Estimate


def growth_table(
    fit: AxisFit,
    horizons: tuple[float, ...] = GROWTH_S,
    window: float = GROWTH_WINDOW_S,
) -> tuple[Growth, ...]:
    """Return the predicted error at given times after the last correction, with intervals.

    Parameters
    ----------
    fit : AxisFit
        Fit of one axis. Terms that are not resolved are included with their estimates.
    horizons : tuple of float
        Times since the last correction in s, above 0.
    window : float
        Time in s, above 0, over which the bias was averaged before the correction.

    Returns
    -------
    tuple of Growth
        One element for each horizon.

    Notes
    -----
    The variance due to each term is computed at both ends of the 95 % interval of its coefficient.
    The interval of a term that is not resolved reaches from 0 to its upper limit. The distances of
    these variances from the estimated variance are added in quadrature over the terms (method of
    variance estimates recovery; G. Y. Zou, A. Donner, Statistics in Medicine 2008). This assumes
    uncorrelated estimates. Estimates of neighboring terms are usually negatively correlated, which
    makes the interval too wide rather than too narrow.

    The predictive interval contains the root mean square of the errors in another hour with a
    probability of about 95 %. The levels of white noise and drift in that hour may differ from the
    levels in the recording, and an hour contains a limited number of independent errors
    (`INDEPENDENT`).
    """
    h = np.array(horizons)
    model = fit.model.drift
    std = model.growth(h, window)
    end_models = fit.models_at_ends(predictive=False)
    if end_models is None:
        return tuple(
            Growth(float(horizon), window, Estimate(float(value))) for horizon, value in zip(h, std)
        )
    low_model, high_model = (model_at_end.drift for model_at_end in end_models)
    high_model = high_model.changed(
        **{term: high_model.value(term) or fit.limit(term) for term in 'NBKR'}
    )
    variances_of_models = [
        any_model.growth_variances(h, window) for any_model in (model, low_model, high_model)
    ]
    zero = np.zeros(len(h))
    variance, distance_below, distance_above, scatter = zero, zero, zero, zero
    for process in {**variances_of_models[0], **variances_of_models[2]}:
        estimated, at_low_end, at_high_end = (
            variances.get(process, zero) for variances in variances_of_models
        )
        variance = variance + estimated
        distance_below = np.hypot(distance_below, np.maximum(estimated - at_low_end, 0.0))
        distance_above = np.hypot(distance_above, np.maximum(at_high_end - estimated, 0.0))
        scatter = scatter + estimated * (
            fit.white_scatter if process.is_white else fit.drift_scatter
        )
    low_std = np.sqrt(np.maximum(variance - distance_below, 0.0))
    high_std = np.sqrt(variance + distance_above)
    hour_scatter = Z_95 / np.sqrt(2.0 * INDEPENDENT * HOUR / (h + window))
    with np.errstate(divide='ignore', invalid='ignore'):
        next_hour_scatter = np.hypot(scatter / variance, hour_scatter)
        log_below, log_above = (
            np.minimum(np.hypot(np.log(ratio), next_hour_scatter), LARGEST_LOG)
            for ratio in (std / low_std, high_std / std)
        )
    return tuple(
        Growth(
            float(h[i]),
            window,
            Estimate(
                float(std[i]),
                (float(low_std[i]), float(high_std[i])) if high_std[i] > 0.0 else None,
                predictive_ci95=(
                    float(std[i] * np.exp(-log_below[i])),
                    float(std[i] * np.exp(log_above[i])),
                )
                if std[i] > 0.0
                else None,
            ),
        )
        for i in range(len(h))
    )
