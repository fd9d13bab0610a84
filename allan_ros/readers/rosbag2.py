# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read the samples of an Imu topic, and the temperature of the IMU, from a bag.

The Imu topic is found by its message type. Messages are decoded in blocks, so the required memory
hardly depends on the size of the bag.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.errors import AllanError
from ..core.findings import finding
from ..core.imu import AXES, SENSORS, ImuBatch, joined
from ..core.stream.signal import Decimated, TemperatureTrace, trace_of
from .bag import ENCODINGS, Bag, Survey, TopicKey, bag_of
from .bag_messages import Messages, Payloads, Topic, among, decompress, frame_compression
from .cdr import IMU_TYPE, Encoding, MalformedMessage, decode_imus, decode_temperature
from .recording import (
    BATCH,
    MAX_CHUNK_BYTES,
    METADATA,
    ReadOptions,
    Recording,
    Report,
    SourceInfo,
    in_batches,
    listed,
)

if TYPE_CHECKING:
    from .bag import Storage

MAX_MESSAGE_BYTES = 2**16
"""Largest accepted size in bytes of a message that is compressed separately, after decompression.
An Imu message has less than 2 kB."""

MAX_TOPICS = 100
"""Largest number of Imu topics of a bag that are all analyzed. If there are more, the user must
select one topic, because each topic is read separately."""


def imu_topics(path: Path) -> list[str]:
    """Return the Imu topics of a bag, as `ReadOptions.topic` accepts them.

    Topics without messages are included only if no Imu topic has messages. The list is empty if the
    bag has more than `MAX_TOPICS` Imu topics. Raises AllanError when the bag cannot be read.
    """
    bag = bag_of(path)
    imu_keys: dict[TopicKey, None] = {}
    for file in bag.files if bag.described is None else ():
        topics = bag.storage(file).topics
        imu_keys |= {(t.name, t.type): None for t in topics if t.type == IMU_TYPE}
    # messages are counted only if necessary, because counting reads an sqlite3 file completely
    imus = [*imu_keys] if len(imu_keys) == 1 else bag.survey().imus()
    bag.close()
    return [name for name, _ in imus] if len(imus) <= MAX_TOPICS else []


def chosen_topic(path: Path, survey: Survey, wanted: str, accel_topic: str = '') -> Topic:
    """Return the Imu topic with the name ``wanted``, or the only Imu topic if ``wanted`` is ''.

    Without a name, Imu topics without messages are considered only if no Imu topic has messages.

    Parameters
    ----------
    path : Path
        Path of the bag, for error messages.
    survey : Survey
        The topics of the bag.
    wanted : str
        Name of a topic, with or without a leading slash; '' for the only Imu topic.
    accel_topic : str
        Topic with only the accelerometer. It is returned only if ``wanted`` is its name.

    Raises
    ------
    AllanError
        When there is no such topic, when ``wanted`` is '' and several Imu topics are considered, or
        when the messages of the topic are missing or cannot be decoded.
    """
    imus = [key for key in survey.imus() if key[0].lstrip('/') != accel_topic.lstrip('/')]
    candidates = [_named(path, survey, wanted)] if wanted else imus
    if not candidates:
        raise _no_imu(path, survey)
    if len(candidates) > 1:
        labels = listed([f'{key[0]} ({survey.counts[key]})' for key in candidates])
        raise AllanError(
            f'{path}: has {len(candidates)} Imu topics: {labels}: choose one with --topic'
        )
    topic = survey.topics[candidates[0]]
    if topic.encoding not in ENCODINGS:
        raise AllanError(
            f'{path}: topic {topic.name} is serialized as {topic.encoding!r}: only '
            f'{" and ".join(ENCODINGS)} can be read; convert the bag with "ros2 bag convert"'
        )
    if not survey.counts[candidates[0]]:
        raise no_message(path, topic.name)
    return topic


def no_message(path: Path, name: str) -> AllanError:
    return AllanError(
        f'{path}: topic {name} has no message: check that the driver was running and record again'
    )


def _named(path: Path, survey: Survey, wanted: str) -> TopicKey:
    """Return the Imu topic with the name ``wanted``, with or without a leading slash."""
    topic_keys = [key for key in survey.topics if key[0].lstrip('/') == wanted.lstrip('/')]
    imu_keys = [key for key in survey.topics if key[1] == IMU_TYPE]
    matching = [key for key in topic_keys if key in imu_keys]
    if matching:
        return matching[0]
    if not topic_keys:
        existing = survey.listed(imu_keys or survey.topics) or 'none'
        problem = f'has no topic {wanted}; it has {existing}: check --topic'
    else:
        problem = (
            f'topic {wanted} is of type {topic_keys[0][1]}, not sensor_msgs/Imu: choose another '
            'with --topic'
        )
    raise AllanError(f'{path}: {problem}')


def _no_imu(path: Path, survey: Survey) -> AllanError:
    truncation = survey.truncation
    truncation_text = (
        f'; only {truncation.read} of {truncation.size} bytes could be read (copy it again)'
        if truncation
        else ''
    )
    keys_by_count = sorted(survey.topics, key=lambda key: (-survey.counts[key], key))
    return AllanError(
        f'{path}: no sensor_msgs/Imu topic; it has {survey.listed(keys_by_count) or "no topic"}'
        f'{truncation_text}: record the topic of the IMU'
    )


# --- samples --------------------------------------------------------------------------------------


def open_bag(path: Path, options: ReadOptions) -> Recording:
    """Open the Imu topic of a bag as a recording; ``path`` is a bag folder or a bag file.

    Raises AllanError when the bag cannot be read, when a needed Imu topic is missing, when several
    Imu topics have messages and the options select none of them, or when the topic has no messages
    or its serialization is not one of `ENCODINGS`.
    """
    bag = bag_of(path)
    survey = bag.survey()
    topic = chosen_topic(path, survey, options.topic, options.accel_topic)
    topics = [topic for topic in survey.topics.values() if topic.encoding in ENCODINGS]

    def recording(topic: Topic, axes: tuple[str, ...], accel: Recording | None) -> Recording:
        other_names = [name for name, _ in survey.imus() if name != topic.name]
        reader = _Reader(bag, topic, options, _thermometers(topics, topic.name))
        return Recording(
            info=SourceInfo(str(path), topic.name, topic.type, bag.format),
            messages=survey.counts[topic.name, topic.type] + (accel.messages or 0 if accel else 0),
            read=reader.read,
            temperature=reader.temperature,
            options=options,
            axes=axes,
            close=bag.close,
            accel=accel,
            other_topics=sorted(other_names, key=lambda name: -_shared_parts(name, topic.name)),
        )

    if not options.accel_topic:
        return recording(topic, AXES, None)
    accel_topic = chosen_topic(path, survey, options.accel_topic)
    accel = recording(accel_topic, AXES[SENSORS['accel']], None)
    return recording(topic, AXES[SENSORS['gyro']], accel)


@dataclass
class _Reader:
    """Reads the messages of one Imu topic, and of the topics that may contain its temperature."""

    bag: Bag
    topic: Topic
    options: ReadOptions
    thermometers: list[Topic]
    # for each Temperature topic: record time in ns and payload of some of the messages
    _temperatures: list[Decimated[tuple[int, bytes]]] = field(default_factory=list)
    # sensor -> number of messages that wrongly declare the sensor absent
    _wrongly_absent: Counter[str] = field(default_factory=Counter)

    def read(self, report: Report) -> Iterator[ImuBatch]:
        """Yield the samples of all files in order, in SI; call ``report`` with each finding."""
        self._temperatures = [Decimated() for _ in self.thermometers]
        self._wrongly_absent.clear()
        bag, key, total = self.bag, (self.topic.name, self.topic.type), 0
        stated_counts = bag.described.counts if bag.described else {}
        for file in bag.files:
            storage = bag.storage(file)
            if truncation := storage.truncation:
                report(finding('bag_cut', path=file, read=truncation.read, size=truncation.size))
            samples_of_file = 0
            for batch in _rebatched(self._decoded(file, self._blocks(storage))):
                samples_of_file += len(batch)
                yield self.options.in_si(batch)
            if key not in stated_counts:
                stated_count = storage.stated_count(_ids(storage, self.topic), samples_of_file)
                _compare(stated_count, samples_of_file, file, report)
            total += samples_of_file
        bag.close()
        if key in stated_counts:
            _compare(stated_counts[key], total, bag.path / METADATA, report)
        for sensor, count in sorted(self._wrongly_absent.items()):
            axes = AXES[SENSORS[sensor]]
            report(finding('covariance_ignored', axes, count=count, sensor=sensor, read=total))
        if not total:
            raise no_message(bag.path, self.topic.name)

    def _blocks(self, storage: Storage) -> Iterator[Messages]:
        imu_ids, *thermometer_ids = (
            _ids(storage, topic) for topic in (self.topic, *self.thermometers)
        )
        for block in storage.blocks(imu_ids.union(*thermometer_ids)):
            for topic_ids, messages in zip(thermometer_ids, self._temperatures):
                for row in np.flatnonzero(among(block.topics, topic_ids)).tolist():
                    messages.add((int(block.record_ns[row]), bytes(block.payloads[row])))
            rows = np.flatnonzero(among(block.topics, imu_ids))
            yield block if len(rows) == len(block) else block.chosen(rows)

    def _decoded(self, file: Path, blocks: Iterable[Messages]) -> Iterator[ImuBatch]:
        earlier_messages = 0  # number of messages in earlier blocks
        for block in blocks:
            try:
                imus = decode_imus(_decompressed(block.payloads), _encoding(self.topic))
            except MalformedMessage as error:
                raise AllanError(
                    f'{file}: message {earlier_messages + error.index + 1} of {self.topic.name} is '
                    f'not a {self.topic.type} ({error}): record it again'
                ) from error
            self._wrongly_absent.update(imus.kept)
            yield from imus.batches(block.record_ns)
            earlier_messages += len(block)

    def temperature(self, frame_id: str) -> TemperatureTrace | None:
        """Return the temperature of the IMU over time; None if it is not known.

        If there is one Temperature topic, it is used. If there are several, the topic with the
        ``frame_id`` of the IMU is used, if exactly one topic has this frame_id. The result is also
        None if the used topic contains no plausible temperature.
        """
        readings_by_topic = [
            (topic, [t for message in messages if (t := _temperature(topic, *message))])
            for topic, messages in zip(self.thermometers, self._temperatures)
        ]
        if len(readings_by_topic) > 1:
            readings_by_topic = [
                (topic, readings)
                for topic, readings in readings_by_topic
                if readings and readings[0][1] == frame_id
            ]
        if len(readings_by_topic) != 1:
            return None
        ((topic, readings),) = readings_by_topic
        return trace_of(topic.name, [reading for reading, _ in readings])


def _ids(storage: Storage, topic: Topic) -> set[int]:
    return {t.id for t in storage.topics if (t.name, t.type) == (topic.name, topic.type)}


def _compare(stated: int, read: int, where: Path, report: Report) -> None:
    if stated != read:
        report(finding('count_differs', path=where, stated=stated, read=read))


def _encoding(topic: Topic) -> Encoding:
    return 'ros1' if topic.encoding == 'ros1' else 'cdr'


def _rebatched(batches: Iterable[ImuBatch]) -> Iterator[ImuBatch]:
    """Yield the same samples in batches of at most `BATCH` samples with one frame_id each."""
    parts: list[ImuBatch] = []
    count = 0
    for batch in batches:
        if parts and (batch.frame_id != parts[0].frame_id or count + len(batch) > BATCH):
            yield from in_batches(joined(parts))
            parts, count = [], 0
        parts.append(batch)
        count += len(batch)
    if parts:
        yield from in_batches(joined(parts))


def _decompressed(payloads: Payloads) -> Payloads:
    compression = frame_compression(bytes(payloads[0])) if len(payloads) else ''
    if not compression:
        return payloads
    decompressed: list[bytes | memoryview] = []
    size = 0
    for payload in payloads:
        try:
            decompressed.append(decompress(bytes(payload), compression, MAX_MESSAGE_BYTES))
            size += len(decompressed[-1])
            if size > MAX_CHUNK_BYTES:
                raise ValueError(f'messages expand to more than {MAX_CHUNK_BYTES} bytes')
        except ValueError as error:
            raise MalformedMessage(len(decompressed), f'{compression} {error}') from error
    return decompressed


TEMPERATURE_TYPE = 'sensor_msgs/msg/Temperature'

MAX_THERMOMETERS = 16
"""Largest number of Temperature topics that are read. If more topics share the longest namespace
with the Imu topic, no temperature is read."""


def _thermometers(topics: Sequence[Topic], imu_topic: str) -> list[Topic]:
    """Return the Temperature topics that have the longest common namespace with the Imu topic.

    The list is empty if there are more than `MAX_THERMOMETERS` such topics.
    """
    temperature_topics = [topic for topic in topics if topic.type == TEMPERATURE_TYPE]
    longest = max((_shared_parts(topic.name, imu_topic) for topic in temperature_topics), default=0)
    nearest_topics = [
        topic for topic in temperature_topics if _shared_parts(topic.name, imu_topic) == longest
    ]
    return nearest_topics if len(nearest_topics) <= MAX_THERMOMETERS else []


def _shared_parts(name: str, other: str) -> int:
    """Return how many parts at the start of two topic names are equal; '/' separates the parts."""
    pairs = list(zip(name.strip('/').split('/'), other.strip('/').split('/')))
    parts_are_equal = [a == b for a, b in pairs]
    return parts_are_equal.index(False) if False in parts_are_equal else len(parts_are_equal)


def _temperature(
    topic: Topic, record_ns: int, payload: bytes
) -> tuple[tuple[int, int, float], str] | None:
    """Return (header stamp in ns, record time in ns, degC) and the frame_id of a message.

    Returns None if the message is damaged.
    """
    with suppress(MalformedMessage, ValueError):
        decompressed = decompress(payload, frame_compression(payload), MAX_MESSAGE_BYTES)
        header_ns, frame_id, celsius = decode_temperature(decompressed, _encoding(topic))
        return (header_ns, record_ns, celsius), frame_id
    return None
