# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of the report as HTML, with the notes below the tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from html import escape
from typing import TYPE_CHECKING

from ...core.check import Check
from ...core.errors import AllanError
from ...core.fit.fit_findings import ADVISED_TERMS
from ...core.fit.result import TERMS
from ...core.imu import shown_unit
from ...export import target_of
from ...results.axis_result import AxisResult
from ...results.datasheets import Datasheet
from ..coefficient_table import Coefficients, coefficient_table
from ..comparison import baseline_table, limit_table, stated_limits
from ..finding_text import explained
from ..format import pretty_unit
from ..model_table import Axes, error_growth_table, filter_table, parts_table, size_cell
from ..table import Cell, Heading, Table, html_table, in_units, note_html

if TYPE_CHECKING:
    from ...results.results import Results


def headline_html(axes: Axes) -> str:
    """Return an HTML table of N, B and K of a sensor, with a column for each axis."""
    return html_table('coefficients', lambda units: _coefficients(axes, units, ADVISED_TERMS))


def model_html(axes: Axes) -> Iterator[str]:
    """Yield an HTML table of the terms that `headline_html` omits, and of the parts of the models.

    If no term has a value or a limit, a note states this instead.
    """
    noise = [c for axis in axes.values() for c in axis.fit.noise.values()]
    if all(c.value is None and c.upper95 is None for c in noise):
        yield note_html('Nothing could be measured: neither a value nor a limit.')
        return
    other_terms = [term for term in TERMS if term not in ADVISED_TERMS]
    parts = parts_table(axes).rows
    yield _scrolled(
        'coefficients', lambda units: _coefficients(axes, units, other_terms).with_rows(*parts)
    )


def filter_html(results: Results) -> str:
    """Return an HTML table of the noise parameters in imu.yaml, and how they were computed.

    If imu.yaml cannot be written, a note states the reason instead.
    """
    try:
        table = filter_table(results)
    except AllanError as error:
        return note_html(f'imu.yaml is not written: {explained(error)}.')
    return html_table('filter', lambda _: table) + note_html(
        'The numbers are in SI, for the worst axis of each sensor, and for integration up to '
        f'{target_of("kalibr").horizon_s:g} s without a correction.'
    )


def growth_html(axes: Axes) -> Iterator[str]:
    """Yield an HTML table of the predicted angle or velocity error without correction.

    The table is omitted if an axis has no prediction. If the results are from several recordings,
    notes state the scatter of the bias of each axis between the recordings.
    """
    if all(axis.growth for axis in axes.values()):
        yield _scrolled('comparison', partial(error_growth_table, axes))
        window = next(iter(axes.values())).growth[0].window
        yield note_html(
            'One standard deviation of the error, with its 95 % interval, after the bias was '
            f'averaged over {window:g} s.'
        )
    for name, axis in axes.items():
        if axis.turn_on:
            yield (
                f'<p class="note">Bias of {name[-1]} between {axis.turn_on.recordings} recordings: '
                f'standard deviation {in_units(partial(_scatter, name, axis))}</p>'
            )


def _scatter(name: str, axis: AxisResult, units: str) -> str:
    turn_on = axis.turn_on
    if turn_on is None or not turn_on.scatter.value:
        return 'not resolved'
    unit = shown_unit(name, 'B', units)
    cell = size_cell(turn_on.scatter, unit.factor)
    interval = f' ({cell.detail})' if cell.detail else ''
    return escape(f'{cell.text} {pretty_unit(unit.name)}{interval}')


def datasheet_html(axes: Axes, sheet: Datasheet, comparisons: Sequence[Check]) -> Iterator[str]:
    """Yield an HTML table that compares a sensor with its datasheet, and notes about the limits.

    Nothing is yielded if the datasheet has no limit for a measured term.
    """
    stated_texts: dict[str, list[str]] = {}
    notes = []
    for term in TERMS:
        axis_limits = (
            sheet.limits[c.axis] for c in comparisons if c.axis in axes and c.quantity == term
        )
        limits = [terms[term] for terms in axis_limits]
        if limits:
            stated_texts[term] = [limit.stated for limit in limits]
        distinct_notes = dict.fromkeys(
            n for limit in limits for n in (limit.note, limit.condition) if n
        )
        notes += [f'{term}: {note}' for note in distinct_notes]
    notes.append('; '.join(str(source) for source in sheet.sources.values()))
    if stated_texts:
        noise, limit_texts = _noise(axes), stated_limits(stated_texts)
        yield _scrolled(
            'comparison',
            lambda units: limit_table(noise, comparisons, units, limit_texts),
        )
        yield from map(note_html, notes)


def baseline_html(axes: Axes, before: Results, comparisons: Sequence[Check]) -> Iterator[str]:
    """Yield an HTML table that compares a sensor with an earlier run, and a note.

    Nothing is yielded if no coefficient of the sensor was compared with the earlier run.
    """
    if any(c.axis in axes and c.quantity in TERMS for c in comparisons):
        yield _scrolled(
            'comparison', lambda units: baseline_table(_noise(axes), comparisons, units, before)
        )
        yield note_html(
            '"within": not significantly above the earlier run. "exceeds": significantly above it, '
            'by more than the margin.'
        )


def facts_html(facts: Mapping[str, str]) -> str:
    """Return an HTML table with a row for each fact: the name and the text."""
    rows = [(Heading(name), [Cell(text)]) for name, text in facts.items()]
    return html_table('facts', lambda _: Table(Heading(''), [Heading('')], rows))


def _noise(axes: Axes) -> Coefficients:
    return {name: axis.fit.noise for name, axis in axes.items()}


def _coefficients(axes: Axes, units: str, terms: Sequence[str]) -> Table:
    # the heading of the section already names the sensor
    return replace(coefficient_table(_noise(axes), units, terms), corner=Heading(''))


def _scrolled(kind: str, table_of: Callable[[str], Table]) -> str:
    return f'<div class="scroll">{html_table(kind, table_of)}</div>'
