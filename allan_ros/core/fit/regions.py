# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which part of the selected model dominates in which range of tau, as in Cong et al. 2019."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from ..allan.curve import AllanCurve, local_slopes
from .model import AxisFit

Floats = NDArray[np.float64]


MIN_WIDTH = 3.0
"""tau_high/tau_low from which a part dominates a range alone: half a decade."""


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
