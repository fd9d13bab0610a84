# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags: the messages of an Imu topic as batches, and the temperature of the IMU."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial, reduce
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...core.errors import AllanError
from ...core.findings import finding
from ...core.imu import AXES, NANOSECONDS, SENSORS, ImuBatch, joined
from ..signal import Decimated, TemperatureTrace, trace_of
from .bag_topics import ENCODINGS, ImuSource, chosen_source, definitions_of, no_message, survey_bag
from .cdr import DecodedImus, Encoding, MalformedMessage, decode_imus, decode_temperature
from .open import METADATA, BagFiles, bag_files, open_storage
from .recording import BATCH, ReadOptions, Recording, Report, SourceInfo, in_batches
from .storage import (
    MAX_MESSAGE_BYTES,
    Block,
    Payloads,
    Topic,
    as_list,
    decompress,
    decompress_messages,
    frame_compression,
)

Decoder = Callable[[Payloads], DecodedImus]


def open_bag(path: Path, options: ReadOptions) -> Recording:
    """Open a bag as one recording of its Imu topic.

    Raises AllanError when it is not a readable bag, or the Imu topic is ambiguous.
    """
    bag = bag_files(path)
    survey = survey_bag(bag)
    source = chosen_source(path, survey, options.topic)
    info = SourceInfo(str(path), source.label, source.key[1], survey.storage)
    topic = survey.topics[source.key]
    topics = [topic for topic in survey.topics.values() if topic.encoding in ENCODINGS]
    return Recording(
        info,
        survey.counts.get(source.key),
        partial(_read, bag, topic, source, options),
        partial(bag_temperature, bag.files, topics, topic.name),
        options,
    )


def _read(
    bag: BagFiles, topic: Topic, source: ImuSource, options: ReadOptions, report: Report
) -> Iterator[ImuBatch]:
    """Yield the samples of the chosen topic in all files, in order."""
    decode: Decoder
    if source.field:
        decode = nested_decoder(topic, source.field, options.trust_covariance)
    else:
        decode = partial(
            decode_imus,
            encoding='ros1' if topic.encoding == 'ros1' else 'cdr',
            trust_covariance=options.trust_covariance,
        )
    kept: Counter[str] = Counter()
    total = 0
    for file in bag.files:
        with open_storage(file) as (storage, _):
            if storage.cut:
                report(finding('bag_cut', path=file, read=storage.cut.read, size=storage.cut.size))
            ids = {t.id for t in storage.topics if (t.name, t.type) == source.key}
            read = 0
            for batch in _gathered(_decoded(file, source, storage.blocks(ids), decode, kept)):
                read += len(batch)
                yield options.in_si(batch)
            _compare(storage.stated(ids, read), read, file, report)
            total += read
    if bag.described is not None and source.key in bag.described:
        _compare(bag.described[source.key].count, total, bag.path / METADATA, report)
    for sensor, count in sorted(kept.items()):
        report(
            finding(
                'covariance_ignored', AXES[SENSORS[sensor]], count=count, sensor=sensor, read=total
            )
        )
    if not total:
        raise no_message(bag.path, source)


def _compare(stated: int, read: int, where: Path, report: Report) -> None:
    """Report where another number of messages was read than stated."""
    if stated != read:
        report(finding('count_differs', path=where, stated=stated, read=read))


def _decoded(
    file: Path, source: ImuSource, blocks: Iterable[Block], decode: Decoder, kept: Counter[str]
) -> Iterator[ImuBatch]:
    """Decode the messages of a storage file, and begin a new batch wherever the frame changes.

    ``kept`` receives the number of messages per sensor whose covariance was ignored.
    """
    read = 0
    for block in blocks:
        first = 0
        try:
            for payloads in _decompressed(block.payloads):
                first = yield from _batches(block, first, decode(payloads), kept)
        except MalformedMessage as error:
            number = read + first + error.index + 1
            raise AllanError(
                f'{file}: message {number} of {source.label} is not a {source.key[1]} '
                f'({error}): record it again'
            ) from error
        read += len(block.payloads)


def _batches(
    block: Block, first: int, decoded: DecodedImus, kept: Counter[str]
) -> Generator[ImuBatch, None, int]:
    """Yield decoded messages, which begin at ``first`` in the block; return where they end."""
    kept.update(decoded.kept)
    edges = [0, len(decoded.frames)]
    if len(decoded.frame_ids) > 1:
        edges[1:1] = (np.flatnonzero(np.diff(decoded.frames)) + 1).tolist()
    for start, stop in pairwise(edges):
        yield ImuBatch(
            decoded.stamps_ns[start:stop],
            decoded.samples[start:stop],
            block.record_ns[first + start : first + stop],
            decoded.frame_ids[decoded.frames[start]],
        )
    return first + len(decoded.frames)


def _gathered(batches: Iterable[ImuBatch]) -> Iterator[ImuBatch]:
    """Join the batches of one frame to about `BATCH` samples, and split longer ones."""
    held: list[ImuBatch] = []
    count = 0
    for batch in batches:
        if held and (batch.frame_id != held[0].frame_id or count >= BATCH):
            yield from in_batches(joined(held))
            held, count = [], 0
        held.append(batch)
        count += len(batch)
    if held:
        yield from in_batches(joined(held))


def _decompressed(payloads: Payloads) -> Iterator[Payloads]:
    """Yield the messages, decompressed where they were compressed one by one."""
    if not len(payloads):
        return
    compression = frame_compression(bytes(payloads[0]))
    if not compression:
        yield payloads
        return
    try:
        yield from decompress_messages(as_list(payloads), compression)
    except ValueError as error:
        reason, index = error.args
        raise MalformedMessage(index, reason) from error


TEMPERATURE_TYPE = 'sensor_msgs/msg/Temperature'

Message = tuple[int, bytes]
"""Record time in ns, and serialized bytes."""


def bag_temperature(
    files: Sequence[Path], topics: Sequence[Topic], imu_topic: str, frame_id: str
) -> TemperatureTrace | None:
    """Return the temperature of an IMU, or None where the bag has none or it is ambiguous.

    A topic belongs to the IMU when it is the only one of its type, the only one in the namespace
    of the Imu topic, or, among several of these, the only one with the frame_id of the IMU.
    """
    near = _nearest([t for t in topics if t.type == TEMPERATURE_TYPE], imu_topic)
    if len(near) > 1:
        firsts = [next(_messages(files, topic), (0, b'')) for topic in near]
        found = [_temperature(topic, *first) for topic, first in zip(near, firsts)]
        near = [topic for topic, t in zip(near, found) if t and t[1] == frame_id]
    if len(near) != 1:
        return None
    kept: Decimated[Message] = Decimated()
    for message in _messages(files, near[0]):
        kept.add(message)
    readings = [t[0] for message in kept if (t := _temperature(near[0], *message))]
    return trace_of(near[0].name, readings)


def _nearest(topics: Sequence[Topic], imu_topic: str) -> list[Topic]:
    """Return the topics that share most of their namespace with the Imu topic."""

    def shared(topic: Topic) -> int:
        pairs = list(zip(topic.name.strip('/').split('/'), imu_topic.strip('/').split('/')))
        equal = [a == b for a, b in pairs]
        return equal.index(False) if False in equal else len(equal)

    most = max(map(shared, topics), default=0)
    return [topic for topic in topics if shared(topic) == most]


def _messages(files: Sequence[Path], topic: Topic) -> Iterator[Message]:
    for file in files:
        with open_storage(file) as (storage, _):
            ids = {t.id for t in storage.topics if (t.name, t.type) == (topic.name, topic.type)}
            for block in storage.blocks(ids) if ids else ():
                yield from zip(block.record_ns.tolist(), map(bytes, as_list(block.payloads)))


def _temperature(
    topic: Topic, record_ns: int, payload: bytes
) -> tuple[tuple[int, int, float], str] | None:
    """Return (header stamp, record time, degC) and the frame_id; None of a damaged message."""
    with suppress(MalformedMessage, ValueError):
        plain = decompress(payload, frame_compression(payload), MAX_MESSAGE_BYTES)
        encoding: Encoding = 'ros1' if topic.encoding == 'ros1' else 'cdr'
        header_ns, frame_id, celsius = decode_temperature(plain, encoding)
        return (header_ns, record_ns, celsius), frame_id
    return None


def nested_decoder(
    topic: Topic, field: tuple[str, ...], trust_covariance: bool
) -> Callable[[Payloads], DecodedImus]:
    """Return a function that decodes the Imu in a field of the topic's messages."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(definitions_of(topic))
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
            stamp, frame_id = imu.header.stamp, imu.header.frame_id
            decoded.stamps_ns[row] = stamp.sec * NANOSECONDS + stamp.nanosec
            for sensor, name in (('gyro', 'angular_velocity'), ('accel', 'linear_acceleration')):
                vector = getattr(imu, name)
                decoded.samples[row, SENSORS[sensor]] = vector.x, vector.y, vector.z
                first[sensor][row] = getattr(imu, f'{name}_covariance')[0]
            if frame_id not in decoded.frame_ids:
                decoded.frame_ids.append(frame_id)
            decoded.frames[row] = decoded.frame_ids.index(frame_id)
        for sensor in SENSORS:
            decoded.drop_absent(sensor, slice(None), first[sensor], trust_covariance)
        return decoded

    return decode
