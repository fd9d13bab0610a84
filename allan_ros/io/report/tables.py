# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tables of one sensor: coefficients, and comparisons with datasheets and earlier runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from html import escape

import numpy as np
import yaml

from ...core.compare import Comparison
from ...core.fit import TERMS, Coefficient
from ...core.fit.reading import ADVISED_TERMS
from ..axis_result import AxisResult
from ..datasheets import VERDICT_TEXT, DatasheetComparison
from ..format import (
    NOTHING_KNOWN,
    SENSOR_NAMES,
    ShownUnit,
    deviation_text,
    interval_text,
    known_numbers,
    markdown_rows,
    pretty_unit,
    region_text,
    shown_unit,
    significant,
    value_text,
)
from ..results import Results

SYSTEMS = ('datasheet', 'si')
"""The systems of units that the page offers."""

TERM_NAMES = {
    'gyro': {
        'Q': 'quantization',
        'N': 'angle random walk',
        'B': 'bias instability',
        'K': 'rate random walk',
        'R': 'rate ramp',
    },
    'accel': {
        'Q': 'quantization',
        'N': 'velocity random walk',
        'B': 'bias instability',
        'K': 'acceleration random walk',
        'R': 'acceleration ramp',
    },
}
"""sensor -> term -> its name in IEEE Std 952 and 1293."""

MARKS = {'within': '✓', 'open': '≈', 'beyond': '✕'}
"""Verdict -> its symbol, which repeats the meaning of word and colour."""


def coefficient_table(
    sensor: str, axes: Mapping[str, AxisResult], deviations: bool = True
) -> Iterator[str]:
    """Yield the table of the five terms, one column per axis; a note where none is known."""
    noise = [c for axis in axes.values() for c in axis.fit.noise.values()]
    if all(c.value is None and c.upper95 is None for c in noise):
        yield '<p class="note">Nothing could be measured: neither a value nor a limit.</p>'
        return
    rows = [*_coefficient_rows(sensor, axes, TERMS)]
    if deviations and any(result.fit.deviation for result in axes.values()):
        texts = (deviation_text(result.fit.deviation) or '–' for result in axes.values())
        cells = ''.join(f'<td>{text}</td>' for text in texts)
        rows.append(
            f'<tr><th scope="row">largest deviation<small>from the model</small></th>{cells}</tr>'
        )
    if any(result.regions for result in axes.values()):
        texts = (
            '<br>'.join(region_text(region, result.fit.likely) for region in result.regions)
            for result in axes.values()
        )
        cells = ''.join(f'<td class="regions">{text}</td>' for text in texts)
        rows.append(f'<tr class="wide"><th scope="row">dominant noise</th>{cells}</tr>')
    yield '<div class="scroll"><table class="coefficients">'
    yield from _rows(axes, rows, '<th scope="col">term</th>')
    also = [
        f'{_letter(axis)}: {f"{part}, likely but not resolved (?)" if part in TERMS else part}'
        for axis, result in axes.items()
        for part in result.part_adev(np.ones(1, int))
        if part not in TERMS or part in result.fit.likely
    ]
    yield (
        '</div><p class="note">95 % intervals below the values. "&lt;" is the 95 % '
        'upper limit of a term that is not resolved. B is the coefficient; the level part of the '
        'curve lies at 0.664 B.'
        + (f' The model also has {escape("; ".join(also))}.' if also else '')
        + '</p>'
    )


ERRORS = {
    'gyro': ('angle', {'datasheet': ('°', 180.0 / math.pi), 'si': ('rad', 1.0)}),
    'accel': ('velocity', {'datasheet': ('m/s', 1.0), 'si': ('m/s', 1.0)}),
}
"""Sensor -> what grows without correction, and its unit and factor by system of units."""


def growth_table(sensor: str, axes: Mapping[str, AxisResult]) -> Iterator[str]:
    """Yield the predicted growth of the error, and the scatter of the bias between recordings."""
    tables = {axis: result.growth for axis, result in axes.items()}
    rows = []
    quantity, units_of = ERRORS[sensor]
    for row in zip(*tables.values()):
        cells = ''.join(
            f'<td>{in_units(partial(_size, growth.std, growth.ci95, units_of))}</td>'
            for growth in row
        )
        rows.append(f'<tr><th scope="row">after {row[0].horizon:g} s</th>{cells}</tr>')
    turned = {axis: result.turn_on for axis, result in axes.items() if result.turn_on}
    if rows:
        heading = in_units(lambda system: f'Predicted {quantity} error [{units_of[system][0]}]')
        yield from _comparison_table(heading, axes, rows, 'time')
        window = next(iter(tables.values()))[0].window
        yield (
            '<p class="note">One standard deviation without correction, with the 95 % interval, '
            f'after the bias was averaged over {window:g} s.</p>'
        )
    for axis, bias in turned.items():
        units = {s: _unit_of(shown_unit(axis, 'B', s)) for s in ('datasheet', 'si')}
        size = in_units(partial(_size, bias.std, bias.ci95, units, in_line=True))
        yield (
            f'<p class="note">Bias of {_letter(axis)} between {bias.recordings} recordings: '
            f'standard deviation {size}</p>'
        )


def _unit_of(unit: ShownUnit) -> tuple[str, float]:
    return pretty_unit(unit.name), unit.factor


def _size(
    size: float,
    interval: tuple[float, float] | None,
    units: Mapping[str, tuple[str, float]],
    system: str,
    in_line: bool = False,
) -> str:
    """Return a standard deviation with its interval, below it or in the same line."""
    name, factor = units[system]
    low, high = interval or (size, size)
    if not low > 0.0:  # no term is resolved: only a limit is known
        limit = f'< {significant(high * factor, 2)}' if high > 0.0 else '–'
        return escape(f'{limit} {name}' if in_line else limit)
    ends = '..'.join(significant(end * factor, 2) for end in interval or ())
    if in_line:
        return escape(f'{significant(size * factor, 2)} {name}' + (f' ({ends})' if ends else ''))
    return f'{escape(significant(size * factor, 2))}' + (f'<small>{ends}</small>' if ends else '')


def headline_table(sensor: str, axes: Mapping[str, AxisResult]) -> Iterator[str]:
    """Yield the small table of N, B and K of the verdict section."""
    yield f'<table class="coefficients"><caption>{SENSOR_NAMES[sensor]}</caption>'
    yield from _rows(axes, _coefficient_rows(sensor, axes, ADVISED_TERMS, named=False), '<td></td>')


def datasheet_table(
    sensor: str, axes: Mapping[str, AxisResult], comparison: DatasheetComparison
) -> Iterator[str]:
    """Yield the comparison with a datasheet; nothing where it states nothing about the sensor."""
    stated, notes = {}, []
    for term in TERMS:
        checks = [c for axis in axes if (c := comparison.of(axis, term)) is not None]
        limits = [comparison.limit(c) for c in checks]
        text = ' / '.join(dict.fromkeys(pretty_unit(limit.stated) for limit in limits))
        stated[term] = f'stated <span class="nowrap">{escape(text)}</span>'
        texts = dict.fromkeys(n for limit in limits for n in (limit.note, limit.condition) if n)
        notes += [f'{term}: {note}' for note in texts]
    notes.append('; '.join(str(source) for source in comparison.datasheet.sources.values()))
    heading = f'Compared with the datasheet of {escape(comparison.datasheet.name)}'
    yield from _checks_table(heading, sensor, axes, comparison.comparisons, notes, stated)


def baseline_table(
    sensor: str,
    axes: Mapping[str, AxisResult],
    name: str,
    baseline: Results,
    comparisons: Sequence[Comparison],
) -> Iterator[str]:
    """Yield the comparison with an earlier run; nothing where the two share no term."""
    notes = [
        '"Within" is not significantly above the earlier run; "beyond" is significantly above it '
        'and its margin.'
    ]
    heading = f'Compared with {escape(name)}'
    yield from _checks_table(heading, sensor, axes, comparisons, notes, {}, baseline)


def _checks_table(
    heading: str,
    sensor: str,
    axes: Mapping[str, AxisResult],
    comparisons: Sequence[Comparison],
    notes: Sequence[str],
    stated: Mapping[str, str],
    baseline: Results | None = None,
) -> Iterator[str]:
    """Yield a table of comparisons with limits, and its notes; nothing without comparisons."""
    rows = []
    for term in TERMS:
        checks = {c.axis: c for c in comparisons if c.term == term and c.axis in axes}
        cells = ''.join(
            _verdict_cell(axes[axis].fit.noise[term], checks[axis], baseline)
            if axis in checks
            else '<td></td>'
            for axis in axes
        )
        if checks:
            rows.append(f'<tr>{_term_heading(sensor, term, stated.get(term, ""))}{cells}</tr>')
    if rows:
        yield from _comparison_table(heading, axes, rows)
        yield from (f'<p class="note">{escape(note)}</p>' for note in notes)


def _comparison_table(
    caption: str, axes: Mapping[str, AxisResult], rows: Sequence[str], first: str = 'term'
) -> Iterator[str]:
    yield f'<h3>{caption}</h3><div class="scroll"><table class="comparison">'
    yield from _rows(axes, rows, f'<th scope="col">{first}</th>')
    yield '</div>'


def _rows(axes: Mapping[str, AxisResult], rows: Iterable[str], corner: str) -> Iterator[str]:
    """Yield head and body of a table with a column per axis, and its end."""
    yield f'<thead><tr>{corner}'
    yield ''.join(f'<th scope="col">{_letter(axis)}</th>' for axis in axes) + '</tr></thead><tbody>'
    yield from rows
    yield '</tbody></table>'


def _coefficient_rows(
    sensor: str, axes: Mapping[str, AxisResult], terms: Sequence[str], named: bool = True
) -> Iterator[str]:
    for term in terms:
        cells = ''.join(_coefficient_cell(a, term, r.fit.noise[term]) for a, r in axes.items())
        yield f'<tr>{_term_heading(sensor, term, named=named)}{cells}</tr>'


def _verdict_cell(coefficient: Coefficient, check: Comparison, baseline: Results | None) -> str:
    """Return the value, its share of the limit or what it was, and the verdict."""
    axis, term = check.axis, check.term

    def shown(c: Coefficient) -> str:
        return in_units(lambda units: escape(value_text(c, shown_unit(axis, term, units))))

    resolved = coefficient.status == 'estimated'
    size = coefficient.value if resolved else coefficient.upper95
    second = ''
    if baseline is not None:
        former = shown(baseline.axes[axis].fit.noise[term])
        second = f'<small>then <span class="nowrap">{former}</span></small>'
    elif size:
        share = f'{100.0 * size / check.limit:.0f}&nbsp;% of it'
        second = f'<small>{"" if resolved else "&lt; "}{share}</small>'
    return (
        f'<td>{shown(coefficient)}{second}<b class="mark {check.verdict}">'
        f'<i aria-hidden="true">{MARKS[check.verdict]}</i> {VERDICT_TEXT[check.verdict]}</b></td>'
    )


def _coefficient_cell(axis: str, term: str, coefficient: Coefficient) -> str:
    def shown(units: str) -> str:
        unit = shown_unit(axis, term, units)
        value, interval = value_text(coefficient, unit), interval_text(coefficient, unit)
        low, _, high = interval.partition('..')
        # an interval may be broken at its dots where the column is narrow
        ends = f'<small>{escape(low)}<wbr>..{escape(high)}</small>' if high else ''
        value = '–' if value == NOTHING_KNOWN else value
        return f'<b>{escape(value)}</b>{ends}'

    return f'<td class="{coefficient.status}">{in_units(shown)}</td>'


def _term_heading(sensor: str, term: str, html: str = '', named: bool = True) -> str:
    """Return the heading of a term's row; ``html`` replaces its name."""
    units = in_units(lambda system: escape(pretty_unit(shown_unit(sensor, term, system).name)))
    what = html or escape(TERM_NAMES[sensor][term])
    name = f'<small>{what}</small>' if named else ''
    return f'<th scope="row">{term} <em>{units}</em>{name}</th>'


def _letter(axis: str) -> str:
    return axis.rsplit('_', 1)[1]


def in_units(html_of: Callable[[str], str]) -> str:
    """Return the HTML of both systems of units, of which the page shows the chosen one."""
    return ''.join(f'<span data-units="{units}">{html_of(units)}</span>' for units in SYSTEMS)


COLUMNS = ('axis', 'term', 'value', 'low95', 'high95', 'upper95', 'unit')
"""Columns of the table for spreadsheets."""


def copies(results: Results, axes: Sequence[str], units: str) -> dict[str, str]:
    """Return the coefficients of some axes as tab-separated values, Markdown and YAML.

    Units are in ASCII here, so that they survive wherever the text is pasted.
    """
    lines, table = ['\t'.join(COLUMNS)], []
    tree: dict[str, dict[str, dict[str, object]]] = {}
    for axis in axes:
        tree[axis] = {}
        for term, c in results.axes[axis].fit.noise.items():
            unit = shown_unit(axis, term, units)
            value, low, high, upper = numbers = known_numbers(c, unit)
            shown = ('' if number is None else f'{number:g}' for number in numbers)
            lines.append('\t'.join([axis, term, *shown, unit.name]))
            known = {
                'value': value,
                'ci95': None if low is None else [low, high],
                'upper95': upper,
            }
            given = {key: number for key, number in known.items() if number is not None}
            tree[axis][term] = {'unit': unit.name, **given}
    for term in TERMS:
        unit = shown_unit(axes[0], term, units)
        noise = [results.axes[axis].fit.noise[term] for axis in axes]
        intervals = [f' ({i})' if (i := interval_text(c, unit)) else '' for c in noise]
        cells = [value_text(c, unit) + interval for c, interval in zip(noise, intervals)]
        table.append([term, unit.name, *cells])
    return {
        'TSV': '\n'.join(lines) + '\n',
        'Markdown': markdown_rows([['term', 'unit', *axes], *table]),
        'YAML': yaml.safe_dump(tree, sort_keys=False, default_flow_style=None),
    }
