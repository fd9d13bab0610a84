# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings about a fit, and the recommended length of a recording that resolves more terms.

`not_noise_findings` detects recordings that show motion or vibration instead of the noise of the
sensor. A recording is not a noise recording if at least half of its axes are disturbed.

Conditions for a disturbed axis
-------------------------------
An axis is disturbed if one of these conditions holds. The conditions are chosen so that none of
them holds for a sensor at rest beside a fan, which adds only a few sinusoids. An axis without a
value or an upper limit of N is not regarded as disturbed.

1. Several broad or slow oscillations, or more than `MOST_LINES` oscillations of any kind, together
   have more variance than the white noise of a sample. Sinusoids of up to 0.1 Hz are regarded as
   drift of the sensor, and are not counted.
2. Neither white noise nor quantization noise is resolved, or the white noise is known much less
   precisely than pure white noise in a recording of this length would be. Other noise is then
   larger at all frequencies.
3. In more than a third of the octaves of frequencies, the model does not fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..allan.at_rest import rounding_step
from ..allan.curve import AllanCurve
from ..allan.sums import AllanSums
from ..estimate import Z_95
from ..findings import Finding, finding
from ..noise import FLICKER_FLOOR, Part
from .result import AxisFit, NoiseModel, largest_deviation, model_line

TOO_SHORT_S = 20.0
"""Duration of the data at rest in s below which a recording is not judged."""

SLOWEST_VIBRATION = 0.5
"""Lowest frequency in Hz of a sinusoid that a finding reports as vibration. Buildings and tables
have resonances above this frequency."""

RATE_WITHOUT_ALIASES = 400.0
"""Sample rate in Hz from which a finding about vibration mentions no alias. The frequencies of
rotors and engines are mostly below half of this rate."""

ALIAS_FROM = 0.02
"""Lowest frequency, as a fraction of the sample rate, for which an alias is mentioned. A slower
sinusoid can only be an alias of a vibration at nearly a multiple of the sample rate."""

HARMONIC, HIGHEST_HARMONIC = 0.01, 6.5
"""Largest relative distance of a harmonic from a multiple of the fundamental frequency, and upper
limit of this multiple. The limit is needed because every frequency is near some high multiple."""

MOST_LINES = 3
"""Largest number of oscillations in the model of an axis that are not regarded as a disturbance. A
machine beside the sensor, such as a fan, causes as many."""

SLOW_HZ = 3.0
"""Frequency in Hz below which an oscillation counts as motion. Machines and buildings vibrate
faster."""

LARGEST_WIDTH, LARGEST_EXCESS = 0.1, 5.0
"""The white noise is obscured if half of the width of the interval of N, relative to N, exceeds
both `LARGEST_WIDTH` and `LARGEST_EXCESS` times the half width for pure white noise. The ratio of
the half widths is 1 to 3 in clean recordings, 8 with heavy tails, and 6 to 20 in vehicles, with
half widths up to 0.4. Gauss-Markov noise with a correlation time of 2 samples causes ratios up to
30, but half widths below 0.1 on nearly all axes."""

LACK_OF_FIT_SHARE = 1.0 / 3.0
"""An axis is disturbed if more than this share of the octaves of frequencies has a lack of fit."""

DISTURBED_SHARE = 0.5
"""Least share of disturbed axes for which a recording is not a noise recording."""


def axis_findings(sums: AllanSums, axis: int, fit: AxisFit, tau0: float) -> list[Finding]:
    """Return the findings about the fit of one axis; ``tau0`` is the sample period in s."""
    name = (sums.axes[axis],)
    findings = []
    if fit.filtered:
        findings.append(finding('low_pass', name, frequency=4.0 / (fit.m_min * tau0)))
    shaped = fit.model.shaped.parts
    sinusoids = [part for part in shaped if part.process.is_line]
    findings += [line_finding(name, group, tau0) for group in with_harmonics(sinusoids)]
    for process, value, *_ in shaped:
        if not process.is_line:
            findings.append(finding(process.finding, name, **process.facts(value)))
    white = fit.noise['N'].value
    step = rounding_step(sums, axis, white**2 / tau0) if white else None
    is_counter = any(part.process.letter == 'Q' for part in shaped)
    if step is not None and white and not is_counter:
        share = step * step / 12.0 / (white**2 / tau0)
        findings.append(finding('rounding', name, step=step, share=min(share, 1.0)))
    advice = recommended_duration(fit, sums.longest * tau0)
    if advice is not None:
        seconds, terms = advice
        findings.append(finding('record_longer', name, terms=' and '.join(terms), how_long=seconds))
    return findings


def with_deviations(model: NoiseModel, curve: AllanCurve) -> NoiseModel:
    """Return a copy of the model with `AxisFit.deviation` computed from the measured curve.

    A finding reports each axis with a lack of fit. The finding states the octave with the largest
    relative difference between data and model, and this difference.
    """
    axes, new_findings = {}, []
    for i, name in enumerate(curve.axes):
        fit = model.axes[name]
        line = model_line(fit, model.tau0, curve)
        axes[name] = replace(fit, deviation=largest_deviation(line, curve.axis(i)))
        if fit.lack_of_fit:
            worst = max(fit.lack_of_fit, key=lambda each: abs(math.log(each.ratio)))
            relative_deviation = math.sqrt(worst.ratio) - 1.0
            new_findings.append(
                finding('lack_of_fit', (name,), frequency=worst.low, deviation=relative_deviation)
            )
    return replace(model, axes=axes, findings=(*model.findings, *merge_equal(new_findings)))


def with_harmonics(lines: Sequence[Part]) -> list[list[Part]]:
    """Return the sinusoids in groups: each group has a fundamental and then its harmonics.

    ``lines`` must be sorted by frequency, the lowest first.
    """
    groups: list[list[Part]] = []
    for line in lines:
        for group in groups:
            ratio = _frequency(line) / _frequency(group[0])
            is_multiple = abs(ratio - round(ratio)) < HARMONIC * ratio
            if is_multiple and 1.5 < ratio < HIGHEST_HARMONIC:
                group.append(line)
                break
        else:
            groups.append([line])
    return groups


def _frequency(line: Part) -> float:
    """Return the frequency of a sinusoid of a model in Hz."""
    return float(line.process.numbers['frequency'])


def line_finding(name: tuple[str], lines: Sequence[Part], tau0: float) -> Finding:
    """Return the finding about a sinusoid and its harmonics: a vibration or a slow disturbance.

    ``name`` contains the name of the axis. The first of the ``lines`` is the fundamental. ``tau0``
    is the sample period in s.
    """
    frequency = _frequency(lines[0])
    amplitude = math.sqrt(sum(each.value**2 for each in lines))
    if frequency < SLOWEST_VIBRATION:
        period = 1.0 / frequency
        return finding('slow_disturbance', name, period=period, amplitude=amplitude)
    rate = 1.0 / tau0
    alias = rate - frequency
    is_distinct = f'{alias:.3g}' != f'{frequency:.3g}'
    has_alias = rate < RATE_WITHOUT_ALIASES and frequency > ALIAS_FROM * rate and is_distinct
    return finding(
        'vibration',
        name,
        frequency=frequency,
        alias=alias if has_alias else None,
        harmonics=', '.join(f'{_frequency(each):.3g}' for each in lines[1:]) or None,
        amplitude=amplitude,
    )


def merge_equal(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return the findings, with equal findings about several axes merged into one."""
    merged: dict[tuple[str, tuple[tuple[str, object], ...]], Finding] = {}
    for f in findings:
        key = (f.id, tuple(f.values.items()))
        merged[key] = replace(f, axes=(*merged[key].axes, *f.axes)) if key in merged else f
    return tuple(merged.values())


def not_noise_findings(models: Sequence[NoiseModel], seconds: float) -> list[Finding]:
    """Return one finding, in a list, if the recording is not a noise recording, else an empty list.

    The list is also empty if the time at rest is below `TOO_SHORT_S`.

    Parameters
    ----------
    models : sequence of NoiseModel
        Fits of one IMU: one fit for all axes, or one for each sensor if the sample rates differ.
    seconds : float
        Time at rest in s.
    """
    if seconds < TOO_SHORT_S:
        return []
    fits = {name: (fit, m.tau0) for m in models for name, fit in m.axes.items()}
    disturbed_axes = [
        name for name, (fit, tau0) in fits.items() if is_disturbed(fit, tau0, seconds)
    ]
    if not disturbed_axes or len(disturbed_axes) < DISTURBED_SHARE * len(fits):
        return []
    return [finding('not_noise', tuple(disturbed_axes))]


def is_disturbed(fit: AxisFit, tau0: float, seconds: float) -> bool:
    """Return whether motion or vibration hides the noise of an axis.

    The result is False if N is not resolved and has no upper limit.

    Parameters
    ----------
    fit : AxisFit
        Fit of the axis.
    tau0 : float
        Sample period in s.
    seconds : float
        Time at rest in s.
    """
    n = fit.noise['N']
    white = ((n.value if n.resolved else n.upper95) or 0.0) ** 2 / tau0
    if not white:
        return False
    shares = [
        (p.process, p.value**2 / (2.0 if p.process.is_line else 1.0) / white)
        for p in fit.model.shaped.parts
        # the rounding errors of a counter (letter Q) are not an oscillation
        if not p.process.is_drift and not p.process.letter
    ]
    motion_shares = [s for p, s in shares if not p.is_line or p.numbers['frequency'] < SLOW_HZ]
    if len(motion_shares) > 1 and sum(motion_shares) > 1.0:
        return True
    if len(shares) > MOST_LINES and sum(s for _, s in shares) > 1.0:
        return True
    return _is_obscured(fit, tau0, seconds) or _has_lack_of_fit(fit, tau0, seconds)


def _is_obscured(fit: AxisFit, tau0: float, seconds: float) -> bool:
    """Return whether N is known much less precisely than it would be if all noise were white.

    Pure white noise with the bandwidth W determines N in the time T with a relative standard error
    of 1 / sqrt(4 W T). If N is not resolved, the result is whether Q is not resolved either.
    """
    n = fit.noise['N']
    if not n.resolved:
        return not fit.noise['Q'].resolved
    if not n.value or n.recording_ci95 is None:
        return False
    bandwidth = min(0.5 / tau0, 4.0 / (fit.m_min * tau0)) if fit.filtered else 0.5 / tau0
    low, high = n.recording_ci95
    width = (high - low) / (2.0 * n.value)
    return width > max(LARGEST_WIDTH, LARGEST_EXCESS * Z_95 / math.sqrt(4.0 * bandwidth * seconds))


def _has_lack_of_fit(fit: AxisFit, tau0: float, seconds: float) -> bool:
    octaves = math.log2(max(seconds / (2.0 * tau0), 2.0))
    octaves_with_lack = sum(
        math.log2(each.high / each.low) for each in fit.lack_of_fit if each.low > 0.0
    )
    return octaves_with_lack > LACK_OF_FIT_SHARE * octaves


# --- recommended length of a recording ------------------------------------------------------------


ADVISED_TERMS = ('N', 'B', 'K')
"""Terms for which a longer recording is recommended. Most state estimators do not use Q and R."""

HORIZON_S = 100.0
"""Averaging time in s at which the effect of a term is judged: a long time for a state estimator to
integrate without a correction."""

NEGLIGIBLE = 0.25
"""Share of the Allan variance of all resolved terms at `HORIZON_S`. An unresolved term below this
share is negligible."""

SECONDS_FOR_N = 60.0
"""Length in s of a recording that resolves N at any sample rate of an IMU."""

B_RESOLVED = 8.5
"""Smallest B that is resolved in T seconds, divided by N/sqrt(T), if K is not resolved."""

B_RESOLVED_WITH_K = ((10.0, 2.8), (1e2, 1.3), (1e3, 0.70), (1e4, 0.41))
"""Pairs of numbers for a resolved K: K T/N, and the smallest B that is resolved in T seconds,
divided by sqrt(N K)."""

K_RESOLVED = 51.0
"""Smallest K that is resolved in T seconds, divided by N/T."""

K_RESOLVED_WITH_B = 6.2
"""Smallest K that is resolved in T seconds, divided by B/sqrt(T), if B dominates the curve."""

LENGTHS_S = (
    *(60.0 * n for n in (1, 2, 5, 10, 20, 30)),
    *(3600.0 * n for n in (1, 1.5, 2, 3, 4, 6, 8, 12, 16, 24)),
)
"""Lengths in s that are recommended, ascending. A required length is rounded up to one of these
lengths. If the required length exceeds the longest of them, no length is recommended."""


def recommended_duration(
    fit: AxisFit, seconds: float, limits: Mapping[str, float] | None = None
) -> tuple[float, tuple[str, ...]] | None:
    """Return the recommended length of a recording, or None if a longer recording is not useful.

    If a segment shorter than `SECONDS_FOR_N` does not resolve N, `SECONDS_FOR_N` is recommended. If
    N is resolved, a longer recording is recommended if B or K is not resolved and the upper limit
    of this term is relevant or unknown. An upper limit is relevant if it exceeds the limit of the
    datasheet. Without such a limit, it is relevant if the term could contribute more than a quarter
    of the Allan variance at 100 s that is due to N, B and K, as far as they are resolved. A term is
    ignored if the length that resolves it exceeds 24 h, or does not exceed ``seconds``.

    The length is computed from N, and from B and K if they are resolved. The uncertain estimate of
    the unresolved term is not used, so that the advice is stable during a recording.

    Parameters
    ----------
    fit : AxisFit
        Fit by method 'likelihood'.
    seconds : float
        Length of the longest static segment so far, in s.
    limits : mapping of term to float, optional
        Limits of a datasheet for this axis, in SI units.

    Returns
    -------
    (seconds, terms) or None
        Length of a recording without gaps in s, and the terms for which it is recommended.
    """
    n = fit.noise['N'].value
    if fit.noise['N'].status != 'estimated' or not n:
        return (SECONDS_FOR_N, ('N',)) if seconds < SECONDS_FOR_N else None
    needed_s = {
        term: _seconds_for(term, target, fit)
        for term in ('B', 'K')
        if fit.noise[term].status != 'estimated'
        and (target := (limits or {}).get(term) or _negligible(term, fit))
        and (fit.noise[term].upper95 or math.inf) > target
    }
    useful_s = {term: t for term, t in needed_s.items() if seconds < t <= LENGTHS_S[-1]}
    if not useful_s:
        return None
    return next(t for t in LENGTHS_S if t >= max(useful_s.values())), tuple(useful_s)


def longest_recommended(
    advice: Iterable[tuple[float, tuple[str, ...]] | None],
) -> tuple[float, tuple[str, ...]] | None:
    """Return the longest of the recommended lengths in s, and the terms of all recommendations.

    ``advice`` contains the result of `recommended_duration` for each axis. The result is None if no
    longer recording is recommended for any axis.
    """
    recommended = [each for each in advice if each is not None]
    if not recommended:
        return None
    terms = {term for _, axis_terms in recommended for term in axis_terms}
    return max(t for t, _ in recommended), tuple(t for t in ADVISED_TERMS if t in terms)


def _resolved_value(term: str, fit: AxisFit) -> float:
    """Return a coefficient in SI; 0 if the term is not resolved."""
    coefficient = fit.noise[term]
    return coefficient.value or 0.0 if coefficient.status == 'estimated' else 0.0


def _negligible(term: str, fit: AxisFit) -> float:
    """Return the coefficient in SI below which a term has no relevant effect at `HORIZON_S`."""
    n, b, k = (_resolved_value(t, fit) for t in ADVISED_TERMS)
    known_variance = n**2 / HORIZON_S + FLICKER_FLOOR * b**2 + k**2 * HORIZON_S / 3.0
    unit_variance = FLICKER_FLOOR if term == 'B' else HORIZON_S / 3.0
    return math.sqrt(NEGLIGIBLE * known_variance / unit_variance)


def _seconds_for(term: str, size: float, fit: AxisFit) -> float:
    """Return the estimated length in s of a recording that resolves B or K of ``size`` in SI."""
    n, b, k = (_resolved_value(t, fit) for t in ADVISED_TERMS)
    if term == 'K':
        return max(K_RESOLVED * n / size, (K_RESOLVED_WITH_B * b / size) ** 2)
    if k > 0.0:
        log_times, log_sizes = np.log(B_RESOLVED_WITH_K).T
        log_time = np.interp(-np.log(size / (n * k) ** 0.5), -log_sizes, log_times)
        return float(np.exp(log_time) * n / k)
    return (B_RESOLVED * n / size) ** 2
