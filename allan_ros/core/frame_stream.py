# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The samples of one frame_id, which is one IMU: which stamps and which lanes, then into these."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .batch import ImuBatch
from .clock import LEARN
from .findings import Finding, finding
from .health import Counts, State
from .lane_stream import Evidence, LaneStream
from .lanes import plan_lanes
from .settings import SegmenterSettings
from .sums import ImuIdentity

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]


class FrameStream:
    """Learns from the first samples what the stream is like, and feeds its lanes.

    Attributes
    ----------
    identity : ImuIdentity
    lanes : tuple of LaneStream
        One, or one a sensor where their rates differ; empty while the stream is learned.
    notes : list of Finding
        What was seen while it was learned.
    first_ns, last_ns : int or None
        First and latest stamp.
    use_record : bool
        Whether record times stand for the stamps.
    """

    def __init__(
        self, identity: ImuIdentity, settings: SegmenterSettings, with_spectra: bool
    ) -> None:
        self.identity = identity
        self.lanes: tuple[LaneStream, ...] = ()
        self.notes: list[Finding] = []
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self.use_record = settings.stamps == 'record'
        self._settings = settings
        self._with_spectra = with_spectra
        self._learning: list[tuple[Stamps, Stamps | None, Floats]] = []
        self._learned = 0
        self._skipped = 0
        self._skip_until: int | None = None
        self._made_up = 0  # samples whose stamps come from the declared rate
        self._without_stamps = False

    @property
    def state(self) -> State:
        """Where the stream stands."""
        if self.lanes:
            return self.lanes[0].state
        return 'learning' if self._learned else 'waiting'

    @property
    def counts(self) -> Counts:
        """What became of the samples, but for how many came."""
        counts = Counts(skipped=self._skipped)
        for lane in self.lanes:
            counts.add(lane.counts)
        return counts

    @property
    def evidence(self) -> list[Evidence]:
        """What there is of each lane at each rate it had."""
        return [each for lane in self.lanes for each in lane.evidence_by_rate()]

    @property
    def longest_ns(self) -> int:
        """Length of the longest evidence in ns."""
        return max((each.sums.elapsed_ns for each in self.evidence), default=0)

    def update(self, batch: ImuBatch) -> None:
        """Take the next samples."""
        rows = batch.samples.T
        if self.lanes:
            self._feed(batch.stamps_ns, batch.record_ns, rows)
            return
        # the first LEARN samples decide together, whatever chunks they came in
        take = min(LEARN - self._learned, len(batch))
        record = batch.record_ns
        self._learning.append(
            (
                batch.stamps_ns[:take].copy(),
                None if record is None else record[:take].copy(),
                np.array(rows[:, :take], order='C'),
            )
        )
        self._learned += take
        if self._learned == LEARN:
            self._learn()
            if take < len(batch):
                self._feed(
                    batch.stamps_ns[take:],
                    None if record is None else record[take:],
                    rows[:, take:],
                )

    def flush(self) -> None:
        """Judge all that waits and close the segment: no more samples come."""
        if not self.lanes and self._learned:
            self._learn()
        for lane in self.lanes:
            lane.flush()

    def _learn(self) -> None:
        """Choose the stamps and the lanes from the first samples, then take them."""
        waited, self._learning = self._learning, []
        self._learned = 0
        stamps = np.concatenate([s for s, _, _ in waited])
        records = [r for _, r, _ in waited if r is not None]
        rows = np.concatenate([r for _, _, r in waited], axis=1)
        record = np.concatenate(records) if len(records) == len(waited) else None
        if not self.use_record and len(stamps) > 1 and stamps.min() == stamps.max():
            what = 'all zero' if not stamps.any() else 'all equal'
            if record is not None:
                self.use_record = True
                self.notes.append(finding('stamps_unusable', what=what))
            elif self._settings.declared_rate:
                self._without_stamps = True
                rate = self._settings.declared_rate
                self.notes.append(finding('stamps_from_rate', what=what, rate=rate))
            else:
                self.notes.append(finding('stamps_missing', what=what))
        plans, findings = plan_lanes(stamps, rows)
        self.notes += findings
        self.lanes = tuple(
            LaneStream(p, self.identity, self._settings, self._with_spectra) for p in plans
        )
        self._feed(stamps, record, rows)

    def _feed(self, stamps: Stamps, record: Stamps | None, rows: Floats) -> None:
        if self.use_record and record is not None:
            stamps = record
        elif self._without_stamps:
            index = np.arange(self._made_up, self._made_up + len(stamps))
            self._made_up += len(stamps)
            stamps = np.rint(index * (1e9 / self._settings.declared_rate)).astype(np.int64)
        if self.first_ns is None:
            self.first_ns = int(stamps[0])
            self._skip_until = self.first_ns + round(self._settings.skip * 1e9)
        self.last_ns = int(stamps[-1])
        if self._skip_until is not None and self._settings.skip:
            late = stamps >= self._skip_until
            if late.any():
                start = int(np.argmax(late))
                self._skip_until = None  # a clock that goes back later skips nothing more
            else:
                start = len(stamps)
            self._skipped += start
            stamps, rows = stamps[start:], rows[:, start:]
        for lane in self.lanes:
            lane.feed(stamps, rows)
