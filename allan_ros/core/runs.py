# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where a played recording begins again: its second pass must not count as new evidence."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .batch import ImuBatch
from .stamp_filter import BACKWARD_RUN


class RunSplitter:
    """Splits a stream where its stamps go back and stay back.

    A single backward stamp is left to the segmenter, which drops it. So samples behind the latest
    stamp are held until `BACKWARD_RUN` of them have come in a row (a new run, from the first of
    them on) or one ahead of it has.

    Parameters
    ----------
    latest_ns : int or None
        Latest stamp of the evidence there is already, as from a checkpoint.
    """

    def __init__(self, latest_ns: int | None = None) -> None:
        self._latest = latest_ns
        self._held: ImuBatch | None = None

    def split(self, batch: ImuBatch) -> Iterator[tuple[bool, ImuBatch]]:
        """Yield (begins a new run, samples) in order; joined, they are the stream."""
        if self._held is not None:
            if self._held.frame_id == batch.frame_id:
                batch = _joined(self._held, batch)
            else:
                yield False, self._held
            self._held = None
        new_run = False
        while len(batch):
            settled, another = self._look(batch)
            if settled:
                yield new_run, batch[:settled]
            batch = batch[settled:]
            if not another:
                self._held = batch if len(batch) else None
                return
            self._latest, new_run = None, True

    def flush(self) -> Iterator[tuple[bool, ImuBatch]]:
        """Yield what is held: no more samples come."""
        held, self._held = self._held, None
        if held is not None:
            yield False, held

    def _look(self, batch: ImuBatch) -> tuple[int, bool]:
        """Return how many samples surely belong to this run, and whether another follows them."""
        stamps = batch.stamps_ns
        latest = stamps[0] if self._latest is None else self._latest
        reached = np.maximum.accumulate(np.concatenate([[latest], stamps]))
        ahead = np.flatnonzero(stamps >= reached[:-1])
        # between two samples that are ahead lies a row of samples that are behind
        edges = np.concatenate([[-1], ahead, [len(stamps)]])
        long = np.flatnonzero(np.diff(edges) > BACKWARD_RUN)
        if len(long):
            return int(edges[long[0]]) + 1, True
        self._latest = int(reached[-1])
        return int(edges[-2]) + 1, False


def _joined(a: ImuBatch, b: ImuBatch) -> ImuBatch:
    record = None
    if a.record_ns is not None and b.record_ns is not None:
        record = np.concatenate([a.record_ns, b.record_ns])
    return ImuBatch(
        np.concatenate([a.stamps_ns, b.stamps_ns]),
        np.concatenate([a.samples, b.samples]),
        record,
        b.frame_id,
    )
