# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Style of the plots: the width of a journal page or column, or a style sheet of the user."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import AllanError
from ..core.settings import check, parameter

if TYPE_CHECKING:  # takes 0.3 s to import, and most commands draw nothing
    from matplotlib.axes import Axes

FORMATS = ('png', 'svg', 'pdf')
"""File formats of the plots."""

PAGE_IN, COLUMN_IN = 7.16, 3.5
"""Widths in inches of a page and a column of the IEEE's journals."""

STYLES: dict[str, dict[str, Any]] = {
    'page': {'figure.figsize': (PAGE_IN, 6.3)},
    'column': {'figure.figsize': (COLUMN_IN, 7.6)},
}
"""Styles of our own: as wide as a page, with the signal next to the curves, or as a column."""

NARROW_IN = 5.0
"""A narrower picture has no room for the signal next to the curves."""

FOOT_IN, LEFT_IN, MARGIN_IN = 0.45, 0.62, 0.12
"""Inches below the panels, left of the curves and at the right edge."""

SMALL = 7.0
"""Font size of the legend in points: the least that journals accept."""

TERM_STYLES: dict[str, tuple[str, Any]] = {
    'Q': ('#CC79A7', (0, (1, 1.2))),
    'N': ('#0072B2', (0, (5, 1.5))),
    'B': ('#009E73', (0, (6, 1.5, 1, 1.5))),
    'K': ('#D55E00', (0, (9, 2))),
    'R': ('#E69F00', (0, (3, 1.2, 1, 1.2, 1, 1.2))),
}
"""Term -> colour and dashes of its part.

Colours are those of Okabe and Ito ("Color universal design", 2008), which the colour-blind tell
apart; dashes keep a picture as legible in grey.
"""

BELOW_CURVE = 0.2
"""A part is drawn where it is above this share of the lowest point of the curve."""

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
"""Settings of all plots; fonts are embedded completely in a PDF (type 42), as journals ask."""


@dataclass(frozen=True)
class PictureSettings:
    """File formats and style of the plots."""

    plot_format: tuple[str, ...] = parameter(('png',), 'File formats of each plot: png, svg, pdf.')
    plot_style: str = parameter(
        'page',
        'Style of the plots: page or column (the width of a journal page or column), a style of '
        'matplotlib, or the path of a style sheet.',
    )

    def __post_init__(self) -> None:
        check(self)
        for form in self.plot_format:
            if form not in FORMATS:
                raise AllanError(f'no plot format {form!r}: choose from {", ".join(FORMATS)}')
        if not self.plot_format:
            raise AllanError(f'no plot format given: choose from {", ".join(FORMATS)}')


def load_style(name: str) -> Mapping[str, Any]:
    """Return the matplotlib settings of a style, by its name or by the path of its sheet."""
    if name in STYLES:
        return STYLES[name]
    path = Path(name)
    if path.is_file():
        return {**STYLES['page'], **_sheet(path)}
    from matplotlib import style  # slow to import, and not needed for the built-in styles

    if name in style.library:
        return {**STYLES['page'], **style.library[name]}
    raise AllanError(
        f'no plot style {name!r}: give {", ".join(STYLES)}, a style of matplotlib (ggplot, '
        'grayscale ...) or the path of a style sheet'
    )


def _sheet(path: Path) -> Mapping[str, Any]:
    from matplotlib import rc_params_from_file

    # matplotlib only logs what is wrong with a line
    log, handler, warnings = logging.getLogger('matplotlib'), logging.Handler(), []
    handler.emit = lambda record: warnings.append(record.getMessage())  # type: ignore[method-assign]
    passes_on, log.propagate = log.propagate, False
    log.addHandler(handler)
    try:
        sheet: Mapping[str, Any] = rc_params_from_file(
            str(path), fail_on_error=True, use_default_template=False
        )
    except (OSError, ValueError, KeyError) as error:
        warnings.append(str(error))
        sheet = {}
    finally:
        log.removeHandler(handler)
        log.propagate = passes_on
    if warnings:
        why = ' '.join(warnings[0].split())[:160]
        raise AllanError(f'{path}: is no style sheet of matplotlib ({why})')
    return sheet


def log_axes(panel: Axes, across: tuple[float, float], up: tuple[float, float]) -> None:
    """Make both axes logarithmic, from and to these values.

    The fine grid is drawn as one piece: ticks of it would cost more time than all the rest of the
    picture.
    """
    from matplotlib import rcParams
    from matplotlib.collections import LineCollection
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    panel.set_xscale('log')
    panel.set_yscale('log', nonpositive='mask')
    panel.set_xlim(*across)
    panel.set_ylim(*up)
    for direction, limits in ((panel.xaxis, across), (panel.yaxis, up)):
        direction.set_major_locator(LogLocator(numticks=9))
        direction.set_minor_locator(NullLocator())
        decades = np.arange(np.floor(np.log10(limits[0])), np.ceil(np.log10(limits[1])))
        fine = np.outer(10.0**decades, np.arange(1, 10)).ravel()
        fine = fine[(fine > limits[0]) & (fine < limits[1])]
        labelled = np.isin(fine, 10.0**decades)
        if labelled.sum() < 2:  # less than two decades: the twos and fives help
            direction.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
        direction.set_major_formatter(FuncFormatter(lambda value, _: tick_text(value)))
        is_x = direction is panel.xaxis
        ends = [0.0, 1.0]
        panel.add_collection(
            LineCollection(
                [[(v, e) if is_x else (e, v) for e in ends] for v in fine],
                transform=panel.get_xaxis_transform() if is_x else panel.get_yaxis_transform(),
                colors=rcParams['grid.color'],
                linewidths=np.where(labelled, 0.6, 0.25),
                zorder=0.5,
            ),
            autolim=False,
        )


SUPERSCRIPT = str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹')
"""Digits of an exponent, which need no mathematical typesetting."""


def tick_text(value: float) -> str:
    """Return the label of a tick: plain where that is short, else as a power of ten."""
    if 1e-3 <= value < 1e5:
        return f'{value:g}'
    exponent = int(np.floor(np.log10(value) + 1e-9))
    digit = round(value / 10.0**exponent)
    power = f'10{str(exponent).translate(SUPERSCRIPT)}'
    return power if digit == 1 else f'{digit}·{power}'
