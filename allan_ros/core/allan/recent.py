# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparison of recent noise with earlier noise, from the periods of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from .curve import AllanCurve, chi_squared_limits, edf, noise_types_of_avar
from .grid import LEVEL_FACTORS
from .periods import add_padded
from .sums import AllanSums

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LONGEST_TAU_SHARE = 0.25
"""Longest averaging time that is compared, as a fraction of the window."""

MIN_EDF = 30.0
"""Smallest number of degrees of freedom before and after a step; the ratio of the variances is then
accurate to 30 %."""

LIKELIHOOD_RATIO = 30.0
"""Smallest significant value of twice the log likelihood ratio of a step. By chance, chi-squared
with one degree of freedom exceeds it once in 2e7, so many times and axes can be tested."""


@dataclass(frozen=True)
class RecentNoise:
    """Allan deviation of one axis in recent and in earlier data."""

    before: AllanCurve  # curve of the earlier data, of this axis only
    recent: AllanCurve  # curve of the recent data, at the same averaging times
    since_s: float | None  # time since the last step of the noise level in s; None without a step
    # averaging time in s at which the first step is most significant; None without a step
    tau: float | None


def recent_noise(sums: AllanSums, window_s: float) -> dict[str, RecentNoise]:
    """Return the recent and the earlier noise of each axis, or {} if there are too few data.

    The recent window of ``window_s`` seconds ends at the end of the latest recording.

    Raises
    ------
    AllanError
        If the window is not above 0.
    """
    if not window_s > 0.0:
        raise AllanError(f'a recent window of {window_s} s is invalid: give a positive number')
    if not sums.recordings or not sums.tau0:
        return {}
    latest = sums.recordings[-1]
    levels = int(np.count_nonzero(sums.m * sums.tau0 <= LONGEST_TAU_SHARE * window_s))
    none = np.zeros((levels, len(sums.axes)))
    count = np.array([add_padded(none[:, 0].astype(int), p.count)[:levels] for p in sums.periods])
    sum_sq = np.array([add_padded(none, p.sum_sq)[:levels] for p in sums.periods])
    # all data before the window are one row
    start = latest.samples - window_s / sums.tau0
    begins = [p.begin if r is latest else -1 for r in sums.recordings for p in r.periods]
    earlier = max(int(np.searchsorted(begins, max(start, 0))), 1)
    count = np.concatenate([count[:earlier].sum(axis=0)[None], count[earlier:]])
    sum_sq = np.concatenate([sum_sq[:earlier].sum(axis=0)[None], sum_sq[earlier:]])
    begins = begins[earlier - 1 :]
    if len(begins) < 2 or not levels:
        return {}
    m = sums.m[:levels]
    total = np.maximum(count.sum(axis=0), 1)
    avar = sum_sq.sum(axis=0) / (2.0 * (m * m * total).astype(float))[:, None]
    types = noise_types_of_avar(m, np.where(avar > 0.0, avar, np.nan), sums.samples)
    found = {}
    for i, axis in enumerate(sums.axes):
        share = np.array(  # degrees of freedom per second difference
            [
                edf(int(alpha), int(factor), max(1, int(factor) // LEVEL_FACTORS[0]), int(n)) / n
                for alpha, factor, n in zip(types[:, i], m, total)
            ]
        )
        last_row, next_row, level = _noise_steps(count * share, sum_sq[:, :, i])
        sides = (slice(0, last_row), slice(next_row, None))
        before, recent = (
            _curve(axis, m, sums.tau0, count[rows], sum_sq[rows, :, i], share, types[:, i])
            for rows in sides
        )
        since = tau = None
        if level is not None:
            since = (latest.samples - begins[next_row]) * sums.tau0
            tau = float(m[level] * sums.tau0)
        found[axis] = RecentNoise(before, recent, since, tau)
    return found


def _noise_steps(degrees: Floats, squares: Floats) -> tuple[int, int, int | None]:
    """Locate steps of the noise level; return (row after the first, row after the last, factor).

    The degrees of freedom and the sums of squares are (rows, factors). The first step is the most
    significant one of all factors; ``factor`` is the index of its factor, at which later steps are
    searched for. Without a significant step, the result is (1, 1, None).
    """
    degrees, squares = np.cumsum(degrees, axis=0), np.cumsum(squares, axis=0)
    ratio = _step_ratios(degrees, squares)
    at, level = np.unravel_index(int(ratio.argmax()), ratio.shape)
    if not ratio[at, level] > LIKELIHOOD_RATIO:
        return 1, 1, None
    first = last = int(at)
    while True:
        later = [a[last + 1 :, level] - a[last, level] for a in (degrees, squares)]
        ratio = _step_ratios(*later) if len(later[0]) else np.zeros(1)
        if not ratio.max() > LIKELIHOOD_RATIO:
            return first + 1, last + 1, int(level)
        last += 1 + int(ratio.argmax())


def _step_ratios(degrees: Floats, squares: Floats) -> Floats:
    """Return twice the log likelihood ratio of a step after each row, or -inf with too few data.

    ``degrees`` and ``squares`` are cumulative sums, (rows, ...).
    """
    nu = degrees, degrees[-1] - degrees, degrees[-1]
    sums = squares, squares[-1] - squares, squares[-1]
    with np.errstate(invalid='ignore', divide='ignore'):
        before, after, both = (n * np.log(p / n) for n, p in zip(nu, sums))
        gain = both - before - after
    enough = (nu[0] >= MIN_EDF) & (nu[1] >= MIN_EDF) & (sums[0] > 0.0) & (sums[1] > 0.0)
    return np.where(enough, gain, -np.inf)


def _curve(
    axis: str, m: Ints, tau0: float, count: Ints, sum_sq: Floats, share: Floats, types: Ints
) -> AllanCurve:
    """Return the curve of an axis; ``share`` is the degrees of freedom per second difference."""
    number = count.sum(axis=0)
    with np.errstate(invalid='ignore', divide='ignore'):
        avar = sum_sq.sum(axis=0) / (2.0 * m.astype(float) ** 2 * number)
    degrees = np.where(number > 0, share * number, np.nan)
    low, high = chi_squared_limits(avar, degrees)
    columns = (np.sqrt(avar), low, high, degrees, types)
    adev, low, high, degrees, types = (np.asarray(a)[:, None] for a in columns)
    return AllanCurve(m, np.asarray(m * tau0), number, adev, low, high, (axis,), degrees, types)
