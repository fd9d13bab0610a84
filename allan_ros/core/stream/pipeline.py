# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From batches of samples to sums: the path that nodes and offline tools share.

`ImuStream` separates IMUs by their frame_id; each `FrameStream` chooses the stamps and separates
the sensors where their rates differ; each `SensorStream` runs the stages from samples to sums.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from ..allan.spectrum import SpectrumSums
from ..allan.sums import AllanSums
from ..findings import Finding, finding
from ..imu import AXES, ImuBatch, ImuIdentity, joined
from ..settings import SegmenterSettings
from .cleaning import plan_sensors
from .health import Counts, Segment, State, StreamHealth, stream_findings
from .sensor_stream import Means, SensorStream, StreamOptions, StreamSums
from .timing import LEARN

KEPT_FRAMES = 8
"""Different frame_ids in one stream whose sums are kept: each is another IMU."""


@dataclass(frozen=True)
class Accumulation:
    """The results of a stream so far.

    Attributes
    ----------
    sums : tuple of AllanSums
        One with all axes, or one per sensor where their rates differ; sensors without samples are
        left out. If the rate or the frame changed: those of the longest time.
    current : tuple of AllanSums
        The same, of the present rate and frame.
    health : StreamHealth
    findings : tuple of Finding
    segments : tuple of Segment
        The longest 1000 segments of the first of ``sums``, in order of time;
        ``sums[0].segment_count`` is their full number.
    spectra : tuple of SpectrumSums
        Those of ``sums``, in the same order; empty unless requested.
    """

    sums: tuple[AllanSums, ...]
    current: tuple[AllanSums, ...]
    health: StreamHealth
    findings: tuple[Finding, ...]
    segments: tuple[Segment, ...]
    spectra: tuple[SpectrumSums, ...] = ()


class ImuStream:
    """Accumulates the Allan sums of one stream of IMU samples.

    Any chunking of the same samples gives the same sums, bit for bit: all decisions are taken on
    samples counted from the start of the stream, with a fixed look-ahead.

    Parameters
    ----------
    settings : SegmenterSettings
    hardware_id : str
    with_spectra, with_means : bool
        Whether to keep the power spectral density, and the means over a second too.

    Examples
    --------
    >>> import numpy as np
    >>> stream = ImuStream()
    >>> stamps = np.arange(5000) * 10_000_000
    >>> noise = np.random.default_rng(0).normal(size=(5000, 6))
    >>> stream.update(ImuBatch(stamps, noise))
    >>> stream.end()
    >>> stream.result().sums[0].samples
    5000
    """

    def __init__(
        self,
        settings: SegmenterSettings = SegmenterSettings(),
        hardware_id: str = '',
        with_spectra: bool = False,
        with_means: bool = False,
    ) -> None:
        self._hardware_id = hardware_id
        self._wanted = StreamOptions(settings, with_spectra, with_means)
        self._received = 0
        self._frames: dict[str, FrameStream] = {}
        self._present = self._frame('')
        self._frame_changes = 0
        self._dropped = Counts()  # of the frames there was no room for

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
        """Process all buffered samples at the end of the input, and close the segment."""
        for frame in self._frames.values():
            frame.flush()

    def means(self) -> tuple[Means, ...]:
        """Return the latest means of static samples over a second, one value for each sensor."""
        return tuple(stream.means for stream in self._present.sensors if stream.means is not None)

    def result(self) -> Accumulation:
        """Return the results as if the input ended here; the stream itself is not changed."""
        now = copy.deepcopy(self)
        state = now._present.state
        now.end()
        streams = now._present.sensors
        longest = now._longest()
        sums = tuple(each.sums for each in longest)
        health = now._health(state, sums)
        return Accumulation(
            sums,
            tuple(s.present.sums for s in streams if s.present.sums.samples),
            health,
            now._findings(health, sums),
            longest[0].segments if longest else (),
            tuple(each.spectrum for each in longest if each.spectrum is not None),
        )

    def _frame(self, frame_id: str) -> FrameStream:
        return FrameStream(ImuIdentity(frame_id, self._hardware_id), self._wanted)

    def _another(self, frame_id: str) -> FrameStream:
        """Add a frame; if there are too many, drop the one with the shortest data."""
        if len(self._frames) >= KEPT_FRAMES:
            least = min(self._frames.values(), key=lambda frame: frame.longest_ns)
            least.flush()
            self._dropped.add(least.counts)
            del self._frames[least.identity.frame_id]
        self._frames[frame_id] = self._frame(frame_id)
        return self._frames[frame_id]

    def _longest(self) -> tuple[StreamSums, ...]:
        """Return the sums of the longest time for each sensor that was ever present."""
        best: dict[str, StreamSums] = {}
        for frame in self._frames.values():
            for each in frame.by_rate():
                sums = each.sums
                for axis in sums.axes:
                    have = best.get(axis)
                    if sums.samples and (have is None or sums.elapsed_ns > have.sums.elapsed_ns):
                        best[axis] = each
        return tuple({id(best[axis]): best[axis] for axis in AXES if axis in best}.values())

    def _health(self, state: State, longest: tuple[AllanSums, ...]) -> StreamHealth:
        frame = self._present
        counts = Counts(received=self._received)
        for each in (self._dropped, *(frame.counts for frame in self._frames.values())):
            counts.add(each)
        clock = frame.sensors[0].clock if frame.sensors else None
        streams = [s for each in self._frames.values() for s in each.sensors]
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
            sum(stream.relearned for stream in streams),
            {axis: ratio for s in frame.sensors for axis, ratio in s.loudest.items()},
        )

    def _findings(
        self, health: StreamHealth, longest: tuple[AllanSums, ...]
    ) -> tuple[Finding, ...]:
        found = [note for frame in self._frames.values() for note in frame.notes]
        if self._frame_changes:
            times, frame_id = self._frame_changes, self._present.identity.frame_id
            found.append(finding('frame_changed', times=times, frame_id=frame_id))
        found += stream_findings(health, longest, self._wanted.settings)
        return tuple(dict.fromkeys(found))


class FrameStream:
    """The samples of one frame_id: chooses the stamps and feeds the sensor streams.

    Attributes
    ----------
    identity : ImuIdentity
    sensors : tuple of SensorStream
        One, or one per sensor where their rates differ; empty during the learning phase.
    notes : list of Finding
        Findings of the learning phase.
    first_ns, last_ns : int or None
        First and latest stamp.
    use_record : bool
        Whether record times are used as stamps.
    """

    def __init__(self, identity: ImuIdentity, wanted: StreamOptions) -> None:
        self.identity = identity
        self.sensors: tuple[SensorStream, ...] = ()
        self.notes: list[Finding] = []
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self.use_record = wanted.settings.stamps == 'record'
        self._wanted = wanted
        self._settings = wanted.settings
        self._learning: list[ImuBatch] = []
        self._learned = 0
        self._skipped = 0
        self._skip_until: int | None = None
        self._placed = 0  # samples whose stamps come from the declared rate
        self._without_stamps = False

    @property
    def state(self) -> State:
        """State of the stream."""
        states = [sensor.state for sensor in self.sensors]
        if not states:
            return 'learning' if self._learned else 'waiting'
        return 'louder' if 'louder' in states else states[0]

    @property
    def counts(self) -> Counts:
        """Counts of the samples, except the number received."""
        counts = Counts(skipped=self._skipped)
        for sensor in self.sensors:
            counts.add(sensor.counts)
        return counts

    def by_rate(self) -> list[StreamSums]:
        """Return the sums of each sensor stream at each of its rates."""
        return [each for sensor in self.sensors for each in sensor.by_rate()]

    @property
    def longest_ns(self) -> int:
        """Length of the longest data in ns."""
        return max((each.sums.elapsed_ns for each in self.by_rate()), default=0)

    def update(self, batch: ImuBatch) -> None:
        """Take the next samples."""
        if self.sensors:
            self._feed(batch)
            return
        # the first LEARN samples decide together, whatever chunks they came in
        take = min(LEARN - self._learned, len(batch))
        self._learning.append(batch[np.arange(take)])  # a copy
        self._learned += take
        if self._learned == LEARN:
            self._learn()
            if take < len(batch):
                self._feed(batch[take:])

    def flush(self) -> None:
        """Process all buffered samples at the end of the input, and close the segment."""
        if not self.sensors and self._learned:
            self._learn()
        for sensor in self.sensors:
            sensor.flush()

    def _learn(self) -> None:
        """Choose the stamps and the sensor streams from the first samples, then take them."""
        first, self._learning, self._learned = joined(self._learning), [], 0
        stamps, record = first.stamps_ns, first.record_ns
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
        plans, findings = plan_sensors(stamps, first.samples.T)
        self.notes += findings
        self.sensors = tuple(SensorStream(p, self.identity, self._wanted) for p in plans)
        self._feed(first)

    def _feed(self, batch: ImuBatch) -> None:
        stamps, rows = batch.stamps_ns, batch.samples.T
        if self.use_record and batch.record_ns is not None:
            stamps = batch.record_ns
        elif self._without_stamps:
            index = np.arange(self._placed, self._placed + len(stamps))
            self._placed += len(stamps)
            stamps = np.rint(index * (1e9 / self._settings.declared_rate)).astype(np.int64)
        if self.first_ns is None:
            self.first_ns = int(stamps[0])
            self._skip_until = self.first_ns + round(self._settings.skip * 1e9)
        self.last_ns = int(stamps[-1])
        if self._skip_until is not None and self._settings.skip > 0.0:
            late = stamps >= self._skip_until
            start = int(np.argmax(late)) if late.any() else len(stamps)
            if late.any():
                self._skip_until = None  # a backward clock step later skips no more samples
            self._skipped += start
            stamps, rows = stamps[start:], rows[:, start:]
        for sensor in self.sensors:
            sensor.feed(stamps, rows)
