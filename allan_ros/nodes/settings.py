# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the nodes with their defaults; the settings of the data selection are in core.

Every field becomes a ROS parameter ``<group>.<name>`` (see `parameters`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from ..core.compare import MARGIN
from ..core.errors import AllanError
from ..core.imu import SAMPLE_UNITS
from ..core.settings import CheckedSettings, SegmenterSettings, fixed_parameter, parameter


class WatchedImu(NamedTuple):
    """One IMU: topic, label if there are several, serial number and checkpoint if given."""

    topic: str
    label: str
    hardware_id: str
    checkpoint: str


@dataclass(frozen=True)
class InputSettings(CheckedSettings):
    """How Imu messages are received (group ``input``)."""

    topics: tuple[str, ...] = fixed_parameter(('imu/data',), 'Imu topics to watch.')
    labels: tuple[str, ...] = fixed_parameter(
        ('',),
        'One short name per topic, for topics, files and diagnostics; may be empty for one IMU.',
    )
    hardware_ids: tuple[str, ...] = fixed_parameter(
        ('',), 'One serial number per topic; empty: the frame_id is used.'
    )
    queue_depth: int = fixed_parameter(
        4000, 'Messages that the middleware may queue between two drains.', 'messages', 1, 1_000_000
    )
    drain_period: float = fixed_parameter(0.1, 'How often the queue is emptied.', 's', 0.005, 1.0)
    update_period: float = fixed_parameter(
        0.5, 'How often the drained messages are decoded and accumulated.', 's', 0.005, 10.0
    )
    stale_after: float = parameter(
        2.0, 'Silence after which the input is reported as an error.', 's', 0.1, 3600.0
    )
    gyro_unit: str = fixed_parameter(
        'rad/s',
        'Unit of angular_velocity as the driver publishes it; ROS requires rad/s.',
        choices=SAMPLE_UNITS['gyro'],
    )
    accel_unit: str = fixed_parameter(
        'm/s^2',
        'Unit of linear_acceleration as the driver publishes it; ROS requires m/s^2.',
        choices=SAMPLE_UNITS['accel'],
    )
    plain_callback: bool = fixed_parameter(
        False,
        'Receive each message in a callback (more CPU) instead of draining the queue.',
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.topics or not all(self.topics):
            raise AllanError('input.topics contains no topic: give at least one, such as imu/data')
        for name in ('labels', 'hardware_ids'):
            given = getattr(self, name)
            if given != ('',) and len(given) != len(self.topics):
                raise AllanError(
                    f'input.{name} has {len(given)} entries for {len(self.topics)} topics: '
                    'give one for each, in the same order'
                )
        for label in self.labels:
            if label and not label.isidentifier():
                raise AllanError(
                    f'input.labels has {label!r}: use letters, digits and underscores, '
                    'not starting with a digit'
                )
        names = [imu.label for imu in self.imus()]
        if len(set(names)) < len(names):
            raise AllanError(
                f'input.labels {", ".join(names)} are not unique: give each IMU another label'
            )

    def imus(self, checkpoint: str = '') -> list[WatchedImu]:
        """Return the IMUs; the checkpoints of several IMUs are in one folder, '' for none.

        Missing labels are derived from the topics.
        """
        count = len(self.topics)
        made = [t.strip('~/').replace('/', '_') if count > 1 else '' for t in self.topics]
        labels = self.labels if any(self.labels) else made
        hardware_ids = self.hardware_ids * (count if len(self.hardware_ids) == 1 else 1)
        path = Path(checkpoint).expanduser()
        files = [path if count == 1 else path / f'{label}.json' for label in labels]
        files_or_none = [str(file) if checkpoint else '' for file in files]
        return list(map(WatchedImu, self.topics, labels, hardware_ids, files_or_none))


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
        1.0, 'How often every diagnostic status is repeated.', 's', 0.1, 60.0
    )


@dataclass(frozen=True)
class CheckpointSettings(CheckedSettings):
    """Where and how often the sums are saved (group ``checkpoint``)."""

    path: str = fixed_parameter(
        '',
        'Checkpoint file, or a folder for several IMUs (<label>.json in it); missing folders are '
        'created; empty: none.',
    )
    period: float = parameter(60.0, 'How often the checkpoint is written.', 's', 0.5, 86400.0)


@dataclass(frozen=True)
class EstimatorSettings(CheckedSettings):
    """How often the sums are fitted, and the reference of comparisons (group ``estimator``)."""

    method: str = parameter(
        'gls', 'Method of the fit of the five terms.', choices=('gls', 'relative', 'paper')
    )
    growth: float = parameter(
        0.1, 'Refit when the samples have grown by this fraction.', '', 0.0, 10.0
    )
    sensor: str = fixed_parameter(
        '', 'Datasheet to compare with: a name in config/sensors or a file; empty: none.'
    )
    baseline: str = fixed_parameter(
        '', 'Earlier results to compare with, a results.json; empty: none.'
    )
    margin: float = parameter(
        MARGIN,
        'Warn when the complete interval exceeds the limit by more than this fraction.',
        low=0.0,
        high=100.0,
    )
    recent_window: float = fixed_parameter(
        3600.0,
        'Length of the recent window, which is compared with all earlier data.',
        unit='s',
        low=1.0,
        high=604800.0,
    )
    bias_tolerance_gyro: float = fixed_parameter(
        0.0,
        'Tolerance of the gyro bias: diagnostics show how long the bias stays within it; 0: twice '
        'its 95 % interval.',
        unit='rad/s',
        low=0.0,
        high=10.0,
    )
    bias_tolerance_accel: float = fixed_parameter(
        0.0, 'Tolerance of the accelerometer bias; 0: twice its 95 % interval.', 'm/s^2', 0.0, 100.0
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
    """How covariances are filled in by the relay (group ``relay``)."""

    enabled: bool = fixed_parameter(
        False, 'Whether allan_monitor relays each Imu, to <topic>_with_covariance.'
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
    inflate: float = parameter(1.0, 'Factor on the standard deviation.', '', 1.0, 1000.0)
    subtract_bias: bool = parameter(
        False,
        'Subtract the gyro bias on the topic bias from the angular velocity while the IMU is at '
        'rest and the bias is fresh.',
    )
    bias_max_age: float = parameter(
        60.0, 'Largest age of a bias that is subtracted.', 's', 1.0, 86400.0
    )
    bias_rate_limit: float = parameter(
        0.05,
        'Largest difference of angular velocity and bias at which the bias is subtracted.',
        unit='rad/s',
        low=1e-4,
        high=10.0,
    )
    overwrite: bool = parameter(False, 'Replace covariances that the driver has set.')
    queue_depth: int = fixed_parameter(
        1000,
        'Messages that the middleware may queue at input and output.',
        unit='messages',
        low=1,
        high=1_000_000,
    )
    plain_callback: bool = fixed_parameter(
        False,
        'Receive each message in a callback of the executor (more CPU) instead of in a thread.',
    )


@dataclass(frozen=True)
class PushSettings(CheckedSettings):
    """How parameters of another node are set to measured values (group ``push``)."""

    node: str = fixed_parameter('', 'Full name of the node whose parameters are set; empty: none.')
    filter: str = fixed_parameter('', 'Mapping: a name in config/filters, or a file.')
    enabled: bool = parameter(
        True, 'Whether parameters are set; ~/restore restores the previous values and turns it off.'
    )
    ratio: float = parameter(
        1.5,
        'A value is set once the ratio of the ends of its 95 % interval is at most this.',
        low=1.0,
        high=1000.0,
    )
    period: float = parameter(300.0, 'Shortest time between two settings.', 's', 0.1, 604800.0)
    change: float = parameter(
        0.1, 'A value is set again when it differs by more than this fraction.', '', 0.0, 10.0
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
