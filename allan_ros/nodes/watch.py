# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan_watch`: show `/diagnostics` of the allan_ros nodes as a live table in the terminal.

The most severe status comes first. If the output is not a terminal, a line is printed whenever
the level of a status changes.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from .shell import STEADY, run
from .status_table import Row, document, headline, most_severe_first, picture, plain_line, row

if TYPE_CHECKING:
    from rich.console import Console
    from rich.live import Live

    from .live_page import LivePage

TOPIC = '/diagnostics'

WEB_PORT = 8095
"""Default port of the live page."""

REFRESH_S = 0.5
"""Period in s at which the table is redrawn."""

SETTLE_S = 1.5
"""Time in s from the first status until every node has published once."""

PATIENCE_S, NOBODY_S = 10.0, 6.5
"""Time in s for which ``--once`` waits for the first status: if a node publishes on `TOPIC`, and if
none has been discovered. Fast DDS announces a process every 3 s; a busy computer can miss one."""

HINT_S = 8.0
"""Time in s without a status after which the hint is shown. Nodes need some seconds to start."""

CALL_S, ANSWER_S = 5.0, 15.0
"""Time in s after which a call is repeated, and longest time to wait for its answer."""

EXIT_LEVEL = {'ok': 0, 'WARN': 3, 'STALE': 4, 'ERROR': 4}
"""Exit code of ``--check`` by the most severe level."""

EXIT_FAILED = 1
"""Exit code: no status was received, or a service was not found or did not succeed."""

DISCOVERY = (
    'ROS_DOMAIN_ID',
    'ROS_AUTOMATIC_DISCOVERY_RANGE',
    'ROS_LOCALHOST_ONLY',
    'RMW_IMPLEMENTATION',
)
"""Environment variables that determine which nodes discover each other."""

TRIGGER = 'std_srvs/srv/Trigger'


class Watch(Node):
    """Keeps the latest status of each name and displays it."""

    def __init__(self, options: argparse.Namespace, stop: threading.Event) -> None:
        super().__init__('allan_watch')
        self._options, self._stop = options, stop
        self._latest: dict[str, tuple[float, DiagnosticStatus]] = {}
        self._wanted = f'/{options.node.strip("/")}/' if options.node.strip('/') else ''
        self._levels: dict[tuple[str, str], str] = {}  # of the lines printed so far
        self._hinted = False
        self._console = None if options.json or options.plain else terminal()
        self._live: Live | None = None
        if self._console and not options.once:
            from rich.live import Live

            self._live = Live(console=self._console, auto_refresh=False)
            self._live.start()
        self._began = time.monotonic()
        self._first: float | None = None
        self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, 100)
        self._page: LivePage | None = None  # the module is imported only if the page is requested
        if options.web is not None:
            from .live_page import LivePage

            self._page = LivePage(self, options.web)
        self.create_timer(REFRESH_S, self._refresh, clock=STEADY)

    def exit_code(self) -> int:
        """Return the exit code; with ``--check``, it depends on the most severe level."""
        rows = self._rows()
        if not rows:
            return EXIT_FAILED
        return max(EXIT_LEVEL[row.level] for row in rows) if self._options.check else 0

    def close(self) -> None:
        """Show the final state, and stop serving the page."""
        rows = self._rows()
        if self._live:
            self._show(self._hint())
            self._live.stop()
        elif self._console:
            self._console.print(picture(rows) if rows else self._hint())
        else:
            if self._options.json:
                print(document(rows))
            elif rows:
                print('\n'.join([headline(rows), *map(plain_line, rows)]))
            if not rows and not self._hinted:
                print(self._hint(), file=sys.stderr)
        if self._page is not None:
            self._page.close()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in message.status:
            # a renamed node also has statuses of axes and inputs
            known = {'static data [s]', 'segments'} <= {v.key for v in status.values}
            node = f'/{status.name.partition(":")[0].strip("/")}/'
            if self._wanted and not node.startswith(self._wanted):
                continue
            if self._options.all or 'allan' in status.name or known:
                self._latest[status.name] = now, status
                self._first = self._first or now

    def _refresh(self) -> None:
        now = time.monotonic()
        if self._page is not None:
            self._page.discover()
        if self._options.once:
            settled = self._first is not None and now - self._first >= SETTLE_S
            heard = self.count_publishers(TOPIC)
            patience = self._options.seconds or (PATIENCE_S if heard else NOBODY_S)
            done = settled or now - self._began >= patience
        else:
            silent = not self._latest and now - self._began >= HINT_S
            self._show(self._hint() if silent else '')
            done = 0.0 < self._options.seconds <= now - self._began
        if done:
            self._stop.set()

    def _show(self, hint: str) -> None:
        """Draw the table, or print new statuses and changed levels; without any, the hint."""
        rows = self._rows()
        if self._live:
            self._live.update(picture(rows) if rows else hint or 'listening ...', refresh=True)
            return
        for each in rows:
            if self._levels.get((each.node, each.name)) != each.level:
                self._levels[each.node, each.name] = each.level
                print(f'{time.strftime("%H:%M:%S")} {plain_line(each)}', flush=True)
        if hint and not self._hinted:
            self._hinted = True
            print(hint, file=sys.stderr, flush=True)

    def _rows(self) -> list[Row]:
        now = time.monotonic()
        return most_severe_first(row(status, now - at) for at, status in self._latest.values())

    def _hint(self) -> str:
        """Return a text that explains what to check if no status is received."""
        count = len(self.get_publishers_info_by_topic(TOPIC))
        others = f' (other nodes: {count})' if count else ''
        given = [f'{name}={os.environ[name]}' for name in DISCOVERY if os.environ.get(name)]
        return (
            f'no allan_ros node publishes on {TOPIC}{others}. Start one: ros2 launch allan_ros '
            'allan_ros.launch.py imu:=/your/imu. If one is running, it must have the same '
            f'discovery settings; here: {" ".join(given) or "all defaults"}.'
        )


def terminal() -> Console | None:
    """Return the terminal for rich; None if stdout is none, or rich is not installed."""
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
        'NO_COLOR turns colors off, COLUMNS sets the width.',
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
        '--node', default='', metavar='NAME', help='only this node, such as /allan_monitor'
    )
    parser.add_argument('--all', action='store_true', help='show the statuses of all nodes')
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
        help='exit after this time; with --once, wait so long for the first status (default '
        f'{NOBODY_S:g}, or {PATIENCE_S:g} if a node publishes)',
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


def services_of(node: Node, verb: str, wanted: str) -> list[str]:
    """Return the full names of a service of all running allan_ros nodes.

    ``verb`` is 'save' or 'fit'. ``wanted`` is the name of one node or IMU, such as
    ``/allan_monitor``, or '' for all.
    """
    known = {name for name, types in node.get_service_names_and_types() if TRIGGER in types}
    homes = [name.rpartition('/')[0] for name in known if name.endswith(f'/{verb}')]
    # an accumulator has `reset` next to `save`, an estimator `noise_model` next to `fit`
    topics = {name for name, _ in node.get_topic_names_and_types()}
    ours = [h for h in homes if f'{h}/reset' in known or f'{h}/noise_model' in topics]
    chosen = f'/{wanted.strip("/")}' if wanted else ''
    return sorted(f'{h}/{verb}' for h in ours if f'{h}/'.startswith(f'{chosen}/'))


def call_services(verb: str, args: Sequence[str]) -> int:
    """Call ``~/save`` or ``~/fit`` of running nodes, and return the exit code.

    It is 0 if a node with this service is running and all calls succeed. ``args`` is the command
    line after the verb.
    """
    doc = {
        'save': 'Write the checkpoint of running nodes now.',
        'fit': 'Fit the sums of running nodes now.',
    }[verb]
    parser = argparse.ArgumentParser(prog=f'ros2 allan {verb}', description=doc)
    parser.add_argument('--node', default='', help='only this node or IMU, such as /allan_monitor')
    parser.add_argument(
        '--seconds',
        type=float,
        default=0.0,
        metavar='S',
        help=f'longest time to wait for a node (default {NOBODY_S:g}), and then for its answer '
        f'(default {ANSWER_S:g})',
    )
    options = parser.parse_args(list(args))
    wanted, patience = options.node, options.seconds
    rclpy.init(args=[])
    node, executor = Node(f'allan_{verb}'), SingleThreadedExecutor()
    executor.add_node(node)
    try:
        found: list[str] = []
        deadline = time.monotonic() + (patience or NOBODY_S)
        while (now := time.monotonic()) < deadline:
            executor.spin_once(timeout_sec=0.1)
            known, found = found, services_of(node, verb, wanted)
            if found and not known:  # other nodes may follow
                deadline = min(deadline, now + SETTLE_S)
        if not found:
            named = f' {wanted}' if wanted else ''
            remedy = 'check --node' if wanted else 'start allan_monitor'
            print(f'no allan_ros node{named} with a service {verb} is running: {remedy}')
        codes = [_call(node, executor, name, patience or ANSWER_S) for name in found]
        return max(codes, default=EXIT_FAILED)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()


def _call(node: Node, executor: SingleThreadedExecutor, name: str, patience: float) -> int:
    """Call one service and print its answer; return 0 on success."""
    client = node.create_client(Trigger, name)
    client.wait_for_service(patience)
    # An answer to a client that the service has not discovered yet is lost: repeat the call.
    deadline = time.monotonic() + patience
    while time.monotonic() < deadline:
        future = client.call_async(Trigger.Request())
        executor.spin_until_future_complete(future, CALL_S)
        answer = future.result() if future.done() else None
        if answer is not None:
            print(f'{name}: {answer.message or "done"}')
            return 0 if answer.success else EXIT_FAILED
    print(f'{name}: no answer within {patience:g} s')
    return EXIT_FAILED
