# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Computes Allan sums from batches of samples, for the nodes and the offline tools.

`ImuStream` separates IMUs by their frame_id, `FrameStream` chooses the stamps and separates the
sensors if their rates differ, and `SensorStream` runs the stages from samples to sums.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from heapq import nlargest
from typing import NamedTuple, get_args

import numpy as np

from ..allan.replaced import RunningStretches
from ..allan.running import RunningSums
from ..allan.sums import AllanSums
from ..errors import AllanError
from ..findings import Finding, finding
from ..imu import AXES, LARGEST, SENSORS, Floats, ImuBatch, ImuIdentity, Stamps, joined
from ..settings import SegmenterSettings
from .cleaning import CoveredTime, RepeatFilter, SampleFilter, StampChoice, StampSorter
from .drive_recorder import NO_DRIVES, DriveRecorder, Drives
from .health import (
    LISTED_EVENTS,
    LISTED_SEGMENTS,
    Accumulation,
    Counts,
    Event,
    Longest,
    Means,
    RunningMeans,
    Segment,
    State,
    StreamHealth,
    stream_findings,
)
from .motion import MotionGate
from .noise_floor import idle_share
from .rest_filter import Change
from .sensors import Clipping, SensorPlan, plan_sensors
from .timing import LEARN, SampleClock, learned_from

CHECKED = LEARN // 8
"""Number of samples that are examined at once to find that all samples of a sensor are measured
again, after some were zero or repeated."""

IDLE = ('sensor_all_zero', 'zero_filled', 'held')
"""Findings of a sensor whose samples are zero or repeated."""

STILL_IDLE = 0.05
"""Smallest share of zero or repeated samples that shows that these continue."""


class StreamSums(NamedTuple):
    """Sums and longest segments of data at one sample rate."""

    sums: AllanSums
    segments: tuple[Segment, ...]


class Present(NamedTuple):
    """State of a stream, known faults of its latest samples, and the white noise of each axis."""

    state: State
    faults: tuple[Finding, ...]
    noise: dict[str, float]


class ImuStream:
    """Accumulates the Allan sums of one stream of IMU samples.

    The sums are the same, bit for bit, however the samples are divided into batches: all decisions
    depend only on the positions of samples counted from the start of the stream, with a fixed
    look-ahead. ``hardware_id`` identifies the IMU if the user states it. ``sensor`` is 'gyro' or
    'accel' if the other sensor is in another stream; its values in this one are ignored.
    ``with_samples`` also keeps all samples at rest in memory, ``with_drives`` what is needed of the
    latest drives between two rests. With ``covered``, each time is counted once: samples are
    skipped if their time is covered by samples before, or is in one of these stretches (first and
    last stamp in ns).
    """

    def __init__(
        self,
        settings: SegmenterSettings = SegmenterSettings(),
        hardware_id: str = '',
        sensor: str = '',
        with_samples: bool = False,
        with_drives: bool = False,
        covered: Sequence[tuple[int, int]] | None = None,
    ) -> None:
        self._hardware_id = hardware_id
        self._settings = settings
        self._options = settings, sensor, with_samples, with_drives, covered
        self._received = 0
        self._frames: dict[str, FrameStream] = {}
        self._present = FrameStream(ImuIdentity('', hardware_id), *self._options)
        self._frame_changes = 0
        self._ended = False  # since the last sample
        self._dropped = Counts()  # of frames whose sums were dropped
        self._dropped_frames = 0

    def update(self, batch: ImuBatch) -> None:
        """Process the next samples of the stream."""
        if not len(batch):
            return
        frame_id = batch.frame_id
        if not self._frames or frame_id != self._present.identity.frame_id:
            self._frame_changes += bool(self._frames)
            self._present = self._frames.get(frame_id) or self._add_frame(frame_id)
        self._received += len(batch)
        self._ended = False
        self._present.update(batch)

    def end(self) -> None:
        """Process all buffered samples at the end of the input, and close the segment."""
        for frame in self._frames.values():
            frame.flush()
        self._ended = True

    def means(self) -> tuple[Means, ...]:
        """Return the latest one-second means of static data of each sensor stream."""
        return tuple(stream.means for stream in self._present.sensors)

    def samples(self) -> dict[str, tuple[Stamps, Floats]]:
        """Return stamps in ns and values of all samples at rest, (n,), by axis, after `end`.

        They belong to the frame_id with the most data, since the last change of its rate. The
        result is empty unless requested.
        """
        frame = max(self._frames.values(), key=lambda each: each.counts.used, default=self._present)
        whole = [(s.axes, joined(s.kept)) for s in frame.sensors if s.kept]
        return {
            axis: (block.stamps_ns, row)
            for axes, block in whole
            for axis, row in zip(axes, block.rows)
        }

    def drives(self) -> Drives:
        """Return the latest drives between two rests; empty unless requested.

        They belong to the frame_id with the most data. There are none if gyro and accelerometer
        have different rates or are in different streams. Before `end`, a drive is complete when its
        second rest is over or long enough.
        """
        frame = max(self._frames.values(), key=lambda each: each.counts.used, default=self._present)
        recorders = [each.recorder for each in frame.sensors if each.recorder is not None]
        if not recorders:
            return NO_DRIVES
        return recorders[0].result if self._ended else recorders[0].complete

    def result(self) -> Accumulation:
        """Return the results as if the input ended here; the stream is not changed."""
        now = self if self._ended else copy.deepcopy(self)
        present = now._present.present
        if not self._ended:
            now.end()
        longest = now._longest()
        sums = tuple(each.sums for each in longest)
        segments = longest[0].segments if longest else ()
        return Accumulation(sums, *now._health(present, sums), segments)

    def present_health(
        self, sums: tuple[AllanSums, ...]
    ) -> tuple[StreamHealth, tuple[Finding, ...]]:
        """Return state and findings without computing new sums, which is faster than `result`.

        ``sums`` are the sums of an earlier `result`. The counts do not include samples that are not
        classified yet.
        """
        present = self._present.present
        if present.state not in ('waiting', 'learning'):
            return self._health(present, sums)
        now = self
        if not self._ended:
            now = copy.deepcopy(self)  # all samples are buffered, and there are few of them
            now.end()
        return now._health(present, sums)

    def _add_frame(self, frame_id: str) -> FrameStream:
        """Start the stream of a new frame_id; of two earlier streams, remove the smaller one."""
        if len(self._frames) > 1:
            least = min(self._frames.values(), key=lambda frame: frame.counts.used)
            del self._frames[least.identity.frame_id]
            self._dropped.other_frame += least.received
            self._dropped_frames += 1
        frame = FrameStream(ImuIdentity(frame_id, self._hardware_id), *self._options)
        self._frames[frame_id] = frame
        return frame

    def _longest(self) -> tuple[StreamSums, ...]:
        """Return the sums with the longest elapsed time for each sensor with data."""
        frames = self._frames.values()
        sensors = [sensor for frame in frames for sensor in (*frame.earlier, *frame.sensors)]
        known = [each for sensor in sensors for each in sensor.by_rate()]
        best: dict[str, StreamSums] = {}
        for each in sorted(known, key=lambda each: -each.sums.elapsed_ns):
            for axis in each.sums.axes:
                best.setdefault(axis, each)
        return tuple({id(best[axis]): best[axis] for axis in AXES if axis in best}.values())

    def _health(
        self, present: Present, longest: tuple[AllanSums, ...]
    ) -> tuple[StreamHealth, tuple[Finding, ...]]:
        """Return counts, state and findings; ``longest`` are the sums that are reported."""
        frame = self._present
        counts = Counts(received=self._received)
        for each in (self._dropped, *(frame.counts for frame in self._frames.values())):
            counts.add(each)
        clock = frame.sensors[0].clock.clock if frame.sensors else None
        gates = [sensor.gate for sensor in frame.sensors if sensor.gate is not None]
        streams = [s for each in self._frames.values() for s in (*each.earlier, *each.sensors)]
        health = StreamHealth(
            counts,
            present.state,
            1e9 / clock.period_ns if clock else None,
            clock.bursty if clock else False,
            1e9 / clock.base_ns if clock and clock.base_ns else None,
            frame.first_ns,
            'record' if frame.stamps.use_record else 'header',
            frame.identity.frame_id,
            longest[0].identity.frame_id if longest else frame.identity.frame_id,
            self._frame_changes,
            sum(stream.relearned for stream in streams),
            {axis: ratio for gate in gates for axis, ratio in gate.increases.items()},
            max((stream.discarded_s for stream in streams), default=0.0),
            {axis: share for gate in gates for axis, share in gate.heavy_tails.items()},
            tuple(event for s in (*frame.earlier, *frame.sensors) for event in s.events.items),
            self._dropped_frames,
            {axis: ratio for gate in gates for axis, ratio in gate.decreases.items()},
            tuple(axis for gate in gates for axis in gate.stuck),
            {axis: share for sensor in frame.sensors for axis, share in sensor.clipped.items()},
            present.faults,
            present.noise,
        )
        notes = [note for frame in self._frames.values() for note in frame.notes]
        if repeated := sum(frame.repeated for frame in self._frames.values()):
            notes.append(finding('time_repeated', count=repeated))
        if clock is not None:  # the stamps became usable later
            notes = [note for note in notes if note.id != 'stamps_missing']
        # the share of the first samples is known earlier, that of all samples is better
        if any(sensor.is_examined for sensor in frame.sensors):
            notes = [note for note in notes if note.id != 'clipped']
        found = [*notes, *stream_findings(health, longest, self._settings)]
        return health, tuple(dict.fromkeys(found))


class FrameStream:
    """Chooses the stamps of the samples with one frame_id, and divides them into sensor streams.

    ``sensors`` has one stream for all axes, or one per sensor if the rates differ. It is empty
    until the first samples are evaluated. ``notes`` are the findings about these first samples. If
    samples of a sensor were zero or repeated, each `CHECKED` samples are examined before they are
    processed: when the fault ends, other streams begin, and the streams before are ``earlier``.
    """

    def __init__(
        self,
        identity: ImuIdentity,
        settings: SegmenterSettings,
        sensor: str,
        with_samples: bool,
        with_drives: bool,
        covered: Sequence[tuple[int, int]] | None,
    ) -> None:
        self.identity = identity
        self._options = settings, with_samples, with_drives
        self.sensors: tuple[SensorStream, ...] = ()
        self.earlier: tuple[SensorStream, ...] = ()
        self._dropped = Counts()  # of streams before these
        self._has_idle = False  # whether samples of a sensor were zero or repeated
        self.notes: list[Finding] = []
        self.first_ns: int | None = None
        self.received = 0
        self.stamps = StampChoice(settings.stamps == 'record', settings.declared_rate)
        self._settings = settings
        self._sensor = sensor  # the only one that is used; '' for both
        self._sorter = StampSorter()
        self._learning: list[ImuBatch] = []
        self._learned = 0
        self._skip_ns = round(settings.skip * 1e9)  # 0 once the warm-up time is over
        self._skipped = 0  # number of samples during this time
        self._covered = None if covered is None else CoveredTime(covered)

    @property
    def state(self) -> State:
        """State of the first sensor stream, or 'noise_increased' if any stream is in this state."""
        states = [sensor.state for sensor in self.sensors]
        if not states:
            return 'learning' if self._learned else 'waiting'
        return 'noise_increased' if 'noise_increased' in states else states[0]

    @property
    def present(self) -> Present:
        """State, known faults and noise of the samples that were classified last."""
        gates = [sensor.gate for sensor in self.sensors if sensor.gate is not None]
        return Present(
            self.state,
            tuple(fault for gate in gates for fault in gate.faults),
            {axis: level for gate in gates for axis, level in gate.noise.items()},
        )

    @property
    def repeated(self) -> int:
        """Number of samples of a time that was covered before."""
        return 0 if self._covered is None else self._covered.dropped

    @property
    def counts(self) -> Counts:
        """Counts of all sensor streams; ``received`` is 0, since `ImuStream` counts it."""
        counts = Counts(skipped=self._skipped + self.repeated, reordered=self._sorter.sorted)
        counts.add(self._dropped)
        for sensor in (*self.earlier, *self.sensors):
            counts.add(sensor.counts)
        return counts

    def update(self, batch: ImuBatch) -> None:
        """Process the next samples with this frame_id."""
        self.received += len(batch)
        while (self._has_idle or not self.sensors) and len(batch):
            # exactly this number of samples is evaluated, so that batch sizes do not matter
            stamps = [each.stamps_ns for each in (*self._learning, batch[:LEARN])]
            number = CHECKED if self.sensors else learned_from(np.concatenate(stamps))
            take = min((number or LEARN) - self._learned, len(batch))
            self._learning.append(batch[np.arange(take)])  # a copy
            self._learned += take
            if self._learned == number:
                self._learn()
            batch = batch[take:]
        self._feed(self._sorter.feed(self.stamps.of(batch)))

    def flush(self) -> None:
        """Process all buffered samples at the end of the input, and close the segment."""
        if self._learned:
            self._learn(at_end=True)
        self._feed(self._sorter.flush())
        for sensor in self.sensors:
            sensor.flush()

    def _learn(self, at_end: bool = False) -> None:
        """Choose the stamps and the sensor streams from the buffered samples; process these."""
        first, self._learning, self._learned = joined(self._learning), [], 0
        if self.sensors and (at_end or self._is_idle(first)):
            self._feed(self._sorter.feed(self.stamps.of(first)))
            return
        if self.sensors:
            self._start_again(first)
            return
        notes = self.stamps.learn(first)
        samples = self.stamps.of(first)
        plans, findings = plan_sensors(StampSorter.all_sorted(samples), self._sensor)
        self.notes += [note for note in (*notes, *findings) if note not in self.notes]
        self._sorter = StampSorter(samples.stamps_ns)
        self.sensors = tuple(SensorStream(plan, self.identity, *self._options) for plan in plans)
        self._has_idle = any(each.id in IDLE for each in findings)
        self._feed(self._sorter.feed(samples))

    def _is_idle(self, samples: ImuBatch) -> bool:
        """Return whether samples of a sensor are still zero or repeated."""
        wanted = [place for each, place in SENSORS.items() if self._sensor in ('', each)]
        for rows in (samples.rows[place] for place in wanted):
            usable = rows[:, (np.abs(rows) <= LARGEST).all(axis=0)]
            if usable.size and idle_share(usable, usable.shape[1])[0] >= STILL_IDLE:
                return True
        return False

    def _start_again(self, samples: ImuBatch) -> None:
        """Evaluate the next samples like the first ones; the streams so far have ended."""
        self._feed(self._sorter.flush())
        for sensor in self.sensors:
            sensor.flush()
        for sensor in self.earlier:
            self._dropped.add(sensor.counts)
        self._dropped.reordered += self._sorter.sorted
        self.earlier, self.sensors = self.sensors, ()
        self.notes = [note for note in self.notes if note.id not in IDLE]
        self._learning, self._learned = [samples], len(samples)

    def _feed(self, samples: ImuBatch) -> None:
        if self._covered is not None:
            samples = self._covered.feed(samples)
        if not len(samples):
            return
        if self.first_ns is None:
            self.first_ns = int(samples.stamps_ns[0])
        if self._skip_ns:
            late = samples.stamps_ns >= self.first_ns + self._skip_ns
            start = int(np.argmax(late)) if late.any() else len(samples)
            self._skip_ns *= not late.any()
            self._skipped += start
            samples = samples.part(slice(start, None))
        for sensor in self.sensors:
            sensor.feed(samples)


class SensorStream:
    """Computes the sums of axes that are sampled together, from their samples at rest.

    These are all six axes, or the axes of one sensor if the sensors have different rates. The
    stages are: `SampleFilter`, `SampleClock`, `RepeatFilter` (if the driver repeats samples at
    random), `MotionGate`, `RunningSums`.
    ``gate`` is None before the sample period is learned, or if it is switched off. ``recorder`` has
    the drives between two rests, if they are requested.
    """

    def __init__(
        self,
        plan: SensorPlan,
        identity: ImuIdentity,
        settings: SegmenterSettings,
        with_samples: bool = False,
        with_drives: bool = False,
    ) -> None:
        self.axes = plan.axes
        self._with_drives = with_drives and plan.axes == AXES
        self.recorder: DriveRecorder | None = None
        self._with_samples = with_samples
        self.counts = Counts()
        self.events: Longest[Event] = Longest(LISTED_EVENTS)
        self._discards = 0
        self._discarded_s = 0.0
        self._first_ns: int | None = None
        self._restarted = False
        self._plan = plan
        self._former: StreamSums | None = None  # at the earlier rate with the most data
        self._identity = identity
        self._settings = settings
        self._filter = SampleFilter(plan, self.counts)
        self._start()

    def _start(self) -> None:
        """Begin to learn the sample period."""
        axes, drop = self._plan.axes, self._plan.drop
        self.clock = SampleClock(len(axes), self._settings, bool(drop), self.counts)
        self.gate: MotionGate | None = None
        # between the clock and the sums
        self._stages: list[RepeatFilter | MotionGate] = []
        if self._plan.random_repeats:
            groups = [[axes.index(axis) for axis in group] for group in self._plan.random_repeats]
            self._stages.append(RepeatFilter(groups, len(axes)))
        self._clear()

    def _clear(self) -> None:
        """Start with empty sums."""
        self._sums = FloorSums(self._identity, self._plan.axes, self._with_samples)
        self._other: FloorSums | None = None  # at another noise floor
        self._tried = False  # whether the present noise floor is only tried
        self._means = RunningMeans(self._plan.axes)

    @property
    def _published(self) -> FloorSums:
        """The sums that are the result: those of before while another noise floor is tried."""
        return self._other if self._tried and self._other is not None else self._sums

    @property
    def _is_later(self) -> bool:
        """Whether the result lacks earlier sums, because the noise changed for a longer time."""
        other = self._other
        return other is not None and not self._tried and other.first_ns < self._sums.first_ns

    @property
    def relearned(self) -> int:
        """How often the result lost the sums so far, because the IMU moved or its noise changed."""
        return self._discards + self._is_later

    @property
    def discarded_s(self) -> float:
        """Time in s between the first samples at rest and of the result; 0 if they are the same."""
        later = self._since_start(self._sums.first_ns) if self._is_later else 0.0
        return max(self._discarded_s, later)

    @property
    def kept(self) -> list[ImuBatch]:
        """The samples at rest, if they were requested."""
        return self._published.kept

    @property
    def is_examined(self) -> bool:
        """Whether samples at rest were searched for clipped ones."""
        return self._published.is_examined

    @property
    def clipped(self) -> dict[str, float]:
        """Axis -> share of its samples at rest that are at the end of the measurement range."""
        return self._published.clipped

    @property
    def state(self) -> State:
        """'waiting' or 'learning' until the period is known, then the state of `MotionGate`."""
        if self.gate is not None:
            return self.gate.state
        if self.clock.clock is not None and not self._settings.motion_gate:
            return 'at_rest'
        return 'learning' if len(self.clock.pending) else 'waiting'

    def by_rate(self) -> list[StreamSums]:
        """Return the sums at the present sample rate and at the earlier one with the most data."""
        sums, segments = self._published.result
        former = [] if self._former is None else [self._former]
        if not sums.samples:
            return former
        if former:
            with suppress(AllanError):  # another rate
                sums = former[0].sums + sums
                longest = nlargest(
                    LISTED_SEGMENTS, [*former[0].segments, *segments], key=lambda each: each.samples
                )
                return [StreamSums(sums, tuple(sorted(longest)))]
        return [*former, StreamSums(sums, segments)]

    @property
    def means(self) -> Means:
        """The latest one-second means of static data."""
        return self._means.means

    def feed(self, samples: ImuBatch) -> None:
        """Process samples of the six-axis stream."""
        self._pass_on(self.clock.feed(self._filter.feed(samples)))
        while self.clock.rate_changed:
            self._pass_on(self._change_rate())

    def flush(self) -> None:
        """Process all buffered samples at the end of the input, and close the segment."""
        self._pass_on(self.clock.flush())
        while self.clock.rate_changed:
            self._pass_on(self._change_rate() + self.clock.flush())
        self._end_segment()

    def _change_rate(self) -> list[ImuBatch]:
        """Store the sums at the previous rate; return the blocks of the samples at the new one."""
        self._end_segment()
        self.counts.splits['rate change'] += 1
        known = self.by_rate()
        self._former = max(known, key=lambda each: each.sums.elapsed_ns) if known else None
        pending = self.clock.pending
        self._start()
        return self.clock.feed(pending)

    def _pass_on(self, blocks: list[ImuBatch], at_end: bool = False) -> None:
        """Pass evenly spaced blocks through the stages to the sums."""
        if blocks and self.gate is None and self._settings.motion_gate:
            period, axes = self.clock.learned_ns, self._plan.axes
            self.gate = MotionGate(period, axes, self.counts, self.events, self._settings)
            self._stages.append(self.gate)
            if self._with_drives:
                self.recorder = DriveRecorder(period * 1e-9)
        for stage in self._stages:
            if stage is self.gate and self.recorder is not None:
                self.recorder.add_samples(blocks)
            blocks = stage.feed(blocks) + (stage.flush() if at_end else [])
        if self.recorder is not None:
            self.recorder.add_rests(blocks)
        for block in blocks:
            self._accumulate(block)

    def _end_segment(self) -> None:
        """Process the samples that the stages have buffered, and close the segment."""
        self._pass_on([], at_end=True)
        self._sums.close()
        self._means.cut()

    def _accumulate(self, block: ImuBatch) -> None:
        """Add a block at rest to the sums."""
        if block.cut in get_args(Change):
            self._change_floor(block.cut)
        elif block.cut:
            self._sums.close()
            self._means.cut()
        if not len(block):
            return
        if self._first_ns is None:
            self._first_ns = int(block.stamps_ns[0])
        if self._restarted:  # the gate released samples of the last discarded block again
            self._discarded_s = (int(block.stamps_ns[0]) - self._first_ns) * 1e-9
            self._restarted = False
        if self.gate is None:  # else it counts them
            self.counts.used += len(block)
        self._sums.add(block)
        self._means.update(block.stamps_ns, block.rows)

    def _change_floor(self, change: str) -> None:
        """Discard sums, set them aside or continue them, as `Change` states."""
        if change != 'accepted':
            self._sums.close()
            self._means.cut()
        present, other, was_tried = self._sums, self._other, self._tried
        if change == 'resumed':
            assert other is not None
            self._sums, self._other = other, None if was_tried else present
            self._tried = False
        elif change == 'accepted':
            self._tried = False
        else:
            self._sums = FloorSums(self._identity, self._plan.axes, self._with_samples)
            if change == 'set_aside':
                if self._is_later:  # the earlier sums are dropped
                    self._note_discarded(present.first_ns)
                self._other, self._tried = (other if was_tried else present), True
            elif not was_tried:
                self._other, self._restarted = None, True
                self._note_discarded(present.last_ns)  # until the next sample is kept

    def _note_discarded(self, until_ns: int) -> None:
        """Count that the sums from the start to a stamp were discarded."""
        self._discards += 1
        self._discarded_s = max(self._discarded_s, self._since_start(until_ns))

    def _since_start(self, stamp_ns: int) -> float:
        """Return the time in s since the first sample at rest."""
        return (stamp_ns - (self._first_ns or 0)) * 1e-9


class FloorSums:
    """Sums of the samples at rest at one noise floor, and their segments."""

    def __init__(self, identity: ImuIdentity, axes: tuple[str, ...], with_samples: bool) -> None:
        self.kept: list[ImuBatch] = []
        self.first_ns = self.last_ns = 0
        self._with_samples = with_samples
        self._engine = RunningSums(identity, axes)
        self._replaced = RunningStretches(len(axes))
        self._axes, self._clipping = axes, Clipping(len(axes))
        self._segments: Longest[Segment] = Longest(LISTED_SEGMENTS)
        self._start_ns, self._cut = 0, ''  # of the segment

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self._engine.samples

    @property
    def is_examined(self) -> bool:
        """Whether samples were searched for clipped ones."""
        return self._clipping.samples > 0

    @property
    def clipped(self) -> dict[str, float]:
        """Axis -> share of its samples that are clipped; without axes that are not clipped."""
        shares = zip(self._axes, self._clipping.shares.tolist())
        return {axis: share for axis, share in shares if share}

    @property
    def result(self) -> StreamSums:
        """The sums and the longest segments."""
        sums = replace(self._engine.sums, replaced=self._replaced.table)
        return StreamSums(sums, self._segments.items)

    def add(self, block: ImuBatch) -> None:
        """Add samples that directly follow the previous ones unless the segment was closed."""
        if not self._engine.open_samples:
            self._start_ns, self._cut = int(block.stamps_ns[0]), block.cut
        if not self._engine.samples:
            self.first_ns = self._start_ns
        self.last_ns = int(block.stamps_ns[-1])
        self._replaced.add(block.filled)
        self._clipping.add(block.rows)
        interpolated = None if block.filled is None else np.asarray(block.filled.any(axis=0))
        self._engine.update(block.samples, int(block.stamps_ns[0]), self.last_ns, interpolated)
        if self._with_samples:
            self.kept.append(block.copy())

    def close(self) -> None:
        """End the segment."""
        samples = self._engine.open_samples
        if samples:
            length = (self.last_ns - self._start_ns) * 1e-9
            self._segments.add(samples, Segment(self._start_ns, samples, length, self._cut))
            self._engine.end_segment()
            self._replaced.add(None)
