# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the nodes with their defaults; those of the data selection are in core.

Every field becomes a ROS parameter ``<group>.<name>`` (see `parameters`).
"""

from __future__ import annotations

from dataclasses import dataclass

from ..core.compare import MARGIN
from ..core.errors import AllanError
from ..core.imu import SAMPLE_UNITS
from ..core.settings import CheckedSettings, SegmenterSettings, parameter


@dataclass(frozen=True)
class InputSettings(CheckedSettings):
    """How Imu messages are received (group ``input``)."""

    topics: tuple[str, ...] = parameter(('imu/data',), 'Imu topics to watch.', read_only=True)
    labels: tuple[str, ...] = parameter(
        ('',),
        'One short name per topic, for topics, files and diagnostics; may be empty for one IMU.',
        read_only=True,
    )
    hardware_ids: tuple[str, ...] = parameter(
        ('',), 'One serial number per topic; empty: the frame_id is used.', read_only=True
    )
    queue_depth: int = parameter(
        4000,
        'Messages that the middleware may queue between two drains.',
        unit='messages',
        low=1,
        high=1_000_000,
        read_only=True,
    )
    drain_period: float = parameter(
        0.1, 'How often the queue is emptied.', unit='s', low=0.005, high=1.0, read_only=True
    )
    update_period: float = parameter(
        0.5,
        'How often the drained messages are decoded and accumulated.',
        unit='s',
        low=0.005,
        high=10.0,
        read_only=True,
    )
    stale_after: float = parameter(
        2.0,
        'Silence after which the input is reported as an error.',
        unit='s',
        low=0.1,
        high=3600.0,
    )
    gyro_unit: str = parameter(
        'rad/s',
        'Unit of angular_velocity as the driver publishes it; ROS requires rad/s.',
        choices=SAMPLE_UNITS['gyro'],
        read_only=True,
    )
    accel_unit: str = parameter(
        'm/s^2',
        'Unit of linear_acceleration as the driver publishes it; ROS requires m/s^2.',
        choices=SAMPLE_UNITS['accel'],
        read_only=True,
    )
    plain_callback: bool = parameter(
        False,
        'Receive each message in a callback of its own (more CPU) instead of draining the queue.',
        read_only=True,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.topics or not all(self.topics):
            raise AllanError('input.topics names no topic: give at least one, such as imu/data')
        for name in ('labels', 'hardware_ids'):
            given = getattr(self, name)
            if given != ('',) and len(given) != len(self.topics):
                raise AllanError(
                    f'input.{name} has {len(given)} entries for {len(self.topics)} topics: '
                    'give one for each, in the same order'
                )
        wrong = [label for label in self.labels if label and not label.isidentifier()]
        if wrong:
            raise AllanError(
                f'input.labels has {wrong[0]!r}: use letters, digits and underscores, '
                'not starting with a digit'
            )
        names = [label for _, label, _ in self.imus]
        if len(set(names)) < len(names):
            raise AllanError(
                f'input.labels {", ".join(names)} are not unique: give each IMU another label'
            )

    @property
    def imus(self) -> tuple[tuple[str, str, str], ...]:
        """(topic, label, hardware id) of each IMU; missing labels are made from the topics."""
        several = len(self.topics) > 1
        made = tuple(t.strip('~/').replace('/', '_') if several else '' for t in self.topics)
        given = self.labels if any(self.labels) else made
        hardware = self.hardware_ids * (len(self.topics) if len(self.hardware_ids) == 1 else 1)
        return tuple(zip(self.topics, given, hardware))


@dataclass(frozen=True)
class PublishSettings(CheckedSettings):
    """How often the nodes publish (group ``publish``)."""

    sums_period: float = parameter(
        10.0,
        'How often the running sums are published, and checked for a change.',
        unit='s',
        low=0.1,
        high=3600.0,
    )
    diagnostics_period: float = parameter(
        1.0, 'How often every diagnostic status is repeated.', unit='s', low=0.1, high=60.0
    )


@dataclass(frozen=True)
class CheckpointSettings(CheckedSettings):
    """Where the sums are saved over restarts (group ``checkpoint``)."""

    path: str = parameter(
        '',
        'Checkpoint file, or a folder for several IMUs (<label>.json in it); missing folders are '
        'created; empty: none.',
        read_only=True,
    )
    period: float = parameter(
        60.0, 'How often the checkpoint is written.', unit='s', low=0.5, high=86400.0
    )


@dataclass(frozen=True)
class EstimatorSettings(CheckedSettings):
    """When sums are fitted and what coefficients are compared with (group ``estimator``)."""

    method: str = parameter(
        'gls', 'Method of the fit of the five terms.', choices=('gls', 'relative', 'paper')
    )
    growth: float = parameter(
        0.1, 'Refit when the samples have grown by this fraction.', low=0.0, high=10.0
    )
    sensor: str = parameter(
        '',
        'Datasheet to compare with: a name in config/sensors or a file; empty: none.',
        read_only=True,
    )
    baseline: str = parameter(
        '', 'Former results to compare with, a results.json; empty: none.', read_only=True
    )
    margin: float = parameter(
        MARGIN,
        'Warn when the complete interval exceeds the limit by more than this fraction.',
        low=0.0,
        high=100.0,
    )
    recent_window: float = parameter(
        3600.0,
        'Length of the recent window, which is compared with all the time before it.',
        unit='s',
        low=1.0,
        high=604800.0,
        read_only=True,
    )
    bias_tolerance_gyro: float = parameter(
        0.0,
        'Tolerance of the gyro bias: diagnostics show how long the bias stays within it; 0: twice '
        'its 95 % interval.',
        unit='rad/s',
        low=0.0,
        high=10.0,
        read_only=True,
    )
    bias_tolerance_accel: float = parameter(
        0.0,
        'Tolerance of the accelerometer bias; 0: twice its 95 % interval.',
        unit='m/s^2',
        low=0.0,
        high=100.0,
        read_only=True,
    )
    plot_period: float = parameter(
        10.0,
        'Shortest time between two plots of the curves; none is drawn without a subscriber.',
        unit='s',
        low=1.0,
        high=86400.0,
    )


@dataclass(frozen=True)
class RelaySettings(CheckedSettings):
    """Which covariances relayed Imu messages get (group ``relay``)."""

    enabled: bool = parameter(
        False,
        'Whether allan_monitor relays each Imu, to <topic>_with_covariance.',
        read_only=True,
    )
    until_model: str = parameter(
        'pass',
        'Messages without a noise model: pass them on unchanged, or hold them back (drop them).',
        choices=('pass', 'hold'),
    )
    variance: str = parameter(
        'white',
        'Variance to fill in: white is N^2 f, which keeps a filter consistent; sample is the '
        'variance of the samples within a second.',
        choices=('white', 'sample'),
    )
    rate: float = parameter(
        0.0,
        'Rate f of the messages if they were averaged before the relay; 0: rate of the noise '
        'model.',
        unit='Hz',
        low=0.0,
        high=1_000_000.0,
    )
    horizon: float = parameter(
        0.0,
        'For filters without a state for the bias: the white variance is raised until it covers '
        'all drift over this time; 0: white noise alone.',
        unit='s',
        low=0.0,
        high=1e6,
    )
    inflate: float = parameter(1.0, 'Factor on the standard deviation.', low=1.0, high=1000.0)
    subtract_bias: bool = parameter(
        False,
        'Subtract the gyro bias on the topic bias from the angular velocity while the IMU is at '
        'rest and the bias is fresh.',
    )
    bias_max_age: float = parameter(
        60.0,
        'Older biases are not subtracted.',
        unit='s',
        low=1.0,
        high=86400.0,
    )
    bias_rate_limit: float = parameter(
        0.05,
        'No bias is subtracted from a message whose angular velocity differs from it by more.',
        unit='rad/s',
        low=1e-4,
        high=10.0,
    )
    overwrite: bool = parameter(False, 'Replace covariances that the driver has set.')
    queue_depth: int = parameter(
        1000,
        'Messages that the middleware may queue at input and output.',
        unit='messages',
        low=1,
        high=1_000_000,
        read_only=True,
    )
    plain_callback: bool = parameter(
        False,
        'Receive each message in a callback of the executor (more CPU) instead of in a thread.',
        read_only=True,
    )


@dataclass(frozen=True)
class PushSettings(CheckedSettings):
    """Which parameters of another node follow the coefficients (group ``push``)."""

    node: str = parameter(
        '', 'Full name of the node whose parameters are set; empty: none.', read_only=True
    )
    filter: str = parameter(
        '',
        'Mapping: a name in config/filters, or a file.',
        read_only=True,
    )
    enabled: bool = parameter(
        True, 'Whether parameters are set; ~/restore restores the former values and turns it off.'
    )
    ratio: float = parameter(
        1.5,
        'A value is set once the ratio of the ends of its 95 % interval is at most this.',
        low=1.0,
        high=1000.0,
    )
    period: float = parameter(
        300.0, 'Shortest time between two settings.', unit='s', low=0.1, high=604800.0
    )
    change: float = parameter(
        0.1, 'A value is set again when it differs by more than this fraction.', low=0.0, high=10.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.node and not (self.node.startswith('/') and self.filter):
            raise AllanError(
                f'push.node is {self.node!r}, push.filter {self.filter!r}: give a full name such '
                'as /imu_filter_madgwick, and the mapping'
            )


GROUPS: dict[str, type] = {
    'input': InputSettings,
    'segmenter': SegmenterSettings,
    'publish': PublishSettings,
    'checkpoint': CheckpointSettings,
    'estimator': EstimatorSettings,
    'relay': RelaySettings,
    'push': PushSettings,
}
"""Parameter group -> its settings."""
