# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Level of the noise in each period of a recording, and changes and scatter of this level.

The level of white noise is the power of a period in the highest octaves, relative to all data.
`drift_levels` computes the level of the drift.
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
from .statistics import Floats

LEVEL_CHANGES = 1e-3
"""Probability in Bartlett's test, or in a test of two levels, below which levels of the white noise
of an axis count as different. Measured false alarms: none in 240 recordings."""

TOP_OCTAVES = 3
"""Number of the highest octaves, in which the level of the white noise is measured."""

SINUSOID_RATIO = 1.5
"""Largest ratio of the power of a bin to the median power of all bins of its octave. A bin with a
larger ratio is assumed to contain a sinusoid."""

SPREAD_DOF = 0.3
"""Degrees of freedom of the result of `PeriodLevels.spread`, divided by the number of periods."""

MEDIAN_CHI_SQUARED = 0.455
"""Median of chi-squared with one degree of freedom."""

PART = 0.04
"""Approximate length of a part of the data, relative to all data. A finding states the lowest and
the highest N of the parts. Periods that are longer are not divided."""

SCATTER = 0.005
"""Probability in Bartlett's test below which the levels of the parts of a recording are regarded as
different. Each sensor is tested with each number of parts in `SCALES`, which gives false alarms on
at most 1.5 % of the sensors for each kind of level. Measured: 2 of 150 sensors for white noise, 7
of 1800 for the spectra of drift, and 19 of 1800 for the innovations of the block means."""

SCALES = (3, 6, 12)
"""Numbers of parts of a recording whose levels are compared."""

LEAST_DOF = 10.0
"""Fewest degrees of freedom of the level of a part of a recording."""

LEAST_PARTS = 3
"""Fewest parts of a recording from which the scatter of the levels is computed."""

LEAST_CHANGE = 0.2
"""Least relative change of N after which only the last part is fitted."""

LEAST_LAST_S, LEAST_LAST_PART = 30.0, 0.1
"""Shortest last part of a recording that is fitted alone: in s, and relative to all data."""


@dataclass(frozen=True, eq=False)
class PeriodLevels:
    """Level of white noise or of drift in each period.

    Attributes
    ----------
    power : (periods, axes) array
        Level: mean ratio of the power to the expected power. It is 0 for periods without spectra.
    dof : (periods, axes) array
        Degrees of freedom of the level if the noise is Gaussian.
    samples : (periods,) array
        Number of samples of each period.
    share : (axes,) array
        Share of the white noise, or of the drift, in the power of the band.
    """

    power: Floats
    dof: Floats
    samples: NDArray[np.int64]
    share: Floats

    def mean(self, axis: int, rows: slice = slice(None)) -> float:
        """Return the mean level of an axis over the periods ``rows``."""
        weights = np.maximum(self.dof[rows, axis], 1e-9)
        return float(np.average(self.power[rows, axis], weights=weights))

    def usual(self, axis: int, before: int) -> float:
        """Return the weighted median of the levels of the periods before the index ``before``."""
        order = np.argsort(self.power[:before, axis])
        weight = np.cumsum(self.dof[:before, axis][order])
        at = int(np.searchsorted(weight, weight[-1] / 2.0))
        return float(self.power[order[at], axis])

    def spread(self, axis: int) -> float:
        """Return the variance of the level relative to its variance for Gaussian noise, at least 1.

        The variance is the median over all pairs of neighboring periods, on which a few changes of
        the level have no effect.
        """
        power, dof = self.power[:, axis], self.dof[:, axis]
        is_known_pair = (dof[1:] > 0.0) & (dof[:-1] > 0.0) & (power[1:] > 0.0) & (power[:-1] > 0.0)
        if not is_known_pair.any():
            return 1.0
        difference = np.log(power[1:][is_known_pair] / power[:-1][is_known_pair])
        expected = 2.0 / dof[1:][is_known_pair] + 2.0 / dof[:-1][is_known_pair]
        return max(float(np.median(difference**2 / expected)) / MEDIAN_CHI_SQUARED, 1.0)

    def varies(self, axis: int, spread: float = 1.0) -> bool:
        """Return whether the levels of the periods differ significantly (Bartlett's test).

        ``spread`` is the result of `spread`, or 1 for Gaussian noise.
        """
        power, dof = self.power[:, axis], self.dof[:, axis]
        is_known = (dof > 0.0) & (power > 0.0)
        if is_known.sum() < 2:
            return False
        with np.errstate(divide='ignore', invalid='ignore'):
            statistic = float(np.sum(dof[is_known] * np.log(self.mean(axis) / power[is_known])))
        return _tail(statistic, int(is_known.sum()) - 1, spread, len(power)) < LEVEL_CHANGES

    def extremes(self, axis: int) -> tuple[float, float]:
        """Return the lowest and the highest N in parts of the data, divided by N of all data."""
        part_index = np.floor(np.cumsum(self.samples) / (PART * self.samples.sum()) - 1e-9)
        rows = (
            slice(*np.flatnonzero(part_index == i)[[0, -1]] + [0, 1]) for i in np.unique(part_index)
        )
        mean = np.float64(self.mean(axis)) or np.nan
        ratios = np.sqrt(np.array([self.mean(axis, each) for each in rows]) / mean)
        if not np.isfinite(ratios).all():
            return 1.0, 1.0
        return float(ratios.min(initial=1.0)), float(ratios.max(initial=1.0))

    def last_change(self, axis: int) -> int | None:
        """Return the index of the first period after the last change of the level, or None.

        A change is found only if N after it differs from the usual N before it by more than
        `LEAST_CHANGE`.
        """
        dof, power, spread = self.dof[:, axis], self.power[:, axis], self.spread(axis)
        found, begin = None, 0
        while begin < len(dof) - 1:
            dof_before = np.cumsum(dof[begin:])[:-1]
            dof_after = dof[begin:].sum() - dof_before
            sum_before = np.cumsum((dof * power)[begin:])[:-1]
            total = (dof * power)[begin:].sum()
            with np.errstate(divide='ignore', invalid='ignore'):
                before, after = sum_before / dof_before, (total - sum_before) / dof_after
                mean = total / dof[begin:].sum()
                gain = dof_before * np.log(mean / before) + dof_after * np.log(mean / after)
                is_large = np.abs(np.log(after / before)) / 2.0 > np.log1p(LEAST_CHANGE)
            gain = np.where(np.isfinite(gain) & is_large, gain, 0.0)
            at = int(gain.argmax())
            if not _tail(float(gain[at]), 1, spread, len(dof)) * len(dof) < LEVEL_CHANGES:
                break
            found = begin = begin + at + 1
        if not found:
            return None
        if found + 1 < len(dof) and self._is_mixed(axis, found, spread):
            found += 1
        return found if self.change(axis, found) > LEAST_CHANGE else None

    def joined(self, axis: int, parts: int) -> tuple[Floats, Floats]:
        """Return level and degrees of freedom of an axis for parts that consist of whole periods.

        Both arrays are (n,), where n <= ``parts`` is the number of parts; n is 0 if all periods
        together have fewer than `LEAST_DOF` degrees of freedom. The k-th part ends with the first
        period that completes a share of k / ``parts`` of the samples and gives the part at least
        `LEAST_DOF` degrees of freedom. Periods after the last such period belong to the last part.
        If the periods are short and have many degrees of freedom, the parts have nearly the same
        number of samples.
        """
        share_until_end = np.cumsum(self.samples) / self.samples.sum()
        bounds, dof_of_part = [0], 0.0
        for k, (done, dof) in enumerate(zip(share_until_end.tolist(), self.dof[:, axis].tolist())):
            dof_of_part += dof
            if done > len(bounds) / parts - 1e-9 and dof_of_part >= LEAST_DOF:
                bounds.append(k + 1)
                dof_of_part = 0.0
        dof = np.add.reduceat(self.dof[:, axis], bounds[:-1]) if len(bounds) > 1 else np.zeros(0)
        total = self.dof[:, axis] * self.power[:, axis]
        return np.add.reduceat(total, bounds[:-1]) / dof if len(bounds) > 1 else dof, dof

    def _is_mixed(self, axis: int, at: int, spread: float) -> bool:
        """Return whether the level of a period differs from the mean level of all later periods."""
        dof, power = self.dof[:, axis], self.power[:, axis]
        later_dof = dof[at + 1 :].sum()
        if not (dof[at] > 0.0 and later_dof > 0.0 and power[at] > 0.0):
            return False
        difference = math.log(self.mean(axis, slice(at + 1, None)) / power[at])
        square = difference**2 / (2.0 / dof[at] + 2.0 / later_dof)
        return _tail(square, 1, spread, len(dof)) < LEVEL_CHANGES

    def change(self, axis: int, at: int) -> float:
        """Return the relative change of N at the start of the period ``at``; the result is >= 0.

        The usual N before this time is compared with the mean N after it. A decrease of N counts
        like an increase by the same factor.
        """
        before, after = self.usual(axis, at), self.mean(axis, slice(at, None))
        if not (before > 0.0 and after > 0.0):  # no noise before or after the change
            return 0.0
        ratio = after / before
        return float(np.sqrt(max(ratio, 1.0 / ratio)) - 1.0)


def scatter(levels: PeriodLevels, axes: Sequence[int]) -> float:
    """Return by how much the amplitude of the noise of a sensor may differ in another hour.

    The logarithms of the levels of the parts of a recording are assumed to have a normally
    distributed scatter in addition to the scatter of Gaussian noise (random effects;
    R. DerSimonian, N. Laird, Controlled Clinical Trials 7, 1986). The scatter is computed for 3, 6
    and 12 parts, and the largest significant value is used.

    Parameters
    ----------
    levels : PeriodLevels
        Levels of white noise or of drift.
    axes : sequence of int
        Indices of the axes of the sensor, which have a common scatter.

    Returns
    -------
    float
        Half of the width of the 95 % interval of the logarithm of the amplitude; 0 if the levels of
        the parts do not differ significantly.
    """
    from scipy.special import chdtrc, polygamma, stdtrit

    largest = 0.0
    for parts in SCALES:
        joined_levels = [(*levels.joined(axis, parts), float(levels.share[axis])) for axis in axes]
        joined_levels = [
            each for each in joined_levels if len(each[0]) >= LEAST_PARTS and each[0].min() > 0.0
        ]
        if not joined_levels:
            continue
        statistic, total_freedom, excess, information = 0.0, 0, 0.0, 0.0
        for power, dof, share in joined_levels:
            freedom = len(dof) - 1
            correction = 1.0 + (np.sum(1.0 / dof) - 1.0 / dof.sum()) / (3.0 * freedom)
            mean = np.average(power, weights=dof)
            statistic += float(np.sum(dof * np.log(mean / power))) / correction
            total_freedom += freedom
            weight = 1.0 / polygamma(1, dof / 2.0)
            level = np.log(power)
            squares = weight @ (level - np.average(level, weights=weight)) ** 2
            excess += float(squares) - freedom
            information += float(weight.sum() - weight @ weight / weight.sum()) * share**2
        if excess > 0.0 and chdtrc(total_freedom, statistic) < SCATTER:
            quantile = float(stdtrit(total_freedom / len(joined_levels), 0.975))
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

    whole: Spectra  # spectra of all periods together
    power: Floats  # (periods, bins, axes) mean power of each period
    dof: Floats  # (periods, bins) `Spectra.shared_dof` of each period
    samples: NDArray[np.int64]  # (periods,) number of samples

    def levels(self, expected: Floats, share: Floats) -> PeriodLevels:
        """Return the level of white noise or of drift in each period, as a weighted mean of bins.

        ``expected``, (bins, axes), is the power with which the power of a period is compared.
        ``share``, (bins, axes), is the share of the white noise, or of the drift, in the power of a
        bin, and the weight of the bin.
        """
        dof = self.dof[:, :, None]
        weight, square = dof * share, dof * share**2
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
    is_top = (whole.octave < TOP_OCTAVES) & (whole.dof > 0.0)
    # 1 for bins of the highest octaves without a sinusoid, else 0
    no_sinusoid = np.zeros_like(whole.power)
    for o in np.unique(whole.octave[is_top]):
        in_octave = whole.octave == o
        power = whole.power[in_octave]
        no_sinusoid[in_octave] = power <= SINUSOID_RATIO * np.median(power, axis=0)
    return spectra.levels(whole.power, no_sinusoid)


def present_part(sums: AllanSums, levels: PeriodLevels) -> tuple[int, tuple[int, ...]] | None:
    """Return the first period at the present level of the white noise, and the axes that changed.

    Both results are indices. An axis has changed if N of the axis changed by more than
    `LEAST_CHANGE` at the start of this period. The result is None if no level has changed
    significantly by more than this, or if the present level has not lasted for the time
    `LEAST_LAST_S` and the share `LEAST_LAST_PART` of the data.
    """
    total = levels.samples.sum()
    least_samples = max(LEAST_LAST_S / (sums.tau0 or 1.0), LEAST_LAST_PART * total)
    last_changes = {i: levels.last_change(i) for i in range(len(sums.axes))}
    last_changes = {
        i: k for i, k in last_changes.items() if k and levels.samples[k:].sum() >= least_samples
    }
    if not last_changes:
        return None
    at = max(k for k in last_changes.values() if k)
    return at, tuple(i for i in range(len(sums.axes)) if levels.change(i, at) > LEAST_CHANGE)
