# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read a recording as `allan analyze` does, up to the sums, and check all results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from allan_ros.core.imu import AXES, ImuBatch
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.io.readers import ReadOptions, open_recordings
from allan_ros.io.readers.cdr import encode_imus

from .harness import BrokenRule, check_line, refused_or_valid

MESSAGES = 40
"""Number of messages of a small bag, enough for several chunks or pages."""

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 5_000_000


def small_batch(n: int = MESSAGES, frame_id: str = 'imu') -> ImuBatch:
    """Return a few samples of a still IMU."""
    samples = np.random.default_rng(7).normal(0.0, 1e-3, (n, len(AXES)))
    return ImuBatch(START_NS + np.arange(n) * PERIOD_NS, samples, frame_id=frame_id)


def payloads(encoding: Any, n: int = MESSAGES) -> list[bytes]:
    """Return the messages of `small_batch`."""
    return [bytes(payload) for payload in encode_imus(small_batch(n), encoding)]


def read_and_check(path: Path, options: ReadOptions = ReadOptions()) -> bool:
    """Compute the sums of a recording, and return whether it is valid.

    Raises BrokenRule when reading breaks the rule of `harness`.
    """
    before = sorted(path.parent.rglob('*'))
    with refused_or_valid() as outcome:
        for recording in open_recordings([path], options):
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
