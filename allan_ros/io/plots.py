# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of a sensor: Allan deviation, selected model and its parts, with the raw signal."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import rc_context, rcParams
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ..core.allan.curve import AxisCurve
from ..core.fit import TERMS, Coefficient
from ..core.imu import AXES, SENSORS
from .axis_result import AxisResult
from .format import (
    NOTHING_KNOWN,
    READ_AT,
    SENSOR_NAMES,
    ShownUnit,
    interval_text,
    pretty_unit,
    shown_signal_unit,
    shown_unit,
    value_text,
)
from .plot_style import (
    BELOW_CURVE,
    FOOT_IN,
    LEFT_IN,
    MARGIN_IN,
    NARROW_IN,
    RC,
    SMALL,
    STYLES,
    TERM_STYLES,
    log_axes,
)
from .results import Results
from .signal import SignalSummary

HATCHES = {True: '///', False: 3 * '\\'}
"""Hatching of excluded data, by whether the IMU moved."""

VEIL = 0.75
"""Opacity of the ground over the signal that is left out."""

CLOCKS = ((7200.0, 3600.0, 'h'), (120.0, 60.0, 'min'), (0.0, 1.0, 's'))
"""Least length in s, seconds in a unit, its name."""

ABOVE_SIGNAL = 1.15
"""Margin around the used samples, relative to the largest; an excluded knock may exceed it."""

STEPS = (1, 2, 5, 10)
"""Of ticks: numbers that are easy to count in."""


def clock(summary: SignalSummary) -> tuple[float, str]:
    """Return the seconds in the unit of time that suits a recording, and its name."""
    length = float(summary.time_s[-1])
    return next((scale, name) for least, scale, name in CLOCKS if length >= least)


def draw_signal(panel: Axes, axis: str, summary: SignalSummary, units: str) -> None:
    """Draw the signal about its middle, and mark the samples that are not used."""
    unit, column = shown_signal_unit(axis, units), AXES.index(axis)
    middle = summary.middle[column]
    low, high = ((a[:, column] - middle) * unit.factor for a in (summary.low, summary.high))
    scale, _ = clock(summary)
    panel.fill_between(
        *(summary.time_s / scale, low, high), color=TERM_STYLES['N'][0], ec='none', step='post'
    )
    for start, end in summary.gaps:
        panel.axvspan(start / scale, end / scale, fc=rcParams['grid.color'], lw=0)
    for start, end, why in summary.left_out:
        span, hatch = (start / scale, end / scale), HATCHES[why == 'motion']
        panel.axvspan(*span, fc=rcParams['axes.facecolor'], alpha=VEIL, lw=0)
        panel.axvspan(*span, fc='none', ec=rcParams['text.color'], hatch=2 * hatch, lw=0)
    for start in summary.starts[1:]:
        panel.axvline(start / scale, color=rcParams['text.color'], lw=0.6)
    reach = ABOVE_SIGNAL * unit.factor * float(summary.reach[column])
    panel.set_ylim(-reach, reach)
    panel.text(  # a title would be moved around the tick labels, which takes time
        0.0, 1.02, f'about {middle * unit.factor:.4g} {pretty_unit(unit.name)}',
        size=SMALL, transform=panel.transAxes,
    )  # fmt: skip
    panel.yaxis.set_major_locator(MaxNLocator(4, steps=STEPS, symmetric=True))
    panel.xaxis.set_major_locator(MaxNLocator(4, steps=STEPS))
    panel.set_axisbelow(True)
    panel.grid(color=rcParams['grid.color'], lw=0.5)
    panel.margins(x=0.01)


HEAD_IN = 0.62
"""Inches above the panels."""

LEGEND_IN, SIGNAL_LEFT_IN = 1.34, 0.42
"""Inches of the legend next to the curves, and left of the signal."""

TALLER_LEGEND_IN = 0.5
"""Inches of the legend above each panel of a narrow picture."""

NARROW_ENTRIES = 6
"""Most entries of that legend, in two columns."""

PROCESS_STYLE = ('0.5', (0, (2, 1)))
"""Colour and dashes of a Gauss-Markov process or a sinusoid."""

LIMIT_ALPHA = 0.1
"""Opacity of the band that terms which are not resolved may fill, up to their upper limits."""

LIMIT_STYLE: dict[str, Any] = {'ls': (0, (1, 3)), 'lw': 0.9}
"""Line of the 95 % upper limit of a term that is not resolved."""

PNG_DPI = 200
"""Dots per inch of the PNG: sharp on a page of print and on a screen."""

PNG_LEVEL = 3
"""Of zlib: a third of the time of its default for a file that is 7 % larger."""


class _ShownFigure(Figure):
    """A figure that a notebook shows without pyplot."""

    def _repr_png_(self) -> bytes:
        return to_form(self, 'png')


def sensor_figure(
    results: Results,
    sensor: str,
    summary: SignalSummary | None = None,
    units: str = 'datasheet',
    style: Mapping[str, Any] = STYLES['page'],
) -> Figure | None:
    """Return the figure of one sensor: a row for each of its axes, or None when it is absent.

    Without a ``summary`` of the raw signal, or on a narrow picture, the curves stand alone. The
    ``figure.figsize`` of the style is that of a picture of three axes.
    """
    axes = [a for a in AXES[SENSORS[sensor]] if a in results.axes and results.axes[a].curve]
    if not axes:
        return None
    with rc_context({**RC, **style}):
        width, height = rcParams['figure.figsize']
        row = (height - HEAD_IN - FOOT_IN) / len(AXES[SENSORS[sensor]])
        height = HEAD_IN + FOOT_IN + row * len(axes)
        figure = _ShownFigure(figsize=(width, height))
        wide = width >= NARROW_IN
        panels = _panels(figure, len(axes), wide, wide and summary is not None)
        for of_axis, axis in zip(panels, axes):
            _draw_curve(of_axis[0], axis, results.axes[axis], units, wide)
            if len(of_axis) > 1 and summary is not None:
                draw_signal(of_axis[1], axis, summary, units)
        panels[-1][0].set_xlabel('averaging time τ [s]')
        drawn = summary if panels.shape[1] > 1 else None
        if drawn is not None:
            panels[-1][1].set_xlabel(f'time [{clock(drawn)[1]}]')
        _head(figure, results, sensor, wide, drawn)
    return figure


def draw_axes(panel: Axes, axes: Mapping[str, AxisResult], units: str = 'datasheet') -> None:
    """Draw one axis with the parts of its model into a panel, or several axes without them."""
    for name, result in axes.items():
        if result.curve is None:
            continue
        if len(axes) == 1:
            _draw_curve(panel, name, result, units, wide=False)
            continue
        curve, unit = result.curve, shown_unit(name, 'B', units)
        (points,) = panel.loglog(curve.tau, unit.factor * curve.adev, 'o', ms=3, label=name)
        colour = points.get_color()
        low, high = (unit.factor * limit for limit in (curve.ci_low, curve.ci_high))
        panel.fill_between(curve.tau, low, high, color=colour, alpha=0.2, lw=0)
        panel.loglog(curve.tau, unit.factor * result.model_line().adev, color=colour, lw=1.0)
        panel.set_ylabel(f'Allan deviation  [{pretty_unit(unit.name)}]')
    panel.set_xlabel('averaging time τ [s]')
    if len(axes) > 1:
        panel.legend()


def to_png(figure: Figure) -> bytes:
    """Return the figure as a PNG file."""
    return to_form(figure, 'png')


def to_form(figure: Figure, form: str, style: Mapping[str, Any] = STYLES['page']) -> bytes:
    """Return the figure as a file of a form of `plot_style.FORMATS`."""
    metadata = {
        'png': {'Software': 'allan_ros'},
        'svg': {'Date': None},
        'pdf': {'CreationDate': None, 'Producer': None, 'Creator': 'allan_ros'},
    }
    file = io.BytesIO()
    with rc_context({**RC, **style}):
        dpi = rcParams['savefig.dpi'] if 'savefig.dpi' in style else PNG_DPI
        quick: dict[str, Any] = (
            {'pil_kwargs': {'compress_level': PNG_LEVEL}} if form == 'png' else {}
        )
        figure.savefig(file, format=form, dpi=dpi, metadata=metadata[form], **quick)
    return file.getvalue()


def _panels(figure: Figure, rows: int, wide: bool, with_signal: bool) -> NDArray[Any]:
    """Return the panels, (rows, 1 or 2), laid out so that no legend covers a curve."""
    width, height = figure.get_size_inches()
    right = width - MARGIN_IN - (LEGEND_IN if wide and not with_signal else 0.0)
    room = right - LEFT_IN
    between = LEGEND_IN + SIGNAL_LEFT_IN
    columns = 2 if with_signal else 1
    ratios = [2.0, 1.0][:columns]
    across = (room - between) / 2.0 if with_signal else room  # mean width, as wspace counts
    gap = 0.15 if wide else TALLER_LEGEND_IN
    top = height - HEAD_IN - (0.0 if wide else TALLER_LEGEND_IN - 0.15)
    down = (top - FOOT_IN - gap * (rows - 1)) / rows
    made: NDArray[Any] = figure.subplots(
        rows,
        columns,
        squeeze=False,
        sharex='col',
        gridspec_kw={
            'width_ratios': ratios,
            'left': LEFT_IN / width,
            'right': right / width,
            'bottom': FOOT_IN / height,
            'top': top / height,
            'wspace': between / across if with_signal else 0.0,
            'hspace': gap / down,
        },
    )
    return made


def _head(
    figure: Figure, results: Results, sensor: str, wide: bool, summary: SignalSummary | None
) -> None:
    """Draw the title, and the legend that all panels share."""
    width, height = figure.get_size_inches()
    of = results.identity.label
    facts = (
        f'{results.samples:,} samples at {results.rate_hz:.4g} Hz, '
        f'{results.duration_s / 3600.0:.3g} h'
    )
    if summary is not None and summary.left_out:
        moved = {out.why == 'motion' for out in summary.left_out}
        reasons = {True: f'{HATCHES[True]} it moved', False: f'{HATCHES[False]} left out otherwise'}
        facts += f'; hatched: {", ".join(reasons[why] for why in (True, False) if why in moved)}'
    left, top = LEFT_IN / width, 1.0 - 0.09 / height
    title = f'{SENSOR_NAMES[sensor]}{f" of {of}" if of else ""}'
    bold = figure.text(left, top, title, va='top', weight='bold', size='large')
    bold.set_parse_math(False)
    plain = figure.text(left, top - 0.19 / height, facts, va='top', size=SMALL)
    plain.set_parse_math(False)
    ink = rcParams['text.color']
    handles: list[Artist] = [
        Line2D([], [], ls='', marker='o', ms=3, mfc='none', mec=ink, mew=0.7, label='measured'),
        Patch(color=ink, alpha=0.2, lw=0, label='68 % limits'),
        Line2D([], [], color=ink, lw=0.9, label='model'),
    ]
    if wide:
        handles.append(Patch(color=ink, alpha=LIMIT_ALPHA, lw=0, label='unresolved terms, at most'))
    figure.legend(
        handles=handles,
        loc='upper right' if wide else 'upper left',
        bbox_to_anchor=(1.0, 1.0 - 0.02 / height) if wide else (left, 1.0 - 0.4 / height),
        borderaxespad=0.3 if wide else 0.0,
        borderpad=0.4 if wide else 0.0,
        ncol=len(handles),
        fontsize=SMALL,
        frameon=False,
        columnspacing=1.0,
        handlelength=1.6,
    )


def _draw_curve(panel: Axes, axis: str, result: AxisResult, units: str, wide: bool) -> None:
    """Draw the deviation with its limits, the fit and its parts."""
    curve, unit = result.curve, shown_unit(axis, 'B', units)
    assert curve is not None
    panel.set_ylabel(f'{axis.replace("_", " ")}  [{pretty_unit(unit.name)}]')
    positive = curve.adev[curve.adev > 0.0]
    if not len(positive):
        panel.text(0.5, 0.5, 'no noise', ha='center', transform=panel.transAxes)
        panel.set_yticks([])
        return
    ink = rcParams['text.color']
    adev, low, high = (unit.factor * a for a in (curve.adev, curve.ci_low, curve.ci_high))
    positive = positive * unit.factor
    log_axes(
        panel,
        (curve.tau[0] / 1.3, curve.tau[-1] * 1.3),
        (0.45 * positive.min(), 1.8 * positive.max()),
    )
    panel.fill_between(curve.tau, low, high, color=ink, alpha=0.2, lw=0)
    panel.plot(
        *(curve.tau, adev, 'o'), ms=2.6, mfc=rcParams['axes.facecolor'], mec=ink, mew=0.6,
        label='measured',
    )  # fmt: skip
    lines = _draw_parts(panel, axis, result, curve, units)
    if not wide:  # values only, of what is drawn
        lines = [line for line in lines if line.get_linestyle() != 'None'][:NARROW_ENTRIES]
        for line in lines:
            line.set_label(str(line.get_label()).partition('\n')[0])
    model, upper = (unit.factor * values for values in result.model_line())
    panel.plot(curve.tau, model, color=ink, lw=0.9, zorder=1.9)
    panel.fill_between(curve.tau, model, upper, color=ink, alpha=LIMIT_ALPHA, lw=0)
    on_the_right = {'loc': 'upper left', 'bbox_to_anchor': (1.0, 1.03), 'ncol': 1}
    above = {'loc': 'lower left', 'bbox_to_anchor': (-0.02, 0.99), 'ncol': 2}
    panel.legend(
        handles=lines,
        fontsize=SMALL,
        frameon=False,
        handlelength=2.2,
        labelspacing=0.35,
        borderaxespad=0.3,
        **(on_the_right if wide else above),
    )


def _draw_parts(
    panel: Axes, axis: str, result: AxisResult, curve: AxisCurve, units: str
) -> list[Line2D]:
    """Draw the parts of the model and the limits of what is not resolved; return the legend."""
    unit = shown_unit(axis, 'B', units)
    floor = BELOW_CURVE * unit.factor * float(curve.adev[curve.adev > 0.0].min())
    lines: list[Line2D] = []
    for name, adev in result.part_adev(curve.m).items():
        colour, dashes = TERM_STYLES.get(name, PROCESS_STYLE)
        label = name
        if name in result.fit.noise:
            label = _legend_text(name, result.fit.noise[name], shown_unit(axis, name, units))
        if name in result.fit.likely:
            label += ', likely'
        shown = np.where(unit.factor * adev > floor, unit.factor * adev, np.nan)
        lines += panel.plot(curve.tau, shown, color=colour, ls=dashes, lw=1.1, label=label)
    _mark_terms(panel, axis, result, units)
    for name, limit in result.limit_adev(curve.m).items():
        shown = np.where(unit.factor * limit > floor, unit.factor * limit, np.nan)
        label = _legend_text(name, result.fit.noise[name], shown_unit(axis, name, units))
        colour = TERM_STYLES[name][0]
        lines += panel.plot(curve.tau, shown, color=colour, label=label, **LIMIT_STYLE)
    known = {str(line.get_label())[:1] for line in lines}
    hidden = [t for t in TERMS if t not in known]
    return [*lines, *(Line2D([], [], ls='', label=f'{t} not resolved') for t in hidden)]


def _mark_terms(panel: Axes, axis: str, result: AxisResult, units: str) -> None:
    """Mark where the coefficients are read as in IEEE Std 952: N at 1 s, K at 3 s, 0.664 B."""
    unit = shown_unit(axis, 'B', units)
    low, high = panel.get_xlim()
    for term, tau in READ_AT.items():
        adev = float(np.sqrt(result.fit.selected.parts([tau]).get(term, np.zeros(1))[0]))
        bottom, top = panel.get_ylim()
        if low < tau < high and bottom < adev * unit.factor < top:
            colour = TERM_STYLES[term][0]
            panel.plot([tau], [adev * unit.factor], '+', color=colour, ms=7.0, mew=1.2)


def _legend_text(term: str, coefficient: Coefficient, unit: ShownUnit) -> str:
    value, interval = value_text(coefficient, unit), interval_text(coefficient, unit)
    if value == NOTHING_KNOWN:
        return f'{term} not resolved'
    return f'{term} {value} {pretty_unit(unit.name)}' + (f'\n   {interval}' if interval else '')
