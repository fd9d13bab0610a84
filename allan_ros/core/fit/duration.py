# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How long to record until a coefficient shows, and until it is known to 10 %.

The constants belong to the fit of method gls with all five terms free: a term shows with 95 %
probability at 1 % false alarms. They were found by simulation (docs/method.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .values import TERMS, AxisFit

Q_SHOWS = 2.0
"""Least Q over N sqrt(tau0) n^(-1/4), n samples."""

B_SHOWS = 8.5
"""Least B over N/sqrt(T), beside a walk that is not seen."""

B_SHOWS_BESIDE_WALK = ((10.0, 2.8), (1e2, 1.3), (1e3, 0.70), (1e4, 0.41))
"""K T/N, and least B over sqrt(N K) beside that walk."""

K_SHOWS = 51.0
"""Least K over N/T."""

K_SHOWS_BESIDE_FLICKER = 6.2
"""Least K over B/sqrt(T), where flicker rules the curve."""

R_WHITE, R_FLICKER, R_WALK = 12.0**0.5, 1.6, 1.0
"""sd(R) over N/T^1.5, B/T, K/sqrt(T): the largest of the three is that of the ramp."""

R_SHOWS = 2.58 + 1.645
"""Standard deviations: 1 % false alarms on both sides, 95 % probability."""

AGAIN = 1.5
"""A term that did not show though it might have asks for half the record again, at least."""

TIGHT = 0.1
"""Half-width of the 95 % interval, relative to the coefficient."""

Z_TWO_SIDED = 1.96

JUST_SHOWN = Z_TWO_SIDED / 2.0 / (2.33 + 1.645)
"""Relative half-width of a coefficient that just shows: its square does at 2.33 + 1.645 sd."""


@dataclass(frozen=True)
class RecordTime:
    """Seconds of record that a term takes; None where the fit gives no number to go by.

    Attributes
    ----------
    observable : float or None
        Until it shows, if it is as large as it is estimated now.
    tight : float or None
        Until its 95 % interval is within 10 %.
    """

    observable: float | None
    tight: float | None


def record_times(fit: AxisFit, tau0: float, seconds: float) -> dict[str, RecordTime]:
    """Return how long to record for every term, from what is known of all five.

    Parameters
    ----------
    fit : AxisFit
        By method gls.
    tau0 : float
        Sample period in s.
    seconds : float
        Length of the record that was fitted, in s.
    """
    value = {term: fit.noise[term].value or 0.0 for term in TERMS}
    out = {}
    for term in TERMS:
        c = fit.noise[term]
        if not c.value:
            out[term] = RecordTime(None, None)
        elif c.status == 'estimated' and c.ci95 is not None:
            half = (c.ci95[1] - c.ci95[0]) / 2.0 / c.value
            tight = (
                _ramp_time(value, TIGHT / Z_TWO_SIDED) if term == 'R' else _shrunk(half, seconds)
            )
            out[term] = RecordTime(seconds, max(seconds, tight) if half > TIGHT else seconds)
        elif term == 'R':
            shows = max(AGAIN * seconds, _ramp_time(value, 1.0 / R_SHOWS))
            out[term] = RecordTime(shows, max(shows, _ramp_time(value, TIGHT / Z_TWO_SIDED)))
        else:
            walk_seen = fit.noise['K'].status == 'estimated'
            shows = max(AGAIN * seconds, _shows(term, value, tau0, walk_seen))
            out[term] = RecordTime(shows, _shrunk(JUST_SHOWN, shows))
    return out


def _shrunk(half_width: float, seconds: float) -> float:
    """Return when a relative half-width is down to `TIGHT`, shrinking as 1/sqrt(T)."""
    return seconds * (half_width / TIGHT) ** 2


def _shows(term: str, value: dict[str, float], tau0: float, walk_seen: bool) -> float:
    """Return when a random term of that value shows."""
    n, b, k = value['N'], value['B'], value['K']
    if term == 'Q':
        return float(tau0 * (Q_SHOWS * n * tau0**0.5 / value['Q']) ** 4)
    if term == 'B' and walk_seen and n * k > 0.0:
        walk, least = np.log(B_SHOWS_BESIDE_WALK).T
        reach = np.interp(-np.log(b / (n * k) ** 0.5), -least, walk)
        return float(np.exp(reach) * n / k)
    if term == 'B':
        return float((B_SHOWS * n / b) ** 2)
    if term == 'K':
        return max(K_SHOWS * n / k, (K_SHOWS_BESIDE_FLICKER * b / k) ** 2)
    return 0.0


def _ramp_time(value: dict[str, float], share: float) -> float:
    """Return when sd(R) is down to that share of R."""
    deviation = share * value['R']
    white = float(np.cbrt(R_WHITE * value['N'] / deviation)) ** 2
    flicker = float(R_FLICKER * value['B'] / deviation)
    walk = float(R_WALK * value['K'] / deviation) ** 2
    return max(white, flicker, walk)
