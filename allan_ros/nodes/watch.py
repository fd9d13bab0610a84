# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan_watch`: `/diagnostics` of the allan_ros nodes as a live table in the terminal."""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from .shell import STEADY, run

LEVEL_WORDS = {
    DiagnosticStatus.OK: ('ok', 'green'),
    DiagnosticStatus.WARN: ('WARN', 'yellow'),
    DiagnosticStatus.ERROR: ('ERROR', 'bold red'),
    DiagnosticStatus.STALE: ('STALE', 'magenta'),
}
"""Level -> how it is written, and its colour."""

SHOWN_TERMS = ('N', 'B', 'K')
"""Terms with a column of their own; all five are among the values of the status."""

DATASHEET_UNITS = ('deg/sqrt(h)', 'm/s/sqrt(h)', 'deg/h', 'ug', 'deg/h^1.5', 'ug/sqrt(h)')

REFRESH_S = 0.5
STALE_S = 5.0
"""A status that has not been repeated for so long is shown as stale."""

Row = tuple[str, str, str, str, str, str]


class Watch(Node):
    """Keeps the latest status of each name and redraws the table."""

    def __init__(self, options: argparse.Namespace, stop: threading.Event) -> None:
        super().__init__('allan_watch')
        self._options, self._stop = options, stop
        self._latest: dict[str, tuple[float, DiagnosticStatus]] = {}
        self._draw, self._end = _display(options.plain)
        self._began = time.monotonic()
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 100)
        self.create_timer(REFRESH_S, self._refresh, clock=STEADY)

    def close(self) -> None:
        """Leave the last table on the screen."""
        self._draw(self._rows())
        self._end()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in message.status:
            if 'allan' in status.name or self._options.all:
                self._latest[status.name] = now, status

    def _refresh(self) -> None:
        self._draw(self._rows())
        limit = self._options.seconds
        if limit and time.monotonic() - self._began >= limit:
            self._stop.set()

    def _rows(self) -> list[Row]:
        now = time.monotonic()
        return [row(status, now - at) for _, (at, status) in sorted(self._latest.items())]


def row(status: DiagnosticStatus, age_s: float) -> Row:
    """Return level, name, the shown terms in the datasheets' units, and the message."""
    level = DiagnosticStatus.STALE if age_s > STALE_S else status.level
    values = {v.key: v.value for v in status.values}
    terms = []
    for term in SHOWN_TERMS:
        keys = [k for k in values if k in {f'{term} [{unit}]' for unit in DATASHEET_UNITS}]
        unit = keys[0].split(' ', 1)[1].strip('[]') if keys else ''
        terms.append(f'{values[keys[0]]} {unit}' if keys and values[keys[0]] != '-' else '')
    name, message = status.name.split(': ', 1)[-1], status.message
    if level == DiagnosticStatus.OK and any(terms):
        message = message.partition(' from ')[2]  # what comes before stands in the columns
    if age_s > STALE_S:
        message = f'no word for {age_s:.0f} s: start the node again, or look why it hangs'
    return LEVEL_WORDS[level][0], name, terms[0], terms[1], terms[2], message


def _display(plain: bool) -> tuple[Callable[[list[Row]], None], Callable[[], None]]:
    """Return how to draw the rows, and how to end."""
    if not plain and sys.stdout.isatty():
        try:
            return _rich_display()
        except ImportError:
            pass
    return _plain_display()


def _rich_display() -> tuple[Callable[[list[Row]], None], Callable[[], None]]:
    from rich.live import Live
    from rich.table import Table

    colours = dict(LEVEL_WORDS.values())
    live = Live(auto_refresh=False)
    live.start()

    def draw(rows: list[Row]) -> None:
        table = Table(title='allan_ros')
        for heading in ('', 'status', *SHOWN_TERMS, 'message'):
            table.add_column(heading, overflow='fold')
        for level, *cells in rows:
            table.add_row(f'[{colours[level]}]{level}[/]', *cells)
        live.update(table, refresh=True)

    return draw, live.stop


def _plain_display() -> tuple[Callable[[list[Row]], None], Callable[[], None]]:
    shown: dict[str, Row] = {}

    def draw(rows: list[Row]) -> None:
        for each in rows:
            # only what is new, without the ages and amounts that change all the time
            if shown.get(each[1], ('',))[0] != each[0]:
                level, name, *_, message = each
                print(f'{time.strftime("%H:%M:%S")} {level:5} {name}: {message}', flush=True)
            shown[each[1]] = each

    def end() -> None:
        for level, name, *terms, message in shown.values():
            print(f'{level:5} {name:32} {" ".join(f"{t:24}" for t in terms)} {message}')

    return draw, end


def main(args: list[str] | None = None) -> int:
    """Run `allan_watch`."""
    argv = sys.argv if args is None else ['allan_watch', *args]
    parser = argparse.ArgumentParser(prog='allan_watch', description=__doc__)
    parser.add_argument('--all', action='store_true', help='show the statuses of all nodes')
    parser.add_argument('--plain', action='store_true', help='lines of text instead of a table')
    parser.add_argument('--seconds', type=float, default=0.0, help='end after that time')
    options = parser.parse_args(remove_ros_args(argv)[1:])
    return run('allan_watch', lambda stop: Watch(options, stop), argv)


if __name__ == '__main__':
    sys.exit(main())
