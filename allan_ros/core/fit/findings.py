# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a fit by method gls tells its user: causes and remedies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..findings import Finding, finding
from ..imu import SI_UNITS, sensor_of, to_datasheet
from .intervals import Z_DETECT, RampInterval, Score
from .model import TERMS, AxisFit, Floats
from .select import Selection
from .solve import K, N
from .table import PooledTable

COARSEST_IGNORED = 0.02
"""A step below this part of the white noise per sample adds 3e-5 of its variance."""


NEAR_WHOLE = 0.05
"""How near to whole numbers the phase must be, in steps."""


LEAST_POINTS = 8
"""Fewer phase points are multiples of some step by chance."""


def lattice_step(phase: Floats, deviation: float) -> float | None:
    """Return the step of which all phase points are multiples, or None.

    Parameters
    ----------
    phase : (points,) float64 array
        Coarse phase record of one axis.
    deviation : float
        Standard deviation of the white noise per sample: far finer steps are of no account.
    """
    least = COARSEST_IGNORED * deviation
    moved = np.unique(np.abs(phase[np.abs(phase) > least]))
    if len(moved) < LEAST_POINTS or not deviation > 0.0:
        return None
    step = 0.0
    for i, value in enumerate(moved):
        step = _common_divisor(float(value), step, least)
        if step < least:
            return None
        # Euclid gathers rounding errors; the multiples so far, the smallest first, take them out.
        for known in moved[: i + 1]:
            multiple = np.round(known / step)
            if multiple < 1.0:
                return None  # the divisor grew past what it should divide: there is none
            step = float(known / multiple)
    off = np.abs(moved / step - np.round(moved / step))
    return step if off.max() < NEAR_WHOLE else None


def _common_divisor(a: float, b: float, least: float) -> float:
    """Return the greatest common divisor of two numbers, remainders below ``least`` being 0."""
    while b >= least:
        rest = a % b
        a, b = b, min(rest, b - rest)
    return a


Q_SHOWS = 2.0
"""Least Q over N sqrt(tau0) n^(-1/4), n samples."""


B_SHOWS = 8.5
"""Least B over N/sqrt(T), beside a walk that is not seen."""


B_SHOWS_BESIDE_WALK = ((10.0, 2.8), (1e2, 1.3), (1e3, 0.70), (1e4, 0.41))
"""K T/N, and least B over sqrt(N K) beside that walk."""


K_SHOWS = 51.0
"""Least K over N/T."""


K_SHOWS_BESIDE_FLICKER = 6.2
"""Least K over B/sqrt(T), where flicker rules the curve."""


R_WHITE, R_FLICKER, R_WALK = 12.0**0.5, 1.6, 1.0
"""sd(R) over N/T^1.5, B/T, K/sqrt(T): the largest of the three is that of the ramp."""


R_SHOWS = 2.58 + 1.645
"""Standard deviations: 1 % false alarms on both sides, 95 % probability."""


AGAIN = 1.5
"""A term that did not show though it might have asks for half the record again, at least."""


TIGHT = 0.1
"""Half-width of the 95 % interval, relative to the coefficient."""


Z_TWO_SIDED = 1.96


JUST_SHOWN = Z_TWO_SIDED / 2.0 / (2.33 + 1.645)
"""Relative half-width of a coefficient that just shows: its square does at 2.33 + 1.645 sd."""


@dataclass(frozen=True)
class RecordTime:
    """Seconds of record that a term takes; None where the fit gives no number to go by.

    Attributes
    ----------
    observable : float or None
        Until it shows, if it is as large as it is estimated now.
    tight : float or None
        Until its 95 % interval is within 10 %.
    """

    observable: float | None
    tight: float | None


def record_times(fit: AxisFit, tau0: float, seconds: float) -> dict[str, RecordTime]:
    """Return how long to record for every term, from what is known of all five.

    Parameters
    ----------
    fit : AxisFit
        By method gls.
    tau0 : float
        Sample period in s.
    seconds : float
        Length of the record that was fitted, in s.
    """
    value = {term: fit.noise[term].value or 0.0 for term in TERMS}
    out = {}
    for term in TERMS:
        c = fit.noise[term]
        if not c.value:
            out[term] = RecordTime(None, None)
        elif c.status == 'estimated' and c.ci95 is not None:
            half = (c.ci95[1] - c.ci95[0]) / 2.0 / c.value
            tight = (
                _ramp_time(value, TIGHT / Z_TWO_SIDED) if term == 'R' else _shrunk(half, seconds)
            )
            out[term] = RecordTime(seconds, max(seconds, tight) if half > TIGHT else seconds)
        elif term == 'R':
            shows = max(AGAIN * seconds, _ramp_time(value, 1.0 / R_SHOWS))
            out[term] = RecordTime(shows, max(shows, _ramp_time(value, TIGHT / Z_TWO_SIDED)))
        else:
            walk_seen = fit.noise['K'].status == 'estimated'
            shows = max(AGAIN * seconds, _shows(term, value, tau0, walk_seen))
            out[term] = RecordTime(shows, _shrunk(JUST_SHOWN, shows))
    return out


def _shrunk(half_width: float, seconds: float) -> float:
    """Return when a relative half-width is down to `TIGHT`, shrinking as 1/sqrt(T)."""
    return seconds * (half_width / TIGHT) ** 2


def _shows(term: str, value: dict[str, float], tau0: float, walk_seen: bool) -> float:
    """Return when a random term of that value shows."""
    n, b, k = value['N'], value['B'], value['K']
    if term == 'Q':
        return float(tau0 * (Q_SHOWS * n * tau0**0.5 / value['Q']) ** 4)
    if term == 'B' and walk_seen and n * k > 0.0:
        walk, least = np.log(B_SHOWS_BESIDE_WALK).T
        reach = np.interp(-np.log(b / (n * k) ** 0.5), -least, walk)
        return float(np.exp(reach) * n / k)
    if term == 'B':
        return float((B_SHOWS * n / b) ** 2)
    if term == 'K':
        return max(K_SHOWS * n / k, (K_SHOWS_BESIDE_FLICKER * b / k) ** 2)
    return 0.0


def _ramp_time(value: dict[str, float], share: float) -> float:
    """Return when sd(R) is down to that share of R."""
    deviation = share * value['R']
    white = float(np.cbrt(R_WHITE * value['N'] / deviation)) ** 2
    flicker = float(R_FLICKER * value['B'] / deviation)
    walk = float(R_WALK * value['K'] / deviation) ** 2
    return max(white, flicker, walk)


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


def explain_nothing(pooled: PooledTable, axis: int, constant: bool) -> list[Finding]:
    """Return why an axis has no numbers."""
    name = (pooled.sums.axes[axis],)
    longest = max((s.samples for s in pooled.segments), default=0)
    if constant and len(pooled.m):
        return [finding('no_noise', name)]
    return [finding('record_too_short', name, samples=longest)]


def explain(
    pooled: PooledTable,
    axis: int,
    selected: Selection,
    fit: AxisFit,
    ramp: RampInterval | None,
    tau0: float,
) -> list[Finding]:
    """Return what there is to know of the fit of one axis."""
    name = (pooled.sums.axes[axis],)
    unit = SI_UNITS[sensor_of(name[0])]['B']
    found = [*_shape_findings(name, unit, selected, fit, tau0)]
    phase = pooled.segments[0].phase[:, axis]
    white = float(selected.fit.power[N])
    step = lattice_step(phase, math.sqrt(max(white, 0.0)))
    if step is not None and step * step / 12.0 > ROUNDING_SHARE * white:
        share = step * step / 12.0 / white
        found.append(finding('rounding', name, step=step, unit=unit, share=min(share, 1.0)))
    if ramp is not None and not ramp.shared:
        found.append(finding('ramps_differ', name))
    return [*found, *_time_findings(pooled, axis, selected, fit, tau0)]


def _shape_findings(
    name: tuple[str], unit: str, selected: Selection, fit: AxisFit, tau0: float
) -> list[Finding]:
    """Return what of the curve is not the five terms."""
    found = []
    if fit.m_min > 1:
        hint = ''
        if selected.hint is not None:
            # A slow filter bends the shortest averages as a line does: then it may be either.
            either = ', or a low-pass filter' if selected.filtered else ''
            hint = f' (vibration at {selected.hint / tau0:.3g} Hz{either})'
        elif selected.filtered:
            hint = ' (a low-pass filter)'
        found.append(finding('short_averages', name, tau=fit.m_min * tau0, hint=hint))
    elif selected.filtered:
        found.append(finding('low_pass', name, deviations=-selected.z_quantization))
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
    if selected.levels_off:
        found.append(finding('levels_off', name))
    return found


def _time_findings(
    pooled: PooledTable, axis: int, selected: Selection, fit: AxisFit, tau0: float
) -> list[Finding]:
    """Return what a longer record would show."""
    name = pooled.sums.axes[axis]
    seconds = pooled.segments[0].samples * tau0
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
        held = selected.fit.options.table(
            pooled, axis, selected.fit.power, np.zeros(len(pooled.segments))
        )
        if Score(held, K, selected.fit.power, selected.fit.options.misfit)(0.0) > Z_DETECT:
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
