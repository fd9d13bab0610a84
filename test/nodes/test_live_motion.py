# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The monitor measures the errors in motion of a robot that stops now and then."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip('rclpy')

from support.simulate_drives import MotionErrors, Route, simulate_drives

from allan_ros.core.imu import ImuBatch
from allan_ros.core.noise import Model

RATE = 50.0
OK, WARN = b'\x00', b'\x01'


def robot(drives: int, errors: MotionErrors = MotionErrors()) -> tuple[ImuBatch, int]:
    """Return samples of a robot that rests for 11 s and drives for 15 to 25 s, several times.

    The number is the index of the sample at which the last drive begins.
    """
    noise = [Model.of(N=7e-5)] * 3, [Model.of(N=1.2e-3)] * 3
    route = Route(drives=drives, tilt=0.15, shortest=15.0, longest=25.0, rest=11.0)
    simulated = simulate_drives(RATE, *noise, route, errors, seed=1)
    stamps = 10**18 + np.arange(len(simulated.samples)) * round(1e9 / RATE)
    batch = ImuBatch(stamps.astype(np.int64), simulated.samples, frame_id='imu')
    return batch, simulated.drives[-1][0]


def driven(drives: int, errors: MotionErrors = MotionErrors()) -> ImuBatch:
    return robot(drives, errors)[0]


def test_the_factor_is_published_with_the_model_and_a_large_one_is_a_warning(graph) -> None:
    graph.run('monitor', **{'estimator.motion_limit': 3.0})
    models = graph.latched('/allan_monitor/noise_model')
    graph.send(graph.publisher(), driven(10, MotionErrors(gyro_scale=0.02)))
    status = graph.until(lambda: (s := graph.status('in motion')) and 'times' in s.message and s)
    assert status.level == WARN
    assert 'In motion the angle error is' in status.message
    assert 'the limit is 3 times' in status.message
    assert float(graph.value('in motion', 'factor of the angle error low')) > 3.0
    raised = [graph.value('in motion', f'factor of {term} of the gyro') for term in 'NK']
    assert any(factor and float(factor) > 3.0 for factor in raised)
    assert 'of the gyro' in graph.value('in motion', 'cause')
    motion = graph.until(lambda: models and models[-1]['motion'])
    assert motion['gyro']['factor']['value'] > 3.0
    assert len(motion['drives']) >= 5


def test_a_robot_without_errors_gets_a_line_and_no_warning(graph) -> None:
    graph.run('monitor')
    graph.send(graph.publisher(), driven(10))
    status = graph.until(lambda: (s := graph.status('in motion')) and 'times' in s.message and s)
    assert status.level == OK
    assert status.message.startswith('in motion: angle error ')
    assert 'times the noise at rest, ' in status.message


def test_too_few_drives_say_what_is_needed(graph) -> None:
    """The last rest is not over, so that its drive does not count yet."""
    graph.run('monitor')
    graph.send(graph.publisher(), driven(4))
    needed = 'not measured yet: 3 of at least 5 drives between rests, '
    status = graph.until(lambda: (s := graph.status('in motion')) and needed in s.message and s)
    assert status.level == OK and 'of at least 60 s at rest' in status.message


def test_the_relay_covers_the_errors_while_the_robot_moves(graph) -> None:
    graph.run('monitor', **{'relay.enabled': True, 'relay.motion': True, 'relay.debiased': True})
    publisher = graph.publisher()
    batch, last_drive = robot(11, MotionErrors(gyro_scale=0.02))
    graph.send(publisher, batch.part(slice(0, last_drive)))
    graph.until(lambda: graph.value('in motion', 'factor of the angle error'))
    variance = lambda: float(graph.value('relay', 'variance of gyro x') or 'nan')  # noqa: E731
    graph.until(lambda: variance() == pytest.approx(RATE * 7e-5**2, rel=0.5))
    low = float(graph.value('in motion', 'factor of the angle error low'))
    assert low > 3.0
    moved = last_drive + round(14 * RATE)
    graph.send(publisher, batch.part(slice(last_drive, moved)))
    graph.until(lambda: variance() > low**2 * RATE * 7e-5**2)
    graph.send(publisher, batch.part(slice(moved, None)))  # ends at rest
    graph.until(lambda: variance() == pytest.approx(RATE * 7e-5**2, rel=0.5))
