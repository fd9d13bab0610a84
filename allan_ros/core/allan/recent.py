# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recent view: Allan sums of a recent window, compared with those of all the time before.

The difference of two snapshots of the running sums is the sums of the time between them. Two
variances at the same averaging time are compared by their ratio, which has an F distribution (both
are scaled chi-squared with their equivalent degrees of freedom, NIST SP 1065 section 5.3.1).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from ..errors import AllanError
from .curve import edf, noise_types_of_avar
from .sums import AllanSums

Floats = NDArray[np.float64]


PARTS = 120
"""Snapshots per window: the resolution of the time at which a change began."""


LONGEST_TAU_SHARE = 0.25
"""Longest averaging time of a recent deviation, as a fraction of the window."""


CONFIDENCE = 0.95


MIN_EDF = 30.0
"""Fewest degrees of freedom on each side of a change; its ratio is then known to 30 %."""


LIKELIHOOD_RATIO = 30.0
"""Twice the log likelihood ratio at which a change is significant: chi-squared with one degree of
freedom exceeds it once in 2e7, which allows for all times and axes that are tested."""


@dataclass(frozen=True)
class Change:
    """A change in the noise of one axis at one averaging time: what was, and what is now.

    Noise that rose and fell back is a change too, of a ratio about 1: it is over.

    Attributes
    ----------
    axis : str
    m : int
        Averaging factor in samples.
    tau : float
        Averaging time in s.
    before, after : float
        Allan deviation before the first step and since the last, in the unit of the samples.
    ratio_ci95 : (low, high)
        95 % interval of after / before.
    since_s : float
        How long ago the last step was, in s.
    likelihood_ratio : float
        Twice the log likelihood ratio of two levels against one, at the first step.
    """

    axis: str
    m: int
    tau: float
    before: float
    after: float
    ratio_ci95: tuple[float, float]
    since_s: float
    likelihood_ratio: float

    def beyond(self, margin: float) -> bool:
        """Return whether the complete interval of the ratio is beyond 1 by this fraction."""
        low, high = self.ratio_ci95
        return low > 1.0 + margin or high < 1.0 / (1.0 + margin)

    def in_terms_of(self, term: str) -> tuple[float, float]:
        """Return before and after as the coefficient that dominates at this averaging time.

        N = sigma sqrt(tau) and Q = sigma tau / sqrt(3) (IEEE Std 952-1997, C.1.1 and C.1.2).
        """
        factor = {'N': math.sqrt(self.tau), 'Q': self.tau / math.sqrt(3.0)}[term]
        return self.before * factor, self.after * factor


@dataclass(frozen=True)
class RecentCurve:
    """Deviation over the window, and its ratio to that of all the time before.

    ``m`` and ``tau`` are (factors,); ``adev`` and the ratio with its 95 % limits are
    (factors, axes), NaN where there is no data on either side.
    """

    axes: tuple[str, ...]
    m: NDArray[np.int64]
    tau: Floats
    adev: Floats
    ratio: Floats
    ratio_low: Floats
    ratio_high: Floats


@dataclass(frozen=True)
class _Snapshot:
    """Running sums at one time, of the factors that the window can hold."""

    time_s: float
    count: Floats
    sum_sq: Floats


class RecentView:
    """Snapshots of running sums over a window; compares the times before and after each.

    Parameters
    ----------
    window_s : float
        Length of the recent view in s.
    """

    def __init__(self, window_s: float) -> None:
        if not window_s > 0.0:
            raise AllanError(f'a recent window of {window_s} s is invalid: give a positive number')
        self._window_s = window_s
        self._ring: deque[_Snapshot] = deque()
        self._latest: _Snapshot | None = None
        self._sums: AllanSums | None = None
        self._scaled: tuple[NDArray[np.int64], Floats, Floats] | None = None

    def update(self, sums: AllanSums, time_s: float) -> None:
        """Add a snapshot of the running sums; sums of another stream start a new window."""
        if not sums.tau0:
            return
        keep = sums.m * sums.tau0 <= LONGEST_TAU_SHARE * self._window_s
        now = _Snapshot(time_s, sums.count[keep].astype(float), sums.sum_sq[keep])
        if self._sums is None or not self._continues(sums, now):
            self._ring.clear()
        if not self._ring or time_s >= self._ring[-1].time_s + self._window_s / PARTS:
            self._ring.append(now)
        while len(self._ring) > 2 and self._ring[1].time_s <= time_s - self._window_s:
            self._ring.popleft()
        self._latest, self._sums, self._scaled = now, sums, None

    def curve(self) -> RecentCurve | None:
        """Return the deviation over the window; None before there is anything to compare."""
        if self._latest is None or self._sums is None or len(self._ring) < 2:
            return None
        m, tau, dof = self._scale()
        count, sum_sq = self._padded(self._ring[0])
        all_count, all_sq = self._padded(self._latest)
        scale = 2.0 * m[:, None].astype(float) ** 2
        with np.errstate(invalid='ignore', divide='ignore'):
            before = sum_sq / (scale * count)
            after = (all_sq - sum_sq) / (scale * (all_count - count))
        low, high = _ratio_limits(after, (all_count - count) * dof, before, count * dof)
        with np.errstate(invalid='ignore', divide='ignore'):
            ratio = np.sqrt(after / before)
        return RecentCurve(self._sums.axes, m, tau, np.sqrt(after), ratio, low, high)

    def changes(self) -> list[Change]:
        """Return the significant change of each axis and averaging time.

        The most significant change is found first, then that of the time since, until there is
        none. The time since the last change is compared with the time before the first.
        """
        if self._latest is None or self._sums is None or len(self._ring) < 2:
            return []
        m, tau, dof = self._scale()
        snapshots = [*self._ring, self._latest]
        counts, squares = (np.stack(a) for a in zip(*map(self._padded, snapshots)))
        nu = counts * dof
        scale = 2.0 * m[:, None].astype(float) ** 2
        likelihood_ratio = _two_levels(nu, squares)
        best = likelihood_ratio.argmax(axis=0)
        found = []
        for f, a in np.argwhere(likelihood_ratio.max(axis=0) > LIKELIHOOD_RATIO):
            first = int(best[f, a])
            last = first + _last_step(nu[first:, f, a], squares[first:, f, a])
            degrees = nu[-1, f, a] - nu[last, f, a], nu[first, f, a]
            before = squares[first, f, a] / (scale[f, 0] * counts[first, f, 0])
            gained = counts[-1, f, 0] - counts[last, f, 0]
            after = (squares[-1, f, a] - squares[last, f, a]) / (scale[f, 0] * gained)
            low, high = _ratio_limits(after, degrees[0], before, degrees[1])
            found.append(
                Change(
                    self._sums.axes[a],
                    int(m[f]),
                    float(tau[f]),
                    math.sqrt(before),
                    math.sqrt(after),
                    (float(low), float(high)),
                    self._latest.time_s - snapshots[last].time_s,
                    float(likelihood_ratio[first, f, a]),
                )
            )
        return found

    def _continues(self, sums: AllanSums, now: _Snapshot) -> bool:
        """Return whether the sums contain the previous ones."""
        before, latest = self._sums, self._latest
        if before is None or latest is None or before.tau0 is None or sums.tau0 is None:
            return False
        n = len(latest.count)
        return (
            (before.identity, before.axes) == (sums.identity, sums.axes)
            and n <= len(now.count)
            and bool(np.all(now.count[:n] >= latest.count))
            and now.time_s >= latest.time_s
        )

    def _scale(self) -> tuple[NDArray[np.int64], Floats, Floats]:
        """Return m, tau and the degrees of freedom of one second difference (factors, axes)."""
        if self._scaled is not None:
            return self._scaled
        assert self._latest is not None and self._sums is not None and self._sums.tau0
        n = len(self._latest.count)
        m, stride = self._sums.m[:n], self._sums.stride[:n]
        types = noise_types_of_avar(m, self._sums.avar[:n], self._sums.samples)
        dof = np.empty(types.shape)
        for i, number in enumerate(np.maximum(self._latest.count, 1.0).astype(np.int64)):
            for noise_type in np.unique(types[i]):  # most often all axes have the same
                degrees = edf(int(noise_type), int(m[i]), int(stride[i]), number)
                dof[i, types[i] == noise_type] = degrees / number
        self._scaled = m, np.asarray(m * self._sums.tau0, float), dof
        return self._scaled

    def _padded(self, snapshot: _Snapshot) -> tuple[Floats, Floats]:
        """Return count (factors, 1) and sum_sq (factors, axes) with the factors of the latest."""
        assert self._latest is not None
        missing = len(self._latest.count) - len(snapshot.count)
        count = np.pad(snapshot.count, (0, missing))[:, None]
        return count, np.pad(snapshot.sum_sq, ((0, missing), (0, 0)))


def _two_levels(degrees: Floats, energy: Floats) -> Floats:
    """Return twice the log likelihood ratio of a step at each snapshot against none.

    Chi-squared variances on both sides; -inf where either has too few degrees of freedom.

    Parameters
    ----------
    degrees, energy : (snapshots, ...) float64 arrays
        Degrees of freedom and sums of squares, both running.
    """
    nu = degrees, degrees[-1] - degrees, degrees[-1]
    power = energy, energy[-1] - energy, energy[-1]
    with np.errstate(invalid='ignore', divide='ignore'):
        before, after, both = (n * np.log(p / n) for n, p in zip(nu, power))
    enough = (nu[0] >= MIN_EDF) & (nu[1] >= MIN_EDF) & (power[0] > 0.0) & (power[1] > 0.0)
    return np.where(enough, both - before - after, -np.inf)


def _last_step(degrees: Floats, energy: Floats) -> int:
    """Return the snapshot since which the level did not change again; 0 if it never did."""
    last = 0
    while True:
        likelihood_ratio = _two_levels(degrees[last:] - degrees[last], energy[last:] - energy[last])
        if likelihood_ratio.max() <= LIKELIHOOD_RATIO:
            return last
        last += int(likelihood_ratio.argmax())


def _ratio_limits(
    after: Floats, nu_a: Floats, before: Floats, nu_b: Floats
) -> tuple[Floats, Floats]:
    """Return the 95 % limits of the true ratio of two deviations from their F distribution."""
    tail = (1.0 - CONFIDENCE) / 2.0
    with np.errstate(invalid='ignore', divide='ignore'):
        ratio = after / before
        low = np.sqrt(ratio / fdtri(nu_a, nu_b, 1.0 - tail))
        high = np.sqrt(ratio / fdtri(nu_a, nu_b, tail))
    return low, high
