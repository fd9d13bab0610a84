# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags: the messages of an Imu topic as batches, and the temperature of the IMU."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial, reduce
from pathlib import Path

from ...core.errors import AllanError
from ...core.findings import finding
from ...core.imu import AXES, SENSORS, ImuBatch, joined
from ..signal import Decimated, TemperatureTrace, trace_of
from .bag_topics import ENCODINGS, ImuSource, chosen_source, definitions_of, no_message, survey_bag
from .cdr import IMU_TYPE, Encoding, MalformedMessage, decode_imus, decode_temperature
from .open import METADATA, BagFiles, bag_files, open_storage
from .recording import BATCH, ReadOptions, Recording, Report, SourceInfo, in_batches
from .storage import (
    MAX_MESSAGE_BYTES,
    Block,
    Payloads,
    Topic,
    as_list,
    decompress,
    frame_compression,
)


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
    extract = extractor(topic, source.field) if source.field else None
    kept: Counter[str] = Counter()  # number of messages per sensor whose covariance was ignored
    total = 0

    def decoded(file: Path, blocks: Iterable[Block]) -> Iterator[ImuBatch]:
        done = 0  # number of messages of this file
        for block in blocks:
            at = 0
            try:
                for payloads in _plain(block.payloads, extract):
                    imus = decode_imus(payloads, _encoding(topic), options.trust_covariance)
                    kept.update(imus.kept)
                    yield from imus.batches(block.record_ns[at : at + len(payloads)])
                    at += len(payloads)
            except MalformedMessage as error:
                raise AllanError(
                    f'{file}: message {done + at + error.index + 1} of {source.label} is not a '
                    f'{source.key[1]} ({error}): record it again'
                ) from error
            done += at

    for file in bag.files:
        with open_storage(file) as (storage, _):
            if storage.cut:
                report(finding('bag_cut', path=file, read=storage.cut.read, size=storage.cut.size))
            ids = {t.id for t in storage.topics if (t.name, t.type) == source.key}
            read = 0
            for batch in _gathered(decoded(file, storage.blocks(ids))):
                read += len(batch)
                yield options.in_si(batch)
            _compare(storage.stated(ids, read), read, file, report)
            total += read
    if bag.described is not None and source.key in bag.described:
        _compare(bag.described[source.key].messages, total, bag.path / METADATA, report)
    for sensor, count in sorted(kept.items()):
        axes = AXES[SENSORS[sensor]]
        report(finding('covariance_ignored', axes, count=count, sensor=sensor, read=total))
    if not total:
        raise no_message(bag.path, source)


def _compare(stated: int, read: int, where: Path, report: Report) -> None:
    """Report if the number of read messages differs from the stated number."""
    if stated != read:
        report(finding('count_differs', path=where, stated=stated, read=read))


def _encoding(topic: Topic) -> Encoding:
    return 'ros1' if topic.encoding == 'ros1' else 'cdr'


def _gathered(batches: Iterable[ImuBatch]) -> Iterator[ImuBatch]:
    """Join the batches of one frame_id to about `BATCH` samples, and split longer ones."""
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


def _plain(payloads: Payloads, extract: Callable[[bytes], bytes] | None) -> Iterator[Payloads]:
    """Yield the Imu messages, decompressed or extracted from other messages if necessary.

    Converted messages are yielded in groups of limited total size.
    """
    compression = frame_compression(bytes(payloads[0])) if len(payloads) else ''
    if not compression and extract is None:
        yield payloads
        return
    group: list[bytes | memoryview] = []
    size = 0
    for payload in as_list(payloads):
        try:
            plain = decompress(payload, compression, MAX_MESSAGE_BYTES)
            group.append(extract(plain) if extract else plain)
        except ValueError as error:
            raise MalformedMessage(len(group), f'{compression} {error}'.lstrip()) from error
        size += len(plain)
        if size > MAX_MESSAGE_BYTES:
            yield group
            group, size = [], 0
    if group:
        yield group


def extractor(topic: Topic, field: tuple[str, ...]) -> Callable[[bytes], bytes]:
    """Return a function that extracts the serialized Imu from a field of the topic's messages."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(definitions_of(topic))
    form = _encoding(topic)
    deserialize = getattr(store, f'deserialize_{form}')
    serialize = getattr(store, f'serialize_{form}')

    def extract(payload: bytes) -> bytes:
        try:
            message = deserialize(payload, topic.type)
            return bytes(serialize(reduce(getattr, field, message), IMU_TYPE))
        except Exception as error:  # the generated code may raise any exception
            raise ValueError(f'it does not match its schema: {error}') from error

    return extract


TEMPERATURE_TYPE = 'sensor_msgs/msg/Temperature'

Message = tuple[int, bytes]
"""Record time in ns, and serialized bytes."""


def bag_temperature(
    files: Sequence[Path], topics: Sequence[Topic], imu_topic: str, frame_id: str
) -> TemperatureTrace | None:
    """Return the temperature of an IMU, or None if the bag has none or it is ambiguous.

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
    """Return the topics that share the longest part of their namespace with the Imu topic."""

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
    """Return (header stamp, record time, degC) and the frame_id; None for a damaged message."""
    with suppress(MalformedMessage, ValueError):
        plain = decompress(payload, frame_compression(payload), MAX_MESSAGE_BYTES)
        header_ns, frame_id, celsius = decode_temperature(plain, _encoding(topic))
        return (header_ns, record_ns, celsius), frame_id
    return None
