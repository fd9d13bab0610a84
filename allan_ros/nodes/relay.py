# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan_imu_relay`: hand an Imu on with the covariances that its noise model says."""

from __future__ import annotations

import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from .diagnostics import diagnostic_array
from .parameters import ParameterGroup
from .relaying import ImuRelay, RelayTopics
from .settings import PublishSettings, RelaySettings
from .shell import STEADY, Periodic, run

TOPICS = RelayTopics('imu/data', 'noise_model', 'imu/data_with_covariance')

TICK_S = 0.1
"""How often it looks whether a parameter has changed or something is due."""


class Relay(Node):
    """Subscribes ``imu/data`` and ``noise_model``; publishes ``imu/data_with_covariance``."""

    def __init__(self) -> None:
        super().__init__('allan_imu_relay')
        publish = ParameterGroup(self, 'publish', PublishSettings)
        self._relay = ImuRelay(self, TOPICS, ParameterGroup(self, 'relay', RelaySettings))
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._diagnostics_due = Periodic(lambda: publish.value.diagnostics_period, time.monotonic())
        self.create_timer(TICK_S, self._tick, clock=STEADY)

    def close(self) -> None:
        """Stop relaying."""
        self._relay.close()

    def _tick(self) -> None:
        self._relay.tick()
        if self._diagnostics_due.due(time.monotonic()):
            self._diagnostics.publish(diagnostic_array(self, [self._relay.status()]))


def main(args: list[str] | None = None) -> int:
    """Run `allan_imu_relay`."""
    return run('allan_imu_relay', lambda _stop: Relay(), args)


if __name__ == '__main__':
    sys.exit(main())
