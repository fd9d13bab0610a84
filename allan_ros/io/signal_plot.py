# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The panel of the raw signal: its outline over time, and what of it is no evidence."""

from __future__ import annotations

from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from ..core.batch import AXES
from .outline import Outline
from .plot_style import SMALL, TERM_STYLES
from .shown import pretty_unit, shown_signal_unit

HATCHES = {True: '///', False: 3 * '\\'}
"""Of what is left out, by whether the IMU moved."""

VEIL = 0.75
"""Opacity of the ground over the signal that is left out."""

CLOCKS = ((7200.0, 3600.0, 'h'), (120.0, 60.0, 'min'), (0.0, 1.0, 's'))
"""Least length in s, seconds in a unit, its name."""

ABOVE_SIGNAL = 1.15
"""Room about the evidence, over its largest value; a knock that was left out may leave it."""

STEPS = (1, 2, 5, 10)
"""Of ticks: numbers that are easy to count in."""


def clock(outline: Outline) -> tuple[float, str]:
    """Return the seconds in the unit of time that suits a recording, and its name."""
    length = float(outline.time_s[-1])
    return next((scale, name) for least, scale, name in CLOCKS if length >= least)


def draw_signal(panel: Axes, axis: str, outline: Outline, units: str) -> None:
    """Draw the outline of the signal about its middle, and mark what is no evidence."""
    unit, column = shown_signal_unit(axis, units), AXES.index(axis)
    middle = outline.middle[column]
    low, high = ((a[:, column] - middle) * unit.factor for a in (outline.low, outline.high))
    scale, _ = clock(outline)
    panel.fill_between(
        *(outline.time_s / scale, low, high), color=TERM_STYLES['N'][0], ec='none', step='post'
    )
    for start, end in outline.gaps:
        panel.axvspan(start / scale, end / scale, fc=rcParams['grid.color'], lw=0)
    for start, end, why in outline.left_out:
        span, hatch = (start / scale, end / scale), HATCHES[why == 'motion']
        panel.axvspan(*span, fc=rcParams['axes.facecolor'], alpha=VEIL, lw=0)
        panel.axvspan(*span, fc='none', ec=rcParams['text.color'], hatch=2 * hatch, lw=0)
    for start in outline.starts[1:]:
        panel.axvline(start / scale, color=rcParams['text.color'], lw=0.6)
    reach = ABOVE_SIGNAL * unit.factor * float(outline.reach[column])
    panel.set_ylim(-reach, reach)
    panel.set_title(
        f'about {middle * unit.factor:.4g} {pretty_unit(unit.name)}',
        size=SMALL,
        loc='left',
        pad=2.0,
    )
    panel.yaxis.set_major_locator(MaxNLocator(4, steps=STEPS, symmetric=True))
    panel.xaxis.set_major_locator(MaxNLocator(4, steps=STEPS))
    panel.set_axisbelow(True)
    panel.grid(color=rcParams['grid.color'], lw=0.5)
    panel.margins(x=0.01)
