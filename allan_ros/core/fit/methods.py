# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`fit_noise`: the noise coefficients of all axes by one of two methods, with findings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..allan.sums import AllanSums
from ..errors import AllanError
from ..findings import Finding, finding
from ..noise.processes.sinusoid import daily_cycle
from .candidates import Candidates
from .coefficients import axis_fit, without_estimates
from .counter import rounding_errors
from .fit_findings import axis_findings, merge_equal
from .frequency_range import estimate
from .likelihood import AxisData
from .result import METHODS, AxisFit, NoiseModel
from .statistics import Statistics, statistics

LEAST_DRIFT_S = 10.0
"""Shortest time at rest in s for which B, K and R are estimated."""

LEAST_STATISTICS = 12
"""Fewest statistics from which an axis is fitted: bins of the spectra plus contrasts of block
means."""


def fit_noise(sums: AllanSums, method: str = 'likelihood') -> NoiseModel:
    """Estimate the noise coefficients of every axis.

    Parameters
    ----------
    sums : AllanSums
        Allan sums of one IMU.
    method : str
        One of `METHODS`.

    Returns
    -------
    NoiseModel
        Coefficients with intervals for each axis, and findings.

    Raises
    ------
    AllanError
        If the method is unknown, or if the method is 'paper' and no segment has two samples.
        With 'likelihood', a finding reports too few samples.
    """
    if method not in METHODS:
        raise AllanError(f'fit method {method!r} is unknown: choose one of {", ".join(METHODS)}')
    if method == 'likelihood':
        return fit_likelihood(sums)
    from .least_squares import fit_paper  # imported here, because the method is rarely used

    return fit_paper(sums)


def fit_likelihood(sums: AllanSums, of_axes: Sequence[Statistics] = ()) -> NoiseModel:
    """Estimate the noise of every axis by maximum likelihood.

    ``of_axes`` are the statistics of the sums for each axis, if they are already computed. From
    these statistics, the settling of a sensor must already be subtracted.

    Too few data raise no error: a term that the data do not determine has no value and no limit,
    and a finding reports the axis. An axis whose spectra are not finite has no values and no
    finding.
    """
    tau0 = sums.tau0 or 1.0
    of_axes = of_axes or [statistics(sums)] * len(sums.axes)
    candidates_of = {one: Candidates(one) for one in of_axes}
    axes: dict[str, AxisFit] = {}
    findings: list[Finding] = []
    for a, (name, known) in enumerate(zip(sums.axes, of_axes)):
        candidates, daily = candidates_of[known], daily_cycle(known.longest, tau0)
        number = len(known.f) + sum(g.size.high for g in known.groups)
        if number < LEAST_STATISTICS or _is_constant(sums, a):
            axes[name] = without_estimates()
            is_constant = len(sums.count) > 0 and _is_constant(sums, a)
            id, numbers = (
                ('no_noise', {}) if is_constant else ('record_too_short', {'samples': sums.samples})
            )
            findings.append(finding(id, (name,), **numbers))
            continue
        if not np.all(np.isfinite(known.power[:, a])):
            # The samples have a wrong unit of measurement, which the stream reports.
            axes[name] = without_estimates()
            continue
        brief = sums.samples * tau0 < LEAST_DRIFT_S
        try:
            data = AxisData.of(known, a)
            result = estimate(data, candidates, daily, rounding_errors(sums, a, data))
            axes[name] = axis_fit(result, tau0, brief)
        except np.linalg.LinAlgError:  # the signal is periodic except for rounding errors
            axes[name] = without_estimates()
            findings.append(finding('no_noise', (name,)))
            continue
        if brief:
            findings.append(finding('rest_too_short', (name,), rest=sums.samples * tau0))
        findings += axis_findings(sums, a, axes[name], tau0)
    return NoiseModel('likelihood', tau0, axes, merge_equal(findings))


def _is_constant(sums: AllanSums, axis: int) -> bool:
    return not np.any(sums.avar[:, axis] > 0.0)
