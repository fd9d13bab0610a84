# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of a comparison: tables as Markdown and CSV, the document, and the pictures."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterator
from pathlib import Path

from ..core.batch import SENSORS
from ..core.differences import Difference
from ..core.fit import TERMS, Coefficient
from ..core.units import SI_UNITS, sensor_of
from .atomic import write_atomic
from .compare_words import headline, ratio_text, verdict_text
from .datasheet_comparison import VERDICT_TEXT
from .documents import to_json
from .plot_style import PictureSettings, load_style
from .result_files import made_folder
from .run_comparison import Pair, RunComparison, comparison_document
from .shown import interval_text, shown_unit, value_text

CSV_COLUMNS = (
    *('second', 'axis', 'quantity', 'tau_s', 'unit'),
    *(f'{run}_{part}' for run in ('first', 'second') for part in ('value', 'low', 'high', 'upper')),
    *('ratio', 'ratio_low', 'ratio_high', 'p', 'verdict'),
)
"""One line a comparison, in SI; ``upper`` is the 95 % limit of what is not observable."""


def write_comparison(
    folder: str | os.PathLike[str],
    comparison: RunComparison,
    units: str = 'datasheet',
    pictures: PictureSettings = PictureSettings(),
) -> list[Path]:
    """Write comparison.json, .md and .csv and a picture of each sensor, and return their paths.

    Raises
    ------
    AllanError
        When the folder cannot be made or written, or the style of the pictures is unknown.
    """
    # Heavy to import, and a table needs no pictures until here.
    from .compare_plot import comparison_figure
    from .plots import to_form

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
    for name, content in contents.items():
        write_atomic(place / name, content)
    return [place / name for name in contents]


def markdown(comparison: RunComparison, units: str = 'datasheet') -> str:
    """Return the comparison as Markdown: what is so, then a table for each pair and datasheet."""
    return '\n'.join(_markdown_lines(comparison, units)) + '\n'


def _markdown_lines(comparison: RunComparison, units: str) -> Iterator[str]:
    yield from (f'{line}\n' for line in headline(comparison))
    for pair in comparison.pairs:
        yield f'## {pair.second} against {pair.first}\n'
        yield f'| axis | quantity | unit | {pair.first} | {pair.second} | ratio | |'
        yield '|---|---|---|---|---|---|---|'
        for d in pair.differences:
            yield _markdown_row(comparison, pair, d, units)
        yield ''
    for label, beside in comparison.beside:
        yield f'## {label} beside the datasheet of {beside.datasheet.name}\n'
        yield '| axis | term | limit | stated | |'
        yield '|---|---|---|---|---|'
        for held in beside.held:
            unit = shown_unit(held.axis, held.term, units)
            limit = f'{held.limit.value * unit.factor:.3g} {unit.name}'
            yield (
                f'| {held.axis} | {held.term} | {limit} | {held.limit.stated} '
                f'| {VERDICT_TEXT[held.verdict]} |'
            )
        yield ''


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
    """Return every comparison of two runs as CSV, in SI."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(CSV_COLUMNS)
    for pair in comparison.pairs:
        for d in pair.differences:
            term = 'B' if d.tau is not None else d.quantity
            numbers: list[float | None] = []
            if d.tau is None:
                for c in _coefficients(comparison, pair, d):
                    known = c.status == 'estimated'
                    low, high = c.ci95 or (None, None)
                    numbers += [c.value if known else None, low, high, None if known else c.upper95]
            else:
                numbers = [None] * 8
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
