# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings about a fit by method 'gls': rounding, filters, vibration, drift, record length."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..allan.curve import AllanCurve
from ..findings import Finding, finding
from .goodness import few_averages
from .interpretation import largest_deviation, model_line, recommended_duration
from .intervals import Z_DETECT, RampInterval, ScoreTest
from .model import AxisFit, Floats, K, N, NoiseModel, Q, Sinusoid
from .model_selection import Selection
from .table import PooledTable

NEGLIGIBLE_STEP = 0.02
"""Rounding steps below this fraction of the white noise per sample are ignored: they increase its
variance by a fraction of only 3e-5."""

WHOLE_TOLERANCE = 0.05
"""Largest distance of the phase, divided by the step, from a whole number."""

LEAST_POINTS = 8
"""Smallest number of different phase values needed to search for a step. Fewer values are multiples
of some step by chance."""


def common_step(phase: Floats, deviation: float) -> float | None:
    """Return the largest step of which all phase values are multiples, or None if there is none.

    ``phase`` contains cumulative sums of samples. If the samples are rounded, this is the rounding
    step. Steps far below ``deviation``, the white noise per sample, are ignored.
    """
    least = NEGLIGIBLE_STEP * deviation
    moved = np.unique(np.abs(phase[np.abs(phase) > least]))
    if len(moved) < LEAST_POINTS or not deviation > 0.0:
        return None
    step, values = 0.0, moved.tolist()
    for i, value in enumerate(values):
        step = _common_divisor(value, step, least)
        if step < least:
            return None
        # Euclid's algorithm accumulates rounding errors; dividing by the multiples so far, smallest
        # first, removes them.
        for known in values[: i + 1]:
            multiple = round(known / step)
            if multiple < 1:
                return None  # the divisor exceeds a number that it should divide: there is no step
            step = known / multiple
    off = np.abs(moved / step - np.round(moved / step))
    return step if off.max() < WHOLE_TOLERANCE else None


def _common_divisor(a: float, b: float, least: float) -> float:
    """Return the greatest common divisor of two floats; remainders below ``least`` count as 0."""
    while b >= least:
        remainder = a % b
        a, b = b, min(remainder, b - remainder)
    return a


ROUNDING_SHARE = 0.1
"""Variance of the rounding error, relative to that of the white noise, above which rounding is
reported."""

FILTERED_FRACTION = 0.1
"""Fraction of the white noise per sample that a low-pass filter must remove to be reported.
Interpolation of 1 % of the samples removes 1.5 %."""

SMALL_DEVIATION = 0.05
"""Relative deviation of the curve from the model below which the finding has severity info."""

HUMP_RATIO = 1.5
"""Neighboring sinusoids with a smaller ratio of frequencies are reported as one broad hump."""

SAME_LINE = 1.02
"""Sinusoids whose frequency ratio is smaller than this describe one strong vibration."""

WEAK_LINE = 0.2
"""Amplitude, relative to the largest sinusoid of a hump, below which another one only corrects the
model of the largest."""

SLOWEST_VIBRATION = 0.5
"""Frequency in Hz below which sinusoids are not called vibration: buildings and tables resonate
above it."""

SHORTEST_THERMAL_S = 300.0
"""Shortest period in s of a cycle that is attributed to heating, air conditioning or temperature
control."""

FASTEST_VIBRATION = 400.0
"""Sample rate in Hz from which vibration of rotors and engines has no aliases."""

ALIAS_FROM = 0.02
"""Lowest frequency, as a fraction of the sample rate, for which an alias is mentioned. Slower lines
can only be aliases of vibration at nearly the sample rate."""


def merge_equal(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Merge findings with equal values into one for all their axes."""
    out: dict[tuple[str, tuple[tuple[str, object], ...]], Finding] = {}
    for f in findings:
        key = (f.id, tuple(f.values.items()))
        out[key] = replace(f, axes=(*out[key].axes, *f.axes)) if key in out else f
    return tuple(out.values())


def rounding_step(phase: Floats, white: float) -> float | None:
    """Return the step to which the samples are rounded, or None if rounding is negligible.

    ``phase`` is the cumulative sum at some samples, ``white`` the white noise variance per sample.
    """
    step = common_step(phase, math.sqrt(max(white, 0.0)))
    return step if step is not None and step * step / 12.0 > ROUNDING_SHARE * white else None


def findings_without_estimates(pooled: PooledTable, axis: int, constant: bool) -> list[Finding]:
    """Return the finding that explains why an axis has no estimates, as a list.

    The reason is that the samples have no noise (``constant``), or that there are too few samples.
    """
    name = (pooled.sums.axes[axis],)
    longest = max((s.samples for s in pooled.segments), default=0)
    if constant and len(pooled.m):
        return [finding('no_noise', name)]
    return [finding('record_too_short', name, samples=longest)]


def axis_findings(
    pooled: PooledTable,
    axis: int,
    selected: Selection,
    fit: AxisFit,
    ramp: RampInterval | None,
    tau0: float,
) -> list[Finding]:
    """Return the findings about the fit of one axis.

    ``selected`` is the selected model and ``fit`` contains the same model in SI units. ``ramp`` is
    None if it cannot be estimated. ``tau0`` is the sample period in s.
    """
    name = (pooled.sums.axes[axis],)
    found = [*_shape_findings(name, selected, fit, tau0)]
    white = float(selected.fit.variances[N])
    step = rounding_step(pooled.segments[0].phase[:, axis], white)
    if step is not None:
        share = step * step / 12.0 / white
        found.append(finding('rounding', name, step=step, share=min(share, 1.0)))
    if ramp is not None and ramp.other is not None:
        rates = {'longest': ramp.value / tau0, 'other': ramp.other / tau0}
        found.append(finding('ramps_differ', name, **rates))
    return [*found, *_time_findings(pooled, axis, selected, fit, tau0)]


def with_deviations(model: NoiseModel, curve: AllanCurve) -> NoiseModel:
    """Return a copy of the model with `AxisFit.deviation` computed from the measured curve.

    A finding is added for each axis that has a relative model error and deviates significantly.
    """
    axes, found = {}, []
    for i, name in enumerate(curve.axes):
        fit = model.axes[name]
        adev, low, high = (a[:, i] for a in (curve.adev, curve.ci_low, curve.ci_high))
        line = model_line(fit, model.tau0, curve.m, adev, high)
        deviation = largest_deviation(line, curve.tau, adev, low, high)
        axes[name] = replace(fit, deviation=deviation)
        if fit.misfit > 0.0 and deviation is not None:
            relative, tau = deviation
            misfit = finding('misfit', (name,), deviation=abs(relative), tau=tau)
            small = abs(relative) < SMALL_DEVIATION
            found.append(replace(misfit, severity='info') if small else misfit)
    return replace(model, axes=axes, findings=(*model.findings, *merge_equal(found)))


def _shape_findings(
    name: tuple[str], selected: Selection, fit: AxisFit, tau0: float
) -> list[Finding]:
    """Return the findings about filters, vibration and bounded drift."""
    found = []
    if fit.m_min > 1:
        # A slow filter and a fast sinusoid have the same effect on the shortest averages.
        frequency = None if selected.hint is None else selected.hint / tau0
        hint = (', or' if frequency else ':') + ' a low-pass filter' if selected.filtered else ''
        tau = fit.m_min * tau0
        found.append(finding('short_averages', name, tau=tau, frequency=frequency, hint=hint))
    elif selected.filtered and _filtered_fraction(selected) > FILTERED_FRACTION:
        found.append(finding('low_pass', name))
    for lines in _grouped(fit.processes.sinusoid):
        found.append(line_finding(name, lines, tau0))
    n = fit.noise['N']
    if fit.processes.sinusoid and n.status != 'estimated' and n.upper95:
        line = max(fit.processes.sinusoid, key=lambda each: each.amplitude)
        ratio = line.amplitude * math.sqrt(tau0) / n.upper95
        found.append(finding('noise_hidden', name, frequency=line.frequency, ratio=ratio))
    for process in fit.processes.gauss_markov:
        time = process.correlation_time
        found.append(finding('gauss_markov', name, sigma=process.sigma, time=time))
    if selected.levels_off:
        few = _first_factor_of_few_averages(selected)
        found.append(finding('levels_off', name, tau=few * tau0))
    return found


def _filtered_fraction(selected: Selection) -> float:
    """Return the fraction of the white noise per sample that a low-pass filter has removed."""
    fit = selected.fit
    white = float(fit.table.terms[0, N] * fit.variances[N])
    return (
        max(-float(fit.table.terms[0, Q] * fit.variances[Q]) / white, 0.0) if white > 0.0 else 1.0
    )


def _first_factor_of_few_averages(selected: Selection) -> float:
    """Return the smallest averaging factor whose Allan variance has few degrees of freedom."""
    few = few_averages(selected.fit.table, selected.fit.variances)
    return float(selected.fit.table.m[few].min(initial=selected.fit.table.m[-1]))


def _grouped(lines: Sequence[Sinusoid]) -> list[list[Sinusoid]]:
    """Group sinusoids (sorted by frequency) whose frequencies are close together."""
    groups: list[list[Sinusoid]] = []
    for line in lines:
        if groups and line.frequency < HUMP_RATIO * groups[-1][-1].frequency:
            groups[-1].append(line)
        else:
            groups.append([line])
    return groups


def line_finding(name: tuple[str], lines: Sequence[Sinusoid], tau0: float) -> Finding:
    """Return the finding about one sinusoid, or about several that describe one broad hump.

    ``name`` contains the axis, ``tau0`` is the sample period in s. The sinusoids are sorted by
    frequency.
    """
    largest = max(lines, key=lambda line: line.amplitude)
    amplitude = math.sqrt(sum(line.amplitude**2 for line in lines))
    strong = [line.frequency for line in lines if line.amplitude > WEAK_LINE * largest.amplitude]
    if strong[-1] > SAME_LINE * strong[0]:
        return finding(
            'broad_hump',
            name,
            low=strong[0],
            high=strong[-1],
            amplitude=amplitude,
        )
    if largest.frequency < SLOWEST_VIBRATION:
        thermal = largest.frequency * SHORTEST_THERMAL_S < 1.0
        id = 'slow_cycle' if thermal else 'slow_disturbance'
        return finding(id, name, period=1.0 / largest.frequency, amplitude=amplitude)
    rate = 1.0 / tau0
    other = rate - largest.frequency
    is_other = f'{other:.3g}' != f'{largest.frequency:.3g}'
    has_alias = rate < FASTEST_VIBRATION and largest.frequency > ALIAS_FROM * rate and is_other
    return finding(
        'vibration',
        name,
        frequency=largest.frequency,
        alias=other if has_alias else None,
        amplitude=amplitude,
    )


def _time_findings(
    pooled: PooledTable, axis: int, selected: Selection, fit: AxisFit, tau0: float
) -> list[Finding]:
    """Return the findings about terms that a longer record would resolve."""
    name = (pooled.sums.axes[axis],)
    found = []
    if {'K', 'R'} <= {t for t, c in fit.noise.items() if c.status == 'not_observable'}:
        without_ramps = selected.fit.options.table(
            pooled,
            axis,
            selected.fit.options.noise(selected.fit.variances),
            np.zeros(len(pooled.segments)),
        )
        if (
            ScoreTest(without_ramps, K, selected.fit.variances, selected.fit.options.misfit)(0.0)
            > Z_DETECT
        ):
            found.append(finding('drift_not_separable', name))
    advice = recommended_duration(fit, pooled.segments[0].samples * tau0)
    if advice is not None:
        seconds, terms = advice
        named = ' and '.join(terms)
        found.append(finding('record_longer', name, terms=named, how_long=seconds))
    return found
