# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`RecordingSums`: the sums and the context of one or more recordings, which can be added.

Recordings are read one after the other, or in several processes. Their sums are added, so the
result is the same, bit for bit.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from copy import deepcopy
from dataclasses import asdict, dataclass, field, replace
from functools import reduce
from itertools import product
from operator import add
from typing import TYPE_CHECKING, Any, Protocol

from ..core.allan.spectrum import SpectrumSums
from ..core.allan.sums import AllanSums, add_sums
from ..core.errors import AllanError
from ..core.findings import SEVERITIES, Finding
from ..core.settings import SegmenterSettings
from ..core.stream.health import Counts, Segment
from ..core.stream.pipeline import ImuStream
from .readers.open import open_recordings
from .readers.recording import ReadOptions, Recording, SourceInfo
from .signal import SignalEnvelope, TemperatureTrace

if TYPE_CHECKING:
    from .datasheets import DatasheetComparison


@dataclass(frozen=True)
class Provenance:
    """The origin of sums, stored next to them in `sums.json` and `results.json`.

    Segments are in recorded order, findings come from the reader and the stream, and settings are
    plain values. With simulated time, samples older than ``last_stamp_ns`` are a repeated pass.
    """

    sources: tuple[SourceInfo, ...] = ()
    segments: tuple[Segment, ...] = ()
    findings: tuple[Finding, ...] = ()
    counts: Counts = field(default_factory=Counts)
    settings: Mapping[str, Any] = field(default_factory=dict)
    last_stamp_ns: int | None = None

    def __add__(self, other: Provenance) -> Provenance:
        """Return the provenance of both: equal findings appear once, settings come from the
        first."""
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


@dataclass(frozen=True)
class RecordingSums:
    """The sums of one or more recordings of one IMU, with signal and spectrum for a report.

    There is one `AllanSums` with all axes, or one per sensor if the rates differ, each with its
    spectrum. There is a signal and a temperature for each recording. Spectra, signals and
    temperatures are empty unless they were requested. The name is the path of the first recording,
    and ``judged`` contains earlier comparisons with datasheets.
    """

    name: str
    sums: tuple[AllanSums, ...]
    provenance: Provenance = field(default_factory=Provenance)
    signals: tuple[SignalEnvelope, ...] = ()
    spectra: tuple[SpectrumSums, ...] = ()
    temperatures: tuple[TemperatureTrace | None, ...] = ()
    judged: tuple[DatasheetComparison, ...] = ()

    def __add__(self, other: RecordingSums) -> RecordingSums:
        """Return the sums of both recordings.

        Raises AllanError when the other recording is of another IMU (the message names the
        difference), or contains the same samples.
        """
        try:
            sums = add_sums(self.sums, other.sums)
        except AllanError as error:
            raise AllanError(f'{other.name} cannot be added to {self.name}: {error}') from error
        if any(_share_a_segment(a, b) for a, b in product(self.sums, other.sums)):
            raise AllanError(
                f'{other.name} contains samples of an earlier recording: give each '
                'recording once, because samples must not count twice'
            )
        same_spectra = len(self.spectra) == len(other.spectra)
        return RecordingSums(
            self.name,
            sums,
            self.provenance + other.provenance,
            self.signals + other.signals,
            tuple(a + b for a, b in zip(self.spectra, other.spectra)) if same_spectra else (),
            self.temperatures + other.temperatures,
            self.judged + other.judged,
        )

    def with_findings(self, findings: Iterable[Finding]) -> RecordingSums:
        """Return a copy with further findings."""
        return replace(self, provenance=self.provenance + Provenance(findings=tuple(findings)))


@dataclass(frozen=True)
class ReadJob:
    """One recording to read, in a form that can be sent to another process or machine.

    With context, the data for a report are kept: signal, spectrum and temperature.
    """

    path: str
    reading: ReadOptions = field(default_factory=ReadOptions)
    segmenter: SegmenterSettings = field(default_factory=SegmenterSettings)
    hardware_id: str = ''
    with_context: bool = False

    def open(self) -> Recording:
        """Open the recording without reading its samples."""
        (recording,) = open_recordings([self.path], self.reading)
        return recording


def read_recording(
    job: ReadJob,
    recording: Recording | None = None,
    advance: Callable[[int], None] = lambda samples: None,
) -> RecordingSums:
    """Return the sums of one recording, which is read once from start to end.

    By default the recording is ``job.open()``. ``advance`` is called with the number of samples of
    every batch. Raises AllanError when there is no static data.
    """
    recording = job.open() if recording is None else recording
    stream = ImuStream(job.segmenter, job.hardware_id, job.with_context)
    signal = SignalEnvelope()
    for batch in recording.batches():
        stream.update(batch)
        if job.with_context:
            signal.update(batch)
        advance(len(batch))
    stream.end()
    known = stream.result()
    findings = (*recording.findings, *known.findings)
    counts = known.health.counts
    if not known.sums:
        possible = [f for f in findings if not f.axes or {*f.axes} & {*recording.axes}]
        raise AllanError(_no_data(job, counts, possible))
    settings = {
        **asdict(job.segmenter),
        **asdict(recording.options),
        'hardware_id': job.hardware_id,
    }
    provenance = Provenance((recording.info,), known.segments, findings, counts, settings)
    if not job.with_context:
        return RecordingSums(job.path, known.sums, provenance)
    temperature = recording.temperature(known.sums[0].identity.frame_id)
    return RecordingSums(job.path, known.sums, provenance, (signal,), known.spectra, (temperature,))


def _no_data(job: ReadJob, counts: Counts, findings: Sequence[Finding]) -> str:
    causes = [f for f in findings if f.id not in ('nothing_left', 'unit_assumed')]
    causes.sort(key=lambda f: SEVERITIES.index(f.severity))
    why = '; '.join(map(str, causes))
    if counts.skipped and counts.skipped == counts.received:
        why = f'--skip {job.segmenter.skip:g} (s) excludes the complete recording: reduce it'
    why = why or ('it is too short' if counts.received else 'it has no samples')
    samples = f'{counts.received:,} sample' + 's' * (counts.received != 1)
    return f'{job.path}: no static data in {samples}: {why}'


def _share_a_segment(a: AllanSums, b: AllanSums) -> bool:
    """Return whether a segment is in both. (No two segments have the same noise.)"""
    return any(
        one.order == other.order and (one.phase == other.phase).all()
        for one in a.segments
        for other in b.segments
        if one.samples > 1
    )


class Observer(Protocol):
    """Receives the progress of reading recordings."""

    def progress(self, label: str, total: int | None) -> AbstractContextManager[Any]:
        """Return a context whose value has ``advance(samples)``."""
        return contextlib.nullcontext(self)

    def timed(self, what: str) -> AbstractContextManager[None]:
        """Return a context around one step."""
        return contextlib.nullcontext()


class Silent(Observer):
    """An `Observer` that does nothing."""

    def advance(self, samples: int) -> None: ...

    def __repr__(self) -> str:
        return 'Silent()'


def read_in_turn(jobs: Sequence[ReadJob], observer: Observer = Silent()) -> Iterator[RecordingSums]:
    """Read the recordings one after the other, in this process."""
    # All are opened before the first is read, so that a wrong name is reported at once.
    recordings = [job.open() for job in jobs]
    for job, recording in zip(jobs, recordings):
        bar = observer.progress(job.path, recording.messages)
        with observer.timed(f'read {job.path}'), bar as progress:
            recorded = read_recording(job, recording, progress.advance)
        yield recorded


def read_in_processes(
    jobs: Sequence[ReadJob], processes: int, observer: Observer = Silent()
) -> Iterator[RecordingSums]:
    """Read several recordings at a time in processes; the result is the same, bit for bit."""
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import active_children, get_context

    # a fork would copy the locks of numpy's threads, but not the threads
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
        for child in active_children():  # no task writes files
            child.terminate()
        raise
    except BrokenProcessPool as error:
        raise AllanError(
            f'one of {workers} processes died, probably for lack of memory: reduce --jobs'
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT, so that processes started meanwhile never receive it."""
    if not hasattr(signal, 'pthread_sigmask'):  # not on Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def add_recordings(recordings: Iterable[RecordingSums]) -> RecordingSums:
    """Return the sums of all recordings of one IMU.

    They are added from the earliest to the latest, so the order of the arguments does not matter.
    """
    return reduce(add, sorted(recordings, key=_start_ns))


def _start_ns(recorded: RecordingSums) -> tuple[int, int]:
    """Return the stamp of the first sample and the number of samples."""
    starts = [segment.start_ns for s in recorded.sums for segment in s.segments]
    return min(starts, default=0), sum(s.samples for s in recorded.sums)
