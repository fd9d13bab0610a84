# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How a measured IMU stands beside its datasheet, in a few lines for the terminal."""

from __future__ import annotations

from collections.abc import Iterator

from ..core.compare import Verdict
from ..core.units import sensor_of
from ..io.datasheet_comparison import VERDICT_TEXT, DatasheetComparison, Held
from ..io.shown import shown_unit, significant
from .console import wrapped

HEADLINES: dict[Verdict | None, str] = {
    'within': 'all that it states is kept',
    'open': 'nothing is beyond it; some intervals still hold the limit',
    'beyond': 'not all that it states is kept',
    None: 'it states nothing of what was measured',
}

LIMIT_DIGITS = 3
"""Significant digits of a limit, as in the tables of intervals."""


def datasheet_lines(comparison: DatasheetComparison, units: str, columns: int) -> Iterator[str]:
    """Yield a headline, and a line for each limit: what is stated, and how each axis stands."""
    sheet = comparison.datasheet
    headline = f'beside the datasheet of {sheet.name}: {HEADLINES[comparison.verdict]}'
    yield from wrapped(headline, columns, '  ')
    for group in _by_limit(comparison).values():
        yield from wrapped(_line(group, units), columns, ' ' * 9)


def _by_limit(comparison: DatasheetComparison) -> dict[tuple[str, str, float], list[Held]]:
    """Return the axes of one sensor that share a limit of a term together."""
    groups: dict[tuple[str, str, float], list[Held]] = {}
    for held in comparison.held:
        key = sensor_of(held.axis), held.term, held.limit.value
        groups.setdefault(key, []).append(held)
    return groups


def _line(group: list[Held], units: str) -> str:
    first = group[0]
    unit = shown_unit(first.axis, first.term, units)
    limit = f'{significant(first.limit.value * unit.factor, LIMIT_DIGITS)} {unit.name}'
    stood: dict[Verdict, list[str]] = {}
    for held in group:
        stood.setdefault(held.verdict, []).append(held.axis.rsplit('_', 1)[1])
    verdicts = ', '.join(f'{" ".join(axes)} {VERDICT_TEXT[v]}' for v, axes in stood.items())
    sensor = sensor_of(first.axis)
    return f'{sensor:5} {first.term}  {verdicts}: limit {limit} (stated {first.limit.stated})'
