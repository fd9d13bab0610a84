# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan_estimator`: turn the sums of an accumulator into coefficients on `/diagnostics`."""

from __future__ import annotations

import sys
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import String

from ..core.errors import AllanError
from ..core.findings import finding
from ..io.documents import sums_file_from_document
from ..io.text import parse_json
from .diagnostics import diagnostic_array, key_values, message_of, status_name, worst_level
from .estimation import ImuEstimate, load_references
from .parameter_push import ParameterPush
from .parameters import ParameterGroup
from .qos import LATCHED
from .settings import EstimatorSettings, PublishSettings
from .shell import STEADY, Periodic, Worker, run

TICK_S = 0.1
"""How often it looks whether a fit has ended or something is due."""

STALE_PERIODS = 3.0
"""Sums that have not come for so many of their periods are said to be missing."""

ALONE_S = 5.0
"""So they are after this time where nobody publishes them; less is discovery."""


class Estimator(Node):
    """Subscribes ``sums``; publishes ``~/noise_model`` and one diagnostic status per axis."""

    def __init__(self) -> None:
        super().__init__('allan_estimator')
        self._publish = ParameterGroup(self, 'publish', PublishSettings)
        settings = ParameterGroup(self, 'estimator', EstimatorSettings)
        references = load_references(settings.value)
        self._push = ParameterPush(self)
        self._estimate = ImuEstimate(self, '', settings, references, Worker(), self._push.offer)
        self._subscription = self.create_subscription(String, 'sums', self._on_sums, LATCHED)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._last_sums = now = time.monotonic()
        self._trouble = ''
        self._diagnostics_due = Periodic(lambda: self._publish.value.diagnostics_period, now)
        self.create_timer(TICK_S, self._tick, clock=STEADY)

    def close(self) -> None:
        """Nothing to finish: all it knows is in the sums."""

    def _on_sums(self, message: String) -> None:
        self._last_sums = time.monotonic()
        try:
            self._estimate.take(sums_file_from_document(parse_json(message.data, 'sums'), 'sums'))
            self._trouble = ''
        except AllanError as error:
            self._trouble = f'these sums cannot be read: {error}'
            self.get_logger().warning(self._trouble, throttle_duration_sec=60.0)

    def _tick(self) -> None:
        now = time.monotonic()
        self._estimate.tick(now)
        self._push.tick(now)
        if self._diagnostics_due.due(now):
            statuses = [self._sums_status(now), *self._estimate.statuses(now)]
            statuses += self._push.statuses()
            self._diagnostics.publish(diagnostic_array(self, statuses))

    def _sums_status(self, now: float) -> DiagnosticStatus:
        """Return whether sums come at all."""
        topic, age = self._subscription.topic_name, now - self._last_sums
        patience = STALE_PERIODS * self._publish.value.sums_period
        if not self.count_publishers(topic):
            patience = min(patience, ALONE_S)
        late = age > patience
        findings = [finding('no_sums', topic=topic, seconds=age)] if late else []
        status = DiagnosticStatus(
            level=worst_level(findings),
            name=status_name(self, 'sums'),
            message=message_of(findings, f'sums come on {topic}'),
            values=key_values([('topic', topic), ('sums age [s]', age)]),
        )
        if self._trouble:
            status.level, status.message = DiagnosticStatus.ERROR, self._trouble
        return status


def main(args: list[str] | None = None) -> int:
    """Run `allan_estimator`."""
    return run('allan_estimator', lambda _stop: Estimator(), args)


if __name__ == '__main__':
    sys.exit(main())
