# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The samples every room passes on: stamps and six axes in one array."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .errors import AllanError

AXES: tuple[str, ...] = ('gyro_x', 'gyro_y', 'gyro_z', 'accel_x', 'accel_y', 'accel_z')
"""The axes, in the order of the last dimension of every six-axis array."""

SENSORS = {'gyro': slice(0, 3), 'accel': slice(3, 6)}
"""Where each three-axis sensor stands among `AXES`."""

LARGEST = 1e30
"""Larger numbers, either way, no IMU measures; their squares, summed over years, stay finite."""

MAX_NAME = 1000
"""Longest frame_id or hardware id, in characters: what is longer is damage, or meant ill."""


@dataclass(frozen=True)
class ImuBatch:
    """A run of consecutive Imu samples, as they came.

    Attributes
    ----------
    stamps_ns : (n,) int64 array
        Header stamps in nanoseconds. Nothing is promised of them: they may repeat, go back or be 0.
    samples : (n, 6) float64 array
        Angular rate in rad/s and specific force in m/s^2, in the order of `AXES`. NaN where a
        sensor is absent (covariance[0] is -1) or a value is not a number.
    record_ns : (n,) int64 array or None
        When each sample was recorded or received, in nanoseconds; used where the header stamps
        cannot be. None when the source has no such time.
    frame_id : str
        ``header.frame_id`` of all samples of this batch; '' when the source has none.
    """

    stamps_ns: NDArray[np.int64]
    samples: NDArray[np.float64]
    record_ns: NDArray[np.int64] | None = None
    frame_id: str = ''

    def __post_init__(self) -> None:
        n = len(self.stamps_ns)
        if self.samples.shape != (n, len(AXES)):
            raise AllanError(
                f'a batch of {n} stamps needs samples of shape ({n}, {len(AXES)}), '
                f'got {self.samples.shape}: pass one row of six axes per stamp'
            )
        if len(self.frame_id) > MAX_NAME:
            raise AllanError(
                f'frame_id has {len(self.frame_id)} characters, {self.frame_id[:20]!r} ...: '
                'a name is expected'
            )
        if self.record_ns is not None and self.record_ns.shape != (n,):
            raise AllanError(
                f'a batch of {n} stamps needs {n} record times, got {self.record_ns.shape}'
            )

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __getitem__(self, rows: slice | NDArray[np.intp] | NDArray[np.bool_]) -> ImuBatch:
        """Return the rows as a batch of their own (views of a slice, copies of what is listed)."""
        record = None if self.record_ns is None else self.record_ns[rows]
        return ImuBatch(self.stamps_ns[rows], self.samples[rows], record, self.frame_id)
