# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Types used by all readers: the options, and a recording of an IMU as a stream of `ImuBatch`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

from ...core.findings import Finding
from ...core.imu import AXES, SAMPLE_SI, SAMPLE_UNITS, STAMP_UNITS, ImuBatch, sample_factors
from ...core.settings import check, parameter
from ..signal import TemperatureTrace

BATCH = 32768
"""Samples per batch: so many that the cost per batch is negligible, and so few that they fit into
the cache."""

Report = Callable[[Finding], None]
"""Receives the findings of a reader."""


@dataclass(frozen=True)
class ReadOptions:
    """Options for reading: information that the recording itself does not contain."""

    topic: str = parameter('', 'Imu topic of a bag, or instance of a log; empty: the only one')
    columns: tuple[str, ...] = parameter(
        (),
        'columns of a table: a name for each (- leaves one out), or gx=NAME,gy=NAME,... for '
        'columns picked by their names in the header',
    )
    rate_hz: float = parameter(
        0.0, 'sample rate of a table or array without stamps; 0: not given', unit='Hz', low=0.0
    )
    gyro_unit: str = parameter(
        '',
        'unit of the angular rate; empty: as stated in the recording, else rad/s',
        choices=('', *SAMPLE_UNITS['gyro']),
    )
    accel_unit: str = parameter(
        '',
        'unit of the acceleration; empty: as stated in the recording, else m/s^2',
        choices=('', *SAMPLE_UNITS['accel']),
    )
    stamp_unit: str = parameter(
        's', 'unit of the stamp column of a table or array', choices=tuple(STAMP_UNITS)
    )
    trust_covariance: bool = parameter(
        False, 'treat a sensor as absent wherever covariance[0] is -1 or NaN, even with valid data'
    )

    def __post_init__(self) -> None:
        check(self)

    def in_si(self, batch: ImuBatch) -> ImuBatch:
        """Return samples, given in the units of the options, in SI."""
        known = self.with_units()
        factors = sample_factors(known.gyro_unit, known.accel_unit)
        if (factors == 1.0).all():
            return batch
        return replace(batch, samples=batch.samples * factors)

    def with_units(self, found: Mapping[str, str] = {}) -> ReadOptions:
        """Return the options with units per sensor: those found, else those given, else SI."""
        gyro = found.get('gyro') or self.gyro_unit or SAMPLE_SI['gyro']
        accel = found.get('accel') or self.accel_unit or SAMPLE_SI['accel']
        return replace(self, gyro_unit=gyro, accel_unit=accel)


@dataclass(frozen=True)
class SourceInfo:
    """Source of samples: the given path, and the topic, message type and storage format."""

    path: str
    topic: str
    type: str
    storage: str


def in_batches(whole: ImuBatch) -> Iterator[ImuBatch]:
    """Yield the samples in parts of at most `BATCH` (views)."""
    for first in range(0, len(whole), BATCH):
        yield whole[first : first + BATCH]


class Recording:
    """One recording, which can be read any number of times.

    ``messages`` is the number of samples that the recording states, or None. ``options`` are the
    options in effect, with the units that were found or assumed. ``axes`` are the possible axes.
    """

    def __init__(
        self,
        info: SourceInfo,
        messages: int | None,
        read: Callable[[Report], Iterator[ImuBatch]],
        read_temperature: Callable[[str], TemperatureTrace | None] = lambda frame_id: None,
        options: ReadOptions = ReadOptions(),
        axes: tuple[str, ...] = AXES,
    ) -> None:
        self.info = info
        self.axes = axes
        self.messages = messages
        self.options = options.with_units()
        self._read = read
        self._read_temperature = read_temperature
        self._findings: list[Finding] = []

    def batches(self) -> Iterator[ImuBatch]:
        """Yield the samples in order, about `BATCH` at a time, with one frame_id per batch.

        Raises AllanError when a part of the recording cannot be read.
        """
        self._findings = []
        yield from self._read(self._findings.append)

    def temperature(self, frame_id: str) -> TemperatureTrace | None:
        """Return the temperature of the IMU with the given frame_id, or None if there is none.

        This reads the recording again.
        """
        return self._read_temperature(frame_id)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of the last reading; complete after the last batch."""
        return tuple(self._findings)
