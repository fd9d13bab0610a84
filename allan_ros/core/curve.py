# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Allan curve of running sums, with the confidence limits of every point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .edf import chi_squared_limits, edf
from .errors import AllanError
from .grid import counts
from .noise_type import noise_types_of_avar
from .sums import AllanSums

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class AllanCurve:
    """Overlapping Allan deviation of all axes, with limits.

    Attributes
    ----------
    axes : tuple of str
        The last dimension.
    m : (factors,) int64 array
        Averaging factors in samples.
    tau : (factors,) float64 array
        Averaging times in s.
    n : (factors,) int64 array
        Second differences in each point.
    adev, ci_low, ci_high : (factors, axes) float64 arrays
        Deviation and its chi-squared limits of level `edf.CI_LEVEL`, in the unit of the samples.
    edf : (factors, axes) float64 array
        Equivalent degrees of freedom.
    noise_type : (factors, axes) int64 array
        Exponent alpha of S ~ f^alpha they were counted for: 2 (Q), 1, 0 (N), -1 (B), -2 (K, R).
    """

    axes: tuple[str, ...]
    m: NDArray[np.int64]
    tau: Floats
    n: NDArray[np.int64]
    adev: Floats
    ci_low: Floats
    ci_high: Floats
    edf: Floats
    noise_type: NDArray[np.int64]


def sample_period(sums: AllanSums) -> float:
    """Return tau0 in s.

    Raises
    ------
    AllanError
        When there are fewer than two samples, so that it is not known.
    """
    if sums.tau0 is None:
        raise AllanError('there is no Allan curve of fewer than two samples: record some minutes')
    return sums.tau0


def allan_curve(sums: AllanSums) -> AllanCurve:
    """Return the curve of the factors that have data.

    The degrees of freedom are those of the noise type found at each point and of the segments as
    they are: segments pooled by length count with their mean length.

    Raises
    ------
    AllanError
        When there are fewer than two samples, so that no sample period is known.
    """
    tau0 = sample_period(sums)
    some = sums.count > 0
    m, stride, avar = sums.m[some], sums.stride[some], sums.avar[some]
    types = noise_types_of_avar(m, avar, sums.samples)
    degrees = degrees_of_freedom(sums, m, stride, types)
    low, high = chi_squared_limits(avar, degrees)
    tau = np.asarray(m * tau0, float)
    return AllanCurve(sums.axes, m, tau, sums.count[some], np.sqrt(avar), low, high, degrees, types)


def degrees_of_freedom(
    sums: AllanSums, m: NDArray[np.int64], stride: NDArray[np.int64], types: NDArray[np.int64]
) -> Floats:
    """Return the equivalent degrees of freedom of variances pooled over the segments of the sums.

    Parameters
    ----------
    sums : AllanSums
        Its histogram of segment lengths is used.
    m, stride : (factors,) int64 arrays
        Averaging factors, and samples between starts: those of the grid, or m itself for groups
        that do not overlap.
    types : (factors, axes) int64 array
        Noise type at each.

    Returns
    -------
    (factors, axes) float64 array
        NaN where no segment is long enough.
    """
    lengths = [round(samples) for samples, _ in sums.length_histogram]
    number = [how_many for _, how_many in sums.length_histogram]
    degrees = np.empty(types.shape)
    for i in range(len(m)):
        per_segment = np.array([counts(n, m[i], stride[i]) for n in lengths])
        of_type = {
            t: edf(t, int(m[i]), int(stride[i]), per_segment, number)
            for t in set(types[i].tolist())
        }
        degrees[i] = [of_type[t] for t in types[i].tolist()]
    return degrees
