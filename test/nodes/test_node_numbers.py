# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics hold finite numbers or none, for axes and inputs of any size."""

from __future__ import annotations

from collections.abc import Callable

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticStatus
from support.numbers import NO_NUMBER, noiseless_sums, noisy_sums

from allan_ros.core.allan.recent import recent_noise
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.stream.health import Counts, StreamHealth
from allan_ros.core.stream.transport import TransportStatistics
from allan_ros.io.analysis import analyze_sums
from allan_ros.io.recorded import Provenance
from allan_ros.nodes.diagnostics import AxisView, axis_status, input_status


def check_status(status: DiagnosticStatus) -> None:
    assert status.message[:1].strip()
    for said in (status.message, *(f'{v.key}: {v.value}' for v in status.values)):
        assert not NO_NUMBER.search(said), said


@pytest.mark.parametrize('make, method', [(noiseless_sums, 'relative'), (noisy_sums, 'paper')])
def test_of_an_axis(make: Callable[[], AllanSums], method: str) -> None:
    sums = make()
    results = analyze_sums([sums], Provenance(), method)
    recent = recent_noise(sums, 10.0)
    for axis, result in results.axes.items():
        for fitted in (None, result):
            view = AxisView(axis, sums, fitted, method, 1e300, '', (), 0.2, recent.get(axis), ())
            check_status(axis_status('node: imu', 'imu', view))


@pytest.mark.parametrize('count', [0, 1, 10**18])
def test_of_an_input(count: int) -> None:
    health = StreamHealth(Counts(received=count, used=count), first_ns=0)
    named = {'static_s': float(count), 'others': [('stamp age [s]', -1e300)]}
    check_status(input_status('node: imu', 'imu', health, TransportStatistics(), **named))
