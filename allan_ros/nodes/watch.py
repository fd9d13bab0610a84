# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan_watch`: show `/diagnostics` of the allan_ros nodes as a live table in the terminal.

The most severe status comes first. If the output is not a terminal, a line is printed for
each new status and whenever the level of a status changes.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from ..core.errors import one_line
from .shell import STEADY_CLOCK, run

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.live import Live

    from .live_page import LivePage

TOPIC = '/diagnostics'

WEB_PORT = 8095
"""Default port of the live page."""

REFRESH_S = 0.5
"""Period in s at which the table is redrawn."""

SETTLE_S, DISCOVERY_WAIT_S = 1.5, 3.5
"""Assumed time in s from the first status until every discovered node has published once, and from
the start until every node is discovered. Fast DDS announces a process every 3 s."""

OWN_TOPICS = ('sums', 'noise_model')
"""Topics below the name of a node by which the node is recognized as an allan_ros node."""

PATIENCE_S, NOBODY_S = 10.0, 6.5
"""Times in s for which ``--once`` waits for the first status: `PATIENCE_S` if a node publishes on
`TOPIC`, `NOBODY_S` if no such node was discovered. Fast DDS announces a process every 3 s, and
a busy computer may lose one announcement."""

HINT_S = 8.0
"""If no status arrives for this time in s, the user is told what to check. A node needs some
seconds to start."""

EXIT_LEVEL = {'ok': 0, 'WARN': 3, 'STALE': 4, 'ERROR': 4}
"""Most severe level of all statuses -> exit code of ``--check``."""

EXIT_NO_STATUS = 1
"""Exit code if no status was received."""

DISCOVERY = (
    'ROS_DOMAIN_ID',
    'ROS_AUTOMATIC_DISCOVERY_RANGE',
    'ROS_LOCALHOST_ONLY',
    'RMW_IMPLEMENTATION',
)
"""Environment variables that determine which nodes discover each other."""

LEVEL_WORDS = {
    DiagnosticStatus.OK: 'ok',
    DiagnosticStatus.STALE: 'STALE',
    DiagnosticStatus.WARN: 'WARN',
    DiagnosticStatus.ERROR: 'ERROR',
}
"""Level of a status -> word that is shown for it."""

STYLES = {'ERROR': 'bold reverse', 'STALE': 'bold magenta', 'WARN': 'black on yellow', 'ok': 'cyan'}
"""Level -> style of the package rich, in the order of the rows of a table. STALE precedes WARN,
because a node that stopped publishing may have an error. The styles also differ without color."""

STALE_S = 5.0
"""A status older than this time in s is shown as stale. By default, nodes publish each status every
second."""


@dataclass(frozen=True)
class StatusRow:
    """One status as it is displayed; ``age_s`` is its age in s."""

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


def row(status: DiagnosticStatus, age_s: float) -> StatusRow:
    """Return a status that was received ``age_s`` ago as a row; control characters are escaped."""
    values = {one_line(v.key): one_line(v.value) for v in status.values}
    node, _, name = one_line(status.name).rpartition(': ')
    level = 'STALE' if age_s > STALE_S else LEVEL_WORDS.get(status.level, 'STALE')
    message, hardware_id = one_line(status.message), one_line(status.hardware_id)
    return StatusRow(level, node, name, message, age_s, hardware_id, values)


def most_severe_first(rows: Iterable[StatusRow]) -> list[StatusRow]:
    """Return the rows sorted by level, then by node and name."""
    return sorted(rows, key=lambda r: (list(STYLES).index(r.level), r.node, r.name))


def counts_text(rows: Sequence[StatusRow]) -> str:
    """Return a line with the number of statuses per level, and the age of the latest status.

    Raises ValueError if there are no rows.
    """
    counts = {level: sum(r.level == level for r in rows) for level in STYLES}
    numbers = ', '.join(f'{count} {level}' for level, count in counts.items() if count)
    return f'allan_ros: {numbers}; last message {min(r.age_s for r in rows):.1f} s ago'


def plain_line(row: StatusRow) -> str:
    """Return a status in one line of text."""
    return f'{row.level:5} {row.title}: {row.message}{f" ({row.age} old)" if row.age else ""}'


def picture(rows: Sequence[StatusRow]) -> RenderableType:
    """Return the statuses as a table of the package rich; raise ValueError if there are no rows."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=counts_text(rows),
        title_justify='left',
        title_style='bold',
        expand=True,
        box=SIMPLE_HEAD,
    )
    table.add_column('', no_wrap=True)
    table.add_column('status', overflow='fold', ratio=2)
    table.add_column('message and next step', overflow='fold', ratio=5)
    for r in rows:
        message = Text(r.message)
        if r.age:
            message = Text.assemble((f'silent for {r.age}; last: ', 'bold'), message)
        table.add_row(Text(r.level, style=STYLES[r.level]), Text(r.title), message)
    return table


def document(rows: Sequence[StatusRow]) -> str:
    """Return the rows as a JSON document."""
    return json.dumps({'statuses': [asdict(row) for row in rows]}, indent=1)


class Watch(Node):
    """Node that displays the latest status of each name on `/diagnostics`.

    Only statuses with 'allan' in their name, or with keys of an allan_ros node, are displayed. With
    ``--node``, only statuses of this node, or of the nodes in this namespace, are displayed.
    """

    def __init__(self, options: argparse.Namespace, stop: threading.Event) -> None:
        super().__init__('allan_watch')
        self._options, self._stop = options, stop
        self._latest: dict[str, tuple[float, DiagnosticStatus]] = {}
        self._wanted = f'/{options.node.strip("/")}/' if options.node.strip('/') else ''
        self._levels: dict[tuple[str, str], str] = {}  # last printed level of each status
        self._hinted = False
        self._final: list[StatusRow] = []  # latest rows at the time when the node was closed
        self._console = None if options.json or options.plain else terminal()
        self._live: Live | None = None
        if self._console and not options.once:
            from rich.live import Live

            self._live = Live(console=self._console, auto_refresh=False)
            self._live.start()
        self._began = time.monotonic()
        self._first: float | None = None
        self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, 100)
        self._page: LivePage | None = None
        if options.web is not None:  # the module is imported only if the page is requested
            from .live_page import LivePage

            self._page = LivePage(self, options.web)
        self.create_timer(REFRESH_S, self._refresh, clock=STEADY_CLOCK)

    def exit_code(self) -> int:
        """Return the exit code, which is known after `close`.

        The code is `EXIT_NO_STATUS` if no status to display was received. Otherwise, it is 0 or,
        with ``--check``, the code of the most severe level (`EXIT_LEVEL`).
        """
        rows = self._final
        if not rows:
            return EXIT_NO_STATUS
        return max(EXIT_LEVEL[row.level] for row in rows) if self._options.check else 0

    def close(self) -> None:
        """Show the final state, and stop the server of the live page."""
        rows = self._final = self._rows()
        if self._live:
            self._show(self._hint())
            self._live.stop()
        elif self._console:
            self._console.print(picture(rows) if rows else self._hint())
        else:
            if self._options.json:
                print(document(rows))
            elif rows:
                print('\n'.join([counts_text(rows), *map(plain_line, rows)]))
            if not rows and not self._hinted:
                print(self._hint(), file=sys.stderr)
        if self._page is not None:
            self._page.close()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in message.status:
            # these keys identify a status of an allan_ros node even if the node was renamed
            has_own_keys = {'static data [s]', 'segments'} <= {v.key for v in status.values}
            node_prefix = f'/{status.name.partition(":")[0].strip("/")}/'
            if self._wanted and not node_prefix.startswith(self._wanted):
                continue
            if 'allan' in status.name or has_own_keys:
                self._latest[status.name] = now, status
                self._first = self._first or now

    def _refresh(self) -> None:
        now = time.monotonic()
        if self._page is not None:
            self._page.discover()
        if self._options.once:
            is_settled = self._first is not None and now - self._first >= SETTLE_S
            publishers = self.count_publishers(TOPIC)
            longest_wait_s = self._options.seconds or (PATIENCE_S if publishers else NOBODY_S)
            is_settled = (
                is_settled and now - self._began >= DISCOVERY_WAIT_S and not self._missing()
            )
            is_done = is_settled or now - self._began >= longest_wait_s
        else:
            has_no_status = not self._latest and now - self._began >= HINT_S
            self._show(self._hint() if has_no_status else '')
            is_done = 0.0 < self._options.seconds <= now - self._began
        if is_done:
            self._stop.set()

    def _show(self, hint: str) -> None:
        """Show the latest statuses, or ``hint`` if there is none.

        In a terminal, the table is drawn again. With ``--plain``, or without a terminal or the
        package rich, each new status and each status whose level has changed is printed.
        """
        rows = self._rows()
        if self._live:
            self._live.update(picture(rows) if rows else hint or 'listening ...', refresh=True)
            return
        for status_row in rows:
            if self._levels.get((status_row.node, status_row.name)) != status_row.level:
                self._levels[status_row.node, status_row.name] = status_row.level
                print(f'{time.strftime("%H:%M:%S")} {plain_line(status_row)}', flush=True)
        if hint and not self._hinted:
            self._hinted = True
            print(hint, file=sys.stderr, flush=True)

    def _rows(self) -> list[StatusRow]:
        now = time.monotonic()
        rows = [row(status, now - received_s) for received_s, status in self._latest.values()]
        if self._options.once and rows:
            message = 'runs, but publishes no status'
            silent_nodes = (name.strip('/') for name in self._missing())
            rows += [
                StatusRow('STALE', name, 'node', message, now - self._began)
                for name in silent_nodes
            ]
        return most_severe_first(rows)

    def _missing(self) -> list[str]:
        """Return the full names of allan_ros nodes on `TOPIC` from which no status was received."""
        heard_nodes = {name.partition(':')[0].strip('/') for name in self._latest}
        topics = [name for name, _ in self.get_topic_names_and_types()]
        missing_nodes = []
        for publisher in self.get_publishers_info_by_topic(TOPIC):
            name = f'{publisher.node_namespace.rstrip("/")}/{publisher.node_name}'
            has_own_topic = any(t.startswith(f'{name}/') and t.endswith(OWN_TOPICS) for t in topics)
            is_wanted = f'{name}/'.startswith(self._wanted)
            is_allan_node = has_own_topic or publisher.node_name.startswith('allan_')
            if is_wanted and is_allan_node and name.strip('/') not in heard_nodes:
                missing_nodes.append(name)
        return missing_nodes

    def _hint(self) -> str:
        """Return a text that explains what to check if no status is received."""
        count = len(self.get_publishers_info_by_topic(TOPIC))
        other_nodes_text = f' (other nodes: {count})' if count else ''
        discovery_settings = [
            f'{name}={os.environ[name]}' for name in DISCOVERY if os.environ.get(name)
        ]
        return (
            f'no allan_ros node publishes on {TOPIC}{other_nodes_text}. Start one: ros2 launch '
            'allan_ros allan_ros.launch.py imu:=/your/imu. If one is running, it must have the '
            f'same discovery settings; here: {" ".join(discovery_settings) or "all defaults"}.'
        )


def terminal() -> Console | None:
    """Return the console of rich; None if stdout is not a terminal, or rich is not installed.

    A terminal with ``TERM=dumb`` does not count as a terminal.
    """
    if not sys.stdout.isatty() or os.environ.get('TERM') == 'dumb':
        return None
    try:
        from rich.console import Console
    except ImportError:
        return None
    return Console()


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line without ROS arguments."""
    parser = argparse.ArgumentParser(
        prog='allan_watch',
        description=__doc__,
        epilog='exit codes: 0 done; 1 no status was received; 2 wrong command line. '
        'Environment variables: NO_COLOR turns colors off, COLUMNS sets the width.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('--once', action='store_true', help='print the present state and exit')
    parser.add_argument(
        '--json', action='store_true', help='print the present state as one JSON document and exit'
    )
    parser.add_argument(
        '--check',
        action='store_true',
        help='like --once; the exit code is 3 for a warning and 4 for an error',
    )
    parser.add_argument(
        '--node', default='', metavar='NAME', help='show only this node, such as /allan_monitor'
    )
    parser.add_argument(
        '--plain', action='store_true', help='print lines of text instead of a table'
    )
    parser.add_argument(
        '--web',
        type=int,
        nargs='?',
        const=WEB_PORT,
        metavar='PORT',
        help=f'also serve the report as a web page on this machine (default port {WEB_PORT})',
    )
    parser.add_argument(
        '--seconds',
        type=float,
        default=0.0,
        metavar='S',
        help='exit after this time in s; with --once, longest time to wait for the first status '
        f'(default {NOBODY_S:g}, or {PATIENCE_S:g} if a node publishes)',
    )
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Run `allan_watch` and return the exit code.

    The code is 0 if the program that reads the output, such as head, has ended. Raises SystemExit
    if an option of the command line is invalid.
    """
    nodes: list[Watch] = []

    def make(stop: threading.Event, options: argparse.Namespace) -> Watch:
        options.once = options.once or options.json or options.check
        nodes.append(Watch(options, stop))
        return nodes[0]

    try:
        code = run('allan_watch', make, make_parser(), args)
        sys.stdout.flush()
    except BrokenPipeError:  # the program that reads the output, such as head, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    return code or nodes[0].exit_code()
