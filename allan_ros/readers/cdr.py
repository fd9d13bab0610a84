# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Decode and encode serialized `sensor_msgs/Imu` messages, and change their covariances.

In each serialization, the layout depends only on byte order and length of ``header.frame_id``.
Messages with the same layout are decoded together, as an array of records.

Serializations
--------------
``cdr`` : OMG CDR as ROS 2 writes it
    Four bytes of encapsulation, of which the second is the byte order, then fields aligned to
    multiples of their size (OMG DDSI-RTPS 2.3, section 10; CORBA 3.4 part 2, section 9.3).
``ros1`` : the serialization of ROS 1
    Packed little-endian fields, with ``header.seq`` (https://wiki.ros.org/msg).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.imu import AXES, MAX_NAME, NANOSECONDS, SENSORS, ImuBatch

IMU_TYPE = 'sensor_msgs/msg/Imu'

Encoding = Literal['cdr', 'ros1']

ABSENT = -1.0
"""Value of covariance[0] that marks an absent sensor (sensor_msgs/Imu.msg)."""

BIG_ENDIAN, LITTLE_ENDIAN = 0, 1
"""Values of the first two bytes of the encapsulation for big-endian and little-endian CDR."""

_ORDERS = {bytes([0, LITTLE_ENDIAN]): '<', bytes([0, BIG_ENDIAN]): '>'}
"""First two bytes of the encapsulation -> byte order in the notation of numpy."""

_FRAME_AT = 16
"""Offset of frame_id in bytes. Four fields of four bytes each come before frame_id: encapsulation
(in ROS 1: seq), sec, nanosec, and the length of frame_id."""

MAX_FRAME_BYTES = MAX_NAME + 1
"""Largest serialized length of a frame_id in bytes; in CDR, this includes the final NUL."""

_DOUBLE = 8
"""Number of bytes in a float64."""

_IMU_BYTES = 400
"""Number of zeros that are appended to a Temperature message, so that it can be read with the
layout of an Imu message. An Imu message without a frame_id has fewer bytes."""

_VECTORS = (
    ('orientation', 4),
    ('orientation_covariance', 9),
    ('gyro', 3),
    ('gyro_covariance', 9),
    ('accel', 3),
    ('accel_covariance', 9),
)
"""Name of each field of an Imu message after the header, and number of its elements."""


class MalformedMessage(Exception):
    """A message has another type than expected, or is damaged.

    ``index`` is the position of the message in the sequence of messages.
    """

    def __init__(self, index: int, reason: str) -> None:
        super().__init__(reason)
        self.index = index


@dataclass(frozen=True)
class DecodedImus:
    """The content of n Imu messages."""

    stamps_ns: NDArray[np.int64]  # (n,), header stamps in ns
    # (n, 6), in the order of `AXES` and the units of the messages, normally SI; NaN for an absent
    # sensor
    samples: NDArray[np.float64]
    frame_ids: list[str]  # the distinct frame_ids
    frames: NDArray[np.intp]  # (n,), index of the frame_id of each message
    # sensor -> number of messages that declare the sensor absent, but contain valid data of the
    # sensor; these data are used
    kept: dict[str, int] = field(default_factory=dict)

    def batches(self, record_ns: NDArray[np.int64]) -> Iterator[ImuBatch]:
        """Yield the samples in batches with one frame_id each.

        ``record_ns``, (n,), are the record times of the messages in ns.
        """
        edges = [0, len(self.frames)]
        if len(self.frame_ids) > 1:
            edges[1:1] = (np.flatnonzero(np.diff(self.frames)) + 1).tolist()
        for start, stop in pairwise(edges if len(self.frames) else ()):
            rows, frame_id = slice(start, stop), self.frame_ids[self.frames[start]]
            yield ImuBatch(self.stamps_ns[rows], self.samples[rows], record_ns[rows], frame_id)


@lru_cache(maxsize=256)
def imu_dtype(encoding: Encoding, order: str, frame_bytes: int, itemsize: int = 0) -> np.dtype[Any]:
    """Return the layout of a serialized Imu message as a structured numpy dtype.

    Parameters
    ----------
    encoding : 'cdr' or 'ros1'
        Serialization of the message.
    order : '<' or '>'
        Byte order.
    frame_bytes : int
        Serialized length of the frame_id in bytes; in CDR, this includes the final NUL.
    itemsize : int
        Length of the message in bytes, which may be padded at the end; 0 for no padding.

    Raises
    ------
    ValueError
        When ``itemsize`` is smaller than an Imu message.
    """
    start = 4
    if encoding == 'cdr':
        fields: list[tuple[str, Any, int]] = [('representation', '>u2', 0)]
        fields += [('sec', f'{order}i4', start)]
    else:
        fields = [('seq', f'{order}u4', 0), ('sec', f'{order}u4', start)]
    fields += [('nanosec', f'{order}u4', start + 4), ('frame_bytes', f'{order}u4', start + 8)]
    fields += [('frame_id', (np.void, frame_bytes), start + 12)]
    offset = start + 12 + frame_bytes
    if encoding == 'cdr':
        offset += -(offset - start) % _DOUBLE
    for name, count in _VECTORS:
        fields += [(name, (f'{order}f8', (count,)), offset)]
        offset += count * _DOUBLE
    names, formats, offsets = map(list, zip(*fields))
    size = itemsize or offset
    return np.dtype({'names': names, 'formats': formats, 'offsets': offsets, 'itemsize': size})


def decode_imus(
    payloads: Sequence[bytes | memoryview] | NDArray[np.void],
    encoding: Encoding,
) -> DecodedImus:
    """Decode n serialized Imu messages to stamps in ns, (n,), and samples, (n, 6).

    The samples have the units of the messages, normally SI. If covariance[0] of a sensor is -1 or
    NaN in a message, and the data of this sensor are all zero or not all finite, its samples are
    NaN. Raises MalformedMessage for the first payload that cannot be an Imu message, because of its
    first bytes, its length or the length of its frame_id.
    """
    n = len(payloads)
    samples = np.empty((len(AXES), n)).T
    decoded = DecodedImus(np.empty(n, np.int64), samples, [], np.zeros(n, np.intp))
    for rows, records in _grouped_by_layout(payloads, encoding):
        decoded.stamps_ns[rows] = records['sec'].astype(np.int64) * NANOSECONDS + records['nanosec']
        for sensor, axes in SENSORS.items():
            for i, axis in enumerate(range(len(AXES))[axes]):
                decoded.samples[rows, axis] = records[sensor][:, i]
            variances = records[f'{sensor}_covariance'][:, 0].copy()
            if not variances.min() >= 0.0:  # true for NaN, too
                is_absent = (variances == ABSENT) | np.isnan(variances)
                _drop_absent(decoded, sensor, np.arange(n)[rows][is_absent])
        distinct, indices = _distinct(records['frame_id'])
        frame_indices = []
        for name in distinct:
            text = name.rstrip(b'\0' if encoding == 'cdr' else b'').decode(errors='replace')
            if text not in decoded.frame_ids:
                decoded.frame_ids.append(text)
            frame_indices.append(decoded.frame_ids.index(text))
        decoded.frames[rows] = (
            frame_indices[0] if len(frame_indices) == 1 else np.array(frame_indices)[indices]
        )
    return decoded


def _drop_absent(decoded: DecodedImus, sensor: str, absent_rows: NDArray[np.intp]) -> None:
    """Set the samples of a sensor to NaN in messages that declare the sensor absent.

    ``absent_rows`` are the indices of these messages. Many drivers declare a sensor absent by
    mistake, so data are kept if they are valid, that is, finite and not all zero.
    """
    values = decoded.samples[absent_rows, SENSORS[sensor]]
    has_valid_data = np.isfinite(values).all(axis=1) & values.any(axis=1)
    if has_valid_data.any():
        decoded.kept[sensor] = decoded.kept.get(sensor, 0) + int(np.count_nonzero(has_valid_data))
    decoded.samples[absent_rows[~has_valid_data], SENSORS[sensor]] = np.nan


def _grouped_by_layout(
    payloads: Sequence[bytes | memoryview] | NDArray[np.void], encoding: Encoding
) -> Iterator[tuple[slice | NDArray[np.intp], NDArray[Any]]]:
    """For each group of messages with the same layout, yield their positions and records."""
    n = len(payloads)
    # messages of equal length have the same layout if these fields are equal, too
    fields = ('frame_bytes',) if encoding == 'ros1' else ('frame_bytes', 'representation')
    lengths_differ = not isinstance(payloads, np.ndarray) and len(set(map(len, payloads))) > 1
    if n and not lengths_differ:
        dtype = _layout_of(bytes(payloads[0]), encoding).dtype
        if isinstance(payloads, np.ndarray):
            records = payloads.view(dtype)
        else:
            records = np.frombuffer(b''.join(payloads), dtype)
        if all((records[name] == records[name][0]).all() for name in fields):
            yield slice(0, n), records
            return
    groups: dict[tuple[object, ...], list[int]] = {}
    for row, payload in enumerate(map(bytes, payloads)):
        layout_fields = (
            payload[:2] if encoding == 'cdr' else b'',
            payload[_FRAME_AT - 4 : _FRAME_AT],
        )
        groups.setdefault((len(payload), *layout_fields), []).append(row)
    for rows in groups.values():
        group_payloads = [bytes(payloads[row]) for row in rows]
        dtype = _layout_of(group_payloads[0], encoding, rows[0]).dtype
        yield np.array(rows), np.frombuffer(b''.join(group_payloads), dtype)


class _MessageLayout(NamedTuple):
    """Layout of a message: byte order, record dtype, offsets of fields, position of frame_id."""

    order: str
    dtype: np.dtype[Any]
    offsets: dict[str, int]
    frame: slice


def _layout_of(payload: bytes, encoding: Encoding = 'cdr', index: int = 0) -> _MessageLayout:
    """Return the layout of an Imu message, or raise MalformedMessage with ``index``."""
    if len(payload) < _FRAME_AT:
        raise MalformedMessage(index, f'{len(payload)} bytes are too few for an Imu')
    order = '<' if encoding == 'ros1' else _ORDERS.get(payload[:2])
    if order is None:
        reason = f'its encapsulation 0x{payload[:2].hex()} is not plain CDR'
        raise MalformedMessage(index, reason)
    length_field = payload[_FRAME_AT - 4 : _FRAME_AT]
    frame_bytes = int.from_bytes(length_field, 'little' if order == '<' else 'big')
    if frame_bytes > MAX_FRAME_BYTES:
        reason = f'its frame_id has {frame_bytes} bytes, the limit is {MAX_FRAME_BYTES}'
        raise MalformedMessage(index, reason)
    try:
        return _layout(encoding, order, frame_bytes, len(payload))
    except ValueError as error:
        reason = f'{len(payload)} bytes are too few for an Imu with a frame_id of {frame_bytes}'
        raise MalformedMessage(index, reason) from error


@lru_cache(maxsize=256)
def _layout(encoding: Encoding, order: str, frame_bytes: int, length: int = 0) -> _MessageLayout:
    dtype = imu_dtype(encoding, order, frame_bytes, length)
    offsets = {name: entry[1] for name, entry in (dtype.fields or {}).items()}
    return _MessageLayout(order, dtype, offsets, slice(_FRAME_AT, _FRAME_AT + frame_bytes))


def is_imu(payload: bytes, encoding: Encoding) -> bool:
    """Return whether a payload can be decoded as a serialized Imu message."""
    try:
        decode_imus([payload], encoding)
    except MalformedMessage:
        return False
    return True


def _distinct(names: NDArray[np.void]) -> tuple[list[bytes], NDArray[np.intp]]:
    """Return the distinct byte strings of an array, and for each item the index of its string."""
    if not names.itemsize:
        return [b''], np.zeros(len(names), np.intp)
    size, all_bytes = names.itemsize, names.copy().view(np.uint8)
    if (all_bytes[size:] == all_bytes[: len(all_bytes) - size]).all():
        return [all_bytes[:size].tobytes()], np.zeros(len(names), np.intp)
    distinct, indices = np.unique(all_bytes.reshape(-1, size), axis=0, return_inverse=True)
    # reshaped, because the indices are a column in numpy 2.0
    return [name.tobytes() for name in distinct], indices.reshape(-1)


def encode_imus(batch: ImuBatch, encoding: Encoding, order: str = '<') -> list[memoryview]:
    """Serialize a batch to one message per sample.

    A sensor whose axes are all NaN is declared absent: its values are zeros, and covariance[0] is
    -1. The orientation is always declared absent.

    Parameters
    ----------
    batch : ImuBatch
        The samples, (n, 6).
    encoding : 'cdr' or 'ros1'
        Serialization of the messages.
    order : '<' or '>'
        Byte order.

    Raises
    ------
    OverflowError
        When the seconds of a stamp do not fit into 32 bits (before 1901 or after 2038).
    """
    frame = batch.frame_id.encode() + (b'\0' if encoding == 'cdr' else b'')
    dtype = imu_dtype(encoding, order, len(frame))
    records = np.zeros(len(batch), dtype)
    if encoding == 'cdr':
        records['representation'] = LITTLE_ENDIAN if order == '<' else BIG_ENDIAN
    seconds, records['nanosec'] = np.divmod(batch.stamps_ns, NANOSECONDS)
    records['sec'] = seconds
    if (records['sec'] != seconds).any():
        raise OverflowError('a stamp does not fit into a message: it has more than 32-bit seconds')
    records['frame_bytes'] = len(frame)
    records['frame_id'] = np.void(frame)
    records['orientation'][:, 3] = 1.0
    records['orientation_covariance'][:, 0] = ABSENT
    for name, axes in SENSORS.items():
        values = batch.samples[:, axes]
        is_absent = np.asarray(np.isnan(values).all(axis=1))
        records[name] = np.where(is_absent[:, None], 0.0, values)
        records[f'{name}_covariance'][is_absent, 0] = ABSENT
    joined = memoryview(records.tobytes())
    size = dtype.itemsize
    return [joined[start : start + size] for start in range(0, len(joined), size)]


def decode_temperature(payload: bytes, encoding: Encoding) -> tuple[int, str, float]:
    """Return the header stamp in ns, frame_id and temperature in degC of a Temperature message.

    Raises MalformedMessage when the payload is too short for a sensor_msgs/Temperature, is not
    plain CDR, or has a frame_id that is too long.
    """
    # the temperature follows the header, at the place of the orientation in an Imu message
    padded = payload + bytes(_IMU_BYTES)
    _, dtype, offsets, frame = _layout_of(padded, encoding)
    if len(payload) < offsets['orientation'] + _DOUBLE:
        raise MalformedMessage(0, f'{len(payload)} bytes are too few for a Temperature')
    record = np.frombuffer(padded, dtype, 1)[0]
    stamp_ns = int(record['sec']) * NANOSECONDS + int(record['nanosec'])
    frame_id = payload[frame].rstrip(b'\0').decode(errors='replace')
    return stamp_ns, frame_id, float(record['orientation'][0])


_COVARIANCE_BYTES = 9 * _DOUBLE

_UNKNOWN = bytes(_COVARIANCE_BYTES)
"""Bytes of an unknown covariance, which is all zeros (sensor_msgs/Imu.msg)."""

_NUMBERS = {order: struct.Struct(f'{order}9d') for order in '<>'}


class CovariancePatch:
    """Writes given variances into the covariances of Imu messages in CDR.

    A covariance that begins with -1 or NaN, which marks an absent sensor, is never changed.

    Parameters
    ----------
    variances : mapping of str to (float, float, float)
        'gyro' or 'accel' -> variances of the x, y and z axis in (rad/s)^2 or (m/s^2)^2.
    overwrite : bool
        Whether covariances that the driver has set are changed, too. Such covariances are not all
        zeros.
    frame_id : str
        Only messages with this frame_id are changed; '' for all messages.
    """

    def __init__(
        self,
        variances: Mapping[str, tuple[float, float, float]],
        overwrite: bool = False,
        frame_id: str = '',
    ) -> None:
        self._overwrite = overwrite
        self._frame = frame_id.encode()
        self._packed = {
            order: [
                (sensor, numbers.pack(x, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, z))
                for sensor, (x, y, z) in variances.items()
            ]
            for order, numbers in _NUMBERS.items()
        }

    def patch(self, payload: bytes) -> bytes:
        """Return an Imu message that has the ``variances`` of this object in its covariances.

        Covariances that must not be changed are kept. Returns ``payload`` itself if no covariance
        may be changed. Raises MalformedMessage when the payload cannot be an Imu message in plain
        CDR.
        """
        order, _, offsets, frame = _layout_of(payload)
        if self._frame and payload[frame].rstrip(b'\0') != self._frame:
            return payload
        patched = None
        for sensor, covariance in self._packed[order]:
            start = offsets[f'{sensor}_covariance']
            stop = start + _COVARIANCE_BYTES
            if not self._may_change(payload[start:stop], order):
                continue
            if patched is None:
                patched = bytearray(payload)
            patched[start:stop] = covariance
        return payload if patched is None else bytes(patched)

    def _may_change(self, covariance: bytes, order: str) -> bool:
        if covariance == _UNKNOWN:
            return True
        numbers = _NUMBERS[order].unpack(covariance)
        if numbers[0] == ABSENT or numbers[0] != numbers[0]:
            return False
        return self._overwrite or not any(numbers)


def frame_id_of(payload: bytes) -> str:
    """Return header.frame_id of an Imu message in CDR.

    Raises MalformedMessage when the payload cannot be an Imu message in plain CDR.
    """
    return payload[_layout_of(payload).frame].rstrip(b'\0').decode(errors='replace')
