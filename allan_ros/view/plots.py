# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of Allan deviations and coherences, drawn with matplotlib.

Importing this module raises AllanError if matplotlib cannot be imported.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import AllanError
from ..core.estimate import interval_text, value_text
from ..core.fit.result import TERMS
from ..core.imu import AXES, SENSORS, shown_unit
from ..results.axis_result import AxisResult
from .format import SENSOR_NAMES, TERM_STYLES, drawn_curve, pretty_unit

try:
    from matplotlib import rc_context
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
except ImportError as error:
    raise AllanError(
        f'figures need matplotlib, which cannot be imported ({error}): install it with pip or apt, '
        'or use the charts of report.html'
    ) from None

if TYPE_CHECKING:
    from ..results.common_result import CommonResult
    from ..results.results import Results

RC: dict[str, Any] = {
    'font.size': 8.0,
    'legend.fontsize': 7.0,
    'legend.frameon': False,
    'axes.grid': True,
    'grid.color': '0.88',
    'pdf.fonttype': 42,
    'svg.fonttype': 'none',
    'svg.hashsalt': 'allan_ros',
}
"""Settings of the figures that this module creates. Fonts are embedded in a PDF as TrueType (42),
as journals require."""

WIDTH_IN, ROW_IN, HEAD_IN = 7.16, 1.9, 0.7
"""Width of a figure (the width of the text on a page of IEEE journals), height of a panel, and
height of the title and labels together, in inches."""

BAND_ALPHA, LIMIT_ALPHA = 0.2, 0.1
"""Opacity of a band of confidence limits, and of the area for unresolved terms."""

TAU_LABEL = 'averaging time τ [s]'


class _ShownFigure(Figure):
    """A figure that Jupyter displays, although it was not created by pyplot."""

    def _repr_png_(self) -> bytes:
        return render_figure(self, 'png')


def figure_files(
    results: Results, formats: Sequence[str], units: str = 'deg/h'
) -> dict[str, bytes]:
    """Return the figure of each sensor that has a curve: file name -> content of the file.

    ``formats`` are the formats of the files: 'png', 'svg' or 'pdf'. ``units`` is 'deg/h' or 'SI'.
    """
    return {
        f'allan_{sensor}.{form}': render_figure(figure, form)
        for sensor in SENSORS
        if (figure := sensor_figure(results, sensor, units)) is not None
        for form in formats
    }


def render_figure(figure: Figure, form: str) -> bytes:
    """Return the content of an image file of the figure; ``form`` is 'png', 'svg' or 'pdf'."""
    metadata: dict[str, dict[str, Any]] = {
        'png': {'Software': 'allan_ros'},
        'svg': {'Date': None},
        'pdf': {'CreationDate': None, 'Producer': None, 'Creator': 'allan_ros'},
    }
    file = io.BytesIO()
    with rc_context(RC):
        figure.savefig(file, format=form, dpi=200, metadata=metadata[form])
    return file.getvalue()


def sensor_figure(results: Results, sensor: str, units: str = 'deg/h') -> Figure | None:
    """Return a figure of the Allan deviations of a sensor; None if no axis has a curve.

    The figure has a panel for each axis with a curve. ``sensor`` is 'gyro' or 'accel', and
    ``units`` is 'deg/h' or 'SI'.
    """
    axes = {a: results.axes[a] for a in AXES[SENSORS[sensor]] if a in results.axes}
    axes = {name: axis for name, axis in axes.items() if axis.curve is not None}
    if not axes:
        return None
    label_text = f' of {results.identity.label}' if results.identity.label else ''
    title = (
        f'{SENSOR_NAMES[sensor]}{label_text}: Allan deviation, {results.samples:,} samples at '
        f'{results.rate_hz:.4g} Hz, {results.duration_s / 3600.0:.3g} h'
    )
    with rc_context(RC):
        figure, panels = _new_figure(len(axes), title)
        for panel, (name, axis) in zip(panels, axes.items()):
            _draw_axis(panel, name, axis, units)
            if panel.lines:
                panel.legend(loc='center left', bbox_to_anchor=(1.0, 0.5))
    return figure


def common_figure(common: CommonResult) -> Figure:
    """Return a figure of coherences with 95 % limits; each axis or pair of axes has a panel."""
    names = list(dict.fromkeys(row.axis for row in common.rows))
    with rc_context(RC):
        title = 'coherence: 0 for independent, 1 for common noise'
        figure, panels = _new_figure(len(names), title)
        for panel, name in zip(panels, names):
            panel.set(xscale='log', ylim=(-1.05, 1.05), ylabel=name.replace('_', ' '))
            panel.axhline(0.0, color='k', lw=0.8)
            for row in (row for row in common.rows if row.axis == name):
                tau, value, low, high = row.coherence
                (line,) = panel.plot(tau, value, lw=1.0, label=row.label)
                panel.fill_between(tau, low, high, color=line.get_color(), alpha=BAND_ALPHA, lw=0)
        for text in panels[0].legend().get_texts():
            text.set_parse_math(False)
    return figure


def draw_axes(panel: Axes, axes: Mapping[str, AxisResult], units: str = 'deg/h') -> None:
    """Draw Allan curves and models of axes; for a single axis, also draw the parts of its model."""
    for name, axis in axes.items():
        unit = shown_unit(name, 'B', units)
        curve = drawn_curve(axis, unit.factor)
        if len(axes) == 1:
            _draw_axis(panel, name, axis, units)
        elif curve is not None:
            (points,) = panel.loglog(curve.tau, curve.adev, 'o', ms=3, label=name)
            color = points.get_color()
            panel.fill_between(
                curve.tau, curve.low, curve.high, color=color, alpha=BAND_ALPHA, lw=0
            )
            panel.loglog(curve.tau, curve.model, color=color, lw=1.0)
            panel.set_ylabel(f'Allan deviation [{pretty_unit(unit.name)}]')
    panel.set_xlabel(TAU_LABEL)
    if panel.lines:
        panel.legend()


def _new_figure(rows: int, title: str) -> tuple[Figure, Any]:
    """Return a figure and its panels, (rows,), which share the horizontal axis."""
    size = (WIDTH_IN, HEAD_IN + ROW_IN * rows)
    figure = _ShownFigure(figsize=size, layout='constrained')
    panels = figure.subplots(rows, sharex=True, squeeze=False)[:, 0]
    heading = figure.suptitle(title, fontsize='medium', fontweight='bold')
    # a frame_id or serial number may contain dollar signs, which would enclose a formula
    heading.set_parse_math(False)
    panels[-1].set_xlabel(TAU_LABEL)
    return figure, panels


def _draw_axis(panel: Axes, name: str, axis: AxisResult, units: str) -> None:
    unit = shown_unit(name, 'B', units)
    panel.set_ylabel(f'{name.replace("_", " ")} [{pretty_unit(unit.name)}]')
    curve = drawn_curve(axis, unit.factor)
    if curve is None or not curve.any:
        panel.text(0.5, 0.5, 'no noise', ha='center', transform=panel.transAxes)
        return
    panel.set(xscale='log', yscale='log')
    style = {'marker': 'o', 'ls': '', 'ms': 2.6, 'mew': 0.6}
    panel.plot(curve.tau, curve.adev, color='k', mfc='none', label='measured', **style)
    is_uncertain = curve.uncertain
    tau_uncertain, adev_uncertain = curve.tau[is_uncertain], curve.adev[is_uncertain]
    panel.plot(tau_uncertain, adev_uncertain, color='0.7', label='uncertain', **style)
    panel.fill_between(
        curve.tau, curve.low, curve.high, color='k', alpha=BAND_ALPHA, lw=0, label='68 % limits'
    )
    panel.plot(curve.tau, curve.model, 'k-', lw=0.9, label='model')
    for part, adev in (*curve.parts.items(), *curve.limits.items()):
        # processes other than the five terms are gray
        color, dashes = TERM_STYLES.get(part, ('0.5', (0, (2, 1))))
        dashes = dashes if part in curve.parts else (0, (1, 3))
        text = _part_text(part, name, axis, units)
        panel.plot(curve.tau, adev, color=color, ls=dashes, lw=1.1, label=text)
    label = 'unresolved terms,\nup to 95 % limits' if curve.limits else ''
    panel.fill_between(
        curve.tau, curve.model, curve.upper, color='k', alpha=LIMIT_ALPHA, lw=0, label=label
    )
    # each mark shows where the deviation of a term equals the coefficient of this term
    for term, (tau, value) in curve.marks.items():
        panel.plot([tau], [value], '+', color=TERM_STYLES[term][0], ms=7.0, mew=1.2)
    panel.set_ylim(0.45 * np.nanmin(curve.adev), 1.8 * np.nanmax(curve.adev))


def _part_text(part: str, name: str, axis: AxisResult, units: str) -> str:
    label = part
    if part in TERMS:
        unit, coefficient = shown_unit(name, part, units), axis.fit.noise[part]
        interval = interval_text(coefficient, unit)
        label = f'{part} {value_text(coefficient, unit)} {pretty_unit(unit.name)}'
        label += f' ({interval})' if interval else ''
    return f'{label}, likely' if part in axis.fit.likely else label
