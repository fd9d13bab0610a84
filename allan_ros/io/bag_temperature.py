# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The `sensor_msgs/Temperature` that a bag holds beside the Imu it is of."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .bag_folder import open_storage
from .bag_storage import Topic, as_list, decompress, frame_compression
from .imu_cdr import NANOSECONDS
from .temperature import TemperatureTrace, Thinned, trace_of

TEMPERATURE_TYPE = 'sensor_msgs/msg/Temperature'

Message = tuple[int, bytes]
"""When it was recorded, ns, and its serialized bytes."""


class Reading(NamedTuple):
    """One message: its two times, its temperature (NaN where it is damaged) and its frame."""

    header_ns: int
    record_ns: int
    celsius: float
    frame_id: str


def bag_temperature(
    files: Sequence[Path], topics: Sequence[Topic], imu_topic: str, frame_id: str
) -> TemperatureTrace | None:
    """Return the temperature of an IMU, or None where the bag has none or does not tell which.

    A topic is the IMU's when it is the only one of its type, the only one in the namespace of the
    Imu topic, or, of several such, the only one with its frame_id.

    Parameters
    ----------
    files : sequence of path
        The storage files of the bag, in order.
    topics : sequence of Topic
        All that the bag has.
    imu_topic, frame_id : str
        Of the Imu that was read.
    """
    near = _nearest([t for t in topics if t.type == TEMPERATURE_TYPE], imu_topic)
    if len(near) > 1:
        near = [topic for topic in near if _frame_of_first(files, topic) == frame_id]
    if len(near) != 1:
        return None
    kept: Thinned[Message] = Thinned()
    for message in _messages(files, near[0]):
        kept.add(message)
    return trace_of(near[0].name, (reading[:3] for reading in map(_decoder(near[0]), kept)))


def _nearest(topics: Sequence[Topic], imu_topic: str) -> list[Topic]:
    """Return the topics that share most of their namespace with the Imu topic."""

    def shared(topic: Topic) -> int:
        pairs = list(zip(topic.name.strip('/').split('/'), imu_topic.strip('/').split('/')))
        alike = [a == b for a, b in pairs]
        return alike.index(False) if False in alike else len(alike)

    most = max(map(shared, topics), default=0)
    return [topic for topic in topics if shared(topic) == most]


def _frame_of_first(files: Sequence[Path], topic: Topic) -> str | None:
    first = next(_messages(files, topic), None)
    return None if first is None else _decoder(topic)(first).frame_id


def _messages(files: Sequence[Path], topic: Topic) -> Iterator[Message]:
    for file in files:
        with open_storage(file) as (storage, _):
            ids = {t.id for t in storage.topics if (t.name, t.type) == (topic.name, topic.type)}
            for block in storage.blocks(ids) if ids else ():
                yield from zip(block.record_ns.tolist(), map(bytes, as_list(block.payloads)))


def _decoder(topic: Topic) -> Callable[[Message], Reading]:
    from rosbags.typesys import Stores, get_typestore

    ros1 = topic.encoding == 'ros1'
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.LATEST)
    read = store.deserialize_ros1 if ros1 else store.deserialize_cdr

    def decode(message: Message) -> Reading:
        record_ns, payload = message
        try:
            found: Any = read(decompress(payload, frame_compression(payload)), topic.type)
        except Exception:  # the library raises what its generated code runs into
            return Reading(record_ns, record_ns, float('nan'), '')
        header = found.header
        header_ns = header.stamp.sec * NANOSECONDS + header.stamp.nanosec
        return Reading(header_ns, record_ns, float(found.temperature), header.frame_id)

    return decode
