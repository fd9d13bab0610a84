# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From batches to sums: the one way that the node and the offline tool share."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..allan.spectrum import SpectrumSums
from ..allan.sums import AllanSums
from ..findings import Finding, finding
from ..imu import AXES, ImuBatch, ImuIdentity
from ..settings import SegmenterSettings
from .cleaning import BACKWARD_RUN, plan_sensors
from .findings import stream_findings
from .health import Counts, Segment, State, StreamHealth
from .sensor_stream import SensorStream, StreamSums
from .timing import LEARN

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
    spans: tuple[Segment, ...]
    spectra: tuple[SpectrumSums, ...] = ()


class ImuStream:
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
    >>> accumulator = ImuStream()
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

    def _longest(self) -> tuple[StreamSums, ...]:
        """Return, for each sensor that ever came, the evidence of the longest time."""
        best: dict[str, StreamSums] = {}
        for frame in self._frames.values():
            for evidence in frame.evidence:
                sums = evidence.sums
                for axis in sums.axes:
                    have = best.get(axis)
                    if sums.samples and (have is None or sums.elapsed_ns > have.sums.elapsed_ns):
                        best[axis] = evidence
        chosen: list[StreamSums] = []
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
        if self._frame_changes:
            times, frame_id = self._frame_changes, self._present.identity.frame_id
            found.append(finding('frame_changed', times=times, frame_id=frame_id))
        relearned = sum(lane.relearned for frame in frames for lane in frame.lanes)
        found += stream_findings(health, longest, self._settings, relearned)
        return tuple(dict.fromkeys(found))


Floats = NDArray[np.float64]

Stamps = NDArray[np.int64]


class FrameStream:
    """Learns from the first samples what the stream is like, and feeds its lanes.

    Attributes
    ----------
    identity : ImuIdentity
    lanes : tuple of SensorStream
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
        self.lanes: tuple[SensorStream, ...] = ()
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
    def evidence(self) -> list[StreamSums]:
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
        plans, findings = plan_sensors(stamps, rows)
        self.notes += findings
        self.lanes = tuple(
            SensorStream(p, self.identity, self._settings, self._with_spectra) for p in plans
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
        if self._skip_until is not None and self._settings.skip > 0.0:
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
                batch = joined(self._held, batch)
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


def joined(a: ImuBatch, b: ImuBatch) -> ImuBatch:
    """Return the samples of both in one batch, with the frame_id of the second."""
    record = None
    if a.record_ns is not None and b.record_ns is not None:
        record = np.concatenate([a.record_ns, b.record_ns])
    return ImuBatch(
        np.concatenate([a.stamps_ns, b.stamps_ns]),
        np.concatenate([a.samples, b.samples]),
        record,
        b.frame_id,
    )
