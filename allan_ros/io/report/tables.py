# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tables of one sensor: its coefficients, and how they stand to datasheets and former runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape

from ...core.compare import Comparison
from ...core.fit import TERMS, Coefficient
from ..datasheet_comparison import DatasheetComparison
from ..results import AxisResult, Results
from ..shown import (
    NOTHING_KNOWN,
    interval_text,
    pretty_unit,
    region_text,
    shown_unit,
    significant,
    value_text,
)
from .words import TERM_NAMES, VERDICT_WORDS, in_units

MARKS = {'within': '✓', 'open': '≈', 'beyond': '✕'}
"""Verdict -> a sign beside its word and colour."""


def coefficient_table(sensor: str, axes: Mapping[str, AxisResult]) -> Iterator[str]:
    """Yield the table of the five terms, a column an axis."""
    yield '<div class="scroll"><table class="coefficients"><thead><tr><th scope="col">term</th>'
    yield ''.join(f'<th scope="col">{_letter(axis)}</th>' for axis in axes) + '</tr></thead><tbody>'
    for term in TERMS:
        cells = ''.join(_coefficient_cell(a, term, r.fit.noise[term]) for a, r in axes.items())
        yield f'<tr>{_term_heading(sensor, term)}{cells}</tr>'
    if any(result.fit.misfit > 0.0 for result in axes.values()):
        misfits = ''.join(f'<td>{result.fit.misfit:.1%}</td>' for result in axes.values())
        yield f'<tr><th scope="row">misfit<small>of the five terms</small></th>{misfits}</tr>'
    if any(result.regions for result in axes.values()):
        regions = ''.join(
            f'<td class="regions">{"<br>".join(region_text(r) for r in result.regions)}</td>'
            for result in axes.values()
        )
        yield f'<tr class="wide"><th scope="row">what rules where</th>{regions}</tr>'
    yield (
        '</tbody></table></div><p class="note">Under each value its 95 % interval. "&lt;": not '
        'observable in this much data; the 95 % upper limit is given.</p>'
    )


def datasheet_table(
    sensor: str, axes: Mapping[str, AxisResult], comparison: DatasheetComparison
) -> Iterator[str]:
    """Yield the table of what a datasheet states of a sensor; nothing where it states nothing."""
    rows = []
    for term in TERMS:
        held = {axis: comparison.of(axis, term) for axis in axes}
        limits = [h.limit for h in held.values() if h is not None]
        if not limits:
            continue
        stated = ' / '.join(dict.fromkeys(limit.stated for limit in limits))
        notes = [note for limit in limits for note in (limit.note, limit.condition) if note]
        said = ''.join(f'<small>{escape(note)}</small>' for note in dict.fromkeys(notes))
        cells = ''.join(
            '<td></td>'
            if h is None
            else _verdict_cell(axis, term, axes[axis].fit.noise[term], h.limit.value, h.verdict)
            for axis, h in held.items()
        )
        rows.append(
            f'<tr>{_term_heading(sensor, term)}<td>{escape(pretty_unit(stated))}{said}</td>'
            f'{cells}</tr>'
        )
    if rows:
        name = comparison.datasheet.name
        yield from _comparison_table(f'Beside the datasheet of {name}', 'stated', axes, rows)
        sources = '; '.join(str(source) for source in comparison.datasheet.sources.values())
        yield f'<p class="note">{escape(sources)}</p>'


def former_table(
    sensor: str,
    axes: Mapping[str, AxisResult],
    name: str,
    former: Results,
    comparisons: Sequence[Comparison],
) -> Iterator[str]:
    """Yield the table of a former run beside this one; nothing where they share no term."""
    rows = []
    for term in TERMS:
        held = {c.axis: c for c in comparisons if c.term == term and c.axis in axes}
        if not held:
            continue
        then = ''.join(_then(axis, term, former) for axis in held)
        cells = ''.join(
            _verdict_cell(axis, term, axes[axis].fit.noise[term], c.limit, c.verdict)
            if (c := held.get(axis)) is not None
            else '<td></td>'
            for axis in axes
        )
        rows.append(f'<tr>{_term_heading(sensor, term)}<td class="then">{then}</td>{cells}</tr>')
    if rows:
        yield from _comparison_table(f'Beside {name}', 'then', axes, rows)
        yield (
            '<p class="note">"Within" is not above the upper end of what the earlier run allowed; '
            '"beyond" is a whole interval above it.</p>'
        )


def _then(axis: str, term: str, former: Results) -> str:
    coefficient = former.axes[axis].fit.noise[term]
    value = in_units(lambda units: escape(value_text(coefficient, shown_unit(axis, term, units))))
    return f'<small>{_letter(axis)}</small> {value}<br>'


def _comparison_table(
    caption: str, second: str, axes: Mapping[str, AxisResult], rows: Sequence[str]
) -> Iterator[str]:
    yield f'<h3>{escape(caption)}</h3><div class="scroll"><table class="comparison"><thead><tr>'
    yield f'<th scope="col">term</th><th scope="col">{second}</th>'
    yield ''.join(f'<th scope="col">{_letter(axis)}</th>' for axis in axes) + '</tr></thead><tbody>'
    yield from rows
    yield '</tbody></table></div>'


def _verdict_cell(
    axis: str, term: str, coefficient: Coefficient, limit: float, verdict: str
) -> str:
    """Return the value, its share of the limit, and the verdict in sign and word."""
    value = in_units(lambda units: escape(value_text(coefficient, shown_unit(axis, term, units))))
    size = coefficient.value if coefficient.status == 'estimated' else coefficient.upper95
    least = '' if coefficient.status == 'estimated' else '&lt; '
    share = f'<small>{least}{significant(100.0 * size / limit, 3)} % of it</small>' if size else ''
    return (
        f'<td><b class="mark {verdict}"><i aria-hidden="true">{MARKS[verdict]}</i> '
        f'{VERDICT_WORDS[verdict]}</b>{value}{share}</td>'
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


def _term_heading(sensor: str, term: str) -> str:
    units = in_units(lambda system: escape(pretty_unit(shown_unit(sensor, term, system).name)))
    return f'<th scope="row">{term} <em>{units}</em><small>{TERM_NAMES[sensor][term]}</small></th>'


def _letter(axis: str) -> str:
    return axis.rsplit('_', 1)[1]
