# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan_watch --web`: an HTTP server that shows the report of running nodes."""

from __future__ import annotations

import re
import threading
import time
from functools import lru_cache, partial
from html import escape
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from rclpy.node import Node
from std_msgs.msg import String

from ..core.errors import AllanError
from ..core.estimate import duration_text
from ..results.analysis import analyze_sums
from ..view.report import render_report
from .messages import Snapshot
from .shell import LATCHED

HOST = '127.0.0.1'
"""Address of the server. Other machines can connect only through a tunnel or proxy."""

RELOAD_S = 10
"""Period in s at which the browser reloads the page."""

SUMS_TOPIC = '/sums', ['std_msgs/msg/String']
"""End of the name of a topic with Allan sums, and the message types of such a topic."""

CACHED_PAGES = 8
"""Number of rendered pages that are kept in memory."""

MOST_REQUESTS, REQUEST_S = 16, 10.0
"""Largest number of simultaneous requests, and longest time in s for which a request may wait for
the next bytes from its client. The server closes the connections of further requests and of slower
requests."""

STALE_SUMS_S = 60.0
"""Allan sums older than this time in s are shown as out of date. By default, nodes publish them
every 10 s."""


class _Server(ThreadingHTTPServer):
    """HTTP server that answers at most `MOST_REQUESTS` requests at a time, each in a thread."""

    daemon_threads = True

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._free = threading.BoundedSemaphore(MOST_REQUESTS)
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Start a thread for a request, or close the connection if there are too many."""
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer a request, and then permit a further request."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()


class LivePage:
    """Subscribes to the Allan sums of all accumulators, and serves reports of them over HTTP.

    A report is rendered when a browser requests it, unless it is still cached. ``port`` is the TCP
    port; 0 selects a free one. Raises AllanError if the port cannot be used, for example because it
    is in use or above 65535.
    """

    def __init__(self, node: Node, port: int) -> None:
        self._node = node
        # topic -> time in s at which the latest document was received, and this document
        self._sums: dict[str, tuple[float, str]] = {}
        self._subscriptions: dict[str, Any] = {}
        try:
            self._server = _Server((HOST, port), _handler_of(self))
        except (OSError, OverflowError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            raise AllanError(
                f'port {port} cannot be used ({reason}): give another port with --web PORT'
            ) from error
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()
        node.get_logger().info(f'live page: {self.address}')

    @property
    def address(self) -> str:
        """URL of the page."""
        return f'http://{HOST}:{self._server.server_address[1]}/'

    def discover(self) -> None:
        """Subscribe to the sums of accumulators that have started since the last call."""
        name_end, types = SUMS_TOPIC
        for topic, topic_types in self._node.get_topic_names_and_types():
            if (
                topic not in self._subscriptions
                and topic.endswith(name_end)
                and topic_types == types
            ):
                self._subscriptions[topic] = self._node.create_subscription(
                    String, topic, partial(self.on_sums, topic), LATCHED
                )

    def on_sums(self, topic: str, message: String) -> None:
        """Store the latest sums of a topic."""
        self._sums[topic] = time.monotonic(), message.data

    def page(self, path: str) -> str | None:
        """Return the HTML page of a URL path, or None if there is none.

        Each topic from which sums were received has a page, whose path is the name of the topic.
        The page of '/' is the page of the only such topic, a list of several such topics, or a hint
        if there is none.
        """
        sums = dict(self._sums)  # a copy, because another thread adds topics
        topic = next(iter(sums)) if path == '/' and len(sums) == 1 else path
        if topic in sums:
            received_s, text = sums[topic]
            is_running = self._node.count_publishers(topic) > 0
            return _with_age(_report(topic, text), time.monotonic() - received_s, is_running)
        return _index(sorted(sums)) if path == '/' else None

    def close(self) -> None:
        """Stop the server."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


@lru_cache(CACHED_PAGES)
def _report(topic: str, text: str) -> str:
    try:
        snapshot = Snapshot.from_json(text)
        results = analyze_sums(*snapshot.total)
        now_text = time.strftime('%H:%M:%S')
        method = {'topic': topic, 'computed at': now_text}
        return render_report(results, 'deg/h', method=method)
    except AllanError as error:
        return _notice(f'{topic}: {error}')


def _with_age(html: str, age_s: float, is_running: bool) -> str:
    """Return the page ``html`` with an added first line that states the age of the data."""
    is_stale = age_s > STALE_SUMS_S or not is_running
    text = f'live at {time.strftime("%H:%M:%S")}; data received {duration_text(age_s)} ago'
    if is_stale:
        reason = 'the node no longer publishes' if is_running else 'the node has stopped'
        text = f'OUT OF DATE: {reason}; last data {duration_text(age_s)} ago'
    style = 'background:#a00;color:#fff;' if is_stale else ''
    line = f'<p id="live" role="status" style="{style}margin:0;padding:.3em 1em">{text}</p>'
    return re.sub('<body[^>]*>', lambda body: body[0] + line, html, count=1)


def _index(topics: list[str]) -> str:
    if not topics:
        return _notice('No accumulator has published sums yet. Start allan_monitor.')
    links = ''.join(f'<li><a href="{escape(t)}">{escape(t)}</a></li>' for t in topics)
    return _notice('', f'<ul>{links}</ul>')


def _notice(text: str, html: str = '') -> str:
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>allan_watch</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'</head><body><h1>allan_watch</h1><p>{escape(text)}</p>{html}</body></html>\n'
    )


def _handler_of(page: LivePage) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        """Answers GET with a page that the browser reloads periodically."""

        timeout = REQUEST_S  # for each socket operation; a client may send only half a request

        def do_GET(self) -> None:
            # Requests for other host names are rejected. Otherwise, a web page of another site
            # could read the report through a host name that resolves to this machine (DNS
            # rebinding).
            if self.headers.get('Host', '').rsplit(':', 1)[0] not in (HOST, 'localhost'):
                self.send_error(403)
                return
            text = page.page(self.path)
            if text is None:
                self.send_error(404)
                return
            body = text.encode()
            self.send_response(200)
            self.send_header('Content-Type', 'text/html; charset=utf-8')
            self.send_header('Content-Length', str(len(body)))
            self.send_header('Cache-Control', 'no-store')
            self.send_header('Refresh', str(RELOAD_S))
            self.end_headers()
            try:
                self.wfile.write(body)
            except OSError:  # the browser has closed the connection
                self.close_connection = True

        def log_message(self, format: str, *args: object) -> None:
            """Suppress the log of requests."""

    return Handler
