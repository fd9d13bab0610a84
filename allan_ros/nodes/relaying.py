# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Republishes one Imu topic with covariances filled in, as raw bytes.

A separate thread waits for messages and republishes each at once. It needs half the CPU time of an
executor's callback, and no other task of the node delays a message. It uses a wait set, as
`wait_for_message` of rclpy does. If this version of rclpy has no wait set, a callback is used.
"""

from __future__ import annotations

import operator
import sys
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistWithCovarianceStamped
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from ..core.errors import AllanError, one_line
from ..core.filters.noise_parameters import Variances, white_ratio, white_variances
from ..core.findings import Finding, finding
from ..core.imu import SENSORS, ImuIdentity, sensor_of
from ..core.stream.transport import faults_of
from ..readers.cdr import CovariancePatch, MalformedMessage, frame_id_of
from ..readers.files import parse_json
from ..results.documents import results_from_document
from ..results.results import Results
from .diagnostics import status_name, status_of
from .imu_input import QUEUE_DEPTH, full_name, qos_text, subscribe_raw
from .node import AllanNode, Part
from .settings import SETTLED_RATIO, RelaySettings, WatchedImu
from .shell import LATCHED

WAIT_NS = 100_000_000
"""Time in ns after which the waiting thread checks whether it should end."""

POLL_S = 0.005
"""Period in s at which messages are fetched if waiting for them fails."""

SWITCH_INTERVAL_S = 0.0005
"""Longest time in s for which other Python threads, such as a fit, delay the relay (Python's
default is 5 ms)."""

MODEL_GRACE_S = 120.0
"""Time in s after the start from which a missing noise model is a warning."""

DISCOVERY_S = 5.0
"""Time in s after the start from which a missing publisher of the noise model is a warning."""

VARIANCE_UNITS = {'gyro': '(rad/s)^2', 'accel': '(m/s^2)^2'}

RECEIVED, FILLED, PASSED, MALFORMED, UNPUBLISHED = COUNTS = (
    'received',
    'filled',
    'passed on as they are',
    'malformed',
    'not published',
)
"""Names of the message counts in diagnostics."""


def relay_variances(results: Results, settings: RelaySettings) -> dict[str, Variances]:
    """Return the variances of the axes of each sensor without a fault, in (rad/s)^2 or (m/s^2)^2.

    They do not cover the bias.
    """
    fits = {name: axis.fit for name, axis in results.axes.items()}
    found = white_variances(fits, results.rate_hz, settings.inflate, settings.horizon)
    faults = faults_of(results.findings)
    bad = {sensor_of(axis) for fault in faults for axis in fault.axes}
    return {sensor: variances for sensor, variances in found.items() if sensor not in bad}


def cover_bias(
    variances: dict[str, Variances], bias: TwistWithCovarianceStamped | None, messages: float
) -> dict[str, Variances]:
    """Return the variances of a gyro whose bias is not removed.

    The integral over this number of ``messages`` then has the variance of noise and bias together.
    The bias of an accelerometer at rest is unknown, because it cannot be told from gravity.
    """
    if bias is None or 'gyro' not in variances or bias.twist.covariance[21] < 0.0:
        return variances
    rates, spread = bias.twist.twist.angular, bias.twist.covariance
    known = zip((rates.x, rates.y, rates.z), (spread[21], spread[28], spread[35]))
    added = [max(1.0, messages) * (rate**2 + variance) for rate, variance in known]
    x, y, z = (noise + more for noise, more in zip(variances['gyro'], added))
    return {**variances, 'gyro': (x, y, z)}


class ImuRelay(Part):
    """Republishes the messages of one IMU on ``<topic>_with_covariance``, with covariances.

    ``home`` is the prefix of the topics ``noise_model`` and ``bias``, which it subscribes to.
    Raises AllanError if both topics have the same name after remapping.
    """

    def __init__(self, node: AllanNode, imu: WatchedImu, home: str = '') -> None:
        self._node, self._imu = node, imu
        self._settings = node.parameters.group('relay', RelaySettings)
        self._began = time.monotonic()
        self._invalidated = False
        self._counts = dict.fromkeys(COUNTS, 0)
        self._other_frame = 0
        self._results: Results | None = None
        self._problem: tuple[Finding, ...] = ()
        self._variances: dict[str, Variances] = {}
        self._patch = CovariancePatch({})
        self._made_of: tuple[object, ...] = None, None, None
        self._ratio = 1.0  # of the interval of the variances with a horizon
        self._last_malformed = self._last_frame = ''
        overriding = QoSOverridingOptions.with_default_policies()
        self._publisher = node.create_publisher(
            Imu,
            f'{imu.topic}_with_covariance',
            QoSProfile(depth=QUEUE_DEPTH),
            qos_overriding_options=overriding,
        )
        self._model = node.create_subscription(
            String, f'{home}noise_model', self._on_model, LATCHED
        )
        self._bias: TwistWithCovarianceStamped | None = None
        node.create_subscription(TwistWithCovarianceStamped, f'{home}bias', self._on_bias, LATCHED)
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        wait_set = self._wait_set()
        self._subscription, drained = subscribe_raw(
            node, imu.topic, self._relay, QUEUE_DEPTH, plain=wait_set is None
        )
        if self._subscription.topic_name == self._publisher.topic_name:
            raise AllanError(
                f'{self._publisher.topic_name} would be relayed to itself: remap imu/data or '
                'imu/data_with_covariance'
            )
        if drained:
            sys.setswitchinterval(SWITCH_INTERVAL_S)
            self._thread = threading.Thread(target=self._work, args=(wait_set,), daemon=True)
            self._thread.start()

    @property
    def description(self) -> str:
        """Description of the relay, for the log at start."""
        source = self._subscription
        return (
            f'relays {source.topic_name} ({qos_text(source.qos_profile)}) to '
            f'{self._publisher.topic_name} with the noise model on {self._model.topic_name}'
        )

    def tick(self, now: float) -> None:
        """Make a new patch if the noise model, the bias or the parameters have changed."""
        results, settings, bias = self._results, self._settings.value, self._bias
        made_of = results, settings, bias
        if all(map(operator.is_, made_of, self._made_of)):
            return
        self._made_of, self._ratio, noise, frame_id = made_of, 1.0, {}, ''
        if results is not None:
            frame_id = results.identity.frame_id
            if settings.horizon:
                fits = {name: axis.fit for name, axis in results.axes.items()}
                self._ratio = white_ratio(fits, settings.horizon)
            if self._ratio <= SETTLED_RATIO:
                noise = relay_variances(results, settings)
            if not settings.debiased:
                noise = cover_bias(noise, bias, settings.horizon * results.rate_hz)
        self._variances = noise
        self._patch = CovariancePatch(noise, settings.overwrite, frame_id)

    def statuses(self, now: float) -> list[DiagnosticStatus]:
        """Return the status of the relay."""
        findings = self._findings(now)
        pairs: list[tuple[str, object]] = [
            ('from', self._subscription.topic_name),
            ('to', self._publisher.topic_name),
            *((f'{what} [messages]', count) for what, count in self._counts.items()),
            ('messages taken by', 'a thread' if self._thread else 'a callback'),
            *(
                (f'variance of {sensor} {axis} [{VARIANCE_UNITS[sensor]}]', variance)
                for sensor, variances in self._variances.items()
                for axis, variance in zip('xyz', variances)
            ),
        ]
        filled = f'covariances of {" and ".join(self._variances)} are filled'
        identity = self._results.identity if self._results else ImuIdentity()
        hardware_id = self._imu.hardware_id or identity.hardware_id or identity.frame_id
        name = status_name(self._node, self._imu.label, 'relay')
        text = filled if self._variances else str(findings[0]) if findings else 'nothing to fill'
        return [status_of(name, findings, text, pairs, hardware_id=one_line(hardware_id))]

    def close(self) -> None:
        """Stop the thread."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    # --- the messages -----------------------------------------------------------------------------

    def _relay(self, payload: bytes, _info: Any = None) -> None:
        """Publish one message with the known covariances filled in."""
        counts = self._counts
        counts[RECEIVED] += 1
        try:
            patched = self._patch.patch(payload)
        except MalformedMessage as error:
            counts[MALFORMED] += 1
            self._last_malformed = str(error)
            patched = payload
        if patched is not payload:
            counts[FILLED] += 1
        else:
            counts[PASSED] += 1
            self._note_frame(payload)
        try:
            self._publisher.publish(patched)
        except rclpy_implementation.RCLError:  # the queue of a reliable subscriber stayed full
            counts[UNPUBLISHED] += 1

    def _on_bias(self, message: TwistWithCovarianceStamped) -> None:
        self._bias = message
        self.tick(time.monotonic())

    def _note_frame(self, payload: bytes) -> None:
        """Count a message whose frame_id differs from the frame_id of the noise model."""
        results = self._results
        try:
            frame_id = frame_id_of(payload)
        except MalformedMessage:
            return
        if results is not None and results.identity.frame_id not in ('', frame_id):
            self._other_frame += 1
            self._last_frame = frame_id

    def _wait_set(self) -> Any:
        """Return a wait set for one subscription; None if this version of rclpy has none."""
        try:
            return rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, self._node.context.handle)
        except (AttributeError, TypeError):
            return None

    def _work(self, wait_set: Any) -> None:
        """Republish messages until the node is closed. An error does not end the thread."""
        handle = self._subscription.handle
        with handle, wait_set:
            while not self._stop.is_set():
                try:
                    wait_set.clear_entities()
                    wait_set.add_subscription(handle)
                    wait_set.wait(WAIT_NS)
                except Exception as error:
                    self._pause('relay wait', error)
                try:
                    while (taken := handle.take_message(Imu, True)) is not None:
                        self._relay(taken[0])
                except Exception as error:
                    self._pause('relay', error)

    def _pause(self, where: str, error: Exception) -> None:
        """Report an error of the thread, and wait for `POLL_S`."""
        self._node.fault(where, error)
        self._stop.wait(POLL_S)

    # --- the noise model --------------------------------------------------------------------------

    def _on_model(self, message: String) -> None:
        try:
            results = results_from_document(parse_json(message.data, 'noise model'), 'noise model')
        except AllanError as error:
            topic = self._model.topic_name
            self._problem = (finding('relay_model_unreadable', topic=topic, reason=error),)
            self._node.get_logger().warning(str(self._problem[0]), throttle_duration_sec=60.0)
            return
        self._invalidated = not results.axes
        self._results, self._problem = (results if results.axes else None), ()
        self.tick(time.monotonic())

    def _missing_model(self, now: float) -> Finding:
        """Return a finding with the reason why there is no noise model."""
        topic, seconds = self._model.topic_name, now - self._began
        if self._invalidated:
            return finding('relay_invalidated', topic=topic)
        if seconds > DISCOVERY_S and not self._node.count_publishers(topic):
            return finding('relay_without_model', topic=topic)
        if seconds > MODEL_GRACE_S:
            return finding('relay_late_model', topic=topic, seconds=seconds)
        return finding('relay_waits', topic=topic)

    def _findings(self, now: float) -> list[Finding]:
        """Return the present problems; the cause comes before its effects."""
        counts, results, found = self._counts, self._results, list(self._problem)

        def add(id: str, count: int, **values: Any) -> None:
            if count:
                found.append(finding(id, count=count, **values))

        sink = self._publisher.topic_name
        publishers = self._node.get_publishers_info_by_topic(sink)
        names = ', '.join(sorted(map(full_name, publishers)))
        several = len(publishers) if len(publishers) > 1 else 0
        add('relay_several_publishers', several, topic=sink, names=names)
        if results is None:
            found.append(self._missing_model(now))
        else:
            faults = faults_of(results.findings)
            found += faults
            known = {sensor_of(axis) for axis in results.axes}
            if self._ratio > SETTLED_RATIO:
                horizon = self._settings.value.horizon
                known_to = {'ratio': self._ratio, 'limit': SETTLED_RATIO}
                found.append(finding('relay_unsettled', (), horizon=horizon, **known_to))
            elif not faults:
                for sensor in SENSORS:
                    if sensor in known - self._variances.keys():
                        found.append(finding('relay_nothing_to_fill', sensor=sensor))
            expected = results.identity.frame_id
            add('relay_other_frame', self._other_frame, found=self._last_frame, expected=expected)
        source, reason = self._subscription.topic_name, self._last_malformed
        add('relay_malformed', counts[MALFORMED], reason=reason, topic=source)
        add('relay_unpublished', counts[UNPUBLISHED])
        return found
