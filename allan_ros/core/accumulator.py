# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From batches to sums: the one way that the node and the offline tool share."""

from __future__ import annotations

import copy
from dataclasses import dataclass

from .batch import AXES, ImuBatch
from .findings import Finding, finding
from .frame_stream import FrameStream
from .health import Counts, Span, State, StreamHealth
from .lane_stream import Evidence
from .settings import SegmenterSettings
from .spectrum import SpectrumSums
from .stream_findings import stream_findings
from .sums import AllanSums, ImuIdentity

KEPT_FRAMES = 8
"""Different frame_ids in one stream whose evidence is kept: each is another IMU."""


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
        self._frames: dict[str, FrameStream] = {}
        self._present = self._frame('')
        self._frame_changes = 0
        self._frame_note: Finding | None = None
        self._forgotten = Counts()  # of the frames there was no room for

    def update(self, batch: ImuBatch) -> None:
        """Take the next samples of the stream."""
        if not len(batch):
            return
        before, after = self._present.identity.frame_id, batch.frame_id
        if self._received == 0:
            self._present = self._frames[after] = self._frame(after)
        elif after != before:
            self._frame_changes += 1
            times = self._frame_changes
            self._frame_note = finding('frame_changed', before=before, after=after, times=times)
            self._present = self._frames.get(after) or self._another(after)
        self._received += len(batch)
        self._present.update(batch)

    def end(self) -> None:
        """Judge all that waits and close the segment: no more samples come."""
        for frame in self._frames.values():
            frame.flush()

    def result(self) -> Accumulation:
        """Return what is known, as if the input ended here; what follows is not disturbed."""
        now = copy.deepcopy(self)
        state = now._present.state
        now.end()
        lanes = now._present.lanes
        longest = now._longest()
        sums = tuple(sums for sums, _ in longest)
        health = now._health(state, sums)
        return Accumulation(
            sums,
            tuple(lane.sums for lane in lanes if lane.sums.samples),
            health,
            now._findings(health, sums),
            tuple(lanes[0].spans) if lanes else (),
            tuple(spectrum for _, spectrum in longest if spectrum is not None),
        )

    # --- the frames ---------------------------------------------------------------------------

    def _frame(self, frame_id: str) -> FrameStream:
        identity = ImuIdentity(frame_id, self._hardware_id)
        return FrameStream(identity, self._settings, self._with_spectra)

    def _another(self, frame_id: str) -> FrameStream:
        """Begin with another frame; where there are too many, that of the least evidence goes."""
        if len(self._frames) >= KEPT_FRAMES:
            least = min(self._frames.values(), key=lambda frame: frame.longest_ns)
            least.flush()
            self._forgotten.add(least.counts)
            del self._frames[least.identity.frame_id]
        self._frames[frame_id] = self._frame(frame_id)
        return self._frames[frame_id]

    # --- what is known ------------------------------------------------------------------------

    def _longest(self) -> tuple[Evidence, ...]:
        """Return, for each sensor that ever came, the evidence of the longest time."""
        best: dict[str, Evidence] = {}
        for frame in self._frames.values():
            for evidence in frame.evidence:
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

    def _health(self, state: State, longest: tuple[AllanSums, ...]) -> StreamHealth:
        frame = self._present
        counts = Counts(received=self._received)
        for each in (self._forgotten, *(frame.counts for frame in self._frames.values())):
            counts.add(each)
        clock = frame.lanes[0].clock if frame.lanes else None
        return StreamHealth(
            counts,
            state,
            1e9 / clock[0] if clock else None,
            clock[1] if clock else False,
            frame.first_ns,
            frame.last_ns,
            'record' if frame.use_record else 'header',
            frame.identity.frame_id,
            longest[0].identity.frame_id if longest else frame.identity.frame_id,
            self._frame_changes,
        )

    def _findings(
        self, health: StreamHealth, longest: tuple[AllanSums, ...]
    ) -> tuple[Finding, ...]:
        frames = self._frames.values()
        found = [note for frame in frames for note in frame.notes]
        if self._frame_note is not None:
            found.append(self._frame_note)
        relearned = sum(lane.relearned for frame in frames for lane in frame.lanes)
        found += stream_findings(health, longest, self._settings, relearned)
        return tuple(dict.fromkeys(found))
