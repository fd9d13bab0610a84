# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The topics of a bag, and the selection of the Imu topic: by its type, or inside other
messages."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ...core.errors import AllanError
from .cdr import IMU_TYPE
from .open import BagFiles, bag_files, open_storage
from .storage import Cut, Topic, optional_package

ENCODINGS = ('cdr', 'ros1')
"""Supported serializations."""

LISTED = 10
"""Largest number of topics that a message lists."""

Key = tuple[str, str]
"""Topic name and type, which identify a topic in all files of a bag."""


@dataclass
class Survey:
    """The topics of all files of a bag, and their numbers of messages."""

    topics: dict[Key, Topic] = field(default_factory=dict)
    counts: Counter[Key] = field(default_factory=Counter)
    storage: str = ''
    cut: Cut | None = None

    def listed(self, keys: Iterable[Key]) -> str:
        """Return topics with type, number of messages and, if unsupported, serialization."""
        shown = []
        for key in keys:
            encoding = self.topics[key].encoding
            foreign = '' if encoding in ENCODINGS else f', serialized as {encoding}'
            shown.append(f'{key[0]} ({key[1]}, {self.counts[key]}{foreign})')
        more = f' and {len(shown) - LISTED} more' if len(shown) > LISTED else ''
        return ', '.join(shown[:LISTED]) + more

    def imus(self, keys: Iterable[Key] | None = None) -> list[ImuSource]:
        """Return the Imu topics among ``keys`` (by default, all topics); if there are none, the Imu
        fields of other message types.
        """
        keys = self.topics if keys is None else list(keys)
        plain = [ImuSource(key) for key in keys if key[1] == IMU_TYPE]
        return plain or [ImuSource(key, p) for key in keys for p in imu_fields(self.topics[key])]


@dataclass(frozen=True)
class ImuSource:
    """The topic that is read, and the path of the Imu in its messages (() for the message
    itself)."""

    key: Key
    field: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Name for users: the topic, or topic:field."""
        return ':'.join([self.key[0], '.'.join(self.field)]) if self.field else self.key[0]


def imu_topics(path: Path) -> list[str]:
    """Return the Imu topics of a bag with messages, in the notation of `ReadOptions.topic`."""
    return [source.label for source in _candidates(survey_bag(bag_files(path)))]


def survey_bag(bag: BagFiles) -> Survey:
    """Open the files until every topic with messages is found."""
    survey = Survey()
    described = bag.described
    expected = None if described is None else {k for k, d in described.items() if d.messages}
    for file in bag.files:
        with open_storage(file) as (storage, survey.storage):
            counts = storage.counts() if described is None else {}
            for topic in storage.topics:
                key = (topic.name, topic.type)
                survey.topics.setdefault(key, topic)
                survey.counts[key] += counts.get(topic.id, 0)
            survey.cut = survey.cut or storage.cut
        if expected is not None and expected <= set(survey.topics):
            break
    for key, stated in (described or {}).items():
        if key in survey.topics:
            survey.counts[key] = stated.messages
            survey.topics[key] = replace(survey.topics[key], encoding=stated.encoding)
    return survey


def chosen_source(path: Path, survey: Survey, wanted: str) -> ImuSource:
    """Return the Imu source that the user selected, or the only one."""
    candidates = [_named(path, survey, wanted)] if wanted else _candidates(survey)
    if not candidates:
        raise _no_imu(path, survey)
    if len(candidates) > 1:
        listed = ', '.join(f'{c.label} ({survey.counts[c.key]})' for c in candidates)
        raise AllanError(
            f'{path}: has {len(candidates)} Imu topics: {listed}: choose one with --topic'
        )
    (chosen,) = candidates
    topic = survey.topics[chosen.key]
    if topic.encoding not in ENCODINGS:
        raise AllanError(
            f'{path}: topic {chosen.label} is serialized as {topic.encoding!r}: only '
            f'{" and ".join(ENCODINGS)} can be read; convert the bag with "ros2 bag convert"'
        )
    if not survey.counts[chosen.key]:
        raise no_message(path, chosen)
    return chosen


def _candidates(survey: Survey) -> list[ImuSource]:
    """Return all Imus; only those with messages, if there are any."""
    sources = survey.imus()
    return [source for source in sources if survey.counts[source.key]] or sources


def no_message(path: Path, source: ImuSource) -> AllanError:
    return AllanError(
        f'{path}: topic {source.label} has no message: check that the driver was running and '
        'record again'
    )


def _named(path: Path, survey: Survey, wanted: str) -> ImuSource:
    """Return the only source that matches ``wanted``, a topic or topic:field."""
    name, _, field = wanted.lstrip('/').partition(':')
    there = [key for key in survey.topics if key[0].lstrip('/') == name]
    fitting = [s for s in survey.imus(there) if field in ('', '.'.join(s.field))]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        labels = ', '.join(source.label for source in fitting)
        problem = f'topic {wanted} contains several Imus: choose one of {labels}'
    elif not there:
        imus = [key for key in survey.topics if key[1] == IMU_TYPE]
        shown = survey.listed(imus or survey.topics) or 'none'
        problem = f'has no topic {wanted}; it has {shown}: check --topic'
    elif _is_unknown(topic := survey.topics[there[0]]):
        problem = (
            f'topic {wanted} is of type {topic.type}, and the bag has no schema that '
            'describes it: record it as mcap, which stores the schemas'
        )
    else:
        problem = (
            f'topic {wanted} is of type {topic.type}, which contains no sensor_msgs/Imu: '
            'choose another with --topic'
        )
    raise AllanError(f'{path}: {problem}')


def _no_imu(path: Path, survey: Survey) -> AllanError:
    read = survey.cut and f'{survey.cut.read} of {survey.cut.size} bytes could be read'
    if read and not survey.topics:
        return AllanError(
            f'{path}: is truncated: {read}, without a complete message: copy or record it again'
        )
    busiest = sorted(survey.topics, key=lambda key: -survey.counts[key])
    unknown = sum(map(_is_unknown, survey.topics.values()))
    schemas = f', {unknown} of them of unknown type without a schema' if unknown else ''
    cut = f'; {read}' if read else ''
    return AllanError(
        f'{path}: no sensor_msgs/Imu topic; it has {survey.listed(busiest) or "no topic"}'
        f'{schemas}{cut}: record the topic of the IMU'
    )


MAX_DEPTH = 8
"""Largest depth of nested messages that is searched."""

STANDARD_PACKAGES = re.compile(
    '(actionlib|diagnostic|geometry|map|nav|rosgraph|sensor|shape|std|stereo|tf2|trajectory|'
    'unique_identifier|visualization)_msgs|builtin_interfaces|rcl_interfaces'
)
"""Packages of message types that need no schema."""

IDL_SEPARATOR = '=' * 80 + '\n'


def imu_fields(topic: Topic) -> list[tuple[str, ...]]:
    """Return the path of every Imu field in the topic's type; none without a usable schema.

    Raises AllanError when the schema contains an Imu, but ``rosbags`` is not installed.
    """
    definitions = definitions_of(topic)

    def search(name: str, above: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
        if name == IMU_TYPE:
            yield above
        elif name in definitions and len(above) < MAX_DEPTH:
            for inside, (kind, inner) in definitions[name][1]:
                if kind == kind.NAME:
                    yield from search(inner, (*above, inside))

    return list(search(topic.type, ())) if definitions else []


def _is_unknown(topic: Topic) -> bool:
    """Return whether the content of the messages is unknown: no schema, no standard package."""
    return not topic.schema and not STANDARD_PACKAGES.fullmatch(topic.type.split('/')[0])


def definitions_of(topic: Topic) -> dict[str, Any]:
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
