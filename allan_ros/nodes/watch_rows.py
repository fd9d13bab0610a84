# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What `allan_watch` shows of each status, gravest first, as wide as there is room."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticStatus

from ..core.units import DATASHEET_UNITS

if TYPE_CHECKING:
    from rich.console import RenderableType

WORDS = {
    DiagnosticStatus.OK: 'ok',
    DiagnosticStatus.STALE: 'STALE',
    DiagnosticStatus.WARN: 'WARN',
    DiagnosticStatus.ERROR: 'ERROR',
}
"""Level -> how it is written."""

GRAVITY = ('ERROR', 'STALE', 'WARN', 'ok')
"""The order in which statuses are shown: silence may hide an error."""

STYLES = {'ok': 'cyan', 'STALE': 'bold magenta', 'WARN': 'black on yellow', 'ERROR': 'bold reverse'}
"""Level -> its style in rich. The words say the same without colours; cyan, magenta, yellow and
reverse differ in lightness, so that the colour-blind tell them apart."""

STALE_S = 5.0
"""A status that has not been repeated for so long is shown as stale."""

SHOWN_TERMS = ('N', 'B', 'K')
"""Terms with a column of their own where there is room; all five are among the values."""

WIDE, NARROW = 120, 60
"""Columns from which the terms have columns of their own, and below which nothing is in columns."""

_UNITS = {unit for units in DATASHEET_UNITS.values() for unit in units.values()}


@dataclass(frozen=True)
class Row:
    """One status as it is shown.

    Attributes
    ----------
    level : str
        One of `GRAVITY`.
    node, name : str
        Who says it, and of what.
    terms : mapping
        Term -> value and unit, of those in `SHOWN_TERMS` that are known.
    message : str
        What is so, and what to do.
    age_s : float
        Time since it was said last, s.
    values : mapping
        All that the status tells.
    """

    level: str
    node: str
    name: str
    terms: Mapping[str, str]
    message: str
    age_s: float
    hardware_id: str = ''
    values: Mapping[str, str] = field(default_factory=dict)

    @property
    def remark(self) -> str:
        """The message without what stands in the columns of the terms."""
        if self.level == 'ok' and self.terms:
            return self.message.partition(' from ')[2]
        return self.message

    @property
    def age(self) -> str:
        """The age in whole seconds; '' for what is repeated as it should be."""
        return f'{self.age_s:.0f} s' if self.level == 'STALE' else ''


def row(status: DiagnosticStatus, age_s: float) -> Row:
    """Return what is shown of a status that came so many seconds ago."""
    values = {v.key: v.value for v in status.values}
    terms = {}
    for term in SHOWN_TERMS:
        for key, value in values.items():
            head, _, unit = key.partition(' ')
            if head == term and unit.strip('[]') in _UNITS and value != '-':
                terms[term] = f'{value} {unit.strip("[]")}'
    node, _, name = status.name.rpartition(': ')
    level = 'STALE' if age_s > STALE_S else WORDS.get(status.level, 'STALE')
    return Row(level, node, name, terms, status.message, age_s, status.hardware_id, values)


def gravest_first(rows: Iterable[Row]) -> list[Row]:
    """Return the rows in the order in which they are to be read."""
    return sorted(rows, key=lambda r: (GRAVITY.index(r.level), r.node, r.name))


def headline(rows: Sequence[Row]) -> str:
    """Return how many statuses there are of each level, and how old the latest is."""
    counts = {level: sum(r.level == level for r in rows) for level in GRAVITY}
    told = ', '.join(f'{count} {level}' for level, count in counts.items() if count)
    age = min(r.age_s for r in rows)
    return f'allan_ros: {told}; last message {age:.1f} s ago'


def document(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the rows as plain values."""
    return {
        'statuses': [
            {
                'level': r.level,
                'node': r.node,
                'name': r.name,
                'hardware_id': r.hardware_id,
                'message': r.message,
                'age_s': round(r.age_s, 3),
                'values': dict(r.values),
            }
            for r in rows
        ]
    }


def plain_line(row: Row) -> str:
    """Return a status in one line of text."""
    return f'{row.level:5} {_name(row)}: {row.message}{f" ({row.age} old)" if row.age else ""}'


def picture(rows: Sequence[Row], columns: int) -> RenderableType:
    """Return the rows as rich draws them: a table, or a list where there is no room for one."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Group
    from rich.padding import Padding
    from rich.table import Table
    from rich.text import Text

    if columns < NARROW:
        lines: list[RenderableType] = [Text(headline(rows), style='bold')]
        for r in rows:
            lines.append(Text.assemble((r.level, STYLES[r.level]), f' {_name(r)} {r.age}'.rstrip()))
            lines.append(Padding(Text(r.message), (0, 0, 0, 2)))
        return Group(*lines)
    wide = columns >= WIDE
    table = Table(
        title=headline(rows), title_justify='left', title_style='bold', expand=True, box=SIMPLE_HEAD
    )
    table.add_column('', no_wrap=True)
    table.add_column('status', overflow='fold', ratio=3 if wide else 2)
    for term in SHOWN_TERMS if wide else ():
        table.add_column(term, no_wrap=True)
    table.add_column('what is so, and what to do', overflow='fold', ratio=5)
    for r in rows:
        terms = [Text(r.terms.get(term, '')) for term in SHOWN_TERMS] if wide else []
        remark = Text(r.remark if wide else r.message)
        if r.age:
            remark = Text.assemble((f'silent for {r.age}; last: ', 'bold'), remark)
        table.add_row(Text(r.level, style=STYLES[r.level]), Text(_name(r)), *terms, remark)
    return table


def _name(row: Row) -> str:
    """Return the name with its node, where that is not the usual one."""
    return row.name if row.node == 'allan_monitor' else f'{row.node}: {row.name}'
