# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From batches to sums: the one way that the node and the offline tool share."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .batch import AXES, ImuBatch
from .clock import LEARN
from .findings import Finding, finding
from .health import Counts, Span, StreamHealth
from .lane_stream import Evidence, LaneStream
from .lanes import plan_lanes
from .settings import SegmenterSettings
from .spectrum import SpectrumSums
from .stream_findings import stream_findings
from .sums import AllanSums, ImuIdentity

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]


@dataclass(frozen=True)
class Accumulation:
    """What an accumulator knows.

    Attributes
    ----------
    sums : tuple of AllanSums
        One with all axes, or one a sensor where their rates differ; sensors without a sample are
        left out. Where the rate or the frame changed on the way: those of the longest time.
    current : tuple of AllanSums
        The same, of the present rate and frame.
    health : StreamHealth
    findings : tuple of Finding
    spans : tuple of Span
        The longest 1000 segments of ``current``, in order of time.
    spectra : tuple of SpectrumSums
        Those of ``sums``, in the same order; empty unless they were asked for.
    """

    sums: tuple[AllanSums, ...]
    current: tuple[AllanSums, ...]
    health: StreamHealth
    findings: tuple[Finding, ...]
    spans: tuple[Span, ...]
    spectra: tuple[SpectrumSums, ...] = ()


class ImuAccumulator:
    """Accumulates the Allan sums of one Imu stream.

    Any chunking of the same samples gives the same sums, bit for bit: all decisions are taken on
    samples counted from the start of the stream, with a fixed look-ahead.

    Parameters
    ----------
    settings : SegmenterSettings
    hardware_id : str
    with_spectra : bool
        Whether to keep the power spectral density of the evidence too.

    Examples
    --------
    >>> import numpy as np
    >>> accumulator = ImuAccumulator()
    >>> stamps = np.arange(5000) * 10_000_000
    >>> noise = np.random.default_rng(0).normal(size=(5000, 6))
    >>> accumulator.update(ImuBatch(stamps, noise))
    >>> accumulator.end()
    >>> accumulator.result().sums[0].samples
    5000
    """

    def __init__(
        self,
        settings: SegmenterSettings = SegmenterSettings(),
        hardware_id: str = '',
        with_spectra: bool = False,
    ) -> None:
        self._settings = settings
        self._hardware_id = hardware_id
        self._with_spectra = with_spectra
        self._received = 0
        self._skipped = 0
        self._first_ns: int | None = None
        self._last_ns: int | None = None
        self._skip_until: int | None = None
        self._former: list[LaneStream] = []
        self._notes: list[Finding] = []
        self._begin('')

    def _begin(self, frame_id: str) -> None:
        """Start anew with another frame."""
        self._frame_id = frame_id
        self._learning: list[tuple[Stamps, Stamps | None, Floats]] = []
        self._learned = 0
        self._lanes: tuple[LaneStream, ...] | None = None
        self._use_record = self._settings.stamps == 'record'
        self._made_up = 0  # samples whose stamps come from the declared rate
        self._without_stamps = False

    def update(self, batch: ImuBatch) -> None:
        """Take the next samples of the stream."""
        if not len(batch):
            return
        if self._received == 0:
            self._frame_id = batch.frame_id
        elif batch.frame_id != self._frame_id:
            self._flush()
            self._former += self._lanes or ()
            self._notes.append(
                finding('frame_changed', before=self._frame_id, after=batch.frame_id)
            )
            self._begin(batch.frame_id)
        self._received += len(batch)
        rows = batch.samples.T
        if self._lanes is not None:
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

    def end(self) -> None:
        """Judge all that waits and close the segment: no more samples come."""
        self._flush()

    def result(self) -> Accumulation:
        """Return what is known, as if the input ended here; what follows is not disturbed."""
        now = copy.deepcopy(self)
        state = now._lanes[0].state if now._lanes else ('learning' if now._learned else 'waiting')
        now._flush()
        lanes = now._lanes or ()
        longest = now._longest()
        return Accumulation(
            tuple(sums for sums, _ in longest),
            tuple(lane.sums for lane in lanes if lane.sums.samples),
            now._health(state),
            now._findings(),
            tuple(lanes[0].spans) if lanes else (),
            tuple(spectrum for _, spectrum in longest if spectrum is not None),
        )

    # --- the way of a batch -------------------------------------------------------------------

    def _learn(self) -> None:
        """Choose the stamps and the lanes from the first samples, then take them."""
        waited, self._learning = self._learning, []
        self._learned = 0
        stamps = np.concatenate([s for s, _, _ in waited])
        records = [r for _, r, _ in waited if r is not None]
        rows = np.concatenate([r for _, _, r in waited], axis=1)
        record = np.concatenate(records) if len(records) == len(waited) else None
        if not self._use_record and len(stamps) > 1 and stamps.min() == stamps.max():
            what = 'all zero' if not stamps.any() else 'all equal'
            if record is not None:
                self._use_record = True
                self._notes.append(finding('stamps_unusable', what=what))
            elif self._settings.declared_rate:
                self._without_stamps = True
                rate = self._settings.declared_rate
                self._notes.append(finding('stamps_from_rate', what=what, rate=rate))
            else:
                self._notes.append(finding('stamps_missing', what=what))
        plans, findings = plan_lanes(stamps, rows)
        self._notes += findings
        identity = ImuIdentity(self._frame_id, self._hardware_id)
        self._lanes = tuple(
            LaneStream(p, identity, self._settings, self._with_spectra) for p in plans
        )
        self._feed(stamps, record, rows)

    def _feed(self, stamps: Stamps, record: Stamps | None, rows: Floats) -> None:
        if self._use_record and record is not None:
            stamps = record
        elif self._without_stamps:
            index = np.arange(self._made_up, self._made_up + len(stamps))
            self._made_up += len(stamps)
            stamps = np.rint(index * (1e9 / self._settings.declared_rate)).astype(np.int64)
        if self._first_ns is None:
            self._first_ns = int(stamps[0])
            self._skip_until = self._first_ns + round(self._settings.skip * 1e9)
        self._last_ns = int(stamps[-1])
        if self._skip_until is not None and self._settings.skip:
            late = stamps >= self._skip_until
            if late.any():
                start = int(np.argmax(late))
                self._skip_until = None  # a clock that goes back later skips nothing more
            else:
                start = len(stamps)
            self._skipped += start
            stamps, rows = stamps[start:], rows[:, start:]
        for lane in self._lanes or ():
            lane.feed(stamps, rows)

    def _flush(self) -> None:
        if self._lanes is None and self._learned:
            self._learn()
        for lane in self._lanes or ():
            lane.flush()

    # --- what is known ------------------------------------------------------------------------

    def _longest(self) -> tuple[Evidence, ...]:
        """Return, for each sensor that ever came, the evidence of the longest time."""
        best: dict[str, Evidence] = {}
        for lane in (*self._former, *(self._lanes or ())):
            for evidence in (*lane.former, lane.evidence):
                sums = evidence.sums
                for axis in sums.axes:
                    have = best.get(axis)
                    if sums.samples and (have is None or sums.elapsed_ns > have.sums.elapsed_ns):
                        best[axis] = evidence
        chosen: list[Evidence] = []
        for axis in AXES:
            if axis in best and not any(best[axis] is evidence for evidence in chosen):
                chosen.append(best[axis])
        return tuple(chosen)

    def _health(self, state: str) -> StreamHealth:
        lanes = self._lanes or ()
        counts = Counts(received=self._received, skipped=self._skipped)
        for lane in (*self._former, *lanes):
            counts.add(lane.counts)
        clock = lanes[0].clock if lanes else None
        return StreamHealth(
            counts,
            state,  # type: ignore[arg-type]
            1e9 / clock[0] if clock else None,
            clock[1] if clock else False,
            self._first_ns,
            self._last_ns,
            'record' if self._use_record else 'header',
        )

    def _findings(self) -> tuple[Finding, ...]:
        found = list(self._notes)
        health = self._health('still')
        relearned = sum(lane.relearned for lane in (*self._former, *(self._lanes or ())))
        longest = tuple(sums for sums, _ in self._longest())
        found += stream_findings(health, longest, self._settings, relearned)
        return tuple(found)
