# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Logarithmic axes with a fine grid and short labels, the same on every picture."""

from __future__ import annotations

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator


def log_axes(panel: Axes, across: tuple[float, float], up: tuple[float, float]) -> None:
    """Make both axes logarithmic, from and to these values.

    The fine grid is drawn as one piece: ticks of it would cost more time than all the rest of the
    picture.
    """
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


def tick_text(value: float) -> str:
    """Return the label of a tick: plain where that is short, else as a power of ten."""
    if 1e-3 <= value < 1e5:
        return f'{value:g}'
    exponent = int(np.floor(np.log10(value) + 1e-9))
    digit = round(value / 10.0**exponent)
    return rf'$10^{{{exponent}}}$' if digit == 1 else rf'${digit}\cdot10^{{{exponent}}}$'
