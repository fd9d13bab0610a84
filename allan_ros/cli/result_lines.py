# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results and comparisons as text for a terminal: verdict, tables, findings, next steps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from ..core.check import Check, Judgement, worst_verdict
from ..core.errors import AllanError
from ..core.estimate import LIMIT_DIGITS, NOTHING_KNOWN, significant
from ..core.imu import AXES, SENSORS, ShownUnit, sensor_of, shown_unit
from ..results.measured import against_measured, measured_check_text
from ..results.results import Level, Results
from ..view.coefficient_table import coefficient_cell, coefficient_table
from ..view.comparison import runs_table, sentences
from ..view.finding_text import texts_of
from ..view.format import deviation_text, temperature_text
from ..view.model_table import filter_table
from ..view.table import Cell, Heading, Table, terminal_lines
from ..view.verdict_text import (
    VERDICT_WORDS,
    Verdict,
    datasheet_title,
    finding_text,
    findings_and_notes,
    further_steps,
    headline,
)
from .console import SEVERITY_COLORS, painted, wrapped

if TYPE_CHECKING:
    from ..results.comparison import RunComparison

LEVEL_COLORS: dict[Level, str] = {
    'healthy': '1;32',
    'attention': '1;33',
    'measured': '1;36',
    'unknown': '1;36',
    'failed': '1;31',
}
"""Level of a verdict -> ANSI color: bold green, yellow, cyan or red."""

HEADLINES: dict[Judgement | None, str] = {
    'within': 'all stated limits are met',
    'undecided': 'no limit is exceeded; some intervals contain the limit',
    'exceeds': 'a limit is exceeded',
    None: 'it states no limit for the measured terms',
}
"""Worst verdict of the comparisons with a datasheet, or None without comparisons -> text that is
shown for it."""


def datasheet_lines(results: Results, units: str, columns: int) -> Iterator[str]:
    """Yield the lines of a comparison with a datasheet: a headline, then one entry for each limit.

    An entry is for all axes of a sensor that have the same limit of a term. ``units`` is 'deg/h' or
    'SI', and ``columns`` is the width of the text in characters. Without a datasheet, there are no
    lines.
    """
    sheet, checks = results.datasheet, results.datasheet_checks
    if sheet is None:
        return
    summary = 'not judged' if results.is_too_short else HEADLINES[worst_verdict(checks)]
    headline = f'compared with {datasheet_title(results)}: {summary}'
    yield from wrapped(headline, columns, '  ')
    groups: dict[tuple[str, str, float], list[Check]] = {}
    for c in checks:
        groups.setdefault((sensor_of(c.axis), c.quantity, c.limit), []).append(c)
    for group in groups.values():
        stated = sheet.limits[group[0].axis][group[0].quantity].stated
        yield from wrapped(_line(group, stated, units), columns, ' ' * 9)


def _line(group: list[Check], stated: str, units: str) -> str:
    first = group[0]
    unit = shown_unit(first.axis, first.quantity, units)
    limit = f'{significant(first.limit * unit.factor, LIMIT_DIGITS)} {unit.name}'
    axes: dict[Judgement, list[str]] = {}
    for c in group:
        axes.setdefault(c.verdict, []).append(c.axis[-1])
    verdicts = ', '.join(f'{" ".join(names)} {v}' for v, names in axes.items())
    sensor = sensor_of(first.axis)
    return f'{sensor:5} {first.quantity}  {verdicts}: limit {limit} (stated {stated})'


DEVIATION = 'deviation'
"""Label of the last row of a table of coefficients."""

MOST_FINDINGS, MOST_NEXT_STEPS = 5, 4
"""Largest numbers of printed findings (without ``--verbose``) and of printed next steps."""


def results_lines(
    results: Results,
    verdict: Verdict,
    units: str,
    columns: int,
    colors: bool = False,
    complete: bool = False,
) -> Iterator[str]:
    """Yield the results as lines of text.

    The lines contain the verdict, the coefficients, the bias over temperature, the numbers for a
    state estimator, the comparison with a datasheet, the findings, and the next steps. Parts that
    are not known are omitted.

    Parameters
    ----------
    results : Results
        The results.
    verdict : Verdict
        Verdict on the results.
    units : str
        'deg/h' or 'SI'.
    columns : int
        Width of the text in characters; the headings are not wrapped.
    colors : bool
        Whether the text contains ANSI colors.
    complete : bool
        Whether all findings are included, not only the most important ones.
    """
    yield from wrapped(headline(results), columns, '  ')
    yield from verdict_lines(verdict, columns, colors)
    for sensor, rows in SENSORS.items():
        axes = [axis for axis in AXES[rows] if axis in results.axes]
        fitted_axes = [axis for axis in axes if _has_numbers(results, axis)]
        if fitted_axes:
            noise_of_axes = {axis: results.axes[axis].fit.noise for axis in fitted_axes}
            table = coefficient_table(noise_of_axes, units, prefixes=True)
            deviations = [Cell(_deviation(results, axis)) for axis in fitted_axes]
            table = table.with_rows((Heading(DEVIATION), deviations))
            yield from ('', *terminal_lines(_known_rows(table), columns))
        if len(fitted_axes) < len(axes):
            names_without_fit = ', '.join(axis[-1] for axis in axes if axis not in fitted_axes)
            if not fitted_axes:
                yield ''
            yield f'{sensor} {names_without_fit}: no coefficients'
    yield from _temperature_lines(results, units, columns)
    yield from _filter_lines(results, columns)
    if any(_has_numbers(results, axis) for axis in results.axes):
        yield from ('', *wrapped(_legend(results), columns))
    if results.datasheet is not None:
        yield from ('', *datasheet_lines(results, units, columns))
    yield from findings_lines(results, units, columns, colors, complete)
    yield from _step_lines(results, verdict, columns)


def _temperature_lines(results: Results, units: str, columns: int) -> Iterator[str]:
    for sensor, models in results.temperature_models.items():
        first = next(iter(models.values()))
        title = f'{sensor} bias from {first.lowest:.1f} to {first.highest:.1f} degC'
        yield from ('', *wrapped(f'{title}: {temperature_text(models, units)}', columns, '  '))


def _has_numbers(results: Results, axis: str) -> bool:
    noise = results.axes[axis].fit.noise.values()
    return any(coefficient_cell(c, ShownUnit('', 1.0)).text != NOTHING_KNOWN for c in noise)


def verdict_lines(verdict: Verdict, columns: int, colors: bool = False) -> list[str]:
    """Return the level and the summary of a verdict as lines, wrapped to ``columns`` characters."""
    word = VERDICT_WORDS[verdict.level].lower()
    lines = wrapped(f'{word}: {verdict.summary}', columns, '  ')
    return [painted(lines[0], word, LEVEL_COLORS[verdict.level], colors), *lines[1:]]


def findings_lines(
    results: Results, units: str, columns: int, colors: bool, complete: bool
) -> Iterator[str]:
    """Yield the findings with their remedies as lines of text.

    Parameters
    ----------
    results : Results
        The results.
    units : str
        'deg/h' or 'SI'.
    columns : int
        Width of the text in characters.
    colors : bool
        Whether the text contains ANSI colors.
    complete : bool
        Whether all findings are included, not only the `MOST_FINDINGS` most important ones.
    """
    main_findings, notes = findings_and_notes(results)
    printed_findings = [*main_findings, *notes][: None if complete else MOST_FINDINGS]
    if printed_findings:
        yield ''
    for each in printed_findings:
        text = (
            f'{each.severity}: {finding_text(each, results, units)} {texts_of(each, units).remedy}'
        )
        lines = wrapped(text, columns, '  ')
        color = SEVERITY_COLORS[each.severity]
        yield from (painted(lines[0], each.severity, color, colors), *lines[1:])
    if hidden_count := len(main_findings) + len(notes) - len(printed_findings):
        yield f'and {hidden_count} more finding{"s" * (hidden_count > 1)}: -v shows all'


def _step_lines(results: Results, verdict: Verdict, columns: int) -> Iterator[str]:
    """Yield the next steps, except for remedies of findings, as lines of text."""
    for i, step in enumerate(further_steps(results, verdict)[:MOST_NEXT_STEPS]):
        if i == 0:
            yield ''
        yield from wrapped(f'{"next:" if i == 0 else "     "} {step}', columns, ' ' * 6)


def _filter_lines(results: Results, columns: int) -> Iterator[str]:
    """Yield lines with the numbers for Kalibr; no lines if these numbers are not known."""
    try:
        table = filter_table(results)
    except AllanError:
        return
    yield from ('', 'numbers for a filter (imu.yaml): SI, noisiest axis')
    yield from terminal_lines(table, columns)


def _legend(results: Results) -> str:
    coefficients = [c for axis in results.axes.values() for c in axis.fit.noise.values()]
    if not any(c.ci95 or c.upper95 for c in coefficients):
        return f'method {results.method} gives no intervals'
    text = '95 % intervals; "<" is the 95 % upper limit of a term that is not resolved'
    any_deviation = any(_deviation(results, axis) != NOTHING_KNOWN for axis in results.axes)
    return text + f'; {DEVIATION}: largest difference of the curve from the model' * any_deviation


def _known_rows(table: Table) -> Table:
    """Return a table without the rows in which no number is known."""
    rows_with_numbers = (
        row for row in table.rows if any(cell.text != NOTHING_KNOWN for cell in row[1])
    )
    return replace(table, rows=[*rows_with_numbers])


SMALL_DEVIATION = 0.05
"""Smallest relative difference between curve and model that is printed."""


def _deviation(results: Results, axis: str) -> str:
    deviation = results.axes[axis].fit.deviation
    is_large = deviation is not None and abs(deviation.relative) >= SMALL_DEVIATION
    return deviation_text(deviation) if is_large and not results.is_too_short else NOTHING_KNOWN


def comparison_lines(comparison: RunComparison, units: str, columns: int) -> Iterator[str]:
    """Yield a comparison of recordings as lines of text.

    The lines are sentences, a table for each sensor, and the comparisons with datasheets and with
    measured values of other IMUs of the same type. ``units`` is 'deg/h' or 'SI', and ``columns`` is
    the width of the text in characters. Labels and comparisons with measured values are not
    wrapped.
    """
    for sentence in sentences(comparison):
        yield from wrapped(sentence, columns, '  ')
    for rows in SENSORS.values():
        axes = [a for a in AXES[rows] if any(a in r.axes for r in comparison.runs.values())]
        if axes:
            yield from ('', *terminal_lines(runs_table(comparison, axes, units), columns))
    if comparison.differences:
        yield ''
        yield from wrapped(
            f'ratios to {comparison.first} with 95 % intervals; "higher" and "lower" are '
            f'significant (at most {100.0 * comparison.family_error:g} % false alarms overall)',
            columns,
        )
    for label, results in comparison.checked:
        yield from ('', label, *datasheet_lines(results, units, columns))
        if results.datasheet and (checks := against_measured(results.datasheet, results)):
            yield f'compared with measured units of {results.datasheet.name}:'
            yield from (f'         {measured_check_text(check)}' for check in checks)
