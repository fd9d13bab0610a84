# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The measured curve against the selected model: the drawn line, the largest deviation from it, and
which part dominates in which range of tau, as in Cong et al. 2019."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..allan.curve import AllanCurve, local_slopes
from .model import AxisFit, Deviation

Floats = NDArray[np.float64]


MIN_WIDTH = 3.0
"""tau_high/tau_low from which a part dominates a range alone: half a decade."""


SIGNIFICANT = 3.0
"""A point departs from the line by chance if it is nearer than this many of its error bars."""


FILTER_LOSS = 0.02
"""Relative loss of deviation below which the effect of a low-pass filter is not visible."""


class ModelLine(NamedTuple):
    """The selected model as it is drawn: NaN at averaging times that it does not describe.

    Attributes
    ----------
    adev : (factors,) float64 array
        Deviation of the selected model.
    upper : (factors,) float64 array
        The same with every term that is not resolved at its 95 % upper limit.
    """

    adev: Floats
    upper: Floats


def model_line(
    fit: AxisFit, tau0: float, m: NDArray[np.int64], adev: Floats, high: Floats
) -> ModelLine:
    """Return the line of the selected model at the points of a measured curve.

    It begins at the shortest averaging time of the fit. Where Q cannot be measured because of a
    low-pass filter, it begins where the filter no longer lowers the points.

    Parameters
    ----------
    fit : AxisFit
    tau0 : float
        Sample period in s.
    m : (factors,) int64 array
        Averaging factors.
    adev, high : (factors,) float64 arrays
        Measured Allan deviation and its upper 68.3 % limit.
    """
    line, upper = (
        np.sqrt(model.avar(m * tau0, tau0)) for model in (fit.selected, fit.selected_at_limits)
    )
    drawn = (m >= fit.m_min) & (line > 0.0)
    if fit.is_filtered:
        with np.errstate(divide='ignore', invalid='ignore'):
            low = (adev * (high / adev) ** SIGNIFICANT < line) & (adev < (1.0 - FILTER_LOSS) * line)
        drawn &= np.cumsum(drawn & ~low) > 0
    return ModelLine(np.where(drawn, line, np.nan), np.where(drawn, upper, np.nan))


def largest_deviation(
    line: ModelLine, tau: Floats, adev: Floats, low: Floats, high: Floats
) -> Deviation | None:
    """Return where the measured deviation departs most from the line of the model.

    A point above the line departs from it only by what exceeds the unresolved terms at their upper
    limits. Points within `SIGNIFICANT` error bars, on the logarithmic axis, do not count.

    Parameters
    ----------
    line : ModelLine
    tau : (factors,) float64 array
        Averaging times in s.
    adev, low, high : (factors,) float64 arrays
        Measured Allan deviation and its 68.3 % limits.
    """
    with np.errstate(divide='ignore', invalid='ignore'):
        edge = np.clip(adev, line.adev, line.upper)
        off = np.log(adev / edge)
        bar = np.where(off > 0.0, np.log(adev / low), np.log(high / adev))
        counts = (adev > 0.0) & (np.abs(off) > SIGNIFICANT * bar)
    if not counts.any():
        return None
    at = int(np.argmax(np.where(counts, np.abs(off), -1.0)))
    return Deviation(math.expm1(off[at]), float(tau[at]))


@dataclass(frozen=True)
class Region:
    """A range of averaging times and the noise that dominates there.

    Attributes
    ----------
    tau_low, tau_high : float
        Ends of the range in s.
    term : str
        The part of the model with the largest share of sigma^2 (a term's letter, or the name of
        a process), or several joined by '+' where they dominate in turn or mixed.
    slope : float
        d log adev / d log tau of the measured curve over the range: -1 (Q), -1/2 (N), 0 (B),
        1/2 (K), 1 (R) where one term is alone.
    """

    tau_low: float
    tau_high: float
    term: str
    slope: float


@dataclass(frozen=True)
class _Stretch:
    """Consecutive points on which one part has the largest share, or the join of several."""

    terms: tuple[str, ...]
    points: slice


def read_curve(curve: AllanCurve, axis: str, fit: AxisFit) -> list[Region]:
    """Return the regions of one axis, from the shortest tau to the longest.

    A part dominates where its share of the modelled sigma^2 is the largest. A stretch narrower
    than a factor 3 in tau has no dominant part: adjacent ones are joined, and a single one is
    joined with its runner-up.

    Parameters
    ----------
    curve : AllanCurve
        The measured curve.
    axis : str
        One of its axes.
    fit : AxisFit
        Its selected model; terms that are not resolved have no share.

    Returns
    -------
    list of Region
        They touch and cover the curve; empty when no part is known.
    """
    tau0 = curve.tau[0] / curve.m[0] if len(curve.m) else math.nan
    parts = fit.selected.parts(curve.tau, tau0) if len(curve.m) else {}
    if not parts:
        return []
    variances = np.stack(list(parts.values()), axis=1)
    shares = variances / variances.sum(axis=1, keepdims=True)
    edges = np.concatenate([curve.tau[:1], np.sqrt(curve.tau[1:] * curve.tau[:-1]), curve.tau[-1:]])
    i = curve.axes.index(axis)
    return [
        Region(
            float(edges[s.points.start]),
            float(edges[s.points.stop]),
            '+'.join(s.terms),
            _slope(curve, i, s.points),
        )
        for s in _stretches(list(parts), shares, edges)
    ]


def curve_slopes(curve: AllanCurve) -> Floats:
    """Return the local slope d log adev / d log tau at every point, (factors, axes).

    Over two octaves each way, weighted by the degrees of freedom; NaN where adev is 0.
    """
    weights = np.nan_to_num(curve.edf.mean(axis=1))
    return local_slopes(curve.m, curve.adev**2, weights) / 2.0


def _stretches(parts: Sequence[str], shares: Floats, edges: Floats) -> list[_Stretch]:
    """Return the stretches of the curve, narrow ones joined."""
    simple = []
    for k, same in groupby(range(len(shares)), key=lambda j: int(np.argmax(shares[j]))):
        run = list(same)
        simple.append(_Stretch((parts[k],), slice(run[0], run[-1] + 1)))

    def is_wide(s: _Stretch) -> bool:
        return bool(edges[s.points.stop] >= MIN_WIDTH * edges[s.points.start])

    out: list[_Stretch] = []
    for wide, group in groupby(simple, key=is_wide):
        alike = list(group)
        if wide:
            out += alike
            continue
        points = slice(alike[0].points.start, alike[-1].points.stop)
        names = {s.terms[0] for s in alike}
        if len(names) == 1:
            names = {parts[k] for k in np.argsort(shares[points].mean(axis=0))[-2:]}
        out.append(_Stretch(tuple(name for name in parts if name in names), points))
    return out


def _slope(curve: AllanCurve, axis: int, points: slice) -> float:
    """Return the slope of log adev on log tau over the points (over more if they are too few)."""
    if points.stop - points.start < 2:
        points = slice(max(points.start - 1, 0), points.stop + 1)
    adev, degrees = curve.adev[points, axis], curve.edf[points, axis]
    good = (adev > 0.0) & (degrees > 0.0)
    if np.count_nonzero(good) < 2:
        return 0.0
    x, y, w = np.log(curve.tau[points][good]), np.log(adev[good]), degrees[good]
    dx = x - (w @ x) / w.sum()
    return float((w * dx) @ y / ((w * dx) @ dx))
