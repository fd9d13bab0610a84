# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags: find the Imu topic by its type, and stream its messages as batches."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...core.errors import AllanError
from ...core.findings import finding
from ...core.imu import ImuBatch
from ..signal import Decimated, TemperatureTrace, trace_of
from .cdr import NANOSECONDS, DecodedImus, MalformedMessage, decode_imus
from .folder import BagFiles, bag_files, open_storage
from .message_fields import IMU_TYPE, imu_fields, is_unknown, nested_decoder
from .recording import BATCH, ReadOptions, Recording, Report, SourceInfo
from .storage import (
    Block,
    Cut,
    Payloads,
    Topic,
    as_list,
    decompress,
    decompress_all,
    frame_compression,
)

ENCODINGS = ('cdr', 'ros1')
"""Serializations we read."""

LISTED = 10
"""At most this many topics are named in a message."""


Decoder = Callable[[Payloads], DecodedImus]

Key = tuple[str, str]
"""Topic name and type: what is one topic over all splits of a bag."""


@dataclass
class Survey:
    """What topics a bag has, over all its files."""

    topics: dict[Key, Topic] = field(default_factory=dict)
    counts: dict[Key, int] = field(default_factory=dict)
    storage: str = ''
    cut: Cut | None = None

    def listed(self, keys: Iterable[Key]) -> str:
        """Name topics with their type, number of messages and foreign serialization."""
        shown = []
        for key in keys:
            encoding = self.topics[key].encoding
            foreign = '' if encoding in ENCODINGS else f', serialized as {encoding}'
            shown.append(f'{key[0]} ({key[1]}, {self.counts.get(key, 0)}{foreign})')
        more = f' and {len(shown) - LISTED} more' if len(shown) > LISTED else ''
        return ', '.join(shown[:LISTED]) + more


@dataclass(frozen=True)
class ImuSource:
    """The topic that is read, and the field of its messages that is the Imu (() for the whole)."""

    key: Key
    field: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """What the user calls it: the topic, or topic:field."""
        return ':'.join([self.key[0], '.'.join(self.field)]) if self.field else self.key[0]


def open_bag(path: Path, options: ReadOptions) -> Recording:
    """Open a bag as one recording of its Imu topic.

    Raises
    ------
    AllanError
        When it is no readable bag, or not exactly one Imu topic is meant.
    """
    bag = bag_files(path)
    survey = _survey(bag)
    source = _choose(path, survey, options.topic)
    info = SourceInfo(str(path), source.label, source.key[1], survey.storage)
    topic = survey.topics[source.key]
    topics = [topic for topic in survey.topics.values() if topic.encoding in ENCODINGS]
    return Recording(
        info,
        survey.counts.get(source.key),
        partial(_read, bag, topic, source),
        partial(bag_temperature, bag.files, topics, topic.name),
    )


def _survey(bag: BagFiles) -> Survey:
    """Look into the files until every topic that holds messages has been seen."""
    survey = Survey()
    expected = None if bag.described is None else {k for k, d in bag.described.items() if d.count}
    for file in bag.files:
        with open_storage(file) as (storage, survey.storage):
            counts = storage.counts() if bag.described is None else {}
            for topic in storage.topics:
                key = (topic.name, topic.type)
                survey.topics.setdefault(key, topic)
                survey.counts[key] = survey.counts.get(key, 0) + counts.get(topic.id, 0)
            survey.cut = survey.cut or storage.cut
        if expected is not None and expected <= set(survey.topics):
            break
    for key, described in (bag.described or {}).items():
        if key in survey.topics:
            survey.counts[key] = described.count
            survey.topics[key] = replace(survey.topics[key], encoding=described.encoding)
    return survey


def _choose(path: Path, survey: Survey, wanted: str) -> ImuSource:
    """Return the one Imu source that is meant."""
    plain = [ImuSource(key) for key in survey.topics if key[1] == IMU_TYPE]
    if wanted:
        chosen = _named(path, survey, plain, wanted)
    else:
        candidates = [source for source in plain if survey.counts[source.key]] or plain
        if not candidates:
            nested = _nested(survey)
            candidates = [source for source in nested if survey.counts[source.key]] or nested
        if not candidates:
            raise _no_imu(path, survey)
        if len(candidates) > 1:
            listed = ', '.join(f'{c.label} ({survey.counts[c.key]})' for c in candidates)
            raise AllanError(
                f'{path}: has {len(candidates)} Imu topics: {listed}: choose one with --topic'
            )
        chosen = candidates[0]
    topic = survey.topics[chosen.key]
    if topic.encoding not in ENCODINGS:
        raise AllanError(
            f'{path}: topic {chosen.label} is serialized as {topic.encoding!r}: only '
            f'{" and ".join(ENCODINGS)} can be read; convert the bag with "ros2 bag convert"'
        )
    if not survey.counts[chosen.key]:
        raise _no_message(path, chosen)
    return chosen


def _no_message(path: Path, source: ImuSource) -> AllanError:
    return AllanError(
        f'{path}: topic {source.label} holds no message: check that the driver was running and '
        'record again'
    )


def _named(path: Path, survey: Survey, plain: list[ImuSource], wanted: str) -> ImuSource:
    """Return the source the user named, as topic or topic:field."""
    name = wanted.lstrip('/')
    there = [key for key in survey.topics if key[0].lstrip('/') == name.split(':')[0]]
    fitting = [s for s in [*plain, *_nested(survey)] if s.label.lstrip('/') == name]
    fitting += [s for s in _nested(survey) if not fitting and s.key in there and ':' not in name]
    if len(fitting) == 1:
        return fitting[0]
    if len(fitting) > 1:
        labels = ', '.join(source.label for source in fitting)
        raise AllanError(f'{path}: topic {wanted} carries several Imus: choose one of {labels}')
    if there:
        topic = survey.topics[there[0]]
        if is_unknown(topic):
            raise AllanError(
                f'{path}: topic {wanted} is of type {topic.type}, and the bag has no schema that '
                'tells where an Imu is in it: record it as mcap, which stores the schemas'
            )
        raise AllanError(
            f'{path}: topic {wanted} is of type {topic.type}, which carries no sensor_msgs/Imu: '
            'choose another with --topic'
        )
    shown = survey.listed(source.key for source in plain) or survey.listed(survey.topics)
    raise AllanError(f'{path}: has no topic {wanted}; it has {shown or "none"}: check --topic')


def _nested(survey: Survey) -> list[ImuSource]:
    """Return the Imus inside messages of other types."""
    return [
        ImuSource(key, path)
        for key, topic in survey.topics.items()
        if key[1] != IMU_TYPE and topic.schema
        for path in imu_fields(topic)
    ]


def _no_imu(path: Path, survey: Survey) -> AllanError:
    if not survey.topics and survey.cut:
        return AllanError(
            f'{path}: is cut off after {survey.cut.read} of {survey.cut.size} bytes and holds no '
            'whole message: copy or record it again'
        )
    busiest = sorted(survey.topics, key=lambda key: -survey.counts.get(key, 0))
    unknown = sum(is_unknown(topic) for topic in survey.topics.values())
    schemas = f', {unknown} of them of unknown type without a schema' if unknown else ''
    cut = (
        f', and is cut off after {survey.cut.read} of {survey.cut.size} bytes' if survey.cut else ''
    )
    return AllanError(
        f'{path}: no sensor_msgs/Imu topic; it has {survey.listed(busiest) or "no topic"}'
        f'{schemas}{cut}: record the topic of the IMU'
    )


def _read(bag: BagFiles, topic: Topic, source: ImuSource, report: Report) -> Iterator[ImuBatch]:
    """Stream the chosen topic of all files, in order."""
    decode: Decoder
    if source.field:
        decode = nested_decoder(topic, source.field)
    else:
        decode = partial(decode_imus, encoding='ros1' if topic.encoding == 'ros1' else 'cdr')
    read = 0
    for file in bag.files:
        with open_storage(file) as (storage, _):
            if storage.cut:
                report(finding('bag_cut', path=file, read=storage.cut.read, size=storage.cut.size))
            ids = {t.id for t in storage.topics if (t.name, t.type) == source.key}
            for batch in _gathered(_decoded(file, source, storage.blocks(ids), decode)):
                read += len(batch)
                yield batch
    if not read:
        raise _no_message(bag.path, source)


def _decoded(
    file: Path, source: ImuSource, blocks: Iterable[Block], decode: Decoder
) -> Iterator[ImuBatch]:
    """Decode what the storage yields, with a new batch wherever the frame changes."""
    read = 0
    for block in blocks:
        if not len(block.payloads):
            continue
        try:
            decoded = decode(_plain(block.payloads))
        except MalformedMessage as error:
            raise AllanError(
                f'{file}: message {read + error.index + 1} of {source.label} is no '
                f'{source.key[1]} ({error}): record it again'
            ) from error
        edges = [0, len(decoded.frames)]
        if len(decoded.frame_ids) > 1:
            edges[1:1] = (np.flatnonzero(np.diff(decoded.frames)) + 1).tolist()
        for start, stop in pairwise(edges):
            yield ImuBatch(
                decoded.stamps_ns[start:stop],
                decoded.samples[start:stop],
                block.record_ns[start:stop],
                decoded.frame_ids[decoded.frames[start]],
            )
        read += len(block.payloads)


def _gathered(batches: Iterable[ImuBatch]) -> Iterator[ImuBatch]:
    """Join the batches of one frame to about `BATCH` samples, and part longer ones."""
    held: list[ImuBatch] = []
    count = 0
    for batch in batches:
        if held and (batch.frame_id != held[0].frame_id or count >= BATCH):
            yield from _parted(held)
            held, count = [], 0
        held.append(batch)
        count += len(batch)
    if held:
        yield from _parted(held)


def _parted(held: list[ImuBatch]) -> Iterator[ImuBatch]:
    record = [batch.record_ns for batch in held if batch.record_ns is not None]
    whole = ImuBatch(
        np.concatenate([batch.stamps_ns for batch in held]),
        np.concatenate([batch.samples for batch in held]),
        np.concatenate(record),
        held[0].frame_id,
    )
    for start in range(0, len(whole), BATCH):
        yield whole[start : start + BATCH]


def _plain(payloads: Payloads) -> Payloads:
    """Decompress messages that were compressed one by one, which their first bytes tell."""
    compression = frame_compression(bytes(payloads[0]))
    if not compression:
        return payloads
    packed = as_list(payloads)
    if all_plain := decompress_all(packed, compression):
        return all_plain
    plain: list[bytes | memoryview] = []
    for index, payload in enumerate(packed):
        try:
            plain.append(decompress(bytes(payload), compression))
        except ValueError as error:
            raise MalformedMessage(index, f'{compression}: {error}') from error
    return plain


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
    kept: Decimated[Message] = Decimated()
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
