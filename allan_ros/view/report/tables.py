# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""HTML tables of one sensor: coefficients, and comparisons with datasheets and earlier runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from ...core.compare import Comparison
from ...core.errors import AllanError
from ...core.estimate import NOTHING_KNOWN, Estimate, interval_text, value_text
from ...core.fit import TERMS
from ...core.fit.interpretation import ADVISED_TERMS
from ...core.imu import ShownUnit, shown_unit
from ...core.number_text import significant
from ...core.settings import UNIT_SYSTEMS
from ...export import RAISED, origin_text, target_of, target_rows
from ...results.axis_result import AxisResult
from ...results.datasheets import DatasheetComparison
from ..format import deviation_text, part_text, pretty_unit

if TYPE_CHECKING:
    from ...results.results import Results

Axes = Mapping[str, AxisResult]

Row = tuple[str, Iterable[str]]
"""Heading of a row, and a ``<td>`` element for each axis, as HTML."""

WALKS = {'gyro': ('angle', 'rate'), 'accel': ('velocity', 'acceleration')}
"""Sensor -> quantities whose random walks are N and K (IEEE Std 952 and 1293)."""

MARKS = {'within': '✓', 'undecided': '≈', 'exceeds': '✕'}
"""Verdict on one limit -> its symbol."""

ERRORS = {
    'gyro': {'deg/h': ShownUnit('°', 180.0 / math.pi), 'SI': ShownUnit('rad', 1.0)},
    'accel': dict.fromkeys(UNIT_SYSTEMS, ShownUnit('m/s', 1.0)),
}
"""Sensor -> system of units -> unit of the integrated error (an angle or a velocity)."""


def in_units(html_of: Callable[[str], str]) -> str:
    """Return HTML with a text in datasheet units and in SI; the page shows one of them.

    ``html_of`` returns the text for 'deg/h' or 'SI'.
    """
    return ''.join(f'<span data-units="{units}">{html_of(units)}</span>' for units in UNIT_SYSTEMS)


def headline_table(sensor: str, axes: Axes) -> str:
    """Return an HTML table of N, B and K with one column per axis."""
    return _table('coefficients', axes, '', _coefficient_rows(sensor, axes, ADVISED_TERMS))


def model_table(sensor: str, axes: Axes) -> Iterator[str]:
    """Yield an HTML table of the other terms and of what the model contains.

    If there is neither a value nor a limit of any term, only a note says so.
    """
    noise = [c for axis in axes.values() for c in axis.fit.noise.values()]
    if all(c.value is None and c.upper95 is None for c in noise):
        yield _note('Nothing could be measured: neither a value nor a limit.')
        return
    rows = _coefficient_rows(sensor, axes, [t for t in TERMS if t not in ADVISED_TERMS])
    stated = [deviation_text(axis.fit.deviation) for axis in axes.values()]
    if any(stated):
        heading = 'largest deviation<small>of the curve from the model</small>'
        rows.append((heading, [f'<td>{text or "–"}</td>' for text in stated]))
    if any(axis.regions for axis in axes.values()):
        texts = (
            [
                f'{significant(r.tau_low, 2)}..{significant(r.tau_high, 2)}&nbsp;s '
                + escape(part_text(r.term, axis.fit.likely))
                for r in axis.regions
            ]
            for axis in axes.values()
        )
        heading = 'dominant noise<small>by averaging time</small>'
        rows.append((heading, (f'<td class="regions">{"<br>".join(t)}</td>' for t in texts)))
    others = [
        [
            f'{part}, likely but not resolved (?)' if part in TERMS else part
            for part in axis.part_adev(np.ones(1, int))
            if part not in TERMS or part in axis.fit.likely
        ]
        for axis in axes.values()
    ]
    if any(others):
        cells = (f'<td class="regions">{"<br>".join(parts) or "–"}</td>' for parts in others)
        rows.append(('other parts<small>of the model</small>', cells))
    yield f'<div class="scroll">{_table("coefficients", axes, "", rows)}</div>'


def filter_table(results: Results) -> str:
    """Return an HTML table of the numbers in imu.yaml: key, value, and their origin.

    If a key needs an axis that was not measured, a note says so instead.
    """
    try:
        rows = target_rows(results, 'kalibr')
    except AllanError as error:
        return _note(f'imu.yaml is not written: {error}.')
    raised = any(level.raised_from is not None for row in rows for level in row.levels)
    body = ''.join(
        f'<tr><th scope="row"><code>{escape(row.key)}</code>'
        f'<small>{escape(", ".join(map(origin_text, row.levels)))}</small></th>'
        f'<td><b>{row.value:.4g}</b></td></tr>'
        for row in rows
        if row.levels
    )
    note = f'{RAISED} ' if raised else ''
    return f'<table class="filter"><tbody>{body}</tbody></table>' + _note(
        f'{note}In SI, the worst axis of each sensor, for integration up to '
        f'{target_of("kalibr").horizon_s:g} s without a correction.'
    )


def growth_table(sensor: str, axes: Axes) -> Iterator[str]:
    """Yield an HTML table of the predicted angle or velocity error without correction.

    The scatter of the bias between recordings follows if it is known.
    """
    rows: list[Row] = []
    for growth in zip(*(axis.growth for axis in axes.values())):
        cells = (f'<td>{_size(g.std, g.ci95, ERRORS[sensor], below=True)}</td>' for g in growth)
        rows.append((f'after {growth[0].horizon:g}&nbsp;s', cells))
    if rows:
        unit = in_units(lambda system: f'{WALKS[sensor][0]} error [{ERRORS[sensor][system].name}]')
        yield _comparison(axes, rows, unit)
        window = next(iter(axes.values())).growth[0].window
        yield _note(
            'One standard deviation without correction, with the 95 % interval, after the bias was '
            f'averaged over {window:g} s.'
        )
    for name, axis in axes.items():
        if axis.turn_on:
            units = {system: shown_unit(name, 'B', system) for system in UNIT_SYSTEMS}
            known = axis.turn_on
            size = _size(known.std, known.ci95, units) if known.std else 'not resolved'
            yield (
                f'<p class="note">Bias of {name[-1]} between {known.recordings} recordings: '
                f'standard deviation {size}</p>'
            )


def _size(
    size: float,
    interval: tuple[float, float] | None,
    units: Mapping[str, ShownUnit],
    below: bool = False,
) -> str:
    """Return a standard deviation (SI) with its 95 % interval as HTML.

    With ``below``, the interval is on a second line, and the unit is omitted.
    """
    low, high = interval or (size, size)

    def shown(system: str) -> str:
        name, factor = units[system]
        value, ends = significant(size * factor, 2), ''
        if not low > 0.0:  # no term is resolved: only a limit is known
            value = f'&lt; {significant(high * factor, 2)}' if high > 0.0 else '–'
        elif interval:
            ends = '..'.join(significant(end * factor, 2) for end in interval)
        if below:
            return value + _ends(ends)
        return f'{value} {escape(pretty_unit(name))}' + (f' ({ends})' if ends else '')

    return in_units(shown)


def datasheet_table(sensor: str, axes: Axes, comparison: DatasheetComparison) -> Iterator[str]:
    """Yield an HTML table of the limits of a datasheet; nothing if it has none for this sensor."""
    stated, notes = {}, []
    for term in TERMS:
        checks = [c for axis in axes if (c := comparison.of(axis, term)) is not None]
        limits = [comparison.limit(c) for c in checks]
        text = ' / '.join(dict.fromkeys(pretty_unit(limit.stated) for limit in limits))
        stated[term] = f'stated <span class="nowrap">{escape(text)}</span>'
        texts = dict.fromkeys(n for limit in limits for n in (limit.note, limit.condition) if n)
        notes += [f'{term}: {note}' for note in texts]
    notes.append('; '.join(str(source) for source in comparison.datasheet.sources.values()))
    yield from _checks_table(sensor, axes, comparison.comparisons, notes, stated)


def baseline_table(
    sensor: str, axes: Axes, baseline: Results, comparisons: Sequence[Comparison]
) -> Iterator[str]:
    """Yield an HTML table of the comparison with an earlier run; nothing without comparisons."""
    notes = [
        '"within": not significantly above the earlier run. "exceeds": significantly above it, by '
        'more than the margin.'
    ]
    yield from _checks_table(sensor, axes, comparisons, notes, {}, baseline)


def _checks_table(
    sensor: str,
    axes: Axes,
    comparisons: Sequence[Comparison],
    notes: Sequence[str],
    stated: Mapping[str, str],
    baseline: Results | None = None,
) -> Iterator[str]:
    """Yield an HTML table of comparisons with limits, and its notes; nothing without comparisons.

    ``stated`` maps a term to HTML that replaces its name in the heading. With ``baseline``, cells
    show the values of this earlier run instead of the fraction of the limit.
    """
    rows: list[Row] = []
    for term in TERMS:
        checks = {c.axis: c for c in comparisons if c.term == term and c.axis in axes}
        cells = (
            _check_cell(axis.fit.noise[term], checks[name], baseline)
            if name in checks
            else '<td></td>'
            for name, axis in axes.items()
        )
        if checks:
            rows.append((_term_heading(sensor, term, stated.get(term, '')), [*cells]))
    if rows:
        yield _comparison(axes, rows)
        yield from map(_note, notes)


def _check_cell(coefficient: Estimate, check: Comparison, baseline: Results | None) -> str:
    axis, term = check.axis, check.term

    def shown(c: Estimate) -> str:
        return in_units(lambda units: escape(value_text(c, shown_unit(axis, term, units))))

    resolved = coefficient.status == 'estimated'
    size = coefficient.value if resolved else coefficient.upper95
    second = ''
    if baseline is not None:
        former = shown(baseline.axes[axis].fit.noise[term])
        second = f'<small>before: <span class="nowrap">{former}</span></small>'
    elif size:
        share = f'{100.0 * size / check.limit:.0f}&nbsp;% of the limit'
        second = f'<small>{"" if resolved else "&lt; "}{share}</small>'
    return (
        f'<td>{shown(coefficient)}{second}<b class="mark {check.verdict}">'
        f'<i aria-hidden="true">{MARKS[check.verdict]}</i> {check.verdict}</b></td>'
    )


def _coefficient_rows(sensor: str, axes: Axes, terms: Sequence[str]) -> list[Row]:
    def cell(axis: str, term: str, c: Estimate) -> str:
        def shown(units: str) -> str:
            unit = shown_unit(axis, term, units)
            value = value_text(c, unit)
            known = '–' if value == NOTHING_KNOWN else escape(value)
            return f'<b>{known}</b>{_ends(interval_text(c, unit))}'

        return f'<td class="{c.status}">{in_units(shown)}</td>'

    return [
        (
            _term_heading(sensor, term),
            [cell(name, term, axis.fit.noise[term]) for name, axis in axes.items()],
        )
        for term in terms
    ]


def _term_heading(sensor: str, term: str, html: str = '') -> str:
    """Return the heading of the row of a term: letter, unit, and name (or ``html`` instead)."""
    angle, rate = WALKS[sensor]
    names = {
        'Q': 'quantization',
        'N': f'{angle} random walk',
        'B': 'bias instability',
        'K': f'{rate} random walk',
        'R': f'{rate} ramp',
    }
    units = in_units(lambda system: escape(pretty_unit(shown_unit(sensor, term, system).name)))
    return f'{term} <em>{units}</em><small>{html or names[term]}</small>'


def _comparison(axes: Axes, rows: Sequence[Row], corner: str = 'term') -> str:
    return f'<div class="scroll">{_table("comparison", axes, corner, rows)}</div>'


def _table(kind: str, axes: Axes, corner: str, rows: Iterable[Row]) -> str:
    first = f'<th scope="col">{corner}</th>' if corner else '<td></td>'
    head = ''.join(f'<th scope="col" class="{axis[-1]}">{axis[-1]}</th>' for axis in axes)
    body = ''.join(f'<tr><th scope="row">{th}</th>{"".join(cells)}</tr>' for th, cells in rows)
    return (
        f'<table class="{kind}"><thead><tr>{first}{head}</tr></thead><tbody>{body}</tbody></table>'
    )


def _ends(interval: str) -> str:
    """Return an interval as HTML in small type, which can break only before the two dots."""
    return f'<small>{interval.replace("..", "<wbr>..")}</small>' if interval else ''


def _note(text: str) -> str:
    return f'<p class="note">{escape(text, quote=False).replace(" %", "&nbsp;%")}</p>'
