# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recent noise and the former noise, from the sums by period of the latest recording.

Where the level of an axis stepped within a recent window, the time before the first step is
compared with the time since the last one, otherwise the window with all the time before it. Steps
are located by the likelihood ratio of two levels against one: a variance is scaled chi-squared with
its equivalent degrees of freedom (NIST SP 1065 section 5.3.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from .curve import AllanCurve, chi_squared_limits, edf, noise_types_of_avar
from .history import Recording
from .sums import LEVEL_FACTORS, AllanSums

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LONGEST_TAU_SHARE = 0.25
"""Longest averaging time that is compared, as a fraction of the window."""

MIN_EDF = 30.0
"""Fewest degrees of freedom on each side of a step; its ratio is then known to 30 %."""

LIKELIHOOD_RATIO = 30.0
"""Twice the log likelihood ratio of a step: chi-squared with one degree of freedom exceeds it once
in 2e7, which allows for all times and axes that are tested."""


@dataclass(frozen=True)
class RecentNoise:
    """Deviations of one axis in the recent time and before.

    Attributes
    ----------
    before, recent : AllanCurve
        Of this axis alone, at the same averaging times.
    since_s : float or None
        How long ago the last step of the level was, in s; None if there was none.
    tau : float or None
        Averaging time in s at which the step is most significant.
    """

    before: AllanCurve
    recent: AllanCurve
    since_s: float | None
    tau: float | None


def recent_noise(sums: AllanSums, window_s: float) -> dict[str, RecentNoise]:
    """Return the recent and the former noise of each axis; nothing while there is too little data.

    Parameters
    ----------
    sums : AllanSums
        Of one or more recordings; the end of the latest one is the present.
    window_s : float
        Length of the recent window in s.
    """
    if not window_s > 0.0:
        raise AllanError(f'a recent window of {window_s} s is invalid: give a positive number')
    recordings = sums.history.recordings
    if not recordings or not sums.tau0:
        return {}
    latest = max(recordings, key=lambda r: (r.start_ns, r.length))
    start = latest.length - window_s / sums.tau0
    levels = int(np.count_nonzero(latest.level_m * sums.tau0 <= LONGEST_TAU_SHARE * window_s))
    count, sum_sq, begins = _rows(recordings, latest, start, levels)
    if len(begins) < 2 or not levels:
        return {}
    m = latest.level_m[:levels]
    total = np.maximum(count.sum(axis=0), 1)
    avar = sum_sq.sum(axis=0) / (2.0 * (m * m * total).astype(float))[:, None]
    types = noise_types_of_avar(m, np.where(avar > 0.0, avar, np.nan), sums.samples)
    found = {}
    for i, axis in enumerate(sums.axes):
        share = _edf_per_difference(types[:, i], m, total)
        first, last, level = _steps(count * share, sum_sq[:, :, i])
        sides = (slice(0, first), slice(last, None))
        before, recent = (
            _curve(axis, m, sums.tau0, count[rows], sum_sq[rows, :, i], share, types[:, i])
            for rows in sides
        )
        since = tau = None
        if level is not None:
            since = (latest.length - int(begins[last])) * sums.tau0
            tau = float(m[level] * sums.tau0)
        found[axis] = RecentNoise(before, recent, since, tau)
    return found


def _rows(
    recordings: tuple[Recording, ...], latest: Recording, start: float, levels: int
) -> tuple[Ints, Floats, Ints]:
    """Return counts, sums of squares and ages of the time before the window and its periods.

    Without former data the first period counts as the time before.
    """
    begins, count, sum_sq = latest.period_begin, latest.level_count, latest.level_sum_sq
    first = int(np.searchsorted(begins, start))
    counts, squares = count[:first, :levels].sum(axis=0), sum_sq[:first, :levels].sum(axis=0)
    for former in recordings:
        if former is not latest:
            some = min(levels, former.level_count.shape[1])
            counts[:some] += former.level_count[:, :some].sum(axis=0)
            squares[:some] += former.level_sum_sq[:, :some].sum(axis=0)
    if counts.any():
        return (
            np.concatenate([counts[None], count[first:, :levels]]),
            np.concatenate([squares[None], sum_sq[first:, :levels]]),
            np.concatenate([[0], begins[first:]]),
        )
    return count[:, :levels], sum_sq[:, :levels], begins


def _edf_per_difference(types: Ints, m: Ints, total: Ints) -> Floats:
    """Return the degrees of freedom of one second difference at each factor."""
    return np.array(
        [
            edf(int(alpha), int(factor), max(1, int(factor) // LEVEL_FACTORS[0]), int(n)) / int(n)
            for alpha, factor, n in zip(types, m, total)
        ]
    )


def _steps(degrees: Floats, power: Floats) -> tuple[int, int, int | None]:
    """Return the rows at which the level of one axis first and last stepped, and at which factor.

    Parameters
    ----------
    degrees, power : (rows, factors) float64 arrays
        Degrees of freedom and sums of squares.

    Returns
    -------
    first, last : int
        Both 1, the beginning of the window, where there is no step.
    level : int or None
    """
    degrees, power = np.cumsum(degrees, axis=0), np.cumsum(power, axis=0)
    ratio = _two_levels(degrees, power)
    at, level = np.unravel_index(int(ratio.argmax()), ratio.shape)
    if not ratio[at, level] > LIKELIHOOD_RATIO:
        return 1, 1, None
    first = last = int(at)
    while True:
        rest = [a[last + 1 :, level] - a[last, level] for a in (degrees, power)]
        ratio = _two_levels(*rest) if len(rest[0]) else np.zeros(1)
        if not ratio.max() > LIKELIHOOD_RATIO:
            return first + 1, last + 1, int(level)
        last += 1 + int(ratio.argmax())


def _two_levels(degrees: Floats, power: Floats) -> Floats:
    """Return twice the log likelihood ratio of a step after each row against none.

    Chi-squared variances on both sides; -inf where either has too few degrees of freedom.

    Parameters
    ----------
    degrees, power : (rows, ...) float64 arrays
        Degrees of freedom and sums of squares, both running.
    """
    nu = degrees, degrees[-1] - degrees, degrees[-1]
    sums = power, power[-1] - power, power[-1]
    with np.errstate(invalid='ignore', divide='ignore'):
        before, after, both = (n * np.log(p / n) for n, p in zip(nu, sums))
        gain = both - before - after
    enough = (nu[0] >= MIN_EDF) & (nu[1] >= MIN_EDF) & (sums[0] > 0.0) & (sums[1] > 0.0)
    return np.where(enough, gain, -np.inf)


def _curve(
    axis: str, m: Ints, tau0: float, count: Ints, sum_sq: Floats, share: Floats, types: Ints
) -> AllanCurve:
    """Return the curve of some rows; NaN at factors without data."""
    number = count.sum(axis=0)
    with np.errstate(invalid='ignore', divide='ignore'):
        avar = sum_sq.sum(axis=0) / (2.0 * m.astype(float) ** 2 * number)
    degrees = np.where(number > 0, share * number, np.nan)
    low, high = chi_squared_limits(avar, degrees)
    columns = (np.sqrt(avar), low, high, degrees, types)
    adev, low, high, degrees, types = (np.asarray(a)[:, None] for a in columns)
    return AllanCurve((axis,), m, np.asarray(m * tau0), number, adev, low, high, degrees, types)
