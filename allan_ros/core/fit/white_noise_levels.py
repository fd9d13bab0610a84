# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Level of the white noise in each period of a recording, and its changes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..allan.curve import pooled_spectra
from ..allan.sums import AllanSums
from .statistics import Floats

LEVEL_CHANGES = 1e-3
"""Probability below which the level of the white noise varies, per axis (0 of 240 records)."""

TOP_OCTAVES = 3
"""Octaves that measure the level of the white noise."""

SINUSOID_RATIO = 1.5
"""Bins whose power exceeds the median of their octave by this ratio contain a sinusoid."""

SPREAD_DOF = 0.3
"""Degrees of freedom of the scatter between neighboring periods, per period."""

MEDIAN_CHI_SQUARED = 0.455
"""Median of chi-squared with one degree of freedom."""

PART = 0.04
"""Typical length, relative to all data, of the shortest parts whose level a finding states."""

LEAST_CHANGE = 0.2
"""Least relative change of N after which only the last part is fitted."""

LEAST_LAST_S, LEAST_LAST_PART = 30.0, 0.1
"""Shortest last part that is fitted alone, in s and relative to all data."""


@dataclass(frozen=True, eq=False)
class WhiteNoiseLevels:
    """Variance of the white noise in each period."""

    power: Floats  # (periods, axes) relative to all data; NaN without spectra
    dof: Floats  # (periods,) of Gaussian noise
    samples: NDArray[np.int64]  # (periods,)

    def mean(self, axis: int, rows: slice = slice(None)) -> float:
        """Return the mean level of some periods."""
        return float(np.average(self.power[rows, axis], weights=np.maximum(self.dof[rows], 1e-9)))

    def usual(self, axis: int, before: int) -> float:
        """Return the weighted median of the levels before a period."""
        order = np.argsort(self.power[:before, axis])
        weight = np.cumsum(self.dof[:before][order])
        at = int(np.searchsorted(weight, weight[-1] / 2.0))
        return float(self.power[order[at], axis])

    def spread(self, axis: int) -> float:
        """Return the variance between neighboring periods relative to Gaussian noise, at least 1.

        It is a median, on which changes of the level have no effect as long as there are few.
        """
        r, n = self.power[:, axis], self.dof
        some = (n[1:] > 0.0) & (n[:-1] > 0.0) & (r[1:] > 0.0) & (r[:-1] > 0.0)
        if not some.any():
            return 1.0
        gap = np.log(r[1:][some] / r[:-1][some])
        expected = 2.0 / n[1:][some] + 2.0 / n[:-1][some]
        return max(float(np.median(gap**2 / expected)) / MEDIAN_CHI_SQUARED, 1.0)

    def varies(self, axis: int, spread: float = 1.0) -> bool:
        """Return whether the levels of the periods differ significantly (Bartlett's test).

        ``spread`` is the variance of the periods relative to Gaussian noise.
        """
        r, n = self.power[:, axis], self.dof
        on = (n > 0.0) & (r > 0.0)
        if on.sum() < 2:
            return False
        with np.errstate(divide='ignore', invalid='ignore'):
            statistic = float(np.sum(n[on] * np.log(self.mean(axis) / r[on])))
        return _tail(statistic, int(on.sum()) - 1, spread, len(r)) < LEVEL_CHANGES

    def scatter(self, axis: int) -> float:
        """Return the relative error of N due to the scatter between periods beyond chance."""
        w = self.dof / max(self.dof.sum(), 1e-9)
        spare = 1.0 - float(w @ w)
        if spare <= 0.0 or not self.varies(axis):
            return 0.0
        mean = self.mean(axis) or np.nan
        variance = float(w**2 @ (self.power[:, axis] / mean - 1.0) ** 2) / spare
        return float(np.sqrt(max(variance - 2.0 / self.dof.sum(), 0.0)) / 2.0)

    def extremes(self, axis: int) -> tuple[float, float]:
        """Return the lowest and the highest N in parts of the data, divided by N of all data."""
        part = np.floor(np.cumsum(self.samples) / (PART * self.samples.sum()) - 1e-9)
        rows = (slice(*np.flatnonzero(part == i)[[0, -1]] + [0, 1]) for i in np.unique(part))
        mean = np.float64(self.mean(axis)) or np.nan
        r = np.sqrt(np.array([self.mean(axis, each) for each in rows]) / mean)
        if not np.isfinite(r).all():
            return 1.0, 1.0
        return float(r.min(initial=1.0)), float(r.max(initial=1.0))

    def last_change(self, axis: int) -> int | None:
        """Return the first period after the last change of the level, or None.

        The level after it differs by `LEAST_CHANGE` of N from the usual level before.
        """
        n, r, spread = self.dof, self.power[:, axis], self.spread(axis)
        found, begin = None, 0
        while begin < len(n) - 1:
            before, power = np.cumsum(n[begin:])[:-1], np.cumsum((n * r)[begin:])[:-1]
            after = n[begin:].sum() - before
            total = (n * r)[begin:].sum()
            with np.errstate(divide='ignore', invalid='ignore'):
                low, high = power / before, (total - power) / after
                mean = total / n[begin:].sum()
                gain = before * np.log(mean / low) + after * np.log(mean / high)
                large = np.abs(np.log(high / low)) / 2.0 > np.log1p(LEAST_CHANGE)
            gain = np.where(np.isfinite(gain) & large, gain, 0.0)
            at = int(gain.argmax())
            if not _tail(float(gain[at]), 1, spread, len(n)) * len(n) < LEVEL_CHANGES:
                break
            found = begin = begin + at + 1
        if not found:
            return None
        if found + 1 < len(n) and self._is_mixed(axis, found, spread):
            found += 1
        return found if self.change(axis, found) > LEAST_CHANGE else None

    def _is_mixed(self, axis: int, at: int, spread: float) -> bool:
        """Return whether the level of a period differs from the level of all later ones."""
        n, r = self.dof, self.power[:, axis]
        later = n[at + 1 :].sum()
        if not (n[at] > 0.0 and later > 0.0 and r[at] > 0.0):
            return False
        difference = math.log(self.mean(axis, slice(at + 1, None)) / r[at])
        square = difference**2 / (2.0 / n[at] + 2.0 / later)
        return _tail(square, 1, spread, len(n)) < LEVEL_CHANGES

    def change(self, axis: int, at: int) -> float:
        """Return the relative change of N at a period, from the usual level before; at least 0."""
        before, after = self.usual(axis, at), self.mean(axis, slice(at, None))
        if not (before > 0.0 and after > 0.0):  # one of them has no noise at all
            return 0.0
        ratio = after / before
        return float(np.sqrt(max(ratio, 1.0 / ratio)) - 1.0)


def _tail(statistic: float, number: int, spread: float, periods: int) -> float:
    """Return the probability that chi-squared exceeds a statistic.

    A ``spread`` above 1 is itself uncertain, as if it was the mean of `SPREAD_DOF` squares per
    period.
    """
    from scipy.special import chdtrc, fdtrc

    if spread == 1.0:
        return float(chdtrc(number, statistic))
    return float(fdtrc(number, SPREAD_DOF * periods, statistic / number / spread))


def white_noise_levels(sums: AllanSums) -> WhiteNoiseLevels:
    """Return the level of the white noise in each period of the sums."""
    whole = pooled_spectra(sums)
    used = (whole.octave < TOP_OCTAVES) & (whole.dof > 0.0)
    power, dof = [], []
    flat = np.zeros((len(whole.f), len(sums.axes)), bool)
    for o in np.unique(whole.octave[used]):
        on = whole.octave == o
        flat[on] = whole.power[on] <= SINUSOID_RATIO * np.median(whole.power[on], axis=0)
    for r in sums.recordings:
        for p in r.periods:
            one = pooled_spectra(replace(sums, recordings=(replace(r, periods=(p,)),)))
            weight = np.zeros(len(whole.f))
            weight[: len(one.f)] = one.shared_dof
            weight = np.where(used, weight, 0.0)[:, None] * flat
            ratio = np.ones_like(whole.power)
            ratio[: len(one.f)] = one.power / np.maximum(whole.power[: len(one.f)], 1e-300)
            power.append(np.sum(weight * ratio, axis=0) / np.maximum(weight.sum(axis=0), 1e-300))
            dof.append(weight.sum(axis=0).max(initial=0.0))
    samples = np.array([p.samples for p in sums.periods])
    return WhiteNoiseLevels(np.array(power).reshape(-1, len(sums.axes)), np.array(dof), samples)


def present_part(sums: AllanSums, levels: WhiteNoiseLevels) -> tuple[int, tuple[int, ...]] | None:
    """Return the first period of the present level, and the axes whose level has changed.

    The result is None without a change, or if the level has not lasted long enough.
    """
    total = levels.samples.sum()
    least = max(LEAST_LAST_S / (sums.tau0 or 1.0), LEAST_LAST_PART * total)
    found = {i: levels.last_change(i) for i in range(len(sums.axes))}
    found = {i: k for i, k in found.items() if k and levels.samples[k:].sum() >= least}
    if not found:
        return None
    at = max(k for k in found.values() if k)
    return at, tuple(i for i in range(len(sums.axes)) if levels.change(i, at) > LEAST_CHANGE)
