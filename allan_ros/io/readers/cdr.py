# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`sensor_msgs/Imu` on the wire: whole batches of payloads to arrays and back, no message objects.

Behind ``header.frame_id`` the message has a fixed layout, so payloads of equal length are one
numpy array of records. Two wire forms are known:

- ``cdr``: OMG CDR as ROS 2 writes it: four bytes of encapsulation (the second says the byte order),
  then fields aligned to their size counted from there (OMG DDSI-RTPS 2.3, section 10;
  CORBA 3.4 part 2, section 9.3).
- ``ros1``: packed little-endian, with ``header.seq`` (https://wiki.ros.org/msg).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...core.imu import AXES, MAX_NAME, SENSORS, ImuBatch

Encoding = Literal['cdr', 'ros1']


Rows = slice | NDArray[np.intp]
"""Places of messages in their batch; a slice where they are all of it."""


NANOSECONDS = 10**9

ABSENT = -1.0
"""covariance[0] of a sensor that is not there (sensor_msgs/Imu.msg)."""

ENCAPSULATION_BYTES = 4

BIG_ENDIAN, LITTLE_ENDIAN = 0, 1
"""How the encapsulation begins: CDR_BE and CDR_LE."""

_DOUBLE = 8

_VECTORS = (
    ('orientation', 4),
    ('orientation_covariance', 9),
    ('gyro', 3),
    ('gyro_covariance', 9),
    ('accel', 3),
    ('accel_covariance', 9),
)


class MalformedMessage(Exception):
    """A payload is not an Imu: ``index`` says which of the batch, the message why."""

    def __init__(self, index: int, reason: str) -> None:
        super().__init__(reason)
        self.index = index


@dataclass(frozen=True)
class DecodedImus:
    """The messages of one batch: stamps, axes, and which frame each names.

    Attributes
    ----------
    stamps_ns : (n,) int64 array
    samples : (n, 6) float64 array
        rad/s and m/s^2 in the order of `AXES`; NaN where the message says the sensor is absent.
    frame_ids : list of str
        The distinct frames of the batch.
    frames : (n,) integer array
        The frame of each message, as an index into ``frame_ids``.
    """

    stamps_ns: NDArray[np.int64]
    samples: NDArray[np.float64]
    frame_ids: list[str]
    frames: NDArray[np.intp]


@lru_cache(maxsize=256)
def imu_dtype(encoding: Encoding, order: str, frame_bytes: int, itemsize: int = 0) -> np.dtype[Any]:
    """Return the record layout of an Imu whose frame_id takes that many bytes on the wire.

    Parameters
    ----------
    encoding : 'cdr' or 'ros1'
    order : '<' or '>'
    frame_bytes : int
        As the length field says: with the closing NUL in CDR, without in ROS 1.
    itemsize : int, optional
        Length of the payload where it is longer than the message (padding at the end).

    Raises
    ------
    ValueError
        When ``itemsize`` is too small for the message.
    """
    fields: list[tuple[str, Any, int]] = []
    if encoding == 'cdr':
        start = ENCAPSULATION_BYTES
        fields += [('representation', '>u2', 0)]
        fields += [('sec', f'{order}i4', start)]
    else:
        start = 4
        fields += [('seq', f'{order}u4', 0), ('sec', f'{order}u4', start)]
    fields += [('nanosec', f'{order}u4', start + 4), ('frame_bytes', f'{order}u4', start + 8)]
    fields += [('frame_id', (np.void, frame_bytes), start + 12)]
    offset = start + 12 + frame_bytes
    if encoding == 'cdr':
        offset += -(offset - start) % _DOUBLE
    for name, count in _VECTORS:
        fields += [(name, (f'{order}f8', (count,)), offset)]
        offset += count * _DOUBLE
    names, formats, offsets = zip(*fields)
    return np.dtype(
        {
            'names': list(names),
            'formats': list(formats),
            'offsets': list(offsets),
            'itemsize': itemsize or offset,
        }
    )


def decode_imus(
    payloads: Sequence[bytes | memoryview] | NDArray[np.void], encoding: Encoding
) -> DecodedImus:
    """Decode serialized Imu messages, all at once where their layout is the same.

    ``payloads`` are any bytes, or one array of them where all have the same length.

    Raises
    ------
    MalformedMessage
        Naming the first payload that cannot be an Imu.
    """
    n = len(payloads)
    decoded = DecodedImus(
        np.empty(n, np.int64), np.empty((len(AXES), n)).T, [], np.zeros(n, dtype=np.intp)
    )
    if isinstance(payloads, np.ndarray):
        _decode_equal(payloads, encoding, slice(0, n), decoded)
        return decoded
    lengths = np.fromiter(map(len, payloads), dtype=np.int64, count=n)
    for length in np.unique(lengths):
        rows = np.flatnonzero(lengths == length)
        same = payloads if len(rows) == n else [payloads[row] for row in rows.tolist()]
        if not length:
            raise _too_few(int(rows[0]), 0)
        joined = np.frombuffer(b''.join(same), np.dtype((np.void, int(length))))
        _decode_equal(joined, encoding, slice(0, n) if len(rows) == n else rows, decoded)
    return decoded


def is_imu(payload: bytes, encoding: Encoding) -> bool:
    """Tell whether one payload can be decoded."""
    try:
        decode_imus([payload], encoding)
    except MalformedMessage:
        return False
    return True


def _too_few(index: int, length: int) -> MalformedMessage:
    return MalformedMessage(index, f'{length} bytes are too few for an Imu')


def _decode_equal(
    payloads: NDArray[np.void], encoding: Encoding, rows: Rows, into: DecodedImus
) -> None:
    """Decode payloads of one length; those of another byte order or frame length apart."""
    length = payloads.itemsize
    if length < imu_dtype(encoding, '<', 0).itemsize:
        raise _too_few(_first(rows), length)
    head = payloads.view(imu_dtype(encoding, '<', 0, length))
    # What decides the layout, as one integer: the byte order and the raw length field.
    kind = head['frame_bytes'].astype(np.int64)
    if encoding == 'cdr':
        kind += head['representation'].astype(np.int64) << 32
    if (kind == kind[:1]).all():
        _decode_alike(payloads, int(kind[0]), encoding, rows, into)
        return
    places = np.arange(len(into.frames))[rows]
    for value in np.unique(kind):
        chosen = kind == value
        _decode_alike(payloads[chosen], int(value), encoding, places[chosen], into)


def _decode_alike(
    payloads: NDArray[np.void], kind: int, encoding: Encoding, rows: Rows, into: DecodedImus
) -> None:
    """Decode payloads of one layout."""
    order, frame_bytes = _order_and_frame_bytes(kind, encoding, _first(rows))
    try:
        dtype = imu_dtype(encoding, order, frame_bytes, payloads.itemsize)
    except (ValueError, OverflowError) as error:
        reason = f'its frame_id of {frame_bytes} bytes does not fit {payloads.itemsize} bytes'
        raise MalformedMessage(_first(rows), reason) from error
    if frame_bytes > MAX_NAME:
        raise MalformedMessage(_first(rows), f'its frame_id of {frame_bytes} bytes is no name')
    _fill(payloads.view(dtype), encoding, rows, into)


def _first(rows: Rows) -> int:
    """Return the place of the first message of some rows."""
    return int(rows.start if isinstance(rows, slice) else rows[0])


def _order_and_frame_bytes(kind: int, encoding: Encoding, index: int) -> tuple[str, int]:
    raw_length = (kind & 0xFFFFFFFF).to_bytes(4, 'little')
    representation = kind >> 32
    if encoding == 'ros1':
        return '<', int.from_bytes(raw_length, 'little')
    if representation == LITTLE_ENDIAN:
        return '<', int.from_bytes(raw_length, 'little')
    if representation == BIG_ENDIAN:
        return '>', int.from_bytes(raw_length, 'big')
    raise MalformedMessage(index, f'its encapsulation {representation:#06x} is not plain CDR')


def _fill(records: NDArray[Any], encoding: Encoding, rows: Rows, into: DecodedImus) -> None:
    """Write the records of one layout to their rows."""
    into.stamps_ns[rows] = records['sec'].astype(np.int64) * NANOSECONDS + records['nanosec']
    for name, axes in SENSORS.items():
        for i, axis in enumerate(range(len(AXES))[axes]):
            into.samples[rows, axis] = records[name][:, i]
        first = records[f'{name}_covariance'][:, 0].copy()
        if not first.min() >= 0.0:  # NaN is neither
            absent = (first == ABSENT) | np.isnan(first)
            into.samples[np.arange(len(into.frames))[rows][absent], axes] = np.nan

    distinct, which = _distinct(records['frame_id'])
    texts = [
        name.rstrip(b'\0' if encoding == 'cdr' else b'').decode(errors='replace')
        for name in distinct
    ]
    for text in texts:
        if text not in into.frame_ids:
            into.frame_ids.append(text)
    places = [into.frame_ids.index(text) for text in texts]
    into.frames[rows] = places[0] if len(places) == 1 else np.array(places)[which]


def _distinct(names: NDArray[np.void]) -> tuple[list[bytes], NDArray[np.intp]]:
    """Return the distinct items of an array, and which of them each item is."""
    if not names.itemsize:
        return [b''], np.zeros(len(names), np.intp)
    size, flat = names.itemsize, names.copy().view(np.uint8)
    if (flat[size:] == flat[: len(flat) - size]).all():
        return [flat[:size].tobytes()], np.zeros(len(names), np.intp)
    distinct, which = np.unique(flat.reshape(-1, size), axis=0, return_inverse=True)
    # numpy 2.0 returned it as a column
    return [name.tobytes() for name in distinct], which.reshape(-1)


def encode_imus(batch: ImuBatch, encoding: Encoding, order: str = '<') -> list[memoryview]:
    """Serialize a batch to one payload a sample, in one go.

    Axes of a sensor that are all NaN are written as an absent sensor (zeros, covariance[0] -1), the
    orientation always is.
    """
    frame = batch.frame_id.encode() + (b'\0' if encoding == 'cdr' else b'')
    dtype = imu_dtype(encoding, order, len(frame))
    records = np.zeros(len(batch), dtype)
    if encoding == 'cdr':
        records['representation'] = LITTLE_ENDIAN if order == '<' else BIG_ENDIAN
    records['sec'], records['nanosec'] = np.divmod(batch.stamps_ns, NANOSECONDS)
    records['frame_bytes'] = len(frame)
    records['frame_id'] = np.void(frame)
    records['orientation'][:, 3] = 1.0
    records['orientation_covariance'][:, 0] = ABSENT
    for name, axes in SENSORS.items():
        values = batch.samples[:, axes]
        absent = np.asarray(np.isnan(values).all(axis=1))
        records[name] = np.where(absent[:, None], 0.0, values)
        records[f'{name}_covariance'][absent, 0] = ABSENT
    joined = memoryview(records.tobytes())
    size = dtype.itemsize
    return [joined[start : start + size] for start in range(0, len(joined), size)]


PATCHED_SENSORS = ('gyro', 'accel')
"""Of these the covariance is written; that of the orientation never is."""


_ORDERS = {bytes([0, LITTLE_ENDIAN]): '<', bytes([0, BIG_ENDIAN]): '>'}
"""The first two bytes of the encapsulation -> byte order."""


_FRAME_BYTES_AT = ENCAPSULATION_BYTES + 8
"""Where the length of frame_id stands, behind sec and nanosec."""


_FRAME_AT = _FRAME_BYTES_AT + 4

_COVARIANCE = 9
"""Numbers in a covariance, row by row."""


_COVARIANCE_BYTES = 8 * _COVARIANCE

_UNKNOWN = bytes(_COVARIANCE_BYTES)
"""All zeros say that the covariance is not known (sensor_msgs/Imu.msg)."""


_LENGTH = {order: struct.Struct(f'{order}I') for order in '<>'}

_NUMBERS = {order: struct.Struct(f'{order}{_COVARIANCE}d') for order in '<>'}


class CovariancePatch:
    """Writes known variances into the covariances of CDR payloads.

    A covariance whose first number is -1 (or NaN) says that the sensor is absent and stays; one
    that is not all zeros is the driver's and stays, too, unless ``overwrite``.

    Parameters
    ----------
    variances : mapping of 'gyro' and 'accel' to (x, y, z)
        (rad/s)^2 and (m/s^2)^2; a sensor that is left out stays as it is.
    overwrite : bool
    frame_id : str
        Only messages of this frame are patched; '' for all.
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
        """Return the message with its covariances filled; the same object if nothing was to fill.

        Raises
        ------
        MalformedMessage
            When the payload is no Imu in plain CDR.
        """
        order, frame_bytes = _order_and_frame_size(payload)
        offsets = _covariance_offsets(order, frame_bytes, len(payload))
        if self._frame:
            frame = payload[_FRAME_AT : _FRAME_AT + frame_bytes]
            if frame.rstrip(b'\0') != self._frame:
                return payload
        patched = None
        for sensor, covariance in self._packed[order]:
            start = offsets[sensor]
            stop = start + _COVARIANCE_BYTES
            if not self._is_free(payload[start:stop], order):
                continue
            if patched is None:
                patched = bytearray(payload)
            patched[start:stop] = covariance
        return payload if patched is None else bytes(patched)

    def _is_free(self, covariance: bytes, order: str) -> bool:
        """Return whether this covariance may be written."""
        if covariance == _UNKNOWN:
            return True
        numbers = _NUMBERS[order].unpack(covariance)
        if numbers[0] == ABSENT or numbers[0] != numbers[0]:
            return False
        return self._overwrite or not any(numbers)


def frame_id_of(payload: bytes) -> str:
    """Return header.frame_id of a CDR payload.

    Raises
    ------
    MalformedMessage
        When the payload is no Imu in plain CDR.
    """
    order, frame_bytes = _order_and_frame_size(payload)
    _covariance_offsets(order, frame_bytes, len(payload))
    frame = payload[_FRAME_AT : _FRAME_AT + frame_bytes]
    return frame.rstrip(b'\0').decode(errors='replace')


def _order_and_frame_size(payload: bytes) -> tuple[str, int]:
    order = _ORDERS.get(payload[:2])
    if order is None or len(payload) < _FRAME_AT:
        raise MalformedMessage(0, f'{len(payload)} bytes that do not begin as plain CDR')
    (frame_bytes,) = _LENGTH[order].unpack_from(payload, _FRAME_BYTES_AT)
    if frame_bytes > len(payload):
        raise MalformedMessage(0, f'its frame_id of {frame_bytes} bytes does not fit')
    return order, frame_bytes


@lru_cache(maxsize=256)
def _covariance_offsets(order: str, frame_bytes: int, length: int) -> dict[str, int]:
    """Return where the covariances begin in a payload of that length."""
    try:
        fields = imu_dtype('cdr', order, frame_bytes, length).fields
    except ValueError as error:
        raise MalformedMessage(0, f'{length} bytes are too few for an Imu') from error
    assert fields is not None
    return {sensor: fields[f'{sensor}_covariance'][1] for sensor in PATCHED_SENSORS}
