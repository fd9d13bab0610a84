# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostic statuses as a table, lines of text, or JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus

from ..core.errors import one_line

if TYPE_CHECKING:
    from rich.console import RenderableType

WORDS = {
    DiagnosticStatus.OK: 'ok',
    DiagnosticStatus.STALE: 'STALE',
    DiagnosticStatus.WARN: 'WARN',
    DiagnosticStatus.ERROR: 'ERROR',
}
"""Level of a status -> its text in the displays."""

STYLES = {'ERROR': 'bold reverse', 'STALE': 'bold magenta', 'WARN': 'black on yellow', 'ok': 'cyan'}
"""Level -> style of rich, in the order of the table. STALE comes early, because a node that stopped
publishing may have an error. The styles also differ without color."""

STALE_S = 5.0
"""Age in s from which a status is shown as stale; nodes publish each status once a second."""


@dataclass(frozen=True)
class Row:
    """One status as it is displayed; ``age_s`` is the time since it was received, in s."""

    level: str
    node: str
    name: str
    message: str
    age_s: float
    hardware_id: str = ''
    values: Mapping[str, str] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Name of the status, preceded by the name of the node unless it is allan_monitor."""
        return self.name if self.node == 'allan_monitor' else f'{self.node}: {self.name}'

    @property
    def age(self) -> str:
        """Age of a stale status, such as '12 s'; else ''."""
        return f'{self.age_s:.0f} s' if self.level == 'STALE' else ''


def row(status: DiagnosticStatus, age_s: float) -> Row:
    """Convert a status that was received ``age_s`` seconds ago; control characters are escaped."""
    values = {one_line(v.key): one_line(v.value) for v in status.values}
    node, _, name = one_line(status.name).rpartition(': ')
    level = 'STALE' if age_s > STALE_S else WORDS.get(status.level, 'STALE')
    message, hardware_id = one_line(status.message), one_line(status.hardware_id)
    return Row(level, node, name, message, age_s, hardware_id, values)


def most_severe_first(rows: Iterable[Row]) -> list[Row]:
    """Return the rows sorted by level, then by node and name."""
    return sorted(rows, key=lambda r: (list(STYLES).index(r.level), r.node, r.name))


def headline(rows: Sequence[Row]) -> str:
    """Return a line with the number of statuses per level, and the age of the latest status."""
    counts = {level: sum(r.level == level for r in rows) for level in STYLES}
    numbers = ', '.join(f'{count} {level}' for level, count in counts.items() if count)
    return f'allan_ros: {numbers}; last message {min(r.age_s for r in rows):.1f} s ago'


def plain_line(row: Row) -> str:
    """Return a status in one line of text."""
    return f'{row.level:5} {row.title}: {row.message}{f" ({row.age} old)" if row.age else ""}'


def picture(rows: Sequence[Row]) -> RenderableType:
    """Return a table for rich."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=headline(rows), title_justify='left', title_style='bold', expand=True, box=SIMPLE_HEAD
    )
    table.add_column('', no_wrap=True)
    table.add_column('status', overflow='fold', ratio=2)
    table.add_column('message and next step', overflow='fold', ratio=5)
    for r in rows:
        said = Text(r.message)
        if r.age:
            said = Text.assemble((f'silent for {r.age}; last: ', 'bold'), said)
        table.add_row(Text(r.level, style=STYLES[r.level]), Text(r.title), said)
    return table


def document(rows: Sequence[Row]) -> str:
    """Return the rows as a JSON document."""
    keys = ('level', 'node', 'name', 'hardware_id', 'message', 'age_s', 'values')
    statuses = [
        {**{key: getattr(r, key) for key in keys}, 'age_s': round(r.age_s, 3)} for r in rows
    ]
    return json.dumps({'statuses': statuses}, indent=1)
