# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan_monitor`: accumulate and estimate one or several IMUs in one process."""

from __future__ import annotations

import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from .accumulation import ImuWatch, Settings
from .diagnostics import diagnostic_array
from .estimation import ImuEstimate, load_references
from .parameters import ParameterGroup
from .periodic import Periodic
from .settings import EstimatorSettings
from .shell import STEADY, run
from .worker import Worker


class Monitor(Node):
    """What `allan_accumulator` and `allan_estimator` do, for every topic in ``input.topics``."""

    def __init__(self) -> None:
        super().__init__('allan_monitor')
        self._settings = Settings(self)
        estimator = ParameterGroup(self, 'estimator', EstimatorSettings)
        references, worker = load_references(estimator.value), Worker()
        self._watches: list[ImuWatch] = []
        self._estimates: list[ImuEstimate] = []
        for imu, checkpoint_path in self._settings.watched():
            estimate = ImuEstimate(self, imu.label, estimator, references, worker)
            self._estimates.append(estimate)
            self._watches.append(
                ImuWatch(self, imu, self._settings, checkpoint_path, estimate.take)
            )
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._diagnostics_due = Periodic(
            lambda: self._settings.publish.value.diagnostics_period, time.monotonic()
        )
        self.create_timer(self._settings.input.value.drain_period, self._tick, clock=STEADY)

    def close(self) -> None:
        """Write the checkpoints."""
        for watch in self._watches:
            watch.close()

    def _tick(self) -> None:
        now = time.monotonic()
        for watch in self._watches:
            watch.tick(now)
        for estimate in self._estimates:
            estimate.tick(now)
        if self._diagnostics_due.due(now):
            statuses = [watch.status(now) for watch in self._watches]
            for estimate in self._estimates:
                statuses += estimate.statuses(now)
            self._diagnostics.publish(diagnostic_array(self, statuses))


def main(args: list[str] | None = None) -> int:
    """Run `allan_monitor`."""
    return run('allan_monitor', lambda _stop: Monitor(), args)


if __name__ == '__main__':
    sys.exit(main())
