# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The verdict on an IMU, and a summary of the results, as text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ..core.check import Check
from ..core.estimate import duration_text, significant
from ..core.findings import Finding, by_consequence, grouped, is_note
from ..core.fit.fit_findings import ADVISED_TERMS, TOO_SHORT_S
from ..core.imu import AXES, SENSORS, sensor_of, shown_unit
from ..results.results import (
    SENSOR_FAULTS,
    UNSUITABLE,
    WRONG_UNITS,
    Level,
    Results,
)
from .coefficient_table import axis_table
from .finding_text import finding_line, texts_of
from .table import WIDE, terminal_lines

VERDICT_WORDS: dict[Level, str] = {
    'healthy': 'Healthy',
    'attention': 'Usable with care',
    'measured': 'Measured',
    'unknown': 'Not judged',
    'failed': 'Failed',
}
"""Level of a verdict -> text that is shown to users."""

NO_STEP = ('file_left_out', 'held', 'short', 'record_longer', 'record_too_short')
"""Ids of findings whose remedy is not listed as a next step. No action is needed, or another next
step recommends a longer recording."""


@dataclass(frozen=True)
class Verdict:
    """Summary of an analysis: level, reasons and next steps.

    Attributes
    ----------
    level : 'healthy', 'attention', 'measured', 'unknown' or 'failed'
        'failed' for a broken sensor or an exceeded limit. 'unknown' for too little data, units that
        are probably wrong, exchanged sensors, a recording of motion or of a warm-up, another error,
        or an undecided comparison of N (of any term if N has no limit). 'measured' if no
        coefficient is compared with a datasheet or an earlier run. 'attention' for a warning.
        'healthy' in all other cases. `Results.level` states which of these conditions is tested
        first.
    summary : str
        The most important reason for the level, or the precision of N, B and K.
    reasons : tuple of str
        Warnings and errors as sentences, the most important first.
    next_steps : tuple of str
        Recommended actions, the most important first.
    """

    level: Level
    summary: str
    reasons: tuple[str, ...]
    next_steps: tuple[str, ...]


def verdict_of(results: Results, units: str = 'deg/h') -> Verdict:
    """Return the verdict on an IMU, given its results; ``units`` is 'deg/h' or 'SI'."""
    comparisons = results.comparisons
    summary = _summary(results, comparisons, units)
    reasons = tuple(finding_text(f, results, units) for f in warnings_and_errors(results))
    steps = tuple(dict.fromkeys(_steps(results, comparisons)))
    return Verdict(results.level, summary, reasons, steps)


def _summary(results: Results, comparisons: Sequence[Check], units: str) -> str:
    faults = [f for f in results.findings if f.id in SENSOR_FAULTS]
    unsuitable = [f for f in grouped(results.findings) if f.id in (*WRONG_UNITS, *UNSUITABLE)]
    if unsuitable and not faults and not results.is_too_short:
        return finding_text(unsuitable[0], results, units)
    exceeded = [c for c in comparisons if c.verdict == 'exceeds']
    if exceeded and not results.is_too_short:
        excesses = list(_excesses(results, exceeded, units))
        return f'Above {_references(exceeded)}: {_joined(excesses)}.'
    if faults:
        return finding_text(faults[0], results, units)
    if not results.is_measured:
        errors = [f for f in results.findings if f.severity == 'error']
        reason = texts_of(errors[0]).message if errors else 'No coefficient is resolved.'
        return f'Nothing could be measured. {reason}'
    if results.duration_s < TOO_SHORT_S:
        return f'Too short to judge: {duration_text(results.duration_s, 3)} at rest.'
    if not comparisons:
        return quality(results)
    undecided = [c for c in comparisons if c.verdict == 'undecided']
    if not undecided:
        return f'All {len(comparisons)} numbers are within {_references(comparisons)}.'
    terms: dict[str, list[str]] = {}
    for c in undecided:
        terms.setdefault(c.quantity, []).append(c.axis)
    term_texts = [f'{term} of {_axes_text(axes, results)}' for term, axes in terms.items()]
    return (
        f'{len(comparisons) - len(undecided)} of {len(comparisons)} numbers are within '
        f'{_references(comparisons)}, none is above; undecided: {_joined(term_texts)}.'
    )


def quality(results: Results) -> str:
    """Return a sentence about the precision of N, B and K: 'N to 0.4 %, B to 8 %, K needs 3 h.'

    A percentage is half the width of the 95 % interval, relative to the value, on the axis on which
    this ratio is largest. If the method gives no intervals, the sentence says so.
    """
    if not any(c.ci95 or c.upper95 for a in results.axes.values() for c in a.fit.noise.values()):
        return f'Method {results.method} gives no intervals.'
    advice = results.time_to_record
    parts: list[str] = []
    long_terms: list[str] = []
    limited_terms: list[str] = []
    for term in ADVISED_TERMS:
        coefficients = [axis.fit.noise[term] for axis in results.axes.values()]
        widths = [
            (c.ci95[1] - c.ci95[0]) / (2.0 * c.value)
            for c in coefficients
            if c.status == 'estimated' and c.value and c.ci95
        ]
        axes_text = (
            ''
            if len(widths) == len(coefficients)
            else f' on {len(widths)} of {len(coefficients)} axes'
        )
        if axes_text and advice and term in advice[1]:
            long_terms.append(term)
        elif widths:
            parts.append(f'{term} to {float(f"{100.0 * max(widths):.2g}"):g} %{axes_text}')
        else:
            limited_terms.append(term)
    if advice and long_terms:
        parts.append(
            f'{_joined(long_terms)} need{"s" * (len(long_terms) == 1)} {duration_text(advice[0])}'
        )
    if limited_terms:
        parts.append(f'only a limit of {_joined(limited_terms)}')
    text = ', '.join(parts)
    return f'{text[0].upper()}{text[1:]}.'


def _references(comparisons: Sequence[Check]) -> str:
    return _joined(list(dict.fromkeys(c.reference for c in comparisons)))


def _excesses(results: Results, exceeded: Sequence[Check], units: str) -> Iterator[str]:
    groups: dict[tuple[str, str, float | None], list[Check]] = {}
    for c in exceeded:
        groups.setdefault((sensor_of(c.axis), c.quantity, c.tau), []).append(c)
    for (sensor, term, tau), group in groups.items():
        unit = shown_unit(sensor, 'B' if tau else term, units)
        axes_text = _axes_text([c.axis for c in group], results)
        ratios = [c.at_least for c in group]
        ratio_texts = dict.fromkeys(f'{each:.2g}' for each in (min(ratios), max(ratios)))
        limit = significant(max(c.limit for c in group) * unit.factor, 3)
        quantity = f'deviation at {significant(tau, 2)} s' if tau else term
        ratio = ' to '.join(ratio_texts)
        yield f'{quantity} of {axes_text} (at least {ratio} times {limit} {unit.name})'


def warnings_and_errors(results: Results) -> list[Finding]:
    """Return the warnings and errors among the findings, merged and sorted by `grouped`."""
    return [found for found in grouped(results.findings) if found.severity != 'info']


def _steps(results: Results, comparisons: Sequence[Check]) -> Iterator[str]:
    level = results.level
    remedies: dict[str, list[str]] = {}
    for finding in by_consequence(results.findings):
        if finding.severity != 'info' and finding.id not in NO_STEP:
            remedies.setdefault(texts_of(finding).remedy, []).extend(finding.axes)
    for remedy, axes in remedies.items():
        axes_text = f' ({_axes_text(axes, results)})' if axes else ''
        yield f'{remedy.rstrip(".")}{axes_text}.'
    advice = results.time_to_record
    if advice is not None:
        seconds, terms = advice
        time = duration_text(seconds)
        yield f'Record {time} at rest, warmed up, to resolve or bound {_joined(terms)}.'
    elif results.is_too_short and level == 'unknown' and not remedies:
        yield 'Record at least a minute at rest.'
    if not comparisons and results.is_measured:
        yield 'Compare with a datasheet (--sensor NAME) or an earlier run (--baseline FILE).'
    if level in ('healthy', 'attention', 'measured'):
        yield 'Write a file for a filter: allan export FOLDER --to openvins.'
        if results.motion is None and not any('motion' in f.id for f in results.findings):
            yield 'For the noise in motion, record drives between rests (docs/motion.md).'


def datasheet_title(results: Results) -> str:
    """Return a text that names the limits of the coefficients: 'the datasheet of X plus 20 %'.

    The results must have a datasheet. A margin of 0 is not named.
    """
    assert results.datasheet is not None
    margin = f' plus {100.0 * results.margin:.3g} %' if results.margin else ''
    return f'the datasheet of {results.datasheet.name}{margin}'


def further_steps(results: Results, verdict: Verdict) -> list[str]:
    """Return the next steps of a verdict except the remedies of findings."""
    remedies = tuple(r for f in results.findings if (r := texts_of(f).remedy.rstrip('.')))
    return [step for step in verdict.next_steps if not step.startswith(remedies)]


def findings_and_notes(results: Results) -> tuple[list[Finding], list[Finding]]:
    """Return the findings that affect the data or the numbers, and the notes.

    Findings of several axes that differ only in numbers are merged. Both lists begin with the
    findings that affect the user most (`by_consequence`).
    """
    findings = grouped(results.findings)
    return [f for f in findings if not is_note(f)], [f for f in findings if is_note(f)]


def finding_text(finding: Finding, results: Results, units: str) -> str:
    """Return the axes and the message of a finding: 'gyro x, accel: Vibration at ...'."""
    return where(finding, results) + texts_of(finding, units).message


def where(finding: Finding, results: Results) -> str:
    """Return the axes of a finding as the start of a text: 'gyro x, accel: '; '' without axes."""
    return f'{_axes_text(finding.axes, results)}: ' if finding.axes else ''


def _axis(axis: str) -> str:
    return f'{sensor_of(axis)} {axis.rsplit("_", 1)[1]}'


def _axes_text(axes: Sequence[str], results: Results) -> str:
    """Return axes as text: 'gyro x', 'gyro' for all axes of the gyro, or 'all axes'."""
    if set(axes) >= set(results.axes):
        return 'all axes'
    words: list[str] = []
    for sensor, rows in SENSORS.items():
        present_axes = [axis for axis in AXES[rows] if axis in results.axes]
        named_axes = [axis for axis in AXES[rows] if axis in axes]
        words += [sensor] if len(named_axes) == len(present_axes) > 1 else map(_axis, named_axes)
    return ', '.join(words)


def _joined(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f'{", ".join(words[:-1])} and {words[-1]}'


SHOWN_UNUSED_SHARE = 0.01
"""The number of received samples is also shown if more than this fraction of them is unused."""


def used_samples(results: Results) -> str:
    """Return the number of used samples as text, such as '60,000 samples'.

    If more than `SHOWN_UNUSED_SHARE` of the received samples are unused, the text also states the
    number of received samples: '737,856 of 1,000,000 samples'. This number is omitted if
    ``provenance.counts`` also includes a second sensor stream, or samples that the fit excludes,
    and these samples are more than `SHOWN_UNUSED_SHARE` of ``counts.used``.
    """
    used, counts = results.samples, results.provenance.counts
    least_used_share = 1.0 - SHOWN_UNUSED_SHARE
    counts_contain_others = used < least_used_share * counts.used
    shows_total = not counts_contain_others and used < least_used_share * counts.received
    total = f' of {counts.received:,}' if shows_total else ''
    return f'{used:,}{total} samples'


def headline(results: Results) -> str:
    """Return one line: name of the IMU, samples, rate, time at rest, segments and fit method."""
    name = results.identity.label or 'IMU'
    return (
        f'{name}: {used_samples(results)} at {results.rate_hz:.5g} Hz, '
        f'{duration_text(results.duration_s, 3)} of static data in {results.segments:,} '
        f'segment{"" if results.segments == 1 else "s"}, fitted by {results.method}'
    )


def summary_lines(results: Results) -> Iterator[str]:
    """Yield the lines of a summary: headline, N, B and K of each axis, warnings and errors."""
    yield headline(results)
    yield from terminal_lines(axis_table(results.noise, 'deg/h', ADVISED_TERMS), WIDE)
    for each in warnings_and_errors(results):
        yield f'  {each.severity}: {finding_line(each)}'
