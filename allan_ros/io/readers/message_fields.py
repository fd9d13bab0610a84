# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of other types with a `sensor_msgs/Imu` field, read by the schema in the bag.

This needs the package ``rosbags``, which parses schemas and deserializes messages of any type.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np

from ...core.imu import SENSORS
from .cdr import NANOSECONDS, DecodedImus, MalformedMessage
from .storage import Payloads, Topic, as_list, optional_package

IMU_TYPE = 'sensor_msgs/msg/Imu'

MAX_DEPTH = 8
"""Messages nested deeper than this are not searched."""

STANDARD_PACKAGES = re.compile(
    '(actionlib|diagnostic|geometry|map|nav|rosgraph|sensor|shape|std|stereo|tf2|trajectory|'
    'unique_identifier|visualization)_msgs|builtin_interfaces|rcl_interfaces'
)
"""Packages of message types that need no schema."""

IDL_SEPARATOR = '=' * 80 + '\n'


def imu_fields(topic: Topic) -> list[tuple[str, ...]]:
    """Return the path of every Imu field in the topic's type.

    The list is empty where there is none, or the bag has no usable schema.

    Raises AllanError when the schema mentions an Imu, but ``rosbags`` is not installed.
    """
    definitions = _definitions(topic)
    return list(_search(topic.type, definitions, ())) if definitions else []


def is_unknown(topic: Topic) -> bool:
    """Return whether the content of the messages is unknown: no schema, no standard package."""
    return not topic.schema and not STANDARD_PACKAGES.fullmatch(topic.type.split('/')[0])


def _search(
    name: str, definitions: dict[str, Any], above: tuple[str, ...]
) -> list[tuple[str, ...]]:
    from rosbags.interfaces import Nodetype

    if name == IMU_TYPE:
        return [above]
    if name not in definitions or len(above) == MAX_DEPTH:
        return []
    found = []
    for field, (kind, inner) in definitions[name][1]:
        if kind == Nodetype.NAME:
            found += _search(inner, definitions, (*above, field))
    return found


def _definitions(topic: Topic) -> dict[str, Any]:
    """Return the parsed schema of a topic; empty if it has none or it is invalid."""
    if 'Imu' not in topic.schema:
        return {}
    typesys = optional_package('rosbags.typesys', f'reading an Imu inside {topic.type}')
    definitions: dict[str, Any] = {}
    try:
        if topic.schema_format in ('ros2msg', 'ros1msg'):
            definitions = dict(typesys.get_types_from_msg(topic.schema, topic.type))
        elif topic.schema_format in ('ros2idl', 'omgidl'):
            for part in topic.schema.split(IDL_SEPARATOR):
                text = part.split('\n', 1)[1] if part.startswith('IDL: ') else part
                if text.strip():
                    definitions.update(typesys.get_types_from_idl(text))
    except typesys.TypesysError:
        return {}
    return definitions


def nested_decoder(
    topic: Topic, field: tuple[str, ...], trust_covariance: bool
) -> Callable[[Payloads], DecodedImus]:
    """Return a function that decodes the Imu in that field of the topic's messages.

    The path of the field is one of `imu_fields`; ``trust_covariance`` is as in `decode_imus`.
    """
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(_definitions(topic))
    deserialize = store.deserialize_ros1 if topic.encoding == 'ros1' else store.deserialize_cdr

    def decode(payloads: Payloads) -> DecodedImus:
        decoded = DecodedImus.empty(len(payloads))
        first = {sensor: np.empty(len(payloads)) for sensor in SENSORS}
        for row, payload in enumerate(as_list(payloads)):
            try:
                message = deserialize(payload, topic.type)
            except Exception as error:  # the generated code may raise anything
                raise MalformedMessage(row, f'it does not match its schema: {error}') from error
            imu = reduce(getattr, field, message)
            _copy(imu, row, decoded)
            first['gyro'][row] = imu.angular_velocity_covariance[0]
            first['accel'][row] = imu.linear_acceleration_covariance[0]
        for sensor in SENSORS:
            decoded.drop_absent(sensor, slice(None), first[sensor], trust_covariance)
        return decoded

    return decode


def _copy(imu: Any, row: int, into: DecodedImus) -> None:
    """Copy a deserialized Imu to its row."""
    into.stamps_ns[row] = imu.header.stamp.sec * NANOSECONDS + imu.header.stamp.nanosec
    for axes, vector in (('gyro', imu.angular_velocity), ('accel', imu.linear_acceleration)):
        into.samples[row, SENSORS[axes]] = vector.x, vector.y, vector.z
    frame_id = imu.header.frame_id
    if frame_id not in into.frame_ids:
        into.frame_ids.append(frame_id)
    into.frames[row] = into.frame_ids.index(frame_id)
