# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Adds Imu messages to Allan sums, keeps the sums in a checkpoint, and publishes the sums."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ..core.allan.sums import AllanSums
from ..core.errors import one_line
from ..core.findings import LIVE, Finding, finding
from ..core.imu import AXES, SENSORS, ImuBatch
from ..core.settings import SegmenterSettings
from ..core.stream.health import StreamHealth
from ..core.stream.pipeline import ImuStream
from ..core.stream.present_faults import noise_now
from ..core.stream.transport import TransportMonitor, faults_of
from ..readers import SourceInfo
from ..readers.cdr import IMU_TYPE
from ..readers.recording_sums import Provenance
from ..results.checkpoint import Checkpoint, Total
from ..view.finding_text import finding_line
from .diagnostics import input_status, status_name
from .imu_input import ImuInput, full_name
from .messages import REPLACED_SHARE, Snapshot, kinds_of, replaced_share
from .node import AllanNode, NodePart, Periodic
from .node_settings import CheckpointSettings, InputSettings, WatchedImu, home_of
from .shell import LATCHED

UPDATE_S = 0.5
"""Period in s at which fetched messages are decoded and added to the Allan sums."""


class SumsOutput:
    """Publishes snapshots of the Allan sums on ``<home>sums``, and passes them to listeners.

    ``home`` is the prefix of the topic, such as ``~/``.

    Attributes
    ----------
    latest : Snapshot or None
        The latest snapshot of this input, without an accelerometer that has its own topic.
    state : object
        The state of the input at the latest snapshot. If the present state of the input is
        different, the estimator must receive a new snapshot at once.
    """

    def __init__(self, node: Node, home: str) -> None:
        self.latest: Snapshot | None = None
        self.state: object = None
        self._listeners: list[Callable[[Snapshot], None]] = []
        self._publisher = node.create_publisher(String, f'{home}sums', LATCHED)
        self._subscribers = 0

    @property
    def topic(self) -> str:
        """Full name of the topic of the sums."""
        return str(self._publisher.topic_name)

    @property
    def sums(self) -> tuple[AllanSums, ...]:
        """The sums in the latest snapshot of this input; empty before the first snapshot."""
        return self.latest.sums if self.latest is not None else ()

    def add_listener(self, listener: Callable[[Snapshot], None]) -> None:
        """Register a function that is called with every further snapshot."""
        self._listeners.append(listener)

    def has_new_subscriber(self) -> bool:
        """Return whether there are more subscribers than at the last call."""
        last_count, self._subscribers = self._subscribers, self._publisher.get_subscription_count()
        return self._subscribers > last_count

    def put(self, snapshot: Snapshot, state: object, accel: Snapshot | None) -> None:
        """Publish a snapshot, extended by the snapshot ``accel`` of a separate accelerometer.

        ``state`` is the state of the input at this snapshot. Listeners always receive the snapshot;
        a message is made and published only if the topic has a subscriber.
        """
        self.latest, self.state = snapshot, state
        complete_snapshot = snapshot if accel is None else snapshot.with_accel(accel)
        for listener in self._listeners:
            listener(complete_snapshot)
        if self._publisher.get_subscription_count():
            document = complete_snapshot.to_document()
            text = json.dumps(document, separators=(',', ':'), allow_nan=False)
            self._publisher.publish(String(data=text))


class ImuWatch(NodePart):
    """Accumulates the Allan sums of one IMU, and continues the sums in its checkpoint if possible.

    ``output`` publishes the sums periodically and for each new subscriber. It also publishes them
    when a service saves or resets them, when many of their samples are replaced, when the first
    means at rest are known, and when the frame_id, axes or faults of the input change. ``sensor``
    is the only sensor that is used, or '' for both sensors. ``accel`` is the `ImuWatch` of an
    accelerometer with its own topic. If ``accel`` is given, ``output`` publishes the sums of both
    sensors together, also each time that ``accel`` publishes its own sums, and the services reset
    or save the sums of both.
    """

    def __init__(
        self,
        node: AllanNode,
        imu: WatchedImu,
        sensor: str = '',
        accel: ImuWatch | None = None,
    ) -> None:
        self._node, self._imu = node, imu
        self._settings = node.parameters.group('input', InputSettings)
        self._segmenter = node.parameters.group('segmenter', SegmenterSettings)
        checkpoint = node.parameters.group('checkpoint', CheckpointSettings)
        self._sensor, self._accel = sensor, accel
        self._usable_axes = AXES[SENSORS[sensor]] if sensor else AXES
        home = home_of(imu.label)
        self.output = SumsOutput(node, home)
        if accel is not None:
            accel.output.add_listener(lambda _: self._publish(self._total()))
        self._log = node.get_logger()
        self._input = ImuInput(node, imu.topic, self._settings.value)
        self._checkpoint = Checkpoint(imu.checkpoint, self._log, finding_line)
        now = time.monotonic()
        self._monitor = TransportMonitor(self._input.topic, now)
        self._last_stamp_ns: int | None = None
        self.frame_id = ''
        self._axes: tuple[str, ...] = ()  # axes for which a finite value was received
        self._faults: tuple[Finding, ...] = ()
        self._received = 0  # number of messages when the last status was made
        self._clock_ns = -1  # time of the node in ns when the last status was made
        self._events: tuple[object, ...]
        self._begin(self._checkpoint.covered)

        node.create_service(Trigger, f'{home}reset', self._on_reset)
        node.create_service(Trigger, f'{home}save', self._on_save)
        self._update_due = Periodic(lambda: UPDATE_S)
        self._sums_due = Periodic(lambda: node.publish.value.sums_period)
        self._save_due = Periodic(lambda: checkpoint.value.period)

    @property
    def description(self) -> str:
        """Text that describes the input in the log at the start of the node."""
        name = f' as {self._imu.label}' if self._imu.label else ''
        checkpoint = self._checkpoint.path or 'none'
        return f'{self._input.topic}{name} ({self._input.qos}; checkpoint {checkpoint})'

    def tick(self, now: float) -> None:
        """Run the tasks that are due; ``now`` is the time of the monotonic clock in s."""
        self._monitor.set_received(now, self._input.received)
        if self._update_due.due(now):
            self._update()
        has_new_subscriber = self.output.has_new_subscriber()
        if self._sums_due.due(now) and self._sensor != 'accel':
            self._update()
            # A separate accelerometer publishes its own sums. This object listens to it, and then
            # publishes the sums of both sensors.
            publishing_watch = self._accel or self
            publishing_watch._update()
            publishing_watch._publish(publishing_watch._total())
        elif has_new_subscriber:  # a new subscriber need not wait until sums are due
            self._publish(self._total())
        if self._save_due.due(now):
            self._update()
            self._checkpoint.save_in_background(self._total())

    def statuses(self, now: float) -> list[DiagnosticStatus]:
        """Return the status of the input; also publish the sums if the input has changed."""
        self._update()
        self._checkpoint.tick()
        # called first, because `_health_and_findings` stores the number of messages that
        # `_is_paused` compares
        is_paused = self._is_paused()
        health, stream_findings = self._health_and_findings()
        statistics = self._input.statistics()
        publishers, graph_findings = self._input.publishers()
        stale_after = self._settings.value.stale_after
        stuck_axes = self._input.constant.stuck(health.rate_hz) if health.rate_hz else ()
        if stuck_axes := tuple(axis for axis in stuck_axes if axis in self._usable_axes):
            stream_findings = (finding('stuck_now', stuck_axes), *stream_findings)
        if is_paused:
            graph_findings = (*graph_findings, finding('playback_paused', topic=self._input.topic))
        input_findings = self._monitor.observe(
            now, statistics, health, publishers, stale_after, stream_findings, graph_findings
        )
        own_topic = self.output.topic
        # a second publisher of the sums is another node with the same name
        if (count := self._node.count_publishers(own_topic)) > 1:
            names = ', '.join(map(full_name, self._node.get_publishers_info_by_topic(own_topic)))
            shared_topic_finding = finding(
                'relay_several_publishers', count=count, topic=own_topic, names=names
            )
            input_findings = *input_findings, shared_topic_finding
        faults = faults_of(input_findings)
        self._faults = tuple(f for f in faults if f.axes)
        if len(self._faults) < len(faults):
            self._faults = finding('no_data'), *self._faults
        noise_findings = noise_now(health, self._sums)
        self._faults = *self._faults, *noise_findings
        input_findings = *input_findings, *noise_findings
        if health.state == 'moving':
            self._faults = *self._faults, finding('moving_now')
        if self._state() != self.output.state:
            self._publish(self._total())
        # A finding about the whole stream is not shown if a finding about the present input has the
        # same id.
        live_ids = {*LIVE, 'gaps', *(f.id for f in input_findings)}
        stamp_age = None
        if self._last_stamp_ns is not None:
            stamp_age = (self._node.get_clock().now().nanoseconds - self._last_stamp_ns) * 1e-9
        others: list[tuple[str, object]] = [
            ('topic', self._input.topic),
            ('declared rate [Hz]', self._segmenter.value.declared_rate or None),
            ('segments', max((s.segment_count for s in self._sums), default=0)),
            ('message age [s]', self._monitor.silence_s(now) if statistics.received else None),
            ('stamp age [s]', stamp_age),
            ('publishers', ', '.join(publishers) or 'none'),
            ('messages taken by', 'a thread' if self._input.polled else 'a callback'),
            ('checkpoint', self._checkpoint.path or 'none'),
            ('checkpoint age [s]', self._checkpoint.age_s(now)),
        ]
        status = input_status(
            status_name(self._node, self._imu.label or self._imu.topic, 'input'),
            self._imu.hardware_id or one_line(self.frame_id),
            health,
            statistics,
            (*input_findings, *self._checkpoint.findings),
            tuple(f for f in stream_findings if f.id not in live_ids),
            static_s=max((s.elapsed_ns * 1e-9 for s in self._sums), default=0.0),
            streams=max(1, len(self._result.sums)),
            others=others,
        )
        return [status]

    def _is_paused(self) -> bool:
        """Return whether simulated time has not changed since the last call; False with real time.

        If a message has arrived since the last call, simulated time counts as running.
        """
        now_ns, former_ns = self._node.get_clock().now().nanoseconds, self._clock_ns
        self._clock_ns = now_ns
        is_simulated = bool(self._node.get_parameter('use_sim_time').value)
        return is_simulated and now_ns == former_ns and self._received == self._input.received

    def close(self) -> None:
        """Accumulate the remaining messages; save the sums in the checkpoint, if there is one."""
        self._input.drain()
        self._update()
        self._input.close()
        self._checkpoint.save(self._total())
        self._checkpoint.close()

    def _health_and_findings(self) -> tuple[StreamHealth, tuple[Finding, ...]]:
        """Return the health and the findings of the stream.

        The computation of the sums can take tens of milliseconds. While messages arrive, the sums
        are therefore computed here only after an event (`_events`). If more than `REPLACED_SHARE`
        of the published samples are missing in the new sums, the new sums are published at once.
        """
        has_new_messages = self._input.received != self._received
        self._received = self._input.received
        if self._outdated:
            health, findings = self._stream.present_health(self._result.sums)
            former_events, self._events = self._events, _events(health)
            if has_new_messages and self._events == former_events:
                return health, findings
            total = self._total()
            if replaced_share(self.output.sums, total[0]) > REPLACED_SHARE:
                self._publish(total)
        return self._result.health, self._result.findings

    # --- input of samples -------------------------------------------------------------------------

    def _begin(self, covered: Sequence[tuple[int, int]] = ()) -> None:
        """Start new sums; ``covered`` are (first, last) stamps in ns of data in the checkpoint.

        With simulated time, a recording may be played twice. Samples from a time that the
        checkpoint covers are therefore excluded. With real time, ``covered`` is not used, because
        stamps that go back mean that the clock was set.
        """
        is_simulated = bool(self._node.get_parameter('use_sim_time').value)
        self._stream = ImuStream(
            self._segmenter.value,
            self._imu.hardware_id,
            self._sensor,
            with_drives=True,
            with_means=True,
            covered=covered if is_simulated else None,
        )
        self._latest_ns: int | None = None
        self._result = self._stream.result()
        self._sums: tuple[AllanSums, ...] = ()  # sums of this run and of earlier runs of the node
        # whether `_result` must be computed again, for example because samples were added
        self._outdated = True
        self._events = ()

    def _update(self) -> None:
        """Add the fetched messages to the Allan sums."""
        for batch in self._input.batches():
            self._accumulate(batch)

    def _accumulate(self, batch: ImuBatch) -> None:
        self._stream.update(batch)
        self._outdated = True
        if len(self._axes) < len(self._usable_axes):
            finite_axes = np.array(AXES)[np.isfinite(batch.samples).any(axis=0)].tolist()
            known_axes = {*self._axes, *finite_axes}
            self._axes = tuple(axis for axis in self._usable_axes if axis in known_axes)
        self.frame_id = batch.frame_id
        self._last_stamp_ns = int(batch.stamps_ns[-1])
        self._latest_ns = max(self._latest_ns or 0, int(batch.stamps_ns.max()))

    # --- output of Allan sums ---------------------------------------------------------------------

    def _total(self) -> Total:
        """Return the sums and the provenance of the samples of this run and of earlier runs.

        Earlier runs of the node count only if their sums in the checkpoint can be continued.
        """
        if self._outdated:
            self._result, self._outdated = self._stream.result(), False
        result, name = self._result, self._node.get_fully_qualified_name()
        provenance = Provenance(
            (SourceInfo(name, self._input.topic, IMU_TYPE, 'live'),),
            result.segments,
            result.findings,
            result.health.counts,
            asdict(self._segmenter.value),
            self._latest_ns,
        )
        total = self._checkpoint.total(result.sums, provenance)
        self._sums = total[0]
        return total

    def _state(self) -> object:
        """Return a value whose change means that the estimator must receive the sums at once."""
        has_means = any(len(means.end_ns) for means in self._stream.means())
        return self.frame_id, self._axes, has_means, kinds_of(self._faults)

    def _publish(self, total: Total) -> None:
        """Publish the sums, together with the sums of an accelerometer with its own topic."""
        means, faults = self._stream.means(), self._faults
        hardware_id = self._imu.hardware_id
        drives = self._stream.drives()
        snapshot = Snapshot(total, self.frame_id, hardware_id, self._axes, means, faults, drives)
        accel = self._accel.output.latest if self._accel is not None else None
        self.output.put(snapshot, self._state(), accel)

    # --- services ---------------------------------------------------------------------------------

    def _on_save(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._input.drain()
        self._update()
        total = self._total()
        self._publish(total)
        if not self._checkpoint.path:
            response.message = 'nothing was saved: set checkpoint.path'
            return response
        response.success = self._checkpoint.save(total)
        samples = max((s.samples for s in total[0]), default=0)
        lines = [
            f'{self._checkpoint.path}: {samples} samples',
            *map(finding_line, self._checkpoint.findings),
        ]
        if self._accel is not None:
            accel = self._accel._on_save(_request, Trigger.Response())
            response.success &= accel.success
            lines.append(accel.message)
        response.message = '; '.join(lines)
        return response

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._input.drain()
        self._update()
        backup_path = self._checkpoint.start_over(self._total())
        self._begin()
        if self._accel is not None:
            self._accel._on_reset(_request, Trigger.Response())
        self._publish(self._total())
        backup_lines = [f'the previous sums are in {backup_path}'] if backup_path else []
        lines = [
            'the sums start from zero',
            *backup_lines,
            *map(finding_line, self._checkpoint.findings),
        ]
        response.success, response.message = True, '; '.join(lines)
        return response


def watches(
    node: AllanNode,
    imu: WatchedImu,
    listener: Callable[[Snapshot], None] | None = None,
) -> list[ImuWatch]:
    """Return a list with the input of an IMU, or two inputs if the sensors have separate topics.

    ``listener`` is called with every snapshot of the IMU.
    """
    if imu.accel_topic:
        accel = ImuWatch(node, imu.accel, 'accel')
        inputs = [ImuWatch(node, imu, 'gyro', accel), accel]
    else:
        inputs = [ImuWatch(node, imu)]
    if listener is not None:
        inputs[0].output.add_listener(listener)
    return inputs


def watched_imus(node: AllanNode) -> list[WatchedImu]:
    """Return the IMUs that the parameters ``input.*`` and ``checkpoint.path`` name."""
    checkpoint = node.parameters.group('checkpoint', CheckpointSettings)
    return node.parameters.group('input', InputSettings).value.imus(checkpoint.value.path)


def _events(health: StreamHealth) -> tuple[object, ...]:
    """Return values that change after an event, such as a motion, a gap, or a new frame_id.

    Other events are a change of the noise, discarded sums, and the first used sample.
    """
    counts = health.counts
    has_used_samples, splits = counts.used > 0, sum(counts.splits.values())
    return (
        health.state,
        health.discarded,
        health.frame_id,
        health.frame_changes,
        splits,
        has_used_samples,
    )
