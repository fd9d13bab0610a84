# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read the messages of a ROS 1 bag with the package ``rosbags``.

The recorder must have closed the bag, so that it has an index. The package does not limit the
memory for a chunk.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from .bag_messages import Messages, Topic, Truncation
from .recording import damaged, optional_package, translated

MAGIC = b'#ROSBAG V2.0\n'

MESSAGES = 2048
"""Largest number of messages that are read together from a ROS 1 bag."""

REMEDY = 'copy it again, or repair it with "rosbag reindex" or "rosbag fix"'


class Ros1Storage:
    """A ROS 1 bag that is open in ``reader``, an object of the package ``rosbags``.

    ``path`` is the path of the bag in error messages.
    """

    truncation: Truncation | None = None

    def __init__(self, path: Path, reader: Any) -> None:
        self._path = path
        self._reader = reader
        self.topics = [Topic(c.id, c.topic, c.msgtype, 'ros1') for c in reader.connections]

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages in the bag."""
        return {connection.id: connection.msgcount for connection in self._reader.connections}

    def stated_count(self, ids: set[int], read_count: int) -> int:
        """Return the number of messages of the topics ``ids`` according to the list of chunks.

        ``read_count``, the number of messages that were read, is not used.
        """
        counts: Counter[int] = Counter()
        for chunk in self._reader.chunk_infos:
            counts.update(chunk.connection_counts)
        return sum(counts[topic_id] for topic_id in ids)

    def blocks(self, ids: set[int]) -> Iterator[Messages]:
        """Yield all messages of the topics ``ids`` in blocks, in the order of record time."""
        with translated(self._path, (Exception,), REMEDY):
            messages = self._reader.messages([c for c in self._reader.connections if c.id in ids])
            while batch := list(islice(messages, MESSAGES)):
                connections, times, payloads = zip(*batch)
                topics = np.array([connection.id for connection in connections])
                yield Messages(topics, np.array(times, np.int64), list(payloads))


@contextmanager
def open_storage(path: Path, shown: Path) -> Iterator[Ros1Storage]:
    """Open a ROS 1 bag for reading.

    ``shown`` is the path in error messages, because ``path`` may be a decompressed copy. Raises
    AllanError when the bag is of another version or damaged, or the package ``rosbags`` is missing.
    """
    with path.open('rb') as file:
        magic = file.read(len(MAGIC))
    if magic != MAGIC:
        version = magic.split(b'\n')[0].decode(errors='replace')
        raise damaged(shown, f'{version!r} is not ROS bag 2.0', 'update it with "rosbag fix"')
    rosbag1 = optional_package('rosbags.rosbag1', f'{shown}: reading a ROS 1 bag')
    with translated(shown, (Exception,), REMEDY):
        reader = rosbag1.Reader(path)
        reader.open()
    with closing(reader):
        with translated(shown, (Exception,), REMEDY):
            storage = Ros1Storage(shown, reader)
        yield storage
