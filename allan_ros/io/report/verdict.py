# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The verdict in plain words: is the IMU fine, was the record long enough, what to do next."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from ...core.compare import Comparison
from ...core.findings import Finding
from ...core.fit import TERMS
from ...core.fit.findings import FARTHEST, about, record_times
from ...core.imu import AXES, SENSORS, sensor_of
from ..format import duration_text, pretty_unit, shown_unit, significant, value_text
from ..results import Results

Light = Literal['good', 'caution', 'bad']

WORDS: dict[Light, str] = {'good': 'Good', 'caution': 'With care', 'bad': 'Not good'}
"""Light -> the word beside it: colour alone says nothing to many."""

UNCOMPARED, UNMEASURED = 'Nothing wrong found', 'Not measured'
"""Instead of 'Good' where nothing says what would be good, of 'Not good' where nothing is known."""

FOR_FILTERS = ('N', 'B', 'K')
"""The terms that filters take; Q and R are asked for by few."""

ODD_AXIS = 2.0
"""Axes of one sensor differ by less in N; more is worth a look at that axis."""

NO_STEP = ('file_left_out',)
"""Findings after which there is nothing to do."""

LISTED = 3
"""How many coefficients are named before the rest is only counted."""


@dataclass(frozen=True)
class Verdict:
    """What a report says first.

    Attributes
    ----------
    light : 'good', 'caution' or 'bad'
    word : str
        The light in words.
    fine, long_enough : str
        Answers to "Is this IMU fine?" and "Was the recording long enough?".
    steps : tuple of str
        What to do next, the most pressing first.
    """

    light: Light
    word: str
    fine: str
    long_enough: str
    steps: tuple[str, ...]


def verdict_of(results: Results, comparisons: Sequence[Comparison], units: str) -> Verdict:
    """Return the verdict on an IMU and its record.

    Parameters
    ----------
    results : Results
    comparisons : sequence of Comparison
        With its datasheet and former runs; empty where there is nothing to hold it against.
    units : 'datasheet' or 'si'
    """
    light = _light(results, comparisons)
    return Verdict(
        light,
        _word(light, results, comparisons),
        ' '.join(_fine(results, comparisons, units)),
        ' '.join(_long_enough(results)),
        tuple(dict.fromkeys(_steps(results, comparisons))),
    )


def measured(results: Results) -> bool:
    """Tell whether any coefficient of any axis has a value."""
    return any(
        c.value is not None and c.status == 'estimated'
        for axis in results.axes.values()
        for c in axis.fit.noise.values()
    )


def _light(results: Results, comparisons: Sequence[Comparison]) -> Light:
    severities = {finding.severity for finding in results.findings}
    if not measured(results) or 'error' in severities:
        return 'bad'
    verdicts = {comparison.verdict for comparison in comparisons}
    if 'beyond' in verdicts:
        return 'bad'
    return 'caution' if 'warning' in severities else 'good'


def _word(light: Light, results: Results, comparisons: Sequence[Comparison]) -> str:
    if not measured(results):
        return UNMEASURED
    return UNCOMPARED if light == 'good' and not comparisons else WORDS[light]


def _fine(results: Results, comparisons: Sequence[Comparison], units: str) -> Iterator[str]:
    """Yield the sentences that answer whether the IMU is fine."""
    if not measured(results):
        yield 'Nothing could be measured; the findings below say why.'
        return
    if not comparisons:
        yield (
            'It cannot be told from these numbers alone: name its datasheet with --sensor, or an '
            'earlier run with --baseline.'
        )
    for reference in dict.fromkeys(c.reference for c in comparisons):
        yield _against(results, [c for c in comparisons if c.reference == reference], units)
    yield from _axes_alike(results)
    bad = sum(finding.severity != 'info' for finding in results.findings)
    if bad:
        yield (
            f'{_count(bad, "finding")} below {"asks" if bad == 1 else "ask"} for a look before '
            'these numbers are used.'
        )


def _against(results: Results, comparisons: Sequence[Comparison], units: str) -> str:
    reference = comparisons[0].reference
    beyond = [c for c in comparisons if c.verdict == 'beyond']
    unsettled = [c for c in comparisons if c.verdict == 'open']
    if beyond:
        named = [_named(results, c, units) for c in beyond[:LISTED]]
        more = f' and {len(beyond) - LISTED} more' if len(beyond) > LISTED else ''
        return f'No: above {reference} {"is" if len(beyond) == 1 else "are"} {_and(named)}{more}.'
    if unsettled:
        named = [f'{c.term} of {_axis(c.axis)}' for c in unsettled[:LISTED]]
        more = f' and {len(unsettled) - LISTED} more' if len(unsettled) > LISTED else ''
        within = len(comparisons) - len(unsettled)
        answer = 'Yes, as far as this record shows' if within else 'It is not settled'
        return (
            f'{answer}: {within} of {len(comparisons)} numbers are surely within {reference}, none '
            f'is surely above; open {"is" if len(unsettled) == 1 else "are"} {_and(named)}{more}.'
        )
    return f'Yes: all {len(comparisons)} numbers are surely within {reference}.'


def _named(results: Results, c: Comparison, units: str) -> str:
    unit = shown_unit(c.axis, c.term, units)
    value = value_text(results.axes[c.axis].fit.noise[c.term], unit)
    limit = significant(c.limit * unit.factor, 3)
    return f'{c.term} of {_axis(c.axis)} ({value} against {limit} {pretty_unit(unit.name)})'


def _axes_alike(results: Results) -> Iterator[str]:
    """Yield how far the axes of each sensor agree: the one thing to go by without a datasheet."""
    for sensor, where in SENSORS.items():
        known = {
            axis: c.value
            for axis in AXES[where]
            if axis in results.axes
            and (c := results.axes[axis].fit.noise['N']).status == 'estimated'
            and c.value
        }
        if len(known) < 2:
            continue
        noisy, quiet = max(known, key=known.__getitem__), min(known, key=known.__getitem__)
        ratio = known[noisy] / known[quiet]
        if ratio > ODD_AXIS:
            yield (
                f'{_axis(noisy).capitalize()} has {ratio:.1f} times the white noise of '
                f'{_axis(quiet)}: look at that axis.'
            )
        else:
            share = math.ceil(100.0 * (ratio - 1.0))
            yield f'The {sensor} axes agree in white noise within {max(share, 1)}\u00a0%.'


def _long_enough(results: Results) -> Iterator[str]:
    """Yield the sentences that answer whether the record was long enough."""
    if not measured(results):
        yield 'There is too little to tell.'
        return
    axes = results.axes
    if not any(c.ci95 for axis in axes.values() for c in axis.fit.noise.values()):
        yield f'Method {results.method} gives no intervals, so it cannot tell; gls can.'
        return
    shown = {
        term: [name for name, a in axes.items() if a.fit.noise[term].status == 'estimated']
        for term in TERMS
    }
    length = duration_text(results.duration_s)
    full = [term for term in FOR_FILTERS if len(shown[term]) == len(axes)]
    if full == list(FOR_FILTERS):
        yield f'Yes: {length} at rest show N, B and K of every axis.'
    else:
        lacking = [
            f'{term} on {len(shown[term])} of {len(axes)}'
            for term in FOR_FILTERS
            if term not in full
        ]
        start = f'For {_and(full)} of every axis: yes. ' if full else ''
        yield f'{start}{length} at rest show {_and(lacking)} axes.'
    wait = time_to_show(results)
    if wait is not None:
        yield f'About {about(wait)} would show what filters take (N, B, K) on every axis.'
    others = [f'{t} on {len(shown[t])}' for t in TERMS if t not in FOR_FILTERS and shown[t]]
    if others:
        yield f'It shows {_and(others)} of {len(axes)} axes besides, which few ask for.'


def time_to_show(results: Results) -> float | None:
    """Return the seconds of record that would show what filters take; None where all shows.

    Terms that would take longer than anybody records, or of which no size is known, are passed
    over: they matter as little as they show.
    """
    if results.method != 'gls':
        return None
    longest = max((span.duration_s for span in results.provenance.spans), default=0.0)
    seconds = longest or results.duration_s
    waits = [
        time.observable
        for axis in results.axes.values()
        for term, time in record_times(axis.fit, axis.tau0, seconds).items()
        if term in FOR_FILTERS
        and axis.fit.noise[term].status == 'not_observable'
        and time.observable is not None
        and time.observable < FARTHEST
    ]
    return max(waits, default=None)


def _steps(results: Results, comparisons: Sequence[Comparison]) -> Iterator[str]:
    """Yield what to do next, the most pressing first."""
    wait = time_to_show(results)
    for severity in ('error', 'warning'):
        remedies: dict[str, list[Finding]] = {}
        for finding in results.findings:
            settled = finding.id in NO_STEP or (finding.id == 'short' and wait is not None)
            if finding.severity == severity and not settled:
                remedies.setdefault(finding.remedy, []).append(finding)
        for remedy, findings in remedies.items():
            axes = dict.fromkeys(axis for finding in findings for axis in finding.axes)
            where = f' ({_axes_text(tuple(axes), results)})' if axes else ''
            yield f'{remedy.rstrip(".")}{where}.'
    if wait is not None:
        yield f'Record about {about(wait)} at rest, warmed up, if a filter needs what is hidden.'
    if not comparisons and measured(results):
        yield 'Hold it against its datasheet: --sensor NAME ("allan sensors" lists them).'
    if _light(results, comparisons) != 'bad':
        yield 'Hand the numbers to a filter: "allan export results.json --to openvins".'


def _axis(axis: str) -> str:
    return f'{sensor_of(axis)} {axis.rsplit("_", 1)[1]}'


def _axes_text(axes: Sequence[str], results: Results) -> str:
    """Return axes by name, or by sensor where all of one are meant."""
    if set(axes) == set(results.axes):
        return 'all axes'
    words: list[str] = []
    for sensor, where in SENSORS.items():
        have = [axis for axis in AXES[where] if axis in results.axes]
        named = [axis for axis in have if axis in axes]
        words += [sensor] if len(named) == len(have) > 1 else map(_axis, named)
    return ', '.join(words)


def _and(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f'{", ".join(words[:-1])} and {words[-1]}'


def _count(number: int, thing: str) -> str:
    return f'{number} {thing}{"" if number == 1 else "s"}'
