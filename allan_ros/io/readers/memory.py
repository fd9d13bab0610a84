# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Samples in memory as a recording: arrays, data frames, mappings of columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.errors import AllanError
from ...core.fields import MAX_INTEGER
from ...core.findings import Finding
from ...core.imu import AXES, SENSORS, ImuBatch, sensor_of
from .recording import ACCEL_UNITS, BATCH, GYRO_UNITS, ReadOptions, Recording, SourceInfo
from .table_columns import axis_of_column, time_of_column

NAME = 'array'
"""Name of samples that do not come from a file."""

DEFAULT_AXES = {1: AXES[:1], 3: AXES[:3], 6: AXES}
"""Number of columns -> the axes they are assumed to be when none are named."""

NS = 1e9


def recording_in_memory(
    samples: Any,
    rate: float = 0.0,
    axes: str | Sequence[str] | None = None,
    gyro_unit: str = 'rad/s',
    accel_unit: str = 'm/s^2',
) -> Recording:
    """Return samples in memory as a recording.

    Parameters
    ----------
    samples : ImuBatch, (n,) or (n, k) array, DataFrame, or mapping of column name to array
        Columns of a DataFrame are recognized by their names, as in a table file; its times are
        its DatetimeIndex or a column such as ``t`` or ``time``.
    rate : float
        Sample rate in Hz; needed where there are no times, and used instead of them if given.
    axes : str or sequence of str, optional
        The axis of each column, or 'gyro' or 'accel' for three. By default one column is
        ``gyro_x``, three are the gyro, six are gyro and accelerometer.
    gyro_unit, accel_unit : str
        Units of the columns that do not name theirs.

    Raises
    ------
    AllanError
        When the shape, a name, a unit or the rate is impossible, or a time is missing.
    """
    if isinstance(samples, ImuBatch):
        return _recording(samples)
    if rate and not (np.isfinite(rate) and rate > 0.0):
        raise AllanError(f'rate is {rate} Hz: give a positive number')
    units = {'gyro': gyro_unit, 'accel': accel_unit}
    stamps = None
    if isinstance(samples, Mapping) or hasattr(samples, 'columns'):
        columns, units_of, stamps = _named_columns(samples, axes, bool(rate))
    else:
        values = _numbers(samples)
        names = _axis_names(axes, values.shape[1])
        columns, units_of = dict(zip(names, values.T)), {}
    n = len(next(iter(columns.values())))
    rows = np.full((n, len(AXES)), np.nan)
    for axis, column in columns.items():
        rows[:, AXES.index(axis)] = column * _factor(axis, units_of.get(axis) or units)
    if rate:
        stamps = np.rint(np.arange(n) * (NS / rate)).astype(np.int64)
    if stamps is None:
        raise AllanError('the samples have no times: give their rate in Hz, such as rate=200')
    named = {sensor_of(axis): unit for axis, unit in units_of.items() if unit}
    options = ReadOptions(
        rate_hz=rate,
        gyro_unit=named.get('gyro', gyro_unit),
        accel_unit=named.get('accel', accel_unit),
    )
    return _recording(ImuBatch(stamps, rows), options)


def _recording(batch: ImuBatch, options: ReadOptions = ReadOptions()) -> Recording:
    def read(_report: object) -> Iterator[ImuBatch]:
        for first in range(0, len(batch), BATCH):
            yield batch[first : first + BATCH]

    if len(batch) and np.abs(batch.stamps_ns.astype(float)).max() > MAX_INTEGER:
        raise AllanError('some times are beyond a hundred years from 1970: check their unit')
    if not len(batch):
        raise AllanError('there are no samples: give an array with at least some thousand rows')
    info = SourceInfo(NAME, '', 'array', 'memory')
    return Recording(info, len(batch), read, options=options)


def without_absent(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return the findings without those on sensors that an array never had."""
    return tuple(f for f in findings if f.id != 'sensor_absent')


def _numbers(samples: Any) -> NDArray[np.float64]:
    """Return the samples as (n, k) float64."""
    try:
        values = np.asarray(samples, float)
    except (TypeError, ValueError) as error:
        raise AllanError(
            f'the samples are not numbers ({error}): give an array, a DataFrame or paths'
        ) from None
    values = values[:, None] if values.ndim == 1 else values
    if values.ndim != 2:
        raise AllanError(
            f'the samples have shape {values.shape}: give (n,) or (n, axes), one row per sample'
        )
    return values


def _axis_names(axes: str | Sequence[str] | None, columns: int) -> tuple[str, ...]:
    if axes is None:
        if columns not in DEFAULT_AXES:
            raise AllanError(
                f'{columns} columns could be any axes: name them, such as axes=["gyro_z", ...]'
            )
        return DEFAULT_AXES[columns]
    names = AXES[SENSORS[axes]] if isinstance(axes, str) and axes in SENSORS else axes
    names = (names,) if isinstance(names, str) else tuple(names)
    for name in names:
        if name not in AXES:
            raise AllanError(f'axis {name!r} is unknown: choose from {", ".join(AXES)}')
    if len(set(names)) < len(names) or len(names) != columns:
        raise AllanError(
            f'{columns} columns and {len(names)} axes ({", ".join(names)}): name each column once'
        )
    return names


def _named_columns(
    samples: Any, axes: str | Sequence[str] | None, has_rate: bool
) -> tuple[dict[str, NDArray[np.float64]], dict[str, str], NDArray[np.int64] | None]:
    """Return the columns by axis, the units in their names, and the stamps in ns."""
    names = list(samples.columns if hasattr(samples, 'columns') else samples)
    columns: dict[str, NDArray[np.float64]] = {}
    units: dict[str, str] = {}
    stamps = None
    wanted = None if axes is None else set(_axis_names(axes, len(_tuple(axes))))
    for name in names:
        known = axis_of_column(str(name))
        if known is not None and known[0] not in columns and (not wanted or known[0] in wanted):
            columns[known[0]] = _numbers(samples[name])[:, 0]
            units[known[0]] = known[1]
        elif stamps is None and not has_rate and (scale := time_of_column(str(name))):
            stamps = _stamps(samples[name], scale)
    index = getattr(getattr(samples, 'index', None), 'values', None)
    if stamps is None and index is not None and np.asarray(index).dtype.kind == 'M':
        stamps = _stamps(index, 1)
    if not columns:
        raise AllanError(
            f'none of the columns {", ".join(map(str, names[:10]))} is an axis: '
            f'name them {", ".join(AXES)}'
        )
    if len({len(column) for column in columns.values()}) > 1:
        raise AllanError('the columns have different lengths: give one row per sample')
    return columns, units, stamps


def _tuple(axes: str | Sequence[str]) -> Sequence[str]:
    if isinstance(axes, str):
        return AXES[SENSORS[axes]] if axes in SENSORS else (axes,)
    return axes


def _stamps(times: Any, scale: int) -> NDArray[np.int64]:
    """Return times as int64 ns: dates, whole numbers or floats of ``scale`` ns."""
    values = np.asarray(times)
    if values.dtype.kind == 'M':
        return values.astype('datetime64[ns]').astype(np.int64)
    if values.dtype.kind in 'iu':
        return values.astype(np.int64) * scale
    values = _numbers(values)[:, 0]
    if not np.isfinite(values).all():
        raise AllanError('some times are NaN or infinite: drop these rows, or give the rate')
    return np.rint(values * scale).astype(np.int64)


def _factor(axis: str, unit: str | Mapping[str, str]) -> float:
    """Return the size of the unit of an axis in SI."""
    sensor = sensor_of(axis)
    known = GYRO_UNITS if sensor == 'gyro' else ACCEL_UNITS
    name = unit if isinstance(unit, str) else unit[sensor]
    if name not in known:
        raise AllanError(f'{sensor} unit {name!r} is unknown: choose one of {", ".join(known)}')
    return known[name]
