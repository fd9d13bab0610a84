# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags: find the Imu topic by its type, and read its messages as batches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...core.errors import AllanError
from ...core.findings import finding
from ...core.imu import AXES, ImuBatch, joined, sensor_of
from ..signal import Decimated, TemperatureTrace, trace_of
from .cdr import DecodedImus, MalformedMessage, decode_imus, decode_temperature
from .folder import METADATA, BagFiles, bag_files, open_storage
from .message_fields import IMU_TYPE, imu_fields, is_unknown, nested_decoder
from .recording import BATCH, ReadOptions, Recording, Report, SourceInfo, in_batches
from .storage import (
    MAX_MESSAGE_BYTES,
    Block,
    Cut,
    Payloads,
    Topic,
    as_list,
    decompress,
    decompress_messages,
    frame_compression,
)

ENCODINGS = ('cdr', 'ros1')
"""Serializations that can be read."""

LISTED = 10
"""At most this many topics are listed in a message."""

Decoder = Callable[[Payloads], DecodedImus]

Key = tuple[str, str]
"""Topic name and type, which identify a topic in all splits of a bag."""


@dataclass
class Survey:
    """The topics of all files of a bag."""

    topics: dict[Key, Topic] = field(default_factory=dict)
    counts: dict[Key, int] = field(default_factory=dict)
    storage: str = ''
    cut: Cut | None = None

    def listed(self, keys: Iterable[Key]) -> str:
        """Return topics with type, number of messages and, if unsupported, serialization."""
        shown = []
        for key in keys:
            encoding = self.topics[key].encoding
            foreign = '' if encoding in ENCODINGS else f', serialized as {encoding}'
            shown.append(f'{key[0]} ({key[1]}, {self.counts.get(key, 0)}{foreign})')
        more = f' and {len(shown) - LISTED} more' if len(shown) > LISTED else ''
        return ', '.join(shown[:LISTED]) + more


@dataclass(frozen=True)
class ImuSource:
    """The topic that is read, and the path of the Imu in its messages (() for the message)."""

    key: Key
    field: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """The name for users: the topic, or topic:field."""
        return ':'.join([self.key[0], '.'.join(self.field)]) if self.field else self.key[0]


def open_bag(path: Path, options: ReadOptions) -> Recording:
    """Open a bag as one recording of its Imu topic.

    Raises AllanError when it is not a readable bag, or several topics could be meant.
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
        partial(_read, bag, topic, source, options),
        partial(bag_temperature, bag.files, topics, topic.name),
        options,
    )


def imu_topics(path: Path) -> list[str]:
    """Return the Imu topics with messages of a bag, as `ReadOptions.topic` names them.

    Raises
    ------
    AllanError
        When it is not a readable bag.
    """
    return [source.label for source in _candidates(_survey(bag_files(path)))]


def _survey(bag: BagFiles) -> Survey:
    """Open the files until every topic that has messages was found."""
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
    """Return the Imu source that the user asks for, or the only one."""
    plain = [ImuSource(key) for key in survey.topics if key[1] == IMU_TYPE]
    if wanted:
        chosen = _named(path, survey, plain, wanted)
    else:
        candidates = _candidates(survey)
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


def _candidates(survey: Survey) -> list[ImuSource]:
    """Return the Imu topics, else the Imus inside other messages; those with messages if any."""
    plain = [ImuSource(key) for key in survey.topics if key[1] == IMU_TYPE]
    sources = plain or _nested(survey)
    return [source for source in sources if survey.counts[source.key]] or sources


def _no_message(path: Path, source: ImuSource) -> AllanError:
    return AllanError(
        f'{path}: topic {source.label} has no message: check that the driver was running and '
        'record again'
    )


def _named(path: Path, survey: Survey, plain: list[ImuSource], wanted: str) -> ImuSource:
    """Return the source with that name, which is a topic or topic:field."""
    name = wanted.lstrip('/')
    there = [key for key in survey.topics if key[0].lstrip('/') == name.split(':')[0]]
    fitting = [s for s in plain if s.label.lstrip('/') == name]
    nested = [] if fitting else [s for s in _nested(survey) if s.key in there]
    fitting += [s for s in nested if ':' not in name or s.label.lstrip('/') == name]
    if len(fitting) == 1:
        return fitting[0]
    if len(fitting) > 1:
        labels = ', '.join(source.label for source in fitting)
        raise AllanError(f'{path}: topic {wanted} contains several Imus: choose one of {labels}')
    if there:
        topic = survey.topics[there[0]]
        if is_unknown(topic):
            raise AllanError(
                f'{path}: topic {wanted} is of type {topic.type}, and the bag has no schema that '
                'describes it: record it as mcap, which stores the schemas'
            )
        raise AllanError(
            f'{path}: topic {wanted} is of type {topic.type}, which contains no sensor_msgs/Imu: '
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
            f'{path}: is truncated: {survey.cut.read} of {survey.cut.size} bytes could be read, '
            'without a complete message: copy or record it again'
        )
    busiest = sorted(survey.topics, key=lambda key: -survey.counts.get(key, 0))
    unknown = sum(is_unknown(topic) for topic in survey.topics.values())
    schemas = f', {unknown} of them of unknown type without a schema' if unknown else ''
    cut = f'; {survey.cut.read} of {survey.cut.size} bytes could be read' if survey.cut else ''
    return AllanError(
        f'{path}: no sensor_msgs/Imu topic; it has {survey.listed(busiest) or "no topic"}'
        f'{schemas}{cut}: record the topic of the IMU'
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
        axes = tuple(axis for axis in AXES if sensor_of(axis) == sensor)
        report(finding('covariance_ignored', axes, count=count, sensor=sensor, read=total))
    if not total:
        raise _no_message(bag.path, source)


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
    of the Imu topic, or, among several of these, the only one with the frame_id of the IMU. The
    arguments are the storage files of the bag in order, all its topics, and those two names.
    """
    near = _nearest([t for t in topics if t.type == TEMPERATURE_TYPE], imu_topic)
    if len(near) > 1:
        near = [topic for topic in near if _frame_of_first(files, topic) == frame_id]
    if len(near) != 1:
        return None
    kept: Decimated[Message] = Decimated()
    for message in _messages(files, near[0]):
        kept.add(message)
    readings = []
    for record_ns, payload in kept:
        with suppress(MalformedMessage, ValueError):
            header_ns, _, celsius = _temperature(near[0], payload)
            readings.append((header_ns, record_ns, celsius))
    return trace_of(near[0].name, readings)


def _nearest(topics: Sequence[Topic], imu_topic: str) -> list[Topic]:
    """Return the topics that share most of their namespace with the Imu topic."""

    def shared(topic: Topic) -> int:
        pairs = list(zip(topic.name.strip('/').split('/'), imu_topic.strip('/').split('/')))
        equal = [a == b for a, b in pairs]
        return equal.index(False) if False in equal else len(equal)

    most = max(map(shared, topics), default=0)
    return [topic for topic in topics if shared(topic) == most]


def _frame_of_first(files: Sequence[Path], topic: Topic) -> str | None:
    for _, payload in _messages(files, topic):
        with suppress(MalformedMessage, ValueError):
            return _temperature(topic, payload)[1]
        break
    return None


def _messages(files: Sequence[Path], topic: Topic) -> Iterator[Message]:
    for file in files:
        with open_storage(file) as (storage, _):
            ids = {t.id for t in storage.topics if (t.name, t.type) == (topic.name, topic.type)}
            for block in storage.blocks(ids) if ids else ():
                yield from zip(block.record_ns.tolist(), map(bytes, as_list(block.payloads)))


def _temperature(topic: Topic, payload: bytes) -> tuple[int, str, float]:
    plain = decompress(payload, frame_compression(payload), MAX_MESSAGE_BYTES)
    return decode_temperature(plain, 'ros1' if topic.encoding == 'ros1' else 'cdr')
