# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Allan deviation of a fitted model, largest deviation of the measured curve, and dominant terms.

Cong et al. 2019 also state the dominant term in each range of averaging times.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..allan.curve import AllanCurve, AxisCurve
from .result import AxisFit, Deviation, Floats

MIN_WIDTH = 3.0
"""Smallest ratio tau_high/tau_low of a range with a single dominant term: half a decade."""

SIGNIFICANT = 3.0
"""Least deviation of a point from the model that is significant, in error bars of the point."""


class ModelLine(NamedTuple):
    """Allan deviation of the model at the points of a curve, for drawing.

    Both arrays are NaN at averaging times that the model does not describe.

    Attributes
    ----------
    adev : (factors,) float64 array
        Allan deviation of the model.
    upper : (factors,) float64 array
        Allan deviation of the model with every unresolved term at its 95 % upper limit.
    """

    adev: Floats
    upper: Floats


def model_line(fit: AxisFit, tau0: float, m: NDArray[np.int64]) -> ModelLine:
    """Return the Allan deviation of the model at the averaging factors ``m`` of a curve, in SI.

    ``m`` and both arrays of the result are (factors,). ``tau0`` is the sample period in s.
    The Allan deviation is NaN below the shortest averaging time that the model describes, and where
    the Allan variance of the model is not above 0.
    """
    # the Allan variance of a model with a low-pass filter may be negative at short times
    with np.errstate(invalid='ignore'):
        line, upper = (
            np.sqrt(model.avar(m * tau0, tau0)) for model in (fit.model, fit.model_at_limits)
        )
    is_described = (m >= fit.m_min) & (line > 0.0)
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
        dominates over a factor of 3 in tau, several names are joined by '+'.
    """

    tau_low: float
    tau_high: float
    term: str


@dataclass(frozen=True)
class _Stretch:
    """Range of consecutive points of a curve, and the dominant terms in this range."""

    terms: tuple[str, ...]
    points: slice


def dominant_regions(curve: AllanCurve, fit: AxisFit) -> list[Region]:
    """Return ranges of averaging times, each with its dominant term.

    A term or process dominates where it has the largest share of the Allan variance of the model.
    Adjacent ranges that are narrower than a factor of 3 in tau are merged. A narrow range
    without a narrow neighbor gets the two terms with the largest shares.

    The ranges are contiguous, cover the measured curve, and are sorted by tau. The list is empty if
    the model or the curve is empty.
    """
    tau0 = curve.tau[0] / curve.m[0] if len(curve.m) else math.nan
    parts = fit.model.contributions(curve.tau, tau0) if len(curve.m) else {}
    if not parts:
        return []
    variances = np.stack(list(parts.values()), axis=1)
    shares = variances / variances.sum(axis=1, keepdims=True)
    edges = np.concatenate([curve.tau[:1], np.sqrt(curve.tau[1:] * curve.tau[:-1]), curve.tau[-1:]])
    return [
        Region(float(edges[s.points.start]), float(edges[s.points.stop]), '+'.join(s.terms))
        for s in _stretches(list(parts), shares, edges)
    ]


def _stretches(parts: Sequence[str], shares: Floats, edges: Floats) -> list[_Stretch]:
    """Divide a curve into ranges with their dominant terms; narrow ranges are merged."""
    ranges = []
    for k, indices in groupby(range(len(shares)), key=lambda j: int(np.argmax(shares[j]))):
        points = list(indices)
        ranges.append(_Stretch((parts[k],), slice(points[0], points[-1] + 1)))

    def is_wide(s: _Stretch) -> bool:
        return bool(edges[s.points.stop] >= MIN_WIDTH * edges[s.points.start])

    stretches: list[_Stretch] = []
    for is_wide_group, group in groupby(ranges, key=is_wide):
        neighbors = list(group)
        if is_wide_group:
            stretches += neighbors
            continue
        merged = slice(neighbors[0].points.start, neighbors[-1].points.stop)
        names = {s.terms[0] for s in neighbors}
        if len(names) == 1:
            names = {parts[k] for k in np.argsort(shares[merged].mean(axis=0))[-2:]}
        stretches.append(_Stretch(tuple(name for name in parts if name in names), merged))
    return stretches
