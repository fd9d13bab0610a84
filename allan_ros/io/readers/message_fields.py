# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of other types that carry a `sensor_msgs/Imu` in a field, read by their own schema."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np

from ...core.imu import AXES
from .cdr import ABSENT, NANOSECONDS, DecodedImus, MalformedMessage
from .storage import Payloads, Topic, as_list

IMU_TYPE = 'sensor_msgs/msg/Imu'

MAX_DEPTH = 8
"""Messages nested deeper than this are not searched."""

IDL_SEPARATOR = '=' * 80 + '\n'


def imu_fields(topic: Topic) -> list[tuple[str, ...]]:
    """Return the path of every field of the topic's type that is an Imu.

    Empty where there is none, or where the bag has no schema that tells.
    """
    definitions = _definitions(topic)
    return list(_search(topic.type, definitions, ())) if definitions else []


def is_unknown(topic: Topic) -> bool:
    """Tell whether nothing says what the topic's messages hold: no schema, no standard type."""
    from rosbags.typesys import Stores, get_typestore

    return not topic.schema and topic.type not in get_typestore(Stores.LATEST).fielddefs


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
    """Parse the schema of a topic; empty if it has none or it cannot be understood."""
    from rosbags.typesys import TypesysError, get_types_from_idl, get_types_from_msg

    definitions: dict[str, Any] = {}
    try:
        if topic.schema_format in ('ros2msg', 'ros1msg'):
            definitions = dict(get_types_from_msg(topic.schema, topic.type))
        elif topic.schema_format in ('ros2idl', 'omgidl'):
            for part in topic.schema.split(IDL_SEPARATOR):
                text = part.split('\n', 1)[1] if part.startswith('IDL: ') else part
                if text.strip():
                    definitions.update(get_types_from_idl(text))
    except TypesysError:
        return {}
    return definitions


def nested_decoder(topic: Topic, field: tuple[str, ...]) -> Callable[[Payloads], DecodedImus]:
    """Return what decodes the Imu in that field of the topic's messages."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(_definitions(topic))
    deserialize = store.deserialize_ros1 if topic.encoding == 'ros1' else store.deserialize_cdr

    def decode(payloads: Payloads) -> DecodedImus:
        n = len(payloads)
        decoded = DecodedImus(
            np.empty(n, np.int64), np.empty((n, len(AXES))), [], np.empty(n, dtype=np.intp)
        )
        for row, payload in enumerate(as_list(payloads)):
            try:
                message = deserialize(payload, topic.type)
            except Exception as error:  # the library raises what its generated code runs into
                raise MalformedMessage(row, f'it does not match its schema: {error}') from error
            _take(reduce(getattr, field, message), row, decoded)
        return decoded

    return decode


def _take(imu: Any, row: int, into: DecodedImus) -> None:
    """Write one deserialized Imu to its row."""
    stamp = imu.header.stamp
    into.stamps_ns[row] = stamp.sec * NANOSECONDS + stamp.nanosec
    for axes, vector, covariance in (
        (slice(0, 3), imu.angular_velocity, imu.angular_velocity_covariance),
        (slice(3, 6), imu.linear_acceleration, imu.linear_acceleration_covariance),
    ):
        absent = covariance[0] == ABSENT or np.isnan(covariance[0])
        into.samples[row, axes] = np.nan if absent else (vector.x, vector.y, vector.z)
    frame_id = imu.header.frame_id
    if frame_id not in into.frame_ids:
        into.frame_ids.append(frame_id)
    into.frames[row] = into.frame_ids.index(frame_id)
