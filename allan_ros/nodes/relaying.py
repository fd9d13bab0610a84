# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The part of a node that hands one Imu topic on, with covariances filled, as raw bytes.

A thread of its own waits for messages and hands each on at once: half the CPU of an executor's
callback, and nothing else that the node does holds a message up. It uses the wait set as rclpy's
own `wait_for_message` does. Where a client library lacks that, a plain callback does the same.
"""

from __future__ import annotations

import sys
import threading
from dataclasses import dataclass
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from ..core.errors import AllanError
from ..core.filters.noise_parameters import Variances, measured_variances, white_variances
from ..core.findings import Finding, finding
from ..core.imu import SENSORS
from ..io.documents import results_from_document
from ..io.readers.cdr import CovariancePatch, MalformedMessage, frame_id_of
from ..io.results import Results
from ..io.text import parse_json
from .diagnostics import key_values, message_of, status_name, worst_level
from .imu_input import DrainedGroup
from .parameters import ParameterGroup
from .qos import LATCHED, NO_CALLBACKS
from .settings import RelaySettings

WAIT_NS = 100_000_000
"""How long the thread sleeps without a message before it looks whether it should end."""

SWITCH_INTERVAL_S = 0.0005
"""How long other Python threads, such as a fit, may keep the relay waiting (5 ms by default)."""

SHOWN_UNIT = {'gyro': '(rad/s)^2', 'accel': '(m/s^2)^2'}


class RelayTopics(NamedTuple):
    """Where messages and noise model come from, where messages go, and a name for diagnostics."""

    source: str
    model: str
    sink: str
    label: str = ''


@dataclass
class RelayCounts:
    """What became of the messages."""

    received: int = 0
    patched: int = 0
    untouched: int = 0
    held: int = 0
    malformed: int = 0
    other_frame: int = 0
    unpublished: int = 0


def relay_variances(results: Results, settings: RelaySettings) -> dict[str, Variances]:
    """Return the variances that the messages get, of each sensor that the model knows."""
    if settings.variance == 'sample':
        stds = {name: axis.sample_std for name, axis in results.axes.items()}
        return measured_variances(stds, settings.inflate)
    fits = {name: axis.fit for name, axis in results.axes.items()}
    return white_variances(fits, settings.rate or results.rate_hz, settings.inflate)


class ImuRelay:
    """Hands on the messages of one Imu.

    Parameters
    ----------
    node : Node
    topics : RelayTopics
    settings : ParameterGroup of RelaySettings

    Raises
    ------
    AllanError
        When it would read what it publishes.
    """

    def __init__(
        self, node: Node, topics: RelayTopics, settings: ParameterGroup[RelaySettings]
    ) -> None:
        self._node, self._label, self._settings = node, topics.label, settings
        self.counts = RelayCounts()
        self._results: Results | None = None
        self._trouble: tuple[Finding, ...] = ()
        self._variances: dict[str, Variances] = {}
        self._patch = CovariancePatch({})
        self._made_of: tuple[Results, RelaySettings] | None = None
        self._last_malformed = self._last_frame = ''
        overriding = QoSOverridingOptions.with_default_policies()
        depth = settings.value.queue_depth
        self._publisher = node.create_publisher(
            Imu, topics.sink, QoSProfile(depth=depth), qos_overriding_options=overriding
        )
        self._model = node.create_subscription(String, topics.model, self._on_model, LATCHED)
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        plain = settings.value.plain_callback
        self._subscription = self._subscribe(topics.source, plain)
        if self._subscription.topic_name == self._publisher.topic_name:
            raise AllanError(
                f'{self._publisher.topic_name} would be relayed to itself: remap imu/data or '
                'imu/data_with_covariance'
            )
        if not plain and not self._start():
            node.destroy_subscription(self._subscription)
            self._subscription = self._subscribe(topics.source, True)

    def tick(self) -> None:
        """Take changed parameters over."""
        results, settings = self._results, self._settings.value
        if results is None:
            return
        if self._made_of and self._made_of[0] is results and self._made_of[1] is settings:
            return
        self._variances = relay_variances(results, settings)
        frame_id = results.identity.frame_id
        self._patch = CovariancePatch(self._variances, settings.overwrite, frame_id)
        self._made_of = (results, settings)

    def status(self) -> DiagnosticStatus:
        """Return what the relay does."""
        c, findings = self.counts, self._findings()
        pairs: list[tuple[str, object]] = [
            ('from', self._subscription.topic_name),
            ('to', self._publisher.topic_name),
            ('received [messages]', c.received),
            ('filled [messages]', c.patched),
            ('passed on as they are [messages]', c.untouched),
            ('held back [messages]', c.held),
            ('malformed [messages]', c.malformed),
            ('not published [messages]', c.unpublished),
            ('variance', self._settings.value.variance),
            ('messages taken by', 'a thread' if self._thread else 'a plain callback'),
        ]
        for sensor, variances in self._variances.items():
            for axis, variance in zip('xyz', variances):
                pairs.append((f'variance of {sensor} {axis} [{SHOWN_UNIT[sensor]}]', variance))
        pairs += [(f'finding: {f.id}', f) for f in findings]
        filled = ' and '.join(self._variances)
        return DiagnosticStatus(
            level=worst_level(findings),
            name=status_name(self._node, self._label, 'relay'),
            message=message_of(findings, f'covariances of {filled} are filled'),
            hardware_id=self._results.identity.frame_id if self._results else '',
            values=key_values(pairs),
        )

    def close(self) -> None:
        """End the thread."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    # --- the messages -----------------------------------------------------------------------------

    def _hand_on(self, payload: bytes) -> None:
        """Publish one message, with what is known filled in."""
        counts = self.counts
        counts.received += 1
        if not self._made_of and self._settings.value.until_model == 'hold':
            counts.held += 1
            return
        try:
            handed_on = self._patch.patch(payload)
        except MalformedMessage as error:
            counts.malformed += 1
            self._last_malformed = str(error)
            handed_on = payload
        if handed_on is not payload:
            counts.patched += 1
        else:
            counts.untouched += 1
            self._note_frame(payload)
        try:
            self._publisher.publish(handed_on)
        except rclpy_implementation.RCLError:  # a reliable subscriber's queue stayed full
            counts.unpublished += 1

    def _note_frame(self, payload: bytes) -> None:
        """Count a message that is of another frame than the model."""
        results = self._results
        try:
            frame_id = frame_id_of(payload)
        except MalformedMessage:
            return
        if results is not None and results.identity.frame_id not in ('', frame_id):
            self.counts.other_frame += 1
            self._last_frame = frame_id

    def _subscribe(self, topic: str, plain: bool) -> Subscription:
        # Best effort connects to every publisher; reliable publishers still deliver in order.
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=self._settings.value.queue_depth,
            reliability=ReliabilityPolicy.BEST_EFFORT,
        )
        return self._node.create_subscription(
            Imu,
            topic,
            self._hand_on,
            qos,
            callback_group=MutuallyExclusiveCallbackGroup() if plain else DrainedGroup(),
            event_callbacks=NO_CALLBACKS,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            raw=True,
        )

    def _start(self) -> bool:
        """Start the thread; return False where this client library does not let us wait."""
        try:
            wait_set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, self._node.context.handle)
            wait_set.clear_entities()
            wait_set.add_subscription(self._subscription.handle)
            taken = self._subscription.handle.take_message(Imu, True)
        except (AttributeError, TypeError):
            return False
        if taken is not None:
            self._hand_on(taken[0])
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        self._thread = threading.Thread(target=self._work, args=(wait_set,), daemon=True)
        self._thread.start()
        return True

    def _work(self, wait_set: rclpy_implementation.WaitSet) -> None:
        """Hand messages on as they come, until the node is closed."""
        handle = self._subscription.handle
        with handle, wait_set:
            while not self._stop.is_set():
                wait_set.clear_entities()
                wait_set.add_subscription(handle)
                wait_set.wait(WAIT_NS)
                while (taken := handle.take_message(Imu, True)) is not None:
                    self._hand_on(taken[0])

    # --- the noise model --------------------------------------------------------------------------

    def _on_model(self, message: String) -> None:
        try:
            results = results_from_document(parse_json(message.data, 'noise model'), 'noise model')
        except AllanError as error:
            topic = self._model.topic_name
            self._trouble = (finding('relay_model_unreadable', topic=topic, reason=error),)
            self._node.get_logger().warning(str(self._trouble[0]), throttle_duration_sec=60.0)
            return
        self._results, self._trouble = results, ()
        self.tick()

    def _findings(self) -> list[Finding]:
        c, results = self.counts, self._results
        found = list(self._trouble)
        if results is None:
            passed = self._settings.value.until_model == 'pass'
            done = 'passed on as they are' if passed else 'held back'
            found.append(finding('relay_without_model', topic=self._model.topic_name, done=done))
        else:
            for sensor in SENSORS:
                known = any(name.startswith(sensor) for name in results.axes)
                if known and sensor not in self._variances:
                    found.append(finding('relay_nothing_to_fill', sensor=sensor))
            if c.other_frame:
                expected = results.identity.frame_id
                found.append(
                    finding(
                        'relay_other_frame',
                        count=c.other_frame,
                        found=self._last_frame,
                        expected=expected,
                    )
                )
        if c.malformed:
            topic = self._subscription.topic_name
            found.append(
                finding(
                    'relay_malformed', count=c.malformed, reason=self._last_malformed, topic=topic
                )
            )
        if c.unpublished:
            found.append(finding('relay_unpublished', count=c.unpublished))
        return found
