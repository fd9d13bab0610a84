# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Layout of a figure (panels, heading, logarithmic axes, legends), and its conversion to a file."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context, rcParams
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullLocator
from matplotlib.transforms import ScaledTranslation
from numpy.typing import NDArray

from .plot_style import STYLES

Floats = NDArray[np.float64]

Entry = tuple[str, Mapping[str, Any]]
"""Text of an entry of a legend, and the style of its line (no line if empty)."""

RC: dict[str, Any] = {
    'font.size': 8.0,
    'axes.linewidth': 0.6,
    'xtick.major.width': 0.6,
    'ytick.major.width': 0.6,
    'grid.color': '0.86',
    'hatch.linewidth': 0.5,
    'pdf.fonttype': 42,
    'svg.fonttype': 'none',
    'svg.hashsalt': 'allan_ros',
    'axes.grid': False,
}
"""Settings of all plots. Fonts are embedded in a PDF as TrueType (42), as journals require."""

HEAD_IN, LEGEND_ROW_IN, FOOT_IN, LEFT_IN, MARGIN_IN = 0.4, 0.17, 0.45, 0.62, 0.12
"""Lengths in inches: title and facts, each row of the legend, and the margins below, left and
right."""

GAP_IN, KEY_ABOVE_IN, KEY_RIGHT_IN = 0.15, 0.5, 1.34
"""Lengths in inches: space above each panel, the same with a legend above the panel, and width of a
legend to the right of the panel."""

SMALL = 7.0
"""Font size of legends and notes in points: the smallest that journals accept."""

LINE_IN = SMALL * 1.2 / 72.0
"""Line spacing of the small font in inches."""

KEY_GAP_IN = 0.03
"""Space in inches between two entries of a legend to the right of a panel."""

TAU_LABEL = 'averaging time τ [s]'

PNG_DPI = 200
"""Dots per inch of a PNG."""

PNG_LEVEL = 1
"""Compression level of a PNG: 4 times as fast as the default, for a file that is 10 % larger."""


class _ShownFigure(Figure):
    """A figure that Jupyter displays, although it was not created by pyplot."""

    def _repr_png_(self) -> bytes:
        return render_figure(self, 'png')


def render_figure(figure: Figure, form: str, style: Mapping[str, Any] = STYLES['page']) -> bytes:
    """Return the figure as the bytes of a 'png', 'svg' or 'pdf' file, drawn with ``style``."""
    options: dict[str, dict[str, Any]] = {
        'png': {
            'metadata': {'Software': 'allan_ros'},
            'pil_kwargs': {'compress_level': PNG_LEVEL},
        },
        'svg': {'metadata': {'Date': None}},
        'pdf': {'metadata': {'CreationDate': None, 'Producer': None, 'Creator': 'allan_ros'}},
    }
    file = io.BytesIO()
    with rc_context({**RC, **style}):
        dpi = rcParams['savefig.dpi'] if 'savefig.dpi' in style else PNG_DPI
        figure.savefig(file, format=form, dpi=dpi, **options[form])
    return file.getvalue()


def new_figure(
    rows: int,
    head: float,
    gap: float = GAP_IN,
    right: float = MARGIN_IN,
    between: float = 0.0,
    ratios: Sequence[float] = (1.0,),
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure and its panels, by row.

    The current ``figure.figsize`` is for three rows; fewer rows make a lower figure. Lengths are in
    inches: ``head`` is the space above all rows, ``gap`` above each panel, ``right`` the margin to
    the right, and ``between`` the space between two panels of a row. ``ratios`` are the relative
    widths of the panels of a row.
    """
    width, height = rcParams['figure.figsize']
    row = (height - head - FOOT_IN) / 3.0
    height = head + FOOT_IN + row * rows
    figure = _ShownFigure(figsize=(width, height))
    unit = (width - LEFT_IN - right - between * (len(ratios) - 1)) / sum(ratios)
    panels: list[list[Axes]] = []
    for i in reversed(range(rows)):
        left, in_row = LEFT_IN, []
        for ratio in ratios:
            box = (left, FOOT_IN + row * i, unit * ratio, row - gap)
            sizes = (width, height, width, height)
            panel = figure.add_axes(tuple(inches / size for inches, size in zip(box, sizes)))
            panel.xaxis.set_visible(i == 0)
            in_row.append(panel)
            left += unit * ratio + between
        panels.append(in_row)
    panels[-1][0].set_xlabel(TAU_LABEL)
    return figure, panels


def heading(figure: Figure, title: str, facts: str, entries: Sequence[Entry], columns: int) -> None:
    """Draw the title, a line of facts, and the legend in evenly spaced columns."""
    width, height = figure.get_size_inches()
    inches, top = figure.dpi_scale_trans, height - 0.09
    figure.text(LEFT_IN, top, title, transform=inches, va='top', weight='bold', size='large')
    figure.text(LEFT_IN, top - 0.19, facts, transform=inches, va='top', size=SMALL)
    for i, entry in enumerate(entries):
        row, column = divmod(i, columns)
        left = LEFT_IN + column * (width - LEFT_IN - MARGIN_IN) / columns
        down = (0.33 if facts else 0.2) + row * LEGEND_ROW_IN
        _draw_entry(figure, inches, left, top - down, entry)
    for text in figure.texts:
        text.set_parse_math(False)  # labels of users may contain dollar signs


def log_axes(panel: Axes, across: tuple[float, float], up: tuple[float, float]) -> None:
    """Make both axes logarithmic with the limits ``across`` (x) and ``up`` (y), and draw a grid.

    The grid is a single artist: separate lines would take longer than the rest of the figure.
    """
    panel.set(xscale='log', yscale='log', xlim=across, ylim=up)
    for direction, limits in ((panel.xaxis, across), (panel.yaxis, up)):
        labeled, fine = ticks(*limits)
        direction.set_major_locator(FixedLocator(labeled.tolist()))
        direction.set_major_formatter(FixedFormatter([tick_text(value) for value in labeled]))
        direction.set_minor_locator(NullLocator())
        is_x = direction is panel.xaxis
        panel.add_collection(
            LineCollection(
                [[(v, e) if is_x else (e, v) for e in (0.0, 1.0)] for v in fine],
                transform=panel.get_xaxis_transform() if is_x else panel.get_yaxis_transform(),
                colors=rcParams['grid.color'],
                linewidths=np.where(np.isin(fine, labeled), 0.6, 0.25),
                zorder=0.5,
            ),
            autolim=False,
        )


def ticks(low: float, high: float) -> tuple[Floats, Floats]:
    """Return the labeled values (at least three) and all grid lines of a logarithmic axis."""
    decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)))
    digits = ([1], [1, 2, 5], [1, 1.2, 1.5, 2, 3, 5, 7], range(1, 10))
    choices = [np.outer(decades, some).ravel() for some in digits]
    choices.append(np.asarray(MaxNLocator(4).tick_values(low, high)))
    *labels, grid, even = (values[(values > low) & (values < high)] for values in choices)
    labeled = next((values for values in labels if len(values) > 2), even)
    return labeled[:: 1 + len(labeled) // 10], np.union1d(grid, labeled)


SUPERSCRIPT = str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹')
"""Digits -> superscript digits."""


def tick_text(value: float) -> str:
    """Return the label of a tick: a plain number if it is short, else a power of ten."""
    if 1e-3 <= value < 1e5:
        return f'{value:g}'
    exponent = math.floor(math.log10(value) + 1e-9)
    digit = f'{value / 10.0**exponent:.3g}'
    power = f'10{str(exponent).translate(SUPERSCRIPT)}'
    return power if digit == '1' else f'{digit}·{power}'


def draw_key(panel: Axes, entries: Sequence[Entry], wide: bool) -> None:
    """Draw the legend to the right of a panel (``wide``), or in two columns above it."""
    axes: Any = panel.transAxes
    rows = len(entries) if wide else math.ceil(len(entries) / 2)
    for first in range(0, len(entries), rows or 1):
        corner = ScaledTranslation(1.0 if wide else first / (2.0 * rows), 1.0, axes)
        left, y = (0.08, 0.0) if wide else (0.0, 0.04 + rows * LINE_IN)
        for entry in entries[first : first + rows]:
            _draw_entry(panel, panel.figure.dpi_scale_trans + corner, left, y, entry)
            y -= LINE_IN * (1 + entry[0].count('\n')) + KEY_GAP_IN * wide


def _draw_entry(owner: Figure | Axes, inches: Any, left: float, top: float, entry: Entry) -> None:
    """Draw an entry of a legend, three times as fast as matplotlib.

    ``left`` and ``top`` are its position in the coordinates of the transform ``inches``.
    """
    text, style = entry
    if style:
        at = [left, left + 0.11, left + 0.22], [top - 0.5 * LINE_IN] * 3
        line = Line2D(*at, transform=inches, clip_on=False, markevery=[1], **style)
        owner.add_artist(line)
    owner.text(left + 0.28, top, text, transform=inches, va='top', size=SMALL)
