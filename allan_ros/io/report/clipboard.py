# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The coefficients as text to copy: for a spreadsheet, a document or a file of settings."""

from __future__ import annotations

from collections.abc import Sequence

import yaml

from ...core.fit import TERMS, Coefficient
from ..results import Results
from ..shown import ShownUnit, interval_text, shown_unit, value_text

COLUMNS = ('axis', 'term', 'value', 'low95', 'high95', 'upper95', 'unit')
"""Of the table for spreadsheets."""

DIGITS = 6
"""Significant digits of a copied number: more than any interval is known to."""


def copies(results: Results, axes: Sequence[str], units: str) -> dict[str, str]:
    """Return the coefficients of some axes as tab-separated values, Markdown and YAML.

    Units are in ASCII here, so that they survive wherever the text is pasted.
    """
    return {
        'TSV': _tsv(results, axes, units),
        'Markdown': _markdown(results, axes, units),
        'YAML': _yaml(results, axes, units),
    }


def _tsv(results: Results, axes: Sequence[str], units: str) -> str:
    lines = ['\t'.join(COLUMNS)]
    for axis in axes:
        for term in TERMS:
            unit = shown_unit(axis, term, units)
            numbers = _numbers(results.axes[axis].fit.noise[term], unit)
            shown = ('' if number is None else f'{number:g}' for number in numbers)
            lines.append('\t'.join([axis, term, *shown, unit.name]))
    return '\n'.join(lines) + '\n'


def _markdown(results: Results, axes: Sequence[str], units: str) -> str:
    rows = [['term', 'unit', *axes], ['---'] * (len(axes) + 2)]
    for term in TERMS:
        cells = []
        for axis in axes:
            coefficient, unit = results.axes[axis].fit.noise[term], shown_unit(axis, term, units)
            interval = interval_text(coefficient, unit)
            cells.append(value_text(coefficient, unit) + (f' ({interval})' if interval else ''))
        rows.append([term, shown_unit(axes[0], term, units).name, *cells])
    return '\n'.join(f'| {" | ".join(row)} |' for row in rows) + '\n'


def _yaml(results: Results, axes: Sequence[str], units: str) -> str:
    tree: dict[str, dict[str, dict[str, object]]] = {}
    for axis in axes:
        tree[axis] = {}
        for term in TERMS:
            unit = shown_unit(axis, term, units)
            value, low, high, upper = _numbers(results.axes[axis].fit.noise[term], unit)
            known: dict[str, object] = {'unit': unit.name}
            if value is not None:
                known['value'] = value
            if low is not None:
                known['ci95'] = [low, high]
            if upper is not None:
                known['upper95'] = upper
            tree[axis][term] = known
    text: str = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)
    return text


def _numbers(c: Coefficient, unit: ShownUnit) -> tuple[float | None, ...]:
    """Return value, interval and limit in a unit; what is not known is None.

    Of a term that is not observable only the limit is given: its estimate means nothing.
    """
    seen = c.status == 'estimated'
    low, high = c.ci95 if seen and c.ci95 is not None else (None, None)
    sign = -1.0 if c.sign < 0 else 1.0
    value = c.value * sign if seen and c.value is not None else None
    numbers = (value, low, high, None if seen else c.upper95)
    return tuple(None if n is None else float(f'{n * unit.factor:.{DIGITS}g}') for n in numbers)
