# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Imu samples to write, and complete recordings as arrays."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allan_ros.core.errors import AllanError
from allan_ros.core.findings import Finding
from allan_ros.core.imu import ImuBatch, joined
from allan_ros.readers import ReadOptions, Recording, open_recording

START_NS = 1_700_000_000_123_456_789


class Contents(NamedTuple):
    """All samples of one recording."""

    recording: Recording
    stamps_ns: np.ndarray
    samples: np.ndarray
    record_ns: np.ndarray | None
    frame_ids: list[str]
    findings: tuple[Finding, ...]


def imu_batches(n: int = 2000, *, parts: int = 3, frame_id: str = 'imu_link') -> list[ImuBatch]:
    """Return n samples of every magnitude, with stamps that use all their digits."""
    rng = np.random.default_rng(20)
    samples = rng.normal(size=(n, 6)) * 10.0 ** rng.integers(-12, 6, size=(n, 6))
    stamps = START_NS + np.cumsum(rng.integers(4_900_000, 5_100_000, size=n))
    record = stamps + rng.integers(10_000, 90_000, size=n)
    whole = ImuBatch(stamps, samples, record, frame_id)
    edges = np.linspace(0, n, parts + 1).astype(int)
    return [whole[start:stop] for start, stop in pairwise(edges)]


def read(path: Path, **options: Any) -> Contents:
    """Open one recording and read all of it."""
    recording = open_recording(path, ReadOptions(**options))
    batches = list(recording.batches())
    whole = joined(batches)
    return Contents(
        recording,
        whole.stamps_ns,
        whole.samples,
        whole.record_ns,
        [batch.frame_id for batch in batches],
        recording.findings,
    )


def outcome(path: Path, **options: Any) -> tuple[int, str]:
    """Return the number of samples of a recording, and the error text if it is refused."""
    count = 0
    try:
        for batch in open_recording(path, ReadOptions(**options)).batches():
            count += len(batch)
    except AllanError as error:
        return count, str(error)
    return count, ''


def refused(path: Path, **options: Any) -> str:
    """Check that a recording is refused in one line that names it; return this line."""
    _, said = outcome(path, **options)
    assert said.startswith(str(path))
    assert '\n' not in said
    return said
