# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write covariances into serialized Imu messages: nothing else of them changes, not by one bit."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from functools import lru_cache

from .imu_cdr import (
    ABSENT,
    BIG_ENDIAN,
    ENCAPSULATION_BYTES,
    LITTLE_ENDIAN,
    MalformedMessage,
    imu_dtype,
)

SENSORS = ('gyro', 'accel')
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
        order, frame_bytes = _order_and_frame_bytes(payload)
        offsets = _offsets(order, frame_bytes, len(payload))
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
    order, frame_bytes = _order_and_frame_bytes(payload)
    _offsets(order, frame_bytes, len(payload))
    frame = payload[_FRAME_AT : _FRAME_AT + frame_bytes]
    return frame.rstrip(b'\0').decode(errors='replace')


def _order_and_frame_bytes(payload: bytes) -> tuple[str, int]:
    order = _ORDERS.get(payload[:2])
    if order is None or len(payload) < _FRAME_AT:
        raise MalformedMessage(0, f'{len(payload)} bytes that do not begin as plain CDR')
    (frame_bytes,) = _LENGTH[order].unpack_from(payload, _FRAME_BYTES_AT)
    if frame_bytes > len(payload):
        raise MalformedMessage(0, f'its frame_id of {frame_bytes} bytes does not fit')
    return order, frame_bytes


@lru_cache(maxsize=256)
def _offsets(order: str, frame_bytes: int, length: int) -> dict[str, int]:
    """Return where the covariances begin in a payload of that length."""
    try:
        fields = imu_dtype('cdr', order, frame_bytes, length).fields
    except ValueError as error:
        raise MalformedMessage(0, f'{length} bytes are too few for an Imu') from error
    assert fields is not None
    return {sensor: fields[f'{sensor}_covariance'][1] for sensor in SENSORS}
