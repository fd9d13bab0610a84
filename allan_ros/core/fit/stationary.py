# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fit of all axes of an IMU, also if the noise changes with time: `fit_stationary`.

If the level of the white noise has changed, only the data after the change are fitted. A settling
of the bias is part of the model. Predictive intervals take into account how much the noise level
varies between periods. Findings report all these changes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..allan.at_rest import step_of_sums
from ..allan.sums import LEAST_EQUAL, AllanSums, part
from ..errors import AllanError
from ..estimate import Estimate
from ..findings import Finding, finding
from ..imu import axes_of_sensors
from ..noise import RANDOM_TERMS, Process
from ..noise.processes.rounded_angle import rounding_of_counter
from ..noise.processes.sinusoid import daily_cycle
from .bias_changes import settling, settling_findings, step_findings
from .candidates import Candidates
from .coefficients import axis_fit, without_estimates
from .fit_findings import axis_findings, merge_equal
from .frequency_range import estimate
from .likelihood import AxisData
from .period_levels import (
    PeriodLevels,
    innovation_levels,
    period_spectra,
    present_part,
    spectrum_levels,
    white_noise_levels,
)
from .result import METHODS, AxisFit, N, NoiseModel, Q
from .selection import TOLERANCE
from .statistics import Statistics, statistics

LEAST_DRIFT_S = 10.0
"""Shortest time at rest in s for which B, K and R are estimated."""

LEAST_STATISTICS = 12
"""Fewest statistics from which an axis is fitted: bins of the spectra plus contrasts of block
means."""

SHAKY_RATIO = 1.3
"""Largest ratio of the highest to the lowest N in parts of the data. If the ratio of an axis is
larger, steps of the bias are not searched for."""

LEVEL_RATIO, LARGE_RATIO = 1.02, 1.1
"""Least ratio of the highest to the lowest N of the periods that is reported. The second value is
used if the scatter between neighboring periods, such as from impulsive noise, may explain the
ratio."""


def fit_stationary(
    sums: AllanSums, method: str = 'likelihood', may_exclude: bool = True
) -> tuple[AllanSums, NoiseModel]:
    """Fit the data at the present level of the white noise.

    Parameters
    ----------
    sums : AllanSums
        Allan sums of one IMU.
    method : str
        One of `METHODS`; 'paper' always fits all data.
    may_exclude : bool
        Whether data before a change of the level may be excluded.

    Returns
    -------
    sums : AllanSums
        The sums that were fitted.
    model : NoiseModel
        The fit. With method 'likelihood', findings also report noise that changes with time.

    Raises
    ------
    AllanError
        If the method is unknown, or if the method is 'paper' and no segment has two samples.
    """
    if method not in METHODS:
        raise AllanError(f'fit method {method!r} is unknown: choose one of {", ".join(METHODS)}')
    if method == 'paper':
        from .least_squares import fit_paper  # imported here, because the method is rarely used

        return sums, fit_paper(sums)
    if not sums.tau0:
        return sums, fit_likelihood(sums)
    spectra = period_spectra(sums)
    levels = white_noise_levels(spectra)
    present = present_part(sums, levels) if may_exclude else None
    data = sums if present is None else _from_period(sums, present[0])
    if data is not sums:
        spectra = period_spectra(data)
    known = statistics(data)
    axis_statistics = [known] * len(data.axes)
    settlings = []
    for indices in axes_of_sensors(data.axes).values():
        sensor_settling = settling(data, known, indices)
        if sensor_settling is not None:
            settlings.append(sensor_settling)
            settled = statistics(data, sensor_settling.settling)
            axis_statistics = [
                settled if i in indices else each for i, each in enumerate(axis_statistics)
            ]
    model = fit_likelihood(data, axis_statistics)
    findings = settling_findings(data, settlings)
    if present is not None:
        first_period, changed_axes = present
        seconds_since = data.samples * sums.tau0
        findings += [
            _level_finding(model, i, levels, first_period, seconds_since) for i in changed_axes
        ]
        levels = white_noise_levels(spectra)
    # a settling, or white noise that increases for some time, would look like steps of the bias
    ratios = (np.divide(*levels.extremes(i)) for i in range(len(sums.axes)))
    not_tested = {i for i, ratio in enumerate(ratios) if ratio < 1.0 / SHAKY_RATIO}
    settling_times = {a: each.settling.time for each in settlings for a in each.axes}
    findings += step_findings(data, known, not_tested | settling_times.keys())
    findings = [*level_findings(data, levels, model), *findings, *model.findings]
    fits = list(model.axes.values())
    drifts = (
        spectrum_levels(spectra, axis_statistics, fits, model.tau0),
        innovation_levels(data, fits, settling_times),
    )
    return data, replace(
        _with_predictive_intervals(levels, drifts, model), findings=tuple(findings)
    )


def _from_period(sums: AllanSums, omitted: int) -> AllanSums:
    """Return the sums without the first ``omitted`` periods, counted over all recordings."""
    parts = []
    for recording in sums.recordings:
        first = min(omitted, len(recording.periods))
        omitted -= first
        if first < len(recording.periods):
            parts.append(part(replace(sums, recordings=(recording,)), first=first))
    return sum(parts[1:], start=parts[0])


# --- fit of each axis -----------------------------------------------------------------------------


def fit_likelihood(sums: AllanSums, statistics_of_axes: Sequence[Statistics] = ()) -> NoiseModel:
    """Estimate the noise of every axis by maximum likelihood.

    ``statistics_of_axes`` are the statistics of the sums for each axis, if they are already
    computed. They must take the settling of a sensor into account (see `statistics`).

    Too few data raise no error: an axis with too few statistics, or without noise, has no values
    and no limits, and a finding reports the axis. An axis whose spectra are not finite has no
    values and no limits.
    """
    tau0 = sums.tau0 or 1.0
    statistics_of_axes = statistics_of_axes or [statistics(sums)] * len(sums.axes)
    candidates_of = {each: Candidates(each) for each in statistics_of_axes}
    axes: dict[str, AxisFit] = {}
    findings: list[Finding] = []
    for a, (name, known) in enumerate(zip(sums.axes, statistics_of_axes)):
        candidates, daily = candidates_of[known], daily_cycle(known.longest, tau0)
        number = len(known.f) + sum(g.size.high for g in known.groups)
        is_constant = _is_constant(sums, a)
        if number < LEAST_STATISTICS or is_constant:
            axes[name] = without_estimates()
            has_no_noise = is_constant and sums.count[:1].sum() >= LEAST_EQUAL
            id, numbers = (
                ('no_noise', {})
                if has_no_noise
                else ('record_too_short', {'samples': sums.samples})
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


# --- rounding errors of a counter -----------------------------------------------------------------


LEAST_STEP_RATIO = 1.8
"""Least ratio of the squared step to the variance of the samples for which the correlation of the
rounding errors is taken into account. This ratio is reached if the step is 1.6 times the standard
deviation of the white noise of a sample. The correlation of successive rounding errors is then
0.03 %."""

LARGEST_STEP_DIFFERENCE = 0.2
"""Largest relative difference between the fitted variance of the rounding errors and step^2/12. If
the difference is larger, the samples are rounded without carrying the remainder."""

STEP_ROUNDS = 3
"""Number of times that the shape of the rounding errors is computed from N, and N fitted again."""


def rounding_errors(sums: AllanSums, axis: int, data: AxisData) -> Process | None:
    """Return the rounding errors of a counter with a large step, or None.

    The result is None if no step is found, if the step is too small (`LEAST_STEP_RATIO`), or if the
    fitted variance of the errors is not near step^2/12 (`LARGEST_STEP_DIFFERENCE`).

    ``data`` are the statistics of the axis. The shape of the result is in samples. It depends on
    the step, on the white noise, and on the rate, which the block means show
    (`rounding_of_counter`).

    Notes
    -----
    The shape is computed, not searched for. If the rounding errors are correlated, a fit with
    quantization noise, which assumes independent errors, has a wrong N and Q. The spectrum of the
    correlated errors differs from the spectrum of quantization noise mostly by a combination of the
    spectra of Q and N. Therefore, a search by likelihood would find the correlation only in data
    from which N and Q are already wrong by several standard errors.
    """
    step = step_of_sums(sums, axis, math.sqrt(data.scale))
    if step is None or step**2 < LEAST_STEP_RATIO * data.scale:
        return None
    means = np.concatenate([m.values[:, axis] for m in sums.means])
    effect_of_rate = complex(np.mean(np.exp(2j * math.pi / step * means)))
    fit, rounding = data.solve(RANDOM_TERMS, tolerance=TOLERANCE), None
    for _ in range(STEP_ROUNDS):
        rounding = rounding_of_counter(step, float(fit.p[N]) * data.scale, effect_of_rate)
        fit = data.solve((rounding, *RANDOM_TERMS[Q + 1 :]), None, fit.p, tolerance=TOLERANCE)
    is_carried = abs(12.0 * fit.p[Q] * data.scale / step**2 - 1.0) < LARGEST_STEP_DIFFERENCE
    return rounding if is_carried else None


# --- findings about the level ---------------------------------------------------------------------


def _level_finding(
    model: NoiseModel, axis_index: int, levels: PeriodLevels, first_period: int, seconds: float
) -> Finding:
    """Return the finding that the white noise of an axis changed at the start of a period.

    ``first_period`` is the index of the period, and ``seconds`` is the duration of the data since
    the change in s.
    """
    axis = list(model.axes)[axis_index]
    n = model.axes[axis].noise['N'].value or 0.0
    level_after = levels.mean(axis_index, slice(first_period, None))
    ratio = math.sqrt(levels.usual(axis_index, first_period) / level_after)
    return finding('level_changed', (axis,), before=n * ratio, value=n, since=seconds)


def level_findings(sums: AllanSums, levels: PeriodLevels, model: NoiseModel) -> list[Finding]:
    """Return a finding for each axis with a resolved N that varies between the periods.

    The ratio of the highest to the lowest N in parts of the data must exceed `LEVEL_RATIO`. It must
    exceed `LARGE_RATIO` if the scatter between neighboring periods may explain the variation.
    """
    place = 'between recordings' if len(sums.recordings) > 1 else 'within the recording'
    findings = []
    for i, axis in enumerate(sums.axes):
        low, high = levels.extremes(i)
        n = model.axes[axis].noise['N']
        if not levels.varies(i) or not n.resolved or not n.value:
            continue
        least_ratio = LEVEL_RATIO if levels.varies(i, levels.spread(i)) else LARGE_RATIO
        if high > least_ratio * low:
            numbers = {'low': n.value * low, 'high': n.value * high, 'value': n.value}
            findings.append(finding('level_changes', (axis,), which=place, **numbers))
    return findings


# --- predictive intervals -------------------------------------------------------------------------


SCATTER = 0.005
"""Probability in Bartlett's test below which the levels of the parts of a recording are regarded as
different. Each sensor is tested with each number of parts in `SCALES`, which gives false alarms on
at most 1.5 % of the sensors for each kind of level. Measured: 2 of 150 sensors for white noise, 7
of 1800 for the spectra of drift, and 19 of 1800 for the innovations of the block means."""

SCALES = (3, 6, 12)
"""Numbers of parts into which the data are divided to compare the levels of the parts. If periods
are long, there are fewer parts."""

LEAST_PARTS = 3
"""Fewest parts of the data from which the scatter of the levels is computed."""


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
        statistic, total_dof, excess, information = 0.0, 0, 0.0, 0.0
        for power, level_dof, share in joined_levels:
            axis_dof = len(level_dof) - 1
            correction = 1.0 + (np.sum(1.0 / level_dof) - 1.0 / level_dof.sum()) / (3.0 * axis_dof)
            mean = np.average(power, weights=level_dof)
            statistic += float(np.sum(level_dof * np.log(mean / power))) / correction
            total_dof += axis_dof
            weight = 1.0 / polygamma(1, level_dof / 2.0)
            level = np.log(power)
            squares = weight @ (level - np.average(level, weights=weight)) ** 2
            excess += float(squares) - axis_dof
            information += float(weight.sum() - weight @ weight / weight.sum()) * share**2
        if excess > 0.0 and chdtrc(total_dof, statistic) < SCATTER:
            quantile = float(stdtrit(total_dof / len(joined_levels), 0.975))
            largest = max(largest, quantile * math.sqrt(excess / information) / 2.0)
    return largest


def _with_predictive_intervals(
    levels: PeriodLevels, drifts: Sequence[PeriodLevels], model: NoiseModel
) -> NoiseModel:
    """Return the model with predictive intervals for sensors whose noise varies with time.

    ``levels`` are the levels of the white noise. ``drifts`` are the levels of the drift in the
    spectra and in the block means, of which the larger scatter is used.
    """
    axes = dict(model.axes)
    names = list(axes)
    for indices in axes_of_sensors(names).values():
        white = scatter(levels, indices)
        drift = max(scatter(each, indices) for each in drifts)
        for name in (names[i] for i in indices):
            axes[name] = _fit_with_scatter(axes[name], white, drift)
    return replace(model, axes=axes)


def _fit_with_scatter(fit: AxisFit, white_scatter: float, drift_scatter: float) -> AxisFit:
    """Return a fit with the predictive intervals of N, B and K.

    ``white_scatter`` and ``drift_scatter`` are stored in the fields of `AxisFit` with these names.
    Upper limits are multiplied by the exponential of the scatter.
    """
    noise = dict(fit.noise)
    for letter, half_width in (('N', white_scatter), ('B', drift_scatter), ('K', drift_scatter)):
        if half_width:
            noise[letter] = _predicted(noise[letter], half_width)
    return replace(fit, noise=noise, white_scatter=white_scatter, drift_scatter=drift_scatter)


def _predicted(estimate: Estimate, half_width: float) -> Estimate:
    """Return an estimate with its predictive interval, or with a larger upper limit.

    An estimate without an interval and without a limit is returned unchanged.

    ``half_width`` is half of the width of the 95 % interval of the logarithm of the value in
    another hour.
    """
    value, interval, limit = estimate.value, estimate.recording_ci95, estimate.upper95
    if limit is not None:
        return replace(estimate, upper95=limit * math.exp(half_width))
    if not value or interval is None:
        return estimate
    low = math.hypot(math.log(value / interval[0]), half_width) if interval[0] > 0.0 else math.inf
    high = math.hypot(math.log(interval[1] / value), half_width)
    return replace(estimate, predictive_ci95=(value * math.exp(-low), value * math.exp(high)))
