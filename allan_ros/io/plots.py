# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of one sensor: its Allan deviation and raw signal, or a comparison of recordings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context, rcParams
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ..core.fit import TERMS
from ..core.imu import AXES, SENSORS
from .axis_result import AxisResult
from .format import (
    NOTHING_KNOWN,
    SENSOR_NAMES,
    interval_text,
    pretty_unit,
    shown_unit,
    value_text,
)
from .plot_layout import (
    HEAD_IN,
    KEY_ABOVE_IN,
    KEY_RIGHT_IN,
    LEFT_IN,
    LEGEND_ROW_IN,
    MARGIN_IN,
    RC,
    SMALL,
    TAU_LABEL,
    draw_key,
    heading,
    log_axes,
    new_figure,
)
from .plot_style import STYLES, TERM_STYLES, DrawnCurve, drawn_curve
from .signal import SignalSummary

if TYPE_CHECKING:
    from .comparison import RunComparison
    from .results import Results

NARROW_IN = 5.0
"""Width in inches below which a figure has one panel for each axis, and its legend above the
panel."""

NARROW_ENTRIES = 6
"""Largest number of entries in the legend of a narrow figure."""

BAND_ALPHA, LIMIT_ALPHA = 0.2, 0.1
"""Opacity of the 68 % limits, and of the possible contribution of unresolved terms."""

BAND_STYLE: dict[str, Any] = {'lw': 6.0, 'solid_capstyle': 'butt'}
"""Style of the line that stands for a band in the legend."""

LIMIT_STYLE: dict[str, Any] = {'ls': (0, (1, 3)), 'lw': 0.9}
"""Style of the 95 % upper limit of a term that is not resolved."""

PROCESS_STYLE = ('0.5', (0, (2, 1)))
"""Color and dashes of a Gauss-Markov process or a sinusoid."""

HATCHES = {True: '///', False: 3 * '\\'}
"""Whether the IMU moved -> hatching of the excluded samples."""

FADE = 0.75
"""Opacity of the background color over samples that are not used."""

TIME_UNITS = ((7200.0, 3600.0, 'h'), (120.0, 60.0, 'min'), (0.0, 1.0, 's'))
"""Units of the time axis: smallest length of a recording in s, seconds per unit, name."""

SIGNAL_RANGE = 1.15
"""Upper end of the axis of the signal, relative to the largest used sample."""

STEPS = (1, 2, 5, 10)
"""Steps between ticks that are easy to read."""

RUN_STYLES: tuple[tuple[str, str, Any], ...] = (
    ('', 'o', '-'),
    ('#D55E00', 's', '--'),
    ('#0072B2', '^', '-.'),
    ('#009E73', 'D', ':'),
    ('#CC79A7', 'v', (0, (5, 1, 1, 1, 1, 1))),
    ('#E69F00', 'P', (0, (8, 2))),
)
"""Color of Okabe and Ito ('' for the text color), marker and dashes of each recording."""

MARK_EVERY = 6
"""Points of a curve per marker; markers of different recordings are at different points."""

RATIO_MARGIN = 1.1
"""Upper end of the axis of ratios, relative to the largest end of an interval."""

RATIO_STYLE: dict[str, Any] = {'ls': '', 'ms': 4.0, 'capsize': 1.5, 'lw': 0.9}
"""Style of ratios with their intervals."""

OFFSET = 1.05
"""Factor in averaging time between the ratios of two recordings, which would overlap otherwise."""


def sensor_figure(
    results: Results,
    sensor: str,
    summary: SignalSummary | None = None,
    units: str = 'datasheet',
    style: Mapping[str, Any] = STYLES['page'],
) -> Figure | None:
    """Return the figure of one sensor with a row for each axis; None if no axis has a curve.

    The raw signal is drawn next to the curves if ``summary`` is given and the figure is wide.
    ``units`` is 'datasheet' or 'si'. ``style`` are settings of matplotlib; their ``figure.figsize``
    is the size for three axes.
    """
    known = {a: results.axes[a] for a in AXES[SENSORS[sensor]] if a in results.axes}
    axes = {name: axis for name, axis in known.items() if axis.curve is not None}
    if not axes:
        return None
    facts = (
        f'{results.samples:,} samples at {results.rate_hz:.4g} Hz, '
        f'{results.duration_s / 3600.0:.3g} h'
    )
    head = HEAD_IN + LEGEND_ROW_IN
    with rc_context({**RC, **style}):
        wide = rcParams['figure.figsize'][0] >= NARROW_IN
        if wide and summary is not None:
            between = KEY_RIGHT_IN + LEFT_IN - 0.2
            figure, panels = new_figure(len(axes), head, between=between, ratios=(2.0, 1.0))
            facts += _hatch_text(summary)
        elif wide:
            figure, panels = new_figure(len(axes), head, right=MARGIN_IN + KEY_RIGHT_IN)
        else:
            figure, panels = new_figure(len(axes), head, gap=KEY_ABOVE_IN)
        for row, (name, axis) in zip(panels, axes.items()):
            _draw_axis(row[0], name, axis, units, wide)
            if len(row) > 1 and summary is not None:
                _draw_signal(row[1], name, summary, units)
                row[1].set_xlabel(f'time [{_time_unit(summary)[1]}]' * (row is panels[-1]))
        ink = rcParams['text.color']
        points = {'ls': '', 'marker': 'o', 'ms': 3, 'mfc': 'none', 'mec': ink, 'mew': 0.7}
        entries = [
            ('measured', points),
            ('68 % limits', {'color': ink, 'alpha': BAND_ALPHA, **BAND_STYLE}),
            ('model', {'color': ink, 'lw': 0.9}),
            ('unresolved terms, at most', {'color': ink, 'alpha': LIMIT_ALPHA, **BAND_STYLE}),
        ]
        of = f' of {results.identity.label}' if results.identity.label else ''
        columns = 4 if wide else 3
        heading(figure, f'{SENSOR_NAMES[sensor]}{of}', facts, entries[:columns], columns)
    return figure


def comparison_figure(
    comparison: RunComparison,
    sensor: str,
    units: str = 'datasheet',
    style: Mapping[str, Any] = STYLES['page'],
) -> Figure | None:
    """Return the figure of one sensor with a row for each axis; None if no axis has a curve.

    The left panel shows the deviations with their 68.3 % limits. In a wide figure, the right panel
    shows the ratios to the first recording with 95 % intervals; significant ones are filled. Units
    and style are those of `sensor_figure`.
    """
    curves: dict[str, dict[int, DrawnCurve]] = {}
    for name in AXES[SENSORS[sensor]]:
        factor = shown_unit(name, 'B', units).factor
        for i, run in enumerate(comparison.runs):
            axis = run.results.axes.get(name)
            if axis is not None and (curve := drawn_curve(axis, factor)) is not None:
                curves.setdefault(name, {})[i] = curve
    if not curves:
        return None
    with rc_context({**RC, **style}):
        wide = rcParams['figure.figsize'][0] >= NARROW_IN
        columns = 4 if wide else 2
        ratios = bool(comparison.pairs) and wide
        head = HEAD_IN + LEGEND_ROW_IN * math.ceil(len(comparison.runs) / columns)
        figure, panels = new_figure(
            len(curves), head, between=0.52, ratios=(1.0, 1.0) if ratios else (1.0,)
        )
        for row, (name, by_run) in zip(panels, curves.items()):
            panel = row[0]
            if _set_up(panel, name, by_run.values(), units):
                for i, curve in by_run.items():
                    _draw_run(panel, i, curve)
            if ratios:
                _draw_ratios(row[1], name, comparison)
        if ratios:
            panels[-1][1].set_xlabel(TAU_LABEL)
        styles = [_run_style(i) for i in range(len(comparison.runs))]
        entries = [
            (run.label, {'color': color, 'marker': mark, 'ls': dashes, 'ms': 4.0, 'lw': 1.1})
            for run, (color, mark, dashes) in zip(comparison.runs, styles)
        ]
        facts = f'right: ratio to {comparison.runs[0].label}, filled where significant'
        heading(figure, SENSOR_NAMES[sensor], facts if ratios else '', entries, columns)
    return figure


def draw_axes(panel: Axes, axes: Mapping[str, AxisResult], units: str = 'datasheet') -> None:
    """Draw the curves and models of axes; for a single axis, also the parts of its model."""
    for name, axis in axes.items():
        if len(axes) == 1:
            _draw_axis(panel, name, axis, units, wide=False)
            continue
        unit = shown_unit(name, 'B', units)
        curve = drawn_curve(axis, unit.factor)
        if curve is None:
            continue
        (points,) = panel.loglog(curve.tau, curve.adev, 'o', ms=3, label=name)
        color = points.get_color()
        panel.fill_between(curve.tau, curve.low, curve.high, color=color, alpha=BAND_ALPHA, lw=0)
        panel.loglog(curve.tau, curve.model, color=color, lw=1.0)
        panel.set_ylabel(f'Allan deviation  [{pretty_unit(unit.name)}]')
    panel.set_xlabel(TAU_LABEL)
    if len(axes) > 1:
        panel.legend()


def _set_up(panel: Axes, name: str, curves: Iterable[DrawnCurve], units: str) -> bool:
    """Set labels and limits of a panel for curves of one axis; return False if all are empty."""
    unit = pretty_unit(shown_unit(name, 'B', units).name)
    panel.set_ylabel(f'{name.replace("_", " ")}  [{unit}]')
    some = [curve for curve in curves if curve.any]
    if not some:
        panel.text(0.5, 0.5, 'no noise', ha='center', transform=panel.transAxes)
        panel.set_yticks([])
        return False
    tau = np.concatenate([curve.tau for curve in some])
    adev = np.concatenate([curve.adev for curve in some])
    across = tau.min() / 1.3, tau.max() * 1.3
    log_axes(panel, across, (0.45 * np.nanmin(adev), 1.8 * np.nanmax(adev)))
    return True


def _draw_axis(panel: Axes, name: str, axis: AxisResult, units: str, wide: bool) -> None:
    """Draw the deviation with its limits, the model, its parts, and the legend of the parts."""
    curve = drawn_curve(axis, shown_unit(name, 'B', units).factor)
    if curve is None or not _set_up(panel, name, [curve], units):
        return
    ink = rcParams['text.color']
    panel.fill_between(curve.tau, curve.low, curve.high, color=ink, alpha=BAND_ALPHA, lw=0)
    panel.plot(
        *(curve.tau, curve.adev, 'o'), ms=2.6, mfc=rcParams['axes.facecolor'], mec=ink, mew=0.6,
        label='measured',
    )  # fmt: skip
    entries: list[tuple[str, dict[str, Any]]] = []
    for part, adev in (*curve.parts.items(), *curve.limits.items()):
        color, dashes = TERM_STYLES.get(part, PROCESS_STYLE)
        style = {'ls': dashes, 'lw': 1.1} if part in curve.parts else LIMIT_STYLE
        entries.append((_part_text(part, name, axis, units), {'color': color, **style}))
        panel.plot(curve.tau, adev, **entries[-1][1])
    panel.plot(curve.tau, curve.model, color=ink, lw=0.9, zorder=1.9)
    panel.fill_between(curve.tau, curve.model, curve.upper, color=ink, alpha=LIMIT_ALPHA, lw=0)
    for term, (tau, value) in curve.read.items():  # as in IEEE Std 952: N at 1 s, K at 3 s
        panel.plot([tau], [value], '+', color=TERM_STYLES[term][0], ms=7.0, mew=1.2)
    if wide:
        known = {**curve.parts, **curve.limits}
        entries += [(f'{term} not resolved', {}) for term in TERMS if term not in known]
    else:
        entries = [(text.partition('\n')[0], style) for text, style in entries[:NARROW_ENTRIES]]
    draw_key(panel, entries, wide)


def _part_text(part: str, name: str, axis: AxisResult, units: str) -> str:
    """Return the legend of a part of the model: name, value, and interval on a second line."""
    text = part
    if part in axis.fit.noise:
        unit = shown_unit(name, part, units)
        coefficient = axis.fit.noise[part]
        value, interval = value_text(coefficient, unit), interval_text(coefficient, unit)
        text = f'{part} {value} {pretty_unit(unit.name)}' + (f'\n{interval}' if interval else '')
        if value == NOTHING_KNOWN:
            text = f'{part} not resolved'
    return f'{text}, likely' if part in axis.fit.likely else text


def _draw_signal(panel: Axes, axis: str, summary: SignalSummary, units: str) -> None:
    """Draw the signal relative to its median, and mark the samples that are not used."""
    unit, column = shown_unit(axis, 'signal', units), AXES.index(axis)
    middle = summary.middle[column]
    low, high = ((a[:, column] - middle) * unit.factor for a in (summary.low, summary.high))
    scale, _ = _time_unit(summary)
    panel.fill_between(
        *(summary.time_s / scale, low, high), color=TERM_STYLES['N'][0], ec='none', step='post'
    )
    for start, end in summary.gaps:
        panel.axvspan(start / scale, end / scale, fc=rcParams['grid.color'], lw=0)
    for start, end, why in summary.left_out:
        span, hatch = (start / scale, end / scale), HATCHES[why == 'motion']
        panel.axvspan(*span, fc=rcParams['axes.facecolor'], alpha=FADE, lw=0)
        panel.axvspan(*span, fc='none', ec=rcParams['text.color'], hatch=2 * hatch, lw=0)
    for start in summary.starts[1:]:
        panel.axvline(start / scale, color=rcParams['text.color'], lw=0.6)
    reach = SIGNAL_RANGE * unit.factor * float(summary.reach[column])
    panel.set_ylim(-reach, reach)
    about = f'about {middle * unit.factor:.4g} {pretty_unit(unit.name)}'
    panel.text(0.0, 1.02, about, size=SMALL, transform=panel.transAxes)
    panel.yaxis.set_major_locator(MaxNLocator(4, steps=STEPS, symmetric=True))
    panel.xaxis.set_major_locator(MaxNLocator(4, steps=STEPS))
    panel.set_axisbelow(True)
    panel.grid(axis='y', color=rcParams['grid.color'], lw=0.5)
    panel.margins(x=0.01)


def _time_unit(summary: SignalSummary) -> tuple[float, str]:
    """Return the seconds per unit of the time axis, and the name of the unit."""
    length = float(summary.time_s[-1])
    return next((scale, name) for least, scale, name in TIME_UNITS if length >= least)


def _hatch_text(summary: SignalSummary) -> str:
    """Return text that explains the hatching of excluded samples, or '' if there are none."""
    moved = {out.why == 'motion' for out in summary.left_out}
    meanings = {True: 'the IMU moved', False: 'not used for another reason'}
    texts = [f'{HATCHES[why]} {text}' for why, text in meanings.items() if why in moved]
    return f'; hatched: {", ".join(texts)}' if texts else ''


def _run_style(run: int) -> tuple[str, str, Any]:
    """Return color, marker and dashes of the recording with this index."""
    color, marker, dashes = RUN_STYLES[run % len(RUN_STYLES)]
    return color or rcParams['text.color'], marker, dashes


def _draw_run(panel: Axes, run: int, curve: DrawnCurve) -> None:
    """Draw the deviation of one of several recordings."""
    color, marker, dashes = _run_style(run)
    panel.fill_between(curve.tau, curve.low, curve.high, color=color, alpha=BAND_ALPHA, lw=0)
    marked = (run * MARK_EVERY // len(RUN_STYLES), MARK_EVERY)
    style = {'color': color, 'ls': dashes, 'marker': marker, 'ms': 3.0, 'lw': 1.0}
    panel.plot(curve.tau, curve.adev, markevery=marked, **style)


def _draw_ratios(panel: Axes, axis: str, comparison: RunComparison) -> None:
    """Draw the ratios of the deviations to the first recording, with 95 % intervals."""
    points = [
        (run, d.significant, d.tau, d.ratio, *d.ci95)
        for run, pair in enumerate(comparison.pairs, 1)
        for d in pair.differences
        if d.axis == axis and d.tau and d.ratio and d.ci95 and d.ci95[0] > 0.0
    ]
    if not points:
        return
    runs, significant, tau, ratio, low, high = (np.array(column) for column in zip(*points))
    reach = RATIO_MARGIN * max(high.max(), 1.0 / low.min())
    log_axes(panel, (tau.min() / 1.3, tau.max() * 1.3), (1.0 / reach, reach))
    panel.axhline(1.0, color=rcParams['text.color'], lw=0.8)
    for run, filled in sorted({(int(point[0]), point[1]) for point in points}):
        some = (runs == run) & (significant == filled)
        color, marker, _ = _run_style(run)
        panel.errorbar(
            tau[some] * OFFSET ** (run - 1),
            ratio[some],
            yerr=[(ratio - low)[some], (high - ratio)[some]],
            mfc=color if filled else rcParams['axes.facecolor'],
            **{**RATIO_STYLE, 'color': color, 'marker': marker},
        )
