# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Computes Allan sums from batches of samples, for the nodes and the offline tools.

`ImuStream` separates IMUs by their frame_id, `FrameStream` chooses the stamps and separates the
sensors if their rates differ, and `SensorStream` runs the stages from samples to sums.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..allan.sums import AllanSums
from ..findings import Finding, finding
from ..imu import AXES, LARGEST, Floats, ImuBatch, ImuIdentity, Stamps, joined
from ..settings import SegmenterSettings
from .cleaning import CoveredTime, StampChoice, StampSorter, are_ordered
from .drive_recorder import NO_DRIVES, Drives
from .health import Counts, Means, Segment, State, StreamHealth, stream_findings
from .noise_levels import StreamSums
from .sensor_stream import SensorStream
from .sensors import plan_sensors
from .timing import LEARN, learned_from
from .windows import idle_share

CHECKED = LEARN // 8
"""Number of samples that are examined together to decide whether a fault of the first samples has
ended."""

IDLE = ('sensor_all_zero', 'zero_filled', 'held')
"""Ids of findings which state that samples of a sensor are zero or repeated. When such a fault, or
a fault of `ABSENT` or `UNTIMED`, ends after the first samples, new sensor streams begin."""

ABSENT = ('sensor_absent', 'axis_absent')
"""Ids of findings which state that a sensor or an axis has no usable values."""

UNTIMED = ('stamps_missing', 'stamps_unusable', 'stamps_from_rate')
"""Ids of findings which state that the stamps are not usable."""

STILL_IDLE = 0.05
"""A fault of zero or repeated samples has ended if their share is below this value."""


class Present(NamedTuple):
    """State of a stream, known faults of its latest samples, and noise of each axis.

    ``noise`` maps each axis whose noise is known to the standard deviation of its white noise in
    the unit of the samples. In a motion, the noise is not known.
    """

    state: State
    faults: tuple[Finding, ...]
    noise: dict[str, float]


@dataclass(frozen=True)
class Accumulation:
    """Results of a stream: Allan sums, health, findings and segments.

    ``sums`` has one entry for all axes, or one per sensor, for example if their rates differ. An
    axis without data is in no entry. After a change of the sample rate or the frame_id, or after a
    fault, ``sums`` contains the sums with the longest elapsed time of each axis. An axis can then
    be in two entries, and its longer sums are in the later one. ``segments`` are the longest
    segments of the first entry of ``sums``.
    """

    sums: tuple[AllanSums, ...]
    health: StreamHealth
    findings: tuple[Finding, ...]
    segments: tuple[Segment, ...]


class ImuStream:
    """Accumulates the Allan sums of one stream of IMU samples.

    The sums are the same, bit for bit, however the samples are divided into batches: each decision
    is made at a position that is counted from the first sample, with a fixed look-ahead.
    ``hardware_id`` identifies the IMU if the user states it. ``sensor`` is 'gyro' or 'accel' if the
    other sensor is in another stream; this stream then ignores the values of the other sensor.
    ``with_samples`` keeps samples at rest in memory (`samples`). ``with_drives`` keeps the errors
    of the latest drives between two rests. ``with_means`` keeps the latest means over one second.

    With ``covered``, each time is counted once for each frame_id, as far as `CoveredTime` stores
    the earlier times: samples are excluded if earlier samples cover their time, or if their time is
    in one of the stretches ``covered``, (first, last) stamp in ns.
    """

    def __init__(
        self,
        settings: SegmenterSettings = SegmenterSettings(),
        hardware_id: str = '',
        sensor: str = '',
        with_samples: bool = False,
        with_drives: bool = False,
        covered: Sequence[tuple[int, int]] | None = None,
        with_means: bool = False,
    ) -> None:
        self._hardware_id = hardware_id
        self._settings = settings
        self._options = settings, sensor, with_samples, with_drives, with_means, covered
        self._received = 0
        self._frames: dict[str, FrameStream] = {}
        self._present = FrameStream(ImuIdentity('', hardware_id), *self._options)
        self._frame_changes = 0
        self._ended = False  # whether `end` was called after the last sample
        self._dropped = Counts()  # counts of the frame_ids whose sums were discarded
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
        """Return the latest one-second means of static data of each present sensor stream.

        The result is empty unless ``with_means`` was set.
        """
        return tuple(s.means for s in self._present.sensors if s.means is not None)

    def samples(self) -> dict[str, tuple[Stamps, Floats]]:
        """Return axis -> stamps in ns, (n,), and values, (n,), of the samples at rest.

        Call `end` first; otherwise, the buffered samples are missing. The values are in the unit of
        the received samples. The samples belong to the frame_id with the largest number of used
        samples, and to one noise level (`NoiseLevels.published`) of each sensor stream. Samples
        before the sample rate was last learned are not included. The result is empty unless
        ``with_samples`` was set.
        """
        kept = [(s.axes, joined(s.kept)) for s in self._most_used.sensors if s.kept]
        return {
            axis: (block.stamps_ns, row)
            for axes, block in kept
            for axis, row in zip(axes, block.rows)
        }

    @property
    def _most_used(self) -> FrameStream:
        """The stream of the frame_id with the largest number of used samples."""
        return max(self._frames.values(), key=lambda f: f.counts.used, default=self._present)

    def drives(self) -> Drives:
        """Return the latest drives between two rests; empty unless ``with_drives`` was set.

        The drives have the frame_id with the largest number of used samples, and the latest sample
        rate that is known.
        There are none if an axis is absent, if gyro and accelerometer have different rates or are
        in different streams, or if motion detection is switched off. Before `end`, a drive is
        included when its second rest is over or long enough.
        """
        recorders = [s.recorder for s in self._most_used.sensors if s.recorder is not None]
        if not recorders:
            return NO_DRIVES
        return recorders[0].result if self._ended else recorders[0].complete

    def result(self) -> Accumulation:
        """Return the results as if the input ended here; the stream is not changed."""
        ended = self if self._ended else self._at_end()
        longest = ended._longest()
        sums = tuple(stream_sums.sums for stream_sums in longest)
        segments = longest[0].segments if longest else ()
        return Accumulation(sums, *ended._health(self._state_with(ended), sums), segments)

    def present_health(
        self, sums: tuple[AllanSums, ...]
    ) -> tuple[StreamHealth, tuple[Finding, ...]]:
        """Return the present health and findings; faster than `result` after the first samples.

        ``sums`` are the sums of an earlier `result`. Unless the state is 'waiting' or 'learning',
        samples that are not classified yet are counted neither as used nor as excluded.
        """
        present = self._present.present_state
        if present.state not in ('waiting', 'learning'):
            return self._health(present, sums)
        # while the noise floor is learned, the latest samples are buffered, and not classified yet
        ended = self if self._ended else self._at_end()
        return ended._health(self._state_with(ended), sums)

    def _at_end(self) -> ImuStream:
        """Return a copy of the stream, as if the input ended here."""
        ended = copy.deepcopy(self)
        ended.end()
        return ended

    def _state_with(self, ended: ImuStream) -> Present:
        """Return the present state; ``ended`` is the stream as if the input ended here.

        While the noise floor is learned, only ``ended`` shows whether the first samples are moving.
        """
        present, at_end = self._present.present_state, ended._present.present_state
        is_first = present.state in ('waiting', 'learning')
        return at_end if is_first and at_end.state == 'moving' else present

    def _add_frame(self, frame_id: str) -> FrameStream:
        """Start the stream of a new frame_id.

        If there are two streams already, the one with fewer used samples is removed.
        """
        if len(self._frames) > 1:
            smallest = min(self._frames.values(), key=lambda frame: frame.counts.used)
            del self._frames[smallest.identity.frame_id]
            self._dropped.other_frame += smallest.received
            self._dropped_frames += 1
        frame = FrameStream(ImuIdentity(frame_id, self._hardware_id), *self._options)
        self._frames[frame_id] = frame
        return frame

    def _longest(self) -> tuple[StreamSums, ...]:
        """Return, for each axis with data, the Allan sums with the longest elapsed time.

        Sums that are the longest for several axes are returned once. If an axis is in two of the
        sums, the longer sums come last.
        """
        frames = self._frames.values()
        sensors = [sensor for frame in frames for sensor in (*frame.earlier, *frame.sensors)]
        results = [stream_sums for sensor in sensors for stream_sums in sensor.by_rate()]
        longest: dict[str, StreamSums] = {}
        for stream_sums in sorted(results, key=lambda result: -result.sums.elapsed_ns):
            for axis in stream_sums.sums.axes:
                longest.setdefault(axis, stream_sums)
        entries = [*{id(longest[a]): longest[a] for a in AXES if a in longest}.values()]
        if sum(len(entry.sums.axes) for entry in entries) > len(longest):  # an axis is in two sums
            entries.sort(key=lambda entry: entry.sums.elapsed_ns)
        return tuple(entries)

    def _health(
        self, present: Present, sums: tuple[AllanSums, ...]
    ) -> tuple[StreamHealth, tuple[Finding, ...]]:
        """Return the health and findings of the stream; ``sums`` are the reported Allan sums."""
        frame = self._present
        counts = Counts(received=self._received)
        for frame_counts in (self._dropped, *(frame.counts for frame in self._frames.values())):
            counts.add(frame_counts)
        clock = frame.sensors[0].clock.clock if frame.sensors else None
        gates = [sensor.gate for sensor in frame.sensors if sensor.gate is not None]
        streams = [s for frame in self._frames.values() for s in (*frame.earlier, *frame.sensors)]
        health = StreamHealth(
            counts=counts,
            state=present.state,
            rate_hz=1e9 / clock.period_ns if clock else None,
            bursty=clock.bursty if clock else False,
            base_rate_hz=1e9 / clock.base_ns if clock and clock.base_ns else None,
            first_ns=frame.first_ns,
            stamps='record' if frame.stamps.use_record else 'header',
            frame_id=frame.identity.frame_id,
            sums_frame_id=sums[0].identity.frame_id if sums else frame.identity.frame_id,
            frame_changes=self._frame_changes,
            discarded=sum(stream.lost for stream in streams),
            largest_increase=_united(gate.increases for gate in gates),
            discarded_s=max((stream.lost_s for stream in streams), default=0.0),
            outliers=_united(gate.heavy_tails for gate in gates),
            events=tuple(e for s in (*frame.earlier, *frame.sensors) for e in s.events.items),
            dropped_frames=self._dropped_frames,
            largest_decrease=_united(gate.decreases for gate in gates),
            stuck_axes=tuple(axis for gate in gates for axis in gate.stuck),
            clipped=_united(sensor.clipped for sensor in frame.sensors),
            faults=present.faults,
            noise=present.noise,
        )
        notes = [note for frame in self._frames.values() for note in frame.notes]
        if repeated := sum(frame.repeated for frame in self._frames.values()):
            notes.append(finding('time_repeated', count=repeated))
        interleaved = [sensor for sensor in frame.sensors if sensor.is_interleaved]
        notes += [finding('interleaved', sensor.axes) for sensor in interleaved]
        if clock is not None:  # the stamps became usable later
            notes = [note for note in notes if note.id != 'stamps_missing']
        # when the clipped share of all samples is known, it replaces the share of the first samples
        if any(sensor.is_examined or sensor.lost for sensor in frame.sensors):
            notes = [note for note in notes if note.id != 'clipped']
        findings = [*notes, *stream_findings(health, sums, self._settings)]
        return health, tuple(dict.fromkeys(findings))


def _united(parts: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return one dict with the axes of all ``parts``: axis -> number."""
    return {axis: number for part in parts for axis, number in part.items()}


class FrameStream:
    """Chooses the stamps of the samples with one frame_id, and divides them into sensor streams.

    ``sensors`` contains one stream for all usable axes, or one stream per sensor, for example if
    the rates differ. It is empty while the first samples are buffered, and if no axis is usable.
    ``notes`` are the findings about these samples. If the first samples have a fault that may end
    (`IDLE`, `ABSENT`, `UNTIMED`), the next samples are examined, `CHECKED` at a time, before they
    are processed. When the fault has ended, new sensor streams begin, and the former streams become
    ``earlier``.
    """

    def __init__(
        self,
        identity: ImuIdentity,
        settings: SegmenterSettings,
        sensor: str,
        with_samples: bool,
        with_drives: bool,
        with_means: bool,
        covered: Sequence[tuple[int, int]] | None,
    ) -> None:
        self.identity = identity
        self._options = settings, with_samples, with_drives, with_means
        self.sensors: tuple[SensorStream, ...] = ()
        self.earlier: tuple[SensorStream, ...] = ()
        self._dropped = Counts()  # counts of sensor streams that ended before `earlier`
        # faults that were found in the first samples, and that may end later
        self._faulty: tuple[Finding, ...] = ()
        self.notes: list[Finding] = []
        self.first_ns: int | None = None
        self.received = 0
        self.stamps = StampChoice(settings.stamps == 'record', settings.declared_rate)
        self._settings = settings
        self._sensor = sensor  # the only sensor that is used; '' for both
        self._sorter = StampSorter()
        self._buffer: list[ImuBatch] = []  # samples that are not evaluated yet
        self._skip_ns = round(settings.skip * 1e9)  # length of the warm-up time; 0 after its end
        self._skipped = 0  # number of samples in the warm-up time
        self._covered = None if covered is None else CoveredTime(covered)

    @property
    def state(self) -> State:
        """State of the first sensor stream; 'noise_increased' if any sensor stream has this state.

        Without a sensor stream, the state is 'learning' if samples are buffered, else 'waiting'.
        """
        states = [sensor.state for sensor in self.sensors]
        if not states:
            return 'learning' if self._buffered else 'waiting'
        return 'noise_increased' if 'noise_increased' in states else states[0]

    @property
    def _buffered(self) -> int:
        """Number of samples that are not evaluated yet."""
        return sum(map(len, self._buffer))

    @property
    def present_state(self) -> Present:
        """State, known faults and noise of the samples that were classified last."""
        gates = [sensor.gate for sensor in self.sensors if sensor.gate is not None]
        return Present(
            self.state,
            tuple(fault for gate in gates for fault in gate.faults),
            _united(gate.noise for gate in gates),
        )

    @property
    def repeated(self) -> int:
        """Number of samples that were excluded because their time was covered already."""
        return 0 if self._covered is None else self._covered.dropped

    @property
    def counts(self) -> Counts:
        """Counts of all sensor streams; ``received`` is 0, because `ImuStream` counts it."""
        counts = Counts(skipped=self._skipped + self.repeated, reordered=self._sorter.sorted)
        counts.add(self._dropped)
        for sensor in (*self.earlier, *self.sensors):
            counts.add(sensor.counts)
        return counts

    def update(self, batch: ImuBatch) -> None:
        """Process the next samples with this frame_id."""
        self.received += len(batch)
        while len(batch) and (self._faulty or not self.sensors):
            batch = self._watch(batch) if self.sensors else self._learn_from(batch)
        self._feed(*self._sorter.feed(self.stamps.of(batch)))

    def flush(self) -> None:
        """Process all buffered samples at the end of the input, and close the segment."""
        if self.sensors:
            self._take_buffered()
        elif self._buffered:
            self._learn()
        self._feed(self._sorter.flush())
        for sensor in self.sensors:
            sensor.flush()

    def _learn_from(self, batch: ImuBatch) -> ImuBatch:
        """Buffer the first samples until they suffice to learn from; return the other samples."""
        stamps = [samples.stamps_ns for samples in (*self._buffer, batch[:LEARN])]
        number_needed = learned_from(np.concatenate(stamps))
        number_taken = min((number_needed or LEARN) - self._buffered, len(batch))
        self._buffer.append(batch[np.arange(number_taken)])  # an index array makes a copy
        if self._buffered == number_needed:
            self._learn()
        return batch[number_taken:]

    def _learn(self) -> None:
        """Choose stamps and sensor streams from the buffered samples; process these samples."""
        first, self._buffer = joined(self._buffer), []
        notes = self.stamps.learn(first)
        samples = self.stamps.of(first)
        plans, findings = plan_sensors(StampSorter.all_sorted(samples), self._sensor)
        self.notes += [note for note in (*notes, *findings) if note not in self.notes]
        self._sorter = StampSorter(samples.stamps_ns)
        self.sensors = tuple(SensorStream(plan, self.identity, *self._options) for plan in plans)
        ids_that_may_end = (*IDLE, *ABSENT, *UNTIMED)
        self._faulty = tuple(note for note in self.notes if note.id in ids_that_may_end)
        self._feed(*self._sorter.feed(samples))

    def _watch(self, batch: ImuBatch) -> ImuBatch:
        """Process samples, `CHECKED` at a time, until a fault of the first samples has ended.

        Returns the samples that are not processed or buffered yet.
        """
        buffered, self._buffer = joined([*self._buffer, batch], copy=True), []
        for begin in range(0, len(buffered) - CHECKED + 1, CHECKED):
            group = buffered.part(slice(begin, begin + CHECKED))
            if any(self._has_ended(note, group) for note in self._faulty):
                self._feed(*self._sorter.feed(self.stamps.of(buffered.part(slice(begin)))))
                self._start_again(group)
                return buffered.part(slice(begin + CHECKED, None))
        number_checked = len(buffered) // CHECKED * CHECKED
        self._feed(*self._sorter.feed(self.stamps.of(buffered.part(slice(number_checked)))))
        self._buffer = [buffered.part(slice(number_checked, None)).copy()]
        return batch[:0]

    def _has_ended(self, note: Finding, samples: ImuBatch) -> bool:
        """Return whether a fault of the first samples is no longer found in ``samples``."""
        if note.id in UNTIMED:
            return are_ordered(samples)
        rows = samples.rows[[AXES.index(axis) for axis in note.axes]]
        is_finite = np.abs(rows) <= LARGEST
        if note.id in ABSENT:
            return bool(is_finite.any(axis=0).mean() > 0.5)
        usable = rows[:, is_finite.all(axis=0)]
        return bool(usable.size and idle_share(usable, usable.shape[1])[0] < STILL_IDLE)

    def _take_buffered(self) -> None:
        for samples in self._buffer:
            self._feed(*self._sorter.feed(self.stamps.of(samples)))
        self._buffer = []

    def _start_again(self, samples: ImuBatch) -> None:
        """End the present sensor streams, and learn new ones, beginning with ``samples``."""
        self._feed(self._sorter.flush())
        for sensor in self.sensors:
            sensor.flush()
        for sensor in self.earlier:
            self._dropped.add(sensor.counts)
        self._dropped.reordered += self._sorter.sorted
        self.earlier, self.sensors = self.sensors, ()
        self.notes = [note for note in self.notes if note not in self._faulty]
        self._faulty, self._buffer = (), [samples]

    def _feed(self, *parts: ImuBatch) -> None:
        """Process the next samples, which `StampSorter` has returned, in one or several parts."""
        used_parts: list[ImuBatch] = []
        for samples in parts:
            if self._covered is not None:
                samples = self._covered.feed(samples)
            if not len(samples):
                continue
            if self.first_ns is None:
                self.first_ns = int(samples.stamps_ns[0])
            if self._skip_ns:
                is_used = samples.stamps_ns >= self.first_ns + self._skip_ns
                first_used = int(np.argmax(is_used)) if is_used.any() else len(samples)
                self._skip_ns *= not is_used.any()
                self._skipped += first_used
                samples = samples.part(slice(first_used, None))
            used_parts.append(samples)
        for sensor in self.sensors if used_parts else ():
            sensor.feed(*used_parts)
