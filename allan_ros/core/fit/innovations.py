# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Level of the drift, from the innovations of the block means.

An innovation is the error with which the model predicts a block mean from all earlier block means
of the segment, divided by the standard deviation of this error. If the model is right, the
innovations are independent and have a variance of 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..allan.periods import BlockMeans
from ..allan.sums import AllanSums
from ..noise import Process
from ..noise.processes.white import White
from .period_levels import LEAST_SHARE, PeriodLevels, total_and_drift
from .result import AxisFit
from .statistics import Floats, decay_of_means, mean_alias

MOST_MEANS = 256
"""Largest number of block means of a segment. More block means are averaged in pairs, which keeps
the covariance matrix of the block means small."""

LEAST_MEANS = 8
"""Fewest block means of a segment whose innovations are used."""


class _Predictor(NamedTuple):
    """Prediction of the differences between neighboring block means of an axis.

    Differences are predicted, because the mean of the bias is unknown.
    """

    root: Floats  # Cholesky factor of the covariance of the differences
    share: Floats  # share of the drift in the variance of each innovation

    @classmethod
    def of(cls, fit: AxisFit, tau0: float, step: int, number: int) -> _Predictor:
        """Return the prediction of ``number`` differences of means over ``step`` samples."""
        lag = np.arange(number + 1)

        def autocovariance(process: Process) -> Floats:
            aliases = mean_alias(process, step)
            if aliases:
                return aliases * White().gamma(step, lag)
            return process.gamma(step, lag)

        total, drift = total_and_drift(fit, tau0, autocovariance, len(lag))
        root: Floats = np.asarray(np.linalg.cholesky(_of_differences(total)), np.float64)
        whitened: Floats = np.linalg.solve(root, np.linalg.solve(root, _of_differences(drift)).T)
        return cls(root, np.diag(whitened))

    def innovations(self, differences: Floats, effects: Floats) -> Floats:
        """Return the innovations, (n,), of differences, (n,), after effects are subtracted.

        Each column of ``effects``, (n, effects), is one effect, whose size is fitted.
        """
        n = len(differences)
        whitened = np.linalg.solve(self.root[:n, :n], np.column_stack([effects, differences]))
        sizes = np.linalg.lstsq(whitened[:, :-1], whitened[:, -1], rcond=None)[0]
        return np.asarray(whitened[:, -1] - whitened[:, :-1] @ sizes)


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
    segments = [m for r in sums.recordings for m in r.means]
    step = max((m.step for m in segments), default=1)
    longest = max((len(m.values) * m.step for m in segments), default=0)
    while longest > MOST_MEANS * step:
        step *= 2
    segments = [m for m in (m.coarser(step) for m in segments) if len(m.values) >= LEAST_MEANS]
    number = sum(len(m.values) - 1 for m in segments)
    power, dof = np.zeros((2, number, len(sums.axes)))
    share = np.zeros(len(sums.axes))
    for i, fit in enumerate(fits):
        if not segments or not fit.model.has_drift:
            continue
        try:
            predictor = _Predictor.of(
                fit, sums.tau0 or 1.0, step, max(len(m.values) for m in segments) - 1
            )
        except np.linalg.LinAlgError:  # nearly all power is at the frequencies of sinusoids
            continue
        share[i] = predictor.share.mean()
        if share[i] < LEAST_SHARE:
            continue
        each = [
            predictor.innovations(np.diff(m.values[:, i]), _effects(m, settlings.get(i, 0.0)))
            for m in segments
        ]
        power[:, i], dof[:, i] = np.concatenate(each) ** 2, 1.0
    return PeriodLevels(power, dof, np.full(number, step), share)


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
