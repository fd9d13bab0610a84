# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings about a fit: rounding, low-pass filter, vibration, drift, lack of fit, record length."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..allan.curve import AllanCurve
from ..allan.sums import AllanSums
from ..findings import Finding, finding
from .model_curve import largest_deviation, model_line
from .record_length import recommended_duration
from .result import AxisFit, Floats, NoiseModel

NEGLIGIBLE_STEP = 0.02
"""Largest rounding step that is ignored, as a fraction of the standard deviation of the white noise
of a sample. Such a step increases the variance of the samples by a fraction of only 3e-5."""

WHOLE_TOLERANCE = 0.05
"""A phase value is a multiple of a step if the ratio of the two differs from a whole number by less
than this value."""

LARGEST_SHARE = 1.05
"""Largest ratio of the variance of the rounding error to the variance of the white noise. The white
noise contains independent rounding errors. A larger ratio therefore shows that the rounding errors
of successive samples are not independent."""

LEAST_POINTS = 8
"""Fewest different phase values among which a rounding step is searched for. A few values can be
multiples of some step by chance."""


def common_step(phase: Floats, deviation: float) -> float | None:
    """Return the largest step of which all phase values are multiples, or None if there is none.

    If the samples are rounded, this is the rounding step. ``phase``, (n,), contains cumulative sums
    of samples. ``deviation`` is the standard deviation of the white noise of a sample: steps below
    `NEGLIGIBLE_STEP` times ``deviation`` are ignored. All numbers have the unit of the samples.
    """
    least_step = NEGLIGIBLE_STEP * deviation
    magnitudes = np.unique(np.abs(phase[np.abs(phase) > least_step]))
    if len(magnitudes) < LEAST_POINTS or not deviation > 0.0:
        return None
    step, values = 0.0, magnitudes.tolist()
    for i, value in enumerate(values):
        former_step, step = step, _common_divisor(value, step, least_step)
        if step < least_step:
            return None
        # Euclid's algorithm accumulates rounding errors. To remove them, the step is computed again
        # as the ratio of each phase value so far, from the smallest on, to its multiple.
        for magnitude in [value] if step == former_step else values[: i + 1]:
            multiple = round(magnitude / step)
            if multiple < 1:
                return None  # the step exceeds a value that should be a multiple of it
            step = magnitude / multiple
    remainders = np.abs(magnitudes / step - np.round(magnitudes / step))
    return step if remainders.max() < WHOLE_TOLERANCE else None


def _common_divisor(a: float, b: float, least: float) -> float:
    """Return the greatest common divisor of two floats; remainders below ``least`` count as 0."""
    while b >= least:
        remainder = a % b
        a, b = b, min(remainder, b - remainder)
    return a


ROUNDING_SHARE = 0.1
"""Least ratio of the variance of the rounding error to the variance of the white noise for which
rounding is reported."""

SLOWEST_VIBRATION = 0.5
"""Lowest frequency in Hz of a sinusoid that a finding reports as vibration. Buildings and tables
have resonances above this frequency."""

FASTEST_VIBRATION = 400.0
"""Lowest sample rate in Hz at which vibration of rotors and engines has no aliases."""

ALIAS_FROM = 0.02
"""Lowest frequency, as a fraction of the sample rate, for which an alias is mentioned. A slower
sinusoid can only be an alias of a vibration at nearly the sample rate."""


def merge_equal(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return the findings, with equal findings about several axes merged into one."""
    out: dict[tuple[str, tuple[tuple[str, object], ...]], Finding] = {}
    for f in findings:
        key = (f.id, tuple(f.values.items()))
        out[key] = replace(f, axes=(*out[key].axes, *f.axes)) if key in out else f
    return tuple(out.values())


def rounding_step(sums: AllanSums, axis: int, white: float) -> float | None:
    """Return the step to which the samples of an axis are rounded, or None if it is negligible.

    ``white`` is the variance of the white noise of a sample. If the rounding errors of successive
    samples are independent, this variance contains the variance step^2/12 of these errors. A
    counter that carries its remainder to the next sample has less white noise: its rounding error
    is quantization noise (Q).
    """
    means = [m for r in sums.recordings for m in r.means]
    if not means:
        return None
    longest = max(means, key=lambda m: m.samples)
    totals = longest.step * longest.values[:, axis]
    step = common_step(np.cumsum(totals), math.sqrt(max(white, 0.0)))
    if step is None or not ROUNDING_SHARE < step * step / 12.0 / white < LARGEST_SHARE:
        return None
    return step


HARMONIC, HIGHEST_HARMONIC = 0.01, 6.5
"""Largest relative distance of a harmonic from a multiple of the fundamental frequency, and upper
limit of this multiple. The limit is needed because every frequency is near some high multiple."""


def axis_findings(sums: AllanSums, axis: int, fit: AxisFit, tau0: float) -> list[Finding]:
    """Return the findings about the fit of one axis; ``tau0`` is the sample period in s."""
    name = (sums.axes[axis],)
    found = []
    if fit.filtered:
        found.append(finding('low_pass', name, frequency=4.0 / (fit.m_min * tau0)))
    shaped = fit.model.shaped.parts
    sinusoids = [Line(p.process.shape[0], p.value) for p in shaped if p.process.is_line]
    found += [line_finding(name, group, tau0) for group in with_harmonics(sinusoids)]
    for process, value, *_ in shaped:
        if not process.is_line:
            found.append(finding(process.finding, name, **process.facts(value)))
    white = fit.noise['N'].value
    step = rounding_step(sums, axis, white**2 / tau0) if white else None
    if step is not None and white:
        share = step * step / 12.0 / (white**2 / tau0)
        found.append(finding('rounding', name, step=step, share=min(share, 1.0)))
    longest = max((m.samples for r in sums.recordings for m in r.means), default=0)
    advice = recommended_duration(fit, longest * tau0)
    if advice is not None:
        seconds, terms = advice
        found.append(finding('record_longer', name, terms=' and '.join(terms), how_long=seconds))
    return found


def with_deviations(model: NoiseModel, curve: AllanCurve) -> NoiseModel:
    """Return a copy of the model with `AxisFit.deviation` computed from the measured curve.

    A finding is added for each axis with a lack of fit. The finding states the octave with the
    largest difference between data and model, and this difference.
    """
    axes, found = {}, []
    for i, name in enumerate(curve.axes):
        fit = model.axes[name]
        line = model_line(fit, model.tau0, curve.m)
        axes[name] = replace(fit, deviation=largest_deviation(line, curve.axis(i)))
        if fit.lack_of_fit:
            worst = max(fit.lack_of_fit, key=lambda each: abs(math.log(each.ratio)))
            edges = {'low': worst.low, 'high': worst.high}
            relative_deviation = math.sqrt(worst.ratio) - 1.0
            found.append(finding('lack_of_fit', (name,), deviation=relative_deviation, **edges))
    return replace(model, axes=axes, findings=(*model.findings, *merge_equal(found)))


class Line(NamedTuple):
    """Sinusoid in the model of an axis."""

    frequency: float  # in Hz
    amplitude: float  # in SI


def with_harmonics(lines: Sequence[Line]) -> list[list[Line]]:
    """Return the sinusoids in groups: each group has a fundamental and then its harmonics.

    ``lines`` must be sorted by frequency.
    """
    groups: list[list[Line]] = []
    for line in lines:
        for group in groups:
            ratio = line.frequency / group[0].frequency
            is_multiple = abs(ratio - round(ratio)) < HARMONIC * ratio
            if is_multiple and 1.5 < ratio < HIGHEST_HARMONIC:
                group.append(line)
                break
        else:
            groups.append([line])
    return groups


def line_finding(name: tuple[str], lines: Sequence[Line], tau0: float) -> Finding:
    """Return the finding about a sinusoid and its harmonics: a vibration or a slow disturbance.

    ``name`` contains the name of the axis. The first of the ``lines`` is the fundamental. ``tau0``
    is the sample period in s.
    """
    fundamental = lines[0]
    amplitude = math.sqrt(sum(each.amplitude**2 for each in lines))
    if fundamental.frequency < SLOWEST_VIBRATION:
        period = 1.0 / fundamental.frequency
        return finding('slow_disturbance', name, period=period, amplitude=amplitude)
    rate = 1.0 / tau0
    alias = rate - fundamental.frequency
    is_distinct = f'{alias:.3g}' != f'{fundamental.frequency:.3g}'
    has_alias = (
        rate < FASTEST_VIBRATION and fundamental.frequency > ALIAS_FROM * rate and is_distinct
    )
    return finding(
        'vibration',
        name,
        frequency=fundamental.frequency,
        alias=alias if has_alias else None,
        harmonics=', '.join(f'{each.frequency:.3g}' for each in lines[1:]) or None,
        amplitude=amplitude,
    )
