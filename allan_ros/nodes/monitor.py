# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan_monitor`, and the three nodes that it combines: accumulator, estimator and relay.

Each node is a list of parts. The monitor has the parts of all three nodes for each of its IMUs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Any

from ..core.errors import AllanError
from .accumulation import AccumulatorParameters, watches
from .estimation import ImuEstimate, SumsInput, load_references
from .node import AllanNode, Part
from .parameter_push import ParameterPush
from .relaying import ImuRelay, RelayTopics
from .settings import EstimatorSettings, MonitorSettings, RelaySettings
from .shell import Worker, run


class Accumulator(AllanNode):
    """Subscribes to ``imu/data``; publishes ``~/sums`` and the status of its input."""

    def __init__(self, **options: Any) -> None:
        super().__init__('allan_accumulator', **options)
        settings = AccumulatorParameters(self)
        imus = settings.imus()
        if len(imus) != 1:
            raise AllanError(
                f'input.topics contains {len(imus)} topics, but allan_accumulator handles one: '
                'use allan_monitor for several IMUs'
            )
        inputs = watches(self, imus[0], settings)
        described = ' and '.join(watch.description for watch in inputs)
        self.begin(inputs, f'accumulates {described}', settings.input.value.drain_period)


class Estimator(AllanNode):
    """Subscribes to ``sums``; publishes ``~/noise_model`` and one diagnostic status per axis."""

    def __init__(self, **options: Any) -> None:
        super().__init__('allan_estimator', **options)
        settings = self.parameters.group('estimator', EstimatorSettings)
        references = load_references(settings.value)
        push = ParameterPush(self)
        estimate = ImuEstimate(self, '', settings, references, Worker(), push.offer)
        source = SumsInput(self, estimate.process)
        self.begin([source, estimate, push], f'estimates from the sums on {source.topic}')


class Relay(AllanNode):
    """Subscribes to ``imu/data`` and ``noise_model``; publishes ``imu/data_with_covariance``."""

    def __init__(self, **options: Any) -> None:
        super().__init__('allan_imu_relay', **options)
        topics = RelayTopics('imu/data', 'noise_model', 'imu/data_with_covariance')
        relay = ImuRelay(self, topics, self.parameters.group('relay', RelaySettings))
        self.begin([relay], relay.description)


class Monitor(AllanNode):
    """Runs an accumulator, an estimator and, if enabled, a relay for each of ``input.topics``."""

    def __init__(self, **options: Any) -> None:
        super().__init__('allan_monitor', **options)
        self.metrics_file = self.parameters.group('monitor', MonitorSettings).value.metrics_file
        settings = AccumulatorParameters(self)
        estimator = self.parameters.group('estimator', EstimatorSettings)
        references, worker = load_references(estimator.value), Worker()
        relay = self.parameters.group('relay', RelaySettings)
        push = ParameterPush(self)
        imus = settings.imus()
        if push.node and len(imus) > 1:
            raise AllanError(
                f'push.node is set, but there are {len(imus)} IMUs: start a separate '
                f'allan_monitor for the IMU of {push.node}'
            )
        units = settings.input.value
        if relay.value.enabled and (units.gyro_unit, units.accel_unit) != ('rad/s', 'm/s^2'):
            raise AllanError(
                'relay.enabled excludes input.gyro_unit and input.accel_unit, because filters '
                'expect rad/s and m/s^2: convert the units in the driver'
            )
        if relay.value.enabled and any(units.accel_topics):
            raise AllanError(
                'relay.enabled excludes input.accel_topics, because filters expect both sensors in '
                'each message: unite them in the driver'
            )
        parts: list[Part] = []
        described: list[str] = []
        for imu in imus:
            estimate = ImuEstimate(self, imu.label, estimator, references, worker, push.offer)
            inputs = watches(self, imu, settings, estimate.process)
            parts += [*inputs, estimate]
            described += [watch.description for watch in inputs]
            if relay.value.enabled:
                home = f'~/{imu.label}' if imu.label else '~'
                model, bias = f'{home}/noise_model', f'{home}/bias'
                sink = f'{imu.topic}_with_covariance'
                topics = RelayTopics(imu.topic, model, sink, imu.label, imu.hardware_id, bias)
                parts.append(ImuRelay(self, topics, relay))
        purpose = f'monitors {", ".join(described)}'
        self.begin([*parts, push], purpose, settings.input.value.drain_period)


def _executable(make: Callable[[], AllanNode], name: str, purpose: str) -> Callable[..., int]:
    """Return the main function of a node that is configured only by ROS arguments."""

    def main(args: Sequence[str] | None = None) -> int:
        parser = argparse.ArgumentParser(
            prog=name,
            description=purpose,
            epilog='Parameters are set by ROS arguments: --ros-args -p NAME:=VALUE, '
            '--params-file FILE, -r TOPIC:=OTHER. All parameters: config/allan_ros.yaml, or '
            'ros2 param describe.',
        )
        return run(name, lambda _stop, _options: make(), parser, args)

    return main


accumulator = _executable(Accumulator, 'allan_accumulator', 'Accumulate the Allan sums of one IMU.')
estimator = _executable(
    Estimator,
    'allan_estimator',
    'Estimate noise coefficients from the sums of an allan_accumulator.',
)
relay = _executable(
    Relay, 'allan_imu_relay', 'Republish an Imu topic with covariances from its noise model.'
)
main = _executable(
    Monitor,
    'allan_monitor',
    'Accumulate the Allan sums of one or several IMUs, estimate their noise coefficients on '
    '/diagnostics, and relay them with covariances if relay.enabled is true.',
)

if __name__ == '__main__':
    sys.exit(main())
