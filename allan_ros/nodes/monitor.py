# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan_monitor`: accumulate, estimate and relay one or several IMUs in one process."""

from __future__ import annotations

import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from ..core.errors import AllanError
from .accumulation import ImuWatch, Settings
from .diagnostics import diagnostic_array
from .estimation import ImuEstimate, load_references
from .parameter_push import ParameterPush
from .parameters import ParameterGroup
from .relaying import ImuRelay, RelayTopics
from .settings import EstimatorSettings, RelaySettings
from .shell import STEADY, Periodic, Worker, run


class Monitor(Node):
    """What the other nodes do, for every topic in ``input.topics``."""

    def __init__(self) -> None:
        super().__init__('allan_monitor')
        self._settings = Settings(self)
        estimator = ParameterGroup(self, 'estimator', EstimatorSettings)
        references, worker = load_references(estimator.value), Worker()
        relay, self._push = ParameterGroup(self, 'relay', RelaySettings), ParameterPush(self)
        watched = self._settings.watched()
        if self._push.node and len(watched) > 1:
            raise AllanError(
                f'push.node with {len(watched)} IMUs: start an allan_monitor for the one that '
                f'{self._push.node} uses'
            )
        self._watches: list[ImuWatch] = []
        self._estimates: list[ImuEstimate] = []
        self._relays: list[ImuRelay] = []
        for imu, checkpoint_path in watched:
            estimate = ImuEstimate(self, imu.label, estimator, references, worker, self._push.offer)
            self._estimates.append(estimate)
            self._watches.append(
                ImuWatch(self, imu, self._settings, checkpoint_path, estimate.take)
            )
            if relay.value.enabled:
                model = f'~/{imu.label}/noise_model' if imu.label else '~/noise_model'
                topics = RelayTopics(imu.topic, model, f'{imu.topic}_with_covariance', imu.label)
                self._relays.append(ImuRelay(self, topics, relay))
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._diagnostics_due = Periodic(
            lambda: self._settings.publish.value.diagnostics_period, time.monotonic()
        )
        self.create_timer(self._settings.input.value.drain_period, self._tick, clock=STEADY)

    def close(self) -> None:
        """Stop relaying, and write the checkpoints."""
        for relay in self._relays:
            relay.close()
        for watch in self._watches:
            watch.close()

    def _tick(self) -> None:
        now = time.monotonic()
        for watch in self._watches:
            watch.tick(now)
        for estimate in self._estimates:
            estimate.tick(now)
        for relay in self._relays:
            relay.tick()
        self._push.tick(now)
        if self._diagnostics_due.due(now):
            statuses = [watch.status(now) for watch in self._watches]
            for estimate in self._estimates:
                statuses += estimate.statuses(now)
            statuses += [*(relay.status() for relay in self._relays), *self._push.statuses()]
            self._diagnostics.publish(diagnostic_array(self, statuses))


def main(args: list[str] | None = None) -> int:
    """Run `allan_monitor`."""
    return run('allan_monitor', lambda _stop: Monitor(), args)


if __name__ == '__main__':
    sys.exit(main())
