# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Level of the noise in each period of a recording, and changes and scatter of this level.

The level is the mean power in a band of frequencies, relative to the mean power of all data. Two
bands are used: for white noise, the highest octaves; for drift, the frequencies at which drift has
a relevant share of the power.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..allan.curve import Spectra, pooled_spectra
from ..allan.sums import AllanSums
from .result import AxisFit
from .statistics import Floats, Statistics

LEVEL_CHANGES = 1e-3
"""Probability in Bartlett's test below which the level of the white noise of an axis varies.
Measured false alarms: none in 240 recordings."""

TOP_OCTAVES = 3
"""Number of the highest octaves, in which the level of the white noise is measured."""

SINUSOID_RATIO = 1.5
"""Largest ratio of the power of a bin to the median of the octave; a bin with more power contains a
sinusoid."""

SPREAD_DOF = 0.3
"""Degrees of freedom of the estimated scatter between neighboring periods, divided by the number of
periods."""

MEDIAN_CHI_SQUARED = 0.455
"""Median of chi-squared with one degree of freedom."""

PART = 0.04
"""Typical length of the shortest part whose level a finding states, relative to the length of all
data."""

LEAST_SHARE = 0.3
"""Least share of the drift in the power of a bin from which the level of the drift is measured."""

LARGEST_SETTLING = 0.01
"""Largest share of a settling in the power of a bin from which the level of the drift is measured.
The share of a settling is not the same in all periods."""

SCATTER = 0.005
"""Probability in Bartlett's test below which the levels of the parts of a recording vary, for each
sensor and each number of parts: false alarms of 1.5 % in all. Measured: 2 of 150 sensors for white
noise, and 1 of 600 for drift."""

SCALES = (3, 6, 12)
"""Numbers of parts of a recording whose levels are compared."""

LEAST_DOF = 10.0
"""Fewest degrees of freedom of the level of a part."""

LEAST_PARTS = 3
"""Fewest parts from which the scatter is computed."""

LEAST_CHANGE = 0.2
"""Least relative change of N after which only the last part is fitted."""

LEAST_LAST_S, LEAST_LAST_PART = 30.0, 0.1
"""Shortest last part of a recording that is fitted alone: in s, and relative to all data."""


@dataclass(frozen=True, eq=False)
class PeriodLevels:
    """Power of a band of frequencies in each period, relative to all data.

    Attributes
    ----------
    power : (periods, axes) array
        Mean power over the expected power; 0 without spectra.
    dof : (periods, axes) array
        Degrees of freedom of the mean power if the noise is Gaussian.
    samples : (periods,) array
        Number of samples.
    share : (axes,) array
        Share of the white noise, or of the drift, in the power of the band.
    """

    power: Floats
    dof: Floats
    samples: NDArray[np.int64]
    share: Floats

    def mean(self, axis: int, rows: slice = slice(None)) -> float:
        """Return the mean level of some periods."""
        weights = np.maximum(self.dof[rows, axis], 1e-9)
        return float(np.average(self.power[rows, axis], weights=weights))

    def usual(self, axis: int, before: int) -> float:
        """Return the weighted median of the levels of the periods before the index ``before``."""
        order = np.argsort(self.power[:before, axis])
        weight = np.cumsum(self.dof[:before, axis][order])
        at = int(np.searchsorted(weight, weight[-1] / 2.0))
        return float(self.power[order[at], axis])

    def spread(self, axis: int) -> float:
        """Return the variance between neighboring periods relative to Gaussian noise, at least 1.

        The median over all pairs of neighbors is used, on which a few changes of the level have no
        effect.
        """
        r, n = self.power[:, axis], self.dof[:, axis]
        both_known = (n[1:] > 0.0) & (n[:-1] > 0.0) & (r[1:] > 0.0) & (r[:-1] > 0.0)
        if not both_known.any():
            return 1.0
        difference = np.log(r[1:][both_known] / r[:-1][both_known])
        expected = 2.0 / n[1:][both_known] + 2.0 / n[:-1][both_known]
        return max(float(np.median(difference**2 / expected)) / MEDIAN_CHI_SQUARED, 1.0)

    def varies(self, axis: int, spread: float = 1.0) -> bool:
        """Return whether the levels of the periods differ significantly (Bartlett's test).

        ``spread`` is the variance between neighboring periods relative to Gaussian noise.
        """
        r, n = self.power[:, axis], self.dof[:, axis]
        known = (n > 0.0) & (r > 0.0)
        if known.sum() < 2:
            return False
        with np.errstate(divide='ignore', invalid='ignore'):
            statistic = float(np.sum(n[known] * np.log(self.mean(axis) / r[known])))
        return _tail(statistic, int(known.sum()) - 1, spread, len(r)) < LEVEL_CHANGES

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
        """Return the index of the first period after the last change of the level, or None.

        N after the change differs from the usual N before by more than `LEAST_CHANGE`.
        """
        n, r, spread = self.dof[:, axis], self.power[:, axis], self.spread(axis)
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

    def joined(self, axis: int, parts: int) -> tuple[Floats, Floats]:
        """Return mean power and degrees of freedom of an axis in parts of several periods.

        Both arrays are (n,), where n <= ``parts`` is the number of parts that were found. The parts
        have nearly the same number of samples, and at least `LEAST_DOF` degrees of freedom each.
        """
        share = np.cumsum(self.samples) / self.samples.sum()
        ends, number = [0], 0.0
        for k, (done, dof) in enumerate(zip(share.tolist(), self.dof[:, axis].tolist())):
            number += dof
            if done > len(ends) / parts - 1e-9 and number >= LEAST_DOF:
                ends.append(k + 1)
                number = 0.0
        dof = np.add.reduceat(self.dof[:, axis], ends[:-1]) if len(ends) > 1 else np.zeros(0)
        total = self.dof[:, axis] * self.power[:, axis]
        return np.add.reduceat(total, ends[:-1]) / dof if len(ends) > 1 else dof, dof

    def _is_mixed(self, axis: int, at: int, spread: float) -> bool:
        """Return whether the level of a period differs from the mean level of all later periods."""
        n, r = self.dof[:, axis], self.power[:, axis]
        later = n[at + 1 :].sum()
        if not (n[at] > 0.0 and later > 0.0 and r[at] > 0.0):
            return False
        difference = math.log(self.mean(axis, slice(at + 1, None)) / r[at])
        square = difference**2 / (2.0 / n[at] + 2.0 / later)
        return _tail(square, 1, spread, len(n)) < LEVEL_CHANGES

    def change(self, axis: int, at: int) -> float:
        """Return the relative change of N at the period ``at``, as a number of 0 or above.

        The usual N before the period is compared with the mean N from the period on. A decrease of
        N counts like an increase by the same factor.
        """
        before, after = self.usual(axis, at), self.mean(axis, slice(at, None))
        if not (before > 0.0 and after > 0.0):  # the samples before or after are constant
            return 0.0
        ratio = after / before
        return float(np.sqrt(max(ratio, 1.0 / ratio)) - 1.0)


def scatter(levels: PeriodLevels, axes: Sequence[int]) -> float:
    """Return by how much the amplitude of the noise of a sensor may differ in another hour.

    The logarithms of the levels of the parts of a recording are assumed to have a normal scatter in
    addition to the scatter of Gaussian noise (random effects; R. DerSimonian, N. Laird, Controlled
    Clinical Trials 7, 1986). The scatter is computed for 3, 6 and 12 parts, and the largest
    significant value is used.

    Parameters
    ----------
    levels : PeriodLevels
        Levels of white noise or of drift.
    axes : sequence of int
        Indices of the axes of the sensor, which have a common scatter.

    Returns
    -------
    float
        Half of the 95 % interval of the logarithm of the amplitude; 0 if the levels of the parts do
        not differ significantly.
    """
    from scipy.special import chdtrc, polygamma, stdtrit

    largest = 0.0
    for parts in SCALES:
        joined = [(*levels.joined(axis, parts), float(levels.share[axis])) for axis in axes]
        joined = [each for each in joined if len(each[0]) >= LEAST_PARTS and each[0].min() > 0.0]
        if not joined:
            continue
        statistic, number, excess, information = 0.0, 0, 0.0, 0.0
        for power, dof, share in joined:
            more = len(dof) - 1
            correction = 1.0 + (np.sum(1.0 / dof) - 1.0 / dof.sum()) / (3.0 * more)
            mean = np.average(power, weights=dof)
            statistic += float(np.sum(dof * np.log(mean / power))) / correction
            number += more
            weight = 1.0 / polygamma(1, dof / 2.0)
            level = np.log(power)
            squares = weight @ (level - np.average(level, weights=weight)) ** 2
            excess += float(squares) - more
            information += float(weight.sum() - weight @ weight / weight.sum()) * share**2
        if excess > 0.0 and chdtrc(number, statistic) < SCATTER:
            quantile = float(stdtrit(number / len(joined), 0.975))
            largest = max(largest, quantile * math.sqrt(excess / information) / 2.0)
    return largest


def _tail(statistic: float, number: int, spread: float, periods: int) -> float:
    """Return the tail probability of chi-squared with ``number`` degrees of freedom.

    The statistic is first divided by ``spread``. A spread above 1 is an estimate with `SPREAD_DOF`
    degrees of freedom for each of the ``periods``, so an F distribution is then used.
    """
    from scipy.special import chdtrc, fdtrc

    if spread == 1.0:
        return float(chdtrc(number, statistic))
    return float(fdtrc(number, SPREAD_DOF * periods, statistic / number / spread))


class PeriodSpectra(NamedTuple):
    """Octave spectra of each period of the recordings, and of all periods together."""

    whole: Spectra  # of all periods together
    power: Floats  # (periods, bins, axes) mean power
    dof: Floats  # (periods, bins) `Spectra.shared_dof` of each period
    samples: NDArray[np.int64]  # (periods,) number of samples

    def levels(self, expected: Floats, share: Floats) -> PeriodLevels:
        """Return the level of the noise in each period from some bins.

        ``expected``, (bins, axes), is the power with which the power of a period is compared.
        ``share``, (bins, axes), is the share of the white noise, or of the drift, in the power of a
        bin, with which the bin is weighted.
        """
        of_bin = self.dof[:, :, None]
        weight, square = of_bin * share, of_bin * share**2
        total = np.maximum(weight.sum(axis=1), 1e-300)
        ratio = self.power / np.maximum(expected, 1e-300)
        return PeriodLevels(
            np.sum(weight * ratio, axis=1) / total,
            weight.sum(axis=1) ** 2 / np.maximum(square.sum(axis=1), 1e-300),
            self.samples,
            np.sum(share**2, axis=0) / np.maximum(share.sum(axis=0), 1e-300),
        )


def period_spectra(sums: AllanSums) -> PeriodSpectra:
    """Return the octave spectra of all periods of the sums."""
    whole = pooled_spectra(sums)
    periods = [(r, p) for r in sums.recordings for p in r.periods]
    power = np.zeros((len(periods), len(whole.f), len(sums.axes)))
    dof = np.zeros((len(periods), len(whole.f)))
    for k, (r, p) in enumerate(periods):
        one = pooled_spectra(replace(sums, recordings=(replace(r, periods=(p,)),)))
        power[k, : len(one.f)], dof[k, : len(one.f)] = one.power, one.shared_dof
    return PeriodSpectra(whole, power, dof, np.array([p.samples for _, p in periods]))


def white_noise_levels(spectra: PeriodSpectra) -> PeriodLevels:
    """Return the level of the white noise in each period."""
    whole = spectra.whole
    used = (whole.octave < TOP_OCTAVES) & (whole.dof > 0.0)
    no_sinusoid = np.zeros_like(whole.power)  # 1 for bins without a sinusoid, else 0
    for o in np.unique(whole.octave[used]):
        in_octave = whole.octave == o
        power = whole.power[in_octave]
        no_sinusoid[in_octave] = power <= SINUSOID_RATIO * np.median(power, axis=0)
    return spectra.levels(whole.power, no_sinusoid)


def drift_levels(
    spectra: PeriodSpectra, known: Sequence[Statistics], fits: Sequence[AxisFit], tau0: float
) -> PeriodLevels:
    """Return the level of the drift in each period.

    Drift is all noise, except white noise, whose integral grows with time.

    Parameters
    ----------
    spectra : PeriodSpectra
    known : sequence of Statistics
        Statistics of the sums for each axis.
    fits : sequence of AxisFit
        Fit of each axis.
    tau0 : float
        Sample period in s.
    """
    expected, share = np.ones_like(spectra.whole.power), np.zeros_like(spectra.whole.power)
    for i, (one, fit) in enumerate(zip(known, fits)):
        total, drift = np.zeros((2, len(one.f)))
        for part in fit.model.parts:
            process = part.process.in_unit(tau0)
            if process.is_regressor:
                continue
            power = part.process.variance_of(part.value, tau0) * one.power_of(process)
            total += power
            if part.process.is_drift and not process.is_white:
                drift += power
        some = np.flatnonzero((total > 0.0) & (one.settling[:, i] < LARGEST_SETTLING))
        expected[some, i] = total[some]
        share[some, i] = drift[some] / total[some]
    return spectra.levels(expected, np.where(share > LEAST_SHARE, share, 0.0))


def present_part(sums: AllanSums, levels: PeriodLevels) -> tuple[int, tuple[int, ...]] | None:
    """Return the index of the first period of the present level of the white noise.

    The second result are the indices of the axes whose level has changed. The result is None if
    there is no change, or if the present level has not lasted long enough.
    """
    total = levels.samples.sum()
    least = max(LEAST_LAST_S / (sums.tau0 or 1.0), LEAST_LAST_PART * total)
    found = {i: levels.last_change(i) for i in range(len(sums.axes))}
    found = {i: k for i, k in found.items() if k and levels.samples[k:].sum() >= least}
    if not found:
        return None
    at = max(k for k in found.values() if k)
    return at, tuple(i for i in range(len(sums.axes)) if levels.change(i, at) > LEAST_CHANGE)
