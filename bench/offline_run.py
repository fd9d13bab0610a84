# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums of an offline analysis, to compare with the sums of a node."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from allan_ros.core.allan.document import sums_to_document
from allan_ros.core.imu import ImuBatch
from allan_ros.core.stream.pipeline import ImuStream


def offline_sums(batches: Iterable[ImuBatch]) -> list[dict[str, Any]]:
    """Return the sums of batches after they were written as a document and read again."""
    accumulator = ImuStream()
    for batch in batches:
        accumulator.update(batch)
    accumulator.end()
    documents = [sums_to_document(s) for s in accumulator.result().sums]
    read: list[dict[str, Any]] = json.loads(json.dumps(documents))
    return read
