# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The evidence of each recording: one after the other, or spread over processes.

A recording is the unit: its samples feed one segmenter in order, and the sums of separate
recordings add up. So the ways differ in time only, not in what comes out.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace

from ..core.allan.spectrum import SpectrumSums
from ..core.errors import AllanError
from ..core.findings import Finding
from ..core.settings import SegmenterSettings
from ..core.stream.pipeline import ImuStream
from ..io.readers.open import open_recordings
from ..io.readers.recording import ReadOptions, Recording
from ..io.results import Provenance
from ..io.signal import SignalEnvelope, TemperatureTrace
from .console import Console
from .outcome import RecordingSums


@dataclass(frozen=True)
class Job:
    """One recording to read, as it can be sent to another process or machine."""

    path: str
    reading: ReadOptions
    evidence: SegmenterSettings
    hardware_id: str
    drawn: bool = False


@dataclass(frozen=True)
class Part:
    """What came of one recording: its sums, and if it is to be drawn, what is drawn beside them."""

    run: RecordingSums
    signal: SignalEnvelope
    spectra: tuple[SpectrumSums, ...] = ()
    temperature: TemperatureTrace | None = None


def accumulate(job: Job) -> Part:
    """Return the sums of one recording, reading it once from end to end.

    Raises
    ------
    AllanError
        When it cannot be read, or holds no evidence at all.
    """
    (recording,) = open_recordings([job.path], job.reading)
    return _accumulate(job, recording, lambda samples: None)


def in_turn(jobs: Sequence[Job], console: Console) -> Iterator[Part]:
    """Do the jobs one after the other, in this process."""
    # all are opened before the first is read: a wrong name shall not come out after an hour
    recordings = [open_recordings([job.path], job.reading)[0] for job in jobs]
    for job, recording in zip(jobs, recordings):
        bar = console.progress(job.path, recording.messages)
        with console.timed(f'read {job.path}'), bar as progress:
            part = _accumulate(job, recording, progress.advance)
        yield part


def in_processes(jobs: Sequence[Job], processes: int, console: Console) -> Iterator[Part]:
    """Do the jobs in so many processes at a time.

    Raises
    ------
    AllanError
        What a job raised, or that a process died.
    """
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import active_children, get_context

    # a fork would copy the threads' locks of numpy's libraries, but not the threads
    workers = min(processes, len(jobs))
    pool = ProcessPoolExecutor(workers, mp_context=get_context('spawn'))
    try:
        with _deaf_to_interrupts():
            futures = [pool.submit(accumulate, job) for job in jobs]
        with console.progress(f'{len(jobs)} recordings in {workers} processes', None) as progress:
            for future in futures:
                part = future.result()
                progress.advance(part.run.provenance.counts.received)
                yield part
    except KeyboardInterrupt:
        for child in active_children():  # none of them writes anything
            child.terminate()
        raise
    except BrokenProcessPool as error:
        raise AllanError(
            f'one of {workers} processes died, perhaps for want of memory: use fewer --jobs'
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Hold SIGINT back for a moment: what starts within never hears it, and leaves it to us."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def add_spectra(parts: Sequence[Part]) -> tuple[SpectrumSums, ...]:
    """Return the spectra of all parts as one for each sensor, or none where some part has none."""
    first, *others = parts
    if any(len(part.spectra) != len(first.spectra) for part in others):
        return ()
    return tuple(sum(more, start) for start, *more in zip(*(part.spectra for part in parts)))


def add_findings(part: Part, lost: Iterable[Finding]) -> Part:
    """Return the part with more to say of it."""
    run = part.run
    more = Provenance(findings=tuple(lost))
    return replace(part, run=RecordingSums(run.name, run.sums, run.provenance + more))


def _accumulate(job: Job, recording: Recording, advance: Callable[[int], None]) -> Part:
    accumulator = ImuStream(job.evidence, job.hardware_id, job.drawn)
    signal = SignalEnvelope()
    for batch in recording.batches():
        accumulator.update(batch)
        if job.drawn:
            signal.update(batch)
        advance(len(batch))
    accumulator.end()
    known = accumulator.result()
    findings = (*recording.findings, *known.findings)
    counts = known.health.counts
    if not known.sums:
        why = '; '.join(str(each) for each in findings if each.id != 'nothing_left')
        if counts.skipped and counts.skipped == counts.received:
            why = f'--skip {job.evidence.skip:g} (s) leaves out all of it: skip less'
        why = why or 'it has no samples'
        raise AllanError(f'{job.path}: no evidence among {counts.received:,} samples: {why}')
    settings = {**asdict(job.evidence), **asdict(job.reading), 'hardware_id': job.hardware_id}
    origin = Provenance((recording.info,), known.spans, findings, counts, settings)
    frame_id = known.sums[0].identity.frame_id
    temperature = recording.temperature(frame_id) if job.drawn else None
    return Part(RecordingSums(job.path, known.sums, origin), signal, known.spectra, temperature)
