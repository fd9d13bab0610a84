# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Interpretation of a fitted curve.

It provides the curve of the model and the largest deviation from it, the term that dominates in
each range of tau (as in Cong et al. 2019), and the recommended length of a recording.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..allan.curve import AllanCurve, AxisCurve
from ..noise import FLICKER_FLOOR
from .model import AxisFit, Deviation, Floats

MIN_WIDTH = 3.0
"""Smallest ratio tau_high/tau_low of a range with a single dominant term: half a decade."""

SIGNIFICANT = 3.0
"""Number of error bars below which the deviation of a point from the model is not significant."""


class ModelLine(NamedTuple):
    """Allan deviation of the model at the points of a curve, for drawing.

    Both arrays are NaN at averaging times that the model does not describe.

    Attributes
    ----------
    adev : (factors,) float64 array
        Allan deviation of the model.
    upper : (factors,) float64 array
        The same with every unresolved term at its 95 % upper limit.
    """

    adev: Floats
    upper: Floats


def model_line(fit: AxisFit, tau0: float, m: NDArray[np.int64]) -> ModelLine:
    """Return the Allan deviation of the model at the averaging factors of a curve.

    It is NaN below the shortest averaging time of the fit; ``tau0`` is the sample period in s.
    """
    with np.errstate(invalid='ignore'):  # a filter is described at long averaging times only
        line, upper = (
            np.sqrt(model.avar(m * tau0, tau0)) for model in (fit.model, fit.model_at_limits)
        )
    drawn = (m >= fit.m_min) & (line > 0.0)
    return ModelLine(np.where(drawn, line, np.nan), np.where(drawn, upper, np.nan))


def largest_deviation(line: ModelLine, curve: AxisCurve) -> Deviation | None:
    """Return the largest significant deviation of a measured curve from the model, or None.

    A point above the line is compared with ``line.upper``. A deviation is significant if it exceeds
    `SIGNIFICANT` error bars on a logarithmic axis. Uncertain points are not compared.
    """
    adev, low, high = curve.adev, curve.ci_low, curve.ci_high
    with np.errstate(divide='ignore', invalid='ignore'):
        edge = np.clip(adev, line.adev, line.upper)
        off = np.log(adev / edge)
        bar = np.where(off > 0.0, np.log(adev / low), np.log(high / adev))
        significant = ~curve.is_uncertain & (adev > 0.0) & (np.abs(off) > SIGNIFICANT * bar)
    if not significant.any():
        return None
    at = int(np.argmax(np.where(significant, np.abs(off), -1.0)))
    return Deviation(math.expm1(off[at]), float(curve.tau[at]))


@dataclass(frozen=True)
class Region:
    """A range of averaging times and the noise that dominates there.

    Attributes
    ----------
    tau_low, tau_high : float
        Ends of the range in s.
    term : str
        Term or process with the largest share of the Allan variance; several names joined by '+' if
        no single one dominates over a wide enough range.
    """

    tau_low: float
    tau_high: float
    term: str


@dataclass(frozen=True)
class _Stretch:
    """Range of consecutive points of a curve with its dominant terms."""

    terms: tuple[str, ...]
    points: slice


def dominant_regions(curve: AllanCurve, fit: AxisFit) -> list[Region]:
    """Return the ranges of averaging times with the dominant term of each.

    The ranges are contiguous, cover the measured curve, and are sorted by tau. The list is empty if
    no term is known. A term or process of the model dominates where it has the largest
    share of the Allan variance of the model. Adjacent ranges narrower than a factor of 3 in tau are
    merged; a single narrow range gets the two terms with the largest shares.
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


ADVISED_TERMS = ('N', 'B', 'K')
"""The terms for which a longer record is recommended; filters do not use Q and R."""

HORIZON_S = 100.0
"""Time in s over which a filter integrates without correction. A term with a small effect at this
time is negligible."""

NEGLIGIBLE = 0.25
"""Fraction of the known Allan variance at `HORIZON_S` below which an unresolved term is
negligible."""

SECONDS_FOR_N = 60.0
"""Length in s of a record that resolves N at any sample rate of an IMU."""

B_RESOLVED = 8.5
"""Smallest B that a record of T seconds resolves, divided by N/sqrt(T), if K is not resolved."""

B_RESOLVED_WITH_K = ((10.0, 2.8), (1e2, 1.3), (1e3, 0.70), (1e4, 0.41))
"""Pairs of K T/N and the smallest resolved B divided by sqrt(N K), if K is resolved."""

K_RESOLVED = 51.0
"""Smallest K that a record of T seconds resolves, divided by N/T."""

K_RESOLVED_WITH_B = 6.2
"""Smallest K that a record of T seconds resolves, divided by B/sqrt(T), if B dominates the
curve."""

LENGTHS_S = (
    *(60.0 * n for n in (1, 2, 5, 10, 20, 30)),
    *(3600.0 * n for n in (1, 1.5, 2, 3, 4, 6, 8, 12, 16, 24)),
)
"""Recommended lengths in s. A length is rounded up to one of these; longer ones are not
recommended."""


def recommended_duration(
    fit: AxisFit, seconds: float, limits: Mapping[str, float] | None = None
) -> tuple[float, tuple[str, ...]] | None:
    """Return the recommended length of a record of one axis, or None if a longer one is not useful.

    A longer record is recommended if N, B or K is not resolved and its upper limit is relevant:
    above the limit of the datasheet or, without a datasheet, above a quarter of the known Allan
    variance at 100 s. The length is computed from N (and from B and K if they are resolved), not
    from the uncertain estimate of the unresolved term. The advice is therefore stable during a
    recording.

    Parameters
    ----------
    fit : AxisFit
        Fit by method 'likelihood'.
    seconds : float
        Length of the longest static segment so far, in s.
    limits : mapping of term to float, optional
        Limits of a datasheet for this axis, in SI units.

    Returns
    -------
    (seconds, terms) or None
        Length of a recording without gaps in s, and the terms for which it is recommended.
    """
    n = fit.noise['N'].value
    if fit.noise['N'].status != 'estimated' or not n:
        return (SECONDS_FOR_N, ('N',)) if seconds < SECONDS_FOR_N else None
    needed = {
        term: _seconds_for(term, target, fit)
        for term in ('B', 'K')
        if fit.noise[term].status != 'estimated'
        and (target := (limits or {}).get(term) or _negligible(term, fit))
        and (fit.noise[term].upper95 or math.inf) > target
    }
    worth = {term: t for term, t in needed.items() if seconds < t <= LENGTHS_S[-1]}
    if not worth:
        return None
    return next(t for t in LENGTHS_S if t >= max(worth.values())), tuple(worth)


def longest_recommended(
    advice: Iterable[tuple[float, tuple[str, ...]] | None],
) -> tuple[float, tuple[str, ...]] | None:
    """Return the longest of the recommended lengths in s, and the terms of all recommendations.

    ``advice`` contains the results of `recommended_duration` for the axes. Returns None if no axis
    needs a longer record.
    """
    known = [each for each in advice if each is not None]
    if not known:
        return None
    terms = {term for _, of_axis in known for term in of_axis}
    return max(t for t, _ in known), tuple(t for t in ADVISED_TERMS if t in terms)


def _known(term: str, fit: AxisFit) -> float:
    coefficient = fit.noise[term]
    return coefficient.value or 0.0 if coefficient.status == 'estimated' else 0.0


def _negligible(term: str, fit: AxisFit) -> float:
    """Return the size below which a term has no relevant effect at averaging time `HORIZON_S`."""
    n, b, k = (_known(t, fit) for t in ADVISED_TERMS)
    known = n**2 / HORIZON_S + FLICKER_FLOOR * b**2 + k**2 * HORIZON_S / 3.0
    unit = FLICKER_FLOOR if term == 'B' else HORIZON_S / 3.0
    return math.sqrt(NEGLIGIBLE * known / unit)


def _seconds_for(term: str, size: float, fit: AxisFit) -> float:
    """Return the length in s of a record that resolves a term of a given SI coefficient."""
    n, b, k = (_known(t, fit) for t in ADVISED_TERMS)
    if term == 'K':
        return max(K_RESOLVED * n / size, (K_RESOLVED_WITH_B * b / size) ** 2)
    if k > 0.0:
        walk, least = np.log(B_RESOLVED_WITH_K).T
        return float(np.exp(np.interp(-np.log(size / (n * k) ** 0.5), -least, walk)) * n / k)
    return (B_RESOLVED * n / size) ** 2
