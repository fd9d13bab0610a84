# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the nodes: checked parameters, one timer, diagnostics, and protected callbacks."""

from __future__ import annotations

import time
import traceback
from collections.abc import Sequence
from typing import Protocol

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from ..core.findings import Finding, finding
from .diagnostics import diagnostic_array, status_name, status_of
from .parameters import Parameters
from .settings import PublishSettings
from .shell import STEADY, Periodic

TICK_S = 0.1
"""Default period of the timer that polls the parts of a node."""

FAULT_SHOWN_S = 60.0
"""How long an internal error stays on `/diagnostics` after it last happened."""


class Part(Protocol):
    """One part of a node, such as the input, the estimate or the relay of one IMU."""

    def tick(self, now: float) -> None:
        """Run the tasks that are due; ``now`` is on a steady clock in s."""

    def statuses(self, now: float) -> list[DiagnosticStatus]:
        """Return the diagnostic statuses of this part."""

    def close(self) -> None:
        """Finish before the node is destroyed."""


class AllanNode(Node):
    """A node that is made of parts.

    An exception that nothing else catches is logged once with its traceback and reported as ERROR
    on `/diagnostics`; the node and its other parts go on.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.parameters = Parameters(self)
        self.publish = self.parameters.group('publish', PublishSettings)
        self._parts: Sequence[Part] = ()
        self._faults: dict[tuple[str, str], tuple[float, Finding]] = {}
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._diagnostics_due = Periodic(
            lambda: self.publish.value.diagnostics_period, time.monotonic()
        )

    def begin(self, parts: Sequence[Part], does: str, period: float = TICK_S) -> None:
        """Start the timer that polls the parts, and log what the node does in one line."""
        self._parts = parts
        settings = ', '.join(self.parameters.changes()) or 'all defaults'
        self.get_logger().info(f'{does}; settings: {settings}')
        for line in self.parameters.unknown():
            self.get_logger().warning(f'{line} It is ignored.')
        self.create_timer(period, self._tick, clock=STEADY)

    def close(self) -> None:
        """Close every part."""
        for part in self._parts:
            try:
                part.close()
            except Exception as error:  # the other checkpoints must still be written
                self.fault('close', error)

    def fault(self, where: str, error: Exception) -> None:
        """Log an unexpected exception once per place and kind, and report it on `/diagnostics`."""
        found = finding('internal_error', where=where, error=repr(error))
        kind = where, type(error).__name__
        if kind not in self._faults:
            self.get_logger().error(f'{found}\n{"".join(traceback.format_exception(error))}')
        self._faults[kind] = time.monotonic(), found

    def _tick(self) -> None:
        now = time.monotonic()
        for part in self._parts:
            try:
                part.tick(now)
            except Exception as error:
                self.fault(type(part).__name__, error)
        if self._diagnostics_due.due(now):
            statuses: list[DiagnosticStatus] = []
            for part in self._parts:
                try:
                    statuses += part.statuses(now)
                except Exception as error:
                    self.fault(f'{type(part).__name__} diagnostics', error)
            self._diagnostics.publish(diagnostic_array(self, [*statuses, *self._fault_status(now)]))

    def _fault_status(self, now: float) -> list[DiagnosticStatus]:
        """Return one status with the internal errors of the last minute; none without one."""
        recent = [f for at, f in self._faults.values() if now - at <= FAULT_SHOWN_S]
        if not recent:
            return []
        return [status_of(status_name(self, 'node'), recent, '', ())]
