# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan_watch`: `/diagnostics` of the allan_ros nodes as a live table in the terminal.

The gravest comes first, each with what to do. Where the output is no terminal, a line is printed
whenever a status changes.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from ..core.imu import DATASHEET_UNITS
from .shell import STEADY, run

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


def most_severe_first(rows: Iterable[Row]) -> list[Row]:
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


REFRESH_S = 0.5

TOPIC = '/diagnostics'


SETTLE_S = 1.5
"""Every status is repeated once a second by default: so long after the first, all have come."""


PATIENCE_S = 10.0
"""How long ``--once`` waits for a first status."""


LONELY_S = 8.0
"""Silence after which it says what to check: a node started at the same time needs some seconds."""


EXIT_NOTHING = 1
"""Nothing was heard of any node."""


DISCOVERY = (
    'ROS_DOMAIN_ID',
    'ROS_AUTOMATIC_DISCOVERY_RANGE',
    'ROS_LOCALHOST_ONLY',
    'RMW_IMPLEMENTATION',
)
"""Variables that decide whom a node finds."""


class Display(Protocol):
    """Where the rows go."""

    def show(self, rows: Sequence[Row], hint: str) -> None:
        """Show how things are; the hint says what to check where there are no rows."""

    def end(self, rows: Sequence[Row], hint: str) -> None:
        """Leave the last state."""


class Watch(Node):
    """Keeps the latest status of each name and shows it."""

    def __init__(self, options: argparse.Namespace, stop: threading.Event) -> None:
        super().__init__('allan_watch')
        self._options, self._stop = options, stop
        self._latest: dict[str, tuple[float, DiagnosticStatus]] = {}
        self._display = make_display(options)
        self._began = time.monotonic()
        self._first: float | None = None
        self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, 100)
        self.create_timer(REFRESH_S, self._refresh, clock=STEADY)

    @property
    def heard(self) -> bool:
        """Whether any status came."""
        return bool(self._latest)

    def close(self) -> None:
        """Leave the last state on the screen."""
        self._display.end(self._rows(), self._hint())

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in message.status:
            if 'allan' in status.name or self._options.all:
                self._latest[status.name] = now, status
                self._first = self._first or now

    def _refresh(self) -> None:
        now = time.monotonic()
        if self._options.once:
            settled = self._first is not None and now - self._first >= SETTLE_S
            done = settled or now - self._began >= (self._options.seconds or PATIENCE_S)
        else:
            lonely = not self.heard and now - self._began >= LONELY_S
            self._display.show(self._rows(), self._hint() if lonely else 'listening ...')
            done = 0.0 < self._options.seconds <= now - self._began
        if done:
            self._stop.set()

    def _rows(self) -> list[Row]:
        now = time.monotonic()
        return most_severe_first(row(status, now - at) for at, status in self._latest.values())

    def _hint(self) -> str:
        """Return what to check when nothing comes."""
        speakers = self.get_publishers_info_by_topic(TOPIC)
        others = f', though {len(speakers)} publish there' if speakers else ''
        given = [f'{name}={os.environ[name]}' for name in DISCOVERY if os.environ.get(name)]
        return (
            f'no allan_ros node speaks on {TOPIC}{others}. Start one: ros2 launch allan_ros '
            'allan_ros.launch.py imu:=/your/imu; or, if one runs, see whether it has the same '
            f'discovery: here {" ".join(given) or "all variables are at their defaults"}.'
        )


class Lines:
    """A line for every status that comes or changes its level."""

    def __init__(self) -> None:
        self._levels: dict[tuple[str, str], str] = {}
        self._hinted = False

    def show(self, rows: Sequence[Row], hint: str) -> None:
        """Print what is new; ages and amounts, which change all the time, are not."""
        for each in rows:
            if self._levels.get((each.node, each.name)) != each.level:
                self._levels[each.node, each.name] = each.level
                print(f'{time.strftime("%H:%M:%S")} {plain_line(each)}', flush=True)
        if not rows and not self._hinted and hint.startswith('no '):
            self._hinted = True
            print(hint, file=sys.stderr, flush=True)

    def end(self, rows: Sequence[Row], hint: str) -> None:
        """Print all once more, or what to check."""
        for line in [headline(rows), *map(plain_line, rows)] if rows else []:
            print(line)
        if not rows and not self._hinted:
            print(hint, file=sys.stderr)


class Document:
    """One JSON document at the end, and nothing before."""

    def show(self, rows: Sequence[Row], hint: str) -> None:
        """Wait."""

    def end(self, rows: Sequence[Row], hint: str) -> None:
        """Print the document; the hint goes to stderr."""
        print(json.dumps(document(rows), indent=1))
        if not rows:
            print(hint, file=sys.stderr)


class Screen:
    """A table that rich draws anew; it honours NO_COLOR and the width and charset of the terminal.

    Parameters
    ----------
    live : bool
        Whether to draw before the end.
    """

    def __init__(self, live: bool) -> None:
        from rich.console import Console
        from rich.live import Live

        self._console = Console()
        self._live = Live(console=self._console, auto_refresh=False) if live else None
        if self._live:
            self._live.start()

    def show(self, rows: Sequence[Row], hint: str) -> None:
        """Draw the table, or the hint."""
        if self._live:
            drawn = picture(rows, self._console.width) if rows else hint
            self._live.update(drawn, refresh=True)

    def end(self, rows: Sequence[Row], hint: str) -> None:
        """Leave the last table on the screen."""
        if self._live:
            self.show(rows, hint)
            self._live.stop()
        else:
            self._console.print(picture(rows, self._console.width) if rows else hint)


def make_display(options: argparse.Namespace) -> Display:
    """Return where the rows go: what the options say, else what the output can show."""
    if options.json:
        return Document()
    if not options.plain and sys.stdout.isatty() and os.environ.get('TERM') != 'dumb':
        try:
            return Screen(live=not options.once)
        except ImportError:
            pass
    return Lines()


def main(args: list[str] | None = None) -> int:
    """Run `allan_watch`."""
    argv = sys.argv if args is None else ['allan_watch', *args]
    parser = argparse.ArgumentParser(
        prog='allan_watch',
        description=__doc__,
        epilog='exit codes: 0 done; 1 nothing was heard; 2 wrong words on the command line. '
        'NO_COLOR turns colours off, COLUMNS sets the width.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('--once', action='store_true', help='show how things are, and end')
    parser.add_argument(
        '--json', action='store_true', help='the same as one JSON document on stdout, and end'
    )
    parser.add_argument('--all', action='store_true', help='show the statuses of all nodes')
    parser.add_argument('--plain', action='store_true', help='lines of text instead of a table')
    parser.add_argument(
        '--seconds', type=float, default=0.0, metavar='S', help='end after that time'
    )
    options = parser.parse_args(remove_ros_args(argv)[1:])
    options.once = options.once or options.json
    made: list[Watch] = []

    def make(stop: threading.Event) -> Watch:
        made.append(Watch(options, stop))
        return made[0]

    try:
        code = run('allan_watch', make, argv)
        sys.stdout.flush()
    except BrokenPipeError:  # the reader (head, less) has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    return code or (0 if made[0].heard else EXIT_NOTHING)


if __name__ == '__main__':
    sys.exit(main())
