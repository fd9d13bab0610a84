# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of the noise level in recent data, found from the Allan sums of periods."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..estimate import lies_beyond
from .curve import edf, noise_types_of_avar
from .grid import allan_variance
from .periods import add_padded
from .sums import AllanSums

Floats = NDArray[np.float64]

LONGEST_TAU_SHARE = 0.25
"""Longest averaging time at which noise levels are compared, relative to the length of the recent
window."""

MIN_STEP_EDF = 30.0
"""Smallest number of degrees of freedom of the variances before and after a step. The standard
error of the ratio of these variances is then at most 37 %."""

LIKELIHOOD_RATIO = 30.0
"""Smallest significant value of twice the log likelihood ratio of a step. Chi-squared with one
degree of freedom exceeds this value with a probability of 4e-8, so that many times and axes can be
tested."""


@dataclass(frozen=True)
class NoiseStep:
    """Change of the noise level of an axis in the recent window, by one or more steps.

    The first step is the most significant step in the window. After it, further significant steps
    are searched for, one after the other.

    Attributes
    ----------
    tau : float
        Averaging time in s at which the first step is most significant.
    before : float
        Allan deviation at ``tau`` before the first step, in the unit of the samples.
    ratio : float
        Allan deviation at ``tau`` after the last step, divided by ``before``.
    ci95 : (low, high)
        95 % interval of the ratio.
    since_s : float
        Time in s from the last step to the end of the latest recording, without gaps.
    """

    tau: float
    before: float
    ratio: float
    ci95: tuple[float, float]
    since_s: float

    def beyond(self, margin: float) -> bool:
        """Return whether the whole interval of the ratio differs from 1 by more than ``margin``.

        This means that the interval lies above 1 + margin, or below 1 / (1 + margin).
        """
        return lies_beyond(self.ci95, margin)

    def coefficient_before(self, term: str) -> float | None:
        """Return the coefficient ``term`` (N or Q, in SI) before the first step.

        The coefficient is computed as if only the noise of this term was present at ``tau``: N =
        sigma sqrt(tau) and Q = sigma tau / sqrt(3) (IEEE Std 952-1997, C.1.1 and C.1.2). The result
        is None for other terms: the window is too short for K and R, and B has no specific
        averaging time.

        Examples
        --------
        >>> NoiseStep(4.0, 0.5, 2.0, (1.9, 2.1), 60.0).coefficient_before('N')
        1.0
        """
        factors = {'N': math.sqrt(self.tau), 'Q': self.tau / math.sqrt(3.0)}
        return self.before * factors[term] if term in factors else None


def noise_steps(sums: AllanSums, window_s: float) -> dict[str, NoiseStep]:
    """Return axis -> change of the noise level, for the axes with a step in the recent window.

    The window of ``window_s`` seconds ends at the end of the latest recording. It consists of whole
    periods, and does not contain the first period of all data. The noise before a step includes the
    noise of all data before the window. Noise is compared only at averaging times of at most a
    quarter of the window.

    Raises
    ------
    AllanError
        If the window is not above 0.
    """
    from scipy.special import fdtri

    if not window_s > 0.0:
        raise AllanError(f'a recent window of {window_s} s is invalid: give a positive number')
    if not sums.recordings or not sums.tau0:
        return {}
    latest = sums.recordings[-1]
    factors = int(np.count_nonzero(sums.m * sums.tau0 <= LONGEST_TAU_SHARE * window_s))
    no_sums = np.zeros((factors, len(sums.axes)))
    count = np.array(
        [add_padded(no_sums[:, 0].astype(int), p.count)[:factors] for p in sums.periods]
    )
    sum_sq = np.array([add_padded(no_sums, p.sum_sq)[:factors] for p in sums.periods])
    # the first row of `count` and `sum_sq` will contain all data before the window, at least one
    # period
    window_start = latest.samples - window_s / sums.tau0
    begins = [p.begin if r is latest else -1 for r in sums.recordings for p in r.periods]
    periods_before = max(int(np.searchsorted(begins, max(window_start, 0))), 1)
    count = np.concatenate([count[:periods_before].sum(axis=0)[None], count[periods_before:]])
    sum_sq = np.concatenate([sum_sq[:periods_before].sum(axis=0)[None], sum_sq[periods_before:]])
    begins = begins[periods_before - 1 :]
    if len(begins) < 2 or not factors:
        return {}
    m, stride = sums.m[:factors], sums.stride[:factors]
    total_count = np.maximum(count.sum(axis=0), 1)
    avar = allan_variance(sum_sq.sum(axis=0), m, total_count)
    noise_types = noise_types_of_avar(m, np.where(avar > 0.0, avar, np.nan), sums.samples)
    steps = {}
    for i, axis in enumerate(sums.axes):
        edf_per_difference = np.array(
            [
                edf(int(alpha), int(factor), int(factor_stride), int(n)) / n
                for alpha, factor, factor_stride, n in zip(
                    noise_types[:, i], m, stride, total_count
                )
            ]
        )
        first_and_last_step = _first_and_last_step(count * edf_per_difference, sum_sq[:, :, i])
        if first_and_last_step is None:
            continue
        first, last, factor_index = first_and_last_step
        sides = slice(first), slice(last, None)
        difference_counts = [float(count[side, factor_index].sum()) for side in sides]
        variance_before, variance_after = (
            sum_sq[side, factor_index, i].sum() / (2.0 * float(m[factor_index]) ** 2 * n)
            for side, n in zip(sides, difference_counts)
        )
        edf_before, edf_after = edf_per_difference[factor_index] * np.array(difference_counts)
        ratio = variance_after / variance_before
        low, high = (math.sqrt(ratio / fdtri(edf_after, edf_before, q)) for q in (0.975, 0.025))
        since_s = (latest.samples - begins[last]) * sums.tau0
        tau, adev_before = float(m[factor_index] * sums.tau0), math.sqrt(variance_before)
        steps[axis] = NoiseStep(tau, adev_before, math.sqrt(ratio), (low, high), since_s)
    return steps


def _first_and_last_step(dofs: Floats, squares: Floats) -> tuple[int, int, int] | None:
    """Return where the noise level of an axis has its first and its last significant step.

    The result is three indices: of the period after the first step, of the period after the last
    step, and of the averaging factor at which both were found. It is None if no step is
    significant.

    ``dofs`` are the degrees of freedom, and ``squares`` are the sums of squares, of each period
    and averaging factor, (periods, factors). The first step is the most significant step at any
    factor. Later steps are searched for only at the factor of the first step.
    """
    dofs, squares = np.cumsum(dofs, axis=0), np.cumsum(squares, axis=0)
    ratio = _step_ratios(dofs, squares)
    row, factor = np.unravel_index(int(ratio.argmax()), ratio.shape)
    if not ratio[row, factor] > LIKELIHOOD_RATIO:
        return None
    first = last = int(row)
    while True:
        later_sums = [a[last + 1 :, factor] - a[last, factor] for a in (dofs, squares)]
        ratio = _step_ratios(*later_sums) if len(later_sums[0]) else np.zeros(1)
        if not ratio.max() > LIKELIHOOD_RATIO:
            return first + 1, last + 1, int(factor)
        last += 1 + int(ratio.argmax())


def _step_ratios(dofs: Floats, squares: Floats) -> Floats:
    """Return twice the log likelihood ratio of a step after each period, (periods, ...).

    ``dofs``, the degrees of freedom, and ``squares`` are cumulative sums over the periods,
    (periods, ...). The result is -inf where the data before or after the step are too few or
    constant.
    """
    edfs = dofs, dofs[-1] - dofs, dofs[-1]
    sums = squares, squares[-1] - squares, squares[-1]
    with np.errstate(invalid='ignore', divide='ignore'):
        deviance_before, deviance_after, deviance_without_step = (
            n * np.log(total / n) for n, total in zip(edfs, sums)
        )
        doubled_log_ratio = deviance_without_step - deviance_before - deviance_after
    has_enough_data = (
        (edfs[0] >= MIN_STEP_EDF) & (edfs[1] >= MIN_STEP_EDF) & (sums[0] > 0.0) & (sums[1] > 0.0)
    )
    return np.where(has_enough_data, doubled_log_ratio, -np.inf)
