# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What every reader returns: a recording of an IMU as a stream of `ImuBatch`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ...core.findings import Finding
from ...core.imu import ImuBatch
from ...core.settings import check, parameter
from ..signal import TemperatureTrace

BATCH = 32768
"""Samples a batch: enough to forget the cost of a batch, few enough to stay in the cache."""


STANDARD_GRAVITY = 9.80665
"""m/s^2 in one g (3rd CGPM, 1901)."""

GYRO_UNITS = {
    'rad/s': 1.0,
    'mrad/s': 1e-3,
    'deg/s': np.pi / 180,
    'mdeg/s': np.pi / 180e3,
    'deg/h': np.pi / 180 / 3600,
}
"""Unit -> its size in rad/s."""

ACCEL_UNITS = {'m/s^2': 1.0, 'g': STANDARD_GRAVITY, 'mg': STANDARD_GRAVITY / 1e3}
"""Unit -> its size in m/s^2."""

STAMP_UNITS = {'s': 10**9, 'ms': 10**6, 'us': 10**3, 'ns': 1}
"""Unit -> its size in nanoseconds."""


Report = Callable[[Finding], None]
"""Where a reader says what it found on its way."""


@dataclass(frozen=True)
class ReadOptions:
    """How to read what the recording itself does not say."""

    topic: str = parameter('', 'the Imu topic of a bag; empty: the only one there is')
    columns: tuple[str, ...] = parameter(
        (), 'names of the columns of a table without a header, - for one to leave out'
    )
    rate_hz: float = parameter(
        0.0, 'sample rate of a table or array without stamps; 0: not given', unit='Hz', low=0.0
    )
    gyro_unit: str = parameter(
        'rad/s', 'unit of the gyro columns of a table or array', choices=tuple(GYRO_UNITS)
    )
    accel_unit: str = parameter(
        'm/s^2', 'unit of the accel columns of a table or array', choices=tuple(ACCEL_UNITS)
    )
    stamp_unit: str = parameter(
        's', 'unit of the stamp column of a table or array', choices=tuple(STAMP_UNITS)
    )

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class SourceInfo:
    """Where samples came from: a path as it was given, and the topic, type and storage inside."""

    path: str
    topic: str
    type: str
    storage: str


class Recording:
    """One recording, ready to be streamed as often as wanted.

    Attributes
    ----------
    info : SourceInfo
    messages : int or None
        How many samples the recording says it holds; None when only reading it can tell.
    """

    def __init__(
        self,
        info: SourceInfo,
        messages: int | None,
        read: Callable[[Report], Iterator[ImuBatch]],
        read_temperature: Callable[[str], TemperatureTrace | None] = lambda frame_id: None,
    ) -> None:
        self.info = info
        self.messages = messages
        self._read = read
        self._read_temperature = read_temperature
        self._findings: list[Finding] = []

    def batches(self) -> Iterator[ImuBatch]:
        """Yield the samples in order, about `BATCH` at a time, one frame_id a batch.

        Raises
        ------
        AllanError
            When the recording turns out to be unreadable on the way.
        """
        self._findings = []
        yield from self._read(self._findings.append)

    def temperature(self, frame_id: str) -> TemperatureTrace | None:
        """Return the temperature of the IMU with that frame_id, if there is one beside it.

        The recording is read once more for it.
        """
        return self._read_temperature(frame_id)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was found while reading; complete after the last batch."""
        return tuple(self._findings)
