# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What `analyze` and `merge` say in the terminal: the coefficients, then what to know and do."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from typing import TextIO

from ..core.compare import Verdict
from ..core.fit import TERMS
from ..core.imu import AXES, SENSORS, sensor_of
from ..io.datasheet_comparison import VERDICT_TEXT, DatasheetComparison, LimitCheck
from ..io.format import (
    interval_text,
    region_text,
    shown_unit,
    significant,
    value_text,
)
from ..io.results import Results
from ..io.summary import headline
from .console import coloured, finding_lines, width, wrapped

HEADLINES: dict[Verdict | None, str] = {
    'within': 'all that it states is kept',
    'open': 'nothing is beyond it; some intervals still hold the limit',
    'beyond': 'not all that it states is kept',
    None: 'it states nothing of what was measured',
}


LIMIT_DIGITS = 3
"""Significant digits of a limit, as in the tables of intervals."""


def datasheet_lines(comparison: DatasheetComparison, units: str, columns: int) -> Iterator[str]:
    """Yield a headline, and a line for each limit: what is stated, and how each axis stands."""
    sheet = comparison.datasheet
    headline = f'beside the datasheet of {sheet.name}: {HEADLINES[comparison.verdict]}'
    yield from wrapped(headline, columns, '  ')
    for group in _by_limit(comparison).values():
        yield from wrapped(_line(group, units), columns, ' ' * 9)


def _by_limit(comparison: DatasheetComparison) -> dict[tuple[str, str, float], list[LimitCheck]]:
    """Return the axes of one sensor that share a limit of a term together."""
    groups: dict[tuple[str, str, float], list[LimitCheck]] = {}
    for held in comparison.held:
        key = sensor_of(held.axis), held.term, held.limit.value
        groups.setdefault(key, []).append(held)
    return groups


def _line(group: list[LimitCheck], units: str) -> str:
    first = group[0]
    unit = shown_unit(first.axis, first.term, units)
    limit = f'{significant(first.limit.value * unit.factor, LIMIT_DIGITS)} {unit.name}'
    stood: dict[Verdict, list[str]] = {}
    for held in group:
        stood.setdefault(held.verdict, []).append(held.axis.rsplit('_', 1)[1])
    verdicts = ', '.join(f'{" ".join(axes)} {VERDICT_TEXT[v]}' for v, axes in stood.items())
    sensor = sensor_of(first.axis)
    return f'{sensor:5} {first.term}  {verdicts}: limit {limit} (stated {first.limit.stated})'


LABEL, GAP = 16, 2
"""Characters of the first column, and between the columns of two axes."""


MISFIT, NOTHING = 'misfit', '-'
"""Label of the last row, which is left out where the five terms describe every curve."""


def print_results(results: Results, units: str, stream: TextIO | None = None) -> None:
    """Print the results as wide as the terminal is."""
    stream = sys.stdout if stream is None else stream
    for line in results_lines(results, units, width(), coloured(stream)):
        print(line, file=stream)


def results_lines(
    results: Results, units: str, columns: int, colours: bool = False
) -> Iterator[str]:
    """Yield the lines of the report: headline, tables, reading of the curves, findings."""
    yield from wrapped(headline(results), columns, '  ')
    for sensor, where in SENSORS.items():
        axes = [_column(results, axis, units) for axis in AXES[where] if axis in results.axes]
        if axes:
            yield from table_lines(_labels(sensor, units), axes, columns)
    if any(a.regions for a in results.axes.values()):
        yield ''
        yield from _reading_lines(results, columns)
    yield ''
    yield from wrapped(_legend(results), columns)
    if results.datasheet is not None:
        yield ''
        yield from datasheet_lines(results.datasheet, units, columns)
    for finding in results.findings:
        yield ''
        yield from finding_lines(finding, columns, colours)


def _legend(results: Results) -> str:
    known = [c for axis in results.axes.values() for c in axis.fit.noise.values()]
    if not any(c.ci95 or c.upper95 for c in known):
        return f'method {results.method} gives no intervals and no verdicts'
    return '95 % intervals; "<": not observable in this much data, the 95 % upper limit is given'


def _labels(sensor: str, units: str) -> list[str]:
    terms = [f'{term} {shown_unit(sensor, term, units).name}' for term in TERMS]
    return [sensor, *terms, MISFIT]


def _column(results: Results, axis: str, units: str) -> list[str]:
    fit = results.axes[axis].fit
    cells = [axis.rsplit('_', 1)[1]]
    for term in TERMS:
        unit, coefficient = shown_unit(axis, term, units), fit.noise[term]
        cells.append(f'{value_text(coefficient, unit):9} {interval_text(coefficient, unit)}')
    return [*cells, f'{fit.misfit:.0%}' if fit.misfit > 0.0 else NOTHING]


def table_lines(
    labels: Sequence[str], columns: Sequence[Sequence[str]], width: int
) -> Iterator[str]:
    """Yield the columns beside each other, as many at a time as the width holds."""
    label = max(LABEL, *(len(text) + GAP for text in labels))
    cell = max(len(text) for column in columns for text in column) + GAP
    across = max(1, (width - label + GAP) // cell)
    for at in range(0, len(columns), across):
        yield ''
        for text, *row in zip(labels, *columns[at : at + across]):
            if all(entry == NOTHING for entry in row) and text == MISFIT:
                continue
            yield (f'{text:{label}}' + ''.join(f'{entry:{cell}}' for entry in row)).rstrip()


def _reading_lines(results: Results, columns: int) -> Iterator[str]:
    for axis, result in results.axes.items():
        if not result.regions:
            continue
        reading = ', '.join(region_text(region) for region in result.regions)
        yield from wrapped(f'{axis:{len("accel_x")}}  {reading}', columns, ' ' * 9)
