# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The reading of a curve as in Cong et al. 2019: which noise rules in which range of tau."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from ..allan.curve import AllanCurve, local_slopes
from ..noise import NoiseTerms, term_avar
from .model import TERMS, AxisFit, Coefficient

Floats = NDArray[np.float64]


MIN_WIDTH = 3.0
"""tau_high/tau_low from which a term rules a range alone: half a decade, the least on which an eye
reads a slope."""


@dataclass(frozen=True)
class Region:
    """A range of averaging times and the noise that rules there.

    Attributes
    ----------
    tau_low, tau_high : float
        Ends of the range in s.
    term : str
        The term with the largest share of sigma^2, or several joined by '+' where they rule in
        turn or mixed.
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
    """Consecutive points on which one term has the largest share, or the join of several."""

    terms: tuple[str, ...]
    points: slice


def read_curve(curve: AllanCurve, axis: str, fit: AxisFit) -> list[Region]:
    """Return the regions of one axis, from the shortest tau to the longest.

    A term rules where its share of the fitted sigma^2 is the largest. A stretch narrower than a
    factor 3 in tau rules nothing alone: adjacent ones are read together, as terms that rule in
    turn, and a lone one together with its runner-up.

    Parameters
    ----------
    curve : AllanCurve
        The measured curve.
    axis : str
        One of its axes.
    fit : AxisFit
        Its five terms; those not observable have no share.

    Returns
    -------
    list of Region
        They touch and cover the curve; empty when no term is known.
    """
    tau0 = curve.tau[0] / curve.m[0] if len(curve.m) else math.nan
    terms = _estimated(fit.noise)
    if not any(terms.values()) or not len(curve.m):
        return []
    variances = term_avar(curve.m, tau0, NoiseTerms(**terms))
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
        for s in _stretches(shares, edges)
    ]


def curve_slopes(curve: AllanCurve) -> Floats:
    """Return the local slope d log adev / d log tau at every point, (factors, axes).

    Over two octaves each way, weighted by the degrees of freedom; NaN where adev is 0.
    """
    weights = np.nan_to_num(curve.edf.mean(axis=1))
    return local_slopes(curve.m, curve.adev**2, weights) / 2.0


def _estimated(noise: Mapping[str, Coefficient]) -> dict[str, float]:
    return {
        term: max(c.value, 0.0) if c.value is not None and c.status == 'estimated' else 0.0
        for term, c in noise.items()
    }


def _stretches(shares: Floats, edges: Floats) -> list[_Stretch]:
    """Return the stretches of the curve, narrow ones joined."""
    simple = []
    for k, same in groupby(range(len(shares)), key=lambda j: int(np.argmax(shares[j]))):
        run = list(same)
        simple.append(_Stretch((TERMS[k],), slice(run[0], run[-1] + 1)))

    def is_wide(s: _Stretch) -> bool:
        return bool(edges[s.points.stop] >= MIN_WIDTH * edges[s.points.start])

    out: list[_Stretch] = []
    for wide, group in groupby(simple, key=is_wide):
        parts = list(group)
        if wide:
            out += parts
            continue
        points = slice(parts[0].points.start, parts[-1].points.stop)
        names = {s.terms[0] for s in parts}
        if len(names) == 1:
            names = {TERMS[k] for k in np.argsort(shares[points].mean(axis=0))[-2:]}
        out.append(_Stretch(tuple(t for t in TERMS if t in names), points))
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
