# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a fit by method gls tells its user: causes and remedies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..findings import Finding, finding
from ..units import SI_UNITS, sensor_of, to_datasheet
from .duration import record_times
from .evidence import Evidence
from .frame import Chosen
from .intervals import Z_DETECT, Score
from .lattice import lattice_step
from .ramp_interval import RampInterval
from .solve import K, N
from .values import AxisFit

ROUNDING_SHARE = 0.1
"""Part of the white noise from which rounding is worth a word."""

FARTHEST = 30 * 86400.0
"""Seconds: nobody records for longer to see one coefficient."""


def joined(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return the findings with those that read alike made one, for all their axes."""
    out: dict[tuple[str, str, str], Finding] = {}
    for f in findings:
        key = (f.id, f.message, f.remedy)
        out[key] = replace(f, axes=(*out[key].axes, *f.axes)) if key in out else f
    return tuple(out.values())


def explain_nothing(evidence: Evidence, axis: int, constant: bool) -> list[Finding]:
    """Return why an axis has no numbers."""
    name = (evidence.sums.axes[axis],)
    longest = max((s.samples for s in evidence.segments), default=0)
    if constant and len(evidence.m):
        return [finding('no_noise', name)]
    return [finding('record_too_short', name, samples=longest)]


def explain(
    evidence: Evidence,
    axis: int,
    chosen: Chosen,
    fit: AxisFit,
    ramp: RampInterval | None,
    tau0: float,
) -> list[Finding]:
    """Return what there is to know of the fit of one axis."""
    name = (evidence.sums.axes[axis],)
    unit = SI_UNITS[sensor_of(name[0])]['B']
    found = [*_shape_findings(name, unit, chosen, fit, tau0)]
    phase = evidence.segments[0].phase[:, axis]
    white = float(chosen.fit.power[N])
    step = lattice_step(phase, math.sqrt(max(white, 0.0)))
    if step is not None and step * step / 12.0 > ROUNDING_SHARE * white:
        share = step * step / 12.0 / white
        found.append(finding('rounding', name, step=step, unit=unit, share=min(share, 1.0)))
    if ramp is not None and not ramp.shared:
        found.append(finding('ramps_differ', name))
    return [*found, *_time_findings(evidence, axis, chosen, fit, tau0)]


def _shape_findings(
    name: tuple[str], unit: str, chosen: Chosen, fit: AxisFit, tau0: float
) -> list[Finding]:
    """Return what of the curve is not the five terms."""
    found = []
    if fit.m_min > 1:
        hint = ''
        if chosen.hint is not None:
            # A slow filter bends the shortest averages as a line does: then it may be either.
            either = ', or a low-pass filter' if chosen.filtered else ''
            hint = f' (vibration at {chosen.hint.extra.shape / tau0:.3g} Hz{either})'
        elif chosen.filtered:
            hint = ' (a low-pass filter)'
        found.append(finding('short_averages', name, tau=fit.m_min * tau0, hint=hint))
    elif chosen.filtered:
        found.append(finding('low_pass', name, deviations=-chosen.z_quantization))
    if fit.sinusoid is not None:
        line = fit.sinusoid
        found.append(
            finding(
                'vibration', name, frequency=line.frequency, amplitude=line.amplitude, unit=unit
            )
        )
    if fit.gauss_markov is not None:
        drift = fit.gauss_markov
        time = about(drift.correlation_time)
        found.append(finding('gauss_markov', name, sigma=drift.sigma, unit=unit, time=time))
    if fit.misfit > 0.0:
        found.append(finding('misfit', name, misfit=fit.misfit))
    if chosen.levels_off:
        found.append(finding('levels_off', name))
    return found


def _time_findings(
    evidence: Evidence, axis: int, chosen: Chosen, fit: AxisFit, tau0: float
) -> list[Finding]:
    """Return what a longer record would show."""
    name = evidence.sums.axes[axis]
    seconds = evidence.segments[0].samples * tau0
    times = record_times(fit, tau0, seconds)
    unseen = {
        term: time.observable
        for term, time in times.items()
        if fit.noise[term].status == 'not_observable'
        and time.observable is not None
        and time.observable < FARTHEST
    }
    found = []
    if {'K', 'R'} <= {t for t, c in fit.noise.items() if c.status == 'not_observable'}:
        held = chosen.fit.frame.table(
            evidence, axis, chosen.fit.power, np.zeros(len(evidence.segments))
        )
        if Score(held, K, chosen.fit.power, fit.misfit)(0.0) > Z_DETECT:
            ends = [unseen[t] for t in 'KR' if t in unseen]
            how_long = f'about {about(min(ends))}' if ends else 'several times as long'
            found.append(finding('drift_not_separable', (name,), how_long=how_long))
    if unseen:
        sensor = sensor_of(name)
        sizes = []
        for term in unseen:
            value, unit = to_datasheet(term, sensor, fit.noise[term].value or 0.0)
            sizes.append(f'{term} of {value:.2g} {unit}')
        spans = [f'about {about(time)} for {term}' for term, time in unseen.items()]
        found.append(
            finding('record_longer', (name,), terms=', '.join(sizes), how_long=', '.join(spans))
        )
    return found


def about(seconds: float) -> str:
    """Return a time to two digits in the unit one would say it in."""
    for unit, size, least in (('days', 86400.0, 2.0), ('h', 3600.0, 2.0), ('min', 60.0, 2.0)):
        if seconds >= least * size:
            return f'{float(f"{seconds / size:.2g}"):g} {unit}'
    return f'{float(f"{seconds:.2g}"):g} s'
