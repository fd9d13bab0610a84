# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Republishes the messages of an Imu topic, as raw bytes, with covariances filled in.

A separate thread waits for messages and republishes each message at once. The thread needs half the
CPU time of a callback, and other tasks of the node hardly delay it. If this version of rclpy has no
wait set, a callback republishes the messages.
"""

from __future__ import annotations

import math
import operator
import sys
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistWithCovarianceStamped
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from ..core.errors import AllanError, one_line
from ..core.estimate import Estimate
from ..core.filters.white_variances import (
    Variances,
    cover_bias,
    scaled_variances,
    white_ratio,
    white_variances,
)
from ..core.findings import Finding, finding
from ..core.imu import AXES, SENSORS, ImuIdentity, sensor_of
from ..core.stream.present_faults import noise_ratios
from ..core.stream.transport import faults_of
from ..readers.cdr import CovariancePatch, MalformedMessage, frame_id_of
from ..readers.files import parse_json
from ..results.datasheets import load_sensor
from ..results.documents import results_from_document
from ..results.from_datasheet import results_of_datasheet
from ..results.results import Results
from ..view.finding_text import finding_line
from .diagnostics import status_name, status_of
from .first_messages import FirstMessages
from .imu_input import QUEUE_DEPTH, full_name, qos_text, subscribe_raw
from .messages import ModelListener, bias_of
from .node import AllanNode, NodePart
from .node_settings import SETTLED_RATIO, EstimatorSettings, RelaySettings, WatchedImu
from .shell import LATCHED

WAIT_NS = 100_000_000
"""Longest time in ns that the thread waits before it checks whether it should end."""

POLL_S = 0.005
"""Period in s at which messages are fetched if waiting for them fails."""

SWITCH_INTERVAL_S = 0.0005
"""Time in s after which another Python thread, such as a fit, has to let the relay run (Python's
default is 5 ms). A library function that does not let other threads run may delay the relay
longer."""

MODEL_GRACE_S = 120.0
"""Time in s after the start from which a missing noise model is a warning, unless covariances come
from a datasheet. Before this time, it is a warning only if the relay passes on covariances of
zero."""

DISCOVERY_S = 5.0
"""Time in s after the start from which a missing publisher of the noise model is a warning."""

PROBES = {sensor: CovariancePatch({sensor: (1.0, 1.0, 1.0)}) for sensor in SENSORS}
"""Sensor -> patch that changes a message only if the covariance of this sensor is zero."""

VARIANCE_UNITS = {'gyro': '(rad/s)^2', 'accel': '(m/s^2)^2'}

RECEIVED, FILLED, PASSED, MALFORMED, UNPUBLISHED = COUNTS = (
    'received',
    'filled',
    'passed on as they are',
    'malformed',
    'not published',
)
"""Names of the message counts in diagnostics."""


def relay_variances(results: Results, settings: RelaySettings, rate: float) -> dict[str, Variances]:
    """Return sensor -> variances of one sample of x, y and z, in (rad/s)^2 or (m/s^2)^2.

    ``rate`` is the sample rate in Hz. The variances contain the factor ``relay.inflate``, and cover
    the drift over ``relay.horizon``, but not the bias. A sensor is absent if the variance of one of
    its axes is unknown.
    """
    fits = {name: axis.fit for name, axis in results.axes.items()}
    return white_variances(fits, rate, settings.inflate, settings.horizon)


def in_motion(variances: dict[str, Variances], results: Results) -> dict[str, Variances]:
    """Return the variances, multiplied by the squared factor in motion of each sensor.

    The factor in motion is the error in motion divided by its prediction from the noise at rest. A
    factor below 1 is taken as 1. If no factors are known, or no finding in ``results`` states that
    the IMU moves at present, the variances are returned unchanged.
    """
    motion = results.motion
    if motion is None or not any(f.id == 'moving_now' for f in results.findings):
        return variances
    factors = {
        sensor: max(errors.factor.value or 1.0, 1.0) for sensor, errors in motion.sensors.items()
    }
    return scaled_variances(variances, {axis: factors[sensor_of(axis)] for axis in AXES})


def bias_in_model(results: Results) -> dict[str, Estimate]:
    """Return axis -> mean of the samples at rest in SI, for each axis whose mean is known.

    For an accelerometer, the mean contains gravity. The standard deviation is the scatter of the
    bias between recordings, or 0 if this is unknown. Unless the samples are debiased, the relay
    uses the values of the gyro until the present bias is known.
    """
    return {
        name: Estimate.normal(
            axis.at_rest.mean, (axis.turn_on and axis.turn_on.scatter.value) or 0.0
        )
        for name, axis in results.axes.items()
        if axis.at_rest is not None
    }


class ModelInput:
    """Receives the topics ``noise_model`` and ``bias`` of an estimator in another process.

    After each readable message, ``listener`` is called with the latest noise model and the latest
    bias, unless no noise model has been received yet.
    """

    def __init__(self, node: AllanNode) -> None:
        self._node = node
        self.listener: ModelListener = lambda results, bias: None
        self._began = time.monotonic()
        self._results: Results | None = None
        self._bias: dict[str, Estimate] = {}
        self._unreadable: Finding | None = None
        self._model = node.create_subscription(String, 'noise_model', self._on_model, LATCHED)
        node.create_subscription(TwistWithCovarianceStamped, 'bias', self._on_bias, LATCHED)

    @property
    def topic(self) -> str:
        """Full name of the topic of the noise model."""
        return str(self._model.topic_name)

    def findings(self, now: float) -> list[Finding]:
        """Return findings if the noise model cannot be read, or if no node publishes one.

        A missing publisher is reported `DISCOVERY_S` after the start, unless a model was received.
        """
        found = [self._unreadable] if self._unreadable else []
        has_waited = now - self._began > DISCOVERY_S
        if self._results is None and has_waited and not self._node.count_publishers(self.topic):
            found.append(finding('relay_without_model', topic=self.topic))
        return found

    def _on_model(self, message: String) -> None:
        try:
            results = results_from_document(parse_json(message.data, 'noise model'), 'noise model')
        except AllanError as error:
            self._unreadable = finding('relay_model_unreadable', topic=self.topic, reason=error)
            text = finding_line(self._unreadable)
            self._node.get_logger().warning(text, throttle_duration_sec=60.0)
            return
        self._results, self._unreadable = results, None
        self.listener(results, self._bias)

    def _on_bias(self, message: TwistWithCovarianceStamped) -> None:
        self._bias = bias_of(message)
        if self._results is not None:
            self.listener(self._results, self._bias)


class ImuRelay(NodePart):
    """Republishes the messages of one IMU on ``<topic>_with_covariance``, with covariances.

    The covariances are computed from the noise model that `offer` receives. If this model does not
    determine the covariance of a sensor, the covariance is computed from the datasheet
    ``estimator.sensor``, if this parameter is set. The covariance of a sensor with a fault is not
    filled in. With a datasheet, the mean angular rate is regarded as the bias of the gyro until the
    bias is known, unless the samples are debiased.

    ``model_topic`` is the topic of the noise model, and ``input_findings`` returns the findings
    about the messages on this topic. Raises AllanError if the input topic and the output topic have
    the same name after remapping, or if the datasheet is unknown, invalid or cannot be read.
    """

    def __init__(
        self,
        node: AllanNode,
        imu: WatchedImu,
        model_topic: str,
        input_findings: Callable[[float], list[Finding]] = lambda now: [],
    ) -> None:
        self._node, self._imu = node, imu
        self._model_topic, self._input_findings = model_topic, input_findings
        self._settings = node.parameters.group('relay', RelaySettings)
        sensor = node.parameters.group('estimator', EstimatorSettings, ('sensor',)).value.sensor
        self._datasheet = results_of_datasheet(load_sensor(sensor)) if sensor else None
        self._began = time.monotonic()
        self._invalidated = False
        self._counts = dict.fromkeys(COUNTS, 0)
        self._other_frame = 0
        self._results: Results | None = None
        self._bias: Mapping[str, Estimate] = {}
        self._variances: dict[str, Variances] = {}  # variances that are filled into messages
        self._from_datasheet: tuple[str, ...] = ()  # sensors with variances from the datasheet
        self._first = FirstMessages()
        self._latest: bytes | None = None  # the latest message
        self._patch = CovariancePatch({})
        self._made_of: tuple[object, ...] = ()  # inputs from which the patch was made
        self._last_malformed = self._last_frame = ''
        # variances of the noise model without the bias, and the values from which they are computed
        self._measured: dict[str, Variances] = {}
        self._measured_of: tuple[object, ...] = None, None
        # largest ratio of the upper to the lower end of the 95 % interval of an N that covers the
        # drift over the horizon; 1 without a horizon
        self._ratio = 1.0
        qos_options = QoSOverridingOptions.with_default_policies()
        self._publisher = node.create_publisher(
            Imu,
            f'{imu.topic}_with_covariance',
            QoSProfile(depth=QUEUE_DEPTH),
            qos_overriding_options=qos_options,
        )
        self.tick(self._began)  # computes the covariances for the first message
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        wait_set = self._wait_set()
        self._subscription, must_fetch = subscribe_raw(
            node, imu.topic, self._relay, QUEUE_DEPTH, plain=wait_set is None
        )
        if self._subscription.topic_name == self._publisher.topic_name:
            raise AllanError(
                f'{self._publisher.topic_name} would be relayed to itself: remap imu/data or '
                'imu/data_with_covariance'
            )
        if must_fetch:
            sys.setswitchinterval(SWITCH_INTERVAL_S)
            self._thread = threading.Thread(target=self._work, args=(wait_set,), daemon=True)
            self._thread.start()

    @property
    def description(self) -> str:
        """Text that describes the relay in the log at the start of the node."""
        source = self._subscription
        return (
            f'relays {source.topic_name} ({qos_text(source.qos_profile)}) to '
            f'{self._publisher.topic_name} with the noise model on {self._model_topic}'
        )

    def offer(self, results: Results, bias: Mapping[str, Estimate]) -> None:
        """Use the latest noise model and bias at rest.

        Results without axes mean that the model is invalidated.
        """
        self._invalidated = not results.axes
        self._results, self._bias = (results if results.axes else None), bias
        self.tick(time.monotonic())

    def tick(self, now: float) -> None:
        """Make a new patch if noise model, bias or parameters have changed.

        With a datasheet, a patch is also made if the measured rate or mean has changed.
        """
        if self._datasheet is not None:
            self._first.update(self._counts[RECEIVED], self._latest)
        first_values = self._first.rate_hz, self._first.bias
        inputs = self._results, self._settings.value, self._bias, *first_values
        if self._made_of and all(map(operator.is_, inputs, self._made_of)):
            return
        self._made_of = inputs
        results, settings, bias, rate, first_bias = inputs
        variances: dict[str, Variances] = {}
        if self._datasheet is not None:
            variances = relay_variances(self._datasheet, settings, rate)
        datasheet_sensors, frame_id = set(variances), ''
        if results is not None:
            frame_id, rate = results.identity.frame_id, results.rate_hz
            model_variances = self._measured_variances(results, settings)
            faulty_sensors = {
                sensor_of(axis) for f in faults_of(results.findings) for axis in f.axes
            }
            variances = {
                s: v for s, v in {**variances, **model_variances}.items() if s not in faulty_sensors
            }
            datasheet_sensors = variances.keys() - model_variances.keys()
            bias = {**bias_in_model(results), **bias}
            variances = scaled_variances(variances, noise_ratios(results.findings))
            if settings.motion:
                variances = in_motion(variances, results)
        if not settings.debiased:
            variances = cover_bias(variances, {**first_bias, **bias}, settings.horizon * rate)
        self._variances = variances
        self._from_datasheet = tuple(s for s in SENSORS if s in datasheet_sensors)
        self._patch = CovariancePatch(variances, settings.overwrite, frame_id)

    def _measured_variances(
        self, results: Results, settings: RelaySettings
    ) -> dict[str, Variances]:
        """Return the variances from a noise model, cached for the latest model and settings."""
        inputs = results.axes, settings
        if not all(map(operator.is_, inputs, self._measured_of)):
            self._measured_of, self._ratio = inputs, 1.0
            self._measured = relay_variances(results, settings, results.rate_hz)
            if settings.horizon:
                fits = {name: axis.fit for name, axis in results.axes.items()}
                self._ratio = white_ratio(fits, settings.horizon)
        return self._measured

    def statuses(self, now: float) -> list[DiagnosticStatus]:
        """Return the status of the relay."""
        findings = self._findings(now)
        pairs: list[tuple[str, object]] = [
            ('from', self._subscription.topic_name),
            ('to', self._publisher.topic_name),
            *((f'{kind} [messages]', count) for kind, count in self._counts.items()),
            ('messages taken by', 'a thread' if self._thread else 'a callback'),
            *(
                (f'variance of {sensor} {axis} [{VARIANCE_UNITS[sensor]}]', variance)
                for sensor, variances in self._variances.items()
                for axis, variance in zip('xyz', variances)
            ),
        ]
        filled_text = f'covariances of {" and ".join(self._variances)} are filled'
        if self._from_datasheet:
            filled_text += f' ({" and ".join(self._from_datasheet)} from the datasheet)'
        identity = self._results.identity if self._results else ImuIdentity()
        hardware_id = self._imu.hardware_id or identity.hardware_id or identity.frame_id
        name = status_name(self._node, self._imu.label, 'relay')
        otherwise = finding_line(findings[0]) if findings else 'nothing to fill'
        text = filled_text if self._variances else otherwise
        return [status_of(name, findings, text, pairs, hardware_id=one_line(hardware_id))]

    def close(self) -> None:
        """Stop the thread."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    # --- the messages -----------------------------------------------------------------------------

    def _relay(self, payload: bytes, _info: Any = None) -> None:
        """Publish one message, with the covariances that `CovariancePatch.patch` fills in."""
        counts = self._counts
        counts[RECEIVED] += 1
        self._latest = payload
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
        except rclpy_implementation.RCLError:  # the queue of a reliable subscriber remained full
            counts[UNPUBLISHED] += 1

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
        """Report an error in the thread, and wait for `POLL_S`."""
        self._node.fault(where, error)
        self._stop.wait(POLL_S)

    # --- the noise model --------------------------------------------------------------------------

    def _missing_model(self, now: float) -> Finding:
        """Return a finding about the missing noise model."""
        topic, seconds = self._model_topic, now - self._began
        if self._invalidated:
            return finding('relay_invalidated', topic=topic)
        if seconds > MODEL_GRACE_S:
            return finding('relay_late_model', topic=topic, seconds=seconds)
        return finding('relay_zeros' if self._zeros() else 'relay_waits', topic=topic)

    def _zeros(self) -> list[str]:
        """Return the sensors whose covariance is zero in the latest message after correction."""
        latest = self._latest
        if latest is None:
            return []
        try:
            published = self._patch.patch(latest)
            return [s for s, probe in PROBES.items() if probe.patch(published) is not published]
        except MalformedMessage:
            return []

    def _findings(self, now: float) -> list[Finding]:
        """Return findings about the present state and about messages counted since the start.

        Each cause precedes its effects.
        """
        counts, results, found = self._counts, self._results, self._input_findings(now)

        def add(id: str, count: int, **values: Any) -> None:
            if count:
                found.append(finding(id, count=count, **values))

        output_topic = self._publisher.topic_name
        publishers = self._node.get_publishers_info_by_topic(output_topic)
        names = ', '.join(sorted(map(full_name, publishers)))
        rival_publishers = len(publishers) if len(publishers) > 1 else 0
        add('relay_several_publishers', rival_publishers, topic=output_topic, names=names)
        if self._from_datasheet:
            sensors = ' and '.join(self._from_datasheet)
            found.append(finding('relay_datasheet', sensors=sensors))
        elif results is None and not found:
            found.append(self._missing_model(now))
        if results is not None:
            faults = faults_of(results.findings)
            found += faults
            model_sensors = {sensor_of(axis) for axis in results.axes}
            if self._ratio > SETTLED_RATIO:
                horizon = self._settings.value.horizon
                ratio = self._ratio if self._ratio < math.inf else None
                found.append(finding('relay_unsettled', (), horizon=horizon, ratio=ratio))
            if not faults:
                for sensor in SENSORS:
                    if sensor in model_sensors - self._variances.keys():
                        found.append(finding('relay_nothing_to_fill', sensor=sensor))
            expected = results.identity.frame_id
            add('relay_other_frame', self._other_frame, found=self._last_frame, expected=expected)
        source, reason = self._subscription.topic_name, self._last_malformed
        add('relay_malformed', counts[MALFORMED], reason=reason, topic=source)
        add('relay_unpublished', counts[UNPUBLISHED])
        return found
