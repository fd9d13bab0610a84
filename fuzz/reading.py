# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read a recording as `allan analyze` does, up to the sums, and check all results."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from allan_ros.core.errors import AllanError
from allan_ros.core.imu import AXES, ImuBatch, joined
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.readers import ReadOptions, open_recording
from allan_ros.readers.cdr import IMU_TYPE, encode_imus

MESSAGES = 40
"""Number of messages of a small bag, enough for several chunks or pages."""

LONGEST_LINE = 4000
"""Largest length of an error message, in characters."""

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 5_000_000


class BrokenRule(AssertionError):
    """An input that should have been rejected was accepted, or the error message is invalid."""


@dataclass
class Outcome:
    """The result of one input: valid, unless it is rejected."""

    valid: bool = True


@contextmanager
def refused_or_valid() -> Iterator[Outcome]:
    """Catch an `AllanError` with a valid message; anything else is a crash."""
    outcome = Outcome()
    try:
        yield outcome
    except AllanError as error:
        check_line(str(error))
        outcome.valid = False


def check_line(text: str) -> None:
    """Raise unless the text is one printable line of limited length."""
    if not text or not text.isprintable() or len(text) > LONGEST_LINE:
        raise BrokenRule(f'not a printable line: {text[:200]!r}')


def small_batch(n: int = MESSAGES, frame_id: str = 'imu') -> ImuBatch:
    """Return a few samples of a still IMU."""
    samples = np.random.default_rng(7).normal(0.0, 1e-3, (n, len(AXES)))
    return ImuBatch(START_NS + np.arange(n) * PERIOD_NS, samples, frame_id=frame_id)


def payloads(encoding: Any, n: int = MESSAGES) -> list[bytes]:
    """Return the messages of `small_batch`."""
    return [bytes(payload) for payload in encode_imus(small_batch(n), encoding)]


def write_bag(
    path: Path,
    batches: Iterable[ImuBatch] | Mapping[str, ImuBatch],
    storage: str = 'mcap',
    compression: str = 'none',
) -> Path:
    """Write samples of one topic, or of several in the order of their times, with rosbags.

    ``storage`` is 'mcap', 'sqlite3' or 'ros1', ``compression`` is 'none', 'storage' (the chunks of
    mcap), 'message' or 'file', or for a ROS 1 bag also 'bz2' or 'lz4'.
    """
    from rosbags import rosbag1, rosbag2, typesys

    writer: Any
    if storage == 'ros1':
        writer, store = rosbag1.Writer(path), typesys.Stores.ROS1_NOETIC
        if compression != 'none':
            writer.set_compression(writer.CompressionFormat[compression.upper()])
    else:
        plugin = rosbag2.StoragePlugin[storage.upper()]
        writer = rosbag2.Writer(path, version=8, storage_plugin=plugin)
        store = typesys.Stores.ROS2_JAZZY
        mode = rosbag2.CompressionMode[compression.upper()]
        writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
    topics = batches if isinstance(batches, Mapping) else {'/imu/data': joined(list(batches))}
    with writer:
        messages = []
        for topic, batch in topics.items():
            link = writer.add_connection(topic, IMU_TYPE, typestore=typesys.get_typestore(store))
            times = batch.stamps_ns if batch.record_ns is None else batch.record_ns
            payloads = encode_imus(batch, 'ros1' if storage == 'ros1' else 'cdr')
            messages += [(time_ns, link, one) for time_ns, one in zip(times.tolist(), payloads)]
        if len(topics) > 1:
            messages.sort(key=lambda message: message[0])
        for time_ns, link, payload in messages:
            writer.write(link, time_ns, payload)
    return path


def read_and_check(path: Path, options: ReadOptions = ReadOptions()) -> bool:
    """Compute the sums of a recording, and return whether it is valid.

    Raises BrokenRule when reading breaks the rule of this package.
    """
    before = sorted(path.parent.rglob('*'))
    with refused_or_valid() as outcome:
        recording = open_recording(path, options)
        accumulator = ImuStream()
        for batch in recording.batches():
            _check_batch(batch)
            accumulator.update(batch)
        accumulator.end()
        known = accumulator.result()
        for found in (*recording.findings, *known.findings):
            check_line(str(found))
    if sorted(path.parent.rglob('*')) != before:
        raise BrokenRule('reading left a file behind')
    return outcome.valid


def _check_batch(batch: ImuBatch) -> None:
    well = batch.stamps_ns.dtype == np.int64 and batch.samples.dtype == np.float64 and len(batch)
    if not (well and isinstance(batch.frame_id, str)):
        raise BrokenRule(f'a batch of {batch.stamps_ns.dtype}, {batch.samples.dtype}, {len(batch)}')
