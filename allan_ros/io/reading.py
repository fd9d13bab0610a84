# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read several recordings to sums: one after the other, or in several processes.

Sums of separate recordings add, so both give the same result, bit for bit.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import reduce
from operator import add
from typing import Any, Protocol

from ..core.errors import AllanError
from .recorded import ReadJob, RecordingSums, read_recording


class Observer(Protocol):
    """Receives the progress of reading recordings."""

    def progress(self, label: str, total: int | None) -> AbstractContextManager[Any]:
        """Return a context whose value has ``advance(samples)``."""

    def timed(self, what: str) -> AbstractContextManager[None]:
        """Return a context around one step."""


class Silent:
    """An `Observer` that does nothing."""

    def progress(self, label: str, total: int | None) -> AbstractContextManager[Any]:
        return contextlib.nullcontext(self)

    def timed(self, what: str) -> AbstractContextManager[None]:
        return contextlib.nullcontext()

    def advance(self, samples: int) -> None: ...

    def __repr__(self) -> str:
        return 'Silent()'


def read_in_turn(jobs: Sequence[ReadJob], observer: Observer = Silent()) -> Iterator[RecordingSums]:
    """Read the recordings one after the other, in this process."""
    # All are opened before the first is read: a wrong name is reported now, not after an hour.
    recordings = [job.open() for job in jobs]
    for job, recording in zip(jobs, recordings):
        bar = observer.progress(job.path, recording.messages)
        with observer.timed(f'read {job.path}'), bar as progress:
            recorded = read_recording(job, recording, progress.advance)
        yield recorded


def read_in_processes(
    jobs: Sequence[ReadJob], processes: int, observer: Observer = Silent()
) -> Iterator[RecordingSums]:
    """Read the recordings in several processes at a time; the result is the same, bit for bit.

    Raises
    ------
    AllanError
        What a job raised, or that a process died.
    """
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
        for child in active_children():  # none of them writes anything
            child.terminate()
        raise
    except BrokenProcessPool as error:
        raise AllanError(
            f'one of {workers} processes died, perhaps for lack of memory: use fewer --jobs'
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT: processes started meanwhile never receive it and leave it to this one."""
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

    They are added from the earliest to the latest, so the sums do not depend on the order in which
    the recordings are given.

    Raises
    ------
    AllanError
        When one is of another IMU than the first, or was given twice.
    """
    return reduce(add, sorted(recordings, key=_start_ns))


def _start_ns(recorded: RecordingSums) -> tuple[int, int]:
    """Return the stamp of the first sample and the number of samples."""
    starts = [segment.start_ns for s in recorded.sums for segment in s.segments]
    return min(starts, default=0), sum(s.samples for s in recorded.sums)
