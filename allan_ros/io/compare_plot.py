# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The curves of several runs over each other, and their ratio to the first.

Every run has a colour of Okabe and Ito ("Color universal design", 2008) and a marker of its own,
so that the picture is as legible to the colour-blind and in grey.
"""

from __future__ import annotations

import math

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from ..core.batch import AXES, SENSORS
from .plots import RC
from .run_comparison import RunComparison, Subject
from .shown import shown_unit

RUN_STYLES = (
    ('#000000', 'o', '-'),
    ('#D55E00', 's', '--'),
    ('#0072B2', '^', '-.'),
    ('#009E73', 'D', ':'),
    ('#CC79A7', 'v', (0, (5, 1, 1, 1, 1, 1))),
    ('#E69F00', 'P', (0, (8, 2))),
)
"""Colour, marker and dashes of each run; a seventh begins anew."""

WIDTH_IN, ROW_IN, HEAD_IN, FOOT_IN = 10.0, 2.6, 0.8, 0.5
"""Size of the picture in inches: its width, the height of an axis, what is above and below."""

BAND_OPACITY = 0.18
"""Of the 68.3 % limits about a curve."""

RATIO_TICKS = ((1.1, 1.2), (1.2, 1.5, 2.0), (2.0, 5.0, 10.0), (10.0, 100.0, 1000.0))
"""Labelled ratios above 1, and below it as one over them, by how far the axis reaches."""

OFFSET = 1.05
"""Runs are drawn this factor apart in averaging time where their ratios would hide each other."""


def comparison_figure(
    comparison: RunComparison, sensor: str, units: str = 'datasheet'
) -> Figure | None:
    """Return the figure of one sensor, a row for each axis; None where no run has its curves.

    On the left the deviations with their 68.3 % limits; on the right their ratio to the first run
    with 95 % intervals, filled where it is more than chance.
    """
    runs = comparison.runs
    axes = [a for a in AXES[SENSORS[sensor]] if any(_has_curve(run, a) for run in runs)]
    if not axes:
        return None
    with rc_context(RC):
        height = ROW_IN * len(axes) + HEAD_IN + FOOT_IN
        figure = Figure(figsize=(WIDTH_IN, height))
        columns = 2 if comparison.pairs else 1
        panels = figure.subplots(
            len(axes),
            columns,
            squeeze=False,
            sharex=True,
            gridspec_kw={
                'left': 0.09,
                'right': 0.98,
                'bottom': FOOT_IN / height,
                'top': 1.0 - HEAD_IN / height,
                'wspace': 0.22,
                'hspace': 0.14,
            },
        )
        for row, axis in zip(panels, axes):
            _draw_curves(row[0], axis, comparison, units)
            if comparison.pairs:
                _draw_ratios(row[1], axis, comparison)
        for panel in panels[-1]:
            panel.set_xlabel('averaging time τ [s]')
        handles, labels = _legend(panels[0][0], comparison)
        name = {'gyro': 'Gyroscope', 'accel': 'Accelerometer'}[sensor]
        figure.suptitle(name, fontsize=11, y=1.0 - 0.08 / height, va='top')
        figure.legend(
            handles,
            labels,
            loc='upper center',
            bbox_to_anchor=(0.5, 1.0 - 0.3 / height),
            ncol=min(len(labels), 4),
            frameon=False,
        )
    return figure


def _has_curve(run: Subject, axis: str) -> bool:
    return axis in run.results.axes and run.results.axes[axis].curve is not None


def _draw_curves(panel: Axes, axis: str, comparison: RunComparison, units: str) -> None:
    """Draw the deviation of one axis of every run, and what a datasheet states of it."""
    unit = shown_unit(axis, 'B', units)
    for i, run in enumerate(comparison.runs):
        curve = run.results.axes[axis].curve if _has_curve(run, axis) else None
        if curve is None:
            continue
        colour, marker, dashes = RUN_STYLES[i % len(RUN_STYLES)]
        low, high = (np.nan_to_num(limit, nan=0.0) for limit in (curve.ci_low, curve.ci_high))
        known = (low > 0.0) & (high > 0.0)
        panel.fill_between(
            curve.tau[known],
            low[known] * unit.factor,
            high[known] * unit.factor,
            color=colour,
            alpha=BAND_OPACITY,
            linewidth=0,
        )
        panel.plot(
            curve.tau,
            curve.adev * unit.factor,
            color=colour,
            linestyle=dashes,
            marker=marker,
            markersize=3.0,
            markevery=8,
            linewidth=1.2,
        )
    panel.set_xscale('log')
    panel.set_yscale('log')
    panel.set_ylabel(f'{axis.replace("_", " ")} [{unit.name}]')
    panel.grid(True, which='major', alpha=0.3, linewidth=0.5)


def _draw_ratios(panel: Axes, axis: str, comparison: RunComparison) -> None:
    """Draw the ratio of the deviations to those of the first run, with 95 % intervals."""
    panel.axhline(1.0, color=RUN_STYLES[0][0], linewidth=0.8)
    for i, pair in enumerate(comparison.pairs, 1):
        colour, marker, _ = RUN_STYLES[i % len(RUN_STYLES)]
        for d in pair.differences:
            if d.axis != axis or d.tau is None or d.ratio is None or d.ci95 is None:
                continue
            panel.errorbar(
                [d.tau * OFFSET ** (i - 1)],
                [d.ratio],
                yerr=[[d.ratio - d.ci95[0]], [d.ci95[1] - d.ratio]],
                color=colour,
                marker=marker,
                markersize=5.0,
                markerfacecolor=colour if d.verdict in ('higher', 'lower') else 'white',
                capsize=2.0,
                linewidth=1.0,
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
    panel.set_ylabel(f'ratio to {comparison.runs[0].label}')
    panel.grid(True, which='major', alpha=0.3, linewidth=0.5)


def _legend(panel: Axes, comparison: RunComparison) -> tuple[list[Line2D], list[str]]:
    handles = []
    for i in range(len(comparison.runs)):
        colour, marker, dashes = RUN_STYLES[i % len(RUN_STYLES)]
        [line] = panel.plot(
            [], [], color=colour, marker=marker, markersize=4.0, linestyle=dashes, linewidth=1.2
        )
        handles.append(line)
    return handles, [run.label for run in comparison.runs]
