# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Level of the drift in parts of a recording, relative to the fitted model.

The level is measured in the spectra of the periods, at frequencies with a relevant share of drift,
and from the innovations of the block means.

Innovations
-----------
An innovation is the error with which the model predicts a block mean from all earlier block means
of the segment, divided by the standard deviation of this error. If the model is right, the
innovations are independent and have a variance of 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..allan.periods import BlockMeans
from ..allan.sums import AllanSums
from ..noise import Process
from ..noise.processes.white import White
from .period_levels import PeriodLevels, PeriodSpectra
from .result import AxisFit
from .statistics import Floats, Statistics, decay_of_means, mean_alias

LEAST_SHARE = 0.3
"""The level of the drift is measured in bins in which the drift has more than this share of the
power, and in block means whose innovations have at least this share of drift in their variance."""

LARGEST_SETTLING = 0.01
"""The level of the drift is measured in bins in which a settling has less than this share of the
power, because the share of a settling differs between the periods."""

MOST_MEANS = 256
"""Largest number of block means of a segment. More block means are averaged in pairs, which keeps
the covariance matrix of the block means small."""

LEAST_MEANS = 8
"""Fewest block means of a segment whose innovations are used."""


def total_and_drift(
    fit: AxisFit, tau0: float, expected: Callable[[Process], Floats], size: int
) -> tuple[Floats, Floats]:
    """Return an expected statistic of the model of an axis, and the part that is due to drift.

    Drift is all noise whose integral grows with time, except white noise.

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
        of_part = part.process.variance_of(part.value, tau0) * expected(process)
        total += of_part
        if part.process.is_drift and not process.is_white:
            drift += of_part
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
    for i, (one, fit) in enumerate(zip(known, fits)):
        total, drift = total_and_drift(fit, tau0, one.power_of, len(one.f))
        used_bins = np.flatnonzero((total > 0.0) & (one.settling[:, i] < LARGEST_SETTLING))
        expected[used_bins, i] = total[used_bins]
        share[used_bins, i] = drift[used_bins] / total[used_bins]
    return spectra.levels(expected, np.where(share > LEAST_SHARE, share, 0.0))


def innovation_levels(
    sums: AllanSums, fits: Sequence[AxisFit], settlings: Mapping[int, float]
) -> PeriodLevels:
    """Return the level of the drift in each block mean except the first of each segment.

    The level of a block mean is the square of its innovation, with one degree of freedom. Both are
    0 for an axis whose model has no drift, or whose drift has a mean share below `LEAST_SHARE` in
    the variance of the innovations.

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
            number_of_longest = max(len(m.values) for m in segments) - 1
            root, drift_share = _prediction(fit, sums.tau0 or 1.0, step, number_of_longest)
        except np.linalg.LinAlgError:  # nearly all power is at the frequencies of sinusoids
            continue
        share[i] = drift_share.mean()
        if share[i] < LEAST_SHARE:
            continue
        each = [
            _innovations(root, np.diff(m.values[:, i]), _effects(m, settlings.get(i, 0.0)))
            for m in segments
        ]
        power[:, i], dof[:, i] = np.concatenate(each) ** 2, 1.0
    return PeriodLevels(power, dof, np.full(number, step), share)


def _prediction(fit: AxisFit, tau0: float, step: int, number: int) -> tuple[Floats, Floats]:
    """Return the root of the covariance of successive block means, and the shares of the drift.

    The Cholesky root, (number, number), is for the differences between ``number`` + 1 neighboring
    means over ``step`` samples. Differences are predicted, because the mean of the bias is unknown.
    The shares, (number,), are the shares of the drift in the variance of each innovation.
    """
    lag = np.arange(number + 1)

    def autocovariance(process: Process) -> Floats:
        aliases = mean_alias(process, step)
        if aliases:
            return aliases * White().gamma(step, lag)
        return process.gamma(step, lag)

    total, drift = total_and_drift(fit, tau0, autocovariance, len(lag))
    root: Floats = np.asarray(np.linalg.cholesky(_of_differences(total)), np.float64)
    whitened: Floats = np.linalg.solve(root, np.linalg.solve(root, _of_differences(drift)).T)
    return root, np.diag(whitened)


def _innovations(root: Floats, differences: Floats, effects: Floats) -> Floats:
    """Return the innovations, (n,), of differences, (n,), after effects are subtracted.

    ``root`` is the first result of `_prediction`. Each column of ``effects``, (n, effects), is one
    effect, whose size is fitted.
    """
    n = len(differences)
    whitened = np.linalg.solve(root[:n, :n], np.column_stack([effects, differences]))
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
    """Return the effects of a ramp and of a settling on the differences, (n, effects).

    ``time`` is the time constant of the settling in samples; 0 for none.
    """
    number = len(means.values)
    effects = [np.ones(number - 1)]
    if time:
        effects.append(np.diff(decay_of_means(time, means.step, number)))
    return np.column_stack(effects)
