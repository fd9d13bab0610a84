# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of a comparison: JSON, tables, plots, and a report of the first recording."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ..core.compare import MARGIN, Difference
from ..core.errors import one_line
from ..core.fit import TERMS, Coefficient
from ..core.imu import SENSORS, SI_UNITS, sensor_of
from .comparison import (
    Pair,
    RunComparison,
    Subject,
    comparison_document,
    comparison_headline,
    ratio_text,
    verdict_text,
)
from .datasheets import VERDICT_TEXT
from .files import to_json, write_atomic, write_together
from .format import interval_text, markdown_rows, shown_unit, value_text
from .plot_style import PictureSettings, load_style
from .result_files import made_folder

CSV_COLUMNS = (
    *('second', 'axis', 'quantity', 'tau_s', 'unit'),
    *(f'{run}_{part}' for run in ('first', 'second') for part in ('value', 'low', 'high', 'upper')),
    *('ratio', 'ratio_low', 'ratio_high', 'p', 'verdict'),
)
"""One line per comparison, in SI; ``upper`` is the 95 % limit of a term that is not observable."""


def write_comparison(
    folder: str | os.PathLike[str],
    comparison: RunComparison,
    units: str = 'datasheet',
    pictures: PictureSettings = PictureSettings(),
) -> list[Path]:
    """Write comparison.json, .md and .csv and a picture of each sensor; return their paths."""
    from .plot_layout import to_form  # imports matplotlib
    from .plots import comparison_figure

    style = load_style(pictures.plot_style)
    place = made_folder(Path(folder))
    contents: dict[str, str | bytes] = {
        'comparison.json': to_json(comparison_document(comparison)),
        'comparison.md': markdown(comparison, units),
        'comparison.csv': csv_table(comparison),
    }
    for sensor in SENSORS:
        figure = comparison_figure(comparison, sensor, units, style)
        if figure is None:
            continue
        for form in pictures.plot_format:
            contents[f'compare_{sensor}.{form}'] = to_form(figure, form, style)
    write_together(place, contents)
    return [place / name for name in contents]


def markdown(comparison: RunComparison, units: str = 'datasheet') -> str:
    """Return the comparison as Markdown: headlines, then a table for each pair and datasheet."""
    parts = [f'{line}\n' for line in comparison_headline(comparison)]
    for pair in comparison.pairs:
        first, second = _safe(pair.first), _safe(pair.second)
        rows = [['axis', 'quantity', 'unit', first, second, 'ratio', '']]
        for d in pair.differences:
            what = ['' if d.tau is None else f'deviation at {d.tau:.3g} s', '', '', '']
            if d.tau is None:
                unit = shown_unit(d.axis, d.quantity, units)
                both = _coefficients(comparison, pair, d)
                values = (f'{value_text(c, unit)} {interval_text(c, unit)}'.strip() for c in both)
                what = [d.quantity, unit.name, *values]
            rows.append([d.axis, *what, ratio_text(d), verdict_text(d)])
        parts += _section(f'{second} against {first}', rows)
    for label, of_run in comparison.datasheets:
        rows = [['axis', 'term', 'limit', 'stated', '']]
        for c in of_run.comparisons:
            unit = shown_unit(c.axis, c.term, units)
            limit = f'{c.limit * unit.factor:.3g} {unit.name}'
            stated = _safe(of_run.limit(c).stated)
            rows.append([c.axis, c.term, limit, stated, VERDICT_TEXT[c.verdict]])
        parts += _section(
            f'{_safe(label)} and the datasheet of {_safe(of_run.datasheet.name)}', rows
        )
    return '\n'.join(parts)


def _safe(text: str) -> str:
    """Return text of a user that Markdown does not interpret as HTML."""
    return one_line(text).replace('<', '&lt;')


def _section(title: str, rows: list[list[str]]) -> list[str]:
    heading = title.replace('|', '\\|')
    return [f'## {heading}\n', markdown_rows(rows)]


def csv_table(comparison: RunComparison) -> str:
    """Return every comparison of two recordings as CSV, in SI."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(CSV_COLUMNS)
    for pair in comparison.pairs:
        for d in pair.differences:
            term = 'B' if d.tau is not None else d.quantity
            numbers: list[float | None] = []
            for c in _coefficients(comparison, pair, d) if d.tau is None else ():
                known = c.status == 'estimated'
                low, high = c.ci95 or (None, None)
                numbers += [c.value if known else None, low, high, None if known else c.upper95]
            numbers = numbers or [None] * 8
            low, high = d.ci95 or (None, None)
            unit = SI_UNITS[sensor_of(d.axis)][term]
            writer.writerow(
                [pair.second, d.axis, d.quantity, _cell(d.tau), unit]
                + [_cell(number) for number in (*numbers, d.ratio, low, high, d.p)]
                + [d.verdict]
            )
    return text.getvalue()


def _coefficients(comparison: RunComparison, pair: Pair, d: Difference) -> tuple[Coefficient, ...]:
    runs = {run.label: run.results for run in comparison.runs}
    assert d.quantity in TERMS
    return tuple(
        runs[label].axes[d.axis].fit.noise[d.quantity] for label in (pair.first, pair.second)
    )


def _cell(number: float | None) -> str:
    return '' if number is None or not math.isfinite(number) else repr(float(number))


def write_overlay(
    folder: str | os.PathLike[str],
    runs: Sequence[Subject],
    margin: float = MARGIN,
    units: str = 'datasheet',
    facts: Mapping[str, str] | None = None,
) -> Path:
    """Write report.html of the first recording, with the curves of the others."""
    from .report import ReportContext, render_report

    first, *others = runs
    baselines = {run.label: run.results for run in others}
    results = replace(first.results, baselines=baselines, margin=margin)
    context = ReportContext(method={'runs': ', '.join(run.label for run in runs), **(facts or {})})
    path = Path(folder) / 'report.html'
    write_atomic(path, render_report(results, context, units))
    return path
