# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results and comparisons as text for a terminal: verdict, tables, findings, next steps."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence

from ..core.compare import Comparison, LimitVerdict
from ..core.fit import TERMS, Coefficient
from ..core.fit.findings import SMALL_DEVIATION
from ..core.imu import AXES, SENSORS, sensor_of
from ..io.comparison import RunComparison, comparison_headline, ratio_text, verdict_text
from ..io.datasheets import VERDICT_TEXT, DatasheetComparison
from ..io.format import (
    ShownUnit,
    deviation_text,
    interval_text,
    region_text,
    shown_unit,
    significant,
    value_text,
)
from ..io.results import Results
from ..io.verdict import (
    WORDS,
    Level,
    Verdict,
    finding_text,
    findings_and_notes,
    headline,
    too_short,
)
from .console import SEVERITY_COLORS, painted, wrapped

LEVEL_COLORS: dict[Level, str] = {
    'healthy': '1;32',
    'attention': '1;33',
    'unknown': '1;36',
    'failed': '1;31',
}
"""Level of a verdict -> ANSI color: bold green, yellow, cyan, red."""

HEADLINES: dict[LimitVerdict | None, str] = {
    'within': 'all stated limits are met',
    'open': 'no limit is exceeded; some intervals contain the limit',
    'beyond': 'a limit is exceeded',
    None: 'it states no limit for the measured terms',
}

LIMIT_DIGITS = 3
"""Significant digits of a limit, as in the tables of intervals."""


def datasheet_lines(
    comparison: DatasheetComparison, units: str, columns: int, judged: bool = True
) -> Iterator[str]:
    """Yield the lines of a comparison with a datasheet: a headline, then one entry per limit.

    ``units`` is 'deg/h' or 'SI', ``columns`` the width of the text. ``judged`` is False if the
    results are too short for a verdict.
    """
    sheet = comparison.datasheet
    found = HEADLINES[comparison.verdict] if judged else 'not judged'
    headline = f'compared with the datasheet of {sheet.name}: {found}'
    yield from wrapped(headline, columns, '  ')
    groups: dict[tuple[str, str, float], list[Comparison]] = {}
    for c in comparison.comparisons:  # axes of one sensor with the same limit of a term
        groups.setdefault((sensor_of(c.axis), c.term, c.limit), []).append(c)
    for group in groups.values():
        stated = comparison.limit(group[0]).stated
        yield from wrapped(_line(group, stated, units), columns, ' ' * 9)


def _line(group: list[Comparison], stated: str, units: str) -> str:
    first = group[0]
    unit = shown_unit(first.axis, first.term, units)
    limit = f'{significant(first.limit * unit.factor, LIMIT_DIGITS)} {unit.name}'
    axes: dict[LimitVerdict, list[str]] = {}
    for c in group:
        axes.setdefault(c.verdict, []).append(c.axis[-1])
    verdicts = ', '.join(f'{" ".join(names)} {VERDICT_TEXT[v]}' for v, names in axes.items())
    sensor = sensor_of(first.axis)
    return f'{sensor:5} {first.term}  {verdicts}: limit {limit} (stated {stated})'


LABEL, GAP = 16, 2
"""Width of the first column, and space between the columns of two axes, in characters."""

DEVIATION, NOTHING = 'deviation', '-'
"""Label of the last row, and its text for a curve that the model describes well."""

MOST_FINDINGS, MOST_STEPS = 5, 4
"""Largest number of findings without ``--verbose``, and of next steps."""


def results_lines(
    results: Results,
    verdict: Verdict,
    units: str,
    columns: int,
    colors: bool = False,
    complete: bool = False,
) -> Iterator[str]:
    """Yield the lines of the results: headline, verdict, tables, findings, next steps.

    ``units`` is 'deg/h' or 'SI', ``columns`` the width of the text, ``colors`` whether to
    color it; ``complete`` includes all findings and their remedies.
    """
    yield from wrapped(headline(results), columns, '  ')
    yield from verdict_lines(verdict, columns, colors)
    for sensor, where in SENSORS.items():
        axes = [axis for axis in AXES[where] if axis in results.axes]
        cells = [
            [*axis_cells(a, results.axes[a].fit.noise, units), _deviation(results, a)] for a in axes
        ]
        yield from table_lines([*term_labels(sensor, units), DEVIATION], cells, columns)
    if any(a.regions for a in results.axes.values()):
        yield ''
        yield 'dominant noise by averaging time, and slope of the curve'
        yield from _region_lines(results, columns)
    yield ''
    yield from wrapped(_legend(results), columns)
    if results.datasheet is not None:
        yield ''
        judged = not too_short(results)
        yield from datasheet_lines(results.datasheet, units, columns, judged)
    yield from findings_lines(results, units, columns, colors, complete)
    for i, step in enumerate(verdict.next_steps[:MOST_STEPS]):
        if i == 0:
            yield ''
        yield from wrapped(f'{"next:" if i == 0 else "     "} {step}', columns, ' ' * 6)


def verdict_lines(verdict: Verdict, columns: int, colors: bool = False) -> list[str]:
    """Return the lines of the level and the summary of a verdict, wrapped to ``columns``."""
    word = WORDS[verdict.level].lower()
    lines = wrapped(f'{word}: {verdict.summary}', columns, '  ')
    return [painted(lines[0], word, LEVEL_COLORS[verdict.level], colors), *lines[1:]]


def findings_lines(
    results: Results, units: str, columns: int, colors: bool, complete: bool
) -> Iterator[str]:
    """Yield the first findings, one per line; with ``complete``, all with their remedies."""
    shown, notes = findings_and_notes(results)
    if not shown and not notes:
        return
    yield ''
    first = [*shown, *notes]
    if len(first) > MOST_FINDINGS and not complete:
        first = shown[: MOST_FINDINGS - (bool(notes) or len(shown) > MOST_FINDINGS)]
    for finding in first:
        color = SEVERITY_COLORS[finding.severity]
        line = f'{finding.severity}: {finding_text(finding, results, units)}'
        if complete:
            lines = wrapped(f'{line} {finding.texts(units).remedy}', columns, '  ')
        else:
            lines = [textwrap.shorten(line, columns - 1, placeholder=' ...')]
        yield from (painted(lines[0], finding.severity, color, colors), *lines[1:])
    left = {
        'warning': sum(f not in first for f in shown),
        'note': sum(f not in first for f in notes),
    }
    hidden = [f'{n} {word}{"" if n == 1 else "s"}' for word, n in left.items() if n]
    if hidden:
        yield f'and {" and ".join(hidden)}: -v shows all, with remedies'


def _legend(results: Results) -> str:
    known = [c for axis in results.axes.values() for c in axis.fit.noise.values()]
    if not any(c.ci95 or c.upper95 for c in known):
        return f'method {results.method} gives no intervals'
    text = '95 % intervals; "<" is the 95 % upper limit of a term that is not resolved'
    likely = any(axis.fit.likely and axis.regions for axis in results.axes.values())
    processes = any('GM' in r.term for axis in results.axes.values() for r in axis.regions)
    text += '; "?" is a part of the model that is likely but not resolved' * likely
    return text + '; "GM" is a Gauss-Markov process with its correlation time' * processes


def term_labels(sensor: str, units: str) -> list[str]:
    """Return the first column of a table of noise terms: the sensor, then terms with units."""
    return [sensor, *(f'{term} {shown_unit(sensor, term, units).name}' for term in TERMS)]


def axis_cells(axis: str, noise: Mapping[str, Coefficient], units: str) -> list[str]:
    """Return the column of one axis: x, y or z, then the values with their intervals."""
    shown = [(noise[term], shown_unit(axis, term, units)) for term in TERMS]
    return [axis[-1], *(coefficient_cell(c, unit) for c, unit in shown)]


def coefficient_cell(coefficient: Coefficient, unit: ShownUnit) -> str:
    """Return the value, padded to a fixed width, and its interval."""
    return f'{value_text(coefficient, unit):9} {interval_text(coefficient, unit)}'


def _deviation(results: Results, axis: str) -> str:
    deviation = results.axes[axis].fit.deviation
    large = deviation is not None and abs(deviation.relative) >= SMALL_DEVIATION
    return deviation_text(deviation) if large and not too_short(results) else NOTHING


def table_lines(
    labels: Sequence[str], columns: Sequence[Sequence[str]], width: int
) -> Iterator[str]:
    """Yield a table with a first column of labels, split into blocks of at most ``width``."""
    if not columns:
        return
    label = max(LABEL, *(len(text) + GAP for text in labels))
    cell = max(len(text) for column in columns for text in column) + GAP
    across = max(1, (width - label + GAP) // cell)
    for at in range(0, len(columns), across):
        yield ''
        for text, *row in zip(labels, *columns[at : at + across]):
            if all(entry == NOTHING for entry in row) and text == DEVIATION:
                continue
            yield (f'{text:{label}}' + ''.join(f'{entry:{cell}}' for entry in row)).rstrip()


def _region_lines(results: Results, columns: int) -> Iterator[str]:
    for axis, result in results.axes.items():
        if not result.regions:
            continue
        reading = ', '.join(region_text(r, result.fit.likely) for r in result.regions)
        yield from wrapped(f'{axis:{len("accel_x")}}  {reading}', columns, ' ' * 9)


def comparison_lines(comparison: RunComparison, units: str, columns: int) -> Iterator[str]:
    """Yield the lines of a comparison: sentences, a table per sensor, and limits of datasheets."""
    for sentence in comparison_headline(comparison):
        yield from wrapped(sentence, columns, '  ')
    for sensor, where in SENSORS.items():
        axes = [a for a in AXES[where] if any(a in r.results.axes for r in comparison.runs)]
        labels = [sensor, *_run_labels(comparison, sensor, units)]
        cells = [[a[-1], *_run_cells(comparison, a, units)] for a in axes]
        yield from table_lines(labels, cells, columns)
    if comparison.pairs:
        yield ''
        yield from wrapped(
            f'ratios to {comparison.runs[0].label} with 95 % intervals; "higher" and "lower" are '
            f'significant (at most {100.0 * comparison.family_error:g} % false alarms overall)',
            columns,
        )
    for label, checked in comparison.datasheets:
        yield ''
        yield label
        yield from datasheet_lines(checked, units, columns)


def _run_labels(comparison: RunComparison, sensor: str, units: str) -> Iterator[str]:
    for label in term_labels(sensor, units)[1:]:
        for i, subject in enumerate(comparison.runs):
            yield f'{"" if i else label:{LABEL}}{subject.label}'
        yield from (f'{"":{LABEL}}{pair.second} ratio' for pair in comparison.pairs)
    yield from (f'{DEVIATION} {pair.second}' for pair in comparison.pairs)


def _run_cells(comparison: RunComparison, axis: str, units: str) -> Iterator[str]:
    """Yield the cells of one axis: values and ratios, then counts of significant deviations."""
    for term in TERMS:
        unit = shown_unit(axis, term, units)
        for subject in comparison.runs:
            result = subject.results.axes.get(axis)
            yield coefficient_cell(result.fit.noise[term], unit).rstrip() if result else ''
        for difference in (pair.of(axis, term) for pair in comparison.pairs):
            text = difference and f'{ratio_text(difference)} {verdict_text(difference)}'
            yield (text or '').strip()
    for pair in comparison.pairs:
        tested = [d for d in pair.differences if d.axis == axis and d.tau is not None]
        differ = sum(d.significant for d in tested)
        yield f'{differ} of {len(tested)} differ' if tested else ''
