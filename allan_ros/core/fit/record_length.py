# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recommended length of a recording in which the unresolved terms would be resolved."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from ..noise import FLICKER_FLOOR
from .result import AxisFit

ADVISED_TERMS = ('N', 'B', 'K')
"""Terms for which a longer recording is recommended. Most state estimators do not use Q and R."""

TOO_SHORT_S = 20.0
"""Duration of the data at rest in s below which a recording is not judged."""

HORIZON_S = 100.0
"""Averaging time in s at which the effect of a term is judged: a long time for a state estimator to
integrate without a correction."""

NEGLIGIBLE = 0.25
"""Share of the Allan variance of all resolved terms at `HORIZON_S`. An unresolved term below this
share is negligible."""

SECONDS_FOR_N = 60.0
"""Length in s of a recording that resolves N at any sample rate of an IMU."""

B_RESOLVED = 8.5
"""Smallest B that is resolved in T seconds, divided by N/sqrt(T), if K is not resolved."""

B_RESOLVED_WITH_K = ((10.0, 2.8), (1e2, 1.3), (1e3, 0.70), (1e4, 0.41))
"""Pairs of numbers for a resolved K: K T/N, and the smallest B that is resolved in T seconds,
divided by sqrt(N K)."""

K_RESOLVED = 51.0
"""Smallest K that is resolved in T seconds, divided by N/T."""

K_RESOLVED_WITH_B = 6.2
"""Smallest K that is resolved in T seconds, divided by B/sqrt(T), if B dominates the curve."""

LENGTHS_S = (
    *(60.0 * n for n in (1, 2, 5, 10, 20, 30)),
    *(3600.0 * n for n in (1, 1.5, 2, 3, 4, 6, 8, 12, 16, 24)),
)
"""Lengths in s that are recommended, ascending. A required length is rounded up to one of these
lengths. If it exceeds the longest of them, no recording is recommended."""


def recommended_duration(
    fit: AxisFit, seconds: float, limits: Mapping[str, float] | None = None
) -> tuple[float, tuple[str, ...]] | None:
    """Return the recommended length of a recording, or None if a longer recording is not useful.

    If N is not resolved, `SECONDS_FOR_N` is recommended. Otherwise, a longer recording is
    recommended if B or K is not resolved and the upper limit of this term is relevant. An upper
    limit is relevant if it exceeds the limit of the datasheet. Without a datasheet, it is relevant
    if the term could contribute a quarter of the Allan variance of the resolved terms at 100 s.

    The length is computed from N, and from B and K if they are resolved. The uncertain estimate of
    the unresolved term is not used, so that the advice is stable during a recording.

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
    needed_s = {
        term: _seconds_for(term, target, fit)
        for term in ('B', 'K')
        if fit.noise[term].status != 'estimated'
        and (target := (limits or {}).get(term) or _negligible(term, fit))
        and (fit.noise[term].upper95 or math.inf) > target
    }
    useful_s = {term: t for term, t in needed_s.items() if seconds < t <= LENGTHS_S[-1]}
    if not useful_s:
        return None
    return next(t for t in LENGTHS_S if t >= max(useful_s.values())), tuple(useful_s)


def longest_recommended(
    advice: Iterable[tuple[float, tuple[str, ...]] | None],
) -> tuple[float, tuple[str, ...]] | None:
    """Return the longest of the recommended lengths in s, and the terms of all recommendations.

    ``advice`` contains the result of `recommended_duration` for each axis. The result is None if no
    longer recording is recommended for any axis.
    """
    recommended = [each for each in advice if each is not None]
    if not recommended:
        return None
    terms = {term for _, axis_terms in recommended for term in axis_terms}
    return max(t for t, _ in recommended), tuple(t for t in ADVISED_TERMS if t in terms)


def _resolved_value(term: str, fit: AxisFit) -> float:
    """Return a coefficient in SI; 0 if the term is not resolved."""
    coefficient = fit.noise[term]
    return coefficient.value or 0.0 if coefficient.status == 'estimated' else 0.0


def _negligible(term: str, fit: AxisFit) -> float:
    """Return the coefficient in SI below which a term has no relevant effect at `HORIZON_S`."""
    n, b, k = (_resolved_value(t, fit) for t in ADVISED_TERMS)
    known_variance = n**2 / HORIZON_S + FLICKER_FLOOR * b**2 + k**2 * HORIZON_S / 3.0
    unit_variance = FLICKER_FLOOR if term == 'B' else HORIZON_S / 3.0
    return math.sqrt(NEGLIGIBLE * known_variance / unit_variance)


def _seconds_for(term: str, size: float, fit: AxisFit) -> float:
    """Return the length in s of a recording that resolves B or K with the value ``size`` in SI."""
    n, b, k = (_resolved_value(t, fit) for t in ADVISED_TERMS)
    if term == 'K':
        return max(K_RESOLVED * n / size, (K_RESOLVED_WITH_B * b / size) ** 2)
    if k > 0.0:
        log_times, log_sizes = np.log(B_RESOLVED_WITH_K).T
        log_time = np.interp(-np.log(size / (n * k) ** 0.5), -log_sizes, log_times)
        return float(np.exp(log_time) * n / k)
    return (B_RESOLVED * n / size) ** 2
