# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read recordings and compute their Allan sums, in one or in several processes.

The Allan sums are bit for bit the same for any number of processes.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from copy import deepcopy
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime, timezone
from functools import reduce
from itertools import product
from operator import add
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..core.allan.sums import AllanSums, add_sums
from ..core.errors import AllanError
from ..core.findings import SEVERITIES, Finding, finding
from ..core.imu import EPOCH_S, MAX_NAME, NANOSECONDS, SENSORS, ImuIdentity, sensor_of
from ..core.settings import SegmenterSettings
from ..core.stream.drive_recorder import NO_DRIVES, Drives
from ..core.stream.health import Counts, Event, Segment
from ..core.stream.pipeline import ImuStream
from ..core.stream.signal import SignalEnvelope, TemperatureTrace
from . import open_recording
from .recording import ReadOptions, Recording, SourceInfo


@dataclass(frozen=True)
class Provenance:
    """The origin of Allan sums, stored with the sums in `sums.json` and `results.json`.

    ``segments`` contains at most the `health.LISTED_SEGMENTS` longest segments of each recording,
    in the order of time, or the longest first if they were read from a document. Findings come from
    the reader and the stream. Settings are plain values. ``last_stamp_ns`` is the latest stamp that
    a node has received, so that samples do not count twice if simulated time jumps back; it is None
    for a recording.
    """

    sources: tuple[SourceInfo, ...] = ()
    segments: tuple[Segment, ...] = ()
    findings: tuple[Finding, ...] = ()
    counts: Counts = field(default_factory=Counts)
    settings: Mapping[str, Any] = field(default_factory=dict)
    last_stamp_ns: int | None = None

    def __add__(self, other: Provenance) -> Provenance:
        """Return the combined provenance, with the settings of ``self``.

        A finding that is in both provenances occurs only once in the result.
        """
        counts = deepcopy(self.counts)
        counts.add(other.counts)
        stamps = [t for t in (self.last_stamp_ns, other.last_stamp_ns) if t is not None]
        return Provenance(
            self.sources + other.sources,
            tuple(sorted(self.segments + other.segments, key=lambda s: s.start_ns)),
            tuple(dict.fromkeys(self.findings + other.findings)),
            counts,
            self.settings,
            max(stamps, default=None),
        )

    @property
    def start(self) -> datetime | None:
        """Start of the first of the listed segments in UTC, in whole seconds.

        It is None without segments, or if the stamps do not count from 1970.
        """
        start_s = min((s.start_ns for s in self.segments), default=0) // NANOSECONDS
        return datetime.fromtimestamp(start_s, timezone.utc) if start_s >= EPOCH_S[0] else None

    def with_accel(self, accel: Provenance) -> Provenance:
        """Return the combined provenance of a gyro topic and its accelerometer topic.

        Only the segments of the gyro are kept.
        """
        return replace(self + accel, segments=self.segments)


@dataclass(frozen=True)
class RecordingSums:
    """The Allan sums of one or more recordings of one IMU, with the data for a report.

    ``signals`` and ``events`` are empty unless the `ReadJob` requested them.
    """

    name: str  # path of the first recording
    sums: tuple[AllanSums, ...]  # one for all axes, or separate ones for gyro and accel
    provenance: Provenance = field(default_factory=Provenance)
    signals: tuple[SignalEnvelope, ...] = ()  # signal of each recording
    # temperature over time of each recording; None for a recording without temperature
    temperatures: tuple[TemperatureTrace | None, ...] = ()
    events: tuple[Event, ...] = ()  # the longest shocks, motions and changes of noise
    drives: Drives = NO_DRIVES  # errors of the drives, which are motions between two rests

    def __add__(self, other: RecordingSums) -> RecordingSums:
        """Return the Allan sums of both recordings together.

        Raises AllanError when the sums cannot be added, for example because the recordings are of
        different IMUs, or when the recordings have a segment or too much time in common
        (`MAX_SHARED_TIME`).
        """
        try:
            sums = add_sums(self.sums, other.sums)
        except AllanError as error:
            raise AllanError(f'{self.name} and {other.name}: {error}') from error
        if any(_share_a_segment(a, b) for a, b in product(self.sums, other.sums)):
            raise AllanError(
                f'{other.name} contains samples of an earlier recording: give each '
                'recording once, because samples must not count twice'
            )
        if shared_s := _shared_time_s(self.provenance.segments, other.provenance.segments):
            raise AllanError(
                f'{other.name} and {self.name} have {shared_s:.0f} s in common: samples must not '
                'count twice, so give only one of these recordings; analyze two IMUs separately'
            )
        return RecordingSums(
            self.name,
            sums,
            self.provenance + other.provenance,
            self.signals + other.signals,
            self.temperatures + other.temperatures,
            self.events + other.events,
            self.drives + other.drives,
        )

    def temperature_readings(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the times in ns, (n,), and values in degC, (n,), of the kept temperature readings.

        The readings are sorted by time. The times of the readings of a recording are header stamps
        if at least two of these stamps lie between the start of the first and the end of the last
        listed segment of all recordings. Otherwise, the times are record times.
        """
        segments = self.provenance.segments
        begin = min((s.start_ns for s in segments), default=0)
        end = max((s.start_ns + s.duration_s * 1e9 for s in segments), default=0.0)
        times, values = [np.zeros(0, np.int64)], [np.zeros(0)]
        for trace in self.temperatures:
            if trace is not None:
                is_inside = (trace.header_ns >= begin) & (trace.header_ns <= end)
                times.append(trace.header_ns if is_inside.sum() > 1 else trace.record_ns)
                values.append(trace.celsius)
        order = np.argsort(np.concatenate(times), kind='stable')
        return np.concatenate(times)[order], np.concatenate(values)[order]

    def with_serial(self, serial: str) -> RecordingSums:
        """Return a copy in which the IMU has the serial number ``serial``."""
        sums = (replace(s, identity=s.identity._replace(hardware_id=serial)) for s in self.sums)
        return replace(self, sums=tuple(sums))

    def with_findings(self, findings: Iterable[Finding]) -> RecordingSums:
        """Return a copy with further findings."""
        return replace(self, provenance=self.provenance + Provenance(findings=tuple(findings)))


@dataclass(frozen=True)
class ReadJob:
    """The path of a recording and the settings for reading it, which can be sent to a process.

    ``with_context`` requests the data for a report: signals and events. Raises AllanError when
    ``hardware_id`` has more than `MAX_NAME` characters.
    """

    path: str
    reading: ReadOptions = field(default_factory=ReadOptions)
    segmenter: SegmenterSettings = field(default_factory=SegmenterSettings)
    hardware_id: str = ''
    with_context: bool = False

    def __post_init__(self) -> None:
        if len(self.hardware_id) > MAX_NAME:
            raise AllanError(
                f'the hardware id has {len(self.hardware_id)} characters, '
                f'{self.hardware_id[:20]!r} ...: give the serial number of the IMU'
            )

    def open(self) -> Recording:
        """Open the recording; raise AllanError when this is impossible."""
        return open_recording(self.path, self.reading)


def read_recording(
    job: ReadJob,
    recording: Recording | None = None,
    advance: Callable[[int], None] = lambda samples: None,
) -> RecordingSums:
    """Return the Allan sums of one recording. Each topic is read once from start to end.

    A bag whose accelerometer has a separate topic is therefore read twice.

    Parameters
    ----------
    job : ReadJob
        Path and settings.
    recording : Recording, optional
        The open recording of the job; by default ``job.open()``.
    advance : callable
        Function that is called with the number of samples of each batch.

    Raises
    ------
    AllanError
        When the recording cannot be read, or contains no static data.
    """
    recording = job.open() if recording is None else recording
    recorded = _read_topic(job, recording, advance)
    if recording.accel is None:
        return recorded
    return _joined(recorded, _read_topic(job, recording.accel, advance))


def _read_topic(
    job: ReadJob, recording: Recording, advance: Callable[[int], None]
) -> RecordingSums:
    stream = ImuStream(job.segmenter, job.hardware_id, recording.sensor, with_drives=True)
    signal = SignalEnvelope()
    for batch in recording.batches():
        stream.update(batch)
        if job.with_context:
            signal.update(batch)
        advance(len(batch))
    stream.end()
    streamed = stream.result()
    findings = tuple(
        f
        for f in (*recording.findings, *streamed.findings)
        if not f.axes or not {*f.axes}.isdisjoint(recording.axes)
    )
    findings += _other_topic(recording, findings)
    counts = streamed.health.counts
    if not streamed.sums:
        raise _no_data(job, recording.info.topic, counts, findings)
    settings = {
        **asdict(job.segmenter),
        **asdict(recording.options),
        'hardware_id': job.hardware_id,
    }
    provenance = Provenance((recording.info,), streamed.segments, findings, counts, settings)
    temperatures = (recording.temperature(streamed.sums[0].identity.frame_id),)
    if not job.with_context:
        return RecordingSums(
            job.path, streamed.sums, provenance, temperatures=temperatures, drives=stream.drives()
        )
    events, drives = streamed.health.events, stream.drives()
    return RecordingSums(
        job.path, streamed.sums, provenance, (signal,), temperatures, events, drives
    )


def with_accel(
    gyro: Sequence[AllanSums], accel: Sequence[AllanSums], identity: ImuIdentity
) -> tuple[AllanSums, ...]:
    """Return the Allan sums of two topics of one IMU, all with the same identity.

    Parameters
    ----------
    gyro, accel : sequence of AllanSums
        The sums of both topics.
    identity : ImuIdentity
        Identity of the IMU according to the gyro topic, also for the sums of the accelerometer.
    """
    return (*gyro, *(replace(sums, identity=identity) for sums in accel))


def _joined(gyro: RecordingSums, accel: RecordingSums) -> RecordingSums:
    events = sorted((*gyro.events, *accel.events), key=lambda event: event.start_ns)
    return replace(
        gyro,
        sums=with_accel(gyro.sums, accel.sums, gyro.sums[0].identity),
        provenance=gyro.provenance.with_accel(accel.provenance),
        signals=tuple(a.with_accel(b) for a, b in zip(gyro.signals, accel.signals)),
        temperatures=tuple(a or b for a, b in zip(gyro.temperatures, accel.temperatures)),
        events=tuple(events),
    )


def _other_topic(recording: Recording, findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return a finding if a sensor is absent, and another topic of the bag may contain it."""
    absent = [f for f in findings if f.id in ('sensor_absent', 'sensor_all_zero')]
    if not (absent and recording.other_topics):
        return ()
    axes, read_topic, other_topic = absent[0].axes, recording.info.topic, recording.other_topics[0]
    sensor = sensor_of(axes[0])
    gyro, accel = (other_topic, read_topic) if sensor == 'gyro' else (read_topic, other_topic)
    return (
        finding('sensor_elsewhere', axes, sensor=sensor, other=other_topic, gyro=gyro, accel=accel),
    )


def _no_data(job: ReadJob, topic: str, counts: Counts, findings: Sequence[Finding]) -> AllanError:
    causes = [f for f in findings if f.id not in ('nothing_left', 'unit_assumed')]
    worst_severity = min((SEVERITIES.index(f.severity) for f in causes), default=0)
    worst_causes = tuple(f for f in causes if SEVERITIES.index(f.severity) == worst_severity)
    reason = ''
    if counts.skipped and counts.skipped == counts.received:
        worst_causes = ()
        reason = f' --skip {job.segmenter.skip:g} (s) excludes the complete recording: reduce it'
    elif not worst_causes:
        reason = ' it is too short' if counts.received else ' it has no samples'
    samples = f'{counts.received:,} sample' + 's' * (counts.received != 1)
    where = f'{job.path}: topic {topic}' if job.reading.accel_topic else job.path
    return AllanError(f'{where}: no static data in {samples}:{reason}', worst_causes)


def _share_a_segment(a: AllanSums, b: AllanSums) -> bool:
    """Return whether ``a`` and ``b`` have a segment in common.

    Segments with the same start, length and block means are regarded as the same samples, because
    noise hardly repeats.
    """
    return any(
        (means_a.samples, means_a.start_ns) == (means_b.samples, means_b.start_ns)
        and np.array_equal(recording_a.reference, recording_b.reference)
        and np.array_equal(
            means_a.coarser(means_b.step).values, means_b.coarser(means_a.step).values
        )
        for recording_a, recording_b in product(a.recordings, b.recordings)
        for means_a, means_b in product(recording_a.means, recording_b.means)
    )


def _shared_time_s(a: Sequence[Segment], b: Sequence[Segment]) -> float:
    """Return the time in s that segments of two recordings have in common, if it is substantial.

    The result is 0 if the time is at most `MAX_SHARED_TIME` of the recording with less data, or if
    the stamps do not count from 1970. Recordings whose stamps count from a start of the computer
    can overlap although they were made on different days.
    """
    ranges_a, ranges_b = (
        [(s.start_ns * 1e-9, s.start_ns * 1e-9 + s.duration_s) for s in segments]
        for segments in (a, b)
    )
    if min((start for start, _ in (*ranges_a, *ranges_b)), default=0.0) < EPOCH_S[0]:
        return 0.0
    shared_s = sum(
        max(0.0, min(end_a, end_b) - max(start_a, start_b))
        for (start_a, end_a), (start_b, end_b) in product(ranges_a, ranges_b)
    )
    least_s = min(sum(end - start for start, end in ranges) for ranges in (ranges_a, ranges_b))
    return shared_s if shared_s > MAX_SHARED_TIME * least_s else 0.0


MAX_SHARED_TIME = 0.01
"""Two recordings can be added if the time that they have in common is at most this share of the
duration of the shorter recording."""


class Observer(Protocol):
    """Base class for objects that show the progress of reading recordings."""

    def progress(self, label: str, total: int | None) -> AbstractContextManager[Any]:
        """Return a context manager that yields an object with the method ``advance(samples)``.

        ``label`` describes the input. ``total`` is the number of samples of the input; None if
        unknown.
        """
        return contextlib.nullcontext(self)


class Silent(Observer):
    """An `Observer` that shows nothing."""

    def advance(self, samples: int) -> None: ...

    def __repr__(self) -> str:
        return 'Silent()'


def read_in_turn(jobs: Sequence[ReadJob], observer: Observer = Silent()) -> Iterator[RecordingSums]:
    """Read recordings one after the other in this process, and yield their Allan sums.

    Raises AllanError when a recording cannot be read, or contains no static data.
    """
    # All recordings are opened before the first is read, so that a wrong path is reported at once.
    recordings: list[Recording] = []
    for job in jobs:
        recordings.append(job.open())
        if recordings[1:]:
            recordings[-1].close()
    for job, recording in zip(jobs, recordings):
        with observer.progress(job.path, recording.messages) as progress:
            recorded = read_recording(job, recording, progress.advance)
        yield recorded


def read_in_processes(
    jobs: Sequence[ReadJob], processes: int, observer: Observer = Silent()
) -> Iterator[RecordingSums]:
    """Read recordings in several processes, and yield their Allan sums in the order of the jobs.

    Parameters
    ----------
    jobs : sequence of ReadJob
        The recordings, at least one.
    processes : int
        Largest number of processes.
    observer : Observer
        Shows the progress.

    Raises
    ------
    AllanError
        When a recording cannot be read or contains no static data, or when a process dies.
    """
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import active_children, get_context

    # 'spawn', because a fork would copy the locks of numpy's threads without the threads
    workers = min(processes, len(jobs))
    pool = ProcessPoolExecutor(workers, mp_context=get_context('spawn'))
    try:
        with _interrupts_blocked():
            futures = [pool.submit(read_recording, job) for job in jobs]
        with observer.progress(f'{len(jobs)} recordings in {workers} processes', None) as progress:
            for future in futures:
                recorded = future.result()
                progress.advance(recorded.provenance.counts.received)
                yield recorded
    except KeyboardInterrupt:
        for child in active_children():  # no file is left incomplete, because no task writes files
            child.terminate()
        raise
    except BrokenProcessPool as error:
        raise AllanError(
            f'one of {workers} processes died, probably because memory ran out: reduce --jobs'
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT in this thread, and in all processes that it starts within the context.

    On Windows, nothing is blocked.
    """
    if not hasattr(signal, 'pthread_sigmask'):  # Windows has no signal masks
        yield
        return
    previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)


def add_recordings(recordings: Iterable[RecordingSums]) -> RecordingSums:
    """Return the Allan sums of all recordings of one IMU, added in the order of their start.

    There must be at least one recording. Phone apps write one recording for each sensor. If all
    recordings are pairs of a gyro and an accelerometer that were recorded at the same time, each
    pair is joined as the two sensors of one IMU. Raises AllanError when recordings cannot be added.
    """
    return reduce(add, _with_both_sensors(sorted(recordings, key=_start_ns)))


def _with_both_sensors(recordings: Sequence[RecordingSums]) -> Sequence[RecordingSums]:
    """Join each recording of a gyro with the recording of an accelerometer from the same time.

    If any recording is not a part of such a pair, all recordings are returned unchanged.
    """
    sensors = [{sensor_of(axis) for s in r.sums for axis in s.axes} for r in recordings]
    gyros, accels = (
        [r for r, recorded_sensors in zip(recordings, sensors) if recorded_sensors == {sensor}]
        for sensor in SENSORS
    )
    pairs = list(zip(gyros, accels))
    if len(gyros) != len(accels) or len(gyros) + len(accels) < len(recordings):
        return recordings
    if not all(_overlap(gyro, accel) for gyro, accel in pairs):
        return recordings
    return [_joined(gyro, accel) for gyro, accel in pairs]


def _overlap(first: RecordingSums, second: RecordingSums) -> bool:
    """Return whether two recordings overlap for more than `MIN_OVERLAP` of the longer recording."""
    ranges = []
    for recorded in (first, second):
        times = [(s.start_ns * 1e-9, s.duration_s) for s in recorded.provenance.segments]
        begin = min((start for start, _ in times), default=0.0)
        ranges.append((begin, max((start + length for start, length in times), default=begin)))
    (a, b), (c, d) = ranges
    return min(b, d) - max(a, c) > MIN_OVERLAP * max(b - a, d - c)


MIN_OVERLAP = 0.5
"""Two recordings are regarded as made at the same time if they overlap for more than this share of
the duration of the longer recording."""


def _start_ns(recorded: RecordingSums) -> tuple[int, int]:
    starts = [period.begin_ns for s in recorded.sums for period in s.periods]
    return min(starts, default=0), sum(s.samples for s in recorded.sums)
