# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan_accumulator`: accumulate the Allan sums of one IMU and publish them."""

from __future__ import annotations

import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from ..core.errors import AllanError
from .accumulation import ImuWatch, Settings
from .diagnostics import diagnostic_array
from .shell import STEADY, Periodic, run


class Accumulator(Node):
    """Subscribes ``imu/data``; publishes ``~/sums`` and the health of its input."""

    def __init__(self) -> None:
        super().__init__('allan_accumulator')
        self._settings = Settings(self)
        watched = self._settings.watched()
        if len(watched) != 1:
            raise AllanError(
                f'input.topics names {len(watched)} IMUs: allan_accumulator takes one, '
                'use allan_monitor for several'
            )
        self._watch = ImuWatch(self, watched[0][0], self._settings, watched[0][1])
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._diagnostics_due = Periodic(
            lambda: self._settings.publish.value.diagnostics_period, time.monotonic()
        )
        self.create_timer(self._settings.input.value.drain_period, self._tick, clock=STEADY)

    def close(self) -> None:
        """Write the checkpoint."""
        self._watch.close()

    def _tick(self) -> None:
        now = time.monotonic()
        self._watch.tick(now)
        if self._diagnostics_due.due(now):
            self._diagnostics.publish(diagnostic_array(self, [self._watch.status(now)]))


def main(args: list[str] | None = None) -> int:
    """Run `allan_accumulator`."""
    return run('allan_accumulator', lambda _stop: Accumulator(), args)


if __name__ == '__main__':
    sys.exit(main())
