# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The noise variance of one sample: N^2 f, and what the samples themselves show.

A filter that takes every sample for independent wants the variance that makes the mean of n
samples as good as it is, N^2 f / n. Without a low-pass filter in the sensor it is the variance of
the samples, too. With one, neighbours resemble each other: the samples scatter less than N^2 f, but
their mean is no better for it, and a filter told of the smaller variance believes itself too much.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from .batch import AXES, SENSORS
from .errors import AllanError
from .fit.values import AxisFit
from .noise_model import axis_level, white_std

SAMPLE_WINDOW_S = 1.0
"""The scatter of samples is that about the mean of at most so long: slower noise is bias."""

Variances = tuple[float, float, float]
"""Of x, y and z, in the squared unit of the samples."""


def sample_variance(
    m: NDArray[np.int64], adev: NDArray[np.float64], tau0: float, window: float = SAMPLE_WINDOW_S
) -> float | None:
    """Return the variance of samples about the mean of 2^k of them, 2^k tau0 <= window.

    The mean square deviation within 2^k samples is the sum of avar(2^j)/2 over j < k, whatever the
    noise (Percival & Guttorp, Long-memory processes, the Allan variance and wavelets, 1994: the
    Haar wavelet shares the variance out over the scales); n/(n - 1) takes the bias of a mean of n
    independent samples away.

    Parameters
    ----------
    m : (factors,) array
        With every power of two of the window among them.
    adev : (factors,) array
    tau0 : float
        Sample period in s.

    Returns
    -------
    float or None
        None where two samples do not fit the window, or a deviation is not known.
    """
    levels = math.floor(math.log2(window / tau0 * (1.0 + 1e-9))) if tau0 <= window else 0
    known = {int(factor): float(deviation) for factor, deviation in zip(m, adev)}
    parts = [known.get(1 << j, math.nan) ** 2 / 2.0 for j in range(levels)]
    total = sum(parts) * (1 << levels) / ((1 << levels) - 1) if levels else math.nan
    return total if math.isfinite(total) else None


def white_variances(
    axes: Mapping[str, AxisFit], rate: float, inflation: float = 1.0
) -> dict[str, Variances]:
    """Return (inflation N)^2 f of each sensor that has three axes with a value or a limit of N.

    ``rate`` is f in Hz. Where N is not observable its 95 % upper limit stands for it.
    """
    variances = {}
    for sensor, names in _sensors(axes):
        try:
            x, y, z = (
                white_std(inflation * axis_level(name, axes[name], 'N').value, rate) ** 2
                for name in names
            )
        except AllanError:
            continue
        variances[sensor] = (x, y, z)
    return variances


def measured_variances(
    stds: Mapping[str, float | None], inflation: float = 1.0
) -> dict[str, Variances]:
    """Return the squares of the sample standard deviations of each sensor that has all three."""
    variances = {}
    for sensor, names in _sensors(stds):
        known = [std for name in names if (std := stds[name])]
        if len(known) == len(names):
            x, y, z = ((inflation * std) ** 2 for std in known)
            variances[sensor] = (x, y, z)
    return variances


def _sensors(axes: Mapping[str, object]) -> list[tuple[str, Sequence[str]]]:
    """Return the sensors whose axes are all there, with the names of these."""
    named = [(sensor, AXES[rows]) for sensor, rows in SENSORS.items()]
    return [(sensor, names) for sensor, names in named if all(name in axes for name in names)]
