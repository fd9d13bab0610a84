# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The part of a node that watches one IMU: messages in; running sums, checkpoint, health out."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ..core.allan.sums import AllanSums
from ..core.findings import Finding, finding
from ..core.imu import ImuBatch
from ..core.settings import SegmenterSettings
from ..core.stream.pipeline import ImuStream, RunSplitter
from ..core.stream.transport import LIVE_FINDINGS, TransportMonitor
from ..io.documents import sums_file_to_document
from ..io.readers.recording import SourceInfo
from ..io.recorded import Provenance
from .checkpointing import CheckpointKeeper, Total
from .diagnostics import InputView, input_status, status_name
from .imu_input import ImuInput
from .parameters import ParameterGroup
from .qos import LATCHED
from .settings import CheckpointSettings, InputSettings, PublishSettings
from .shell import Periodic

IMU_TYPE = 'sensor_msgs/msg/Imu'


class WatchedImu(NamedTuple):
    """Which IMU: its topic, a label where there are several, and its serial number if given."""

    topic: str
    label: str = ''
    hardware_id: str = ''


class Settings:
    """The parameters of a node that accumulates."""

    def __init__(self, node: Node) -> None:
        self.input = ParameterGroup(node, 'input', InputSettings)
        self.segmenter = ParameterGroup(node, 'segmenter', SegmenterSettings)
        self.publish = ParameterGroup(node, 'publish', PublishSettings)
        self.checkpoint = ParameterGroup(node, 'checkpoint', CheckpointSettings)

    def watched(self) -> list[tuple[WatchedImu, str]]:
        """Return each IMU with the path of its checkpoint ('' for none)."""
        imus = [WatchedImu(*imu) for imu in self.input.value.imus]
        path = self.checkpoint.value.path
        if len(imus) == 1 or not path:
            return [(imu, path) for imu in imus]
        return [(imu, str(Path(path) / f'{imu.label}.json')) for imu in imus]


class ImuWatch:
    """Accumulates the sums of one IMU and keeps them over restarts.

    Parameters
    ----------
    node : Node
    imu : WatchedImu
    settings : Settings
    checkpoint_path : str
        '' for none.
    listener : callable, optional
        Called with the sums whenever they are due, as a value: no JSON within one process.
    """

    def __init__(
        self,
        node: Node,
        imu: WatchedImu,
        settings: Settings,
        checkpoint_path: str = '',
        listener: Callable[[Total], None] | None = None,
    ) -> None:
        self._node, self._imu, self._settings, self._listener = node, imu, settings, listener
        self._log = node.get_logger()
        self._input = ImuInput(node, imu.topic, settings.input.value)
        self._checkpoint = CheckpointKeeper(checkpoint_path, self._log)
        self._noted: tuple[Finding, ...] = ()
        now = time.monotonic()
        self._health = TransportMonitor(self._input.topic, now)
        self._last_stamp_ns: int | None = None
        self.frame_id = ''
        self._begin(self._checkpoint.sums)

        home = f'~/{imu.label}/' if imu.label else '~/'
        self._publisher = node.create_publisher(String, f'{home}sums', LATCHED)
        self._subscribers = 0
        node.create_service(Trigger, f'{home}reset', self._on_reset)
        node.create_service(Trigger, f'{home}save', self._on_save)
        self._update_due = Periodic(lambda: settings.input.value.update_period, now)
        self._sums_due = Periodic(lambda: settings.publish.value.sums_period, now)
        self._save_due = Periodic(lambda: settings.checkpoint.value.period, now)

    def tick(self, now: float) -> None:
        """Do what is due; called by the node's timer, as often as the queue must be emptied."""
        self._input.drain()
        self._health.heard(now, self._input.received)
        if self._update_due.due(now):
            self._update()
        if self._sums_due.due(now):
            self._update()
            self._publish(self._total())
        elif self._publisher.get_subscription_count() > self._subscribers:
            self._publish(self._total())  # who is new need not wait
        self._subscribers = self._publisher.get_subscription_count()
        if self._save_due.due(now):
            self._update()
            self._checkpoint.save_in_background(self._total())

    def status(self, now: float) -> DiagnosticStatus:
        """Return the health of the input."""
        self._update()
        self._checkpoint.tick()
        known = self._accumulator.result()
        reception, publishers = self._input.reception(), self._input.publishers()
        silence = self._health.silence_s(now)
        stale_after = self._settings.input.value.stale_after
        found = self._health.observe(
            now, reception, known.health, publishers, stale_after, known.findings
        )
        noted = (f for f in known.findings if f.id not in LIVE_FINDINGS)
        stamp_age = None
        if self._last_stamp_ns is not None:
            stamp_age = (self._node.get_clock().now().nanoseconds - self._last_stamp_ns) * 1e-9
        return input_status(
            status_name(self._node, self._imu.label or self._imu.topic, 'input'),
            self._imu.hardware_id or self.frame_id,
            InputView(
                topic=self._input.topic,
                health=known.health,
                reception=reception,
                findings=(*found, *self._checkpoint.findings),
                noted=(*noted, *self._noted),
                sums=self._checkpoint.total(known.sums, Provenance())[0],
                publishers=publishers,
                declared_rate=self._settings.segmenter.value.declared_rate,
                path='draining' if self._input.lean else 'a plain callback',
                received_age_s=silence if reception.received else None,
                stamp_age_s=stamp_age,
                checkpoint=self._checkpoint.path,
                checkpoint_age_s=self._checkpoint.age_s(now),
            ),
        )

    def close(self) -> None:
        """Take what has come, and write the checkpoint."""
        self._input.drain()
        self._update()
        for _, piece in self._splitter.flush():
            self._take(piece)
        self._checkpoint.save(self._total())
        self._checkpoint.close()

    # --- samples in -------------------------------------------------------------------------------

    def _begin(self, before: tuple[AllanSums, ...] = ()) -> None:
        """Start to accumulate, after what was there before."""
        self._accumulator = ImuStream(self._settings.segmenter.value, self._imu.hardware_id)
        self._splitter = RunSplitter(_latest_ns(before))

    def _update(self) -> None:
        """Accumulate what has been drained."""
        # Played with simulated time, a recording may be looped: its second pass is no evidence.
        # Without it, stamps that go back are a clock that was set, which only cuts.
        played = bool(self._node.get_parameter('use_sim_time').value)
        for batch in self._input.batches():
            if not played:
                self._take(batch)
                continue
            for new_run, piece in self._splitter.split(batch):
                if new_run:
                    self._begin_run()
                self._take(piece)

    def _take(self, batch: ImuBatch) -> None:
        self._accumulator.update(batch)
        self.frame_id = batch.frame_id
        self._last_stamp_ns = int(batch.stamps_ns[-1])

    def _begin_run(self) -> None:
        """Put the sums of the run that ended aside, and start anew."""
        where = self._checkpoint.begin_anew(self._total())
        splitter = self._splitter
        self._begin()
        self._splitter = splitter  # it is in the middle of a batch
        note = finding('run_began_anew', kept=f'in {where}' if where else 'dropped')
        self._noted = (note,)
        self._log.info(str(note))

    # --- sums out ---------------------------------------------------------------------------------

    def _total(self) -> Total:
        """Return the sums as if the input ended now, with those of the runs before."""
        known = self._accumulator.result()
        source = SourceInfo(
            self._node.get_fully_qualified_name(), self._input.topic, IMU_TYPE, 'live'
        )
        settings = asdict(self._settings.segmenter.value)
        provenance = Provenance(
            (source,), known.spans, known.findings, known.health.counts, settings
        )
        return self._checkpoint.total(known.sums, provenance)

    def _publish(self, total: Total) -> None:
        if self._listener is not None:
            self._listener(total)
        if self._publisher.get_subscription_count():
            document = sums_file_to_document(*total)
            text = json.dumps(document, separators=(',', ':'), allow_nan=False)
            self._publisher.publish(String(data=text))

    # --- services ---------------------------------------------------------------------------------

    def _on_save(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._input.drain()
        self._update()
        total = self._total()
        self._publish(total)
        if not self._checkpoint.path:
            response.message = 'no file: set checkpoint.path to have one'
            return response
        response.success = self._checkpoint.save(total)
        samples = max((s.samples for s in total[0]), default=0)
        saved = f'{self._checkpoint.path}: {samples} samples'
        response.message = '; '.join([saved, *map(str, self._checkpoint.findings)])
        return response

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._input.drain()
        self._update()
        where = self._checkpoint.begin_anew(self._total())
        self._begin()
        self._publish(self._total())
        response.success = True
        response.message = 'the sums began anew'
        if where:
            response.message += f'; those before are in {where}'
        response.message = '; '.join([response.message, *map(str, self._checkpoint.findings)])
        return response


def _latest_ns(sums: tuple[AllanSums, ...]) -> int | None:
    """Return the end of the latest segment that is known one by one."""
    ends = [
        segment.start_ns + round(segment.samples * s.tau0 * 1e9)
        for s in sums
        if s.tau0 is not None
        for segment in s.segments
    ]
    return max(ends, default=None)
