# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The picture to trust the numbers by: Allan deviation, fit and its five parts beside the signal.

Colours are those of Okabe and Ito ("Color universal design", 2008), which the colour-blind tell
apart; every part has its own dashes besides, so that the picture is as legible in grey.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..core.batch import AXES, SENSORS
from ..core.fit import TERMS, Coefficient
from .envelope import SignalEnvelope
from .results import AxisResult, Results
from .shown import (
    NOTHING_KNOWN,
    ShownUnit,
    interval_text,
    shown_signal_unit,
    shown_unit,
    value_text,
)

Floats = NDArray[np.float64]

TERM_STYLES: dict[str, tuple[str, Any]] = {
    'Q': ('#CC79A7', (0, (1, 1.2))),
    'N': ('#0072B2', (0, (5, 1.5))),
    'B': ('#009E73', (0, (6, 1.5, 1, 1.5))),
    'K': ('#D55E00', (0, (9, 2))),
    'R': ('#E69F00', (0, (3, 1.2, 1, 1.2, 1, 1.2))),
}
"""Term -> colour and dashes of its part."""

WIDTH_IN, ROW_IN, HEAD_IN, FOOT_IN = 11.0, 2.9, 0.55, 0.5
"""Size of the picture in inches: its width, the height of an axis, what is above and below."""

PNG_DPI = 150
"""Dots per inch of the PNG."""

BELOW_CURVE = 0.2
"""A part is drawn where it is above this share of the lowest point of the curve."""

RC = {'font.size': 9.0, 'svg.fonttype': 'none', 'svg.hashsalt': 'allan_ros', 'axes.grid': False}


def sensor_figure(
    results: Results, sensor: str, signals: Sequence[SignalEnvelope] = (), units: str = 'datasheet'
) -> Figure | None:
    """Return the figure of one sensor: a row for each of its axes, or None when it is absent.

    Parameters
    ----------
    results : Results
    sensor : 'gyro' or 'accel'
    signals : sequence of SignalEnvelope
        One a recording, drawn one after the other; without any the curves stand alone.
    units : 'datasheet' or 'si'
    """
    axes = [a for a in AXES[SENSORS[sensor]] if a in results.axes and results.axes[a].curve]
    if not axes:
        return None
    with rc_context(RC):
        height = ROW_IN * len(axes) + HEAD_IN + FOOT_IN
        figure = Figure(figsize=(WIDTH_IN, height))
        columns = 2 if signals else 1
        panels = figure.subplots(
            len(axes),
            columns,
            squeeze=False,
            sharex='col',
            gridspec_kw={
                'width_ratios': [4, 3][:columns],
                'left': 0.075,
                'right': 0.985 if signals else 0.8,
                'bottom': FOOT_IN / height,
                'top': 1.0 - HEAD_IN / height,
                'wspace': 0.62,
                'hspace': 0.18,
            },
        )
        for row, axis in zip(panels, axes):
            _draw_curve(row[0], axis, results.axes[axis], units)
            if signals:
                _draw_signal(row[1], axis, signals, units)
        for panel, label in zip(panels[-1], ('averaging time τ [s]', 'time [h]')):
            panel.set_xlabel(label)
        figure.suptitle(_title(results, sensor), fontsize=11, y=1.0 - 0.1 / height, va='top')
    return figure


def to_png(figure: Figure) -> bytes:
    """Return the figure as a PNG file."""
    return _saved(figure, 'png', dpi=PNG_DPI, metadata={'Software': 'allan_ros'})


def to_svg(figure: Figure) -> str:
    """Return the figure as an ``<svg>`` element to stand inside a page."""
    text = _saved(figure, 'svg', metadata={'Date': None}).decode()
    return text[text.index('<svg') :]


def _saved(figure: Figure, form: str, **how: Any) -> bytes:
    file = io.BytesIO()
    with rc_context(RC):
        figure.savefig(file, format=form, **how)
    return file.getvalue()


def _title(results: Results, sensor: str) -> str:
    name = {'gyro': 'Gyroscope', 'accel': 'Accelerometer'}[sensor]
    of = results.identity.hardware_id or results.identity.frame_id
    return (
        f'{name}{f" of {of}" if of else ""}: {results.samples:,} samples at '
        f'{results.rate_hz:.4g} Hz, {results.duration_s / 3600.0:.3g} h'
    )


def _draw_curve(panel: Axes, axis: str, result: AxisResult, units: str) -> None:
    """Draw the deviation with its limits, the fit and the parts it is made of."""
    curve, unit = result.curve, shown_unit(axis, 'B', units)
    assert curve is not None
    adev, low, high = (unit.factor * a for a in (curve.adev, curve.ci_low, curve.ci_high))
    panel.set_ylabel(f'{axis.replace("_", " ")}\nAllan deviation [{unit.name}]')
    if not np.any(adev > 0.0):
        panel.text(0.5, 0.5, 'no noise to show', ha='center', transform=panel.transAxes)
        return
    panel.set_xscale('log')
    panel.set_yscale('log', nonpositive='mask')
    panel.fill_between(curve.tau, low, high, color='0.8', lw=0, label='68 % limits')
    panel.plot(curve.tau, adev, 'o', ms=3, mfc='white', mec='0.15', mew=0.8, label='measured')
    parts = result.part_adev(curve.m) * unit.factor
    floor = BELOW_CURVE * adev[adev > 0.0].min()
    for i, term in enumerate(TERMS):
        colour, dashes = TERM_STYLES[term]
        coefficient, its_unit = result.fit.noise[term], shown_unit(axis, term, units)
        known = coefficient.status == 'estimated'
        panel.plot(
            curve.tau,
            np.where((parts[:, i] > floor) & known, parts[:, i], np.nan),
            color=colour if known else 'none',
            ls=dashes,
            lw=1.4,
            label=_legend_text(term, coefficient, its_unit),
        )
    for name, adev_of_extra in result.extra_adev(curve.m).items():
        shown = unit.factor * adev_of_extra
        panel.plot(
            curve.tau, np.where(shown > floor, shown, np.nan), color='0.45', lw=0.9, label=name
        )
    total = np.where(curve.m >= result.fit.m_min, result.total_adev(curve.m), np.nan)
    panel.plot(curve.tau, unit.factor * total, color='black', lw=1.0, label='fit', zorder=1.9)
    panel.grid(which='major', color='0.88', lw=0.6)
    panel.legend(fontsize=7, loc='upper left', bbox_to_anchor=(1.0, 1.0), frameon=False)


def _legend_text(term: str, coefficient: Coefficient, unit: ShownUnit) -> str:
    value, interval = value_text(coefficient, unit), interval_text(coefficient, unit)
    if value == NOTHING_KNOWN:
        return f'{term} not observable'
    return f'{term} {value} {unit.name}\n    {interval}'.rstrip()


def _draw_signal(panel: Axes, axis: str, signals: Sequence[SignalEnvelope], units: str) -> None:
    """Draw the outline of the signal about its mean, one recording after the other."""
    unit = shown_signal_unit(axis, units)
    column = AXES.index(axis)
    outlines = [(s.time_s, s.low[:, column], s.high[:, column]) for s in signals if s.bins]
    middle = float(np.nanmedian(np.concatenate([low + high for _, low, high in outlines]))) / 2.0
    start_s = 0.0
    for i, (time_s, low, high) in enumerate(outlines):
        hours = (start_s + time_s) / 3600.0
        panel.fill_between(
            hours,
            (low - middle) * unit.factor,
            (high - middle) * unit.factor,
            color=('#56B4E9', '#0072B2')[i % 2],
            ec='none',
            step='post',
        )
        start_s += float(time_s[-1])
    panel.set_title(f'signal about {middle * unit.factor:.4g} {unit.name}', fontsize=8, loc='left')
    panel.set_ylabel(f'[{unit.name}]')
    panel.set_axisbelow(True)
    panel.grid(color='0.9', lw=0.6)
    panel.margins(x=0.01)
