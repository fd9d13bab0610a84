# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read PX4 logs (``.ulg``) with ``pyulog``: the topic ``sensor_combined`` or ``vehicle_imu``.

``sensor_combined`` contains angular rate and acceleration of the IMU that PX4 uses. Each instance
of ``vehicle_imu`` contains delta angles and delta velocities of one IMU, which are divided by their
integration times. Dropouts of the logger cause gaps. Topics in `THERMOMETERS` contain the
temperature.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..core.errors import AllanError
from ..core.findings import finding
from ..core.imu import AXES, SENSORS, ImuBatch
from ..core.stream.signal import MAX_BINS, TemperatureTrace, trace_of
from .files import open_regular
from .recording import (
    ReadOptions,
    Recording,
    Report,
    SourceInfo,
    damaged,
    in_batches,
    optional_package,
)

TOPICS = ('sensor_combined', 'vehicle_imu')

THERMOMETERS = ('sensor_gyro', 'sensor_accel')
"""Topics that contain the temperature of an IMU, in the order of preference."""

SELECTION = 'sensor_selection'
"""Topic that states which IMU the samples in ``sensor_combined`` come from."""

MAX_LOG_BYTES = 4 * 2**30
"""Largest size of a log in bytes. The parser keeps the data of the topics in memory."""

MAX_SEEKS = 50_000
"""Number of seeks after which reading stops. The parser seeks once for each damaged byte, and needs
about a second for this number of seeks."""

REMEDY = 'copy the log again'


def open_ulog(path: Path, options: ReadOptions) -> Recording:
    """Open a PX4 log as a recording of one IMU.

    If the options select no topic, ``sensor_combined`` is preferred. Raises AllanError when the log
    cannot be read, when it contains no IMU or lacks the selected topic, when one of several
    instances of a topic must be selected, or when the package ``pyulog`` is missing.
    """
    log = _parsed(path)
    topics = {_label(data, log): data for data in log.data_list if data.name in TOPICS}
    name = _chosen(path, list(topics), options.topic)
    data = topics[name]
    try:
        batch, integration_s = _samples(name, data.data)
    except (KeyError, ValueError, OverflowError) as error:
        raise damaged(path, f'topic {name}: {error}', REMEDY) from error
    batch = options.in_si(batch)

    def read(report: Report) -> Iterator[ImuBatch]:
        if log.file_corruption:
            report(finding('log_damaged', path=path))
        if count := len(log.dropouts):
            seconds = sum(dropout.duration for dropout in log.dropouts) / 1e3
            report(finding('log_dropouts', path=path, count=count, seconds=seconds))
        period_s = float(np.median(np.diff(batch.stamps_ns))) * 1e-9 if len(batch) > 1 else 0.0
        if period_s > 1.5 * integration_s > 0.0:  # the logger did not store every sample
            rate, full_rate = 1.0 / period_s, 1.0 / integration_s
            report(finding('log_decimated', path=path, topic=name, rate=rate, full=full_rate))
        yield from in_batches(batch)

    trace = _temperature(log, data)
    info = SourceInfo(str(path), name, data.name, 'ulog')
    return Recording(info, len(batch), read, lambda frame_id: trace, options=options)


def _parsed(path: Path) -> Any:
    pyulog = optional_package('pyulog', f'{path}: reading a PX4 log')
    with open_regular(path) as file, redirect_stdout(io.StringIO()):  # the parser prints to stdout
        if os.fstat(file.fileno()).st_size > MAX_LOG_BYTES:
            raise AllanError(f'{path}: is larger than {MAX_LOG_BYTES} bytes: split the log')
        try:
            return pyulog.ULog(_Limited(file), [*TOPICS, *THERMOMETERS, SELECTION])
        except Exception as error:  # the parser may raise any exception
            raise damaged(path, error, REMEDY) from error


class _Limited:
    """A file object whose content ends after more than `MAX_SEEKS` seeks.

    The parser seeks back once for each byte of a damaged part of the log. Without a limit, parsing
    such a part takes very long.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._seeks = 0
        self.tell = file.tell
        self.close = file.close

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes, or b'' after too many seeks."""
        return self._file.read(size) if self._seeks <= MAX_SEEKS else b''

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Change the position, and count the seeks."""
        self._seeks += 1
        return self._file.seek(offset, whence)


def _label(data: Any, log: Any) -> str:
    name_repeats = sum(other_topic.name == data.name for other_topic in log.data_list) > 1
    return f'{data.name}:{data.multi_id}' if name_repeats else str(data.name)


def _chosen(path: Path, topics: list[str], wanted: str) -> str:
    if not topics:
        raise AllanError(f'{path}: has no topic {" or ".join(TOPICS)}: log one of them')
    if wanted:
        if wanted not in topics:
            raise AllanError(
                f'{path}: has no topic {wanted}; it has {", ".join(topics)}: check --topic'
            )
        return wanted
    if TOPICS[0] in topics:
        return TOPICS[0]
    if len(topics) > 1:
        raise AllanError(
            f'{path}: has {len(topics)} IMUs: {", ".join(topics)}: choose one with --topic'
        )
    return topics[0]


def _samples(name: str, data: dict[str, NDArray[Any]]) -> tuple[ImuBatch, float]:
    """Return the samples of a topic, and the median integration time in s (0 if unknown)."""
    record = _nanoseconds(data['timestamp'])
    stamps = _nanoseconds(data['timestamp_sample']) if 'timestamp_sample' in data else record
    samples = np.empty((len(AXES), len(record))).T
    if 'delta_angle[0]' in data:
        for sensor, field in (('gyro', 'delta_angle'), ('accel', 'delta_velocity')):
            seconds = data.get(f'{field}_dt', data.get('dt', np.zeros(1))) * 1e-6
            seconds = np.where(seconds > 0.0, seconds, np.nan)
            samples[:, SENSORS[sensor]] = _vectors(data, field) / seconds[:, None]
        integration_times = data.get('delta_angle_dt', data.get('dt', np.zeros(1)))
    else:
        samples[:, SENSORS['gyro']] = _vectors(data, 'gyro_rad')
        samples[:, SENSORS['accel']] = _vectors(data, 'accelerometer_m_s2')
        relative_stamps = data.get('accelerometer_timestamp_relative', np.zeros(1))
        # this value marks a sample without acceleration
        absent_rows = np.flatnonzero(relative_stamps == 0x7FFFFFFF)
        samples[absent_rows, SENSORS['accel']] = np.nan
        integration_times = data.get('gyro_integral_dt', np.zeros(1))
    unit = 1.0 if integration_times.dtype.kind == 'f' else 1e-6  # older logs state the time in s
    return ImuBatch(stamps, samples, record, name), float(np.median(integration_times)) * unit


def _temperature(log: Any, data: Any) -> TemperatureTrace | None:
    """Return the temperature over time of the gyro whose samples ``data`` contains.

    Returns None if no topic contains the temperature of this gyro, or if the log does not state the
    device of the gyro and has temperatures of several instances.
    """
    topics = [topic for topic in log.data_list if topic.name in THERMOMETERS]
    selections = (topic for topic in log.data_list if topic.name == SELECTION)
    device_fields = data.data if 'gyro_device_id' in data.data else next(selections, data).data
    if 'gyro_device_id' in device_fields:
        device = device_fields['gyro_device_id'][-1:]
        topics = [t for t in topics if 'device_id' in t.data and t.data['device_id'][-1:] == device]
    elif len({topic.multi_id for topic in topics}) > 1:
        return None
    for topic in sorted(topics, key=lambda topic: THERMOMETERS.index(topic.name)):
        stamps, celsius = topic.data['timestamp'], topic.data.get('temperature', np.zeros(0))
        rows = slice(None, None, max(1, -(-len(celsius) // MAX_BINS)))
        times = (stamps[rows].astype(np.int64) * 1000).tolist()
        trace = trace_of(_label(topic, log), zip(times, times, celsius[rows].tolist()))
        if trace is not None:
            return trace
    return None


def _vectors(data: dict[str, NDArray[Any]], field: str) -> NDArray[np.float64]:
    return np.stack([data[f'{field}[{i}]'] for i in range(3)], axis=1).astype(np.float64)


def _nanoseconds(microseconds: NDArray[Any]) -> NDArray[np.int64]:
    if (microseconds > np.iinfo(np.int64).max // 1000).any():
        raise ValueError('a timestamp is out of range')
    return microseconds.astype(np.int64) * 1000
