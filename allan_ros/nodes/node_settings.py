# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the nodes: each field of a class is a ROS parameter ``<group>.<field>``.

The settings of the data selection (group ``segmenter``) are in `core.settings`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from ..core.check import MARGIN
from ..core.errors import AllanError
from ..core.fit.result import METHODS
from ..core.imu import SAMPLE_UNITS
from ..core.settings import CheckedSettings, SegmenterSettings, fixed_parameter, parameter
from ..readers.files import expanded

SETTLED_RATIO = 1.5
"""Largest ratio of the upper to the lower end of the 95 % interval of a number that is set in a
state estimator; a relay reports a larger ratio. Numbers from a short recording are upper limits,
which fall by orders of magnitude when the recording becomes longer."""


def home_of(label: str) -> str:
    """Return the prefix of the topics and services of an IMU; ``label`` is '' for a single IMU."""
    return f'~/{label}/' if label else '~/'


class WatchedImu(NamedTuple):
    """An IMU whose messages a node receives.

    ``label`` is '' for a single IMU. ``checkpoint`` is a path, or '' without a checkpoint.
    ``accel_topic`` is '' unless the accelerometer has its own topic.
    """

    topic: str
    label: str = ''
    hardware_id: str = ''
    checkpoint: str = ''
    accel_topic: str = ''

    @property
    def accel(self) -> WatchedImu:
        """The accelerometer with its own topic, as an IMU with its own label and checkpoint."""
        file = Path(self.checkpoint)
        path = str(file.with_name(f'{file.stem}_accel{file.suffix}')) if self.checkpoint else ''
        label = f'{self.label}_accel' if self.label else 'accel'
        return WatchedImu(self.accel_topic, label, self.hardware_id, path)


@dataclass(frozen=True)
class InputSettings(CheckedSettings):
    """How Imu messages are received (group ``input``)."""

    topics: tuple[str, ...] = fixed_parameter(('imu/data',), 'Imu topics to watch.')
    accel_topics: tuple[str, ...] = fixed_parameter(
        ('',),
        'Topic with the accelerometer of each IMU, if input.topics contain only gyros; the sample '
        'rates may differ; empty: input.topics contain both sensors.',
    )
    labels: tuple[str, ...] = fixed_parameter(
        ('',),
        'One short name per IMU, used in topics, files and diagnostics; empty: made from the '
        'topics if there are several IMUs.',
    )
    hardware_ids: tuple[str, ...] = fixed_parameter(
        ('',), 'One serial number per topic; empty: the frame_id is used.'
    )
    stale_after: float = parameter(
        2.0, 'Time without a message after which an error is reported.', 's', 0.1, 3600.0
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

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.topics or not all(self.topics):
            raise AllanError('input.topics contains no topic: give at least one, such as imu/data')
        for name in ('accel_topics', 'labels', 'hardware_ids'):
            entries = getattr(self, name)
            if entries != ('',) and len(entries) != len(self.topics):
                raise AllanError(
                    f'input.{name} has {len(entries)} entries for {len(self.topics)} topics: '
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
        """Return the IMU of each topic; without ``labels``, several IMUs are labeled by topic.

        ``checkpoint`` is the parameter ``checkpoint.path``: a file for one IMU, a folder for
        several, or ''.
        """
        count = len(self.topics)
        topic_labels = [t.strip('~/').replace('/', '_') if count > 1 else '' for t in self.topics]
        labels = self.labels if any(self.labels) else topic_labels
        hardware_ids = self.hardware_ids * (count if len(self.hardware_ids) == 1 else 1)
        accel_topics = self.accel_topics if any(self.accel_topics) else [''] * count
        path = expanded(checkpoint)
        files = [path if count == 1 else path / f'{label}.json' for label in labels]
        checkpoints = [str(file) if checkpoint else '' for file in files]
        return list(map(WatchedImu, self.topics, labels, hardware_ids, checkpoints, accel_topics))


@dataclass(frozen=True)
class PublishSettings(CheckedSettings):
    """How often the nodes publish (group ``publish``)."""

    sums_period: float = parameter(
        10.0,
        'Period at which Allan sums are published, and fitted if they contain enough new samples.',
        's',
        0.1,
        3600.0,
    )
    diagnostics_period: float = parameter(
        1.0, 'Period at which every diagnostic status is published.', 's', 0.1, 60.0
    )


@dataclass(frozen=True)
class CheckpointSettings(CheckedSettings):
    """Where and how often the Allan sums are saved (group ``checkpoint``)."""

    path: str = fixed_parameter(
        '',
        'Checkpoint file, or a folder for several IMUs (<label>.json in it); missing folders are '
        'created; empty: no checkpoint.',
    )
    period: float = parameter(60.0, 'Period at which the checkpoint is written.', 's', 0.5, 86400.0)


@dataclass(frozen=True)
class EstimatorSettings(CheckedSettings):
    """How Allan sums are fitted and results are compared (group ``estimator``)."""

    method: str = parameter(
        'likelihood',
        'Method that fits the five terms.',
        choices=METHODS,
    )
    growth: float = parameter(
        0.1,
        'Fit again when the number of samples of a sensor has grown by this fraction.',
        '',
        0.0,
        10.0,
    )
    sensor: str = fixed_parameter(
        '', 'Datasheet to compare with: a name in config/sensors or a file; empty: none.'
    )
    baseline: str = fixed_parameter('', 'Earlier results.json to compare with; empty: none.')
    margin: float = parameter(
        MARGIN,
        'Warn when the entire 95 % interval of a coefficient is above its limit by more than this '
        'fraction.',
        low=0.0,
        high=100.0,
    )
    motion_limit: float = parameter(
        10.0,
        'Warn when the 95 % interval of a factor in motion lies above this limit. This factor is '
        'the error in motion divided by its prediction from the noise at rest.',
        low=1.0,
        high=1e6,
    )
    recent_window: float = fixed_parameter(
        3600.0,
        'Length of the latest time window. The noise in it is compared with the earlier noise.',
        's',
        1.0,
        604800.0,
    )


@dataclass(frozen=True)
class RelaySettings(CheckedSettings):
    """How the relay fills in covariances (group ``relay``)."""

    enabled: bool = fixed_parameter(
        False,
        'Whether allan_monitor republishes each Imu message with covariances. The output topic is '
        'imu/data_with_covariance, or <topic>_with_covariance for each of several input topics.',
    )
    horizon: float = parameter(
        0.0,
        'For state estimators without a bias state: the variance is raised until it covers all '
        'drift over this time; 0: drift is not covered.',
        unit='s',
        low=0.0,
        high=1e6,
    )
    debiased: bool = parameter(
        False,
        'Do not cover the gyro bias with the variance. Set this if the driver removes the bias, or '
        'if the state estimator estimates it.',
    )
    inflate: float = parameter(
        1.0, 'Factor by which the standard deviation is multiplied.', '', 1.0, 1000.0
    )
    motion: bool = parameter(
        False,
        'Multiply the standard deviation of each sensor by its factor in motion while the IMU '
        'moves.',
    )
    overwrite: bool = parameter(False, 'Replace covariances that the driver has set.')


@dataclass(frozen=True)
class PushSettings(CheckedSettings):
    """How parameters of another node are set from the noise model (group ``push``)."""

    node: str = fixed_parameter('', 'Full name of the node whose parameters are set; empty: none.')
    filter: str = fixed_parameter(
        '',
        'File that states which numbers are set as which parameters; or a name in config/filters.',
    )
    enabled: bool = parameter(
        True,
        'Whether parameters are set; if false, the values before the first change are restored.',
    )
    max_factor: float = parameter(
        10.0,
        'A value is not set if it differs by more than this factor from the value that the '
        'parameter had before the first change.',
        low=1.0,
        high=1e6,
    )
    debiased: bool = parameter(
        False, 'Whether the driver removes the gyro bias; if true, gains are computed without it.'
    )
    period: float = parameter(
        300.0,
        'Shortest time between two changes of parameters. The values before the first change are '
        'restored without this delay.',
        's',
        0.1,
        604800.0,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.node and not (self.node.startswith('/') and self.filter):
            raise AllanError(
                f'push.node is {self.node!r}, push.filter is {self.filter!r}: give a full name '
                'such as /imu_filter_madgwick, and a filter such as imu_filter_madgwick'
            )


@dataclass(frozen=True)
class MonitorSettings(CheckedSettings):
    """Output of the monitor for the supervision of many robots (group ``monitor``)."""

    metrics_file: str = fixed_parameter(
        '',
        "File for the textfile collector of Prometheus' node exporter, such as "
        '/var/lib/node_exporter/imu.prom; empty: none.',
    )


GROUPS: dict[str, type] = {
    'input': InputSettings,
    'segmenter': SegmenterSettings,
    'publish': PublishSettings,
    'checkpoint': CheckpointSettings,
    'estimator': EstimatorSettings,
    'relay': RelaySettings,
    'push': PushSettings,
    'monitor': MonitorSettings,
}
"""Parameter group -> class of its settings."""
