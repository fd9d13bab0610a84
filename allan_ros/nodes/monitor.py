# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node `allan_monitor`, and the nodes accumulator, estimator and relay that it combines.

A node consists of parts. For each of its IMUs, the monitor has the parts of an accumulator, of an
estimator and, if enabled, of a relay.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import Any

from ..core.errors import AllanError
from .accumulation import watched_imus, watches
from .estimation import ImuEstimate, SumsInput
from .node import AllanNode, NodePart
from .node_settings import InputSettings, MonitorSettings, RelaySettings, WatchedImu, home_of
from .parameter_push import ParameterPush
from .relaying import ImuRelay, ModelInput
from .shell import Worker, run


class Accumulator(AllanNode):
    """Subscribes to one IMU, by default ``imu/data``; publishes ``~/sums`` and the input status."""

    def __init__(self, **options: Any) -> None:
        super().__init__('allan_accumulator', **options)
        imus = watched_imus(self)
        if len(imus) != 1:
            raise AllanError(
                f'input.topics contains {len(imus)} topics, but allan_accumulator handles one: '
                'use allan_monitor for several IMUs'
            )
        inputs = watches(self, imus[0])
        descriptions = ' and '.join(watch.description for watch in inputs)
        self.begin(inputs, f'accumulates {descriptions}')


class Estimator(AllanNode):
    """Subscribes to ``sums``; publishes ``~/noise_model``, ``~/bias`` and a status per axis."""

    def __init__(self, **options: Any) -> None:
        super().__init__('allan_estimator', **options)
        push = ParameterPush(self)
        estimate = ImuEstimate(self, '', Worker(), [push.offer])
        source = SumsInput(self, estimate.process)
        self.begin([source, estimate, push], f'estimates from the sums on {source.topic}')


class Relay(AllanNode):
    """Subscribes to ``imu/data``, ``noise_model`` and ``bias``; fills in the covariances.

    The Imu messages with covariances are published on ``imu/data_with_covariance``.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__('allan_imu_relay', **options)
        source = ModelInput(self)
        relay = ImuRelay(self, WatchedImu('imu/data'), source.topic, source.findings)
        source.listener = relay.offer
        self.begin([relay], relay.description)


class Monitor(AllanNode):
    """Runs an accumulator, an estimator and, if enabled, a relay for each topic in input.topics."""

    def __init__(self, **options: Any) -> None:
        super().__init__('allan_monitor', **options)
        self.metrics_file = self.parameters.group('monitor', MonitorSettings).value.metrics_file
        settings = self.parameters.group('input', InputSettings).value
        has_relay = self.parameters.group('relay', RelaySettings).value.enabled
        imus, worker, push = watched_imus(self), Worker(), ParameterPush(self)
        if push.node and len(imus) > 1:
            raise AllanError(
                f'push.node is set, but there are {len(imus)} IMUs: start a separate '
                f'allan_monitor for the IMU of {push.node}'
            )
        if has_relay and (settings.gyro_unit, settings.accel_unit) != ('rad/s', 'm/s^2'):
            raise AllanError(
                'relay.enabled cannot be combined with input.gyro_unit or input.accel_unit, '
                'because state estimators expect rad/s and m/s^2: convert the units in the driver'
            )
        if has_relay and any(settings.accel_topics):
            raise AllanError(
                'relay.enabled cannot be combined with input.accel_topics, because state '
                'estimators expect both sensors in each message: publish gyro and accelerometer '
                'together in the driver'
            )
        parts: list[NodePart] = []
        descriptions: list[str] = []
        for imu in imus:
            topic = self.resolve_topic_name(f'{home_of(imu.label)}noise_model')
            relays = [ImuRelay(self, imu, topic)] if has_relay else []
            listeners = [push.offer, *(relay.offer for relay in relays)]
            estimate = ImuEstimate(self, imu.label, worker, listeners)
            inputs = watches(self, imu, estimate.process)
            parts += [*inputs, estimate, *relays]
            descriptions += [watch.description for watch in inputs]
        self.begin([*parts, push], f'monitors {", ".join(descriptions)}')


NODES: dict[str, tuple[Callable[[], AllanNode], str]] = {
    'accumulator': (Accumulator, 'allan_accumulator'),
    'estimator': (Estimator, 'allan_estimator'),
    'relay': (Relay, 'allan_imu_relay'),
    'monitor': (Monitor, 'allan_monitor'),
}
"""Name of a node on the command line -> its class, and its name in ROS."""


def main(node: str, args: Sequence[str] | None = None) -> int:
    """Run one of `NODES` and return its exit code."""
    make_node, name = NODES[node]
    parser = argparse.ArgumentParser(
        prog=name,
        description=(make_node.__doc__ or '').replace('``', ''),
        epilog='Parameters are set by ROS arguments: --ros-args -p NAME:=VALUE, '
        '--params-file FILE, -r TOPIC:=OTHER. All parameters are described in '
        'config/allan_ros.yaml and by ros2 param describe.',
    )
    return run(name, lambda _stop, _options: make_node(), parser, args)
