# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged messages, documents and parameters, which running nodes receive over DDS.

One monitor with a relay, and one estimator, run all the time. After each input, both must still
publish `/diagnostics` and answer their services.
"""

from __future__ import annotations

import atexit
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from allan_ros.core.errors import AllanError
from allan_ros.io.documents import results_from_document, sums_file_from_document
from allan_ros.io.files import parse_json
from allan_ros.io.readers.cdr import MalformedMessage, decode_imus

from .damage import ODD_TEXTS, any_bytes, as_utf8, damaged_json, floats
from .documents_target import seeds
from .harness import BrokenRule, Target, check_line, refused_or_valid
from .imu_target import any_message

PATIENCE_S = 60.0
"""Time without diagnostics, on a loaded machine, after which a node counts as dead."""

NODE_BYTES = 6 << 30
"""Address space of a node: DDS maps much of it and uses little."""

GROWTH_BYTES = 300 << 20
"""Largest growth of the memory of a node."""

NODES = ('allan_monitor', 'allan_estimator')
TEXT_TOPICS = ('/sums', '/allan_monitor/noise_model')
PARAMETERS: tuple[str, ...] = (
    'estimator.growth',
    'estimator.margin',
    'estimator.method',
    'publish.sums_period',
)
PARAMETERS += ('input.stale_after', 'segmenter.max_bridge', 'segmenter.motion_ratio', 'relay.rate')
PARAMETERS += ('checkpoint.path', 'checkpoint.period', 'input.topics', 'no.such', 'relay.inflate')

NO_NUMBER = re.compile(r'(?<![\w-])-?(nan|inf)(?!\w)')
"""Text that must not be in diagnostics: numbers that are not finite."""

_values = (
    st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | floats
    | st.sampled_from([t for t in ODD_TEXTS if t.isprintable()])
    | st.lists(st.integers(-5, 5), max_size=3)
    | st.lists(floats, max_size=3)
)


class Graph:
    """The nodes that are tested, and a client."""

    def __init__(self) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from sensor_msgs.msg import Imu
        from std_msgs.msg import String

        self.folder = tempfile.TemporaryDirectory(prefix='allan_fuzz_nodes.')
        self.processes = {
            'allan_monitor': self._start(
                'monitor', 'relay.enabled:=true', 'publish.sums_period:=1.0'
            ),
            'allan_estimator': self._start('estimator'),
        }
        rclpy.init()
        self.node = rclpy.create_node('fuzz')
        self.heard: dict[str, float] = {}
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 100)
        self.imu = self.node.create_publisher(Imu, 'imu/data', 1000)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.texts = {t: self.node.create_publisher(String, t, latched) for t in TEXT_TOPICS}
        self.clients = {name: self._client(name) for name in NODES}
        self.check_alive()
        self.memory = {name: self._resident(name) for name in NODES}
        atexit.register(self.close)

    def _start(self, module: str, *parameters: str) -> subprocess.Popen[bytes]:
        given = [a for p in parameters for a in ('-p', p)]
        return subprocess.Popen(
            [sys.executable, '-m', 'allan_ros.nodes', module, '--ros-args', *given],
            cwd=self.folder.name,
            env={
                **os.environ,
                'ROS_LOG_DIR': self.folder.name,
                'PYTHONPATH': str(Path(__file__).resolve().parents[1]),
            },
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (NODE_BYTES, NODE_BYTES)),
        )

    def _client(self, name: str) -> Any:
        from rcl_interfaces.srv import SetParameters

        return self.node.create_client(SetParameters, f'/{name}/set_parameters')

    def set_parameter(self, name: str, parameter: str, value: Any) -> bool:
        """Ask a node to change a parameter and return its answer; raise if there is none."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        try:
            message = Parameter(parameter, value=value).to_parameter_msg()
        except (TypeError, ValueError, AssertionError):
            return False  # the type of an empty list is unknown
        future = self.clients[name].call_async(SetParameters.Request(parameters=[message]))
        self._until(future.done, f'{name} does not answer about {parameter}')
        (answer,) = future.result().results
        if not answer.successful:
            check_line(answer.reason)
        return bool(answer.successful)

    def check_alive(self) -> None:
        """Raise unless both nodes publish diagnostics, use little memory and wrote no file."""
        began = time.monotonic()
        for name in NODES:
            self._until(partial(self._heard_since, name, began), f'{name} is silent')
            grown = self._resident(name) - getattr(self, 'memory', {}).get(name, 1 << 40)
            if grown > GROWTH_BYTES:
                raise BrokenRule(f'{name} has grown by {grown >> 20} MB')
        for path in Path(self.folder.name).rglob('*'):
            if path.suffix != '.log':
                raise BrokenRule(f'a node wrote {path.name}')

    def _heard_since(self, name: str, began: float) -> bool:
        return self.heard.get(name, 0.0) > began

    def _until(self, holds: Callable[[], Any], otherwise: str) -> None:
        import rclpy

        ends = time.monotonic() + PATIENCE_S
        while not holds():
            for name, process in self.processes.items():
                if process.poll() is not None:
                    raise BrokenRule(f'{name} ended with {process.returncode}')
            if time.monotonic() > ends:
                raise BrokenRule(otherwise)
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            self.heard[status.name.partition(':')[0]] = time.monotonic()
            for text in (status.message, *(f'{v.key}: {v.value}' for v in status.values)):
                if NO_NUMBER.search(text):
                    raise BrokenRule(f'{status.name}: {text}')

    def _resident(self, name: str) -> int:
        pages = Path(f'/proc/{self.processes[name].pid}/statm').read_text().split()[1]
        return int(pages) * resource.getpagesize()

    def close(self) -> None:
        """End the nodes."""
        for process in self.processes.values():
            process.kill()
            process.wait()
        self.folder.cleanup()


@lru_cache(maxsize=1)
def graph() -> Graph:
    """Return the nodes, which are started at the first call."""
    return Graph()


@st.composite
def _attacks(draw: Any) -> tuple[str, Any]:
    """Draw an input: messages, a text on a topic, or the value of a parameter."""
    sums, results = seeds()
    match draw(st.sampled_from(['imu', 'imu', 'text', 'text', 'parameter'])):
        case 'imu':
            messages = draw(st.lists(any_message, min_size=1, max_size=6))
            return 'imu', (messages, draw(st.sampled_from([1, 1, 50, 500])))
        case 'text':
            topic = draw(st.sampled_from(TEXT_TOPICS))
            seed = sums if topic == '/sums' else results
            text = draw(damaged_json([seed]) | any_bytes([as_utf8(json.dumps(seed))]).map(
                lambda data: data.decode(errors='replace')))  # fmt: skip
            return 'text', (topic, text)
    values = (st.sampled_from(NODES), st.sampled_from(PARAMETERS), _values)
    return 'parameter', draw(st.tuples(*values))


def check(attack: tuple[str, Any], folder: Path) -> bool:
    """Send the attack and check the nodes; return whether it was accepted as valid."""
    from std_msgs.msg import String

    del folder
    here = graph()
    kind, what = attack
    with refused_or_valid() as outcome:
        _read(kind, what)
    if kind == 'imu':
        messages, times = what
        for message in messages * times:
            here.imu.publish(message)
    elif kind == 'text':
        topic, text = what
        try:
            message = String(data=text)
            here.texts[topic].publish(message)
        except UnicodeEncodeError:
            return False  # a lone surrogate cannot be sent
    else:
        outcome.valid = here.set_parameter(*what)
    here.check_alive()
    return outcome.valid


def _read(kind: str, what: Any) -> None:
    """Read messages and texts as the nodes do; raise `AllanError` if they are invalid."""
    if kind == 'imu':
        try:
            decode_imus(what[0], 'cdr')
        except MalformedMessage as error:
            raise AllanError(str(error)) from None
    elif kind == 'text':
        read = sums_file_from_document if what[0] == '/sums' else results_from_document
        read(parse_json(what[1], what[0]), what[0])


TARGET = Target('nodes', _attacks(), check, forks=True)
