# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots and tables of a comparison: curves of several runs, and their ratios to the first.

Every run has a colour of Okabe and Ito ("Color universal design", 2008) and a marker of its own,
so that the picture is as legible to the colour-blind and in grey.
"""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context, rcParams
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from ..core.allan.curve import AxisCurve
from ..core.compare import MARGIN, Difference
from ..core.errors import one_line
from ..core.fit import TERMS, Coefficient
from ..core.imu import AXES, SENSORS, SI_UNITS, sensor_of
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
from .format import SENSOR_NAMES, interval_text, pretty_unit, shown_unit, value_text
from .plot_style import (
    FOOT_IN,
    LEFT_IN,
    MARGIN_IN,
    NARROW_IN,
    RC,
    SMALL,
    STYLES,
    PictureSettings,
    load_style,
    log_axes,
    tick_text,
)
from .result_files import made_folder

RUN_STYLES = (
    ('', 'o', '-'),
    ('#D55E00', 's', '--'),
    ('#0072B2', '^', '-.'),
    ('#009E73', 'D', ':'),
    ('#CC79A7', 'v', (0, (5, 1, 1, 1, 1, 1))),
    ('#E69F00', 'P', (0, (8, 2))),
)
"""Colour ('' for that of the text), marker and dashes of each run; they repeat from the seventh run
on."""

HEAD_IN, LEGEND_ROW_IN, BETWEEN_IN = 0.45, 0.17, 0.52
"""Inches above the panels, of each row of the legend there, and between the panels of an axis."""

LEGEND_COLUMNS = {True: 4, False: 2}
"""Runs in a row of the legend, by whether the picture is wide."""

MARK_EVERY = 6
"""Points between two marks of a curve; those of the next run are shifted by one."""

BAND_OPACITY = 0.18
"""Opacity of the band between the 68.3 % limits of a curve."""

RATIO_TICKS = (
    (1.1, 1.2),
    (1.2, 1.5, 2.0),
    (2.0, 5.0, 10.0),
    (3.0, 10.0, 30.0),
    (10.0, 100.0, 1000.0),
)
"""Labelled ratios above 1, and below it as one over them, by how far the axis reaches."""

OFFSET = 1.05
"""Runs are drawn this factor apart in averaging time where their ratios would hide each other."""


def comparison_figure(
    comparison: RunComparison,
    sensor: str,
    units: str = 'datasheet',
    style: Mapping[str, Any] = STYLES['page'],
) -> Figure | None:
    """Return the figure of one sensor, a row for each axis; None where no run has its curves.

    On the left the deviations with their 68.3 % limits; on the right, where the picture is wide,
    their ratio to the first run with 95 % intervals, filled where it is significant. The
    ``figure.figsize`` of the style is that of a picture of three axes.
    """
    runs = comparison.runs
    axes = [a for a in AXES[SENSORS[sensor]] if any(_has_curve(run, a) for run in runs)]
    if not axes:
        return None
    with rc_context({**RC, **style}):
        width, height = rcParams['figure.figsize']
        wide = width >= NARROW_IN
        rows = math.ceil(len(runs) / LEGEND_COLUMNS[wide])
        head = HEAD_IN + LEGEND_ROW_IN * rows
        row = (height - head - FOOT_IN) / len(AXES[SENSORS[sensor]])
        height = head + FOOT_IN + row * len(axes)
        figure = Figure(figsize=(width, height))
        with_ratios = bool(comparison.pairs) and wide
        room = width - LEFT_IN - MARGIN_IN
        panels = figure.subplots(
            len(axes),
            2 if with_ratios else 1,
            squeeze=False,
            sharex='col',
            gridspec_kw={
                'left': LEFT_IN / width,
                'right': 1.0 - MARGIN_IN / width,
                'bottom': FOOT_IN / height,
                'top': 1.0 - head / height,
                'wspace': BETWEEN_IN / ((room - BETWEEN_IN) / 2.0),
                'hspace': 0.08,
            },
        )
        for of_axis, axis in zip(panels, axes):
            _draw_curves(of_axis[0], axis, comparison, units)
            if with_ratios:
                _draw_ratios(of_axis[1], axis, comparison)
        for panel in panels[-1]:
            panel.set_xlabel('averaging time τ [s]')
        _figure_head(figure, comparison, sensor, with_ratios, LEGEND_COLUMNS[wide])
    return figure


def _figure_head(
    figure: Figure, comparison: RunComparison, sensor: str, with_ratios: bool, columns: int
) -> None:
    """Draw the title, and the legend of the runs."""
    width, height = figure.get_size_inches()
    left, top = LEFT_IN / width, 1.0 - 0.09 / height
    figure.text(left, top, SENSOR_NAMES[sensor], va='top', weight='bold', size='large')
    if with_ratios:
        right = 1.0 - MARGIN_IN / width
        said = f'right: ratio to {comparison.runs[0].label}, filled where significant'
        text = figure.text(right, top - 0.04 / height, said, va='top', ha='right', size=SMALL)
        text.set_parse_math(False)
    handles = []
    for i, run in enumerate(comparison.runs):
        colour, marker, line = _look(i)
        drawn = {'color': colour, 'marker': marker, 'linestyle': line}
        handles.append(Line2D([], [], **drawn, markersize=4.0, linewidth=1.1, label=run.label))
    legend = figure.legend(
        handles=handles,
        loc='upper left',
        bbox_to_anchor=(left, top - 0.2 / height),
        borderaxespad=0.0,
        borderpad=0.0,
        ncol=min(len(handles), columns),
        handlelength=3.2,
        fontsize=SMALL,
        frameon=False,
    )
    for name_of_run in legend.get_texts():
        name_of_run.set_parse_math(False)


def _look(run: int) -> tuple[str, str, Any]:
    """Return colour, marker and dashes of a run."""
    colour, marker, dashes = RUN_STYLES[run % len(RUN_STYLES)]
    return colour or rcParams['text.color'], marker, dashes


def _has_curve(run: Subject, axis: str) -> bool:
    return axis in run.results.axes and run.results.axes[axis].curve is not None


def _draw_curves(panel: Axes, axis: str, comparison: RunComparison, units: str) -> None:
    """Draw the deviation of one axis of every run, each with its own marks."""
    unit = shown_unit(axis, 'B', units)
    known: list[tuple[int, AxisCurve]] = []
    for i, run in enumerate(comparison.runs):
        curve = run.results.axes[axis].curve if axis in run.results.axes else None
        if curve is not None and np.any(curve.adev > 0.0):
            known.append((i, curve))
    panel.set_ylabel(f'{axis.replace("_", " ")}  [{pretty_unit(unit.name)}]')
    if not known:
        panel.text(0.5, 0.5, 'no noise', ha='center', transform=panel.transAxes)
        panel.set_yticks([])
        return
    adevs = np.concatenate([curve.adev[curve.adev > 0.0] for _, curve in known]) * unit.factor
    taus = np.concatenate([curve.tau for _, curve in known])
    log_axes(panel, (taus.min() / 1.3, taus.max() * 1.3), (0.6 * adevs.min(), 1.8 * adevs.max()))
    for i, curve in known:
        colour, marker, dashes = _look(i)
        low, high = (
            np.where(v > 0.0, unit.factor * v, np.nan) for v in (curve.ci_low, curve.ci_high)
        )
        panel.fill_between(curve.tau, low, high, color=colour, alpha=BAND_OPACITY, linewidth=0)
        panel.plot(
            *(curve.tau, curve.adev * unit.factor),
            color=colour,
            linestyle=dashes,
            marker=marker,
            markersize=3.0,
            markevery=(i * MARK_EVERY // len(RUN_STYLES), MARK_EVERY),
            linewidth=1.0,
        )


def _draw_ratios(panel: Axes, axis: str, comparison: RunComparison) -> None:
    """Draw the ratio of the deviations to those of the first run, with 95 % intervals."""
    panel.axhline(1.0, color=rcParams['text.color'], linewidth=0.8)
    for i, pair in enumerate(comparison.pairs, 1):
        colour, marker, _ = _look(i)
        for d in pair.differences:
            if d.axis != axis or d.tau is None or d.ratio is None or d.ci95 is None:
                continue
            panel.errorbar(
                [d.tau * OFFSET ** (i - 1)],
                [d.ratio],
                yerr=[[d.ratio - d.ci95[0]], [d.ci95[1] - d.ratio]],
                color=colour,
                marker=marker,
                markersize=4.0,
                markerfacecolor=colour if d.significant else rcParams['axes.facecolor'],
                capsize=1.5,
                linewidth=0.9,
            )
    panel.set_xscale('log')
    panel.set_yscale('log')
    low, high = panel.get_ylim()
    reach = max(math.log(high), -math.log(low), math.log(1.1))
    panel.set_ylim(math.exp(-reach), math.exp(reach))
    ticks = next(t for t in RATIO_TICKS if t[-1] >= math.exp(reach) or t is RATIO_TICKS[-1])
    panel.yaxis.set_major_locator(FixedLocator([*(1.0 / t for t in ticks), 1.0, *ticks]))
    panel.yaxis.set_major_formatter(FuncFormatter(lambda ratio, _: f'{ratio:.3g}'))
    panel.yaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_major_formatter(FuncFormatter(lambda tau, _: tick_text(tau)))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.set_axisbelow(True)
    panel.grid(True, which='major', color=rcParams['grid.color'], linewidth=0.5)


CSV_COLUMNS = (
    *('second', 'axis', 'quantity', 'tau_s', 'unit'),
    *(f'{run}_{part}' for run in ('first', 'second') for part in ('value', 'low', 'high', 'upper')),
    *('ratio', 'ratio_low', 'ratio_high', 'p', 'verdict'),
)
"""One line per comparison, in SI; ``upper`` is the 95 % limit of what is not observable."""


def write_comparison(
    folder: str | os.PathLike[str],
    comparison: RunComparison,
    units: str = 'datasheet',
    pictures: PictureSettings = PictureSettings(),
) -> list[Path]:
    """Write comparison.json, .md and .csv and a picture of each sensor, and return their paths."""
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
    """Return text of a user as it may stand in a Markdown table."""
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
    """Return every comparison of two runs as CSV, in SI."""
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
    """Write report.html of the first run, with the curves of the others drawn over it.

    The facts are further lines about the comparison.
    """
    from .report import ReportContext, render_report

    first, *others = runs
    baselines = {run.label: run.results for run in others}
    results = replace(first.results, baselines=baselines, margin=margin)
    context = ReportContext(method={'runs': ', '.join(run.label for run in runs), **(facts or {})})
    path = Path(folder) / 'report.html'
    write_atomic(path, render_report(results, context, units))
    return path
