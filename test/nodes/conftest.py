# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Real nodes in real processes over real DDS; each test has its own ROS domain.

Messages use UDP on the loopback interface, not shared memory. A killed process leaves its files
in ``/dev/shm``, Fast DDS names them by port, and its readers of ``ros_discovery_info`` use the
ports from 7000 in every domain, so tests that kill nodes could disturb other tests.
"""

from __future__ import annotations

import fcntl
import itertools
import json
import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.node_server import PATIENCE_S, NodeProcess, NodeServer

from allan_ros.core.imu import ImuBatch
from allan_ros.readers.cdr import encode_imus

ROOT = Path(__file__).resolve().parents[2]
DOMAINS = range(1, 101)
"""Domains whose UDP ports stay below the ephemeral ones (docs.ros.org, The ROS_DOMAIN_ID)."""

FIRST_PORT, PORTS_OF_DOMAIN = 7400, 250
"""First UDP port of domain 0, and number of ports of each domain."""

_WORKER = int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0').removeprefix('gw'))
_WORKERS = int(os.environ.get('PYTEST_XDIST_WORKER_COUNT', '1'))
_ROUND = itertools.cycle(DOMAINS[_WORKER::_WORKERS])
"""A test does not use the domain of a recent one, or of another worker. A subscription of an
earlier test that Python has not yet collected would answer in place of the node under test."""

ASK_AGAIN_S = 1.0
"""Seconds after which an unanswered request is sent again."""

BURST = 2000
"""Messages after which a node in this process fetches them; Fast DDS keeps 5000 in a queue."""

_PERIODS = {'publish.sums_period': 0.3, 'publish.diagnostics_period': 0.2}

_INPUT = {**_PERIODS, 'input.stale_after': 3600.0}

QUICK: dict[str, dict[str, Any]] = {
    'accumulator': _INPUT,
    'monitor': _INPUT,
    'estimator': {**_PERIODS, 'publish.sums_period': 10.0},
    'relay': {'publish.diagnostics_period': 0.2},
}
"""Node -> parameters of every test that does not set them: statuses are published soon, and it is
not reported that the publisher of a test is silent."""

RELIABLE = {'reliability': 'reliable', 'history': 'keep_all'}
"""QoS of the inputs: no message is lost, because the publisher waits while the queue is full."""


def _domains_in_use() -> set[int]:
    """Return the domains with a participant on this machine, by its UDP ports (RTPS 2.5, 9.6.2)."""
    lines = Path('/proc/net/udp').read_text().splitlines()[1:]
    ports = (int(line.split()[1].partition(':')[2], 16) for line in lines)
    return {(port - FIRST_PORT) // PORTS_OF_DOMAIN for port in ports}


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[int]:
    """Reserve a ROS domain that no other process uses, restricted to the loopback interface."""
    taken = _domains_in_use()
    for domain in (d for d in itertools.islice(_ROUND, len(DOMAINS)) if d not in taken):
        file = Path(tempfile.gettempdir()) / f'allan_ros_test_domain_{domain}'
        try:
            lock = file.open('w')
        except PermissionError:  # reserved by another user
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            break
        except BlockingIOError:
            lock.close()
    else:
        raise RuntimeError('no free ROS domain')
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'ros_home'))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SYSTEM_DEFAULT')  # as in the profile
    for variable in ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE'):
        monkeypatch.setenv(variable, str(ROOT / 'config' / 'fastdds' / 'loopback_udp.xml'))
    yield domain
    lock.close()


class Graph:
    """The ROS graph of one test: started processes, and a client node in the process of the
    test.
    """

    def __init__(self, folder: Path, server: NodeServer) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        self.folder = folder
        self._server = server
        self._processes: list[NodeProcess] = []
        self._nodes: list[Any] = []
        self._others: list[Any] = []
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = Node('test_client', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.statuses: dict[str, Any] = {}
        self.history: list[tuple[float, Any]] = []
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 100)

    def start(
        self, module: str, *arguments: str, remap: dict[str, str] | None = None, **parameters: Any
    ) -> NodeProcess:
        """Start ``allan_ros.nodes.<module>`` in its own process; see `run`."""
        log = self.folder / f'{module}{len(self._processes)}.log'
        words = [module, *arguments, *_ros_arguments(module, remap, parameters)]
        environment = {**os.environ, 'ROS_LOG_DIR': str(self.folder)}
        process = NodeProcess(self._server, words, environment, log)
        self._processes.append(process)
        return process

    def run(self, module: str, remap: dict[str, str] | None = None, **parameters: Any) -> Any:
        """Return a new node in this process, with the executor of the client.

        ``parameters`` have their full names and precede those in `QUICK`.
        """
        from allan_ros.nodes import monitor

        arguments = _ros_arguments(module, remap, parameters)
        made = getattr(monitor, module.title())(context=self._context, cli_args=arguments)
        self._executor.add_node(made)
        self._nodes.append(made)
        return made

    def add_node(self, name: str) -> Any:
        """Return a new node of another package, with the executor of the client."""
        from rclpy.node import Node

        self._others.append(Node(name, context=self._context))
        self._executor.add_node(self._others[-1])
        return self._others[-1]

    def stop(self, node: Any) -> None:
        """End a node in this process as `shell.run` does."""
        self._nodes.remove(node)
        self._executor.remove_node(node)
        node.close()
        node.destroy_node()

    def until(self, holds: Callable[[], Any], patience: float = PATIENCE_S) -> Any:
        """Spin until the condition is true and return its value."""
        deadline = time.monotonic() + patience
        while not (value := holds()):
            if time.monotonic() > deadline:
                logs = '\n'.join(f'--- {p.arguments}\n{p.output}' for p in self._processes)
                raise AssertionError(f'no success within {patience} s; {self.summary()}\n{logs}')
            self._executor.spin_once(timeout_sec=0.05)
        return value

    def spin(self, seconds: float) -> None:
        """Spin for a duration."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.05)

    def status(self, ending: str) -> Any:
        """Return the latest diagnostic status whose name ends with ``ending``, or None."""
        return next((s for name, s in self.statuses.items() if name.endswith(ending)), None)

    def value(self, ending: str, key: str) -> str | None:
        """Return one value of that status; ``key`` may omit the unit."""
        status = self.status(ending)
        pairs = status.values if status else ()
        return next((v.value for v in pairs if v.key == key or v.key.startswith(f'{key} [')), None)

    def summary(self) -> str:
        """Return every status and the values of the inputs as text, for messages of failed
        tests.
        """
        known = (v for name, s in self.statuses.items() if name.endswith('input') for v in s.values)
        counts = ', '.join(f'{v.key} {v.value}' for v in known)
        said = '; '.join(f'{s.name}: {s.level!r} {s.message}' for s in self.statuses.values())
        return f'{said} ({counts})'

    def publisher(self, topic: str = 'imu/data') -> Any:
        """Return a publisher of Imu that keeps all messages, once it and a subscriber have
        discovered each other."""
        from rclpy.qos import HistoryPolicy, QoSProfile
        from sensor_msgs.msg import Imu

        qos = QoSProfile(history=HistoryPolicy.KEEP_ALL)
        publisher = self.node.create_publisher(Imu, topic, qos)
        self.introduce(publisher)
        return publisher

    def introduce(self, publisher: Any, wanted: int = 1) -> None:
        """Wait until this publisher and at least ``wanted`` subscribers have discovered each
        other.
        """
        from support.handshake import Handshake

        handshake = Handshake(self.node, publisher, wanted)
        self.until(handshake.update)
        handshake.close()

    def send(self, publisher: Any, batch: ImuBatch) -> None:
        """Publish every sample, waiting while the queue of a reliable subscriber is full."""
        from rclpy.impl.implementation_singleton import rclpy_implementation

        for i, payload in enumerate(encode_imus(batch, 'cdr')):
            if self._nodes and i % BURST == 0:
                self.spin(0.05)
            deadline = time.monotonic() + PATIENCE_S
            while True:
                try:
                    publisher.publish(bytes(payload))
                    break
                except rclpy_implementation.RCLError:
                    assert time.monotonic() < deadline, f'message {i} could not be published'

    def ask(self, kind: Any, service: str, request: Any) -> Any:
        """Call a service of a node and return its response.

        A client discovers a service before the service discovers the client, and answers in between
        are lost. Endpoints are announced in order (see `handshake`), so a node that answers a
        client created later has also discovered the earlier one. This call can be repeated.
        """
        from rcl_interfaces.srv import GetParameters

        client = self.node.create_client(kind, service)
        self.until(client.service_is_ready)
        question = self.until(lambda: self._parameter_service(service))
        later = self.node.create_client(GetParameters, question)
        answers: list[Any] = []
        asked = float('-inf')

        def answered() -> bool:
            nonlocal asked
            if time.monotonic() - asked > ASK_AGAIN_S and later.service_is_ready():
                asked = time.monotonic()
                later.call_async(GetParameters.Request()).add_done_callback(answers.append)
            return bool(answers)

        self.until(answered)
        future = client.call_async(request)
        self.until(future.done)
        self.node.destroy_client(later)
        self.node.destroy_client(client)
        return future.result()

    def _parameter_service(self, service: str) -> str:
        """Return the parameter service of the node that has a service; '' while it is not known."""
        known = {name for name, _ in self.node.get_service_names_and_types()}
        parts = service.split('/')
        named = (f'{"/".join(parts[:n])}/get_parameters' for n in range(len(parts), 1, -1))
        return next((name for name in named if name in known), '')

    def call(self, service: str) -> Any:
        """Call a Trigger service and return its response."""
        from std_srvs.srv import Trigger

        return self.ask(Trigger, service, Trigger.Request())

    def model_of(self, samples: int) -> dict[str, Any]:
        """Let the monitor fit this number of samples, and return its model.

        It does not fit again until more samples arrive.
        """
        models = self.latched('/allan_monitor/noise_model')
        self.until(lambda: self.value('input', 'used') == str(samples))
        self.call('/allan_monitor/save')  # also passes the sums of all samples to the fit
        self.until(lambda: self.call('/allan_monitor/fit').success)
        return self.until(lambda: models and models[-1]['samples'] == samples and models[-1])

    def latched(self, topic: str) -> list[dict[str, Any]]:
        """Subscribe to a latched String topic and return the list to which its documents are
        appended.
        """
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from std_msgs.msg import String

        documents: list[dict[str, Any]] = []
        qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(
            String, topic, lambda m: documents.append(json.loads(m.data)), qos
        )
        return documents

    def close(self) -> None:
        for process in self._processes:
            process.send_signal(signal.SIGKILL)
            process.wait()
        for node in [*self._nodes]:
            self.stop(node)
        self._executor.shutdown()
        for node in (*self._others, self.node):
            node.destroy_node()
        self._context.shutdown()

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            self.statuses[status.name] = status
            self.history.append((time.monotonic(), status))


def _ros_arguments(
    module: str, remap: dict[str, str] | None, parameters: dict[str, Any]
) -> list[str]:
    remap, topics = remap or {}, parameters.get('input.topics', ['imu/data'])
    qos = {
        f'qos_overrides./{remap.get(topic, topic)}.subscription.{policy}': value
        for topic in (*topics, *parameters.get('input.accel_topics', ()))
        for policy, value in RELIABLE.items()
    }
    parameters = {**(qos if module in QUICK else {}), **QUICK.get(module, {}), **parameters}
    given = [a for old, new in remap.items() for a in ('-r', f'{old}:={new}')]
    for name, value in parameters.items():
        text = json.dumps(list(value) if isinstance(value, tuple) else value)
        given += ['-p', f'{name}:={text}']
    return ['--ros-args', *given] if given else []


@pytest.fixture(scope='session')
def node_server() -> Iterator[NodeServer]:
    """Yield the process from which nodes are forked."""
    server = NodeServer(ROOT)
    yield server
    server.close()


@pytest.fixture
def graph(ros_domain: int, tmp_path: Path, node_server: NodeServer) -> Iterator[Graph]:
    """Yield a ROS graph that is torn down after the test."""
    graph = Graph(tmp_path, node_server)
    yield graph
    graph.close()


@pytest.fixture
def still_imu() -> Callable[..., ImuBatch]:
    """Return a function that makes samples of a level IMU at rest: white noise, even stamps."""

    def make(
        n: int, rate: float = 200.0, start_ns: int = 10**18, seed: int = 1, frame_id: str = 'imu'
    ) -> ImuBatch:
        rng = np.random.default_rng(seed)
        samples = rng.normal(0.0, [1e-3] * 3 + [1e-2] * 3, (n, 6)) + [0, 0, 0, 0, 0, 9.8]
        stamps = start_ns + np.round(np.arange(n) * (1e9 / rate)).astype(np.int64)
        return ImuBatch(stamps, samples, frame_id=frame_id)

    return make
