# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Variances of one sample due to white noise and bias, for the covariances in IMU messages."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress

from ..errors import AllanError
from ..estimate import Estimate
from ..fit.result import AxisFit
from ..imu import AXES, SENSORS
from ..noise import Model
from .noise_parameters import axis_level, reduce_axis, reduce_model

Variances = tuple[float, float, float]
"""Variances of x, y and z, in the squared unit of the samples."""


def white_variances(
    axes: Mapping[str, AxisFit], rate: float, inflation: float = 1.0, horizon: float = 0.0
) -> dict[str, Variances]:
    """Return the variance of the white noise of one sample, (inflation N)^2 f, for each axis.

    Parameters
    ----------
    axes : mapping of axis name to AxisFit
        Fits of the axes.
    rate : float
        Sample rate f in Hz.
    inflation : float
        Factor by which N is multiplied.
    horizon : float
        If not 0, the longest time in s that a state estimator without bias states integrates. N is
        then increased until white noise alone predicts errors at least as large as the errors that
        the complete model predicts.

    Returns
    -------
    dict of 'gyro' and 'accel' to (x, y, z)
        The variances in the squared unit of the samples. A sensor is excluded if N of one of its
        axes has neither a resolved estimate nor a limit that is positive and finite, or if an axis
        is missing. With a horizon, the same holds for K of an axis whose model has no drift.
    """
    stds: dict[str, float] = {}
    for name, fit in axes.items():
        with suppress(AllanError):
            if horizon:
                white_noise = reduce_axis(name, fit, 'none', horizon).model.value('N')
            else:
                white_noise = axis_level(name, fit, 'N').value
            stds[name] = white_noise * rate**0.5
    variances = {}
    for sensor, rows in SENSORS.items():
        axis_stds = [stds[name] for name in AXES[rows] if name in stds]
        if len(axis_stds) == 3:
            x, y, z = ((inflation * std) ** 2 for std in axis_stds)
            variances[sensor] = (x, y, z)
    return variances


def white_ratio(axes: Mapping[str, AxisFit], horizon: float) -> float:
    """Return the largest ratio, over all axes, of N for high noise to N for low noise.

    Each N is increased until white noise alone covers the error of a model up to a ``horizon`` in
    s, above 0. The models have coefficients at the upper and at the lower ends of their 95 %
    intervals (`AxisFit.models_at_ends`). The ratio is at least 1. It is infinite if N for low noise
    is 0, or if N, B, K or R of the model of an axis has neither an interval nor a finite limit.
    """
    ratios = [1.0]
    for fit in axes.values():
        end_models = fit.models_at_ends() or (Model(),) * 2
        low, high = (
            reduce_model(end_model, 'none', horizon).model.value('N') for end_model in end_models
        )
        ratios.append(high / low if low > 0.0 else math.inf)
    return max(ratios)


def scaled_variances(
    variances: dict[str, Variances], ratios: Mapping[str, float]
) -> dict[str, Variances]:
    """Return each variance times the squared ratio of its axis; a missing ratio is taken as 1."""
    scaled = dict(variances)
    for sensor, values in variances.items():
        x, y, z = (
            value * ratios.get(axis, 1.0) ** 2 for axis, value in zip(AXES[SENSORS[sensor]], values)
        )
        scaled[sensor] = x, y, z
    return scaled


def cover_bias(
    variances: dict[str, Variances], bias: Mapping[str, Estimate], messages: float
) -> dict[str, Variances]:
    """Return ``variances`` with the variances of the gyro increased to cover the bias.

    ``messages`` is the number of samples that a state estimator integrates; less than 1 counts as
    1. From the increased variances, the state estimator computes a variance of the integral that
    covers the error due to noise and bias. ``bias`` is axis -> bias at rest in SI for each axis
    with a known bias; the bias of a missing axis is taken as 0. The bias of an accelerometer is
    unknown, because it cannot be distinguished from gravity.
    """
    if 'gyro' not in variances:
        return variances
    no_bias = Estimate.normal(0.0, 0.0)
    biases = (bias.get(axis, no_bias) for axis in AXES[SENSORS['gyro']])
    bias_variances = (
        max(1.0, messages) * ((axis_bias.value or 0.0) ** 2 + axis_bias.std**2)
        for axis_bias in biases
    )
    x, y, z = (
        variance + bias_variance
        for variance, bias_variance in zip(variances['gyro'], bias_variances)
    )
    return {**variances, 'gyro': (x, y, z)}
