# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of an IMU, the names of its axes, and units of measurement.

All computations are in SI. Units of datasheets are used only for input and output.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import AllanError, one_line

Stamps = NDArray[np.int64]
Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int32]

AXES: tuple[str, ...] = ('gyro_x', 'gyro_y', 'gyro_z', 'accel_x', 'accel_y', 'accel_z')
"""The axes, in the order of the columns of six-axis samples and of the rows of `ImuBatch.rows`."""

SENSORS = {'gyro': slice(0, 3), 'accel': slice(3, 6)}
"""Sensor -> slice of its axes in `AXES`."""

LARGEST = 1e30
"""Largest magnitude of a sample in SI. No IMU measures larger values, and the sum of the squares of
such samples over years is a finite float64."""

MAX_NAME = 1000
"""Largest number of characters in a frame_id or hardware id. Longer names indicate corruption or an
attack."""


@dataclass(frozen=True, eq=False)
class ImuBatch:
    """Samples of an IMU with their stamps.

    A reader yields batches of six axes. The batches of `SampleClock` and of later processing stages
    contain evenly spaced samples, whose stamps may still scatter. These batches have neither record
    times nor a frame_id, and may contain only some of the axes.

    Attributes
    ----------
    stamps_ns : (n,) int64 array
        Stamps in nanoseconds. The header stamps may repeat, go back or be 0.
    samples : (n, axes) float64 array
        Angular rate in rad/s and specific force in m/s^2, in the order of `AXES`. A value is NaN
        if it is missing, for example because the source contains only one of the sensors.
    record_ns : (n,) int64 array or None
        Times in nanoseconds at which the samples were recorded or received. They are used if the
        header stamps are unusable. None if these times are unknown.
    frame_id : str
        ``header.frame_id`` of the samples, or another name of the IMU in the source; '' if unknown.
    cut : str
        Reason for the gap between the previous batch and this batch; '' if no gap is known.
    filled : (axes, n) int32 array or None
        0 for measured values. For replaced values, the number of samples over which the signal was
        averaged before and after the replaced stretch (see `core.allan.replaced_stretches`). None
        means that all values are measured.

    Raises
    ------
    AllanError
        When ``stamps_ns`` or ``record_ns`` is not (n,), when ``samples`` does not have n rows and
        at most six columns, or when ``frame_id`` is longer than `MAX_NAME` characters.
    """

    stamps_ns: NDArray[np.int64]
    samples: NDArray[np.float64]
    record_ns: NDArray[np.int64] | None = None
    frame_id: str = ''
    cut: str = ''
    filled: Ints | None = None

    def __post_init__(self) -> None:
        n = self.stamps_ns.size
        is_table = self.stamps_ns.ndim == 1 and self.samples.ndim == 2
        if not is_table or len(self.samples) != n or self.samples.shape[1] > len(AXES):
            raise AllanError(
                f'a batch of {n} stamps needs samples of shape ({n}, {len(AXES)}), '
                f'got {self.samples.shape}: pass one row of six axes per stamp'
            )
        if len(self.frame_id) > MAX_NAME:
            raise AllanError(
                f'frame_id has {len(self.frame_id)} characters, {self.frame_id[:20]!r} ...: '
                'a short name is expected'
            )
        if self.record_ns is not None and self.record_ns.shape != (n,):
            raise AllanError(
                f'a batch of {n} stamps needs {n} record times, got {self.record_ns.shape}'
            )

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @classmethod
    def of_rows(
        cls, stamps_ns: Stamps, rows: Floats, cut: str = '', filled: Ints | None = None
    ) -> ImuBatch:
        """Return a batch of ``rows``, (axes, n), the samples of each axis in one row.

        The samples are not copied.

        >>> import numpy as np
        >>> ImuBatch.of_rows(np.arange(3), np.zeros((6, 3))).samples.shape
        (3, 6)
        """
        return cls(stamps_ns, rows.T, None, '', cut, filled)

    @classmethod
    def empty(cls, axes: int) -> ImuBatch:
        """Return a batch without samples, with the given number of axes."""
        return cls(np.empty(0, np.int64), np.empty((0, axes)))

    @property
    def rows(self) -> Floats:
        """View of the samples with one row per axis, (axes, n)."""
        return self.samples.T

    def __getitem__(self, which: slice | NDArray[np.intp] | Flags) -> ImuBatch:
        """Return the selected samples as a batch with an empty ``cut``, as `part` does."""
        return self.part(which)

    def part(self, which: slice | NDArray[np.intp] | Flags, cut: str = '') -> ImuBatch:
        """Return the selected samples as a batch; ``cut`` is the reason for a gap before them.

        ``which`` is a slice, an array of indices, (k,), or an array of flags, (n,). A slice
        returns views of the arrays, other selections return copies.
        """
        record_ns = None if self.record_ns is None else self.record_ns[which]
        filled = None if self.filled is None else self.filled[:, which]
        rows = self.samples.T[:, which]  # the samples of an axis stay contiguous in memory
        return ImuBatch(self.stamps_ns[which], rows.T, record_ns, self.frame_id, cut, filled)

    def copy(self) -> ImuBatch:
        """Return a copy of the batch; the samples of each axis are contiguous in memory."""
        return joined([self], copy=True)


def joined(batches: Sequence[ImuBatch], copy: bool = False) -> ImuBatch:
    """Return one batch with the samples of one or more consecutive batches.

    Batches without samples are ignored. Of the other batches, the result has the ``cut`` of the
    first batch and the frame_id of the last batch. The record times are None unless all of these
    batches have record times. If only one batch has samples, the result is this batch itself, and
    if no batch has samples, the first batch itself; with ``copy``, a copy of this batch. In other
    results and in copies, the samples of each axis are contiguous in memory.
    """
    parts = [part for part in batches if len(part)] or list(batches[:1])
    if len(parts) == 1 and not copy:
        return parts[0]
    records = [part.record_ns for part in parts if part.record_ns is not None]
    filled = None
    if any(part.filled is not None for part in parts):
        filled_of_parts = [
            np.zeros(p.rows.shape, np.int32) if p.filled is None else p.filled for p in parts
        ]
        filled = np.concatenate(filled_of_parts, axis=1)
    rows = np.empty((parts[0].samples.shape[1], sum(map(len, parts))))
    np.concatenate([part.rows for part in parts], axis=1, out=rows)
    return ImuBatch(
        np.concatenate([part.stamps_ns for part in parts]),
        rows.T,
        np.concatenate(records) if len(records) == len(parts) else None,
        parts[-1].frame_id,
        parts[0].cut,
        filled,
    )


DEGREE = math.pi / 180.0
"""One degree in rad."""

HOUR = 3600.0
"""Seconds in an hour."""

NANOSECONDS = 10**9
"""Nanoseconds in a second."""

STANDARD_GRAVITY = 9.80665
"""Standard acceleration of free fall in m/s^2 (BIPM, The International System of Units, 9th ed.,
2019)."""

MICRO_G = STANDARD_GRAVITY * 1e-6
"""One millionth of standard gravity in m/s^2."""


LONGEST_S = 2**63 / NANOSECONDS
"""Longest time in s that an int64 stamp in ns can represent: 292 years."""


class Unit(NamedTuple):
    """A unit of measurement: its SI unit, and the factor that converts values to the SI unit."""

    si: str
    factor: float


SI_UNITS = {
    'gyro': {
        'Q': 'rad',
        'N': 'rad/s/sqrt(Hz)',
        'B': 'rad/s',
        'K': 'rad/s^2/sqrt(Hz)',
        'R': 'rad/s^2',
    },
    'accel': {
        'Q': 'm/s',
        'N': 'm/s^2/sqrt(Hz)',
        'B': 'm/s^2',
        'K': 'm/s^3/sqrt(Hz)',
        'R': 'm/s^3',
    },
}
"""Sensor -> term -> SI unit. The Allan deviation has the unit of B."""

DATASHEET_UNITS = {
    'gyro': {'Q': 'urad', 'N': 'deg/sqrt(h)', 'B': 'deg/h', 'K': 'deg/h^1.5', 'R': 'deg/h^2'},
    'accel': {'Q': 'um/s', 'N': 'm/s/sqrt(h)', 'B': 'ug', 'K': 'ug/sqrt(h)', 'R': 'ug/h'},
}
"""Sensor -> term -> unit in datasheets. Cong et al. 2019 use the same units for gyros."""

UNITS = {
    'rad': Unit('rad', 1.0),
    'urad': Unit('rad', 1e-6),
    'deg': Unit('rad', DEGREE),
    'rad/s/sqrt(Hz)': Unit('rad/s/sqrt(Hz)', 1.0),
    'rad/sqrt(s)': Unit('rad/s/sqrt(Hz)', 1.0),
    'deg/s/sqrt(Hz)': Unit('rad/s/sqrt(Hz)', DEGREE),
    'mdeg/s/sqrt(Hz)': Unit('rad/s/sqrt(Hz)', 1e-3 * DEGREE),
    'deg/h/sqrt(Hz)': Unit('rad/s/sqrt(Hz)', DEGREE / HOUR),
    'deg/sqrt(h)': Unit('rad/s/sqrt(Hz)', DEGREE / math.sqrt(HOUR)),
    'rad/s': Unit('rad/s', 1.0),
    'deg/s': Unit('rad/s', DEGREE),
    'deg/h': Unit('rad/s', DEGREE / HOUR),
    'mrad/s': Unit('rad/s', 1e-3),
    'mdeg/s': Unit('rad/s', 1e-3 * DEGREE),
    'rad/s^2/sqrt(Hz)': Unit('rad/s^2/sqrt(Hz)', 1.0),
    'rad/s/sqrt(s)': Unit('rad/s^2/sqrt(Hz)', 1.0),
    'deg/h^1.5': Unit('rad/s^2/sqrt(Hz)', DEGREE / HOUR**1.5),
    'rad/s^2': Unit('rad/s^2', 1.0),
    'deg/h^2': Unit('rad/s^2', DEGREE / HOUR**2),
    'm/s': Unit('m/s', 1.0),
    'um/s': Unit('m/s', 1e-6),
    'm/s^2/sqrt(Hz)': Unit('m/s^2/sqrt(Hz)', 1.0),
    'm/s/sqrt(s)': Unit('m/s^2/sqrt(Hz)', 1.0),
    'm/s/sqrt(h)': Unit('m/s^2/sqrt(Hz)', 1.0 / math.sqrt(HOUR)),
    'mg/sqrt(Hz)': Unit('m/s^2/sqrt(Hz)', 1e3 * MICRO_G),
    'ug/sqrt(Hz)': Unit('m/s^2/sqrt(Hz)', MICRO_G),
    'm/s^2': Unit('m/s^2', 1.0),
    'um/s^2': Unit('m/s^2', 1e-6),
    'g': Unit('m/s^2', STANDARD_GRAVITY),
    'mg': Unit('m/s^2', 1e3 * MICRO_G),
    'ug': Unit('m/s^2', MICRO_G),
    'mGal': Unit('m/s^2', 1e-5),
    'm/s^3/sqrt(Hz)': Unit('m/s^3/sqrt(Hz)', 1.0),
    'm/s^2/sqrt(s)': Unit('m/s^3/sqrt(Hz)', 1.0),
    'ug/sqrt(h)': Unit('m/s^3/sqrt(Hz)', MICRO_G / math.sqrt(HOUR)),
    'm/s^3': Unit('m/s^3', 1.0),
    'ug/h': Unit('m/s^3', MICRO_G / HOUR),
}
"""Name of a unit -> its SI unit and factor."""

SHOWN_UNITS = {
    'deg/h': {
        'gyro': {**DATASHEET_UNITS['gyro'], 'signal': 'deg/s', 'density': 'deg/s/sqrt(Hz)'},
        'accel': {**DATASHEET_UNITS['accel'], 'signal': 'mg', 'density': 'ug/sqrt(Hz)'},
    },
    'SI': {
        sensor: {**units, 'signal': units['B'], 'density': units['N']}
        for sensor, units in SI_UNITS.items()
    },
}
"""System of units ('deg/h' or 'SI') -> sensor -> quantity -> unit. A quantity is a term (Q, N, B, K
or R), the samples ('signal'), or the square root of their power spectral density ('density')."""


class ShownUnit(NamedTuple):
    """A unit of the output, and the factor that converts an SI value to this unit."""

    name: str
    factor: float


def shown_unit(axis: str, quantity: str, units: str) -> ShownUnit:
    """Return the unit in which a quantity of an axis or sensor is printed.

    Parameters
    ----------
    axis : str
        Name of an axis or of a sensor.
    quantity : str
        A term such as 'N', 'signal' or 'density'. The Allan deviation has the unit of 'B'.
    units : str
        'deg/h' or 'SI'.

    Raises
    ------
    KeyError
        When the sensor, the quantity or the system of units is unknown.
    """
    unit = SHOWN_UNITS[units][sensor_of(axis)][quantity]
    return ShownUnit(unit, 1.0 / UNITS[unit].factor)


SAMPLE_SI = {sensor: units['B'] for sensor, units in SI_UNITS.items()}
"""Sensor -> SI unit of its samples."""

SAMPLE_UNITS = {
    'gyro': ('rad/s', 'mrad/s', 'deg/s', 'mdeg/s', 'deg/h'),
    'accel': ('m/s^2', 'g', 'mg'),
}
"""Sensor -> units that recordings and drivers use for its samples."""

STAMP_UNITS = {
    's': NANOSECONDS, 'ms': 10**6, 'us': 10**3, 'ns': 1,
    'min': 60 * NANOSECONDS, 'h': 3600 * NANOSECONDS, 'd': 86_400 * NANOSECONDS,
}  # fmt: skip
"""Unit of a stamp -> its size in nanoseconds."""

EPOCH_S = (9.4e8, 4.2e9)
"""Range of stamps in s that are recognized as times since 1970: the years 1999 to 2103. Smaller
stamps count from the start of a machine or a simulation."""


def even_stamps(first: int, count: int, rate: float) -> NDArray[np.int64]:
    """Return the stamps in ns of evenly spaced samples, (count,).

    Parameters
    ----------
    first : int
        Index of the first sample; the sample with index 0 has the stamp 0.
    count : int
        Number of samples.
    rate : float
        Sample rate in Hz, above 0.

    Raises
    ------
    AllanError
        When the stamps do not fit into 64 bits (292 years).
    """
    if (first + count) / rate >= LONGEST_S:
        raise AllanError(f'a sample rate of {rate:g} Hz is too low: state the rate in Hz')
    stamps: NDArray[np.int64] = np.rint(np.arange(first, first + count) * (1e9 / rate)).astype(
        np.int64
    )
    return stamps


def real_numbers(values: Any) -> Floats:
    """Return numbers as a float64 array of the same shape; masked values become NaN.

    Raises TypeError or ValueError if the values cannot be converted, such as complex numbers, dates
    or durations, or if they have no common shape.
    """
    array = np.asarray(values)
    if array.dtype.kind in 'cmM':
        raise TypeError('complex values' if array.dtype.kind == 'c' else 'dates or durations')
    try:
        numbers = np.asarray(array, float)
    except OverflowError as error:
        raise ValueError(str(error)) from None
    return np.where(np.ma.getmask(values), np.nan, numbers) if np.ma.is_masked(values) else numbers


def sensor_of(axis: str) -> str:
    """Return 'gyro' or 'accel' for an axis name such as 'gyro_x'."""
    return axis.split('_', 1)[0]


def axes_of_sensors(axes: Sequence[str]) -> dict[str, list[int]]:
    """Return a dict that maps each sensor to the indices of its axes in ``axes``.

    >>> axes_of_sensors(['gyro_z', 'accel_x', 'accel_y'])
    {'gyro': [0], 'accel': [1, 2]}
    """
    indices: dict[str, list[int]] = {}
    for i, axis in enumerate(axes):
        indices.setdefault(sensor_of(axis), []).append(i)
    return indices


def from_datasheet(term: str, sensor: str, value: float) -> float:
    """Convert a coefficient from the unit of datasheets (`DATASHEET_UNITS`) to SI.

    ``term`` is Q, N, B, K or R; ``sensor`` is 'gyro' or 'accel'. Raises KeyError for another term
    or sensor.
    """
    return value * UNITS[DATASHEET_UNITS[sensor][term]].factor


def to_si(value: float, unit: str, si: str) -> float:
    """Convert a value to SI.

    Parameters
    ----------
    value : float
        The value in ``unit``.
    unit : str
        A unit in `UNITS`.
    si : str
        The expected SI unit.

    Raises
    ------
    AllanError
        When the unit is unknown, or has another SI unit; the message lists the possible units.
    """
    known_unit = UNITS.get(unit)
    if known_unit is None or known_unit.si != si:
        possible_units = ', '.join(name for name, u in UNITS.items() if u.si == si)
        raise AllanError(f'unit {unit!r} cannot be used here: use one of {possible_units}')
    return value * known_unit.factor


def sample_factors(gyro_unit: str, accel_unit: str) -> NDArray[np.float64]:
    """Return the factors that convert samples in the given units to SI, (6,), one for each axis.

    Raises KeyError if a unit is not in `UNITS`.
    """
    return np.repeat([UNITS[gyro_unit].factor, UNITS[accel_unit].factor], 3)


class ImuIdentity(NamedTuple):
    """Identity of an IMU: its frame_id and its serial number, each '' if it is unknown."""

    frame_id: str = ''
    hardware_id: str = ''

    def __str__(self) -> str:
        return (
            f'frame_id {self.frame_id or "unknown"}, serial number {self.hardware_id or "unknown"}'
        )

    def can_be(self, other: ImuIdentity) -> bool:
        """Return whether two identities can be of one IMU.

        The serial numbers must be equal: an unknown one differs from a known one. The frame_ids
        must be equal if both are known.
        """
        known_frame_ids = {self.frame_id, other.frame_id} - {''}
        return self.hardware_id == other.hardware_id and len(known_frame_ids) < 2

    @property
    def label(self) -> str:
        """Name for users, safe to print: the serial number if it is known, else the frame_id."""
        return one_line(self.hardware_id or self.frame_id)
