# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bag folders: a damaged metadata.yaml with intact or damaged files."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from .damage import ODD_TEXTS, any_bytes, floats, signed, texts
from .mcap_target import IMU_TYPE, Plan, build
from .reading import MESSAGES, read_and_check

PAIRS = tuple(zip('abcdefgh', 'bcdefghi'))

METADATA: dict[str, Any] = {
    'rosbag2_bagfile_information': {
        'version': 8,
        'storage_identifier': 'mcap',
        'relative_file_paths': ['a_0.mcap', 'a_1.mcap'],
        'duration': {'nanoseconds': 1},
        'message_count': MESSAGES,
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': '/imu',
                    'type': IMU_TYPE,
                    'serialization_format': 'cdr',
                    'offered_qos_profiles': '',
                },
                'message_count': MESSAGES,
            }
        ],
        'compression_format': '',
        'compression_mode': '',
    }
}
ALIASES, MERGES = (
    first + ''.join(f'{b}: &{b} {link.format(",".join([f"*{a}"] * 9))}\n' for a, b in PAIRS)
    for first, link in (('a: &a [x,x,x]\n', '[{}]'), ('a: &a {k: 1}\n', '{{<<: [{}]}}'))
)
"""YAML lines whose entries each contain the previous one nine times."""

YAML_TRICKS = (
    'rosbag2_bagfile_information: !!python/object/apply:os.system ["touch pwned"]\n',
    ALIASES + 'rosbag2_bagfile_information: *i\n',
    ALIASES + 'rosbag2_bagfile_information: {relative_file_paths: [*i]}\n',
    ALIASES + 'rosbag2_bagfile_information: {topics_with_message_count: [{topic_metadata: '
    '{name: *i, type: *i, serialization_format: *i}, message_count: 1}]}\n',
    MERGES + 'rosbag2_bagfile_information: *i\n',
    '- ' * 3000,
    '[' * 3000,
    'rosbag2_bagfile_information: {relative_file_paths: ' + '[' * 900 + ']' * 900 + '}',
    'rosbag2_bagfile_information: &r {topics_with_message_count: [*r]}\n',
    'rosbag2_bagfile_information: {message_count: 1' + '0' * 6000 + '}',
    '? {a: b}\n: c\n',
    '\ufeff%YAML 9.9\n---\n- 2001-99-99\n',
)


@lru_cache(maxsize=2)
def _splits(which: int) -> bytes:
    return build(Plan(chunks=1 + which))


ODD_VALUES = (
    st.none()
    | st.booleans()
    | signed
    | floats
    | texts
    | st.sampled_from([10**400, [0.0] * 5000, {'a': {}}, [[[[[]]]]]])
    | st.lists(texts, max_size=3)
)


@st.composite
def _metadata(draw: Any) -> bytes:
    """Draw metadata of which some values are replaced, removed or added."""
    document = json.loads(json.dumps(METADATA))
    (information,) = document.values()
    (topic,) = information['topics_with_message_count']
    for _ in range(draw(st.integers(0, 4))):
        place = draw(st.sampled_from([document, information, topic, topic['topic_metadata']]))
        key = draw(st.sampled_from([*place, *ODD_TEXTS]))
        if draw(st.integers(0, 4)) or key not in place:
            place[key] = draw(ODD_VALUES)
        else:
            del place[key]
            break
    return json.dumps(document, ensure_ascii=draw(st.booleans())).encode('utf-8', 'surrogatepass')


@st.composite
def _folders(draw: Any) -> tuple[bytes, bytes | None]:
    """Draw metadata and the second file of the bag (None: missing)."""
    metadata = (
        _metadata()
        | st.sampled_from(YAML_TRICKS).map(str.encode)
        | any_bytes([b'rosbag2_bagfile_information:\n  relative_file_paths:\n    - a_0.mcap\n'])
    )
    intact = st.just(_splits(1))
    return draw(metadata), draw(st.none() | intact | intact | any_bytes([_splits(1)]))


def check(made: tuple[bytes, bytes | None], folder: Path) -> bool:
    """Read the folder."""
    metadata, second = made
    bag = folder / 'a'
    bag.mkdir()
    (bag / 'metadata.yaml').write_bytes(metadata)
    (bag / 'a_0.mcap').write_bytes(_splits(0))
    if second is not None:
        (bag / 'a_1.mcap').write_bytes(second)
    return read_and_check(bag)


INPUTS = _folders()
