# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparisons as tables: with limits, with an earlier run, and of several recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from ..core.compare import Check
from ..core.estimate import NOTHING_KNOWN, UNKNOWN, Estimate
from ..core.fit.result import TERMS
from ..core.imu import sensor_of, shown_unit
from ..core.number_text import prefixed
from ..results.comparison import (
    RunComparison,
    ratio_text,
    significant_of,
    verdict_text,
)
from ..results.results import Results
from .coefficient_table import (
    Coefficients,
    axis_headings,
    coefficient_cell,
    largest,
    term_name,
)
from .format import NO_BREAK, pretty_unit
from .table import Cell, Heading, Table


def limit_table(
    axes: Coefficients, comparisons: Sequence[Check], units: str, stated: Mapping[str, str]
) -> Table:
    """Return the coefficients of one sensor, each with its part of a limit and the verdict.

    ``stated`` maps a term to its limits as text. A term without a limit has no row.
    """

    def part(check: Check) -> str:
        coefficient = axes[check.axis][check.quantity]
        resolved = coefficient.resolved
        size = coefficient.magnitude.value if resolved else coefficient.upper95
        share = f'{100.0 * size / check.limit:.0f}{NO_BREAK}% of the limit' if size else ''
        return share if resolved or not share else f'< {share}'

    notes = {term: f'stated {text}' for term, text in stated.items()}
    return _checks_table(axes, comparisons, units, notes, part)


def baseline_table(
    axes: Coefficients, comparisons: Sequence[Check], units: str, before: Results
) -> Table:
    """Return the coefficients of one sensor, each with its former value and the verdict."""

    def former(check: Check) -> str:
        unit = shown_unit(check.axis, check.quantity, units)
        cell = coefficient_cell(before.axes[check.axis].fit.noise[check.quantity], unit)
        return f'before: {cell.text.replace(" ", NO_BREAK)}'

    return _checks_table(axes, comparisons, units, {}, former)


def _checks_table(
    axes: Coefficients,
    comparisons: Sequence[Check],
    units: str,
    notes: Mapping[str, str],
    detail: Callable[[Check], str],
) -> Table:
    """Return the coefficients that are compared; ``detail`` returns the detail of a cell.

    ``notes`` maps terms to explanations that replace the names in the headings.
    """
    sensor = sensor_of(next(iter(axes)))
    rows = []
    for term in TERMS:
        checks = {c.axis: c for c in comparisons if c.quantity == term and c.axis in axes}
        unit = shown_unit(sensor, term, units)
        cells = [
            Cell(
                coefficient_cell(axes[axis][term], unit).text,
                detail(checks[axis]),
                status=checks[axis].verdict,
            )
            if axis in checks
            else Cell()
            for axis in axes
        ]
        if checks:
            note = notes.get(term) or term_name(sensor, term)
            rows.append((Heading(term, unit.name, note), cells))
    return Table(Heading('term'), axis_headings(axes), rows)


def runs_table(comparison: RunComparison, axes: Sequence[str], units: str) -> Table:
    """Return the coefficients of several recordings for the axes of one sensor.

    Each term has a row for each recording and the ratios to the first one; terms that no recording
    measures are left out. The last rows count the deviations of the curve that differ.
    """
    sensor = sensor_of(axes[0])
    rows: list[tuple[Heading, list[Cell]]] = []
    for term in TERMS:
        known = {run: _of_axes(each, axes, term) for run, each in comparison.runs.items()}
        size = largest([c for of_run in known.values() for c in of_run])
        unit = prefixed(shown_unit(sensor, term, units), size)
        cells = {run: [coefficient_cell(c, unit) for c in of_run] for run, of_run in known.items()}
        if all(cell.text == NOTHING_KNOWN for of_run in cells.values() for cell in of_run):
            continue
        for i, (run, of_run) in enumerate(cells.items()):
            heading = Heading('') if i else Heading(term, unit.name)
            rows.append((heading, [Cell(run), *of_run]))
        for run, checks in comparison.differences.items():
            of_axis = {d.axis: d for d in checks if d.quantity == term}
            ratios = [of_axis.get(axis) for axis in axes]
            texts = [f'{ratio_text(d)} {verdict_text(d)}'.strip() if d else '' for d in ratios]
            rows.append((Heading(''), [Cell(f'{run} ratio'), *map(Cell, texts)]))
    for run, checks in comparison.differences.items():
        counts = [Cell(run)]
        for axis in axes:
            tested = [d for d in checks if d.axis == axis and d.tau is not None]
            differ = len(significant_of(tested))
            counts.append(Cell(f'{differ} of {len(tested)} differ' if tested else ''))
        rows.append((Heading('deviation'), counts))
    runs = Heading('', repeats=True)
    return Table(Heading(sensor), [runs, *(Heading(axis[-1]) for axis in axes)], rows)


def _of_axes(results: Results, axes: Sequence[str], term: str) -> list[Estimate]:
    known = results.axes
    return [known[axis].fit.noise[term] if axis in known else UNKNOWN for axis in axes]


def stated_limits(texts: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return term -> its limits as one text, such as '0.3 °/√h / 0.4 °/√h', without repetition."""
    return {
        term: ' / '.join(dict.fromkeys(pretty_unit(text) for text in each)).replace(' ', NO_BREAK)
        for term, each in texts.items()
    }
