# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Summary of several IMUs: a CSV table for programs, and an HTML page for readers."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from urllib.parse import quote

import numpy as np

from ..core.allan.curve import AxisCurve
from ..core.estimate import Estimate, significant
from ..core.imu import AXES, SENSORS, sensor_of, shown_unit
from ..results.plan import Limits
from ..results.results import Results
from ..results.unit_check import UnitCheck
from ..version import __version__
from .table import Cell, Heading, Record, Table, csv_text, html_table

SUMMARY, INDEX = 'summary.csv', 'index.html'
"""Names of the summary files, which are in the folder that contains the folders of the IMUs."""

SUMMARY_TERMS = ('N', 'B', 'K')
"""Coefficients that the summary states for each axis, whether or not the plan limits them."""


@dataclass(frozen=True)
class UnitRow:
    """What the summary states about one IMU.

    Attributes
    ----------
    name : str
        Name of the IMU in the batch.
    serial : str
        Serial number of the IMU; '' if unknown.
    word : str
        The decision or verdict, such as 'healthy'.
    reason : str
        Reason for the decision, in one line.
    results : Results or None
        Results of the recording; None if the recording could not be read or analyzed.
    check : UnitCheck or None
        Decision about the IMU; None if there are no results.
    report : str
        Path of the report, relative to the summary; '' if there is none.
    exit_code : int
        Exit code for this IMU. The exit code of the command is the worst of all IMUs.
    """

    name: str
    serial: str
    word: str
    reason: str
    results: Results | None
    check: UnitCheck | None
    report: str = ''
    exit_code: int = 0


def summary_csv(rows: Sequence[UnitRow], units: str) -> str:
    """Return a CSV table with one row for each IMU.

    Each quantity has a column for its value, two for the ends of its 95 % interval, and two for the
    limits of the plan. For N of the x axis, they are ``gyro_x N [deg/sqrt(h)]``, followed by
    ``gyro_x N low95``, ``high95``, ``lower limit`` and ``upper limit``, each with the unit. If a
    quantity is not resolved, its value and ``low95`` are empty, and ``high95`` is its 95 % upper
    limit. Columns that are empty for all IMUs are omitted. ``units`` is 'deg/h' or 'SI'.
    Quantities with limits are in the units of measurement that the plan states.
    """
    records = [_record(row, units) for row in rows]
    names = dict.fromkeys(name for record in records for name in record)
    used_names = [n for n in names if any(record.get(n) not in (None, '') for record in records)]
    return csv_text([{n: record.get(n) for n in used_names} for record in records], used_names)


def _record(row: UnitRow, units: str) -> Record:
    record: dict[str, float | int | str | None] = {
        'unit': row.name,
        'serial': row.serial,
        'verdict': row.word,
        'exit_code': row.exit_code,
        'reason': row.reason,
    }
    if row.results is None or row.check is None:
        return record
    record['hours'] = row.results.duration_s / 3600.0
    record['rate [Hz]'] = row.results.rate_hz
    limited_quantities = {
        (check.axis, check.quantity): (check.measured, row.check.plan.limits_of(check))
        for check in row.check.checks
        if row.check.plan is not None
    }
    for axis, result in row.results.axes.items():
        for term in SUMMARY_TERMS:
            unit = shown_unit(axis, term, units)
            no_limits = Limits(None, None, unit.name, 1.0 / unit.factor)
            value_and_limits = limited_quantities.pop(
                (axis, term), (result.fit.noise[term].magnitude, no_limits)
            )
            record |= _columns(f'{axis} {term}', *value_and_limits)
        for quantity in [quantity for key, quantity in limited_quantities if key == axis]:
            record |= _columns(f'{axis} {quantity}', *limited_quantities.pop((axis, quantity)))
    for (axis, quantity), value_and_limits in limited_quantities.items():
        record |= _columns(f'{axis} {quantity}'.strip(), *value_and_limits)
    return record


def _columns(name: str, measured: Estimate, limits: Limits) -> Iterator[tuple[str, float | None]]:
    """Yield the name of each column of a quantity, and its number in the unit of the limits.

    The number is None if it is unknown or not finite. An exact value has no interval.
    """
    unit = f' [{limits.unit}]' if limits.unit else ''
    value = measured.value if measured.resolved else None
    low, high = (measured.resolved and measured.ci95) or (None, measured.upper95)
    if low == high:  # an exact value, for which no interval is stated
        low = high = None
    for suffix, number in (
        ('', value),
        (' low95', low),
        (' high95', high),
        (' lower limit', limits.lower),
        (' upper limit', limits.upper),
    ):
        is_finite = number is not None and math.isfinite(number)
        yield (
            f'{name}{suffix}{unit}',
            number / limits.scale if is_finite and number is not None else None,
        )


# --- the page -------------------------------------------------------------------------------------

WIDTH, HEIGHT = 110, 44
"""Width and height in pixels of the small drawing with the curves of a sensor."""

COLORS = ('#c0504d', '#4f9a57', '#4f72c0')
"""Colors of the axes x, y and z."""

INDEX_STYLE = """
:root { color-scheme: light dark; font: 15px/1.4 system-ui, sans-serif; }
body { margin: 1.5rem; }
h1 { font-size: 1.3rem; }
table { border-collapse: collapse; }
th, td { padding: .3rem .6rem; text-align: left; vertical-align: top;
  border-bottom: 1px solid #8884; }
thead th { cursor: pointer; white-space: nowrap; }
thead th[aria-sort=ascending]::after { content: ' \\25b4'; }
thead th[aria-sort=descending]::after { content: ' \\25be'; }
td.failed, td.error { color: #c0392b; font-weight: 600; }
td.attention, td.unknown { color: #a06000; font-weight: 600; }
td.healthy { color: #2e7d32; font-weight: 600; }
small { display: block; opacity: .75; }
svg { display: block; }
.wide { overflow-x: auto; }
"""

SCRIPT = """
'use strict';
for (const table of document.querySelectorAll('table')) {
  const body = table.tBodies[0];
  const content = (row, i) => row.cells[i].textContent.trim();
  [...table.tHead.rows[0].cells].forEach((head, i) => {
    head.tabIndex = 0;
    const sort = () => {
      const down = head.ariaSort === 'ascending';
      for (const other of table.tHead.rows[0].cells) other.ariaSort = null;
      head.ariaSort = down ? 'descending' : 'ascending';
      const order = new Intl.Collator('en', {numeric: true});
      const rows = [...body.rows].sort((a, b) => order.compare(content(a, i), content(b, i)));
      body.append(...(down ? rows.reverse() : rows));
    };
    head.addEventListener('click', sort);
    head.addEventListener('keydown', (event) => { if (event.key === 'Enter') sort(); });
  });
}
"""

CLASSES = {
    'healthy': 'healthy',
    'usable with care': 'attention',
    'not judged': 'unknown',
    'failed': 'failed',
    'error': 'error',
}
"""Word of a verdict -> CSS class of its table cell."""


def index_html(rows: Sequence[UnitRow], plan: str = '') -> str:
    """Return an HTML page with a sortable table of the IMUs, and links to their reports.

    Small drawings in the table show the Allan deviations of each sensor on logarithmic scales,
    which are equal for all IMUs, and the limits of N as a band. ``plan`` is the name of the plan;
    '' without a plan.
    """
    sensors = [s for s in SENSORS if any(_curves(row, s) for row in rows)]
    columns = [Heading('verdict'), Heading('serial'), Heading('reason'), Heading('h at rest')]
    columns += [Heading(f'{sensor} deviation') for sensor in sensors]
    frames = {sensor: _frame(rows, sensor) for sensor in sensors}
    table_rows, drawings = [], {}
    for i, row in enumerate(rows):
        hours = '' if row.results is None else significant(row.results.duration_s / 3600.0, 3)
        cells = [
            Cell(row.word, status=CLASSES.get(row.word, 'measured')),
            Cell(row.serial),
            Cell(row.reason),
            Cell(hours),
        ]
        for sensor in sensors:
            placeholder = f'\ue000{i} {sensor}\ue000'
            drawings[placeholder] = _drawing(row, sensor, frames[sensor])
            cells.append(Cell(placeholder))
        link = Cell(row.name, link=quote(row.report))
        table_rows.append((Heading(str(i + 1)), [link, *cells]))
    table = Table(Heading('no.'), [Heading('unit'), *columns], table_rows)
    body = html_table('units', lambda units: table)
    for placeholder, drawing in drawings.items():
        body = body.replace(placeholder, drawing)
    words = [row.word for row in rows]
    counts = ', '.join(f'{words.count(word)} {word}' for word in dict.fromkeys(words))
    plan_text = f' against the plan {escape(plan)}' if plan else ''
    digest = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
    policy = (
        "default-src 'none'; base-uri 'none'; form-action 'none'; "
        f"style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<title>{len(rows)} units</title>\n<style>{INDEX_STYLE}</style>\n</head>\n<body>\n'
        f'<h1>{len(rows)} units{plan_text}: {escape(counts)}</h1>\n'
        f'<div class="wide">{body}</div>\n'
        f'<p><a href="{SUMMARY}">{SUMMARY}</a> has the numbers. allan_ros {__version__}</p>\n'
        f'<script>{SCRIPT}</script>\n</body>\n</html>\n'
    )


def _curves(row: UnitRow, sensor: str) -> dict[str, AxisCurve]:
    """Return the measured Allan curves of a sensor: axis -> curve, for each axis with a curve."""
    if row.results is None:
        return {}
    axes = {axis: row.results.axes[axis] for axis in AXES[SENSORS[sensor]] if axis in row.results}
    return {name: axis.curve for name, axis in axes.items() if axis.curve is not None}


@dataclass(frozen=True)
class _Frame:
    """Limits of the axes of the drawings of one sensor, as logarithms to base 10.

    ``left`` and ``right`` are for averaging times in s, ``bottom`` and ``top`` for Allan deviations
    in SI.
    """

    left: float
    right: float
    bottom: float
    top: float

    def points(self, tau: np.ndarray, adev: np.ndarray) -> str:
        is_drawn = (adev > 0.0) & np.isfinite(adev) & (tau > 0.0)
        x = (np.log10(tau[is_drawn]) - self.left) / max(self.right - self.left, 1e-9) * WIDTH
        y = (self.top - np.log10(adev[is_drawn])) / max(self.top - self.bottom, 1e-9) * HEIGHT
        return ' '.join(f'{a:.1f},{min(max(b, -99.0), 199.0):.1f}' for a, b in zip(x, y))


def _frame(rows: Sequence[UnitRow], sensor: str) -> _Frame:
    curves = [curve for row in rows for curve in _curves(row, sensor).values()]
    tau = np.concatenate([curve.tau for curve in curves])
    adev = np.concatenate([curve.adev for curve in curves])
    is_positive = (adev > 0.0) & np.isfinite(adev)
    if not is_positive.any():
        return _Frame(0.0, 1.0, 0.0, 1.0)
    x, y = np.log10(tau[is_positive]), np.log10(adev[is_positive])
    # percentiles, because a few extreme Allan deviations would otherwise make all curves flat
    bottom, top = np.percentile(y, [1.0, 99.0])
    return _Frame(float(x.min()), float(x.max()), float(bottom) - 0.1, float(top) + 0.1)


def _drawing(row: UnitRow, sensor: str, frame: _Frame) -> str:
    """Return an SVG of the curves of the axes of a sensor; '' without curves.

    If a plan limits N, bands show the limits. Axes with equal limits share a band.
    """
    curves = _curves(row, sensor)
    if not curves:
        return ''
    areas = []
    for check in row.check.checks if row.check else ():
        if check.quantity == 'N' and sensor_of(check.axis or 'unit') == sensor:
            tau = np.logspace(frame.left, frame.right, 2)
            low = np.full(2, 10.0**frame.bottom)
            if check.lower:
                low = check.lower / np.sqrt(tau)
            high = np.full(2, 10.0**frame.top)
            if check.upper:
                high = check.upper / np.sqrt(tau)
            areas.append(f'{frame.points(tau, low)} {frame.points(tau[::-1], high[::-1])}')
    parts = [f'<polygon points="{area}" fill="#8883"/>' for area in dict.fromkeys(areas)]
    for axis, curve in curves.items():
        color = COLORS['xyz'.index(axis[-1])]
        line = frame.points(curve.tau, curve.adev)
        parts.append(f'<polyline points="{line}" fill="none" stroke="{color}"/>')
    title = f'Allan deviation of the {sensor}: x red, y green, z blue'
    return (
        f'<svg width="{WIDTH}" height="{HEIGHT}" role="img"><title>{title}</title>'
        f'{"".join(parts)}</svg>'
    )
