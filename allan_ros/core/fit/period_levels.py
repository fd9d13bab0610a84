# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Levels of white noise and of drift in the periods of a recording, and changes of these levels.

The level of white noise is the power of a period in the highest octaves, relative to all data. The
level of drift is relative to the fitted model.

Level of the drift
------------------
The level is measured in the spectra of the periods, at frequencies with a relevant share of drift,
and from the innovations of the block means. An innovation is the error with which the model
predicts a block mean from all earlier block means of the segment, divided by the standard deviation
of this error. If the model is right, the innovations are independent and have a variance of 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..allan.curve import Spectra, pooled_spectra
from ..allan.periods import BlockMeans
from ..allan.sums import AllanSums
from ..noise import Process
from ..noise.processes.white import White
from .result import AxisFit
from .statistics import Floats, Statistics, decay_of_means, mean_alias

LEVEL_CHANGES = 1e-3
"""Probability in Bartlett's test, or in a test of two levels, below which levels of the white noise
of an axis count as different. In a search for a change, the probability is first multiplied by the
number of periods. Measured false alarms: none in 240 recordings."""

TOP_OCTAVES = 3
"""Number of octaves, counted from the highest frequencies, in which the level of the white noise is
measured."""

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

LEAST_DOF = 10.0
"""Fewest degrees of freedom of the level in each part into which `PeriodLevels.joined` divides the
data."""

LEAST_CHANGE = 0.2
"""Relative change of N above which only the data after the change are fitted."""

LEAST_LAST_S, LEAST_LAST_PART = 30.0, 0.1
"""Least amount of data after a change of N that is fitted alone: in s, and relative to all data."""


@dataclass(frozen=True, eq=False)
class PeriodLevels:
    """Level of white noise or of drift in each period of time.

    A period is a `Period` of the Allan sums, or one block mean (`innovation_levels`).

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
        """Return the mean level of an axis over the periods ``rows``.

        The periods are weighted with their degrees of freedom.
        """
        weights = np.maximum(self.dof[rows, axis], 1e-9)
        return float(np.average(self.power[rows, axis], weights=weights))

    def usual(self, axis: int, before: int) -> float:
        """Return the weighted median of the levels of the periods before the index ``before``.

        The weights are the degrees of freedom. ``before`` is at least 1.
        """
        order = np.argsort(self.power[:before, axis])
        cumulative_dof = np.cumsum(self.dof[:before, axis][order])
        at = int(np.searchsorted(cumulative_dof, cumulative_dof[-1] / 2.0))
        return float(self.power[order[at], axis])

    def spread(self, axis: int) -> float:
        """Return the variance of the level relative to its variance for Gaussian noise, at least 1.

        The variance follows from the median of the squared differences between the logarithms of
        neighboring levels, on which a few changes of the level have no effect. The result is 1 if
        no two neighboring levels are known.
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

        ``spread`` is the variance of the level relative to its variance for Gaussian noise: 1, or
        the result of the method `spread`.
        """
        power, dof = self.power[:, axis], self.dof[:, axis]
        is_known = (dof > 0.0) & (power > 0.0)
        if is_known.sum() < 2:
            return False
        with np.errstate(divide='ignore', invalid='ignore'):
            statistic = float(np.sum(dof[is_known] * np.log(self.mean(axis) / power[is_known])))
        return _tail(statistic, int(is_known.sum()) - 1, spread, len(power)) < LEVEL_CHANGES

    def extremes(self, axis: int) -> tuple[float, float]:
        """Return the lowest and the highest N in parts of the data, divided by N of all data.

        The first result is at most 1, the second at least 1. Parts without spectra are omitted.
        Both results are 1 if the level of all data is unknown or 0.
        """
        part_index = np.floor(np.cumsum(self.samples) / (PART * self.samples.sum()) - 1e-9)
        parts = (
            slice(*np.flatnonzero(part_index == i)[[0, -1]] + [0, 1]) for i in np.unique(part_index)
        )
        levels = [self.mean(axis, rows) for rows in parts if self.dof[rows, axis].any()]
        ratios = np.sqrt(np.array(levels) / (self.mean(axis) or np.nan))
        if not np.isfinite(ratios).all():
            return 1.0, 1.0
        return float(ratios.min(initial=1.0)), float(ratios.max(initial=1.0))

    def last_change(self, axis: int) -> int | None:
        """Return the index of the first period after the last significant change of the level.

        Changes of N by no more than `LEAST_CHANGE` are ignored. The result is None if no other
        change is significant, or if N after the last change differs from the usual N before this
        change by no more than `LEAST_CHANGE`.
        """
        dof, power, spread = self.dof[:, axis], self.power[:, axis], self.spread(axis)
        found, begin = None, 0
        while begin < len(dof) - 1:
            dof_before = np.cumsum(dof[begin:])[:-1]
            dof_after = dof[begin:].sum() - dof_before
            sum_before = np.cumsum((dof * power)[begin:])[:-1]
            total = (dof * power)[begin:].sum()
            with np.errstate(divide='ignore', invalid='ignore'):
                level_before = sum_before / dof_before
                level_after = (total - sum_before) / dof_after
                mean = total / dof[begin:].sum()
                gain = dof_before * np.log(mean / level_before)
                gain += dof_after * np.log(mean / level_after)
                is_large = np.abs(np.log(level_after / level_before)) / 2.0 > np.log1p(LEAST_CHANGE)
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
        for k, (share, dof) in enumerate(zip(share_until_end.tolist(), self.dof[:, axis].tolist())):
            dof_of_part += dof
            if share > len(bounds) / parts - 1e-9 and dof_of_part >= LEAST_DOF:
                bounds.append(k + 1)
                dof_of_part = 0.0
        dof = np.add.reduceat(self.dof[:, axis], bounds[:-1]) if len(bounds) > 1 else np.zeros(0)
        total = self.dof[:, axis] * self.power[:, axis]
        return np.add.reduceat(total, bounds[:-1]) / dof if len(bounds) > 1 else dof, dof

    def _is_mixed(self, axis: int, at: int, spread: float) -> bool:
        """Return whether the level of a period differs significantly from the mean level after it.

        ``at`` is the index of the period. ``spread`` is the variance of the level relative to its
        variance for Gaussian noise.
        """
        dof, power = self.dof[:, axis], self.power[:, axis]
        later_dof = dof[at + 1 :].sum()
        if not (dof[at] > 0.0 and later_dof > 0.0 and power[at] > 0.0):
            return False
        difference = math.log(self.mean(axis, slice(at + 1, None)) / power[at])
        square = difference**2 / (2.0 / dof[at] + 2.0 / later_dof)
        return _tail(square, 1, spread, len(dof)) < LEVEL_CHANGES

    def change(self, axis: int, at: int) -> float:
        """Return the relative change of N at the start of the period ``at``; the result is >= 0.

        The usual N before this time is compared with the root mean square of N after it. A decrease
        of N counts like an increase by the same factor. The result is 0 if N before or after the
        change is 0 or unknown. ``at`` is at least 1.
        """
        level_before, level_after = self.usual(axis, at), self.mean(axis, slice(at, None))
        if not (level_before > 0.0 and level_after > 0.0):  # no noise before or after the change
            return 0.0
        ratio = level_after / level_before
        return float(np.sqrt(max(ratio, 1.0 / ratio)) - 1.0)


def _tail(statistic: float, number: int, spread: float, periods: int) -> float:
    """Return the probability that chi-squared exceeds a statistic.

    Chi-squared has ``number`` degrees of freedom. The statistic is first divided by ``spread``. A
    spread above 1 is an estimate with `SPREAD_DOF` degrees of freedom for each of the ``periods``,
    so an F distribution is then used.
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
        """Return the level of white noise or of drift in each period, as a weighted mean over bins.

        ``expected``, (bins, axes), is the power with which the power of a period is compared.
        ``share``, (bins, axes), is the share of the white noise, or of the drift, in the power of a
        bin. The weight of a bin is this share times the degrees of freedom of the bin.
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
        pooled = pooled_spectra(replace(sums, recordings=(replace(r, periods=(p,)),)))
        power[k, : len(pooled.f)], dof[k, : len(pooled.f)] = pooled.power, pooled.shared_dof
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


def _before(levels: PeriodLevels, end: int) -> PeriodLevels:
    """Return the levels of the periods before the index ``end``."""
    return replace(
        levels, power=levels.power[:end], dof=levels.dof[:end], samples=levels.samples[:end]
    )


def _lasting_change(levels: PeriodLevels, axis: int, least_samples: float) -> int | None:
    """Return the index of the first period after the last change of N with enough later data.

    A change is ignored if it is followed by fewer than ``least_samples`` samples, or if N of all
    later data differs from the usual N before the change by no more than `LEAST_CHANGE`. The search
    then continues before this change. The result is None if `PeriodLevels.last_change` finds no
    further change.
    """
    change = levels.last_change(axis)
    while change is not None and (
        levels.samples[change:].sum() < least_samples or levels.change(axis, change) <= LEAST_CHANGE
    ):
        change = _before(levels, change).last_change(axis)
    return change


def present_part(sums: AllanSums, levels: PeriodLevels) -> tuple[int, tuple[int, ...]] | None:
    """Return the first period at the present level of the white noise, and the axes that changed.

    Both results are indices. An axis has changed if N of the axis changed by more than
    `LEAST_CHANGE` at the start of this period. A change is ignored if the data after the change
    last less than `LEAST_LAST_S`, or less than the share `LEAST_LAST_PART` of all data. An earlier
    change of the axis may then be used. The result is None if no change is used.
    """
    total = levels.samples.sum()
    least_samples = max(LEAST_LAST_S / (sums.tau0 or 1.0), LEAST_LAST_PART * total)
    axes = range(len(sums.axes))
    changes = [_lasting_change(levels, i, least_samples) for i in axes]
    at = max((change for change in changes if change), default=None)
    if at is None:
        return None
    return at, tuple(i for i in axes if levels.change(i, at) > LEAST_CHANGE)


# --- level of the drift ---------------------------------------------------------------------------


LEAST_SHARE = 0.3
"""The level of the drift is measured in bins in which the drift has more than this share of the
power, and in the block means of axes on which the drift has, on average, at least this share of the
variance of the innovations."""

LARGEST_SETTLING = 0.01
"""Largest share of a settling in the power of a bin in which the level of the drift is measured.
Other bins are not used, because the share of a settling differs between the periods."""

MOST_MEANS = 256
"""Largest number of block means of a segment. More block means are averaged in pairs, which keeps
the covariance matrix of the block means small."""

LEAST_MEANS = 8
"""Fewest block means of a segment whose innovations are used."""


def total_and_drift(
    fit: AxisFit, tau0: float, expected: Callable[[Process], Floats], size: int
) -> tuple[Floats, Floats]:
    """Return an expected statistic of the model of an axis, and the part that is due to drift.

    Drift is all noise with `Process.is_drift`, except white noise. A ramp and the effect of a
    low-pass filter are ignored, because they are not noise.

    Parameters
    ----------
    fit : AxisFit
        Fit of the axis.
    tau0 : float
        Sample period in s.
    expected : callable
        Function that returns the statistic, (size,), of a process with the coefficient 1 and its
        shape in samples.
    size : int
        Length of both results.
    """
    total, drift = np.zeros((2, size))
    for part in fit.model.parts:
        process = part.process.in_unit(tau0)
        if process.is_regressor:
            continue
        part_statistic = part.process.variance_of(part.value, tau0) * expected(process)
        total += part_statistic
        if part.process.is_drift and not process.is_white:
            drift += part_statistic
    return total, drift


def spectrum_levels(
    spectra: PeriodSpectra, known: Sequence[Statistics], fits: Sequence[AxisFit], tau0: float
) -> PeriodLevels:
    """Return the level of the drift (`total_and_drift`) in each period.

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
    for i, (axis_statistics, fit) in enumerate(zip(known, fits)):
        total, drift = total_and_drift(fit, tau0, axis_statistics.power_of, len(axis_statistics.f))
        used_bins = np.flatnonzero(
            (total > 0.0) & (axis_statistics.settling[:, i] < LARGEST_SETTLING)
        )
        expected[used_bins, i] = total[used_bins]
        share[used_bins, i] = drift[used_bins] / total[used_bins]
    return spectra.levels(expected, np.where(share > LEAST_SHARE, share, 0.0))


def innovation_levels(
    sums: AllanSums, fits: Sequence[AxisFit], settlings: Mapping[int, float]
) -> PeriodLevels:
    """Return the levels of the drift for each block mean except the first mean of each segment.

    Block means of one length are used, at most `MOST_MEANS` per segment. Segments with fewer than
    `LEAST_MEANS` of them are omitted. The level of a block mean is the square of its innovation,
    with one degree of freedom. The levels of an axis and their degrees of
    freedom are 0 if the model of the axis has no drift, if the mean share of the drift in the
    variance of the innovations is below `LEAST_SHARE`, or if nearly all power of the model is at
    the frequencies of sinusoids.

    Parameters
    ----------
    sums : AllanSums
        Sums with the block means.
    fits : sequence of AxisFit
        Fit of each axis.
    settlings : mapping of int to float
        Index of an axis -> time constant of its settling in samples.
    """
    step = max((m.step for m in sums.means), default=1)
    longest = max((len(m.values) * m.step for m in sums.means), default=0)
    while longest > MOST_MEANS * step:
        step *= 2
    segments = [m for m in (m.coarser(step) for m in sums.means) if len(m.values) >= LEAST_MEANS]
    number = sum(len(m.values) - 1 for m in segments)
    power, dof = np.zeros((2, number, len(sums.axes)))
    share = np.zeros(len(sums.axes))
    for i, fit in enumerate(fits):
        if not segments or not fit.model.has_drift:
            continue
        try:
            most_differences = max(len(m.values) for m in segments) - 1
            whitening, drift_share = _prediction(fit, sums.tau0 or 1.0, step, most_differences)
        except np.linalg.LinAlgError:  # nearly all power is at the frequencies of sinusoids
            continue
        share[i] = drift_share.mean()
        if share[i] < LEAST_SHARE:
            continue
        innovations = [
            _innovations(whitening, np.diff(m.values[:, i]), _effects(m, settlings.get(i, 0.0)))
            for m in segments
        ]
        power[:, i], dof[:, i] = np.concatenate(innovations) ** 2, 1.0
    return PeriodLevels(power, dof, np.full(number, step), share)


def _prediction(fit: AxisFit, tau0: float, step: int, number: int) -> tuple[Floats, Floats]:
    """Return the matrix that whitens differences of block means, and the shares of the drift.

    The matrix, (number, number), is the inverse Cholesky root of the covariance of the differences
    between ``number`` + 1 neighboring means over ``step`` samples. Differences are predicted,
    because the mean of the bias is unknown. The shares, (number,), are the shares of the drift in
    the variance of each innovation.
    """
    from scipy.linalg import lapack  # slow to import

    lag = np.arange(number + 1)

    def autocovariance(process: Process) -> Floats:
        aliases = mean_alias(process, step)
        if aliases:
            return aliases * White().gamma(step, lag)
        return process.gamma(step, lag)

    total, drift = total_and_drift(fit, tau0, autocovariance, len(lag))
    whitening = lapack.dtrtri(np.linalg.cholesky(_of_differences(total)), lower=1)[0]
    return whitening, np.sum(whitening @ _of_differences(drift) * whitening, axis=1)


def _innovations(whitening: Floats, differences: Floats, effects: Floats) -> Floats:
    """Return the innovations, (n,), of differences of block means, after effects are subtracted.

    ``whitening`` is the first result of `_prediction`. ``differences`` are (n,). Each column of
    ``effects``, (n, effects), is one effect, whose size is fitted.
    """
    n = len(differences)
    whitened = whitening[:n, :n] @ np.column_stack([effects, differences])
    sizes = np.linalg.lstsq(whitened[:, :-1], whitened[:, -1], rcond=None)[0]
    return np.asarray(whitened[:, -1] - whitened[:, :-1] @ sizes)


def _of_differences(gamma: Floats) -> Floats:
    """Return the covariance of the differences between neighboring means, (n, n).

    ``gamma``, (n + 1,), is the autocovariance of the means at the lags 0 to n.
    """
    lag = np.arange(len(gamma) - 1)
    values = 2.0 * gamma[lag] - gamma[np.abs(lag - 1)] - gamma[lag + 1]
    return np.asarray(values[np.abs(lag[:, None] - lag)])


def _effects(means: BlockMeans, time: float) -> Floats:
    """Return the effects of a ramp and a settling on differences of block means, (n, effects).

    ``time`` is the time constant of the settling in samples; 0 for none.
    """
    number = len(means.values)
    effects = [np.ones(number - 1)]
    if time:
        effects.append(np.diff(decay_of_means(time, means.step, number)))
    return np.column_stack(effects)
