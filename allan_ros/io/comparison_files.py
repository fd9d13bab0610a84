# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of a comparison: JSON, tables, plots, and a report of the first recording."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterator, Mapping, Sequence
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
from .format import interval_text, shown_unit, value_text
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
    return '\n'.join(_markdown_lines(comparison, units)) + '\n'


def _markdown_lines(comparison: RunComparison, units: str) -> Iterator[str]:
    yield from (f'{line}\n' for line in comparison_headline(comparison))
    for pair in comparison.pairs:
        first, second = _cell_text(pair.first), _cell_text(pair.second)
        yield f'## {second} against {first}\n'
        yield f'| axis | quantity | unit | {first} | {second} | ratio | |'
        yield '|---|---|---|---|---|---|---|'
        for d in pair.differences:
            yield _markdown_row(comparison, pair, d, units)
        yield ''
    for label, of_run in comparison.datasheets:
        yield f'## {_cell_text(label)} and the datasheet of {_cell_text(of_run.datasheet.name)}\n'
        yield '| axis | term | limit | stated | |'
        yield '|---|---|---|---|---|'
        for c in of_run.comparisons:
            unit = shown_unit(c.axis, c.term, units)
            limit = f'{c.limit * unit.factor:.3g} {unit.name}'
            stated = _cell_text(of_run.limit(c).stated)
            yield f'| {c.axis} | {c.term} | {limit} | {stated} | {VERDICT_TEXT[c.verdict]} |'
        yield ''


def _cell_text(text: str) -> str:
    """Return a user's text, escaped for a Markdown table."""
    return one_line(text).replace('|', '\\|').replace('<', '&lt;')


def _markdown_row(comparison: RunComparison, pair: Pair, d: Difference, units: str) -> str:
    values: tuple[str, ...] = ('', '')
    if d.tau is not None:
        what, unit = f'deviation at {d.tau:.3g} s', ''
    else:
        shown = shown_unit(d.axis, d.quantity, units)
        what, unit = d.quantity, shown.name
        values = tuple(
            f'{value_text(c, shown)} {interval_text(c, shown)}'.strip()
            for c in _coefficients(comparison, pair, d)
        )
    cells = (d.axis, what, unit, *values, ratio_text(d), verdict_text(d))
    return f'| {" | ".join(cells)} |'


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
