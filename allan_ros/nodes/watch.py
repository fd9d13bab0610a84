# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan_watch`: `/diagnostics` of the allan_ros nodes as a live table in the terminal.

The most severe status comes first. If the output is not a terminal, a line is printed whenever
the level of a status changes.
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

from ..core.errors import one_line
from ..core.imu import DATASHEET_UNITS
from .shell import STEADY, run

if TYPE_CHECKING:
    from rich.console import RenderableType

    from .live_page import LivePage


WORDS = {
    DiagnosticStatus.OK: 'ok',
    DiagnosticStatus.STALE: 'STALE',
    DiagnosticStatus.WARN: 'WARN',
    DiagnosticStatus.ERROR: 'ERROR',
}
"""Level -> its text."""


SEVERITY = ('ERROR', 'STALE', 'WARN', 'ok')
"""Order of the levels in the table; STALE comes early, because silence may hide an error."""


STYLES = {'ok': 'cyan', 'STALE': 'bold magenta', 'WARN': 'black on yellow', 'ERROR': 'bold reverse'}
"""Level -> its style in rich. The text carries the same information without colours; the colours
differ in lightness, for colour-blind readers."""


WEB_PORT = 8095
"""Port of the live page."""


STALE_S = 5.0
"""A status that has not been repeated for this time is shown as stale."""


SHOWN_TERMS = ('N', 'B', 'K')
"""Terms that have their own columns in a wide terminal; the values hold all five."""


WIDE, NARROW = 120, 60
"""Terminal widths: from WIDE on terms have columns; below NARROW there is a list, no table."""


_UNITS = {unit for units in DATASHEET_UNITS.values() for unit in units.values()}


@dataclass(frozen=True)
class Row:
    """One status as it is displayed.

    Attributes
    ----------
    level : str
        One of `SEVERITY`.
    node, name : str
        Name of the node, and the rest of the status name.
    terms : mapping
        Term -> value and unit, of the known ones in `SHOWN_TERMS`.
    message : str
        Text of the status.
    age_s : float
        Time since it was last received, s.
    values : mapping
        All key-value pairs of the status.
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
        """The message without the text that the term columns show."""
        if self.level == 'ok' and self.terms:
            return self.message.partition(' from ')[2]
        return self.message

    @property
    def age(self) -> str:
        """The age in whole seconds; '' for a status that is repeated in time."""
        return f'{self.age_s:.0f} s' if self.level == 'STALE' else ''


def row(status: DiagnosticStatus, age_s: float) -> Row:
    """Return the row of a status that was received ``age_s`` seconds ago."""
    values = {one_line(v.key): one_line(v.value) for v in status.values}
    terms = {}
    for term in SHOWN_TERMS:
        for key, value in values.items():
            head, _, unit = key.partition(' ')
            if head == term and unit.strip('[]') in _UNITS and value != '-':
                terms[term] = f'{value} {unit.strip("[]")}'
    node, _, name = one_line(status.name).rpartition(': ')
    level = 'STALE' if age_s > STALE_S else WORDS.get(status.level, 'STALE')
    message, hardware_id = one_line(status.message), one_line(status.hardware_id)
    return Row(level, node, name, terms, message, age_s, hardware_id, values)


def most_severe_first(rows: Iterable[Row]) -> list[Row]:
    """Return the rows sorted by level, then by name."""
    return sorted(rows, key=lambda r: (SEVERITY.index(r.level), r.node, r.name))


def headline(rows: Sequence[Row]) -> str:
    """Return the number of statuses per level, and the age of the latest."""
    counts = {level: sum(r.level == level for r in rows) for level in SEVERITY}
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
    """Return the rows for rich: a table, or a list in a narrow terminal."""
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
    table.add_column('status and next step', overflow='fold', ratio=5)
    for r in rows:
        terms = [Text(r.terms.get(term, '')) for term in SHOWN_TERMS] if wide else []
        remark = Text(r.remark if wide else r.message)
        if r.age:
            remark = Text.assemble((f'silent for {r.age}; last: ', 'bold'), remark)
        table.add_row(Text(r.level, style=STYLES[r.level]), Text(_name(r)), *terms, remark)
    return table


def _name(row: Row) -> str:
    """Return the status name, with the node unless it is allan_monitor."""
    return row.name if row.node == 'allan_monitor' else f'{row.node}: {row.name}'


REFRESH_S = 0.5

TOPIC = '/diagnostics'


SETTLE_S = 1.5
"""Time after the first status until all were received: each is repeated once a second."""


PATIENCE_S = 10.0
"""Time that ``--once`` waits for a first status."""


HINT_S = 8.0
"""Silence after which the hint is shown: a node started at the same time needs some seconds."""


EXIT_LEVEL = {'ok': 0, 'WARN': 3, 'STALE': 4, 'ERROR': 4}
"""Exit code of ``--check`` by the most severe level."""


EXIT_NOTHING = 1
"""Exit code: no status was received."""


DISCOVERY = (
    'ROS_DOMAIN_ID',
    'ROS_AUTOMATIC_DISCOVERY_RANGE',
    'ROS_LOCALHOST_ONLY',
    'RMW_IMPLEMENTATION',
)
"""Environment variables that decide which nodes are discovered."""


class Display(Protocol):
    """Output of the rows."""

    def show(self, rows: Sequence[Row], hint: str) -> None:
        """Show the rows, or the hint where there are none."""

    def end(self, rows: Sequence[Row], hint: str) -> None:
        """Show the final state."""


class Watch(Node):
    """Keeps the latest status of each name and displays it."""

    def __init__(self, options: argparse.Namespace, stop: threading.Event) -> None:
        super().__init__('allan_watch')
        self._options, self._stop = options, stop
        self._latest: dict[str, tuple[float, DiagnosticStatus]] = {}
        self._display = make_display(options)
        self._began = time.monotonic()
        self._first: float | None = None
        self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, 100)
        self._page: LivePage | None = None
        if options.web is not None:
            from .live_page import LivePage

            self._page = LivePage(self, options.web)
        self.create_timer(REFRESH_S, self._refresh, clock=STEADY)

    @property
    def received_any(self) -> bool:
        """Whether any status was received."""
        return bool(self._latest)

    def exit_code(self) -> int:
        """Return the exit code: by the most severe level with ``--check``."""
        rows = self._rows()
        if not rows:
            return EXIT_NOTHING
        return max(EXIT_LEVEL[row.level] for row in rows) if self._options.check else 0

    def close(self) -> None:
        """Show the final state, and stop serving the page."""
        self._display.end(self._rows(), self._hint())
        if self._page is not None:
            self._page.close()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in message.status:
            if self._options.all or 'allan' in status.name or _is_ours(status):
                self._latest[status.name] = now, status
                self._first = self._first or now

    def _refresh(self) -> None:
        now = time.monotonic()
        if self._page is not None:
            self._page.discover()
        if self._options.once:
            settled = self._first is not None and now - self._first >= SETTLE_S
            done = settled or now - self._began >= (self._options.seconds or PATIENCE_S)
        else:
            silent = not self.received_any and now - self._began >= HINT_S
            self._display.show(self._rows(), self._hint() if silent else 'listening ...')
            done = 0.0 < self._options.seconds <= now - self._began
        if done:
            self._stop.set()

    def _rows(self) -> list[Row]:
        now = time.monotonic()
        return most_severe_first(row(status, now - at) for at, status in self._latest.values())

    def _hint(self) -> str:
        """Return what to check when no status is received."""
        speakers = self.get_publishers_info_by_topic(TOPIC)
        others = f', although {len(speakers)} publish there' if speakers else ''
        given = [f'{name}={os.environ[name]}' for name in DISCOVERY if os.environ.get(name)]
        return (
            f'no allan_ros node publishes on {TOPIC}{others}. Start one: ros2 launch allan_ros '
            'allan_ros.launch.py imu:=/your/imu. If one runs, compare its discovery settings: '
            f'here {" ".join(given) or "all variables are at their defaults"}.'
        )


def _is_ours(status: DiagnosticStatus) -> bool:
    """Return whether it is the status of an axis or input of a renamed node."""
    return {'evidence [s]', 'segments'} <= {v.key for v in status.values}


class Lines:
    """Prints a line for every new status and every change of level."""

    def __init__(self) -> None:
        self._levels: dict[tuple[str, str], str] = {}
        self._hinted = False

    def show(self, rows: Sequence[Row], hint: str) -> None:
        """Print new statuses and changed levels; ages and values change all the time."""
        for each in rows:
            if self._levels.get((each.node, each.name)) != each.level:
                self._levels[each.node, each.name] = each.level
                print(f'{time.strftime("%H:%M:%S")} {plain_line(each)}', flush=True)
        if not rows and not self._hinted and hint.startswith('no '):
            self._hinted = True
            print(hint, file=sys.stderr, flush=True)

    def end(self, rows: Sequence[Row], hint: str) -> None:
        """Print all statuses once more, or the hint."""
        for line in [headline(rows), *map(plain_line, rows)] if rows else []:
            print(line)
        if not rows and not self._hinted:
            print(hint, file=sys.stderr)


class Document:
    """Prints one JSON document at the end."""

    def show(self, rows: Sequence[Row], hint: str) -> None:
        """Do nothing."""

    def end(self, rows: Sequence[Row], hint: str) -> None:
        """Print the document, and the hint to stderr."""
        print(json.dumps(document(rows), indent=1))
        if not rows:
            print(hint, file=sys.stderr)


class Screen:
    """A table redrawn by rich; respects NO_COLOR, the width and the charset of the terminal.

    Parameters
    ----------
    live : bool
        Whether to draw repeatedly, or only once at the end.
    """

    def __init__(self, live: bool) -> None:
        from rich.console import Console
        from rich.live import Live

        self._console = Console()
        self._live = Live(console=self._console, auto_refresh=False) if live else None
        if self._live:
            self._live.start()

    def show(self, rows: Sequence[Row], hint: str) -> None:
        """Draw the table or the hint."""
        if self._live:
            drawn = picture(rows, self._console.width) if rows else hint
            self._live.update(drawn, refresh=True)

    def end(self, rows: Sequence[Row], hint: str) -> None:
        """Draw the final table."""
        if self._live:
            self.show(rows, hint)
            self._live.stop()
        else:
            self._console.print(picture(rows, self._console.width) if rows else hint)


def make_display(options: argparse.Namespace) -> Display:
    """Return the display that the options select, else the best one for the output."""
    if options.json:
        return Document()
    if not options.plain and sys.stdout.isatty() and os.environ.get('TERM') != 'dumb':
        try:
            return Screen(live=not options.once)
        except ImportError:
            pass
    return Lines()


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line without ROS arguments."""
    parser = argparse.ArgumentParser(
        prog='allan_watch',
        description=__doc__,
        epilog='exit codes: 0 done; 1 no status was received; 2 wrong command line. '
        'NO_COLOR turns colours off, COLUMNS sets the width.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('--once', action='store_true', help='show the present state and exit')
    parser.add_argument(
        '--json', action='store_true', help='print the present state as one JSON document and exit'
    )
    parser.add_argument(
        '--check', action='store_true', help='as --once; exit code 3 on a warning, 4 on an error'
    )
    parser.add_argument('--all', action='store_true', help='show the statuses of all nodes')
    parser.add_argument('--plain', action='store_true', help='lines of text instead of a table')
    parser.add_argument(
        '--web',
        type=int,
        nargs='?',
        const=WEB_PORT,
        metavar='PORT',
        help=f'also serve the report as a live page on this machine (default port {WEB_PORT})',
    )
    parser.add_argument(
        '--seconds', type=float, default=0.0, metavar='S', help='exit after this time'
    )
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Run `allan_watch`."""
    made: list[Watch] = []

    def make(stop: threading.Event, options: argparse.Namespace) -> Watch:
        options.once = options.once or options.json or options.check
        made.append(Watch(options, stop))
        return made[0]

    try:
        code = run('allan_watch', make, make_parser(), args)
        sys.stdout.flush()
    except BrokenPipeError:  # the reader (head, less) has exited
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    return code or made[0].exit_code()


if __name__ == '__main__':
    sys.exit(main())
