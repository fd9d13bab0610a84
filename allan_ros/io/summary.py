# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results as text, as HTML for notebooks, and as table rows."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from typing import Any

from ..core.findings import Finding
from ..core.fit import TERMS
from ..core.imu import SI_UNITS, sensor_of
from .format import duration_text, interval_text, pretty_unit, shown_unit, value_text
from .results import Results
from .verdict import WORDS

IN_SUMMARY = ('N', 'B', 'K')
"""Terms of the text summary: those that filters take."""


def headline(results: Results) -> str:
    """Return one line: which IMU, how many samples, how long at rest."""
    name = results.identity.label or 'IMU'
    return (
        f'{name}: {results.samples:,} samples at {results.rate_hz:.5g} Hz, '
        f'{duration_text(results.duration_s)} of static data in {results.segments:,} '
        f'segment{"" if results.segments == 1 else "s"}, fitted by {results.method}'
    )


def summary_text(results: Results, units: str = 'datasheet') -> str:
    """Return a headline, N, B and K of each axis, and the warnings."""
    return '\n'.join(_lines(results, units))


def _lines(results: Results, units: str) -> Iterator[str]:
    yield headline(results)
    for name, axis in results.axes.items():
        cells = []
        for term in IN_SUMMARY:
            unit = shown_unit(name, term, units)
            cells.append(f'{term} {value_text(axis.fit.noise[term], unit)} {unit.name}')
        yield f'  {name:8} {"   ".join(f"{cell:24}" for cell in cells).rstrip()}'
    for finding in _pressing(results):
        yield f'  {finding.severity}: {finding}'


def summary_html(results: Results, units: str = 'datasheet') -> str:
    """Return the coefficients as an HTML table, with the verdict and the warnings."""
    head = ''.join(f'<th>{term}</th>' for term in TERMS)
    rows = ''.join(_html_row(results, name, units) for name in results.axes)
    notes = ''.join(
        f'<li><b>{escape(finding.severity)}</b> {escape(str(finding))}</li>'
        for finding in _pressing(results)
    )
    verdict = results.verdict
    return (
        f'<div><p><b>{WORDS[verdict.level]}.</b> {escape(verdict.summary)}</p>'
        f'<p>{escape(headline(results))}</p>'
        f'<table><thead><tr><th>axis</th>{head}</tr></thead><tbody>{rows}</tbody></table>'
        f'{f"<ul>{notes}</ul>" if notes else ""}</div>'
    )


def _html_row(results: Results, name: str, units: str) -> str:
    cells = ''
    for term in TERMS:
        unit, coefficient = shown_unit(name, term, units), results.axes[name].fit.noise[term]
        interval = interval_text(coefficient, unit)
        value = f'{value_text(coefficient, unit)} {pretty_unit(unit.name)}'
        small = f'<br><small>{escape(interval)}</small>' if interval else ''
        cells += f'<td>{escape(value)}{small}</td>'
    return f'<tr><th>{escape(name)}</th>{cells}</tr>'


def table_rows(results: Results, units: str = 'datasheet') -> list[dict[str, Any]]:
    """Return one row for each term of each axis, in the units asked for."""
    rows = []
    for name, axis in results.axes.items():
        for term in TERMS:
            unit = shown_unit(name, term, units).name
            quantity = axis.quantity(term)
            if unit != SI_UNITS[sensor_of(name)][term]:
                quantity = quantity.to(unit)
            low, high = quantity.ci95 or (None, None)
            rows.append(
                {
                    'axis': name,
                    'term': term,
                    'value': quantity.value,
                    'ci95_low': low,
                    'ci95_high': high,
                    'upper95': quantity.upper95,
                    'unit': unit,
                }
            )
    return rows


def _pressing(results: Results) -> list[Finding]:
    return [finding for finding in results.findings if finding.severity != 'info']
