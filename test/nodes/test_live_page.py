# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The live page is served on the loopback interface only, and rendered again when the sums
change."""

from __future__ import annotations

import contextlib
import http.client
import re
import socket
import threading
import time
import urllib.request
from collections.abc import Iterator

import pytest

pytest.importorskip('rclpy')

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import String
from support.chromium import Chromium
from support.node_server import PATIENCE_S

from allan_ros.core.errors import AllanError
from allan_ros.nodes.live_page import MOST_REQUESTS, RELOAD_S, LivePage, _with_age
from allan_ros.nodes.messages import Snapshot
from allan_ros.readers.files import to_json

TOPIC = '/allan_monitor/sums'


@pytest.fixture
def node(ros_domain: int) -> Iterator[Node]:
    context = Context()
    rclpy.init(context=context, domain_id=ros_domain)
    made = Node('page', context=context)
    yield made
    made.destroy_node()
    rclpy.shutdown(context=context)


@pytest.fixture
def page(node: Node) -> Iterator[LivePage]:
    made = LivePage(node, 0)
    yield made
    made.close()


def port_of(page: LivePage) -> int:
    return int(page.address.rsplit(':', 1)[1].strip('/'))


def read(address: str) -> str:
    with urllib.request.urlopen(address, timeout=PATIENCE_S) as answer:
        assert answer.headers['Refresh'] == str(RELOAD_S)
        text: str = answer.read().decode()
        return text


def test_the_report_follows_the_sums(page: LivePage, small_run) -> None:
    assert 'No accumulator has published' in read(page.address)
    sums, provenance = small_run
    text = to_json(Snapshot(((sums,), provenance)).to_document())
    page.on_sums(TOPIC, String(data=text))
    first = read(page.address)
    assert 'Noise of unit 7' in first and 'data-kind="allan"' in first
    assert 'OUT OF DATE: the node has stopped' in first  # nothing publishes this topic
    assert 'id="live"' in first and 'OUT OF DATE' not in _with_age('<body>', 3.0, True)
    with socket.create_connection(('127.0.0.1', port_of(page))) as leaving:
        leaving.sendall(b'GET / HTTP/1.0\r\nHost: localhost\r\n\r\n')
    page.on_sums(TOPIC, String(data='{"schema": "odd"}'))
    assert TOPIC in read(page.address)
    page.on_sums('/other/sums', String(data=text))
    assert 'href="/other/sums"' in read(page.address)
    assert 'Noise of unit 7' in read(page.address + 'other/sums')


def test_other_hosts_and_unknown_paths_are_rejected(page: LivePage) -> None:
    for host, path, code in (('evil.example', '/', 403), ('localhost', '/none', 404)):
        connection = http.client.HTTPConnection('127.0.0.1', port_of(page), timeout=PATIENCE_S)
        connection.request('GET', path, headers={'Host': host})
        assert connection.getresponse().status == code
        connection.close()


def test_half_requests_do_not_exhaust_the_threads(page: LivePage) -> None:
    before = threading.active_count()
    place = ('127.0.0.1', port_of(page))
    halves = [socket.create_connection(place) for _ in range(2 * MOST_REQUESTS)]
    for half in halves:
        with contextlib.suppress(OSError):
            half.sendall(b'GET / HT')
    for half in halves[MOST_REQUESTS:]:  # closed by the server
        with contextlib.suppress(ConnectionError):
            assert half.recv(1) == b''
    assert threading.active_count() - before <= MOST_REQUESTS
    for half in halves:
        half.close()
    deadline = time.monotonic() + PATIENCE_S
    while threading.active_count() > before:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert 'No accumulator' in read(page.address)


def test_a_port_in_use_is_one_line(node: Node) -> None:
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(AllanError, match=f'port {port} cannot be used'):
            LivePage(node, port)
    with pytest.raises(AllanError, match='port 70000 cannot be used'):
        LivePage(node, 70000)


def test_a_browser_follows_a_live_monitor(graph, still_imu, browser: Chromium) -> None:
    graph.run('monitor')
    watch = graph.start('watch', '--web', '0')
    publisher = graph.publisher()
    batch = still_imu(12_000)
    graph.send(publisher, batch[:6000])
    address = graph.until(lambda: re.search(r'http://127\.0\.0\.1:\d+/', watch.output))[0]

    def shows(text: str) -> bool:
        try:
            return text in urllib.request.urlopen(address, timeout=PATIENCE_S).read().decode()
        except OSError:  # not yet served
            return False

    graph.until(lambda: shows('6,000 samples'))
    browser.complaints.clear()
    browser.call('Page.navigate', url=address)
    browser.wait_for('typeof Chart !== "undefined" && Chart.all.length >= 2')
    graph.send(publisher, batch[6000:])
    graph.until(lambda: shows('12,000 samples'))
    # the page reloads its data
    browser.wait_for(
        'document.readyState === "complete" && '
        'document.querySelector("header").textContent.includes("12,000 samples")'
    )
    browser.wait_for('typeof Chart !== "undefined" && Chart.all.length >= 2')
    assert browser.complaints == []
    assert watch.stop() == 0
    browser.call('Page.navigate', url='about:blank')
