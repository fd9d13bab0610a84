# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recommended recording time, as report, terminal and monitor show it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from ..noise import FLICKER_FLOOR
from .model import AxisFit

ADVISED_TERMS = ('N', 'B', 'K')
"""The terms that filters use; Q and R do not justify a longer record."""

HORIZON_S = 100.0
"""Seconds over which a filter integrates without correction; noise that is small there is
negligible."""

NEGLIGIBLE = 0.25
"""Share of the known Allan variance at `HORIZON_S` below which an unresolved term is negligible."""

SECONDS_FOR_N = 60.0
"""Record that resolves N at any rate of an IMU."""

B_RESOLVED = 8.5
"""Least B over N/sqrt(T) that T seconds resolve where K is not resolved."""

B_RESOLVED_BESIDE_K = ((10.0, 2.8), (1e2, 1.3), (1e3, 0.70), (1e4, 0.41))
"""K T/N, and least B over sqrt(N K) where that K is resolved."""

K_RESOLVED = 51.0
"""Least K over N/T."""

K_RESOLVED_BESIDE_B = 6.2
"""Least K over B/sqrt(T), where B dominates the curve."""

LENGTHS_S = (
    *(60.0 * n for n in (1, 2, 5, 10, 20, 30)),
    *(3600.0 * n for n in (1, 1.5, 2, 3, 4, 6, 8, 12, 16, 24)),
)
"""Advice is rounded up to one of these; what takes longer than the last is not advised."""


def recommended_duration(
    fit: AxisFit, seconds: float, limits: Mapping[str, float] | None = None
) -> tuple[float, tuple[str, ...]] | None:
    """Return how long to record one axis, or None where a longer record would not help.

    A term is worth recording for if it is N, B or K, is not resolved, and its 95 % upper limit
    still allows it to matter: above its datasheet limit, or else above a quarter of the known
    Allan variance at 100 s. The time follows from N (and from B where it is resolved), not from
    the uncertain estimate of the missing term, so it is stable during the recording.

    Parameters
    ----------
    fit : AxisFit
        By method gls.
    seconds : float
        Length of the longest segment at rest, in s.
    limits : mapping of term to float, optional
        What a datasheet states of this axis, in SI.

    Returns
    -------
    (seconds, terms) or None
        The length one recording should have, and the terms it resolves or bounds.
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
    """Return the longest recommended time of all axes, and all terms that need it."""
    known = [each for each in advice if each is not None]
    if not known:
        return None
    terms = {term for _, of_axis in known for term in of_axis}
    return max(t for t, _ in known), tuple(t for t in ADVISED_TERMS if t in terms)


def _known(term: str, fit: AxisFit) -> float:
    coefficient = fit.noise[term]
    return coefficient.value or 0.0 if coefficient.status == 'estimated' else 0.0


def _negligible(term: str, fit: AxisFit) -> float:
    """Return the largest coefficient that is negligible in the Allan variance at the horizon."""
    n, b, k = (_known(t, fit) for t in ADVISED_TERMS)
    known = n**2 / HORIZON_S + FLICKER_FLOOR * b**2 + k**2 * HORIZON_S / 3.0
    unit = FLICKER_FLOOR if term == 'B' else HORIZON_S / 3.0
    return math.sqrt(NEGLIGIBLE * known / unit)


def _seconds_for(term: str, size: float, fit: AxisFit) -> float:
    """Return the length of record that resolves a term of that size."""
    n, b, k = (_known(t, fit) for t in ADVISED_TERMS)
    if term == 'K':
        return max(K_RESOLVED * n / size, (K_RESOLVED_BESIDE_B * b / size) ** 2)
    if k > 0.0:
        walk, least = np.log(B_RESOLVED_BESIDE_K).T
        return float(np.exp(np.interp(-np.log(size / (n * k) ** 0.5), -least, walk)) * n / k)
    return (B_RESOLVED * n / size) ** 2
