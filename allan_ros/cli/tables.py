# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What `analyze` and `merge` say in the terminal: the coefficients, then what to know and do."""

from __future__ import annotations

import os
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from typing import TextIO

from ..core.batch import AXES, SENSORS
from ..core.findings import Finding
from ..core.fit import TERMS
from ..io.results import Results
from ..io.shown import (
    duration_text,
    interval_text,
    region_text,
    shown_unit,
    value_text,
)

LABEL, GAP = 16, 2
"""Characters of the first column, and between the columns of two axes."""

MISFIT, NOTHING = 'misfit', '-'
"""Label of the last row, which is left out where the five terms describe every curve."""

SEVERITY_COLOURS = {'info': '36', 'warning': '33', 'error': '31'}
"""ANSI colours (ECMA-48): cyan, yellow, red."""


def print_results(results: Results, units: str, stream: TextIO | None = None) -> None:
    """Print the results as wide as the terminal is."""
    stream = sys.stdout if stream is None else stream
    width = shutil.get_terminal_size((100, 24)).columns
    coloured = stream.isatty() and 'NO_COLOR' not in os.environ
    for line in results_lines(results, units, width, coloured):
        print(line, file=stream)


def results_lines(
    results: Results, units: str, width: int, coloured: bool = False
) -> Iterator[str]:
    """Yield the lines of the report: headline, tables, reading of the curves, findings."""
    yield headline(results)
    for sensor, where in SENSORS.items():
        columns = [_column(results, axis, units) for axis in AXES[where] if axis in results.axes]
        if columns:
            yield from _table_lines(_labels(sensor, units), columns, width)
    if any(a.regions for a in results.axes.values()):
        yield ''
        yield from _reading_lines(results, width)
    yield ''
    yield _legend(results)
    for finding in results.findings:
        yield ''
        yield from finding_lines(finding, width, coloured)


def headline(results: Results) -> str:
    """Return one line that says what was analysed."""
    segments = len(results.provenance.spans)
    name = results.identity.hardware_id or results.identity.frame_id or 'IMU'
    return (
        f'{name}: {results.samples:,} samples at {results.rate_hz:.5g} Hz, '
        f'{duration_text(results.duration_s)} of evidence in '
        f'{segments} segment{"" if segments == 1 else "s"}, fitted by {results.method}'
    )


def finding_lines(finding: Finding, width: int, coloured: bool = False) -> Sequence[str]:
    """Return a finding wrapped to the width, its severity first."""
    lines = textwrap.wrap(
        f'{finding.severity}: {finding}', max(width - 1, 40), subsequent_indent='  '
    )
    if coloured:
        colour = SEVERITY_COLOURS[finding.severity]
        lines[0] = lines[0].replace(finding.severity, f'\x1b[{colour}m{finding.severity}\x1b[0m', 1)
    return lines


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


def _table_lines(
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


def _reading_lines(results: Results, width: int) -> Iterator[str]:
    for axis, result in results.axes.items():
        if not result.regions:
            continue
        reading = ', '.join(region_text(region) for region in result.regions)
        yield from textwrap.wrap(
            f'{axis:{len("accel_x")}}  {reading}', max(width - 1, 40), subsequent_indent=' ' * 9
        )
